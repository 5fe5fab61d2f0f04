"""What the ground does to a robot on its feet: measured wrenches, or contacts with unknown forces.

Wrenches w that were measured at frames are efforts Σ Jᵀ w of the base and of joints. If none was
measured, the log says which frames may touch the ground and when, and the fit does without their
forces (`geodrake.identification.logs.contact_rows`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import LogError
from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.logs.floating import FLAG, FORCE, ContactFlags, frames_of, vectors, widened
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files.checks import numbers
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes

_POINTS = 3  # feet that a robot can stand on if they are points
_NEAR = 0.02  # m over the ground, within which a frame may touch it
_LOWEST = 5.0  # per cent of the lowest heights, which are taken for the ground's
_UNLIKE = 0.2  # of the weight, by which mean forces at feet may differ from it


@dataclass(frozen=True)
class ContactFrame:
    """A link that may touch the ground, by a ball or a point.

    Attributes:
        body: Name of the body that the link L is welded to.
        origin: (3,) p_BoLo_B, m.
        rotation: (3, 3) R_BL.
        center: (3,) p_BoCo_B of the center of the ball, m.
        radius: Radius of the ball, m.
    """

    name: str
    body: str
    origin: Array
    rotation: Array
    center: Array
    radius: float

    def jacobian(self, bodies: RobotBodies, *, sole: bool = False) -> Array:
        """Return the Jacobian (N, 3, nv), in W, of the lowest point of the ball.

        Of a sole, which moments act on too, it has the link's turning below, (N, 6, nv).
        """
        motion = bodies.motion(self.body)
        arm = motion.rotation @ self.center - self.radius * upwards(bodies.gravity)
        point = motion.linear + np.cross(motion.angular, arm[:, :, None], axis=1)
        return np.concatenate([point, motion.angular], axis=1) if sole else point

    def height(self, bodies: RobotBodies) -> Array:
        """Return heights (N,) of the lowest point of the ball over the world's origin, m."""
        motion = bodies.motion(self.body)
        center = motion.position + motion.rotation @ self.center
        return center @ upwards(bodies.gravity) - self.radius


def upwards(gravity: Array) -> Array:
    """Return the unit vector (3,) against gravity, in W."""
    return -gravity / max(float(np.linalg.norm(gravity)), 1e-12)


def contact_frames(model: RobotModel, names: Sequence[str]) -> tuple[ContactFrame, ...]:
    """Return links by name, with the collision spheres that a URDF gives them."""
    links = {
        member.name: (lump.name, member.X_RB)
        for lump in lumped_bodies(model.plant)
        for member in lump.members
    }
    balls, found = _balls(model), []
    for name in names:
        if name not in links:
            raise LogError(
                f"The model has no link {name!r}, of which the log has a contact or a force.",
                advice=f"Links are: {', '.join(links)}.",
            )
        body, X_BL = links[name]
        center, radius = balls.get(name, (np.zeros(3), 0.0))
        frame = X_BL.translation(), X_BL.rotation().matrix(), X_BL.multiply(center), radius
        found.append(ContactFrame(name, body, *frame))
    return tuple(found)


def _balls(model: RobotModel) -> dict[str, tuple[Array, float]]:
    """Link of a URDF that has one collision sphere -> its center in the link, and its radius, m."""
    if model.path.suffix.lower() in (".yaml", ".yml") or not model.path.is_file():
        return {}
    root, found = parse_xml_bytes(read_expanded(model.path, model.given), model.path), {}
    for link in root.iterfind("link"):
        spheres = [
            (collision, sphere)
            for collision in link.iterfind("collision")
            for sphere in collision.iterfind("geometry/sphere")
        ]
        if len(spheres) == 1:
            collision, sphere = spheres[0]
            origin = collision.find("origin")
            place = numbers("" if origin is None else origin.get("xyz", ""), 3)
            radius = float(numbers(sphere.get("radius", ""), 1)[0])
            if np.isfinite([*place, radius]).all():
                found[link.get("name", "")] = place, radius
    return found


def with_ground(log: JointLog, model: RobotModel) -> JointLog:
    """Return a log with the efforts of measured wrenches, or with the frames that may touch."""
    loaded, flagged = frames_of(log.floating, FORCE), frames_of(log.floating, FLAG)
    whole = set(model.joints) <= set(log.joints)
    if loaded and whole:
        ground = _efforts_of_wrenches(log, model, loaded)
        base = np.isin(log.joints, model.base_joints)
        words = f"wrenches at {', '.join(loaded)} are efforts of the base and the joints"
        return replace(
            log,
            effort=log.effort + ground,
            ground=np.where(base, 0.0, ground),  # of the base it is all that is measured
            notes=(*log.notes, words),
        )
    names = flagged or _last_links(model)
    frames = contact_frames(model, names)
    flags = np.zeros((len(log), len(names)), bool)
    if flagged:
        columns = [log.floating[f"{name}{FLAG}"] for name in names]
        flags = widened(log.time, np.nan_to_num(np.stack(columns, -1), nan=1.0) > 0.5)
    if whole and vectors(log.floating, "base.position") is not None:
        flags |= _low(log, model, frames)
    elif not flagged:
        flags[:] = True
    told = "as the log says" if flagged else "the ends of the robot's limbs"
    contacts = ContactFlags(names, log.time, flags)
    what = "forces and moments" if on_soles(contacts, frames) else "forces"
    words = f"unknown {what} at {', '.join(names)} ({told}) are taken out"
    return replace(log, contacts=contacts, notes=(*log.notes, words))


def on_soles(contacts: ContactFlags, frames: Sequence[ContactFrame]) -> bool:
    """Return whether frames touch by surfaces: nobody stands on the points of two feet."""
    most = int(contacts.flags.sum(axis=1).max(initial=0))
    return most < _POINTS and not any(frame.radius for frame in frames)


def _bodies(log: JointLog, model: RobotModel) -> tuple[NDArray[np.bool_], RobotBodies]:
    """Return in which rows (N,) all positions are known, and the bodies there."""
    q = log.position[:, [log.joints.index(joint) for joint in model.joints]]
    known = np.asarray(np.isfinite(q).all(axis=1))
    return known, RobotBodies(model.tree, model.positions(q[known]), model.total_phi)


def _low(log: JointLog, model: RobotModel, frames: Sequence[ContactFrame]) -> NDArray[np.bool_]:
    """Return (N, c) whether frames are as low as the ground; where nobody knows, they are."""
    known, bodies = _bodies(log, model)
    found = np.ones((len(log), len(frames)), bool)
    if known.any():
        heights = np.stack([frame.height(bodies) for frame in frames], -1)
        found[known] = heights < np.percentile(heights.min(axis=1), _LOWEST) + _NEAR
    return found


def _efforts_of_wrenches(log: JointLog, model: RobotModel, names: Sequence[str]) -> Array:
    """Return Σ Jᵀ w (N, n) of wrenches at links, in the log's order; NaN where nobody knows."""
    known, bodies = _bodies(log, model)
    efforts = np.full((len(log), len(model.joints)), np.nan)
    efforts[known] = 0.0
    sums = np.zeros((2, 3))  # mean forces by the axes of links, and as if by the world's
    for frame in contact_frames(model, names):
        if (force := vectors(log.floating, f"{frame.name}.force")) is None:
            raise LogError(
                f"Log {log.name!r} has not all of {frame.name}.force.x, .y and .z.",
                advice="Log all three, in the axes of the link.",
            )
        torque = vectors(log.floating, f"{frame.name}.torque")
        torque = np.zeros_like(force) if torque is None else torque
        motion = bodies.motion(frame.body)
        R_WL = motion.rotation @ frame.rotation
        wrench = np.stack([force[known], torque[known]], 1)  # (K, 2, 3)
        in_world = wrench @ np.swapaxes(R_WL, 1, 2)
        whole = np.isfinite(wrench).all(axis=(1, 2))
        sums += [each[whole, 0].sum(axis=0) / max(len(each), 1) for each in (in_world, wrench)]
        J = np.concatenate([motion.jacobian_at(frame.origin), motion.angular], axis=1)
        efforts[known] += np.einsum("nij,ni->nj", J, in_world.reshape(-1, 6))
    _check_axes(sums, model, log.name)
    found = np.zeros(log.effort.shape)
    found[:, [log.joints.index(joint) for joint in model.joints]] = efforts
    return found


def _check_axes(sums: Array, model: RobotModel, name: str) -> None:
    """Refuse forces that carry the robot by axes of the world, and not by those of links."""
    weight = -model.total_phi[:, 0].sum() * model.tree.gravity
    size = max(float(np.linalg.norm(weight)), 1e-12)
    own, world = np.linalg.norm(sums - weight, axis=1) / size
    if own > _UNLIKE and world < 0.5 * own:
        raise LogError(
            f"Mean forces at the feet of log {name!r} are off the robot's weight by {own:.0%} of "
            f"it in the axes of links, and by {world:.0%} in those of the world.",
            advice="Turn them into the axes of the link that each is named after.",
        )


def _last_links(model: RobotModel) -> tuple[str, ...]:
    """Return the last links of limbs, where a robot may touch the ground."""
    plant, lumps = model.plant, lumped_bodies(model.plant)
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    inner = {int(joint.parent_body().index()) for joint in joints}
    moving = {int(j.parent_body().index()) for j in joints if j.num_velocities()}
    last = [lump for lump in lumps[1:] if not moving & {int(m.index) for m in lump.members}]
    ends = [member for lump in last for member in lump.members if int(member.index) not in inner]
    return tuple(member.name for member in ends)
