"""Logs of chains of joints on known motions: Drake's inverse dynamics plus hidden efforts.

A hidden effort is any function of the motion, written where it is used.
"""

from functools import partial

import numpy as np
from pydrake.multibody.tree import MultibodyForces

from geodrake.logs import JointLog


def multisine(time, rng, *, joints=2, base=0.1, harmonics=8, reach=1.2):
    """Return a smooth random motion: positions, velocities and accelerations (N, joints)."""
    rate = 2 * np.pi * base * np.arange(1, harmonics + 1)[:, None]
    angle = rate[None] * time[:, None, None] + rng.uniform(0, 2 * np.pi, (harmonics, joints))
    swing = reach * rng.uniform(0.3, 1.0, (harmonics, joints)) / np.sqrt(harmonics)
    q = (swing * np.sin(angle)).sum(1)
    v = (swing * rate * np.cos(angle)).sum(1)
    return q, v, -(swing * rate**2 * np.sin(angle)).sum(1)


def inverse_dynamics(plant, q, v, vd, context=None):
    """Return efforts (N, nv) of a plant's bodies by Drake, with the parameters of a Context."""
    context = plant.CreateDefaultContext() if context is None else context
    forces, rows = MultibodyForces(plant), []
    for state, accelerations in zip(np.hstack([q, v]), vd, strict=True):
        plant.SetPositionsAndVelocities(context, state)
        plant.CalcForceElementsContribution(context, forces)
        rows.append(plant.CalcInverseDynamics(context, accelerations, forces))
    return np.array(rows)


def logged(dynamics, joints, seed, hidden, noise, *, seconds=20.0, rate=200.0, **motion):
    """Return a log of a robot.

    Args:
        dynamics: Function (q, v, vd) -> load (N, nv) of its joints.
        joints: Their names.
        seed: Of motion and noise.
        hidden: None, or a function (q, v, vd, load) -> further efforts (N, nv).
        noise: Function of the load that returns the deviation (nv,) of the efforts' white noise.
        seconds: Length.
        rate: Sampling rate, Hz.
        motion: Further arguments of `multisine`.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(round(seconds * rate)) / rate
    q, v, vd = multisine(time, rng, joints=len(joints), **motion)
    effort = load = dynamics(q, v, vd)
    if hidden is not None:
        effort = load + hidden(q, v, vd, load)
    effort = effort + noise(load) * rng.normal(size=effort.shape)
    return JointLog(f"log_{seed}", joints, time, q + 1e-6 * rng.normal(size=q.shape), effort)


def chain_log(model, seed, hidden=None, *, share=0.02, **options):
    """Return a log of a model, whose noise is a share of the deviation of its load."""
    dynamics = partial(inverse_dynamics, model.plant)
    return logged(dynamics, model.joints, seed, hidden, lambda u: share * u.std(0), **options)
