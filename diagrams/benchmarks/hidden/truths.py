"""What logs can hide: effects of geodrake's catalogue, in formulas of their own.

A truth says where it acts, and gives its effort for a size of one; the benchmark scales that to a
share of the joint's effort. The table of them is in `hidden.table`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from diagrams.benchmarks.hidden.engines import Engine

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

    def zeros(self) -> Array:
        """No effort."""
        return np.zeros_like(self.q)

    def at(self, joint: int, values: Array) -> Array:
        """(N, n) effort of a joint."""
        effort = self.zeros()
        effort[:, joint] = values
        return effort


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
    """One hidden effect.

    Attributes:
        effort: Its effort by size.
        values: What geodrake should find by name, as multiples of the size.
    """

    effort: Effort
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Truth:
    """An effect of the catalogue that a log may hide.

    Attributes:
        name: Its name there.
        places: What it acts on: "joint", "pair", "body" or "robot".
        make: Draws one at a site.
        companions: Effects that it comes with, which are no mistakes.
        unit: A usual size, from which that of a wanted share is sought.
        largest: Largest size, where formulas or geodrake's range end.
        needs_known_inertia: Whether the model must have been fitted to another log first.
        alone: Whether it is left out of pairs.
        reverses: Whether it shows only at a joint whose load changes its sign.
    """

    name: str
    places: str
    make: Callable[[Site], Hidden]
    companions: tuple[str, ...] = ()
    unit: float = 1.0
    largest: float = np.inf
    needs_known_inertia: bool = False
    alone: bool = False
    reverses: bool = False


def smooth_sign(v: Array) -> Array:
    """Direction of motion, v / √(v² + ε²)."""
    return np.asarray(v / np.hypot(v, _BREAKAWAY))


def joint_law(
    law: Callable[[Array, Array, Array, Array], Array], **values: float
) -> Callable[[Site], Hidden]:
    """A truth whose effort is a function of q, v, a and load of its joint."""

    def make(site: Site) -> Hidden:
        j = site.joint

        def effort(seen: Seen, size: float) -> Array:
            signals = (seen.q[:, j], seen.v[:, j], seen.a[:, j], seen.load[:, j])
            return seen.at(j, size * law(*signals))

        return Hidden(effort, values)

    return make


def asymmetric(site: Site) -> Hidden:
    """Friction whose height and slope are larger by the same share in one direction."""
    skew = site.rng.uniform(0.25, 0.6) * site.rng.choice([-1.0, 1.0])
    levels = {"coulomb_positive": 1.0 + skew, "coulomb_negative": 1.0 - skew}

    def law(q: Array, v: Array, a: Array, load: Array) -> Array:
        direction = smooth_sign(v)
        return (1.0 + skew * direction) * (direction + v / np.abs(v).max())

    return joint_law(law, **levels)(site)


def stribeck(site: Site) -> Hidden:
    """A dip as 1 / (1 + (v/vs)²) and not as an exponential."""
    excess, share = site.rng.uniform(0.6, 1.2), site.rng.uniform(0.05, 0.2)

    def law(q: Array, v: Array, a: Array, load: Array) -> Array:
        dip = 1.0 / (1.0 + (v / (share * np.abs(v).max())) ** 2)
        return smooth_sign(v) * (1.0 + excess * dip)

    return joint_law(law)(site)


def nonlinear_viscous(site: Site) -> Hidden:
    """A power of the speed that is smooth about zero."""
    power = site.rng.uniform(1.6, 2.6)
    return joint_law(lambda q, v, a, load: v * np.hypot(v, 1e-3) ** (power - 1.0))(site)


def belt(site: Site) -> Hidden:
    """Dry and viscous friction of a motor that turns with v_i ± v_j."""
    sign = site.rng.choice([-1.0, 1.0])

    def effort(seen: Seen, size: float) -> Array:
        w = seen.v[:, site.joint] + sign * seen.v[:, site.other]
        torque = size * (smooth_sign(w) + 0.5 * w / np.abs(w).max())
        return seen.at(site.joint, torque) + seen.at(site.other, sign * torque)

    return Hidden(effort)


def coupled_rotor(site: Site) -> Hidden:
    """A rotor that turns with the difference of two joints, [1, −1]ᵀ I (v̇_i − v̇_j).

    One that turns with the sum is the same as a heavier link where two axes are parallel.
    """

    def effort(seen: Seen, size: float) -> Array:
        torque = size * (seen.a[:, site.joint] - seen.a[:, site.other])
        return seen.at(site.joint, torque) - seen.at(site.other, torque)

    return Hidden(effort, {"inertia": -1.0})


def warming(site: Site) -> Hidden:
    """Friction that falls as 1 / (1 + t / T)."""
    time_constant = site.rng.uniform(5.0, 10.0)

    def effort(seen: Seen, size: float) -> Array:
        v = seen.v[:, site.joint]
        warm = 0.5 + 1.0 / (1.0 + seen.time / time_constant)
        return seen.at(site.joint, size * warm * (smooth_sign(v) + 0.7 * v))

    return Hidden(effort)


def running_in(site: Site) -> Hidden:
    """Friction that falls as 1 / (1 + t / T)³, to nothing."""
    time_constant = site.rng.uniform(5.0, 10.0)

    def effort(seen: Seen, size: float) -> Array:
        v = seen.v[:, site.joint]
        left = (1.0 + seen.time / time_constant) ** -3
        return seen.at(site.joint, size * left * (smooth_sign(v) + 0.7 * v))

    return Hidden(effort)


def gain(site: Site) -> Hidden:
    """A torque constant that is off."""

    def effort(seen: Seen, size: float) -> Array:
        return seen.at(site.joint, size * seen.load[:, site.joint])

    return Hidden(effort, {"gain_error": 1.0})


def late(site: Site) -> Hidden:
    """Efforts by interpolation between those of earlier samples."""
    del site

    def effort(seen: Seen, size: float) -> Array:
        columns = [np.interp(seen.time - size, seen.time, u) for u in seen.load.T]
        return np.stack(columns, 1) - seen.load

    return Hidden(effort, {"delay": 1.0})


def spring(site: Site) -> Hidden:
    """A spring by its rest position."""
    rest = site.rng.uniform(-1.0, 1.0)
    return joint_law(lambda q, v, a, load: q - rest, stiffness=1.0)(site)


def compensator(site: Site) -> Hidden:
    """A spring of zero free length between two cranks: its force times its lever."""
    at, r, s = site.rng.uniform(-np.pi, np.pi), 0.05, 0.3

    def law(q: Array, v: Array, a: Array, load: Array) -> Array:
        length = np.sqrt(r * r + s * s - 2.0 * r * s * np.cos(q - at))
        lever = r * s * np.sin(q - at) / length
        return length * lever / (r * s)

    return joint_law(law)(site)


def cogging(site: Site) -> Hidden:
    """Waves over the position, of which the motion passes a few."""
    waves, phase = site.rng.uniform(2.5, 12.0), site.rng.uniform(0.0, 2.0 * np.pi)

    def law(q: Array, v: Array, a: Array, load: Array) -> Array:
        return np.asarray(np.cos(2.0 * np.pi * waves * q / np.ptp(q) - phase))

    return joint_law(law)(site)


def hysteresis(site: Site) -> Hidden:
    """Spring-and-slider elements that begin to slip one after the other (Maxwell slip)."""
    widths = site.rng.uniform(0.01, 0.03) * np.arange(1, 9)

    def effort(seen: Seen, size: float) -> Array:
        q = seen.q[:, site.joint]
        stretch, found = np.zeros(len(widths)), np.zeros(len(q))
        for k in range(1, len(q)):
            stretch = np.clip(stretch + q[k] - q[k - 1], -widths, widths)
            found[k] = np.mean(stretch / widths)
        return seen.at(site.joint, size * found)

    return Hidden(effort)
