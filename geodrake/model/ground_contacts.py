"""Ground contacts of a robot with a free base: frames that may touch, and forces there.

Wrenches w measured at frames add efforts Σ Jᵀ w to the base and the joints. Without wrenches, only
the frames that may touch and the times are known, and the fit eliminates the unknown forces
(`geodrake.identification.logs.contact_rows`).

Forces and flags may belong to other frames than their names state, have other axes, or be inverted.
The robot's weight and centre of mass reveal this for forces, and feet at rest for flags.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from pydrake.multibody.plant import MultibodyPlant
from scipy.optimize import least_squares, lsq_linear
from scipy.spatial.transform import Rotation

from geodrake.compiling import compiled, contiguous
from geodrake.effects.body_motion import RobotBodies
from geodrake.errors import LogError
from geodrake.inertia import Array
from geodrake.inertia.bodies import lumped_bodies
from geodrake.logs.floating import FLAG, FORCE, ContactFlags, frames_of, odd_flags, vectors, widened
from geodrake.logs.motion import JointLog, Motion
from geodrake.model.contact_probability import HIGHEST, signs_of, smooth_rates, touching_probability
from geodrake.model.robot_model import RobotModel
from geodrake.robot.joints import joints_of
from geodrake.robot.regressor import inverse_dynamics_regressor
from geodrake.robot.shapes import collision_balls

_POINTS = 3  # fewest point feet on which a robot can stand
_NEAR = 0.02  # m over the ground, within which a frame may touch it
_LOWEST = 5.0  # percentile of the lowest heights that defines the ground
_DOUBT = 0.01  # probability from which a contact, or a missing contact, is possible
_ODD = 0.01  # tolerated share of contact flags that contradict their neighbors
_UNLIKE = 0.2  # tolerated difference of forces at the feet, as a share of the weight
_NOTHING, _HALF = 0.02, 0.5  # shares of the samples
_LESS = 0.35  # tolerated error of the mean force at the feet, as a share of the weight
_HELD = (
    "If the robot is held or fixed to the world, omit --floating; otherwise log contacts or forces "
    "of everything that touches it."
)
_FEW = 5000  # samples whose forces are compared with the weight
_FEW_POSES = 200
_MISPLACED = 0.015  # error from which forces may belong to other feet, as a share of the weight
_TOGETHER = 32  # samples per mean, to reduce noise
_MOST_LOAD, _LEAST_LOAD = 0.5, 0.4  # of the mass, added; and missing, relative to that
_FITS = 0.15  # largest error of correctly interpreted forces, as a share of the weight
_ALIKE = 1.5  # a simpler interpretation may have this many times the least error
_ARM = 0.1  # m, smallest lever arm of forces
_FEW_FRAMES = 6  # most frames of which all orders are candidates
_CLEARLY, _MOSTLY = 0.3, 0.8  # shares of samples: gain in agreement, and agreement
_RIGHT = np.radians(3.0)  # tolerance of rotations by right angles


@dataclass(frozen=True)
class ContactFrame:
    """A link that may touch the ground with a ball or a point."""

    name: str
    body: str  # name of the body that the link L is welded to
    origin: Array  # (3,) p_BoLo_B, m
    rotation: Array  # (3, 3) R_BL
    center: Array  # (3,) p_BoCo_B of the center of the ball, m
    radius: float  # radius of the ball, m

    def middle(self, bodies: RobotBodies) -> Array:
        """Return the position (N, 3) of the center of the ball, in W, m."""
        motion = bodies.motion(self.body)
        return motion.position + motion.rotation @ self.center

    def height(self, bodies: RobotBodies) -> Array:
        """Return heights (N,) of the lowest point of the ball over the world's origin, m."""
        return self.middle(bodies) @ upwards(bodies.gravity) - self.radius


def contact_jacobians(
    frames: Sequence[ContactFrame], bodies: RobotBodies, *, soles: bool = False
) -> Array:
    """Return Jacobians (N, c, 3, nv), in W, of the lowest points of frames' balls.

    With `soles`, which also transmit moments, angular rows follow: (N, c, 6, nv).
    """
    count, axes = len(bodies.q), 6 if soles else 3
    jacobians = np.zeros((count, len(frames), axes, bodies.tree.num_velocities))
    for k, frame in enumerate(frames):
        motion = bodies.motion(frame.body)
        arm = motion.rotation @ frame.center - frame.radius * upwards(bodies.gravity)
        body, dofs = (contiguous(motion.angular), contiguous(motion.linear)), np.array(motion.dofs)
        _put_point_jacobian(body, arm, dofs, jacobians, k)
    return jacobians


@compiled
def _put_point_jacobian(
    body: tuple[Array, Array], arm: Array, dofs: NDArray[np.intp], out: Array, k: int
) -> None:
    """Write the k-th Jacobian, of points at (N, 3) from a body's origin, in W.

    `own` contains the Jacobians (N, 3, nv) of the body's rotation and of its origin. Only columns
    of the velocities `dofs`, which move the body, are written.
    """
    angular, linear = body
    for n in range(len(arm)):
        x, y, z = arm[n, 0], arm[n, 1], arm[n, 2]
        for i in dofs:
            wx, wy, wz = angular[n, 0, i], angular[n, 1, i], angular[n, 2, i]
            out[n, k, 0, i] = linear[n, 0, i] + wy * z - wz * y
            out[n, k, 1, i] = linear[n, 1, i] + wz * x - wx * z
            out[n, k, 2, i] = linear[n, 2, i] + wx * y - wy * x
            if out.shape[2] > 3:
                out[n, k, 3, i], out[n, k, 4, i], out[n, k, 5, i] = wx, wy, wz


def upwards(gravity: Array) -> Array:
    """Return the unit vector (3,) against gravity, in W."""
    return -gravity / max(float(np.linalg.norm(gravity)), 1e-12)


_BALLS = WeakKeyDictionary[MultibodyPlant, Mapping[str, tuple[Array, float]]]()
"""Cached collision spheres of links."""


def contact_frames(model: RobotModel, names: Sequence[str]) -> tuple[ContactFrame, ...]:
    """Return links by name, with their collision spheres in the model file."""
    links = {
        member.name: (lump.name, member)
        for lump in lumped_bodies(model.plant)
        for member in lump.members
    }
    if model.plant not in _BALLS:
        is_file = model.path.is_file()
        _BALLS[model.plant] = collision_balls(model.path, model.given) if is_file else {}
    balls, frames = _BALLS[model.plant], []
    for name in names:
        if name not in links:
            raise LogError(
                f"The log has a contact or a force at link {name!r}, which the model lacks.",
                advice=f"Links are {', '.join(links)}.",
            )
        body, link = links[name]
        center, radius = balls.get(link.scoped_name, (np.zeros(3), 0.0))
        X_BL = link.X_RB
        frame = X_BL.translation(), X_BL.rotation().matrix(), X_BL.multiply(center), radius
        frames.append(ContactFrame(name, body, *frame))
    return tuple(frames)


def with_ground(log: JointLog, model: RobotModel) -> JointLog:
    """Return the log with the efforts of measured wrenches, or with the frames that may touch."""
    heads = dict.fromkeys(name[:-2] for name in log.floating if name[-2] == ".")
    incomplete = [each for each in heads if vectors(log.floating, each) is None]
    if incomplete := [each for each in incomplete if not each.endswith("orientation")]:
        words = f"{', '.join(incomplete)}: not used, as an axis is missing"
        log = replace(log, notes=(*log.notes, words))
    is_whole, loaded = set(model.joints) <= set(log.joints), frames_of(log.floating, FORCE)
    if loaded and is_whole:
        return _with_wrenches(log, model, loaded)
    if set(model.joints) <= {*log.unmeasured, *model.base_joints}:
        raise LogError(
            f"Log {log.name!r} has neither efforts of joints nor forces at feet, so nothing "
            "determines the weight of the robot.",
            advice="Log <joint>.effort …, or <frame>.force.x, .y and .z at each foot.",
        )
    return _with_contacts(log, model, frames_of(log.floating, FLAG), is_whole=is_whole)


def _bodies(
    log: JointLog, model: RobotModel, *, most: int = 0
) -> tuple[NDArray[np.bool_], RobotBodies]:
    """Return a mask (N,) of rows with known positions, at most `most` if > 0, and their bodies."""
    q = log.position[:, [log.joints.index(joint) for joint in model.joints]]
    known = np.asarray(np.isfinite(q).all(axis=1))
    if most and (rows := np.flatnonzero(known)).size > most:
        known = np.isin(np.arange(len(log)), rows[:: len(rows) // most])
    return known, RobotBodies(model.tree, model.positions(q[known]), model.total_phi)


def _low_links(log: JointLog, model: RobotModel, logged: Sequence[str]) -> tuple[str, ...]:
    """Return ends of limbs that come close to the ground, other than the frames in the log."""
    known, bodies = _bodies(log, model, most=_FEW_POSES)
    is_placed = vectors(log.floating, "base.position") is not None and known.any()
    if not (is_placed and model.tree.gravity.any()):
        return ()
    named = contact_frames(model, logged)
    others = {frame.body for frame in named}
    frames = [f for f in contact_frames(model, last_links(model)) if f.body not in others]
    ground = np.percentile(np.min([f.height(bodies) for f in named], axis=0), _LOWEST)
    lowest = {f.name: np.percentile(f.height(bodies), _LOWEST) - ground for f in frames}
    return tuple(name for name, height in lowest.items() if abs(height) < _NEAR)


# Contacts.


def _with_contacts(
    log: JointLog, model: RobotModel, flagged: Sequence[str], *, is_whole: bool
) -> JointLog:
    """Return the log with the frames that may touch the ground, and notes."""
    low = _low_links(log, model, flagged) if flagged and is_whole else ()
    names = (*flagged, *low) or last_links(model)
    frames, logged = contact_frames(model, names), _flags(log, names)
    flags, doubts = np.zeros_like(logged), list[str]()
    heights, touching = np.full((2, *flags.shape), np.nan)
    if is_whole and vectors(log.floating, "base.position") is not None:
        heights, touching = _contact_probabilities(log, model, frames, by_efforts=not flagged)
        flags |= ~(heights >= _NEAR)
    elif not flagged:
        flags[:] = True
    if flagged:
        count = len(flagged)
        logged[:, :count], more = _corrected(log, flagged, logged[:, :count], touching[:, :count])
        doubts += [*more, *_check_airborne(log, logged.astype(float))]
        if low:
            doubts.append(
                f"no contact flags of {', '.join(low)}: they count as touching near the ground"
            )
        odd = zip(names, odd_flags(log.time, logged).tolist(), strict=True)
        if wrong := [f"{x:.0%} of those of {name}" for name, x in odd if x > _ODD]:
            doubts.append(
                f"contact flags are wrong for single samples: {', '.join(wrong)}; near each of "
                "them the frame counts as touching"
            )
        flags |= widened(log.time, logged)
    elif np.isfinite(touching).any():
        may_touch = widened(log.time, np.nan_to_num(touching) > _DOUBT)
        doubtful = ((may_touch | flags) & ~(touching >= 1.0 - _DOUBT)).any(axis=1).mean()
        flags |= may_touch
        is_known = np.isfinite(touching).all(axis=1)
        doubts += _check_airborne(log, touching[is_known])
        shares = zip(names, (touching > 0.5).mean(axis=0).tolist(), strict=True)
        frequent = [f"{name} in {x:.0%}" for name, x in shares if x > _DOUBT]
        doubts.append(
            f"contacts by heights, speeds and efforts: {', '.join(frequent) or 'none'} of the "
            f"samples; in {doubtful:.0%} of them one is uncertain, and its limb is left out"
        )
    contacts = ContactFlags(tuple(names), log.time, flags)
    loads = "forces and moments" if on_soles(contacts, frames) else "forces"
    source = "from the log" if flagged else "at the ends of the limbs"
    words = f"unknown {loads} at {', '.join(names)} ({source}) are eliminated"
    return replace(log, contacts=contacts, notes=(*log.notes, *doubts, words))


def _flags(log: JointLog, names: Sequence[str]) -> NDArray[np.bool_]:
    """Return the contact flags (N, c) of a log; an empty cell counts as contact."""
    none = np.zeros(len(log))
    columns = [log.floating.get(f"{name}{FLAG}", none) for name in names]
    for name, values in zip(names, columns, strict=True):
        if (most := float(np.nanmax(values, initial=0.0))) > 1.0:
            raise LogError(
                f"The contact of {name} in log {log.name!r} goes up to {most:.4g}, but it is "
                "1 while the link touches the ground and 0 in the air.",
                advice=f"Name a column in per cent '{name}.contact [%]', and forces "
                f"{name}.force.x to .z.",
            )
    return np.asarray(np.nan_to_num(np.stack(columns, -1), nan=1.0) > 0.5)


def on_soles(contacts: ContactFlags, frames: Sequence[ContactFrame]) -> bool:
    """Return whether frames are soles: robots cannot stand on two point feet."""
    most = int(contacts.flags.sum(axis=1).max(initial=0))
    return most < _POINTS and not any(frame.radius for frame in frames)


def _contact_probabilities(
    log: JointLog, model: RobotModel, frames: Sequence[ContactFrame], *, by_efforts: bool
) -> tuple[Array, Array]:
    """Return heights of frames over level ground (N, c), m, and probabilities of contact.

    Both are NaN where positions are unknown. Uncertain frames count as touching: this is valid for
    frames in the air too, and only costs the rows of their limbs.
    """
    known, bodies = _bodies(log, model)
    heights, probability = np.full((2, len(log), len(frames)), np.nan)
    if not known.any():
        return heights, probability
    raw = np.stack([frame.height(bodies) for frame in frames], -1)
    heights[known] = raw - np.percentile(raw.min(axis=1), _LOWEST)
    near = np.flatnonzero((heights[known] < HIGHEST).any(axis=0)).tolist()
    may_be_soles = sum(frames[k].radius == 0.0 for k in near) < _POINTS
    jacobians = contact_jacobians([frames[k] for k in near], bodies, soles=may_be_soles)
    signs = signs_of(log, model, jacobians, heights[known][:, near], known, by_efforts=by_efforts)
    probability[:] = 0.0
    probability[:, near] = touching_probability(signs)
    return heights, probability


def _corrected(
    log: JointLog, names: Sequence[str], flags: NDArray[np.bool_], touching: Array
) -> tuple[NDArray[np.bool_], list[str]]:
    """Return corrected flags (N, c) and notes; raise if flags belong to other frames.

    `touching` (N, c) are probabilities of contact from heights and speeds.
    """
    known = np.isfinite(touching).all(axis=1)
    if not known.any():
        return flags, []
    flagged, contact = flags[known].astype(float), touching[known]
    matches = (flagged.T @ contact + (1.0 - flagged).T @ (1.0 - contact)) / len(flagged)
    given, inverted = float(np.trace(matches)), np.diagonal(matches) < 0.5 - _CLEARLY
    aloft = 1.0 - flagged  # inverted flags: these samples are at rest
    inverted &= ((aloft * contact).sum(axis=0) > 0.5 * aloft.sum(axis=0)) & flagged.any(axis=0)
    orders = [list(order) for order in _orders(len(names))]
    sums = [float(matches[range(len(names)), order].sum()) for order in orders]
    best, count = int(np.argmax(sums)), len(names)
    corrected = float(np.maximum(np.diagonal(matches), 1.0 - np.diagonal(matches)).sum())
    if max(sums) > max(corrected, given + _CLEARLY) and max(sums) > _MOSTLY * count:
        raise LogError(
            f"Contact flags in log {log.name!r} are those of feet that rest in {given / count:.0%} "
            f"of the samples, but in {max(sums) / count:.0%} {_order_words(names, orders[best])}.",
            advice="Name each column after its link.",
        )
    if not inverted.any() or corrected < _MOSTLY * count:
        return flags, []
    named = ", ".join(name for name, odd in zip(names, inverted, strict=True) if odd)
    words = (
        f"contact flags of {named} are inverted, 1 while it moves and 0 while it rests: corrected"
    )
    return flags ^ inverted, [words]


def _check_airborne(log: JointLog, probability: Array) -> tuple[str, ...]:
    """Return a note if frames (N, c) rarely touch; raise if they almost never do."""
    share = float((1.0 - probability).prod(axis=1).mean())
    words = f"nothing touches the ground in {share:.0%} of the samples"
    if share > 1.0 - _NOTHING:
        raise LogError(f"In log {log.name!r} {words}, but a robot in the air falls.", advice=_HELD)
    return (words,) if share > _HALF else ()


# Measured wrenches.


def _with_wrenches(log: JointLog, model: RobotModel, names: Sequence[str]) -> JointLog:
    """Return the log with Σ Jᵀ w of wrenches added to its efforts, NaN if unknown, and notes."""
    known, bodies = _bodies(log, model)
    frames, is_base = contact_frames(model, names), np.isin(model.joints, model.base_joints)
    rates = smooth_rates(log, model) or np.zeros((2, len(log), len(model.joints)))
    v, vd = (each[known] for each in rates)
    few = np.flatnonzero(np.isfinite(v + vd).all(axis=1))
    few, count = few[:: max(1, len(few) // _FEW)], len(frames)
    J = np.zeros((len(few), count, 6, np.count_nonzero(is_base)))
    wrenches, turns = np.zeros((len(J), count, 2, 3)), np.zeros((len(J), count, 3, 3))
    efforts = np.zeros((np.count_nonzero(known), len(model.joints)))
    bare, notes = list[str](), list[str]()  # soles without moments
    for k, frame in enumerate(frames):
        force, torque = (vectors(log.floating, f"{frame.name}.{w}") for w in ("force", "torque"))
        if force is None:
            raise LogError(
                f"Log {log.name!r} lacks some of {frame.name}.force.x, .y and .z.",
                advice="Log all three, in the axes of the link.",
            )
        axes = zip("xyz", force.T, strict=True)
        if flat := [f"{frame.name}.force.{axis}" for axis, x in axes if not x.any()]:
            notes.append(f"{', '.join(flat)}: always zero, as if the sensor lacked that axis")
        bare += [frame.name] * (torque is None and count < _POINTS and not frame.radius)
        torque = np.zeros_like(force) if torque is None else torque
        motion = bodies.motion(frame.body)
        R_WL = motion.rotation @ frame.rotation
        wrench = np.stack([force[known], torque[known]], 1)  # (K, 2, 3)
        J_L = np.concatenate([motion.jacobian_at(frame.origin), motion.angular], axis=1)
        efforts += np.einsum("nij,ni->nj", J_L, (wrench @ np.swapaxes(R_WL, 1, 2)).reshape(-1, 6))
        J[:, k], wrenches[:, k], turns[:, k] = J_L[few][:, :, is_base], wrench[few], R_WL[few]
    if bare:
        notes.append(f"no moments at {', '.join(bare)}: taken as zero, although soles carry them")
    motion_few = bodies.q[few], v[few], vd[few]
    needed = model.effort(Motion(*motion_few))[:, is_base]
    regressor = inverse_dynamics_regressor(model.tree, *motion_few)[:, is_base]
    root = next(each.body for each in model.tree.mobilizers if each.body >= 0)
    load = regressor[..., 10 * root : 10 * root + 4]  # its mass and first moments
    notes += _check_wrenches(log, model, names, (J, wrenches, turns, needed, load))
    if low := _low_links(log, model, names):
        notes.append(f"no forces at {', '.join(low)}, near the ground: their load is missing")
    notes.append(
        f"wrenches at {', '.join(names)} are included in the efforts of the base and the joints"
    )
    ground, total = np.zeros(log.effort.shape), np.full((len(log), len(model.joints)), np.nan)
    total[known] = efforts
    ground[:, [log.joints.index(joint) for joint in model.joints]] = total
    of_base = np.isin(log.joints, model.base_joints)  # these have no other measured effort
    return replace(
        log,
        effort=log.effort + ground,
        ground=np.where(of_base, 0.0, ground),
        notes=(*log.notes, *notes),
    )


def _check_wrenches(
    log: JointLog,
    model: RobotModel,
    names: Sequence[str],
    seen: tuple[Array, Array, Array, Array, Array],
) -> tuple[str, ...]:
    """Raise for wrenches that carry the robot only in another interpretation.

    The robot may carry an unknown load. Forces that carry nothing are refused, too. A note reports
    those that carry much less or more than the robot's weight.

    Args:
        seen: Base Jacobians (S, F, 6, 6) of F links in S samples, their wrenches (S, F, 2, 3), R_WL
            (S, F, 3, 3), the required efforts of the base (S, 6), and those (S, 6, 4) for the mass
            and first moments of a load.
    """
    is_known = np.isfinite(seen[1]).all(axis=(1, 2, 3))
    J, wrenches, turns, needed, load = (each[is_known] for each in seen)
    size = float(model.total_phi[:, 0].sum() * np.linalg.norm(model.tree.gravity))
    if not len(J) or not size:
        return ()
    arm = max(float(np.sqrt(np.square(J[:, :, :3, 3:]).mean())), _ARM)
    scales = size * np.array([1.0, 1.0, 1.0, arm, arm, arm])
    starts = np.arange(0, len(J), _TOGETHER)

    def means(efforts: Array) -> Array:
        sums = np.add.reduceat(efforts, starts, axis=0)
        return np.asarray((sums.T / np.diff(np.append(starts, len(J)))).T)

    def carried(turns: Array, wrenches: Array, J: Array = J) -> Array:
        """Return mean efforts (B, 6) of wrenches in axes with the rotations `turns` to W."""
        in_world = np.einsum("sfij,sfaj->sfai", turns, wrenches).reshape(*J.shape[:2], 6)
        return means(np.einsum("sfij,sfi->sj", J, in_world))

    def missing(efforts: Array) -> Array:
        return np.asarray((efforts - means(needed)) / scales)

    def size_of(errors: Array) -> float:
        return float(np.median(np.linalg.norm(errors, axis=1)))

    gravity = float(np.linalg.norm(model.tree.gravity))
    most = size / gravity * np.array([_MOST_LOAD, *[_MOST_LOAD * arm] * 3])
    columns = means(load) * most / scales[:, None]

    def error_of(efforts: Array) -> float:
        """Return the error beside the load that lowers it most."""
        errors = missing(efforts)
        bounds = [-_LEAST_LOAD, -1.0, -1.0, -1.0], np.ones(4)
        found = lsq_linear(columns.reshape(-1, 4), errors.ravel(), bounds).x
        return size_of(errors - columns @ found)

    count, against = len(names), "as forces of the robot on the ground"
    of_each = [  # [i][k]: the wrench in the columns of link i acts at link k
        [carried(turns[:, [k]], wrenches[:, [i]], J[:, [k]]) for k in range(count)]
        for i in range(count)
    ]
    orders = {
        _order_words(names, order): np.sum([of_each[i][k] for i, k in enumerate(order)], axis=0)
        for order in _orders(count)
    }
    in_links, in_world = orders.pop(""), carried(0 * turns + np.eye(3), wrenches)
    upwards_all = needed[:, :3].mean(axis=0)
    fitted = _fitted_axes(wrenches[:, :, 0], turns, upwards_all)
    others = {
        "in world axes": in_world,
        f"in link axes {against}": -in_links,
        f"in world axes {against}": -in_world,
        **orders,
        f"if {axes_words(fitted, 'the links')}": carried(turns @ fitted.as_matrix(), wrenches),
    }
    error = error_of(in_links)
    errors = {words: error_of(efforts) for words, efforts in others.items()}
    best = next(words for words in errors if errors[words] <= _ALIKE * min(errors.values()))
    least = errors[best]
    is_fitted, is_moved = best == next(reversed(errors)), best in orders
    wrong = _UNLIKE if is_fitted else _MISPLACED if is_moved else 0.25 * _UNLIKE
    if error > wrong and least < min(_FITS, (0.5 if is_moved else 0.3) * error):
        raise LogError(
            f"Forces at the feet in log {log.name!r} differ by {error:.0%} of the weight from what "
            "carries the robot with any load in link axes, but only by "
            f"{least:.0%} {best}.",
            advice="Log forces of the ground on the robot, in the axes of the link in their name.",
        )
    whole = size_of(missing(in_links))
    words = f"forces at the feet differ by {whole:.0%} of the weight from what carries the robot"
    doubts = (words,) if whole > _UNLIKE else ()
    share = float(in_links[:, :3].mean(axis=0) @ upwards_all) / size**2
    words = f"forces at the feet carry {round(100.0 * share)}% of the weight on average"
    if abs(share) < _NOTHING:
        raise LogError(f"In log {log.name!r} {words}, but a robot in the air falls.", advice=_HELD)
    return (words,) if abs(share - 1.0) > _LESS else doubts


def _fitted_axes(forces: Array, turns: Array, weight: Array) -> Rotation:
    """Return the rotation of all links' axes with which forces (S, F, 3) best carry a weight."""
    rows = np.einsum("sfij,sfl->sijl", turns, forces).reshape(-1, 9)
    R = np.linalg.qr(np.column_stack([rows, np.tile(weight, len(forces))]), mode="r")

    def misses(turn: Rotation) -> Array:
        return np.asarray(R @ np.append(turn.as_matrix(), -1.0))

    right = Rotation.create_group("O")
    nearest = right[int(np.argmin([np.linalg.norm(misses(axes)) for axes in right]))]
    fit = least_squares(lambda x: misses(Rotation.from_rotvec(x) * nearest), np.zeros(3))
    return Rotation.from_rotvec(fit.x) * nearest


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    """Yield all orders of `count` frames; of many frames only the given order."""
    yield from permutations(range(count)) if count <= _FEW_FRAMES else [tuple(range(count))]


def _order_words(names: Sequence[str], order: Sequence[int]) -> str:
    """Return the meaning of columns in another order, in words; "" for the given order."""
    moved = [(names[k], names[at]) for k, at in enumerate(order) if k != at]
    said = [f"those of {name} are of {other}" for name, other in moved]
    return f"if {', '.join(said)}" if said else ""


def last_links(model: RobotModel) -> tuple[str, ...]:
    """Return the last links of limbs, where a robot may touch the ground."""
    plant, lumps = model.plant, lumped_bodies(model.plant)
    joints = joints_of(plant)
    inner = {int(joint.parent_body().index()) for joint in joints}
    moving = {int(j.parent_body().index()) for j in joints if j.num_velocities()}
    last = [lump for lump in lumps[1:] if not moving & {int(m.index) for m in lump.members}]
    ends = [member for lump in last for member in lump.members if int(member.index) not in inner]
    return tuple(member.name for member in ends)


def axes_words(turn: Rotation, what: str) -> str:
    """Return a rotation of the log's axes, in words."""
    right = Rotation.create_group("O")
    off = (right.inv() * turn).magnitude()
    if off.min() < _RIGHT:
        signs = right[int(off.argmin())].as_matrix().round().astype(int).tolist()
        named = [f"{'-' * (-1 in row)}{'xyz'[[*map(abs, row)].index(1)]}" for row in signs]
        return f"x, y, z of {what} are, for example, {', '.join(named)} of the log"
    angles = ", ".join(f"{x:.0f}°" for x in turn.as_euler("ZYX", degrees=True))
    return f"axes of {what} are those of the log rotated by {angles} (yaw, pitch, roll)"
