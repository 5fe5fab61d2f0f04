"""Robot and joint motion, the input of effects."""

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
    """Motion of one joint, each field (N,), the input of joint effects.

    Attributes:
        q: Position, rad or m.
        v: Velocity, rad/s or m/s.
        vd: Acceleration, rad/s² or m/s².
        load: Effort that the rigid-body model needs (not the measured one), N·m or N.
        sign_v: Direction of motion in [-1, 1]: sgn(v), smoothed at low speed.
    """

    q: Array
    v: Array
    vd: Array
    load: Array
    sign_v: Array


@dataclass(frozen=True, eq=False)
class RobotMotion(Short):
    """Motion of all joints over N samples, the input of effects.

    Attributes:
        joints: Names of the nv velocities.
        q: (N, nv) position belonging to each velocity (NaN for joints of several degrees).
        v: (N, nv) velocities.
        vd: (N, nv) accelerations.
        load: (N, nv) effort that the rigid-body model needs.
        sign_width: (nv,) speed below which the direction of motion is uncertain.
        body_columns: Maps a body name to its (N, nv, 10) inertial regressor.
        bodies: Poses and Jacobians of the bodies; None if unavailable.
        time: (N,) time since the log began, s; None if the samples are not a series.
        log: Identifier of the log, from `log_number`; 0 for none.
        before: (M, nv) positions right before the first sample, M = 0 at the start of a log; None
            if the samples are not a series.
        states: Effect -> (N, s) its hidden states, if known, as in a simulation.
        effort: Returns the effort (N, nv) that the model needs with all effects except scales; None
            if unavailable.
        temperature: (N, nv) temperatures of motors or gears, °C; NaN for unknown entries, None if
            all are unknown.
        bandwidth: Bandwidth of the efforts, Hz; infinite for a motion without noise.
        acceleration_noise: (nv,) standard deviation of accelerations within this bandwidth.
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
        """Return the motion of one joint, possibly behind a transmission or in a loop.

        The load of such a joint is unknown and set to 0.

        Raises:
            ArgumentError: There is no such joint.
        """
        return self.once((JointMotion, name), lambda: self._joint(name))

    def once(self, key: tuple[Any, str], make: Callable[[], T]) -> T:
        """Return make(), cached under a key, for values that several effects share."""
        if key not in self._cache:
            self._cache[key] = make()
        return cast(T, self._cache[key])

    @cached_property
    def _cache(self) -> dict[tuple[Any, str], Any]:
        return {}

    def _joint(self, name: str) -> JointMotion:
        if (transmitted := self._transmitted(name)) is not None:
            (theta, rates, accelerations, J), j = transmitted
            v, width = rates[:, j], np.abs(J[:, j]) @ self.sign_width
            sign_v = self.direction(v, width)
            return JointMotion(theta[:, j], v, accelerations[:, j], np.zeros_like(v), sign_v)
        i = self.index(name)
        v = self.v[:, i]
        return JointMotion(
            self.q[:, i], v, self.vd[:, i], self.load[:, i], self.direction(v, self.sign_width[i])
        )

    def efforts_at(self, name: str, columns: Array) -> Mapping[str, Array]:
        """Return columns by velocity for effort columns (N, k) at a joint, τ_q = Jᵀ τ_θ."""
        if (transmitted := self._transmitted(name)) is None:
            return {name: columns}
        (*_, J), j = transmitted
        moving = np.flatnonzero(J[:, j].any(axis=0))
        return {self.joints[i]: J[:, j, i, None] * columns for i in moving}

    def at_both(self, joints: tuple[str, str], first: Array, second: Array) -> Mapping[str, Array]:
        """Return columns by velocity for effort columns (N, k) at two joints."""
        total = dict(self.efforts_at(joints[0], first))
        for joint, columns in self.efforts_at(joints[1], second).items():
            total[joint] = total[joint] + columns if joint in total else columns
        return total

    def _transmitted(self, name: str) -> tuple[tuple[Array, Array, Array, Array], int] | None:
        """Return the tree's motion and a joint's index in it, if behind a transmission."""
        if name in self.joints or self.bodies is None:
            return None
        indices = self.bodies.joints_behind
        return (self._tree_motion, indices[name]) if name in indices else None

    @cached_property
    def _tree_motion(self) -> tuple[Array, Array, Array, Array]:
        """Positions, velocities and accelerations of the tree's joints, and J."""
        bodies = self.body_motions("A joint behind a transmission")
        return bodies.tree_samples(self.v, self.vd)

    def index(self, name: str) -> int:
        """Return the index of a joint; raise an ArgumentError if it does not exist."""
        if name not in self.joints:
            raise ArgumentError(
                f"There is no joint {name!r}.", advice=f"Joints are {', '.join(self.joints)}."
            )
        return self.joints.index(name)

    def warmer(self, name: str, reference: float) -> Array:
        """Return a joint's temperature (N,) relative to a reference, °C; 0 where unknown."""
        if self.temperature is None:
            return np.zeros(len(self.v))
        values = self.temperature[:, self.index(name)]
        if values.dtype != object:
            return np.nan_to_num(values - reference)
        unknown = [isinstance(value, float) and np.isnan(value) for value in values]
        return np.asarray(np.where(unknown, reference, values) - reference)

    def body_motions(self, effect: str) -> RobotBodies:
        """Return the bodies' poses and Jacobians.

        Args:
            effect: Name of the effect that needs them, for the message.

        Raises:
            ArgumentError: They are unavailable.
        """
        if self.bodies is None:
            raise ArgumentError(
                f"{effect} needs poses of bodies, which are unknown here.",
                advice="Remove it from the model here.",
            )
        return self.bodies

    @cached_property
    def effort_slopes(self) -> EffortSlopes:
        """Derivatives of the bodies' effort with respect to the motion.

        Raises:
            ArgumentError: The bodies are unavailable.
        """
        bodies = self.body_motions("An elastic or loose joint")
        return effort_slopes(bodies.tree, bodies.q, self.v, self.vd, bodies.phi)

    @staticmethod
    def direction(v: Array, width: float | Array) -> Array:
        """Return smoothed signs of velocities, tanh(v / width); sgn v where the width is 0."""
        width = np.asarray(width)
        if width.all():
            return np.tanh(v / width)
        return np.where(width == 0, np.sign(v), np.tanh(v / np.where(width == 0, 1.0, width)))


def smoothed_sign(width: Array) -> Callable[[Array], Array]:
    """Return `RobotMotion.direction` for widths (nv,), fast for repeated calls."""
    if (width > 0).all():
        return lambda v: np.tanh(v / width)
    return lambda v: RobotMotion.direction(v, width)


def log_number(name: str) -> int:
    """Return the identifier of a log with a name."""
    return zlib.crc32(name.encode(errors="surrogatepass")) or 1
