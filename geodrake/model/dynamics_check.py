"""Comparison of a model's dynamics with MultibodyPlant and with another program.

Drake supplies a model's tree and constants, but efforts and regressors come from a compiled
recursion over that tree (`geodrake.robot.recursion`), which is compared with MultibodyPlant.

MultibodyPlant has the bodies that geodrake read, so this cannot reveal errors of reading. For these
MuJoCo compiles an MJCF file, Pinocchio reads a URDF, and Drake reads all other files unmodified.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.tree import MultibodyForces

from geodrake.boundary.arguments import instance, integer
from geodrake.boundary.showing import Short
from geodrake.errors import ModelError
from geodrake.inertia import Array, inertial_parameters
from geodrake.model.other_programs import (
    OtherProgram,
    Places,
    by_drake,
    by_pinocchio,
    joint_units,
    with_mujoco,
)
from geodrake.model.robot_model import RobotModel, is_of_file
from geodrake.robot.files import read_description
from geodrake.robot.files.description import drake_messages
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.texts import ModelText
from geodrake.robot.plant import set_inertial_parameters
from geodrake.robot.regressor import inverse_dynamics, inverse_dynamics_regressor
from geodrake.robot.transmission import times

States = tuple[Array, Array, Array]


def second_opinion(model: RobotModel, states: States) -> tuple[str, Array, Array] | str:
    """Return another program's name, its efforts (N, nv) and geodrake's, or the reason for none.

    Both include what that program supports: all but dry friction for MuJoCo, only the bodies for
    Pinocchio.
    """
    if model.given.robot is not None:
        return "one of several robots was chosen, and only Drake reads part of a file"
    try:
        with drake_messages():
            texts = read_description(model.path, model.given).texts
        is_mjcf = len(texts) == 1 and isinstance(texts[0], MjcfText)
        was_changed = is_mjcf and not is_of_file(model)
    except ModelError as error:
        return f"the model's file cannot be read again: {error.problem.rstrip('.')}"
    bodies_differ = not np.array_equal(model.total_phi, inertial_parameters(model.plant))
    if was_changed or bodies_differ or model.fitted_to:
        return "the model was changed after loading its file"
    held = {name: place for text in texts for name, place in _held(model, text).items()}
    if is_mjcf and isinstance(texts[0], MjcfText):
        return with_mujoco(model, texts[0].compiled, held, states)
    pinocchio: OtherProgram | str = ""
    if len(texts) == 1 and texts[0].kind == "urdf":
        pinocchio = by_pinocchio(model, texts[0], held, joint_units(model.plant))
    why = pinocchio if isinstance(pinocchio, str) else ""
    other = by_drake(model) if isinstance(pinocchio, str) else pinocchio
    if isinstance(other, str):
        return why or other
    ours = inverse_dynamics(model.tree, *states, model.total_phi)
    by = f"{other.by} ({why})" if why else other.by
    return by, other.efforts_of(model.coordinates, states), ours


def _held(model: RobotModel, text: ModelText) -> Places:
    """Return the positions of fixed joints and of their followers."""
    places, ties = dict(model.held), text.terms.followers
    for _ in ties:  # followers may form chains
        for joint, tie in ties.items():
            if (leader := tie.leader.split("::")[-1]) in places:
                places.setdefault(joint.split("::")[-1], tie.at(places[leader]))
    return places


Quantities = dict[str, Array]

QUANTITIES = ("inverse dynamics", "regressor", "gravity", "bias", "mass matrix")

TOLERANCE = 1e-9
"""Largest relative difference that counts as rounding."""

MOST_SAMPLES = 10_000
_SPEED, _ACCELERATION = 3.0, 10.0  # rad/s or m/s, and per s
_UPRIGHT = 0.45  # largest pitch of a free base, as a share of 180°
_SIZES = np.array([1.0, *[0.3] * 3, *[0.1] * 6])  # magnitude of parameters per mass: 1, m, m²


@dataclass(frozen=True)
class Agreement(Short):
    """Difference of two computations of a quantity.

    Attributes:
        difference: Largest difference, N·m or N; for the mass matrix kg·m² or kg.
        size: Largest effort of the inverse dynamics, or largest entry of the mass matrix.
        where: Joint of the largest difference; for the mass matrix, row and column.
    """

    quantity: str
    difference: float
    size: float
    where: tuple[str, ...]

    @property
    def relative(self) -> float:
        """Return the relative difference."""
        return self.difference / self.size if self.size else float(np.sign(self.difference))

    @property
    def holds(self) -> bool:
        """Return whether the difference is rounding."""
        return self.relative <= TOLERANCE  # false for NaN


@dataclass(frozen=True, eq=False)
class DynamicsCheck(Short):
    """Comparison of a model's dynamics with MultibodyPlant and with another program.

    Attributes:
        repairs: Repairs of the model's file.
        left_out: Those that ignored an element of the file.
        second: Agreement of efforts with another program that reads the file; None without one.
        by: Name of that program, or the reason for none.
    """

    agreements: tuple[Agreement, ...]
    joints: tuple[str, ...]
    bodies: int
    samples: int
    seed: int
    repairs: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    second: Agreement | None = None
    by: str = ""
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> Agreement:
        """Return the agreement with the largest relative difference."""
        return max(self.agreements, key=lambda a: (not a.holds, a.relative))

    @property
    def is_rounding(self) -> bool:
        """Return whether all differences are rounding."""
        return all(agreement.holds for agreement in self.agreements)

    @property
    def holds(self) -> bool:
        """Return whether all differences are rounding and the file needed no repair."""
        second = self.second is None or self.second.holds
        return self.is_rounding and second and not self.repairs


def check_dynamics(model: RobotModel, *, samples: int = 100, seed: int = 0) -> DynamicsCheck:
    """Compare the rigid bodies' dynamics with MultibodyPlant's, payloads included.

    States are random within the limits of positions and speeds. Regressors are compared by the
    efforts of random bodies, different in every sample. Following joints move with their leaders,
    joints behind a transmission with their actuators, and their efforts are mapped there. Effects
    are excluded.

    Another program, such as MuJoCo or Pinocchio, checks the file. This requires an unchanged model:
    without payloads, fits or, for MJCF, added effects.
    """
    instance(model, "model", RobotModel)
    integer(samples, "samples", lower=1, upper=MOST_SAMPLES)
    rng = np.random.default_rng(integer(seed, "seed", lower=0))
    states, phi = _random_states(model, samples, rng), model.total_phi
    mass = float(np.abs(phi[:, 0]).mean()) or 1.0
    others = mass * _SIZES * rng.uniform(-1.0, 1.0, (samples, *phi.shape))
    others[..., 0] += 2.0 * mass  # Drake divides by it
    ours = _by_recursion(model, states, phi, others)
    drakes = _by_plant(model, states, others)
    largest = float(np.abs(drakes["inverse dynamics"]).max(initial=0.0))
    sizes = {"mass matrix": float(np.abs(drakes["mass matrix"]).max(initial=0.0))}
    agreements = tuple(
        _agreement(name, ours[name] - drakes[name], sizes.get(name, largest), model.joints)
        for name in ours
    )
    of_model = model.joints, len(model.bodies), samples, seed, model.repairs, model.left_out
    second, by = None, second_opinion(model, states)
    if not isinstance(by, str):
        by, efforts, by_model = by
        size = float(np.abs(efforts).max(initial=0.0))
        second = _agreement(f"efforts by {by}", by_model - efforts, size, model.joints)
    notes = tuple(dict.fromkeys((*model.repairs, *model.notes)))
    return DynamicsCheck(agreements, *of_model, second, by, notes)


def _random_states(model: RobotModel, count: int, rng: np.random.Generator) -> States:
    """Return positions (N, nq), velocities and accelerations (N, nv) within the robot's limits."""
    lower, upper = model.position_limits
    lower, upper = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
    middle = np.clip(0.0, np.minimum(lower, upper), np.maximum(lower, upper))
    low, high = np.where(lower <= upper, [lower, upper], middle)  # limits may be farther than π
    q = rng.uniform(low, high, (count, len(low)))
    pitches = [k for k, joint in enumerate(model.joints) if joint in model.base_joints[4::6]]
    q[:, pitches] *= _UPRIGHT  # angles of free bases are singular at a pitch of 90°
    v, vd = rng.uniform(-1.0, 1.0, (2, count, len(model.joints)))
    return q, v * np.minimum(model.velocity_limits, _SPEED), vd * _ACCELERATION


def _by_recursion(model: RobotModel, states: States, phi: Array, others: Array) -> Quantities:
    """Return geodrake's dynamics of states (N, ·), bodies (nb, 10) and random ones (N, nb, 10)."""
    (q, v, vd), tree = states, model.tree
    still, (count, nv) = np.zeros_like(v), v.shape
    regressors = (
        inverse_dynamics_regressor(tree, *(x[k : k + 1] for x in states))[0] for k in range(count)
    )
    gravity = inverse_dynamics(tree, q, still, still, phi)
    units = np.repeat(q, nv, 0), np.zeros((count * nv, nv)), np.tile(np.eye(nv), (count, 1))
    columns = inverse_dynamics(tree, *units, phi).reshape(count, nv, nv) - gravity[:, None]
    return {
        "inverse dynamics": inverse_dynamics(tree, q, v, vd, phi),
        "regressor": np.array([Y @ p.ravel() for Y, p in zip(regressors, others, strict=True)]),
        "gravity": gravity,
        "bias": inverse_dynamics(tree, q, v, still, phi) - gravity,
        "mass matrix": np.swapaxes(columns, 1, 2),
    }


def _by_plant(model: RobotModel, states: States, others: Array) -> Quantities:
    """Return MultibodyPlant's dynamics of the same states, mapped to leaders and actuators."""
    plant = model.plant
    q, v, vd, jacobians = model.coordinates.tree_samples(*states)
    along = vd - times(jacobians, states[2])
    context, other = model.create_context(), plant.CreateDefaultContext()
    none = MultibodyForces(plant)
    result: dict[str, list[Array]] = {name: [] for name in QUANTITIES}
    for k, phi in enumerate(others):
        set_inertial_parameters(plant, other, phi)
        for at in (context, other):
            plant.SetPositions(at, q[k])
            plant.SetVelocities(at, v[k])
        gravity = -plant.CalcGravityGeneralizedForces(context)
        weight = -plant.CalcGravityGeneralizedForces(other)
        J, M = jacobians[k], plant.CalcMassMatrix(context)
        values = (
            J.T @ (plant.CalcInverseDynamics(context, vd[k], none) + gravity),
            J.T @ (plant.CalcInverseDynamics(other, vd[k], none) + weight),
            J.T @ gravity,
            J.T @ (plant.CalcBiasTerm(context) + M @ along[k]),
            J.T @ M @ J,
        )
        for name, value in zip(QUANTITIES, values, strict=True):
            result[name].append(value)
    return {name: np.array(values) for name, values in result.items()}


def _agreement(name: str, error: Array, size: float, joints: Sequence[str]) -> Agreement:
    """Return the agreement for differences (N, nv) or (N, nv, nv)."""
    worst = np.abs(error).max(axis=0, initial=0.0)
    at = np.unravel_index(int(np.argmax(worst)), worst.shape) if worst.size else ()
    where = tuple(dict.fromkeys(joints[int(k)] for k in at))
    return Agreement(name, float(worst[at]) if worst.size else 0.0, size, where)
