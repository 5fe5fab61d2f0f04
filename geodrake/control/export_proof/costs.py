"""What an export lacks, in held-out errors on logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from geodrake.identification.logs.case import Case, reopen
from geodrake.identification.logs.compare import comparison
from geodrake.logs.motion import Motion
from geodrake.model.exporting.held import ExportFormat, HeldModel, Lost, held_by
from geodrake.model.robot_model import RobotModel


@dataclass(frozen=True)
class Cost:
    """An effect that an export lacks, and what that costs.

    Attributes:
        lost: The effect, and what stands in its place.
        nrms: nrms with it approximated or left out, and all else as it is; None without logs.
    """

    lost: Lost
    nrms: float | None


@dataclass(frozen=True)
class Costs:
    """Errors of a model and of its export on logs.

    Attributes:
        whole: nrms of the whole model.
        held: nrms of what the export holds.
        effects: What each effect costs that the export lacks, alone; the largest first.
        ignored: nrms of what the export holds less what the simulator does not act upon; None
            where it acts upon all.
    """

    whole: float
    held: float
    effects: tuple[Cost, ...]
    ignored: float | None


def costs_of(
    case: Case,
    held: HeldModel,
    form: ExportFormat,
    motions: Sequence[Motion],
    ignored: Sequence[str],
) -> Costs:
    """The errors with and without what an export lacks.

    Args:
        motions: Motion of the logs, on which effects are approximated.
        ignored: Names of effects upon which the simulator does not act.
    """
    holds = form.holding(case.model)

    def without(name: str) -> RobotModel:
        return held_by(case.model, holds, motions, keep=lambda other: other.name != name).model

    acting = tuple(f for f in held.model.effects if f.effect.name not in ignored)
    acted = replace(held.model, effects=acting)
    found = [Cost(lost, _nrms(case, without(lost.effect))) for lost in held.lost]
    return Costs(
        whole=comparison(case).errors.nrms,
        held=_nrms(case, held.model),
        effects=tuple(sorted(found, key=lambda cost: -(cost.nrms or 0.0))),
        ignored=_nrms(case, acted) if len(acting) < len(held.model.effects) else None,
    )


def _nrms(case: Case, model: RobotModel) -> float:
    return comparison(reopen(case, model)).errors.nrms
