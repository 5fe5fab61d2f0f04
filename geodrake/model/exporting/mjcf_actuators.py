"""Actuators in MJCF: motors, position servos, and their delays.

MuJoCo (3.5 and later) keeps the last `nsample` control signals of an actuator, one of each step,
and reads the signal of `delay` ago from them. What is longer ago than they reach is read as the
oldest of them, unsaid, so nsample · step has to be the delay at least. What is younger than a step
is not there yet, so a delay is a step at least.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from geodrake.model.exporting.actuators import Actuator, actuators_of
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.mjcf_sections import with_sections
from geodrake.robot.files.reading import model_text_of
from geodrake.robot.files.values import words

SHORTEST_STEP = 1e-3
"""Step of the simulation, s, down to which delays are kept where the file's own is longer."""


def with_actuators(
    data: bytes, path: Path, model: RobotModel, *, anew: bool
) -> tuple[bytes, tuple[str, ...]]:
    """An MJCF file with actuators at the end, and with sensors of efforts that are measured late.

    Actuators of the file stay as they are, and the joints that they drive get no other one. A file
    of the user's own gets some only for servos and delays, which it does not hold otherwise.

    Args:
        data: The file.
        path: Where it is from, for messages.
        model: The model.
        anew: Whether the file was written from the model alone.

    Returns:
        The file, and notes on it.
    """
    text = model_text_of(data, path)
    if not isinstance(text, MjcfText) or model.transmission:
        return data, ()
    all_of_them, driven = actuators_of(model), text.driven_joints
    free = [each for each in all_of_them if each.joint not in driven]
    wanted = [each for each in all_of_them if each.is_servo or each.delay]
    kept = [each for each in wanted if each.joint in driven]
    notes = [_kept_note(kept, path)] if kept else []
    if text.actuator_defaults and set(wanted).intersection(free):
        notes.append(
            f"{path.name} has defaults of actuators, which would change what an export adds: it "
            "has no actuators for servos and delays of the model"
        )
        free = []
    late = [each for each in all_of_them if each.measured_late]
    adds = free if anew or set(wanted).intersection(free) else []
    if not adds and not late:
        return data, tuple(notes)
    step = min(text.timestep, SHORTEST_STEP)
    sections = {
        "actuator": [_actuator(each, step) for each in adds],
        "sensor": [_sensor(each, step) for each in late],
    }
    data = with_sections(data, path, sections, [each.joint for each in (*adds, *late)])
    return data, (*notes, *_notes(adds, late, step, text.timestep))


def samples_of(delay: float, step: float) -> int:
    """How many signals MuJoCo has to keep for a delay: one more than the steps that it takes.

    Args:
        delay: The delay, s.
        step: Step of the simulation, s.
    """
    return int(np.ceil(delay / step - 1e-9)) + 1


def _actuator(actuator: Actuator, step: float) -> str:
    name = quoteattr(actuator.joint)
    attributes = [f"name={name} joint={name}"]
    if actuator.is_servo:
        kp, kv = words(actuator.stiffness), words(actuator.damping)
        attributes.append(f'kp="{kp}" kv="{kv}"')
    if np.isfinite(actuator.limit):
        limit = words(np.array([-actuator.limit, actuator.limit]))
        attributes.append(f'forcelimited="true" forcerange="{limit}"')
        if not actuator.is_servo:
            attributes.append(f'ctrllimited="true" ctrlrange="{limit}"')
    if actuator.delay:
        attributes.append(_delay(actuator.delay, step))
    return f"<{'position' if actuator.is_servo else 'motor'} {' '.join(attributes)}/>"


def _sensor(actuator: Actuator, step: float) -> str:
    name, joint = quoteattr(f"{actuator.joint}_effort"), quoteattr(actuator.joint)
    late = _delay(actuator.measured_late, step)
    return f"<jointactuatorfrc name={name} joint={joint} {late}/>"


def _delay(delay: float, step: float) -> str:
    return f'delay="{words(delay)}" nsample="{samples_of(delay, step)}" interp="linear"'


def _notes(
    adds: Sequence[Actuator], late: Sequence[Actuator], step: float, timestep: float
) -> list[str]:
    notes = []
    damped = [each.joint for each in adds if each.is_servo and each.damping]
    if damped:
        notes.append(
            f"kv of {', '.join(damped)} damps the motion itself, and that of the model its error: "
            "told c + (kv / kp) dc/dt, they do the same"
        )
    delays = {each.joint: each.delay for each in adds if each.delay}
    delays |= {each.joint: each.measured_late for each in late}
    if delays:
        notes.append(
            "delays need MuJoCo 3.5 or later; they are kept with steps of the simulation of "
            f"{step:g} s and more, and shorter with others unless nsample grows"
        )
    if late:
        notes.append(
            f"efforts of {', '.join(each.joint for each in late)} are measured late: sensors "
            "<joint>_effort have them as the log does"
        )
    short = [joint for joint, delay in delays.items() if delay < timestep * (1.0 - 1e-9)]
    if short:
        notes.append(
            f"MuJoCo delays by one step at least, and the file's step of {timestep:g} s is longer "
            f"than the delay of {', '.join(short)}: make timestep {min(delays.values()):.3g} s or "
            "less"
        )
    return notes


def _kept_note(kept: Sequence[Actuator], path: Path) -> str:
    """What the user's own actuators would need to be those of the model."""
    words_of = []
    for each in kept:
        servo = f'kp="{words(each.stiffness)}" kv="{words(each.damping)}"' if each.is_servo else ""
        delay = _delay(each.delay, SHORTEST_STEP) if each.delay else ""
        words_of.append(f"{each.joint}: {' '.join(filter(None, (servo, delay)))}")
    return (
        f"actuators of {path.name} stay as they are; those of the model have {'; '.join(words_of)}"
    )
