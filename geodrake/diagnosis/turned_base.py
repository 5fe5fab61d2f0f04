"""A base that is mounted otherwise than the model says, as on a wall or a ceiling."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from geodrake.effects.base import Effect
from geodrake.effects.body_motion import RobotBodies
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.noise import motion_of
from geodrake.identification.logs.reduce import sign_widths
from geodrake.model.carried_payloads import carrying

Array = NDArray[np.float64]

_POSES = 400  # of each log at which gravity is looked at
_LEAST = 0.5  # rad; turns of less are found from the slope about the model's gravity
_LEAST_MOVED = 4.0  # degrees; gains that are off by 20 % look like half of it
_OTHER_SIZE = 0.3  # by which gravity may seem larger or smaller, as bodies and gains are off
_SHARE = 0.5  # of the squared errors that friction and rotors leave
_START = 2.0  # rad, about each axis in turn, from where a turn is looked for
_ALIKE = 1e-6  # half of the squared distance of two directions that are the same


def turned_bases(case: Case, effects: Iterable[Effect]) -> dict[Effect, Effect]:
    """Return those effects that turn gravity, far turned if that explains most errors.

    Efforts are linear in gravity, but not in large angles: upside down, a small turn to either side
    changes nothing. A model that is turned already keeps its effect, which is fitted along.
    """
    turning = [effect for effect in effects if _turns(effect)]
    if not turning or any(map(_turns, effects_of(case.model))):
        return {}
    felt = _felt(case)
    if felt is None or _angle(felt, case.model.tree.gravity) < _LEAST:
        return {}
    return {effect: _turned(effect, felt, case.model.bodies_at_rest) for effect in turning}


def moved_base_notes(case: Case) -> list[str]:
    """Return a note on a model with an effect that turns gravity, if the base stands otherwise.

    Its angles are known from other logs, and do not follow.
    """
    turning = [f for f in case.model.effects if _turns(f.effect)]
    if len(turning) != 1 or (felt := _felt(case)) is None:
        return []
    (own,) = turning
    angle = np.degrees(_angle(felt, _gravity(case)))
    if angle < _LEAST_MOVED:
        return []
    return [
        f"these logs show gravity {angle:.0f}° from where the model's {own.effect.name} has it: "
        "if the base was moved, explain them with the model without that effect"
    ]


def _turns(effect: Effect) -> bool:
    return type(effect).gravity_of_bodies is not Effect.gravity_of_bodies


def _gravity(case: Case) -> Array:
    """Return the gravity of a model with its effects (3,), m/s²."""
    gravity, bodies = case.model.tree.gravity, case.model.bodies_at_rest
    for fitted in case.model.effects:
        if _turns(fitted.effect):
            effect = fitted.effect.expanded_about(fitted.parameters, bodies)
            turned = effect.gravity_of_bodies(gravity)
            return gravity if turned is None else turned
    return gravity


def _felt(case: Case) -> Array | None:
    """Return gravity (3,), m/s², as another one would explain most errors; None if none would."""
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
    """Return an effect under which gravity points as it is felt (3,), or nearly."""
    size, wanted = float(np.linalg.norm(bodies.gravity)), felt / np.linalg.norm(felt)

    def apart(parameters: Array) -> Array:
        turned = effect.expanded_about(parameters, bodies).gravity_of_bodies(bodies.gravity)
        return (bodies.gravity if turned is None else turned) / size - wanted

    starts = _START * np.eye(len(effect.parameters))
    tried = [least_squares(apart, start) for start in (*starts, *-starts)]
    least = min(each.cost for each in tried) + _ALIKE
    found = [each.x for each in tried if each.cost <= least]  # whole turns further are the same
    return effect.expanded_about(min(found, key=np.linalg.norm), bodies)


def _change_of_gravity(case: Case) -> tuple[Array, float]:
    """Return the change of gravity (3,) that explains the model's errors best, m/s².

    The second result is the share of their squares that it explains, of what is left by friction,
    a rotor and an offset of each joint.
    """
    parts = list[tuple[Array, Array]]()
    widths = sign_widths(case.load_model, case.trajectories)
    for log in case.trajectories:
        robot = carrying(case.load_model, log.payloads)
        step = max(1, sum(map(len, log.segments)) // _POSES)
        for segment in log.segments:
            some = segment[::step]
            motion = motion_of(some, robot, log)
            left = some.effort - robot.effort(motion, sign_width=widths)
            bodies = RobotBodies(robot.tree, motion.q, robot.total_phi)
            direction = np.tanh(motion.v / np.maximum(widths, 1e-9))
            own = np.stack([direction, motion.v, motion.vd, np.ones_like(motion.v)], axis=2)
            parts.append((left, np.concatenate([own, bodies.gravity_efforts(np.eye(3))], axis=2)))
    left, columns = (np.concatenate(each) for each in zip(*parts, strict=True))
    rows = [np.zeros((1, 4))]
    for j in np.flatnonzero(np.isfinite(left).all(axis=0) & (left.std(axis=0) > 0.0)).tolist():
        own, both = columns[:, j, :4], np.column_stack([columns[:, j, 4:], left[:, j]])
        both = both - own @ np.linalg.lstsq(own, both, rcond=1e-9)[0]
        rows.append(both / left[:, j].std())
    gravities, errors = np.split(np.concatenate(rows), [3], axis=1)
    change, *_ = np.linalg.lstsq(gravities, errors[:, 0], rcond=1e-6)
    after = errors[:, 0] - gravities @ change
    total = max(float(np.square(errors).sum()), 1e-300)
    return np.asarray(change), 1.0 - float(after @ after) / total
