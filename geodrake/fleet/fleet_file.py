"""Files that describe a fleet: types with models, and robots with logs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import msgspec

from geodrake.boundary.arguments import file_path, number
from geodrake.boundary.showing import Short
from geodrake.boundary.yaml_schema import Schema, as_schema
from geodrake.boundary.yaml_text import made_of_yaml
from geodrake.errors import ArgumentError, FleetError
from geodrake.fleet.digest_log import Wanted
from geodrake.fleet.log_places import DATED_BY, absolute_pattern, check_date_pattern, home_path
from geodrake.logs.known_payload import KnownPayload

_FORM = (
    "Write `to: FOLDER`, `types:`, each with `model: FILE`, and `robots:`, a list of {name: NAME, "
    "type: TYPE, logs: PATTERN}."
)
_Text = str | int  # names may look like numbers


class _TypeSchema(Schema):
    """A type in a fleet file; see `FleetType`."""

    model: str
    own_effects: list[str] = msgspec.field(default_factory=list)
    effects: list[str] | None = None
    bandwidth: float | None = None
    blocks: int | None = None
    payload: float | None = None
    lock: dict[_Text, float] | None = None
    floating: bool = False
    transmission: str | None = None
    mapping: str | None = None
    units: dict[str, str] | None = None


class _PayloadSchema(Schema):
    """A payload in a fleet file; see `KnownPayload`."""

    body: str
    mass: float
    mass_center: list[float] = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class _RobotSchema(Schema):
    """A robot in a fleet file; see `FleetRobot`."""

    name: _Text
    logs: list[str] | str
    type: _Text | None = None
    model: str | None = None
    dates: str = "file"
    payloads: list[_PayloadSchema] | None = None


class _FleetSchema(Schema):
    """The content of a fleet file."""

    to: str
    types: dict[_Text, _TypeSchema]
    robots: list[_RobotSchema]


@dataclass(frozen=True)
class FleetType(Short):
    """A type of robots with the same model."""

    name: str
    model: Path
    own_effects: tuple[Path, ...] = ()  # Python files with user-defined effects
    effects: tuple[str, ...] | None = None  # added to each joint; None for friction and offsets
    bandwidth: float | None = None  # of the digests, Hz; None to choose it from the first log
    blocks: int | None = None  # number of blocks of each log; None for the default
    payload: float | None = None  # typical payload, kg; None for a tenth of the robot's mass
    lock: Mapping[str, float] = field(default_factory=dict)  # joint -> fixed position, rad or m
    floating: bool = False  # whether bodies that are not fixed to the world are free
    transmission: str | None = None  # transmission file, or `file` or `none`
    mapping: Path | None = None  # file with the meaning of the logs' columns
    units: Mapping[str, str] = field(default_factory=dict)  # quantity -> unit in the logs

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the type."""
        return (self.model, *self.own_effects, *filter(None, [self.mapping]))

    def __hash__(self) -> int:
        return hash((self.name, self.files))


@dataclass(frozen=True)
class FleetRobot(Short):
    """One robot of a fleet."""

    name: str
    type: str
    logs: tuple[str, ...]  # patterns: absolute paths or addresses, with `*`, `?`, `[…]` and `**`
    # Dates of logs whose time stamps are not dates: `file` for the modification time, `stamps` to
    # reject such logs, or a pattern of dates in paths such as `%Y-%m-%d`.
    dates: str = "file"
    payloads: tuple[KnownPayload, ...] = ()  # payloads in all logs that the model does not have
    model: Path | None = None  # the robot's own model file, for comparison; None for its type's


@dataclass(frozen=True)
class Fleet(Short):
    """Types and robots."""

    path: Path
    folder: Path  # of digests and results
    types: Mapping[str, FleetType]
    robots: tuple[FleetRobot, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the fleet, except logs."""
        models = [robot.model for robot in self.robots if robot.model is not None]
        return (self.path, *(file for kind in self.types.values() for file in kind.files), *models)

    def of_type(self, name: str) -> tuple[FleetRobot, ...]:
        """Return the robots of a type."""
        return tuple(robot for robot in self.robots if robot.type == name)


def read_fleet(path: str | Path) -> Fleet:
    """Read a fleet file, whose paths are relative to it.

    Raises:
        FleetError: It cannot be read, has invalid keys or values, or contains a robot twice.
    """
    path = file_path(path)
    return made_of_yaml(path, "fleet file", FleetError, partial(_fleet, path), advice=_FORM)


def _fleet(path: Path, content: object) -> Fleet:
    data, base = as_schema(content, _FleetSchema), path.absolute().parent
    if not data.types or not data.robots or not data.to:
        raise ArgumentError("`to`, `types` or `robots` is empty.", advice=_FORM)
    types = {str(name): _type(str(name), kind, base) for name, kind in data.types.items()}
    robots = tuple(_robot(robot, types, base) for robot in data.robots)
    names: set[str] = set()
    for robot in robots:
        if robot.name in names:
            raise ArgumentError(
                f"robot {robot.name!r} occurs twice.",
                advice="List all its logs in one entry.",
            )
        names.add(robot.name)
    for name in types:
        if not any(robot.type == name for robot in robots):
            raise ArgumentError(f"no robot is of type {name!r}.", advice="Remove the type.")
    return Fleet(path, base / home_path(data.to), types, robots)


def _type(name: str, data: _TypeSchema, base: Path) -> FleetType:
    title = f"type {name!r}"
    if not name.isprintable() or not name or "/" in name or name.startswith("."):
        raise ArgumentError(f"{title} has a name that a folder cannot have.", advice="Rename it.")
    Wanted(data.bandwidth, data.blocks)  # raises if they are invalid
    if data.payload is not None:
        number(data.payload, f"payload of {title}", lower=0.0, strict=True)
    lock = {str(joint): number(x, f"lock of {joint}") for joint, x in (data.lock or {}).items()}
    transmission = data.transmission
    if transmission is not None and transmission not in ("file", "none"):
        transmission = str(base / home_path(transmission))
    values = msgspec.structs.asdict(data) | {
        "model": base / home_path(data.model),
        "own_effects": tuple(base / home_path(file) for file in data.own_effects),
        "effects": None if data.effects is None else tuple(data.effects),
        "lock": lock,
        "transmission": transmission,
        "mapping": None if data.mapping is None else base / home_path(data.mapping),
        "units": data.units or {},
    }
    return FleetType(name, **values)


def _robot(data: _RobotSchema, types: Mapping[str, FleetType], base: Path) -> FleetRobot:
    name = str(data.name)
    kind = str(data.type or (next(iter(types)) if len(types) == 1 else ""))
    if not name or kind not in types:
        raise ArgumentError(
            f"robot {name!r} has the unknown type {kind!r}.",
            advice=f"Types are {', '.join(types)}.",
        )
    patterns = [data.logs] if isinstance(data.logs, str) else data.logs
    if not patterns or not all(patterns):
        raise ArgumentError(
            f"robot {name!r} has no logs.", advice="Give a pattern, such as logs/*.csv."
        )
    if data.dates not in DATED_BY:
        check_date_pattern(data.dates)
    return FleetRobot(
        name,
        kind,
        tuple(absolute_pattern(pattern, base) for pattern in patterns),
        data.dates,
        tuple(
            KnownPayload(p.body, p.mass, tuple(p.mass_center))  # type: ignore[arg-type]
            for p in data.payloads or []
        ),
        None if data.model is None else base / home_path(data.model),
    )
