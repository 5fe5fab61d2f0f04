"""Hidden effects of bodies and of the whole robot: by the engine's bodies, gravity, Jacobians."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from diagrams.benchmarks.hidden.engines import GRAVITY, congruent, pseudo
from diagrams.benchmarks.hidden.truths import Array, Hidden, Seen, Site

_SOFTEST = 0.05  # rad, to which a gear gives way at most
_DENT = 0.05  # of the gap, that a flank gives way under the largest load


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
    return _push(site, turning=False)


def jet(site: Site) -> Hidden:
    """The same of a jet or a tool, whose force turns with the body."""
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
    """Lag (N,) of a link within a gap of half width `gap`, its rate and acceleration.

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
    """(N, n) effort that it makes a difference of that a link lags behind its motor."""
    motion = [seen.q.copy(), seen.v.copy(), seen.a.copy()]
    for signal, behind in zip(motion, (lag, rate, acceleration), strict=True):
        signal[:, joint] -= behind
    return seen.engine.efforts(*motion) - seen.load
