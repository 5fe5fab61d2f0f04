"""A motion replayed over the robot: one HTML page with MeshCat's recording in it."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Meshcat, MeshcatParams, MeshcatVisualizer, Role
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, JointIndex
from pydrake.systems.framework import DiagramBuilder

from geodrake.errors import ModelError
from geodrake.identification.logs.unknowns import payload_reference
from geodrake.inertia import Array, is_physical
from geodrake.model.robot_model import RobotModel
from geodrake.report.ellipsoids import EllipsoidSet
from geodrake.report.meshcat_ellipsoids import MeshcatEllipsoids
from geodrake.robot.files import read_description
from geodrake.robot.files.description import drake_errors, drake_messages
from geodrake.robot.files.xacro_file import is_xacro, read_expanded
from geodrake.robot.plant import arrange_as

FRAMES = 30.0
"""Frames a second."""

_AWAY = np.array([0.9, -0.65, 0.4])  # of the camera, in sizes of the robot


def replay_page(model: RobotModel, times: Array, q: Array) -> str:
    """One HTML page that loads nothing from elsewhere and replays a motion.

    The robot looks as its file says; where Drake cannot show that, bodies are ellipsoids of their
    inertia.

    Args:
        model: The robot.
        times: (N,) instants, s.
        q: (N, nq) positions of the model.
    """
    q = model.coordinates.plant_positions(q)
    with drake_messages():  # where MeshCat listens does not matter for a page
        meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
        meshcat.SetProperty("/Background", "top_color", [1.0, 1.0, 1.0])
        meshcat.SetProperty("/Background", "bottom_color", [0.93, 0.95, 0.97])
        meshcat.SetProperty("/Axes", "visible", False)
        _place_camera(meshcat, model, q)
        meshcat.StartRecording(frames_per_second=FRAMES, set_visualizations_while_recording=False)
        if not _record_visuals(meshcat, model, times, q):
            _record_ellipsoids(meshcat, model, times, q)
        meshcat.StopRecording()
        meshcat.PublishRecording()
        return str(meshcat.StaticHtml())


def _record_visuals(meshcat: Meshcat, model: RobotModel, times: Array, q: Array) -> bool:
    """Records the file's own shapes; whether there are any that Drake can show."""
    builder = DiagramBuilder()
    plant, scene = AddMultibodyPlantSceneGraph(builder, 0.0)
    try:
        with drake_errors(model.path):
            parser = Parser(plant)
            description = read_description(model.path, model.given)
            names = description.named_packages()
            description.add_packages(parser.package_map(), names)
            _parse(parser, model)
            arrange_as(plant, model.plant)
            plant.Finalize()
            starts = _positions(model.plant, plant)
    except ModelError:
        return False
    if not scene.model_inspector().NumGeometriesWithRole(Role.kIllustration):
        return False
    MeshcatVisualizer.AddToBuilder(builder, scene, meshcat)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    context = plant.GetMyMutableContextFromRoot(root)
    shown = np.array(plant.GetPositions(context))
    for time, posture in zip(times.tolist(), q, strict=True):
        shown[starts] = posture
        root.SetTime(time)
        plant.SetPositions(context, shown)
        diagram.ForcedPublish(root)
    return True


def _parse(parser: Parser, model: RobotModel) -> None:
    """Adds what the file describes, a xacro file expanded."""
    data = model.path.read_bytes()
    if is_xacro(data):
        text = read_expanded(model.path, model.given).decode()
        parser.AddModelsFromString(text, "urdf")
    else:
        parser.AddModels(str(model.path))


def _positions(model: MultibodyPlant, shown: MultibodyPlant) -> list[int]:
    """Where each position of the model's plant is in the plant that is shown.

    Raises:
        RuntimeError: A joint of the model is not there.
    """
    where = np.empty(model.num_positions(), int)
    for index in model.GetJointIndices():
        joint = model.get_joint(JointIndex(index))
        if joint.num_positions():
            other = shown.GetJointByName(joint.name())
            count = joint.num_positions()
            start, to = joint.position_start(), other.position_start()
            where[start : start + count] = np.arange(to, to + count)
    return where.tolist()


def _record_ellipsoids(meshcat: Meshcat, model: RobotModel, times: Array, q: Array) -> None:
    context, phi = model.plant.CreateDefaultContext(), model.total_phi
    # Bodies that cannot be are shown as some body rather than as nothing.
    phi = np.where(is_physical(phi)[:, None], phi, payload_reference(model.phi))
    ellipsoids = MeshcatEllipsoids(meshcat, model.plant, [EllipsoidSet.of("robot", phi)])
    for time, posture in zip(times.tolist(), q, strict=True):
        model.plant.SetPositions(context, posture)
        ellipsoids.update(context, time)


def _place_camera(meshcat: Meshcat, model: RobotModel, q: Array) -> None:
    """Looks at where bodies go."""
    plant, context, points = model.plant, model.plant.CreateDefaultContext(), [np.zeros(3)]
    bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
    for posture in q[:: max(1, len(q) // 20)]:
        plant.SetPositions(context, posture)
        points += [plant.EvalBodyPoseInWorld(context, b).translation() for b in bodies]
    cloud = np.array(points)
    middle, size = 0.5 * (cloud.min(0) + cloud.max(0)), np.ptp(cloud, axis=0).max() + 0.2
    meshcat.SetCameraPose(middle + size * _AWAY, middle)
