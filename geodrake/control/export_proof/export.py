"""Export of models, verified in simulators that load the files."""

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
from geodrake.control.rollout.passages import commanded_joints
from geodrake.errors import LogError, ModelError, OutputError
from geodrake.identification.logs.case import Case, prepare_case, reduce_fitted
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

_WINDOWS = 6  # of rollouts without integral gains of servos

Progress = Callable[[str], object]


@dataclass(frozen=True)
class Costs:
    """Errors of a model and of its export on logs."""

    whole: float  # of the model
    held: float  # of the exported model
    ignored: float | None  # without effects that the simulator ignores; None if there are none


@dataclass(frozen=True, eq=False)
class ProvenExport:
    """An export and its verification."""

    form: ExportFormat
    exported: Exported
    held: RobotModel  # the part of the model that the format can express
    lacks: tuple[Lost, ...]  # effects that it cannot express; with logs, sorted by cost
    costs: Costs | None  # None without logs
    proof: Proof
    notes: tuple[str, ...]  # on the logs and the files


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
    """Write a model for a simulator, load the files there, and compare with the model.

    Args:
        to: Name of the format: urdf, sdf, mjcf, drake, isaac, python, cpp or ros2.
        folder: Folder of the files, created if necessary.
        logs: Logs, or their files, whose motion is used to approximate lost effects and to measure
            their cost; without logs, random motion within the robot's limits is used.
        bandwidth: Bandwidth of the filter of the logs, Hz; by default that of the model's fit.

    Returns:
        The files, their content and lost effects, and the differences of simulators.

    Raises:
        ArgumentError: There is no such format.
        ModelError: The model's file cannot be edited, or the format does not support a joint.
        LogError: A log is invalid.
        OutputError: A file exists, or cannot be written.
    """
    form, folder = export_format(to), file_path(folder)
    logs = instances(logs, "logs", (JointLog, str, Path))
    if bandwidth is not None:
        positive(bandwidth, "bandwidth")
    check_folder(model, form, folder, (), force=force)
    export = export_with_proof(model, form, folder, logs, bandwidth=bandwidth)
    write_files(export, folder)
    return export


def export_with_proof(
    model: RobotModel,
    form: ExportFormat,
    folder: Path,
    logs: Sequence[JointLog | str | Path] = (),
    *,
    bandwidth: float | None = None,
    progress: Progress = lambda words: None,
) -> ProvenExport:
    """Return the files of an export, tested in simulators, without writing them to the folder.

    Args:
        folder: Future folder of the files, to which relative paths refer.
    """
    check_format(model, form)
    model = model.with_volume  # as simulators reject or change point masses
    if bandwidth is not None:
        number(bandwidth, "bandwidth", lower=0.0)
    case = prepare_case(model, logs, candidates=False, bandwidth=bandwidth) if len(logs) else None
    is_testable = not model.floating and len(model.single_joints) == len(model.joints)
    if case is not None:
        motions = logged_motions(model, case.trajectories)
    else:
        motions = [random_motion(model)] if is_testable else []
    held, lost = held_by(model, form.holding(model), motions)
    exported = form.write(model, held, folder)
    proof = Proof((), (), (_SEVERAL,))
    if is_testable:
        progress("Testing in simulators")
        starts = (
            logged_starts(held, case.trajectories)
            if case is not None
            else random_starts(held, motions[0])
        )
        with TemporaryDirectory() as scratch:
            copy = form.write(model, held, Path(scratch))
            for name, content in copy.files.items():
                (path := Path(scratch) / name).parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            main_file = Path(scratch) / next(iter(copy.files))
            proof = prove(held, main_file, form.engines, compared(motions), starts)
    costs = None
    if case is not None:
        progress("Comparing it with the logs")
        costs = _costs(case, held, proof.ignored)
        lost = _with_costs(case, form, motions, lost)
    notes = [*(model.notes if case is None else case.notes), *exported.notes, *proof.notes]
    notes += _servo_notes(model, form, case)
    names = {effect.effect for effect in lost}
    notes += reasons([fitted for fitted in model.effects if fitted.effect.name in names])
    if DrakeEngine in form.engines and (proof.ignored or lost):
        notes.append(_IN_DRAKE)
    return ProvenExport(form, exported, held, lost, costs, proof, tuple(notes))


def check_folder(
    model: RobotModel, form: ExportFormat, folder: Path, inputs: Iterable[Path], *, force: bool
) -> None:
    """Raise if the files cannot be written to a folder, before expensive work."""
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
    export: ProvenExport, folder: Path, other_files: Mapping[Path, Content] | None = None
) -> list[Path]:
    """Write all files or none, and return those of the export; remove new folders on failure."""
    files: dict[Path, Content] = {folder / name: d for name, d in export.exported.files.items()}
    with ExitStack() as stack:
        for parent in sorted({folder, *(path.parent for path in files)}):
            stack.enter_context(made_folder(parent))
        write_together({**files, **(other_files or {})})
    return [*files]


def check_format(model: RobotModel, form: ExportFormat) -> None:
    """Raise if a format does not support the model's joints."""
    problem = ""
    if loops := [", ".join(drive.joints) for drive in model.transmission if drive.is_loop]:
        problem = f"closed loops, but the model has one of {loops[0]}"
    elif nonlinear := [joint for joint, tie in model.followers.items() if not tie.is_linear]:
        follower = nonlinear[0].rpartition("::")[2]
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
    """Return the errors of a model, of its export, and without effects that are ignored."""
    effects = tuple(f for f in held.effects if f.effect.name not in ignored)
    without_ignored = None
    if len(effects) < len(held.effects):
        without_ignored = _nrms(case, replace(held, effects=effects))
    return Costs(comparison(case).errors.nrms, _nrms(case, held), without_ignored)


def _with_costs(
    case: Case, form: ExportFormat, motions: Sequence[Motion], lost: Sequence[Lost]
) -> tuple[Lost, ...]:
    """Return the lost effects with the error without each, sorted by decreasing error."""
    holds = form.holding(case.model)

    def nrms(name: str) -> float:
        without, _ = held_by(case.model, holds, motions, keep=lambda other: other.name != name)
        return _nrms(case, without)

    costed = [replace(effect, nrms=nrms(effect.effect)) for effect in lost]
    return tuple(sorted(costed, key=lambda effect: -(effect.nrms or 0.0)))


def _servo_notes(model: RobotModel, form: ExportFormat, case: Case | None) -> list[str]:
    """Return notes on properties of servos that an export lacks.

    For integral gains they report the motion error under logged commands without and with them.
    """
    notes, servos = [], [servo for servo in servos_of(model) if servo]
    in_drake = "PositionServo in a Drake diagram"
    if joints := ", ".join(servo.joint for servo in servos if not form.servos):
        notes.append(
            f"{form.name} has no servo gains, such as those of {joints}; mjcf and isaac do, and "
            f"{in_drake}"
        )
    integrals = [servo.joint for servo in servos if servo.integral and form.servos]
    if integrals:
        words = f"servos of {form.name} have no integral gain, such as that of "
        words += ", ".join(integrals) + _integral_cost(case, integrals)
        notes.append(f"{words}; {in_drake} has it")
    if joints := ", ".join(servo.joint for servo in servos if servo.dead_band):
        notes.append(
            f"{form.name} has no dead band of servos, such as that of {joints}; {in_drake} has it"
        )
    return notes


def _integral_cost(case: Case | None, joints: Sequence[str]) -> str:
    """Return a clause on the motion error without and with integral gains; "" if unknown."""
    if case is None:
        return ""
    model = case.model
    indices = [model.joints.index(joint) for joint in joints]
    if not any(commanded_joints(model, log)[indices].any() for log in case.options.logs):
        return ""
    signals = tuple(replace(signal, integral=0.0) for signal in model.effort_signals)
    try:
        errors = [
            case_rollout(replace(case, model=variant), most=_WINDOWS, commands=True).relative
            for variant in (replace(model, effort_signals=signals), model)
        ]
    except (LogError, ModelError):  # logs are too short, or the robot cannot be simulated
        return ""
    if not np.isfinite(errors).all():
        return ""
    return (
        f": the motion error under the logged commands is {100 * errors[0]:.2g} % "
        f"without it, and {100 * errors[1]:.2g} % with it"
    )


ROUNDING = 1e-6
"""Absolute (rad or m) or relative difference below which an export is exact."""

_FARTHEST = 100.0  # rad or m, limit of motion in a rollout


@dataclass(frozen=True)
class Difference:
    """Difference between a simulator and the model."""

    engine: str
    what: str  # "effort", needed along the motion, or "position", in rollouts
    largest: float  # N·m or N, or rad or m
    joint: str  # of the largest difference
    typical: float  # RMS of the compared values at that joint
    compared: float  # fraction of the samples that are comparable
    without: tuple[str, ...]  # effects in the file that are not included

    @property
    def is_rounding(self) -> bool:
        """Whether it is negligible."""
        return self.largest <= ROUNDING * max(1.0, self.typical)


@dataclass(frozen=True)
class Proof:
    """Comparison of an export in simulators with the model."""

    differences: tuple[Difference, ...]
    ignored: tuple[str, ...]  # effects in the file that the first simulator ignores
    notes: tuple[str, ...]  # on simulators that are not installed or cannot read the file


def prove(
    held: RobotModel,
    file: Path,
    engines: Sequence[type[Engine]],
    motion: Motion,
    starts: Sequence[Start],
) -> Proof:
    """Compare the model with simulators that load its export."""
    differences, ignored, notes = list[Difference](), None, list[str]()
    for kind in engines:
        if find_spec(kind.package) is None:
            notes.append(
                f"{kind.package} is not installed, so the export was not tested in it: pip "
                'install "geodrake[export]"'
            )
            continue
        try:
            engine = kind(file, held)
        except ModelError as error:
            notes.append(f"the export was not tested: {error.problem}")
            continue
        excluded = (
            f.effect.name for f in held.effects if f.effect.file_term.joint in engine.ignores
        )
        names = tuple(dict.fromkeys(excluded))
        ignored = names if ignored is None else ignored
        of_engine = [_effort_difference(held, engine, motion, names)]
        try:
            if not held.followers and (rollout := _rollout_difference(held, engine, starts, names)):
                of_engine.append(rollout)
        except RuntimeError as error:
            reason = " ".join(str(error).split()).partition(". ")[0][:200].rstrip(".")
            notes.append(f"{engine.name}: no rollouts of the export: {reason}")
        if not all(difference.is_rounding for difference in of_engine):
            notes += [f"{engine.name}: {message}" for message in engine.messages]
        differences += of_engine
    return Proof(tuple(differences), ignored or (), tuple(notes))


def _effort_difference(
    held: RobotModel, engine: Engine, motion: Motion, names: tuple[str, ...]
) -> Difference:
    expected = without(held, engine.ignores).effort(motion)
    if held.followers and engine.of_plant:
        J, q = np.asarray(held.coordinates.constant), held.plant_positions(motion.q)
        effort, comparable = engine.effort(q, motion.v @ J.T, motion.vd @ J.T)
        effort, comparable = effort @ J, (comparable[:, :, None] | (J == 0.0)).all(axis=1)
    else:
        effort, comparable = engine.effort(motion.q, motion.v, motion.vd)
    error, fraction = np.where(comparable, np.abs(effort - expected), 0.0), float(comparable.mean())
    return Difference(engine.name, "effort", *_largest(error, expected, held), fraction, names)


def _rollout_difference(
    held: RobotModel, engine: Engine, starts: Sequence[Start], names: tuple[str, ...]
) -> Difference | None:
    if not starts:
        return None
    with np.errstate(all="ignore"):
        expected = roll_out_all(without(held, engine.ignores), starts, STEP, engine.drives)
    if not np.abs(expected - expected[:, :1]).max() < _FARTHEST:  # or NaN
        raise RuntimeError("the model is too fast for steps of a millisecond")
    rollouts = [engine.roll_out(start.q, start.v, start.effort, STEP) for start in starts]
    simulated = [positions for positions in rollouts if positions is not None]
    if len(simulated) < len(starts):
        return None
    error = np.abs(np.array(simulated) - expected).reshape(-1, expected.shape[-1])
    displacement = (expected - expected[:, :1]).reshape(error.shape)
    dry = (f.effect.name for f in held.effects if f.effect.file_term.joint == "friction")
    names = tuple(dict.fromkeys([*names, *dry]))
    return Difference(engine.name, "position", *_largest(error, displacement, held), 1.0, names)


def _largest(errors: Array, values: Array, model: RobotModel) -> tuple[float, str, float]:
    """Return the largest of errors (N, nv), its joint, and the RMS of the values there."""
    worst = int(errors.max(0).argmax())
    return float(errors.max()), model.joints[worst], float(np.sqrt(np.mean(values[:, worst] ** 2)))
