"""Closed loops as transmissions, from the free joints to all; see `geodrake.robot.loops`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.showing import Short
from geodrake.compiling import contiguous
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.robot.loop_recursion import Indices, LoopRecords, calc_loop, calc_loop_rates
from geodrake.robot.transmission.base import Transmission

_FAR = 10.0  # rad or sizes of the loop, up to where ends of its motion are looked for
_OFF_THE_END = 1e-3  # of the way to an end, where the loop still moves
_CORNERS = 4  # free joints, of whose ranges all corners are tried
_SMALLER, _MOST_TRIALS = 0.8, 15  # ranges of several free joints


@dataclass(frozen=True, eq=False)
class LoopTransmission(Transmission, Short):
    """How all joints of a closed loop follow from the free ones.

    Attributes:
        name: What closes the loop, in words.
        joints: Names of its k joints; the last ones may be cut.
        records: The loop for compiled code.
        shown: Numbers of the joints that it moves in the tree.
        driven: Names of joints that follow, though motors drive them, too.
        cut: Numbers of the joints that close the loop and are not in the tree.
        slides: (k) whether each joint slides.
    """

    name: str
    joints: tuple[str, ...]
    records: LoopRecords
    shown: Indices
    driven: tuple[str, ...] = ()
    cut: tuple[int, ...] = ()
    slides: tuple[bool, ...] = ()

    @property
    def free(self) -> Indices:
        """Numbers of the free joints."""
        return self.records[4]

    @property
    def reference(self) -> Array:
        """(k,) the posture of the file, in which the loop is closed."""
        return self.records[6]

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of the free joints."""
        return tuple(self.joints[at] for at in self.free)

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of joints that it moves in the tree, and of free ones."""
        return len(self.shown), len(self.free)

    def solved(self, q: Array) -> tuple[Array, Array, Array]:
        """Positions (N, k) of all joints, G (N, k, n), and the share of the way there (N,)."""
        q = contiguous(q)
        theta = np.empty((len(q), len(self.reference)))
        G, reached = np.empty((*theta.shape, self.num_actuators)), np.empty(len(q))
        calc_loop(self.records, q, theta, G, reached)
        return theta, G, reached

    def along(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """θ = T(q), J and J̇ along a motion, by one solution."""
        theta, G, rate = self.of_all(q, v)
        return theta[:, self.shown], G[:, self.shown], rate[:, self.shown]

    def of_all(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return positions (N, k) of all k joints, G and Ġ (N, k, n)."""
        theta, G = self._closed(self._q(q))
        rate = np.zeros_like(G)
        calc_loop_rates(self.records, theta, G, contiguous(v), rate)
        return theta, G, rate

    def joint_positions(self, q: Array) -> Array:
        """θ = T(q), by Newton's method."""
        return self._closed(self._q(q))[0][:, self.shown]

    def jacobian(self, q: Array) -> Array:
        """J = G."""
        return self._closed(self._q(q))[1][:, self.shown]

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """J̇ = Ġ."""
        return self.along(q, v)[2]

    def actuator_positions(self, theta: Array, *, start: object = 0.0) -> Array:
        """Return Q (N, n): those of the free joints, whatever the others'."""
        del start
        return np.array(theta[:, np.searchsorted(self.shown, self.free)])

    def inside(self, q: Array) -> Array:
        """Return positions moved towards the posture of the file to where the loop closes."""
        share, there = self.solved(q)[2], self.reference[self.free]
        moved = there + (1.0 - _OFF_THE_END) * share[:, None] * (q - there)
        return np.where((share < 1.0)[:, None], moved, q)

    def range_within(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Least and greatest positions (n,) of the free joints between which the loop closes."""
        there, units = self.reference[self.free], self.records[7][self.free]
        ends = [np.maximum(lower, there - _FAR * units), np.minimum(upper, there + _FAR * units)]
        for k, (end, own) in enumerate(zip(ends, (lower, upper), strict=True)):
            q = there + np.diag(end - there)  # one joint at a time
            share = self.solved(q)[2]
            stops = there + (1.0 - _OFF_THE_END) * share * (end - there)
            ends[k] = np.where(share < 1.0, stops, own)
        if 1 < len(there) <= _CORNERS:
            for _ in range(_MOST_TRIALS):
                near = [np.clip(end, there - _FAR * units, there + _FAR * units) for end in ends]
                corners = np.array(list(product(*zip(*near, strict=True))))
                if (self.solved(corners)[2] == 1.0).all():
                    break
                ends = [there + _SMALLER * (end - there) for end in near]
        return ends[0], ends[1]

    def _closed(self, q: Array) -> tuple[Array, Array]:
        """Return positions and G."""
        theta, G, reached = self.solved(q)
        if (open_ := reached < 1.0).any():
            at = int(np.argmax(open_))
            end = self.reference[self.free] + reached[at] * (q[at] - self.reference[self.free])
            raise ArgumentError(
                f"The closed loop of {self.name} does not close at {_places(self.actuators, q[at])}"
                f": on the way there from where the file has it, it ends at "
                f"{_places(self.actuators, end)}.",
                advice="Check its lengths and zero positions, and that the log is of this robot.",
            )
        return theta, G


def _places(names: Sequence[str], values: ArrayLike) -> str:
    return ", ".join(f"{n} = {x:.4g}" for n, x in zip(names, np.asarray(values), strict=True))
