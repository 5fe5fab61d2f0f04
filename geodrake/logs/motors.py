"""Published data of servos and actuators, for priors of their gains."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

import msgspec

from geodrake.boundary.arguments import file_path, typed
from geodrake.boundary.yaml_schema import Schema, as_schema
from geodrake.boundary.yaml_text import made_of_yaml
from geodrake.errors import ArgumentError, nearest

Published = tuple[float, float, str]
"""A value, its standard deviation, and its source."""

_TABLE = Path(__file__).parent / "motors.yaml"
_FORM = "Write, for example: my_servo: {stiffness: [17.8, 9.0, source of the values]}."
_GAINS = {"command": "stiffness", "current": "torque_constant", "pwm": "stall_torque"}


class Motor(Schema, kw_only=True):
    """Data of a servo or actuator, referred to its output."""

    name: str = ""  # its name in the table
    robots: tuple[str, ...] = ()  # words in the names of robots that have it at all joints
    stiffness: Published | None = None  # of its servo loop, N·m/rad
    torque_constant: Published | None = None  # N·m/A, gears included
    stall_torque: Published | None = None  # N·m, at a duty cycle of 1
    no_load_speed: Published | None = None  # rad/s
    gear_ratio: Published | None = None  # turns of the motor for one of the output
    armature: Published | None = None  # kg·m²
    damping: Published | None = None  # N·m·s/rad
    dry_friction: Published | None = None  # N·m

    def gain(self, kind: str) -> tuple[float, float] | None:
        """Return the published gain of a kind of signal and its standard deviation, or None."""
        name = _GAINS.get(kind)
        gain: Published | None = None if name is None else getattr(self, name)
        return None if gain is None else gain[:2]


def known_motors(path: str | Path | None = None) -> Mapping[str, Motor]:
    """Return the motors in geodrake's table, and in a file of the same form, by name."""
    return _motors_of(_TABLE) if path is None else {**_motors_of(_TABLE), **_read(file_path(path))}


@typed
def motor_named(name: str, motors: Mapping[str, Motor] | None = None) -> Motor:
    """Return the motor of a name, ignoring case, in geodrake's table or in `motors`."""
    table = known_motors() if motors is None else motors
    found = {_plain(key): motor for key, motor in table.items()}.get(_plain(name))
    if found is None:
        raise ArgumentError(
            f"Motor {name!r} is unknown.",
            advice=f"{nearest(name, table)}Known motors are {', '.join(table)}; "
            "--motors FILE.yaml adds others.",
        )
    return found


@typed
def motor_of_robot(name: str) -> Motor | None:
    """Return the motor of all joints of a robot by the robot's name, or None."""
    plain = _plain(name)
    motors = known_motors().values()
    return next((m for m in motors if any(word in plain for word in m.robots)), None)


def _read(path: Path) -> dict[str, Motor]:
    return made_of_yaml(path, "motors", ArgumentError, _motors, advice=_FORM)


def _motors(content: object) -> dict[str, Motor]:
    motors = as_schema(content, dict[str, Motor])
    for name, motor in motors.items():
        for quantity in motor.__struct_fields__[2:]:
            value = getattr(motor, quantity)
            if value is not None and not (value[0] > 0.0 and 0.0 <= value[1] < float("inf")):
                raise ArgumentError(f"{quantity} of {name} is {value[0]:.4g} ± {value[1]:.4g}.")
    return {name: msgspec.structs.replace(motor, name=name) for name, motor in motors.items()}


_motors_of = cache(_read)


def _plain(name: str) -> str:
    """Return the letters and digits of a name in lower case."""
    return "".join(c for c in name.lower() if c.isalnum())
