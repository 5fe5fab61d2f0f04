"""Logs of a robot on its feet by Pinocchio."""

import re
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pandas
import pytest
import yaml
from foreign_logs import EPOCH, joint_states, nanoseconds, ros2_header, ros2_store, write_rosbag2
from free_robots import FreeRobot, MuJoCoRobot
from meshcat_pages import tracks
from quadruped import FEET, JOINTS, LEGS, joint_text, link_text, quadruped
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.cli.command import unchecked_words
from geodrake.control import roll_out
from geodrake.diagnosis import compare, explain
from geodrake.effects import Role, WrenchOffset
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import LogError
from geodrake.excitation import log_identifiability
from geodrake.identification.logs.candidate_effects import candidate_effects
from geodrake.identification.logs.case import prepare_case
from geodrake.identification.logs.contact_rows import rows_without
from geodrake.identification.logs.noise import known_noise
from geodrake.logs import JointLog, Reading, read_log
from geodrake.logs.files import read_mapping
from geodrake.logs.files.messages import base_sources
from geodrake.logs.floating import ANGLES, ContactFlags
from geodrake.logs.preparation import prepare_logs
from geodrake.model import Given, load_description
from geodrake.model.base_motion import with_base
from geodrake.model.ground_contacts import contact_frames, contact_jacobians, on_soles
from geodrake.model.logged_joints import log_of_model, reading_for
from geodrake.report.meshcat_scene import play_page
from geodrake.report.playback import play_back
from geodrake.robot import inverse_dynamics_regressor
from geodrake.robot.shapes import collision_balls

RATE = 100.0


def waves(time: np.ndarray, sizes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return smooth signals (N, n) of given sizes, their rates and accelerations."""
    found = np.zeros((3, len(time), len(sizes)))
    for frequency in (0.31, 0.73, 1.1):
        w, phase = 2 * np.pi * frequency, rng.uniform(0, 2 * np.pi, len(sizes))
        angle = w * time[:, None] + phase
        found += sizes * np.stack([np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)]) / 2.0
    return found


class Maker:
    """Motion, efforts and forces at the feet of a quadruped that may carry something."""

    def __init__(
        self, payload: float = 0.0, seed: int = 0, place: str = "0.1 0.02 0.1", slope: float = 0.0
    ) -> None:
        rng, text = np.random.default_rng(seed), quadruped()
        if payload:
            load = link_text("load", payload, (0.1, 0.1, 0.1))
            weld = (
                '<joint name="on" type="fixed"><parent link="trunk"/><child link="load"/>'
                f'<origin xyz="{place}"/></joint></robot>'
            )
            text = text.replace("</robot>", load + weld)
        self.time = np.arange(0.0, 9.0, 1 / RATE)
        self.place = waves(self.time, np.array([0.04, 0.03, 0.03]), rng)
        self.place[0, :, 2] += 0.38
        self.angles = waves(self.time, np.array([0.12, 0.15, 0.12]), rng)  # yaw, pitch, roll
        self.joints = waves(self.time, np.full(12, 0.3), rng)
        self.joints[0] += np.tile([0.0, 0.6, -1.2], 4)
        dog = FreeRobot(text, JOINTS)
        dog.model.gravity.linear = 9.81 * np.array([np.sin(slope), 0.0, -np.cos(slope)])
        self._solve(dog)

    def _solve(self, dog: FreeRobot) -> None:
        h, (angles, rates, accelerations) = 1e-5, self.angles
        self.R = Rotation.from_euler("ZYX", angles)
        ways = (angles + s * h * rates + 0.5 * h * h * accelerations for s in (-1, 1))
        steps = (Rotation.from_euler("ZYX", way) for way in ways)
        back, ahead = ((self.R.inv() * step).as_rotvec() for step in steps)
        self.gyro = (ahead - back) / (2 * h)  # in the body
        self.imu = self.R.inv().apply(self.place[2] + [0, 0, 9.81])
        self.effort, count = np.zeros((len(self.time), 12)), len(self.time)
        self.forces, self.world_forces = np.zeros((2, count, 4, 3))
        self.carried = np.zeros((count, 6))  # moment and force about the origin
        motion = np.concatenate([self.place, self.angles, self.joints], axis=2)
        for k in range(count):
            needed = dog.efforts(*motion[:, k])
            self.carried[k] = dog.wrench()
            J = np.vstack([dog.jacobian(foot)[:3] for foot in FEET])
            w = np.linalg.lstsq(J[:, :6].T, needed[:6], rcond=None)[0]
            self.effort[k] = (needed - J.T @ w)[6:]
            self.world_forces[k] = w.reshape(4, 3)
            for at, foot in enumerate(FEET):
                self.forces[k, at] = dog.pose(foot)[0].T @ self.world_forces[k, at]

    def log(self, *, wrenches: bool, noise: float = 0.0, seed: int = 1, **changes) -> JointLog:
        rng, columns = np.random.default_rng(seed), {}

        def put(name, values, axes="xyz", size=0.0):
            for axis, column in zip(axes, np.asarray(values).T, strict=True):
                columns[f"{name}.{axis}"] = column + size * rng.normal(size=len(column))

        put("base.position", self.place[0])
        put("base.orientation", np.roll(self.R.as_quat(), 1, axis=1), "wxyz")
        put("imu.angular_velocity", self.gyro)
        put("imu.linear_acceleration", self.imu, size=0.02 * noise)
        for at, foot in enumerate(FEET):
            columns[f"{foot}.contact"] = np.ones(len(self.time))
            if wrenches:
                put(f"{foot}.force", self.forces[:, at], size=0.1 * noise)
        effort = self.effort + 0.05 * noise * rng.normal(size=self.effort.shape)
        columns |= changes
        return JointLog("log", JOINTS, self.time, self.joints[0], effort, floating=columns)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.urdf"
    path.write_text(quadruped(), encoding="utf-8")
    return load_description(path, floating=True)


@pytest.fixture(scope="module")
def maker():
    return Maker()


@pytest.fixture(scope="module")
def heavy():
    return Maker(payload=0.9)


def test_pose_and_imu_are_the_joints_of_the_base(model, maker):
    log = with_base(maker.log(wrenches=False), model)
    at = [log.joints.index(joint) for joint in model.base_joints]
    expected = [np.hstack([maker.place[k], maker.angles[k]]) for k in (0, 2)]
    np.testing.assert_allclose(log.position[:, at], expected[0], atol=1e-9)
    inner = slice(5, -5)
    np.testing.assert_allclose(log.acceleration[inner, at], expected[1][inner], atol=2e-3)
    assert log.measured == model.base_joints


def _lifted(trajectory, share, steps=1):
    """Return a trajectory whose feet are in the air in the first share of each of its steps."""
    time = trajectory.segments[0][:].time
    on_ground = np.linspace(0.0, steps, len(time), endpoint=False) % 1.0 >= share
    flags = np.repeat(on_ground[:, None], len(FEET), axis=1)
    return replace(trajectory, contacts=ContactFlags(FEET, time, flags))


@pytest.mark.parametrize("steps", [1, 20])
def test_noise_of_limbs_is_that_of_the_time_in_the_air(model, maker, steps):
    log = log_of_model(maker.log(wrenches=True, noise=1.0), model)
    trajectory = prepare_logs([log])[0]
    wrong = replace(model, phi=3.0 * model.phi)  # what it leaves jumps where feet touch and lift
    parts = (_lifted(trajectory, share, steps) for share in (1.0, 0.4))
    whole, part = (known_noise([each], wrong)[0] for each in parts)
    np.testing.assert_allclose(part[-12:], whole[-12:], rtol=0.3)


@pytest.mark.parametrize("wrenches", [True, False])
def test_the_model_needs_what_was_measured(model, maker, wrenches):
    errors = compare(model, maker.log(wrenches=wrenches)).errors
    assert errors.nrms < 2e-3
    rows = model.joints if wrenches else model.base_joints  # as no foot is ever in the air
    assert {error.joint for error in errors.joints} == set(rows)


BALL = (0.01, 0.0, -0.01), 0.04  # its center in a foot's frame, and radius
SDF = """<sdf version="1.9"><model name="dog"><link name="a"><collision name="c">
<pose>.01 0 -.01 0 0 0</pose><geometry><sphere><radius>.04</radius></sphere></geometry></collision>
<collision name="d"><geometry><box><size>.1 .1 .1</size></box></geometry></collision></link></model>
</sdf>"""
MJCF = """<mujoco model="dog"><worldbody><body name="a"><freejoint/><geom size=".05" mass="1"
contype="0" conaffinity="0"/><geom pos=".01 0 -.01" size=".04"/><geom type="capsule" size=".1 .1"/>
</body></worldbody></mujoco>"""
TWO = SDF.replace("box", "sphere").replace("<size>.1 .1 .1</size>", "<radius>.1</radius>")


@pytest.mark.parametrize(
    ("name", "text", "link"),
    [
        ("r.urdf", quadruped(ball=0.04), "fl_foot"),
        ("r.sdf", SDF, "a"),
        ("r.xml", MJCF, "a"),
        ("two.sdf", TWO, ""),
    ],
)
def test_balls_are_those_of_the_file(tmp_path, name, text, link):
    """Those of pictures, other shapes, and links with several balls do not count."""
    (tmp_path / name).write_text(text)
    balls = collision_balls(tmp_path / name, Given())
    found = {scope.rpartition("::")[2]: ball for scope, ball in balls.items()}
    assert bool(found) == bool(link)
    if link:
        np.testing.assert_allclose(np.hstack(found[link]), np.hstack(BALL))


@pytest.mark.parametrize("unmeasured", [(), ("fl_pitch", "hr_knee")], ids=["all", "some"])
@pytest.mark.parametrize(("feet", "axes"), [(FEET, 3), (FEET[:2], 6)], ids=["points", "soles"])
@pytest.mark.parametrize("engine", [FreeRobot, MuJoCoRobot])
def test_rows_without_contact_forces_are_those_of_others(model, engine, feet, axes, unmeasured):
    """N (Y φ) = N (τ + Jᵀ w) for any forces, and moments at soles, of the feet that touch.

    What motors do of which nobody measured it is not in them.
    """
    assert model.joints == (*model.base_joints, *JOINTS)
    dog, rng = engine(model.path.read_text(), JOINTS), np.random.default_rng(3)
    q, v, a = rng.uniform(-0.7, 0.7, (3, 20, 18))
    bodies = RobotBodies(model.tree, model.positions(q), model.total_phi)
    frames = contact_frames(model, feet)
    touching = ContactFlags(feet, np.arange(20) / RATE, rng.random((20, len(feet))) < 0.6)
    sole = axes == 6
    assert on_soles(touching, frames) == sole
    J = contact_jacobians(frames, bodies, soles=sole)
    scales = rng.uniform(0.5, 2.0, 18)
    measured = ~np.isin(model.joints, unmeasured)
    rows = rows_without(J, touching.flags, scales, range(6), measured=measured)
    N = np.stack([rows.efforts(np.tile(unit, (20, 1))) for unit in np.eye(18)], 2)
    Y = inverse_dynamics_regressor(model.tree, model.positions(q), v, a)
    for k, flags in enumerate(touching.flags):
        needed = dog.efforts(q[k], v[k], a[k])
        jacobians = np.stack([dog.jacobian(foot)[:axes] for foot in feet])
        forces = 50.0 * rng.normal(size=(len(feet), axes)) * flags[:, None]
        effort = needed - np.einsum("fan,fa->n", jacobians, forces)  # zero at a free base
        effort[~measured] = rng.normal()
        np.testing.assert_allclose(
            N[k] @ Y[k] @ model.total_phi.ravel(), N[k] @ effort, rtol=0.0, atol=1e-9
        )
        used = np.abs(N[k]).any(axis=1)
        taken = jacobians[flags].reshape(-1, 18)[:, measured]
        assert used.sum() == measured.sum() - np.linalg.matrix_rank(taken)
        whitened = N[k][used] * scales / scales[used, None]
        np.testing.assert_allclose(whitened @ whitened.T, np.eye(used.sum()), atol=1e-6)


def test_loads_are_put_on_trunks_and_where_limbs_branch(model, tmp_path):
    assert model.load_bodies == ("trunk", *(f"{leg}_calf" for leg in LEGS))
    links = ["base", "arm", "palm", "thumb", "finger"]
    parts = [link_text(name, 1.0, (0.1, 0.1, 0.1)) for name in links]
    for parent, child in (("base", "arm"), ("arm", "palm"), ("palm", "thumb"), ("palm", "finger")):
        parts.append(joint_text(f"to_{child}", parent, child, "0 0 0.1", "0 1 0"))
    (tmp_path / "hand.urdf").write_text(f'<robot name="r">{"".join(parts)}</robot>')
    hand = load_description(tmp_path / "hand.urdf")
    assert set(hand.load_bodies) == {"palm", "thumb", "finger"}


def test_a_payload_on_the_trunk_is_named_without_forces_of_the_ground(model, heavy):
    (step,) = explain(model, heavy.log(wrenches=False, noise=1.0)).steps
    assert (step.effect, step.where) == ("payload", ("trunk",)) and step.probability > 0.9
    values = (step.parameters, step.deviations, step.systematic)
    mass, deviation, systematic = (each["trunk"]["mass"] for each in values)
    assert abs(mass - 0.9) < 2.0 * np.hypot(deviation, systematic) < 0.4


@pytest.mark.thorough
def test_a_payload_at_the_edge_of_a_trunk_is_no_wrong_trunk(model):
    log = Maker(payload=2.6, place="-0.2 -0.1 0.1").log(wrenches=True, noise=1.0)
    (step,) = explain(model, log).steps
    assert (step.effect, step.where) == ("payload", ("trunk",)) and step.probability > 0.9


def test_a_compact_payload_on_a_trunk_keeps_its_mass(model):
    """What is not spread as the limbs are is not taken for something lighter that is."""
    log = Maker(payload=0.7, place="0.02 0.03 0.15").log(wrenches=True, noise=1.0)
    (step,) = explain(model, log).steps
    assert step.parameters["trunk"]["mass"] == pytest.approx(0.7, rel=0.01)


def test_base_rows_alone_tell_a_payload_and_an_offset_of_a_foot_sensor(
    tmp_path, monkeypatch, model, heavy
):
    log, offset = heavy.log(wrenches=True, noise=1.0), np.array([3.0, -2.0, 6.0])
    names = [f"hl_foot.force.{axis}" for axis in "xyz"]
    columns = {name: log.floating[name] + o for name, o in zip(names, offset, strict=True)}
    nothing = np.full_like(log.effort, np.nan)
    log = replace(log, floating=log.floating | columns, effort=nothing)
    case = prepare_case(model, [log], candidates=True)
    assert not {joint for effect in case.dataset.effects for joint in effect.where} & {*JOINTS}
    found = explain(model, log)
    steps = {step.effect: step for step in found.steps}
    assert set(steps) == {"payload", "wrench_offset"}
    assert all(step.probability > 0.9 for step in found.steps)
    (load, foot) = steps["payload"], steps["wrench_offset"]
    assert (load.where, foot.where) == (("trunk",), ("hl_calf",))
    assert load.parameters["trunk"]["mass"] == pytest.approx(0.9, rel=0.1)
    values, deviations = (
        np.array([each["hl_calf"][f"force_{axis}"] for axis in "xyz"])
        for each in (foot.parameters, foot.deviations)
    )
    assert np.all(np.abs(values - offset) < 3.0 * deviations + 0.02 * np.abs(offset))
    assert not any("at rest" in note for note in found.notes)
    known = log_identifiability(model, [log])
    assert len(known.identifiable.variances) > 10 and np.isfinite(known.noise).all()
    with pytest.raises(LogError, match="no efforts of fl_roll"):
        roll_out(model, log)
    columns = {name: x for name, x in log.columns().items() if not name.endswith(".effort")}
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quadruped.urdf").write_text(quadruped(), encoding="utf-8")
    for log, bare, words in (
        ("feet.csv", False, "no efforts of fl_roll"),
        ("neither.csv", True, "neither efforts of joints nor forces at feet"),
    ):
        kept = {n: x for n, x in columns.items() if not (bare and "force" in n)}
        pandas.DataFrame(kept).to_csv(log, index=False)
        said = CliRunner().invoke(app, ["compare", "quadruped.urdf", log, "--floating"])
        assert words in said.output.replace("\n", " ")
        assert said.exit_code == (2 if bare else 0)


def test_force_sensors_of_one_body_have_one_offset(model, maker):
    trajectory = prepare_logs([log_of_model(maker.log(wrenches=True), model)])[0]
    trajectory = replace(trajectory, force_sensors=("hl_calf", "hl_foot", "fr_foot"))
    effects = candidate_effects(model, [trajectory])
    offsets = {e.body: (e.x, e.y, e.z) for e in effects if isinstance(e, WrenchOffset)}
    assert offsets == {"hl_calf": (0.0, 0.0, 0.0), "fr_calf": (0.0, 0.0, -0.2)}


def ros_topics(log, store):
    """Return the topics of a log as a robot publishes them, the IMU with another sign each time."""
    types, header = store.types, ros2_header(store)
    Vector, Quaternion, Point = (
        types[f"geometry_msgs/msg/{name}"] for name in ("Vector3", "Quaternion", "Point")
    )

    def of(name, k, make=Vector, axes="xyz", sign=1.0):
        return make(**{axis: sign * float(log.floating[f"{name}.{axis}"][k]) for axis in axes})

    def at(ns, frame):
        return type(header(ns))(header(ns).stamp, frame)

    def odometry(k, ns):
        Pose, Twist = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/Twist"]
        unsure, zero = np.zeros(36), Vector(0.0, 0.0, 0.0)
        turned = of("base.orientation", k, Quaternion, "xyzw", sign=(-1.0) ** k)
        pose = types["geometry_msgs/msg/PoseWithCovariance"](
            Pose(of("base.position", k, Point), turned), unsure
        )
        twist = types["geometry_msgs/msg/TwistWithCovariance"](Twist(zero, zero), unsure)
        return types["nav_msgs/msg/Odometry"](at(ns, "odom"), "base_link", pose, twist)

    def imu(k, ns):
        none, level = np.zeros(9), Quaternion(0.0, 0.0, 0.0, 1.0)
        measured = (of(f"imu.{name}", k) for name in ("angular_velocity", "linear_acceleration"))
        spin, acceleration = measured
        return types["sensor_msgs/msg/Imu"](
            at(ns, "imu_link"), level, none, spin, none, acceleration, none
        )

    def wrench(foot, k, ns):
        made = types["geometry_msgs/msg/Wrench"](of(f"{foot}.force", k), Vector(0.0, 0.0, 0.0))
        return types["geometry_msgs/msg/WrenchStamped"](at(ns, f"dog/{foot}"), made)

    stamps = [EPOCH + ns for ns in nanoseconds(log)]
    topics = {"/joint_states": joint_states(store, replace(log, velocity=0 * log.position), header)}
    topics |= {f"/{f.__name__}": [(ns, f(k, ns)) for k, ns in enumerate(stamps)] for f in (imu,)}
    topics["/odom"] = [(ns, odometry(k, ns)) for k, ns in enumerate(stamps)]
    for foot in FEET:
        topics[f"/{foot}/wrench"] = [(ns, wrench(foot, k, ns)) for k, ns in enumerate(stamps)]
    return topics


def test_topics_of_a_bag_are_the_columns_of_base_and_feet(tmp_path, model, maker):
    pytest.importorskip("rosbags")
    log, store = maker.log(wrenches=True), ros2_store()
    bag = write_rosbag2(tmp_path / "walk", ros_topics(log, store), store)
    read = read_log(bag, joints=JOINTS, reading=reading_for(model))
    assert any("base and feet are read from /odom, /imu" in note for note in read.notes)
    names = [name for name in log.floating if not name.endswith(".contact")]
    first = np.sign(log.floating["base.orientation.w"][0] * read.floating["base.orientation.w"][0])
    for name in names:
        sign = first if name.startswith("base.orientation") else 1.0
        np.testing.assert_allclose(sign * read.floating[name], log.floating[name], atol=1e-9)
    assert not read_log(bag, joints=JOINTS).floating  # a fixed robot has no base


def transforms(log, store, every):
    """Return messages of tf of the base, some as often as the log has rows."""
    types, header = store.types, ros2_header(store)
    of = {"translation": "base.position", "rotation": "base.orientation"}
    found = []
    for k in range(0, len(log), every):
        ns = EPOCH + nanoseconds(log)[k]
        at = {
            name: {a: float(log.floating[f"{prefix}.{a}"][k]) for a in axes}
            for (name, prefix), axes in zip(of.items(), ("xyz", "xyzw"), strict=True)
        }
        moved = types["geometry_msgs/msg/Transform"](
            types["geometry_msgs/msg/Vector3"](**at["translation"]),
            types["geometry_msgs/msg/Quaternion"](**at["rotation"]),
        )
        world = type(header(ns))(header(ns).stamp, "world")
        stamped = types["geometry_msgs/msg/TransformStamped"](world, "base_link", moved)
        found.append((ns, types["tf2_msgs/msg/TFMessage"]([stamped])))
    return found


def test_slow_transforms_give_the_orientation_beside_a_quick_imu(tmp_path, model, maker):
    pytest.importorskip("rosbags")
    log, store = maker.log(wrenches=True), ros2_store()
    topics = {name: list(messages) for name, messages in ros_topics(log, store).items()}
    del topics["/odom"]
    every = round(0.1 / float(np.median(np.diff(log.time))))
    topics["/tf"] = transforms(log, store, every)
    bag = write_rosbag2(tmp_path / "walk", topics, store)
    read = read_log(bag, joints=JOINTS, reading=reading_for(model))
    assert len(read) == len(log)
    (note,) = [note for note in read.notes if note.startswith("/tf has 10 Hz")]
    assert "base.orientation.w" in note and "base.position.z dropped" in note
    assert compare(model, read).errors.nrms < 0.012
    del topics["/imu"]
    slow = write_rosbag2(tmp_path / "blind", topics, store)
    with pytest.raises(LogError, match=r"very different rates: .*/tf 10 Hz"):
        read_log(slow, joints=JOINTS, reading=reading_for(model))


def test_a_topic_that_is_asked_for_leaves_those_of_other_sources():
    kinds = {
        "imu": "sensor_msgs/msg/Imu",
        "l_foot/wrench": "geometry_msgs/msg/WrenchStamped",
        "mocap/pose": "geometry_msgs/msg/PoseStamped",
        "odom": "nav_msgs/msg/Odometry",
        "tf_static": "tf2_msgs/msg/TFMessage",
    }
    rest = ["imu"], ["l_foot/wrench"]
    assert base_sources(kinds, ()) == [["odom", "mocap/pose"], *rest]
    assert base_sources(kinds, ["mocap/pose"]) == [["mocap/pose"], *rest]


def test_wrong_contact_flags_are_said(model, maker):
    rng, name = np.random.default_rng(0), "fr_foot.contact"
    steps = (np.arange(len(maker.time)) // 30 % 2).astype(float)
    for wrong in (0.0, 0.1):
        flags = np.where(rng.random(len(steps)) < wrong, 1.0 - steps, steps)
        log = with_base(maker.log(wrenches=False, **{name: flags}), model)
        said = [note for note in log.notes if "contact flags are wrong" in note]
        assert len(said) == (wrong > 0.0)
    assert "% of those of fr_foot" in said[0] and "fl_foot" not in said[0]


@pytest.mark.parametrize(
    ("form", "name", "factor"),
    [
        ("base_pos_{} [mm]", "base.position", 1e-3),
        ("mocap.rot.{}", "base.orientation", 1.0),
        ("base_q{}", "base.orientation", 1.0),
        ("imu_gyro_{}_dps", "imu.angular_velocity", np.pi / 180.0),
        ("base_pos[{n}]", "base.position", 1.0),
        ("imu.linear_acceleration.{} [g]", "imu.linear_acceleration", 9.80665),
        ("fl_foot.force.{}_kgf", "fl_foot.force", 9.80665),
        ("fl_foot.contact [%]", "fl_foot.contact", 0.01),
    ],
)
def test_other_names_and_units_of_a_base_and_feet(tmp_path, model, maker, form, name, factor):
    columns = maker.log(wrenches=True).columns()
    for old in [c for c in columns if c.startswith(name)]:
        columns[form.format(old[-1], n="xyz".find(old[-1]))] = columns.pop(old) / factor
    pandas.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    read = read_log(tmp_path / "log.csv", joints=JOINTS, reading=reading_for(model))
    expected = maker.log(wrenches=True).floating
    assert read.floating.keys() == expected.keys()
    for each, values in expected.items():
        np.testing.assert_allclose(read.floating[each], values, atol=1e-9)


def test_contacts_in_per_cent_and_forces_along_one_axis_are_said(model, maker):
    count = len(maker.time)
    with pytest.raises(LogError, match=r"goes up to 98, .*fl_foot.contact \[%\]"):
        with_base(maker.log(wrenches=False, **{"fl_foot.contact": np.full(count, 98.0)}), model)
    log = maker.log(wrenches=False, **{"fl_foot.force.z": np.ones(count)})
    own = {name: x for name, x in log.floating.items() if name != "base.position.y"}
    notes = with_base(replace(log, floating=own), model).notes
    assert "base.position, fl_foot.force: not used, as an axis is missing" in notes


def test_bad_poses_are_refused(model, maker):
    count = len(maker.time)
    with pytest.raises(LogError, match="unit quaternion"):
        with_base(maker.log(wrenches=False, **{"base.orientation.w": np.full(count, 2.0)}), model)
    log = maker.log(wrenches=False)
    bare = {name: x for name, x in log.floating.items() if not name.startswith(("base", "imu"))}
    with pytest.raises(LogError, match="no orientation"):
        with_base(JointLog("log", JOINTS, log.time, log.position, log.effort, floating=bare), model)
    with pytest.raises(LogError, match="link 'tail', which the model lacks"):
        with_base(maker.log(wrenches=False, **{"tail.contact": np.ones(count)}), model)


def _on_feet(maker: Maker, lift: float) -> JointLog:
    """Return the log of a dog that sways, without an IMU, on feet that rest, or lift by turns."""
    dog, sway = FreeRobot(quadruped(), JOINTS), deepcopy(maker)
    now = np.append(np.zeros(6), sway.joints[0].mean(axis=0))
    dog.efforts(now, 0.0 * now, 0.0 * now)
    places = np.array([dog.pose(foot)[1] for foot in FEET])
    steps = np.sin(4.0 * np.pi * sway.time[:, None] + [0.0, np.pi, np.pi, 0.0])
    sway.place[0, :, 2] -= 0.38
    for k in range(len(sway.time)):
        now[:6] = np.append(sway.place[0, k], sway.angles[0, k])
        up = lift * np.maximum(steps[k, :, None] - 0.3, 0.0) * [0.0, 0.0, 1.0]
        for _ in range(4):
            dog.efforts(now, 0.0 * now, 0.0 * now)
            off = np.array([dog.pose(foot)[1] for foot in FEET]) - places - up
            J = np.vstack([dog.jacobian(foot)[:3, 6:] for foot in FEET])
            now[6:] -= np.linalg.solve(J, off.ravel())
        sway.joints[0, k] = now[6:]
    sway.place[0, :, 2] -= places[0, 2]
    flags = (steps <= 0.3) | (lift == 0.0)
    log = sway.log(wrenches=False, **dict(zip(CONTACTS, flags.T.astype(float), strict=True)))
    kept = (name for name in log.floating if not name.startswith("imu"))
    return replace(log, floating={name: log.floating[name] for name in kept})


@pytest.fixture(scope="module")
def planted(maker):
    return _on_feet(maker, 0.0)


PLACE, CONTACTS = [f"base.position.{axis}" for axis in "xyz"], [f"{foot}.contact" for foot in FEET]
TURN = [f"base.orientation.{axis}" for axis in "wxyz"]


def _turn_of(log):
    return Rotation.from_quat(np.stack([log.floating[n] for n in TURN], 1), scalar_first=True)


def _other_pose(log, world, body):
    """Return columns of the pose of a log in axes of the world and the body that are turned."""
    place = world.apply(np.stack([log.floating[name] for name in PLACE], 1))
    quaternion = (world * _turn_of(log) * body.inv()).as_quat(scalar_first=True)
    return dict(zip([*PLACE, *TURN], [*place.T, *quaternion.T], strict=True))


def _changed(names, change):
    """Return what changes three columns of a log, by their values and its orientation."""

    def columns(log):
        values = change(np.stack([log.floating[name] for name in names], 1), _turn_of(log))
        return dict(zip(names, values.T, strict=True))

    return columns


SPIN, FELT = (
    [f"imu.{name}.{axis}" for axis in "xyz"] for name in ("angular_velocity", "linear_acceleration")
)
MATRIX = [f"{row}{column}" for row in range(3) for column in range(3)]
YAWED, TILTED = Rotation.from_euler("z", 2.0), Rotation.from_euler("x", -0.8)
SAME, UP, OVER = (Rotation.from_euler("x", x, degrees=True) for x in (0.0, 90.0, 180.0))
MISREAD = {
    "positions are in mm": _changed(PLACE, lambda place, R: 1e3 * place),
    "rotates the world into the body": lambda log: {n: -log.floating[n] for n in TURN[1:]},
    "columns are x, y, z, w": lambda log: {
        n: log.floating[m] for n, m in zip(TURN, [*TURN[1:], TURN[0]], strict=True)
    },
    "y is upwards": lambda log: _other_pose(log, UP.inv(), SAME),
    "z is downwards in the world": lambda log: _other_pose(log, OVER, SAME),
    "z is downwards in the world and the body": lambda log: _other_pose(log, OVER, OVER),
    "in degrees per second": _changed(SPIN, lambda own, R: np.degrees(own)),
    "velocities are in the axes of the world": _changed(SPIN, lambda own, R: R.apply(own)),
    "are, for example, -y, x, z of the log": _changed(
        SPIN, lambda own, R: own[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    ),
    "accelerations are in the axes of the world": _changed(FELT, lambda own, R: R.apply(own)),
}
BY_FEET, BY_SPIN = [*MISREAD][:6], [*MISREAD][1:3] + [*MISREAD][6:9]


@pytest.mark.parametrize(
    ("by", "words"),
    [
        *(("gravity", words) for words in MISREAD if "rotates" in words or "columns" in words),
        *(("does not turn", words) for words in BY_SPIN),
        *(("no foot|feet on", words) for words in BY_FEET),
        *(("no foot|feet on the", words) for words in BY_FEET if "mm" not in words),
        ("does not measure", [*MISREAD][-1]),
    ],
)
def test_poses_that_are_meant_otherwise_are_refused(model, maker, planted, by, words):
    """By gravity, the gyroscope, feet at rest, which need no positions, and accelerations."""
    log = planted if "foot" in by else maker.log(wrenches=False)
    yawed = YAWED if "axes of the world" in words or "foot" in by else SAME
    log = replace(log, floating=log.floating | _other_pose(log, yawed, SAME))
    if by == "gravity":
        felt = _changed(FELT, lambda own, R: TILTED.apply(own))(log)
        log = replace(log, floating=log.floating | _other_pose(log, SAME, TILTED) | felt)
    with_base(log, model)
    own = log.floating | MISREAD[words](log)
    lost = PLACE if by.endswith("the") else []
    own = {name: values for name, values in own.items() if name not in lost}
    with pytest.raises(LogError, match=rf"({by}).* if .*{words}\."):
        with_base(replace(log, floating=own), model)


def test_poses_of_markers_that_are_mounted_otherwise_are_mended(model, planted):
    """They are turned against the root, and elsewhere on it."""
    turn = Rotation.from_euler("ZYX", [20.0, -3.0, 4.0], degrees=True)
    offset = _turn_of(planted).apply([0.1, -0.05, 0.08])
    columns = _other_pose(planted, SAME, turn)
    columns |= {name: columns[name] + x for name, x in zip(PLACE, offset.T, strict=True)}
    found = with_base(replace(planted, floating=planted.floating | columns), model)
    assert any("the tracked body is not the root" in note for note in found.notes)
    plain = with_base(planted, model)
    assert not any("tracked body" in note for note in plain.notes)
    np.testing.assert_allclose(found.position, plain.position, atol=2e-3)


def test_feet_without_flags_are_told(model, planted):
    bare = {name: values for name, values in planted.floating.items() if name != CONTACTS[1]}
    read = with_base(replace(planted, floating=bare), model)
    assert any("no contact flags of fr_foot: " in note for note in read.notes)


@pytest.mark.parametrize(
    ("words", "form", "names", "values"),
    [
        ("roll, pitch and yaw in rad, about fixed", "base_{}", ANGLES, lambda R: R.as_euler("xyz")),
        ("rad, about turned", "odom.euler.{}", "xyz", lambda R: R.as_euler("XYZ")),
        ("rad, about fixed", "root_{}_deg", ANGLES, lambda R: R.as_euler("xyz", degrees=True)),
        ("degrees, about fixed", "base_rpy_{}", "012", lambda R: R.as_euler("xyz", degrees=True)),
        ("row by row", "base_R_{}", MATRIX, lambda R: R.as_matrix().reshape(-1, 9)),
        (
            "column by column",
            "base.rot[{}]",
            "012345678",
            lambda R: R.inv().as_matrix().reshape(-1, 9),
        ),
        ("read as x, y, z, w", "base_quat_{}", "1234", lambda R: R.as_quat()),
        ("read as w, x, y, z", "base_quat_{}", "0123", lambda R: R.as_quat(scalar_first=True)),
    ],
)
def test_orientations_in_other_forms_are_read(tmp_path, model, planted, words, form, names, values):
    log = replace(planted, floating=planted.floating | _other_pose(planted, YAWED, SAME))
    turn = _turn_of(log)
    columns = {name: x for name, x in log.columns().items() if name not in TURN}
    columns |= {form.format(n): x for n, x in zip(names, values(turn).T, strict=True)}
    pandas.DataFrame(columns).to_csv(tmp_path / "log.csv", index=False)
    read = with_base(
        read_log(tmp_path / "log.csv", joints=JOINTS, reading=reading_for(model)), model
    )
    assert any(words in note for note in read.notes)
    expected = with_base(log, model)
    np.testing.assert_allclose(
        read.select(model.joints).position, expected.select(model.joints).position, atol=1e-9
    )


def test_flags_of_other_feet_and_inverted_ones_are_told(model, maker):
    log = _on_feet(maker, 0.1)
    own = [log.floating[name] for name in CONTACTS]
    expected = with_base(log, model).contacts.flags
    for order, words in (
        ([1, 0, 2, 3], "fr_foot are of fl_foot"),
        ([1, 3, 0, 2], "hl_foot are of hr_foot"),
    ):
        columns = dict(zip(CONTACTS, (own[k] for k in order), strict=True))
        with pytest.raises(LogError, match=f"those of feet that rest in .*{words}"):
            with_base(replace(log, floating=log.floating | columns), model)
    for which in (CONTACTS, CONTACTS[2:3]):
        columns = {name: 1.0 - log.floating[name] for name in which}
        mended = with_base(replace(log, floating=log.floating | columns), model)
        assert any("are inverted" in note for note in mended.notes)
        np.testing.assert_array_equal(mended.contacts.flags, expected)


def test_forces_of_other_feet_are_refused(model, maker):
    log = maker.log(wrenches=True, noise=1.0)
    columns = {
        f"{foot}.force.{axis}": log.floating[f"{other}.force.{axis}"]
        for foot, other in zip(FEET, (FEET[1], FEET[0], *FEET[2:]), strict=True)
        for axis in "xyz"
    }
    with pytest.raises(LogError, match="those of fl_foot are of fr_foot, those of fr_foot are of"):
        with_base(replace(log, floating=log.floating | columns), model)


def test_thrust_at_the_trunk_of_a_robot_that_flies_is_read(model, maker):
    """No link of it is near the ground, and the axes of its thrust are told, however upright."""
    log = maker.log(wrenches=False)
    bare = {n: x for n, x in log.floating.items() if n.startswith(("base", "imu"))}
    moment, force = np.split(maker.carried, 2, axis=1)
    in_world = {"torque": moment - np.cross(maker.place[0], force), "force": force}

    def read(**vectors):
        own = {f"trunk.{w}.{'xyz'[k]}": x[:, k] for w, x in vectors.items() for k in range(3)}
        return with_base(replace(log, floating=bare | own), model)

    notes = read(**{w: maker.R.inv().apply(each) for w, each in in_world.items()}).notes
    assert not any("near the ground" in note or "from what carries" in note for note in notes)
    with pytest.raises(LogError, match="in world axes"):
        read(**in_world)


def test_readings_that_are_held_or_stuck_are_told(model, maker, planted):
    held = np.arange(len(planted)) // 4 * 4
    for log, of_use in ((maker.log(wrenches=False), slice(None)), (planted, slice(None, None, 4))):
        slow = {name: log.floating[name][held] for name in (*PLACE, *TURN)}
        found = with_base(replace(log, floating=log.floating | slow), model)
        assert any("every 4 rows" in note for note in found.notes)
        expected = with_base(log, model).position[of_use]
        assert np.abs(found.position - expected)[: len(expected) - 4].max() < 1e-4
    stuck = slice(400, 500)
    frozen = {name: planted.floating[name].copy() for name in (*PLACE, *TURN)}
    for values in frozen.values():
        values[stuck] = values[400]
    found = with_base(replace(planted, floating=planted.floating | frozen), model)
    assert any("is stuck" in note for note in found.notes)
    assert np.isnan(found.position[401:500, -6:]).all()


def _posed(maker, rotation, force=None, missing=slice(0, 0)):
    quaternion = np.roll(rotation.as_quat(), 1, axis=1)
    quaternion[missing] = np.nan
    if force is None:
        force = rotation.inv().apply([0, 0, 9.81])
    columns = {f"base.orientation.{axis}": quaternion[:, k] for k, axis in enumerate("wxyz")}
    columns |= {f"imu.linear_acceleration.{axis}": force[:, k] for k, axis in enumerate("xyz")}
    return maker.log(wrenches=False, **columns)


def test_what_says_no_way_up_is_refused(model, maker):
    count = len(maker.time)
    upright = Rotation.from_euler("z", np.zeros((count, 1)))
    steep = Rotation.from_euler("y", np.linspace(0.0, np.pi / 2, count)[:, None])
    for log, words in (
        (_posed(maker, steep), "pitches by up to 90°"),
        (_posed(maker, upright, missing=slice(None)), "no row"),
    ):
        with pytest.raises(LogError, match=words):
            with_base(log, model)
    for value, words in ((0.0, "has 0 m/s²"), (np.nan, "no value")):
        log = _posed(maker, upright, force=np.full((count, 3), value))
        bare = {n: x for n, x in log.floating.items() if "orientation" not in n}
        with pytest.raises(LogError, match=words):
            with_base(replace(log, floating=bare), model)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("wrenches", [False, True])
def test_a_slope_to_which_the_world_is_parallel_is_a_tilt(model, wrenches):
    """Without an IMU, only the forces show where gravity points."""
    log = Maker(slope=0.07).log(wrenches=wrenches, noise=1.0)
    kept = {name: x for name, x in log.floating.items() if not name.startswith("imu.")}
    (step,) = explain(model, [replace(log, floating=kept)]).steps
    assert step.effect == "gravity_tilt"
    ((_, found),) = step.parameters.items()
    assert [found["tilt_x"], found["tilt_y"]] == pytest.approx([0.0, 0.07], abs=3e-3)


@pytest.mark.parametrize(("payload", "place"), [(2.0, "-0.2 0.1 0.05"), (5.0, "0.1 0.02 0.1")])
def test_forces_in_other_axes_are_refused_beside_heavy_loads(model, payload, place):
    """Up to a third of the robot's mass is missing in the model."""
    heavy = Maker(payload, place=place)
    log = heavy.log(wrenches=True, noise=1.0)
    assert with_base(log, model).ground is not None

    def with_forces(forces: np.ndarray) -> JointLog:
        names = [f"{foot}.force.{axis}" for foot in FEET for axis in "xyz"]
        columns = forces.reshape(len(log), -1).T
        return replace(log, floating=log.floating | dict(zip(names, columns, strict=True)))

    for forces, words in (
        (heavy.world_forces, "in world axes"),
        (-heavy.forces, "in link axes as forces of the robot"),
        (heavy.forces[:, [1, 0, 2, 3]], "those of fl_foot are of fr_foot"),
    ):
        with pytest.raises(LogError, match=words):
            with_base(with_forces(forces), model)


def test_forces_in_other_axes_are_refused(model, maker):
    log = maker.log(wrenches=True)
    changes = {
        f"{foot}.force.{axis}": maker.world_forces[:, at, k]
        for at, foot in enumerate(FEET)
        for k, axis in enumerate("xyz")
    }
    with pytest.raises(LogError, match="in world axes"):
        with_base(replace(log, floating={**log.floating, **changes}), model)
    wrong = {"x": ("z", 1.0), "y": ("y", 1.0), "z": ("x", -1.0)}  # what the log has for each
    turned = {
        f"{foot}.force.{axis}": sign * log.floating[f"{foot}.force.{of}"]
        for foot in FEET
        for axis, (of, sign) in wrong.items()
    }
    with pytest.raises(LogError, match=r"if x, y, z of the links are, for example, .*x of the log"):
        with_base(replace(log, floating={**log.floating, **turned}), model)
    names = [[f"{foot}.force.{axis}" for axis in "xyz"] for foot in FEET]
    mounted = Rotation.from_euler("ZYX", [30.0, -20.0, 10.0], degrees=True).inv()
    found = []
    for turn, words in (
        (mounted.as_matrix(), r"rotated by (.*)° \(yaw"),
        (-np.eye(3), "(robot on)"),
    ):
        changes = {}
        for own in names:
            force = np.array([log.floating[name] for name in own])
            changes |= dict(zip(own, turn @ force, strict=True))
        with pytest.raises(LogError, match=words) as refused:
            with_base(replace(log, floating={**log.floating, **changes}), model)
        found += re.findall(words, str(refused.value))
    angles = [float(angle) for angle in found[0].split("°, ")]
    np.testing.assert_allclose(angles, [30.0, -20.0, 10.0], atol=2.0)  # as the body accelerates
    with_base(log, model)


def test_robots_that_are_held_are_refused(model, maker):
    """Their base rests, and no foot carries it: by flags, by forces, and by nothing logged."""
    held = deepcopy(maker)
    for motion in (held.place, held.angles):
        motion[:] = motion[:1] * [[[1.0]], [[0.0]], [[0.0]]]
        motion[0] = motion[0, 0]
    held.forces[:] = 0.0
    dog = FreeRobot(quadruped(), JOINTS)
    motion = np.concatenate([held.place, held.angles, held.joints], axis=2)
    held.effort = np.array([dog.efforts(*motion[:, k])[6:] for k in range(len(held.time))])
    held.R = Rotation.from_euler("ZYX", held.angles[0])
    held.gyro, held.imu = (
        0.0 * held.gyro,
        held.R.inv().apply(np.tile([0, 0, 9.81], (len(held.R), 1))),
    )
    nothing = {f"{foot}.contact": np.zeros(len(held.time)) for foot in FEET}
    bare = held.log(wrenches=False, noise=1.0)
    columns = {n: x for n, x in bare.floating.items() if not n.endswith(".contact")}
    unlogged = replace(bare, floating=columns)
    for log, words in (
        (held.log(wrenches=True, noise=1.0), "carry 0% of the weight"),
        (held.log(wrenches=False, noise=1.0, **nothing), "nothing touches the ground in 100%"),
        (unlogged, "nothing touches the ground in 100%"),
    ):
        with pytest.raises(LogError, match=f"{words}.*, but a robot in the air falls.*omit --fl"):
            with_base(log, model)


@pytest.mark.parametrize("wrenches", [True, False])
def test_robots_on_their_feet_are_simulated(model, maker, wrenches):
    """By forces that were measured, or those that the motion needs, which bodies must fit to."""
    log, wrong = maker.log(wrenches=wrenches), replace(model, phi=1.5 * model.phi)
    right, worse = (roll_out(each, log, horizon=0.1) for each in (model, wrong))
    assert any("forces at fl_foot" in note for note in right.notes) != wrenches
    most, other = (max(joint.rms for joint in found.joints) for found in (right, worse))
    assert most < min(1e-2, 0.3 * other), (most, other)


def test_a_fixed_model_says_that_the_log_is_of_a_free_base(tmp_path, maker):
    (tmp_path / "quadruped.urdf").write_text(quadruped(), encoding="utf-8")
    fixed, log = load_description(tmp_path / "quadruped.urdf"), maker.log(wrenches=True)
    assert any("--floating frees it" in note for note in compare(fixed, log).first)
    assert "base is logged as free" in unchecked_words(fixed, [log])[0]


@pytest.mark.parametrize("command", ["log", "compare", "play"])
def test_commands_read_the_columns_of_a_free_base(tmp_path, monkeypatch, maker, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quadruped.urdf").write_text(quadruped(), encoding="utf-8")
    pandas.DataFrame(maker.log(wrenches=True).columns())[:600].to_csv("walk.csv", index=False)
    options = {"log": ["walk.csv", "--model", "quadruped.urdf"]}
    options["compare"] = ["quadruped.urdf", "walk.csv", "--report", "page.html"]
    options["play"] = ["quadruped.urdf", "walk.csv", "--out", "page.html"]
    found = CliRunner().invoke(app, [command, *options[command], "--floating"])
    assert found.exit_code == 0, found.output
    assert "have no measurements" not in found.output
    assert command == "log" or (tmp_path / "page.html").stat().st_size > 10_000


@pytest.mark.parametrize("wrenches", [True, False])
def test_forces_and_contacts_of_feet_are_played(model, maker, wrenches):
    played = play_back(model, [maker.log(wrenches=wrenches)], seconds=1.0)
    assert [foot.frame.name for foot in played.feet] == list(FEET)
    recorded = tracks(play_page(played, title="dog", log_names=["log"]))
    for k, foot in enumerate(played.feet):
        assert foot.touches.all() != wrenches
        (path,) = {path for path, _ in recorded if path.endswith(f"ground {FEET[k]}/arrow")}
        frames, scales = recorded[path, "scale"]
        if not wrenches:
            assert np.isnan(foot.force).all() and not any(recorded[path, "visible"][1])
            continue
        time = played.excerpts[0].time
        force = np.stack([np.interp(time, maker.time, x) for x in maker.forces[:, k].T], 1)
        np.testing.assert_allclose(foot.force, force, atol=1e-9)
        shares = np.linalg.norm(force, axis=1) / (9.81 * model.total_phi[:, 0].sum())
        assert len(frames) == len(time)
        np.testing.assert_allclose(np.array(scales)[:, 2], 3.0 * shares, rtol=1e-6)


def test_mappings_name_the_columns_of_a_base_and_its_feet(tmp_path, monkeypatch, maker):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quadruped.urdf").write_text(quadruped(), encoding="utf-8")
    log = maker.log(wrenches=True)
    columns = log.columns()
    pandas.DataFrame(columns).to_csv("walk.csv", index=False)
    asked = ["walk.csv", "--model", "quadruped.urdf", "--floating", "--write-mapping", "m.yaml"]
    said = CliRunner().invoke(app, ["log", *asked])
    assert "base.position" in said.output and "fl_foot.force" in said.output
    content = yaml.safe_load((tmp_path / "m.yaml").read_text())
    assert content["base"].keys() == log.floating.keys()
    odd = {name: f"channel {k}" for k, name in enumerate(log.floating)}
    columns["base.position.x"] = 1000.0 * columns["base.position.x"]
    pandas.DataFrame({odd.get(name, name): x for name, x in columns.items()}).to_csv("odd.csv")
    content["base"] = odd | {"base.position.x": {"column": odd["base.position.x"], "unit": "mm"}}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(content))
    found = read_log("odd.csv", reading=Reading(mapping=read_mapping(tmp_path / "m.yaml")))
    for name, values in log.floating.items():
        np.testing.assert_allclose(found.floating[name], values, atol=1e-9)
    content["base"]["base.nose.x"] = "time"
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(LogError, match=r"'base\.nose\.x' is no quantity of a base"):
        read_mapping(tmp_path / "m.yaml")


@pytest.mark.sampled(2)
@pytest.mark.parametrize("wrenches", [True, False])
def test_a_gain_of_a_leg_is_told_by_forces_of_the_ground(model, maker, wrenches):
    log = maker.log(wrenches=wrenches, noise=1.0)
    wrong, effort = log.joints.index("hl_knee"), log.effort.copy()
    effort[:, wrong] *= 1.2
    (step,) = explain(model, replace(log, effort=effort)).steps
    assert (step.effect, step.where) == ("effort_scale", ("hl_knee",)) and step.probability > 0.9
    assert abs(step.parameters["hl_knee"]["gain_error"] - 0.2) < 0.02


@pytest.mark.parametrize("wrenches", [True, False])
def test_joints_that_bear_forces_of_the_ground_do_not_give_way(model, maker, wrenches):
    """Columns of what gives way have no forces of the ground in them."""
    case = prepare_case(model, [maker.log(wrenches=wrenches)], candidates=True)
    tried = {effect.role for effect in case.dataset.effects if {*effect.where} & {*JOINTS}}
    assert Role.SCALE in tried and Role.DEFLECTION not in tried
