"""Logs of robots that Pinocchio simulates, with hidden effects in formulas of their own.

Nothing here comes from geodrake but the container of the log: dry friction is v / √(v² + ε²), not
tanh; springs are given by their rest position, payloads as welded bodies, rotors by gear ratio;
bodies are perturbed, so that the model file's inertias are off.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dgesv

from geodrake.logs.motion import JointLog

MODELS = Path(__file__).parents[1] / "models"
STEP = 5e-4
BANDWIDTH = 120.0  # of the drives, rad/s
BREAKAWAY_SPEED = 5e-3


@dataclass(frozen=True)
class HiddenEffects:
    """What the simulated robot has and the model file lacks; joints by index, SI units.

    Attributes:
        coulomb, viscous: Joint -> F, c.
        asymmetric: Joint -> (F forwards, F backwards).
        offset: Joint -> constant effort.
        spring: Joint -> (stiffness, rest position).
        load_factor: Joint -> share of the gear's load that friction takes.
        rotor: Joint -> (gear ratio, inertia of the rotor).
        belt: (i, j) -> (F, c) of a motor that turns with v_i + v_j.
        payload: (mass, centre, gyration radius) of a ball held by the last link.
        law: Further torques (n,) as a function of q and v, for effects that no catalogue has.
        late: By how much logged efforts lag behind, s.
    """

    coulomb: Mapping[int, float] = field(default_factory=dict)
    viscous: Mapping[int, float] = field(default_factory=dict)
    asymmetric: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    offset: Mapping[int, float] = field(default_factory=dict)
    spring: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    load_factor: Mapping[int, float] = field(default_factory=dict)
    rotor: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    belt: Mapping[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    payload: tuple[float, tuple[float, float, float], float] | None = None
    law: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    late: float | tuple[float, ...] = 0.0


@dataclass(frozen=True)
class Multisine:
    """A smooth random motion that does not repeat, q = centre + Σ_k a_k sin(ω_k t + φ_k)."""

    center: np.ndarray
    amplitude: np.ndarray
    phase: np.ndarray
    rate: np.ndarray

    def __call__(self, t):
        """Position, velocity and acceleration, (…, n) each, at times t (…)."""
        angle = self.rate * np.asarray(t)[..., None, None] + self.phase
        swing = self.amplitude * np.sin(angle)
        q = self.center + swing.sum(-2)
        v = (self.amplitude * self.rate * np.cos(angle)).sum(-2)
        return q, v, -(self.rate**2 * swing).sum(-2)


def robot(name):
    """Pinocchio's model of one of the repository's robots."""
    return pin.buildModelFromUrdf(str(MODELS / f"{name}.urdf"))


def random_motion(model, rng, *, base=0.1, harmonics=6, reach=0.6, pace=0.6):
    """A motion within shares `reach` of the position and `pace` of the speed limits."""
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
    """A model whose masses, mass centres and inertias are off by a share `off`, still physical."""
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


def with_hidden_bodies(model, hidden):
    """The robot that is simulated: payload and rotors included."""
    model = pin.Model(model)
    if hidden.payload is not None:
        mass, center, radius = hidden.payload
        last = model.inertias[model.njoints - 1]
        ball = pin.Inertia(mass, np.array(center), mass * radius**2 * np.eye(3))
        model.inertias[model.njoints - 1] = last + ball
    for joint, (ratio, inertia) in hidden.rotor.items():
        model.armature[joint] += ratio**2 * inertia
    return model


@dataclass
class JointResistance:
    """What resists one joint: F, c, an effort, k and its rest position, a load factor."""

    dry: float = 0.0
    wet: float = 0.0
    constant: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    factor: float = 0.0

    def torque(self, q, v, load):
        """Torque and its slope in v; plain numbers, which take less time than arrays of one."""
        height = self.dry + self.factor * abs(load)
        root = math.sqrt(v * v + BREAKAWAY_SPEED**2)
        friction = height * v / root + self.wet * v
        slope = height * BREAKAWAY_SPEED**2 / root**3 + self.wet
        return friction + self.constant + self.stiffness * (q - self.rest), slope


def resistances(hidden):
    """Joint -> its JointResistance, of joints that have one."""
    found = defaultdict(JointResistance)
    for joint, value in hidden.coulomb.items():
        found[joint].dry = value
    for joint, value in hidden.viscous.items():
        found[joint].wet = value
    for joint, (forwards, backwards) in hidden.asymmetric.items():
        # Friction of the mean height, and a constant effort on top: the same two levels.
        found[joint].dry, found[joint].constant = (
            (forwards + backwards) / 2,
            (forwards - backwards) / 2,
        )
    for joint, value in hidden.offset.items():
        found[joint].constant = value
    for joint, (k, zero) in hidden.spring.items():
        found[joint].stiffness, found[joint].rest = k, zero
    for joint, value in hidden.load_factor.items():
        found[joint].factor = value
    return dict(found)


def resistance(hidden, n) -> Callable:
    """The hidden joint torques as a function (q, v, transmitted load), and their slope in v."""
    joints = resistances(hidden)
    belts = [(np.eye(n)[i] + np.eye(n)[j], F, c) for (i, j), (F, c) in hidden.belt.items()]
    steps = 1e-5 * np.eye(n)

    def torque(q, v, load):
        f, slope = np.zeros(n), np.zeros((n, n))
        for j, own in joints.items():
            f[j], slope[j, j] = own.torque(float(q[j]), float(v[j]), float(load[j]))
        if hidden.law is not None:
            own = hidden.law(q, v)
            slope += np.stack([(hidden.law(q, v + h) - own) / 1e-5 for h in steps], 1)
            f += own
        for row, F, c in belts:
            w = row @ v
            root_w = np.hypot(w, BREAKAWAY_SPEED)
            f += row * (F * w / root_w + c * w)
            slope += np.outer(row, row) * (F * BREAKAWAY_SPEED**2 / root_w**3 + c)
        return f, slope

    return torque


def simulate(model, controller_model, motion, hidden, duration):
    """Positions, velocities and applied efforts, a row a step, of a robot that tracks a motion.

    The drives add stiff PD control to the controller model's inverse dynamics. Steps are linearly
    implicit in friction and PD, and take the rest at their middle: stable however stiff they are.
    """
    plant, n = with_hidden_bodies(model, hidden), model.nv
    data, inverse = plant.createData(), controller_model.createData()
    torque = resistance(hidden, n)
    steps = round(duration / STEP)
    q_ref, v_ref, a_ref = motion(STEP * np.arange(steps + 1))
    inertia = 0.1 + np.diag(pin.crba(controller_model, inverse, motion.center))
    damping = 2 * 0.7 * BANDWIDTH * inertia
    stiffness = BANDWIDTH**2 * inertia
    implicit, ahead = STEP * np.diag(damping + STEP * stiffness), 0.5 * STEP
    q, v, a, load = q_ref[0].copy(), v_ref[0].copy(), a_ref[0].copy(), np.zeros(n)
    rows = np.empty((3, steps, n))
    for k in range(steps):
        u = pin.rnea(controller_model, inverse, q_ref[k], v_ref[k], a_ref[k])
        u += stiffness * (q_ref[k + 1] - q - STEP * v) + damping * (v_ref[k + 1] - v)
        middle = q + ahead * v
        f, slope = torque(middle, v, load)
        slope *= STEP
        u -= f
        mass, bias = pin.crba(plant, data, middle), pin.nle(plant, data, middle, v + ahead * a)
        a = dgesv(mass + slope + implicit, u - bias)[2]
        u -= implicit @ a
        load = u - slope @ a
        rows[:, k] = q, v, u + f
        q, v = q + STEP * (v + ahead * a), v + STEP * a
    return rows


@dataclass(frozen=True)
class Recording:
    """A log, and the deviation (n,) of the white noise that was added to its efforts."""

    log: JointLog
    noise: np.ndarray


def record(name, rows, rng, *, joints, share=0.04, late=0.0, every=8, encoder=1e-5, least=0.0):
    """What sensors make of a simulation: white noise on efforts, encoder ticks, late efforts.

    Args:
        name: Name of the log.
        rows: Positions, velocities and efforts of `simulate`, a row a step.
        rng: Random generator.
        joints: Names of the joints.
        share: Deviation of the effort's noise, as a share of that of the effort.
        late: By how much logged efforts lag behind, all or each of them, s.
        every: Steps from one sample to the next.
        encoder: Deviation of the position's noise, rad.
    """
    q, v, u = rows
    time = STEP * np.arange(len(q))
    # An effort is held over a step: at the instant between two steps it is their mean.
    at = np.arange(1, len(q), every)
    u = 0.5 * (u[at] + u[at - 1])
    lags = np.broadcast_to(late, u.shape[1])
    both = zip(lags, u.T, strict=True)
    u = np.stack([np.interp(time[at] - lag, time[at], column) for lag, column in both], 1)
    noise = np.hypot(share * u.std(0), least)
    return Recording(
        JointLog(
            name,
            tuple(joints),
            time[at],
            q[at] + encoder * rng.normal(size=u.shape),
            u + noise * rng.normal(size=u.shape),
            v[at] + 20 * encoder * rng.normal(size=u.shape),
        ),
        noise,
    )


def without_effects(name, seed, *, colour=0.0, off=0.0, duration=16.0, share=0.03):
    """A log of a robot that has no hidden effect: inverse dynamics of a random motion, and noise.

    Args:
        name: Name of the robot.
        seed: Of motion, robot and noise.
        colour: Correlation of the effort's noise from one sample to the next (at 250 Hz).
        off: Share by which the bodies differ from the model file.
        duration: Length, s.
        share: Deviation of the effort's noise, as a share of that of the effort.
    """
    rng, model = np.random.default_rng(seed), robot(name)
    plant = perturbed(model, rng, off)
    data, time = plant.createData(), np.arange(0.0, duration, 8 * STEP)
    q, v, a = random_motion(model, rng)(time)
    effort = np.array([pin.rnea(plant, data, *sample) for sample in zip(q, v, a, strict=True)])
    noise = np.sqrt(1 - colour**2) * rng.normal(size=effort.shape)
    for k in range(1, len(noise)):
        noise[k] += colour * noise[k - 1]
    deviation = share * effort.std(0)
    log = JointLog(
        f"{name} {seed}",
        tuple(model.names[1:]),
        time,
        q + 1e-5 * rng.normal(size=q.shape),
        effort + deviation * noise,
        v + 2e-4 * rng.normal(size=q.shape),
    )
    return Recording(log, deviation)
