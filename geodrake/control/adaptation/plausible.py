"""Limits that keep an estimate near what a robot is thought to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, number, real_array
from geodrake.control.adaptation.law import AdaptationLaw, UpdateLaw
from geodrake.control.adaptation.partial import PartialLaw
from geodrake.control.adaptation.projected import ProjectedLaw
from geodrake.control.regressor import ControlModel
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical
from geodrake.manifolds import Interval, PhysicalInertia
from geodrake.manifolds.projections import Polyhedron

_INERTIA = PhysicalInertia()


def plausible_limits(control: ControlModel, start: ArrayLike, factor: float) -> Polyhedron:
    """Limits about the parameters of a model and a first estimate, for a `ProjectedLaw`.

    Those of a body are on its mass and on tr(P₀⁻¹ P), which is four for the model's own P₀ and does
    not depend on units and frames. Those of an effect are on how far a parameter is from its only
    bound. Each stays above 1/factor of the lesser and below factor times the greater of what the
    model and the first estimate have. Parameters with two bounds, or none, have no further limits.

    Mass matrices then stay below 4 factor times the model's. That matters beyond the masses: where
    sampled gains K = λ M̂ are beyond h λ M̂ < 2 M, a loop chatters, chatter drives all estimates of
    inertia up, and the loop does not come back.

    Args:
        control: The robot.
        start: (p,) first estimate.
        factor: Above one.
    """
    prior = instance(control, "control", ControlModel).prior
    points = np.array([prior, real_array(start, "start", prior.shape)])
    if not number(factor, "factor") > 1:
        raise ArgumentError(f"factor must be above one; got {factor}.")
    rows, offsets = [np.zeros((0, len(prior)))], [np.zeros(0)]

    def limit(place: slice, row: Array, offset: Array) -> None:
        matrix = np.zeros((len(row), len(prior)))
        matrix[:, place] = row
        rows.append(matrix)
        offsets.append(offset)

    def limit_body(place: slice) -> None:
        phi = points[0, place] if is_physical(points[0, place]) else points[1, place]
        row = np.eye(1, PARAMETERS_PER_BODY)
        if is_physical(phi):
            row = np.concatenate([row, -_INERTIA.calc_gradient(phi)[None]])
        limit(place, row, np.zeros(len(row)))

    for body in range(len(control.bodies)):
        limit_body(slice(PARAMETERS_PER_BODY * body, PARAMETERS_PER_BODY * (body + 1)))
    for number_of, effect in enumerate(control.effects):
        place = control.effect_parameters(number_of)
        if isinstance(effect.manifold, PhysicalInertia):
            limit_body(place)
        elif isinstance(effect.manifold, Interval):
            lower, upper = np.array(effect.manifold.lower), np.array(effect.manifold.upper)
            sign = np.isfinite(lower).astype(float) - np.isfinite(upper)
            bound = np.where(sign > 0, lower, np.where(sign < 0, upper, 0.0))
            one = sign != 0
            limit(place, np.diag(sign)[one], (-sign * bound)[one])
    A, offset = np.concatenate(rows), np.concatenate(offsets)
    values = points @ A.T + offset
    useful = values.max(0) > 0
    least, most = values.min(0)[useful] / factor, values.max(0)[useful] * factor
    return Polyhedron(A[useful], least - offset[useful], most - offset[useful])


def limited(law: UpdateLaw, limits: Polyhedron) -> UpdateLaw:
    """A law whose estimate keeps to limits, if it has none yet and its steps can be projected.

    Args:
        law: The law; a `ProjectedLaw`, one of Euler steps and one of your own stay as they are.
        limits: On all parameters; of a `PartialLaw`, those on what it adapts count.
    """
    if isinstance(law, PartialLaw):
        own = ~limits.matrix[:, ~law.adapted].any(1)
        matrix = limits.matrix[np.ix_(own, law.adapted)]
        parts = Polyhedron(matrix, limits.lower[own], limits.upper[own])
        return replace(law, law=limited(law.law, parts))
    if isinstance(law, AdaptationLaw) and law.integrator == "geodesic":
        return ProjectedLaw(law, limits)
    return law
