"""Robots of example-robot-data in Drake and in Pinocchio."""

from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from measurements import REFERENCE
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

MODELS = Path(__file__).parents[1] / "models"

ARMS = (
    "models/arm7.urdf",
    "reference/tx40.urdf",
    "reference/ur10e.urdf",
    "robots/panda_description/urdf/panda.urdf",
)
HUMANOIDS = ("reference/atlas_v5.urdf", "robots/g1_description/urdf/g1_29dof_rev_1_0.urdf")
PINOCCHIO_ORDER = [0, 1, 2, 3, 4, 6, 9, 5, 8, 7]  # its [m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz]


def cases(*names):
    """Return the names as parameters; those with public measurements are marked."""
    public = [name for name in names if name.startswith("reference/")]
    marks = {name: pytest.mark.measurements(name) for name in public}
    return [pytest.param(name, marks=marks.get(name, ())) for name in names]


def robots():
    """Return the folder of example-robot-data with its models."""
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    return Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots")))


def description(name):
    """Return a URDF without shapes, damping, transmissions, coupled and continuous joints."""
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


def moving_joints(plant):
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    return [joint for joint in joints if joint.num_velocities() == 1]


def assert_close(actual, expected):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual, expected, rtol=1e-10, atol=1e-10 * scale)


def efforts_on_a_free_base(text, plant, q, v, vd):
    """Return R_WB, wrench (n, f) in the base, and efforts of each sample, by Pinocchio."""
    pinocchio = pytest.importorskip("pinocchio")
    model = pinocchio.buildModelFromXML(text, pinocchio.JointModelFreeFlyer())
    data, joints = model.createData(), moving_joints(plant)
    ours = [joint.velocity_start() for joint in joints]
    pins = [model.joints[model.getJointId(joint.name())].idx_v for joint in joints]
    for i in range(len(q)):
        R = pinocchio.Quaternion(*q[i, :4]).matrix()
        w, t, wd, td = (R.T @ x for x in (v[i, :3], v[i, 3:6], vd[i, :3], vd[i, 3:6]))
        qs, vs, vds = (np.zeros(n) for n in (model.nq, model.nv, model.nv))
        qs[:7] = *q[i, 4:7], *q[i, 1:4], q[i, 0]
        vs[:6], vds[:6] = (*t, *w), (*(td - np.cross(w, t)), *wd)
        qs[np.add(pins, 1)] = q[i, np.add(ours, 1)]
        vs[pins], vds[pins] = v[i, ours], vd[i, ours]
        tau = pinocchio.rnea(model, data, qs, vs, vds)
        yield R, np.r_[tau[3:6], tau[:3]], tau[pins], ours
