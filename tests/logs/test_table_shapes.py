"""Tables as robots write them: lists and names in cells, a row a joint, JSON, HDF5, clocks."""

import csv
import json

import h5py
import numpy as np
import pandas
import pytest

from geodrake.errors import LogError
from geodrake.logs.files import Reading, read_log, text_file

JOINTS = ("base", "elbow")
ROWS = 60
TIME = 0.01 * np.arange(ROWS)
POSITION = np.column_stack([np.sin(3 * TIME), np.cos(2 * TIME)])
EFFORT = np.column_stack([4 * TIME, 1 - TIME])


def _write(path, header, rows):
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    return path


def _lists(folder):
    rows = zip(TIME, map(list, POSITION.tolist()), map(tuple, EFFORT.tolist()), strict=True)
    return _write(
        folder / "lists.csv",
        ["type", "time", "positions", "torques"],
        [
            ["STATE", time, positions, str(efforts).replace(",", "")]
            for time, positions, efforts in rows
        ],
    )


def _named_cells(folder, *, swaps=False):
    rows = []
    for k in range(ROWS):
        order = [1, 0] if swaps and k % 2 else [0, 1]
        names = [JOINTS[j] for j in order]
        rows.append(
            [int(1e9 * (1.7e9 + TIME[k])), "world", *names, *POSITION[k][order], *EFFORT[k][order]]
        )
    header = ["%time", "field.header.frame_id", "field.name0", "field.name1"]
    header += [f"field.{q}{k}" for q in ("position", "effort") for k in (0, 1)]
    return _write(folder / "echo.csv", header, rows)


def _swapping_cells(folder):
    return _named_cells(folder, swaps=True)


def _long(folder):
    rows = [
        [TIME[k], joint, POSITION[k, j], EFFORT[k, j]]
        for k in range(ROWS)
        for j, joint in enumerate(JOINTS)
    ]
    return _write(folder / "long.csv", ["time", "joint", "position", "effort"], rows)


def _long_parquet(folder):
    frame = pandas.read_csv(_long(folder))
    frame.to_parquet(folder / "long.parquet")
    return folder / "long.parquet"


def _records(folder):
    path = folder / "messages.jsonl"
    records = [
        {
            "header": {"stamp": {"sec": 1700000000, "nanosec": round(1e9 * TIME[k])}},
            "name": JOINTS[::-1],
            "position": POSITION[k, ::-1].tolist(),
            "effort": EFFORT[k, ::-1].tolist(),
        }
        for k in range(ROWS)
    ]
    path.write_text("\n".join(map(json.dumps, records)))
    return path


def _object(folder):
    path = folder / "log.json"
    content = {"time": TIME.tolist(), "q": POSITION.tolist(), "tau": EFFORT.tolist(), "robot": "x"}
    path.write_text(json.dumps(content))
    return path


def _hdf5(folder):
    path = folder / "episode.hdf5"
    with h5py.File(path, "w") as file:
        file["timestamp"] = TIME
        file["observations/qpos"], file["observations/effort"] = POSITION, EFFORT
        file["observations/images/top"] = np.zeros((ROWS, 2, 2, 3), np.uint8)
    return path


def _names_in_lists(folder):
    rows = [
        [TIME[k], list(JOINTS[::-1]), POSITION[k, ::-1].tolist(), EFFORT[k, ::-1].tolist()]
        for k in range(ROWS)
    ]
    return _write(folder / "names.csv", ["time", "name", "position", "effort"], rows)


def _reversed():
    return {"time": TIME, "q": POSITION[:, ::-1], "tau": EFFORT[:, ::-1]}


def _names_once_in_json(folder):
    path, content = folder / "names.json", {"joint_names": JOINTS[::-1]}
    content |= {name: values.tolist() for name, values in _reversed().items()}
    path.write_text(json.dumps(content))
    return path


def _names_once_in_npz(folder):
    np.savez(folder / "names.npz", joint_names=JOINTS[::-1], **_reversed())
    return folder / "names.npz"


def _names_once_in_hdf5(folder):
    with h5py.File(folder / "names.h5", "w") as file:
        file["joint_names"] = list(JOINTS[::-1])
        for name, values in _reversed().items():
            file[name] = values
    return folder / "names.h5"


def _names_in_parquet(folder):
    lists = {name: list(values) for name, values in _reversed().items()}
    frame = pandas.DataFrame({**lists, "time": TIME, "name": [list(JOINTS[::-1])] * ROWS})
    frame.to_parquet(folder / "names.parquet")
    return folder / "names.parquet"


def _frame():
    names = [f"{joint}.{q}" for q in ("position", "effort") for joint in JOINTS]
    table = pandas.DataFrame(np.hstack([POSITION, EFFORT]), columns=names)
    table.insert(0, "time", TIME)
    return table


def _text(name, change, **options):
    """A CSV of the frame, changed."""

    def write(folder):
        frame = change(_frame())
        frame.to_csv(folder / f"{name}.csv", index=False, **options)
        return folder / f"{name}.csv"

    write.__name__ = f"_{name}"
    return write


def _with_times(form):
    moments = [pandas.Timestamp("2026-05-01 12:00:00") + pandas.Timedelta(seconds=t) for t in TIME]
    return lambda frame: frame.assign(time=[moment.strftime(form) for moment in moments])


def _two_levels(frame):
    below = [["", *JOINTS, *JOINTS], ["time", *["position"] * 2, *["effort"] * 2]]
    return frame.set_axis(pandas.MultiIndex.from_arrays(below[::-1]), axis=1)


def _frame_as_json(orient):
    def write(folder):
        _frame().to_json(folder / "frame.json", orient=orient, double_precision=15)
        return folder / "frame.json"

    write.__name__ = f"_frame_as_{orient}"
    return write


def _for_excel(folder):
    text = _frame().to_csv(index=False, sep=";", decimal=",")
    (folder / "excel.csv").write_text(f"sep=;\n{text}")
    return folder / "excel.csv"


def _echo_of_ros2(folder):
    stamps = [(1700000000, round(1e9 * t), "world", *JOINTS[::-1]) for t in TIME]
    nothing = np.zeros_like(POSITION)
    numbers = np.hstack([POSITION[:, ::-1], nothing, EFFORT[:, ::-1]]).tolist()
    rows = [[*stamp, *row] for stamp, row in zip(stamps, numbers, strict=True)]
    return _write(folder / "echo.csv", rows[0], rows[1:])


def _preceded(folder):
    text = _frame().to_csv(index=False)
    (folder / "preceded.csv").write_text(f"Robot,UR5\nRate,100 Hz\n\nrecorded by hand\n{text}")
    return folder / "preceded.csv"


def _labelled(folder):
    (folder / "labelled.txt").write_text(_frame().to_string(float_format="{:.17g}".format))
    return folder / "labelled.txt"


def _cut_off(folder):
    text = pandas.concat([_frame()] * 3).assign(time=0.01 * np.arange(3 * ROWS))
    (folder / "cut.csv").write_text(text.to_csv(index=False) + "end of log\n")
    return folder / "cut.csv"


def _turned_npz(folder):
    np.savez(folder / "turned.npz", time=TIME, q=POSITION.T, tau=EFFORT.T)
    return folder / "turned.npz"


def _lerobot_parquet(folder):
    features = {"observation.state": list(POSITION), "observation.effort": list(EFFORT)}
    path = folder / "episode_000000.parquet"
    pandas.DataFrame({"timestamp": TIME, **features}).to_parquet(path)
    return path


ORDINARY = [
    _text("clock", _with_times("%H:%M:%S.%f")),
    _text("strokes", _with_times("%Y/%m/%d %H:%M:%S.%f")),
    _text("timedelta", lambda f: f.assign(time=[str(pandas.Timedelta(seconds=t)) for t in TIME])),
    _text(
        "arrays", lambda f: f[["time"]].assign(q=[*map(repr, POSITION)], tau=[*map(repr, EFFORT)])
    ),
    _text("levels", _two_levels),
    _frame_as_json("columns"),
    _frame_as_json("split"),
    _for_excel,
    _preceded,
    _labelled,
    _echo_of_ros2,
    _turned_npz,
    _lerobot_parquet,
]
NAMED = [
    _names_in_lists,
    _names_once_in_json,
    _names_once_in_npz,
    _names_once_in_hdf5,
    _names_in_parquet,
]
SHAPES = [
    *NAMED,
    *ORDINARY,
    _lists,
    _named_cells,
    _swapping_cells,
    _long,
    _long_parquet,
    _records,
    _object,
    _hdf5,
]


@pytest.mark.parametrize("write", SHAPES)
def test_a_table_of_any_shape_is_the_same_log(tmp_path, write):
    log = read_log(write(tmp_path), joints=JOINTS)
    assert log.joints == JOINTS
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-6)
    np.testing.assert_allclose(log.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(log.effort, EFFORT, atol=1e-12)


def test_a_last_row_that_is_cut_off_is_left_out(tmp_path):
    log = read_log(_cut_off(tmp_path))
    assert len(log) == 3 * ROWS
    assert any("left out 1 bad rows" in note for note in log.notes)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_row_a_joint_by_its_number(tmp_path, kind):
    frame = pandas.read_csv(_long(tmp_path)).rename(columns={"joint": "motor_id"})
    frame["motor_id"] = frame["motor_id"].map(dict(zip(JOINTS, (11, 12), strict=True)))
    path = tmp_path / f"numbers.{kind}"
    getattr(frame, f"to_{kind}")(path, index=False)
    log = read_log(path)
    assert log.joints == ("joint_11", "joint_12")
    np.testing.assert_allclose(log.effort, EFFORT)


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("word", ["NA", "N/A", "null", "None", "-", "#N/A", "NaN"])
def test_words_for_nothing(tmp_path, monkeypatch, word, many):
    monkeypatch.setattr(text_file, "_MANY", 20 if many else 10**6)
    frame = _frame().astype(object)
    frame.iloc[0, 3] = frame.iloc[30, 4] = word
    frame.to_csv(tmp_path / "log.csv", index=False)
    effort = EFFORT.copy()
    effort[0, 0] = effort[30, 1] = np.nan
    np.testing.assert_allclose(read_log(tmp_path / "log.csv").effort, effort)


def test_a_log_without_a_model_has_the_joints_that_its_cells_name(tmp_path):
    for write in (_named_cells, _long, _records):
        assert set(read_log(write(tmp_path)).joints) == set(JOINTS)


def test_a_row_a_joint_with_what_was_commanded_and_other_units(tmp_path):
    header = ["time", "joint", "position_commanded", "position_deg", "effort_Nmm"]
    rows = [
        [1e3 * TIME[k], joint, 7.0, np.degrees(POSITION[k, j]), 1e3 * EFFORT[k, j]]
        for k in range(ROWS)
        for j, joint in enumerate(JOINTS)
    ]
    path = _write(tmp_path / "long.csv", header, rows)
    log = read_log(path, joints=JOINTS, reading=Reading(units={"time": "ms"}))
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-9)
    np.testing.assert_allclose(log.position, POSITION, atol=1e-9)
    np.testing.assert_allclose(log.effort, EFFORT, atol=1e-9)


@pytest.mark.parametrize("first", [0.0, 5.0])  # s at which the second joint begins
def test_one_joint_after_the_other_is_no_row_a_joint(tmp_path, first):
    """Of joints that move one at a time, nobody knows where the others stand."""
    rows = [
        [j * first + TIME[k], joint, POSITION[k, j], EFFORT[k, j]]
        for j, joint in enumerate(JOINTS)
        for k in range(ROWS - 15 * j)
    ]
    path = _write(tmp_path / "one.csv", ["time", "joint", "position", "effort"], rows)
    with pytest.raises(LogError, match=r"one joint after the other, as 'joint' says"):
        read_log(path)
    together = [  # each with stamps of its own
        [TIME[k] + 1e-7 * j, joint, POSITION[k, j], EFFORT[k, j]]
        for j, joint in enumerate(JOINTS)
        for k in range(ROWS)
    ]
    path = _write(tmp_path / "all.csv", ["time", "joint", "position", "effort"], together)
    np.testing.assert_allclose(read_log(path, joints=JOINTS).effort, EFFORT, atol=1e-6)


@pytest.mark.parametrize(
    ("write", "old", "new", "row"),
    [(_long, f"{TIME[3]},elbow,", f"{TIME[3]},,", 8), (_named_cells, "base,elbow", "base,", 1)],
)
def test_cells_without_a_name_are_said(tmp_path, write, old, new, row):
    path = write(tmp_path)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(LogError, match=rf"Row {row} .* names no joint in column '"):
        read_log(path)


@pytest.mark.parametrize("without", [{"elbow"}, {*JOINTS}])
def test_a_joint_without_time_is_said(tmp_path, without):
    """Without a warning of NumPy's, which tests take for an error."""
    rows = [
        ["" if joint in without else TIME[k], joint, POSITION[k, j], EFFORT[k, j]]
        for j, joint in enumerate(JOINTS)
        for k in range(ROWS)
    ]
    path = _write(tmp_path / "long.csv", ["time", "joint", "position", "effort"], rows)
    with pytest.raises(LogError, match="has no number in its column of time"):
        read_log(path)


@pytest.mark.parametrize("kind", ["json", "parquet"])
def test_lists_that_are_missing_in_some_rows(tmp_path, kind):
    content = {"time": TIME.tolist(), "q": POSITION.tolist(), "tau": EFFORT.tolist()}
    content["tau"][5], content["limits"], content["gains"] = None, [1, 2], [3, 4]
    content["q"][7][1] = None
    path = tmp_path / f"log.{kind}"
    if kind == "json":
        path.write_text(json.dumps(content))
    else:
        pandas.DataFrame({n: content[n] for n in ("time", "q", "tau")}).to_parquet(path)
    log = read_log(path)
    assert np.isnan(log.effort[5]).all()
    assert np.isnan(log.position[7, 1])
    np.testing.assert_array_equal(np.delete(log.effort, 5, 0), np.delete(EFFORT, 5, 0))


def test_lists_of_several_lengths_in_json(tmp_path):
    content = {"time": TIME.tolist(), "q": POSITION.tolist(), "tau": EFFORT.tolist()}
    content["tau"][5] = [1.0]
    (tmp_path / "log.json").write_text(json.dumps(content))
    with pytest.raises(LogError, match=r"lists of 2 numbers, and one of 1 in row 6") as caught:
        read_log(tmp_path / "log.json")
    assert "'tau'" in str(caught.value)


def test_a_list_of_another_length_is_a_bad_row(tmp_path):
    path = _lists(tmp_path)
    lines = path.read_text().splitlines()
    lines[20] = 'STATE,0.19,"[1.0]","(0.1 0.2)"'
    path.write_text("\n".join(lines))
    with pytest.raises(LogError, match=r"Row 20, column 'positions'.*no list of 2 numbers"):
        read_log(path)


def test_joints_that_the_model_lacks_are_left_out_and_named(tmp_path):
    header = ["time", *(f"{j}.{q}" for j in (*JOINTS, "gripper") for q in ("position", "effort"))]
    rows = np.column_stack([TIME, *(c for j in (0, 1, 0) for c in (POSITION[:, j], EFFORT[:, j]))])
    path = _write(tmp_path / "log.csv", header, rows.tolist())
    log = read_log(path, joints=JOINTS)
    assert log.joints == JOINTS
    assert log.left_out == ("gripper",)
    with pytest.raises(LogError, match="no joint 'elbow'"):  # misspelled, not one joint more
        read_log(path, joints=("base", "elbows", "gripper"), partial=True)


def _with_time(folder, time, name="time"):
    rows = np.column_stack([time, POSITION[:, 0], EFFORT[:, 0]])
    return _write(folder / "log.csv", [name, "a.position", "a.effort"], rows.tolist())


def test_a_clock_that_was_set_back_leaves_a_gap(tmp_path):
    time = TIME - 0.15 * (np.arange(ROWS) >= 30)
    log = read_log(_with_time(tmp_path, time))
    steps = np.diff(log.time)
    assert np.all(steps > 0)
    assert steps[29] == pytest.approx(1.0)
    np.testing.assert_allclose(np.delete(steps, 29), 0.01, atol=1e-9)
    assert any("set back by 0.14 s at row 31" in note for note in log.notes)


def _log_at(folder, stamps, time):
    rows = np.column_stack([stamps, np.sin(3 * time) + 0.1 * np.cos(7 * time), np.cos(time)])
    return read_log(_write(folder / "log.csv", ["time", "a.position", "a.effort"], rows.tolist()))


@pytest.mark.parametrize("together", [2, 5, 10])
@pytest.mark.parametrize("apart", [0.0, 1e-4])
@pytest.mark.parametrize("lost", [0.0, 0.03])
def test_rows_that_were_stamped_on_arrival(tmp_path, together, apart, lost):
    random, row = np.random.default_rng(together), np.arange(3000)
    row = row[random.random(len(row)) >= lost]
    time, place = 0.01 * row, np.arange(len(row))
    burst = place // together * together
    stamps = time[np.minimum(burst + together - 1, len(row) - 1)] + apart * (place - burst)
    log = _log_at(tmp_path, stamps, time)
    assert any("were stamped on arrival" in note for note in log.notes)
    steps = np.diff(log.time)
    assert len(log) == len(row) and (steps > 0).all()
    late = log.time - time
    assert np.abs(late[100:-100] - np.median(late)).max() < (0.02 if lost else 0.002)


def test_rows_at_irregular_instants_keep_their_stamps(tmp_path):
    time = np.cumsum(np.random.default_rng(0).exponential(0.01, 3000)).round(9)
    log = _log_at(tmp_path, time, time)
    np.testing.assert_array_equal(log.time, time)
    assert not any("arrival" in note for note in log.notes)


def test_rows_of_another_time_are_no_clock_set_back(tmp_path):
    time = TIME.copy()
    time[30:45] -= 0.25
    with pytest.raises(LogError, match="runs backwards"):
        read_log(_with_time(tmp_path, time))


@pytest.mark.parametrize(("factor", "unit"), [(1e6, "µs"), (1e3, "ms"), (1e9, "ns")])
def test_the_rate_tells_the_unit_of_time_that_nobody_said(tmp_path, factor, unit):
    log = read_log(_with_time(tmp_path, factor * TIME, "timestamp"))
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    assert any(f"time is in {unit}, as 100 rows a second say" in note for note in log.notes)


def test_turns_and_currents_of_an_odrive(tmp_path):
    header = ["time"] + [f"axis{j}.{n}" for j in (0, 1) for n in ("pos_estimate", "Iq_measured")]
    columns = [c for j in (0, 1) for c in (POSITION[:, j] / (2 * np.pi), EFFORT[:, j])]
    path = _write(tmp_path / "odrive.csv", header, np.column_stack([TIME, *columns]).tolist())
    log = read_log(path, joints=JOINTS)
    np.testing.assert_allclose(log.position, POSITION, atol=1e-12)
    assert log.effort_kinds == dict.fromkeys(JOINTS, "current")


@pytest.mark.parametrize("odd", ["none", "empty cell", "cut off", "text", "one cell more"])
def test_many_lines_are_read_by_arrow_as_without_it(tmp_path, monkeypatch, odd):
    random = np.random.default_rng(0).normal(size=(ROWS, 3)) * 10.0 ** np.arange(-9, 9, 6)
    rows = [[repr(v) for v in row] for row in np.column_stack([TIME, random]).tolist()]
    if odd == "empty cell":
        rows[50][2] = ""
    elif odd != "none":
        rows[50] = {"cut off": rows[50][:2], "text": ["0.5", "x", "1", "1"]}.get(
            odd, [*rows[50], "1"]
        )
    path = _write(tmp_path / "log.csv", ["time", "a.position", "a.effort", "a.noise"], rows)

    def read():
        try:
            return read_log(path)
        except LogError as error:
            return str(error)

    plain = read()
    monkeypatch.setattr(text_file, "_MANY", 20)
    again = read()
    assert isinstance(plain, str) == (odd not in ("none", "empty cell"))
    if isinstance(plain, str):
        assert again == plain
    else:
        np.testing.assert_array_equal(again.position, random[:, :1])
        np.testing.assert_array_equal(again.effort, plain.effort)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.json", '{"a": 1', "no JSON file that can be read"),
        ("a.json", "3", "neither an object nor records"),
        ("a.jsonl", "[1]\n[2]", "neither an object nor records"),
        ("a.h5", "no archive", "no HDF5 file that can be read"),
    ],
)
def test_files_that_are_none_of_their_kind(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(LogError, match=words):
        read_log(tmp_path / name)


def test_rows_with_some_of_the_columns_are_brought_together(tmp_path):
    """Positions and efforts of two tables that an outer join made one."""
    pandas = pytest.importorskip("pandas")
    early, late = np.arange(400) * 0.01, np.arange(200) * 0.02 + 0.003
    moved = pandas.DataFrame({"time": early, "a.position": np.sin(2.0 * early)})
    heard = pandas.DataFrame({"time": late, "a.effort": np.cos(late)})
    moved.merge(heard, on="time", how="outer").to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv")
    np.testing.assert_array_equal(log.time, late)
    np.testing.assert_array_equal(log.effort[:, 0], np.cos(late))
    np.testing.assert_allclose(log.position[:, 0], np.sin(2.0 * late), atol=1e-4)
    assert "all are brought to the instants of the rarest, 200 of 600 rows" in log.notes[-1]


@pytest.mark.parametrize("late", [0.1, 1.0])
def test_rows_out_of_order_are_sorted_where_that_makes_positions_smooth(tmp_path, late):
    """A tenth of them came one row late, or all in any order."""
    rng, time = np.random.default_rng(3), np.arange(400) * 0.01
    rows = np.stack([time, np.sin(3.0 * time), np.cos(time)], 1)
    late_by = 1.5 if late < 1.0 else rng.random(400) * 400.0
    order = np.argsort(np.arange(400) + late_by * (rng.random(400) < late), kind="stable")
    path, header = tmp_path / "log.csv", ["time", "a.position", "a.effort"]
    _write(path, header, rows[order])
    log = read_log(path)
    np.testing.assert_allclose(log.position[:, 0], rows[:, 1], atol=1e-9)
    assert "rows were not in the order of time: sorted by it" in log.notes
    rows[:, 0] = time[order]  # time alone is damaged
    _write(path, header, rows)
    with pytest.raises(LogError, match="backwards"):
        read_log(path)
