"""Files that describe a fleet: types with a model each, robots with their logs."""

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
    """A type as the file has it; see `FleetType`."""

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
    """A payload as the file has it; see `KnownPayload`."""

    body: str
    mass: float
    mass_center: list[float] = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class _RobotSchema(Schema):
    """A robot as the file has it; see `FleetRobot`."""

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
    """Robots of one model."""

    name: str
    model: Path
    own_effects: tuple[Path, ...] = ()  # Python files with effects of the user's own
    # Effects that each joint has beside the model's; None for friction and offsets.
    effects: tuple[str, ...] | None = None
    # Bandwidth of the digests, Hz; None if it is chosen by the first log.
    bandwidth: float | None = None
    blocks: int | None = None  # blocks that each log is cut into; None for the usual number
    payload: float | None = None  # mass of a usual payload, kg; None for a tenth of the robot's own
    lock: Mapping[str, float] = field(default_factory=dict)  # joint -> where it is held, rad or m
    floating: bool = False  # whether roots are free that nothing fixes to the world
    transmission: str | None = None  # what moves joints in their place: a file, `file` or `none`
    mapping: Path | None = None  # file that says which column of the logs is what
    units: Mapping[str, str] = field(default_factory=dict)  # quantity -> unit in the logs

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that it is read from."""
        return (self.model, *self.own_effects, *filter(None, [self.mapping]))

    def __hash__(self) -> int:
        return hash((self.name, self.files))


@dataclass(frozen=True)
class FleetRobot(Short):
    """One robot of a fleet."""

    name: str
    type: str
    # Patterns of its logs: absolute paths or addresses, with `*`, `?`, `[…]` and `**`.
    logs: tuple[str, ...]
    # When a log without stamps was recorded: `file`, when its file was changed; `stamps`, where
    # those without are refused; or what a date in its path is like, as `%Y-%m-%d`.
    dates: str = "file"
    # What it carried in all logs, of known mass, that the model does not have.
    payloads: tuple[KnownPayload, ...] = ()
    # File of its own model, which its parameters are compared with; None for its type's.
    model: Path | None = None


@dataclass(frozen=True)
class Fleet(Short):
    """Types and robots."""

    path: Path
    folder: Path  # where digests and results go
    types: Mapping[str, FleetType]
    robots: tuple[FleetRobot, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that it is read from."""
        own = [robot.model for robot in self.robots if robot.model is not None]
        return (self.path, *(file for kind in self.types.values() for file in kind.files), *own)

    def of_type(self, name: str) -> tuple[FleetRobot, ...]:
        """Return the robots of a type."""
        return tuple(robot for robot in self.robots if robot.type == name)


def read_fleet(path: str | Path) -> Fleet:
    """Read a fleet file.

    Paths are beside the file, unless they are absolute.

    Raises:
        FleetError: It cannot be read, has other keys or kinds of values, or names a robot twice.
    """
    path = file_path(path)
    return made_of_yaml(path, "fleet file", FleetError, partial(_fleet, path), advice=_FORM)


def _fleet(path: Path, content: object) -> Fleet:
    said, base = as_schema(content, _FleetSchema), path.absolute().parent
    if not said.types or not said.robots or not said.to:
        raise ArgumentError("`to`, `types` or `robots` is empty.", advice=_FORM)
    types = {str(name): _type(str(name), own, base) for name, own in said.types.items()}
    robots = tuple(_robot(own, types, base) for own in said.robots)
    seen: set[str] = set()
    for robot in robots:
        if robot.name in seen:
            raise ArgumentError(
                f"robot {robot.name!r} occurs twice.",
                advice="List all its logs in one entry.",
            )
        seen.add(robot.name)
    for name in types:
        if not any(robot.type == name for robot in robots):
            raise ArgumentError(f"no robot is of type {name!r}.", advice="Remove the type.")
    return Fleet(path, base / home_path(said.to), types, robots)


def _type(name: str, said: _TypeSchema, base: Path) -> FleetType:
    what = f"type {name!r}"
    if not name.isprintable() or not name or "/" in name or name.startswith("."):
        raise ArgumentError(f"{what} has a name that a folder cannot have.", advice="Rename it.")
    Wanted(said.bandwidth, said.blocks)  # refuses what they cannot be
    if said.payload is not None:
        number(said.payload, f"payload of {what}", lower=0.0, strict=True)
    lock = {str(joint): number(x, f"lock of {joint}") for joint, x in (said.lock or {}).items()}
    transmission = said.transmission
    if transmission is not None and transmission not in ("file", "none"):
        transmission = str(base / home_path(transmission))
    found = msgspec.structs.asdict(said) | {
        "model": base / home_path(said.model),
        "own_effects": tuple(base / home_path(each) for each in said.own_effects),
        "effects": None if said.effects is None else tuple(said.effects),
        "lock": lock,
        "transmission": transmission,
        "mapping": None if said.mapping is None else base / home_path(said.mapping),
        "units": said.units or {},
    }
    return FleetType(name, **found)


def _robot(said: _RobotSchema, types: Mapping[str, FleetType], base: Path) -> FleetRobot:
    name = str(said.name)
    kind = str(said.type or (next(iter(types)) if len(types) == 1 else ""))
    if not name or kind not in types:
        raise ArgumentError(
            f"robot {name!r} has the unknown type {kind!r}.",
            advice=f"Types are {', '.join(types)}.",
        )
    patterns = [said.logs] if isinstance(said.logs, str) else said.logs
    if not patterns or not all(patterns):
        raise ArgumentError(
            f"robot {name!r} has no logs.", advice="Give a pattern, such as logs/*.csv."
        )
    if said.dates not in DATED_BY:
        check_date_pattern(said.dates)
    return FleetRobot(
        name,
        kind,
        tuple(absolute_pattern(pattern, base) for pattern in patterns),
        said.dates,
        tuple(
            KnownPayload(each.body, each.mass, tuple(each.mass_center))  # type: ignore[arg-type]
            for each in said.payloads or []
        ),
        None if said.model is None else base / home_path(said.model),
    )
