"""Logs that are short, torn, made to do harm or hold what no sensor says: a clear line, and soon.

Numbers beyond measure are told of in words, not by warnings of NumPy, which fail here.
"""

import os
import struct
from dataclasses import replace

import numpy as np
import pytest
from foreign_logs import blank, lerobot, rosbag2_mcap, rosbag2_sqlite3
from pendulum_logs import PENDULUM, pendulum_log

from geodrake.diagnosis import compare
from geodrake.errors import LogError
from geodrake.logs import JointLog, log_of_frame, read_log
from geodrake.logs.files.table import check_room
from geodrake.logs.inspection import inspect_log
from geodrake.logs.unit_hints import effort_unit_hint
from geodrake.model import load_model, model_of_logs


def columns(rows):
    t = np.arange(rows) / 100.0
    return {"time": t, "a.position": np.sin(t), "a.effort": np.cos(3.0 * t)}


@pytest.mark.parametrize("rows", [10, 11, 49, 50, 51])
def test_logs_shorter_than_a_window_are_inspected(tmp_path, rows):
    np.savez(tmp_path / "short.npz", **columns(rows))
    assert len(inspect_log(tmp_path / "short.npz").log) == rows


def matlab_file(path, fill):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, values in columns(60).items():
            file[name.replace(".", "_")] = values[None]
        fill(h5py, file)
    return path


def doubling(h5py, file):
    group = file.create_group("g0")
    group["x"] = np.ones((1, 60))
    for k in range(24):
        inner, group = group, file.create_group(f"g{k + 1}")
        group["a"] = group["b"] = inner


def circular(h5py, file):
    group = file.create_group("s")
    group["again"] = group


def elsewhere(h5py, file):
    file["other"] = h5py.ExternalLink("/etc/passwd", "/x")
    file["nothing"] = h5py.Empty("f8")


@pytest.mark.parametrize("fill", [doubling, circular, elsewhere])
def test_objects_of_matlab_files_are_visited_once(tmp_path, fill):
    read = read_log(matlab_file(tmp_path / "log.mat", fill))
    assert read.joints == ("a",) and len(read) == 60


def endless(h5py, file):
    file.create_dataset("z", (10**13,), "f8", chunks=(10**6,))


def deep(h5py, file):
    file.create_group("/".join("s" * 40))


@pytest.mark.parametrize(("fill", "words"), [(endless, "GB of memory"), (deep, "more than 30")])
def test_matlab_files_beyond_measure(tmp_path, fill, words):
    with pytest.raises(LogError, match=words):
        read_log(matlab_file(tmp_path / "log.mat", fill))


def test_room_for_numbers(tmp_path):
    check_room(tmp_path, 10**6, "a million numbers")
    with pytest.raises(LogError, match=r"has much, which need 8e\+03 GB; this machine has"):
        check_room(tmp_path, 10**12, "much")


def spoiled_lcm(path, spoil):
    lcm = pytest.importorskip("lcm")
    from drake import lcmt_iiwa_status

    events = lcm.EventLog(str(path), "w")
    for k in range(60):
        status = blank(lcmt_iiwa_status, 1)
        status.utime = spoil.get("utime", 5000 * (k + 1))
        data = status.encode()
        if k == 20:
            data = spoil.get("cut", lambda whole: whole)(data)
        events.write_event(status.utime, "IIWA_STATUS", data)
    events.close()
    return path


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        ({"cut": lambda data: data[:-3]}, "Message 20 .*IIWA_STATUS.* truncated"),
        ({"cut": lambda data: data[:16] + struct.pack(">i", -1) + data[20:]}, "Message 20 "),
        ({"utime": 2**62}, "Message 1 of IIWA_STATUS has the stamp .* which is impossible"),
    ],
)
def test_messages_of_lcm_that_are_none(tmp_path, spoil, words):
    with pytest.raises(LogError, match=words):
        read_log(spoiled_lcm(tmp_path / "torn.lcm", spoil))


def test_messages_of_lcm_that_end_behind_the_file(tmp_path):
    path = spoiled_lcm(tmp_path / "large.lcm", {})
    whole = path.read_bytes()
    for rest in (struct.pack(">IQQII", 0xEDA1DA01, 60, 0, 1, 2 * 10**9) + b"Xdata", whole[:99]):
        path.write_bytes(whole + rest)
        assert len(read_log(path)) == 60


@pytest.mark.parametrize(
    "effort",
    [[10**400] * 60, [1j] * 60, [object()] * 60, ["1_0"] * 60],
    ids=["beyond floats", "complex", "objects", "words"],
)
def test_objects_that_are_no_numbers_are_not_missing_ones(effort):
    with pytest.raises(LogError, match=r"a\.effort.* (has no numbers|neither a number)"):
        log_of_frame({**columns(60), "a.effort": np.array(effort, object)})


def test_masked_values_are_missing():
    masked = np.ma.masked_less(columns(60)["a.effort"], 0.0)
    read = log_of_frame({**columns(60), "a.effort": masked})
    assert np.array_equal(np.isnan(read.effort[:, 0]), masked.mask)


def test_frames_of_polars_that_numpy_does_not_know():
    polars = pytest.importorskip("polars")
    frame = polars.DataFrame(columns(60))
    assert np.array_equal(log_of_frame(frame.lazy()).effort, log_of_frame(frame).effort)
    wide = frame.with_columns(polars.lit(2**100, polars.Int128).alias("a.effort"))
    with pytest.raises(LogError, match="not a readable frame of numbers"):
        log_of_frame(wide)


def test_tables_with_more_columns_than_any_robot(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_text(f"time,{','.join(f'c{k}' for k in range(20_000))}\n", encoding="utf-8")
    with pytest.raises(LogError, match="20001 columns; at most 10000 are read"):
        read_log(path)


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
def test_a_pipe_in_the_folder_of_a_log_is_refused(tmp_path, write, place):
    time = 0.01 * np.arange(50)
    q = np.sin(time)[:, None]
    path = write(tmp_path, JointLog("log", ("a",), time, q, q, q))
    read_log(path, joints=("a",))
    (path / place).unlink(missing_ok=True)
    os.mkfifo(path / place)
    with pytest.raises(LogError, match="is a pipe, not a file"):
        read_log(path, joints=("a",))


@pytest.fixture(scope="module")
def pendulum():
    return pendulum_log(1, seconds=10.0)


@pytest.mark.parametrize("size", [1e308, -1e200, 1e-200])
def test_efforts_of_any_size_are_compared_or_refused(pendulum, size):
    wrong = replace(pendulum, effort=size * np.sin(pendulum.effort))
    model = load_model(PENDULUM)
    assert model_of_logs(model, [wrong]).joints == model.joints
    try:
        found = compare(model, [wrong])
    except LogError as error:
        assert "no robot reaches in SI units" in error.problem or "is constant" in error.problem
    else:
        assert np.isfinite(found.errors.nrms)


@pytest.mark.parametrize("factor", [1e200, 1e-200])
def test_times_of_any_length_are_inspected_or_refused(pendulum, tmp_path, factor):
    path = tmp_path / "log.csv"
    rows = np.column_stack([factor * pendulum.time, pendulum.position, pendulum.effort])
    names = ["time", *(f"{j}.{q}" for q in ("position", "effort") for j in pendulum.joints)]
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="")
    if factor > 1.0:
        with pytest.raises(LogError, match=r"Time in log 'log' reaches .* which is impossible"):
            inspect_log(path)
    else:
        assert not inspect_log(path).rests


def test_limits_that_are_next_to_nothing_say_nothing_of_units(pendulum):
    assert effort_unit_hint(pendulum, 1e-308) is None
    strong = replace(pendulum, effort=np.full_like(pendulum.effort, 1e308))
    assert "other units" in effort_unit_hint(strong, 1e-8)
