"""Logs of chains of joints on known motions: Drake's inverse dynamics, and hidden efforts on top.

The hidden effort is any function of the motion, written out where it is used.
"""

import numpy as np
from pydrake.multibody.tree import MultibodyForces

from geodrake.logs.motion import JointLog


def multisine(time, rng, *, joints=2, base=0.1, harmonics=8, reach=1.2):
    """Smooth random motion: positions, velocities and accelerations (N, joints) at times (N,)."""
    rate = 2 * np.pi * base * np.arange(1, harmonics + 1)[:, None]
    angle = rate[None] * time[:, None, None] + rng.uniform(0, 2 * np.pi, (harmonics, joints))
    swing = reach * rng.uniform(0.3, 1.0, (harmonics, joints)) / np.sqrt(harmonics)
    q = (swing * np.sin(angle)).sum(1)
    v = (swing * rate * np.cos(angle)).sum(1)
    return q, v, -(swing * rate**2 * np.sin(angle)).sum(1)


def inverse_dynamics(plant, q, v, vd, context=None):
    """Efforts (N, nv) of a plant's bodies, by Drake; with the parameters of a Context."""
    context = plant.CreateDefaultContext() if context is None else context
    rows = []
    for positions, velocities, accelerations in zip(q, v, vd, strict=True):
        plant.SetPositions(context, positions)
        plant.SetVelocities(context, velocities)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        rows.append(plant.CalcInverseDynamics(context, accelerations, forces))
    return np.array(rows)


def chain_log(model, seed, hidden=None, *, seconds=20.0, rate=200.0, share=0.02, **motion):
    """A log of the robot of a model, such as those of `excitation_robots.arm`.

    Args:
        model: The model; its plant is the robot.
        seed: Of motion and noise.
        hidden: Function (q, v, vd, load) -> efforts (N, nv) that the plant lacks.
        seconds: Length.
        rate: Sampling rate, Hz.
        share: Deviation of the effort's noise, as a share of that of the effort.
        motion: Further arguments of `multisine`.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    q, v, vd = multisine(time, rng, joints=len(model.joints), **motion)
    effort = load = inverse_dynamics(model.plant, q, v, vd)
    if hidden is not None:
        effort = load + hidden(q, v, vd, load)
    effort = effort + share * load.std(0) * rng.normal(size=effort.shape)
    position = q + 1e-6 * rng.normal(size=q.shape)
    return JointLog(f"log_{seed}", model.joints, time, position, effort)
