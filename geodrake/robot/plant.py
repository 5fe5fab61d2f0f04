"""Model files as plants of rigid bodies, and the parameters of such plants.

A loaded plant has rigid-body dynamics only. Damping, dry friction and rotor inertia in the file are
moved from the plant to `LoadedPlant.terms`, because they are effects in geodrake. Unphysical
inertias are repaired and reported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Joint, JointActuator, RigidBody, SpatialInertia
from pydrake.systems.framework import Context
from scipy.cluster.hierarchy import DisjointSet

from geodrake.boundary.arguments import instance, number, real_array, typed
from geodrake.errors import ModelError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, inertial_parameters, to_spatial_inertia
from geodrake.inertia.bodies import Member, lumped_bodies
from geodrake.robot.arrangement import (
    Arrangement,
    Opened,
    add_base_joints,
    base_joints,
    checked_held,
    chosen_robot,
    ends_of,
    geared,
    open_loops,
    poses_of,
    robots_of,
    weld_joints,
    welds_of,
)
from geodrake.robot.files import Given, ModelDescription
from geodrake.robot.files.checks import check_poses
from geodrake.robot.files.description import drake_errors, drake_messages, read_description
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.named_robots import robot_file
from geodrake.robot.joints import (
    Tie,
    joint_names,
    joints_of,
    resolved,
    scoped,
    single_joints,
)
from geodrake.robot.loops import LoopJoints, Loops, closed_loops
from geodrake.robot.repairs import Repair, repair_inertias
from geodrake.robot.stated import CutJoint, FileTerms, StatedLength
from geodrake.robot.transmission.loop import LoopTransmission
from geodrake.robot.transmission.schema import Gear

_WORLD = 0
_LIMIT = "limit of "  # prefix of actuators that only limit efforts
_SAME = 1e-9  # tolerance of a body's parameters after writing, relative to the largest


@dataclass(frozen=True, eq=False)
class BuiltPlant:
    """A plant of rigid bodies, and the elements removed from it."""

    plant: MultibodyPlant
    lengths: list[StatedLength]  # damping and reflected inertia of joints
    notes: tuple[str, ...]
    opened: Opened


@dataclass(frozen=True)
class LoadedPlant:
    """A robot read from a model file."""

    plant: MultibodyPlant  # finalized, continuous in time, without damping, friction and rotors
    path: Path
    repairs: tuple[Repair, ...]  # bodies with unphysical inertia, and the repaired inertia
    thin: tuple[Repair, ...]  # unchanged bodies without volume, and their inertia in fits
    changes: tuple[str, ...]  # sentences on changed inertias, repairs first
    notes: tuple[str, ...]  # sentences on other interpretations of the file
    terms: FileTerms  # elements of the file other than rigid bodies, which the plant lacks
    left_out: tuple[str, ...]  # sentences on ignored elements that affect efforts
    loops: tuple[LoopTransmission, ...]  # closed loops of the plant's joints
    closing: tuple[CutJoint, ...]  # joints that close loops and are not in the plant
    held: Mapping[str, float]  # fixed joint -> position
    places: Mapping[str, float]  # the same by scoped names, with followers of fixed joints
    given: Given
    followers: Mapping[str, Tie]  # following joint of the plant, by scoped name -> its tie
    joints: tuple[str, ...]  # joints of one degree of freedom in the file, fixed and following too
    geared: tuple[str, ...]  # joints with motors in the file that move differently
    mjcf: MjcfText | None  # the text of a single MJCF file with known inertias


def load_plant(
    path: str | Path,
    *,
    floating: bool = False,
    held: Mapping[str, float] | None = None,
    given: Given | None = None,
    phi: ArrayLike | None = None,
    into: MultibodyPlant | None = None,
) -> LoadedPlant:
    """Read a robot from a model file or by name, as `geodrake.load_model` does.

    Geometry is not loaded, so meshes and packages may be missing. Closed loops are open in the
    plant, and described by `loops`; following joints are `followers`.

    Args:
        floating: Leave bodies free that the file does not attach to the world, on six joints each
            (`geodrake.robot.arrangement`); otherwise weld each root to the world at its pose in the
            file.
        held: Joint of one degree of freedom -> position at which it is fixed, rad or m.
        phi: (nb, 10) inertial parameters in place of the file's, assigned to the representative of
            each lumped body.
        into: An empty plant for the robot, which is finalized; by default a new one, continuous in
            time.
    """
    given = Given() if given is None else instance(given, "given", Given)
    path, given, origin = robot_file(path, given)
    held = {} if held is None else instance(held, "held", Mapping)
    held = {name: number(value, f"held[{name!r}]") for name, value in held.items()}
    with drake_messages() as messages:
        description = read_description(path, given)
        draft, arrangement, loops = _draft(description, floating=floating, held=held, given=given)
        repairs, weightless, changed = repair_inertias(description, draft.plant)
        if any(repair.is_thin for repair in repairs) and not _moves(
            _build(description, arrangement).plant
        ):
            repairs, weightless, _ = repair_inertias(description, draft.plant, keep_thin=False)
        if phi is not None:
            _write_inertias(description, draft.plant, phi)
            changed = True
        built = draft
        if changed or into is not None:
            built = _build(description, arrangement, into)
        if phi is not None:
            _check_inertias(built.plant, phi, path)
    terms, plant = description.terms, built.plant
    hinges = built.opened.hinges
    lengths = [
        replace(each, shares={hinges.get(joint, joint): c for joint, c in each.shares.items()})
        for each in (*built.lengths, *terms.lengths)
    ]
    terms = replace(terms, lengths=lengths)
    ignored = _ignored_ties(description, arrangement)
    has_others = plant.num_constraints() or plant.num_force_elements() > 1  # besides gravity
    left_out = ["Constraints and springs that only Drake reads are ignored."] if has_others else []
    left_out += [
        *built.opened.left_out,
        *terms.left_out,
        *(terms.of_bases if floating else ()),
        *ignored,
        *loops.left_out,
    ]
    ties = {own: t for own, t in arrangement.followers.items() if own not in loops.taken}
    names = {scoped(joint): name for name, joint in _single_joints(plant).items()}
    pairs = ", ".join(f"{names[own]} follows {names[tie.leader]}" for own, tie in ties.items())
    follow = [f"{pairs}, and is not independent."] if pairs else []
    changes, thin = (tuple(r for r in repairs if r.is_thin is kind) for kind in (False, True))
    notes = [*origin, *terms.notes, *map(str, thin), *built.notes, *follow, *loops.notes]
    first_lines = [message.partition("\n")[0].rpartition("warning: ")[2] for message in messages]
    warnings = [f"Drake: {line}" for line in first_lines if "inertia" in line or "mass" in line]
    moving_cuts = {loop.joints[k] for loop in loops.loops for k in loop.cut}
    cut_joints = (each.cut for each in [*terms.closures, *built.opened.closures])
    closing = tuple(cut for cut in cut_joints if cut is not None and cut.name in moving_cuts)
    (text, *has_others), whole = description.texts, None
    if isinstance(text, MjcfText) and text.reference is not None and not has_others:
        whole = text
    return LoadedPlant(
        plant,
        path,
        changes,
        thin,
        _unique([*map(str, changes), *weightless, *terms.lost, *warnings]),
        _unique(notes),
        terms,
        _unique(left_out),
        loops.loops,
        closing,
        held={**loops.held, **held},
        places=arrangement.places,
        given=given,
        followers=ties,
        joints=(*arrangement.joints, *(cut.name for cut in closing)),
        # Gears of MJCF's actuators do not count, as most only scale efforts.
        geared=tuple(
            names.get(x, _short_name(x)) for is_alike, x in _motors(description) if not is_alike
        ),
        mjcf=whole,
    )


def _moves(plant: MultibodyPlant) -> bool:
    """Return whether all joints of a plant have inertia, so that forward dynamics exist."""
    context, random = plant.CreateDefaultContext(), np.random.default_rng(0)
    plant.SetPositions(context, random.uniform(-1.0, 1.0, plant.num_positions()))
    M = plant.CalcMassMatrix(context)
    size = np.sqrt(np.diagonal(M))
    return bool((size > 0.0).all() and np.linalg.eigvalsh(M / np.outer(size, size))[0] > _SAME)


def _unique(sentences: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(sentences))


def _motors(description: ModelDescription) -> Iterator[tuple[bool, str]]:
    """Yield whether a motor in the file moves like its joint, and the joint's scoped name."""
    for text in description.every:
        with suppress(ModelError):  # reported only if the user asks for the transmission
            for part in text.motors():
                is_alike = isinstance(part, Gear) and (
                    text.kind == "xml" or (part.ratio, part.offset, part.rotor) == (1.0, 0.0, "")
                )
                yield from ((is_alike, f"{text.scope}::{joint}") for joint in part.joint_names())


def _draft(
    description: ModelDescription, *, floating: bool, held: Mapping[str, float], given: Given
) -> tuple[BuiltPlant, Arrangement, Loops]:
    """Return the unrepaired plant of the chosen robot, with its joints fixed."""
    arrangement = Arrangement(floating)
    draft = _build(description, arrangement)
    if given.robot is not None:
        robot = chosen_robot(draft.plant, given.robot, description.path)
        others = [joint for r in robots_of(draft.plant) if r != robot for joint in r.joints]
        aside = poses_of(draft.plant, others)
        arrangement = replace(arrangement, aside=aside, robot=robot.bodies)
        draft = _build(description, arrangement)
    joints, terms = _single_joints(draft.plant), description.terms
    names = [scoped(joint) for joint in joints.values()]
    for box in terms.gearboxes:
        own, tie = geared(draft.plant, box) or ("", Tie("", ()))
        if own in terms.followers or own not in resolved({**terms.followers, own: tie}, names):
            reason = f"{own} follows already" if own else "its links turn about other axes"
            terms.left_out.append(f"{box.name} is ignored, as {reason}.")
        else:
            terms.followers[own] = tie
            terms.driven.add(tie.leader)
    followers = resolved(terms.followers, names)
    arrangement = replace(arrangement, followers=followers, joints=tuple(joints))
    stated = dict(description.terms.fixed)
    for own, tie in followers.items():  # a fixed follower fixes its leader
        if own in stated:
            stated.setdefault(tie.leader, tie.leader_at(stated.pop(own)))
    fixed = {name: stated[scoped(j)] for name, j in joints.items() if scoped(j) in stated}
    held = {**fixed, **held}
    base = {joint.name() for joint in chain(*base_joints(draft.plant))}
    if of_base := sorted(base.intersection(held)):
        raise ModelError(
            f"{of_base[0]!r} is a coordinate of the free base, and cannot be fixed alone.",
            advice="Omit `floating` for a fixed base.",
        )
    first = (*held, *given.leading)
    loops = _loops(description, draft, followers, LoopJoints(first=first))
    start, still = loops.places(held, description.path)
    if held or still:
        places = checked_held(joints, followers, {**still, **held}, description.path)
        still = {name: held[name] for name in fixed} | still
        if len(places) == draft.plant.num_velocities():
            what = f"All joints of {description.path} are fixed, so nothing moves."
            advice = "Free at least one of them."
            if still:
                what = f"No joint of {description.path} moves: constraints fix {', '.join(still)}."
                advice = "Correct the constraints; a redundant one may lock a linkage."
            raise ModelError(what, advice=advice)
        arrangement = replace(
            arrangement,
            held=poses_of(draft.plant, places, places),
            places=places,
            followers={own: tie for own, tie in followers.items() if own not in places},
        )
        draft = _build(description, arrangement)
        how = LoopJoints(first=given.leading, start=start)
        loops = replace(_loops(description, draft, arrangement.followers, how), held=still)
    return draft, arrangement, loops


def _loops(
    description: ModelDescription, built: BuiltPlant, followers: Mapping[str, Tie], how: LoopJoints
) -> Loops:
    """Return the closed loops of a plant of a description."""
    plant, terms = built.plant, description.terms
    closures = [*terms.closures, *built.opened.closures]
    if not closures:
        return Loops()
    stiffness, single = dict[str, float](), {scoped(j): n for n, j in _single_joints(plant).items()}
    limited = [scoped(a.joint()) for a in _actuators(plant) if np.isfinite(a.effort_limit())]
    driven = {single[joint] for joint in (*limited, *terms.driven) if joint in single}
    driven |= {each.cut.name for each in closures if each.cut and each.cut.driven}
    for length in terms.lengths:
        (joint, share), *others = length.shares.items()
        if joint in single and not others:
            value = share**2 * length.spring.coefficients[1]
            stiffness[single[joint]] = stiffness.get(single[joint], 0.0) + value
    sprung = sorted((n for n, k in stiffness.items() if k > 0.0), key=lambda n: -stiffness[n])
    how = replace(how, followers=followers, driven=driven, sprung=sprung)
    loops = closed_loops(plant, closures, path=description.path, how=how)
    if loops.left_out and built.opened.closures:
        raise ModelError(
            f"{description.path}: {loops.left_out[0]}",
            advice="Use loop joints that rotate about or slide along one axis.",
        )
    return loops


def _single_joints(plant: MultibodyPlant) -> dict[str, Joint]:
    """Return the joints of one degree of freedom by name, in the order of their velocities."""
    names = joint_names(plant)
    return {names[joint.velocity_start()]: joint for joint in single_joints(plant)}


def _ignored_ties(description: ModelDescription, arrangement: Arrangement) -> list[str]:
    """Return notes on joints that cannot follow as the file requires."""
    still, stated = arrangement.held.keys(), description.terms.followers
    ignored = [
        f"{_short_name(follower)} (of {_short_name(tie.leader)})"
        for follower, tie in stated.items()
        if follower not in {*arrangement.followers, *arrangement.aside}
        and not {follower, tie.leader} <= still
    ]
    what = "<equality>" if description.texts[0].kind == "xml" else "<mimic>"
    words = f"{what} is ignored, as it has no joint to follow: {', '.join(ignored)}."
    return [words] if ignored else []


def _short_name(name: str) -> str:
    return name.rpartition("::")[2]


def _build(
    description: ModelDescription, arrangement: Arrangement, plant: MultibodyPlant | None = None
) -> BuiltPlant:
    plant = MultibodyPlant(time_step=0.0) if plant is None else plant
    description.add_to(plant)
    terms = description.terms
    with drake_errors(description.path):
        lengths = list[StatedLength]()
        for joint in joints_of(plant):
            damping, scoped_name = joint.default_damping_vector().tolist(), scoped(joint)
            for k, c in enumerate(damping):
                name = scoped_name if len(damping) == 1 else f"{scoped_name}[{k}]"
                lengths += [StatedLength({name: 1.0}, damping=(c, 0.0, 0.0))] if c else []
        for actuator in _actuators(plant):
            rotor = actuator.default_reflected_inertia()
            lengths.append(StatedLength({scoped(actuator.joint()): 1.0}, armature=rotor))
            actuator.set_default_rotor_inertia(0.0)
        opened = open_loops(plant)
        weld_joints(plant, arrangement.held)
        weld_joints(plant, arrangement.aside, aside=True)
        notes = _root_notes(plant, arrangement)
        _limit_efforts(plant, description)
        for joint in joints_of(plant):
            joint.set_default_damping_vector(np.zeros(joint.num_velocities()))
            start = terms.start.get(scoped(joint), 0.0)
            if start and joint.num_positions() == 1:
                joint.set_default_positions([start])
        plant.Finalize()
        check_poses(plant, description.path)
    if plant.num_velocities() == 0:
        links = plant.num_bodies() - 1
        why = f"its {links} links are welded to the world" if links else "it has no links"
        advice = "Give a model with moving joints, or load it as a floating base."
        if terms.static:
            why += f", as <static> of {', '.join(sorted(terms.static))} says"
            advice = "Remove <static>, or give a model with moving joints."
        raise ModelError(f"No joint of {description.path} moves: {why}.", advice=advice)
    return BuiltPlant(plant, lengths, (*notes, *opened.notes), opened)


def _write_inertias(description: ModelDescription, plant: MultibodyPlant, phi: ArrayLike) -> None:
    """Write inertial parameters (nb, 10) of a plant into its description."""
    lumps = lumped_bodies(plant)
    phi = real_array(phi, "phi", (len(lumps), PARAMETERS_PER_BODY))
    for body, parameters in zip(lumps, phi, strict=True):
        for member in body.members:
            own = parameters if member.index == body.body_index else None
            description.set_inertia(member.scoped_name, own)


def _check_inertias(plant: MultibodyPlant, phi: ArrayLike, path: Path) -> None:
    """Raise if a plant's inertial parameters differ from those written."""
    actual, wanted = inertial_parameters(plant), np.asarray(phi, float)
    size = np.abs(wanted).max(axis=1)
    wrong = np.flatnonzero(np.abs(actual - wanted).max(axis=1) > _SAME * size)
    if len(wrong):
        body = lumped_bodies(plant)[wrong[0]].name
        raise ModelError(
            f"A plant of {path} cannot have the inertial parameters of {body!r} by default: "
            f"they are {wanted[wrong[0]].tolist()}, but Drake makes them "
            f"{actual[wrong[0]].tolist()}.",
            advice="Use the model's plant, and its create_context() in a simulation.",
        )


def _root_notes(plant: MultibodyPlant, arrangement: Arrangement) -> list[str]:
    """Weld free roots to the world unless they float; return notes."""
    robot, floating = arrangement.robot, arrangement.floating
    roots = [b for b in free_roots(plant) if robot is None or int(b.index()) in robot]
    weld_roots(plant, lambda body: floating and body in roots)
    if floating:
        return [] if roots else ["The file attaches the robot to the world, so it cannot float."]
    if not roots[1:]:
        return []
    names, robots = ", ".join(body.name() for body in roots), [r.name for r in robots_of(plant)]
    note = f"{names} are not attached to anything; each is welded to the world."
    if robots[1:]:
        note += f" Robots in the file are {', '.join(robots)}; choose one by name."
    return [note]


def arrange_as(plant: MultibodyPlant, other: MultibodyPlant) -> None:
    """Weld parts of a plant before finalization as in another plant of the same file."""
    open_loops(plant)
    weld_joints(plant, welds_of(other))
    weld_joints(plant, welds_of(other, aside=True), aside=True)
    context, standing = other.CreateDefaultContext(), set[int]()
    for body in free_roots(plant):
        instance = other.GetModelInstanceByName(plant.GetModelInstanceName(body.model_instance()))
        same = other.GetBodyByName(body.name(), instance)
        plant.SetDefaultFloatingBaseBodyPose(body, same.EvalPoseInWorld(context))
        if other.IsAnchored(same):
            standing.add(int(body.index()))
    weld_roots(plant, lambda body: int(body.index()) not in standing)


def weld_roots(
    plant: MultibodyPlant, floats: Callable[[RigidBody], bool] = lambda body: False
) -> None:
    """Weld free roots to the world at their poses in the file, or put them on six joints."""
    for body in free_roots(plant):
        if floats(body):
            add_base_joints(plant, body)
        else:
            X_WB = plant.GetDefaultFloatingBaseBodyPose(body)
            plant.WeldFrames(plant.world_frame(), body.body_frame(), X_WB)


def free_roots(plant: MultibodyPlant) -> list[RigidBody]:
    """Return the roots of all trees that no joint connects to the world."""
    trees, children = DisjointSet(range(plant.num_bodies())), set[int]()
    for parent, child in map(ends_of, joints_of(plant)):
        trees.merge(parent, child)
        children.add(child)
    tops = (tree - children for tree in trees.subsets() if _WORLD not in tree)
    return [plant.get_body(BodyIndex(body)) for body in sorted(min(top) for top in tops if top)]


def motor_joints(plant: MultibodyPlant) -> frozenset[str]:
    """Return scoped names of the joints with an actuator or a transmission in the model file."""
    stated = (a for a in _actuators(plant) if not a.name().startswith(_LIMIT))
    return frozenset(scoped(actuator.joint()) for actuator in stated)


def _limit_efforts(plant: MultibodyPlant, description: ModelDescription) -> None:
    """Set the effort limits in the file that Drake does not read, adding actuators for them."""
    actuators = {int(a.joint().index()): a for a in _actuators(plant)}
    efforts, driven = description.terms.effort, {n for _, n in _motors(description)}
    for joint in joints_of(plant):
        limit = efforts.get(scoped(joint), 0.0)
        is_driven = scoped(joint) in driven
        if joint.num_velocities() != 1 or not (limit > 0 or is_driven):
            continue
        if int(joint.index()) not in actuators:
            name = joint.name() if is_driven else f"{_LIMIT}{joint.name()}"
            plant.AddJointActuator(name, joint, limit if limit > 0 else np.inf)
        elif limit > 0:
            actuators[int(joint.index())].set_effort_limit(limit)


def _actuators(plant: MultibodyPlant) -> list[JointActuator]:
    return [plant.get_joint_actuator(i) for i in plant.GetJointActuatorIndices()]


def set_inertial_parameters(plant: MultibodyPlant, context: Context, phi: ArrayLike) -> None:
    """Write inertial parameters (nb, 10), as of `inertial_parameters`, into a plant's context.

    They need not be physical. The representative of each lumped body gets all of its inertia; links
    welded to it become massless.
    """
    set_lump_inertias(plant, context, [body.members for body in lumped_bodies(plant)], phi)


def set_lump_inertias(
    plant: MultibodyPlant, context: Context, lumps: Sequence[Sequence[Member]], phi: ArrayLike
) -> None:
    """Write inertial parameters (nb, 10) of groups of links into their first links."""
    phi = real_array(phi, "phi", (len(lumps), PARAMETERS_PER_BODY))
    for members, parameters in zip(lumps, phi, strict=True):
        inertias = [to_spatial_inertia(parameters)] + [SpatialInertia.Zero()] * (len(members) - 1)
        for member, inertia in zip(members, inertias, strict=True):
            plant.get_body(member.index).SetSpatialInertiaInBodyFrame(context, inertia)


def scoped_joint_names(plant: MultibodyPlant) -> tuple[str, ...]:
    """Return the joint of each velocity (nv), as `robot::joint`."""
    names = {
        joint.velocity_start() + k: scoped(joint)
        for joint in joints_of(plant)
        for k in range(joint.num_velocities())
    }
    return tuple(names[k] for k in range(plant.num_velocities()))


@typed
def effort_limits(plant: MultibodyPlant) -> Array:
    """Return the largest efforts (nv,) of the plant's actuators, N·m or N; infinite without."""
    limits = np.full(plant.num_velocities(), np.inf)
    for actuator in _actuators(plant):
        limits[actuator.joint().velocity_start()] = actuator.effort_limit()
    return limits
