"""Logs in formats of other software on the command line: options, and what cannot be used."""

import sys

import foreign_logs
import numpy as np
import pytest
from commands import refused
from foreign_logs import (
    joint_states,
    lcm_log,
    lerobot,
    ros1_bag,
    ros2_header,
    ros2_store,
    write_rosbag2,
)
from pendulum_logs import PENDULUM, body_effort

from geodrake.logs import JointLog


def small_log(rows=40):
    time = 0.01 * np.arange(rows)
    rates = np.array([3.0, 5.0])
    angle = time[:, None] * rates + [0.0, np.pi / 2]
    q, v, vd = np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle)
    return JointLog("log", ("shoulder", "elbow"), time, q, body_effort(q, v, vd), v)


def bag(folder, **topics):
    store = ros2_store()
    return write_rosbag2(folder / "bag", {f"/{n}": m for n, m in topics.items()}, store)


def states(log=None):
    store = ros2_store()
    return joint_states(store, log or small_log(), ros2_header(store))


def strings(folder):
    store = ros2_store()
    message = store.types["std_msgs/msg/String"]("hello")
    return write_rosbag2(folder / "bag", {"/chatter": [(1, message)] * 20}, store)


def cut(path, share=0.6):
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    return path


def only_file(folder, suffix):
    return next(path for path in folder.iterdir() if path.suffix == suffix)


def cut_mcap(folder):
    return cut(only_file(bag(folder, joint_states=states()), ".mcap"))


def cut_sqlite(folder):
    path = foreign_logs.rosbag2_sqlite3(folder, small_log(400))
    cut(only_file(path, ".db3"))
    return path


def garbage(name):
    def write(folder):
        path = folder / name
        path.write_bytes(b"time,a.position\n0.0,1.0\n" * 40)
        return path

    return write


def empty_folder(folder):
    (folder / "recording").mkdir()
    return folder / "recording"


def uneven(folder):
    messages = list(states())
    messages[5][1].effort = np.zeros(3)
    return bag(folder, joint_states=messages)


def back_in_time(folder):
    messages = list(states())
    messages[7][1].header.stamp.sec -= 3
    return bag(folder, joint_states=messages)


def bad_info(folder):
    path = lerobot(folder, small_log())
    (path / "meta" / "info.json").write_text('{"features": [')
    return path


def text_in_mat(folder):
    from scipy.io import savemat

    savemat(folder / "text.mat", {"comment": "no numbers"})
    return folder / "text.mat"


BAD = {
    "empty bag": (lambda f: bag(f, joint_states=[]), "has no messages"),
    "no joint states": (strings, "no topic with both joint positions and efforts"),
    "uneven arrays": (uneven, "2 joints, but 3 values of effort"),
    "back in time": (back_in_time, "Time runs backwards in /joint_states: message 8"),
    "too short": (lambda f: bag(f, joint_states=states(small_log(5))), "5 rows"),
    "cut MCAP": (cut_mcap, "mcap recover"),
    "cut SQLite": (cut_sqlite, "not a readable ROS bag"),
    "cut ROS 1": (lambda f: cut(ros1_bag(f, small_log(400))), "rosbag reindex"),
    "cut Parquet": (
        lambda f: cut(foreign_logs.pandas_parquet(f, small_log())),
        "not a readable Parquet file",
    ),
    "cut LCM": (lambda f: cut(lcm_log(f, small_log(20)), 0.01), "has no messages"),
    "cut MATLAB": (
        lambda f: cut(foreign_logs.mat_v7(f, small_log(400))),
        "not a readable MATLAB file",
    ),
    "cut HDF5": (lambda f: cut(foreign_logs.mat_v73(f, small_log())), "not a readable MATLAB file"),
    "no MCAP": (garbage("log.mcap"), "not a readable ROS bag"),
    "no Feather": (garbage("log.feather"), "not a readable Feather file"),
    "not an LCM": (garbage("log.lcm"), "not an LCM log"),
    "no numbers": (text_in_mat, "no numeric arrays"),
    "empty folder": (empty_folder, "is neither a rosbag2 nor a LeRobot dataset"),
    "bad JSON": (bad_info, "not a readable LeRobot dataset"),
}


@pytest.mark.parametrize(("make", "part"), BAD.values(), ids=BAD)
def test_one_line_and_no_file(tmp_path, make, part):
    path = make(tmp_path)
    assert part in refused("compare", PENDULUM, path, "--json", "out.json")
    assert not (tmp_path / "out.json").exists()


@pytest.mark.parametrize(
    ("module", "suffix"), [("rosbags", "mcap"), ("pyarrow", "parquet"), ("h5py", "h5")]
)
def test_packages_that_are_not_installed(tmp_path, monkeypatch, module, suffix):
    for loaded in [m for m in sys.modules if m.partition(".")[0] == module]:
        monkeypatch.setitem(sys.modules, loaded, None)
    monkeypatch.setitem(sys.modules, module, None)
    (log := tmp_path / f"x.{suffix}").write_bytes(b"\xed\xa1\xda\x01 something")
    assert 'pip install "geodrake[logs]"' in refused("compare", PENDULUM, log)
