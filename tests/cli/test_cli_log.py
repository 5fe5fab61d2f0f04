"""`geodrake log`, and logs with other names and formats in other commands."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
from commands import refused, run, told
from foreign_logs import (
    joint_states,
    lcm_log,
    lerobot,
    mat_v7,
    mat_v73,
    pandas_parquet,
    ros1_bag,
    ros2_store,
    rosbag2_sqlite3,
    write_rosbag2,
)
from pendulum_logs import PENDULUM, body_effort
from PIL import Image
from scipy.io import savemat

from geodrake.cli.input_options import ReadingOptions
from geodrake.cli.options import AddOptions
from geodrake.logs import JointLog, Reading, read_log
from geodrake.logs.files import read_mapping

OWN = "time,shoulder.position,elbow.position,shoulder.effort,elbow.effort"


def table(seconds=24.0, rate=100.0):
    """Return (N, 5) time, positions and efforts of the pendulum, which rests for 2 s."""
    time, rates = np.arange(round(seconds * rate)) / rate, np.array([1.3, 2.1])
    angle = np.maximum(time - 2.0, 0.0)[:, None] * rates
    q, v = 0.5 - 0.5 * np.cos(angle), 0.5 * rates * np.sin(angle)
    effort = body_effort(q, v, 0.5 * rates**2 * np.cos(angle) * (time > 2.0)[:, None])
    noise = np.random.default_rng(0).standard_normal((len(time), 2))
    return np.column_stack([time, q, effort + 0.01 * noise])


def write(path, header, rows, separator=","):
    names = header.split(",")
    pandas.DataFrame(rows, columns=names).to_csv(path, index=False, sep=separator)
    return path


def numbers_of(*arguments):
    result = run(*arguments, "--json", "-")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


def nrms(*arguments):
    return numbers_of("compare", PENDULUM, *arguments, "--bandwidth", "5")["error"]["nrms"]


def shown(log):
    """Return what is said of a log, its numbers, and the log that is converted."""
    files = ("--json", "x.json", "--convert", "x.csv", "--figure", "x.png")
    output = told("log", log, "--model", PENDULUM, *files)
    with Image.open("x.png") as image:
        assert image.size[0] > 800
    return output, json.loads(Path("x.json").read_text())["logs"][0], read_log("x.csv")


def test_the_log_is_described(tmp_path):
    rows = np.delete(table(), slice(1000, 1100), axis=0)
    rows[300, 1] = 1e7
    rows[:, 1:3] = np.rad2deg(rows[:, 1:3])
    output, found, again = shown(write(tmp_path / "log.csv", "t,q1_deg,q2_deg,tau1,tau2", rows))
    for words in (
        *("shoulder", "q1_deg", "deg × 0.01745", "2300 rows in 24.0 s", "time from column t"),
        *("1 gap: 1.01 s at t = 9.99 s", "at rest for", "position is in deg", "has an outlier"),
    ):
        assert words in output
    assert found["joints"] == ["shoulder", "elbow"]
    assert found["period"] == pytest.approx(0.01)
    assert found["rests"][0]["to"] == pytest.approx(2.0, abs=0.3)
    assert again.joints == ("shoulder", "elbow")
    assert np.nanmax(np.abs(again.position)) == pytest.approx(1.0, abs=1e-3)


def test_degrees_are_reported_once(tmp_path):
    """The check of columns corrects them, so that sizes and limits need not."""
    rows = table()
    rows[:, 1:3] = np.rad2deg(rows[:, 1:3])
    output = told("log", write(tmp_path / "log.csv", OWN, rows), "--model", PENDULUM)
    assert output.count("--units position=deg") == 1
    assert "Positions exceed" not in output and output.count("in degrees") == 1


def test_currents_and_commands_are_shown_and_converted(tmp_path):
    rows = table()
    rows[:, 4] = rows[:, 2] + 0.01 * rows[:, 4]
    names = "t,actual_q_0,actual_q_1,i_0_mA,target_q_1"
    output, found, again = shown(write(tmp_path / "log.csv", names, rows))
    for words in (
        *("current", "mA × 0.001", "command", "target_q_1"),
        *("motor currents in A", "no efforts of elbow: their servo commands are used"),
    ):
        assert words in output
    kinds = {c["joint"]: c["quantity"] for c in found["columns"] if c["quantity"] != "position"}
    assert kinds == {"shoulder": "current", "elbow": "command"}
    header = Path("x.csv").read_text().splitlines()[0].split(",")
    assert set(header[3:]) == {"shoulder.current", "elbow.command"}
    assert again.effort_kinds == {"shoulder": "current"}
    assert np.allclose(again.effort[:, 0], 1e-3 * rows[:, 3])
    assert np.allclose(again.command[:, 1], rows[:, 4])


def test_deviations_of_some_gains_override_that_of_all(tmp_path):
    log = write(tmp_path / "log.csv", "t,q1,q2,i1,i2", table())
    reading = ReadingOptions(gain=["shoulder=2±0.2", "elbow=4"]).reading
    reading = replace(reading, usual_deviation=0.01)
    read = read_log(log, joints=("shoulder", "elbow"), reading=reading)
    assert np.allclose(read.effort_uncertainty, [0.1, 0.01])
    assert not read.effort_kinds


def test_useless_commands_and_currents_are_refused(tmp_path):
    rows = table(seconds=6.0)
    q, effort = rows[:, 1:3], rows[:, 3:]
    for near in (0.0, 0.01):
        commands = np.column_stack([rows[:, 0], q, q + near * effort * [1.0, 0.0]])
        log = write(tmp_path / "log.csv", OWN.replace("effort", "command"), commands)
        assert "always equals its position" in refused("compare", PENDULUM, log)
    rows[:, 3] = np.clip(rows[:, 3], -0.5, 0.5)
    log = write(tmp_path / "log.csv", OWN.replace("effort", "current"), rows)
    assert "is saturated" in refused("compare", PENDULUM, log)


def test_joints_of_the_model_that_the_log_lacks(tmp_path):
    log = write(tmp_path / "log.csv", "t,q1,tau1", table(seconds=1.0)[:, [0, 1, 3]])
    text = PENDULUM.read_text().replace('"shoulder"', '"arm_1"').replace('"elbow"', '"arm_2"')
    (tmp_path / "two.urdf").write_text(text)
    output = told("log", log, "--model", tmp_path / "two.urdf")
    assert "arm_1" in output
    assert "the model's arm_2 have no measurements" in output


def test_other_names_give_the_same_numbers(tmp_path):
    rows = table()
    expected = nrms(write(tmp_path / "own.csv", OWN, rows))
    theirs = write(tmp_path / "theirs.csv", "timestamp,q_0,q_1,tau_0,tau_1", rows, " ")
    assert nrms(theirs) == pytest.approx(expected, rel=1e-9)
    scaled = rows * np.array([1e3, 180 / np.pi, 180 / np.pi, 0.5, 0.25])
    np.savetxt(tmp_path / "bare.csv", scaled, delimiter=";")
    options = ["--columns", "t,q1,q2,i1,i2", "--units", "time=ms,position=deg,effort=A"]
    gains = ["--gain", "shoulder=2", "--gain", "elbow=4"]
    assert nrms("bare.csv", *options, *gains) == pytest.approx(expected, rel=1e-6)


def test_joints_assumed_from_numbers_are_said_once_and_first(tmp_path):
    rows, said = table(), "q_0 … q_1, tau_0 … tau_1 are numbered: assigned to joints in the model's"
    logs = [
        write(tmp_path / f"{k}.csv", "t,q_0,q_1,tau_0,tau_1", half)
        for k, half in enumerate(np.split(rows, 2))
    ]
    for command in ("compare", "explain"):
        options = [command, PENDULUM, "--bandwidth", "5", "--quiet"]
        output = told(*options, logs[0])
        assert output.index("Check first") < output.index(said) < output.index("Verdict")
        both = told(*options, *logs, "--details")
        assert both.count(said) == 1 and f"all logs: columns {said}" in both
    own = told("compare", PENDULUM, write(tmp_path / "own.csv", OWN, rows), "--bandwidth", "5")
    assert "Check first" not in own


def test_a_failed_reading_proposes_a_mapping(tmp_path):
    rows = table()
    log = write(tmp_path / "log.csv", "x1,x2,x3,x4,x5", rows)
    proposal = Path("log.mapping.yaml")
    assert f"A draft mapping is in {proposal}" in refused("compare", PENDULUM, log)
    expected = nrms(write(tmp_path / "own.csv", OWN, rows))
    assert nrms(log, "--mapping", proposal) == pytest.approx(expected, rel=1e-9)
    proposal.write_text(proposal.read_text().replace("x3", "x2"))
    edited = proposal.read_text()
    assert f"Edit the existing {proposal}" in refused("compare", PENDULUM, log)
    assert "uses column 'x2' twice" in refused("compare", PENDULUM, log, "--mapping", proposal)
    assert proposal.read_text() == edited


def test_bad_rows_are_left_out_if_asked(tmp_path):
    log = write(tmp_path / "log.csv", OWN, table())
    lines = log.read_text().splitlines()
    lines[700] = "0.0,garbage"
    log.write_text("\n".join(lines) + "\n")
    message = refused("compare", PENDULUM, log)
    assert "Row 700" in message
    assert "--skip-bad-rows" in message
    output = told("compare", PENDULUM, log, "--skip-bad-rows", "--bandwidth", "5")
    assert "1 of 2400 rows are corrupt and skipped: 700" in output


def test_one_axis_without_a_model():
    time = np.arange(4000) / 200.0
    q, v, vd = (f(1.7 * time + np.pi / 2 * k) * 1.7**k for k, f in enumerate([np.sin] * 3))
    force = 90.0 * vd + 20.0 * np.tanh(100 * v) + 0.1 * np.random.default_rng(0).normal(size=4000)
    np.savetxt("q.csv", q)
    np.savetxt("force.csv", force)
    given = ["q.csv+force.csv", "--rate", "200", "--axis", "prismatic", "--mass", "70"]
    found = numbers_of("identify", "axis.urdf", *given, "--effects", "coulomb_friction")
    assert found["bodies"]["moving"]["mass"] == pytest.approx(90.0, rel=0.02)
    assert "exists. Name a new file" in refused("identify", "axis.urdf", *given)
    assert "too short" in refused("compare", "other.urdf", *given, "--bandwidth", "0.02")
    assert not Path("other.urdf").exists()


def test_options_without_a_meaning_are_noted(tmp_path):
    log = write(tmp_path / "log.csv", OWN, table(seconds=1.0))
    told("log", log, "--model", PENDULUM, "--lock", "elbow=0.3", "--quiet")
    other = write(tmp_path / "other.csv", OWN, table(seconds=2.0))
    said = told("log", log, other, "--topic", "/joint_states", "--episode", "3", "--dbc", "a.dbc")
    assert "log.csv has no frames of a CAN bus, so 'a.dbc' has no meaning" in said
    assert "log.csv has no topics, so '/joint_states' has no meaning" in said
    assert "log.csv has no episodes, so 3 has no meaning" in said


def test_a_written_mapping_corrects_the_columns(tmp_path):
    right = table()
    wrong = right * [1e3, *[180.0 / np.pi] * 2, -1.0, 1.0]
    log = write(tmp_path / "my log.csv", "stamp [ms],q1 (deg),q2 (deg),tau1,tau2", wrong)
    said = told("log", log, "--model", PENDULUM, "--write-mapping", "fixed.yaml")
    assert f" geodrake explain {PENDULUM} '{log}' --mapping fixed.yaml" in said
    read = read_log(log, reading=Reading(mapping=read_mapping(Path("fixed.yaml"))))
    assert read.joints == ("shoulder", "elbow")
    found = np.column_stack([read.time, read.position, read.effort])
    np.testing.assert_allclose(found, right, atol=1e-9)


def test_a_mapping_cannot_express_every_table():
    rows = [f"{k / 100},{j},{np.sin(k / 9)},{k}" for k in range(60) for j in ("shoulder", "elbow")]
    Path("long.csv").write_text("time,joint,position,effort\n" + "\n".join(rows))
    said = refused("log", "long.csv", "--write-mapping", "m.yaml")
    assert "A mapping cannot express how log 'long.csv' was read" in said
    assert not Path("m.yaml").exists()


def test_a_written_mapping_keeps_the_deviation_of_a_gain_and_standing_joints(tmp_path):
    numbers, names = table(), "time,shoulder.position,elbow.position,elbow.current"
    log = write(tmp_path / "log.csv", names, numbers[:, [0, 1, 2, 4]])
    told("log", log, "--gain", "elbow=2±0.5", "--write-mapping", "m.yaml")
    read = read_log(log, reading=Reading(mapping=read_mapping(Path("m.yaml"))), partial=True)
    np.testing.assert_allclose(read.effort[:, 0], 2.0 * numbers[:, 4])
    assert 0.0 < read.gain_deviations[0] < np.inf
    assert list(read.standing) == ["shoulder"]


def test_logs_that_cannot_be_used_are_left_out_and_named(tmp_path):
    good = write(tmp_path / "good.csv", OWN, table())
    scrap = np.add(table()[300:340], [0.0, 1e-6, 0.0, 0.0, 0.0])
    short = write(tmp_path / "short.csv", OWN, scrap)
    bad = tmp_path / "bad.csv"
    bad.write_text("time,shoulder.position\n0,x\n")
    said = told("compare", PENDULUM, good, short, bad, "--quiet")
    assert "short is not used" in said and "bad.csv is not used" in said
    assert said.index("bad.csv is not used") < said.index("Verdict")
    refused("compare", PENDULUM, short, bad)
    empty = write(tmp_path / "empty.csv", OWN, table()[:0])
    for given in ((), ("--model", PENDULUM)):
        told("log", good, empty, *given, "--json", "x.json")
        (note,) = json.loads(Path("x.json").read_text())["notes"]
        assert note.startswith("empty.csv is not used: Log ") and "has 0 rows" in note


def test_constant_efforts_are_said_first(tmp_path):
    rows = table()
    rows[:, 4] = 1.5
    said = told("log", write(tmp_path / "log.csv", OWN, rows))
    words = "the effort of elbow is 1.5 in 100 % of the rows, so it is not used"
    assert said.index(words) < said.index("Ranges in SI units")


def test_an_effect_to_add_names_its_place():
    def addition(effect, *where):
        return AddOptions(effect=effect, where=list(where), model=PENDULUM, logs=[]).addition

    assert addition("payload@flange") == ("payload", ["flange"])
    assert addition("coupled_friction@j2+j3") == ("coupled_friction", ["j2", "j3"])
    assert addition("payload") == ("payload", None)


def small_log(rows=40):
    time = 0.01 * np.arange(rows)
    rates = np.array([3.0, 5.0])
    angle = time[:, None] * rates + [0.0, np.pi / 2]
    q, v, vd = np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle)
    return JointLog("log", ("shoulder", "elbow"), time, q, body_effort(q, v, vd), v)


def bag(folder, messages, topic="/joint_states"):
    return write_rosbag2(folder / "bag", {topic: messages})


def states(log=None):
    return list(joint_states(ros2_store(), log or small_log()))


def strings(folder):
    message = ros2_store().types["std_msgs/msg/String"]("hello")
    return bag(folder, [(1, message)] * 20, "/chatter")


def cut(path, share=0.6):
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    return path


def only_file(folder, suffix):
    return next(path for path in folder.iterdir() if path.suffix == suffix)


def cut_mcap(folder):
    return cut(only_file(bag(folder, states()), ".mcap"))


def cut_sqlite(folder):
    path = rosbag2_sqlite3(folder, small_log(400))
    cut(only_file(path, ".db3"))
    return path


def garbage(name):
    def write(folder):
        path = folder / name
        path.write_bytes(b"time,a.position\n0.0,1.0\n" * 40)
        return path

    return write


def uneven(folder):
    messages = states()
    messages[5][1].effort = np.zeros(3)
    return bag(folder, messages)


def back_in_time(folder):
    messages = states()
    messages[7][1].header.stamp.sec -= 3
    return bag(folder, messages)


def bad_info(folder):
    path = lerobot(folder, small_log())
    (path / "meta" / "info.json").write_text('{"features": [')
    return path


def empty_folder(folder):
    (folder / "recording").mkdir()
    return folder / "recording"


def text_in_mat(folder):
    savemat(folder / "text.mat", {"comment": "no numbers"})
    return folder / "text.mat"


BAD = {
    "empty bag": (lambda f: bag(f, []), "has no messages"),
    "no joint states": (strings, "no topic with both joint positions and efforts"),
    "uneven arrays": (uneven, "2 joints, but 3 values of effort"),
    "back in time": (back_in_time, "Time runs backwards in /joint_states: message 8"),
    "too short": (lambda f: bag(f, states(small_log(5))), "5 rows"),
    "cut MCAP": (cut_mcap, "mcap recover"),
    "cut SQLite": (cut_sqlite, "not a readable ROS bag"),
    "cut ROS 1": (lambda f: cut(ros1_bag(f, small_log(400))), "rosbag reindex"),
    "cut Parquet": (lambda f: cut(pandas_parquet(f, small_log())), "not a readable Parquet file"),
    "cut LCM": (lambda f: cut(lcm_log(f, small_log(20)), 0.01), "has no messages"),
    "cut MATLAB": (lambda f: cut(mat_v7(f, small_log(400))), "not a readable MATLAB file"),
    "cut HDF5": (lambda f: cut(mat_v73(f, small_log())), "not a readable MATLAB file"),
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
