"""A simulated robot that tracks a motion, with hidden efforts in formulas of their own.

Drake gives mass matrix, bias and gravity. Drives add stiff PD control to the inverse dynamics of
the model file. Steps are linearly implicit in friction and control, so that they are stable however
stiff those are. Dry friction is v/√(v² + ε²), not the tanh of `geodrake.effects`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant

from geodrake.logs import JointLog
from geodrake.model import RobotModel
from geodrake.robot import inverse_dynamics

Array = NDArray[np.float64]
Reference = Callable[[Array], tuple[Array, Array, Array]]

STEP = 1e-3  # s
EVERY = 5  # steps from one sample to the next
BANDWIDTH = 120.0  # of the drives, rad/s
DAMPING = 0.7
LEAST_INERTIA = 0.1  # kg·m² that drives are tuned for at least
BREAKAWAY = 5e-3  # rad/s
ENCODER = 1e-5  # rad


@dataclass(frozen=True)
class Hidden:
    """What the robot has and the model file lacks; (n,) by joint, SI units.

    Attributes:
        coulomb: Dry friction.
        load_factor: Share of the gear's load that dry friction takes.
        viscous: Viscous friction, forwards and backwards alike.
        one_way: Further viscous friction forwards.
        quadratic: Friction that grows with the square of the speed.
        offset: Constant effort.
        stiffness: Of springs at rest at q = 0.
        tilt: (2,) angles by which the base is turned about x and y, rad.
    """

    coulomb: Array
    load_factor: Array
    viscous: Array
    one_way: Array
    quadratic: Array
    offset: Array
    stiffness: Array
    tilt: Array

    @classmethod
    def of(cls, joints: int, **effects: dict[int, float] | tuple[float, float]) -> Hidden:
        """Some effects by joint number; the others are zero."""
        values = {name: np.zeros(joints) for name in cls.__annotations__} | {"tilt": np.zeros(2)}
        for name, given in effects.items():
            pairs = given.items() if isinstance(given, dict) else enumerate(given)
            for at, value in pairs:
                values[name][at] = value
        return cls(**values)

    def effort(self, q: Array, v: Array, load: Array) -> tuple[Array, Array]:
        """(n,) effort needed, and its slope in v."""
        root = np.sqrt(v * v + BREAKAWAY**2)
        height = self.coulomb + self.load_factor * np.abs(load)
        wet = self.viscous + self.one_way * (v > 0)
        needed = height * v / root + wet * v + self.quadratic * np.abs(v) * v
        slope = height * BREAKAWAY**2 / root**3 + wet + 2.0 * self.quadratic * np.abs(v)
        return needed + self.offset + self.stiffness * q, slope


def tilted(plant: MultibodyPlant, tilt: Array) -> None:
    """Turns the gravity of a plant as a base turned by small angles about x and y sees it."""
    field = plant.mutable_gravity_field()
    turn = np.array([tilt[0], tilt[1], 0.0])
    field.set_gravity_vector(field.gravity_vector() + np.cross(field.gravity_vector(), turn))


def simulate(
    plant: MultibodyPlant, model: RobotModel, hidden: Hidden, motion: Reference, duration: float
) -> tuple[Array, Array, Array]:
    """Positions, velocities and applied efforts (steps, n) of the robot on a motion.

    Args:
        plant: The robot itself, finalized, its positions in the order of its joints.
        model: The model file, for the drives' feedforward.
        hidden: Further efforts.
        motion: Position, velocity and acceleration (N, n) at instants (N,).
        duration: Length, s.
    """
    steps = round(duration / STEP)
    q_ref, v_ref, a_ref = motion(STEP * np.arange(steps + 1))
    forward = inverse_dynamics(model.tree, q_ref, v_ref, a_ref, model.total_phi)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, q_ref[0])
    inertia = LEAST_INERTIA + np.diag(plant.CalcMassMatrix(context))
    stiffness, damping = BANDWIDTH**2 * inertia, 2.0 * DAMPING * BANDWIDTH * inertia
    implicit = damping + STEP * stiffness
    q, v, load = q_ref[0].copy(), v_ref[0].copy(), np.zeros(len(inertia))
    rows = np.empty((3, steps, len(inertia)))
    for k in range(steps):
        middle = q + 0.5 * STEP * v
        plant.SetPositions(context, middle)
        plant.SetVelocities(context, v)
        u = forward[k] + stiffness * (q_ref[k + 1] - q - STEP * v) + damping * (v_ref[k + 1] - v)
        f, slope = hidden.effort(middle, v, load)
        rest = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        mass = plant.CalcMassMatrix(context)
        a = np.linalg.solve(mass + np.diag(STEP * (slope + implicit)), u - f - rest)
        u -= STEP * implicit * a
        load = mass @ a + rest
        rows[:, k] = q, v, u
        q, v = q + STEP * (v + 0.5 * STEP * a), v + STEP * a
    return rows[0], rows[1], rows[2]


def record(
    name: str, model: RobotModel, rows: tuple[Array, Array, Array], noise: Array, seed: int
) -> JointLog:
    """What sensors make of a simulation: white noise (n,) on efforts, an encoder's on positions."""
    q, v, u = rows
    rng = np.random.default_rng(seed)
    at = np.arange(1, len(q), EVERY)
    effort = 0.5 * (u[at] + u[at - 1])  # an effort is held over a step
    return JointLog(
        name,
        model.joints,
        STEP * at,
        q[at] + ENCODER * rng.normal(size=effort.shape),
        effort + noise * rng.normal(size=effort.shape),
        v[at] + 20.0 * ENCODER * rng.normal(size=effort.shape),
    )
