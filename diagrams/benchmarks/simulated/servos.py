"""Arms moved by servos, in formulas other than geodrake's.

Pinocchio gives accelerations, and friction, armature and servos are added here by hand; MuJoCo has
position actuators, armature, damping and friction of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin

from diagrams.benchmarks.simulated.engines import Array

STEP = 0.001  # s
_CRBA_HAS_ARMATURE = int(pin.__version__.split(".")[0]) >= 3
_FADING = 0.002  # rad/s below which dry friction fades
_FINER = 4  # steps in the place of one, where links have play
_SIDES_OF_GAPS = [0.99, 0.999, 1e-5, 0.5, 2.0]  # MuJoCo's solimp


@dataclass(frozen=True)
class Servos:
    """What moves the joints of an arm, and what hinders them; (n,) each."""

    stiffness: Array  # kp, N·m/rad
    damping: Array  # kd, N·m·s/rad
    # Whether the damping acts on the rate of the command less the velocity, and not on the velocity
    # alone.
    knows_rate: bool
    delay: float  # how late commands act, s, a whole number of steps
    viscous: Array  # N·m·s/rad
    coulomb: Array  # N·m
    armature: Array  # kg·m²
    limit: Array  # largest torque, N·m
    # ki, N·m/(rad·s); it stays where the torque is at its limit and would go beyond.
    integral: Array
    play: Array  # half width of the gap between motor and link, rad


def simulated(engine: str, urdf: str, servos: Servos, command: Array) -> tuple[Array, Array, Array]:
    """Return positions, velocities and torques (N, n) of an arm that is told where to go.

    Args:
        command: (N, n) positions it is told to go to, `STEP` apart; it begins there, at rest.
    """
    late = round(servos.delay / STEP)
    told = np.concatenate([np.repeat(command[:1], late, axis=0), command])[: len(command)]
    rate = np.gradient(told, STEP, axis=0) if servos.knows_rate else np.zeros_like(told)
    run = _by_pinocchio if engine == "pinocchio" else _by_mujoco
    return run(urdf, servos, told, rate)


def _by_pinocchio(
    urdf: str, servos: Servos, told: Array, rate: Array
) -> tuple[Array, Array, Array]:
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    model.armature = servos.armature
    q, v, summed = told[0].copy(), np.zeros(model.nv), np.zeros(model.nv)
    positions, velocities, torques = (np.empty_like(told) for _ in range(3))
    for k in range(len(told)):
        raw = servos.stiffness * (told[k] - q) + servos.damping * (rate[k] - v)
        raw = raw + servos.integral * summed
        summed = _summed(summed, told[k] - q, raw, servos.limit)
        torque = np.clip(raw, -servos.limit, servos.limit)
        positions[k], velocities[k], torques[k] = q, v, torque
        # Friction at the end of the step, so that joints that stick do not shake.
        pin.computeAllTerms(model, data, q, v)
        M = pin.crba(model, data, q)
        M = np.triu(M) + np.triu(M, 1).T
        if not _CRBA_HAS_ARMATURE:
            M[np.diag_indices(model.nv)] += servos.armature
        free = torque - data.nle
        v = _with_friction(M, v, free, servos)
        q = q + STEP * v
    return positions, velocities, torques


def _summed(summed: Array, error: Array, raw: Array, limit: Array) -> Array:
    """Return integrals after a step; those of joints at their limit do not go on beyond it."""
    beyond = (np.abs(raw) > limit) & (np.sign(raw) == np.sign(error))
    return np.where(beyond, summed, summed + STEP * error)


def _with_friction(M: Array, v: Array, free: Array, servos: Servos) -> Array:
    """Return velocities after a step, friction F tanh(v/ε) + c v implicit, by Newton's method."""
    after = v + STEP * np.linalg.solve(M, free - servos.viscous * v)
    for _ in range(6):
        sign = np.tanh(after / _FADING)
        slope = servos.viscous + servos.coulomb * (1.0 - sign**2) / _FADING
        left = M @ (after - v) - STEP * (free - servos.viscous * after - servos.coulomb * sign)
        step = np.linalg.solve(M + STEP * np.diag(slope), -left)
        after = after + np.clip(step, -0.05, 0.05) if np.abs(step).max() > 0.5 else after + step
        if np.abs(step).max() < 1e-10:
            break
    return after


def servo_spec(urdf: str, step: float) -> mujoco.MjSpec:
    """Return an arm with a position actuator at each joint, without shapes and limits of joints."""
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
    """Set the damping of a joint, which is a number of MuJoCo's, or the first of several."""
    if np.ndim(joint.damping):
        joint.damping = np.array([damping, *np.zeros(np.size(joint.damping) - 1)])
    else:
        joint.damping = damping


def _by_mujoco(urdf: str, servos: Servos, told: Array, rate: Array) -> tuple[Array, Array, Array]:
    # The sides of gaps are stiff.
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
    data.qpos[at_q] = told[0]
    positions, velocities, torques = (np.empty_like(told) for _ in range(3))
    summed = np.zeros(len(motors))
    for k in range(len(told)):
        data.ctrl[:] = servos.stiffness * told[k] + servos.damping * rate[k]
        data.ctrl[:] += servos.integral * summed
        raw = data.ctrl - servos.stiffness * data.qpos[at_q] - servos.damping * data.qvel[at_v]
        summed = _summed(summed, told[k] - data.qpos[at_q], raw, servos.limit)
        positions[k], velocities[k] = data.qpos[at_q], data.qvel[at_v]
        mujoco.mj_step(model, data, steps)
        torques[k] = data.actuator_force
    return positions, velocities, torques


def _add_play(joint: mujoco.MjsJoint, half_width: float) -> None:
    """Add a joint after that of the motor, about the same axis, which turns within a gap."""
    play = joint.parent.add_joint(name=f"{joint.name}_play", axis=joint.axis, pos=joint.pos)
    play.type = joint.type
    play.limited, play.range = 1, [-half_width, half_width]
    play.solref_limit, play.solimp_limit = [2.0 * STEP / _FINER, 1.0], _SIDES_OF_GAPS
