"""The WAM-like arm of the studies of adaptive control."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

from diagrams.harness import MODELS
from geodrake.control import ControlModel, parameter_manifold
from geodrake.inertia import is_physical, to_spatial_inertia
from geodrake.manifolds import Product
from geodrake.model import RobotModel, load_description

Array = NDArray[np.float64]

MODEL = MODELS / "wam_like.urdf"
RATE = 10.0  # λ, 1/s, [Lee2019] §5.5
PERIOD = 5.0  # s, of a round
AMPLITUDE = 0.8  # rad


@dataclass(frozen=True, eq=False)
class Wam:
    """The arm as controllers know it.

    Attributes:
        model: Seven bodies, no friction.
        control: The same for a controller.
        manifold: Where its 70 parameters live.
    """

    model: RobotModel
    control: ControlModel
    manifold: Product

    @property
    def truth(self) -> Array:
        """(70,) the true parameters."""
        return self.control.prior

    def unphysical(self, parameters: Array) -> Array:
        """(N,) whether a body of an estimate (N, 70) cannot exist."""
        return ~is_physical(parameters.reshape(len(parameters), -1, 10)).all(axis=1)


@cache
def load_wam() -> Wam:
    """The arm, read once in a process."""
    model = load_description(MODEL)
    return Wam(model, ControlModel.of(model), parameter_manifold(model))


def make_plant(load: Array | None = None) -> MultibodyPlant:
    """The true arm, to be simulated: without limits of joints or efforts, as in the source.

    Args:
        load: (10,) inertial parameters of a body on the palm, about the palm's origin.
    """
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(MODEL))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    for name in load_wam().model.joints:
        plant.AddJointActuator(name, plant.GetJointByName(name))
    if load is not None:
        body = plant.AddRigidBody(
            "load", plant.GetModelInstanceByName("wam_like"), to_spatial_inertia(load)
        )
        plant.WeldFrames(plant.GetFrameByName("palm"), body.body_frame())
    plant.Finalize()
    return plant


def first_estimate(sigma: float, seed: int, draw: int) -> Array:
    """(70,) parameters of every body scaled by 1 + ε, ε normal and within ±σ ([Lee2019] §5.5.1).

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
