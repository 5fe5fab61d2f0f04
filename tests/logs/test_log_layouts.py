"""Logs as loggers of robots and scripts of their users write them."""

import json
from datetime import UTC, datetime, timedelta

import numpy as np
import pandas
import pytest

from geodrake.errors import ArgumentError, LogError
from geodrake.logs import Reading, read_log
from geodrake.logs.files import read_mapping
from geodrake.logs.files.reading import ColumnMapping, MappedColumn

UR = tuple(
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))
IIWA = tuple(f"iiwa_joint_{k}" for k in range(1, 8))
ROWS = 200


def motion(joints, rate=500.0):
    """Return time (N,), and positions, velocities and efforts (N, n) of a motion."""
    time = np.arange(ROWS) / rate
    speed = 2.0 + np.arange(len(joints))
    angle = time[:, None] * speed
    return time, 0.4 * np.sin(angle), 0.4 * speed * np.cos(angle), 3.0 * np.sin(angle) + speed


def named(names, *parts):
    """Return the columns of arrays by name."""
    return dict(zip(names, np.column_stack(parts).T, strict=True))


def write(path, names, columns):
    pandas.DataFrame(named(names, *columns)).to_csv(path, index=False)
    return path


def indexed(name, count):
    return [f"{name}_{k}" for k in range(count)]


def check(log, joints, q, v, tau):
    assert log.joints == joints
    for found, truth in ((log.position, q), (log.velocity, v), (log.effort, tau)):
        assert (found is None) == (truth is None)
        assert truth is None or np.allclose(found, truth, atol=1e-12)


def test_no_header_and_no_time(tmp_path):
    _, q, _, tau = motion(("a",))
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([q, 7 * q, tau]), delimiter=",")
    names = ("a.position", "_", "a.effort")
    for reading, words in (
        ({}, r"has no header.*--columns"),
        ({"columns": names}, "sampling rate with --rate"),
        ({"columns": names[:2]}, "has 3 columns, but --columns names 2"),
    ):
        with pytest.raises(LogError, match=words):
            read_log(path, reading=Reading(**reading))
    log = read_log(path, reading=Reading(columns=names, rate=250.0))
    check(log, ("a",), q, None, tau)
    assert np.allclose(log.time, np.arange(ROWS) / 250.0)


def test_joined_files_without_headers_may_begin_with_time(tmp_path):
    time, q, _, tau = motion(("a", "b"))
    for name, values in (("q", q), ("tau", tau)):
        np.savetxt(tmp_path / f"{name}.txt", np.column_stack([time, values]))
    log = read_log(f"{tmp_path}/q.txt+{tmp_path}/tau.txt", joints=("a", "b"))
    assert np.allclose(log.time, time)
    check(log, ("a", "b"), q, None, tau)


def test_joined_files_without_a_common_clock(tmp_path):
    time, q, _, tau = motion(("a",))
    first = write(tmp_path / "positions.csv", ["time", "a"], [time, q])
    stamps = np.datetime64("2026-05-01T12:00") + np.round(1e9 * time).astype("timedelta64[ns]")
    second = tmp_path / "efforts.npz"
    np.savez(second, time=stamps, a=tau[:, 0])
    log = read_log(f"{first}+{second}")
    assert np.allclose(log.time - log.time[0], time - time[0])
    assert np.allclose(log.effort, tau)
    assert any("positions.csv another clock" in note for note in log.notes)
    write(first, ["time", "a"], [time[20:], q[20:]])
    with pytest.raises(LogError, match=r"no common clock: .* 0\.358 s and 0\.398 s long"):
        read_log(f"{first}+{second}")
    write(first, ["time", "a"], [1e3 * time, q])
    np.savez(second, time=1e3 * time, a=tau[:, 0])
    log = read_log(f"{first}+{second}", reading=Reading(units={"time": "ms"}))
    assert np.allclose(log.time, time)


def test_two_files_that_do_not_fit(tmp_path):
    time, q, _, tau = motion(("a",))
    first = write(tmp_path / "positions.csv", ["time", "a"], [time, q])
    path = tmp_path / "efforts.csv"
    for table, words in (
        ([time[::50], tau[::50]], "very different rates: positions.csv 500 Hz, efforts.csv 10 Hz"),
        ([time + 1e3, tau], "do not overlap in time"),
        ([np.floor(time), tau], "efforts.csv, time stands still in most rows"),
        ([time[::-1], tau[::-1]], "efforts.csv, time runs backwards"),
    ):
        write(path, ["time", "a"], table)
        with pytest.raises(LogError, match=words):
            read_log(f"{first}+{path}")
    order = [*range(20), 21, 20, *range(22, len(time))]
    write(path, ["time", "a"], [time[order], tau[order]])
    for files in (f"{first}+{path}", f"{path}+{first}"):
        with pytest.raises(LogError, match=r"efforts.csv, time runs backwards"):
            read_log(files)
        log = read_log(files, reading=Reading(skip_bad_rows=True))
        assert "rows of efforts.csv skipped, as their time is back: 1" in log.notes
        np.testing.assert_allclose(
            log.effort[:, 0], np.interp(log.time, time, tau[:, 0]), atol=0.02
        )
    write(path, ["a"], [tau[:50]])
    with pytest.raises(LogError, match="no time, and different numbers of rows: 50, 200"):
        read_log(f"{first}+{path}")
    with pytest.raises(LogError, match="does not exist"):
        read_log(f"{first}+{tmp_path / 'missing.csv'}")


GARBAGE = {
    "text in a cell": ({300: "3.00,oops,1.0"}, "301"),
    "a row cut off": ({300: "3.0"}, "301"),
    "time that jumps back": ({500 + k: f"1.0{k},1,1" for k in range(3)}, "501 to 503"),
    "time that jumps ahead": ({700: "9e9,1.0,1.0"}, "701"),
    "garbage twice": ({10: "\x01\x02", 20: "x,y,z"}, "11, 21"),
}


@pytest.mark.parametrize("kind", GARBAGE)
def test_corrupt_rows_are_named_and_skipped_on_request(tmp_path, kind):
    torn, numbers = GARBAGE[kind]
    whole = {k: f"{0.01 * k:.2f},{np.sin(0.1 * k)},{k % 7}" for k in range(1000)}
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,a.position,a.effort", *(whole | torn).values()]) + "\n")
    with pytest.raises(LogError, match=rf"(?i){numbers.split(',')[0]}.*--skip-bad-rows"):
        read_log(path)
    log = read_log(path, reading=Reading(skip_bad_rows=True))
    assert log.notes == (f"{len(torn)} of 1000 rows are corrupt and skipped: {numbers}",)
    assert len(log) == 1000 - len(torn)
    assert np.all(np.diff(log.time) > 0)


def test_at_most_one_per_cent_of_rows_is_skipped(tmp_path):
    rows = [f"{0.01 * k:.2f},{k},{k}" if k % 50 else "x,y,z" for k in range(1, 1001)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time,a.position,a.effort", *rows]))
    with pytest.raises(LogError, match=r"Row 50,.*Corrupt rows are 50, 100, 150.* At most 1 %"):
        read_log(path, reading=Reading(skip_bad_rows=True))


MAPPING = """
time: {column: ticks, unit: ms}
joints:
  shoulder: {position: {column: phi_s, unit: deg}, effort: {column: 4, gain: 3.0}}
  elbow: {position: {column: phi_e, unit: deg}, effort: {column: i_e, gain: -2.0}}
"""


def test_mapping(tmp_path, read_table):
    time, q, _, tau = motion(("shoulder", "elbow"))
    names = ["ticks", "phi_s", "phi_e", "i_s", "i_e", "junk"]
    currents = tau / np.array([3.0, -2.0])
    (tmp_path / "m.yaml").write_text(MAPPING)
    mapping = read_mapping(tmp_path / "m.yaml")
    columns = named(names, 1e3 * time, np.rad2deg(q), currents, np.zeros(ROWS))
    log = read_table(columns, ("elbow", "shoulder"), mapping=mapping)
    check(log, ("elbow", "shoulder"), q[:, ::-1], None, tau[:, ::-1])
    assert np.allclose(log.time, time)
    with pytest.raises(LogError, match=r"no column 'ticks', which mapping .*m\.yaml maps"):
        read_table(named(["t", *names[1:]], time, q, currents, 0.0 * time), mapping=mapping)
    words = "m.yaml uses column 'i_e' twice, for 'shoulder.effort' and for 'elbow.effort'"
    with pytest.raises(ArgumentError, match=words):  # by its number and by its name
        read_table(named([*names[:3], "i_e", "i_s"], time, q, currents), mapping=mapping)


def test_mapped_signals(tmp_path, read_table):
    time, q, _, s = motion(("shoulder", "elbow"))
    columns = named(["t", "a", "b", "ca", "cb", "told"], time, q, s, q[:, :1] + 0.1)
    (tmp_path / "m.yaml").write_text(
        "time: t\njoints:\n"
        "  one: {position: {column: a, unit: deg}, current: {column: ca, unit: mA, gain: 2}, "
        "command: told}\n"
        "  two: {position: b, effort: {column: cb, unit: A, gain: 3 ± 0.6}}\n"
    )
    mapping = read_mapping(tmp_path / "m.yaml")
    log = read_table(columns, mapping=mapping)
    assert log.effort_kinds == {"one": "current"}
    assert np.allclose(log.effort, s * [2e-3, 3.0])
    assert np.allclose(log.effort_uncertainty, [0.05, 0.2])
    assert np.allclose(log.command[:, 0], np.deg2rad(q[:, 0] + 0.1))
    assert np.isnan(log.command[:, 1]).all()
    with pytest.raises(LogError, match="is current by the mapping, but voltage by --kind"):
        read_table(columns, mapping=mapping, kinds={"one": "voltage"})


BAD_MAPPINGS = {
    "effort and current of 'elb": ("column: i_e, gain: -2.0}}", "column: i_e}, current: i_f}"),
    "voltage and pwm of 'shoulder'": ("effort: {column: 4", "pwm: x, voltage: {column: 4"),
    "'mA' is not a known unit of volt": ("effort: {column: 4", "voltage: {unit: mA, column: 4"),
    "which is not a number": ("gain: 3.0", "gain: 3 ± x"),
    "less than the gain": ("gain: 3.0", "gain: 3 ± 4"),
    "only gains of efforts": ("effort: {column: 4, gain: 3.0", "pwm: {column: 4, gain: 3 ± 1"),
    "uses column 'phi_e' twice": ("column: i_e", "column: phi_e"),
    "'fortnight' is not a known unit of time": ("unit: ms", "unit: fortnight"),
    "nonzero number": ("gain: 3.0", "gain: 0"),
    "unknown field 'zeit'": ("time:", "zeit:"),
    "neither `time` nor `rate`": ("time: {column: ticks, unit: ms}", ""),
    "expected": ("column: 4", "column: [4]"),
    "is not valid YAML": ("joints:", "joints: none #"),
}


@pytest.mark.parametrize("words", BAD_MAPPINGS)
def test_invalid_mappings(tmp_path, words):
    (tmp_path / "m.yaml").write_text(MAPPING.replace(*BAD_MAPPINGS[words]))
    with pytest.raises(LogError, match=words):
        read_mapping(tmp_path / "m.yaml")


DATES = {
    "Z": "{:%Y-%m-%dT%H:%M:%S.%f}Z",
    "no zone, nanoseconds": "{:%Y-%m-%d %H:%M:%S.%f}000",
    "another zone": "{:%Y-%m-%dT%H:%M:%S.%f}+02:00",
    "day first": "{:%d.%m.%Y %H:%M:%S.%f}",
    "month first": "{:%m/%d/%Y %H:%M:%S.%f}",
    "compact": "{:%Y%m%dT%H%M%S.%f}",
    "of a file's name": "{:%Y-%m-%d-%H-%M-%S.%f}",
    "month's name": "{:%d-%b-%Y %H:%M:%S.%f}",
    "noon and zone": "{:%m/%d/%Y %I:%M:%S.%f %p}+02:00",
    "two digits of a year": "{:%d.%m.%y %H:%M:%S.%f}",
    "month's name first": "{:%b %d, %Y %H:%M:%S.%f}",
    "of C": "{:%a %b %d %H:%M:%S.%f %Y}",
    "Chinese": "{:%Y年%m月%d日 %H:%M:%S.%f}",
    "dashes": "{:%m-%d-%Y %H:%M:%S.%f}",
}


def dated_rows(time, form):
    start = datetime(2026, 5, 1, 23, 59, 59, 900000, UTC)  # and over midnight
    return [form.format(start + timedelta(microseconds=round(1e6 * t))) for t in time]


@pytest.mark.parametrize("form", DATES.values(), ids=DATES)
@pytest.mark.parametrize("header", [True, False])
def test_dates_are_time(tmp_path, form, header):
    time, q, v, tau = motion(("a",))
    names, path = ["datetime_ms", "a.position", "a.velocity", "a.effort"], tmp_path / "log.csv"
    columns = (dated_rows(time, form), q[:, 0], v[:, 0], tau[:, 0])
    frame = pandas.DataFrame(dict(zip(names, columns, strict=True)))
    frame.to_csv(path, index=False, header=header)
    log = read_log(path, reading=Reading(columns=() if header else tuple(names)))
    check(log, ("a",), q, v, tau)
    assert np.allclose(log.time, time, rtol=0, atol=1e-9)
    hour = "21" if "+02" in form else "23"
    assert any(f"in s since 2026-05-01 {hour}:59:59 UTC" in note for note in log.notes)


ORDERS = {
    "a day that is no month": ("2024-02-12", "%d/%m/%Y", "2024-02-12", "by 13/02/2024"),
    "a month that is no day": ("2024-02-12", "%m/%d/%Y", "2024-02-12", "by 02/13/2024"),
    "days that follow each other": ("2024-02-10", "%d/%m/%Y", "2024-02-10", "closer in time"),
    "one day": ("2024-03-05", "%d/%m/%Y", "2024-05-03", "though both are possible"),
}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("kind", ORDERS)
def test_the_order_of_day_and_month_is_that_of_the_column(tmp_path, monkeypatch, kind, suffix):
    """The row that shows the order may follow rows that have both."""
    monkeypatch.setattr("geodrake.logs.files.text_file._LINES_AHEAD", 10)
    start, form, first, why = ORDERS[kind]
    time, q, _, tau = motion(("a",))
    begin = pandas.Timestamp(start) + pandas.Timedelta(seconds=0 if kind == "one day" else 86399.9)
    moments = (begin + pandas.to_timedelta(time, unit="s")).strftime(f"{form} %H:%M:%S.%f")
    frame = pandas.DataFrame({"time": moments, "a.position": q[:, 0], "a.effort": tau[:, 0]})
    path = tmp_path / f"log{suffix}"
    frame.to_csv(path, index=False) if suffix == ".csv" else frame.to_parquet(path)
    log = read_log(path)
    assert np.allclose(log.time, time, rtol=0, atol=1e-6)
    assert any(f"since {first}" in note for note in log.notes)
    (note,) = [note for note in log.notes if why in note]
    assert ("day/month" in note) == (form == "%d/%m/%Y" and kind != "one day")


def test_the_order_of_day_and_month_ignores_other_dates(tmp_path):
    """Neither those of a comment nor those of another column."""
    rows = (f"05/06/2026 00:00:{k:02d},{0.1 * k},{k % 3},14/03/2026 10:00" for k in range(20))
    head = ("# exported 15/05/2026 10:00", "time,a.position,a.effort,calibrated")
    (tmp_path / "log.csv").write_text("\n".join([*head, *rows]))
    assert "since 2026-05-06" in " ".join(read_log(tmp_path / "log.csv").notes)


@pytest.mark.parametrize("stamp", ["yesterday", "2026-02-30T12:00:00"])
def test_texts_that_are_no_dates(read_table, stamp):
    time, q, _, tau = motion(("a",))
    dates, columns = dated_rows(time, DATES["Z"]), {"a.position": q[:, 0], "a.effort": tau[:, 0]}
    stamps = [*dates[:30], stamp, *dates[31:]]
    with pytest.raises(LogError, match=rf"Row 31, column 'time'.*{stamp}.*not a date"):
        read_table({"time": stamps, **columns})
    with pytest.raises(LogError, match=r"'soon', which is not a number\..*from its first row"):
        read_table({"time": ["soon"] * ROWS, **columns})
    with pytest.raises(LogError, match=r"'a.position'.*position of a, but has dates"):
        read_table({"time": time, **columns, "a.position": dates})


HIP = ("hip", "knee")
LEGS = tuple(f"{side}_{joint}_joint" for side in ("left", "right") for joint in ("hip_yaw", "knee"))
SERVOS = ("servo_6064", "servo_6077")
COUNTED = tuple(f"J{k}" for k in range(1, 7))
PARTS = ("shoulder", "shoulder", "elbow", "wrist", "wrist", "wrist", "hand")
FLAGS = ("/joint_status/{}[{{k}}]", "motor_status_{{k}}_{}", "{}_smooth{{k}}")
SETTINGS = {
    "Dynamixel": "torque_enable_{k} profile_velocity_{k} present_position_{k} present_current_{k}",
    "flags": "torque_on_{k} torque_status_{k} position_{k} current_{k}",
    "MuJoCo": "qfrc_applied_{k} qfrc_smooth_{k} qpos_{k} qfrc_actuator_{k}",
    "zeros": "effort_{k} torque_{k} position_{k} current_{k}",
}
"""Two columns that never change, positions, and efforts or what stands for them."""
LAYOUTS = {
    "hands and grippers are no joints of an arm": (PANDA, {
        "obs.robot0_eef_pos[{k}]": "q:3", "obs.robot0_gripper_qpos[{k}]": "q:2",
        "obs.robot0_gripper_qvel[{k}]": "v:2", "obs.robot0_joint_pos[{k}]": "q",
        "obs.robot0_joint_pos_cos[{k}]": "other", "obs.robot0_joint_vel[{k}]": "v",
        "obs.robot0_torques[{k}]": "tau"}),
    **{f"{beside} beside {form}": (IIWA, {beside: "other:4", form: "q", "tau_{k}": "tau"})
       for beside in ("finger_{one}_pos", "cube_pos_{one}", "hand_joint_pos[{one}]")
       for form in ("q[{joint}]", "joint_position_{joint}", "robot/{joint}/position")},
    "forces of a hand stand for no currents": (PANDA, {"hand_force_{one}": "other:3", "q{k}": "q",
        "current_{k}": "tau"}),
    "parts of an arm may be counted through": (COUNTED, {"{part}_q_{one}": "q",
        "{part}_tau_{one}": "tau"}),
    "qd beside qdot is desired": (PANDA, {"q_{k}": "q", "qd_{k}": "other", "qdot_{k}": "v",
        "tau_{k}": "tau"}),
    "objects of CiA 402 are no joints": (HIP, {"axis{k}_position_actual_value_6064": "q",
        "axis{k}_velocity (0x606C) [rad/s]": "v", "axis{k}_torque_actual_value_6077": "tau"}),
    "letters of the model are no units": (("A", "B"), {"arm.{joint}.position": "q",
        "arm.{joint}.torque": "tau"}),
    "numbers of servos are no objects": (SERVOS, {"{joint}.pos": "q", "{joint}.torque": "tau"}),
    "boards are counted where all have one axis": (HIP, {"odrv{k}.axis0.pos_estimate": "turns",
        "odrv{k}.axis0.vel_estimate": "turns/s", "odrv{k}.axis0.motor.torque_estimate": "tau"}),
    **{form: (PANDA, {form.format(word).replace("{{k}}", "{k}"): what
                      for word, what in (("position", "q"), ("torque", "tau"))})
       for form in FLAGS},
    **{form: (LEGS, {f"{form} pos": "q", f"{form} torque": "tau"})
       for form in ("{letter}_{rest}", "{rest}_{side}", "{capital} {rest}")},
    **{f"q is plainer than {other}": (PANDA, {other: "other", "q{k}": "q", "tau_ff_{k}": "other",
        "tau_rnea_{k}": "other", "dynamic_tor[{k}]": "other", "tau_g_{k}": "other",
        "reactionForces_{k}": "other", "tau_fb_{k}": "tau"})
       for other in ("th{k}", "q{k}_hat", "q_prev_{k}", "q_{k}_predicted", "q_filtered_{k}")},
    "feedback and feedforward beside efforts are parts of them": (PANDA, {"q{k}": "q",
        "tau{k}": "tau", "tau_ff{k}": "other", "tau_fb{k}": "other"}),
    "a root is no joint": (PANDA, {"joint_pos[{k}]": "q", "tau[{k}]": "tau",
        "root_pos_w[{k}]": "8:3"}),
    "output of a controller is no measured effort": (PANDA, {"feedback/position[{k}]": "q",
        "feedback/effort[{k}]": "tau", "output/effort[{k}]": "other"}),
    **{f"q and d are axes of {form}": (HIP, {"angle_{k}": "q", form: "tau", other: "0"})
       for form, other in (("q_axis_current_{k}", "d_axis_current_{k}"),
                           ("current_q_{k}", "voltage_q_{k}"))},
    **{f"settings: {kind}": (PANDA, dict(zip(forms.split(), ("8", "0", "q", "tau"), strict=True)))
       for kind, forms in SETTINGS.items()},
    "settings: ODrive": (PANDA, {"axis{k}.current_state": "8", "axis{k}.controller.input_pos": "0",
        "axis{k}.encoder.pos_estimate": "turns",
        "axis{k}.motor.current_control.Iq_measured": "tau"}),
    **{f"two sensors are no two robots: {one} {more}": (UR, {"{joint}_effort": "tau",
        f"{one}_{{joint}}_position": "q", f"{two}_{{joint}}_position": "q", **more})
       for one, two, more in (("raw", "filtered", {}), ("abs", "inc", {}),
                              ("raw", "filtered", {"filtered_{joint}_effort": "tau"}))},
}  # fmt: skip
"""Joints, and forms of names with what columns of them hold, `q:3` of the first three joints."""


@pytest.mark.parametrize("name", LAYOUTS)
def test_names_of_columns_say_what_was_measured_at_joints(read_table, name):
    joints, forms = LAYOUTS[name]
    time, q, v, tau = motion(joints)
    known = {"q": q, "v": v, "tau": tau, "other": q + 1.0, "8": 0.0 * q + 8.0, "0": 0.0 * q}
    known |= {"turns": q / (2.0 * np.pi), "turns/s": v / (2.0 * np.pi)}
    columns = {"time": time}
    for form, said in forms.items():
        what, _, count = said.partition(":")
        for k, joint in enumerate(joints[: int(count or len(joints))]):
            side, *rest = joint.split("_")
            words = {"k": k, "one": k + 1, "joint": joint, "part": PARTS[k], "side": side}
            words |= {"letter": side[0], "capital": side[0].upper(), "rest": "_".join(rest[:-1])}
            columns[form.format(**words)] = known[what][:, k]
    has_speed = not {"v", "turns/s"}.isdisjoint(forms.values())
    check(read_table(columns, joints), joints, q, v if has_speed else None, tau)


@pytest.mark.parametrize("form", ["{}_{}_{}", "/{}/joint_states/{}/{}", "{}.{}.{}"])
def test_two_robots_alike_are_asked_about(read_table, form):
    time, q, _, tau = motion(UR)
    sides, columns = {"left": 1.0, "right": 0.5}, {"time": time}
    for side, scale in sides.items():
        for what, values in (("position", scale * q), ("effort", scale * tau)):
            columns |= named([form.format(side, joint, what) for joint in UR], values)
    asks = "each joint twice: of left and of right. Choose one: --topic left"
    with pytest.raises(LogError, match=asks):
        read_table(columns, UR)
    for side, scale in sides.items():
        log = read_table(columns, UR, topic=side)
        check(log, UR, scale * q, None, scale * tau)
        assert not any("no meaning" in note for note in log.notes)


ARMS = {
    "from 0": "{side}_{what}_{k}",
    "from 1": "{side}_{what}_{one}",
    "arrays": "{side}.{what}[{k}]",
    "letters": "{letter}{one}_{what}",
    "groups": "/{side}/joint_states/{what}[{k}]",
    "joints in groups": "{side}/joint{one}/{what}",
}


@pytest.mark.parametrize("form", ARMS.values(), ids=ARMS)
@pytest.mark.parametrize("model", ["{side}_arm_joint_{one}", "yumi_{one}_joint_{letter}"])
def test_joints_numbered_by_arm(read_table, form, model):
    sides = [{"side": side, "letter": side[0]} for side in ("right", "left")]
    joints = tuple(model.format(**side, one=k + 1) for side in sides for k in range(4))
    time, q, _, tau = motion(joints)
    names = [
        form.format(**side, what=what, k=k, one=k + 1)
        for what in ("position", "torque")
        for side in sides[::-1]
        for k in range(4)
    ]
    turned = [np.hstack([values[:, 4:], values[:, :4]]) for values in (q, tau)]
    columns = named(["time", *names], time, *turned)
    check(read_table(columns, joints), joints, q, None, tau)
    with pytest.raises(LogError, match=r"each joint twice: of l(eft)? and of r(ight)?"):
        read_table(columns, PANDA[:4])


def test_a_file_for_each_arm(tmp_path):
    joints = tuple(f"{side}_arm_{k}" for side in ("left", "right") for k in (1, 2, 3))
    time, q, _, tau = motion(joints)
    names = ["time", *indexed("q", 3), *indexed("tau", 3)]
    for side, arm in (("left", slice(0, 3)), ("right", slice(3, 6))):
        write(tmp_path / f"{side}.csv", names, [time, q[:, arm], tau[:, arm]])
    path = f"{tmp_path / 'right.csv'}+{tmp_path / 'left.csv'}"
    check(read_log(path, joints=joints), joints, q, None, tau)
    with pytest.raises(LogError, match="each joint twice: of left and of right"):
        read_log(path, joints=PANDA[:3])


def test_positions_of_two_robots_with_efforts_of_one_are_asked_about(read_table):
    time, q, _, tau = motion(PANDA)
    forms = ("master_q[{}]", "slave_q[{}]", "slave_tau[{}]")
    names = ["time", *(form.format(k) for form in forms for k in range(7))]
    columns = named(names, time, q + 1.0, q, tau)
    with pytest.raises(LogError, match="each joint twice: of master and of slave"):
        read_table(columns, PANDA)
    check(read_table(columns, PANDA, topic="slave"), PANDA, q, None, tau)


def test_one_name_that_matches_by_chance_is_not_enough(read_table):
    time, q, _, tau = motion(IIWA[:4])
    names = ["time", *(f"{what}_{letter}" for what in ("q", "tau") for letter in "ABCD")]
    with pytest.raises(LogError, match="of which the model has none"):
        read_table(named(names, time, q, tau), IIWA[:4])


@pytest.mark.parametrize("robots", [("0", "1"), ("1", "2"), ("a", "b")])
@pytest.mark.parametrize("in_turn", [True, False])
def test_rows_of_several_robots(read_table, robots, in_turn):
    time, q, _, tau = motion(("a",))
    scales = dict(zip(robots, (1.0, 0.5), strict=True))
    rows = [
        {"robot_id": robot, "time": t, "q": scale * x, "tau": scale * y}
        for robot, scale in scales.items()
        for t, x, y in zip(time, q[:, 0], tau[:, 0], strict=True)
    ]
    if in_turn:
        rows.sort(key=lambda row: row["time"])
    asks = f"rows of 2 robots, by column 'robot_id': .*Choose one: --topic {robots[0]}"
    with pytest.raises(LogError, match=asks):
        read_table(rows, ("a",))
    for robot, scale in scales.items():
        log = read_table(rows, ("a",), topic=robot)
        check(log, ("a",), scale * q, None, scale * tau)
        assert not any("no meaning" in note for note in log.notes)


def test_a_list_of_one_number_is_its_item_in_a_mapping(tmp_path):
    time, q, _, tau = motion(("a",))
    frame = pandas.DataFrame({"t": time, "q": q.tolist(), "effort": tau.tolist()})
    frame.to_json(tmp_path / "log.jsonl", orient="records", lines=True, double_precision=15)
    joint = {"position": MappedColumn("q[0]"), "effort": MappedColumn("effort")}
    mapping = ColumnMapping({"a": joint}, MappedColumn("t"))
    log = read_log(tmp_path / "log.jsonl", joints=("a",), reading=Reading(mapping=mapping))
    check(log, ("a",), q, None, tau)


@pytest.mark.parametrize("words", [("moving", "idle"), ("2", "5"), ("ur5", "ur5")])
def test_rows_of_a_robot_that_moves_continuously(read_table, words):
    time, q, _, tau = motion(("a", "b"))
    state = np.array(words)[np.arange(ROWS) // 30 % 2]
    columns = named(["time", "q1", "q2", "tau1", "tau2"], time, q, tau)
    log = read_table({"arm": state, **columns}, ("a", "b"))
    check(log, ("a", "b"), q, None, tau)
    assert any("all rows are of one robot" in note for note in log.notes)
    if len(set(words)) == 1:
        return

    # Of another robot, joints jump where the word changes, or it may stand where this one stood.
    jumping = {"arm": state, **columns, "q1": q[:, 0] + 0.5 * (state == words[1])}
    for more in ({}, {"q3": np.nan}):  # a joint without a number shows nothing, either
        with pytest.raises(LogError, match="if all rows are of one robot, --topic all"):
            read_table({**jumping, **more}, ("a", "b"))
    log = read_table(jumping, ("a", "b"), topic="all")
    np.testing.assert_array_equal(log.position[:, 0], jumping["q1"])


def test_efforts_of_the_row_before_are_used_if_there_are_no_others(read_table):
    time, q, _, tau = motion(("a",))
    late = np.roll(tau, 1, axis=0)
    log = read_table(named(["time", "q", "tau_prev"], time, q, late), ("a",))
    check(log, ("a",), q, None, late)
    assert "effort: by name, of the row before: tau_prev" in log.notes
    names = ["time", "q1", "q2", "tau_1", "tau_prev_2"]
    log = read_table(named(names, time, q, q, tau, late), ("a", "b"))
    check(log, ("a", "b"), np.hstack([q, q]), None, np.hstack([tau, late]))
    assert "effort: by name, of the row before: tau_prev_2" in log.notes
    names = ["time", "q", "q_prev", "dq_prev", "tau_prev", "tau"]
    check(read_table(named(names, time, q, q, q, late, tau), ("a",)), ("a",), q, None, tau)


@pytest.mark.parametrize(("name", "unit"), [("ms", 1e-3), ("us", 1e-6), ("millis", 1e-3)])
def test_a_unit_of_time_alone_is_time(read_table, name, unit):
    time, q, _, tau = motion(("a",))
    names = [name, "q", "tau"]
    log = read_table(named(names, np.rint(time / unit), q, tau), ("a",))
    np.testing.assert_allclose(log.time, time, atol=1e-12)
    late = np.rint(np.cumsum(np.where(np.arange(ROWS) % 5, 0.01, 0.03)) / unit)
    log = read_table(named(names, late, q, tau), ("a",))
    np.testing.assert_allclose(np.diff(log.time), np.diff(late) * unit, atol=1e-12)
    with pytest.raises(LogError, match="has no column 'time'"):  # the part of a second
        read_table(named(names, np.rint(time / unit) % 100, q, tau), ("a",))


CLOCK = np.arange(ROWS) / 100.0
CLOCKS = {
    **{name: ({name: CLOCK / unit}, 1e-9, "")
       for name, unit in (("min", 60.0), ("hours", 3600.0), ("s", 1.0))},
    **{"+".join(names): (dict(zip(names, np.divmod(np.rint(parts * CLOCK) + 1.7e9 * parts, parts),
                                  strict=True)), 1e-9, "")
       for names, parts in ((("sec", "usec"), 1e6), (("tv_sec", "tv_usec"), 1e6),
                            (("sec", "msec"), 1e3))},
    "nanoseconds": ({"ZeitSek": np.floor(CLOCK) + 1.7e9, "ZeitNanoSek": np.rint(CLOCK % 1 * 1e9)},
        1e-9, ""),
    "times of day": ({"Time": [f"23:59:{59 + k // 100}" if k < 100 else "00:00:00" for k in
        range(ROWS)], "ms": 10 * (np.arange(ROWS) % 100)}, 1e-9, ""),
    "ns since a start": ({"timestamp": 3.2e12 + 1e9 * CLOCK}, 1e-3, "time is in ns, judging by"),
    **{f"{clock} beside {other}": ({clock: start + CLOCK / unit, other: rest + np.arange(ROWS) % 7},
        1e-6, "")  # which is not a part of it
       for clock, other, unit, start, rest in (
           ("timestamp", "us", 1e-3, 1.7e12, 300.0), ("t", "us", 1e-3, 0.0, 300.0),
           ("timestamp", "nanoseconds", 1e-3, 1.7e12, 1.7e18), ("stamp", "ns", 1e-6, 1.7e15, 900.0),
           ("timestamp", "ms", 1.0, 0.25, 5.0))},
    **{f"Windows {years}": ({"timestamp": np.rint(1e7 * (CLOCK + years + 1.77e9))}, 2e-5,
        "time is in 100 ns since")
       for years in (11_644_473_600, 62_135_596_800)},
    **{f"{program} {name}": ({name: day + CLOCK / 86400.0}, 2e-5,
        f"time is in days as in {program},")
       for program, day in (("Excel", 45000.4), ("MATLAB", 738000.4))
       for name in ("time", "Date", "datetime")},
    **{unit: ({"timestamp": factor * CLOCK}, 1e-9, f"time is in {unit}, judging by 100 Hz")
       for factor, unit in ((1e6, "µs"), (1e3, "ms"), (1e9, "ns"))},
    **{form: ({"Time": [(datetime(2026, 5, 1, hour, 59, 59, 900000, UTC)
        + timedelta(seconds=t)).strftime(form) for t in CLOCK.tolist()]}, 1e-9, "")
       for form, hour in (("%H:%M:%S.%f", 23), ("%I:%M:%S.%f", 0), ("%M:%S.%f", 23))},
}  # fmt: skip
"""Columns of time, by how many s they are off, and what is said of their unit."""


@pytest.mark.parametrize("name", CLOCKS)
def test_clocks_of_all_kinds(read_table, name):
    """Times of day continue after midnight, and after noon."""
    clock, off, words = CLOCKS[name]
    _, q, v, tau = motion(("a",))
    log = read_table(clock | named(["a.position", "a.velocity", "a.effort"], q, v, tau))
    check(log, ("a",), q, v, tau)
    np.testing.assert_allclose(log.time - log.time[0], CLOCK, atol=off)
    assert words in " ".join(log.notes)


def test_parts_without_a_column_called_time_are_joined_by_what_may_be_time(tmp_path):
    time, q, _, tau = motion(("a", "b"))

    def read(*starts):
        paths = [tmp_path / f"{k}.csv" for k in (0, 1)]
        for k, (path, start) in enumerate(zip(paths, starts, strict=True)):
            write(
                path, ["ms", f"q_{k}", f"tau_{k}"], [np.rint(1e3 * time) + start, q.T[k], tau.T[k]]
            )
        return read_log("+".join(map(str, paths)), joints=("a", "b"))

    log = read(0, 250)
    there = np.isfinite(log.position).all(axis=1)
    expected = np.interp(log.time - 0.25, time, q[:, 1])
    assert np.count_nonzero(there) > ROWS // 4
    np.testing.assert_allclose(log.position[there, 1], expected[there], atol=1e-9)
    check(read(0, 0), ("a", "b"), q, None, tau)


@pytest.mark.parametrize("form", ["joint_{}_{}", "{1}_{0}", "Joint{}.{}"])
def test_roman_numerals_count_joints(read_table, form):
    time, q, v, tau = motion(UR)
    roman = ["I", "II", "III", "IV", "V", "VI"]
    names = [form.format(number, w) for w in ("pos", "vel", "torque") for number in roman]
    columns = named(["time", *names], time, q, v, tau)
    check(read_table(columns, UR), UR, q, v, tau)
    own = tuple(f"joint_{number}" for number in roman)
    check(read_table(columns), own, q, v, tau)
    turned = own[::-1]
    check(read_table(columns, turned), turned, q[:, ::-1], v[:, ::-1], tau[:, ::-1])


@pytest.mark.parametrize("other", ["target_pos_{}", "motor_pos_{}"])
def test_a_joint_that_nobody_measured_is_not_taken_from_its_target(read_table, other):
    time, q, _, tau = motion(IIWA)
    names = [f"{joint}.{what}" for what in ("angle", "torque") for joint in IIWA[:-1]]
    columns = {"time": time, **named(names, q[:, :-1], tau[:, :-1])}
    columns |= named([other.format(k) for k in range(1, 8)], q + 1.0)
    with pytest.raises(LogError, match=IIWA[-1]):
        read_table(columns, IIWA)
    log = read_table(columns, IIWA, partial=True)
    check(log, IIWA[:-1], q[:, :-1], None, tau[:, :-1])


def test_a_position_that_may_be_a_target_is_named_beside_measured_ones(read_table):
    time, q, _, tau = motion(("a", "b"))
    log = read_table(named(["time", "q_1", "q_des_2", "tau_1", "tau_2"], time, q, tau), ("a", "b"))
    assert "position: by their names, q_des_2 may not be measured at the joints" in log.notes


def test_units_in_the_second_of_two_lines_of_names(tmp_path):
    time, q, v, tau = motion(("axis_1", "axis_2"))
    above = ["Time", *(f"Axis {k}" for k in (1, 2) for _ in range(3))]
    below = ["[ms]", *("ActPos [deg]", "ActVelo [deg/s]", "ActTorque [Nm]") * 2]
    both = np.stack([np.rad2deg(q), np.rad2deg(v), tau], axis=2).reshape(ROWS, -1)
    frame = pandas.DataFrame(np.column_stack([1e3 * time, both]))
    frame.columns = pandas.MultiIndex.from_arrays([above, below])
    frame.to_csv(tmp_path / "log.csv", index=False)
    log = read_log(tmp_path / "log.csv", joints=("axis_1", "axis_2"))
    check(log, ("axis_1", "axis_2"), q, v, tau)


@pytest.mark.parametrize(
    ("names", "rows", "row", "words"),
    [
        ("columns", "data", [0.0, 1.0], "has 2 values, but there are 3 names"),
        ("columns", "data", None, "is 'None', not a list"),
        ("names", "rows", [0.0, 1.0], "has 2 values, but there are 3 names"),
    ],
)
def test_rows_of_json_that_are_too_short_are_named(tmp_path, names, rows, row, words):
    time, q, _, tau = motion(("a",))
    table = np.column_stack([time, q, tau]).tolist()
    table[5] = row
    content = {names: ["time", "q", "tau"], rows: table}
    (tmp_path / "log.json").write_text(json.dumps(content))
    with pytest.raises(LogError, match=f"Row 6 .* {words}"):
        read_log(tmp_path / "log.json")


TRIALS = {
    "numbers": (25, lambda number: {"trial": number}),
    "words in two columns": (
        50,
        lambda number: {
            "trial": [f"run {k}" for k in number],
            "experiment": [f"day {k // 2}" for k in number],
        },
    ),
}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("by", TRIALS)
def test_recordings_in_one_table_follow_each_other(tmp_path, by, suffix):
    time, q, _, tau = motion(("a",))
    length, named_by = TRIALS[by]
    number, row = np.divmod(np.arange(ROWS), length)
    columns = named_by(number) | {"time": time[row], "q": q[:, 0], "tau": tau[:, 0]}
    frame, path = pandas.DataFrame(columns), tmp_path / f"log{suffix}"
    frame.to_csv(path, index=False) if suffix == ".csv" else frame.to_parquet(path)
    log = read_log(path, joints=("a",))
    np.testing.assert_allclose(log.position, q)
    assert np.count_nonzero(np.diff(log.time) > 0.5) == number[-1]
    if by == "numbers":
        assert "8 episodes, concatenated" in log.notes
        one = read_log(path, joints=("a",), reading=Reading(episode=3))
        np.testing.assert_allclose(one.position, q[number == 3])


@pytest.mark.parametrize("unit", ["furlong", "V", "per mille of rated"])
def test_units_that_are_not_known_are_asked_for(read_table, unit):
    time, q, _, tau = motion(UR)
    names = ["t [s]", *(f"q{k} [{unit}]" for k in range(6)), *(f"tau{k} [Nm]" for k in range(6))]
    columns = named(names, time, q, tau)
    with pytest.raises(LogError, match=f"is in '{unit}', which is no known unit of position"):
        read_table(columns, UR)
    check(read_table(columns, UR, units={"position": "0.5rad"}), UR, 0.5 * q, None, tau)


@pytest.mark.parametrize("moves", [True, False])
def test_stamps_in_milliseconds_are_recognized_by_the_motion(read_table, moves):
    time, q, v, tau = motion(PANDA, rate=1000.0)
    names = ["time", *(f"{kind}{k}" for kind in ("q", "tau", "dq")[: 2 + moves] for k in range(7))]
    log = read_table(named(names, np.rint(1e3 * time), *[q, tau, v][: 2 + moves]))
    np.testing.assert_allclose(log.time, time, atol=1e-12)
    assert any("time is in ms, judging by 1000 Hz" in note for note in log.notes)
    slow = 1e3 * time if moves else 1e3 * time + 0.25 + 0.3 * (np.arange(ROWS) % 2)
    log = read_table(named(names, slow, *[q, tau, 1e-3 * v][: 2 + moves]))
    np.testing.assert_allclose(log.time, slow)


def test_ambiguous_names_of_targets_and_torques(read_table):
    time, q, _, tau = motion(PANDA)
    names = ["time", *indexed("q", 7), *indexed("tq", 7)]
    log = read_table(named(names, time, q, tau))
    check(log, tuple(f"joint_{k}" for k in range(7)), q, None, tau)
    np.testing.assert_allclose(read_table(named(names, time, q, q + 0.01)).command, q + 0.01)
    log = read_table(named([*names, *indexed("i", 7)], time, q, q + 0.01, tau))
    np.testing.assert_allclose(log.effort, tau)
    assert set(log.effort_kinds.values()) == {"current"}


@pytest.mark.parametrize("letters", ["mc", "cm"])
def test_measured_and_commanded_letters_are_asked_about_with_the_measured_first(
    read_table, letters
):
    """As q_m and q_c in logs of Rokae's robots."""
    time, q, v, tau = motion(IIWA)
    columns, known = {"time": time}, {"m": (q, v, tau), "c": (0.9 * q, 0.9 * v, 0.8 * tau)}
    for letter in letters:
        for what, values in zip(("q", "dq", "tau"), known[letter], strict=True):
            columns |= named([f"{what}_{letter}_{k}" for k in range(7)], values)
    asks = r"of m and of c\. Choose one: --topic m \(probably measured, as c are commanded\)"
    with pytest.raises(LogError, match=asks):
        read_table(columns, IIWA)
    check(read_table(columns, IIWA, topic="m"), IIWA, q, v, tau)
