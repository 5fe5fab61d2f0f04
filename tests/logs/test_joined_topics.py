"""Bags whose positions and efforts or commands are in different topics, as rosbags writes them."""

from dataclasses import replace

import numpy as np
import pytest
from foreign_logs import (
    EPOCH,
    joint_states,
    ros1_store,
    ros2_header,
    ros2_store,
    write_rosbag1,
    write_rosbag2,
)

from geodrake.errors import LogError
from geodrake.logs import JointLog, Reading, read_log

JOINTS = ("shoulder", "elbow")
TOLD = "/position_controller/commands"


@pytest.fixture(scope="module")
def log():
    """Positions behind their commands, 200 a second."""
    time = 0.005 * np.arange(300)
    return JointLog(
        "log", JOINTS, time, motion(time - 0.01), 8.0 * motion(time), command=motion(time)
    )


def motion(time):
    return np.column_stack([np.sin(1.9 * time), 0.4 + np.cos(3.1 * time)])


def states(log, *, stamp=lambda ns: ns, efforts=None):
    store = ros2_store()
    header = ros2_header(store)
    measured = replace(log, velocity=np.zeros(log.position.shape))
    measured = measured if efforts is None else replace(measured, effort=efforts)
    told = joint_states(store, measured, lambda ns: header(stamp(ns)), efforts=efforts is not None)
    return list(told)


def test_a_gripper_that_the_model_lacks_slows_no_arm(tmp_path, log):
    """It has the same topic, and a message of its own for each five of the arm."""
    gripper = JointLog(
        "g", ("finger",), log.time[::5] + 1e-3, *[0.02 + 0.0 * log.effort[::5, :1]] * 2
    )
    each = states(log, efforts=log.effort) + states(gripper, efforts=gripper.effort)
    both = sorted(each, key=lambda message: message[0])
    bag = write_rosbag2(tmp_path / "bag", {"/joint_states": both}, ros2_store())
    read = read_log(bag, joints=JOINTS)
    assert np.allclose(read.effort, log.effort, atol=1e-9)
    assert "no such joints: finger.position" in " ".join(read.notes)


def test_positions_and_efforts_without_names_are_joined(tmp_path, log):
    topics = {"/joint_positions": numbers(log, values=log.position)}
    topics["/joint_torques"] = numbers(log, values=log.effort)
    read = read_log(write_rosbag2(tmp_path / "bag", topics, ros2_store()), joints=JOINTS)
    assert np.allclose(read.position, log.position) and np.allclose(read.effort, log.effort)


def numbers(log, order=(0, 1), *, late=0.0, every=1, values=None):
    """Float64MultiArrays, without stamps and names."""
    types = ros2_store().types
    layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    values = log.command if values is None else values
    rows = range(0, len(log), every)
    return [
        (
            EPOCH + round(1e9 * (log.time[k] + late)),
            types["std_msgs/msg/Float64MultiArray"](layout, values[k, list(order)]),
        )
        for k in rows
    ]


def bag(folder, store=None, **topics):
    topics = {f"/{name.replace('__', '/')}": messages for name, messages in topics.items()}
    return write_rosbag2(folder / "bag", topics, store or ros2_store())


def said(log):
    return " ".join(log.notes)


@pytest.mark.parametrize("efforts", [None, np.nan])
def test_commands_of_a_controller_without_names_or_stamps(tmp_path, log, efforts):
    """In an order that is not the model's: the joint is that whose positions follow."""
    empty = None if efforts is None else np.full(log.position.shape, efforts)
    told = numbers(log, (1, 0), late=0.001)
    path = bag(
        tmp_path, joint_states=states(log, efforts=empty), position_controller__commands=told
    )
    read = read_log(path, joints=JOINTS)
    assert np.isnan(read.command[0]).all()  # as no command was there yet
    assert np.abs(read.command - motion(read.time - 0.001))[1:].max() < 1e-4
    assert np.array_equal(read.position, log.position[: len(read)])
    assert np.isnan(read.effort).all()
    assert f"read from /joint_states (sensor_msgs/msg/JointState), {TOLD}" in said(read)
    assert "joined by time at 200 Hz, the rate of /joint_states" in said(read)
    assert f"{TOLD}/data[0] of elbow, {TOLD}/data[1] of shoulder" in said(read)
    assert f"messages of {TOLD} have no stamps" in said(read)


def test_receipt_is_put_on_the_clock_of_a_simulation(tmp_path, log):
    """Of half the speed, which began at 3 s."""
    stamped = states(log, stamp=lambda ns: 3_000_000_000 + (ns - EPOCH) // 2)
    read = read_log(bag(tmp_path, joint_states=stamped, arm__commands=numbers(log)), joints=JOINTS)
    assert read.time[-1] == pytest.approx(0.5 * log.time[-1])
    assert np.abs(read.command - motion(2.0 * read.time)).max() < 1e-4


def test_commands_as_joint_states_by_the_name_of_their_topic(tmp_path, log):
    told = states(replace(log, position=log.command))
    read = read_log(bag(tmp_path, joint_states=states(log), joint_command=told), joints=JOINTS)
    assert np.array_equal(read.command, log.command)


def test_commands_as_trajectories_of_a_point_hold_in_pauses(tmp_path, log):
    types, store = ros2_store().types, ros2_store()
    point, none = types["trajectory_msgs/msg/JointTrajectoryPoint"], np.zeros(0)
    soon = types["builtin_interfaces/msg/Duration"](0, 0)
    told = [
        (
            ns,
            types["trajectory_msgs/msg/JointTrajectory"](
                ros2_header(store)(0), list(JOINTS), [point(data.data, none, none, none, soon)]
            ),
        )
        for ns, data in numbers(log)
    ]
    told = [each for k, each in enumerate(told) if not 100 < k < 160]
    path = bag(tmp_path, joint_states=states(log), arm__joint_trajectory=told)
    read = read_log(path, joints=JOINTS)
    expected = log.command.copy()
    expected[101:160] = expected[100]
    assert np.allclose(read.command, expected, atol=1e-6)


def test_efforts_of_a_topic_at_their_own_instants(tmp_path, log):
    """Fewer of them, and none for a while."""
    rows = [k for k in range(0, 300, 2) if not 100 < k < 160]
    nothing = np.full((len(rows), 2), np.nan)
    some = JointLog("some", JOINTS, log.time[rows], nothing, log.effort[rows])
    heard = states(some, efforts=some.effort)
    read = read_log(bag(tmp_path, joint_states=states(log), joint_efforts=heard), joints=JOINTS)
    assert np.allclose(read.time, some.time) and np.array_equal(read.effort, some.effort)
    assert np.allclose(read.position, log.position[rows])
    assert "at 100 Hz, the rate of /joint_efforts" in said(read)


def test_currents_of_interfaces(tmp_path, log):
    """DynamicJointState of ros2_control, which has all of it."""
    from rosbags.typesys import get_types_from_msg

    store = ros2_store()
    text = "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values\n"
    values = "string[] interface_names\nfloat64[] values\n"
    store.register(get_types_from_msg(values, "control_msgs/msg/InterfaceValue"))
    store.register(get_types_from_msg(text, "control_msgs/msg/DynamicJointState"))
    one, state = (
        store.types[f"control_msgs/msg/{n}"] for n in ("InterfaceValue", "DynamicJointState")
    )
    names = ["position", "velocity", "current"]
    told = [
        (
            ns,
            state(
                message.header,
                list(JOINTS),
                [one(names, np.array([q, np.nan, i])) for q, i in zip(p, c, strict=True)],
            ),
        )
        for (ns, message), p, c in zip(states(log), log.position, log.effort, strict=True)
    ]
    for storage in ("MCAP", "SQLITE3"):
        topics = {"/joint_states": states(log), "/dynamic_joint_states": told}
        path = write_rosbag2(tmp_path / storage, topics, store, storage=storage)
        read = read_log(path, joints=JOINTS)
        assert np.array_equal(read.effort, log.effort)
        assert set(read.effort_kinds.values()) == {"current"}


def test_topics_are_named_where_several_fit(tmp_path, log):
    both = numbers(log, values=2.0 * log.command)
    path = bag(
        tmp_path, joint_states=states(log), left__commands=numbers(log), right__commands=both
    )
    expected = r"/joint_states .* with position.*/left/commands .* with command\), /right/commands"
    with pytest.raises(LogError, match=expected) as refused:
        read_log(path)
    assert "--topic /joint_states --topic /left/commands" in str(refused.value)
    for name, factor in (("left", 1.0), ("right", 2.0)):
        topics = ("/joint_states", f"/{name}/commands")
        read = read_log(path, joints=JOINTS, reading=Reading(topic=topics))
        assert np.allclose(read.command, factor * log.command, atol=1e-6)
    with pytest.raises(LogError, match=r"/left/commands .*2 joints with command.* lacks"):
        read_log(path, reading=Reading(topic="/left/commands"))


def test_commands_beside_efforts_are_asked_for(tmp_path, log):
    measured = states(log, efforts=log.effort)
    path = bag(tmp_path, joint_states=measured, arm__commands=numbers(log))
    assert read_log(path).command is None
    read = read_log(path, reading=Reading(topic=["joint_states", "arm/commands"]))
    assert np.array_equal(read.effort, log.effort)
    assert np.allclose(read.command, log.command, atol=1e-6)


def test_topics_that_do_not_go_together(tmp_path, log):
    types = ros2_store().types
    hello = [(EPOCH + k, types["std_msgs/msg/String"]("hello")) for k in range(20)]
    path = bag(
        tmp_path,
        joint_states=states(log),
        chatter=hello,
        arm__commands=numbers(log, every=25),
        other__commands=numbers(log, late=100.0),
    )
    for name, words in (
        ("chatter", "Topic /chatter .* has no joints"),
        ("arm/commands", "very different rates: /joint_states 200 Hz, /arm/commands 8 Hz"),
        ("other/commands", "do not overlap in time"),
        ("none", "no topic 'none'"),
    ):
        with pytest.raises(LogError, match=words):
            read_log(path, reading=Reading(topic=("joint_states", name)))


def test_bags_of_ros_1_too(tmp_path, log):
    store, header = ros1_store()
    measured = replace(log, velocity=np.zeros(log.position.shape))
    topics = {
        "/joint_states": joint_states(store, measured, header, efforts=False),
        TOLD: numbers(log),
    }
    read = read_log(write_rosbag1(tmp_path / "log.bag", topics, store), joints=JOINTS)
    assert np.allclose(read.command, log.command, atol=1e-6)


def test_messages_of_something_else_do_no_harm(tmp_path, log):
    """As of a type whose `positions` are words."""
    from rosbags.typesys import get_types_from_msg

    store, kind = ros2_store(), "plans/msg/Plan"
    store.register(get_types_from_msg("string[] positions\nfloat64 torque_share\n", kind))
    plans = [(EPOCH + k, store.types[kind](["home", "away"], 0.5)) for k in range(20)]
    path = bag(tmp_path, store, joint_states=states(log), plans=plans, arm__commands=numbers(log))
    assert np.allclose(read_log(path, joints=JOINTS).command, log.command, atol=1e-6)
