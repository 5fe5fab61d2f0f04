"""Sandbags on an AMBIDEX-like arm: inertia and friction adapt, by four laws ([Lee2019] §5.6).

One to three links carry sandbags of 500 g. The controller starts from what was identified without
them, as in `ambidex_arm.py`: bodies and friction of the motors are a little off, and friction is
uneven, which no parameter explains. Its gains are small, λ = 3 1/s, it acts at 1 kHz, and friction
adapts twice as fast as inertia. The plant has ten joints, coupled in pairs by constraints, and
makes fourteen random point-to-point motions of 1.5 s (figures 5.8, 5.9). Adaptation speeds γ⁻¹ are
the source's, or with `--gains rule` chosen by one rule for all laws (`adaptive/laws.py`), on other
motions and a sandbag at link 8, and without its condition on V, as no parameters are the truth.

    python -m diagrams.studies.ambidex_sandbags --json sandbags.json --figures figures
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, MatrixGain
from pydrake.trajectories import PiecewisePolynomial, Trajectory

from diagrams.harness import chart, show, write
from diagrams.studies.adaptive import laws, loop
from diagrams.studies.ambidex.arm import (
    COULOMB,
    MODEL,
    REACH,
    REDUCTION,
    ROTOR_INERTIA,
    UNEVEN,
    VISCOUS,
    WAVES,
    Arm,
    Array,
    measure,
)
from diagrams.studies.ambidex_arm import HULL, identified, prior_of
from geodrake.control import (
    AdaptiveController,
    ControlModel,
    EffectForce,
    PartialLaw,
    PassivityBasedAdaptiveController,
    VaryingGains,
    add_adaptive_loop,
    parameter_manifold,
)
from geodrake.effects import (
    CoulombFriction,
    CoupledFriction,
    Effect,
    FittedEffect,
    RotorInertia,
    ViscousFriction,
)
from geodrake.inertia import from_mass_com_inertia, is_physical, to_spatial_inertia
from geodrake.manifolds import Product
from geodrake.model import RobotModel, load_description, load_model
from geodrake.robot import LinearTransmission, RobotPorts
from geodrake.robot.transmission.schema import Drive

# The AMBIDEX-like arm for adaptive control: seven joints of ten move by themselves, and motor
# friction. The second joint of a rolling pair turns as the first, and both take half a turn each.

FIRST = (0, 1, 2, 3, 5, 6, 8)
"""The joints that move by themselves, one for each turn of the arm."""
PAIRS = ((3, 4), (6, 7), (8, 9))
SHARES = np.array([1.0, 1.0, 1.0, 0.5, 1.0, 0.5, 0.5])  # of a turn that its first joint takes
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
    """Return J (10, 7), all joints of the first ones."""
    J = np.zeros((10, 7))
    J[FIRST, range(7)] = 1.0
    for first, second in PAIRS:
        J[second] = J[first]
    return J


def coupled_model() -> RobotModel:
    """Return the arm whose first joints are driven, and the others with them."""
    joints = load_description(MODEL).joints
    drive = Drive(tuple(joints[k] for k in FIRST), joints, LinearTransmission.of(joint_map()))
    return load_model(MODEL, transmission=[drive])


@dataclass(frozen=True, eq=False)
class Known:
    """Parameters of the arm, identified or true."""

    phi: Array  # (17, 10) of links and then rotors
    coulomb: Array  # (7,) of the motors, N·m
    viscous: Array  # (7,) of the motors, N·m·s/rad

    @classmethod
    def true(cls, phi: Array) -> Known:
        """Return the true parameters."""
        return cls(phi, COULOMB, VISCOUS)

    def friction(self, joints: Sequence[str]) -> list[FittedEffect]:
        """Return the friction of the motors at the seven joints that they turn.

        A motor that turns k times as fast as its joint, or as the sum or difference of the wrist's
        two, contributes k f_c and k² f_v.
        """
        ratio = REDUCTION / SHARES
        found = []
        for k, joint in enumerate(joints[:5]):
            found.append(_fitted(CoulombFriction(joint), ratio[k] * self.coulomb[k]))
            found.append(_fitted(ViscousFriction(joint), ratio[k] ** 2 * self.viscous[k]))
        wrist = tuple(joints[5:])
        for k, sign in ((5, 1), (6, -1)):
            both = ratio[k] * self.coulomb[k], ratio[k] ** 2 * self.viscous[k]
            found.append(_fitted(CoupledFriction(wrist, sign), *both))
        return found

    def rotors(self) -> Array:
        """Return (7,) rotor inertia at each turn's joint, kg·m².

        The wrist's two motors turn both of its joints; the coupling by their difference is left
        out.
        """
        motor = self.phi[10:, 6]
        felt = np.append(motor[:5], [motor[5:].sum()] * 2)
        return felt * (REDUCTION / SHARES) ** 2


def _fitted(effect: Effect, *parameters: float) -> FittedEffect:
    return FittedEffect(effect, np.maximum(parameters, 1e-6))


@dataclass(frozen=True, eq=False)
class CoupledArm:
    """The arm for one experiment."""

    control: ControlModel  # what the controller knows; the rotors' inertias come last, and stay
    manifold: Product

    @classmethod
    def of(cls, known: Known) -> CoupledArm:
        """Return the arm with identified parameters."""
        model = coupled_model()
        friction = known.friction(model.joints)
        rotors = [
            _fitted(RotorInertia(joint), inertia)
            for joint, inertia in zip(model.joints, known.rotors(), strict=True)
        ]
        adapted = replace(model, phi=known.phi[:10], effects=tuple(friction))
        whole = replace(adapted, effects=(*friction, *rotors))
        control = ControlModel.of(whole, sign_width=SIGN_WIDTH)
        return cls(control, parameter_manifold(adapted, effect_weight=FRICTION_WEIGHT))

    def law(self, name: str, speed: float) -> PartialLaw | None:
        """Return a law of links and friction, by its name and γ⁻¹."""
        size = self.manifold.dimension
        law = laws.make_law(name, self.manifold, self.control.prior[:size], speed)
        part: NDArray[np.bool_] = np.arange(len(self.control.prior)) < size
        return None if law is None else PartialLaw(law, part)


def make_coupled_plant(bags: Sequence[int]) -> MultibodyPlant:
    """Return the true arm with sandbags at links: ten joints, coupled by constraints."""
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


DURATION = 1.5  # s of a motion, [Lee2019] §5.6


@cache
def known_arm(seed: int) -> Known:
    """Return the arm, identified from the motions of `ambidex_arm.py`."""
    measured = measure(Arm.load(), seed=seed, hull=HULL)
    result = identified(prior_of(0, seed, measured)[1], measured)
    return Known(result.phi, result.extra[:7], result.extra[7:])


def point_to_point(count: int, seed: int) -> PiecewisePolynomial:
    """Return minimum-jerk moves of joints (7,) between random places, from zero."""
    rng = np.random.default_rng([seed, 56])
    ends = SHARES * np.vstack([np.zeros(7), rng.uniform(-REACH, REACH, (count, 7))])
    s = np.linspace(0.0, 1.0, 31)
    share = 10 * s**3 - 15 * s**4 + 6 * s**5
    return loop.resting(
        ((s + k) * DURATION, (ends[k] + share[:, None] * (ends[k + 1] - ends[k])).T)
        for k in range(count)
    )


class UnevenFriction(LeafSystem):
    """Dry friction of motors by their position, which no parameter explains."""

    def __init__(self, seed: int) -> None:
        LeafSystem.__init__(self)
        self._phase = np.random.default_rng([seed, 57]).uniform(0.0, 2.0 * np.pi, 7)
        motors = np.eye(7)
        motors[5:, 5:] = [[1.0, 1.0], [1.0, -1.0]]
        self._motors = REDUCTION * motors / SHARES @ np.linalg.pinv(joint_map())
        self._state = self.DeclareVectorInputPort("state", BasicVector(20))
        self.DeclareVectorOutputPort("generalized_force", BasicVector(10), self._calc)

    def _calc(self, context: Context, output: BasicVector) -> None:
        state = self._state.Eval(context)
        q, v = self._motors @ state[:10], self._motors @ state[10:]
        sign = np.tanh(v / (SIGN_WIDTH * REDUCTION))
        share = np.sqrt(2.0) * UNEVEN * np.sin(WAVES * q / REDUCTION + self._phase)
        output.SetFromVector(-self._motors.T @ (share * COULOMB * sign))


def simulate_coupled(
    controller: AdaptiveController,
    bags: Sequence[int],
    motion: Trajectory,
    *,
    seed: int,
    end: float | None = None,
) -> loop.Record:
    """Simulate the arm with sandbags over a motion of its joints, until `end` or lost."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(make_coupled_plant(bags))
    first = np.linalg.pinv(joint_map())
    measured = builder.AddSystem(MatrixGain(np.kron(np.eye(2), first)))
    applied = builder.AddSystem(MatrixGain(first.T))
    builder.Connect(plant.get_state_output_port(), measured.get_input_port())
    builder.Connect(applied.get_output_port(), plant.get_actuation_input_port())
    _add_friction(builder, plant, seed)
    ends = measured.get_output_port(), None, applied.get_input_port()
    ports = RobotPorts(controller.control.joints, *ends)
    added = add_adaptive_loop(builder, ports, controller, motion, log_period=loop.LOG_PERIOD)
    record = loop.simulate_loop(builder, added, plant, motion, end, joints=joint_map())
    return replace(record, error=record.error / SHARES)  # of turns


def _add_friction(builder: DiagramBuilder, plant: MultibodyPlant, seed: int) -> None:
    """Add friction, with and without parameters that explain it."""
    joints = [plant.get_joint(index).name() for index in plant.GetJointIndices()]
    moving = [name for name in joints if plant.GetJointByName(name).num_velocities()]
    known = Known.true(Arm.load().phi).friction([moving[k] for k in FIRST])
    effects = [(fitted.effect, fitted.parameters) for fitted in known]
    even = builder.AddSystem(EffectForce(plant, effects, sign_width=SIGN_WIDTH))
    uneven = builder.AddSystem(UnevenFriction(seed))
    both = builder.AddSystem(Adder(2, 10))
    state = plant.get_state_output_port()
    builder.Connect(state, even.GetInputPort("state"))
    builder.Connect(state, uneven.get_input_port())
    builder.Connect(even.get_output_port(), both.get_input_port(0))
    builder.Connect(uneven.get_output_port(), both.get_input_port(1))
    builder.Connect(both.get_output_port(), plant.get_applied_generalized_force_input_port())


RATE = 3.0  # λ, 1/s, [Lee2019] §5.6
MOTIONS = 14
GRID_CASE, GRID_BAGS = "grid", (7,)
LINKS = 100  # parameters of the links


@dataclass(frozen=True)
class Draw:
    """One closed loop."""

    case: str
    law: str
    speed: float
    motions: int = MOTIONS
    end: float | None = None  # when to stop, s; None for the end of the last motion


def run_draw(draw: Draw, *, seed: int) -> dict[str, Any]:
    """Return a row of the table."""
    seed = seed if draw.case in BAGS else laws.CALIBRATION_SEED
    bags = BAGS.get(draw.case, GRID_BAGS)
    arm = CoupledArm.of(known_arm(seed))
    controller = PassivityBasedAdaptiveController(
        arm.control, arm.law(draw.law, draw.speed), gains=VaryingGains(RATE)
    )
    motion = point_to_point(draw.motions, seed)
    record = simulate_coupled(controller, bags, motion, seed=seed, end=draw.end)
    p = record.parameters
    physical = is_physical(p[:, :LINKS].reshape(len(p), -1, 10)).all(axis=1)
    physical &= (p[:, LINKS:] > 0).all(axis=1)
    return {
        **record.told(draw, controller),
        "case": draw.case,
        "rounds": record.rounds(DURATION, draw.motions),
        "unphysical": float(1.0 - physical.mean()),
        "added": float((p[-1] - p[0])[:LINKS:10].sum()),
        "series": record.series,
    }


def all_draws(options: argparse.Namespace) -> list[Draw]:
    """Return every case with every law."""
    speed = laws.speeds("sandbags", options.gains)
    cases = ("link 10",) if options.quick else tuple(BAGS)
    some = (1, 1.0) if options.quick else (MOTIONS, None)
    return [Draw(case, law, speed[law], *some) for case, law in product(cases, laws.LAWS)]


def grid_draws(options: argparse.Namespace) -> list[Draw]:
    """Return the draws from which speeds are chosen."""
    tried = product(laws.LAWS[1:], laws.GRID)
    return [Draw(GRID_CASE, law, speed, 3) for law, speed in tried]


def tell(options: argparse.Namespace, rows: list[Any]) -> None:
    """Print and write the results."""
    for row in rows:
        row["motor"] = REDUCTION * row["rms"]
        half = [x for x in row["rounds"][len(row["rounds"]) // 2 :] if x is not None]
        row["late"] = float(np.mean(half)) if half else None
    show(f"Tracking RMS in degrees, gains: {options.gains}", rows)
    table = {"gains": options.gains, "period": loop.SHOWN_PERIOD, "rows": rows}
    figures = {
        "ambidex_sandbags": lambda: chart(rows, "case", "rms", "law", note="RMS in degrees"),
        "ambidex_sandbags_course": lambda: chart(
            loop.timed(rows), "time", "series", "law", panel="case"
        ),
    }
    write(options, table, **figures)


def main() -> None:
    """Run the study from the command line."""
    parser = laws.study_parser(__doc__, gains="source")
    laws.run_study(parser, run_draw, all_draws, grid_draws, tell, group="case")


if __name__ == "__main__":
    main()
