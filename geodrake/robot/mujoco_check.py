"""The robot of an MJCF against MuJoCo's own inverse dynamics, each time that a file is read.

At a few random states, the effort of the plant with what the file states of its joints and tendons
has to be that of MuJoCo without what is left out. Dry friction, limits and contacts, which are soft
in MuJoCo, take no part, nor do carried weights, media and struts, on which `geodrake check` has
MuJoCo's opinion. Free bodies rest where the file puts them.

Of velocities u of a joint of Drake's, in the world or the joint's frame, those of another program
are T u, those of a turning body in the body. With its rotation R,

    ball           T = Rᵀ                    Drake's u = ω
    free, MuJoCo   T = [0 1; Rᵀ 0] B         B u = (ω, v); theirs (v, ω), the latter in the body
    free, Pinocchio  T = [0 Rᵀ; Rᵀ 0] B      both in the body, so that v̇ is less ω × v

and efforts Tᵀ times theirs. The six joints of a free base have u = (ṗ, rates of yaw, pitch, roll).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint, JointIndex, MultibodyForces

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files import ModelDescription
from geodrake.robot.files.mjcf import MjcfText
from geodrake.robot.files.mjcf_source import load_mujoco, quiet_mujoco
from geodrake.robot.followers import scoped
from geodrake.robot.holding import moving_joints
from geodrake.robot.stated import BuiltPlant

_STATES = 3
_TOLERANCE = 1e-9  # of the largest effort
_APART = 1e-4  # of the size, by which loops of rounded numbers may be open
_SPEED, _ACCELERATION = 2.0, 5.0
_FAR = 3.0  # rad or m, where limits leave a choice
_BUG = "This is a bug in geodrake; please report it with the file."

Units = Sequence[tuple[Joint, ...]]
"""Joints that move, the six of a free base as one."""

Places = Mapping[str, float]
"""Joint -> where it is held, rad or m."""


@dataclass(frozen=True, eq=False)
class OtherProgram:
    """Another program with the model that it read of a file.

    Attributes:
        rest: Its positions, velocities and accelerations, held joints in their places.
        places: Of each joint, where it is in its positions and velocities.
        free: Makes of R and p of a free body, and of its velocities ω and v in the world, the
            positions, T and the bias of accelerations of the program.
        inverse_dynamics: Makes of its positions, velocities and accelerations efforts.
    """

    by: str
    rest: tuple[Array, Array, Array]
    places: Sequence[tuple[slice, slice]]
    free: Callable[[RotationMatrix, Array, Array], tuple[Array, Array, Array]]
    inverse_dynamics: Callable[[Array, Array, Array], Array]

    def state(self, q: Array, v: Array, size: int) -> tuple[Array, Array, Array]:
        """Return its positions, T and the bias of its accelerations, of a joint of the plant.

        Args:
            q: (1,), (3,) or, of a free base, (6,) positions of the joint.
        """
        if len(q) == 6:
            rpy = RollPitchYaw(q[:2:-1])
            spin = np.stack(list(map(rpy.CalcAngularVelocityInParentFromRpyDt, np.eye(3))), 1)
            B, bias = np.zeros((6, 6)), np.zeros(6)
            B[:3, :2:-1], B[3:, :3] = spin, np.eye(3)
            unaccelerated = rpy.CalcRpyDDtFromRpyDtAndAngularAccelInParent(v[:2:-1], np.zeros(3))
            bias[:3] = -spin @ unaccelerated
            placed, T, rest = self.free(rpy.ToRotationMatrix(), q[:3], B @ v)
            return placed, T @ B, T @ bias + rest
        if size == len(q):
            return q, np.eye(size), np.zeros(size)
        if len(q) == 3:
            rpy = RollPitchYaw(q)
            turned = rpy.ToQuaternion().wxyz()
            return turned, rpy.ToRotationMatrix().matrix().T, np.zeros(3)
        return np.array([np.cos(q[0]), np.sin(q[0])]), np.eye(1), np.zeros(1)

    def efforts(self, units: Units, q: Array, v: Array, vd: Array) -> Array:
        """Return efforts (N, nv of the plant) of the plant's motion (N, ·)."""
        found = np.zeros_like(v)
        for k in range(len(q)):
            position, rate, acceleration = (x.copy() for x in self.rest)
            turns = []
            for unit, (at_q, at_v) in zip(units, self.places, strict=True):
                there, own = part(unit)
                placed, T, bias = self.state(q[k, there], v[k, own], len(position[at_q]))
                position[at_q] = placed
                rate[at_v], acceleration[at_v] = T @ v[k, own], T @ vd[k, own] + bias
                turns.append((own, at_v, T))
            effort = self.inverse_dynamics(position, rate, acceleration)
            for own, at_v, T in turns:
                found[k, own] = T.T @ effort[at_v]
        return found


def part(unit: tuple[Joint, ...]) -> tuple[slice, slice]:
    """Return where joints are in the positions and velocities of a plant."""
    first, last = unit[0], unit[-1]
    return (
        slice(first.position_start(), last.position_start() + last.num_positions()),
        slice(first.velocity_start(), last.velocity_start() + last.num_velocities()),
    )


def by_mujoco(theirs: Any, held: Places, units: Units) -> OtherProgram | str:
    """Return MuJoCo with a compiled model whose constraints are off, or why it is of no use."""
    mujoco = load_mujoco()
    theirs.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    sizes = {0: (7, 6), 1: (4, 3)}  # of free joints and balls
    data = mujoco.MjData(theirs)
    for name, place in held.items():
        at = mujoco.mj_name2id(theirs, mujoco.mjtObj.mjOBJ_JOINT, name)
        if at < 0:
            return "MuJoCo has other joints"
        data.qpos[theirs.jnt_qposadr[at]] = place
    places = []
    for *others, joint in units:
        at = mujoco.mj_name2id(theirs, mujoco.mjtObj.mjOBJ_JOINT, joint.name())
        if others:
            body = theirs.body(joint.child_body().name())
            at = int(body.jntadr[0]) if body.jntnum[0] == 1 else -1
        if at < 0 or joint.num_positions() not in (1, 3):
            return "MuJoCo has other joints"
        nq, nv = sizes.get(int(theirs.jnt_type[at]), (1, 1))
        if nv != len(others) + joint.num_velocities():
            return "MuJoCo has other joints"
        start, first = int(theirs.jnt_qposadr[at]), int(theirs.jnt_dofadr[at])
        places.append((slice(start, start + nq), slice(first, first + nv)))

    def free(R: RotationMatrix, p: Array, v: Array) -> tuple[Array, Array, Array]:
        T = np.zeros((6, 6))
        T[:3, 3:], T[3:, :3] = np.eye(3), R.matrix().T
        return np.concatenate([p, R.ToQuaternion().wxyz()]), T, np.zeros(len(v))

    def inverse_dynamics(q: Array, v: Array, vd: Array) -> Array:
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, vd
        with quiet_mujoco():
            mujoco.mj_inverse(theirs, data)
        return np.array(data.qfrc_inverse)

    rest = (np.array(data.qpos), *np.zeros((2, theirs.nv)))
    return OtherProgram(f"MuJoCo {mujoco.__version__}", rest, places, free, inverse_dynamics)


def check_against_mujoco(description: ModelDescription, built: BuiltPlant) -> None:
    """Compare a plant with what MuJoCo compiled, where its file is an MJCF.

    Args:
        built: Its plant, all of whose joints move, before repairs of inertias.
    """
    text, plant = _compiled(description), built.plant
    if text is None or description.directives is not None or text.terms.set_aside:
        return  # of a thin body, say, whose repair is told of
    m, free = text.reference, load_mujoco().mjtJoint.mjJNT_FREE
    numbers = [(j, at) for j, at in _numbers(m, plant, (1, 3)) if int(m.jnt_type[at]) != free]
    units = [(joint,) for joint, _ in numbers]
    count = sum(int(kind) != free for kind in m.jnt_type)
    engine = by_mujoco(m, {}, units)
    if len(units) != count or isinstance(engine, str):
        raise ModelError(
            f"{text.path}: MuJoCo has {count} joints there, and geodrake {len(units)}.",
            advice=_BUG,
            path=text.path,
        )
    states = _random_states(plant, m, numbers)
    theirs, ours = engine.efforts(units, *states), _efforts(built, text, states)
    errors = np.array([np.abs(ours - theirs)[:, part(unit)[1]].max(initial=0.0) for unit in units])
    largest = float(np.abs(theirs).max(initial=0.0))
    if len(errors) and not errors.max() <= _TOLERANCE * max(largest, 1e-12):
        (joint,) = units[int(np.argmax(errors))]
        body = joint.child_body().name()
        raise ModelError(
            f"{description.path}: geodrake does not read the joint {joint.name()} or the body "
            f"{body} as MuJoCo does: efforts differ by up to {errors.max():.3g}, of {largest:.3g}.",
            advice=_BUG,
            path=description.path,
            body=body,
        )


def _random_states(
    plant: MultibodyPlant, m: Any, numbers: list[tuple[Joint, int]]
) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations (N, ·) of the plant; others rest."""
    rng, context = np.random.default_rng(0), plant.CreateDefaultContext()
    q = np.repeat(plant.GetPositions(context)[None], _STATES, axis=0)
    v, vd = np.zeros((2, _STATES, plant.num_velocities()))
    for joint, at in numbers:
        there, own = part((joint,))
        shape = _STATES, joint.num_velocities()
        low, high = m.jnt_range[at] if m.jnt_limited[at] and shape[1] == 1 else (-1.5, 1.5)
        if low < _FAR and high > -_FAR:
            low, high = max(low, -_FAR), min(high, _FAR)
        q[:, there] = rng.uniform(low, high, shape) if shape[1] == 1 else rng.uniform(-1, 1, shape)
        v[:, own] = _SPEED * rng.uniform(-1, 1, shape)
        vd[:, own] = _ACCELERATION * rng.uniform(-1, 1, shape)
    return q, v, vd


def _efforts(built: BuiltPlant, text: MjcfText, states: tuple[Array, Array, Array]) -> Array:
    """Return efforts (N, nv) of a plant, with what its file states of joints and tendons."""
    plant, terms = built.plant, text.terms
    context, found = plant.CreateDefaultContext(), []
    starts = {scoped(j): (j.position_start(), j.velocity_start()) for j in moving_joints(plant)}
    for q, v, vd in zip(*states, strict=True):
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        effort = plant.CalcInverseDynamics(context, vd, MultibodyForces(plant))
        effort -= plant.CalcGravityGeneralizedForces(context)
        effort += v * (built.damping + np.abs(v) * built.powers[0] + v**2 * built.powers[1])
        effort += built.rotor_inertia * vd
        for at_q, at in starts.values():
            if at in built.springs:
                effort[at] += built.springs[at].effort(q[at_q])
        for tendon in terms.tendons:
            along = np.array([*tendon.shares.values()])
            at_q, at = np.array([starts[joint] for joint in tendon.shares]).T
            stretch = along @ q[at_q] - tendon.length
            pull = tendon.stiffness * stretch + tendon.damping * (along @ v[at])
            effort[at] += along * pull
        for first, second, inertia in terms.coupled_inertia:
            i, j = starts[first][1], starts[second][1]
            effort[[i, j]] += inertia * vd[[j, i]]
        found.append(effort)
    return np.array(found)


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
