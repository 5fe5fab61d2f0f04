"""Arms moved by servos, in formulas other than geodrake's.

Pinocchio gives accelerations, and friction, armature and servos are added here by hand; MuJoCo has
position actuators, armature, damping and friction of its own. Nothing here comes from geodrake.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP = 0.001  # s
_FADING = 0.002  # rad/s below which dry friction fades


@dataclass(frozen=True)
class Servos:
    """What moves the joints of an arm, and what hinders them; (n,) each.

    Attributes:
        stiffness: kp, N·m/rad.
        damping: kd, N·m·s/rad.
        knows_rate: Whether the damping acts on the rate of the command less the velocity, and not
            on the velocity alone.
        delay: How late commands act, s, a whole number of steps.
        viscous: N·m·s/rad.
        coulomb: N·m.
        armature: kg·m².
        limit: Largest torque, N·m.
        integral: ki, N·m/(rad·s); it stays where the torque is at its limit and would go beyond.
    """

    stiffness: Array
    damping: Array
    knows_rate: bool
    delay: float
    viscous: Array
    coulomb: Array
    armature: Array
    limit: Array
    integral: Array


def simulated(engine: str, urdf: str, servos: Servos, command: Array) -> tuple[Array, Array, Array]:
    """Positions, velocities and torques (N, n) of an arm that is told where to go.

    Args:
        engine: "pinocchio" or "mujoco".
        urdf: The arm.
        servos: What moves it.
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
        M[np.diag_indices(model.nv)] += 0.0 if _has_armature() else servos.armature
        free = torque - data.nle
        v = _with_friction(M, v, free, servos)
        q = q + STEP * v
    return positions, velocities, torques


def _summed(summed: Array, error: Array, raw: Array, limit: Array) -> Array:
    """Integrals after a step; those of joints at their limit do not go on beyond it."""
    beyond = (np.abs(raw) > limit) & (np.sign(raw) == np.sign(error))
    return np.where(beyond, summed, summed + STEP * error)


def _has_armature() -> bool:
    """Whether `crba` adds the armature, as Pinocchio 3 does."""
    return int(pin.__version__.split(".")[0]) >= 3


def _with_friction(M: Array, v: Array, free: Array, servos: Servos) -> Array:
    """Velocities after a step, friction F tanh(v/ε) + c v implicit, by Newton's method."""
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


def _by_mujoco(urdf: str, servos: Servos, told: Array, rate: Array) -> tuple[Array, Array, Array]:
    spec = mujoco.MjSpec.from_string(urdf)
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for i, joint in enumerate(spec.joints):
        joint.limited = 0
        joint.damping = _first(joint.damping, servos.viscous[i])
        joint.armature, joint.frictionloss = servos.armature[i], servos.coulomb[i]
        kp, kd = float(servos.stiffness[i]), float(servos.damping[i])
        actuator = spec.add_actuator(name=f"servo{i}", target=joint.name)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.gaintype, actuator.biastype = (
            mujoco.mjtGain.mjGAIN_FIXED,
            mujoco.mjtBias.mjBIAS_AFFINE,
        )
        # u = kp c + kd dc/dt, so that the force is u − kp q − kd v.
        actuator.gainprm[0], actuator.biasprm[1], actuator.biasprm[2] = 1.0, -kp, -kd
        actuator.forcelimited = 1
        actuator.forcerange = [-servos.limit[i], servos.limit[i]]
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = told[0]
    positions, velocities, torques = (np.empty_like(told) for _ in range(3))
    summed = np.zeros(model.nv)
    for k in range(len(told)):
        data.ctrl[:] = servos.stiffness * told[k] + servos.damping * rate[k]
        data.ctrl[:] += servos.integral * summed
        raw = data.ctrl - servos.stiffness * data.qpos - servos.damping * data.qvel
        summed = _summed(summed, told[k] - data.qpos, raw, servos.limit)
        positions[k], velocities[k] = data.qpos, data.qvel
        mujoco.mj_step(model, data)
        torques[k] = data.actuator_force
    return positions, velocities, torques


def _first(values: object, number: float) -> object:
    """A number in the form that a field of MuJoCo has: alone, or the first of several."""
    if np.ndim(values) == 0:
        return number
    filled = np.zeros(np.shape(values))
    filled[0] = number
    return filled
