"""Loads on the palm of the WAM-like arm, and the arm as a controller knows it with one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from diagrams.studies.adaptive.laws import make_law
from diagrams.studies.adaptive.wam import load_wam
from geodrake.control import ControlModel, PartialLaw
from geodrake.effects import FittedEffect, Payload
from geodrake.inertia import from_mass_com_inertia
from geodrake.manifolds import PhysicalInertia

Array = NDArray[np.float64]

HELD = np.array([0.0, 0.0, 0.1])  # m from the palm's origin: where a load is thought to be
MASS = 3.0  # kg


def ellipsoid(mass: float, semi_axes: Array, offset: Array) -> Array:
    """(10,) of a uniform ellipsoid about the palm's origin, its centre `offset` from `HELD`."""
    squares = np.asarray(semi_axes, float) ** 2
    inertia = np.diag(0.2 * mass * (squares.sum() - squares))
    return from_mass_com_inertia(mass, HELD + np.asarray(offset, float), inertia)


GUESS = ellipsoid(1.0, np.full(3, 0.1), np.zeros(3))
"""The blind guess: a sphere of 1 kg."""
LOADS = {
    "sphere": ellipsoid(MASS, np.full(3, 0.05), np.zeros(3)),
    "ellipsoid 1": ellipsoid(MASS, np.array([0.0323, 0.3227, 0.0323]), np.zeros(3)),
    "ellipsoid 2": ellipsoid(
        MASS, np.array([0.1375, 0.2165, 0.1082]), np.array([0.05, 0.04, -0.07])
    ),
}
"""Those of [Lee2019] §5.5.2; where the palm holds them is ours."""


def some_load(seed: int, number: int) -> Array:
    """(10,) another load: 2 to 4 kg, semi-axes of 3 to 25 cm, up to 6 cm off along each axis."""
    rng = np.random.default_rng([seed, number])
    return ellipsoid(rng.uniform(2.0, 4.0), rng.uniform(0.03, 0.25, 3), rng.uniform(-0.06, 0.06, 3))


@dataclass(frozen=True, eq=False)
class Loaded:
    """The arm with an unknown load.

    Attributes:
        control: The arm, whose 70 parameters are known, and the ten of the load.
    """

    control: ControlModel

    def law(self, name: str, speed: float) -> PartialLaw | None:
        """A law of the load alone, by its name and γ⁻¹."""
        law = make_law(name, PhysicalInertia(), GUESS, speed)
        part = np.arange(len(self.control.prior)) >= self.control.num_inertial
        return None if law is None else PartialLaw(law, part)

    def parameters(self, load: Array) -> Array:
        """(80,) of the arm with a load (10,)."""
        return np.concatenate([self.control.prior[: self.control.num_inertial], load])


@cache
def load_loaded() -> Loaded:
    """The arm with the guess, read once in a process."""
    model = replace(load_wam().model, effects=(FittedEffect(Payload("palm"), GUESS),))
    return Loaded(ControlModel.of(model))
