"""What logs can hide: effects of geodrake's catalogue in formulas of their own, and others.

A truth says where it acts, and gives its effort for a size of one; the benchmark scales that to a
share of the joint's effort.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from diagrams.benchmarks.hidden.robots import GRAVITY, SLOW, Engine, congruent, make_motion, pseudo
from geodrake.effects import catalogue

Array = NDArray[np.float64]
JOINT, PAIR, BODY, ROBOT = "joint", "pair", "body", "robot"
_BREAKAWAY = 5e-3  # rad/s


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
    def of(cls, engine: Engine, kind: str, time: Array, rng: np.random.Generator) -> Seen:
        """Return a motion of a kind, and the efforts that it needs."""
        q, v, a = make_motion(kind, engine, time, rng)
        return cls(time, q, v, a, engine.efforts(q, v, a), engine)

    def zeros(self) -> Array:
        """Return no effort."""
        return np.zeros_like(self.q)

    def at(self, joint: int, values: Array) -> Array:
        """Return (N, n) effort of a joint."""
        effort = self.zeros()
        effort[:, joint] = values
        return effort


class Signals(NamedTuple):
    """What is seen of one joint, (N,) each."""

    time: Array
    q: Array
    v: Array
    a: Array
    load: Array


@dataclass(frozen=True, eq=False)
class Site:
    """Where a truth acts: joint or body, for a pair also the next one, and what is random."""

    joint: int
    other: int
    rng: np.random.Generator


Effort = Callable[[Seen, float], Array]
"""Hidden effort (N, n) as a function of what is seen and of its size."""


@dataclass(frozen=True, eq=False)
class Hidden:
    """One hidden effect."""

    effort: Effort
    # What geodrake should find by name, as multiples of the size.
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Truth:
    """An effect of the catalogue that a log may hide."""

    name: str
    places: str  # what it acts on: "joint", "pair", "body" or "robot"
    make: Callable[[Site], Hidden]
    companions: tuple[str, ...] = ()  # effects that it comes with, which are no mistakes
    unit: float = 1.0  # a usual size, from which that of a wanted share is sought
    largest: float = np.inf  # largest size, where formulas or geodrake's range end
    # Whether the model must have been fitted to another log first.
    needs_known_inertia: bool = False
    alone: bool = False  # whether it is left out of pairs
    reverses: bool = False  # whether it shows only at a joint whose load changes its sign


def smooth_sign(v: Array) -> Array:
    """Return the direction of motion, v / √(v² + ε²)."""
    return np.asarray(v / np.hypot(v, _BREAKAWAY))


def joint_law(
    law: Callable[[Signals, Signals], Array], **values: float
) -> Callable[[Site], Hidden]:
    """Return a truth whose effort is a function of signals of its joint, and of another one."""

    def make(site: Site) -> Hidden:
        def effort(seen: Seen, size: float) -> Array:
            own, other = (
                Signals(seen.time, *(x[:, j] for x in (seen.q, seen.v, seen.a, seen.load)))
                for j in (site.joint, site.other)
            )
            return seen.at(site.joint, size * law(own, other))

        return Hidden(effort, values)

    return make


def asymmetric(site: Site) -> Hidden:
    """Return the friction whose height and slope are larger by the same share in one direction."""
    skew = site.rng.uniform(0.25, 0.6) * site.rng.choice([-1.0, 1.0])
    levels = {"coulomb_positive": 1.0 + skew, "coulomb_negative": 1.0 - skew}

    def law(own: Signals, other: Signals) -> Array:
        direction = smooth_sign(own.v)
        return (1.0 + skew * direction) * (direction + own.v / np.abs(own.v).max())

    return joint_law(law, **levels)(site)


def stribeck(site: Site) -> Hidden:
    """Return a dip as 1 / (1 + (v/vs)²), or one that falls like a bell."""
    excess, share = site.rng.uniform(0.6, 1.2), site.rng.uniform(0.05, 0.2)
    is_bell = site.rng.random() < 0.5

    def law(own: Signals, other: Signals) -> Array:
        square = (own.v / (share * np.abs(own.v).max())) ** 2
        dip = np.exp(-square) if is_bell else 1.0 / (1.0 + square)
        return smooth_sign(own.v) * (1.0 + excess * dip)

    return joint_law(law)(site)


def nonlinear_viscous(site: Site) -> Hidden:
    """Return a power of the speed that is smooth about zero."""
    power = site.rng.uniform(1.6, 2.6)
    return joint_law(lambda own, other: own.v * np.hypot(own.v, 1e-3) ** (power - 1.0))(site)


def belt(site: Site) -> Hidden:
    """Return dry and viscous friction of a motor that turns with v_i ± v_j."""
    sign = site.rng.choice([-1.0, 1.0])

    def effort(seen: Seen, size: float) -> Array:
        w = seen.v[:, site.joint] + sign * seen.v[:, site.other]
        torque = size * (smooth_sign(w) + 0.5 * w / np.abs(w).max())
        return seen.at(site.joint, torque) + seen.at(site.other, sign * torque)

    return Hidden(effort)


def coupled_rotor(site: Site) -> Hidden:
    """Return a rotor that turns with the difference of two joints, [1, −1]ᵀ I (v̇_i − v̇_j).

    One that turns with the sum is the same as a heavier link where two axes are parallel.
    """

    def effort(seen: Seen, size: float) -> Array:
        torque = size * (seen.a[:, site.joint] - seen.a[:, site.other])
        return seen.at(site.joint, torque) - seen.at(site.other, torque)

    return Hidden(effort, {"inertia": -1.0})


def warming(site: Site) -> Hidden:
    """Return the friction that falls as 1 / (1 + t / T)."""
    return _fading(site, 0.5, 1)


def running_in(site: Site) -> Hidden:
    """Return the friction that falls as 1 / (1 + t / T)³, to nothing."""
    return _fading(site, 0.0, 3)


def _fading(site: Site, floor: float, power: int) -> Hidden:
    time_constant = site.rng.uniform(5.0, 10.0)

    def law(own: Signals, other: Signals) -> Array:
        left = floor + (1.0 + own.time / time_constant) ** -power
        return left * (smooth_sign(own.v) + 0.7 * own.v)

    return joint_law(law)(site)


def late(site: Site) -> Hidden:
    """Return efforts by interpolation between those of earlier samples."""
    del site

    def effort(seen: Seen, size: float) -> Array:
        columns = [np.interp(seen.time - size, seen.time, u) for u in seen.load.T]
        return np.stack(columns, 1) - seen.load

    return Hidden(effort, {"delay": 1.0})


def spring(site: Site) -> Hidden:
    """Return a spring by its rest position."""
    rest = site.rng.uniform(-1.0, 1.0)
    return joint_law(lambda own, other: own.q - rest, stiffness=1.0)(site)


def compensator(site: Site) -> Hidden:
    """Return a spring of zero free length between two cranks: its force times its lever."""
    at, r, s = site.rng.uniform(-np.pi, np.pi), 0.05, 0.3

    def law(own: Signals, other: Signals) -> Array:
        length = np.sqrt(r * r + s * s - 2.0 * r * s * np.cos(own.q - at))
        lever = r * s * np.sin(own.q - at) / length
        return length * lever / (r * s)

    return joint_law(law)(site)


def cogging(site: Site) -> Hidden:
    """Return waves over the position; the motion passes a few of them."""
    waves, phase = site.rng.uniform(2.5, 12.0), site.rng.uniform(0.0, 2.0 * np.pi)

    def law(own: Signals, other: Signals) -> Array:
        return np.cos(2.0 * np.pi * waves * own.q / np.ptp(own.q) - phase)

    return joint_law(law)(site)


def hysteresis(site: Site) -> Hidden:
    """Return spring-and-slider elements that begin to slip one after the other (Maxwell slip)."""
    widths = site.rng.uniform(0.01, 0.03) * np.arange(1, 9)

    def effort(seen: Seen, size: float) -> Array:
        q = seen.q[:, site.joint]
        stretch, found = np.zeros(len(widths)), np.zeros(len(q))
        for k in range(1, len(q)):
            stretch = np.clip(stretch + q[k] - q[k - 1], -widths, widths)
            found[k] = np.mean(stretch / widths)
        return seen.at(site.joint, size * found)

    return Hidden(effort)


_SOFTEST = 0.05  # rad, to which a gear gives way at most
_DENT = 0.05  # of the gap, that a flank gives way under the largest load


def with_bodies(seen: Seen, bodies: Array) -> Array:
    """Return (N, n) effort that the robot needs more with other bodies."""
    before = seen.engine.bodies()
    seen.engine.set_bodies(bodies)
    effort = seen.engine.efforts(seen.q, seen.v, seen.a) - seen.load
    seen.engine.set_bodies(before)
    return effort


def payload(site: Site) -> Hidden:
    """Return a ball that the last link holds; its size is its mass."""
    center = np.array([*site.rng.uniform(-0.05, 0.05, 2), site.rng.uniform(0.05, 0.15)])
    ball = pseudo(1.0, center, 0.05**2 * np.eye(3))

    def effort(seen: Seen, size: float) -> Array:
        bodies = seen.engine.bodies()
        bodies[site.joint] += size * ball
        return with_bodies(seen, bodies)

    return Hidden(effort, {"mass": 1.0})


def wrong_body(site: Site) -> Hidden:
    """A link that differs from the file; its size is the distance in the geometric metric."""
    state = site.rng.bit_generator.state

    def effort(seen: Seen, size: float) -> Array:
        rng = np.random.default_rng(0)
        rng.bit_generator.state = state
        bodies = seen.engine.bodies()
        i = site.joint
        bodies[i : i + 1] = congruent(bodies[i : i + 1], size / np.sqrt(10.0), rng)
        return with_bodies(seen, bodies)

    return Hidden(effort)


def tilt(site: Site) -> Hidden:
    """Return a base turned about a horizontal axis; its size is the angle."""
    direction = site.rng.uniform(0.0, 2.0 * np.pi)
    x, y = np.cos(direction), np.sin(direction)

    def effort(seen: Seen, size: float) -> Array:
        # Gravity as the turned base sees it: R(θ)ᵀ g by Rodrigues' formula.
        down = np.array([np.sin(size) * y, -np.sin(size) * x, -np.cos(size)])
        seen.engine.set_gravity(GRAVITY * down)
        found = seen.engine.efforts(seen.q, seen.v, seen.a) - seen.load
        seen.engine.set_gravity(np.array([0.0, 0.0, -GRAVITY]))
        return found

    return Hidden(effort, {"tilt_x": x, "tilt_y": y})


def drag(site: Site) -> Hidden:
    """Return drag at a point of a body, by the engine's Jacobian."""
    point = site.rng.uniform(-0.1, 0.1, 3)

    def effort(seen: Seen, size: float) -> Array:
        J = seen.engine.jacobians(site.joint, point, seen.q)[:, :3]
        v = np.einsum("nij,nj->ni", J, seen.v)
        return size * np.einsum("nij,ni->nj", J, v * np.linalg.norm(v, axis=1)[:, None])

    return Hidden(effort, {"drag": 1.0})


def touch(site: Site) -> Hidden:
    """Return a push at a point of a body during a few seconds, as of leaning on something soft."""
    return _push(site, turning=False)


def jet(site: Site) -> Hidden:
    """Return the same of a jet or a tool, whose force turns with the body."""
    return _push(site, turning=True)


def _push(site: Site, *, turning: bool) -> Hidden:
    point, direction = site.rng.uniform(-0.1, 0.1, 3), site.rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    begin, length = site.rng.uniform(0.2, 0.7), site.rng.uniform(2.0, 4.0)

    def effort(seen: Seen, size: float) -> Array:
        J = seen.engine.jacobians(site.joint, point, seen.q)[:, :3]
        s = np.clip((seen.time - begin * seen.time[-1]) / length, 0.0, 1.0)
        push = np.minimum(1.0, 4.0 * np.sin(np.pi * s))
        along = np.broadcast_to(direction, (len(J), 3))
        if turning:
            along = seen.engine.rotations(site.joint, seen.q) @ direction
        return size * push[:, None] * np.einsum("nij,ni->nj", J, along)

    return Hidden(effort)


def soft_gear(site: Site) -> Hidden:
    """A gear that gives way: the link lags behind the logged motor by compliance times load."""

    def effort(seen: Seen, size: float) -> Array:
        load = seen.load[:, site.joint]
        lag = min(size, _SOFTEST / float(np.abs(load).max())) * load
        rate = np.gradient(lag, seen.time)
        bend = np.gradient(rate, seen.time)
        return _with_lag(seen, site.joint, lag=lag, rate=rate, acceleration=bend)

    return Hidden(effort)


def loose_gear(site: Site) -> Hidden:
    """A gear with play: between its stiff and damped flanks, the link moves by its load alone."""

    def effort(seen: Seen, size: float) -> Array:
        j = site.joint
        unit, still = np.zeros_like(seen.a), np.zeros_like(seen.v)
        unit[:, j] = 1.0
        weight = seen.engine.efforts(seen.q, still, still)
        inertia = (seen.engine.efforts(seen.q, still, unit) - weight)[:, j]
        lag, rate, bend = _play(seen.load[:, j], inertia, gap=size, time=seen.time)
        return _with_lag(seen, j, lag=lag, rate=rate, acceleration=bend)

    return Hidden(effort)


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
    lags, rates, accelerations = [], [], []
    for pull, mass in zip(pulls.tolist(), masses.tolist(), strict=True):
        dent = s - gap if s > gap else s + gap if s < -gap else 0.0
        flank = stiffness * dent + damping * rate if dent else 0.0
        if flank * dent < 0.0:  # a flank does not hold back
            flank = 0.0
        acceleration = (pull - flank) / mass
        rate += dt * acceleration
        s += dt * rate
        lags.append(s)
        rates.append(rate)
        accelerations.append(acceleration)
    lag, speed, push = (
        uniform_filter1d(signal, steps, mode="nearest")[::steps]
        for signal in (lags, rates, accelerations)
    )
    return lag, speed, push


def _with_lag(seen: Seen, joint: int, *, lag: Array, rate: Array, acceleration: Array) -> Array:
    """Return the (N, n) change in effort because links lag behind their motors."""
    motion = [seen.q.copy(), seen.v.copy(), seen.a.copy()]
    for signal, behind in zip(motion, (lag, rate, acceleration), strict=True):
        signal[:, joint] -= behind
    return seen.engine.efforts(*motion) - seen.load


OWN, OTHER, ANY, TIME = "own", "other", "any", "time"


@dataclass(frozen=True, eq=False)
class Outside:
    """An effect of no catalogue."""

    name: str
    make: Callable[[Site], Hidden]
    # What a correlate is to name: pairs of a joint (its own, the other, any) and one of its
    # signals, "position" or "speed"; or the time.
    follows: tuple[tuple[str, str], ...]
    in_link: bool = False  # whether it sits in a link, and acts on all joints up to it
    in_space: bool = False  # whether a planar robot does not feel it


def _end_stop(site: Site) -> Hidden:
    share = site.rng.uniform(0.55, 0.75)

    def law(own: Signals, other: Signals) -> Array:
        edge = own.q.min() + share * np.ptp(own.q)
        return np.logaddexp(0.0, (own.q - edge) / 0.02)

    return joint_law(law)(site)


def _clock(site: Site) -> Hidden:
    frequency, phase = site.rng.uniform(0.7, 3.0), site.rng.uniform(0.0, 2.0 * np.pi)
    return joint_law(lambda own, other: np.sin(2.0 * np.pi * frequency * own.time + phase))(site)


def _wheel(site: Site) -> Hidden:
    """A wheel that spins about an axis of its link, whose turning it resists: τ = Jᵀ (ω × h)."""
    axis = site.rng.normal(size=3)
    axis /= np.linalg.norm(axis)

    def effort(seen: Seen, size: float) -> Array:
        J = seen.engine.jacobians(site.joint, np.zeros(3), seen.q)
        spin = np.einsum("nij,nj->ni", J[:, 3:], seen.v)
        along = seen.engine.rotations(site.joint, seen.q) @ axis
        return size * np.einsum("nij,ni->nj", J[:, 3:], np.cross(spin, along))

    return Hidden(effort)


def _hose(site: Site) -> Hidden:
    phase = site.rng.uniform(0.0, 2.0 * np.pi)
    return joint_law(lambda own, other: np.cos(1.5 * (own.q + other.q) - phase))(site)


_brake = joint_law(lambda own, other: (1.2 + np.sin(2.0 * other.q)) * smooth_sign(own.v))
_neighbour = joint_law(lambda own, other: np.abs(other.v) * smooth_sign(own.v))
_damper = joint_law(lambda own, other: (other.q - other.q.mean()) * own.v)

OUTSIDE = {
    kind.name: kind
    for kind in (
        Outside("brake that another joint's position tightens", _brake, ((OTHER, "position"),)),
        Outside("spring past an angle", _end_stop, ((OWN, "position"),)),
        Outside("friction of a neighbour's speed", _neighbour, ((OTHER, "speed"),)),
        Outside("oscillation in time", _clock, ((TIME, TIME),)),
        Outside("spinning wheel in a link", _wheel, ((ANY, "speed"),), True, True),
        Outside("hose on the sum of two angles", _hose, ((OTHER, "position"),)),
        Outside("damper that another joint opens", _damper, ((OTHER, "position"),)),
    )
}
"""Effects by name."""


COLOURED = "coloured"
DRY, WET = "coulomb_friction", "viscous_friction"

_ALL = (
    Truth(WET, JOINT, joint_law(lambda own, other: own.v, viscous=1.0)),
    Truth(DRY, JOINT, joint_law(lambda own, other: smooth_sign(own.v), coulomb=1.0)),
    Truth("asymmetric_friction", JOINT, asymmetric),
    Truth("stribeck_friction", JOINT, stribeck, (DRY, WET), alone=True),
    Truth("nonlinear_viscous_friction", JOINT, nonlinear_viscous),
    Truth(
        "load_dependent_friction",
        JOINT,
        joint_law(lambda own, other: abs(own.load) * smooth_sign(own.v), load_factor=1.0),
    ),
    Truth("coupled_friction", PAIR, belt),
    Truth("friction_drift", JOINT, warming, (DRY, WET), alone=True),
    Truth("hysteresis", JOINT, hysteresis, alone=True),
    Truth("effort_offset", JOINT, joint_law(lambda own, other: 0.0 * own.q + 1.0, offset=1.0)),
    Truth(
        "effort_scale",
        JOINT,
        joint_law(lambda own, other: own.load, gain_error=1.0),
        needs_known_inertia=True,
        alone=True,
    ),
    Truth("effort_delay", ROBOT, late, unit=0.01, largest=0.03),
    Truth("joint_spring", JOINT, spring),
    Truth("gravity_compensator", JOINT, compensator),
    Truth("torque_ripple", JOINT, cogging),
    Truth("rotor_inertia", JOINT, joint_law(lambda own, other: own.a, inertia=1.0)),
    Truth("coupled_rotor_inertia", PAIR, coupled_rotor, ("rotor_inertia",), alone=True),
    Truth("joint_elasticity", JOINT, soft_gear, unit=1e-4, alone=True),
    Truth("backlash", JOINT, loose_gear, unit=1e-3, largest=0.02, alone=True, reverses=True),
    Truth("payload", BODY, payload),
    Truth("wrong_inertia", BODY, wrong_body, unit=0.5, largest=2.0, alone=True),
    Truth("gravity_tilt", ROBOT, tilt, unit=0.05, largest=0.2, alone=True),
    Truth("contact", BODY, touch, alone=True),
    Truth("aerodynamic_drag", BODY, drag, alone=True),
)

_KNOWN = {effect.name for effect in catalogue()} | {"wrong_inertia"}

TRUTHS = {truth.name: truth for truth in _ALL if truth.name in _KNOWN}
"""Effects by name; those that geodrake does not know yet are left out."""

KINDS = {
    "wrench that turns with its body": (Truth("contact", BODY, jet), {}),
    "friction that fades to nothing": (Truth("friction_drift", JOINT, running_in, (DRY, WET)), {}),
    "delay in slow motion, coloured noise": (
        TRUTHS["effort_delay"],
        {"motion": SLOW, "colour": COLOURED},
    ),
    "tilt": (TRUTHS["gravity_tilt"], {}),
}
"""Kinds that other engines' logs showed to be hard, each with what of the draws is given."""


def truth_of(name: str) -> Truth | Outside:
    """Return what is hidden by a name of any of the tables."""
    return TRUTHS.get(name) or (KINDS[name][0] if name in KINDS else OUTSIDE[name])
