"""What logs can hide: effects of geodrake's catalogue in formulas of their own, and others.

A truth says where it acts, and gives its effort for a size of one; benchmarks scale that to a share
of the joint's effort. Laws draw their random numbers anew, the same ones, at every call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import mujoco
import numpy as np
from scipy.ndimage import uniform_filter1d

from diagrams.benchmarks.simulated.engines import (
    GRAVITY,
    Array,
    Engine,
    Generator,
    RobotFile,
    congruent,
    pseudo,
)
from diagrams.benchmarks.simulated.motions import SLOW, make_motion

COLOURED = "coloured"
DRY, WET, ROTOR, HELD = "coulomb_friction", "viscous_friction", "rotor_inertia", "payload"
LATE, WRONG_INERTIA, OFFSET = "effort_delay", "wrong_inertia", "effort_offset"
JOINT, PAIR, LINK, BODY, ROBOT = "joint", "pair", "link", "body", "robot"
_BREAKAWAY = 5e-3  # rad/s
_SOFTEST = 0.05  # rad, to which a gear gives way at most
_DENT = 0.05  # of the gap, that a flank gives way under the largest load
_FINE = 1e-3  # s, longest step of a pendulum


class Signals(NamedTuple):
    """What is seen of one joint, (N,) each."""

    time: Array
    q: Array
    v: Array
    a: Array
    load: Array


@dataclass(frozen=True, eq=False)
class Seen:
    """What a hidden effort may be a function of: time (N,), (N, n) each, and the engine."""

    time: Array
    q: Array
    v: Array
    a: Array
    load: Array
    engine: Engine

    @classmethod
    def of(
        cls, engine: Engine, kind: str, time: Array, rng: Generator, *, pace: float = 1.0
    ) -> Seen:
        """Return a motion of a kind, and the efforts that it needs."""
        q, v, a = make_motion(kind, engine, time, rng, pace=pace)
        return cls(time, q, v, a, engine.efforts(q, v, a), engine)

    def joint(self, number: int) -> Signals:
        """Return what is seen of a joint."""
        return Signals(self.time, *(x[:, number] for x in (self.q, self.v, self.a, self.load)))

    def rows(self, rows: slice) -> Seen:
        """Return some of the samples."""
        return Seen(*(x[rows] for x in (self.time, self.q, self.v, self.a, self.load)), self.engine)

    def at(self, joint: int, values: Array) -> Array:
        """Return (N, n) effort of a joint."""
        effort = np.zeros_like(self.q)
        effort[:, joint] = values
        return effort

    def more(self, q: Array, v: Array, a: Array) -> Array:
        """Return (N, n) effort that another motion, or the robot as it is now, needs more."""
        return self.engine.efforts(q, v, a) - self.load

    def with_bodies(self, bodies: Array) -> Array:
        """Return (N, n) effort that the robot needs more with other bodies."""
        before = self.engine.bodies()
        self.engine.set_bodies(bodies)
        effort = self.more(self.q, self.v, self.a)
        self.engine.set_bodies(before)
        return effort

    def tilted(self, x: float, y: float) -> Array:
        """Return (N, n) effort that the robot needs more on a base turned about (x, y, 0), rad."""
        size = np.hypot(x, y)
        # Gravity as the turned base sees it: R(θ)ᵀ g by Rodrigues' formula.
        leans = np.sin(size) / size
        self.engine.set_gravity(-GRAVITY[2] * np.array([leans * y, -leans * x, -np.cos(size)]))
        found = self.more(self.q, self.v, self.a)
        self.engine.set_gravity(GRAVITY)
        return found


@dataclass(frozen=True, eq=False)
class Usual:
    """What is known of a robot's motions, the same for all its logs."""

    file: RobotFile  # the robot's model file
    # center, half: (n,) middle and half width of the positions, rad.
    center: Array
    half: Array
    speed: Array  # (n,) highest speeds, rad/s
    load: Array  # (n,) largest efforts, N·m


@dataclass(frozen=True, eq=False)
class Site:
    """Where a truth acts: joint or body, for a pair also the next one, and what is random."""

    joint: int
    other: int
    numbers: Generator
    usual: Usual | None = None

    @property
    def rng(self) -> Generator:
        """The same random numbers, each time that they are asked for."""
        return deepcopy(self.numbers)

    @property
    def known(self) -> Usual:
        """What is known of the motions."""
        if self.usual is None:
            raise ValueError("This effect is one of robots whose motions are known.")
        return self.usual

    def place(self, seen: Seen, joint: int) -> Array:
        """Return (N,) position of a joint in the range of its motions, from −1 to 1."""
        return np.asarray((seen.q[:, joint] - self.known.center[joint]) / self.known.half[joint])


Law = Callable[[Seen, Site, float], Array]
"""Hidden effort (N, n), of what is seen, where it acts, and its size."""
Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Truth:
    """An effect that a log may hide."""

    name: str
    places: str  # what it acts on: "joint", "pair", "link" (and all joints up to it), "body", …
    law: Law
    # What geodrake should find by name, as multiples of the size.
    values: Values | Callable[[Generator], Values] = field(default_factory=dict)
    companions: tuple[str, ...] = ()  # effects that it comes with, which are no mistakes
    unit: float = 1.0  # a usual size, from which that of a wanted share is sought
    largest: float = np.inf  # largest size, where formulas or geodrake's range end
    # Whether the model must have been fitted to another log first.
    needs_known_inertia: bool = False
    alone: bool = False  # whether it is left out of pairs
    reverses: bool = False  # whether it shows only at a joint whose load changes its sign
    # Of an effect of no catalogue, what a correlate is to name: pairs of a joint (its own, the
    # other, any) and one of its signals, "position" or "speed"; or the time.
    follows: tuple[tuple[str, str], ...] = ()
    in_space: bool = False  # whether a planar robot does not feel it

    def found(self, site: Site, size: float) -> dict[str, float]:
        """Return the parameters that geodrake should find."""
        values = self.values(site.rng) if callable(self.values) else self.values
        return {name: float(size * value) for name, value in values.items()}


def scaled(
    share: float, reached: Callable[[float], float], truth: Truth, *, close: float, tries: int
) -> float:
    """Return the size with which a truth reaches a share of the effort, about or at most."""
    size = wanted = min(truth.unit, truth.largest)
    for _ in range(tries):
        size = wanted
        wanted = min(size * share / reached(size), truth.largest)
        if abs(wanted / size - 1.0) < close:
            break
    return size


def smooth_sign(v: Array) -> Array:
    """Return the direction of motion, v / √(v² + ε²)."""
    return np.asarray(v / np.hypot(v, _BREAKAWAY))


def of_joint(law: Callable[[Signals, Signals, Generator], Array]) -> Law:
    """Return a law of the signals of its joint and of another one, and of random numbers."""

    def effort(seen: Seen, site: Site, size: float) -> Array:
        own, other = seen.joint(site.joint), seen.joint(site.other)
        return seen.at(site.joint, size * law(own, other, site.rng))

    return effort


def _skew(rng: Generator) -> float:
    return rng.uniform(0.25, 0.6) * rng.choice([-1.0, 1.0])


def _heights(rng: Generator) -> Values:
    skew = _skew(rng)
    return {"coulomb_positive": 1.0 + skew, "coulomb_negative": 1.0 - skew}


@of_joint
def _asymmetric(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return friction whose height and slope are larger by the same share in one direction."""
    direction = smooth_sign(own.v)
    return (1.0 + _skew(rng) * direction) * (direction + own.v / np.abs(own.v).max())


@of_joint
def _stribeck(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return friction with a dip as 1 / (1 + (v/vs)²), or one that falls like a bell."""
    excess, share, is_bell = rng.uniform(0.6, 1.2), rng.uniform(0.05, 0.2), rng.random() < 0.5
    square = (own.v / (share * np.abs(own.v).max())) ** 2
    dip = np.exp(-square) if is_bell else 1.0 / (1.0 + square)
    return smooth_sign(own.v) * (1.0 + excess * dip)


@of_joint
def _nonlinear_viscous(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return a power of the speed that is smooth about zero."""
    return own.v * np.hypot(own.v, 1e-3) ** (rng.uniform(1.6, 2.6) - 1.0)


def _belt(seen: Seen, site: Site, size: float) -> Array:
    """Return dry and viscous friction of a motor that turns with v_i ± v_j."""
    sign = site.rng.choice([-1.0, 1.0])
    w = seen.v[:, site.joint] + sign * seen.v[:, site.other]
    torque = size * (smooth_sign(w) + 0.5 * w / np.abs(w).max())
    return seen.at(site.joint, torque) + seen.at(site.other, sign * torque)


def _coupled_rotor(seen: Seen, site: Site, size: float) -> Array:
    """Return a rotor that turns with the difference of two joints, [1, −1]ᵀ I (v̇_i − v̇_j).

    One that turns with the sum is the same as a heavier link where two axes are parallel.
    """
    torque = size * (seen.a[:, site.joint] - seen.a[:, site.other])
    return seen.at(site.joint, torque) - seen.at(site.other, torque)


@of_joint
def _warming(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return friction that falls as 1 / (1 + t / T), to a half at least."""
    left = 0.5 + 1.0 / (1.0 + own.time / rng.uniform(5.0, 10.0))
    return left * (smooth_sign(own.v) + 0.7 * own.v)


@of_joint
def _running_in(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return friction that falls as 1 / (1 + t / T)³, to nothing."""
    left = (1.0 + own.time / rng.uniform(5.0, 10.0)) ** -3
    return left * (smooth_sign(own.v) + 0.7 * own.v)


def _late(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts by interpolation between those of earlier samples."""
    columns = [np.interp(seen.time - size, seen.time, u) for u in seen.load.T]
    return np.stack(columns, 1) - seen.load


@of_joint
def _compensator(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return a spring of zero free length between two cranks: its force times its lever."""
    at, r, s = rng.uniform(-np.pi, np.pi), 0.05, 0.3
    length = np.sqrt(r * r + s * s - 2.0 * r * s * np.cos(own.q - at))
    lever = r * s * np.sin(own.q - at) / length
    return length * lever / (r * s)


@of_joint
def _cogging(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return waves over the position; the motion passes a few of them."""
    waves, phase = rng.uniform(2.5, 12.0), rng.uniform(0.0, 2.0 * np.pi)
    return np.cos(2.0 * np.pi * waves * own.q / np.ptp(own.q) - phase)


@of_joint
def _hysteresis(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return spring-and-slider elements that begin to slip one after the other (Maxwell slip)."""
    widths = rng.uniform(0.01, 0.03) * np.arange(1, 9)
    stretch, found = np.zeros(len(widths)), np.zeros(len(own.q))
    for k in range(1, len(found)):
        stretch = np.clip(stretch + own.q[k] - own.q[k - 1], -widths, widths)
        found[k] = np.mean(stretch / widths)
    return found


def _payload(seen: Seen, site: Site, size: float) -> Array:
    """Return a ball that the last link holds; its size is its mass."""
    rng, bodies = site.rng, seen.engine.bodies()
    center = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.05, 0.15)])
    bodies[site.joint] += size * pseudo(1.0, center, 0.05**2 * np.eye(3))
    return seen.with_bodies(bodies)


def _wrong_body(seen: Seen, site: Site, size: float) -> Array:
    """Return a link unlike that of the file; its size is the distance in the geometric metric."""
    bodies, own = seen.engine.bodies(), slice(site.joint, site.joint + 1)
    bodies[own] = congruent(bodies[own], size / np.sqrt(10.0), site.rng)
    return seen.with_bodies(bodies)


def _level(rng: Generator) -> Values:
    """Return a horizontal axis."""
    direction = rng.uniform(0.0, 2.0 * np.pi)
    return {"tilt_x": np.cos(direction), "tilt_y": np.sin(direction)}


def _tilt(seen: Seen, site: Site, size: float) -> Array:
    """Return a base turned about a horizontal axis; its size is the angle."""
    return seen.tilted(*(size * value for value in _level(site.rng).values()))


def _drag(seen: Seen, site: Site, size: float) -> Array:
    """Return drag at a point of a body, by the engine's Jacobian."""
    J = seen.engine.frames(site.joint, site.rng.uniform(-0.1, 0.1, 3), seen.q)[0][:, :3]
    v = np.einsum("nij,nj->ni", J, seen.v)
    return size * np.einsum("nij,ni->nj", J, v * np.linalg.norm(v, axis=1)[:, None])


def _push(seen: Seen, site: Site, size: float, *, turning: bool = False) -> Array:
    """Return a push at a point of a body during a few seconds, as of leaning on something soft.

    That of a jet or a tool turns with the body.
    """
    rng = site.rng
    point, direction = rng.uniform(-0.1, 0.1, 3), rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    begin, length = rng.uniform(0.2, 0.7), rng.uniform(2.0, 4.0)
    J, R = seen.engine.frames(site.joint, point, seen.q)
    s = np.clip((seen.time - begin * seen.time[-1]) / length, 0.0, 1.0)
    push = np.minimum(1.0, 4.0 * np.sin(np.pi * s))
    along = R @ direction if turning else np.broadcast_to(direction, (len(J), 3))
    return size * push[:, None] * np.einsum("nij,ni->nj", J[:, :3], along)


def _soft_gear(seen: Seen, site: Site, size: float) -> Array:
    """Return a gear that gives way: the link lags behind the motor by compliance times load."""
    load = seen.load[:, site.joint]
    lag = min(size, _SOFTEST / float(np.abs(load).max())) * load
    rate = np.gradient(lag, seen.time)
    return _lagging(seen, site.joint, lag, rate, np.gradient(rate, seen.time))


def _loose_gear(seen: Seen, site: Site, size: float) -> Array:
    """Return a gear with play: between stiff, damped flanks the link moves by its load alone."""
    j, still = site.joint, np.zeros_like(seen.v)
    unit = seen.at(j, np.ones(len(still)))
    weight = seen.engine.efforts(seen.q, still, still)
    inertia = (seen.engine.efforts(seen.q, still, unit) - weight)[:, j]
    return _lagging(seen, j, *_play(seen.load[:, j], inertia, gap=size, time=seen.time))


def _play(load: Array, inertia: Array, *, gap: float, time: Array) -> tuple[Array, Array, Array]:
    """Return lag (N,) of a link within a gap of half width `gap`, its rate and acceleration.

    M s̈ = τ − F(s, ṡ), F the force of the flank, by semi-implicit Euler. What sensors see are means
    over their period.
    """
    period = float(np.median(np.diff(time)))
    stiffness = float(np.abs(load).max()) / (_DENT * gap)
    damping = 1.4 * np.sqrt(stiffness * inertia.min())
    steps = int(np.ceil(period * np.sqrt(stiffness / inertia.min()) / 0.2))
    fine = time[0] + period / steps * np.arange(steps * len(time))
    pulls, masses = np.interp(fine, time, load), np.interp(fine, time, inertia)
    s, rate, dt = float(np.copysign(gap, load[0])), 0.0, period / steps
    rows = np.empty((3, len(fine)))
    for k, (pull, mass) in enumerate(zip(pulls.tolist(), masses.tolist(), strict=True)):
        dent = s - gap if s > gap else s + gap if s < -gap else 0.0
        flank = stiffness * dent + damping * rate if dent else 0.0
        if flank * dent < 0.0:  # a flank does not hold back
            flank = 0.0
        acceleration = (pull - flank) / mass
        rate += dt * acceleration
        s += dt * rate
        rows[:, k] = s, rate, acceleration
    lag, speed, push = (uniform_filter1d(row, steps, mode="nearest")[::steps] for row in rows)
    return lag, speed, push


def _lagging(seen: Seen, joint: int, *behind: Array) -> Array:
    """Return the (N, n) change in effort because a link lags behind its motor, and its rates."""
    ways = (seen.at(joint, each) for each in behind)
    return seen.more(*(x - way for x, way in zip((seen.q, seen.v, seen.a), ways, strict=False)))


_CATALOGUE = (
    Truth(WET, JOINT, of_joint(lambda own, other, rng: own.v), {"viscous": 1.0}),
    Truth(DRY, JOINT, of_joint(lambda own, other, rng: smooth_sign(own.v)), {"coulomb": 1.0}),
    Truth("asymmetric_friction", JOINT, _asymmetric, _heights),
    Truth("stribeck_friction", JOINT, _stribeck, companions=(DRY, WET), alone=True),
    Truth("nonlinear_viscous_friction", JOINT, _nonlinear_viscous),
    Truth(
        "load_dependent_friction",
        JOINT,
        of_joint(lambda own, other, rng: abs(own.load) * smooth_sign(own.v)),
        {"load_factor": 1.0},
    ),
    Truth("coupled_friction", PAIR, _belt),
    Truth("friction_drift", JOINT, _warming, companions=(DRY, WET), alone=True),
    Truth("hysteresis", JOINT, _hysteresis, alone=True),
    Truth(OFFSET, JOINT, of_joint(lambda own, other, rng: 0.0 * own.q + 1.0), {"offset": 1.0}),
    Truth(
        "effort_scale",
        JOINT,
        of_joint(lambda own, other, rng: own.load),
        {"gain_error": 1.0},
        needs_known_inertia=True,
        alone=True,
    ),
    Truth(LATE, ROBOT, _late, {"delay": 1.0}, unit=0.01, largest=0.03),
    Truth(
        "joint_spring",
        JOINT,
        of_joint(lambda own, other, rng: own.q - rng.uniform(-1.0, 1.0)),
        {"stiffness": 1.0},
    ),
    Truth("gravity_compensator", JOINT, _compensator),
    Truth("torque_ripple", JOINT, _cogging),
    Truth(ROTOR, JOINT, of_joint(lambda own, other, rng: own.a), {"inertia": 1.0}),
    Truth(
        "coupled_rotor_inertia",
        PAIR,
        _coupled_rotor,
        {"inertia": -1.0},
        companions=(ROTOR,),
        alone=True,
    ),
    Truth("joint_elasticity", JOINT, _soft_gear, unit=1e-4, alone=True),
    Truth("backlash", JOINT, _loose_gear, unit=1e-3, largest=0.02, alone=True, reverses=True),
    Truth(HELD, BODY, _payload, {"mass": 1.0}),
    Truth(WRONG_INERTIA, BODY, _wrong_body, unit=0.5, largest=2.0, alone=True),
    Truth("gravity_tilt", ROBOT, _tilt, _level, unit=0.05, largest=0.2, alone=True),
    Truth("contact", BODY, _push, alone=True),
    Truth("aerodynamic_drag", BODY, _drag, {"drag": 1.0}, alone=True),
)
TRUTHS = {truth.name: truth for truth in _CATALOGUE}
"""Effects of the catalogue by name."""

# Effects of no catalogue

OWN, OTHER, ANY, TIME = "own", "other", "any", "time"


@of_joint
def _end_stop(own: Signals, other: Signals, rng: Generator) -> Array:
    edge = own.q.min() + rng.uniform(0.55, 0.75) * np.ptp(own.q)
    return np.logaddexp(0.0, (own.q - edge) / 0.02)


@of_joint
def _clock(own: Signals, other: Signals, rng: Generator) -> Array:
    frequency, phase = rng.uniform(0.7, 3.0), rng.uniform(0.0, 2.0 * np.pi)
    return np.sin(2.0 * np.pi * frequency * own.time + phase)


def _wheel(seen: Seen, site: Site, size: float) -> Array:
    """Return a wheel that spins in its link, whose turning it resists: τ = Jᵀ (ω × h)."""
    axis = site.rng.normal(size=3)
    J, R = seen.engine.frames(site.joint, np.zeros(3), seen.q)
    spin = np.einsum("nij,nj->ni", J[:, 3:], seen.v)
    along = R @ axis / np.linalg.norm(axis)
    return size * np.einsum("nij,ni->nj", J[:, 3:], np.cross(spin, along))


@of_joint
def _hose(own: Signals, other: Signals, rng: Generator) -> Array:
    return np.cos(1.5 * (own.q + other.q) - rng.uniform(0.0, 2.0 * np.pi))


@of_joint
def _brake(own: Signals, other: Signals, rng: Generator) -> Array:
    return (1.2 + np.sin(2.0 * other.q)) * smooth_sign(own.v)


_neighbour = of_joint(lambda own, other, rng: np.abs(other.v) * smooth_sign(own.v))
_damper = of_joint(lambda own, other, rng: (other.q - other.q.mean()) * own.v)

_WHEEL = "spinning wheel in a link"
OUTSIDE = {
    name: Truth(
        name,
        LINK if name == _WHEEL else JOINT,
        law,
        follows=(follows,),
        in_space=name == _WHEEL,
    )
    for name, law, follows in (
        ("brake that another joint's position tightens", _brake, (OTHER, "position")),
        ("spring past an angle", _end_stop, (OWN, "position")),
        ("friction of a neighbour's speed", _neighbour, (OTHER, "speed")),
        ("oscillation in time", _clock, (TIME, TIME)),
        (_WHEEL, _wheel, (ANY, "speed")),
        ("hose on the sum of two angles", _hose, (OTHER, "position")),
        ("damper that another joint opens", _damper, (OTHER, "position")),
    )
}
"""Those that one joint shows in one log, by name."""


def _cubic_coupling(seen: Seen, site: Site, size: float) -> Array:
    """Return a spring between two joints of energy x y³."""
    x, y = site.place(seen, site.joint), site.place(seen, site.other)
    return size * (seen.at(site.joint, y**3) + seen.at(site.other, 3.0 * x * y**2))


def _growing_friction(seen: Seen, site: Site, size: float) -> Array:
    grip = 1.2 + site.place(seen, site.joint)
    return seen.at(site.joint, size * grip * smooth_sign(seen.v[:, site.joint]))


def _pendulum(seen: Seen, site: Site, size: float) -> Array:
    """Return a weight that swings in a link, less the same weight at rest at the hinge.

    A weight that hangs quietly pulls at its hinge: what is left is the swing.
    """
    rng = site.rng
    length, damping = rng.uniform(0.05, 0.2), rng.uniform(0.05, 0.3)
    spec = mujoco.MjSpec.from_string(site.known.file.text)
    axis, at = rng.normal(size=3), rng.uniform(-0.1, 0.1, 3)
    down = np.cross(axis, rng.normal(size=3))
    weight = spec.joints[site.joint].parent.add_body(name="weight", pos=at)
    weight.mass, weight.ipos = 1.0, length * down / np.linalg.norm(down)
    weight.inertia, weight.explicitinertial = np.full(3, 1e-4), True
    weight.add_joint(name="swing", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model = spec.compile()
    data, free = mujoco.MjData(model), int(model.joint("swing").dofadr[0])
    arm = np.flatnonzero(np.arange(model.nv) != free)
    inertia = length**2 + 1e-4
    drag = 2.0 * damping * inertia * np.sqrt(9.81 / length)

    def needed(motion: Array, swing: tuple[float, float, float]) -> Array:
        signals = (data.qpos, data.qvel, data.qacc)
        for signal, values, own in zip(signals, motion, swing, strict=True):
            signal[arm], signal[free] = values, own
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()

    period = float(np.median(np.diff(seen.time)))
    steps = int(np.ceil(period / _FINE))
    found, angle, rate = np.zeros_like(seen.q), 0.0, 0.0
    motion = np.stack([seen.q, seen.v, seen.a], 1)
    ahead = np.concatenate([motion[1:], motion[-1:]])
    for k in range(len(found)):
        for i in range(steps):
            part = i / steps
            between = (1.0 - part) * motion[k] + part * ahead[k]
            bend = -(drag * rate + needed(between, (angle, rate, 0.0))[free]) / inertia
            if i == 0:
                found[k] = needed(motion[k], (angle, rate, bend))[arm]
            rate += bend * period / steps
            angle += rate * period / steps
    bodies = seen.engine.bodies()
    bodies[site.joint] += pseudo(1.0, at, 1e-4 * np.eye(3))
    return size * (found - seen.load - seen.with_bodies(bodies))


def _saturation(seen: Seen, site: Site, size: float) -> Array:
    """Return what a drive commands more and its motor does not give, at high speed under load."""
    edge, own = site.rng.uniform(0.5, 0.8), seen.joint(site.joint)
    used = np.abs(own.v) / site.known.speed[site.joint]
    used += np.abs(own.load) / site.known.load[site.joint]
    beyond = np.logaddexp(0.0, (used - edge) / 0.05)
    return seen.at(site.joint, size * np.sign(own.load) * beyond * np.abs(own.load))


def _taut_hose(seen: Seen, site: Site, size: float) -> Array:
    """Return a hose on the difference of two angles, which pulls only when it is taut."""
    stretch = site.place(seen, site.joint) - site.place(seen, site.other)
    pull = size * 0.05 * np.logaddexp(0.0, (stretch - site.rng.uniform(0.1, 0.5)) / 0.05)
    return seen.at(site.joint, pull) - seen.at(site.other, pull)


def _slipping_belt(seen: Seen, site: Site, size: float) -> Array:
    """Return a link that falls behind its motor by a little more each time the load is high."""
    load = seen.load[:, site.joint]
    over = np.abs(load) / site.known.load[site.joint] - site.rng.uniform(0.4, 0.7)
    rate = size * np.maximum(over, 0.0) * np.sign(load)
    return _lagging(seen, site.joint, np.cumsum(rate * np.gradient(seen.time)), rate, 0.0 * rate)


def _cable_drag(seen: Seen, site: Site, size: float) -> Array:
    """Return a cable that drags in one direction only, in some postures more."""
    going = 0.5 * (1.0 + smooth_sign(seen.v[:, site.joint]))
    phase = site.rng.uniform(0.0, 2.0 * np.pi)
    posture = np.cos(2.5 * site.place(seen, site.joint) - phase)
    return seen.at(site.joint, size * going * posture)


def _eccentric_gear(seen: Seen, site: Site, size: float) -> Array:
    rng = site.rng
    waves, phase = rng.uniform(3.0, 9.0), rng.uniform(0.0, 2.0 * np.pi)
    turn = seen.q[:, site.joint] + seen.q[:, site.other]
    wave = size * np.sin(waves * turn + phase)
    return seen.at(site.joint, wave) + seen.at(site.other, wave)


def _sticking_places(seen: Seen, site: Site, size: float) -> Array:
    places = site.rng.uniform(-0.8, 0.8, 4)
    away = (site.place(seen, site.joint)[:, None] - places) / 0.05
    grip = np.exp(-0.5 * away**2).sum(1)
    return seen.at(site.joint, size * grip * smooth_sign(seen.v[:, site.joint]))


def _neighbours_square(seen: Seen, site: Site, size: float) -> Array:
    other = seen.v[:, site.other] / site.known.speed[site.other]
    return seen.at(site.joint, size * other**2)


IN_A_LINK = "pendulum in a link"
OF_ALL_MOTIONS = {
    name: Truth(name, JOINT, law, **more)
    for name, law, more in (
        ("cubic coupling of two joints", _cubic_coupling, {}),
        ("friction that grows with position", _growing_friction, {"companions": (DRY,)}),
        (IN_A_LINK, _pendulum, {}),
        ("motor that saturates at high speed", _saturation, {}),
        ("taut hose on a difference of angles", _taut_hose, {}),
        ("slipping belt", _slipping_belt, {"largest": 2.0}),
        ("cable that drags in one direction", _cable_drag, {}),
        ("eccentric gear on a sum of angles", _eccentric_gear, {}),
        ("a few places that stick", _sticking_places, {}),
        ("square of another joint's speed", _neighbours_square, {}),
    )
}
"""Those that are sized by all motions of a robot, by name."""


HARD: Mapping[str, tuple[Truth, Mapping[str, object]]] = {
    "wrench that turns with its body": (Truth("contact", BODY, partial(_push, turning=True)), {}),
    "friction that fades to nothing": (
        Truth("friction_drift", JOINT, _running_in, companions=(DRY, WET)),
        {},
    ),
    "delay in slow motion, coloured noise": (TRUTHS[LATE], {"motion": SLOW, "colour": COLOURED}),
    "tilt": (TRUTHS["gravity_tilt"], {}),
}
"""Kinds that other engines' logs showed to be hard, each with what of the draws is given."""


def truth_of(name: str) -> Truth:
    """Return what is hidden by a name of any of the tables."""
    hard = {kind: truth for kind, (truth, _) in HARD.items()}
    return {**TRUTHS, **OUTSIDE, **OF_ALL_MOTIONS, **hard}[name]
