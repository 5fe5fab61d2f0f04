"""Detection of a base that is mounted differently from the model, such as on a wall or ceiling."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from geodrake.diagnosis.log_model import Fit, LogModel
from geodrake.effects.base import Effect
from geodrake.effects.body_motion import RobotBodies
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.noise import motion_of
from geodrake.identification.logs.reduce import sign_widths
from geodrake.model.carried_payloads import carrying

Array = NDArray[np.float64]

_POSES = 400  # of each log
_LEAST = 0.5  # rad; smaller turns are found by linearization about the model's gravity
_LEAST_MOVED = 4.0  # degrees; gain errors of 20 % look like half of it
_OTHER_SIZE = 0.3  # relative error of gravity's magnitude, due to errors of bodies and gains
_SHARE = 0.5  # least share of the squared errors that gravity must explain
_START = 2.0  # rad, initial turns about each axis
_ALIKE = 1e-6  # half of the squared distance of equal directions


def turned_bases(case: Case, effects: Iterable[Effect]) -> dict[Effect, Effect]:
    """Return effects that turn gravity -> the same with large turns that explain most errors.

    Efforts are linear in gravity, but not in large angles: upside down, a small turn to either side
    changes nothing. A model with such an effect keeps it, as the fit includes it.
    """
    turning = [effect for effect in effects if _turns(effect)]
    if not turning or any(map(_turns, effects_of(case.model))):
        return {}
    felt = _felt(case)
    if felt is None or _angle(felt, case.model.tree.gravity) < _LEAST:
        return {}
    return {effect: _turned(effect, felt, case.model.bodies_at_rest) for effect in turning}


def moved_base_notes(case: Case) -> list[str]:
    """Return a note if a model has a turned base, and the logs show another direction of gravity.

    The angles are known from other logs, and the fit would hardly change them.
    """
    turning = [f for f in case.model.effects if _turns(f.effect)]
    if len(turning) != 1 or (felt := _felt(case)) is None:
        return []
    (fitted,) = turning
    angle = np.degrees(_angle(felt, _gravity(case)))
    if angle < _LEAST_MOVED:
        return []
    return [
        f"these logs show gravity {angle:.0f}° away from the model's {fitted.effect.name}: "
        "if the base was moved, explain them with the model without that effect"
    ]


def logs_apart_notes(case: Case, model: LogModel, fit: Fit) -> list[str]:
    """Return a note if gravity has other directions in some logs of a fit than in others.

    It is due if a turn of gravity in each log takes away most of the squared errors.
    """
    turning, names = [*filter(_turns, case.dataset.effects)], [t.name for t in case.trajectories]
    if len(names) < 2 or not turning or not _is_fixed(case):
        return []
    at, count = case.dataset.effect_columns(turning[0]), len(turning[0].parameters)
    cross, total = np.zeros((len(fit.x), count * len(names))), 0.0
    # The prior deviation of a turn is 1 rad.
    gram, pull = np.eye(cross.shape[1]), np.zeros(cross.shape[1])
    for j, data in enumerate(case.dataset.data):
        local = data.local(at)
        logged = data.logged_rows(case.folds)
        kept = max(sum(len(rows.b) for _, rows in logged), 1)
        weight = fit.weights[j] * model.rows[j] / kept  # long logs keep only some rows
        for log, rows in logged:
            columns, effort = model.row_columns(fit, j, rows.A, rows.b)
            turns, left = rows.A[:, local] * (local >= 0), effort - columns @ fit.x
            own = count * log + np.arange(count)
            cross[:, own] += weight * columns.T @ turns
            gram[np.ix_(own, own)] += weight * turns.T @ turns
            pull[own] += weight * turns.T @ left
            total += weight * float(left @ left)
    gram -= cross.T @ np.linalg.solve(model.hessian(fit), cross)
    if np.linalg.eigvalsh(gram)[0] <= 0.0:  # the kept rows are not like the others
        return []
    found = np.linalg.solve(gram, pull)
    if pull @ found < _SHARE * total:
        return []
    each = found.reshape(len(names), count)
    pairs = [(np.linalg.norm(each[i] - each[k]), i, k) for k in range(len(each)) for i in range(k)]
    angle, one, other = max(pairs)
    if np.degrees(angle) < _LEAST_MOVED:
        return []
    return [
        f"the direction of gravity differs by about {np.degrees(angle):.0f}° between {names[one]} "
        f"and {names[other]}: if the base was moved, explain them separately"
    ]


def _turns(effect: Effect) -> bool:
    return type(effect).gravity_of_bodies is not Effect.gravity_of_bodies


def _gravity(case: Case) -> Array:
    """Return the gravity (3,) of a model with its effects, m/s²."""
    gravity, bodies = case.model.tree.gravity, case.model.bodies_at_rest
    for fitted in case.model.effects:
        if _turns(fitted.effect):
            effect = fitted.effect.expanded_about(fitted.parameters, bodies)
            turned = effect.gravity_of_bodies(gravity)
            return gravity if turned is None else turned
    return gravity


def _felt(case: Case) -> Array | None:
    """Return the gravity (3,) that explains most errors, m/s²; None if a change does not."""
    if not _is_fixed(case):
        return None
    change, removed = _change_of_gravity(case)
    felt, size = _gravity(case) + change, float(np.linalg.norm(case.model.tree.gravity))
    other_size = abs(np.linalg.norm(felt) / size - 1.0) > _OTHER_SIZE
    return None if removed < _SHARE or other_size else felt


def _is_fixed(case: Case) -> bool:
    known = not any(log.has_unknown_forces for log in case.trajectories)
    return known and not case.model.base_joints and bool(case.model.tree.gravity.any())


def _angle(one: Array, other: Array) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))


def _turned(effect: Effect, felt: Array, bodies: RobotBodies) -> Effect:
    """Return an effect that turns gravity to the direction of `felt` (3,), or close to it."""
    size, direction = float(np.linalg.norm(bodies.gravity)), felt / np.linalg.norm(felt)

    def error(parameters: Array) -> Array:
        turned = effect.expanded_about(parameters, bodies).gravity_of_bodies(bodies.gravity)
        return (bodies.gravity if turned is None else turned) / size - direction

    starts = _START * np.eye(len(effect.parameters))
    fits = [least_squares(error, start) for start in (*starts, *-starts)]
    least = min(fit.cost for fit in fits) + _ALIKE
    best = [fit.x for fit in fits if fit.cost <= least]  # whole turns further are the same
    return effect.expanded_about(min(best, key=np.linalg.norm), bodies)


def _change_of_gravity(case: Case) -> tuple[Array, float]:
    """Return the change of gravity (3,) that explains the model's errors best, m/s², and its share.

    The share is of the squared errors that are left by friction, a rotor and an offset of each
    joint.
    """
    parts = list[tuple[Array, Array]]()
    widths = sign_widths(case.load_model, case.trajectories)
    for log in case.trajectories:
        robot = carrying(case.load_model, log.payloads)
        step = max(1, sum(map(len, log.segments)) // _POSES)
        for segment in log.segments:
            poses = segment[::step]
            motion = motion_of(poses, robot, log)
            left = poses.effort - robot.effort(motion, sign_width=widths)
            bodies = RobotBodies(robot.tree, motion.q, robot.total_phi)
            direction = np.tanh(motion.v / np.maximum(widths, 1e-9))
            own = np.stack([direction, motion.v, motion.vd, np.ones_like(motion.v)], axis=2)
            parts.append((left, np.concatenate([own, bodies.gravity_efforts(np.eye(3))], axis=2)))
    left, columns = (np.concatenate(each) for each in zip(*parts, strict=True))
    rows = [np.zeros((1, 4))]
    for j in np.flatnonzero(np.isfinite(left).all(axis=0) & (left.std(axis=0) > 0.0)).tolist():
        own, signals = columns[:, j, :4], np.column_stack([columns[:, j, 4:], left[:, j]])
        signals = signals - own @ np.linalg.lstsq(own, signals, rcond=1e-9)[0]
        rows.append(signals / left[:, j].std())
    gravities, errors = np.split(np.concatenate(rows), [3], axis=1)
    change, *_ = np.linalg.lstsq(gravities, errors[:, 0], rcond=1e-6)
    after = errors[:, 0] - gravities @ change
    total = max(float(np.square(errors).sum()), 1e-300)
    return np.asarray(change), 1.0 - float(after @ after) / total
