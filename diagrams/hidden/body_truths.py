"""Hidden effects of bodies and of the whole robot: by the engine's bodies, gravity, Jacobians."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hidden.engines import GRAVITY, congruent, pseudo
from hidden.truths import Array, Hidden, Seen, Site


def with_bodies(seen: Seen, bodies: Array) -> Array:
    """(N, n) effort that the robot needs more with other bodies."""
    before = seen.engine.bodies()
    seen.engine.set_bodies(bodies)
    effort = seen.engine.efforts(seen.q, seen.v, seen.a) - seen.load
    seen.engine.set_bodies(before)
    return effort


def payload(site: Site) -> Hidden:
    """A ball that the last link holds; its size is its mass."""
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
    """A base turned about a horizontal axis; its size is the angle."""
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
    """Drag at a point of a body, by the engine's Jacobian."""
    point = site.rng.uniform(-0.1, 0.1, 3)

    def effort(seen: Seen, size: float) -> Array:
        J = seen.engine.jacobians(site.joint, point, seen.q)[:, :3]
        v = np.einsum("nij,nj->ni", J, seen.v)
        return size * np.einsum("nij,ni->nj", J, v * np.linalg.norm(v, axis=1)[:, None])

    return Hidden(effort, {"drag": 1.0})


def touch(site: Site) -> Hidden:
    """A push at a point of a body during a few seconds, as of leaning on something soft."""
    point, direction = site.rng.uniform(-0.1, 0.1, 3), site.rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    begin, length = site.rng.uniform(0.2, 0.7), site.rng.uniform(2.0, 4.0)

    def effort(seen: Seen, size: float) -> Array:
        J = seen.engine.jacobians(site.joint, point, seen.q)[:, :3]
        s = np.clip((seen.time - begin * seen.time[-1]) / length, 0.0, 1.0)
        push = np.minimum(1.0, 4.0 * np.sin(np.pi * s))
        return size * push[:, None] * np.einsum("nij,i->nj", J, direction)

    return Hidden(effort)


def soft_gear(site: Site) -> Hidden:
    """A gear that gives way: the link lags behind the logged motor by compliance times load."""
    return _lagging_link(site, lambda load: load)


def loose_gear(site: Site) -> Hidden:
    """A gear with play: the link is half of it ahead or behind, as the load pushes."""
    return _lagging_link(site, lambda load: np.tanh(load / (0.1 * load.std())))


def _lagging_link(site: Site, lag: Callable[[Array], Array]) -> Hidden:
    def effort(seen: Seen, size: float) -> Array:
        motion = [seen.q.copy(), seen.v.copy(), seen.a.copy()]
        behind = size * lag(seen.load[:, site.joint])
        for signal in motion:
            signal[:, site.joint] -= behind
            behind = np.gradient(behind, seen.time)
        return seen.engine.efforts(*motion) - seen.load

    return Hidden(effort)
