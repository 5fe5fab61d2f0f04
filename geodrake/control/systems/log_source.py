"""Playback of logs in a diagram."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from functools import partial

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from geodrake.boundary.arguments import instance, instances, number
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.logs.motion import JointLog
from geodrake.model.simulation.scalar_system import differenced

_USUAL_GAPS = 5.0  # median sampling intervals


@differenced
class LogSource(LeafSystem):
    """Plays a log, interpolated linearly between its samples.

    .. pydrake_system::

        name: LogSource
        output_ports:
        - state
        - position
        - velocity
        - effort

    `state` is position and velocity, as expected by controllers and estimators. Time zero is the
    log's first time stamp. After the last one, position and effort are held and velocity is zero.
    Outputs are NaN in gaps and where the log contains NaN, which geodrake's systems handle. Samples
    without a time stamp are skipped.

    The system can be cloned, and converted to AutoDiffXd.
    """

    def __init__(
        self,
        log: JointLog,
        joints: Sequence[str] | None = None,
        *,
        largest_gap: float | None = None,
    ) -> None:
        """Construct the system.

        Args:
            log: The log. Missing velocities are computed as differences of positions.
            joints: Joints to play, in this order, such as `model.joints`; the log's if None.
            largest_gap: Longest interval between samples that is interpolated, s; five median
                sampling intervals if None.

        Raises:
            LogError: The log lacks one of the joints.
            ArgumentError: The log has less than two samples, or the gap is not positive.
        """
        LeafSystem.__init__(self, converter=self._converter)
        stamped = np.isfinite(instance(log, "log", JointLog).time)
        if stamped.sum() < 2:
            raise ArgumentError(
                f"Log {log.name!r} has {stamped.sum()} samples; playback needs two."
            )
        self.log = log = log if joints is None else log.select(instances(joints, "joints", str))
        time, position, effort = log.time[stamped], log.position[stamped], log.effort[stamped]
        self._time = time - time[0]
        self._stamps = self._time.tolist()
        usual = _USUAL_GAPS * float(np.median(np.diff(self._time)))
        self._largest_gap = usual if largest_gap is None else largest_gap
        if not number(self._largest_gap, "largest_gap", finite=False) > 0:
            raise ArgumentError(f"The largest gap must be positive; got {largest_gap} s.")
        velocity = log.velocity
        if velocity is None:
            velocity = np.gradient(position, self._time, axis=0)
        else:
            velocity = velocity[stamped]
        self._values = np.hstack([position, velocity, effort])
        n = len(log.joints)
        ports = {"state": (0, 2), "position": (0, 1), "velocity": (1, 2), "effort": (2, 3)}
        for name, (first, end) in ports.items():
            calc, size = partial(self._calc, slice(first * n, end * n)), (end - first) * n
            self.DeclareVectorOutputPort(name, BasicVector(size), calc, {self.time_ticket()})

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return float(self._time[-1])

    def _calc(self, columns: slice, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._at(context.get_time())[columns])

    def _at(self, t: float) -> Array:
        """Return positions, velocities and efforts (3 n,) at a time, s."""
        values, stamps = self._values, self._stamps
        if t > stamps[-1]:
            n = len(self.log.joints)
            return np.concatenate([values[-1, :n], np.zeros(n), values[-1, 2 * n :]])
        i = min(max(bisect_right(stamps, t) - 1, 0), len(stamps) - 2)
        interval = stamps[i + 1] - stamps[i]
        fraction = max(t - stamps[i], 0.0) / interval
        if fraction in (0.0, 1.0):
            return values[i + int(fraction)]
        if interval > self._largest_gap:
            return np.full(values.shape[1], np.nan)
        return values[i] + fraction * (values[i + 1] - values[i])
