"""Options of all commands that take logs: how their columns are to be read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from geodrake.errors import ArgumentError, LogError, OutputError

if TYPE_CHECKING:
    from geodrake.logs.files import Reading
    from geodrake.logs.motors import Motor


@dataclass(frozen=True, kw_only=True)
class ReadingOptions:
    """How logs are to be read, where names of columns do not say it.

    Attributes:
        mapping (FILE.yaml): Which column is what. Where names are not understood, a proposal to
            edit is written into the working folder.
        columns (NAME,…): Names of the columns, for logs without a header: time,q1,q2,tau1,tau2; _
            for one that is not used.
        rate (HZ): Rows a second, for logs without time.
        units (QUANTITY=UNIT,…): Units other than SI that names of columns do not say, such as
            position=deg,current=mA.
        gain (JOINT=VALUE[±DEVIATION]): What makes efforts of a joint's currents, voltages or duty
            cycles, such as torque constant × gear ratio; found from the model's inertias if absent.
            Repeatable.
        kind ([JOINT=]KIND): What columns of efforts are: effort, current, voltage, pwm; or command,
            for what a servo was told in their place. Repeatable.
        motor ([JOINT=]MOTOR): Which servo or actuator a joint has, such as sts3215: what its data
            sheet says of gains is expected of the logs. Repeatable.
        motors (FILE.yaml): Motors beside those of geodrake's table, in its form.
        passive (JOINT): A joint without a motor: its bodies and friction need no effort together.
            Repeatable.
        topic (NAME): Topic of a bag, or channel of an LCM log, where several have joints; an
            unknown one such as x lists them. Repeatable: topics of a bag are joined by time.
        episode (N): Episode of a LeRobot dataset, from 0 on; all if absent.
        skip_bad_rows: Leave out rows that no recorder meant, up to 1 %, and say how many.
    """

    PANEL: ClassVar = "logs"

    mapping: Path | None = None
    columns: str | None = None
    rate: float | None = None
    units: str | None = None
    gain: list[str] | None = None
    kind: list[str] | None = None
    motor: list[str] | None = None
    motors: Path | None = None
    passive: list[str] | None = None
    topic: list[str] | None = None
    episode: int | None = None
    skip_bad_rows: bool = False

    @property
    def reading(self) -> Reading:
        """How logs are to be read.

        Raises:
            GeodrakeError: An option, or the mapping, cannot be read.
        """
        from geodrake.logs.files import Reading, read_mapping

        if self.columns is not None and self.mapping is not None:
            raise ArgumentError(
                "--columns and --mapping are given.", advice="A mapping has numbers of columns."
            )
        gains = self._gains
        return Reading(
            mapping=None if self.mapping is None else read_mapping(self.mapping),
            columns=tuple(part.strip() for part in (self.columns or "").split(",") if part.strip()),
            rate=self.rate,
            units=dict(_pairs("--units", [self.units or ""], "position=deg,time=ms")),
            gains={joint: gain for joint, (gain, _) in gains.items()},
            gain_deviations={j: spread for j, (_, spread) in gains.items() if spread is not None},
            kinds=self._kinds,
            motors=self._motors,
            skip_bad_rows=self.skip_bad_rows,
            topic=tuple(self.topic or ()),
            episode=self.episode,
        )

    @property
    def _gains(self) -> dict[str, tuple[float, float | None]]:
        """Joint -> gain, and its deviation if there is one."""
        from geodrake.logs.files.reading import parsed_gain

        said = _pairs("--gain", self.gain or (), "elbow_joint=13.2")
        return {joint: parsed_gain(text, f"--gain of {joint!r}") for joint, text in said}

    @property
    def _motors(self) -> dict[str, Motor]:
        """Joint -> motor; that of all joints by the name ""."""
        from geodrake.logs.motors import known_motors, motor_named

        of_all, named = _of_all_and_named("--motor", self.motor or (), "elbow_flex=sts3215")
        if not (of_all or named or self.motors):
            return {}
        table = known_motors(self.motors)
        return {joint: motor_named(name, table) for joint, name in [*of_all, *named]}

    @property
    def _kinds(self) -> dict[str, str]:
        """Joint -> kind; that of all joints by the name ""."""
        of_all, named = _of_all_and_named("--kind", self.kind or (), "elbow_joint=current")
        passive = [part.strip() for part in ",".join(self.passive or ()).split(",")]
        without = [(joint, "passive") for joint in passive if joint]
        if twice := sorted(dict(named).keys() & dict(without).keys()):
            raise ArgumentError(
                f"--passive says that {twice[0]!r} has no motor, and --kind that it is "
                f"{dict(named)[twice[0]]}.",
                advice="Leave one of both out.",
            )
        return dict([*of_all, *named, *without])


def _of_all_and_named(
    option: str, given: Sequence[str], example: str
) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Return what an option says of all joints, by the name "", and of single ones."""
    parts = [part.strip() for part in ",".join(given).split(",")]
    of_all = [part for part in parts if part and "=" not in part]
    if len(of_all) > 1:
        form = f"JOINT={example.rpartition('=')[2].upper()}"
        raise ArgumentError(
            f"{option} is {' and '.join(of_all)} of all joints.", advice=f"Write {form}."
        )
    named = _pairs(option, [part for part in parts if "=" in part], example)
    return [("", each) for each in of_all], named


def _pairs(option: str, given: Sequence[str], example: str) -> list[tuple[str, str]]:
    """Return what is before and after each equals sign; each name once."""
    found: dict[str, str] = {}
    for part in filter(None, ",".join(given).split(",")):
        name, sign, value = (word.strip() for word in part.rpartition("="))
        if not (name and sign and value):
            raise ArgumentError(f"{option} has {part!r}.", advice=f"Write {option} {example}.")
        if name in found:
            raise ArgumentError(f"{option} names {name!r} twice.", advice="Name it once.")
        found[name] = value
    return list(found.items())


@contextmanager
def proposing(logs: Sequence[Path]) -> Iterator[None]:
    """Write a proposed mapping for a log whose columns are not understood, and say so.

    Raises:
        LogError: What the body raised, with where the proposal is.
    """
    try:
        yield
    except LogError as error:
        proposal, path = error.evidence.get("proposal"), error.evidence.get("path")
        if proposal is None or path is None:
            raise
        words = _written(_beside(Path(path), logs), proposal)
        raise LogError(error.problem, advice=f"{error.advice} {words}", **error.evidence) from error


def _beside(path: Path, logs: Sequence[Path]) -> Path:
    """Return where a log's proposal goes: the working folder; joined files share one."""
    first = Path(str(next((log for log in logs if log.name == path.name), path)).split("+")[0])
    from geodrake.logs.files.packed_files import log_name

    return Path(f"{log_name(first)}.mapping.yaml")


def _written(target: Path, proposal: str) -> str:
    """Write a proposal where there is nothing yet, and what to do then, in words."""
    from geodrake.boundary.whole_files import write_whole

    if target.exists() or target.is_symlink():
        return f"Edit {target}, which is there, and give it by --mapping."
    try:
        write_whole(target, proposal)
    except OutputError:
        return "Or say which column is what by --mapping."
    return f"A proposal is in {target}: edit it, and give it by --mapping."
