"""Hidden effects, of geodrake's catalogue and others, without formulas of geodrake.

A truth has its places and a law for its effort; benchmarks scale it to a share of the joint's
effort. A law draws the same random numbers at every call.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
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
_SOFTEST = 0.05  # rad, largest deflection of a gear
_DENT = 0.05  # of the gap, deflection of a flank under the largest load
_TURNS = 6  # changes of the load's sign at joints with backlash
_FINE = 1e-3  # s, longest time step of a pendulum


class Signals(NamedTuple):
    """Signals of one joint, (N,) each."""

    time: Array
    q: Array
    v: Array
    a: Array
    load: Array


@dataclass(frozen=True, eq=False)
class Seen:
    """Arguments of hidden efforts: time (N,), signals (N, n), and the engine."""

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
        """Return a motion of a kind with its efforts."""
        q, v, a = make_motion(kind, engine, time, rng, pace=pace)
        return cls(time, q, v, a, engine.efforts(q, v, a), engine)

    def joint(self, number: int) -> Signals:
        """Return the signals of a joint."""
        return Signals(self.time, *(x[:, number] for x in (self.q, self.v, self.a, self.load)))

    def rows(self, rows: slice) -> Seen:
        """Return selected samples."""
        return Seen(*(x[rows] for x in (self.time, self.q, self.v, self.a, self.load)), self.engine)

    def at(self, joint: int, values: Array) -> Array:
        """Return efforts (N, n) that are zero at other joints."""
        effort = np.zeros_like(self.q)
        effort[:, joint] = values
        return effort

    def more(self, q: Array, v: Array, a: Array) -> Array:
        """Return the additional efforts (N, n) of another motion, or of a changed engine."""
        return self.engine.efforts(q, v, a) - self.load

    def with_bodies(self, bodies: Array) -> Array:
        """Return the additional efforts (N, n) with other bodies."""
        before = self.engine.bodies()
        self.engine.set_bodies(bodies)
        effort = self.more(self.q, self.v, self.a)
        self.engine.set_bodies(before)
        return effort

    def tilted(self, x: float, y: float) -> Array:
        """Return the additional efforts (N, n) on a base rotated by (x, y, 0), rad."""
        size = np.hypot(x, y)
        # Gravity in the frame of the rotated base: R(θ)ᵀ g by Rodrigues' formula.
        factor = np.sin(size) / size
        self.engine.set_gravity(-GRAVITY[2] * np.array([factor * y, -factor * x, -np.cos(size)]))
        efforts = self.more(self.q, self.v, self.a)
        self.engine.set_gravity(GRAVITY)
        return efforts


@dataclass(frozen=True, eq=False)
class Usual:
    """Ranges of a robot's motions, the same for all its logs."""

    file: RobotFile  # the robot's model file
    # center, half: (n,) centre and half range of the positions, rad.
    center: Array
    half: Array
    speed: Array  # (n,) highest speeds, rad/s
    load: Array  # (n,) largest efforts, N·m


@dataclass(frozen=True, eq=False)
class Site:
    """Place of a truth: joint or body, a second joint of pairs, and random numbers."""

    joint: int
    other: int
    numbers: Generator
    usual: Usual | None = None

    @property
    def rng(self) -> Generator:
        """Generator of the same random numbers at each access."""
        return deepcopy(self.numbers)

    @property
    def known(self) -> Usual:
        """Ranges of the motions; a ValueError if they are unknown."""
        if self.usual is None:
            raise ValueError("This effect is one of robots whose motions are known.")
        return self.usual

    def place(self, seen: Seen, joint: int) -> Array:
        """Return the position (N,) of a joint relative to its range, from −1 to 1."""
        return np.asarray((seen.q[:, joint] - self.known.center[joint]) / self.known.half[joint])


Law = Callable[[Seen, Site, float], Array]
"""Hidden efforts (N, n) as a function of signals, place, and size."""
Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Truth:
    """An effect that a log may hide."""

    name: str
    places: str  # "joint", "pair", "link" (and all joints up to it), "body", …
    law: Law
    # Parameters that geodrake should find, relative to the size.
    values: Values | Callable[[Generator], Values] = field(default_factory=dict)
    companions: tuple[str, ...] = ()  # accompanying effects, which are not wrong
    unit: float = 1.0  # initial size of the search for a share of the effort
    largest: float = np.inf  # largest valid size
    # Whether the model must first be fitted to another log.
    needs_known_inertia: bool = False
    alone: bool = False  # whether it is excluded from pairs
    reverses: bool = False  # whether it needs a load that changes its sign
    # Expected correlates of an effect outside the catalogue: pairs of a joint (its own, the other,
    # any) and one of its signals, "position" or "speed"; or the time.
    follows: tuple[tuple[str, str], ...] = ()
    in_space: bool = False  # whether it does not affect planar robots

    def found(self, site: Site, size: float) -> dict[str, float]:
        """Return the parameters that geodrake should find."""
        values = self.values(site.rng) if callable(self.values) else self.values
        return {name: float(size * value) for name, value in values.items()}

    def where(self, site: Site, joints: Sequence[str], bodies: Sequence[str]) -> tuple[str, ...]:
        """Return the joints or the body that are to be named; none for the whole robot."""
        own, other = joints[site.joint], joints[site.other]
        places = {PAIR: (own, other), BODY: (bodies[site.joint],), ROBOT: ()}
        return places.get(self.places, (own,))

    def placed(self, joint: int, load: Array, rng: Generator) -> tuple[int, int]:
        """Return the joint near a random one at which it can act, and a second joint of pairs.

        The `load` (N, n) is that of the joints; bodies have the numbers of their joints.
        """
        n, turns = load.shape[1], (np.diff(np.sign(load), axis=0) != 0).sum(0)
        other = int(rng.choice([j for j in range(n) if j != joint]))
        if self.reverses:
            turning = np.flatnonzero(turns >= min(_TURNS, turns.max()))
            joint = int(turning[joint % len(turning)])
        elif self.places == PAIR:
            joint = min(joint, n - 2)
            other = joint + 1
        elif self.name == HELD:
            joint = n - 1
        elif self.places in (BODY, LINK) and self.name != WRONG_INERTIA:
            joint = int(rng.integers(n // 2, n))
        return joint, other


def scaled(
    share: float, reached: Callable[[float], float], truth: Truth, *, close: float, tries: int
) -> float:
    """Return the size at which a truth reaches a share of the effort, up to its largest size."""
    size = wanted = min(truth.unit, truth.largest)
    for _ in range(tries):
        size = wanted
        wanted = min(size * share / reached(size), truth.largest)
        if abs(wanted / size - 1.0) < close:
            break
    return size


def smooth_sign(v: Array) -> Array:
    """Return the smooth sign of a velocity, v / √(v² + ε²)."""
    return np.asarray(v / np.hypot(v, _BREAKAWAY))


def of_joint(law: Callable[[Signals, Signals, Generator], Array]) -> Law:
    """Turn a function of the signals of two joints and random numbers into a law."""

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
    """Return friction with levels and slopes larger by the same share in one direction."""
    direction = smooth_sign(own.v)
    return (1.0 + _skew(rng) * direction) * (direction + own.v / np.abs(own.v).max())


@of_joint
def _stribeck(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return friction with a Stribeck dip 1 / (1 + (v/vs)²) or exp(−(v/vs)²)."""
    excess, share, is_bell = rng.uniform(0.6, 1.2), rng.uniform(0.05, 0.2), rng.random() < 0.5
    square = (own.v / (share * np.abs(own.v).max())) ** 2
    dip = np.exp(-square) if is_bell else 1.0 / (1.0 + square)
    return smooth_sign(own.v) * (1.0 + excess * dip)


@of_joint
def _nonlinear_viscous(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return a power of the speed, smooth at zero."""
    return own.v * np.hypot(own.v, 1e-3) ** (rng.uniform(1.6, 2.6) - 1.0)


def _belt(seen: Seen, site: Site, size: float) -> Array:
    """Return dry and viscous friction of a motor with the speed v_i ± v_j."""
    sign = site.rng.choice([-1.0, 1.0])
    w = seen.v[:, site.joint] + sign * seen.v[:, site.other]
    torque = size * (smooth_sign(w) + 0.5 * w / np.abs(w).max())
    return seen.at(site.joint, torque) + seen.at(site.other, sign * torque)


def _coupled_rotor(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of a rotor with the difference of two speeds, [1, −1]ᵀ I (v̇_i − v̇_j).

    A rotor with their sum is equivalent to a heavier link if the axes are parallel.
    """
    torque = size * (seen.a[:, site.joint] - seen.a[:, site.other])
    return seen.at(site.joint, torque) - seen.at(site.other, torque)


@of_joint
def _warming(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return friction that falls to a third as 0.5 + 1 / (1 + t / T)."""
    factor = 0.5 + 1.0 / (1.0 + own.time / rng.uniform(5.0, 10.0))
    return factor * (smooth_sign(own.v) + 0.7 * own.v)


@of_joint
def _running_in(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return friction that vanishes as 1 / (1 + t / T)³."""
    factor = (1.0 + own.time / rng.uniform(5.0, 10.0)) ** -3
    return factor * (smooth_sign(own.v) + 0.7 * own.v)


def _late(seen: Seen, site: Site, size: float) -> Array:
    """Return the change of efforts by a delay, with linear interpolation."""
    columns = [np.interp(seen.time - size, seen.time, u) for u in seen.load.T]
    return np.stack(columns, 1) - seen.load


@of_joint
def _compensator(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return the torque of a spring of zero free length between two cranks."""
    angle, r, s = rng.uniform(-np.pi, np.pi), 0.05, 0.3
    length = np.sqrt(r * r + s * s - 2.0 * r * s * np.cos(own.q - angle))
    lever = r * s * np.sin(own.q - angle) / length
    return length * lever / (r * s)


@of_joint
def _cogging(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return a few waves over the range of positions."""
    waves, phase = rng.uniform(2.5, 12.0), rng.uniform(0.0, 2.0 * np.pi)
    return np.cos(2.0 * np.pi * waves * own.q / np.ptp(own.q) - phase)


@of_joint
def _hysteresis(own: Signals, other: Signals, rng: Generator) -> Array:
    """Return Maxwell-slip friction: springs with sliders of different strengths."""
    widths = rng.uniform(0.01, 0.03) * np.arange(1, 9)
    stretch, efforts = np.zeros(len(widths)), np.zeros(len(own.q))
    for k in range(1, len(efforts)):
        stretch = np.clip(stretch + own.q[k] - own.q[k - 1], -widths, widths)
        efforts[k] = np.mean(stretch / widths)
    return efforts


def _payload(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of a ball fixed to the last link; the size is its mass."""
    rng, bodies = site.rng, seen.engine.bodies()
    center = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.05, 0.15)])
    bodies[site.joint] += size * pseudo(1.0, center, 0.05**2 * np.eye(3))
    return seen.with_bodies(bodies)


def _wrong_body(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of a perturbed link; the size is the distance in the geometric metric."""
    bodies, link = seen.engine.bodies(), slice(site.joint, site.joint + 1)
    bodies[link] = congruent(bodies[link], size / np.sqrt(10.0), site.rng)
    return seen.with_bodies(bodies)


def _level(rng: Generator) -> Values:
    """Draw a horizontal axis."""
    direction = rng.uniform(0.0, 2.0 * np.pi)
    return {"tilt_x": np.cos(direction), "tilt_y": np.sin(direction)}


def _tilt(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts on a base tilted about a horizontal axis; the size is the angle."""
    return seen.tilted(*(size * value for value in _level(site.rng).values()))


def _drag(seen: Seen, site: Site, size: float) -> Array:
    """Return aerodynamic drag at a point of a body."""
    J = seen.engine.frames(site.joint, site.rng.uniform(-0.1, 0.1, 3), seen.q)[0][:, :3]
    v = np.einsum("nij,nj->ni", J, seen.v)
    return size * np.einsum("nij,ni->nj", J, v * np.linalg.norm(v, axis=1)[:, None])


def _push(seen: Seen, site: Site, size: float, *, turning: bool = False) -> Array:
    """Return efforts of a force at a point of a body for a few seconds, as of a soft contact.

    The force of a jet or a tool rotates with the body.
    """
    rng = site.rng
    point, direction = rng.uniform(-0.1, 0.1, 3), rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    begin, length = rng.uniform(0.2, 0.7), rng.uniform(2.0, 4.0)
    J, R = seen.engine.frames(site.joint, point, seen.q)
    s = np.clip((seen.time - begin * seen.time[-1]) / length, 0.0, 1.0)
    push = np.minimum(1.0, 4.0 * np.sin(np.pi * s))
    axis = R @ direction if turning else np.broadcast_to(direction, (len(J), 3))
    return size * push[:, None] * np.einsum("nij,ni->nj", J[:, :3], axis)


def _soft_gear(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of an elastic gear: the link lags by compliance times load."""
    load = seen.load[:, site.joint]
    lag = min(size, _SOFTEST / float(np.abs(load).max())) * load
    rate = np.gradient(lag, seen.time)
    return _lagging(seen, site.joint, lag, rate, np.gradient(rate, seen.time))


def _loose_gear(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of backlash: the link moves freely between stiff, damped flanks."""
    j, still = site.joint, np.zeros_like(seen.v)
    unit = seen.at(j, np.ones(len(still)))
    weight = seen.engine.efforts(seen.q, still, still)
    inertia = (seen.engine.efforts(seen.q, still, unit) - weight)[:, j]
    return _lagging(seen, j, *_play(seen.load[:, j], inertia, gap=size, time=seen.time))


def _play(load: Array, inertia: Array, *, gap: float, time: Array) -> tuple[Array, Array, Array]:
    """Return the lag (N,) of a link within a gap of half width `gap`, its rate and acceleration.

    Semi-implicit Euler integrates M s̈ = τ − F(s, ṡ), with the force F of the flank. Sensors
    measure means over their period.
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
        if flank * dent < 0.0:  # flanks only push
            flank = 0.0
        acceleration = (pull - flank) / mass
        rate += dt * acceleration
        s += dt * rate
        rows[:, k] = s, rate, acceleration
    lag, speed, push = (uniform_filter1d(row, steps, mode="nearest")[::steps] for row in rows)
    return lag, speed, push


def _lagging(seen: Seen, joint: int, *lags: Array) -> Array:
    """Return the change of efforts (N, n) by a link's lag and its derivatives."""
    shifts = (seen.at(joint, lag) for lag in lags)
    return seen.more(*(x - dx for x, dx in zip((seen.q, seen.v, seen.a), shifts, strict=False)))


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

# Effects outside the catalogue

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
    """Return efforts of a wheel that spins in a link: τ = Jᵀ (ω × h)."""
    axis = site.rng.normal(size=3)
    J, R = seen.engine.frames(site.joint, np.zeros(3), seen.q)
    spin = np.einsum("nij,nj->ni", J[:, 3:], seen.v)
    direction = R @ axis / np.linalg.norm(axis)
    return size * np.einsum("nij,ni->nj", J[:, 3:], np.cross(spin, direction))


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
"""Effects at one joint in one log, by name."""


def _cubic_coupling(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of a spring between two joints, with energy x y³."""
    x, y = site.place(seen, site.joint), site.place(seen, site.other)
    return size * (seen.at(site.joint, y**3) + seen.at(site.other, 3.0 * x * y**2))


def _growing_friction(seen: Seen, site: Site, size: float) -> Array:
    grip = 1.2 + site.place(seen, site.joint)
    return seen.at(site.joint, size * grip * smooth_sign(seen.v[:, site.joint]))


def _pendulum(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of a weight that swings in a link, less those of the weight at its hinge.

    The difference is due to the swing alone.
    """
    rng = site.rng
    length, damping = rng.uniform(0.05, 0.2), rng.uniform(0.05, 0.3)
    spec = mujoco.MjSpec.from_string(site.known.file.text)
    axis, hinge = rng.normal(size=3), rng.uniform(-0.1, 0.1, 3)
    down = np.cross(axis, rng.normal(size=3))
    weight = spec.joints[site.joint].parent.add_body(name="weight", pos=hinge)
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
        for signal, values, value in zip(signals, motion, swing, strict=True):
            signal[arm], signal[free] = values, value
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()

    period = float(np.median(np.diff(seen.time)))
    steps = int(np.ceil(period / _FINE))
    efforts, angle, rate = np.zeros_like(seen.q), 0.0, 0.0
    motion = np.stack([seen.q, seen.v, seen.a], 1)
    following = np.concatenate([motion[1:], motion[-1:]])
    for k in range(len(efforts)):
        for i in range(steps):
            part = i / steps
            between = (1.0 - part) * motion[k] + part * following[k]
            acceleration = -(drag * rate + needed(between, (angle, rate, 0.0))[free]) / inertia
            if i == 0:
                efforts[k] = needed(motion[k], (angle, rate, acceleration))[arm]
            rate += acceleration * period / steps
            angle += rate * period / steps
    bodies = seen.engine.bodies()
    bodies[site.joint] += pseudo(1.0, hinge, 1e-4 * np.eye(3))
    return size * (efforts - seen.load - seen.with_bodies(bodies))


def _saturation(seen: Seen, site: Site, size: float) -> Array:
    """Return the difference of commanded and actual efforts of a motor that saturates."""
    edge, signals = site.rng.uniform(0.5, 0.8), seen.joint(site.joint)
    utilization = np.abs(signals.v) / site.known.speed[site.joint]
    utilization += np.abs(signals.load) / site.known.load[site.joint]
    excess = np.logaddexp(0.0, (utilization - edge) / 0.05)
    return seen.at(site.joint, size * np.sign(signals.load) * excess * np.abs(signals.load))


def _taut_hose(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of a hose that is taut for large differences of two angles."""
    stretch = site.place(seen, site.joint) - site.place(seen, site.other)
    pull = size * 0.05 * np.logaddexp(0.0, (stretch - site.rng.uniform(0.1, 0.5)) / 0.05)
    return seen.at(site.joint, pull) - seen.at(site.other, pull)


def _slipping_belt(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of a belt that slips a little at each high load."""
    load = seen.load[:, site.joint]
    excess = np.abs(load) / site.known.load[site.joint] - site.rng.uniform(0.4, 0.7)
    rate = size * np.maximum(excess, 0.0) * np.sign(load)
    return _lagging(seen, site.joint, np.cumsum(rate * np.gradient(seen.time)), rate, 0.0 * rate)


def _cable_drag(seen: Seen, site: Site, size: float) -> Array:
    """Return efforts of a cable that drags in one direction, depending on the posture."""
    is_forward = 0.5 * (1.0 + smooth_sign(seen.v[:, site.joint]))
    phase = site.rng.uniform(0.0, 2.0 * np.pi)
    posture = np.cos(2.5 * site.place(seen, site.joint) - phase)
    return seen.at(site.joint, size * is_forward * posture)


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
"""Effects scaled by all motions of a robot, by name."""


HARD: Mapping[str, tuple[Truth, Mapping[str, object]]] = {
    "wrench that turns with its body": (Truth("contact", BODY, partial(_push, turning=True)), {}),
    "friction that fades to nothing": (
        Truth("friction_drift", JOINT, _running_in, companions=(DRY, WET)),
        {},
    ),
    "delay in slow motion, coloured noise": (TRUTHS[LATE], {"motion": SLOW, "colour": COLOURED}),
    "tilt": (TRUTHS["gravity_tilt"], {}),
}
"""Effects that proved hard in logs of other engines, each with fixed settings of the draws."""


def truth_of(name: str) -> Truth:
    """Return the truth of a name in any of the tables."""
    hard = {kind: truth for kind, (truth, _) in HARD.items()}
    return {**TRUTHS, **OUTSIDE, **OF_ALL_MOTIONS, **hard}[name]
