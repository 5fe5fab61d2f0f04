"""Logs with what options say of them: known payloads, how well gains are known."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from geodrake.boundary.arguments import number
from geodrake.errors import ArgumentError
from geodrake.logs.files import Reading
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog
from geodrake.model.carried_payloads import carried_phi
from geodrake.model.robot_model import RobotModel

_FORM = (
    "Write LOG:BODY:MASS or LOG:BODY:MASS:X,Y,Z in kg and m, such as log_2.csv:flange:3:0,0,0.1."
)


def with_known_payloads(
    files: Sequence[Path], logs: Sequence[JointLog], given: Sequence[str], model: RobotModel
) -> tuple[JointLog, ...]:
    """Return the logs with their known payloads.

    Args:
        given: `LOG:BODY:MASS[:X,Y,Z]`: path or name of a log, link of the robot, kg, and the centre
            of mass in the link's frame, m.
    """
    carried = known_payloads(files, given, model)
    return tuple(
        replace(log, payloads=carried[file]) if file in carried else log
        for file, log in zip(files, logs, strict=True)
    )


def known_payloads(
    files: Sequence[Path], given: Sequence[str], model: RobotModel
) -> dict[Path, tuple[KnownPayload, ...]]:
    """Log -> its known payloads, of logs that have some."""
    carried: dict[Path, list[KnownPayload]] = defaultdict(list)
    for text in given:
        log, payload = _parsed(text, files)
        carried[log].append(payload)
    for payloads in carried.values():
        carried_phi(model, tuple(payloads))  # bodies that there are not are refused before the work
    return {log: tuple(payloads) for log, payloads in carried.items()}


def with_facts(
    logs: Sequence[JointLog], facts: Mapping[str, Any], reading: Reading
) -> tuple[JointLog, ...]:
    """Return the logs with what is known of all of them.

    Args:
        facts: Fields of `JointLog` by name; of gains whose deviations were stated, these count.
    """
    found = []
    for log in logs:
        own = dict(facts)
        if (share := own.get("effort_uncertainty")) is not None:
            number(share, "effort_uncertainty", lower=0.0, upper=1.0)
            own["effort_uncertainty"] = reading.effort_uncertainty(log.joints, share)
        found.append(replace(log, **own))
    return tuple(found)


def _parsed(text: str, logs: Sequence[Path]) -> tuple[Path, KnownPayload]:
    """Return the log and the payload of one option."""
    names = {name: _named(name, logs) for log in logs for name in (str(log), log.name, log.stem)}
    name = max((n for n in names if text.startswith(f"{n}:")), key=len, default=None)
    if name is None:
        raise ArgumentError(
            f"--known-payload has {text!r}, and there is no such log.",
            advice=f"Logs are: {', '.join(map(str, logs))}. {_FORM}",
        )
    if len(names[name]) > 1:
        raise ArgumentError(
            f"--known-payload has {text!r}, and several logs are called {name!r}.",
            advice=f"Give the whole path: {' or '.join(map(str, names[name]))}.",
        )
    fields = text[len(name) + 1 :].split(":")
    place = _numbers(text, fields.pop()) if "," in fields[-1] else [0.0, 0.0, 0.0]
    body, mass = (
        ":".join(fields[:-1]),
        _numbers(text, fields[-1]),
    )  # names of bodies may have colons
    if not body or len(mass) != 1 or len(place) != 3:
        raise _malformed(text)
    return names[name][0], KnownPayload(body, mass[0], (place[0], place[1], place[2]))


def _named(name: str, logs: Sequence[Path]) -> list[Path]:
    """Return the logs that a path, a file's name or that without its ending stands for."""
    exact = [log for log in logs if str(log) == name]
    return exact or [log for log in logs if name in (log.name, log.stem)]


def _numbers(text: str, field: str) -> list[float]:
    try:
        return [float(part) for part in field.split(",")]
    except ValueError:
        raise _malformed(text) from None


def _malformed(text: str) -> ArgumentError:
    return ArgumentError(f"--known-payload has {text!r}, which cannot be read.", advice=_FORM)
