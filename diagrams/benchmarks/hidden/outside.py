"""Hidden effects that geodrake has no name for: it is to say so, where, and with what they go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from diagrams.benchmarks.hidden.truths import Array, Hidden, Seen, Site, smooth_sign

OWN, OTHER, ANY, TIME = "own", "other", "any", "time"


@dataclass(frozen=True, eq=False)
class Outside:
    """An effect of no catalogue.

    Attributes:
        name: What it is.
        make: Draws one at a site.
        follows: What a correlate is to name: pairs of a joint (its own, the other, any) and one of
            its signals, "position" or "speed"; or the time.
        in_link: Whether it sits in a link, and acts on all joints up to it.
        in_space: Whether a planar robot does not feel it.
    """

    name: str
    make: Callable[[Site], Hidden]
    follows: tuple[tuple[str, str], ...]
    in_link: bool = False
    in_space: bool = False


def _brake(site: Site) -> Hidden:
    def effort(seen: Seen, size: float) -> Array:
        grip = 1.2 + np.sin(2.0 * seen.q[:, site.other])
        return seen.at(site.joint, size * grip * smooth_sign(seen.v[:, site.joint]))

    return Hidden(effort)


def _end_stop(site: Site) -> Hidden:
    share = site.rng.uniform(0.55, 0.75)

    def effort(seen: Seen, size: float) -> Array:
        q = seen.q[:, site.joint]
        edge = q.min() + share * np.ptp(q)
        return seen.at(site.joint, size * np.logaddexp(0.0, (q - edge) / 0.02))

    return Hidden(effort)


def _neighbour(site: Site) -> Hidden:
    def effort(seen: Seen, size: float) -> Array:
        v, other = seen.v[:, site.joint], seen.v[:, site.other]
        return seen.at(site.joint, size * np.abs(other) * smooth_sign(v))

    return Hidden(effort)


def _clock(site: Site) -> Hidden:
    frequency, phase = site.rng.uniform(0.7, 3.0), site.rng.uniform(0.0, 2.0 * np.pi)

    def effort(seen: Seen, size: float) -> Array:
        return seen.at(site.joint, size * np.sin(2.0 * np.pi * frequency * seen.time + phase))

    return Hidden(effort)


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

    def effort(seen: Seen, size: float) -> Array:
        angle = 1.5 * (seen.q[:, site.joint] + seen.q[:, site.other])
        return seen.at(site.joint, size * np.cos(angle - phase))

    return Hidden(effort)


def _damper(site: Site) -> Hidden:
    def effort(seen: Seen, size: float) -> Array:
        opening = seen.q[:, site.other] - seen.q[:, site.other].mean()
        return seen.at(site.joint, size * opening * seen.v[:, site.joint])

    return Hidden(effort)


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
