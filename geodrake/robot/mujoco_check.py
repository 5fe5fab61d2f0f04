"""The robot of an MJCF against MuJoCo's own inverse dynamics, each time that a file is read.

At a few random states, the effort of the plant with what the file states of its joints and tendons
has to be that of MuJoCo without what is left out. Dry friction, limits and contacts, which are soft
in MuJoCo, take no part, nor do carried weights, media and struts, on which `geodrake check` has
MuJoCo's opinion. Free bodies rest where the file puts them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.math import RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, JointIndex, MultibodyForces

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files import ModelDescription
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.mjcf_source import load_mujoco, quiet_mujoco
from geodrake.robot.followers import scoped
from geodrake.robot.stated import BuiltPlant

_STATES = 3
_TOLERANCE = 1e-9  # of the largest effort
_APART = 1e-4  # of the size, by which loops of rounded numbers may be open
_SPEED, _ACCELERATION = 2.0, 5.0
_FAR = 3.0  # rad or m, where limits leave a choice
_BUG = "This is a bug in geodrake; please report it with the file."


def check_against_mujoco(description: ModelDescription, built: BuiltPlant) -> None:
    """Compare a plant with what MuJoCo compiled, where its file is an MJCF.

    Args:
        built: Its plant, all of whose joints move, before repairs of inertias.
    """
    text = _compiled(description)
    if text is None or description.directives is not None or text.terms.set_aside:
        return  # of a thin body, say, whose repair is told of
    places = _places(text, built.plant)
    rng = np.random.default_rng(0)
    errors, largest = np.zeros(len(places)), 0.0
    for _ in range(_STATES):
        ours, theirs = _efforts(built, text, places, rng)
        for k, (own, other) in enumerate(zip(ours, theirs, strict=True)):
            errors[k] = max(errors[k], float(np.abs(own - other).max(initial=0.0)))
            largest = max(largest, float(np.abs(other).max(initial=0.0)))
    if len(errors) and not errors.max() <= _TOLERANCE * max(largest, 1e-12):
        joint, _ = places[int(np.argmax(errors))]
        body = joint.child_body().name()
        raise ModelError(
            f"{description.path}: geodrake does not read the joint {joint.name()} or the body "
            f"{body} as MuJoCo does: efforts differ by up to {errors.max():.3g}, of {largest:.3g}.",
            advice=_BUG,
            path=description.path,
            body=body,
        )


def _compiled(description: ModelDescription) -> MjcfText | None:
    text, *others = description.texts
    is_whole = isinstance(text, MjcfText) and text.reference is not None and not others
    return text if is_whole else None  # type: ignore[return-value]


def check_loops_against_mujoco(
    description: ModelDescription, plant: MultibodyPlant, states: tuple[Array, Array]
) -> None:
    """Compare closed loops with MuJoCo's constraints, where their file is an MJCF.

    Args:
        plant: Its plant, all of whose joints move.
        states: Positions (N, nq) and velocities (N, nv) of the plant at which the loops are closed.
    """
    text = _compiled(description)
    if text is None:
        return
    m = text.compiled
    data, numbers = load_mujoco().MjData(m), _numbers(m, plant, (1,))
    for at in range(m.neq):
        data.eq_active[at] = at in text.closing
    closing = list(text.closing)
    places = np.concatenate([m.body_pos.ravel(), m.eq_data[closing, :6].ravel()])
    size = float(np.abs(places).max(initial=1e-3))
    equality = int(load_mujoco().mjtConstraint.mjCNSTR_EQUALITY)
    for q, v in zip(*states, strict=True):
        for joint, at in numbers:
            data.qpos[m.jnt_qposadr[at]] = q[joint.position_start()]
            data.qvel[m.jnt_dofadr[at]] = v[joint.velocity_start()]
        with quiet_mujoco():
            load_mujoco().mj_forward(m, data)
        own = np.array(data.efc_type) == equality
        apart = np.concatenate([data.efc_pos[own], data.efc_vel[own]])
        if not np.abs(apart).max(initial=0.0) <= _APART * size:
            raise ModelError(
                f"{description.path}: geodrake does not close its loops as MuJoCo does: they come "
                f"apart by up to {np.abs(apart).max():.3g} m or rad.",
                advice=_BUG,
                path=description.path,
            )


def _numbers(m: Any, plant: MultibodyPlant, sizes: tuple[int, ...]) -> list[tuple[Joint, int]]:
    """Return joints of as many velocities as positions, and their numbers in MuJoCo's model."""
    mujoco, found = load_mujoco(), []
    for joint in (plant.get_joint(JointIndex(i)) for i in plant.GetJointIndices()):
        at = mujoco.mj_name2id(m, mujoco.mjtObj.mjOBJ_JOINT, joint.name())
        if joint.num_velocities() == joint.num_positions() in sizes and at >= 0:
            found.append((joint, at))
    return found


def _places(text: MjcfText, plant: MultibodyPlant) -> list[tuple[Joint, int]]:
    """Return the plant's moving joints, but free ones, and their numbers in MuJoCo's model."""
    m, free = text.reference, load_mujoco().mjtJoint.mjJNT_FREE
    found = [(joint, at) for joint, at in _numbers(m, plant, (1, 3)) if int(m.jnt_type[at]) != free]
    count = sum(int(kind) != free for kind in m.jnt_type)
    if len(found) != count:
        raise ModelError(
            f"{text.path}: MuJoCo has {count} joints there, and geodrake {len(found)}.",
            advice=_BUG,
            path=text.path,
        )
    return found


def _efforts(
    built: BuiltPlant, text: MjcfText, places: list[tuple[Joint, int]], rng: np.random.Generator
) -> tuple[list[Array], list[Array]]:
    """Return efforts at a random state, the plant's and MuJoCo's, N·m or N.

    Both have one (1,) or, of a ball, (3,) for each of `places`, along MuJoCo's velocities.
    """
    plant, m, mujoco = built.plant, text.reference, load_mujoco()
    data = mujoco.MjData(m)
    context = plant.CreateDefaultContext()
    q, v, vd = plant.GetPositions(context), *np.zeros((2, plant.num_velocities()))
    turns = []
    for joint, at in places:
        start, first = joint.position_start(), joint.velocity_start()
        to, dof = int(m.jnt_qposadr[at]), int(m.jnt_dofadr[at])
        count = joint.num_velocities()
        speed, rate = _SPEED * rng.uniform(-1, 1, count), _ACCELERATION * rng.uniform(-1, 1, count)
        data.qvel[dof : dof + count], data.qacc[dof : dof + count] = speed, rate
        turn = np.eye(count)
        if count == 1:
            low, high = m.jnt_range[at] if m.jnt_limited[at] else (-1.5, 1.5)
            if low < _FAR and high > -_FAR:
                low, high = max(low, -_FAR), min(high, _FAR)
            q[start] = data.qpos[to] = rng.uniform(low, high)
        else:  # a ball, turned by roll, pitch and yaw; rates are in the body, and here outside
            angles = rng.uniform(-1.0, 1.0, 3)
            q[start : start + 3] = angles
            rpy = RollPitchYaw(angles)
            data.qpos[to : to + 4] = rpy.ToQuaternion().wxyz()
            turn = rpy.ToRotationMatrix().matrix()
        v[first : first + count] = turn @ speed
        vd[first : first + count] = turn @ rate
        turns.append(turn)
    plant.SetPositions(context, q)
    plant.SetVelocities(context, v)
    with quiet_mujoco():
        mujoco.mj_inverse(m, data)
    effort = plant.CalcInverseDynamics(context, vd, MultibodyForces(plant))
    effort -= plant.CalcGravityGeneralizedForces(context)
    effort += v * (built.damping + np.abs(v) * built.powers[0] + v**2 * built.powers[1])
    effort += built.rotor_inertia * vd
    starts = {scoped(j): (j.position_start(), j.velocity_start()) for j, _ in places}
    for tendon in text.terms.tendons:
        along = np.array([*tendon.shares.values()])
        at_q, at = np.array([starts[joint] for joint in tendon.shares]).T
        stretch = along @ q[at_q] - tendon.length
        pull = tendon.stiffness * stretch + tendon.damping * (along @ v[at])
        effort[at] += along * pull
    for first, second, inertia in text.terms.coupled_inertia:
        i, j = starts[first][1], starts[second][1]
        effort[[i, j]] += inertia * vd[[j, i]]
    ours, theirs = [], []
    for (joint, at), turn in zip(places, turns, strict=True):
        first, count, dof = joint.velocity_start(), joint.num_velocities(), int(m.jnt_dofadr[at])
        own = turn.T @ effort[first : first + count]
        if count == 1:
            spring = built.springs.get(first)
            own = own + (spring.effort(q[joint.position_start()]) if spring else 0.0)
        ours.append(own)
        theirs.append(np.array(data.qfrc_inverse[dof : dof + count]))
    return ours, theirs
