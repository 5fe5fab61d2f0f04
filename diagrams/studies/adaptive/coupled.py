"""The AMBIDEX-like arm for adaptive control: seven turns that move ten joints, and motor friction.

Turns t and joints θ are in proportion, θ = J t: two joints of a rolling pair take half a turn each.
So efforts of the turns are Jᵀ times those of the joints, and with Jᵀ Y for the regressor all that
holds for a robot of ten joints holds for the seven turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant

from diagrams.studies.adaptive.laws import make_law
from diagrams.studies.ambidex.arm import COULOMB, MODEL, REDUCTION, ROTOR_INERTIA, VISCOUS, Array
from geodrake.control import ControlModel, PartialLaw, parameter_manifold
from geodrake.control.regressor import ControlSample
from geodrake.effects import (
    CoulombFriction,
    CoupledFriction,
    Effect,
    FittedEffect,
    RotorInertia,
    ViscousFriction,
)
from geodrake.inertia import from_mass_com_inertia, to_spatial_inertia
from geodrake.manifolds import Product
from geodrake.model import RobotModel, load_description

FIRST = (0, 1, 2, 3, 5, 6, 8)
"""The joint that stands for each turn."""
PAIRS = ((3, 4), (6, 7), (8, 9))
SHARES = np.array([1.0, 1.0, 1.0, 0.5, 1.0, 0.5, 0.5])
BAGS = {"link 10": (9,), "links 3, 10": (2, 9), "links 3, 5, 10": (2, 4, 9)}
"""Where the sandbags are ([Lee2019] figure 5.7), counted from zero."""
BAG_AT = {
    2: (0.05, 0.0, -0.12),
    4: (0.045, 0.0, -0.06),
    7: (0.04, 0.0, -0.01),
    9: (0.04, 0.0, -0.06),
}
BAG_MASS, BAG_RADIUS = 0.5, 0.04  # kg, m
FRICTION_WEIGHT = 0.5  # [Lee2019] §5.6: friction adapts twice as fast
SIGN_WIDTH = 0.02  # rad/s
PLANT_STEP = 5e-4  # s


def joint_map() -> Array:
    """J (10, 7)."""
    J = np.zeros((10, 7))
    J[FIRST, range(7)] = SHARES
    for first, second in PAIRS:
        J[second] = J[first]
    return J


@dataclass(frozen=True, eq=False)
class CoupledSample:
    """The regressor of the turns at one sample.

    Attributes:
        joints: The same of the joints.
        J: (10, 7) joints of turns.
    """

    joints: ControlSample
    J: Array

    @property
    def regressor(self) -> Array:
        """(7, p)."""
        return self.J.T @ self.joints.regressor

    def effort(self, parameters: Array) -> Array:
        """(7,) N·m."""
        return self.J.T @ self.joints.effort(parameters)

    def covector(self, r: Array) -> Array:
        """(p,) Yᵀ r."""
        return self.joints.covector(self.J @ r)

    def mass_matrix(self, parameters: Array) -> Array:
        """(7, 7)."""
        return self.J.T @ self.joints.mass_matrix(parameters) @ self.J


@dataclass(frozen=True, eq=False)
class CoupledControl:
    """What a controller knows of the arm, in its seven turns; stands in for a ControlModel.

    Attributes:
        own: The arm of ten joints.
        J: (10, 7) joints of turns.
    """

    own: ControlModel
    J: Array

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the turns."""
        return tuple(self.own.joints[k] for k in FIRST)

    @property
    def prior(self) -> Array:
        """(p,) parameters."""
        return self.own.prior

    @property
    def single_joints(self) -> bool:
        """True: a turn is one number."""
        return self.own.single_joints

    def at(self, q: Array, qd: Array, v: Array, a: Array) -> CoupledSample:
        """The Slotine–Li regressor, as that of a ControlModel."""
        return CoupledSample(self.own.at(*(self.J @ x for x in (q, qd, v, a))), self.J)


@dataclass(frozen=True, eq=False)
class Known:
    """Parameters of the arm as they were identified, or as they are.

    Attributes:
        phi: (17, 10) of links and then rotors.
        coulomb: (7,) of the motors, N·m.
        viscous: (7,) of the motors, N·m·s/rad.
    """

    phi: Array
    coulomb: Array
    viscous: Array

    @classmethod
    def true(cls, phi: Array) -> Known:
        """The arm as it is."""
        return cls(phi, COULOMB, VISCOUS)

    def friction(self, joints: Sequence[str]) -> list[FittedEffect]:
        """Friction of the motors at the joints that they turn.

        A motor that turns k times as fast as its joint, or as the sum or difference of the wrist's
        two, has there k f_c and k² f_v.
        """
        ratio = REDUCTION / SHARES
        found = []
        for k in range(5):
            joint = joints[FIRST[k]]
            found.append(_fitted(CoulombFriction(joint), ratio[k] * self.coulomb[k]))
            found.append(_fitted(ViscousFriction(joint), ratio[k] ** 2 * self.viscous[k]))
        wrist = (joints[FIRST[5]], joints[FIRST[6]])
        for k, sign in ((5, 1), (6, -1)):
            both = ratio[k] * self.coulomb[k], ratio[k] ** 2 * self.viscous[k]
            found.append(_fitted(CoupledFriction(wrist, sign), *both))
        return found

    def rotors(self) -> Array:
        """(7,) rotor inertia that each turn's joint feels, kg·m².

        The wrist's two motors turn both of its joints; what their difference couples is left out.
        """
        motor = self.phi[10:, 6]
        felt = np.append(motor[:5], [motor[5:].sum()] * 2)
        return felt * (REDUCTION / SHARES) ** 2


def _fitted(effect: Effect, *parameters: float) -> FittedEffect:
    return FittedEffect(effect, np.maximum(parameters, 1e-6))


@dataclass(frozen=True, eq=False)
class CoupledArm:
    """The arm for one experiment.

    Attributes:
        control: What the controller knows; the rotors' inertias come last, and stay.
        manifold: Where what is adapted lives: ten links and the friction.
    """

    control: CoupledControl
    manifold: Product

    @classmethod
    def of(cls, known: Known) -> CoupledArm:
        """The arm with identified parameters."""
        model = load_description(MODEL)
        friction = known.friction(model.joints)
        adapted: RobotModel = replace(model, phi=known.phi[:10], effects=tuple(friction))
        rotors = [
            _fitted(RotorInertia(model.joints[joint]), inertia)
            for joint, inertia in zip(FIRST, known.rotors(), strict=True)
        ]
        whole = replace(adapted, effects=(*friction, *rotors))
        control = ControlModel.of(whole, sign_width=SIGN_WIDTH)
        manifold = parameter_manifold(adapted, effect_weight=FRICTION_WEIGHT)
        return cls(CoupledControl(control, joint_map()), manifold)

    def law(self, name: str, speed: float) -> PartialLaw | None:
        """A law of links and friction, by its name and γ⁻¹."""
        size = self.manifold.dimension
        law = make_law(name, self.manifold, self.control.prior[:size], speed)
        part: NDArray[np.bool_] = np.arange(len(self.control.prior)) < size
        return None if law is None else PartialLaw(law, part)


def make_coupled_plant(bags: Sequence[int]) -> MultibodyPlant:
    """The true arm with sandbags at links, to be simulated: ten joints, coupled by constraints."""
    plant = MultibodyPlant(PLANT_STEP)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)
    (instance,) = Parser(plant).AddModels(str(MODEL))
    model = load_description(MODEL)
    rotors = Known.true(np.vstack([model.phi, _true_rotors()])).rotors()
    for joint in model.joints:
        plant.AddJointActuator(joint, plant.GetJointByName(joint))
        plant.get_mutable_joint(plant.GetJointByName(joint).index()).set_position_limits(
            [-np.inf], [np.inf]
        )
    for joint, inertia in zip(FIRST, rotors, strict=True):
        actuator = plant.GetJointActuatorByName(model.joints[joint])
        actuator.set_default_rotor_inertia(inertia)
        actuator.set_default_gear_ratio(1.0)
    for first, second in PAIRS:
        plant.AddCouplerConstraint(
            *(plant.GetJointByName(model.joints[k]) for k in (first, second)), 1.0
        )
    for link in bags:
        com = np.array(BAG_AT[link])
        phi = from_mass_com_inertia(BAG_MASS, com, 0.4 * BAG_MASS * BAG_RADIUS**2 * np.eye(3))
        body = plant.AddRigidBody(f"sandbag_{link}", instance, to_spatial_inertia(phi))
        plant.WeldFrames(plant.GetFrameByName(model.bodies[link]), body.body_frame())
    plant.Finalize()
    return plant


def _true_rotors() -> Array:
    rotors = np.zeros((7, 10))
    rotors[:, 6] = ROTOR_INERTIA
    return rotors
