"""The arm of [Lee2019] §4.6.2: its target in several base representations, and its validation."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from diagrams.harness import MODELS
from diagrams.studies.excitation.expected import effort_errors, identified_by, parameter_error
from geodrake.excitation import (
    ExcitationTrajectory,
    FourierMotion,
    MotionLimits,
    Target,
    make_target,
    motion_limits,
)
from geodrake.inertia import perturb
from geodrake.model import RobotModel, load_description
from geodrake.robot import BaseParameters, inverse_dynamics_regressor

Array = NDArray[np.float64]

IIWA = Path("reference") / "iiwa14.sdf"
NOISE = 0.1  # N·m
FREQUENCY = 0.3 * np.pi  # rad/s
DURATION, RATE = 10.0, 1000  # s, 1/s
GROUPS = {"1,2": [0, 1], "3,4": [2, 3], "5,6": [4, 5], "7": [6]}
"""Joints of table 4.2."""
_UNCERTAINTY = 0.3  # of the prior's masses
_ACCELERATION = 10.0  # rad/s², of validation, where the model file limits none


@dataclass(frozen=True, eq=False)
class RepresentedTarget(Target):
    """A target whose base parameters are written down in another way.

    Attributes:
        change: (n_B, n_B) S, nonsingular; the base parameters are S φ_B.
    """

    change: Array | None = None

    @cached_property
    def base(self) -> BaseParameters:
        """S B in the place of B."""
        own = super().base
        return own if self.change is None else replace(own, matrix=self.change @ own.matrix)


def manipulator(shared: Path | None) -> RobotModel:
    """The iiwa of the folder `shared`, and an arm of our own with seven joints if None."""
    path = MODELS / "arm7.urdf" if shared is None else shared / IIWA
    return replace(load_description(path), effects=())


def represented_target(model: RobotModel, base: int, seed: int) -> Target:
    """All inertias of an arm, with a random prior, in a base representation.

    Number one is that of geodrake; the others are it times random matrices.
    """
    rng = np.random.default_rng([seed, 0])
    prior = perturb(model.phi, 1, rng=rng, mass_uncertainty=_UNCERTAINTY).phi[0]
    target = make_target(replace(model, phi=prior), noise=NOISE, effects=[])
    values = {field.name: getattr(target, field.name) for field in fields(target)}
    size = target.base.rank
    change = np.random.default_rng([seed, base]).normal(size=(size, size)) if base > 1 else None
    return RepresentedTarget(**values, change=change)


def family(modes: int) -> FourierMotion:
    """Motions of [Lee2019] Eq. (4.6.62)."""
    return FourierMotion(DURATION, modes, FREQUENCY, offset=False)


def limits(model: RobotModel) -> MotionLimits:
    """Positions and speeds alone are limited, as in the source."""
    return motion_limits(model, acceleration=np.inf, effort=np.inf)


@dataclass(frozen=True, eq=False)
class Validation:
    """Random samples within limits, at which efforts are predicted.

    Attributes:
        model: The true arm.
        regressor: (N, nv, p).
        mass: (N, nv, nv) mass matrices.
    """

    model: RobotModel
    regressor: Array
    mass: Array

    @classmethod
    def of(cls, model: RobotModel, count: int, seed: int) -> Validation:
        """Samples drawn evenly."""
        rng, bounds = np.random.default_rng([seed, 99]), motion_limits(model)
        fastest = np.where(np.isfinite(bounds.acceleration), bounds.acceleration, _ACCELERATION)
        shape = (count, len(model.joints))
        q = rng.uniform(bounds.lower, bounds.upper, shape)
        v, vd = (rng.uniform(-most, most, shape) for most in (bounds.velocity, fastest))
        context, mass = model.plant.CreateDefaultContext(), []
        for one in q:
            model.plant.SetPositions(context, one)
            mass.append(model.plant.CalcMassMatrix(context))
        return cls(model, inverse_dynamics_regressor(model.tree, q, v, vd), np.array(mass))

    def errors(self, target: Target, trajectory: ExcitationTrajectory) -> dict[str, object]:
        """Expected errors of what least squares make of a motion at 1 kHz, as in table 4.2."""
        found = identified_by(target, trajectory, round(DURATION * RATE))
        effort, acceleration = effort_errors(found, self.regressor, self.mass)
        by_group = [
            {name: float(np.sqrt(np.mean(x[joints] ** 2))) for name, joints in GROUPS.items()}
            for x in (effort, acceleration)
        ]
        error = parameter_error(found, self.model.phi)
        return {"error": error, "effort": by_group[0], "acceleration": by_group[1]}
