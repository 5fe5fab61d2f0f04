"""What became of the bodies of an identified model, and what to say about it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geodrake.effects import catalogue
from geodrake.identification.fit import FitResult
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.model_fit import ModelFit
from geodrake.identification.models.results import BodyChange
from geodrake.inertia import (
    PARAMETERS_PER_BODY,
    Array,
    pullback_distance,
    to_mass_com_inertia,
)
from geodrake.model.robot_model import RobotModel

_FAR = 2.0
"""Factor of a mass from which on a body's change is worth a word."""

_USUAL = 2.0
"""All bodies together are usually no farther off than so many times what a file knows them to."""

USUAL = tuple(e.name for e in catalogue() if e.complexity == 0 and "v" in e.depends_on)
"""Effects that a real robot is hardly without; inertias that lack them stand in for them."""


def changed_bodies(model: RobotModel, fit: ModelFit) -> tuple[BodyChange, ...]:
    """Return what a fit made of the bodies of a model, the farthest change first."""
    changes = body_changes(model.bodies, model.phi, fit.model.phi, fit.result)
    return tuple(sorted(changes, key=lambda body: -body.distance))


def body_changes(
    names: Sequence[str], before: Array, after: Array, fit: FitResult
) -> tuple[BodyChange, ...]:
    """Return the changes of bodies (nb, 10) by a fit, whose first parameters they are."""
    covariance = fit.covariance()
    masses, com, _ = to_mass_com_inertia(np.stack([before, after], axis=1))
    distances = pullback_distance(before, after, before)
    changes = []
    for k, name in enumerate(names):
        start, (m0, m1) = k * PARAMETERS_PER_BODY, masses[k].tolist()
        block = covariance[start : start + 4, start : start + 4]
        jacobian = np.hstack([-com[k, 1][:, None], np.eye(3)]) / m1  # of h/m by [m, h]
        unknown = np.isinf(np.diagonal(block))
        known = np.where(np.isinf(block), 0.0, block)
        spread = np.sqrt(np.einsum("ij,jk,ik->i", jacobian, known, jacobian))
        spread[unknown[1:] | unknown[0]] = np.inf
        deviation, far = float(np.sqrt(block[0, 0])), float(distances[k])
        changes.append(
            BodyChange(name, (m0, m1), com[k], deviation, spread, start in fit.active_blocks, far)
        )
    return tuple(changes)


def model_notes(model: RobotModel, bodies: Sequence[BodyChange]) -> list[str]:
    """Return what to know of a fitted model: no friction, masses far from the prior."""
    notes = []
    if not any("friction" in fitted.effect.name for fitted in model.effects):
        notes.append(
            "the model has no friction, so inertias stand in for it as far as they can: fit some "
            f"beside them (--effects {','.join(USUAL)}), or let geodrake explain find which"
        )
    far = [
        f"{body.name} {body.mass[0]:.3g} → {body.mass[1]:.3g} kg"
        for body in bodies
        if not 1 / _FAR < body.mass[1] / body.mass[0] < _FAR
    ]
    if far:
        notes.append(
            f"masses far from the prior ({', '.join(far)}): unless the prior is that wrong, the "
            "model lacks an effect that inertias stand in for, which geodrake diagnose looks for; "
            "a larger gamma holds them"
        )
    return [*notes, *common_factor_notes(bodies)]


def common_factor_notes(bodies: Sequence[BodyChange]) -> list[str]:
    """Return a note that all bodies together became heavier or lighter than a file may be wrong.

    Efforts that are all too large or too small by one factor, such as currents or torques of
    motors, do that.
    """
    before, after = (sum(body.mass[k] for body in bodies) for k in (0, 1))
    if before <= 0.0 or after <= 0.0 or abs(np.log(after / before)) <= _USUAL * SPREAD:
        return []
    return [
        f"these bodies weigh {after:.3g} kg, and {before:.3g} kg before: are the efforts of all "
        f"joints N·m or N? {before / after:.3g} times as large, they would leave the bodies where "
        "the file has them"
    ]
