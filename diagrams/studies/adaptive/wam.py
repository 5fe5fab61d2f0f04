"""The WAM-like arm of the studies of adaptive control, and loads on its palm."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from diagrams.harness import MODELS
from diagrams.studies.adaptive.laws import make_law
from diagrams.studies.adaptive.loop import on_its_base
from geodrake.control import ControlModel, PartialLaw, parameter_manifold
from geodrake.effects import FittedEffect, Payload
from geodrake.inertia import Array, Ellipsoid, is_physical, to_spatial_inertia
from geodrake.manifolds import PhysicalInertia, Product
from geodrake.model import RobotModel, load_description

MODEL = MODELS / "wam_like.urdf"
RATE = 10.0  # λ, 1/s, [Lee2019] §5.5
PERIOD = 5.0  # s, of a round
AMPLITUDE = 0.8  # rad


@dataclass(frozen=True, eq=False)
class Wam:
    """The arm as controllers know it."""

    model: RobotModel
    control: ControlModel
    manifold: Product

    @property
    def truth(self) -> Array:
        """(70,) the true parameters."""
        return self.control.prior

    def unphysical(self, parameters: Array) -> Array:
        """Return (N,) whether a body of an estimate (N, 70) cannot exist."""
        return ~is_physical(parameters.reshape(len(parameters), -1, 10)).all(axis=1)


@cache
def load_wam() -> Wam:
    """Return the arm, read once in a process."""
    model = load_description(MODEL)
    return Wam(model, ControlModel.of(model), parameter_manifold(model))


def make_plant(load: Array | None = None) -> MultibodyPlant:
    """Return the true arm without limits of joints or efforts, as in the source.

    `load` are the inertial parameters (10,) of a body on the palm, about the palm's origin.
    """
    plant = MultibodyPlant(0.0)
    on_its_base(MODEL, "base", plant)
    if load is not None:
        body = plant.AddRigidBody(
            "load", plant.GetModelInstanceByName("wam_like"), to_spatial_inertia(load)
        )
        plant.WeldFrames(plant.GetFrameByName("palm"), body.body_frame())
    plant.Finalize()
    return plant


def first_estimate(sigma: float, seed: int, draw: int) -> Array:
    """Return (70,) of bodies scaled by 1 + ε, ε normal and within ±σ ([Lee2019] §5.5.1).

    Draws of one seed and number differ by σ alone.
    """
    rng = np.random.default_rng([seed, draw])
    model = load_wam().model
    share = np.zeros(len(model.bodies))
    for k in range(len(share)):
        share[k] = rng.normal()
        while np.abs(share[k]) > 1.0:
            share[k] = rng.normal()
    return (model.phi * (1.0 + sigma * share[:, None])).ravel()


HELD = np.array([0.0, 0.0, 0.1])  # m from the palm's origin: where a load is thought to be
MASS = 3.0  # kg


def ellipsoid(mass: float, semi_axes: Array, offset: Array) -> Array:
    """Return (10,) of a uniform ellipsoid in the palm's frame, `offset` from `HELD`."""
    center = HELD + np.asarray(offset, float)
    return Ellipsoid(center, np.asarray(semi_axes, float), np.eye(3)).uniform_body(mass)


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
    """Return (10,) of another load: 2 to 4 kg, semi-axes of 3 to 25 cm, up to 6 cm off."""
    rng = np.random.default_rng([seed, number])
    return ellipsoid(rng.uniform(2.0, 4.0), rng.uniform(0.03, 0.25, 3), rng.uniform(-0.06, 0.06, 3))


@dataclass(frozen=True, eq=False)
class Loaded:
    """The arm with an unknown load."""

    control: ControlModel  # the arm, whose 70 parameters are known, and the ten of the load

    def law(self, name: str, speed: float) -> PartialLaw | None:
        """Return a law of the load alone, by its name and γ⁻¹."""
        law = make_law(name, PhysicalInertia(), GUESS, speed)
        part = np.arange(len(self.control.prior)) >= self.control.num_inertial
        return None if law is None else PartialLaw(law, part)

    def parameters(self, load: Array) -> Array:
        """Return (80,) of the arm with a load (10,)."""
        return np.concatenate([self.control.prior[: self.control.num_inertial], load])


@cache
def load_loaded() -> Loaded:
    """Return the arm with the guess, read once in a process."""
    model = replace(load_wam().model, effects=(FittedEffect(Payload("palm"), GUESS),))
    return Loaded(ControlModel.of(model))
