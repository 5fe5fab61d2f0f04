"""Exports loaded again by simulators, and compared with the model that they were made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geodrake.control.export_proof.engines import Engine, engine
from geodrake.control.export_proof.reference import (
    STEP,
    Start,
    position_order,
    roll_out_all,
    without,
)
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.logs.motion import Motion
from geodrake.model.file_terms import DryFriction
from geodrake.model.robot_model import RobotModel

ROUNDING = 1e-6
"""Difference, rad or m, or relative to the values compared, up to which an export is exact."""

_FARTHEST = 100.0  # rad or m, that a joint may move in a rollout


@dataclass(frozen=True)
class Difference:
    """By how much a simulator differs from the model.

    Attributes:
        what: "effort", needed along the motion, or "position", in rollouts.
        largest: Largest difference: N·m or N, or rad or m.
        typical: RMS of the values that are compared, at that joint.
        compared: Share of the samples that are compared.
        without: Names of effects in the file that take no part.
    """

    engine: str
    what: str
    largest: float
    joint: str
    typical: float
    compared: float
    without: tuple[str, ...]

    @property
    def is_rounding(self) -> bool:
        """Whether it is so small that the simulator computes what geodrake computes."""
        return self.largest <= ROUNDING * max(1.0, self.typical)


@dataclass(frozen=True)
class Proof:
    """What simulators make of an export.

    Attributes:
        ignored: Names of effects of the file upon which the first simulator does not act.
        notes: Simulators that are not installed, or cannot read the file.
    """

    differences: tuple[Difference, ...]
    ignored: tuple[str, ...]
    notes: tuple[str, ...]


def prove(
    held: RobotModel, file: Path, engines: Sequence[str], motion: Motion, starts: Sequence[Start]
) -> Proof:
    """Compare simulators that load an export with the model in it."""
    differences, ignored, notes = list[Difference](), None, list[str]()
    if engines and held.followers:
        return Proof((), (), ("joints follow others, so the export was not tried in simulators",))
    for name in engines:
        make = engine(name)
        if make is None:
            notes.append(
                f"{name} is not installed, so the export was not tried in it: "
                'pip install "geodrake[export]"'
            )
            continue
        try:
            loaded = make(file, held)
        except ModelError as error:
            notes.append(f"the export was not tried: {error.problem}")
            continue
        kinds = (f.effect.name for f in held.effects if isinstance(f.effect, loaded.ignores))
        names = tuple(dict.fromkeys(kinds))
        ignored = names if ignored is None else ignored
        found = [_of_efforts(held, loaded, motion, names)]
        try:
            rolled = _of_rollouts(held, loaded, starts, names)
            found += [rolled] if rolled else []
        except (RuntimeError, np.linalg.LinAlgError) as error:
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
    q = motion.q[:, position_order(held)]
    theirs, meant = loaded.effort(q, motion.v, motion.vd)
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
        raise RuntimeError("the model moves too fast for steps of a millisecond")
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
