"""An export with its proof: files, what they hold, and how simulators that load them do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from geodrake.boundary.arguments import number
from geodrake.control.export_proof.costs import Cost, Costs, costs_of
from geodrake.control.export_proof.lost_integral import lost_integrals
from geodrake.control.export_proof.proof import Proof, prove
from geodrake.control.export_proof.refusals import check_format
from geodrake.control.export_proof.samples import (
    compared,
    logged_motions,
    logged_starts,
    random_motion,
    random_starts,
)
from geodrake.identification.logs.case import open_case
from geodrake.logs.motion import JointLog
from geodrake.model.exporting.held import Exported, ExportFormat, held_by, reasons
from geodrake.model.robot_model import RobotModel
from geodrake.model.servos import servos_of

_SEVERAL = (
    "the robot has joints of several degrees of freedom, so the export was not tried in simulators"
)

_IN_DRAKE = (
    "model.add_to_builder simulates all effects in Drake, each once: beside these files, those in "
    "them would count twice"
)

Progress = Callable[[str], object]


@dataclass(frozen=True, eq=False)
class ProvenExport:
    """An export, and what is known about it.

    Attributes:
        held: The model that the files hold.
        lacks: The effects that they do not hold as they are.
        costs: Errors on the logs; None without logs.
        proof: What simulators make of it.
        notes: What was done to the logs, and what is worth knowing about the files.
    """

    form: ExportFormat
    exported: Exported
    held: RobotModel
    lacks: tuple[Cost, ...]
    costs: Costs | None
    proof: Proof
    notes: tuple[str, ...]


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
        logs: Logs, or their files, on whose motion the export is fitted and tried; without any,
            random motion within the limits of the robot serves.
        bandwidth: Bandwidth of the filter of the logs, Hz; by default that of the model's fit.
        progress: Called with what is going on.

    Raises:
        ModelError: The model's file cannot take what is to be written.
        LogError: A log cannot be used.
    """
    check_format(model, form)
    if bandwidth is not None:
        number(bandwidth, "bandwidth", lower=0.0)
    case = open_case(model, logs, candidates=False, bandwidth=bandwidth) if len(logs) else None
    tried = len(model.single_joints) == len(model.joints)
    if case is not None:
        motions = logged_motions(model, case.trajectories)
    else:
        motions = [random_motion(model)] if tried else []
    held = held_by(model, form.holding(model), motions)
    exported = form.write(model, held, folder)
    proof = Proof((), (), (_SEVERAL,))
    if tried:
        progress("Trying it in simulators")
        starts = (
            logged_starts(held.model, case.trajectories)
            if case is not None
            else random_starts(held.model, motions[0])
        )
        with TemporaryDirectory() as scratch:
            again = form.write(model, held, Path(scratch))
            for name, content in again.files.items():
                (path := Path(scratch) / name).parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            first = Path(scratch) / next(iter(again.files))
            proof = prove(held.model, first, form.engines, compared(motions), starts)
    costs = None
    if case is not None:
        progress("Comparing it with the logs")
        costs = costs_of(case, held, form, motions, proof.ignored)
    lacks = costs.effects if costs else tuple(Cost(lost, None) for lost in held.lost)
    notes = [*(model.notes if case is None else case.notes), *exported.notes, *proof.notes]
    if told := [servo.joint for servo in servos_of(model) if servo and not form.servos]:
        notes.append(
            f"{form.name} does not have the gains of servos, such as those of {', '.join(told)}; "
            "mjcf and isaac do, and PositionServo in a Drake diagram"
        )
    notes += lost_integrals(model, form, case)
    gone = {lost.effect for lost in held.lost}
    notes += reasons([fitted for fitted in model.effects if fitted.effect.name in gone])
    if "drake" in form.engines and (proof.ignored or held.lost):
        notes.append(_IN_DRAKE)
    return ProvenExport(form, exported, held.model, lacks, costs, proof, tuple(notes))
