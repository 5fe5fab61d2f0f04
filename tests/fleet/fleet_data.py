"""Small fleets, as rows: what their normal matrices come from."""

from dataclasses import dataclass

import numpy as np

from geodrake.fleet.columns import Spread, TypeColumns, column_spreads
from geodrake.fleet.history import weighted_history
from geodrake.fleet.hypotheses import column_change

P, NOISE = 4, 0.1
MEAN = np.array([2.0, -1.0, 0.5, 0.8])  # two of bodies, two of friction
DEVIATION, SCATTER = 0.1, 0.03


@dataclass(frozen=True)
class Rows:
    """One robot's rows: A (T, m, p) and b (T, m)."""

    A: np.ndarray
    b: np.ndarray

    def history(self, name="robot", days=None):
        both = np.concatenate([self.A, self.b[..., None]], axis=2)
        grams = (np.swapaxes(both, 1, 2) @ both)[:, None]
        days = np.arange(len(self.b)) if days is None else days
        return weighted_history(name, days, grams, np.full((len(self.b), 1), NOISE**-2))


def columns(course=False):
    """Bodies differ together, friction by itself and in shares."""
    relative = np.array([False, False, True, True])
    spreads = (Spread("bodies", np.eye(P)[:, :2]), *column_spreads(["dry", "viscous"], [2, 3], P))
    free = np.ones(P, bool)
    return TypeColumns(1.1 * MEAN, free, relative, relative & course, 0, spreads)


def hypotheses():
    return [
        column_change("dry", "elbow", [2], P),
        column_change("viscous", "elbow", [3], P),
        column_change("both", "elbow", [2, 3], P),
        column_change("load", "hand", [0, 1], P, kinds=("step",)),
    ]


def robot(rng, logs=20, rows=30, change=None, together=0.0):
    """A robot with its own parameters; change(t) and together (T,) are shares of its friction."""
    unit = np.array([1.0, 1.0, *MEAN[2:]])
    own = MEAN + DEVIATION * unit * rng.normal(size=P)
    x = own + SCATTER * np.array([1.0, 1.0, *own[2:]]) * rng.normal(size=(logs, P))
    x[:, 2:] += own[2:] * np.broadcast_to(together, logs)[:, None]
    if change is not None:
        x += own * np.array([change(t) for t in range(logs)])
    A = rng.normal(size=(logs, rows, P))
    return Rows(A, np.einsum("tmp,tp->tm", A, x) + NOISE * rng.normal(size=(logs, rows)))
