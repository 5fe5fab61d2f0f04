"""What names of columns say, and which joints of a model they are of."""

import numpy as np
import pytest

from geodrake.logs.files.name_rules import MEASURED, PLAIN, matched, meaning_of, meanings_of

UR = tuple(
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
IIWA = tuple(f"iiwa_joint_{k}" for k in range(1, 8))


def joints_of(names, joints):
    return matched([meaning_of(name) for name in names], joints)


NAMES = [
    ("elbow.position", "position", "elbow", None),
    ("actual_q_0", "position", "", 0),
    ("target_moment_0", "effort", "", 0),
    ("q1", "position", "", 1),
    ("q_dot_1", "velocity", "", 1),
    ("tau_J[3]", "effort", "", 3),
    ("/joint_states/position[2]", "position", "", 2),
    ("/joint_states/elbow_joint/velocity", "velocity", "elbow_joint", None),
    ("pos_shoulder", "position", "shoulder", None),
    ("shoulder_eff", "effort", "shoulder", None),
    ("MeasuredJointPosition_A1", "position", "", 1),
    ("MeasuredTorque_A1", "effort", "", 1),
    ("MACur.A1", "current", "", 1),
    ("field.effort4", "effort", "", 4),
    ("q1_torque", "effort", "", 1),
    ("qfrc_actuator[elbow]", "effort", "elbow", None),
    ("q2d_3", "acceleration", "", 3),
    ("qd2[1]", "acceleration", "", 1),
    ("qd2", "velocity", "", 2),
    ("i_3", "current", "", 3),
    ("i_meas_elbow", "current", "elbow", None),
    ("elbow_tau_J", "effort", "elbow", None),
    ("cur_elbow", "current", "elbow", None),
    ("target_current_1", "current", "", 1),
    ("actual_joint_voltage_2", "voltage", "", 2),
    ("duty_cycle_2", "pwm", "", 2),
    ("duty_0", "pwm", "", 0),
    ("pwm_0", "pwm", "", 0),
    ("present_pwm_4", "pwm", "", 4),
    ("current_position_1", "position", "", 1),
    ("action[2]", "command", "", 2),
    ("/joint_states/elbow/command", "command", "elbow", None),
    ("/arm_controller/command/data[2]", "command", "", 2),
    ("/effort_controller/command[2]", "effort", "", 2),
    ("elbow.current", "current", "elbow", None),
    ("elbow.command", "command", "elbow", None),
    ("command_1", "command", "", 1),
    ("joint_temperatures_1", "temperature", "", 1),
    ("temp_0", "temperature", "", 0),
    ("axis0.Temperature", "temperature", "", 0),
]
WANTED = ("q_cmd_1", "q_des_1", "target_q_0", "goal_position", "command/positions[2]", "action[0]")


@pytest.mark.parametrize(("name", "quantity", "joint", "number"), NAMES)
def test_names_of_loggers(name, quantity, joint, number):
    meaning = meaning_of(name)
    assert (meaning.quantity, meaning.joint, meaning.number) == (quantity, joint, number)


@pytest.mark.parametrize(
    "name",
    [
        *("time", "t", "timestamp", "__time", "%time", "header.stamp.secs", "Time (ms)", "time_us"),
        *(
            "/joint_states/header/stamp/sec",
            "arm.time",
            "TimeMs",
            "elapsed time [s]",
            "Temps (s)",
            "ctrl_timestamp",
        ),
    ],
)
def test_names_of_time(name):
    assert meaning_of(name).quantity == "time"


@pytest.mark.parametrize(
    "name",
    [
        *("O_T_EE[3]", "actual_execution_time", "mode", "robot_status", "", "é", "col7"),
        *("speed_of_light/", "[]", "///", "q" * 500, "x" * 10_000, "_", "1", "v"),
    ],
)
def test_names_that_say_nothing_or_are_odd(name):
    meaning = meaning_of(name)
    assert meaning is None or meaning.quantity != "time"


@pytest.mark.parametrize(
    ("name", "unit", "factor"),
    [
        ("q1[deg]", "deg", 0.017453292519943295),
        ("q_deg_1", "deg", 0.017453292519943295),
        ("speed1 (rpm)", "rpm", 0.10471975511965977),
        ("vel_1[deg/s]", "deg/s", 0.017453292519943295),
        ("velocity_1_rad_s", "rad/s", 1.0),
        ("torque_1_Nmm", "Nmm", 1e-3),
        ("tau1 [N·m]", "Nm", 1.0),
        ("Time[us]", "us", 1e-6),
        ("%time", "ns", 1e-9),
        ("pos_1 (mm)", "mm", 1e-3),
        ("pwm_2 (%)", "%", 1e-2),
        ("elbow.present_load", "%", 1e-2),
        ("vel_estimate", "rev/s", 6.283185307179586),
        ("effort/elbow [Nmm]", "Nmm", 1e-3),
        ("q/joint2[mrad]", "mrad", 1e-3),
        ("tau/J2_Nmm", "Nmm", 1e-3),
        ("J3/current_mA", "mA", 1e-3),
        ("Current/joint1 [mA]", "mA", 1e-3),
        ("current1_A", "A", 1.0),
        ("joint1VelDegS", "deg/s", 0.017453292519943295),
        ("vel1_dps", "deg/s", 0.017453292519943295),
        ("J1 Velocity (deg/sec)", "deg/s", 0.017453292519943295),
        ("torque1 [kgf.cm]", "kgfcm", 0.0980665),
        ("voltage_1 [mA]", "mA", 1e-3),  # which is refused when it is read
    ],
)
def test_units_in_names(name, unit, factor):
    found = meaning_of(name).unit
    assert found.name == unit
    assert found.factor == pytest.approx(factor)


def test_letters_of_units_are_joints_where_several_columns_or_geodrakes_names_have_them():
    found = [m.joint for m in meanings_of(["q_A", "cur_A", "cur_B", "m.position"])]
    assert found == ["A", "A", "B", "m"]
    (_, current) = meanings_of(["pos_deg", "cur_A"])
    assert (current.joint, current.unit.name) == ("", "A")


@pytest.mark.parametrize(("name", "counted"), [("q_1 [inc]", True), ("q_inc_1", False)])
def test_counts_of_an_encoder_are_a_unit_in_brackets(name, counted):
    unit = meaning_of(name).unit
    assert (unit is not None) == counted
    assert unit is None or (unit.name == "counts" and np.isnan(unit.factor))


@pytest.mark.parametrize(
    ("names", "joints"),
    [
        ([f"actual_q_{k}" for k in range(6)], UR),
        ([f"pos_{joint.removesuffix('_joint')}" for joint in UR], UR),
        ([f"q[{k}]" for k in range(7)], PANDA),
        ([f"joint{k}.position" for k in range(1, 8)], PANDA),
        ([f"axisQMsr_LBR_iiwa_7_R800_1[{k}]" for k in range(7)], IIWA),
        ([f"AIPos.A{k}" for k in range(1, 8)], IIWA),
        (["position"], ("axis",)),
        (["wrist_1_pos", "wrist_2_pos"], ("left_wrist_1", "left_wrist_2")),
    ],
)
def test_joints_in_the_models_order(names, joints):
    found, _ = joints_of(names, joints)
    assert tuple(found[name] for name in names) == joints


def test_the_order_is_said_to_be_assumed():
    _, notes = joints_of([f"actual_q_{k}" for k in range(6)], UR)
    assert "actual_q_0 … actual_q_5" in notes[0]
    assert "model's order" in notes[0]
    assert not joints_of([f"q[{k}]" for k in range(7)], PANDA)[1]  # their names have the numbers


@pytest.mark.parametrize("first", [0, 1])
def test_fewer_columns_than_joints_only_by_their_numbers(first):
    names = [f"q{k + first}" for k in range(7)]
    found, _ = joints_of(names, PANDA + FINGERS)
    assert tuple(found[name] for name in names) == PANDA
    found, _ = joints_of([f"q{k + first}" for k in range(5)], UR)
    assert not set(UR).intersection(found.values())


def test_some_numbered_columns_are_of_the_joints_that_all_others_have():
    names = [*(f"actual_q_{k}" for k in range(6)), "actual_current_1", "target_q_4"]
    found, _ = joints_of(names, UR)
    assert (found["actual_current_1"], found["target_q_4"]) == (UR[1], UR[4])
    found, _ = joints_of([*names, "tau_7"], UR)
    assert found["tau_7"] not in UR


def test_joints_whose_names_say_something_else():
    joints = ("base", "wrist_angle", "arm/joint1")
    names = [f"{q} {joint}" for q in ("actual_position", "qd") for joint in joints]
    names += [f"{joint.upper()}_tau" for joint in joints]
    told = meanings_of(names, joints)
    kinds = [*["position"] * 3, *["velocity"] * 3, *["effort"] * 3]
    assert [(m.quantity, m.joint) for m in told] == [*zip(kinds, joints * 3, strict=True)]
    assert all(m.role <= PLAIN for m in told)


def test_names_that_may_be_of_two_joints_are_of_none():
    joints = ("left_wrist_1", "right_wrist_1")
    found, _ = joints_of(["wrist_1_pos"], joints)
    assert not set(joints).intersection(found.values())


def test_a_unit_in_brackets_says_the_quantity_in_any_language():
    names = [
        "Soll-Winkel 2 [°]",
        "Ist-Winkel 2 [°]",
        "Snelheid elleboog (rad/s)",
        "Par 1 [N·m]",
        "Zeit [ms]",
    ]
    told = [meaning_of(name) for name in names]
    assert [m.quantity for m in told] == ["position", "position", "velocity", "effort", "time"]
    assert [m.number for m in told[:2]] == [2, 2]
    assert told[0].role > told[1].role
    assert (told[2].joint, told[3].number) == ("Snelheid elleboog", 1)
    assert meaning_of("Gewicht [kg]") is None


def test_positions_that_were_asked_for():
    for meaning in map(meaning_of, WANTED):
        assert meaning.quantity in ("position", "command") and meaning.is_wanted
    assert not meaning_of("actual_q_0").is_wanted


def test_limits_and_supplies_are_no_signals_of_joints():
    names = ("current_limit_1", "actual_main_voltage", "present_input_voltage_2", "max_pwm_1")
    assert not any(map(meaning_of, (*names, "bus_current")))


def test_a_column_of_the_whole_robot_beside_numbered_ones():
    names = [*(f"actual_current_{k}" for k in range(6)), "actual_robot_current"]
    found, _ = joints_of(names, UR)
    assert tuple(found[name] for name in names[:6]) == UR


def test_measured_before_desired():
    assert meaning_of("actual_q_0").role == MEASURED
    roles = [meaning_of(n).role for n in ("tau_J[0]", "tau_J_d[0]", "tau_ext_hat_filtered[0]")]
    assert roles == sorted(set(roles))
