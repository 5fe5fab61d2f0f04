"""Arms driven by servos, simulated without formulas of geodrake.

Pinocchio computes the dynamics; friction, armature and servos are added here. MuJoCo has position
actuators, armature, damping and friction of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin

from diagrams.benchmarks.simulated.engines import Array

STEP = 0.001  # s
_CRBA_HAS_ARMATURE = int(pin.__version__.split(".")[0]) >= 3
_FADING = 0.002  # rad/s, speed scale of dry friction
_FINER = 4  # substeps for links with backlash
_SIDES_OF_GAPS = [0.99, 0.999, 1e-5, 0.5, 2.0]  # MuJoCo's solimp


@dataclass(frozen=True)
class Servos:
    """Servos, friction and backlash of the joints of an arm, (n,) each."""

    stiffness: Array  # kp, N·m/rad
    damping: Array  # kd, N·m·s/rad
    # Whether damping acts on the difference between the rate of the command and the velocity.
    knows_rate: bool
    delay: float  # of commands, s, a whole number of steps
    viscous: Array  # N·m·s/rad
    coulomb: Array  # N·m
    armature: Array  # kg·m²
    limit: Array  # largest torque, N·m
    # ki, N·m/(rad·s), with anti-windup at the limit of torque.
    integral: Array
    play: Array  # half width of the gap between motor and link, rad


def simulated(engine: str, urdf: str, servos: Servos, command: Array) -> tuple[Array, Array, Array]:
    """Return positions, velocities and torques (N, n) of an arm that follows commands (N, n).

    Commands are at intervals of `STEP`; the arm starts at rest at the first one.
    """
    delay_steps = round(servos.delay / STEP)
    delayed = np.concatenate([np.repeat(command[:1], delay_steps, axis=0), command])[: len(command)]
    rate = np.gradient(delayed, STEP, axis=0) if servos.knows_rate else np.zeros_like(delayed)
    run = _by_pinocchio if engine == "pinocchio" else _by_mujoco
    return run(urdf, servos, delayed, rate)


def _by_pinocchio(
    urdf: str, servos: Servos, goal: Array, rate: Array
) -> tuple[Array, Array, Array]:
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    model.armature = servos.armature
    q, v, integral = goal[0].copy(), np.zeros(model.nv), np.zeros(model.nv)
    positions, velocities, torques = (np.empty_like(goal) for _ in range(3))
    for k in range(len(goal)):
        raw = servos.stiffness * (goal[k] - q) + servos.damping * (rate[k] - v)
        raw = raw + servos.integral * integral
        integral = _integrated(integral, goal[k] - q, raw, servos.limit)
        torque = np.clip(raw, -servos.limit, servos.limit)
        positions[k], velocities[k], torques[k] = q, v, torque
        # Implicit friction keeps sticking joints from chattering.
        pin.computeAllTerms(model, data, q, v)
        M = pin.crba(model, data, q)
        M = np.triu(M) + np.triu(M, 1).T
        if not _CRBA_HAS_ARMATURE:
            M[np.diag_indices(model.nv)] += servos.armature
        free = torque - data.nle
        v = _with_friction(M, v, free, servos)
        q = q + STEP * v
    return positions, velocities, torques


def _integrated(integral: Array, error: Array, raw: Array, limit: Array) -> Array:
    """Return the integrals after a step; at their limit, joints do not integrate beyond it."""
    beyond = (np.abs(raw) > limit) & (np.sign(raw) == np.sign(error))
    return np.where(beyond, integral, integral + STEP * error)


def _with_friction(M: Array, v: Array, free: Array, servos: Servos) -> Array:
    """Return velocities after a step; Newton's method solves friction F tanh(v/ε) + c v."""
    after = v + STEP * np.linalg.solve(M, free - servos.viscous * v)
    for _ in range(6):
        sign = np.tanh(after / _FADING)
        slope = servos.viscous + servos.coulomb * (1.0 - sign**2) / _FADING
        residual = M @ (after - v) - STEP * (free - servos.viscous * after - servos.coulomb * sign)
        step = np.linalg.solve(M + STEP * np.diag(slope), -residual)
        after = after + np.clip(step, -0.05, 0.05) if np.abs(step).max() > 0.5 else after + step
        if np.abs(step).max() < 1e-10:
            break
    return after


def servo_spec(urdf: str, step: float) -> mujoco.MjSpec:
    """Return an arm with a position actuator at each joint, without shapes and joint limits."""
    spec = mujoco.MjSpec.from_string(urdf)
    for geom in list(spec.geoms):
        spec.delete(geom)
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    for joint in spec.joints:
        joint.limited = 0
        servo = spec.add_actuator(name=joint.name, target=joint.name)
        servo.trntype = mujoco.mjtTrn.mjTRN_JOINT
        servo.gaintype, servo.biastype = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE)
    return spec


def set_damping(joint: mujoco.MjsJoint, damping: float) -> None:
    """Set the damping of a joint, in MuJoCo a number or the first of several coefficients."""
    if np.ndim(joint.damping):
        joint.damping = np.array([damping, *np.zeros(np.size(joint.damping) - 1)])
    else:
        joint.damping = damping


def _by_mujoco(urdf: str, servos: Servos, goal: Array, rate: Array) -> tuple[Array, Array, Array]:
    # The stops of gaps are stiff.
    steps = _FINER if servos.play.any() else 1
    spec = servo_spec(urdf, STEP / steps)
    motors = list(spec.joints)
    for i, joint in enumerate(motors):
        if servos.play[i]:
            _add_play(joint, float(servos.play[i]))
        set_damping(joint, servos.viscous[i])
        joint.armature, joint.frictionloss = servos.armature[i], servos.coulomb[i]
        kp, kd = float(servos.stiffness[i]), float(servos.damping[i])
        actuator = spec.actuator(joint.name)
        # u = kp c + kd dc/dt, so that the force is u − kp q − kd v.
        actuator.gainprm[0], actuator.biasprm[1], actuator.biasprm[2] = 1.0, -kp, -kd
        actuator.forcelimited = 1
        actuator.forcerange = [-servos.limit[i], servos.limit[i]]
    model = spec.compile()
    data = mujoco.MjData(model)
    at_q, at_v = (
        np.array([getattr(model.joint(joint.name), name)[0] for joint in motors])
        for name in ("qposadr", "dofadr")
    )
    data.qpos[at_q] = goal[0]
    positions, velocities, torques = (np.empty_like(goal) for _ in range(3))
    integral = np.zeros(len(motors))
    for k in range(len(goal)):
        data.ctrl[:] = servos.stiffness * goal[k] + servos.damping * rate[k]
        data.ctrl[:] += servos.integral * integral
        raw = data.ctrl - servos.stiffness * data.qpos[at_q] - servos.damping * data.qvel[at_v]
        integral = _integrated(integral, goal[k] - data.qpos[at_q], raw, servos.limit)
        positions[k], velocities[k] = data.qpos[at_q], data.qvel[at_v]
        mujoco.mj_step(model, data, steps)
        torques[k] = data.actuator_force
    return positions, velocities, torques


def _add_play(joint: mujoco.MjsJoint, half_width: float) -> None:
    """Add a joint after the motor's, about the same axis, that moves within a gap."""
    play = joint.parent.add_joint(name=f"{joint.name}_play", axis=joint.axis, pos=joint.pos)
    play.type = joint.type
    play.limited, play.range = 1, [-half_width, half_width]
    play.solref_limit, play.solimp_limit = [2.0 * STEP / _FINER, 1.0], _SIDES_OF_GAPS
