"""Logs in formats of other software on the command line: options, and what cannot be used."""

import json
import sys

import foreign_logs
import numpy as np
import pytest
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
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.logs import JointLog, write_log


def small_log(rows=40):
    time = 0.01 * np.arange(rows)
    rates = np.array([3.0, 5.0])
    angle = time[:, None] * rates + [0.0, np.pi / 2]
    q, v, vd = np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle)
    return JointLog("log", ("shoulder", "elbow"), time, q, body_effort(q, v, vd), v)


def refused(*arguments):
    """Run a command that must fail in one line; returns it."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    (line,) = result.stderr.strip().splitlines()
    return line


def bag(folder, **topics):
    store = ros2_store()
    return write_rosbag2(folder / "bag", {f"/{n}": m for n, m in topics.items()}, store)


def states(log=None, **more):
    store = ros2_store()
    return joint_states(store, log or small_log(), ros2_header(store), **more)


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
    "no joint states": (strings, "no topic with both positions and efforts"),
    "no efforts": (lambda f: bag(f, joint_states=states(efforts=False)), "without effort"),
    "two topics": (lambda f: bag(f, left=states(), right=states()), "--topic /left"),
    "uneven arrays": (uneven, "2 joints and 3 numbers of effort"),
    "back in time": (back_in_time, "Time runs backwards in /joint_states: message 8"),
    "too short": (lambda f: bag(f, joint_states=states(small_log(5))), "5 rows"),
    "cut MCAP": (cut_mcap, "mcap recover"),
    "cut SQLite": (cut_sqlite, "no ROS bag that can be read"),
    "cut ROS 1": (lambda f: cut(ros1_bag(f, small_log(400))), "rosbag reindex"),
    "cut Parquet": (
        lambda f: cut(foreign_logs.pandas_parquet(f, small_log())),
        "no Parquet file that can be read",
    ),
    "cut LCM": (lambda f: cut(lcm_log(f, small_log(20)), 0.01), "has no messages"),
    "cut MATLAB": (lambda f: cut(foreign_logs.mat_v7(f, small_log(400))), "no MATLAB file"),
    "cut HDF5": (lambda f: cut(foreign_logs.mat_v73(f, small_log())), "no MATLAB file"),
    "no MCAP": (garbage("log.mcap"), "no ROS bag that can be read"),
    "no SQLite": (garbage("log.db3"), "no ROS bag that can be read"),
    "no ROS 1 bag": (garbage("log.bag"), "no ROS bag that can be read"),
    "no Parquet": (garbage("log.parquet"), "no Parquet file"),
    "no Feather": (garbage("log.feather"), "no Feather file"),
    "no LCM": (garbage("log.lcm"), "no LCM log"),
    "no MATLAB": (garbage("log.mat"), "no MATLAB file"),
    "no numbers": (text_in_mat, "no arrays of numbers"),
    "empty folder": (empty_folder, "is a folder, and neither a rosbag2 nor a LeRobot dataset"),
    "bad JSON": (bad_info, "no LeRobot dataset that can be read"),
    "dataset without efforts": (
        lambda f: lerobot(f, small_log(), efforts=False, actions=False),
        "no joint with both position and effort",
    ),
}


@pytest.mark.parametrize(("make", "part"), BAD.values(), ids=BAD)
def test_one_line_and_no_file(tmp_path, make, part):
    path = make(tmp_path)
    target = tmp_path / "out.json"
    line = refused("compare", PENDULUM, path, "--json", target)
    assert part in line
    assert not target.exists()


@pytest.mark.parametrize(
    ("module", "extra", "name"),
    [
        ("rosbags", "logs", "x.mcap"),
        ("pyarrow", "logs", "x.parquet"),
        ("lcm", "logs", "x.lcm"),
    ],
)
def test_packages_that_are_not_installed(tmp_path, monkeypatch, module, extra, name):
    for loaded in [m for m in sys.modules if m.partition(".")[0] == module]:
        monkeypatch.setitem(sys.modules, loaded, None)
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"\xed\xa1\xda\x01 something")
    assert f'pip install "geodrake[{extra}]"' in refused("compare", PENDULUM, tmp_path / name)


@pytest.mark.thorough
def test_topic_and_episode_are_chosen_by_options(tmp_path):
    log = small_log(900)
    double = JointLog("log", log.joints, log.time, log.position, 2 * log.effort, log.velocity)
    path = bag(tmp_path, left=states(log), right=states(double))
    dataset = lerobot(tmp_path, log, episodes=2)
    spreads = [spread(path, "--topic", name) for name in ("/left", "right")]
    assert np.allclose(spreads[1], 2 * spreads[0])
    assert spread(dataset).shape == (2,)
    first, second = (spread(dataset, "--episode", k) for k in (0, 1))
    assert not np.allclose(first, second)
    assert "no samples of episode 5" in refused("compare", PENDULUM, dataset, "--episode", 5)
    assert "episode must be" in refused("compare", PENDULUM, dataset, "--episode", -1)
    target = tmp_path / "same.csv"
    write_log(log, target)
    assert np.allclose(spread(target), spreads[0])


def spread(*arguments):
    """Deviations of the efforts that `compare` prints."""
    given = ["compare", PENDULUM, *arguments, "--bandwidth", 10, "--json", "-"]
    result = CliRunner().invoke(app, [str(each) for each in given])
    assert result.exit_code == 0, result.stderr
    return np.array([joint["std"] for joint in json.loads(result.stdout)["joints"].values()])
