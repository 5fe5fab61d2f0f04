"""A log played in a diagram."""

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
    """Plays a log: what was measured at its time stamps, in straight lines between them.

    .. pydrake_system::

        name: LogSource
        output_ports:
        - state
        - position
        - velocity
        - effort

    `state` is position and then velocity, as controllers and estimators take it. Time zero is the
    log's first time stamp. After the last one the robot rests: position and effort of the last
    sample, velocity zero. Where the log holds NaN, and in gaps, outputs are NaN: geodrake's systems
    know what to do with that. Samples without a time stamp are left out.

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
            log: The log. If it has no velocities, they are differences of its positions.
            joints: Joints to be played, in this order, such as `model.joints`; the log's if None.
            largest_gap: Time between two samples that is bridged, s; five usual ones if None.

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
        if log.velocity is None:
            velocity = np.gradient(position, self._time, axis=0)
        else:
            velocity = log.velocity[stamped]
        ports = {"position": position, "velocity": velocity, "effort": effort}
        ports = {"state": np.hstack([position, velocity]), **ports}
        for name, values in ports.items():
            last = values[-1].copy()
            if name in ("state", "velocity"):
                last[-len(log.joints) :] = 0.0
            calc, known = partial(self._calc, values, last), {self.time_ticket()}
            self.DeclareVectorOutputPort(name, BasicVector(len(last)), calc, known)

    @property
    def duration(self) -> float:
        """Time from the first sample to the last, s."""
        return float(self._time[-1])

    def _calc(self, values: Array, last: Array, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._at(context.get_time(), values, last))

    def _at(self, t: float, values: Array, last: Array) -> Array:
        if t > self._stamps[-1]:
            return last
        i = min(max(bisect_right(self._stamps, t) - 1, 0), len(self._stamps) - 2)
        gap = self._stamps[i + 1] - self._stamps[i]
        share = max(t - self._stamps[i], 0.0) / gap
        if share in (0.0, 1.0):
            return values[i + int(share)]
        if gap > self._largest_gap:
            return np.full(values.shape[1], np.nan)
        return values[i] + share * (values[i + 1] - values[i])
