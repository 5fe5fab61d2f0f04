"""Files that say of what a fleet is: types with a model each, robots with their logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from geodrake.boundary.arguments import file_path, number
from geodrake.boundary.showing import Short
from geodrake.boundary.yaml_text import yaml_content, yaml_table
from geodrake.errors import ArgumentError, FleetError
from geodrake.fleet.log_dates import DATED_BY, check_date_pattern
from geodrake.fleet.log_places import absolute_pattern, home_path
from geodrake.fleet.making import Wanted
from geodrake.logs.known_payload import KnownPayload

_FORM = (
    "Write `to: FOLDER`, `types:`, each with `model: FILE`, and `robots:`, a list of {name: NAME, "
    "type: TYPE, logs: PATTERN}."
)
_KEYS = ("to", "types", "robots")
_OF_TYPES = (
    *("model", "own_effects", "effects", "bandwidth", "blocks", "payload", "lock", "floating"),
    *("transmission", "mapping", "units"),
)
_OF_ROBOTS = ("name", "type", "logs", "model", "dates", "payloads")
_OF_PAYLOADS = ("body", "mass", "mass_center")


@dataclass(frozen=True)
class FleetType(Short):
    """Robots of one model.

    Attributes:
        own_effects: Python files with effects of the user's own.
        effects: Effects that each joint has beside the model's; None for those that hardly any
        bandwidth: Bandwidth of the digests, Hz; None if it is chosen by the first log.
        blocks: Blocks that each log is cut into; None for the usual number.
        payload: Mass of a usual payload, kg; None for a tenth of the robot's own.
        lock: Joint -> where it is held, rad or m.
        floating: Whether roots are free that nothing fixes to the world.
        transmission: What moves joints in their place: a file, `file` or `none`.
        mapping: File that says which column of the logs is what.
        units: Quantity -> its unit in the logs.
    """

    name: str
    model: Path
    own_effects: tuple[Path, ...] = ()
    effects: tuple[str, ...] | None = None
    bandwidth: float | None = None
    blocks: int | None = None
    payload: float | None = None
    lock: Mapping[str, float] = field(default_factory=dict)
    floating: bool = False
    transmission: str | None = None
    mapping: Path | None = None
    units: Mapping[str, str] = field(default_factory=dict)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that it is read from."""
        return (self.model, *self.own_effects, *filter(None, [self.mapping]))


@dataclass(frozen=True)
class FleetRobot(Short):
    """One robot of a fleet.

    Attributes:
        logs: Patterns of its logs: absolute paths or addresses, with `*`, `?`, `[…]` and `**`.
        dates: When a log without stamps was recorded: `file`, when its file was changed; `stamps`,
            where those without are refused; or what a date in its path is like, as `%Y-%m-%d`.
        payloads: What it carried in all logs, of known mass, that the model does not have.
        model: File of its own model, which its parameters are compared with; None for its type's.
    """

    name: str
    type: str
    logs: tuple[str, ...]
    dates: str = "file"
    payloads: tuple[KnownPayload, ...] = ()
    model: Path | None = None


@dataclass(frozen=True)
class Fleet(Short):
    """Types and robots.

    Attributes:
        path: The file that says so.
        folder: Where digests and results go.
        types: The types, by name.
        robots: The robots, in the order of the file.
    """

    path: Path
    folder: Path
    types: Mapping[str, FleetType]
    robots: tuple[FleetRobot, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that it is read from."""
        own = [robot.model for robot in self.robots if robot.model is not None]
        return (self.path, *(file for kind in self.types.values() for file in kind.files), *own)

    def of_type(self, name: str) -> tuple[FleetRobot, ...]:
        """The robots of a type."""
        return tuple(robot for robot in self.robots if robot.type == name)


def read_fleet(path: str | Path) -> Fleet:
    """Read a fleet file.

    Paths are beside the file, unless they are absolute.

    Raises:
        FleetError: It cannot be read, has other keys or kinds of values, or names a robot twice.
    """
    path = file_path(path)
    content = yaml_content(path, "fleet file", FleetError, advice=_FORM)
    try:
        return _fleet(path, content)
    except ArgumentError as error:
        advice = error.advice or _FORM
        raise FleetError(f"Fleet file {path}: {error.problem}", advice=advice) from error


def _fleet(path: Path, content: object) -> Fleet:
    said = _table(content, _KEYS, "it")
    base = path.absolute().parent
    folder = _path(base, said.get("to"), "`to`")
    types = {
        str(name): _type(str(name), own, base)
        for name, own in _table(said.get("types"), None, "`types`").items()
    }
    listed = said.get("robots")
    if not isinstance(listed, list) or not listed:
        raise ArgumentError(f"`robots` is {listed!r:.60}, no list.", advice=_FORM)
    robots = tuple(_robot(own, types, base) for own in listed)
    seen: set[str] = set()
    for robot in robots:
        if robot.name in seen:
            raise ArgumentError(
                f"robot {robot.name!r} is there twice.",
                advice="Give all its logs in one entry, as a list of patterns.",
            )
        seen.add(robot.name)
    for name in types:
        if not any(robot.type == name for robot in robots):
            raise ArgumentError(f"no robot is of type {name!r}.", advice="Leave the type out.")
    return Fleet(path, folder, types, robots)


def _type(name: str, content: object, base: Path) -> FleetType:
    what = f"type {name!r}"
    if not name.isprintable() or not name or "/" in name or name.startswith("."):
        raise ArgumentError(f"{what} has a name that no folder can have.", advice="Rename it.")
    said = _table(content, _OF_TYPES, what)
    bandwidth, blocks, payload = (said.get(key) for key in ("bandwidth", "blocks", "payload"))
    Wanted(bandwidth, blocks)  # refuses what they cannot be
    if payload is not None:
        number(payload, f"payload of {what}", lower=0.0, strict=True)
    floating, transmission = said.get("floating", False), said.get("transmission")
    if not isinstance(floating, bool):
        raise ArgumentError(f"floating of {what} is {floating!r}, neither true nor false.")
    if transmission is not None and transmission not in ("file", "none"):
        transmission = str(_path(base, transmission, f"transmission of {what}"))
    effects, mapping = said.get("effects"), said.get("mapping")
    return FleetType(
        name,
        _path(base, said.get("model"), f"model of {what}"),
        tuple(
            _path(base, each, f"own_effects of {what}")
            for each in _texts(said.get("own_effects", []), f"own_effects of {what}")
        ),
        None if effects is None else _texts(effects, f"effects of {what}"),
        None if bandwidth is None else float(bandwidth),
        blocks,
        None if payload is None else float(payload),
        {
            str(joint): number(value, f"lock of {joint} of {what}")
            for joint, value in _table(said.get("lock") or {}, None, f"lock of {what}", 0).items()
        },
        floating,
        transmission,
        None if mapping is None else _path(base, mapping, f"mapping of {what}"),
        {
            str(quantity): _text(unit, f"unit of {quantity} of {what}")
            for quantity, unit in _table(
                said.get("units") or {}, None, f"units of {what}", 0
            ).items()
        },
    )


def _robot(content: object, types: Mapping[str, FleetType], base: Path) -> FleetRobot:
    said = _table(content, _OF_ROBOTS, "a robot")
    name = _text(said.get("name"), "the name of a robot")
    what = f"robot {name!r}"
    kind = str(said.get("type", next(iter(types)) if len(types) == 1 else ""))
    if kind not in types:
        raise ArgumentError(
            f"{what} is of type {kind!r}, which is none of the types.",
            advice=f"Types are: {', '.join(types)}.",
        )
    logs = said.get("logs")
    patterns = _texts([logs] if isinstance(logs, str) else logs, f"logs of {what}")
    if not patterns:
        raise ArgumentError(f"{what} has no logs.", advice="Give a pattern, such as logs/*.csv.")
    dates = _text(said.get("dates", "file"), f"dates of {what}")
    if dates not in DATED_BY:
        check_date_pattern(dates)
    payloads = said.get("payloads") or []
    if not isinstance(payloads, list):
        raise ArgumentError(f"payloads of {what} are {payloads!r:.60}, no list.")
    model = said.get("model")
    return FleetRobot(
        name,
        kind,
        tuple(absolute_pattern(pattern, base) for pattern in patterns),
        dates,
        tuple(_payload(each, what) for each in payloads),
        None if model is None else _path(base, model, f"model of {what}"),
    )


def _payload(content: object, what: str) -> KnownPayload:
    said = _table(content, _OF_PAYLOADS, f"a payload of {what}")
    place = said.get("mass_center", [0.0, 0.0, 0.0])
    if not isinstance(place, list) or len(place) != 3:
        raise ArgumentError(f"mass_center of a payload of {what} is {place!r}, no three numbers.")
    x, y, z = (number(each, f"mass_center of a payload of {what}") for each in place)
    body = _text(said.get("body"), f"the body of a payload of {what}")
    return KnownPayload(body, number(said.get("mass"), f"mass of a payload of {what}"), (x, y, z))


def _table(
    content: object, keys: Sequence[str] | None, what: str, least: int = 1
) -> Mapping[Any, Any]:
    return yaml_table(content, keys, what, advice=_FORM, least=least)


def _path(base: Path, content: object, what: str) -> Path:
    return base / home_path(_text(content, what))


def _text(content: object, what: str) -> str:
    if isinstance(content, bool) or not isinstance(content, str | int) or content == "":
        raise ArgumentError(f"{what} is {content!r:.60}, no name.", advice=_FORM)
    return str(content)


def _texts(content: object, what: str) -> tuple[str, ...]:
    if not isinstance(content, list):
        raise ArgumentError(f"{what} is {content!r:.60}, no list.", advice=_FORM)
    return tuple(_text(each, what) for each in content)
