"""Files of logs that are short, torn or made to do harm: a clear line, and soon."""

import struct

import numpy as np
import pytest

from geodrake.errors import LogError
from geodrake.logs.files import read_log
from geodrake.logs.files.table import check_room
from geodrake.logs.frames import log_of_frame
from geodrake.logs.inspection import inspect_log


def columns(rows):
    t = np.arange(rows) / 100.0
    return {"time": t, "a.position": np.sin(t), "a.effort": np.cos(3.0 * t)}


@pytest.mark.parametrize("rows", [10, 11, 30, 49, 50, 51, 60])
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
    with pytest.raises(LogError, match=r"has much, 8e\+03 GB; this machine has"):
        check_room(tmp_path, 10**12, "much")


def spoiled_lcm(path, spoil):
    lcm = pytest.importorskip("lcm")
    from drake import lcmt_iiwa_status

    events = lcm.EventLog(str(path), "w")
    for k in range(60):
        status = lcmt_iiwa_status()
        status.num_joints, status.utime = 1, 5000 * (k + 1)
        for name in status.__slots__:
            if name.startswith("joint_"):
                setattr(status, name, [np.sin(0.1 * k)])
        status.utime = spoil.get("utime", status.utime)
        data = status.encode()
        if k == 20:
            data = spoil.get("cut", lambda whole: whole)(data)
        events.write_event(status.utime, "IIWA_STATUS", data)
    events.close()
    return path


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        ({"cut": lambda data: data[:-3]}, "Message 20 .*IIWA_STATUS.* cut off"),
        ({"cut": lambda data: data[:16] + struct.pack(">i", -1) + data[20:]}, "Message 20 "),
        ({"utime": 2**62}, "Message 1 of IIWA_STATUS is stamped .* which cannot be"),
        ({"utime": -(2**62)}, "Message 1 of IIWA_STATUS is stamped .* which cannot be"),
    ],
)
def test_messages_of_lcm_that_are_none(tmp_path, spoil, words):
    with pytest.raises(LogError, match=words):
        read_log(spoiled_lcm(tmp_path / "torn.lcm", spoil))


def test_messages_of_lcm_beyond_measure(tmp_path):
    path = spoiled_lcm(tmp_path / "large.lcm", {})
    with path.open("ab") as file:
        file.write(struct.pack(">IQQII", 0xEDA1DA01, 60, 0, 1, 2 * 10**9) + b"Xdata")
    with pytest.raises(LogError, match=r"Message 60 .* has 2000 MB"):
        read_log(path)


def objects(values):
    return {**columns(60), "a.effort": np.array(values, object)}


@pytest.mark.parametrize(
    "effort",
    [[10**400] * 60, [1j] * 60, [object()] * 60, ["1_0"] * 60],
    ids=["beyond floats", "complex", "objects", "words"],
)
def test_objects_that_are_no_numbers_are_not_missing_ones(effort):
    with pytest.raises(LogError, match=r"a\.effort.* (holds no numbers|neither a number)"):
        log_of_frame(objects(effort))


def test_masked_values_are_missing():
    masked = np.ma.masked_less(columns(60)["a.effort"], 0.0)
    read = log_of_frame({**columns(60), "a.effort": masked})
    assert np.array_equal(np.isnan(read.effort[:, 0]), masked.mask)


def test_frames_of_polars_that_numpy_does_not_know():
    polars = pytest.importorskip("polars")
    frame = polars.DataFrame(columns(60))
    assert np.array_equal(log_of_frame(frame.lazy()).effort, log_of_frame(frame).effort)
    wide = frame.with_columns(polars.lit(2**100, polars.Int128).alias("a.effort"))
    with pytest.raises(LogError, match="no frame of numbers that can be read"):
        log_of_frame(wide)


def test_tables_with_more_columns_than_any_robot(tmp_path):
    path = tmp_path / "wide.csv"
    path.write_text(f"time,{','.join(f'c{k}' for k in range(20_000))}\n", encoding="utf-8")
    with pytest.raises(LogError, match="20001 columns; at most 10000 are read"):
        read_log(path)
