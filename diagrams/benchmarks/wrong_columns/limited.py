"""Motions of a robot one of whose motors gives less than its controller asks for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from diagrams.benchmarks.hidden.engines import Engine

Array = NDArray[np.float64]

_STEPS = 8  # between two rows
_STIFFNESS, _DAMPING = 150.0, 25.0  # 1/s² and 1/s, of the controller


@dataclass(frozen=True, eq=False)
class Limited:
    """A controlled motion: positions, velocities and what was asked for, (N, n) each."""

    q: Array
    v: Array
    asked: Array


def follow(
    engine: Engine,
    wanted: tuple[Array, Array, Array, Array],
    friction: Callable[[Array], Array],
    inertia: Array,
    given: Callable[[Array, Array], Array],
) -> Limited:
    """Forward dynamics under a computed torque, of which the motors give a part.

    Accelerations solve (M + h F') a = given − bias − friction, by the slope F' of the friction over
    a step h; M and the bias are inverse dynamics of unit accelerations and of none.

    Args:
        engine: The robot.
        wanted: Instants (N,), positions, velocities and accelerations (N, n).
        friction: Efforts (n,) of friction at velocities.
        inertia: (n,) of the rotors, kg·m².
        given: Efforts (n,) that the motors give, by what is asked for and the velocities.
    """
    time, *motion = wanted
    step = float(time[1] - time[0]) / _STEPS
    fine = time[0] + step * np.arange((len(time) - 1) * _STEPS + 1)
    goals = [np.column_stack([np.interp(fine, time, own) for own in w.T]) for w in motion]
    q, v = goals[0][0].copy(), goals[1][0].copy()
    n, rows = len(q), []
    units = np.vstack([np.zeros(n), np.eye(n)])
    for k, (q_wanted, v_wanted, a_wanted) in enumerate(zip(*goals, strict=True)):
        found = engine.efforts(np.tile(q, (n + 1, 1)), np.tile(v, (n + 1, 1)), units)
        bias, M = found[0], (found[1:] - found[0]).T + np.diag(inertia)
        a = a_wanted + _DAMPING * (v_wanted - v) + _STIFFNESS * (q_wanted - q)
        asked = M @ a + bias + friction(v)
        if k % _STEPS == 0:
            rows.append((q, v, asked))
        slope = (friction(v + 1e-4) - friction(v - 1e-4)) / 2e-4
        a = np.linalg.solve(M + step * np.diag(slope), given(asked, v) - bias - friction(v))
        v = v + step * a
        q = q + step * v
    return Limited(*(np.array(column) for column in zip(*rows, strict=True)))
