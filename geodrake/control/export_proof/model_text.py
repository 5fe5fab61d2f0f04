"""Model files with a model's values: an edited copy of the user's file, or a generated one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis, Quaternion
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import Joint

from geodrake.control.export_proof.joints import (
    ExportedJoint,
    add_actuators,
    changed_numbers,
    exported_joints,
)
from geodrake.effects.file_terms import Tilt
from geodrake.errors import ModelError
from geodrake.inertia import Array, change_frame
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model.export import export_bodies, file_kind, repair_comments
from geodrake.model.robot_model import RobotModel, is_of_file
from geodrake.robot.arrangement import moving_joints
from geodrake.robot.files.checks import words
from geodrake.robot.files.description import model_text_of
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.mjcf_source import unused
from geodrake.robot.files.model_edits import (
    EditedFile,
    comment_words,
    put_inertia,
    put_numbers,
    stated_springs,
)
from geodrake.robot.files.xacro_file import read_expanded
from geodrake.robot.files.xml_text import parse_xml_bytes
from geodrake.robot.joints import joint_names, scoped
from geodrake.robot.plant import motor_joints, scoped_joint_names

_DRAKE = "http://drake.mit.edu"
_ALWAYS = ("damping", "friction")  # written even if 0
_DEFAULT_GRAVITY = [0.0, 0.0, -9.81]  # of simulators, m/s²
_UNLIMITED = 1e9  # effort and speed limits in a URDF, which must have some
SUFFIXES = {"urdf": ".urdf", "sdf": ".sdf", "xml": ".xml"}


@dataclass(frozen=True, eq=False)
class Link:
    """A body moved by a joint; its frame L is the joint's frame on the body."""

    name: str
    parent: str | None  # name of the parent body; None for the world
    joint: ExportedJoint
    X_PL: RigidTransform  # pose in the parent's frame with the joint at zero
    axis: Array  # (3,) unit axis of the joint, in L
    limits: tuple[float, float]  # lower and upper position, rad or m; infinite for none
    phi: Array  # (10,) inertial parameters about Lo, expressed in L
    # Name of the leader joint, r and θ₀ of θ = r θ_leader + θ₀, if this joint follows another.
    follows: tuple[str, float, float] | None = None


def _links_of(model: RobotModel) -> tuple[Link, ...]:
    """Return the links of a model with payloads, each after its parent."""
    plant, joints = model.plant, exported_joints(model)
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.zeros(plant.num_positions()))
    lumps = lumped_bodies(plant)
    moving = sorted(moving_joints(plant), key=lambda joint: joint.velocity_start())
    for joint in moving:
        if joint.type_name() not in ("revolute", "prismatic"):
            raise _refusal(joint, f"has type {joint.type_name()}")
    names = [body.name.replace("::", "_") for body in lumps]
    owner = {int(m.index): k for k, body in enumerate(lumps) for m in body.members}
    inboard = {owner[int(joint.child_body().index())]: joint for joint in moving}
    X_WL = {k: joint.frame_on_child().CalcPoseInWorld(context) for k, joint in inboard.items()}
    links: dict[int, Link] = {}
    while len(links) < len(lumps):
        ready = {
            k: joint
            for k, joint in inboard.items()
            if k not in links
            and ((parent := owner.get(int(joint.parent_body().index()))) is None or parent in links)
        }
        if not ready:
            raise _refusal(moving[0], "points from a body to its parent")
        for k, joint in ready.items():
            parent = owner.get(int(joint.parent_body().index()))
            X_WP = RigidTransform() if parent is None else X_WL[parent]
            X_WR = plant.get_body(lumps[k].body_index).body_frame().CalcPoseInWorld(context)
            X_LR = X_WL[k].inverse() @ X_WR
            turns = joint.type_name() == "revolute"
            axis = joint.revolute_axis() if turns else joint.translation_axis()
            mover, *_ = model.coordinates.moved_by([joint.velocity_start()])
            exported, follows = joints[model.joints[mover]], None
            if (tie := model.followers.get(scoped(joint))) is not None:
                offset, ratio, *_ = tie.coefficients
                follows = exported.name, ratio, offset
                exported = ExportedJoint(joint.name(), scoped(joint), turns)
            links[k] = Link(
                names[k],
                None if parent is None else names[parent],
                exported,
                X_WP.inverse() @ X_WL[k],
                np.array(axis),
                (float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0])),
                change_frame(model.total_phi[k], X_LR.rotation().matrix(), X_LR.translation()),
                follows,
            )
    return tuple(links.values())


def _refusal(joint: Joint, problem: str) -> ModelError:
    return ModelError(
        f"The robot can only be written in its own format: joint {joint.name()} {problem}.",
        advice="Export it in the format of its own file.",
        joint=joint.name(),
    )


def from_plant(model: RobotModel, kind: str, gravity: Array) -> bytes:
    """Return a file of a robot's bodies and joints, without geometry.

    Args:
        gravity: (3,) gravity in the frame of the base, for formats that contain it.
    """
    if model.floating:
        raise ModelError(
            "A floating robot can only be written in the format of its own file.",
            advice=f"Choose that of {model.path.name}.",
        )
    name = model.path.name.partition(".")[0]
    root = _WRITERS[kind](_links_of(model), name, gravity)
    for k, comment in enumerate(repair_comments(model)):
        root.insert(k, Comment(comment_words(comment)))
    indent(root)
    return tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _pose(X: RigidTransform) -> tuple[str, str]:
    return words(X.translation()), words(RollPitchYaw(X.rotation()).vector())


def _urdf(links: Sequence[Link], name: str, gravity: Array) -> Element:
    root = Element("robot", {"name": name, "xmlns:drake": _DRAKE})
    SubElement(root, "link", name="world")
    for link in links:
        put_inertia(root, SubElement(root, "link", name=link.name), link.phi)
        _urdf_joint(root, link)
    return root


def _urdf_joint(root: Element, link: Link) -> None:
    numbers, limited = link.joint, bool(np.isfinite(link.limits).all())
    kind = "prismatic" if not numbers.turns else "revolute" if limited else "continuous"
    joint = SubElement(root, "joint", name=link.joint.name, type=kind)
    xyz, rpy = _pose(link.X_PL)
    SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    SubElement(joint, "parent", link=link.parent or "world")
    SubElement(joint, "child", link=link.name)
    SubElement(joint, "axis", xyz=words(link.axis))
    limit = {
        "effort": words(min(link.joint.effort, _UNLIMITED)),
        "velocity": words(min(link.joint.velocity, _UNLIMITED)),
    }
    if kind != "continuous":
        low, high = np.clip(link.limits, -_UNLIMITED, _UNLIMITED)
        limit |= {"lower": words(low), "upper": words(high)}
    SubElement(joint, "limit", limit)
    if link.follows:
        leader, ratio, offset = link.follows
        SubElement(joint, "mimic", joint=leader, multiplier=words(ratio), offset=words(offset))
    put_numbers(root, joint, {k: x for k, x in numbers.numbers.items() if x or k in _ALWAYS})


def _sdf(links: Sequence[Link], name: str, gravity: Array) -> Element:
    """Return an SDF, with links renamed if a joint has the same name."""
    taken = unused({link.joint.name for link in links})
    names = {link.name: taken(link.name) for link in links}
    links = [
        replace(link, name=names[link.name], parent=names.get(link.parent or "")) for link in links
    ]
    version = "1.11" if any(link.follows for link in links) else "1.9"  # <mimic> needs 1.11
    root = Element("sdf", {"version": version, "xmlns:drake": _DRAKE})
    model = SubElement(root, "model", name=name)
    for link in links:
        element = SubElement(model, "link", name=link.name)
        SubElement(element, "pose", relative_to=link.joint.name).text = "0 0 0 0 0 0"
        put_inertia(root, element, link.phi)
        _sdf_joint(root, model, link)
    return root


def _sdf_joint(root: Element, model: Element, link: Link) -> None:
    numbers = link.joint
    kind = "revolute" if numbers.turns else "prismatic"
    joint = SubElement(model, "joint", name=link.joint.name, type=kind)
    pose = SubElement(joint, "pose", relative_to=link.parent or "__model__")
    pose.text = " ".join(_pose(link.X_PL))
    SubElement(joint, "parent").text = link.parent or "world"
    SubElement(joint, "child").text = link.name
    axis = SubElement(joint, "axis")
    SubElement(axis, "xyz").text = words(link.axis)
    bounds = dict(zip(("lower", "upper"), link.limits, strict=True))
    limits = bounds | {"effort": link.joint.effort, "velocity": link.joint.velocity}
    limit = SubElement(axis, "limit")
    for key, value in limits.items():
        if np.isfinite(value):
            SubElement(limit, key).text = words(value)
    if link.follows:  # for Gazebo, and for Drake, which reads only its own element
        leader, ratio, offset = link.follows
        terms = {"multiplier": words(ratio), "offset": words(offset)}
        SubElement(joint, "drake:mimic", {"joint": leader, **terms})
        mimic = SubElement(axis, "mimic", joint=leader)
        for key, text in terms.items():
            SubElement(mimic, key).text = text
        SubElement(mimic, "reference").text = "0"
    put_numbers(root, joint, {k: x for k, x in numbers.numbers.items() if x or k in _ALWAYS})


def _mjcf(links: Sequence[Link], name: str, gravity: Array) -> Element:
    root = Element("mujoco", model=name)
    SubElement(root, "compiler", angle="radian")
    SubElement(root, "option", gravity=words(gravity))
    world = SubElement(root, "worldbody")
    bodies: dict[str | None, Element] = {None: world}
    for link in links:
        quaternion = Quaternion(link.X_PL.rotation().matrix()).wxyz()
        pose = {"pos": words(link.X_PL.translation()), "quat": words(quaternion)}
        body = SubElement(bodies[link.parent], "body", {"name": link.name, **pose})
        bodies[link.name] = body
        put_inertia(root, body, link.phi)
        joint = SubElement(body, "joint", _mjcf_joint(link))
        put_numbers(root, joint, {k: x for k, x in link.joint.numbers.items() if x})
    following = [link for link in links if link.follows]
    equality = SubElement(root, "equality") if following else root
    for link in following:
        leader, ratio, offset = link.follows or ("", 0.0, 0.0)
        polynomial = words(np.array([offset, ratio, 0.0, 0.0, 0.0]))
        joints = {"joint1": link.joint.name, "joint2": leader}
        SubElement(equality, "joint", {**joints, "polycoef": polynomial})
    return root


def _mjcf_joint(link: Link) -> dict[str, str]:
    numbers = link.joint
    attributes = {
        "name": link.joint.name,
        "type": "hinge" if numbers.turns else "slide",
        "axis": words(link.axis),
    }
    if np.isfinite(link.limits).all():
        attributes |= {"range": words(np.array(link.limits)), "limited": "true"}
    if numbers.driven and np.isfinite(numbers.effort):
        attributes["actuatorfrcrange"] = words(np.array([-link.joint.effort, link.joint.effort]))
        attributes["actuatorfrclimited"] = "true"
    return attributes | (_STICKING if numbers.friction else {})


_STICKING = {"solreffriction": "0.004 1", "solimpfriction": "0.9999 0.9999 0.001 0.5 2"}
"""Solver parameters of dry friction. With MuJoCo's defaults joints creep by centimetres per minute.
The first number is twice MuJoCo's default time step, s, the smallest stable value."""

_WRITERS: Mapping[str, Callable[[Sequence[Link], str, Array], Element]] = {
    "urdf": _urdf,
    "sdf": _sdf,
    "xml": _mjcf,
}


def written_kind(model: RobotModel, kinds: Sequence[str]) -> str:
    """Return the one of `kinds` that the robot's own file has, or else the first."""
    kind = own_kind(model)
    return kind if kind in kinds else kinds[0]


def own_kind(model: RobotModel) -> str:
    """Return the format of the robot's file if it can be edited; "" for directives."""
    return "" if model.path.suffix.lower() in (".yaml", ".yml") else file_kind(model)


def sprung_in_file(model: RobotModel) -> set[str]:
    """Return the joints with springs for Gazebo or Drake in the robot's own URDF."""
    if own_kind(model) != "urdf":
        return set()
    root = parse_xml_bytes(read_expanded(model.path, model.given), model.path)
    names = {name: joint.scoped for name, joint in exported_joints(model).items()}
    return {n for n, scope in names.items() if stated_springs(root, scope.rpartition("::")[2])}


def stands_as_it_is(model: RobotModel, kind: str) -> bool:
    """Return whether an export copies the model's own MJCF with its effects unchanged."""
    return kind == "xml" == own_kind(model) and is_of_file(model)


def model_file(
    model: RobotModel, kind: str, folder: Path, *, stands: bool = False
) -> tuple[str, bytes, tuple[str, ...]]:
    """Return the name and content of a model file, and notes.

    It is an edited copy of the user's file if that has the format (expanded from xacro), and
    otherwise a generated file of bodies and joints.

    Args:
        folder: Future folder of the file, to which relative paths refer.
        stands: Whether the effects of the user's file do not change.
    """
    name = f"{model.path.name.partition('.')[0]}{SUFFIXES[kind]}"
    if own_kind(model) == kind:
        macros = model.path.suffix.lower() == ".xacro"
        return name if macros else model.path.name, *_edited(model, folder, stands)
    note = (
        f"{name} is generated from the bodies and joints of {model.path.name}, without "
        "geometry; welded links are merged"
    )
    data, gravity = from_plant(model, kind, _tilted_gravity(model)), _gravity(model)
    if kind != "xml":
        if gravity.tolist() == _DEFAULT_GRAVITY:
            return name, data, (note,)
        values = " ".join(f"{x:g}" for x in gravity)
        gravity_note = f"{name} does not contain gravity; set it to {values} m/s² in the simulator"
        return name, data, (note, gravity_note)
    file = EditedFile(data, folder / name)
    more = add_actuators(file, model, anew=True)
    return name, file.content, (note, *more)


def _edited(model: RobotModel, folder: Path, stands: bool) -> tuple[bytes, tuple[str, ...]]:
    """Return the user's file with the model's values, and notes.

    Passive forces of an MJCF that do not belong to a joint are removed unless `stands`.
    """
    exported, path = export_bodies(model), model.path
    file, changes = EditedFile(exported.content, path), {} if stands else changed_numbers(model)
    if not stands and file.drop_passive_forces():
        changes = {joint.scoped: joint.numbers for joint in exported_joints(model).values()}
    text = model_text_of(read_expanded(path, model.given), path)
    if isinstance(text, MjcfText) and text.degrees:
        for joint in exported_joints(model).values():
            if joint.turns and "rest" in changes.get(joint.scoped, {}):
                changes[joint.scoped]["rest"] = float(np.rad2deg(joint.rest))
    file.set_joint_numbers(changes)
    notes = _notes_on_limits(model)
    if text.kind == "xml":
        if any(isinstance(fitted.effect, Tilt) for fitted in model.effects):
            file.set_gravity(_tilted_gravity(model))
        notes = add_actuators(file, model, anew=False)
    notes = (*notes, *_notes_on_motors(model))
    if file.move_references(folder):
        note = f"meshes and other files of {path.name} are not copied; the copy "
        notes = (*notes, f"{note}refers to them from its folder")
    return file.content, (*exported.notes, *notes)


def _notes_on_limits(model: RobotModel) -> tuple[str, ...]:
    """Return a note on effort limits from logs that the user's file does not contain."""
    known = model.known_effort_limits
    limits = [
        f"{joint} {limit:.3g} {'N' if joint in model.sliding_joints else 'N·m'}"
        for joint, limit, file_limit in zip(model.joints, known, model.effort_limits, strict=True)
        if limit != file_limit
    ]
    note = f"effort limits in {model.path.name} are unchanged; the model knows lower ones: "
    return (f"{note}{', '.join(limits)}",) if limits else ()


def _notes_on_motors(model: RobotModel) -> tuple[str, ...]:
    """Return a note on motors in the user's file at joints without a motor in logs."""
    names = zip(joint_names(model.plant), scoped_joint_names(model.plant), strict=True)
    motors = {name for name, scoped in names if scoped in motor_joints(model.plant)}
    limited = zip(model.joints, np.isfinite(model.effort_limits), strict=True)
    motors |= {joint for joint, has_limit in limited if has_limit}
    joints = ", ".join(joint for joint in model.motorless if joint in motors)
    note = f"{joints} had no motor in logs, but {model.path.name} has one, which the copy keeps"
    return (note,) if joints else ()


def _tilted_gravity(model: RobotModel) -> Array:
    """Return (3,) gravity in the frame of a model's tilted base, m/s²."""
    return np.asarray(tilt_rotation(model).T @ _gravity(model))


def _gravity(model: RobotModel) -> Array:
    """Return (3,) gravity in the world of a model's file, m/s²."""
    return np.array(model.plant.gravity_field().gravity_vector())


def tilt_rotation(model: RobotModel) -> Array:
    """Return (3, 3) rotation R(θ) of a model's base relative to its file."""
    rotation = np.eye(3)
    for fitted in model.effects:
        if isinstance(fitted.effect, Tilt):
            vector = np.array([*fitted.parameters, 0.0])
            angle = float(np.linalg.norm(vector))
            if angle:
                rotation = AngleAxis(angle, vector / angle).rotation() @ rotation
    return np.asarray(rotation)
