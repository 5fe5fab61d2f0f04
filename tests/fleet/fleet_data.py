"""Rows of small fleets, from which their normal matrices come."""

from dataclasses import dataclass

import numpy as np

from geodrake.fleet.history import JointGrams, RobotHistory
from geodrake.fleet.type_columns import ChangeHypothesis, Spread, TypeColumns

P, NOISE = 4, 0.1
MEAN = np.array([2.0, -1.0, 0.5, 0.8])  # two of bodies, two of friction
UNIT = np.array([1.0, 1.0, *MEAN[2:]])  # friction differs in shares
DEVIATION, SCATTER = 0.1, 0.03
NAMES = ("mass", "moment", "dry", "viscous")


@dataclass(frozen=True)
class Rows:
    """Rows of one robot: A (T, m, p) and b (T, m)."""

    A: np.ndarray
    b: np.ndarray

    def grams(self, weight=NOISE**-2):
        """Return normal matrices over all columns that occur."""
        seen = np.flatnonzero(self.A.any(axis=(0, 1)))
        both = np.concatenate([self.A[..., seen], self.b[..., None]], axis=2)
        return JointGrams(seen, np.swapaxes(both, 1, 2) @ (weight * both))

    def history(self, name="robot"):
        T = len(self.b)
        return RobotHistory(name, np.arange(float(T)), np.full(T, np.nan), P, (self.grams(),))


def columns(course=False):
    """Return columns of bodies, which differ together, and of friction with its shares."""
    relative = np.array([False, False, True, True])
    unit = np.eye(P)
    spreads = (
        Spread("bodies", unit[:, :2]),
        Spread("dry", unit[:, [2]]),
        Spread("viscous", unit[:, [3]]),
    )
    return TypeColumns(1.1 * MEAN, relative, relative & course, 0, spreads)


def hypotheses():
    def change(effect, where, *at, **how):
        return ChangeHypothesis(
            effect, where, np.eye(P)[:, at], tuple((NAMES[k], "") for k in at), **how
        )

    return [
        change("dry", "elbow", 2),
        change("viscous", "elbow", 3),
        change("both", "elbow", 2, 3),
        change("load", "hand", 0, 1, kinds=("step",)),
    ]


def robot(rng, logs=20, rows=30, change=None, together=0.0):
    """Return a robot; change(t) and together (T,) are shares of its friction."""
    own = MEAN + DEVIATION * UNIT * rng.normal(size=P)
    x = own + SCATTER * np.array([1.0, 1.0, *own[2:]]) * rng.normal(size=(logs, P))
    x[:, 2:] += own[2:] * np.broadcast_to(together, logs)[:, None]
    if change is not None:
        x += own * np.array([change(t) for t in range(logs)])
    A = rng.normal(size=(logs, rows, P))
    return Rows(A, np.einsum("tmp,tp->tm", A, x) + NOISE * rng.normal(size=(logs, rows)))
