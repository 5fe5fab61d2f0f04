"""What the numbers of a model must be: those of a robot that can exist.

Fits end at bounds and at the edge of the cone of physical inertias, so bounds themselves are
admitted, and what rounding and the tolerance of solvers put beyond them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, combinations
from typing import TYPE_CHECKING

import numpy as np

from geodrake.boundary.arguments.arrays import LARGEST
from geodrake.effects import FittedEffect
from geodrake.errors import ModelError
from geodrake.inertia import PARAMETER_NAMES, Array, is_physical, pseudo_inertia
from geodrake.manifolds import Interval, PhysicalInertia

if TYPE_CHECKING:
    from geodrake.model.robot_model import RobotModel

ROUNDING = 1e-6
"""Of the largest eigenvalue, entry or parameter beside it: what may be beyond an edge."""

_LEAST = 1e-9  # of a parameter beyond a bound, in its unit


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
            raise ModelError(f"effects has {_named(first)} twice.")
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


def check_body(what: str, phi: Array) -> None:
    """Refuses inertial parameters (10,) of no body.

    Raises:
        ModelError: The message has the values.
    """
    _check_finite(what, PARAMETER_NAMES, phi)
    if phi[0] < 1.0 / LARGEST:
        raise ModelError(f"{what} have a mass of {phi[0]:g} kg.")
    if not is_physical(phi, tolerance=-ROUNDING):
        least, *_, most = np.linalg.eigvalsh(pseudo_inertia(phi))
        raise ModelError(
            f"{what} are those of no body: the pseudo inertia P(φ) must be positive definite, and "
            f"has eigenvalues from {least:.3g} to {most:.3g}."
        )


def check_effect(fitted: FittedEffect) -> None:
    """Refuses parameters beyond the manifold of their effect, as negative friction is.

    Raises:
        ModelError: The message has the parameter and the value.
    """
    effect, what = fitted.effect, f"parameters of {_named(fitted)}"
    names = [parameter.name for parameter in effect.parameters]
    for key, value in effect.shape.items():
        if isinstance(value, float) and not abs(value) <= LARGEST:
            raise ModelError(f"shape of {_named(fitted)} has {key} = {value:g}.")
    _check_finite(what, names, fitted.parameters)
    manifold, values = effect.manifold, fitted.parameters
    if isinstance(manifold, Interval):
        margin = _LEAST + ROUNDING * np.abs(values).max(initial=0.0)
        for name, value, low, high in zip(
            names, values, manifold.lower, manifold.upper, strict=True
        ):
            if not low - margin <= value <= high + margin:
                raise ModelError(f"{what} have {name} = {value:g}, outside [{low:g}, {high:g}].")
    elif isinstance(manifold, PhysicalInertia):
        check_body(what, values)
    elif not manifold.contains(values):
        raise ModelError(f"{what} are {values.tolist()}, outside of what the effect allows.")
    deviations = [] if fitted.deviations is None else fitted.deviations.tolist()
    for name, value in zip(names, deviations, strict=False):
        if not value >= 0.0:
            raise ModelError(
                f"deviations of {_named(fitted)} have {name} = {value:g}, which is less than 0."
            )


def _check_finite(what: str, names: Sequence[str], values: Array) -> None:
    for name, value in zip(names, values, strict=True):
        if not abs(value) <= LARGEST:
            raise ModelError(f"{what} have {name} = {value:g}.")


def _named(fitted: FittedEffect) -> str:
    """An effect and where it is, in words."""
    return f"{fitted.effect.name} at {fitted.effect.place}"
