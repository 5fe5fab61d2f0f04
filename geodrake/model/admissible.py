"""Checks that parameters of bodies and effects are physical.

Fits often end at a bound or on the boundary of the cone of physical inertias. The checks therefore
accept bounds, and violations within rounding and solver tolerances.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geodrake.boundary.arguments import LARGEST
from geodrake.effects import FittedEffect
from geodrake.errors import ModelError
from geodrake.inertia import Array, is_physical, pseudo_inertia
from geodrake.inertia.parameters import PARAMETER_NAMES
from geodrake.manifolds import Interval, PhysicalInertia

ROUNDING = 1e-6
"""Tolerance of a bound, relative to the largest eigenvalue, entry or parameter."""

_LEAST = 1e-9  # absolute tolerance of a bound, in the parameter's unit


def check_body(what: str, phi: Array) -> None:
    """Raise for unphysical inertial parameters (10,)."""
    _check_finite(what, PARAMETER_NAMES, phi)
    if phi[0] < 1.0 / LARGEST:
        raise ModelError(f"{what} have a mass of {phi[0]:g} kg.")
    if not is_physical(phi, tolerance=-ROUNDING):
        least, *_, most = np.linalg.eigvalsh(pseudo_inertia(phi))
        raise ModelError(
            f"{what} are not physical: the pseudo-inertia P(φ) must be positive definite, "
            f"but has eigenvalues from {least:.3g} to {most:.3g}."
        )


def check_effect(fitted: FittedEffect) -> None:
    """Raise for parameters outside the manifold of their effect, such as negative friction."""
    effect, what = fitted.effect, f"parameters of {named(fitted)}"
    names = [parameter.name for parameter in effect.parameters]
    for key, value in effect.shape.items():
        if isinstance(value, float) and not abs(value) <= LARGEST:
            raise ModelError(f"shape of {named(fitted)} has {key} = {value:g}.")
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
        raise ModelError(f"{what} are {values.tolist()}, which the effect does not allow.")
    deviations = [] if fitted.deviations is None else fitted.deviations.tolist()
    for name, value in zip(names, deviations, strict=False):
        if not value >= 0.0:
            raise ModelError(
                f"deviations of {named(fitted)} have {name} = {value:g}, which is negative."
            )


def _check_finite(what: str, names: Sequence[str], values: Array) -> None:
    for name, value in zip(names, values, strict=True):
        if not abs(value) <= LARGEST:
            raise ModelError(f"{what} have {name} = {value:g}.")


def named(fitted: FittedEffect) -> str:
    """Return an effect's name and place, for messages."""
    return f"{fitted.effect.name} at {fitted.effect.place}"
