"""Effects that no catalogue has, by MuJoCo and formulas: no name is right for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from diagrams.benchmarks.hidden.body_truths import with_bodies
from diagrams.benchmarks.hidden.engines import pseudo
from diagrams.benchmarks.hidden.robots import RobotFile
from diagrams.benchmarks.hidden.truths import Array, Effort, Seen, smooth_sign

_FINE = 1e-3  # s, longest step of a pendulum


@dataclass(frozen=True, eq=False)
class Site:
    """Where an effect acts, and what is known of the robot's motions, the same for all logs.

    Attributes:
        joint, other: Numbers of its joints.
        file: The robot's model file.
        center, half: (n,) middle and half width of the positions of the motions, rad.
        speed: (n,) highest speeds, rad/s.
        load: (n,) largest efforts, N·m.
        rng: What is random.
    """

    joint: int
    other: int
    file: RobotFile
    center: Array
    half: Array
    speed: Array
    load: Array
    rng: np.random.Generator

    def place(self, seen: Seen, joint: int) -> Array:
        """(N,) position of a joint in the range of its motions, from −1 to 1."""
        return np.asarray((seen.q[:, joint] - self.center[joint]) / self.half[joint])


@dataclass(frozen=True, eq=False)
class Kind:
    """An effect of no catalogue.

    Attributes:
        make: Draws one at a site.
        comes_with: Names that are right beside it, at its joint: it has a part that they describe.
        largest: Largest size.
    """

    make: Callable[[Site], Effort]
    comes_with: tuple[str, ...] = ()
    largest: float = np.inf


def _cubic_coupling(site: Site) -> Effort:
    """A spring between two joints of energy x y³."""

    def effort(seen: Seen, size: float) -> Array:
        x, y = site.place(seen, site.joint), site.place(seen, site.other)
        return size * (seen.at(site.joint, y**3) + seen.at(site.other, 3.0 * x * y**2))

    return effort


def _growing_friction(site: Site) -> Effort:
    def effort(seen: Seen, size: float) -> Array:
        grip = 1.2 + site.place(seen, site.joint)
        return seen.at(site.joint, size * grip * smooth_sign(seen.v[:, site.joint]))

    return effort


def _pendulum(site: Site) -> Effort:
    """A weight that swings in a link, less the same weight at the hinge, where the file has it.

    A weight that hangs quietly pulls at its hinge: what is left is the swing.
    """
    length, damping = site.rng.uniform(0.05, 0.2), site.rng.uniform(0.05, 0.3)
    spec = mujoco.MjSpec.from_string(site.file.text)
    axis, at = site.rng.normal(size=3), site.rng.uniform(-0.1, 0.1, 3)
    down = np.cross(axis, site.rng.normal(size=3))
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

    def needed(motion: tuple[Array, Array, Array], swing: tuple[float, float, float]) -> Array:
        signals = (data.qpos, data.qvel, data.qacc)
        for signal, values, own in zip(signals, motion, swing, strict=True):
            signal[arm], signal[free] = values, own
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse.copy()

    def effort(seen: Seen, size: float) -> Array:
        period = float(np.median(np.diff(seen.time)))
        steps = int(np.ceil(period / _FINE))
        found, angle, rate = seen.zeros(), 0.0, 0.0
        ahead = [np.vstack([x[1:], x[-1:]]) for x in (seen.q, seen.v, seen.a)]
        for k in range(len(found)):
            now = (seen.q[k], seen.v[k], seen.a[k])
            for i in range(steps):
                part = i / steps
                between = tuple(
                    (1.0 - part) * x + part * y[k] for x, y in zip(now, ahead, strict=True)
                )
                torque = needed(between, (angle, rate, 0.0))  # type: ignore[arg-type]
                bend = -(drag * rate + torque[free]) / inertia
                if i == 0:
                    found[k] = needed(now, (angle, rate, bend))[arm]
                rate += bend * period / steps
                angle += rate * period / steps
        bodies = seen.engine.bodies()
        bodies[site.joint] += pseudo(1.0, at, 1e-4 * np.eye(3))
        return size * (found - seen.load - with_bodies(seen, bodies))

    return effort


def _saturation(site: Site) -> Effort:
    """What a drive commands more and its motor does not give, at high speed under load."""
    edge = site.rng.uniform(0.5, 0.8)

    def effort(seen: Seen, size: float) -> Array:
        load = seen.load[:, site.joint]
        power = np.abs(seen.v[:, site.joint]) / site.speed[site.joint]
        beyond = np.logaddexp(0.0, (power + np.abs(load) / site.load[site.joint] - edge) / 0.05)
        return seen.at(site.joint, size * np.sign(load) * beyond * np.abs(load))

    return effort


def _taut_hose(site: Site) -> Effort:
    """A hose on the difference of two angles, which pulls only when it is taut."""
    slack = site.rng.uniform(0.1, 0.5)

    def effort(seen: Seen, size: float) -> Array:
        stretch = site.place(seen, site.joint) - site.place(seen, site.other)
        pull = size * 0.05 * np.logaddexp(0.0, (stretch - slack) / 0.05)
        return seen.at(site.joint, pull) - seen.at(site.other, pull)

    return effort


def _slipping_belt(site: Site) -> Effort:
    """A link that falls behind its motor by a little more each time the load is high."""
    most = site.rng.uniform(0.4, 0.7)

    def effort(seen: Seen, size: float) -> Array:
        over = np.abs(seen.load[:, site.joint]) / site.load[site.joint] - most
        rate = size * np.maximum(over, 0.0) * np.sign(seen.load[:, site.joint])
        behind = np.cumsum(rate * np.gradient(seen.time))
        q, v = seen.q.copy(), seen.v.copy()
        q[:, site.joint] -= behind
        v[:, site.joint] -= rate
        return seen.engine.efforts(q, v, seen.a) - seen.load

    return effort


def _cable_drag(site: Site) -> Effort:
    """A cable that drags in one direction only, in some postures more."""
    phase = site.rng.uniform(0.0, 2.0 * np.pi)

    def effort(seen: Seen, size: float) -> Array:
        going = 0.5 * (1.0 + smooth_sign(seen.v[:, site.joint]))
        posture = np.cos(2.5 * site.place(seen, site.joint) - phase)
        return seen.at(site.joint, size * going * posture)

    return effort


def _eccentric_gear(site: Site) -> Effort:
    waves, phase = site.rng.uniform(3.0, 9.0), site.rng.uniform(0.0, 2.0 * np.pi)

    def effort(seen: Seen, size: float) -> Array:
        turn = seen.q[:, site.joint] + seen.q[:, site.other]
        wave = size * np.sin(waves * turn + phase)
        return seen.at(site.joint, wave) + seen.at(site.other, wave)

    return effort


def _sticking_places(site: Site) -> Effort:
    places = site.rng.uniform(-0.8, 0.8, 4)

    def effort(seen: Seen, size: float) -> Array:
        away = (site.place(seen, site.joint)[:, None] - places) / 0.05
        grip = np.exp(-0.5 * away**2).sum(1)
        return seen.at(site.joint, size * grip * smooth_sign(seen.v[:, site.joint]))

    return effort


def _neighbours_square(site: Site) -> Effort:
    def effort(seen: Seen, size: float) -> Array:
        other = seen.v[:, site.other] / site.speed[site.other]
        return seen.at(site.joint, size * other**2)

    return effort


KINDS = {
    "cubic coupling of two joints": Kind(_cubic_coupling),
    "friction that grows with position": Kind(_growing_friction, ("coulomb_friction",)),
    "pendulum in a link": Kind(_pendulum),
    "motor that saturates at high speed": Kind(_saturation),
    "taut hose on a difference of angles": Kind(_taut_hose),
    "slipping belt": Kind(_slipping_belt, largest=2.0),
    "cable that drags in one direction": Kind(_cable_drag),
    "eccentric gear on a sum of angles": Kind(_eccentric_gear),
    "a few places that stick": Kind(_sticking_places),
    "square of another joint's speed": Kind(_neighbours_square),
}
"""Effects by name."""
