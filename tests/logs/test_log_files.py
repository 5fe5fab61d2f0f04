"""Reading and writing logs, and what is said about bad ones."""

import bz2
import gzip
import lzma

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from odd_names import IN_XML

from geodrake.errors import LogError, OutputError
from geodrake.logs import JointLog, Reading, read_log, write_log

HEADER = "time,a.position,b.position,a.effort,b.effort"
ROWS = [f"{0.01 * k:.2f},{k},{-k},0.5,1.5" for k in range(12)]


def _write(folder, header=HEADER, rows=ROWS, name="log.csv"):
    path = folder / name
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def test_columns_in_any_order_with_spaces_and_strangers(tmp_path):
    header = "mode, arm.b.effort ,a.effort,time, a.position,arm.b.position , gripper.effort"
    rows = [f"auto,2,1,{0.1 * k},{k},,7" for k in range(12)]
    log = read_log(_write(tmp_path, header, rows))
    assert log.joints == ("a", "arm.b")
    assert log.velocity is None
    assert np.array_equal(log.position[:, 0], np.arange(12))
    assert np.isnan(log.position[:, 1]).all()
    assert np.array_equal(log.effort[0], [1, 2])
    assert log.notes == ("columns ignored: mode, gripper.effort",)


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
    with pytest.raises(LogError, match=r"'\.docx'"):
        read_log(_write(tmp_path, name="log.docx"))
    (tmp_path / "log.csv").write_bytes(bytes(range(256)) * 10)
    with pytest.raises(LogError, match="not UTF-8 text"):
        read_log(tmp_path / "log.csv")
    (tmp_path / "log.csv").write_bytes("time,a.position".encode("utf-16")[:-1])
    with pytest.raises(LogError, match="not UTF-16 text: truncated data"):
        read_log(tmp_path / "log.csv")
    (tmp_path / "log.csv").write_text("joint,effort\na,0.1 rad\na,0.2 rad\n")
    with pytest.raises(LogError):  # of words alone
        read_log(tmp_path / "log.csv")


def test_times_with_a_unit_of_their_own(tmp_path):
    time = np.arange(20)
    columns = {"a.position": np.sin(time), "a.effort": 1.0 * time}
    np.savez(tmp_path / "log.npz", time=time.astype("timedelta64[ms]"), **columns)
    np.testing.assert_allclose(read_log(tmp_path / "log.npz").time, 1e-3 * time)


def test_bad_arrays(tmp_path):
    good = {name: np.arange(12.0) for name in HEADER.split(",")}
    path = tmp_path / "log.npz"
    np.savez(path, **{**good, "a.effort": np.array(["x"] * 12)})
    with pytest.raises(LogError, match=r"'a.effort'.* has 'x', which is neither"):
        read_log(path)
    np.savez(path, **good, extra=np.eye(3))
    assert read_log(path).notes == ("columns with fewer values than rows: extra",)


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


@pytest.mark.parametrize(
    ("name", "words"),
    [("log.npz.gz", "is compressed"), ("log.xlsx", "sheet of Excel"), ("a.gz", "is")],
)
def test_what_is_packed_or_no_sheet_is_said(tmp_path, name, words):
    (tmp_path / name).write_bytes(b"PK and no more")
    with pytest.raises(LogError, match=words):
        read_log(tmp_path / name)
