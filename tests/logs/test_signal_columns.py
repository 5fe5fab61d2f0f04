"""Currents, voltages, duty cycles, commands and temperatures in logs."""

from dataclasses import replace

import numpy as np
import pandas
import pytest
from scipy.io import savemat

from geodrake.diagnosis import corrected
from geodrake.diagnosis.columns.finding import ColumnFinding
from geodrake.errors import ArgumentError, LogError
from geodrake.logs import JointLog, Reading, log_of_frame, read_log, write_log
from geodrake.logs.files import read_mapping
from geodrake.logs.files.reading import ColumnMapping, MappedColumn, parsed_gain
from geodrake.logs.files.units import unit_of
from geodrake.logs.inspection import inspect_log, mapping_text
from geodrake.logs.log_checks import check_commands, check_saturation
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.temperatures import Temperatures
from geodrake.logs.uniform_log import make_uniform

JOINTS = ("shoulder", "elbow")
ROWS = 300
TIME = np.arange(ROWS) / 100.0
Q = np.sin(TIME[:, None] * np.array([2.0, 3.0]))
S = 3.0 * np.cos(TIME[:, None] * np.array([2.0, 3.0])) + np.array([0.5, -0.2])
C = Q + 0.01 * S


def frame(**columns):
    """Return `time`, and columns of two joints by the forms of their names."""
    found = {"time": TIME}
    for form, values in columns.items():
        found |= {form.replace("_J", f"_{k}"): values[:, k] for k in range(2)}
    return found


def own(**quantities):
    return {"time": TIME} | {
        f"{joint}.{quantity}": values[:, k]
        for quantity, values in quantities.items()
        for k, joint in enumerate(JOINTS)
    }


def said(log):
    return " | ".join(log.notes)


def saved(path, columns):
    """Write columns to a file of one of four formats."""
    if path.suffix == ".npz":
        np.savez(path, **columns)
    elif path.suffix == ".mat":
        parts = {}
        for name, values in columns.items():
            joint, _, quantity = name.partition(".")
            parts |= {joint: {**parts.get(joint, {}), quantity: values} if quantity else values}
        savemat(path, parts)
    else:
        table = pandas.DataFrame(columns)
        table.to_parquet(path) if path.suffix == ".parquet" else table.to_csv(path, index=False)
    return path


def test_commands_stand_for_efforts():
    log = log_of_frame(frame(actual_q_J=Q, target_q_J=C), joints=JOINTS)
    assert np.array_equal(log.command, C)
    assert np.array_equal(log.position, Q)
    assert np.isnan(log.effort).all()
    assert not log.effort_kinds
    assert not log.standing
    assert "their servo commands are used" in said(log)


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".mat"])
def test_own_names_in_files_and_back(tmp_path, suffix):
    columns = {**own(position=Q, temperature=30.0 + S), "shoulder.current": S[:, 0]}
    columns["elbow.command"] = C[:, 1]
    log = read_log(saved(tmp_path / f"log{suffix}", columns), joints=JOINTS)
    check_mixed(log)
    for again in ("again.csv", "again.npz"):
        write_log(log, tmp_path / again)
        check_mixed(read_log(tmp_path / again))
    check_mixed(log_of_frame(log.to_dataframe()))


def check_mixed(log):
    """Check that the first joint has currents, the second commands alone, and both temperatures."""
    assert log.joints == JOINTS
    assert log.effort_kinds == {"shoulder": "current"}
    assert np.array_equal(log.effort[:, 0], S[:, 0])
    assert np.isnan(log.effort[:, 1]).all()
    assert np.isnan(log.command[:, 0]).all()
    assert np.array_equal(log.command[:, 1], C[:, 1])
    assert np.array_equal(log.temperature, 30.0 + S)
    assert np.array_equal(log.select(["elbow"]).temperature, 30.0 + S[:, 1:])
    assert not any("ignored" in note for note in log.notes)


def test_efforts_win_over_currents_and_these_over_voltages_and_duty_cycles():
    every = {"tau_J": S, "current_J": 2 * S, "voltage_J": 3 * S, "pwm_J": 4 * S}
    for kind in ("effort", "current", "voltage", "pwm"):
        log = log_of_frame(frame(q_J=Q, **every), joints=JOINTS)
        assert set(log.effort_kinds.values()) == ({kind} - {"effort"})
        assert np.array_equal(log.effort, next(iter(every.values())))
        if len(every) > 1:
            assert f"effort: {next(iter(every)).replace('_J', '_0')}" in said(log)
            assert "used instead of" in said(log)
        if kind != "effort":
            assert "estimated with the model's inertias, unless given by --gain" in said(log)
        every.pop(next(iter(every)))


def test_commands_are_used_beside_efforts_only_on_request():
    told = frame(q_J=Q, tau_J=S, target_q_J=C)
    log = log_of_frame(told, joints=JOINTS)
    assert log.command is None and "target_q_0" in said(log)
    assert np.array_equal(log_of_frame(own(position=Q, effort=S, command=C)).command, C)
    names = {"position": "q_{}", "effort": "tau_{}", "command": "target_q_{}"}
    columns = {
        joint: {quantity: MappedColumn(form.format(k)) for quantity, form in names.items()}
        for k, joint in enumerate(JOINTS)
    }
    mapping = ColumnMapping(columns, MappedColumn("time"))
    assert np.array_equal(log_of_frame(told, reading=Reading(mapping=mapping)).command, C)
    commands = Reading(kinds={"": "command"})
    log = log_of_frame(told, joints=JOINTS, reading=commands)
    assert np.array_equal(log.command, C)
    assert np.isnan(log.effort).all() and not any("no servo" in note for note in log.notes)
    log = log_of_frame(frame(q_J=Q, tau_J=S), joints=JOINTS, reading=commands)
    assert "no servo commands were logged, so --kind command has no effect" in log.notes


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_empty_efforts_are_replaced(tmp_path, suffix):
    nothing = np.full_like(S, np.nan)
    for columns in (
        frame(q_J=Q, effort_J=nothing, target_q_J=C),
        own(position=Q, effort=nothing, command=C),
        frame(q_J=Q, effort_J=nothing, current_J=S),
    ):
        log = read_log(saved(tmp_path / f"log{suffix}", columns), joints=JOINTS)
        assert log.joints == JOINTS and not log.standing
        if log.effort_kinds:
            assert "effort_0, effort_1 do not describe efforts" in said(log)
        else:
            assert np.array_equal(log.command, C) and np.isnan(log.effort).all()
    assert set(log.effort_kinds.values()) == {"current"}


def test_supply_voltages_are_not_efforts():
    supply = 12.0 + 0.1 * S
    log = log_of_frame(frame(q_J=Q, voltage_J=supply, action_J=C), joints=JOINTS)
    assert not log.effort_kinds
    assert np.array_equal(log.command, C)


@pytest.mark.parametrize(
    ("form", "units", "kind", "factor"),
    [
        ("current_J", {"current": "mA"}, "current", 1e-3),
        ("effort_J", {"effort": "mA"}, "current", 1e-3),
        ("effort_J_mA", {}, "current", 1e-3),
        ("current_J [0.01 A]", {}, "current", 1e-2),
        ("voltage_J", {"voltage": "mV"}, "voltage", 1e-3),
        ("pwm_J", {"pwm": "%"}, "pwm", 1e-2),
        ("duty_J [%]", {}, "pwm", 1e-2),
    ],
)
def test_units_of_signals(form, units, kind, factor):
    log = log_of_frame(frame(q_J=Q, **{form: S}), joints=JOINTS, reading=Reading(units=units))
    assert set(log.effort_kinds.values()) == {kind}
    assert np.allclose(log.effort, factor * S)
    assert f"{kind} is in" in said(log)


def test_commands_are_in_the_unit_of_positions_unless_they_say_another():
    deg, told = np.rad2deg(Q), np.rad2deg(C)
    for columns, units in (
        (frame(q_J=deg, cmd_J=told), {"position": "deg"}),
        (frame(q_deg_J=deg, cmd_J=told), {}),
        (frame(q_deg_J=deg, cmd_J=C), {"command": "rad"}),
    ):
        assert np.allclose(log_of_frame(columns, reading=Reading(units=units)).command, C)


def test_known_gains_give_efforts_with_uncertainty():
    columns = frame(q_J=Q, current_J=S)
    reading = Reading(gains={"shoulder": 4.0, "elbow": -2.0}, gain_deviations={"elbow": 0.5})
    log = log_of_frame(columns, joints=JOINTS, reading=reading)
    assert np.allclose(log.effort, S * [4.0, -2.0])
    assert not log.effort_kinds
    assert log.effort_uncertainty.tolist() == [0.05, 0.25]
    assert "estimated with the model" not in said(log)
    one = Reading(gains={"shoulder": 4.0})
    log = log_of_frame(columns, joints=JOINTS, reading=one)
    assert log.effort_kinds == {"elbow": "current"}
    assert log.effort_uncertainty == 0.05


def test_gains_with_deviations():
    for text in ("13.2±0.5", "13.2+-0.5", "13.2 +/- 0.5"):
        assert parsed_gain(text, "it") == (13.2, 0.5)
    assert parsed_gain("-2e-3", "it") == (-2e-3, None)
    for text in ("", "x", "1±", "1±2±3", "±0.5", "1 2"):
        with pytest.raises(ArgumentError, match="not a number"):
            parsed_gain(text, "it")


@pytest.mark.parametrize("kinds", [{"": "current"}, dict.fromkeys(JOINTS, "current")])
def test_kinds_of_efforts_by_option(kinds):
    log = log_of_frame(own(position=Q, effort=S), reading=Reading(kinds=kinds))
    assert log.effort_kinds == dict.fromkeys(JOINTS, "current")
    assert np.array_equal(log.effort, S)
    units = Reading(kinds=kinds, units={"current": "mA"})
    assert np.allclose(log_of_frame(own(position=Q, effort=S), reading=units).effort, 1e-3 * S)


HALF = {**own(position=Q), "shoulder.current": S[:, 0]}
PLAIN = frame(q_J=Q, tau_J=S)
CONTRADICTIONS = {
    r"no joint with both.*\.command may replace effort": (own(position=Q, velocity=S), {}),
    r"no efforts of elbow.*\.command may replace effort": (HALF, {}),
    "used as voltage .* in mA, a unit of current": (frame(**{"q_J": Q, "voltage_J [mA]": S}), {}),
    "is voltage by its name, but current by --kind": (
        frame(q_J=Q, voltage_J=S),
        {"kinds": {"shoulder": "current"}},
    ),
    "--kind names 'wrist'": (PLAIN, {"kinds": {"wrist": "current"}}),
    "with kind 'command'": (PLAIN, {"kinds": {"shoulder": "command"}}),
    "no column of 'shoulder' with efforts or signals, which --gain": (
        frame(q_J=Q, cmd_J=C),
        {"gains": {"shoulder": 2.0}},
    ),
}


@pytest.mark.parametrize("words", CONTRADICTIONS)
def test_contradictions_are_refused(words):
    columns, reading = CONTRADICTIONS[words]
    joints = None if any("." in name for name in columns) else JOINTS
    with pytest.raises(LogError, match=words) as caught:
        log_of_frame(columns, joints=joints, reading=Reading(**reading))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"kinds": {"shoulder": "amps"}}, "not a known kind of efforts of 'shoulder'"),
        ({"units": {"voltage": "A"}}, "'A' is not a known unit of voltage"),
        ({"gains": {"a": 0.0}}, "nonzero number"),
        ({"gains": {"a": 2.0}, "gain_deviations": {"a": 3.0}}, "less than the gain"),
        ({"gains": {"a": 2.0}, "gain_deviations": {"a": -1.0}}, "at least 0"),
        ({"gain_deviations": {"a": 1.0}}, "but no value"),
        ({"units": {"temperature": "R"}}, "'R' is not a known unit of temperature.*°C"),
        ({"units": {"colour": "rad"}}, "Quantity 'colour' is unknown"),
        ({"rate": float("nan")}, "finite number above"),
        ({"rate": 10**400}, "rate"),
        ({"gains": {"a": float("inf")}}, "a finite number"),
        ({"columns": "time"}, "columns must be a tuple"),
    ],
)
def test_invalid_readings(options, words):
    with pytest.raises(ArgumentError, match=words):
        Reading(**options)


def test_useless_commands_are_refused():
    nothing = np.full_like(Q, np.nan)

    def log(command):
        return JointLog("x", JOINTS, TIME, Q, nothing, command=command)

    check_commands(log(C))
    copy = C.copy()
    copy[:, 1] = Q[:, 1]
    with pytest.raises(LogError, match=r"elbow .* always equals.* steps or oscillations"):
        check_commands(log(copy))
    with pytest.raises(LogError, match=r"shoulder .* always equals"):
        check_commands(log(np.roll(Q, -2, axis=0)))  # positions lag two rows
    check_commands(JointLog("x", JOINTS, TIME, Q, S, command=Q))  # efforts are measured
    for other in (np.diff(C, axis=0, prepend=C[:1]), 20.0 * C):
        with pytest.raises(LogError, match=r"No joint follows its commands .* increments"):
            check_commands(log(other))


def test_velocities_unrelated_to_positions_are_not_used(read_table):
    log = read_table(frame(q_J=Q, v_J=0.0 * Q, effort_J=S), JOINTS)
    assert log.velocity is None
    assert "velocity is not used, as it is unrelated to positions" in log.notes
    noise = np.random.default_rng(5).normal(0.0, 1e-3, Q.shape)
    angle = 8.0 * np.pi * TIME[:, None] + [0.0, 1.0]  # a turn in 25 rows
    columns = frame(q_J=np.sin(angle) + noise, v_J=8.0 * np.pi * np.cos(angle), effort_J=S)
    assert read_table(columns, JOINTS).velocity is not None
    columns = frame(q_J=np.rint(2048.0 + 651.9 * Q), v_J=np.rint(41.7 * V), effort_J=S)
    log = read_table(columns, JOINTS)
    np.testing.assert_allclose(log.velocity, V, atol=0.02)
    assert "velocity is in 0.229 rpm, as velocities are" in said(log)


@pytest.mark.parametrize("unit", ["deg", "ticks"])
def test_commands_in_another_unit_than_positions_are_refused(unit):
    columns = frame(actual_q_J=Q, target_q_J=C / unit_of(unit, "command").factor)
    with pytest.raises(LogError, match=r"times as far.*--units position=rad,command=deg, or"):
        check_commands(log_of_frame(columns, joints=JOINTS))
    reading = Reading(units={"command": unit})
    log = log_of_frame(columns, joints=JOINTS, reading=reading)
    np.testing.assert_allclose(log.command, C, atol=1e-9)
    check_commands(log)


def test_commands_that_are_written_as_they_change_are_held():
    told = np.where(np.arange(len(C))[:, None] % 5 == 2, C, np.nan)
    log = log_of_frame(frame(actual_q_J=Q, target_q_J=told), joints=JOINTS)
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.command[2:], C[2 + (np.arange(len(C) - 2) // 5) * 5])


def test_positions_of_leaders_are_commands_of_followers():
    log = log_of_frame(frame(leader_q_J=C, follower_q_J=Q), joints=JOINTS)
    np.testing.assert_array_equal(log.position, Q)
    np.testing.assert_array_equal(log.command, C)


@pytest.mark.parametrize("joint", ["elbow", "gripper"])
def test_normalized_positions_are_shares_of_the_range(joint):
    """LeRobot's are from −100 to 100 for joints, and from 0 to 100 for grippers."""
    share = 50.0 * (1.0 + np.sin(TIME))
    columns = {"time": TIME, f"{joint}.pos": share, f"action.{joint}": share}
    units, limits = {"position": "normalized"}, {joint: (-2.5, 1.5)}
    log = log_of_frame(columns, joints=[joint], reading=Reading(units=units, limits=limits))
    low, high = (-2.5, 1.5) if joint == "gripper" else (-0.5, 1.5)
    expected = low + (high - low) * share / 100.0
    np.testing.assert_allclose(log.position[:, 0], expected, atol=1e-9)
    np.testing.assert_allclose(log.command[:, 0], expected, atol=1e-9)
    with pytest.raises(LogError, match="the model has no limits for it"):
        log_of_frame(columns, joints=[joint], reading=Reading(units=units))


@pytest.mark.parametrize(
    ("quantity", "unit"),
    [("velocity", "normalized/s"), ("position", "normalized/100"), ("command", "normalized@50")],
)
def test_only_positions_are_normalized_and_without_a_scale(quantity, unit):
    with pytest.raises(ArgumentError, match=f"not a known unit of {quantity}"):
        Reading(units={quantity: unit})


def test_efforts_that_are_saturated():
    def log(effort, **more):
        return JointLog("x", JOINTS, TIME, Q, effort, **more)

    check_saturation(log(S))
    check_saturation(log(np.clip(S, -2.9, 2.9)))  # sometimes
    kinds = {"shoulder": "current"}
    with pytest.raises(LogError, match=r"current of shoulder .* is saturated.* 0\.5,"):
        check_saturation(log(np.clip(S, -0.5, 0.5), effort_kinds=kinds))
    with pytest.raises(LogError, match="saturated"):
        check_saturation(log(np.sign(S + 0.01)))
    check_saturation(log(np.clip(np.round(S), -1.0, 1.0)))  # may be rounded
    check_saturation(log(np.round(0.24 * np.tanh(20.0 * S), 2)))  # dry friction, rounded
    check_saturation(log(np.ones_like(S)))
    check_saturation(log(np.full_like(S, np.nan)))


def test_messages_on_joints_without_efforts_and_commands():
    nothing = np.full_like(Q, np.nan)
    with pytest.raises(LogError, match="none has effort of shoulder"):
        make_uniform(JointLog("x", JOINTS, TIME, Q, nothing))
    with pytest.raises(LogError, match="none has effort or command of shoulder"):
        make_uniform(JointLog("x", JOINTS, TIME, Q, nothing, command=nothing))


WHOLE = np.rint(100.0 * S)
ONE_SIGN = np.column_stack([WHOLE[:, 0], -1.0 - np.abs(WHOLE[:, 0])])
LOAD = np.rint(900.0 * S / np.abs(S).max())
COMPLEMENT, MAGNITUDE = "two's complement of 16 bits", "sign and magnitude with the sign in bit 10"
REGISTERS = {
    "complement": (WHOLE, np.mod(WHOLE, 2.0**16), f"{COMPLEMENT}: 65535 is -1"),
    "complement of another zero": (WHOLE - 1000.0, np.mod(WHOLE - 1000.0, 2.0**16), COMPLEMENT),
    "sign and magnitude": (WHOLE, np.where(WHOLE < 0.0, 2.0**10 - WHOLE, WHOLE), MAGNITUDE),
    "beyond half of the range": (LOAD, np.where(LOAD < 0.0, 1024 - LOAD, LOAD), MAGNITUDE),
    "a joint with one sign": (ONE_SIGN, np.where(ONE_SIGN < 0.0, 2.0**10 - ONE_SIGN, ONE_SIGN), ""),
}
"""Values, what a program wrote that ignored their sign, and how they are read."""


@pytest.mark.parametrize("kind", REGISTERS)
def test_registers_that_were_read_without_their_sign(read_table, kind):
    values, written, words = REGISTERS[kind]
    log = read_table(frame(q_J=Q, pwm_J=written), JOINTS)
    assert np.array_equal(log.effort, values)
    assert f"'pwm_0' is read as {words}" in said(log)


def test_whole_numbers_of_a_wide_range_are_no_registers():
    """They never reach half of what a register can hold; positions have no magnitudes."""
    for numbers in (np.abs(WHOLE), np.rint(65535.0 * (0.5 + Q / 2.1))):
        log = log_of_frame(frame(q_J=Q, pwm_J=numbers), joints=JOINTS)
        assert np.array_equal(log.effort, numbers)
        assert "is read as" not in said(log)
    ticks = np.where(WHOLE < 0.0, 2.0**10 - WHOLE, WHOLE)
    reading = Reading(units={"position": "ticks"})
    log = log_of_frame(frame(q_J=ticks, effort_J=S), joints=JOINTS, reading=reading)
    assert "is read as" not in said(log)


TICKS = np.rint(2048.0 + Q / (2.0 * np.pi) * 4096.0)


def test_positions_in_ticks_of_servos(read_table):
    columns = frame(q_J=TICKS, goal_position_J=TICKS[::-1])
    log = read_table(columns, JOINTS)
    np.testing.assert_allclose(log.position, Q, atol=np.pi / 4096.0)
    np.testing.assert_array_equal(log.command, log.position[::-1])
    assert "with zero at tick 2048, as in drivers" in said(log)
    assert "position=ticks,command=ticks for zero at 0" in said(log)
    log = read_table(columns, JOINTS, units={"position": "ticks", "command": "ticks"})
    np.testing.assert_allclose(log.position, np.pi + Q, atol=1e-3)


@pytest.mark.parametrize("name", ["Axis0{}.Position [cnt]", "joint{}_count"])
def test_counts_of_an_encoder_are_shares_of_a_turn(read_table, name):
    columns = frame(effort_J=S)
    columns |= {name.format(k): column for k, column in enumerate(100.0 * TICKS.T)}
    words = r"in counts of unknown resolution.*--units position=rev/4096"
    with pytest.raises(LogError, match=words):
        read_table(columns, JOINTS)
    for unit, turns in (("rev/409600@204800", 1.0), ("rev/4096.5@204800", 409600 / 4096.5)):
        log = read_table(columns, JOINTS, units={"position": unit})
        np.testing.assert_allclose(log.position / turns, Q, atol=np.pi / 4096.0)


def test_the_zero_of_ticks_is_where_the_model_has_its_limits(read_table):
    for low, high, zero in ((-0.1, 6.2, np.pi), (-2.0, 2.0, 0.0), (7.0, 8.0, 0.0)):
        limits = dict.fromkeys(JOINTS, (low, high))
        log = read_table(frame(q_J=TICKS, effort_J=S), JOINTS, limits=limits)
        np.testing.assert_allclose(log.position, zero + Q, atol=np.pi / 4096.0)
        assert ("tick 0, as the model's limits suggest" in said(log)) == (zero > 0.0)


def test_a_mapping_of_ticks_states_their_zero(tmp_path):
    """The gain of a joint that is reversed applies to angles, not to ticks."""
    path = saved(tmp_path / "log.csv", frame(q_J=TICKS, effort_J=S))
    found = inspect_log(path, joints=JOINTS)
    reversed_too = [replace(each, factor=-each.factor) for each in found.columns]
    for columns, sign in ((found.columns, 1.0), (reversed_too, -1.0)):
        text = mapping_text(path, found, columns)
        assert "unit: ticks@2048" in text
        (tmp_path / "m.yaml").write_text(text)
        log = read_log(path, reading=Reading(mapping=read_mapping(tmp_path / "m.yaml")))
        np.testing.assert_allclose(log.position, sign * Q, atol=np.pi / 4096.0)


@pytest.mark.parametrize(
    ("columns", "units"),
    [
        (frame(q_J=TICKS + 0.5, effort_J=S), {}),
        (frame(q_J=TICKS - 3000.0, effort_J=S), {}),
        (frame(q_J=np.rint(180.0 + 180.0 * Q), effort_J=S), {}),
        (frame(q_J=TICKS, effort_J=S), {"position": "rad"}),
        (own(position=TICKS, effort=S), {}),  # geodrake's own names hold radians
    ],
)
def test_other_positions_are_no_ticks(read_table, columns, units):
    log = read_table(columns, JOINTS, units=units)
    np.testing.assert_array_equal(log.position, np.column_stack([*columns.values()][1:3]))


V = np.array([2.0, 3.0]) * np.cos(TIME[:, None] * np.array([2.0, 3.0]))
NOISY = V + np.random.default_rng(5).normal(0.0, 1.0, V.shape)
DEG, RPM = 180.0 / np.pi, 30.0 / np.pi
UNITS = {
    "far beyond limits": ({"q_J": DEG * Q, "cmd_J": DEG * C}, DEG, None),
    "and speeds as they change": ({"q_J": DEG * Q, "v_J": DEG * V}, DEG, 1.0),
    "speeds in rad/s": ({"q_J": DEG * Q, "v_J": V}, DEG, 1.0),
    "turns and rad/s": ({"q_J": Q / (2.0 * np.pi), "dq_J_rad_s": V}, 0.5 / np.pi, 1.0),
    "speeds in deg/s": ({"q_J": Q, "v_J": DEG * V}, 1.0, 1.0),
    "speeds in rpm": ({"q_J_rad": Q, "v_J": RPM * V}, 1.0, 1.0),
    "speeds of motors": ({"q_J": Q, "v_J": 100.0 * V}, 1.0, 100.0),
    "speeds of motors with gears as turns have": ({"q_J": Q, "v_J": 60.0 * V}, 1.0, 60.0),
    "told speeds of such": ({"q_J": Q, "dq_J_rad_s": 6.3 * V}, 1.0, 6.3),
    "noisy speeds in rad/s": ({"q_J": DEG * Q, "v_J": NOISY}, DEG, NOISY / V),
    "noisy speeds in deg/s": ({"q_J": DEG * Q, "v_J": DEG * NOISY}, DEG, NOISY / V),
    "shares of LeRobot": ({"servo_J.pos": DEG * Q}, 1.0, None),
    "motors": ({"motor_q_J": DEG * Q}, 1.0, None),
    "two turns": ({"q_J": 16.0 * Q}, 1.0, None),
    "thousandths": ({"q_J": 1000.0 * Q}, 1.0, None),
    "thousandths and rad/s": ({"q_J": 1000.0 * Q, "v_J": V}, 1000.0, 1.0),
    "hundredths of degrees": ({"q_J": 100.0 * DEG * Q, "v_J": DEG * V}, 100.0 * DEG, 1.0),
    "changes from row to row": ({"q_J": Q, "v_J": 1e-3 * V}, 1.0, 1e-3),
    "changes in a clock ten times as slow": ({"q_J": Q, "v_J": 1e-2 * V}, 1.0, 1e-2),
    "in rad as asked": ({"q_J": DEG * Q}, 1.0, None),
}
"""Columns, and by which factors their positions and velocities are found to be too large."""


@pytest.mark.parametrize("kind", UNITS)
def test_unstated_units_are_converted_where_values_are_certain(read_table, kind):
    told, angle, speed = UNITS[kind]
    columns, given = frame(**told, effort_J=S), next(iter(told.values()))
    units = {"position": "rad"} if "asked" in kind else {}
    how = {"limits": dict.fromkeys(JOINTS, (-2.0, 2.0)), "units": units}
    log = read_table(columns, JOINTS, **how, sliding=frozenset([JOINTS[1]]))
    factor = 1000.0 if "thousandths" in kind else 1.0  # mm
    np.testing.assert_allclose(log.position[:, 1], given[:, 1] / factor, atol=1e-12)
    log = read_table(columns, JOINTS, **how)
    np.testing.assert_allclose(log.position, given / angle, atol=1e-12)
    assert ("position is in" in said(log)) == (angle != 1.0)
    if speed is not None:
        np.testing.assert_allclose(log.velocity, speed * V, rtol=1e-9, atol=1e-12)
    if log.command is not None:
        np.testing.assert_allclose(log.command, C, atol=1e-12)


@pytest.mark.parametrize("speed", [1.0, 1000.0])
def test_sliding_joints_in_mm_are_converted_where_limits_hold_no_others(read_table, speed):
    columns = frame(q_J=1000.0 * Q, cmd_J=1000.0 * C, v_J=speed * V, effort_J=S)
    how = {"sliding": frozenset(JOINTS), "limits": dict.fromkeys(JOINTS, (-2.0, 2.0))}
    log = read_table(columns, JOINTS, **how)
    np.testing.assert_allclose(log.position, Q, atol=1e-12)
    np.testing.assert_allclose(log.velocity, V, atol=1e-12)
    assert "position is in mm at shoulder, elbow, which reaches" in said(log)
    assert ("velocity is in mm/s at" in said(log)) == (speed > 1.0)
    how["limits"] = dict.fromkeys(JOINTS, (-20.0, 20.0))  # may be cm
    np.testing.assert_array_equal(read_table(columns, JOINTS, **how).position, 1000.0 * Q)


CLOCK = np.arange(2000) / 100.0
SWING = np.sin(CLOCK[:, None] * np.array([2.0, 3.0]))
WARMTH = np.stack([30.0 + CLOCK, 45.0 - 0.5 * CLOCK], 1)


def log_with(temperature):
    return JointLog("warm", JOINTS, CLOCK, SWING, np.cos(SWING), temperature=temperature)


def frame_with(form, warmth):
    """Return the columns of another logger, whose temperatures have names of a form."""
    frame = {"time": CLOCK}
    for name, values in (("q_J", SWING), ("tau_J", np.cos(SWING)), (form, warmth)):
        frame |= {name.replace("J", str(k)): values[:, k] for k in range(2)}
    return frame


@pytest.mark.parametrize("unit", ["[°F]", "[degF]"])
def test_degrees_of_fahrenheit_are_read(unit):
    other = 1.8 * WARMTH + 32.0
    log = log_of_frame(frame_with(f"temp_J {unit}", other), joints=JOINTS)
    np.testing.assert_allclose(log.temperature, WARMTH, rtol=1e-12)
    assert "temperature is in °F, by the column names: converted" in log.notes
    reading = Reading(units={"temperature": "F"})
    log = log_of_frame(frame_with("temp_J", other), joints=JOINTS, reading=reading)
    np.testing.assert_allclose(log.temperature, WARMTH, rtol=1e-12)


@pytest.mark.parametrize("numbered", [False, True])
def test_a_mapping_names_slow_temperatures_and_time(tmp_path, numbered):
    """Temperatures are in a file of their own, one a second, beside motions at 100 Hz."""
    slow = {"noise": 0.0 * CLOCK, "drive 7": WARMTH[:, 0], "drive 8": WARMTH[:, 1]}
    quick = log_with(None).columns()
    del quick["time"]
    names = ["moment", *quick, *slow]

    def column(name):
        return MappedColumn(1 + names.index(name) if numbered else name)

    np.savez(tmp_path / "motion.npz", moment=1e3 * CLOCK, **quick)
    rare = {name: values[::100] for name, values in slow.items()}
    np.savez(tmp_path / "drives.npz", moment=1e3 * CLOCK[::100], **rare)
    joints = {
        joint: {q: column(f"{joint}.{q}") for q in ("position", "effort")}
        | {"temperature": column(drive)}
        for joint, drive in zip(JOINTS, ("drive 7", "drive 8"), strict=True)
    }
    time = MappedColumn(1 if numbered else "moment", "ms")
    reading = Reading(mapping=ColumnMapping(joints, time))
    log = read_log(f"{tmp_path / 'motion.npz'}+{tmp_path / 'drives.npz'}", reading=reading)
    assert len(log) == len(CLOCK)
    known = log.time <= 19.0
    np.testing.assert_allclose(log.time[known], CLOCK[CLOCK <= 19.0], atol=1e-12)
    np.testing.assert_allclose(log.temperature[known], WARMTH[CLOCK <= 19.0], rtol=1e-12)


@pytest.mark.parametrize("code", [-1.0, 0.0, 127.0, 255.0, 5 * (255 - 32) / 9])
def test_readings_of_sensors_that_fail_are_none(code):
    readings = np.round(WARMTH)
    readings[:150, 0] = readings[300:303, 0] = code
    readings[:, 1] = code
    courses = Temperatures.of(JOINTS, CLOCK, readings)
    assert list(courses.courses) == ["shoulder"]
    found = courses.at(CLOCK, ["shoulder"])
    assert found.min() > 29.0 and found.max() < 1.0 + WARMTH[:, 0].max()
    cold = Temperatures.of(JOINTS, CLOCK, np.clip(np.round(WARMTH - 30.0), -3.0, 3.0))
    assert cold.courses["shoulder"][0].size == np.unique(CLOCK // 1).size


def test_a_prepared_log_says_which_sensors_fail():
    broken = np.where([False, True], 255.0, WARMTH)
    for readings, fails in ((broken, True), (WARMTH, False)):
        notes = prepare_logs([log_with(readings)], bandwidth=5.0)[0].notes
        assert ("temperature of elbow is not used: the sensor fails" in notes) == fails
        assert any("sensor" in note for note in notes) == fails


def test_temperatures_are_swapped_with_their_joints():
    swap = ColumnFinding("swapped_joints", JOINTS, (), 50.0, 0.99, (), 1.0, 0.1, "swapped", "")
    np.testing.assert_array_equal(corrected(log_with(WARMTH), [swap]).temperature, WARMTH[:, ::-1])


def test_a_prepared_log_has_temperatures_by_time():
    log = replace(log_with(WARMTH), time=CLOCK + 100.0)
    found = prepare_logs([log], bandwidth=5.0)[0].temperature(np.array([105.0, 110.0]))
    np.testing.assert_allclose(found, [[35.0, 42.5], [40.0, 40.0]], atol=0.05)
