"""Write logs as other libraries do; each function returns the path."""

import json
from functools import cache
from pathlib import Path

import numpy as np

MODELS = Path(__file__).parents[1] / "models"
EPOCH = 1_760_000_000_000_000_000  # ns, when recordings begin
QUANTITIES = ("position", "velocity", "effort")


def nanoseconds(log):
    return [int(stamp) for stamp in np.round(1e9 * (log.time - log.time[0]))]


def joint_states(store, log, header=None, *, efforts=True, order=None):
    """Yield the time and a JointState of each row, with headers by `header(ns)`."""
    JointState = store.types["sensor_msgs/msg/JointState"]
    header, order = header or ros2_header(store), order or (lambda k: range(len(log.joints)))
    speeds = 0.0 * log.position if log.velocity is None else log.velocity
    for k, since in enumerate(nanoseconds(log)):
        places = list(order(k))
        yield (
            since + EPOCH,
            JointState(
                header(since + EPOCH),
                [log.joints[place] for place in places],
                log.position[k, places],
                speeds[k, places],
                log.effort[k, places] if efforts else np.zeros(0),
            ),
        )


@cache
def ros2_store(*definitions):
    """Return the types of ROS 2, with further ones by pairs of name and definition."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in definitions:
        store.register(get_types_from_msg(text, name))
    return store


def ros2_header(store):
    Header, Time = (
        store.types[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    return lambda ns: Header(Time(ns // 10**9, ns % 10**9), "base")


def write_rosbag2(folder, topics, store=None, *, storage="MCAP"):
    """Write a rosbag2 of topics -> (time, message)s with rosbags."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = store or ros2_store()
    with Writer(folder, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        for topic, each in topics.items():
            messages = list(each)
            kind = messages[0][1].__msgtype__ if messages else "sensor_msgs/msg/JointState"
            connection = writer.add_connection(topic, kind, typestore=store)
            for ns, message in messages:
                writer.write(connection, ns, store.serialize_cdr(message, kind))
    return folder


def rosbag2_mcap(folder, log, storage="MCAP"):
    topics = {"/joint_states": joint_states(ros2_store(), log)}
    return write_rosbag2(folder / f"bag_{storage}", topics, storage=storage)


def rosbag2_sqlite3(folder, log):
    return rosbag2_mcap(folder, log, "SQLITE3")


HUMBLE_POINTS = ("reference", "feedback", "error", "output", "desired", "actual")


def controller_state(
    folder, log, *, points=("reference", "feedback"), effort_at=None, storage="MCAP"
):
    """Write states of ros2_control's trajectory controller, of a type that only the bag defines."""
    kind = "control_msgs/msg/JointTrajectoryControllerState"
    text = "std_msgs/Header header\nstring[] joint_names\n"
    text += "".join(f"trajectory_msgs/JointTrajectoryPoint {name}\n" for name in points)
    more = [f"multi_dof_{name}" for name in points] if points == HUMBLE_POINTS else []
    if more:
        text += "string[] multi_dof_joint_names\n"
        text += "".join(f"trajectory_msgs/MultiDOFJointTrajectoryPoint {name}\n" for name in more)
    store = ros2_store((kind, text))
    State, Point, Bodies, Duration = (
        store.types[name]
        for name in (
            kind,
            "trajectory_msgs/msg/JointTrajectoryPoint",
            "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
            "builtin_interfaces/msg/Duration",
        )
    )
    header, none, now = ros2_header(store), np.zeros(0), Duration(0, 0)
    measured = "feedback" if "feedback" in points else "actual"

    def messages():
        for k, since in enumerate(nanoseconds(log)):
            numbers = {name: [none, none, none] for name in points}
            numbers[measured][:2] = log.position[k], log.velocity[k]
            if log.command is None:
                numbers[effort_at or measured][2] = log.effort[k]
            else:
                numbers["reference" if "reference" in points else "desired"][0] = log.command[k]
            state = [Point(q, v, none, effort, now) for q, v, effort in numbers.values()]
            bodies = [[], *(Bodies([], [], [], now) for _ in more)] if more else []
            yield (since + EPOCH, State(header(since + EPOCH), list(log.joints), *state, *bodies))

    topics = {"/arm_controller/state": messages()}
    return write_rosbag2(folder / "controller", topics, store, storage=storage)


def motor_states(folder, log, *, spare=0):
    """Write states of all motors in each message, as robots of Unitree publish them.

    A motor has two temperatures, the first of which rises from 30 °C.
    """
    count = len(log.joints) + spare
    motor = "uint8 mode\nfloat32 q\nfloat32 tau_est\nint16[2] temperature\n"
    kinds = {
        "unitree_go/msg/MotorState": motor,
        "unitree_go/msg/LowState": f"unitree_go/MotorState[{count}] motor_state\nuint32 tick\n",
    }
    store = ros2_store(*kinds.items())
    Motor, State = (store.types[kind] for kind in kinds)

    def messages():
        for k, since in enumerate(nanoseconds(log)):
            both = zip(log.position[k].tolist(), log.effort[k].tolist(), strict=True)
            heat = np.array([30 + k // 100, 90], np.int16)
            motors = [Motor(1, q, effort, heat + n) for n, (q, effort) in enumerate(both)]
            others = [Motor(0, 0.0, 0.0, 0 * heat)] * spare
            yield since + EPOCH, State([*motors, *others], since // 10**6)

    return write_rosbag2(folder / "motors", {"/lowstate": messages()}, store)


def other_messages(folder, log, kind, definitions, make):
    """Write a rosbag2 of messages of a type that only the bag defines."""
    store = ros2_store(*definitions.items())
    header = ros2_header(store)

    def messages():
        for k, since in enumerate(nanoseconds(log)):
            stamp = header(since + EPOCH)
            yield since + EPOCH, make(store.types, stamp, *(x[k] for x in log_arrays(log)))

    return write_rosbag2(folder / kind, {"/arm": messages()}, store)


def log_arrays(log):
    return [getattr(log, quantity) for quantity in QUANTITIES]


def messages_with_names(folder, log):
    """Write the states of all joints with their names, the last joint first."""
    state = "string name\nfloat64 angle\nfloat64 speed\nfloat64 torque\n"
    kinds = {"own_msgs/msg/State": state}
    kinds["own_msgs/msg/Arm"] = "std_msgs/Header header\nown_msgs/State[] joints\n"

    def make(types, stamp, *numbers):
        rows = [*zip(log.joints, *numbers, strict=True)][::-1]
        return types["own_msgs/msg/Arm"](stamp, [types["own_msgs/msg/State"](*row) for row in rows])

    return other_messages(folder, log, "named", kinds, make)


def messages_by_names(folder, log):
    """Write messages with a field of the name of each joint."""
    fields = "".join(f"own_msgs/Part {joint}\n" for joint in log.joints)
    kinds = {"own_msgs/msg/Part": "float64 pos\nfloat64 vel\nfloat64 torque\n"}
    kinds["own_msgs/msg/Whole"] = f"builtin_interfaces/Time stamp\n{fields}"

    def make(types, stamp, *numbers):
        parts = (types["own_msgs/msg/Part"](*row) for row in zip(*numbers, strict=True))
        return types["own_msgs/msg/Whole"](stamp.stamp, *parts)

    return other_messages(folder, log, "by_names", kinds, make)


def json_mcap(folder, log):
    """Write JSON messages as Foxglove's SDK does for a program without ROS."""
    from mcap.writer import Writer

    with (path := folder / "json.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("State", "jsonschema", b"{}")
        channel = writer.register_channel("/state", "json", schema)
        for k, since in enumerate(nanoseconds(log)):
            q, dq, tau = (x[k].tolist() for x in log_arrays(log))
            told = {"names": log.joints, "q": q, "dq": dq, "tau": tau}
            data = json.dumps(told).encode()
            writer.add_message(channel, since + EPOCH, data, since + EPOCH)
        writer.finish()
    return path


def protobuf_mcap(folder, log):
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap_protobuf.writer import Writer

    kind = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="own.proto", package="own", syntax="proto3")
    state, names = file.message_type.add(name="State"), ("name", "position", "velocity", "effort")
    for number, name in enumerate(names, 1):
        own = kind.TYPE_STRING if name == "name" else kind.TYPE_DOUBLE
        state.field.add(name=name, number=number, type=own, label=kind.LABEL_REPEATED)
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    make = message_factory.GetMessageClass(pool.FindMessageTypeByName("own.State"))
    with (path := folder / "own.mcap").open("wb") as stream, Writer(stream) as writer:
        for k, since in enumerate(nanoseconds(log)):
            rows = (log.joints[::-1], *(x[k, ::-1] for x in log_arrays(log)))
            message = make(**dict(zip(names, rows, strict=True)))
            writer.write_message("/state", message, since + EPOCH, since + EPOCH)
    return path


def bare_mcap(folder, log):
    """Write one MCAP file with mcap-ros2-support."""
    from mcap_ros2.writer import Writer

    kind = "sensor_msgs/msg/JointState"
    definition, _ = ros2_store().generate_msgdef(kind, ros_version=2)
    path = folder / "bare.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef(kind, definition)
        for k, since in enumerate(nanoseconds(log)):
            ns = since + EPOCH
            stamp = {"sec": ns // 10**9, "nanosec": ns % 10**9}
            numbers = {quantity: getattr(log, quantity)[k].tolist() for quantity in QUANTITIES}
            message = {"header": {"stamp": stamp, "frame_id": ""}, "name": list(log.joints)}
            writer.write_message("/robot/joint_states", schema, message | numbers, log_time=ns)
        writer.finish()
    return path


def ros1_bag(folder, log):
    """Write a bag of ROS 1."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, kind = get_typestore(Stores.ROS1_NOETIC), "sensor_msgs/msg/JointState"
    Header, Time = (
        store.types[name] for name in ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    path = folder / "noetic.bag"
    with Writer(path) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        header = lambda ns: Header(0, Time(ns // 10**9, ns % 10**9), "")  # noqa: E731
        for ns, message in joint_states(store, log, header):
            writer.write(connection, ns, store.serialize_ros1(message, kind))
    return path


def named_columns(log):
    """Return columns by the names of a CSV, but not by geodrake's own writer."""
    columns = {"time": log.time}
    for quantity in QUANTITIES:
        for k, joint in enumerate(log.joints):
            columns[f"{joint}.{quantity}"] = getattr(log, quantity)[:, k]
    return columns


def arrow_parquet(folder, log):
    """Write lists of numbers."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = {"time": log.time, "mode": ["auto"] * len(log)}
    for quantity in QUANTITIES:
        flat = pa.array(getattr(log, quantity).ravel())
        table[quantity] = pa.FixedSizeListArray.from_arrays(flat, len(log.joints))
    path = folder / "arrow.parquet"
    pq.write_table(pa.table(table), path, compression="zstd")
    return path


def pandas_parquet(folder, log):
    import pandas

    path = folder / "pandas.parquet"
    pandas.DataFrame(named_columns(log)).to_parquet(path)
    return path


def polars_parquet(folder, log):
    import polars

    path = folder / "polars.parquet"
    polars.DataFrame(named_columns(log)).write_parquet(path)
    return path


def polars_feather(folder, log):
    import polars

    path = folder / "polars.feather"
    polars.DataFrame(named_columns(log)).write_ipc(path)
    return path


def blank(kind, joints):
    """Return a status message of LCM, all of whose numbers are zero."""
    status = kind()
    status.num_joints = joints
    for name in status.__slots__:
        if name.startswith("joint_"):
            setattr(status, name, [0.0] * joints)
    return status


def lcm_log(folder, log):
    """Write what lcm-logger records of a KUKA iiwa, whose torques have the opposite sign."""
    import lcm
    from drake import lcmt_iiwa_status, lcmt_robot_state

    path = folder / "lcmlog-2026-05-01.00"
    events = lcm.EventLog(str(path), "w")
    for k, since in enumerate(nanoseconds(log)):
        status = blank(lcmt_iiwa_status, len(log.joints))
        status.utime = (since + EPOCH) // 1000
        status.joint_position_measured = log.position[k].tolist()
        status.joint_velocity_estimated = log.velocity[k].tolist()
        status.joint_torque_measured = (-log.effort[k]).tolist()
        events.write_event(status.utime + 300, "IIWA_STATUS", status.encode())
        events.write_event(status.utime + 301, "STATE", lcmt_robot_state().encode())
    events.close()
    return path


def simulated_iiwa():
    """Return status messages of Drake's driver of an arm at rest, and the last actuation."""
    from drake import lcmt_iiwa_command
    from pydrake.lcm import DrakeLcm
    from pydrake.manipulation import BuildIiwaControl, IiwaDriver
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    def arm(plant):
        (instance,) = Parser(plant).AddModels(str(MODELS / "arm7.urdf"))
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("link_0"))
        for index in plant.GetJointIndices(instance):
            if (joint := plant.get_joint(index)).num_velocities():
                plant.AddJointActuator(joint.name(), joint)
        plant.Finalize()
        return instance

    builder, lcm, statuses = DiagramBuilder(), DrakeLcm("memq://"), []
    plant, _ = AddMultibodyPlantSceneGraph(builder, 1e-3)
    own = MultibodyPlant(1e-3)
    instance, _ = arm(plant), arm(own)
    BuildIiwaControl(builder, lcm, plant, instance, IiwaDriver(), own)
    lcm.Subscribe("IIWA_STATUS", statuses.append)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    command = lcmt_iiwa_command()
    command.num_joints, command.joint_position = 7, [0.0] * 7
    lcm.Publish("IIWA_COMMAND", command.encode())
    for _ in range(40):
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.005)
        lcm.HandleSubscriptions(0)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    return statuses, plant.get_net_actuation_output_port(instance).Eval(context)


def mat_v7(folder, log):
    from scipy.io import savemat

    path = folder / "scipy.mat"
    data = {name: getattr(log, name) for name in ("time", "position", "velocity", "effort")}
    savemat(path, {"data": {**data, "comment": "shoulder and elbow"}}, do_compression=True)
    return path


def mat_v73(folder, log):
    """Write arrays as MATLAB does: columns first, and a class for each variable."""
    import h5py

    path = folder / "hdf5.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for k, joint in enumerate(log.joints):
            for quantity in QUANTITIES:
                values = getattr(log, quantity)[:, k]
                file[f"{joint}/{quantity}"] = values[None, :]
        file["time"] = log.time[None, :]
        file["who"] = np.frombuffer(b"me", np.uint8).astype(np.uint16)[:, None]
        file["who"].attrs["MATLAB_class"] = np.bytes_("char")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return path


def lerobot(folder, log, *, version="v3.0", episodes=2, efforts=True, actions=True):
    """Write a dataset of equal episodes, in one file or, in version 2, in one each.

    Actions are the log's commands, or its positions if it has none.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = folder / f"lerobot_{version}_{episodes}"
    names = {"motors": [f"{joint}.pos" for joint in log.joints]} if version[1] == "2" else None
    shape = [len(log.joints)]
    feature = {"dtype": "float32", "shape": shape, "names": list(log.joints)}
    features = {"observation.state": {**feature, "names": names or list(log.joints)}}
    if efforts:
        features["observation.effort"] = feature
    features["observation.images.top"] = {"dtype": "video", "shape": [3, 48, 64], "names": None}
    if actions:
        features["action"] = feature
    told = log.position if log.command is None else log.command
    (path / "meta").mkdir(parents=True)
    info = {"codebase_version": version, "total_episodes": episodes, "features": features}
    (path / "meta" / "info.json").write_text(json.dumps(info))
    tables = []
    for k, rows in enumerate(np.array_split(np.arange(len(log)), episodes)):
        columns = {
            "observation.state": list(log.position[rows].astype(np.float32)),
            "action": list(told[rows].astype(np.float32)),
            "timestamp": (log.time[rows] - log.time[rows[0]]).astype(np.float32),
            "episode_index": np.full(len(rows), k),
        }
        if efforts:
            columns["observation.effort"] = list(log.effort[rows].astype(np.float32))
        tables.append(pa.table(columns))
    data = path / "data" / "chunk-000"
    data.mkdir(parents=True)
    if version[1] == "2":
        for k, table in enumerate(tables):
            pq.write_table(table, data / f"episode_{k:06d}.parquet")
    else:
        pq.write_table(pa.concat_tables(tables), data / "file-000.parquet")
    return path


FORMATS = (
    rosbag2_mcap,
    rosbag2_sqlite3,
    controller_state,
    bare_mcap,
    json_mcap,
    protobuf_mcap,
    messages_with_names,
    messages_by_names,
    ros1_bag,
    arrow_parquet,
    pandas_parquet,
    polars_parquet,
    polars_feather,
    lcm_log,
    mat_v7,
    mat_v73,
)
"""Formats that keep every number as it is."""
