"""An export with its proof: what its files hold and lack, and how simulators of them do."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from geodrake.boundary.arguments import file_path, instances, number, positive, typed
from geodrake.boundary.whole_files import Content, made_folder, write_together
from geodrake.control.export_proof.engines import DrakeEngine, Engine
from geodrake.control.export_proof.formats import Exported, ExportFormat, export_format
from geodrake.control.export_proof.held import Lost, held_by
from geodrake.control.export_proof.reference import (
    STEP,
    Start,
    compared,
    logged_motions,
    logged_starts,
    random_motion,
    random_starts,
    roll_out_all,
    without,
)
from geodrake.control.rollout import case_rollout
from geodrake.control.rollout.passages import told_joints
from geodrake.effects.file_terms import DryFriction
from geodrake.errors import LogError, ModelError, OutputError
from geodrake.identification.logs.case import Case, open_case, reduce_fitted
from geodrake.identification.logs.compare import comparison
from geodrake.inertia import Array
from geodrake.logs.motion import JointLog, Motion
from geodrake.model.export import reasons
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of

_SEVERAL = (
    "the robot has joints of several degrees of freedom, so the export was not tested in simulators"
)

_IN_DRAKE = (
    "model.add_to_builder simulates all effects in Drake; those in these files would then "
    "count twice"
)

_WINDOWS = 6  # of rollouts without the integrals of servos

Progress = Callable[[str], object]


@dataclass(frozen=True)
class Costs:
    """Errors of a model and of its export on logs."""

    whole: float
    held: float
    # Of what the export holds less what the simulator does not act upon; None where it acts upon
    # all.
    ignored: float | None


@dataclass(frozen=True, eq=False)
class ProvenExport:
    """An export, and what is known about it."""

    form: ExportFormat
    exported: Exported
    held: RobotModel
    # The effects that it cannot hold; with logs, those that cost most first.
    lacks: tuple[Lost, ...]
    costs: Costs | None  # None without logs
    proof: Proof
    notes: tuple[str, ...]  # what was done to the logs, and what is worth knowing about the files


@typed
def export_to(
    to: str,
    model: RobotModel,
    folder: str | Path,
    logs: Sequence[JointLog | str | Path] = (),
    *,
    force: bool = False,
    bandwidth: float | None = None,
) -> ProvenExport:
    """Write a model for a simulator, and prove it: loaded again, and compared with the model.

    Args:
        to: Name of the format: urdf, sdf, mjcf, drake, isaac, python, cpp or ros2.
        folder: Where the files go; made if it is not there.
        logs: Logs, or their files, on whose motion what the format lacks is fitted, and the error
            that it costs is measured; without any, random motion within the limits of the robot
            serves.
        bandwidth: Bandwidth of the filter of the logs, Hz; by default that of the model's fit.

    Returns:
        The files, what they hold and lack, and how far simulators that load them are off.

    Raises:
        ArgumentError: There is no such format.
        ModelError: The model's own file cannot take the numbers, or the robot has joints that
            the format does not have.
        LogError: A log cannot be used.
        OutputError: A file is there already, or cannot be written.
    """
    form, folder = export_format(to), file_path(folder)
    logs = instances(logs, "logs", (JointLog, str, Path))
    if bandwidth is not None:
        positive(bandwidth, "bandwidth")
    check_folder(model, form, folder, (), force=force)
    found = export_with_proof(model, form, folder, logs, bandwidth=bandwidth)
    write_files(found, folder)
    return found


def export_with_proof(
    model: RobotModel,
    form: ExportFormat,
    folder: Path,
    logs: Sequence[JointLog | str | Path] = (),
    *,
    bandwidth: float | None = None,
    progress: Progress = lambda words: None,
) -> ProvenExport:
    """Make the files of an export, and try them in the simulators they are for.

    Nothing is written to the folder.

    Args:
        folder: Where the files will be: relative paths in them lead from there.
    """
    check_format(model, form)
    model = model.with_volume  # as simulators take no point masses, or others than they are
    if bandwidth is not None:
        number(bandwidth, "bandwidth", lower=0.0)
    case = open_case(model, logs, candidates=False, bandwidth=bandwidth) if len(logs) else None
    tried = not model.floating and len(model.single_joints) == len(model.joints)
    if case is not None:
        motions = logged_motions(model, case.trajectories)
    else:
        motions = [random_motion(model)] if tried else []
    held, lost = held_by(model, form.holding(model), motions)
    exported = form.write(model, held, folder)
    proof = Proof((), (), (_SEVERAL,))
    if tried:
        progress("Testing in simulators")
        starts = (
            logged_starts(held, case.trajectories)
            if case is not None
            else random_starts(held, motions[0])
        )
        with TemporaryDirectory() as scratch:
            again = form.write(model, held, Path(scratch))
            for name, content in again.files.items():
                (path := Path(scratch) / name).parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            first = Path(scratch) / next(iter(again.files))
            proof = prove(held, first, form.engines, compared(motions), starts)
    costs = None
    if case is not None:
        progress("Comparing it with the logs")
        costs = _costs(case, held, proof.ignored)
        lost = _costed(case, form, motions, lost)
    notes = [*(model.notes if case is None else case.notes), *exported.notes, *proof.notes]
    notes += _servo_notes(model, form, case)
    gone = {each.effect for each in lost}
    notes += reasons([fitted for fitted in model.effects if fitted.effect.name in gone])
    if DrakeEngine in form.engines and (proof.ignored or lost):
        notes.append(_IN_DRAKE)
    return ProvenExport(form, exported, held, lost, costs, proof, tuple(notes))


def check_folder(
    model: RobotModel, form: ExportFormat, folder: Path, inputs: Iterable[Path], *, force: bool
) -> None:
    """Refuse a folder in which the files cannot be written, before the long work."""
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            f"Cannot export to {folder}: it exists and is not a folder.",
            advice="Give a folder.",
            path=folder,
        )
    check_format(model, form)
    taken = {os.path.realpath(path) for path in (*inputs, model.path)}
    model = model.with_volume
    for name in form.write(model, model, folder).files:
        path, advice = folder / name, "Choose another folder"
        if os.path.realpath(path) in taken:
            reason = "an input of this command"
        elif path.exists() and not force:
            reason, advice = "there already", f"{advice}, or overwrite with --force"
        else:
            continue
        raise OutputError(f"Cannot write {path}: it is {reason}.", advice=f"{advice}.", path=path)


def write_files(
    found: ProvenExport, folder: Path, beside: Mapping[Path, Content] | None = None
) -> list[Path]:
    """Write all files or none; a folder that is made for them stays only with them.

    Returns:
        The files of the export.
    """
    files: dict[Path, Content] = {folder / name: d for name, d in found.exported.files.items()}
    with ExitStack() as stack:
        for parent in sorted({folder, *(path.parent for path in files)}):
            stack.enter_context(made_folder(parent))
        write_together({**files, **(beside or {})})
    return [*files]


def check_format(model: RobotModel, form: ExportFormat) -> None:
    """Refuse a format that has no place for what the model has."""
    problem = ""
    if loops := [", ".join(drive.joints) for drive in model.transmission if drive.is_loop]:
        problem = f"closed loops, but the model has one of {loops[0]}"
    elif bent := [joint for joint, tie in model.followers.items() if not tie.is_linear]:
        follower = bent[0].rpartition("::")[2]
        problem = f"that {follower} follows another joint by a ratio that changes"
    if problem:
        raise ModelError(
            f"The format {form.name} cannot express {problem}.",
            advice="Export only the inertias into the model's file: geodrake identify --export.",
        )
    if model.transmission and not form.at_actuators:
        actuators = ", ".join(name for drive in model.transmission for name in drive.actuators)
        raise ModelError(
            f"The format {form.name} has efforts and friction at joints, but the model at "
            f"{actuators}, behind a transmission.",
            advice="Export to python or cpp, or only the inertias: geodrake identify --export.",
        )


def _nrms(case: Case, model: RobotModel) -> float:
    return comparison(reduce_fitted(case, model)).errors.nrms


def _costs(case: Case, held: RobotModel, ignored: Sequence[str]) -> Costs:
    """Return the errors of a model, of its export, and without what the simulator ignores."""
    acting = tuple(f for f in held.effects if f.effect.name not in ignored)
    acted = None
    if len(acting) < len(held.effects):
        acted = _nrms(case, replace(held, effects=acting))
    return Costs(comparison(case).errors.nrms, _nrms(case, held), acted)


def _costed(
    case: Case, form: ExportFormat, motions: Sequence[Motion], lost: Sequence[Lost]
) -> tuple[Lost, ...]:
    """Return what an export lacks with the error without each, those that cost most first."""
    holds = form.holding(case.model)

    def nrms(name: str) -> float:
        without, _ = held_by(case.model, holds, motions, keep=lambda other: other.name != name)
        return _nrms(case, without)

    found = [replace(each, nrms=nrms(each.effect)) for each in lost]
    return tuple(sorted(found, key=lambda each: -(each.nrms or 0.0)))


def _servo_notes(model: RobotModel, form: ExportFormat, case: Case | None) -> list[str]:
    """Return notes on what an export does not have of servos.

    Of integrals they say by what the motion under logged commands departs without and with them.
    """
    found, servos = [], [servo for servo in servos_of(model) if servo]
    in_drake = "PositionServo in a Drake diagram"
    if told := ", ".join(servo.joint for servo in servos if not form.servos):
        found.append(
            f"{form.name} has no servo gains, such as those of {told}; mjcf and isaac do, and "
            f"{in_drake}"
        )
    integrals = [servo.joint for servo in servos if servo.integral and form.servos]
    if integrals:
        words = f"servos of {form.name} have no integral gain, such as that of "
        words += ", ".join(integrals) + _integral_cost(case, integrals)
        found.append(f"{words}; {in_drake} has it")
    if idle := ", ".join(servo.joint for servo in servos if servo.dead_band):
        found.append(
            f"{form.name} has no dead band of servos, such as that of {idle}; {in_drake} has it"
        )
    return found


def _integral_cost(case: Case | None, joints: Sequence[str]) -> str:
    """Return what servos depart by without integrals and with them; "" if logs do not tell."""
    if case is None:
        return ""
    model = case.model
    at = [model.joints.index(joint) for joint in joints]
    if not any(told_joints(model, log)[at].any() for log in case.options.logs):
        return ""
    signals = tuple(replace(signal, integral=0.0) for signal in model.effort_signals)
    try:
        shares = [
            case_rollout(replace(case, model=each), most=_WINDOWS, commands=True).relative
            for each in (replace(model, effort_signals=signals), model)
        ]
    except (LogError, ModelError):  # logs that are too short, or a robot that is not simulated
        return ""
    if not np.isfinite(shares).all():
        return ""
    return (
        f": the motion error under the logged commands is {100 * shares[0]:.2g} % "
        f"without it, and {100 * shares[1]:.2g} % with it"
    )


ROUNDING = 1e-6
"""Difference, rad or m, or relative to the values compared, up to which an export is exact."""

_FARTHEST = 100.0  # rad or m, that a joint may move in a rollout


@dataclass(frozen=True)
class Difference:
    """By how much a simulator differs from the model."""

    engine: str
    what: str  # "effort", needed along the motion, or "position", in rollouts
    largest: float  # N·m or N, or rad or m
    joint: str
    typical: float  # RMS of the values that are compared, at that joint
    compared: float  # share of the samples that are compared
    without: tuple[str, ...]  # names of effects in the file that take no part

    @property
    def is_rounding(self) -> bool:
        """Whether it is so small that the simulator computes what geodrake computes."""
        return self.largest <= ROUNDING * max(1.0, self.typical)


@dataclass(frozen=True)
class Proof:
    """Results of simulators that load an export."""

    differences: tuple[Difference, ...]
    # Names of effects of the file upon which the first simulator does not act.
    ignored: tuple[str, ...]
    notes: tuple[str, ...]  # simulators that are not installed, or cannot read the file


def prove(
    held: RobotModel,
    file: Path,
    engines: Sequence[type[Engine]],
    motion: Motion,
    starts: Sequence[Start],
) -> Proof:
    """Compare simulators that load an export with the model in it."""
    differences, ignored, notes = list[Difference](), None, list[str]()
    for make in engines:
        if find_spec(make.package) is None:
            notes.append(
                f"{make.package} is not installed, so the export was not tested in it: pip "
                'install "geodrake[export]"'
            )
            continue
        try:
            loaded = make(file, held)
        except ModelError as error:
            notes.append(f"the export was not tested: {error.problem}")
            continue
        kinds = (f.effect.name for f in held.effects if isinstance(f.effect, loaded.ignores))
        names = tuple(dict.fromkeys(kinds))
        ignored = names if ignored is None else ignored
        found = [_of_efforts(held, loaded, motion, names)]
        try:
            rolled = None if held.followers else _of_rollouts(held, loaded, starts, names)
            found += [rolled] if rolled else []
        except RuntimeError as error:
            reason = " ".join(str(error).split()).partition(". ")[0][:200].rstrip(".")
            notes.append(f"{loaded.name}: no rollouts of the export: {reason}")
        if not all(difference.is_rounding for difference in found):
            notes += [f"{loaded.name}: {message}" for message in loaded.messages]
        differences += found
    return Proof(tuple(differences), ignored or (), tuple(notes))


def _of_efforts(
    held: RobotModel, loaded: Engine, motion: Motion, names: tuple[str, ...]
) -> Difference:
    model = without(held, loaded.ignores)
    ours = model.effort(motion)
    if held.followers and loaded.of_plant:
        J, q = np.asarray(held.coordinates.constant), held.plant_positions(motion.q)
        theirs, meant = loaded.effort(q, motion.v @ J.T, motion.vd @ J.T)
        theirs, meant = theirs @ J, (meant[:, :, None] | (J == 0.0)).all(axis=1)
    else:
        theirs, meant = loaded.effort(motion.q, motion.v, motion.vd)
    off, share = np.where(meant, np.abs(theirs - ours), 0.0), float(meant.mean())
    return Difference(loaded.name, "effort", *_largest(off, ours, held), share, names)


def _of_rollouts(
    held: RobotModel, loaded: Engine, starts: Sequence[Start], names: tuple[str, ...]
) -> Difference | None:
    if not starts:
        return None
    with np.errstate(all="ignore"):
        ours = roll_out_all(without(held, loaded.ignores), starts, STEP, loaded.drives)
    if not np.abs(ours - ours[:, :1]).max() < _FARTHEST:  # NaN neither
        raise RuntimeError("the model is too fast for steps of a millisecond")
    theirs = [loaded.roll_out(start.q, start.v, start.effort, STEP) for start in starts]
    simulated = [each for each in theirs if each is not None]
    if len(simulated) < len(starts):
        return None
    off = np.abs(np.array(simulated) - ours).reshape(-1, ours.shape[-1])
    moved = (ours - ours[:, :1]).reshape(off.shape)
    dry = (f.effect.name for f in held.effects if isinstance(f.effect, DryFriction))
    names = tuple(dict.fromkeys([*names, *dry]))
    return Difference(loaded.name, "position", *_largest(off, moved, held), 1.0, names)


def _largest(off: Array, values: Array, model: RobotModel) -> tuple[float, str, float]:
    """Return the largest of differences (N, nv) of some values, its joint, and RMS values there."""
    worst = int(off.max(0).argmax())
    return float(off.max()), model.joints[worst], float(np.sqrt(np.mean(values[:, worst] ** 2)))
