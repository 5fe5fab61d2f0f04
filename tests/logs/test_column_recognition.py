"""Meanings of column names, and the joints of a model that they name."""

import re

import numpy as np
import pytest

from geodrake.logs.files.name_rules import MEASURED, OTHER, as_positions, matched, meaning_of

UR = tuple(
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)
PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))
FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


def joints_of(names, joints):
    return matched([meaning_of(name) for name in names], joints)


NAMES = {
    "position": {"elbow.position": "elbow", "actual_q_0": 0, "q1": 1, "current_position_1": 1,
        "/joint_states/position[2]": 2, "pos_shoulder": "shoulder", "MeasuredJointPosition_A1": 1,
        "load_position_3": 3, "关节3实际位置（度）": 3, "Положение 3, град": 3,
        "hoek 3 [graden]": 3, "Istposition Achse 3 [Grad]": 3, "Soll-Winkel 2 [°]": 2,
        "Lageistwert 2 [°]": 2, "3軸 現在位置[deg]": 3, "Vinkel axel 2 [grader]": 2},
    "velocity": {"q_dot_1": 1, "/joint_states/elbow_joint/velocity": "elbow_joint", "qd2": 2,
        "joint_speeds[1]": 1, "Nopeus kyynärpää (rad/s)": "Nopeus kyynärpää"},
    "acceleration": {"q2d_3": 3, "qd2[1]": 1},
    "effort": {"target_moment_0": 0, "tau_J[3]": 3, "shoulder_eff": "shoulder", "q1_torque": 1,
        "MeasuredTorque_A1": 1, "couple_2": 2, "field.effort4": 4, "Drehmomentistwert 2 [Nm]": 2,
        "Vridmoment axel 2": 2, "qfrc_actuator[elbow]": "elbow",
        "elbow_tau_J": "elbow", "/effort_controller/command[2]": 2,
        "軸3トルク": 3, "Момент 3 [Нм]": 3, "Par 1 [N·m]": 1, "present_load_3 [%]": 3},
    "current": {"current3 [Ampere]": 3, "MACur.A1": 1, "i_3": 3, "i_meas_elbow": "elbow",
        "cur_elbow": "elbow", "target_current_1": 1, "elbow.current": "elbow",
        "m2_mA": 2},
    "voltage": {"actual_joint_voltage_2": 2, "U3 [V]": 3},
    "pwm": {"duty_cycle_2": 2, "duty_0": 0, "pwm_0": 0, "present_pwm_4": 4},
    "command": {"action[2]": 2, "/joint_states/elbow/command": "elbow", "elbow.command": "elbow",
        "/arm_controller/command/data[2]": 2, "command_1": 1},
    "temperature": {"joint_temperatures_1": 1, "temp_0": 0, "axis0.Temperature": 0},
    "time": dict.fromkeys(("time", "t", "timestamp", "__time", "%time", "header.stamp.secs",
        "Time (ms)", "time_us", "/joint_states/header/stamp/sec", "arm.time", "TimeMs",
        "elapsed time [s]", "Temps (s)", "ctrl_timestamp", "Zeit [ms]")),
    "": dict.fromkeys(("O_T_EE[3]", "actual_execution_time", "mode", "robot_status", "", "é",
        "col7", "speed_of_light/", "[]", "///", "q" * 500, "x" * 10_000, "_", "1", "v",
        "current_limit_1", "actual_main_voltage", "present_input_voltage_2", "max_pwm_1",
        "bus_current", "Gewicht [kg]")),
}  # fmt: skip
"""Quantity -> names, and joint or number in each; limits and supplies are no signals of joints."""
UNITS = {
    "deg": (np.pi / 180.0, ("q1[deg]", "q_deg_1", "q1 / deg", "q1 in °", "q1, deg", "[deg] q1",
        "q1.deg", "joint1PosDeg", "关节3实际位置（度）", "Положение 3, град", "hoek 3 [graden]",
        "Istposition Achse 3 [Grad]", "position_3［deg］")),
    "deg/s": (np.pi / 180.0, ("vel_1[deg/s]", "joint1VelDegS", "vel1_dps", "dq1 / deg/s",
        "dq1 (degrees/second)", "dq1.degs", "J1 Velocity (deg/sec)")),
    "rpm": (np.pi / 30.0, ("speed1 (rpm)",)), "rad": (1.0, ("q1 (rads)",)),
    "rad/s": (1.0, ("velocity_1_rad_s", "vel1 (rads)", "vel1 [rads/s]")),
    "rev/s": (2.0 * np.pi, ("vel_estimate", "vel3_turns_per_s")),
    "arcmin": (np.pi / 10800.0, ("q3 [arcmin]",)), "cNm": (0.01, ("tau3_cNm",)),
    "mrad": (1e-3, ("q/joint2[mrad]",)), "mm": (1e-3, ("pos_1 (mm)",)),
    "Nm": (1.0, ("j2_tau_nm", "tau1 [N·m]", "Момент 3 [Нм]", "torque3 (Newton-meters)")),
    "Nmm": (1e-3, ("torque_1_Nmm", "effort/elbow [Nmm]", "tau/J2_Nmm")),
    "lbin": (0.1129848290276167, ("J1 Torque (lb-in)",)),
    "kgfcm": (0.0980665, ("torque1 [kgf.cm]",)), "us": (1e-6, ("Time[us]",)),
    "ns": (1e-9, ("%time",)), "%": (1e-2, ("pwm_2 (%)", "pwm_2_%",
        "torque3 [% rated]")), "permille": (1e-3, ("elbow.present_load",)),
    "A": (1.0, ("current1_A", "current3 [Ampere]")), "V": (1.0, ("U3 [V]",)),
    "mA": (1e-3, ("J3/current_mA", "Current/joint1 [mA]", "voltage_1 [mA]")),  # refused when read
}  # fmt: skip


@pytest.mark.parametrize("quantity", NAMES)
def test_names_of_loggers(quantity):
    for name, of in NAMES[quantity].items():
        meaning = meaning_of(name)
        if not quantity:
            assert meaning is None or meaning.quantity != "time", name
            assert meaning is None or not re.search("limit|voltage|max|bus|kg", name), name
            continue
        assert meaning.quantity == quantity, name
        if of is not None:
            joint, number = (of, None) if isinstance(of, str) else ("", of)
            assert (meaning.joint, meaning.number) == (joint, number), name


@pytest.mark.parametrize("name", ["ee_force_1", "tool_force_2", "tcp_velocity_1", "imu.acc[0]"])
def test_columns_of_tools_and_sensors_are_of_no_joint(name):
    assert meaning_of(name).role == OTHER


@pytest.mark.parametrize("unit", UNITS)
def test_units_in_names(unit):
    factor, names = UNITS[unit]
    for found in (meaning_of(name).unit for name in names):
        assert (found.name, found.factor) == (unit, pytest.approx(factor))


def test_columns_named_like_joints_are_positions():
    names = ["joint1", "actual_axis_2", "elbow", "a1", "box1"]
    assert [m.column for m in as_positions(names, ["elbow"])] == names[:3]


@pytest.mark.parametrize("first", [0, 1])
def test_fewer_columns_than_joints_only_by_their_numbers(first):
    names = [f"q{k + first}" for k in range(7)]
    found, _ = joints_of(names, PANDA + FINGERS)
    assert tuple(found[name] for name in names) == PANDA
    found, _ = joints_of([f"q{k + first}" for k in range(5)], UR)
    assert not set(UR).intersection(found.values())


FORMS = [
    ("actual_q_0 actual_q_1", "shoulder_pan_joint elbow_joint"),
    ("pos_shoulder_pan pos_elbow", "shoulder_pan_joint elbow_joint"),
    ("q[0] q[1]", "panda_joint1 panda_joint2"),
    ("joint1.position joint2.position", "panda_joint1 panda_joint2"),
    ("axisQMsr_LBR_iiwa_7_R800_1[0] axisQMsr_LBR_iiwa_7_R800_1[1]", "iiwa_joint_1 iiwa_joint_2"),
    ("AIPos.A1 AIPos.A2", "iiwa_joint_1 iiwa_joint_2"),
    ("position", "axis"),
    (
        "pos_S pos_L pos_U pos_R pos_B pos_T",
        "joint_0_s joint_1_l joint_2_u joint_3_r joint_4_b joint_5_t",
    ),
    ("wrist_1_pos wrist_2_pos", "left_wrist_1 left_wrist_2"),
]
"""Columns, and the joints of a model that they are of."""
GROUPS = [
    ("lift elbow wrist_0 wrist_1 wrist_2", "lift elbow wrist_1 wrist_2 wrist_3"),
    ("pan lift elbow wrist0 wrist1 wrist2", " ".join(UR)),
    ("a0 a1 b0 b1 c0 c1", "leg_a_1 leg_a_2 leg_b_1 leg_b_2 leg_c_1 leg_c_2"),
    ("leg0_j0 leg0_j1 leg1_j0 leg1_j1", "leg_1_j1 leg_1_j2 leg_2_j1 leg_2_j2"),
    ("leg1_j0 leg1_j1 leg2_j0 leg2_j1", "leg_1_j1 leg_1_j2 leg_2_j1 leg_2_j2"),
    (
        "left_0 left_1 right_0 right_1 torso",
        "left_arm_1 left_arm_2 right_arm_1 right_arm_2 torso",
    ),
    ("f1_near f1_far f2_near f2_far", "finger_1_near finger_1_far finger_2_near finger_2_far"),
    ("arm_0 arm_1 hand_0 hand_1", "arm_joint1 arm_joint2 hand_joint1 hand_joint2"),
]
"""The same of groups of joints that are counted from 0."""


@pytest.mark.parametrize(
    ("columns", "joints"),
    [*FORMS, *((" ".join(f"{n}_pos" for n in a.split()), b) for a, b in GROUPS)],
)
def test_columns_are_of_the_joints_of_a_model(columns, joints):
    names = columns.split()
    found, _ = joints_of(names, tuple(joints.split()))
    assert [found[name] for name in names] == joints.split()


def test_a_prefix_with_a_number_and_a_joint_that_the_model_lacks():
    names = [f"ur5e_{joint}_pos" for joint in (*UR, "gripper")]
    found, _ = joints_of(names, UR)
    assert [found.get(name) for name in names] == [*UR, "ur5e_gripper"]


def test_names_that_may_be_of_two_joints_are_of_none():
    joints = ("left_wrist_1", "right_wrist_1")
    found, _ = joints_of(["wrist_1_pos"], joints)
    assert not set(joints).intersection(found.values())


def test_measured_before_desired():
    assert meaning_of("actual_q_0").role == MEASURED
    for names in (
        ("tau_J[0]", "tau_J_d[0]", "tau_ext_hat_filtered[0]"),
        ("axisTauMsr_LBR_iiwa_7_R800_1[0]", "axisTauExtMsr_LBR_iiwa_7_R800_1[0]"),
    ):
        roles = [meaning_of(name).role for name in names]
        assert roles == sorted(set(roles))
    asked = ("q_cmd_1", "q_des_1", "target_q_0", "goal_position", "command/positions[2]")
    for meaning in map(meaning_of, (*asked, "action[0]", "Soll-Winkel 2 [°]")):
        assert meaning.quantity in ("position", "command") and meaning.is_wanted
    assert not meaning_of("actual_q_0").is_wanted
