"""What every diagnosis is given: the types of it, before any work."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from geodrake.boundary.arguments import instance, instances, integer, real_array
from geodrake.effects import Effect
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel

Logs = Sequence[JointLog | str | Path]


def checked_logs(
    model: RobotModel,
    logs: Logs,
    extra: Sequence[type[Effect]],
    bandwidth: float | None,
    blocks: int | None,
) -> tuple[JointLog | str | Path, ...]:
    """The logs, or their files, if what is asked for can be understood at all.

    Args:
        model: What the caller passed as the model.
        logs: What the caller passed as logs: `JointLog`s or files, or a single one.
        extra: Effect classes of the user's own.
        bandwidth: Bandwidth of efforts and regressors, Hz; None to choose it from the data.
        blocks: Blocks for each log, if logs are to be cut; None for the default.

    Raises:
        ArgumentError: Something is not what it must be.
    """
    instance(model, "model", RobotModel)
    instances(extra, "extra", type)
    if bandwidth is not None:
        real_array(bandwidth, "bandwidth", (), finite=False)
    if blocks is not None:
        integer(blocks, "blocks")
    each = (logs,) if isinstance(logs, JointLog | str | Path) else logs
    return instances(each, "logs", (JointLog, str, Path))
