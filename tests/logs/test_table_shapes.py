"""Tables in the shapes that robots write: lists in cells, a row for each joint, JSON, HDF5."""

import json
from pathlib import Path
from zipfile import ZipFile

import h5py
import numpy as np
import pandas
import pytest
import yaml
from pinocchio_logs import MODELS
from scipy.io import savemat

from geodrake import load_model
from geodrake.errors import LogError
from geodrake.logs import Reading, read_log
from geodrake.logs.files import read_mapping, text_file
from geodrake.logs.files.grouped_arrays import one_after_another
from geodrake.logs.files.reading import ColumnMapping, MappedColumn
from geodrake.logs.files.table import LogTable
from geodrake.logs.sensor_faults import without_faults
from geodrake.model.logged_joints import reading_for

JOINTS = ("base", "elbow")
ROWS = 60
TIME = 0.01 * np.arange(ROWS)
POSITION = np.column_stack([np.sin(3 * TIME), np.cos(2 * TIME)])
VELOCITY = np.column_stack([3 * np.cos(3 * TIME), -2 * np.sin(2 * TIME)])
EFFORT = np.column_stack([4 * TIME, 1 - TIME])
PLAIN = pandas.DataFrame(
    np.column_stack([TIME, POSITION, EFFORT]),
    columns=["time", *(f"{joint}.{q}" for q in ("position", "effort") for joint in JOINTS)],
)
MOMENTS = pandas.Timestamp("2026-05-01 12:00:00") + pandas.to_timedelta(TIME, unit="s")
LISTS = {"time": TIME, "q": POSITION, "tau": EFFORT}
TURNED = {"time": TIME, "q": POSITION[:, ::-1], "tau": EFFORT[:, ::-1]}
REVERSED = [
    (t, [*zip(JOINTS[::-1], q, tau, strict=True)])
    for t, q, tau in zip(TIME, TURNED["q"].tolist(), TURNED["tau"].tolist(), strict=True)
]
"""Time, and the joints in reverse order with position and effort."""
LIST_RECORDS = [
    dict(zip(("name", "position", "effort"), map(list, zip(*each, strict=True)), strict=True))
    | {"time": float(t)}
    for t, each in REVERSED
]
UNNAMED = [{"time": r["time"], "q": r["position"], "tau": r["effort"]} for r in LIST_RECORDS]

TEXTS = [str(tuple(row)).replace(",", "") for row in EFFORT.tolist()]
IN_CELLS = pandas.DataFrame(
    {"type": "STATE", "time": TIME, "positions": POSITION.tolist(), "torques": TEXTS}
)
A_ROW_A_JOINT = pandas.DataFrame(
    {
        "time": np.repeat(TIME, 2),
        "joint": JOINTS * ROWS,
        "position": POSITION.ravel(),
        "effort": EFFORT.ravel(),
    }
)


def listed(table):
    """Return columns whose cells are lists where an array has several columns."""
    return {name: values.tolist() for name, values in table.items()}


NAMED = pandas.DataFrame({**listed(TURNED), "name": [JOINTS[::-1]] * ROWS})
NAMED["name"] = NAMED["name"].map(list)


def named_cells(swaps=False):
    order = np.array([[0, 1]] * ROWS)
    order[1::2] = [1, 0] if swaps else [0, 1]
    columns = {"%time": (1e9 * (1.7e9 + TIME)).astype(int), "field.header.frame_id": "world"}
    named = {"name": np.array([JOINTS] * ROWS), "position": POSITION, "effort": EFFORT}
    for name, values in named.items():
        picked = np.take_along_axis(values, order, 1)
        columns |= {f"field.{name}{k}": picked[:, k] for k in (0, 1)}
    return pandas.DataFrame(columns)


def records():
    stamps = [{"stamp": {"sec": 1700000000, "nanosec": round(1e9 * t)}} for t in TIME]
    columns = {"header": stamps, "name": [JOINTS[::-1]] * ROWS}
    for name, values in (("position", POSITION), ("effort", EFFORT)):
        columns[name] = values[:, ::-1].tolist()
    return pandas.DataFrame(columns)


def echo_of_ros2():
    stamps = [(1700000000, round(1e9 * t), "world", *JOINTS[::-1]) for t in TIME]
    numbers = np.hstack([POSITION[:, ::-1], 0.0 * POSITION, EFFORT[:, ::-1]])
    return pandas.concat([pandas.DataFrame(stamps), pandas.DataFrame(numbers)], axis=1)


def in_hdf5(more, attributes=()):
    def write(path):
        with h5py.File(path, "w") as file:
            for name, values in more.items():
                file[name] = values
            for name in attributes:
                file[name].attrs.update(attributes[name])

    return write


def table(frame, **options):
    return lambda path: frame.to_csv(path, **{"index": False, **options})


def text(content):
    return lambda path: path.write_text(content)


def arrays(**values):
    return lambda path: np.savez(path, **values)


def times(form):
    return table(PLAIN.assign(time=MOMENTS.strftime(form)))


def echo_of_ros1():
    stamps = (1.7e18 + 1e9 * TIME).astype(int)
    head = pandas.DataFrame({0: stamps, 1: range(ROWS), 2: stamps, 3: ""})
    return pandas.concat([head, echo_of_ros2().iloc[:, 3:]], axis=1)


def numbered(blocks, form="{}_{}", *, clock="time", first=0, separator=","):
    """Write columns of two joints for each pair of a name and what it holds."""
    deg = np.rad2deg(POSITION)
    known = {"q": POSITION, "v": VELOCITY, "tau": EFFORT, "deg": deg, "turns": deg / 360}
    columns = {clock: TIME}
    for name, said in zip(blocks.split()[::2], blocks.split()[1::2], strict=True):
        quantity, _, more = said.partition("+")
        values = known.get(quantity, 0.0 * TIME[:, None] + [7.0, 7.0]) + float(more or 0)
        columns |= {form.format(name, first + k): values[:, k] for k in (0, 1)}
    return table(pandas.DataFrame(columns | {"mode": 7}), sep=separator)


def logger(clock, position, effort, joints=(1, 2), factor=1.0, *, units=""):
    """Write columns by the forms of their names, with a line of units or none."""
    names = [clock, *map(position.format, joints), *map(effort.format, joints)]
    columns = PLAIN.set_axis(names, axis=1)
    columns[names[1:3]] *= factor
    head, *rows = columns.to_csv(index=False).splitlines()
    return text("\n".join([head, *[units] * bool(units), *rows]))


def odd_text(head, *, times=1, factor=1.0, fortran=False, end=""):
    """Write rows below a header, in the encoding of Windows."""
    mark = next((mark for mark in ";," if mark in head), "  ")
    numbers = np.repeat(PLAIN.to_numpy() * [factor, 1, 1, 1, 1], times, axis=0)
    form = "{:.17e}" if fortran else "{!r}"
    rows = (mark.join(map(form.format, row)) + end for row in numbers.tolist())
    content = "\n".join([head, *rows])
    return lambda path: path.write_bytes(
        (content.replace("e", "D") if fortran and "e" not in head else content).encode("cp1252")
    )


def tables_with_keys(kind, times):
    """Write degrees as TwinCAT or LabVIEW does, at (signals, N) times."""
    is_pair = "pairs" in kind
    names = [f"{what} J{k}" for what in ("Angle", "Torque") for k in (1, 2)]
    said = {"X_Value" if kind == "LabVIEW" else "Name": names, "SymbolComment": ["-"] * 4}
    said |= {"SampleTime[ms]": ["10"] * 4, "Data-Type": ["REAL64"] * 4}
    said["Unit"] = ["deg", "deg", "Nm", "Nm"]
    values = np.vstack([np.rad2deg(POSITION.T), EFFORT.T])
    both = np.stack([times, values], 1).reshape(8, -1) if is_pair else [times[0], *values]
    head = [
        "\t".join(each for cell in cells for each in (name, cell))
        if is_pair
        else "\t".join([name, *cells])
        for name, cells in said.items()
    ]
    if kind == "LabVIEW":
        head.append("***End_of_Header***\t")
        head.append(f"{head.pop(0)}\tComment")
    rows = ("\t".join(map(repr, r)) for r in np.transpose(both).tolist())
    return text("\n".join(["a title", "File\tC:\\arm", "", *head, "", *rows]))


def echoed(*more):
    """Write a YAML document for each message of ROS; the last may be truncated."""
    messages = [
        f"header:\n  stamp:\n    sec: 1700000000\n    nanosec: {round(1e9 * t)}\n"
        f"  frame_id: ''\nname:\n- elbow\n- base\nposition: {q[::-1].tolist()}\n"
        f"velocity: []\neffort: {tau[::-1].tolist()}\n"
        for t, q, tau in zip(TIME, POSITION, EFFORT, strict=True)
    ]
    return text("---\n".join([*messages, *(more or [messages[0][:90]]), *len(more) * messages]))


def frame_of_pandas(index):
    """Write a frame as pandas does in HDF5, indexed by time or by row."""
    names = [*["time"] * (not index), "q0", "q1", "tau0", "tau1"]
    values = PLAIN.to_numpy()[:, index:]
    return in_hdf5({"df/axis0": np.array(names, "S"), "df/block0_items": np.array(names, "S"),
        "df/axis1": TIME if index else np.arange(ROWS), "df/block0_values": values})  # fmt: skip


def records_of_motors(columns, inside=""):
    """Write records of the motors 1 and 2 at each instant, alone or in a list."""
    rows = [
        [{"id": k + 1, **{n: float(x[i, k]) for n, x in columns.items()}} for k in (0, 1)]
        for i in range(ROWS)
    ]
    alone = [{"time": t, **each} for t, row in zip(TIME, rows, strict=True) for each in row]
    lists = [{"time": t, inside: row} for t, row in zip(TIME, rows, strict=True)]
    return text("\n".join(map(json.dumps, lists if inside else alone)))


def zipped(members):
    def write(path):
        with ZipFile(path, "w") as archive:
            for name, content in members.items():
                archive.writestr(name, content)

    return write


def under(head, *, encoding="utf-8", separator=","):
    """Write the rows of the plain table below another header."""
    rows = PLAIN.to_csv(index=False, header=False, sep=separator)
    return lambda path: path.write_bytes(f"{head}\n{rows}".encode(encoding))


def of_octave(variables, *others):
    """Write matrices, and other variables, as Octave's `save` does."""
    each = (
        f"# name: {name}\n# type: matrix\n# rows: {len(x)}\n# columns: {x.shape[1]}\n"
        + "\n".join(" " + " ".join(map(repr, row)) for row in x.tolist())
        for name, x in variables.items()
    )
    return text("\n\n\n".join(["# Created by Octave 8.4.0, Fri May 01 2026", *others, *each]))


IN_GERMAN = pandas.DataFrame(
    {
        "Zeit [ms]": 1e3 * TIME,
        **{f"Winkel {k} [°]": np.rad2deg(POSITION[:, k - 1]) for k in (1, 2)},
        **{f"Drehmoment {k} [Nm]": EFFORT[:, k - 1] for k in (1, 2)},
    }
)
LEVELS = [["time", *["position"] * 2, *["effort"] * 2], ["", *JOINTS, *JOINTS]]
OBSERVED = {"observations/qpos": POSITION, "observations/effort": EFFORT, "timestamp": TIME}
LEROBOT = {"timestamp": TIME, "observation.state": POSITION, "observation.effort": EFFORT}
PREAMBLE = "Robot,UR5\nRate,100 Hz\n\nrecorded by hand\n"
SHAPES = {
    "lists.csv": table(IN_CELLS),
    "cells.csv": table(named_cells()),
    "swapping_cells.csv": table(named_cells(swaps=True)),
    "long.csv": table(A_ROW_A_JOINT),
    "lines.json": lambda path: records().to_json(path, orient="records", lines=True,
        double_precision=15),
    "rows_under_names.json": text(json.dumps({"robot": "x", "header": [*PLAIN],
        "rows": PLAIN.to_numpy().tolist()})),
    "object.json": text(json.dumps({**listed(LISTS), "robot": "x", "remarks": []})),
    "episode.hdf5": in_hdf5({**OBSERVED, "images/top": np.zeros((ROWS, 2, 2, 3), np.uint8)}),
    "one_demonstration.hdf5": in_hdf5({"data/demo_7/obs/joint_pos": POSITION,
        "data/demo_7/obs/joint_torque": EFFORT, "data/demo_7/obs/t": TIME}),
    "motors.jsonl": text("\n".join(json.dumps({"time": t, "motor_state":
        [{"q": p, "tau_est": e, "temperature": [30, 90]} for p, e in zip(q, tau, strict=True)]})
        for t, q, tau in zip(TIME, POSITION.tolist(), EFFORT.tolist(), strict=True))),
    "names.parquet": NAMED.to_parquet,
    "names_once.json": text(json.dumps({**listed(TURNED), "joint_names": JOINTS[::-1]})),
    "names_once.nc": in_hdf5({**TURNED, "joint": list(JOINTS[::-1])}),
    "named_motors.jsonl": text("\n".join(json.dumps({"time": t, "joints": [
        {"name": n, "position": p, "torque": e} for n, p, e in each]}) for t, each in REVERSED)),
    "message.json": text(json.dumps([{"topic": "/states", "timestamp": each["time"], "message":
        {k: each[k] for k in ("name", "position", "effort")}} for each in LIST_RECORDS])),
    "names_beside.json": text(json.dumps({"info": {"joint_names": JOINTS[::-1]}, "data": UNNAMED})),
    "lists_of_names.csv": table(pandas.DataFrame({"Time": TIME, "name": str([*JOINTS[::-1]])} | {
        f"{quantity}_{k}": values[:, 1 - k] for quantity, values in
        (("position", POSITION), ("effort", EFFORT)) for k in (0, 1)})),
    "typed_arrays.json": text(json.dumps([{n: dict(enumerate(x)) if n in ("position", "effort")
        else x for n, x in each.items()} for each in LIST_RECORDS])),
    "motors_from_0.json": text(json.dumps({"time": TIME.tolist(), "servos": {str(k): listed(
        {"position": POSITION[:, k], "effort": EFFORT[:, k]}) for k in (0, 1)}})),
    "records_of_motors_from_0.json": text(json.dumps([{"time": t, "motors": {str(k): {
        "position": q[k], "effort": tau[k]} for k in (0, 1)}} for t, q, tau in
        zip(TIME, POSITION.tolist(), EFFORT.tolist(), strict=True)])),
    "labels.csv": table(NAMED.rename(columns={"name": "labels"})),
    "labels.npz": arrays(labels=JOINTS[::-1], **TURNED),
    "keys_beside.json": text(json.dumps({"keys": JOINTS[::-1], "data": UNNAMED})),
    "names_in_attributes.h5": in_hdf5({f"arm/{name}": x for name, x in TURNED.items()},
        {"arm/q": {"joint_names": JOINTS[::-1]}}),
    "names_of_a_group.h5": in_hdf5({f"arm/{name}": x for name, x in TURNED.items()},
        {"arm": {"names": JOINTS[::-1]}}),
    "isaac.npz": arrays(dof_pos=TURNED["q"], dof_torque=TURNED["tau"],
        dof_names=JOINTS[::-1], step_dt=0.01),
    "one_robot_of_many.npz": arrays(joint_pos=POSITION[:, None],
        applied_torque=EFFORT[:, None], time=TIME),
    "records.h5": in_hdf5({"log": PLAIN.to_records(index=False)}),
    "gazebo.txt": text("".join(f"header {{\n stamp {{\n  sec: 17\n  nsec: {1e9 * t:.0f}\n }}\n}}\n"
        + "".join(f'joint {{\n name: "{n}"\n axis1 {{\n position: {p}\n force: {e}\n }}\n}}\n'
            for n, p, e in each) for t, each in REVERSED)),
    "simulink.mat": lambda path: savemat(path, {n: {"time": TIME[:, None], "signals": {"values": x,
        "label": label}} for n, x, label in (("q", POSITION, ""), ("tau", EFFORT, "tau"))}),
    "units_of_levels.csv": text("Time,Joint 1,,Joint 2,\nms,Position,Torque,Position,Torque\n"
        + pandas.DataFrame(np.column_stack([1e3 * TIME, POSITION, EFFORT])[:, [0, 1, 3, 2, 4]])
        .to_csv(index=False, header=False)),
    "first_column.csv": table(PLAIN.rename(columns={"time": "pc_ts"})),
    "duration.csv": table(PLAIN.rename(columns={"time": "duration"})
        .assign(duration=10 * np.arange(ROWS))),
    "console.log": text("\n".join(f"[INFO] [{1.7e9 + t:.9f}] [arm]: q: {a!r} {b!r} | tau: {c!r} "
        f"{d!r}"
        for t, (a, b), (c, d) in zip(TIME, POSITION.tolist(), EFFORT.tolist(), strict=True))),
    "lists_by_names.json": text(json.dumps({"time": TIME.tolist(), "joints": [
        {"name": n, **listed({"position": POSITION[:, k], "effort": EFFORT[:, k]})}
        for k, n in [*enumerate(JOINTS)][::-1]]})),
    "names_again.csv": table(PLAIN.set_axis(["t", "pos", "pos", "torque", "torque"], axis=1)),
    "names_of_pandas.csv": table(PLAIN.set_axis(["t", "pos", "pos.1", "trq", "trq.1"], axis=1)),
    "raw.csv": table(pandas.DataFrame({"t": TIME, "q_raw_1": TIME, "q_raw_2": TIME}).join(
        PLAIN.set_axis(["_", "q_filt_1", "q_filt_2", "tau_filt_1", "tau_filt_2"], axis=1))),
    "half_day.csv": times("%I:%M:%S.%f %p"),
    "colons.csv": table(PLAIN.assign(time=[f"{m:%H:%M:%S}:{m.microsecond // 1000:03}"
        for m in MOMENTS])),
    "melted.csv": table(PLAIN.melt(id_vars="time")),
    "fields.csv": table(A_ROW_A_JOINT.melt(["time", "joint"], var_name="_field",
        value_name="_value")),
    "samples.json": text(json.dumps({"robot": {"rate": 100}, "samples":
        pandas.DataFrame(listed(LISTS)).to_dict("records")})),
    "braces.csv": table(PLAIN[["time"]].assign(
        q=["{" + f"{a!r}, {b!r}" + "}" for a, b in POSITION.tolist()],
        tau=["{" + f"{a!r}, {b!r}" + "}" for a, b in EFFORT.tolist()])),
    "two_clocks.h5": in_hdf5({"observation/joint_positions": POSITION, "observation/tau": EFFORT,
        "observation/timestamp/seconds": np.full(ROWS, 1.7e9),
        "observation/timestamp/nanos": 1e9 * TIME}),
    "logging.log": text("\n".join(f"{m:%Y-%m-%d %H:%M:%S,%f} INFO arm: q={[*q]} tau={[*e]}"
        for m, q, e in zip(MOMENTS, POSITION.tolist(), EFFORT.tolist(), strict=True))),
    "strokes.csv": times("%Y/%m/%d %H:%M:%S.%f"),
    "timedelta.csv": table(PLAIN.assign(time=pandas.to_timedelta(TIME, unit="s").map(str))),
    "arrays.csv": table(pandas.DataFrame({n: [*map(repr, LISTS[n])] for n in ("q", "tau")})
        .assign(time=TIME)),
    "levels.csv": table(PLAIN.set_axis(pandas.MultiIndex.from_arrays(LEVELS), axis=1)),
    "index.csv": lambda path: PLAIN.set_axis(pandas.MultiIndex.from_arrays(LEVELS), axis=1)
        .set_index([("time", "")]).rename_axis(index="time").to_csv(path),
    "merged.csv": text("time,position,,effort,\n,base,elbow,base,elbow\n"
        + PLAIN.to_csv(index=False, header=False)),
    "keyed.log": text("\n".join(
        " ".join(f"{name}={value!r}" for name, value in zip(PLAIN.columns, row, strict=True))
        for row in PLAIN.to_numpy().tolist())),
    "utf16.txt": lambda path: path.write_text(PLAIN.to_csv(index=False, sep="\t"), "utf-16"),
    "footer.csv": text(PLAIN.to_csv(index=False) + "\nrows: 60\nend\n"),
    "rate.mat": lambda path: savemat(path, {"run": {"q": POSITION, "tau": EFFORT, "Ts": 0.01}}),
    "rate73.mat": in_hdf5({"q": POSITION.T, "tau": EFFORT.T, "fs": [[100.0]]}),
    "split_alone.json": text(json.dumps({"columns": [*PLAIN], "data": PLAIN.to_numpy().tolist()})),
    "identity.csv": table(A_ROW_A_JOINT.rename(columns={"joint": "id"})
        .assign(id=np.tile([1, 2], ROWS))),
    "units.csv": table(PLAIN.set_axis(["time", "base_rad", "elbow_rad", "base_Nm", "elbow_Nm"],
        axis=1)),
    "rate.json": text(json.dumps({"dt": 0.01, **listed({n: LISTS[n] for n in ("q", "tau")})})),
    "date.csv": table(PLAIN.rename(columns={"time": "Zeitpunkt"}).assign(Zeitpunkt=MOMENTS)),
    "long_date.csv": table(A_ROW_A_JOINT.drop(columns="time").assign(when=MOMENTS.repeat(2))),
    "brackets.csv": table(IN_GERMAN, sep=";", decimal=","),
    "ticks.csv": table(PLAIN.assign(tick=range(ROWS))[["tick", *PLAIN]]),
    "ts.csv": table(PLAIN.rename(columns={"time": "ts_ms"}).assign(ts_ms=1e3 * TIME)),
    "columns.json": lambda path: PLAIN.to_json(path, orient="columns", double_precision=15),
    "split.json": lambda path: PLAIN.to_json(path, orient="split", double_precision=15),
    "excel.csv": text(f"sep=;\n{PLAIN.to_csv(index=False, sep=';', decimal=',')}"),
    "preceded.csv": text(PREAMBLE + PLAIN.to_csv(index=False)),
    "labelled.txt": text(PLAIN.to_string(float_format="{:.17g}".format)),
    "echo.csv": table(echo_of_ros2(), header=False),
    "echo_of_ros1.csv": table(echo_of_ros1(), header=False),
    "turned.npz": arrays(time=TIME, q=POSITION.T, tau=EFFORT.T),
    "episode_000000.parquet": pandas.DataFrame(listed(LEROBOT)).to_parquet,
    "durations.csv": table(PLAIN.assign(time=[f"{t:g} sec" for t in TIME])),
    "day.csv": table(PLAIN.assign(time=MOMENTS.strftime("%H:%M:%S.%f"), Date="2026-05-01")
        [["Date", *PLAIN]]),
    **{f"{name}.csv": table(PLAIN, sep=mark, decimal=",")
       for name, mark in {"semicolons": ";", "tabs": "\t", "bars": "|", "blanks": " "}.items()},
    **{f"{name}.csv": text(head + PLAIN.to_csv(index=False))
       for name, head in {"comments": "# rig 7\n# 24.11.\n\n", "Octave": "% of Octave\n"}.items()},
    "savetxt.txt": lambda path: np.savetxt(path, PLAIN, header="t q1 q2 tau1 tau2"),
    "lists_and_semicolons.csv": table(IN_CELLS, sep=";"),
    "RTDE.csv": numbered("target_q q+1 target_qd v+1 target_moment tau+1 actual_q q actual_qd v "
        "actual_current tau actual_TCP_pose 0 actual_TCP_force 0",
        clock="timestamp", separator=" "),
    "libfranka.csv": numbered("q_d q+1 dq_d v+1 q q dq v tau_J_d tau+1 tau_J tau dtau_J tau+1 "
        "tau_ext_hat_filtered tau+1", "{}[{}]"),
    "iiwa_lcm.csv": numbered("joint_position_measured q joint_position_commanded q+1 "
        "joint_position_ipo q+1 joint_torque_measured tau joint_torque_commanded tau+1 "
        "joint_torque_external tau+1", "{}[{}]", clock="Time", separator="\t"),
    "moteus.csv": numbered("position turns torque tau mode 0 fault 0 q_current 0 d_current 0",
        "{1}.{0}", first=1),
    "moteus_ids.csv": numbered("position turns torque tau mode 0 fault 0 q_current 0 d_current 0",
        "id{1}_{0}", first=1),
    "no_moteus.csv": numbered("position q velocity v torque tau", "{1}.{0}", first=1),
    "AxisPos.csv": logger("Time", "AxisPos{} [deg]", "AxisTorque{} [Nm]", factor=180 / np.pi),
    **{f"KUKA {k}.csv": logger("TIME", q, e, factor=180 / np.pi) for k, (q, e) in enumerate((
        ("AXIS_ACT_A{}", "TORQUE_AXIS_ACT_A{}"), ("AXIS_ACT_A{}", "CURR_ACT_A{}"),
        ("$AXIS_ACT.A{}", "$TORQUE_AXIS_ACT[{}]")))},
    "Simscape.csv": logger("Time", "{}_joint.Rz.q (deg)", "{}.Rz.t (N*m)", JOINTS, 180 / np.pi),
    "bare_names.csv": table(PLAIN.set_axis(["t", *JOINTS, "base_torque", "elbow_torque"], axis=1)),
    "dashes.txt": text(PLAIN.to_string(index=False, float_format="{:.17g}".format).replace(
        "\n", "\n" + "---------- " * 5 + "\n", 1)),
    "WandB.csv": logger("_timestamp", "run1 - q/{}", "run1 - tau/{}", (0, 1)),
    "bare_numbers.csv": logger("t", "joint{}", "torque{}"),
    "encoders.csv": logger("t", "enc_{}", "torque_{}", (0, 1)),
    "latest_first.csv": table(PLAIN[::-1]),
    **{f"{mark!r} in cells.csv": table(pandas.DataFrame({"t": TIME} | {n: [form.format(*x) for x in
        LISTS[n].tolist()] for n in ("q", "tau")})) for mark, form in {" ": "{!r} {!r}",
        ";": "{!r};{!r}", "NumPy": "[np.float64({!r}), np.float64({!r})]"}.items()},
    "three_levels.csv": table(PLAIN.set_axis(pandas.MultiIndex.from_arrays(
        [["t", *["robot"] * 4], ["", *JOINTS, *JOINTS], ["", *["q"] * 2, *["tau"] * 2]]), axis=1)),
    "units_in_attributes.h5": in_hdf5({"time": 1e3 * TIME, "q": np.rad2deg(POSITION),
        "tau": EFFORT}, {"time": {"units": "ms"}, "q": {"unit": b"deg"}}),
    "units_beside.json": text(json.dumps({"units": {"time": "ms", "q": "deg"}, "data": listed(
        {"time": 1e3 * TIME, "q": np.rad2deg(POSITION), "tau": EFFORT})})),
    "names_of_columns.mat": lambda path: savemat(path, {"data": PLAIN.to_numpy(),
        "names": np.array([*PLAIN], object)}),
    "structs.mat": lambda path: savemat(path, {"joints": np.array([{"name": n, "t": TIME,
        "q": POSITION[:, k], "tau": EFFORT[:, k]} for k, n in enumerate(JOINTS)], object)}),
    "Greek.csv": logger("t", "θ{}", "τ_{}"),
    "EGM.csv": logger("tm", "feedback_joints_j{}", "feedback_torque_j{}"),
    "dSPACE.csv": text("Version;1.0\n\npath;" + ";".join(f"Model Root/{q}{k}" for q in
        ("q", "tau") for k in (1, 2)) + "\nunit;rad;rad;Nm;Nm\ntrace_values;\n"
        + PLAIN.to_csv(index=False, header=False, sep=";")),
    "Isaac.csv": logger("sim_time", "robot/joint_pos/{}", "robot/applied_torque/{}", JOINTS),
    "ODrive.csv": logger("t", "axis{}.encoder.pos_estimate",
        "axis{}.motor.current_control.Iq_measured", (0, 1), 0.5 / np.pi),
    "servo_stats.csv": logger("timestamp", "servo_stats.{}.position", "servo_stats.{}.torque_Nm",
        factor=0.5 / np.pi),
    "German.csv": logger("Zeit", "Winkel Achse {}", "Moment Achse {}", factor=180 / np.pi,
        units="s,°,°,Nm,Nm"),
    "Siemens.csv": logger("Zeit", "Achse {}.Lageistwert", "Achse {}.Momentenistwert"),
    "CODESYS.csv": logger("Time", "PLC_PRG.Axis{}.fActPosition", "PLC_PRG.Axis{}.fActTorque"),
    "Elmo.csv": logger("Time [sec]", "Axis0{}.Position", "Axis0{}.Active Current [A]"),
    "Damiao.csv": logger("timestamp", "m{}_pos", "m{}_tor"),
    "brackets_of_units.csv": logger("Time", "J{} Position", "J{} Torque", factor=180 / np.pi,
        units="[s],[°],[°],[N·m],[N·m]"),
    "title.csv": odd_text("Measurement of arm;;;;;\nTime;q1;q2;tau1;tau2;\ns;rad;rad;Nm;Nm;",
        end=";"),
    "words_in_a_comment.csv": odd_text("# time [s]  q1 [rad]  q2 [rad]  tau1 [Nm]  tau2 (Nm)"),
    "words.csv": odd_text("time [s]  q1 [rad]  q2 [rad]  tau1 [Nm]  tau2 (Nm)"),
    "Windows.csv": odd_text("# Prüfstand, µ\nZeit;Winkel 1;Winkel 2;Drehmoment 1;Drehmoment 2"),
    "Fortran.csv": odd_text("t q1 q2 tau1 tau2", fortran=True),
    "twice.csv": odd_text("time,q1,q2,tau1,tau2", times=2),
    "factors.csv": odd_text("t [0.1 s];q1 [1e0rad];q2 [1.0 rad];tau1 [1 Nm];tau2 [Nm]",
        factor=10.0),
    "TwinCAT.csv": tables_with_keys("TwinCAT", np.tile(1000.0 * TIME, (4, 1))),
    "TwinCAT_in_pairs.csv": tables_with_keys("in pairs", np.tile(1000.0 * TIME, (4, 1))),
    "LabVIEW.csv": tables_with_keys("LabVIEW", np.tile(TIME, (4, 1))),
    "simulink_labels.mat": lambda path: savemat(path, {"out": {"time": TIME, "signals": np.array(
        [{"values": x, "label": n} for n, x in (("q", POSITION), ("tau", EFFORT))], object)}}),
    **dict.fromkeys(("echo.txt", "echo.yaml", "echo"), echoed()),
    "rsi.xml": text("\n".join(f'<Rob Type="KUKA"><RIst X="1.0" Y="2.0"/><AIPos A1="{a!r}" '
        f'A2="{b!r}"/><MATorque A1="{c!r}" A2="{d!r}"/><IPOC>{4208163 + round(1000 * t)}</IPOC>'
        "</Rob>" for t, a, b, c, d in
        (PLAIN.to_numpy() * [1.0, *[180 / np.pi] * 2, 1.0, 1.0]).tolist())),
    "matrices.npz": arrays(t=TIME, q=POSITION, dq=VELOCITY, tau=EFFORT,
        O_T_EE=np.zeros((3, 4, 4))),
    "frame.h5": frame_of_pandas(False), "indexed.h5": frame_of_pandas(True),
    "folder.zip": zipped({"run/": "", "run/log.csv": PLAIN.to_csv(index=False),
        "run/readme.txt": "", "__MACOSX/run/._log.csv": "", "run/.hidden.csv": "",
        "run/photo.png": ""}),
    "one.csv.zip": zipped({"a.csv": PLAIN.to_csv(index=False)}),
    "records.zip": zipped({"a.jsonl": "\n".join(map(json.dumps, LIST_RECORDS))}),
    **dict.fromkeys(("lines.txt", "lines.log"), text("\n".join(map(json.dumps, LIST_RECORDS)))),
    "widths.csv": under("time,q[2],tau[2]"), "spans.csv": under("time,q1-q2,tau_0..1"),
    "widths_and_units.txt": under("# time(1) q(2) [rad] tau(2) [Nm]", separator=" "),
    "names_before_blanks.csv": under("time,q,,tau,"),
    "GB18030.csv": under("时间,关节1位置,关节2位置,关节1力矩,关节2力矩", encoding="gb18030"),
    "Shift-JIS.csv": under("時刻,軸1位置,軸2位置,軸1トルク,軸2トルク", encoding="shift_jis"),
    "Windows-1251.csv": under("время,положение 1,положение 2,момент 1,момент 2", encoding="cp1251"),
    "Windows-1250.csv": under("czas;Kąt 1;Kąt 2;Moment 1;Moment 2", encoding="cp1250",
        separator=";"),
    "Windows-1254.csv": under("zaman,Açı 1,Açı 2,Tork 1,Tork 2", encoding="cp1254"),
    "Czech.csv": under("Čas [s],Poloha 1 [rad],Poloha 2 [rad],Moment 1,Moment 2",
        encoding="cp1250"),
    "UTF-16-LE.csv": under("time,q1,q2,tau1,tau2", encoding="utf-16-le"),
    "two_clocks.csv": table(pandas.DataFrame({"t_q_ms": 1e3 * TIME, "q1": POSITION[:, 0],
        "q2": POSITION[:, 1], "t_tau": TIME, "tau1": EFFORT[:, 0], "tau2": EFFORT[:, 1]})),
    "Markdown.txt": text(f"| {' | '.join(PLAIN)} |\n|{'---|' * 5}\n" + "".join(
        f"| {' | '.join(map(repr, row))} |\n" for row in PLAIN.to_numpy().tolist())),
    "Spanish_comment.csv": under("# señal\ntime,q1,q2,tau1,tau2", encoding="cp1252"),
    "busy_processor.csv": table(PLAIN[[*PLAIN][:3]].assign(cpu_time=0.3 * TIME).join(
        PLAIN[[*PLAIN][3:]])),
    "ticks_between.csv": table(PLAIN[[*PLAIN][:3]].assign(tick=range(ROWS)).join(
        PLAIN[[*PLAIN][3:]])),
    "pairs_of_values_and_clocks.csv": table(pandas.DataFrame({n: x for q, values in
        (("position", POSITION), ("effort", EFFORT)) for k, joint in enumerate(JOINTS)
        for n, x in ((f"{joint}_{q}", values[:, k]), (f"{joint}_{q}_time", TIME))})),
    "periods.csv": table(PLAIN.assign(time=0.01).rename(columns={"time": "dt"})),
    "today.csv": table(PLAIN.assign(time=1e3 * TIME).rename(columns={"time": "ms_today"})),
    "topics.csv": table(PLAIN.set_axis(["elapsed time", "/s.position[0]", "/s.position[1]",
        "/s.effort[0]", "/s.effort[1]"], axis=1).melt("elapsed time", var_name="topic")
        .assign(**{"header.stamp": ""})),
    "nano.txt": table(PLAIN.assign(time=np.rint(1e9 * TIME), s=1.7e9)[["s", *PLAIN]].set_axis(
        ["TimeSec", "TimeNano", "q1", "q2", "tau1", "tau2"], axis=1), sep=" "),
    "milliseconds.csv": table(PLAIN.assign(time="12:00:00", Millisecond=1e3 * TIME)
        .rename(columns={"time": "Time"})),
    "clocks_in_groups.mat": lambda path: savemat(path, {"data": {"q": POSITION, "lcm_timestamp":
        TIME, "tau_est": EFFORT}, "order": {"tau_ff": 7 + EFFORT, "lcm_timestamp": TIME}}),
    "states.npz": arrays(t=TIME, joint_states=POSITION, tau_J=EFFORT),
    "percent.csv": table(pandas.DataFrame({"t": TIME, **{f"q{k}": POSITION[:, k] for k in (0, 1)},
        **{f"torque{k}_pct": TIME for k in (0, 1)}, **{f"torque{k}_Nm": EFFORT[:, k]
        for k in (0, 1)}})),
    "RAPID.csv": logger("ClkRead", "rax_{}", "MotorTorque_{}"),
    "jointtarget.csv": text("time;jointtarget;torque\n" + "\n".join(
        f"{t!r};[[{a!r},{b!r}],[9E+09,9E9]];[{c!r},{d!r}]" for t, a, b, c, d in
        np.column_stack([TIME, np.rad2deg(POSITION), EFFORT]).tolist())),
    "rows_of_moteus.jsonl": records_of_motors({"position": POSITION / 2 / np.pi, "torque": EFFORT,
        **dict.fromkeys(("mode", "fault", "q_current", "d_current"), EFFORT)}),
    "of_UR_primary.jsonl": records_of_motors({"q_actual": POSITION, "qd_actual": VELOCITY,
        "V_actual": 48.0 + 0.0 * EFFORT, "torque": EFFORT}, "JointData"),
    "EGM.jsonl": text("\n".join(json.dumps({"tm": t, "feedBack": {"joints": q}, "planned": {
        "joints": [2.0, 3.0]}, "torque": tau}) for t, q, tau in
        zip(*(x.tolist() for x in (TIME, POSITION, EFFORT)), strict=True))),
    "states.csv": table(pandas.DataFrame(np.column_stack([TIME, POSITION, VELOCITY, EFFORT]),
        columns=["t", "x1", "x2", "x3", "x4", "u1", "u2"])),
    "states_in_turn.npz": arrays(dt=0.01, us=EFFORT,
        xs=np.stack([POSITION, VELOCITY], 2).reshape(ROWS, 4)),
    "LabVIEW_with_commas.lvm": text("LabVIEW Measurement\t\nDecimal_Separator\t,\nX_Columns\tOne\n"
        "***End_of_Header***\t\n\t\nChannels\t4\t\nSamples" + 4 * "\t60" + "\nX_Dimension"
        + 4 * "\tTime" + "\nX0" + 4 * "\t0,0" + "\nDelta_X" + 4 * "\t0,01" + "\n"
        "***End_of_Header***" + 4 * "\t" + "\nX_Value\tq1\tq2\ttau1\ttau2\tComment\n"
        + PLAIN.to_csv(index=False, header=False, sep="\t", decimal=",")),
    "dSPACE.mat": lambda path: savemat(path, {"rec": {"X": {"Name": "", "Data": TIME}, "Y":
        np.array([{"Name": f'"Model Root/{name}"/Out1', "Data": x, "Unit": unit} for name, x, unit
        in (("q1", POSITION[:, 0], "rad"), ("q2", np.rad2deg(POSITION[:, 1]), "deg"),
        ("tau1", EFFORT[:, 0], "Nm"), ("tau2", EFFORT[:, 1], "Nm"))], object)}}),
    "glog.log": text("".join(f"I0501 {t.time().isoformat('microseconds')} 77 arm.cc:88] q1={a!r} "
        f"q2={b!r} tau1={c!r} tau2={d!r}\n" for t, (a, b, c, d) in
        zip(MOMENTS, PLAIN.to_numpy()[:, 1:].tolist(), strict=True))),
    "Mac.csv": lambda path: path.write_text(PLAIN.assign(**{f"{n}.position": np.rad2deg(x) for n, x
        in zip(JOINTS, POSITION.T, strict=True)}).set_axis(["t", "Winkel 1 [°]", "Winkel 2 [°]",
        "Kraft 1 (N)", "Kraft 2 (N)"], axis=1).to_csv(index=False), "mac_roman"),
    "ODrive_names.csv": logger("t", "node{}.Pos_Estimate", "node{}.Torque_Estimate", (0, 1),
        0.5 / np.pi),
    "theta.csv": logger("t", "th{}", "tau{}"),
    "d_behind_numbers.csv": table(pandas.DataFrame({"t": TIME} | {f"{name.format(k + 1)}": x[:, k]
        for name, x in (("q{}", POSITION), ("q{}d", VELOCITY), ("q{}dd", EFFORT),
        ("tau{}", EFFORT)) for k in (0, 1)})),
    "DDot.csv": numbered("theta q thetaDot v thetaDDot tau torque tau"),
    "plural.npz": arrays(ts=TIME, qs=POSITION, qds=VELOCITY, qdds=EFFORT, taus=EFFORT),
    "commas_in_names.csv": text("t;q1, rad;q2, rad;tau1, Nm;tau2, Nm\n" + PLAIN.to_csv(
        index=False, header=False, sep=";", decimal=",")),
    "KUKA_Sunrise.log": table(PLAIN.assign(time=np.rint(1e9 * TIME), s=0)[["s", *PLAIN]].set_axis(
        ["ZeitInSec", "ZeitInNanoSec", "axisQMsr[0]", "axisQMsr[1]", "axisTauMsr[0]",
        "axisTauMsr[1]"], axis=1), sep=" "),
    "root.npz": arrays(t=TIME, joint_names=np.array(JOINTS), torque=EFFORT,
        joint_pos=POSITION, root_pos=np.zeros((ROWS, 3))),
    "saved_by_Octave.txt": of_octave({"t": TIME[:, None], "q": POSITION, "tau": EFFORT}),
    "of_Octave_at_a_rate.txt": of_octave({"q": POSITION, "Ts": np.array([[0.01]]), "tau": EFFORT}),
    "a_range_of_Octave.txt": of_octave({"q": POSITION, "tau": EFFORT}, "# name: t\n"
        f"# type: double_range\n# base, limit, increment\n0 {TIME[-1]} 0.01"),
    "inside.yaml": text(yaml.safe_dump({"samples": LIST_RECORDS})),
    "records.yaml": text(yaml.safe_dump([{"time": float(t), "joints": {n: {"position": p,
        "effort": e} for n, p, e in each}} for t, each in REVERSED])),
    "objects_in_cells.csv": table(pandas.DataFrame({"t": TIME,
        "position": [str(dict(zip(JOINTS, q, strict=True))) for q in POSITION.tolist()],
        "effort": [json.dumps(dict(zip(JOINTS, x, strict=True)) | {"other": None})
        for x in EFFORT.tolist()]})),
    "a_row_a_signal.csv": table(pandas.concat([pandas.DataFrame({"time": TIME, "signal": signal,
        **dict(zip(JOINTS, x.T, strict=True))}) for signal, x in (("pos", POSITION),
        ("tau", EFFORT))]).sort_values("time", kind="stable")),
    "lists_a_joint.json": text(json.dumps({"meta": {"sample_rate": 100, "joints": JOINTS},
        "signals": {"position": POSITION.T.tolist(), "torque": EFFORT.T.tolist()}})),
    "rate_of_groups.h5": in_hdf5({f"joints/{n}/{q}": x[:, k] for k, n in enumerate(JOINTS)
        for q, x in (("position", POSITION), ("torque", EFFORT))}
        | {"sampling_rate_hz": np.array([100.0])}),
    "remarks.csv": text("t,q1,q2,tau1,tau2,\ns,rad,rad,Nm,Nm,\nclock,encoder,encoder,,sensor,\n"
        + PLAIN.to_csv(index=False, header=False).replace("\n", ",\n")),
    "echo_without_velocity.csv": table(echo_of_ros2().assign(empty="").iloc[
        :, [*range(7), -1, 9, 10]], header=False),
}  # fmt: skip
"""Name of a file -> a function that writes it."""
DERIVED = ("d_behind_numbers.csv", "DDot.csv", "plural.npz")
"""Files with accelerations."""
MOVING = (*DERIVED, "RTDE.csv", "libfranka.csv", "no_moteus.csv", "matrices.npz",
    "of_UR_primary.jsonl", "states.csv", "states_in_turn.npz")  # fmt: skip
"""Files with velocities."""
CURRENTS = ("RTDE.csv", "KUKA 1.csv", "ODrive.csv", "Elmo.csv")
SAYING = {
    "RTDE.csv": ("actual_q_0 … actual_q_1 used", "target_q_0", "desired", "model's order"),
    **dict.fromkeys(("AxisPos.csv", "KUKA 0.csv", "brackets_of_units.csv"), ("is in deg",)),
    "twice.csv": ("repeated time stamp",),
    "no_moteus.csv": ("columns ignored: mode",),
}
"""Words in the notes on some of them."""


def written(folder, name):
    SHAPES[name](folder / name)
    return folder / name


@pytest.mark.parametrize("name", SHAPES)
def test_a_table_of_any_shape_is_the_same_log(tmp_path, name):
    log = read_log(written(tmp_path, name), joints=JOINTS)
    assert log.joints == JOINTS
    np.testing.assert_allclose(log.time - log.time[0], TIME, atol=1e-6)
    np.testing.assert_allclose(log.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(log.effort, EFFORT, atol=1e-12)
    if name in MOVING:
        np.testing.assert_allclose(log.velocity, VELOCITY, atol=1e-12)
    assert (log.acceleration is not None) == (name in DERIVED)
    assert name not in CURRENTS or set(log.effort_kinds.values()) == {"current"}
    noted = " ".join(log.notes)
    assert "thousands" not in noted
    assert ("cp125" in noted) == (name.startswith(("Windows-12", "Czech")))
    for words in SAYING.get(name, ()):
        assert words in noted


@pytest.mark.parametrize(
    "names",
    ["x1 x2 x3 x4 u", "x theta x_dot theta_dot u", "x theta1 x_dot theta1_dot F"],
)
def test_states_of_a_cart_with_a_pole_are_of_its_joints(read_table, names):
    values = np.column_stack([POSITION, VELOCITY, EFFORT[:, 0]]).T
    columns = {"t": TIME, **dict(zip(names.split(), values, strict=True))}
    log = read_table(columns, JOINTS, sliding=frozenset(["base"]), motorless=frozenset(["elbow"]))
    np.testing.assert_allclose(log.position, POSITION, atol=1e-12)
    np.testing.assert_allclose(log.velocity, VELOCITY, atol=1e-12)
    np.testing.assert_allclose(log.effort[:, 0], EFFORT[:, 0], atol=1e-12)


def test_a_truncated_last_row_is_skipped(tmp_path):
    frame = pandas.concat([PLAIN] * 3).assign(time=0.01 * np.arange(3 * ROWS))
    records = "\n".join(map(json.dumps, LIST_RECORDS))
    for name, content, rows, words in (
        ("log.csv", frame.to_csv(index=False) + "end of log\n", 180, "corrupt and skipped:"),
        ("log.jsonl", f'{records}\n{{"time": 9.0, "q', 60, 'cut off and not used: \'{"time": 9.0'),
    ):
        (tmp_path / name).write_text(content)
        log = read_log(tmp_path / name)
        assert len(log) == rows
        assert words in " ".join(log.notes)


def message(each, topic=None, joints=None, scale=1.0, since=0.0):
    stamp = {"sec": int(each["time"]), "nanosec": round(1e9 * (each["time"] % 1.0 + since))}
    numbers = {k: [scale * x for x in each[k]] for k in ("position", "effort")}
    told = {"header": {"stamp": stamp}, "name": joints or each["name"], **numbers}
    return told if topic is None else {"topic": topic, "log_time": each["time"], "data": told}


def test_messages_of_several_topics_and_publishers_in_one_file(tmp_path):
    path = tmp_path / "log.jsonl"

    def read(messages, **how):
        path.write_text("\n".join(map(json.dumps, messages)))
        return read_log(path, joints=JOINTS, reading=Reading(**how))

    plain = read(message(r) for r in LIST_RECORDS)
    fingers = {"joints": ["finger_0", "finger_1"], "scale": 0.1, "since": 0.001}
    both = [each for r in LIST_RECORDS for each in (message(r), message(r, **fingers))]
    np.testing.assert_allclose(read(both).position, plain.position)
    arms = {"/left/joint_states": 1.0, "/right/joint_states": 0.5}
    both = [message(r, topic, None, scale) for r in LIST_RECORDS for topic, scale in arms.items()]
    with pytest.raises(LogError, match=r"2 topics .*--topic /left/joint_states"):
        read(both)
    for topic, scale in arms.items():
        log = read(both, topic=topic)
        np.testing.assert_allclose(log.position, scale * plain.position)
        np.testing.assert_allclose(log.effort, scale * plain.effort)
    imu = {"topic": "/imu", "data": {"x": 1.0}}
    beside = [x for r in LIST_RECORDS for x in (message(r, "/q"), {"log_time": r["time"], **imu})]
    np.testing.assert_allclose(read(beside).position, plain.position)


@pytest.mark.parametrize("many", [False, True])
def test_words_for_missing_values(read_table, monkeypatch, many):
    monkeypatch.setattr(text_file, "_MANY", 20 if many else 10**6)
    effort = EFFORT.copy()
    effort[0, 0] = effort[30, 1] = np.nan
    for word in ("NA", "N/A", "null", "None", "-", "---", "?", "missing", "#N/A", "NaN", "1.#QNAN"):
        frame = PLAIN.astype(object)
        frame.iloc[0, 3] = frame.iloc[30, 4] = word
        np.testing.assert_allclose(read_table(frame).effort, effort)


def test_a_log_without_a_model_has_the_joints_that_its_cells_name(tmp_path):
    for name in ("cells.csv", "long.csv", "lines.json"):
        assert set(read_log(written(tmp_path, name)).joints) == set(JOINTS)


def test_rows_of_a_joint_may_have_stamps_of_their_own(read_table):
    base, elbow = (A_ROW_A_JOINT[k::2] for k in (0, 1))
    log = read_table(pandas.concat([base, elbow.assign(time=elbow["time"] + 1e-7)]), JOINTS)
    np.testing.assert_allclose(log.effort, EFFORT, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "old", "new", "row"),
    [("long.csv", f"{TIME[3]},elbow,", f"{TIME[3]},,", 8),
     ("cells.csv", "base,elbow", "base,", 1)],
)  # fmt: skip
def test_cells_without_a_name_are_refused(tmp_path, name, old, new, row):
    path = written(tmp_path, name)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(LogError, match=rf"Row {row} .* has no joint name in column '"):
        read_log(path)


@pytest.mark.parametrize("kind", ["json", "records", "parquet"])
def test_lists_that_are_missing_in_some_rows(tmp_path, kind):
    content, path = listed(LISTS), tmp_path / f"log.{kind.replace('records', 'json')}"
    content["tau"][5] = [] if kind == "records" else None
    content["q"][7][1] = None
    if kind == "records":
        content["q"][9] = []
        rows = zip(*content.values(), strict=True)
        path.write_text(json.dumps([dict(zip(content, row, strict=True)) for row in rows]))
    elif kind == "json":
        path.write_text(json.dumps({**content, "limits": [1, 2], "gains": [3, 4]}))
    else:
        pandas.DataFrame(content).to_parquet(path)
    log = read_log(path)
    assert np.isnan(log.effort[5]).all()
    assert np.isnan(log.position).sum() == (3 if kind == "records" else 1)
    assert np.isnan(log.position[7, 1]) and not np.isnan(log.position[7, 0])
    np.testing.assert_array_equal(np.delete(log.effort, 5, 0), np.delete(EFFORT, 5, 0))


def test_joints_that_the_model_lacks_are_ignored_and_named(read_table):
    columns = PLAIN.assign(**{f"gripper.{q}": PLAIN[f"base.{q}"] for q in ("position", "effort")})
    log = read_table(columns, JOINTS)
    assert log.joints == JOINTS
    assert log.left_out == ("gripper",)
    with pytest.raises(LogError, match="has joint 'elbow', but"):  # misspelled, not one joint more
        read_table(columns, ("base", "elbows", "gripper"), partial=True)


def test_another_number_of_joints_is_refused_with_a_draft_mapping(read_table):
    each = (("q", POSITION), ("tau", EFFORT))
    own = {f"{name}{k}": x[:, k % 2] for k in range(3) for name, x in each}
    words = "has 3 joints by numbers, but the model has 2: base, elbow"
    with pytest.raises(LogError, match=words) as caught:
        read_table({"time": TIME, **own}, JOINTS)
    proposal = caught.value.evidence["proposal"]
    assert "base:\n    position: q0" in proposal and "elbow:\n    position: q1" in proposal


@pytest.mark.parametrize("first", [0, 1])
def test_numbers_of_columns_that_begin_elsewhere_than_those_of_joints(read_table, first):
    """With one column more than joints, as of a gripper, equal numbers are of other joints."""
    each = (("q", POSITION), ("tau", EFFORT))
    columns = {f"{name}{first + k}": x[:, k % 2] for k in range(3) for name, x in each}
    joints, shifted = ([f"joint_{k + n}" for k in range(2)] for n in (1 - first, first))
    with pytest.raises(LogError, match="has 3 joints by numbers, but the model has 2: j") as caught:
        read_table({"time": TIME, **columns}, tuple(joints))
    assert f"{joints[0]}:\n    position: q{first}\n" in caught.value.evidence["proposal"]
    log = read_table({"time": TIME, **columns}, tuple(shifted))
    assert log.left_out == (f"joint_{first + 2}",)
    np.testing.assert_array_equal(log.position, POSITION)


def joint_a(time, position=POSITION[:, 0], effort=EFFORT[:, 0], name="time"):
    """Return the columns of one joint."""
    return {name: time, "a.position": position, "a.effort": effort}


def test_a_clock_that_was_set_back_leaves_a_gap(read_table):
    log = read_table(joint_a(TIME - 0.15 * (np.arange(ROWS) >= 30)))
    steps = np.diff(log.time)
    assert np.all(steps > 0)
    assert steps[29] == pytest.approx(1.0)
    np.testing.assert_allclose(np.delete(steps, 29), 0.01, atol=1e-9)
    assert any("set back by 0.15 s at row 31" in note for note in log.notes)


def test_a_clock_that_is_set_back_again_by_a_few_periods(read_table):
    row = np.arange(ROWS)
    columns = joint_a(TIME - 0.15 * (row >= 20) - 0.02 * (row >= 40))
    assert "set back 2 times, first by 0.15 s at row 21" in " ".join(read_table(columns).notes)
    columns["time"] += 0.02 * (row > 40)  # one row alone is early
    with pytest.raises(LogError, match="runs backwards"):
        read_table(columns)


@pytest.mark.parametrize(("bits", "unit", "times"), [(16, "ms", 1), (32, "us", 1), (16, "us", 9)])
def test_overflowing_time_counters_continue(read_table, bits, unit, times):
    end, time = 2.0**bits, np.arange(1000 * times) * 1e-3 * (0.59 if times > 1 else 10.0)
    stamps = np.mod(end - 5000 + np.rint(time / {"ms": 1e-3, "us": 1e-6}[unit]), end)
    log = read_table(joint_a(stamps, np.sin(time), np.cos(time), f"t_{unit}"))
    np.testing.assert_allclose(log.time - log.time[0], time, atol=1e-6)
    assert any("the time counter restarts after" in note for note in log.notes)


@pytest.mark.parametrize("form", ["%H%M%S.%f", "%H%M%S%f"])
def test_digits_of_a_clock_are_not_seconds(read_table, form):
    time = 0.02 * np.arange(400)
    moments = pandas.Timestamp("2026-05-01 09:59:55") + pandas.to_timedelta(time, unit="s")
    stamps = [float(text[: len(text) - 3]) for text in moments.strftime(form)]
    log = read_table(moving(stamps, time))
    np.testing.assert_allclose(log.time - log.time[0], time, atol=1e-6)
    assert any("has the digits of a clock" in note for note in log.notes)


def moving(stamps, time):
    """Return the columns of a joint that moves by `time`."""
    return joint_a(stamps, np.sin(3 * time) + 0.1 * np.cos(7 * time), np.cos(time))


@pytest.mark.parametrize("together", [2, 10])
@pytest.mark.parametrize("apart", [0.0, 1e-4])
@pytest.mark.parametrize("lost", [0.0, 0.03])
def test_rows_that_were_stamped_on_arrival(read_table, together, apart, lost):
    random, row = np.random.default_rng(together), np.arange(3000)
    row = row[random.random(len(row)) >= lost]
    time, place = 0.01 * row, np.arange(len(row))
    burst = place // together * together
    stamps = time[np.minimum(burst + together - 1, len(row) - 1)] + apart * (place - burst)
    log = read_table(moving(stamps, time))
    assert any("were stamped on arrival" in note for note in log.notes)
    steps = np.diff(log.time)
    assert len(log) == len(row) and (steps > 0).all()
    late = log.time - time
    assert np.abs(late[100:-100] - np.median(late)).max() < (0.02 if lost else 0.002)


def test_a_joint_without_values_does_not_decide_the_order_of_rows(read_table):
    """Nor does it hide what other joints say, or raise a warning of NumPy's."""
    time = 0.01 * np.arange(3000)
    empty = {"b.position": np.full_like(time, np.nan), "b.effort": time}
    log = read_table(joint_a(time[4::5].repeat(5), np.sin(3 * time), time) | empty)
    assert any("were stamped on arrival" in note for note in log.notes)
    order = np.random.default_rng(0).permutation(3000)
    with pytest.raises(LogError, match="runs backwards"):
        read_table(joint_a(time[order], empty["b.position"], time[order]))


def test_rows_at_irregular_instants_keep_their_stamps(read_table):
    time = np.cumsum(np.random.default_rng(0).exponential(0.01, 3000)).round(9)
    log = read_table(moving(time, time))
    np.testing.assert_array_equal(log.time, time)
    assert not any("arrival" in note for note in log.notes)


@pytest.mark.parametrize("odd", ["none", "empty cell", "cut off", "text", "one cell more"])
def test_many_lines_are_read_by_arrow_as_without_it(tmp_path, monkeypatch, odd):
    random = np.random.default_rng(0).normal(size=(ROWS, 3)) * 10.0 ** np.arange(-9, 9, 6)
    lines = pandas.DataFrame(joint_a(TIME, *random[:, :2].T)).to_csv(index=False).splitlines()
    path, row = tmp_path / "log.csv", 51
    lines[row] = {
        "none": lines[row],
        "empty cell": lines[row].rpartition(",")[0] + ",",
        "cut off": lines[row].rpartition(",")[0],
        "text": "0.5,x,1",
        "one cell more": f"{lines[row]},1",
    }[odd]
    path.write_text("\n".join(lines))

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


ONE_NUMBER = [{**LIST_RECORDS[0], "effort": 0.0}, *LIST_RECORDS[1:]]
SHORT_LIST = listed(LISTS) | {"tau": [*EFFORT[:5].tolist(), [1.0], *EFFORT[6:].tolist()]}
SHORT_CELL = IN_CELLS.assign(positions=["[1.0]" if k == 19 else q for k, q in enumerate(POSITION)])
WITH_UNITS = PLAIN.assign(**{"base.effort": [f"{x:.3f} Nm" for x in EFFORT[:, 0]]})
JUMPING = PLAIN.assign(time=TIME - 0.25 * (np.abs(np.arange(ROWS) - 37) < 8))
PICKLED = {"joint_names": np.array(JOINTS[::-1], object), **TURNED}


def without_time(*joints):
    frame = A_ROW_A_JOINT.sort_values("joint", kind="stable")
    return table(frame.assign(time=frame["time"].mask(frame["joint"].isin(joints))))


def one_after_the_other(begins):
    """Write rows in which a joint begins later; where the other one is then is unknown."""
    base, elbow = (A_ROW_A_JOINT[k::2] for k in (0, 1))
    return table(pandas.concat([base, elbow.assign(time=elbow["time"] + begins)[:-15]]))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.zip", zipped({"a.csv": "", "b/c.csv": ""}), r"of 2 logs of .* it has a\.csv, b/c\.csv"),
        ("a.zip", zipped({"a.mat": ""}), r"of 0 logs of text, JSON or NPZ; it has a\.mat"),
        ("a.zip", text("PK"), "is no complete ZIP archive: .* Copy it again"),
        ("a.tdms", text("TDSm"), "Convert it to CSV"),
        ("a.log", "(1700000000.25) can0 181#D326113F\n", "a CAN bus.* --dbc"),
        ("a.dat", "DIAEXTENDED {@:ENGLISH\n", "the header of a recording of DIAdem"),
        ("a.h5", in_hdf5({"t": TIME, "q": np.zeros((ROWS, 4, 2)), "tau": EFFORT}), "environments"),
        ("a.json", json.dumps(ONE_NUMBER), "lists of 2 numbers, but one of 1 in row 1"),
        ("a.json", json.dumps(SHORT_LIST), "'tau'.* lists of 2 numbers, but one of 1 in row 6"),
        ("a.csv", table(SHORT_CELL), r"Row 20, column 'positions'.*not a list of 2 numbers"),
        ("a.csv", table(WITH_UNITS), r"numbers without units, and .* name: base.effort \[Nm\]"),
        ("a.csv", table(JUMPING), "runs backwards"),
        ("a.csv", without_time("elbow"), "has empty cells of time only"),
        ("a.csv", without_time(*JOINTS), "has empty cells of time only"),
        ("a.csv", one_after_the_other(0.0), "the joints in 'joint' follow each other in time"),
        ("a.csv", one_after_the_other(5.0), "the joints in 'joint' follow each other in time"),
        ("a.json", '{"a": 1', "not a readable JSON file"),
        ("a.json", "3", "neither a JSON object nor a list of records"),
        ("a.json", json.dumps([{"id": k, "box": [1] * 9} for k in range(40_000)]), "neither time"),
        ("a.jsonl", "[1]\n[2]", "neither a JSON object nor a list of records"),
        ("deep.json", '{"a":' * 5000 + "1" + "}" * 5000, "maximum recursion depth exceeded"),
        ("a.h5", "no archive", "not a readable HDF5 file"),
        ("a.xml", "<Rob ", "not a readable XML of a robot"),
        ("a.xml", "<robot/>", "Is it the model"),
        ("a.yaml", "directives:\n- add_model: {name: !Rpy 1}\n", "Is it the model"),
        ("a.yaml", "a: [1, 2]\n", "Is it the model"),
        ("a.yaml", echoed("position: ["), r"not a readable YAML file.*Remove the last message"),
        ("a.h5", in_hdf5({"df/table": np.zeros(9, [("values_block_0", float, 14)])}), "in pickles"),
        ("a.npz", arrays(**LISTS | {"q": POSITION[:50]}), "'q' .* has 50 rows, but others have 60"),
        ("a.npz", arrays(**PICKLED), "'joint_names', an array of Python objects"),
    ],
)
def test_invalid_files_and_tables(tmp_path, name, content, words):
    (content if callable(content) else text(content))(tmp_path / name)
    with pytest.raises(LogError, match=words):
        read_log(tmp_path / name)


def test_rows_with_some_of_the_columns_are_merged(read_table):
    """Positions and efforts of two tables that an outer join made one."""
    early, late = np.arange(400) * 0.01, np.arange(200) * 0.02 + 0.003
    moved = pandas.DataFrame({"time": early, "a.position": np.sin(2.0 * early)})
    heard = pandas.DataFrame({"time": late, "a.effort": np.cos(late)})
    log = read_table(moved.merge(heard, on="time", how="outer"))
    np.testing.assert_array_equal(log.time, late)
    np.testing.assert_array_equal(log.effort[:, 0], np.cos(late))
    np.testing.assert_allclose(log.position[:, 0], np.sin(2.0 * late), atol=1e-4)
    assert "all are interpolated at the instants of the slowest, 200 of 600 rows" in log.notes[-1]


@pytest.mark.parametrize("late", [0.1, 1.0])
def test_rows_out_of_order_are_sorted_where_that_makes_positions_smooth(read_table, late):
    """A tenth of them came one row late, or all in any order."""
    rng, time = np.random.default_rng(3), np.arange(400) * 0.01
    late_by = 1.5 if late < 1.0 else rng.random(400) * 400.0
    order = np.argsort(np.arange(400) + late_by * (rng.random(400) < late), kind="stable")
    position, effort = np.sin(3.0 * time), np.cos(time)
    log = read_table(joint_a(time[order], position[order], effort[order]))
    np.testing.assert_allclose(log.position[:, 0], position, atol=1e-9)
    assert "rows were sorted by time" in log.notes
    with pytest.raises(LogError, match="backwards"):  # time alone is damaged
        read_table(joint_a(time[order], position, effort))


def test_shuffled_blocks_of_rows_are_sorted(read_table):
    rng, time = np.random.default_rng(4), np.arange(400) * 0.01
    blocks = np.array_split(np.arange(400), 9)
    rng.shuffle(blocks)
    order = np.concatenate(blocks)
    position = np.sin(3.0 * time) + 1e-4 * rng.normal(size=400)
    log = read_table(joint_a(time[order], position[order], np.cos(time[order])))
    np.testing.assert_allclose(log.position[:, 0], position, atol=1e-9)
    assert "rows were sorted by time" in log.notes


def test_files_of_a_joint_each_are_named_after_them(tmp_path):
    for k, joint in enumerate(JOINTS):
        columns = {"time": TIME, "position": POSITION[:, k], "effort": EFFORT[:, k]}
        pandas.DataFrame(columns).to_csv(tmp_path / f"run 3 {joint}.csv", index=False)
    path = "+".join(str(tmp_path / f"run 3 {joint}.csv") for joint in JOINTS[::-1])
    mapping = mapping_of({j: (f"run 3 {j}.position", f"run 3 {j}.effort") for j in JOINTS})
    for reading in (Reading(), Reading(mapping=mapping)):
        log = read_log(path, joints=JOINTS, reading=reading)
        np.testing.assert_allclose(log.position, POSITION, atol=1e-12)
        np.testing.assert_allclose(log.effort, EFFORT, atol=1e-12)
    assert read_log(path).joints == ("run 3 elbow", "run 3 base")
    alone = read_log(tmp_path / "run 3 elbow.csv", joints=JOINTS, partial=True)
    assert alone.joints == ("elbow",)
    (tmp_path / "run 3 elbow.csv").rename(tmp_path / "run.csv")
    with pytest.raises(LogError, match=r"of one joint without its name.*base\.csv\+elbow\.csv"):
        read_log(tmp_path / "run.csv", joints=JOINTS, partial=True)
    (tmp_path / "run.csv").rename(tmp_path / "joint_1.csv")  # the first joint, or the wrist?
    with pytest.raises(LogError, match="of one joint without its name"):
        read_log(tmp_path / "joint_1.csv", joints=("base", "wrist_1"), partial=True)
    alone = read_log(tmp_path / "joint_1.csv", joints=("joint1", "joint2"), partial=True)
    assert alone.joints == ("joint1",)


def test_columns_named_like_links_are_those_of_the_joints_that_move_them(tmp_path):
    model = load_model(MODELS / "double_pendulum.urdf")
    data = {"time": TIME}
    for k, link in enumerate(model.bodies):
        data |= {f"{link}_pos": np.sin(TIME + k), f"{link}_effort": np.cos(TIME + k)}
    pandas.DataFrame(data).to_csv(tmp_path / "links.csv", index=False)
    log = read_log(tmp_path / "links.csv", joints=model.joints, reading=reading_for(model))
    np.testing.assert_allclose(log.position[:, 1], np.sin(TIME + 1))
    assert any("named like links" in note for note in log.assumed)


def mapping_of(joints, time="time"):
    """Return a mapping of the columns of positions and efforts by joint."""
    columns = {
        joint: {"position": MappedColumn(position), "effort": MappedColumn(effort)}
        for joint, (position, effort) in joints.items()
    }
    return ColumnMapping(columns, MappedColumn(time))


def test_a_row_of_numbers_and_words_is_not_a_header(tmp_path):
    PLAIN.assign(mode="auto").to_csv(tmp_path / "log.csv", index=False, header=False)
    with pytest.raises(LogError, match="has no header") as caught:
        read_log(tmp_path / "log.csv", joints=JOINTS)
    assert "#   6: auto" in caught.value.evidence["proposal"]
    names = (*PLAIN.columns, "_")
    log = read_log(tmp_path / "log.csv", joints=JOINTS, reading=Reading(columns=names))
    np.testing.assert_allclose(log.effort, EFFORT, atol=1e-12)


def test_efforts_in_percent_are_duty_cycles(read_table):
    positions = {f"q{k}": POSITION[:, k] for k in (0, 1)}
    efforts = {f"Torque {k} (%)": 10.0 * EFFORT[:, k] for k in (0, 1)}
    log = read_table({"time": TIME, **positions, **efforts})
    assert set(log.effort_kinds.values()) == {"pwm"}
    np.testing.assert_allclose(log.effort, 0.1 * EFFORT, atol=1e-12)


MARKS = {
    "English": (";", "{:,.2f}", ""),
    "English in quotes": (",", '"{:,.2f}"', ""),
    "German": (";", "{:,.2f}", ",..,"),
    "French": ("\t", "{:,.2f}", ",\u202f.,"),
    "integers": (";", "{:,.0f}", ""),
    "whole German numbers": (";", "{:,.0f}", ",."),
}


def marked(tmp_path, kind):
    """Return a table of degrees and N·mm with thousands separators."""
    separator, form, swap = MARKS[kind]
    numbers = np.column_stack([1000.0 * (5.0 + TIME), 2000.0 * POSITION, 3000.0 * EFFORT])
    swapped = str.maketrans(dict(zip(swap[::2], swap[1::2], strict=False)) if swap else {})
    rows = [[form.format(x).translate(swapped) for x in row] for row in numbers]
    names = ["time_ms", "q1 [deg]", "q2 [deg]", "tau1 [Nmm]", "tau2 [Nmm]"]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(map(separator.join, [names, *rows])) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("kind", MARKS)
def test_marks_between_thousands(tmp_path, kind):
    log = read_log(marked(tmp_path, kind), joints=JOINTS)
    rounding = 0.5 if kind in ("integers", "whole German numbers") else 0.005
    np.testing.assert_allclose(log.time, 5.0 + TIME, atol=1e-3 * rounding)
    np.testing.assert_allclose(log.position, np.deg2rad(2000.0 * POSITION), atol=0.02 * rounding)
    np.testing.assert_allclose(log.effort, 3.0 * EFFORT, atol=1.01e-3 * rounding)
    assert "thousands separator in numbers such as" in " ".join(log.notes)


def test_ambiguous_separators_of_numbers_are_refused(tmp_path):
    lines = ["t_ms;q_base;q_elbow;tau_base;tau_elbow"]
    lines += [f"{k};1.{k:03d};-2.{k:03d};3,{k:03d};1,{2 * k:03d}" for k in range(100, 160)]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    with pytest.raises(
        LogError,
        match=r"such as '1\.100' and '3,100', whose decimal and thousands separators are ambiguous",
    ) as error:
        read_log(tmp_path / "log.csv", joints=JOINTS)
    assert "without thousands separators" in error.value.advice


def test_three_decimals_are_not_thousands(tmp_path):
    position = 130.0 + 0.125 * np.round(100.0 * POSITION)
    position[::2] = 130.0
    rows = zip(TIME, *position.T, *EFFORT.T, strict=True)
    lines = [f"{t:.6f};{a:.3f};{b:.3f};{c:.6f};{d:.6f}" for t, a, b, c, d in rows]
    lines = [line.replace("130.000", "130") for line in lines]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time;q1 [deg];q2 [deg];tau1;tau2", *lines]))
    log = read_log(path, joints=JOINTS)
    np.testing.assert_allclose(log.position, np.deg2rad(position), atol=1e-6)
    assert "thousands" not in " ".join(log.notes)


def test_columns_in_unknown_units_are_ignored(read_table):
    frame = pandas.DataFrame({"time_s": np.repeat(TIME, 2), "motor_id": [1, 2] * ROWS})
    frame = frame.assign(pos_deg=np.rad2deg(POSITION).ravel(), spd_erpm=1.0, cur_A=EFFORT.ravel())
    log = read_table(frame, JOINTS)
    np.testing.assert_allclose(log.position, POSITION)
    np.testing.assert_allclose(log.effort, EFFORT)
    assert log.velocity is None
    assert log.effort_kinds == dict.fromkeys(JOINTS, "current")
    said = "as the scale of erpm is unknown: joint_1.velocity, joint_2.velocity"
    assert any(said in note for note in log.notes)


def test_stamps_of_whole_seconds_are_refused_with_advice(read_table):
    whole = PLAIN.assign(time=np.floor(TIME))
    with pytest.raises(LogError, match="uniform, give their rate with --rate"):
        read_table(whole)
    np.testing.assert_allclose(read_table(whole, rate=100.0).time, TIME)


@pytest.mark.parametrize("value", [-9999, 99999])
def test_outlying_nines_are_missing_values(read_table, value):
    frame = PLAIN.copy()
    frame.loc[5:49:9, "base.effort"] = value
    log = read_table(frame, JOINTS)
    np.testing.assert_array_equal(np.isnan(log.effort[:, 0]), frame["base.effort"] == value)
    assert f"'base.effort' is {value} in 5 rows: taken as not measured" in log.notes


def test_signals_of_unknown_names_are_mapped(read_table):
    names = dict(zip(PLAIN.columns[1:], ("A", "B", "C", "D"), strict=True))
    columns = PLAIN.rename(columns=names).melt(id_vars="time")
    with pytest.raises(LogError, match="no joint with both position and effort") as error:
        read_table(columns)
    assert ": D" in error.value.evidence["proposal"]
    mapping = mapping_of({"base": "AC", "elbow": "BD"})
    np.testing.assert_allclose(read_table(columns, mapping=mapping).effort, EFFORT)


def test_a_column_that_may_be_time_by_its_values_is_proposed(tmp_path, read_table):
    columns = PLAIN.assign(row=np.arange(ROWS), time=1000.0 * TIME)
    columns = columns[["row", *PLAIN]].rename(columns={"time": "Count"})
    with pytest.raises(LogError, match="'Count' increases by 10 from row to row: is it") as error:
        read_table(columns, JOINTS)
    (tmp_path / "m.yaml").write_text(error.value.evidence["proposal"])
    log = read_table(columns, mapping=read_mapping(tmp_path / "m.yaml"))
    np.testing.assert_allclose(log.time, TIME)
    with pytest.raises(LogError, match="no column 'time'") as error:  # rows are no time
        read_table(columns.drop(columns="Count"), JOINTS)
    assert "rises" not in str(error.value)


def test_contents_of_text_columns_are_named_if_no_column_is_of_joints(read_table):
    cells = [json.dumps({"position": q}) for q in POSITION.tolist()]
    with pytest.raises(LogError, match=r"efforts: none; 'msg' holds '.\"position\": ") as error:
        read_table({"time": TIME, "msg": cells}, JOINTS)
    assert "to a .jsonl file" in error.value.advice


def demonstrations(path, numbers=(0, 1, 10, 2), *, time=False, rate=True):
    """Write demonstrations of 40 + number rows as robomimic does; positions tell the number."""
    with h5py.File(path, "w") as file:
        for number in numbers:
            rows = 40 + number
            position = number + 0.1 * np.sin(np.arange(2 * rows).reshape(rows, 2))
            group = file.create_group(f"data/demo_{number}")
            group["actions"] = np.zeros((rows, 7))
            group["obs/robot0_joint_pos"] = position
            group["obs/robot0_joint_torque"] = 2.0 * position
            group["obs/agentview_image"] = np.zeros((rows, 4, 4, 3), np.uint8)
            group["next_obs/robot0_joint_pos"] = np.roll(position, -1, axis=0)
            group["next_obs/robot0_joint_torque"] = np.roll(position, -1, axis=0)
            if time:
                group["obs/t"] = 0.05 * np.arange(rows)
        settings = {"env_name": "Lift", "env_kwargs": {"control_freq": 20}}
        if rate:
            file["data"].attrs["env_args"] = json.dumps(settings)
    return path


@pytest.mark.parametrize("time", [False, True])
def test_demonstrations_are_one_log_with_gaps_or_one_of_them(tmp_path, time):
    path = demonstrations(tmp_path / "demos.hdf5", time=time)
    log = read_log(path, joints=JOINTS)
    known = np.isfinite(log.position).all(axis=1)
    assert np.count_nonzero(known) == 4 * 40 + 13
    assert "4 episodes" in log.notes[0]
    steps = np.diff(log.time[known])
    assert np.flatnonzero(steps > 0.25).tolist() == [39, 80, 122]
    np.testing.assert_allclose(np.delete(steps, [39, 80, 122]), 0.05, atol=1e-9)
    means = [part.mean() for part in np.split(log.position[known], [40, 81, 123])]
    np.testing.assert_allclose(means, [0, 1, 2, 10], atol=0.05)
    np.testing.assert_allclose(log.effort, 2.0 * log.position)
    second = read_log(path, joints=JOINTS, reading=Reading(episode=10))
    assert len(second) == 50
    assert second.position.mean() == pytest.approx(10.0, abs=0.05)
    with pytest.raises(LogError, match="no episode 3; it has 0, 1, 2, 10"):
        read_log(path, reading=Reading(episode=3))


@pytest.fixture
def few_columns(monkeypatch):
    """Lower the limit on the columns that are read."""
    for module in ("array_files", "column_mapping"):
        monkeypatch.setattr(f"geodrake.logs.files.{module}.MOST_COLUMNS", 50)


def test_only_requested_demonstrations_are_read(tmp_path, few_columns):
    """Objects of other episodes may be many, and damaged."""
    path = tmp_path / "demos.hdf5"
    with h5py.File(path, "w") as file:
        file["data/dt"] = 0.05
        for number in range(40):
            group = file.create_group(f"data/demo_{number}")
            group["joint_pos"] = number + POSITION
            group["joint_torque"] = np.full(1, "x", "S1") if number == 5 else EFFORT
    log = read_log(path, joints=JOINTS, reading=Reading(episode=32))
    np.testing.assert_array_equal(log.position, 32 + POSITION)
    assert log.time[1] == pytest.approx(0.05)
    with pytest.raises(LogError, match="no episode 40; it has 0, 1, 2"):
        read_log(path, reading=Reading(episode=40))


@pytest.mark.parametrize("rows", [(2, 1, 2), (1, 1, 3)])
def test_time_continues_after_episodes_of_one_row(rows):
    tables = [LogTable(Path("log"), {"time": 0.1 * np.arange(n)}) for n in rows]
    time = one_after_another(tables, Reading()).columns["time"]
    ends = np.cumsum(rows)[:-1] - 1
    assert (np.delete(np.diff(time), ends) < 0.2).all() and (np.diff(time)[ends] >= 1.0).all()


def test_a_mapping_selects_among_too_many_arrays(tmp_path, monkeypatch):
    for module in ("array_files", "column_mapping"):
        monkeypatch.setattr(f"geodrake.logs.files.{module}.MOST_COLUMNS", 50)
    path = tmp_path / "many.hdf5"
    with h5py.File(path, "w") as file:
        file["robot/t"], file["robot/a"], file["robot/b"] = TIME, POSITION, EFFORT
        for number in range(50):
            file[f"camera/{number}"] = TIME
    with pytest.raises(LogError, match="at most 50 are read"):
        read_log(path, joints=JOINTS)
    columns = [
        {"position": MappedColumn(f"robot.a[{k}]"), "effort": MappedColumn(f"robot.b[{k}]")}
        for k in range(2)
    ]
    mapping = ColumnMapping(dict(zip(JOINTS, columns, strict=True)), MappedColumn("robot.t"))
    log = read_log(path, joints=JOINTS, reading=Reading(mapping=mapping))
    np.testing.assert_array_equal(log.position, POSITION)
    np.testing.assert_array_equal(log.effort, EFFORT)


def test_an_episode_that_begins_elsewhere_is_no_fault(tmp_path):
    with h5py.File(tmp_path / "demos.hdf5", "w") as file:
        file["data/dt"] = 0.01
        for number in (0, 1):
            file[f"data/demo_{number}/joint_pos"] = POSITION + 60.0 * number
            file[f"data/demo_{number}/joint_torque"] = EFFORT
    log = without_faults(read_log(tmp_path / "demos.hdf5"))
    assert np.count_nonzero(np.isfinite(log.position).all(axis=1)) == 2 * ROWS
    assert not any("jumps" in note for note in log.notes)


def test_demonstrations_without_time_need_a_rate(tmp_path):
    path = demonstrations(tmp_path / "demos.hdf5", rate=False)
    with pytest.raises(LogError, match="no column 'time'") as caught:
        read_log(path, joints=JOINTS)
    assert "--rate" in caught.value.advice
    assert len(read_log(path, joints=JOINTS, reading=Reading(rate=20.0))) > 4 * 40 + 13


def test_a_file_without_episodes_has_none_to_choose(tmp_path):
    with pytest.raises(LogError, match="has no episodes"):
        read_log(written(tmp_path, "object.json"), reading=Reading(episode=0))


def test_columns_before_their_clocks_keep_their_order(read_table):
    columns = dict(zip(["q1", "q2", "t_q", "tau1", "tau2", "t_tau"],
        np.column_stack([POSITION, TIME, EFFORT, TIME + 0.001]).T, strict=True))  # fmt: skip
    log = read_table(columns)
    assert log.joints == ("joint_1", "joint_2")
    np.testing.assert_allclose(log.position, POSITION)


LATE = TIME[:-7] + 0.003
OWN_TIMES = {
    joint: {"t": time, "position": position, "effort": effort}
    for joint, time, position, effort in (
        ("base", TIME, 3.0 * TIME, TIME),
        ("elbow", LATE, 1.0 + LATE, 2.0 - LATE),
    )
}
OWN_FRAMES = {joint: pandas.DataFrame(columns) for joint, columns in OWN_TIMES.items()}
WITH_OWN_TIMES = {
    "lists.json": text(json.dumps({"joints": {n: listed(x) for n, x in OWN_TIMES.items()}})),
    "records.json": text(json.dumps({n: x.to_dict("records") for n, x in OWN_FRAMES.items()})),
    "named.json": text(json.dumps([{"name": n, **listed(x)} for n, x in OWN_TIMES.items()])),
    "groups.hdf5": in_hdf5({f"{n}/{q}": x for n, own in OWN_TIMES.items() for q, x in own.items()}),
    "structs.mat": lambda path: savemat(path, OWN_TIMES),
    "columns.csv": table(
        pandas.concat([x.add_prefix(f"{n}_") for n, x in OWN_FRAMES.items()], axis=1)
    ),
}


@pytest.mark.parametrize("name", WITH_OWN_TIMES)
def test_joints_with_time_of_their_own_are_joined_by_it(tmp_path, name):
    """Their stamps and numbers of rows differ."""
    WITH_OWN_TIMES[name](tmp_path / name)
    log = read_log(tmp_path / name, joints=JOINTS)
    known = np.isfinite(log.position).all(axis=1)
    assert np.count_nonzero(known) == ROWS - 8  # between the first and the last stamp of both
    np.testing.assert_allclose(log.position[known, 0], 3.0 * log.time[known], atol=1e-9)
    np.testing.assert_allclose(log.position[known, 1], 1.0 + log.time[known], atol=1e-9)
    np.testing.assert_allclose(log.effort[known, 1], 2.0 - log.time[known], atol=1e-9)
