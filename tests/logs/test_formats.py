"""Logs that other libraries write, and bags whose topics are joined."""

import sqlite3
from dataclasses import replace

import foreign_logs
import numpy as np
import pandas
import polars
import pyarrow
import pytest
from foreign_logs import (
    EPOCH,
    FORMATS,
    QUANTITIES,
    joint_states,
    lerobot,
    ros2_header,
    ros2_store,
    write_rosbag2,
)

from geodrake.errors import ArgumentError, LogError
from geodrake.logs import JointLog, Reading, log_of_frame, read_log

JOINTS = ("shoulder", "elbow")


@pytest.fixture(scope="module")
def log():
    time = 0.01 * np.arange(450)
    q = np.column_stack([np.sin(1.9 * time), np.cos(3.1 * time) + 0.3 * np.sin(0.7 * time)])
    noise = 0.05 * np.random.default_rng(1).standard_normal(q.shape)
    effort = 8.0 * np.sin(q) + np.sign(np.gradient(q, axis=0)) + noise
    return JointLog("log", JOINTS, time, q, effort, np.gradient(q, time, axis=0))


@pytest.mark.parametrize("write", FORMATS, ids=lambda write: write.__name__)
def test_every_format_keeps_every_number(tmp_path, log, write):
    read = read_log(write(tmp_path, log), joints=JOINTS)
    assert read.joints == JOINTS
    for quantity in ("time", *QUANTITIES):
        assert np.allclose(getattr(read, quantity), getattr(log, quantity), rtol=0, atol=1e-8)


def test_messages_with_states_of_motors(tmp_path, log):
    """Messages of a robot have room for more motors; the first temperature of each is read."""
    spare = foreign_logs.motor_states(tmp_path, log, spare=3)
    read = read_log(spare, joints=JOINTS)
    assert np.allclose(read.position, log.position, atol=1e-6)
    assert np.allclose(read.effort, log.effort, atol=1e-6)
    assert "so without a motor: position[2] …" in " ".join(read.notes)
    heat = 30.0 + np.arange(len(log)) // 100
    assert np.array_equal(read.temperature, np.column_stack([heat, heat + 1.0]))


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_episodes_of_a_dataset_are_one_log_with_gaps_or_one_of_them(tmp_path, log, version):
    path = lerobot(tmp_path, log, version=version, episodes=3)
    every = read_log(path, joints=JOINTS)
    assert len(every) == len(log)
    assert np.allclose(every.effort, log.effort, atol=1e-5)
    assert np.flatnonzero(np.diff(every.time) > 0.5).tolist() == [149, 299]
    assert "3 episodes" in every.notes[0]
    second = read_log(path, reading=Reading(episode=1))
    assert second.joints == JOINTS
    assert np.allclose(second.position, log.position[150:300], atol=1e-6)
    assert np.allclose(second.time, log.time[:150], atol=1e-5)
    with pytest.raises(LogError, match="no samples of episode 3"):
        read_log(path, reading=Reading(episode=3))
    with pytest.raises(ArgumentError, match="episode"):
        read_log(path, reading=Reading(episode=-1))


def test_dataset_without_efforts(tmp_path, log):
    with pytest.raises(LogError, match="both position and effort; positions: shoulder, elbow"):
        read_log(lerobot(tmp_path, log, efforts=False, actions=False))


def test_torques_of_an_iiwa_have_the_sign_of_drakes_plant(tmp_path):
    """Messages and actuation are of Drake's own driver and plant."""
    statuses, actuation = foreign_logs.simulated_iiwa()
    read = read_log(iiwa_log(tmp_path / "iiwa.lcm", statuses, "IIWA_STATUS"))
    assert np.allclose(read.effort[-1], actuation)
    assert "have the opposite sign" in " ".join(read.notes)
    channels = ("LEFT_STATUS", "RIGHT_STATUS")
    path = iiwa_log(tmp_path / "arms.lcm", statuses, *channels)
    one = read_log(path, reading=Reading(topic="LEFT_STATUS"))
    assert np.array_equal(one.effort, read.effort)
    joints = [f"{arm}_{k}" for arm in ("left", "right") for k in range(len(one.joints))]
    both = read_log(path, joints=joints, reading=Reading(topic=channels))
    np.testing.assert_allclose(both.effort, np.hstack([one.effort] * 2))


def iiwa_log(path, statuses, *channels):
    lcm = pytest.importorskip("lcm")
    events = lcm.EventLog(str(path), "w")
    for k, status in enumerate(statuses):
        for channel in channels:
            events.write_event(5000 * k, channel, status)
    events.close()
    return path


def frames(log):
    columns = foreign_logs.named_columns(log)
    indexed = pandas.DataFrame(columns, index=pandas.to_timedelta(log.time, unit="s"))
    kinds = [(name, float) for name in columns]
    arrays = {name: getattr(log, name) for name in ("time", *QUANTITIES)}
    return {
        "pandas": pandas.DataFrame(columns),
        "pandas, time as index": indexed.drop(columns="time"),
        "pandas, nullable": pandas.DataFrame(columns).convert_dtypes(),
        "polars": polars.DataFrame(columns),
        "polars, lists": polars.DataFrame({name: x.tolist() for name, x in arrays.items()}),
        "arrow": pyarrow.table(columns),
        "records": np.array([*zip(*columns.values(), strict=True)], dtype=kinds),
        "arrays": arrays,
        "a CSV's arrays": columns,
    }


def test_frames_of_any_library_are_logs(log):
    for kind, frame in frames(log).items():
        read = log_of_frame(frame, joints=JOINTS)
        for quantity in ("time", *QUANTITIES):
            values = getattr(read, quantity), getattr(log, quantity)
            assert np.allclose(*values, rtol=0, atol=1e-9), kind
    again = log_of_frame(log.to_dataframe())
    assert again.fingerprint == log.fingerprint
    assert list(log.to_dataframe()) == [*foreign_logs.named_columns(log)]


def test_dates_of_frames_are_time(tmp_path, log):
    frame = log.to_dataframe().rename(columns={"time": "timestamp"})
    since = pandas.to_timedelta(np.round(1e9 * log.time), unit="ns")
    aware = pandas.Timestamp("2026-05-01T12:00:00+02:00") + since
    naive = aware.tz_convert(None)
    path = tmp_path / "log.parquet"
    frame.assign(timestamp=aware).to_parquet(path)
    dated = [frame.assign(timestamp=each) for each in (aware, naive, aware.astype(str))]
    logs = [*map(log_of_frame, dated), log_of_frame(dated[0].set_index("timestamp"))]
    for read in [*logs, read_log(path)]:
        assert np.allclose(read.time, log.time - log.time[0], rtol=0, atol=1e-9)
        assert any("2026-05-01 10:00:00 UTC" in note for note in read.notes)


def test_frames_with_a_column_twice_or_of_text(log):
    frame = log.to_dataframe()
    twice = frame[[*frame, "elbow.effort"]]
    for wrong, words in (
        (twice, "duplicate columns: elbow.effort"),
        (frame.assign(time="soon"), r"'time'.*has 'soon'.*neither a number nor a date"),
        (frame.assign(**{"elbow.effort": "much"}), r"'elbow.effort'.*has 'much'"),
        ({**frame, "time": frame["time"][:5]}, r"'time'.*has 5 rows, but others have 450"),
    ):
        with pytest.raises(LogError, match=words):
            log_of_frame(wrong, name="frame")


@pytest.mark.parametrize("frame", [3, "text", [1, 2], None])
def test_objects_that_are_no_frames(frame):
    with pytest.raises(ArgumentError, match="named columns"):
        log_of_frame(frame)


def test_order_of_joints_may_change(tmp_path, log):
    told = states(log, order=lambda k: (0, 1) if k % 3 else (1, 0))
    read = read_log(bag(tmp_path, joint_states=told), joints=JOINTS)
    assert np.array_equal(read.position, log.position)
    assert np.array_equal(read.effort, log.effort)
    assert "order of joints in" in said(read)


@pytest.mark.parametrize("which", ["", "some "])
def test_receive_times_where_stamps_are_missing(tmp_path, log, which):
    def stamp(ns):
        return ns - 7_000_000 if which and ns % 3 else 0

    read = read_log(bag(tmp_path, joint_states=states(log, stamp=stamp)))
    assert np.allclose(read.time, log.time, atol=1e-9)
    words = f"{which}messages of /joint_states have no stamps, so the time of receipt is used"
    assert words in said(read)


def one_joint(log, joint, rows=slice(None), later=0.0):
    picked = log.select([joint])
    parts = {quantity: getattr(picked, quantity)[rows] for quantity in QUANTITIES}
    return replace(picked, time=picked.time[rows] + later, **parts)


def bag_of_parts(folder, log, parts):
    """Write the messages of several logs, in the order of their times, to one topic."""
    messages = []
    for part in parts:
        shift = round(1e9 * (part.time[0] - log.time[0]))
        shifted = states(part, stamp=lambda ns, by=shift: ns + by)
        messages += [(ns + shift, message) for ns, message in shifted]
    return bag(folder, joint_states=sorted(messages, key=lambda item: item[0]))


def test_messages_of_some_joints_each_are_put_together(tmp_path, log):
    at_once = bag_of_parts(tmp_path, log, [one_joint(log, joint) for joint in JOINTS])
    read = read_log(at_once, joints=JOINTS)
    assert np.array_equal(read.effort, log.effort)
    (tmp_path / "later").mkdir()
    later = one_joint(log, "elbow", later=0.004)
    apart = bag_of_parts(tmp_path / "later", log, [one_joint(log, "shoulder"), later])
    read = read_log(apart, joints=JOINTS)
    exact = np.cos(3.1 * (read.time - 0.004)) + 0.3 * np.sin(0.7 * (read.time - 0.004))
    assert np.abs(read.position[:, 1] - exact)[1:].max() < 2e-4  # the first one is unknown
    assert np.isfinite(read.effort)[1:].all()
    assert "joined by time at 100 Hz, the rate of shoulder" in " ".join(read.notes)


def test_rarely_published_joints_are_omitted_unless_needed(tmp_path, log):
    parts = [one_joint(log, "shoulder"), one_joint(log, "elbow", slice(None, None, 20))]
    path = bag_of_parts(tmp_path, log, parts)
    slow = "elbow has 5 Hz, but other columns up to 100 Hz: elbow."
    for joints, words in ((None, slow), (["shoulder"], "no such joints: elbow.position")):
        read = read_log(path, joints=joints)
        assert read.joints == ("shoulder",)
        assert np.array_equal(read.effort[:, 0], log.effort[:, 0])
        assert words in " ".join(read.notes)
    with pytest.raises(LogError, match=r"elbow.position.* too slow: 5 Hz.*--lock"):
        read_log(path, joints=JOINTS)


def test_several_topics_are_named_and_chosen(tmp_path, log):
    other = replace(log, effort=2 * log.effort)
    path = bag(
        tmp_path,
        left__joint_states=states(log),
        right__joint_states=states(other),
        gripper__joint_states=states(log, efforts=False),
        joint_commands=states(log),
    )
    with pytest.raises(LogError, match=r"2 topics.* /left/joint_states .*--topic /left"):
        read_log(path)
    for topic, each in (("right/joint_states", other), ("/joint_commands", log)):
        assert np.array_equal(read_log(path, reading=Reading(topic=topic)).effort, each.effort)
    for topic, words in (
        ("/gripper/joint_states", r"/gripper/joint_states .*joints with position, velocity\)"),
        ("/left/states", r"no topic '/left/states'; .*Did you mean /left/joint_states"),
    ):
        with pytest.raises(LogError, match=words):
            read_log(path, reading=Reading(topic=topic))


def test_bag_whose_recorder_was_killed_has_no_metadata(tmp_path, log):
    path = foreign_logs.rosbag2_sqlite3(tmp_path, log)
    (path / "metadata.yaml").unlink()
    assert len(read_log(path)) == len(log)


def without_definitions(path):
    """Take the definitions of types out of a bag, as rosbag2 wrote none until ROS 2 Humble."""
    (file,) = path.glob("*.db3")
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM message_definitions")
    database.close()
    return path


def test_bags_without_definitions_of_their_types(tmp_path, log):
    states = without_definitions(foreign_logs.rosbag2_sqlite3(tmp_path, log))
    assert np.array_equal(read_log(states).effort, log.effort)
    for points in (("desired", "actual", "error"), foreign_logs.HUMBLE_POINTS):
        folder = tmp_path / str(len(points))
        folder.mkdir()
        path = foreign_logs.controller_state(folder, log, points=points, storage="SQLITE3")
        assert np.array_equal(read_log(without_definitions(path)).effort, log.effort)


def test_efforts_of_a_controller_are_its_output_if_none_are_measured(tmp_path, log):
    points = ("reference", "feedback", "error", "output")
    path = foreign_logs.controller_state(tmp_path, log, points=points, effort_at="output")
    read = read_log(path, joints=JOINTS)
    assert np.array_equal(read.effort, log.effort)
    assert "the controller's output is used" in said(read)


@pytest.mark.parametrize("points", [("reference", "feedback"), ("desired", "actual", "error")])
def test_controller_commands_replace_unmeasured_efforts(tmp_path, log, points):
    told = replace(log, command=log.position + 0.01 * log.effort)
    read = read_log(foreign_logs.controller_state(tmp_path, told, points=points), joints=JOINTS)
    assert np.array_equal(read.command, told.command)
    assert np.array_equal(read.position, log.position)
    assert np.isnan(read.effort).all()
    assert "their servo commands are used" in " ".join(read.notes)


def test_positions_currents_and_commands_in_three_files(tmp_path, log):
    for name, values, header in (
        ("positions", log.position, "t,q1,q2"),
        ("commands", log.position + 0.1, "t,q1,q2"),
        ("currents", log.effort, "t,1,2"),
    ):
        rows, path = np.column_stack([log.time, values]), tmp_path / f"{name}.csv"
        np.savetxt(path, rows, delimiter=",", header=header, comments="")
    read = read_log(f"{tmp_path}/positions.csv+{tmp_path}/commands.csv", joints=JOINTS)
    assert np.allclose(read.command, log.position + 0.1)
    read = read_log(f"{tmp_path}/positions.csv+{tmp_path}/currents.csv", joints=JOINTS)
    assert set(read.effort_kinds.values()) == {"current"}
    assert np.allclose(read.effort, log.effort)
    three = "+".join(f"{tmp_path}/{name}.csv" for name in ("positions", "commands", "currents"))
    slow = np.loadtxt(tmp_path / "commands.csv", delimiter=",", skiprows=1)[::2]
    np.savetxt(tmp_path / "commands.csv", slow, delimiter=",", header="t,q1,q2", comments="")
    read = read_log(three, joints=JOINTS)
    assert len(read) == len(log) and np.allclose(read.effort, log.effort)
    read = read_log(three, joints=JOINTS, reading=Reading(kinds={"": "command"}))
    assert np.allclose(read.command, slow[:, 1:])


TOLD = "/position_controller/commands"


@pytest.fixture(scope="module")
def sent():
    """Return a log of positions that follow their commands, without efforts."""
    time = 0.005 * np.arange(300)
    q, efforts = motion(time - 0.01), 8.0 * motion(time)
    return JointLog("log", JOINTS, time, q, efforts, command=motion(time))


def motion(time):
    return np.column_stack([np.sin(1.9 * time), 0.4 + np.cos(3.1 * time)])


def test_positions_and_efforts_without_names_are_joined(tmp_path, sent):
    topics = {"joint_positions": sent.position, "joint_torques": sent.effort}
    told = {name: numbers(sent, values=values) for name, values in topics.items()}
    read = read_log(bag(tmp_path, **told), joints=JOINTS)
    assert np.allclose(read.position, sent.position) and np.allclose(read.effort, sent.effort)


def numbers(log, order=(0, 1), *, late=0.0, every=1, values=None):
    """Return Float64MultiArrays, which have neither stamps nor names."""
    types = ros2_store().types
    layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    Numbers = types["std_msgs/msg/Float64MultiArray"]
    values = log.command if values is None else values
    stamps = (EPOCH + np.rint(1e9 * (log.time + late))).astype(int).tolist()
    return [(stamps[k], Numbers(layout, values[k, list(order)])) for k in range(0, len(log), every)]


def bag(folder, store=None, storage="MCAP", **topics):
    """Write a rosbag2 of messages by the names of their topics, in which `__` is a slash."""
    topics = {f"/{name.replace('__', '/')}": messages for name, messages in topics.items()}
    return write_rosbag2(folder / f"bag_{storage}", topics, store, storage=storage)


def states(log, *, stamp=lambda ns: ns, efforts=None, **more):
    """Return JointStates; those of a log of commands have no efforts unless they are asked for."""
    header = ros2_header(ros2_store())
    how = {"efforts": log.command is None if efforts is None else efforts, **more}
    return list(joint_states(ros2_store(), log, lambda ns: header(stamp(ns)), **how))


def said(log):
    return " ".join(log.notes)


def test_commands_of_a_controller_without_names_or_stamps(tmp_path, sent):
    """They are in another order than the model's; positions that follow tell the joint."""
    told = numbers(sent, (1, 0), late=0.001)
    empty = replace(sent, effort=np.full(sent.position.shape, np.nan))
    path = bag(
        tmp_path, joint_states=states(empty, efforts=True), position_controller__commands=told
    )
    read = read_log(path, joints=JOINTS)
    assert np.isnan(read.command[0]).all()  # before the first command
    assert np.abs(read.command - motion(read.time - 0.001))[1:].max() < 1e-4
    assert np.array_equal(read.position, sent.position[: len(read)])
    assert np.isnan(read.effort).all()
    assert f"read from /joint_states (sensor_msgs/msg/JointState), {TOLD}" in said(read)
    assert "joined by time at 200 Hz, the rate of /joint_states" in said(read)
    assert f"{TOLD}/data[0] of elbow, {TOLD}/data[1] of shoulder" in said(read)
    assert f"messages of {TOLD} have no stamps" in said(read)


def test_times_of_receipt_are_converted_to_a_simulation_clock(tmp_path, sent):
    """Its clock has half the speed, and began at 3 s."""
    stamped = states(sent, stamp=lambda ns: 3_000_000_000 + (ns - EPOCH) // 2)
    read = read_log(bag(tmp_path, joint_states=stamped, arm__commands=numbers(sent)), joints=JOINTS)
    assert read.time[-1] == pytest.approx(0.5 * sent.time[-1])
    assert np.abs(read.command - motion(2.0 * read.time)).max() < 1e-4


def test_commands_as_joint_states_by_the_name_of_their_topic(tmp_path, sent):
    told = states(replace(sent, position=sent.command))
    read = read_log(bag(tmp_path, joint_states=states(sent), joint_command=told), joints=JOINTS)
    assert np.array_equal(read.command, sent.command)


def test_commands_as_trajectories_of_a_point_hold_in_pauses(tmp_path, sent):
    types, none = ros2_store().types, np.zeros(0)
    Trajectory, Point = (
        types[f"trajectory_msgs/msg/{name}"] for name in ("JointTrajectory", "JointTrajectoryPoint")
    )
    soon = types["builtin_interfaces/msg/Duration"](0, 0)
    header = ros2_header(ros2_store())(0)
    told = [
        (ns, Trajectory(header, list(JOINTS), [Point(data.data, none, none, none, soon)]))
        for k, (ns, data) in enumerate(numbers(sent))
        if not 100 < k < 160
    ]
    path = bag(tmp_path, joint_states=states(sent), arm__joint_trajectory=told)
    read = read_log(path, joints=JOINTS)
    expected = sent.command.copy()
    expected[101:160] = expected[100]
    assert np.allclose(read.command, expected, atol=1e-6)


def test_currents_of_interfaces(tmp_path, sent):
    """DynamicJointState of ros2_control has all interfaces of each joint."""
    kinds = {
        "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
        "control_msgs/msg/DynamicJointState": "std_msgs/Header header\nstring[] joint_names\n"
        "InterfaceValue[] interface_values\n",
    }
    store = ros2_store(*kinds.items())
    Values, State = (store.types[kind] for kind in kinds)
    names, told = ["position", "velocity", "current"], []
    for (ns, message), *each in zip(states(sent), sent.position, sent.effort, strict=True):
        values = [Values(names, np.array([q, np.nan, i])) for q, i in zip(*each, strict=True)]
        told.append((ns, State(message.header, list(JOINTS), values)))
    for storage in ("MCAP", "SQLITE3"):
        path = bag(tmp_path, store, storage, joint_states=states(sent), dynamic_joint_states=told)
        read = read_log(path, joints=JOINTS)
        assert np.array_equal(read.effort, sent.effort)
        assert set(read.effort_kinds.values()) == {"current"}


def test_topics_are_named_where_several_fit(tmp_path, sent):
    both = numbers(sent, values=2.0 * sent.command)
    path = bag(
        tmp_path, joint_states=states(sent), left__commands=numbers(sent), right__commands=both
    )
    expected = r"/joint_states .* with position.*/left/commands .* with command\), /right/commands"
    with pytest.raises(LogError, match=expected) as refused:
        read_log(path)
    assert "--topic /joint_states --topic /left/commands" in str(refused.value)
    for name, factor in (("left", 1.0), ("right", 2.0)):
        topics = ("/joint_states", f"/{name}/commands")
        read = read_log(path, joints=JOINTS, reading=Reading(topic=topics))
        assert np.allclose(read.command, factor * sent.command, atol=1e-6)
    with pytest.raises(LogError, match=r"/left/commands .*2 joints with command.* lacks"):
        read_log(path, reading=Reading(topic="/left/commands"))


def test_topics_that_do_not_go_together(tmp_path, sent):
    types = ros2_store().types
    hello = [(EPOCH + k, types["std_msgs/msg/String"]("hello")) for k in range(20)]
    path = bag(
        tmp_path,
        joint_states=states(sent),
        chatter=hello,
        arm__commands=numbers(sent, every=25),
        other__commands=numbers(sent, late=100.0),
    )
    for name, words in (
        ("chatter", "Topic /chatter .* has no joints"),
        ("arm/commands", "very different rates: /joint_states 200 Hz, /arm/commands 8 Hz"),
        ("other/commands", "do not overlap in time"),
        ("none", "no topic 'none'"),
    ):
        with pytest.raises(LogError, match=words):
            read_log(path, reading=Reading(topic=("joint_states", name)))
