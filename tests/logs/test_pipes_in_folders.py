"""Logs that are folders: a pipe or a device among their files is an error, never a wait."""

import os
from pathlib import Path

import numpy as np
import pytest
from foreign_logs import lerobot, rosbag2_mcap, rosbag2_sqlite3

from geodrake.errors import LogError
from geodrake.logs import JointLog, read_log


@pytest.fixture(scope="module")
def log():
    time = 0.01 * np.arange(50)
    q = np.sin(time)[:, None]
    return JointLog("log", ("a",), time, q, q, q)


def replaced(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


@pytest.mark.parametrize(
    ("write", "place"),
    [
        (rosbag2_sqlite3, "metadata.yaml"),
        (rosbag2_sqlite3, "bag_SQLITE3.db3"),
        (rosbag2_sqlite3, "bag_SQLITE3.db3-wal"),
        (rosbag2_mcap, "metadata.yaml"),
        (rosbag2_mcap, "bag_MCAP.mcap"),
        (lerobot, "meta/info.json"),
        (lerobot, "data/chunk-000/file-000.parquet"),
        (lerobot, "data/chunk-000/more.parquet"),
    ],
)
def test_a_pipe_in_the_folder_of_a_log_is_refused(tmp_path, log, write, place):
    pytest.importorskip("pyarrow" if write is lerobot else "rosbags")
    path = write(tmp_path, log)
    read_log(path, joints=("a",))
    replaced(path / place)
    with pytest.raises(LogError, match="is a pipe, not a file"):
        read_log(path, joints=("a",))
