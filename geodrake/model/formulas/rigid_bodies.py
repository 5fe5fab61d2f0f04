"""The rigid bodies of a robot as formulas: inverse dynamics, poses and Jacobians.

They are what the compiled recursion (`geodrake.robot.recursion`) computes, run by Python with
arrays of symbols.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from geodrake.compiling import interpreted
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.model.formulas.symbols import Formulas, Symbols
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.recursion import calc_inverse_dynamics, calc_kinematics

_DIGITS = 15  # of a rotation, whose zeros and ones come out with rounding errors


def joint_formulas(tree: KinematicTree, q: Formulas) -> Formulas:
    """Return positions (nq of the tree of joints) as formulas of the robot's (nq)."""
    if (actuation := tree.actuation) is None:
        return q
    if actuation.constant is None:
        raise ModelError(
            "Source code cannot have a closed loop, or a transmission whose ratios change with the "
            "position.",
            advice="Write the formula of the joints, and map it in your own code.",
        )
    whole = Symbols.of(np.zeros(actuation.sizes[0]))
    own, joints = actuation.kept_q
    whole[joints] = q[own]
    for place in actuation.places:
        J, still = place.drive.map.constant_jacobian, np.zeros((1, len(place.actuator_q)))
        shift = place.drive.map.joint_positions(still)[0]
        whole[place.joint_q] = J @ q[place.actuator_q] + shift
    return whole


def _rooms(shape: Any, dtype: np.dtype[Any] | None = None) -> Any:
    """Return room for symbols where compiled code has room for numbers."""
    if dtype is None:
        return np.empty(shape, object)
    fields = [(name, object, dtype[name].shape) for name in dtype.names or ()]
    return np.recarray(shape, fields)


_PLAIN = SimpleNamespace(empty=_rooms, cos=np.cos, sin=np.sin, sqrt=np.sqrt)
_inverse_dynamics = interpreted(calc_inverse_dynamics, np=_PLAIN)
_kinematics = interpreted(calc_kinematics, np=_PLAIN)


def _records(tree: KinematicTree) -> tuple[Any, Any]:
    """Return the tree for code that is run by Python."""
    mobilizers, dofs = tree.records
    plain = mobilizers.copy()
    plain["rotation"] = np.round(plain["rotation"], _DIGITS) + 0.0
    return plain.view(np.recarray), dofs


def inverse_dynamics_formula(
    tree: KinematicTree, q: Formulas, v: Formulas, vd: Formulas, phi: Array
) -> Formulas:
    """Return the effort (nv,) of the bodies φ (nb, 10), at the actuators if there are any."""
    theta, J = joint_formulas(tree, q), _jacobian(tree, len(q))
    theta, rates, accelerations = (np.array([x], object) for x in (theta, J @ v, J @ vd))
    effort = np.zeros((1, len(J)), object)
    samples = theta, rates, rates, accelerations
    _inverse_dynamics(_records(tree.joints), samples, phi, effort)
    return Symbols.of(J.T @ effort[0])


def _jacobian(tree: KinematicTree, size: int) -> Array:
    """Return J (nv of the joints, nv), of positions (nq = size,)."""
    if tree.actuation is None:
        return np.eye(tree.num_velocities)
    return tree.actuation.jacobian(np.zeros((1, size)))[0]


@dataclass(frozen=True, eq=False)
class BodyFormulas(RobotBodies):
    """The bodies of a robot in one configuration of symbols; `q` is (1, nq)."""

    def tree_samples(self, v: Array, vd: Array) -> tuple[Array, Array, Array, Array]:
        """Positions, velocities and accelerations (1, ·) of the joints of the tree, and J."""
        theta = joint_formulas(self.tree, Symbols.of(self.q)[0])
        J = _jacobian(self.tree, self.q.shape[1])
        rates, accelerations = (Symbols.of([J @ x[0]]) for x in (v, vd))
        return theta[None], rates, accelerations, J[None]

    def kinematics(self) -> tuple[Array, Array, Array]:
        """Return poses and Jacobians of all bodies, with the velocities of the joints."""
        tree = self.tree.joints
        q = np.array([joint_formulas(self.tree, Symbols.of(self.q)[0])], object)
        poses = np.zeros((1, len(tree.bodies), 4, 4), object)
        jacobians = np.zeros((2, 1, len(tree.bodies), 3, tree.num_velocities), object)
        _kinematics(_records(tree), q, poses, *jacobians)
        angular, linear = jacobians
        return Symbols.of(poses), Symbols.of(angular), Symbols.of(linear)
