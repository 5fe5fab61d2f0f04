"""Matching of a model's joints with logs: joints without efforts, or at rest, are fixed."""

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
from geodrake.robot.joints import joint_names
from geodrake.robot.plant import motor_joints, scoped_joint_names
from geodrake.robot.transmission.loop import LoopTransmission

_FAR = 0.05  # rad or m, that a joint which rests does not go by its velocities, less their mean
_CLEAR = 5.0  # deviations of noise, beyond which a joint is not where a loop has it
_STILL = 2e-3  # rad or m, by which a joint may move and still stand


def reading_for(model: RobotModel, reading: Reading | None = None) -> Reading:
    """Return how logs of a model are read, which knows its base, limits and joints without a motor.

    Those are the joints without an actuator or a transmission in the model file, where others
    have one, and those that had none in other logs; they are passive in logs without an effort of
    them. Some robots' names tell which motors they have.
    """
    motors = motor_joints(model.plant)
    names = zip(joint_names(model.plant), scoped_joint_names(model.plant), strict=True)
    driven = {name for name, scoped in names if scoped in motors}
    leaders = model.coordinates.leaders
    followers = {model.coordinates.joints[at] for at in (*leaders, *leaders.values())}
    others = (*driven, *followers, *model.base_joints)
    none = set(model.single_joints).difference(others) if driven else set()
    reading = reading or Reading()
    usual = motor_of_robot(model.path.stem)
    of_all = {} if usual is None else {"": usual}
    motorless = frozenset({*none, *model.motorless})
    motors_of = {**of_all, **reading.motors}
    ends = np.stack(model.position_limits, 1)[model.single_places]
    limits = {
        j: (low, high) for j, (low, high) in zip(model.single_joints, ends.tolist(), strict=True)
    }
    return replace(
        reading,
        motorless=motorless,
        motors=motors_of,
        of_base=bool(model.base_joints),
        limits=limits,
        sliding=frozenset(model.sliding_joints),
    )


def model_of_logs(
    model: RobotModel, logs: Sequence[JointLog], *, hold_resting: bool = True
) -> RobotModel:
    """Return the model with joints fixed that no log records; itself if there are none.

    They are held where they stand, if their positions were logged, and else where the model file
    has them by default. A joint that stands still all the time under an effort that never changes
    counts as one that was not logged: its sensor has nothing to say.

    Args:
        logs: All logs, of joints of the model; see `read_log` with `partial`.
        hold_resting: Whether joints that hardly move are held, too; see `holding_resting`.

    Raises:
        LogError: Such a joint does not stand in one place, or no joint is left.
    """
    instance(model, "model", RobotModel)
    logs = instances(logs, "logs", JointLog)
    model = _led_by(model, logs)
    free = [joint for joint in model.single_joints if joint not in model.base_joints]
    silent = [j for j in free if not any(_says(log, j) for log in logs)]
    _check_sides(model, logs, silent)
    if len(silent) == len(model.joints):
        return model
    if silent:
        places = {joint: _place(model, logs, joint) for joint in silent}
        why = "as no log has efforts of these joints (--lock JOINT=VALUE sets the position)"
        model = holding(model, places, why=why)
    return holding_resting(model, logs) if hold_resting else model


def _led_by(model: RobotModel, logs: Sequence[JointLog]) -> RobotModel:
    """Return the model with other independent joints of closed loops, if logs have those.

    A model that is no longer that of its file keeps its own.
    """
    leading = list[str]()
    for drive in model.transmission:
        if drive.is_loop and not any(j in log.joints for log in logs for j in drive.actuators):
            leading += (j for j in drive.joints if all(_moves(log, j) for log in logs))
    own = model.information is None and not model.fitted_to
    if not leading or not own or not is_of_file(model):
        return model
    given = replace(model.given, leading=(*leading, *model.given.leading))
    found = read_again(replace(model, given=given))
    added = (note for note in model.notes if note not in read_again(model).notes)
    note = f"In closed loops {', '.join(leading)} is independent, as in the logs."
    return replace(found, notes=(*found.notes, *added, note))


def holding_resting(model: RobotModel, logs: Sequence[JointLog]) -> RobotModel:
    """Return the model with joints fixed that hardly move; itself if there are none.

    At rest dry friction may be anything up to breakaway, so that the effort of such a joint says
    nothing that a model could be held to. Samples at which a joint that moves stands still are left
    out for the same reason. A joint is held if it rests in all logs, at one place; a model that was
    fitted to one of the logs keeps the joints that it was fitted with.
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
    """Joint -> where it rests in all logs; empty where no joint would be left that moves."""
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
    for drive in model.transmission:  # whose actuators can only be held together
        if not set(places).issuperset(drive.actuators):
            places = {joint: at for joint, at in places.items() if joint not in drive.actuators}
    return {} if len(places) == len(model.joints) else places


def log_of_model(log: JointLog, model: RobotModel) -> JointLog:
    """Return the log with joints in the model's order, without held and following ones.

    The effort of a joint that follows another one is added to the other one's.
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
    """Return the log with τ_q = Jᵀ τ_θ at actuators that others follow, where both were logged."""
    efforts, notes, joints = log.effort, list(log.notes), model.coordinates.joints
    for place in model.coordinates.places:
        if set(place.drive.actuators) <= set(log.joints):
            more, said = _of_followers(log, place, [joints[at] for at in place.joints])
            efforts, notes = efforts + more, [*notes, *said]
    return replace(log, effort=efforts, notes=tuple(notes)) if notes else log


def _of_followers(log: JointLog, place: Places, joints: Sequence[str]) -> tuple[Array, list[str]]:
    """Return efforts at a drive's actuators of joints that follow them, and notes.

    Those are the joints of a closed loop; of another drive, whose joints are given, those that
    follow its own.
    """
    drive, motion, where = place.drive, place.map.along, ""
    others, driven = joints[len(place.own) :], tuple[str, ...]()
    if isinstance(loop := drive.map, LoopTransmission):
        joints, motion, driven = loop.joints, loop.of_all, loop.driven
        others = [joint for joint in joints if joint not in drive.actuators]
        where = f" in the closed loop of {loop.name}"
    free = [log.joints.index(name) for name in drive.actuators]
    at = {joint: log.joints.index(joint) for joint in others if joint in log.joints}
    efforts_of = {joint: log.effort[:, k] for joint, k in at.items()}
    places_of = {joint: x for joint, x in log.alone.items() if len(x) == len(log)}
    places_of |= {joint: log.position[:, k] for joint, k in at.items()}
    for joint in driven:
        if not np.isfinite(efforts_of.get(joint, np.array([np.nan]))).any():
            raise LogError(
                f"Log {log.name!r} has no effort of {joint}, which has a motor in addition "
                f"to {', '.join(drive.actuators)}{where}.",
                advice=f"Log its effort too; or if {joint} has no motor, remove it from the "
                "model file.",
            )
    efforts, notes = np.zeros_like(log.effort), list[str]()
    seen = [joint for joint in others if joint in places_of]
    there = np.isfinite(log.position[:, free]).all(axis=1)
    if not seen or not there.any():
        return efforts, notes
    q, names = log.position[there][:, free], ", ".join(drive.actuators)
    try:
        theta, G, _ = motion(q, np.zeros_like(q))
    except ArgumentError as error:
        raise LogError(f"Log {log.name!r}: {error.problem}", advice=error.advice) from error
    for joint in seen:
        own = joints.index(joint)
        effort = np.nan_to_num(efforts_of.get(joint, np.zeros(len(log))))[there]
        if effort.any():
            block = np.ix_(np.flatnonzero(there), np.array(free))
            efforts[block] += G[:, own] * effort[:, None]
            notes.append(f"the effort of {joint} is added to that of {names}, which it follows")
        levers = np.abs(G[:, own]).max(axis=0)
        noise = _noise(places_of[joint][there]) + float(levers @ [_noise(x) for x in q.T])
        apart = readings(places_of[joint][there] - theta[:, own])
        if len(apart) and np.sqrt(np.mean(apart**2)) > _CLEAR * noise + _STILL:
            notes.append(
                f"{joint} differs from its position{where} with {names} by {apart.mean():.3g} on "
                f"average, with standard deviation {apart.std():.3g} and noise {noise:.2g} rad or "
                "m (check zero positions and lengths)"
            )
    return efforts, notes


def _noise(positions: Array) -> float:
    """Return the deviation of noise of positions (N,), by third differences."""
    differences = np.diff(readings(positions), 3)
    return float(np.median(np.abs(differences)) / 0.6745 / np.sqrt(20.0)) if len(differences) else 0


def _travels(log: JointLog, joint: str) -> bool:
    """Return whether velocities show motion of a joint whose position may be stuck."""
    if log.velocity is None or len(log) < 2:
        return False
    velocity = readings(log.velocity[:, log.joints.index(joint)])
    period = float(np.nanmedian(np.diff(log.time)))
    return len(velocity) > 1 and travels(velocity - velocity.mean(), period, _FAR)


def _check_sides(model: RobotModel, logs: Sequence[JointLog], silent: Sequence[str]) -> None:
    """Raise for logs with joints where the model has actuators."""
    for drive in model.transmission:
        for log in logs:
            missing = [name for name in drive.actuators if name in silent]
            there = [joint for joint in drive.joints if joint in (*log.joints, *log.standing)]
            if drive.is_loop:
                others = set(there).difference(drive.actuators).intersection(log.joints)
                there = [joint for joint in there if joint in others and _moves(log, joint)]
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


def _moves(log: JointLog, joint: str) -> bool:
    """Return whether a log has a joint, under efforts that change."""
    if joint not in log.joints:
        return False
    effort = readings(log.effort[:, log.joints.index(joint)])
    return len(effort) > 0 and bool(np.ptp(effort) > 0.0)


def _says(log: JointLog, joint: str) -> bool:
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
        return True  # what is wrong there is told of later
    moves = positions.max() - _STILL > positions.min()
    return bool(efforts.max() > efforts.min() or moves)


def _place(model: RobotModel, logs: Sequence[JointLog], joint: str) -> float:
    """Return the position of a joint in the logs, or its default."""
    places = {}
    for log in logs:
        if joint in log.standing:
            places[log.name] = log.standing[joint]
        elif joint in log.joints:
            positions = np.clip(log.position[:, log.joints.index(joint)], -LARGEST, LARGEST)
            places[log.name] = float(np.nanmean(positions))
    low, high = model.limits_of(joint)
    moves = [name for name, place in places.items() if not np.isfinite(place)]
    if moves:
        raise LogError(
            f"Log {moves[0]!r} has positions but no efforts of {joint}, which moves.",
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
