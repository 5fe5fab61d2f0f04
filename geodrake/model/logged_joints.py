"""Matching of a model's joints with logs: joints without efforts or at rest are fixed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geodrake.boundary.arguments import instance, instances
from geodrake.errors import ArgumentError, LogError
from geodrake.inertia import Array
from geodrake.logs.files import Reading
from geodrake.logs.motion import JointLog, check_joints
from geodrake.logs.motors import motor_of_robot
from geodrake.logs.resting import LARGEST, logged_ranges, readings, resting, travels
from geodrake.model.base_motion import with_base
from geodrake.model.holding import holding
from geodrake.model.robot_model import RobotModel, is_of_file, read_again
from geodrake.robot.coordinates import Places
from geodrake.robot.joints import joint_names, single_joints
from geodrake.robot.plant import motor_joints, scoped_joint_names
from geodrake.robot.transmission.loop import LoopTransmission

_FAR = 0.05  # rad or m, largest integral of a resting joint's velocities less their mean
_CLEAR = 5.0  # standard deviations of noise, tolerance of positions in a loop
_STILL = 2e-3  # rad or m, largest range of positions of a resting joint


def reading_for(model: RobotModel, reading: Reading | None = None) -> Reading:
    """Return options for reading logs of a model, with its base, limits and motorless joints.

    A joint is motorless if the model file gives it no actuator or transmission but has some for
    other joints, or if other logs said so. It is passive in logs without its effort. The names of
    some robots imply their motors.
    """
    motors = motor_joints(model.plant)
    of_velocities = joint_names(model.plant)
    names = zip(of_velocities, scoped_joint_names(model.plant), strict=True)
    driven = {name for name, scoped in names if scoped in motors}
    leaders = model.coordinates.leaders
    followers = {model.coordinates.joints[at] for at in (*leaders, *leaders.values())}
    not_passive = (*driven, *followers, *model.base_joints)
    undriven = set(model.single_joints).difference(not_passive) if driven else set()
    reading = reading or Reading()
    usual = motor_of_robot(model.path.stem)
    of_all = {} if usual is None else {"": usual}
    motorless = frozenset({*undriven, *model.motorless})
    motors_of = {**of_all, **reading.motors}
    ranges = np.stack(model.position_limits, 1)[model.single_places]
    limits = {
        j: (low, high) for j, (low, high) in zip(model.single_joints, ranges.tolist(), strict=True)
    }
    return replace(
        reading,
        motorless=motorless,
        motors=motors_of,
        of_base=bool(model.base_joints),
        limits=limits,
        sliding=frozenset(model.sliding_joints),
        links={
            joint.child_body().name(): of_velocities[joint.velocity_start()]
            for joint in single_joints(model.plant)
        },
    )


def model_of_logs(
    model: RobotModel, logs: Sequence[JointLog], *, hold_resting: bool = True
) -> RobotModel:
    """Return the model with the joints fixed that no log records.

    They are fixed at their logged position, or else at the default of the model file. A joint with
    constant position and effort counts as unrecorded: its sensors carry no information.

    Args:
        logs: All logs, of joints of the model; see `read_log` with `partial`.
        hold_resting: Fix joints that hardly move, too; see `holding_resting`.

    Raises:
        LogError: Such a joint has several positions, or no joint remains.
    """
    instance(model, "model", RobotModel)
    logs = instances(logs, "logs", JointLog)
    model = _with_logged_leaders(model, logs)
    free = [joint for joint in model.single_joints if joint not in model.base_joints]
    silent = [j for j in free if not any(_has_information(log, j) for log in logs)]
    _check_actuators(model, logs, silent)
    if len(silent) == len(model.joints):
        return model
    if silent:
        places = {joint: _fixed_position(model, logs, joint) for joint in silent}
        why = "as no log has efforts of these joints (--lock JOINT=VALUE sets the position)"
        model = holding(model, places, why=why)
    return holding_resting(model, logs) if hold_resting else model


def _with_logged_leaders(model: RobotModel, logs: Sequence[JointLog]) -> RobotModel:
    """Return the model with the logged joints as independent coordinates of closed loops.

    A model that was changed after loading keeps its coordinates.
    """
    leading = list[str]()
    for drive in model.transmission:
        if drive.is_loop and not any(j in log.joints for log in logs for j in drive.actuators):
            leading += (j for j in drive.joints if all(_effort_varies(log, j) for log in logs))
    is_unfitted = model.information is None and not model.fitted_to
    if not leading or not is_unfitted or not is_of_file(model):
        return model
    given = replace(model.given, leading=(*leading, *model.given.leading))
    reloaded = read_again(replace(model, given=given))
    added = (note for note in model.notes if note not in read_again(model).notes)
    note = f"In closed loops {', '.join(leading)} is independent, as in the logs."
    return replace(reloaded, notes=(*reloaded.notes, *added, note))


def holding_resting(model: RobotModel, logs: Sequence[JointLog]) -> RobotModel:
    """Return the model with the joints fixed that hardly move.

    Dry friction at rest is undetermined up to breakaway, so the effort of such a joint cannot be
    compared with a model. (Samples at rest of moving joints are excluded for the same reason.) A
    joint is fixed if it rests at one position in all logs. A model that was fitted to one of the
    logs keeps its joints.
    """
    places, known = _resting_places(model, logs), model.fitted_to
    if not places or (known and any(log_of_model(log, model).fingerprint in known for log in logs)):
        return model
    return holding(
        model,
        places,
        why="as they hardly move in any log, and dry friction at rest is undetermined; a saved "
        "model keeps them fixed (to free them, --no-auto-lock, or hold_resting=False in "
        "Python)",
    )


def _resting_places(model: RobotModel, logs: Sequence[JointLog]) -> dict[str, float]:
    """Return joint -> rest position in all logs; empty if no moving joint would remain."""
    free = [joint for joint in model.single_joints if joint not in model.base_joints]
    joints = [joint for joint in free if all(joint in log.joints for log in logs)]
    if not logs or not joints:
        return {}
    low, high, noise = logged_ranges([log.select(joints).position for log in logs])
    sliding = np.isin(joints, model.sliding_joints)
    places = {}
    for joint, rests in zip(joints, resting(low, high, sliding, noise).tolist(), strict=True):
        if not rests or any(_travels(log, joint) for log in logs):
            continue
        columns = (readings(log.position[:, log.joints.index(joint)]) for log in logs)
        places_of_logs = [column.mean() for column in columns if len(column)]
        place, limits = float(np.mean(places_of_logs)), model.limits_of(joint)
        if limits[0] - _STILL <= place <= limits[1] + _STILL:
            places[joint] = float(np.clip(place, *limits))
    for drive in model.transmission:  # actuators of a drive can only be fixed together
        if not set(places).issuperset(drive.actuators):
            places = {joint: at for joint, at in places.items() if joint not in drive.actuators}
    return {} if len(places) == len(model.joints) else places


def log_of_model(log: JointLog, model: RobotModel) -> JointLog:
    """Return the log with joints in the model's order, without fixed and following ones.

    The effort of a following joint is added to that of its leader.
    """
    log = with_base(log, model)
    aside = set(model.known_joints).difference(model.joints)
    moving = [joint for joint in log.joints if joint not in aside]
    for joint in model.joints:
        if joint not in log.joints and joint in log.standing:
            raise LogError(
                f"Log {log.name!r} has positions but no efforts of {joint}.",
                advice="Log its effort, or its current, voltage, duty cycle or command; or fix "
                f"the joint: --lock {joint}=POSITION; or if it has no motor: --passive "
                f"{joint}.",
            )
    check_joints(log.name, moving, model.joints)
    return _with_followers(log, model).select(model.joints)


def _with_followers(log: JointLog, model: RobotModel) -> JointLog:
    """Return the log with efforts τ_q = Jᵀ τ_θ of following joints added at their actuators."""
    efforts, notes, joints = log.effort, list(log.notes), model.coordinates.joints
    for place in model.coordinates.places:
        if set(place.drive.actuators) <= set(log.joints):
            more, said = _tied_efforts(log, place, [joints[at] for at in place.joints])
            efforts, notes = efforts + more, [*notes, *said]
    return replace(log, effort=efforts, notes=tuple(notes)) if notes else log


def _tied_efforts(log: JointLog, place: Places, joints: Sequence[str]) -> tuple[Array, list[str]]:
    """Return the efforts of following joints at a drive's actuators, and notes.

    In a closed loop these are its dependent joints; with another drive, followers of its joints.
    """
    drive, motion, in_loop = place.drive, place.map.along, ""
    others, driven = joints[len(place.own) :], tuple[str, ...]()
    if isinstance(loop := drive.map, LoopTransmission):
        joints, motion, driven = loop.joints, loop.of_all, loop.driven
        others = [joint for joint in joints if joint not in drive.actuators]
        in_loop = f" in the closed loop of {loop.name}"
    free = [log.joints.index(name) for name in drive.actuators]
    at = {joint: log.joints.index(joint) for joint in others if joint in log.joints}
    efforts_of = {joint: log.effort[:, k] for joint, k in at.items()}
    places_of = {joint: x for joint, x in log.alone.items() if len(x) == len(log)}
    places_of |= {joint: log.position[:, k] for joint, k in at.items()}
    for joint in driven:
        if not np.isfinite(efforts_of.get(joint, np.array([np.nan]))).any():
            raise LogError(
                f"Log {log.name!r} has no effort of {joint}, which has a motor in addition "
                f"to {', '.join(drive.actuators)}{in_loop}.",
                advice=f"Log its effort too; or if {joint} has no motor, remove it from the "
                "model file.",
            )
    efforts, notes = np.zeros_like(log.effort), list[str]()
    logged = [joint for joint in others if joint in places_of]
    known = np.isfinite(log.position[:, free]).all(axis=1)
    if not logged or not known.any():
        return efforts, notes
    q, names = log.position[known][:, free], ", ".join(drive.actuators)
    try:
        theta, G, _ = motion(q, np.zeros_like(q))
    except ArgumentError as error:
        raise LogError(f"Log {log.name!r}: {error.problem}", advice=error.advice) from error
    for joint in logged:
        column = joints.index(joint)
        effort = np.nan_to_num(efforts_of.get(joint, np.zeros(len(log))))[known]
        if effort.any():
            block = np.ix_(np.flatnonzero(known), np.array(free))
            efforts[block] += G[:, column] * effort[:, None]
            notes.append(f"the effort of {joint} is added to that of {names}, which it follows")
        levers = np.abs(G[:, column]).max(axis=0)
        noise = _noise(places_of[joint][known]) + float(levers @ [_noise(x) for x in q.T])
        errors = readings(places_of[joint][known] - theta[:, column])
        if len(errors) and np.sqrt(np.mean(errors**2)) > _CLEAR * noise + _STILL:
            notes.append(
                f"{joint} differs from its position{in_loop} with {names} by {errors.mean():.3g} "
                f"on average, with standard deviation {errors.std():.3g} and noise {noise:.2g} rad "
                "or m (check zero positions and lengths)"
            )
    return efforts, notes


def _noise(positions: Array) -> float:
    """Return the standard deviation of noise of positions (N,), from third differences."""
    differences = np.diff(readings(positions), 3)
    return float(np.median(np.abs(differences)) / 0.6745 / np.sqrt(20.0)) if len(differences) else 0


def _travels(log: JointLog, joint: str) -> bool:
    """Return whether velocities show motion of a joint with a possibly stuck encoder."""
    if log.velocity is None or len(log) < 2:
        return False
    velocity = readings(log.velocity[:, log.joints.index(joint)])
    period = float(np.nanmedian(np.diff(log.time)))
    return len(velocity) > 1 and travels(velocity - velocity.mean(), period, _FAR)


def _check_actuators(model: RobotModel, logs: Sequence[JointLog], silent: Sequence[str]) -> None:
    """Raise for logs with joints where the model has actuators."""
    for drive in model.transmission:
        for log in logs:
            missing = [name for name in drive.actuators if name in silent]
            there = [joint for joint in drive.joints if joint in (*log.joints, *log.standing)]
            if drive.is_loop:
                others = set(there).difference(drive.actuators).intersection(log.joints)
                there = [joint for joint in there if joint in others and _effort_varies(log, joint)]
            if missing and there and drive.is_loop:
                raise LogError(
                    f"Log {log.name!r} has {', '.join(there)} of a closed loop, but not "
                    f"{', '.join(missing)}, which moves the others.",
                    advice=f"Log {', '.join(missing)}; or give {there[0]} a motor in the model "
                    "file: an actuator, or an effort limit of the joint.",
                )
            if missing and there:
                raise LogError(
                    f"Log {log.name!r} has {', '.join(there)}, but not "
                    f"{', '.join(drive.actuators)}, which the model's transmission needs.",
                    advice="Log the actuators, rename them in the transmission, or omit it: "
                    "--transmission none.",
                )


def _effort_varies(log: JointLog, joint: str) -> bool:
    """Return whether a log has a joint with varying effort."""
    if joint not in log.joints:
        return False
    effort = readings(log.effort[:, log.joints.index(joint)])
    return len(effort) > 0 and bool(np.ptp(effort) > 0.0)


def _has_information(log: JointLog, joint: str) -> bool:
    """Return whether a log has information on a joint's effort."""
    if joint not in log.joints:
        return False
    at = log.joints.index(joint)
    efforts, positions = (x[:, at] for x in (log.effort, log.position))
    if log.command is not None and not np.isfinite(efforts).any():
        efforts = np.clip(log.command[:, at], -LARGEST, LARGEST)
        efforts = efforts - np.clip(positions, -LARGEST, LARGEST)
    efforts, positions = (x[np.isfinite(x)] for x in (efforts, positions))
    if not len(efforts) or not len(positions):
        return True  # reported later
    moves = positions.max() - _STILL > positions.min()
    return bool(efforts.max() > efforts.min() or moves)


def _fixed_position(model: RobotModel, logs: Sequence[JointLog], joint: str) -> float:
    """Return the position of a joint in the logs, or its default."""
    places = {}
    for log in logs:
        if joint in log.standing:
            places[log.name] = log.standing[joint]
        elif joint in log.joints:
            values = np.clip(log.position[:, log.joints.index(joint)], -LARGEST, LARGEST)
            places[log.name] = float(np.nanmean(values))
    low, high = model.limits_of(joint)
    moving = [name for name, place in places.items() if not np.isfinite(place)]
    if moving:
        raise LogError(
            f"Log {moving[0]!r} has positions but no efforts of {joint}, which moves.",
            advice=f"Log its effort too; or if it has no motor: --passive {joint}; or fix it: "
            f"--lock {joint}=POSITION.",
        )
    if not places:
        return float(np.clip(model.default_position(joint), low, high))
    lowest, highest = min(places, key=places.__getitem__), max(places, key=places.__getitem__)
    if places[highest] - places[lowest] > _STILL:
        raise LogError(
            f"Joint {joint!r} has no effort in the logs, and different positions: "
            f"{places[lowest]:.4g} in {lowest!r}, {places[highest]:.4g} in {highest!r}.",
            advice=f"Set its position, such as --lock {joint}={places[lowest]:.4g}, or use logs "
            "in which it does not change.",
        )
    return float(np.clip(np.mean(list(places.values())), low, high))
