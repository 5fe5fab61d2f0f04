"""What the numbers of a model must be: those of a robot that can exist.

Fits end at bounds and at the edge of the cone of physical inertias, so bounds themselves are
admitted, and what rounding and the tolerance of solvers put beyond them.
"""

from __future__ import annotations

from itertools import chain, combinations

import numpy as np

from geodrake.boundary.arguments.arrays import LARGEST
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model.admissible_effect import ROUNDING, check_body, check_effect, place_of
from geodrake.model.robot_model import RobotModel


def check_model(model: RobotModel) -> None:
    """Refuses a model whose numbers no robot can have.

    Inertial parameters φ of every body need P(φ) ⪰ 0 and a mass, parameters of effects must lie on
    the effect's manifold or its edge, deviations and noise must not be negative, bandwidths
    positive, and the information matrix must be symmetric and positive semidefinite, with
    something known of each parameter.

    Raises:
        ModelError: The message has the field and the value.
    """
    for body, phi in zip(model.bodies, model.phi, strict=True):
        check_body(f"inertial_parameters of {body!r}", phi)
    for fitted in model.effects:
        check_effect(fitted)
    for first, second in combinations(model.effects, 2):
        if first.effect == second.effect:
            raise ModelError(f"effects has {place_of(first)} twice.")
    for field, values in (
        ("effort_noise", model.effort_noise),
        ("fading_speed", model.fading_speed),
    ):
        for joint, value in zip(model.joints, () if values is None else values, strict=False):
            if not 0.0 <= value <= LARGEST:
                raise ModelError(
                    f"{field} of {joint!r} is {value:g}, which is no number from 0 to {LARGEST:g}."
                )
    for bandwidth in chain.from_iterable(model.bandwidths.values()):
        if not 0.0 < bandwidth <= LARGEST:
            raise ModelError(
                f"bandwidths have {bandwidth:g} Hz, which is no number above 0 and up to "
                f"{LARGEST:g}."
            )
    if model.information is not None:
        _check_information(model.information)


def _check_information(information: Array) -> None:
    size = np.abs(information).max(initial=0.0)
    if not np.isfinite(size):
        raise ModelError(f"information has an entry of {size:g}.")
    diagonal = np.diagonal(information)
    if (diagonal <= 0.0).any():
        at = int(diagonal.argmin())
        raise ModelError(
            f"information has {diagonal[at]:g} at {at}, {at} on its diagonal, where it says how "
            "well a parameter is known, above 0."
        )
    # On a unit diagonal, so that units do not matter.
    scale = np.sqrt(np.maximum(diagonal, 1.0 / LARGEST))
    scaled = information / np.outer(scale, scale)
    wrong = np.abs(scaled - scaled.T)
    if wrong.max(initial=0.0) > ROUNDING:
        i, j = np.unravel_index(wrong.argmax(), wrong.shape)
        raise ModelError(
            f"information is not symmetric: {information[i, j]:g} at {i}, {j} and "
            f"{information[j, i]:g} at {j}, {i}."
        )
    least = np.linalg.eigvalsh(0.5 * (scaled + scaled.T)).min(initial=0.0)
    if least < -ROUNDING * len(scaled):
        raise ModelError(
            f"information is not positive semidefinite: scaled to a unit diagonal, it has the "
            f"eigenvalue {least:.3g}."
        )
