"""Logs as normal matrices of every joint, over base parameters and friction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from fleets.draws import FleetDraw, type_model
from fleets.simulation import RATE, FleetLog, robot_logs
from geodrake.fleet.columns import Spread, TypeColumns, body_spread, column_spreads
from geodrake.fleet.hypotheses import ChangeHypothesis, body_change, column_change
from geodrake.identification.logs.evidence import effective_samples_of_each
from geodrake.robot import inverse_dynamics_regressor
from geodrake.robot.base_parameters import BaseParameters, structural_base_parameters

Array = NDArray[np.float64]

COULOMB, VISCOUS, OFFSET = "coulomb_friction", "viscous_friction", "effort_offset"
BOTH = f"{COULOMB}+{VISCOUS}"
SCALE, LOAD = "effort_scale", "payload"
_EFFECTS = (COULOMB, VISCOUS, OFFSET)
_WINDOW, _ORDER = 11, 4  # samples over which positions are differentiated
_WIDTH = 0.01  # rad/s, within which the direction of motion is not known


@dataclass(frozen=True, eq=False)
class RobotDigests:
    """What is kept of a robot's logs.

    Attributes:
        robot: Its name.
        days: (T,) days.
        grams: (T, n, p + 1, p + 1) matrices [A | b]ᵀ[A | b] of each log and joint.
        weights: (T, n) independent share of the rows over the variance of the noise.
    """

    robot: str
    days: Array
    grams: Array
    weights: Array


def digest_robot(draw: FleetDraw) -> RobotDigests:
    """What is kept of all logs of a robot."""
    days, grams, weights = [], [], []
    for log in robot_logs(draw):
        gram, weight = _digest(draw.kind, log)
        days.append(log.day)
        grams.append(gram)
        weights.append(weight)
    return RobotDigests(draw.name, np.array(days), np.array(grams), np.array(weights))


def _digest(kind: str, log: FleetLog) -> tuple[Array, Array]:
    """Matrices of one log, and what its rows are worth by what its own fit leaves."""
    model, base = type_model(kind), type_base(kind)
    n = len(model.joints)
    q, v, a = (
        savgol_filter(log.position, _WINDOW, _ORDER, d, 1.0 / RATE, axis=0)[_WINDOW:-_WINDOW]
        for d in range(3)
    )
    Y = base.regressor(inverse_dynamics_regressor(model.tree, q, v, a))
    grams, weights = [], []
    b = log.effort[_WINDOW:-_WINDOW]
    for j in range(n):
        effects = np.zeros((len(q), n, len(_EFFECTS)))
        effects[:, j] = np.stack([np.tanh(v[:, j] / _WIDTH), v[:, j], np.ones(len(q))], -1)
        A = np.hstack([Y[:, j], effects.reshape(len(q), -1)])
        rows = np.hstack([A, b[:, [j]]])
        grams.append(rows.T @ rows)
        seen = A[:, A.any(axis=0)]
        seen = seen / np.linalg.norm(seen, axis=0)
        x, _, rank, _ = np.linalg.lstsq(seen, b[:, j], 1e-6)
        rest = b[:, j] - seen @ x
        share = effective_samples_of_each([[rest[:, None]]])[0, 0] / len(rest)
        weights.append(share * (len(rest) - rank) / (rest @ rest))
    return np.array(grams), np.array(weights)


@cache
def type_base(kind: str) -> BaseParameters:
    """Base parameters of a type."""
    return structural_base_parameters(type_model(kind).tree)


def type_columns(kind: str) -> TypeColumns:
    """What the columns are: base parameters, friction and offset of every joint, gains."""
    model, base = type_model(kind), type_base(kind)
    n, bodies = len(model.joints), base.rank
    p = bodies + n * (len(_EFFECTS) + 1)
    at = {e: bodies + np.arange(n) * len(_EFFECTS) + i for i, e in enumerate(_EFFECTS)}
    at[SCALE] = np.arange(p - n, p)
    relative = np.zeros(p, bool)
    relative[at[COULOMB]] = relative[at[VISCOUS]] = True
    names = [f"{effect} of {joint}" for effect in at for joint in model.joints]
    prior = np.zeros(p)
    prior[:bodies] = base.values(model.phi)
    return TypeColumns(
        prior,
        np.arange(p) < p - n,
        relative,
        relative.copy(),
        n,
        (
            *_body_spreads(kind, p),
            *column_spreads(names, np.concatenate(list(at.values())).tolist(), p),
        ),
    )


def type_hypotheses(kind: str, mass: float = 1.0) -> list[ChangeHypothesis]:
    """What may change: friction, offsets and gains of joints, and a payload on any body."""
    model, base = type_model(kind), type_base(kind)
    n, bodies = len(model.joints), base.rank
    p = bodies + n * (len(_EFFECTS) + 1)
    found = []
    for j, joint in enumerate(model.joints):
        dry, viscous, offset = bodies + j * len(_EFFECTS) + np.arange(3)
        found += [
            column_change(COULOMB, joint, [dry], p),
            column_change(VISCOUS, joint, [viscous], p),
            column_change(BOTH, joint, [dry, viscous], p),
            column_change(OFFSET, joint, [offset], p),
            column_change(SCALE, joint, [p - n + j], p, size=0.1, kinds=("step",)),
        ]
    for k, body in enumerate(model.bodies):
        found.append(body_change(LOAD, str(body), k, model.phi, p, mass=mass, matrix=base.matrix))
    return found


def _body_spreads(kind: str, count: int) -> list[Spread]:
    """How each body differs."""
    model, found = type_model(kind), []
    for k, body in enumerate(model.bodies):
        phi = np.full_like(model.phi, np.nan)
        phi[k] = model.phi[k]
        found.append(body_spread(str(body), phi, count, matrix=type_base(kind).matrix))
    return found
