"""Regressors for control, evaluated sample by sample at rates of about 1 kHz.

    M(q, p) a + C(q, q̇, p) v + g(q, p) + effects(v, a, p) = Y(q, q̇, v, a) p  [Lee2019] (5.2.10)

`ControlModel.of(model)` reads a robot model once; `ControlModel.at(q, qd, v, a)` returns a
`ControlSample`, which computes Y p, Yᵀ r and the mass matrix in a few array operations. The
parameters are one vector p = [φ, μ]: inertial parameters, ten per body, then those of the effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, one_or_each
from geodrake.compiling import compiled, contiguous, inlined
from geodrake.control.rigid_bodies import RigidSample, calc_momentum_regressors
from geodrake.effects import Effect, JointMotion, RobotMotion, Role
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.effect_columns import (
    EffectColumns,
    Indices,
    ToRobotMotion,
    Trial,
    put_signals,
)
from geodrake.effects.robot_motion import smoothed_sign
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.logs.motion import Motion
from geodrake.model.robot_model import RobotModel
from geodrake.robot.kinematics import KinematicTree
from geodrake.robot.recursion import TreeRecords, calc_regressor


@dataclass(frozen=True, eq=False, repr=False)
class ControlModel:
    """Constant data of a robot, for the regressors of its samples.

    The parameters are one vector p = [φ, μ]: φ of the nb bodies, ten each, and μ of the effects.

    Attributes:
        effects: The effects, in the order of their parameters.
        prior: (p,) parameters of the robot model.
        measured_friction: Whether effects use the measured velocity q̇ instead of the reference v.
        single_joints: Whether every joint has one degree of freedom, so that q̇ is the rate of q.
        floats: Whether the base is floating.
    """

    tree: KinematicTree
    effects: tuple[Effect, ...]
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    prior: Array
    measured_friction: bool
    single_joints: bool
    floats: bool
    _columns: EffectColumns
    _turning: bool  # whether effects other than payloads depend on accelerations
    _sign_width: Array
    _direction: Callable[[Array], Array]
    _single: NDArray[np.bool_]
    _payloads: tuple[tuple[int, slice], ...]
    _scales: tuple[tuple[int, int], ...]
    _total_phi: Array

    @classmethod
    def of(
        cls,
        model: RobotModel,
        *,
        sign_width: ArrayLike = 1e-2,
        measured_friction: bool = False,
    ) -> ControlModel:
        """Read a robot model.

        Args:
            model: The robot. Effort delays are ignored; hysteresis and drifting friction have their
                steady state.
            sign_width: Minimum speed below which dry friction fades, rad/s or m/s; scalar or (nv,).
            measured_friction: Whether effects use q̇ instead of the reference velocity v. [Lee2019]
                Eq. (5.2.10) uses v, which has less noise but requires friction to grow with speed.
                Use q̇ for other friction, such as Stribeck friction.
        """
        model = instance(model, "model", RobotModel).with_volume
        joints, bodies = model.joints, model.bodies
        single = np.isin(np.arange(len(joints)), model.single_places)
        sign_width = model.sign_widths(one_or_each(sign_width, "sign_width", len(joints)))
        effects = tuple(fitted.effect for fitted in model.effects)
        turning = tuple(effect for effect in effects if effect.role is not Role.BODY)
        trial = _trial(model, sign_width)
        columns = EffectColumns(joints, effects, trial)
        columns.fit_rows(trial(*np.zeros((3, 1, len(joints)))))  # raises if they do not fit
        values = [model.phi.ravel(), *(fitted.parameters for fitted in model.effects)]
        return cls(
            tree=model.tree,
            effects=effects,
            bodies=bodies,
            joints=joints,
            prior=np.concatenate(values),
            measured_friction=measured_friction,
            single_joints=bool(single.all()),
            floats=bool(model.base_joints),
            _columns=columns,
            _turning="vd" in EffectColumns(joints, turning, trial).depends_on,
            _sign_width=sign_width,
            _direction=smoothed_sign(sign_width),
            _single=single,
            _payloads=tuple((bodies.index(name), part) for name, part in _parts(model, Role.BODY)),
            _scales=tuple(
                (joints.index(name), part.start) for name, part in _parts(model, Role.SCALE)
            ),
            _total_phi=model.total_phi,
        )

    @property
    def num_inertial(self) -> int:
        """Number 10 nb of inertial parameters."""
        return PARAMETERS_PER_BODY * len(self.bodies)

    def phi(self, parameters: Array) -> Array:
        """Return inertial parameters (nb, 10) of a parameter vector (p,)."""
        return parameters[: self.num_inertial].reshape(-1, PARAMETERS_PER_BODY)

    def effect_parameters(self, effect: int) -> slice:
        """Return the slice of the parameters of an effect, given by index."""
        counts = [len(e.parameters) for e in self.effects[: effect + 1]]
        return slice(self.num_inertial + sum(counts[:-1]), self.num_inertial + sum(counts))

    def at(self, q: Array, qd: Array, v: Array, a: Array) -> ControlSample:
        """Return the Slotine–Li regressor Y(q, q̇, v, a) at one sample.

        Y p = M(q) a + C(q, q̇) v − τ_g(q) + effects at v and a, with Ṁ − 2 C skew symmetric. With
        v = q̇ and a = v̇ it is the regressor of inverse dynamics and of computed torque. Inputs are
        not checked; non-finite values propagate.

        Load-dependent friction and effort scales use the efforts of the robot model with its
        payloads, so that the columns do not depend on the estimate.

        Args:
            q: (nq,) positions in Drake's order.
            qd: (nv,) measured velocities.
            v: (nv,) reference velocities ([Lee2019] Eq. (5.2.11)).
            a: (nv,) reference accelerations ([Lee2019] Eq. (5.2.12)).
        """
        return ControlSample(self, (q, qd, v, a))

    @cached_property
    def plain(self) -> PlainRobot | None:
        """The robot for compiled loops; None if effects need more than their joint's signals."""
        if self._scales or self.tree.actuation is not None or not self._columns.only_signals:
            return None
        return self.tree.records, self._columns.signals, self._sign_width


PlainRobot = tuple[TreeRecords, tuple[Indices, Indices, Indices], Array]
"""A robot for compiled loops: tree, `EffectColumns.signals`, and sign widths (nv,)."""


@compiled
def calc_plain_regressor(
    plain: PlainRobot, motion: tuple[Array, Array, Array, Array], friction_v: Array, Y: Array
) -> None:
    """Write the regressor at q, q̇, v, a into zeros (nv, p), with friction at `friction_v`."""
    (tree, signals, width), (q, qd, v, a) = plain, motion
    samples = q.reshape((1, -1)), qd.reshape((1, -1)), v.reshape((1, -1)), a.reshape((1, -1))
    full_range = int(np.int64(0)), int(np.int64(-1))  # literals would compile a second version
    calc_regressor(tree, samples, full_range, Y.reshape((1, *Y.shape)))
    effects = Y[:, Y.shape[1] - len(signals[0]) :]
    put_signals((friction_v, a, signs(friction_v, width)), signals, 1.0, effects)


@compiled
def calc_plain_momentum(plain: PlainRobot, q: Array, qd: Array, regressors: Array) -> None:
    """Write the momentum regressors at q and q̇ into zeros (2, nv, p)."""
    tree, signals, width = plain
    q_row, qd_row, zero = q.reshape((1, -1)), qd.reshape((1, -1)), np.zeros(len(qd))
    momentum, drift = regressors[0], regressors[1]
    samples = q_row, qd_row, qd_row, qd_row
    shape = 1, *drift.shape
    calc_momentum_regressors(tree, samples, momentum.reshape(shape), drift.reshape(shape))
    first = drift.shape[1] - len(signals[0])
    put_signals((qd, zero, signs(qd, width)), signals, -1.0, drift[:, first:])
    put_signals((zero, qd, zero), signals, 1.0, momentum[:, first:])


@inlined
def signs(v: Array, width: Array) -> Array:
    """Return the smoothed signs of velocities (nv,); see `RobotMotion.direction`."""
    smoothed = np.empty(len(v))
    for i in range(len(v)):
        smoothed[i] = np.tanh(v[i] / width[i]) if width[i] != 0.0 else np.sign(v[i])
    return smoothed


def checked_control(control: ControlModel) -> ControlModel:
    """Return a `ControlModel` or an object with its interface; raise otherwise."""
    if not all(hasattr(control, name) for name in ("at", "joints", "prior", "single_joints")):
        raise ArgumentError(f"control must be a ControlModel; it is {control!r}.")
    return control


def _parts(model: RobotModel, role: Role) -> list[tuple[str, slice]]:
    """Return the places of effects with a role, and the slices of their parameters."""
    parts, start = [], model.phi.size
    for fitted in model.effects:
        part = slice(start, start + len(fitted.effect.parameters))
        start = part.stop
        if fitted.effect.role is role:
            parts.append((fitted.effect.where[0], part))
    return parts


def _trial(model: RobotModel, sign_width: Array) -> Trial:
    """Return a function to the robot's motion in random configurations."""

    def to_motion(v: Array, vd: Array, load: Array) -> RobotMotion:
        q = np.random.default_rng(0).normal(size=(len(v), model.tree.num_positions))
        q = model.tree.inside(q)
        return model.motion(Motion(q, v, vd), sign_width=sign_width, load=load)

    return to_motion


@dataclass(frozen=True, eq=False)
class ControlSample:
    """The regressor Y (nv, p) of one sample."""

    model: ControlModel
    _motion: tuple[Array, Array, Array, Array]

    @cached_property
    def rigid(self) -> RigidSample:
        """The rigid bodies."""
        return RigidSample.at(self.model.tree, *self._motion)

    @cached_property
    def regressor(self) -> Array:
        """Y (nv, p), formed once. At one sample this costs no more than a product without Y."""
        model, (q, qd, v, a) = self.model, self._motion
        friction_v = qd if model.measured_friction else v
        if model.plain is not None:
            Y = np.zeros((len(qd), len(model.prior)))
            motion = contiguous(q), contiguous(qd), contiguous(v), contiguous(a)
            calc_plain_regressor(model.plain, motion, contiguous(friction_v), Y)
            return Y
        Y = self.rigid.regressor(len(model.prior))
        joints, to_robot_motion = self._joints(a, friction_v), self._to_robot_motion(None)
        Y[:, model.num_inertial :] = model._columns.at(joints, to_robot_motion)
        return self._scaled(Y)

    def effort(self, parameters: Array) -> Array:
        """Return Y p (nv,), N·m or N, for parameters p (p,)."""
        return self.regressor @ parameters

    def covector(self, r: Array) -> Array:
        """Return Yᵀ r (p,) for r (nv,), the b of [Lee2019] Eq. (5.4.46)."""
        return r @ self.regressor

    def mass_matrix(self, parameters: Array) -> Array:
        """Return M (nv, nv) for parameters (p,), including payloads and rotor inertias.

        User-defined body effects with inertia, load-dependent friction and scales are not included.
        """
        phi = self.model.phi(parameters)
        if self.model._payloads:
            phi = phi.copy()
            for body, part in self.model._payloads:
                phi[body] += parameters[part]
        M = self.rigid.mass_matrix(phi)
        if self.model._turning:
            motion = self._joints(self._motion[3], self._motion[1])
            to_robot_motion = self._to_robot_motion(np.zeros((len(M), phi.size)))
            M += self.model._columns.added_mass(motion, parameters[phi.size :], to_robot_motion)
        return M

    @cached_property
    def momentum_regressors(self) -> Array:
        """(Y_p, Y_c) (2, nv, p) with effort = d/dt (Y_p p) − Y_c p along a motion, from q and q̇.

        Y_p p = M q̇ and Y_c p = Cᵀ q̇ + τ_g − effects at q̇. Filtering both sides of this equation
        gives a filtered regressor of inverse dynamics without accelerations: for the low-pass
        filter λ / (s + λ), it is λ (Y_p − [Y_p]) − [Y_c] with [·] filtered.

        The inertia of effects must be constant, as that of a rotor is. Load-dependent friction uses
        the load at this sample's acceleration.
        """
        model, (q, qd, _, _) = self.model, self._motion
        columns, n = model._columns, model.num_inertial
        if model.plain is not None:
            regressors = np.zeros((2, len(qd), len(model.prior)))
            calc_plain_momentum(model.plain, contiguous(q), contiguous(qd), regressors)
            return regressors
        regressors = self.rigid.momentum_regressors(len(model.prior))
        momentum, drift = regressors[..., :n]
        effect_momentum, effect_drift = regressors[..., n:]
        joints = self._joints(np.zeros(len(qd)), qd)
        effect_drift -= columns.at(joints, self._to_robot_motion(-drift))
        if not columns.depends_on.isdisjoint({"vd", "load", "bodies"}):
            at_qd = replace(joints, vd=qd)
            effect_momentum += columns.at(at_qd, self._to_robot_motion(momentum))
            zero = np.zeros_like(momentum)
            effect_momentum -= columns.at(joints, self._to_robot_motion(zero))
        if not model._scales:
            return regressors
        return np.array([self._scaled(regressor) for regressor in regressors])

    def _scaled(self, regressor: Array) -> Array:
        """Set the columns (nv,) of scales to the model's efforts, and return the regressor."""
        if self.model._scales:
            others = self.model.prior.copy()
            others[[column for _, column in self.model._scales]] = 0.0
            efforts = regressor @ others
            for velocity, column in self.model._scales:
                regressor[:, column] = 0.0
                regressor[velocity, column] = efforts[velocity]
        return regressor

    def _joints(self, a: Array, v: Array) -> JointMotion:
        """Return the motion of all joints, each field (nv,), at accelerations and velocities."""
        model, q = self.model, self._motion[0]
        load = np.zeros(len(v))
        if "load" in model._columns.depends_on:
            load = self.rigid.effort(model._total_phi)
        q_joint = q if model.single_joints else np.where(model._single, q, np.nan)
        return JointMotion(q_joint, v, a, load, model._direction(v))

    def _to_robot_motion(self, regressor: Array | None) -> ToRobotMotion:
        """Return a function to the robot's motion at this sample.

        Args:
            regressor: (nv, 10·nb) inertial regressor of the bodies; None for Y, formed on demand.
        """
        model = self.model

        def to_robot_motion(joints: JointMotion) -> RobotMotion:
            vd, bodies = np.atleast_2d(joints.vd), self._bodies
            q, v, load = (np.broadcast_to(x, vd.shape) for x in (joints.q, joints.v, joints.load))
            if len(vd) > 1:
                bodies = replace(bodies, q=np.repeat(bodies.q, len(vd), axis=0))

            def body_columns(name: str) -> Array:
                first = PARAMETERS_PER_BODY * model.bodies.index(name)
                Y = self.rigid.regressor(model.num_inertial) if regressor is None else regressor
                columns = Y[:, first : first + PARAMETERS_PER_BODY]
                return np.broadcast_to(columns, (len(vd), *columns.shape))

            return RobotMotion(
                model.joints, q, v, vd, load, model._sign_width, body_columns, bodies
            )

        return to_robot_motion

    @cached_property
    def _bodies(self) -> RobotBodies:
        """Poses and Jacobians of the bodies."""
        model = self.model
        return RobotBodies(model.tree, self._motion[0][None], model._total_phi)
