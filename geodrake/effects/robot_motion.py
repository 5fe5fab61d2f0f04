"""Motion as effects see it: by joint, with the rigid bodies' effort as load."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import ArgumentError
from geodrake.robot.effort_slopes import EffortSlopes, effort_slopes

Array = NDArray[np.float64]
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class JointMotion(Short):
    """Motion of one joint, each field (N,), on which joint effects depend.

    Attributes:
        q: Position, rad or m.
        v: Velocity, rad/s or m/s.
        vd: Acceleration, rad/s² or m/s².
        load: Effort the rigid-body model needs at this joint, N·m or N (never the measured one).
        sign_v: Direction of motion in [-1, 1]: sgn(v), smoothed where |v| is too small to tell.
    """

    q: Array
    v: Array
    vd: Array
    load: Array
    sign_v: Array


@dataclass(frozen=True, eq=False)
class RobotMotion(Short):
    """Motion of all joints over N samples, as effects see it.

    Attributes:
        joints: Names of the nv velocities.
        q: (N, nv) position belonging to each velocity (NaN for joints of several degrees).
        v: (N, nv) velocities.
        vd: (N, nv) accelerations.
        load: (N, nv) effort that the rigid-body model needs.
        sign_width: (nv,) speed below which the direction of motion is not known.
        body_columns: Maps a body name to its (N, nv, 10) inertial regressor.
        bodies: Poses and Jacobians of the bodies; None where nobody computes them.
        time: (N,) instants since the log began, s; None where samples are no series.
        log: Number that tells a log from others, from `log_number`; 0 for none.
        before: (M, nv) positions right before the first sample, none at the start of a log; None
            where samples do not follow each other in time.
        states: Effect -> (N, s) its hidden state, where it is known, as in a simulation.
        effort: Gives the effort (N, nv) that the model needs with all its effects, scales left
            aside; None where nobody computes it.
        temperature: (N, nv) temperatures of motors or gears, °C; NaN where one is not known, None
            where none is.
        bandwidth: Up to which efforts show the motion, Hz; infinite for a motion without noise.
        acceleration_noise: (nv,) deviation of the noise that accelerations have below it.
    """

    joints: tuple[str, ...]
    q: Array
    v: Array
    vd: Array
    load: Array
    sign_width: Array
    body_columns: Callable[[str], Array]
    bodies: RobotBodies | None = None
    time: Array | None = None
    log: int = 0
    effort: Callable[[], Array] | None = None
    before: Array | None = None
    states: Mapping[Any, Array] = field(default_factory=dict)
    temperature: Array | None = None
    bandwidth: float = np.inf
    acceleration_noise: Array | float = 0.0

    def joint(self, name: str) -> JointMotion:
        """Return the motion of one joint, which may be one behind a transmission or in a loop.

        Nothing tells what load such a joint has: it is 0 there.

        Raises:
            ArgumentError: There is no such joint.
        """
        return self.once((JointMotion, name), lambda: self._joint(name))

    def once(self, key: tuple[Any, str], make: Callable[[], T]) -> T:
        """Return what effects of several shapes make of the motion, made when first asked for."""
        if key not in self._made:
            self._made[key] = make()
        return cast(T, self._made[key])

    @cached_property
    def _made(self) -> dict[tuple[Any, str], Any]:
        return {}

    def _joint(self, name: str) -> JointMotion:
        if (found := self._behind(name)) is not None:
            (theta, rates, accelerations, J), at = found
            v, width = rates[:, at], np.abs(J[:, at]) @ self.sign_width
            sign_v = self.direction(v, width)
            return JointMotion(theta[:, at], v, accelerations[:, at], np.zeros_like(v), sign_v)
        i = self.index(name)
        v = self.v[:, i]
        return JointMotion(
            self.q[:, i], v, self.vd[:, i], self.load[:, i], self.direction(v, self.sign_width[i])
        )

    def efforts_at(self, name: str, columns: Array) -> Mapping[str, Array]:
        """Columns by joint, of those (N, k) of efforts at one joint, τ_q = Jᵀ τ_θ."""
        if (found := self._behind(name)) is None:
            return {name: columns}
        (*_, J), at = found
        moving = np.flatnonzero(J[:, at].any(axis=0))
        return {self.joints[i]: J[:, at, i, None] * columns for i in moving}

    def at_both(self, joints: tuple[str, str], first: Array, second: Array) -> Mapping[str, Array]:
        """Return columns by joint, of those (N, k) of efforts at two joints."""
        found = dict(self.efforts_at(joints[0], first))
        for joint, columns in self.efforts_at(joints[1], second).items():
            found[joint] = found[joint] + columns if joint in found else columns
        return found

    def _behind(self, name: str) -> tuple[tuple[Array, Array, Array, Array], int] | None:
        """Return the motion of the tree and the index of a joint behind a transmission, or None."""
        if name in self.joints or self.bodies is None:
            return None
        places = self.bodies.joints_behind
        return (self._tree, places[name]) if name in places else None

    @cached_property
    def _tree(self) -> tuple[Array, Array, Array, Array]:
        """Positions, velocities and accelerations of the tree's joints, and J."""
        bodies = self.body_motions("A joint behind a transmission")
        return bodies.tree_samples(self.v, self.vd)

    def index(self, name: str) -> int:
        """Return the column of a joint; raise an ArgumentError if it does not exist."""
        if name not in self.joints:
            raise ArgumentError(
                f"There is no joint {name!r}.", advice=f"Joints are {', '.join(self.joints)}."
            )
        return self.joints.index(name)

    def warmer(self, name: str, reference: float) -> Array:
        """Return (N,) degrees by which a joint is warmer than a reference, °C; 0 where unknown."""
        if self.temperature is None:
            return np.zeros(len(self.v))
        own = self.temperature[:, self.index(name)]
        if own.dtype != object:
            return np.nan_to_num(own - reference)
        unknown = [isinstance(value, float) and np.isnan(value) for value in own]
        return np.asarray(np.where(unknown, reference, own) - reference)

    def body_motions(self, effect: str) -> RobotBodies:
        """Return the bodies' poses and Jacobians.

        Args:
            effect: Name of the effect that needs them, for the message.

        Raises:
            ArgumentError: Nobody computes them here.
        """
        if self.bodies is None:
            raise ArgumentError(
                f"{effect} needs poses of bodies, which are unknown here.",
                advice="Remove it from the model here.",
            )
        return self.bodies

    @cached_property
    def effort_slopes(self) -> EffortSlopes:
        """Slopes of the bodies' effort with the motion.

        Raises:
            ArgumentError: Nobody knows the bodies here.
        """
        bodies = self.body_motions("An elastic or loose joint")
        return effort_slopes(bodies.tree, bodies.q, self.v, self.vd, bodies.phi)

    @staticmethod
    def direction(v: Array, width: float | Array) -> Array:
        """Return smoothed signs of velocities, tanh(v / width); plain ones where the width is 0."""
        width = np.asarray(width)
        if width.all():
            return np.tanh(v / width)
        return np.where(width == 0, np.sign(v), np.tanh(v / np.where(width == 0, 1.0, width)))


def smoothed_sign(width: Array) -> Callable[[Array], Array]:
    """`RobotMotion.direction` for widths (nv,) of all velocities, ready to be called often."""
    if (width > 0).all():
        return lambda v: np.tanh(v / width)
    return lambda v: RobotMotion.direction(v, width)


def log_number(name: str) -> int:
    """Return a number that identifies a log by its name."""
    return zlib.crc32(name.encode(errors="surrogatepass")) or 1
