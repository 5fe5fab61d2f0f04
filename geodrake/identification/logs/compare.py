"""Compare a model with measurements, and find where it fails."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.identification.logs.case import Case, error_table, prepare_case, series
from geodrake.identification.logs.hypothesis import HeldOut
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, Failing, Series
from geodrake.identification.logs.model_fit import model_unknowns, unfitted_errors
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LEAST_SAMPLES, _MOST = 8, 6  # samples of a circumstance, and joints
_NOTABLE = 1.3
"""A circumstance is reported if the RMS is so many times larger there than elsewhere."""


def compare(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    bandwidth: float | None = None,
    blocks: int | None = None,
    hold_resting: bool = True,
) -> Comparison:
    """Compare a model, without refitting, with logs.

    The `bandwidth` of the filter, Hz, is by default that of the model's fit to the same logs, or
    chosen from the data. Every log is cut into `blocks`. Joints that hardly move in any log are
    held if `hold_resting`.
    """
    case = prepare_case(
        model,
        logs,
        candidates=False,
        bandwidth=bandwidth,
        blocks=blocks,
        hold_resting=hold_resting,
    )
    return comparison(case)


def comparison(
    case: Case, unknowns: Unknowns | None = None, held_out: HeldOut | None = None
) -> Comparison:
    """Compare a case's model without refitting, or parameters fitted without each fold."""
    dataset = case.dataset
    if unknowns is None or held_out is None:
        unknowns, held_out = (
            model_unknowns(dataset, case.model),
            unfitted_errors(dataset, case.model),
        )
    blocks, errors = series(dataset, unknowns, held_out), error_table(dataset, held_out)
    return Comparison(
        errors,
        error_conditions(blocks, errors, sliding=case.model.sliding_joints),
        blocks,
        case.notes,
        case.first,
    )


def error_conditions(
    all_blocks: Sequence[Series],
    errors: ErrorTable,
    *,
    sliding: Collection[str] = (),
) -> tuple[Failing, ...]:
    """Return the circumstances in which the worst joints' errors are concentrated.

    Joints are sorted by their nrms. `sliding` joints have units of m and N.
    """
    worst = []
    for error in errors.joints:
        joint, blocks = error.joint, [s for s in all_blocks if s.joint == error.joint]
        squares = np.concatenate([s.residual for s in blocks]) ** 2
        if not len(squares):  # of a limb that always stands
            continue
        position, effort = ("m", "N") if joint in sliding else ("rad", "N·m")
        circumstances = _circumstances(blocks, position, effort)
        cases = [_failing(joint, words, mask, squares, effort) for words, mask in circumstances]
        notable = [c for c in cases if c is not None and c.rms > _NOTABLE * c.elsewhere]
        if notable:
            worst.append((error.nrms, max(notable, key=lambda c: c.share - c.time)))
    worst.sort(key=lambda entry: -entry[0])
    return tuple(case for _, case in worst[:_MOST])


def _circumstances(
    blocks: Sequence[Series], position: str, effort: str
) -> Iterator[tuple[str, Mask]]:
    """Yield descriptions and masks of extreme speeds, positions, accelerations, loads, and blocks.

    `position` and `effort` are units.
    """
    signals = {
        name: np.concatenate([getattr(s, name) for s in blocks])
        for name in ("velocity", "position", "acceleration", "predicted")
    }
    speed, load = np.abs(signals["velocity"]), np.abs(signals["predicted"])
    yield from _extremes(speed, "at speeds", f"{position}/s")
    yield from _extremes(load, "at predicted efforts", effort)
    yield from _extremes(np.abs(signals["acceleration"]), "at accelerations", f"{position}/s²")
    yield from _extremes(signals["position"], "at positions", position)
    yield "while moving forwards", signals["velocity"] > 0.02 * speed.max()
    yield "while moving backwards", signals["velocity"] < -0.02 * speed.max()
    names = np.concatenate([[s.block] * len(s.time) for s in blocks])
    for name in dict.fromkeys(names.tolist()):
        yield f"in {name}", names == name


def _extremes(values: Array, words: str, unit: str) -> Iterator[tuple[str, Mask]]:
    low, high = np.quantile(values, [0.2, 0.8])
    yield f"{words} below {low:.3g} {unit}", values < low
    yield f"{words} above {high:.3g} {unit}", values > high


def _failing(joint: str, words: str, mask: Mask, squares: Array, unit: str) -> Failing | None:
    inside, outside = squares[mask], squares[~mask]
    if min(len(inside), len(outside)) < _LEAST_SAMPLES or squares.sum() == 0:
        return None
    return Failing(
        joint,
        words,
        float(np.sqrt(inside.mean())),
        float(np.sqrt(outside.mean())),
        float(inside.sum() / squares.sum()),
        float(mask.mean()),
        unit,
    )
