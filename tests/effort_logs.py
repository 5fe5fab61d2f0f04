"""Logs of robots on known motions: Pinocchio's inverse dynamics, and hidden efforts on top.

The hidden effort is any function of the motion, written out where it is used.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from pinocchio_logs import MODELS, Recording, perturbed, random_motion, robot

from geodrake.logs.motion import JointLog

__all__ = ["MODELS", "Seen", "effort_log"]


@dataclass(frozen=True)
class Seen:
    """What a hidden effort may be a function of: (N, n) each, and Pinocchio's model and data."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray
    model: pin.Model
    data: pin.Data


def effort_log(
    name, seed, hidden=None, *, off=0.0, duration=24.0, share=0.03, rate=250.0, **motion
):
    """A log of a robot's inverse dynamics and a hidden effort, with white noise.

    Args:
        name: Name of the robot.
        seed: Of motion, bodies and noise.
        hidden: Function of `Seen` that gives efforts (N, n), or a dict of joint -> (N,).
        off: Share by which the bodies differ from the model file.
        duration: Length, s.
        share: Deviation of the effort's noise, as a share of that of the effort.
        rate: Samples a second.
        motion: Arguments of `random_motion`.

    Returns:
        A Recording.
    """
    rng, file = np.random.default_rng(seed), robot(name)
    plant = perturbed(file, rng, off)
    data, time = plant.createData(), np.arange(0.0, duration, 1.0 / rate)
    q, v, a = random_motion(file, rng, **motion)(time)
    load = np.array([pin.rnea(plant, data, *sample) for sample in zip(q, v, a, strict=True)])
    effort = load.copy()
    if hidden is not None:
        more = hidden(Seen(time, q, v, a, load, plant, data))
        if isinstance(more, dict):
            for joint, values in more.items():
                effort[:, joint] += values
        else:
            effort += more
    deviation = share * effort.std(0)
    log = JointLog(
        f"{name} {seed}",
        tuple(file.names[1:]),
        time,
        q + 1e-5 * rng.normal(size=q.shape),
        effort + deviation * rng.normal(size=effort.shape),
        v + 2e-4 * rng.normal(size=q.shape),
    )
    return Recording(log, deviation)
