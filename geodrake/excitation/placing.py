"""Place a robot on the ground: feet, their polygon, and the loops that they close."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Mesh, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame
from pydrake.systems.framework import Context
from scipy.spatial import ConvexHull, QhullError

from geodrake.boundary.arguments import instance, instances, number, real_array
from geodrake.errors import ArgumentError, ModelError, nearest
from geodrake.excitation.collisions import Solid, corners_of, solids_of_file
from geodrake.excitation.limits import MotionLimits, motion_limits, motors_of
from geodrake.excitation.stance import Foot, Stance, root_of
from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model.robot_model import RobotModel
from geodrake.robot.joints import joint_names
from geodrake.robot.loops import LoopJoints, closed_loops
from geodrake.robot.stated import WORLD, Closure
from geodrake.robot.transmission.loop import LoopTransmission, solve_loop
from geodrake.robot.transmission.schema import Drive

_FRICTION = 1e-3, 100.0  # smallest and largest friction coefficient
_LEVELLING = 3  # iterations, as lowest points of balls depend on the ground's slope
_LEVEL = 0.005  # m, tolerance of the points of feet to the plane through them
_NARROW = 0.005  # m, width below which a polygon supports nothing
_SIDES = 12  # maximum number of a polygon's sides
_SWAY = np.array([0.3, 0.3, 0.3, 0.5, 0.5, 0.5])  # range of a base: shares of its height, and rad
_Z = 2  # index of the base's vertical joint
_SHRINK, _TRIALS, _RANDOM, _CORNERS = 0.8, 20, 200, 6
_SLACK = 1e-6  # rad or m, tolerance of a posture to the limits
_LOWEST = 0.005  # m over the lowest point of a foot, within which points touch the ground
_FLAT, _TILTED = np.radians(3.0), np.radians(45.0)  # tolerance of a face, largest tilt of a sole
_SAME = 0.002  # m, least extent of a sole
_AROUND = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
_ADVICE = "Define its contact: a Foot with points, or LINK=LENGTHxWIDTH or LINK=point in --feet."


def make_stance(
    robot: RobotModel,
    feet: Sequence[str | Foot],
    *,
    posture: ArrayLike | None = None,
    friction: float = 0.5,
    margin: float = 0.9,
    limits: MotionLimits | None = None,
) -> Stance:
    """Return a robot standing on feet at rest on level ground.

    Args:
        robot: The robot with a floating base (`load_model(..., floating=True)`).
        feet: `Foot`s, or names of links or other frames of the model file whose lowest collision
            geometry touches the ground.
        posture: (m,) positions of the motors in which the feet are placed, rad or m; those of the
            model file if None. The robot is rotated until all feet are level.
        margin: Share of the polygon of the feet, from its middle, in which the zero-moment point
            stays.
        limits: Limits of the motors; `motion_limits(robot, bounded=True)` if None.
    """
    instance(robot, "robot", RobotModel)
    feet = instances(feet, "feet", (str, Foot))
    number(friction, "friction", lower=_FRICTION[0], upper=_FRICTION[1])
    number(margin, "margin", lower=0.0, upper=1.0, strict=True)
    if len(robot.base_joints) != 6:
        raise ArgumentError(
            f"A standing robot needs one floating base; {robot.path.name} has "
            f"{len(robot.base_joints) // 6}.",
            advice="Load it with --floating (floating=True).",
        )
    gravity = robot.tree.gravity
    if not -gravity[2] > 0.999 * np.linalg.norm(gravity) > 0.0:
        raise ArgumentError(
            f"Gravity is {gravity.tolist()}, but a standing robot needs it along −z."
        )
    if not feet:
        raise ArgumentError("A robot stands on at least one foot; none was given.")
    motors = motors_of(robot)
    limits = motion_limits(robot, bounded=True) if limits is None else limits
    positions = {name: robot.default_position(name) for name in robot.joints}
    if posture is not None:
        values = real_array(posture, "posture", (len(motors),))
        positions |= dict(zip(motors, values.tolist(), strict=True))
    q = robot.positions(np.array([[positions[name] for name in robot.joints]]))
    for k, name in enumerate(motors):
        if not limits.lower[k] - _SLACK <= positions[name] <= limits.upper[k] + _SLACK:
            raise ArgumentError(
                f"Where the robot stands, joint {name!r} is at {positions[name]:.4g}, but its "
                f"range is {limits.lower[k]:.4g} to {limits.upper[k]:.4g}.",
                advice="Set its posture: --stand JOINT=NUMBER,… (posture).",
                joint=name,
            )
    plant_q = robot.plant_positions(q)[0]
    context = robot.create_context()
    robot.plant.SetPositions(context, plant_q)
    feet = _feet_of(robot, feet, context)
    X_GW, polygon = _ground(robot, feet, context)
    closures = []
    for foot in feet:
        frame = _frame_of(robot.plant, foot.frame)
        X_FP = RigidTransform() if foot.is_sole else RigidTransform(np.asarray(foot.points)[0])
        X_GP = X_GW @ frame.CalcPoseInWorld(context) @ X_FP
        bodies = WORLD, frame.body().scoped_name().get_full()
        poses = X_GP, frame.GetFixedPoseInBodyFrame() @ X_FP
        closures.append(Closure(foot.frame, bodies, poses, foot.is_sole, radius=foot.radius))
    X_GB = X_GW @ robot.plant.EvalBodyPoseInWorld(context, root_of(robot))
    yaw_pitch_roll = RollPitchYaw(X_GB.rotation()).vector()[::-1]
    base = dict(zip(robot.base_joints, [*X_GB.translation(), *yaw_pitch_roll], strict=True))
    how = LoopJoints(
        robot.followers,
        driven=motors,
        first=() if len(feet) == 1 else robot.base_joints,
        start=dict(zip(joint_names(robot.plant), plant_q.tolist(), strict=True)) | base,
        drives=robot.transmission,
        placed=positions,
    )
    model = _on_loops(robot, closures, how)
    positions |= base
    free, placed = (np.array([positions[n] for n in names]) for names in (model.joints, motors))
    return Stance(robot, model, feet, free, placed, polygon, friction, margin, limits)


def _on_loops(robot: RobotModel, closures: Sequence[Closure], how: LoopJoints) -> RobotModel:
    """Return the robot whose feet form closed loops with the ground."""
    try:
        loops = closed_loops(robot.plant, closures, path=robot.path, how=how)
    except ModelError as error:
        raise ArgumentError(
            f"The robot cannot move on its feet in this posture: {error.problem}",
            advice="Bend its knees: --stand.",
        ) from error
    (loop,) = loops.loops
    if set(loop.actuators) & set(robot.base_joints):
        limits = loop.limits.copy()
        limits[:, loop.free] = _reachable(loop, robot)
        loop = replace(loop, limits=limits)
    drives = (drive for drive in robot.transmission if not {*drive.joints} & {*loop.joints})
    model = replace(
        robot,
        transmission=(*drives, Drive.of_loop(loop)),
        followers={k: tie for k, tie in robot.followers.items() if k not in loops.taken},
        information=None,
        effort_noise=None,
        fading_speed=None,
    )
    indices = [robot.joints.index(name) for name in model.joints]
    noise, fading = robot.effort_noise, robot.fading_speed
    return replace(
        model,
        effort_noise=None if noise is None else noise[indices],
        fading_speed=None if fading is None else fading[indices],
    )


def _reachable(loop: LoopTransmission, robot: RobotModel) -> tuple[Array, Array]:
    """Return a range of the free joints (n,) around the posture in which the feet can stay."""
    names, center = loop.actuators, loop.reference[loop.free]
    low, high = loop.limits[:, loop.free]
    base = [k for k, name in enumerate(names) if name in robot.base_joints]
    sway = _SWAY[[robot.base_joints.index(names[k]) for k in base]].copy()
    slides = np.array([names[k] in robot.sliding_joints for k in base])
    height = loop.reference[loop.joints.index(robot.base_joints[_Z])]
    sway[slides] *= abs(height)
    low[base], high[base] = center[base] - sway, center[base] + sway
    low = np.where(np.isfinite(low), low, center - _SWAY[-1])
    high = np.where(np.isfinite(high), high, center + _SWAY[-1])
    shares = np.random.default_rng(0).uniform(size=(_RANDOM, len(names)))
    if len(names) <= _CORNERS:
        shares = np.vstack([list(product((0.0, 1.0), repeat=len(names))), shares])
    for _ in range(_TRIALS):
        if (solve_loop(loop.records, low + shares * (high - low))[2] == 1.0).all():
            return low, high
        low, high = center + _SHRINK * (low - center), center + _SHRINK * (high - center)
    raise ArgumentError(
        "The robot can hardly move on its feet: its legs are nearly stretched or folded.",
        advice="Let it stand with bent knees: --stand.",
    )


def _ground(
    robot: RobotModel, feet: Sequence[Foot], context: Context
) -> tuple[RigidTransform, Array]:
    """Return the pose X_GW of the world in the ground frame, and the feet's polygon (k, 2), m.

    The ground passes through all feet, with z upwards and its origin amid them. Corners are
    counterclockwise.
    """
    normal, com = np.array([0.0, 0.0, 1.0]), robot.plant.CalcCenterOfMassPositionInWorld(context)
    poses = [_frame_of(robot.plant, foot.frame).CalcPoseInWorld(context) for foot in feet]
    centers = [X.multiply(np.asarray(f.points).T).T for X, f in zip(poses, feet, strict=True)]
    for _ in range(_LEVELLING):
        touching = [c - foot.radius * normal for c, foot in zip(centers, feet, strict=True)]
        points = np.vstack(touching)
        center = points.mean(axis=0)
        if len(points) > 2:
            normal = np.linalg.svd(points - center)[2][2]
            normal = normal if normal @ (com - center) > 0.0 else -normal
    if np.abs((points - center) @ normal).max() > _LEVEL:
        heights = [1e3 * (p - center) @ normal for p in touching]
        words = ", ".join(
            f"{foot.frame} {height.min():.0f} to {height.max():.0f} mm"
            for foot, height in zip(feet, heights, strict=True)
        )
        raise ArgumentError(
            f"The feet are not on one plane in this posture; heights over the best one: {words}.",
            advice=f"Choose a posture in which they stand flat (--stand). {_ADVICE}",
        )
    x = np.array([1.0, 0.0, 0.0]) - normal[0] * normal
    x /= np.linalg.norm(x)
    R = RotationMatrix(np.stack([x, np.cross(normal, x), normal], -1))
    X_GW = RigidTransform(R, center).inverse()
    flat = X_GW.multiply(points.T).T[:, :2]
    spread = np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False)
    hull = None
    if len(flat) > 2 and spread[1] >= _NARROW:
        with suppress(QhullError):
            hull = ConvexHull(flat)
    if hull is None:
        raise ArgumentError(
            f"{', '.join(foot.frame for foot in feet)} touch the ground at a point or along "
            "a line, on which a robot cannot stand.",
            advice="Name more feet, or give a Foot with the corners of its sole.",
        )
    corners = flat[hull.vertices]
    if len(corners) > _SIDES:  # use an inscribed polygon
        angles = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
        directions = np.stack([np.cos(angles), np.sin(angles)], -1)
        corners = corners[np.unique(np.argmax(corners @ directions.T, axis=0))]
    return X_GW, np.asarray(corners)


def _frame_of(plant: MultibodyPlant, name: str) -> Frame:
    """Return the frame of a link, or another frame of the model file."""
    if not plant.HasFrameNamed(name):
        links = [member.name for body in lumped_bodies(plant) for member in body.members]
        raise ArgumentError(
            f"The model has no link {name!r} to stand on.",
            advice=f"{nearest(name, links)}Links: {', '.join(links)}.",
        )
    return plant.GetFrameByName(name)


def _feet_of(robot: RobotModel, feet: Sequence[str | Foot], context: Context) -> tuple[Foot, ...]:
    """Return feet, deriving named ones from their lowest collision geometry."""
    named = any(isinstance(foot, str) for foot in feet)
    solids = solids_of_file(robot.path, robot.given) if named else {}
    contacts = []
    for foot in feet:
        if not isinstance(foot, str):
            contacts.append(foot)
            continue
        frame = _frame_of(robot.plant, foot)
        shapes = solids.get(frame.body().scoped_name().get_full(), [])
        X_FB = frame.GetFixedPoseInBodyFrame().inverse()
        contacts.append(_lowest(foot, shapes, X_FB, frame.CalcPoseInWorld(context)))
    return tuple(contacts)


def _lowest(name: str, solids: Sequence[Solid], X_FB: RigidTransform, X_WF: RigidTransform) -> Foot:
    """Return the lowest part of a link's shapes as a foot."""
    if not solids:
        raise ArgumentError(
            f"Link {name!r} has no collision geometry to show where it touches the ground.",
            advice=_ADVICE,
        )
    parts = [_points(solid) for solid in solids]
    poses = [X_FB @ solid.X_BG for solid in solids]
    points = np.vstack([X.multiply(p.T).T for X, (p, _) in zip(poses, parts, strict=True)])
    radii = np.concatenate([np.full(len(p), r) for p, r in parts])
    down = _downwards(points, -X_WF.rotation().inverse().matrix()[:, 2])
    depths = points @ down + radii
    low = np.flatnonzero(depths > depths.max() - _LOWEST)
    touching, radius = points[low], radii[low]
    extent = np.ptp(touching - np.outer(touching @ down, down), axis=0).max()
    if extent < _SAME:
        return Foot(name, touching[:1], float(radius[0]))
    touching = touching + radius[:, None] * down
    spread = np.linalg.svd(touching - touching.mean(axis=0), compute_uv=False)
    if len(touching) < 3 or spread[1] < _SAME:
        raise ArgumentError(
            f"Link {name!r} touches the ground along an edge in this posture.",
            advice=f"Choose a posture in which it stands flat (--stand). {_ADVICE}",
        )
    return Foot(name, touching)


def _downwards(points: Array, down: Array) -> Array:
    """Return the normal (3,) of the hull's largest face that faces down, otherwise `down`."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # few or coplanar points
        return down
    normals = hull.equations[:, :3]
    first, second, third = np.moveaxis(points[hull.simplices], 1, 0)
    areas = np.linalg.norm(np.cross(second - first, third - first), axis=1)
    faces = (normals @ normals.T > np.cos(_FLAT)) @ areas * (normals @ down > np.cos(_TILTED))
    return np.asarray(normals[np.argmax(faces)]) if faces.any() else down


def _points(solid: Solid) -> tuple[Array, float]:
    """Return points (k, 3) and a radius such that balls around them have the shape's extent, m."""
    points, radius, shape = np.zeros((1, 3)), 0.0, solid.shape
    match shape:
        case Sphere():
            radius = shape.radius()
        case Capsule():
            points = np.array([[0.0, 0.0, x * shape.length()] for x in (0.5, -0.5)])
            radius = shape.radius()
        case Cylinder():
            rim = shape.radius() * np.stack([np.cos(_AROUND), np.sin(_AROUND)], -1)
            ends = [np.full((len(rim), 1), x * shape.length()) for x in (0.5, -0.5)]
            points = np.vstack([np.hstack([rim, end]) for end in ends])
        case Box():
            signs = np.array(np.meshgrid(*3 * [[-0.5, 0.5]])).reshape(3, -1).T
            points = signs * shape.size()
        case Mesh() | Convex():
            points = corners_of(shape)
        case Ellipsoid():
            radius = min(shape.a(), shape.b(), shape.c())
    return points, radius
