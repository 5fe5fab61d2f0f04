"""Logs of robots by Pinocchio, with hidden efforts in formulas where they are used.

Only the container of the log comes from geodrake. Bodies are perturbed, so that the model file's
inertias are off.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.signal import lfilter

from geodrake.logs import JointLog

MODELS = Path(__file__).parents[1] / "models"


@dataclass(frozen=True)
class Multisine:
    """A smooth random motion that does not repeat, q = centre + Σ_k a_k sin(ω_k t + φ_k)."""

    center: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    rate: np.ndarray

    def __call__(self, t):
        """Return position, velocity and acceleration, (…, n) each, at times t (…)."""
        angle = self.rate * np.asarray(t)[..., None, None] + self.phase
        swing = self.amplitude * np.sin(angle)
        q = self.center + swing.sum(-2)
        v = (self.amplitude * self.rate * np.cos(angle)).sum(-2)
        return q, v, -(self.rate**2 * swing).sum(-2)


def robot(name):
    """Return Pinocchio's model of one of the repository's robots."""
    return pin.buildModelFromUrdf(str(MODELS / f"{name}.urdf"))


def random_motion(model, rng, *, base=0.1, harmonics=6, reach=0.6, pace=0.6):
    """Return a motion within shares `reach` of the position and `pace` of the speed limits."""
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    half = np.minimum((high - low) / 2, np.pi / 2)
    center = np.clip(0.0, low + half, high - half)
    shape = (harmonics, model.nv)
    rate = 2 * np.pi * base * (np.arange(1, 1 + harmonics)[:, None] + rng.uniform(-0.4, 0.4, shape))
    amplitude, phase = rng.uniform(0.3, 1.0, shape), rng.uniform(0, 2 * np.pi, shape)
    q, v, _ = Multisine(center, amplitude, phase, rate)(np.arange(0, 4 / base, 0.01))
    limit = np.minimum(model.velocityLimit, 4.0)
    scale = 1 / np.maximum(
        np.abs(q - center).max(0) / (reach * half), np.abs(v).max(0) / (pace * limit)
    )
    return Multisine(center, amplitude * scale, phase, rate)


def perturbed(model, rng, off):
    """Return a physical model whose masses, mass centres and inertias are off by a share `off`."""
    model = pin.Model(model)
    for i in range(1, model.njoints):
        body = model.inertias[i]
        moments, axes = np.linalg.eigh(0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia)
        mass = body.mass * np.exp(off * rng.normal())
        moments = moments * np.exp(off * rng.normal(size=3)) * mass / body.mass
        lever = body.lever * (1 + off * rng.normal(size=3))
        second = axes @ np.diag(moments) @ axes.T
        model.inertias[i] = pin.Inertia(mass, lever, np.trace(second) * np.eye(3) - second)
    return model


@dataclass(frozen=True)
class Seen:
    """Arguments of a hidden effort, (N, n) each, and Pinocchio's model and data."""

    time: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    load: np.ndarray
    model: pin.Model
    data: pin.Data

    def more(self, model):
        """Return the effort (N, n) that another model needs beyond that of this robot."""
        data, samples = model.createData(), zip(self.q, self.v, self.a, strict=True)
        return np.array([pin.rnea(model, data, *sample) for sample in samples]) - self.load

    def with_body(self, joint, change):
        """Return the further effort (N, n) of the robot with another body at a joint."""
        other = pin.Model(self.model)
        other.inertias[joint] = change(other.inertias[joint])
        return self.more(other)


@dataclass(frozen=True)
class Recording:
    """A log, and the deviation (n,) of the white noise that was added to its efforts."""

    log: JointLog
    noise: np.ndarray


def effort_log(
    name, seed, hidden=None, *, off=0.0, duration=24.0, share=0.03, rate=250.0, colour=0.0, **motion
):
    """Return a log of a robot's inverse dynamics and a hidden effort, with noise.

    Args:
        name: Name of the robot.
        seed: Of motion, bodies and noise.
        hidden: Function of `Seen` that returns efforts (N, n), or a dict of joint -> (N,).
        off: Share by which the bodies differ from the model file.
        duration: Length, s.
        share: Deviation of the effort's noise, as a share of that of the effort.
        rate: Samples a second.
        colour: Correlation of the effort's noise from one sample to the next.
        motion: Arguments of `random_motion`.
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
    q = q + 1e-5 * rng.normal(size=q.shape)
    noise = rng.normal(size=effort.shape)
    if colour:
        noise = lfilter([np.sqrt(1.0 - colour**2)], [1.0, -colour], noise, axis=0)
    log = JointLog(
        f"{name} {seed}",
        tuple(file.names[1:]),
        time,
        q,
        effort + deviation * noise,
        v + 2e-4 * rng.normal(size=q.shape),
    )
    return Recording(log, deviation)
