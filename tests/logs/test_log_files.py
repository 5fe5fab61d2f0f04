"""Files of logs that are read and written, and messages on bad ones."""

import bz2
import gzip
import lzma
import os
import struct
from dataclasses import replace

import h5py
import numpy as np
import pytest
from foreign_logs import blank, lerobot, rosbag2_mcap, rosbag2_sqlite3
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from odd_names import IN_XML
from pendulum_logs import PENDULUM, pendulum_log

from geodrake.diagnosis import compare
from geodrake.errors import LogError, OutputError
from geodrake.logs import JointLog, Reading, log_of_frame, read_log, write_log
from geodrake.logs.files.table import check_room
from geodrake.logs.inspection import inspect_log
from geodrake.logs.units_of_values import effort_unit_hint
from geodrake.model import load_model, model_of_logs

HEADER = "time,a.position,b.position,a.effort,b.effort"
ROWS = [f"{0.01 * k:.2f},{k},{-k},0.5,1.5" for k in range(12)]


def _write(folder, header=HEADER, rows=ROWS, name="log.csv"):
    path = folder / name
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_velocity_of_some_joints_only_is_noted(tmp_path):
    log = read_log(_write(tmp_path, HEADER + ",a.velocity", [row + ",0" for row in ROWS]))
    assert log.velocity is None and "b.velocity" in log.notes[0]


numbers = st.floats(-1e9, 1e9) | st.just(np.nan)


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    steps=arrays(float, st.integers(10, 20), elements=st.floats(1e-6, 1e3)),
    data=st.data(),
    joints=st.lists(
        st.text("abc._-12", min_size=1, max_size=6).filter(lambda name: name.strip(".")),
        min_size=1,
        max_size=3,
        unique=True,
    ),
    quantities=st.sets(st.sampled_from(["velocity", "acceleration"])),
)
def test_round_trip(tmp_path, suffix, steps, data, joints, quantities):
    values = arrays(float, (len(steps), len(joints)), elements=numbers)
    more = {quantity: data.draw(values) for quantity in sorted(quantities)}
    log = JointLog(
        "log", tuple(joints), np.cumsum(steps), data.draw(values), data.draw(values), **more
    )
    path = tmp_path / f"log{suffix}"
    write_log(log, path)
    again = read_log(path)
    assert again.name == log.name
    assert again.joints == log.joints
    assert again.notes == ()
    for field in ("time", "position", "effort", "velocity", "acceleration"):
        one, other = getattr(log, field), getattr(again, field)
        assert (one is None) == (other is None)
        assert one is None or np.array_equal(one, other, equal_nan=True)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    path.unlink()


def _replace(k, row):
    return [*ROWS[:k], row, *ROWS[k + 1 :]]


@pytest.mark.parametrize(
    ("header", "rows", "parts"),
    [
        (HEADER, _replace(4, "0.04,1,x7,3,4"), ["Row 5", "'b.position'", "'x7'"]),
        (HEADER, _replace(4, "0.04,1,2,3"), ["Row 5", "line 6", "4 cells", "has 5"]),
        (HEADER, _replace(4, "0.04,1,2,3,4,5"), ["Row 5", "6 cells"]),
        (HEADER, _replace(4, "0.005,1,2,3,4"), ["backwards", "row 4 ", "row 5 ", "0.005", "0.03"]),
        (HEADER, _replace(4, "0.03,1,2,3,4"), ["repeats", "row 4 ", "row 5 ", "0.03 s"]),
        (HEADER, [f"3.5{row[4:]}" for row in ROWS], ["is constant", "3.5 s"]),
        (HEADER, ROWS[:3], ["3 rows", "10"]),
        (HEADER, [], ["0 rows"]),
        ("", [], ["no header"]),
        (ROWS[0], ROWS[1:], ["no header", "0.00,0,0,0.5"]),
        (
            HEADER.replace("time", "Instant"),
            [f"{k}{row[4:]}" for k, row in enumerate(ROWS)],
            ["no column 'time'", "Instant", "a.position", "--rate"],
        ),
        (HEADER.replace("effort", "colour"), ROWS, ["no joint with both", "a, b", "none"]),
        (HEADER.replace("b.effort", "c.effort"), ROWS, ["has positions but no efforts of b"]),
        (HEADER.replace("b.effort", "a.effort"), ROWS, ["duplicate columns", "a.effort"]),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path, header, rows, parts):
    with pytest.raises(LogError) as caught:
        read_log(_write(tmp_path, header, rows))
    for part in parts:
        assert part in str(caught.value)
    assert caught.value.advice


def test_unreadable_files(tmp_path):
    with pytest.raises(LogError, match="does not exist"):
        read_log(tmp_path / "missing.csv")
    with pytest.raises(LogError, match=r"^The folder .* is neither"):
        read_log(tmp_path)
    for name, content, words in (
        ("log.docx", b"words", r"'\.docx'"),
        ("log.csv", bytes(range(256)) * 10, "not UTF-8 text"),
        ("log.csv", "time,a.position".encode("utf-16")[:-1], "not UTF-16-LE text: truncated data"),
        ("log.csv", b"time q1 tau1\n\n\n", "0 rows"),
        ("log.csv", b"joint,effort\na,0.1 rad\na,0.2 rad\n", r"'effort' .* holds"),
        ("log.mat.gz", b"PK and no more", "is compressed"),
        ("log.xlsx", b"PK and no more", "sheet of Excel"),
        ("a.gz", b"PK and no more", "its name does not end in a format of text"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(LogError, match=words):
            read_log(tmp_path / name)


def test_bad_arrays(tmp_path):
    good = {name: np.arange(12.0) for name in HEADER.split(",")}
    path = tmp_path / "log.npz"
    np.savez(path, **{**good, "a.effort": np.array(["x"] * 12)})
    with pytest.raises(LogError, match=r"'a.effort'.* has 'x', which is neither"):
        read_log(path)
    np.savez(path, **good, extra=np.eye(3))
    assert read_log(path).notes == ("'extra' is not used: it has 3 rows, but others have 12",)
    np.savez(path, **{**good, "time": np.arange(12).astype("timedelta64[ms]")})
    np.testing.assert_allclose(read_log(path).time, 1e-3 * np.arange(12))


def test_failed_write_leaves_nothing(tmp_path):
    log = read_log(_write(tmp_path))
    with pytest.raises(OutputError, match="nowhere"):
        write_log(log, tmp_path / "nowhere" / "log.csv")
    with pytest.raises(OutputError, match=r"\.bag"):
        write_log(log, tmp_path / "log.bag")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(OutputError, match=r"folder\.csv"):
        write_log(log, tmp_path / "folder.csv")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["folder.csv", "log.csv"]


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
@pytest.mark.parametrize("what", IN_XML)
def test_a_written_log_has_the_names_that_it_was_given(what, suffix, tmp_path):
    names, values = (IN_XML[what], "elbow"), np.arange(20.0).reshape(10, 2)
    write_log(JointLog("log", names, np.arange(10.0), values, values), tmp_path / f"log{suffix}")
    again = read_log(tmp_path / f"log{suffix}", joints=names)
    assert again.joints == names
    np.testing.assert_array_equal(again.effort, values)


TABLE = "time,a.position,a.effort\n" + "".join(f"{k / 100},{k % 7},{k % 5}\n" for k in range(50))


def packed(path):
    pyarrow = pytest.importorskip("pyarrow")
    ways = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}
    way = ways.get(path.suffix, lambda data: pyarrow.compress(data, "zstd", asbytes=True))
    path.write_bytes(way(TABLE.encode()))


def as_sheet(path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["recorded by hand"])
    sheet = book.create_sheet("run 1")
    header, *rows = (line.split(",") for line in TABLE.splitlines())
    for row in (header, *(map(float, row) for row in rows)):
        sheet.append([*row])
    book.save(path)


def as_records(path):
    numbers = [tuple(map(float, line.split(","))) for line in TABLE.splitlines()[1:]]
    fields = [(name, float) for name in TABLE.splitlines()[0].split(",")]
    np.save(path, np.array(numbers, fields))


@pytest.mark.parametrize(
    ("name", "write"),
    [
        *((f"log.csv{suffix}", packed) for suffix in (".gz", ".bz2", ".xz", ".zst")),
        ("log.xlsx", as_sheet),
        ("log.npy", as_records),
    ],
)
def test_packed_tables_sheets_and_records_are_tables(tmp_path, name, write):
    path = tmp_path / name
    write(path)
    log = read_log(path)
    assert (log.name, len(log), log.joints, log.effort[7, 0]) == ("log", 50, ("a",), 2.0)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(LogError, match="is not a readable"):
        read_log(path)


def test_matrices_have_columns_of_the_names_that_are_given(tmp_path):
    path = tmp_path / "log.npy"
    np.save(path, np.random.default_rng(1).normal(size=(50, 3)) + [[k, 0, 0] for k in range(50)])
    with pytest.raises(LogError, match="has no header") as refused:
        read_log(path)
    assert "1" in refused.value.evidence["proposal"]
    named = Reading(rate=100.0, columns=("_", "a.position", "a.effort"))
    assert read_log(path, reading=named).joints == ("a",)


def columns(rows):
    t = np.arange(rows) / 100.0
    return {"time": t, "a.position": np.sin(t), "a.effort": np.cos(3.0 * t)}


@pytest.mark.parametrize("rows", [10, 11, 49, 50, 51])
def test_logs_shorter_than_a_window_are_inspected(tmp_path, rows):
    np.savez(tmp_path / "short.npz", **columns(rows))
    assert len(inspect_log(tmp_path / "short.npz").log) == rows


def doubling(file):
    group = file.create_group("g0")
    group["x"] = np.ones((1, 60))
    for k in range(24):
        inner, group = group, file.create_group(f"g{k + 1}")
        group["a"] = group["b"] = inner


def circular(file):
    group = file.create_group("s")
    group["again"] = group


def elsewhere(file):
    file["other"] = h5py.ExternalLink("/etc/passwd", "/x")
    file["nothing"] = h5py.Empty("f8")


def endless(file):
    file.create_dataset("z", (10**13,), "f8", chunks=(10**6,))


def deep(file):
    file.create_group("/".join("s" * 40))


@pytest.mark.parametrize(
    ("fill", "words"),
    [
        (doubling, ""),
        (circular, ""),
        (elsewhere, ""),
        (endless, "GB of memory"),
        (deep, "more than 30"),
    ],
)
def test_objects_of_matlab_files_are_visited_once(tmp_path, fill, words):
    path = tmp_path / "log.mat"
    with h5py.File(path, "w") as file:
        for name, values in columns(60).items():
            file[name.replace(".", "_")] = values[None]
        fill(file)
    if words:
        with pytest.raises(LogError, match=words):
            read_log(path)
        return
    read = read_log(path)
    assert read.joints == ("a",) and len(read) == 60


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
def test_invalid_messages_of_lcm(tmp_path, spoil, words):
    with pytest.raises(LogError, match=words):
        read_log(spoiled_lcm(tmp_path / "torn.lcm", spoil))


def test_truncated_messages_at_the_end_of_lcm_logs(tmp_path):
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
def test_objects_other_than_numbers_are_refused(effort):
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


def test_tiny_limits_give_no_hint_at_units(pendulum):
    assert effort_unit_hint(pendulum, 1e-308) is None
    strong = replace(pendulum, effort=np.full_like(pendulum.effort, 1e308))
    assert "other units" in effort_unit_hint(strong, 1e-8)
