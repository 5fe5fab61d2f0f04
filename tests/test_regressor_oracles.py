"""The regressor against Pinocchio, MuJoCo and Drake on robots that people have."""

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from measurements import REFERENCE
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces

from geodrake.inertia import inertial_parameters
from geodrake.regressor import inverse_dynamics, inverse_dynamics_regressor

MODELS = Path(__file__).parents[1] / "models"

ARMS = (
    "models/arm6.urdf",
    "models/arm7.urdf",
    "reference/panda_arm.urdf",
    "reference/tx40.urdf",
    "reference/ur10e.urdf",
    "robots/ur_description/urdf/ur5_robot.urdf",
    "robots/panda_description/urdf/panda.urdf",
    "robots/kinova_description/robots/kinova.urdf",
)
HUMANOIDS = (
    "reference/atlas_v5.urdf",
    "robots/talos_data/robots/talos_reduced.urdf",
    "robots/g1_description/urdf/g1_29dof_rev_1_0.urdf",
)
TIAGO = "robots/tiago_description/robots/tiago.urdf"
PINOCCHIO_ORDER = [0, 1, 2, 3, 4, 6, 9, 5, 8, 7]  # its [m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]


def cases(*names):
    """The names, those marked that come with the public measurements."""
    public = [name for name in names if name.startswith("reference/")]
    marks = {name: pytest.mark.measurements(name) for name in public}
    return [pytest.param(name, marks=marks.get(name, ())) for name in names]


def robots():
    """Where example-robot-data keeps its models."""
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    return Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))


def description(name):
    """Text of a URDF without shapes, damping, transmissions, coupled and continuous joints."""
    folder, _, rest = name.partition("/")
    root = {"models": lambda: MODELS, "reference": lambda: REFERENCE, "robots": robots}[folder]()
    path = root / rest
    if not path.exists():
        pytest.skip(f"{name} is not there")
    robot = ElementTree.parse(path).getroot()
    unused = ("visual", "collision", "dynamics", "mimic", "safety_controller")
    for parent in robot.iter():
        for child in list(parent):
            if child.tag in unused:
                parent.remove(child)
    for joint in robot.iter("joint"):
        if joint.get("type") == "continuous":  # for Pinocchio two positions, not one
            joint.set("type", "revolute")
            if joint.find("limit") is None:
                ElementTree.SubElement(joint, "limit", effort="1", velocity="1")
            joint.find("limit").attrib.update(lower="-3", upper="3")
    for child in list(robot):
        if child.tag not in ("link", "joint"):
            robot.remove(child)
    return ElementTree.tostring(robot, encoding="unicode")


def plant_of(text, *, floating=False):
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(text, "urdf")
    root = ElementTree.fromstring(text)
    children = {joint.find("child").get("link") for joint in root.iter("joint")}
    base = next(link.get("name") for link in root.iter("link") if link.get("name") not in children)
    if base != "world" and not floating:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(base))
    plant.Finalize()
    return plant


def random_motion(plant, count, seed=0):
    rng = np.random.default_rng(seed)
    sizes = plant.num_positions(), plant.num_velocities(), plant.num_velocities()
    return tuple(rng.uniform(-2.0, 2.0, (count, size)) for size in sizes)


def moving_joints(plant):
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return [joint for joint in joints if joint.num_velocities() == 1]


def assert_close(actual, expected):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual, expected, rtol=1e-10, atol=1e-10 * scale)


@pytest.mark.parametrize("name", cases(*ARMS, *HUMANOIDS))
def test_every_entry_is_pinocchios(name):
    pinocchio = pytest.importorskip("pinocchio")
    text = description(name)
    plant, model = plant_of(text), pinocchio.buildModelFromXML(text)
    data, (q, v, vd) = model.createData(), random_motion(plant, 5)
    joints = moving_joints(plant)
    drake = [joint.velocity_start() for joint in joints]
    ids = [model.getJointId(joint.name()) for joint in joints]
    pins = [model.joints[index].idx_v for index in ids]
    columns = [10 * (index - 1) + k for index in ids for k in PINOCCHIO_ORDER]
    bodies = np.argsort(np.argsort([int(joint.child_body().index()) for joint in joints]))
    ours = inverse_dynamics_regressor(plant, q, v, vd).reshape(5, len(joints), -1, 10)
    for i in range(5):
        state = tuple(np.zeros(model.nv) for _ in range(3))
        for theirs, sample in zip(state, (q, v, vd), strict=True):
            theirs[pins] = sample[i, drake]
        expected = pinocchio.computeJointTorqueRegressor(model, data, *state)[np.ix_(pins, columns)]
        assert_close(ours[i][drake][:, bodies].reshape(len(joints), -1), expected)


@pytest.mark.parametrize("name", cases(*HUMANOIDS))
def test_efforts_on_a_floating_base_are_pinocchios(name):
    pinocchio = pytest.importorskip("pinocchio")
    text = description(name)
    plant = plant_of(text, floating=True)
    model = pinocchio.buildModelFromXML(text, pinocchio.JointModelFreeFlyer())
    data, (q, v, vd) = model.createData(), random_motion(plant, 3)
    q[:, :4] /= np.linalg.norm(q[:, :4], axis=1, keepdims=True)
    efforts = inverse_dynamics(plant, q, v, vd, inertial_parameters(plant))
    joints = moving_joints(plant)
    ours = [joint.velocity_start() for joint in joints]
    pins = [model.joints[model.getJointId(joint.name())].idx_v for joint in joints]
    for i in range(3):
        R = pinocchio.Quaternion(*q[i, :4]).matrix()
        w, t, wd, td = (R.T @ x for x in (v[i, :3], v[i, 3:6], vd[i, :3], vd[i, 3:6]))
        positions, velocities, accelerations = (np.zeros(n) for n in (model.nq, model.nv, model.nv))
        positions[:7] = *q[i, 4:7], *q[i, 1:4], q[i, 0]
        velocities[:6], accelerations[:6] = (*t, *w), (*(td - np.cross(w, t)), *wd)
        positions[np.add(pins, 1)] = q[i, np.add(ours, 1)]
        velocities[pins], accelerations[pins] = v[i, ours], vd[i, ours]
        tau = pinocchio.rnea(model, data, positions, velocities, accelerations)
        assert_close(efforts[i, ours], tau[pins])
        assert_close(efforts[i, :6], np.concatenate([R @ tau[3:6], R @ tau[:3]]))


# MuJoCo refuses the last link of tx40, which has no mass.
@pytest.mark.parametrize("name", cases(*sorted({*ARMS} - {"reference/tx40.urdf"})))
def test_efforts_of_arms_are_mujocos(name):
    mujoco = pytest.importorskip("mujoco")
    text = description(name)
    plant, model = plant_of(text), mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, (q, v, vd) = mujoco.MjData(model), random_motion(plant, 5)
    efforts = inverse_dynamics(plant, q, v, vd, inertial_parameters(plant))
    joints = moving_joints(plant)
    ours = [joint.velocity_start() for joint in joints]
    theirs = [model.joint(joint.name()).dofadr[0] for joint in joints]
    for i in range(5):
        data.qpos[theirs], data.qvel[theirs], data.qacc[theirs] = (
            q[i, ours],
            v[i, ours],
            vd[i, ours],
        )
        mujoco.mj_inverse(model, data)
        assert_close(efforts[i, ours], data.qfrc_inverse[theirs])


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("name", cases(*ARMS, *HUMANOIDS, TIAGO))
def test_efforts_are_drakes(name, floating):
    assert_efforts_are_drakes(plant_of(description(name), floating=floating))


@pytest.mark.measurements("reference/iiwa14.sdf")
def test_efforts_of_an_sdf_arm_are_drakes():
    robot = ElementTree.parse(REFERENCE / "iiwa14.sdf").getroot()
    for link in robot.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModelsFromString(ElementTree.tostring(robot, encoding="unicode"), "sdf")
    plant.Finalize()
    assert_efforts_are_drakes(plant)


def assert_efforts_are_drakes(plant):
    q, v, vd = random_motion(plant, 3)
    efforts = inverse_dynamics_regressor(plant, q, v, vd) @ inertial_parameters(plant).ravel()
    context = plant.CreateDefaultContext()
    for i in range(3):
        plant.SetPositions(context, q[i])
        plant.SetVelocities(context, v[i])
        tau = plant.CalcInverseDynamics(context, vd[i], MultibodyForces(plant))
        assert_close(efforts[i], tau - plant.CalcGravityGeneralizedForces(context))
