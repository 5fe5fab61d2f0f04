"""Fits of columns whose gains nobody knows: they end at a minimum, by other means too."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from geodrake.diagnosis.columns.design import JointDesign
from geodrake.diagnosis.columns.gaussian import JointEquations, most_probable

_SHARED, _OWN, _ROWS = 6, 2, 300


@pytest.mark.parametrize("seed", range(8))
def test_fits_with_unknown_gains_end_at_a_minimum(seed: int) -> None:
    """Two joints share bodies that matter little beside their friction; their gains are unknown."""
    random = np.random.default_rng(seed)
    count = _SHARED + 2 * _OWN + 2
    truth = np.concatenate([1.0 + 0.3 * random.normal(size=_SHARED), random.normal(size=2 * _OWN)])
    gains = count - 2 + np.arange(2)
    joints, sizes = [], np.repeat([0.02, 1.0], [_SHARED, _OWN])
    for j, error in enumerate((0.6, -0.6)):
        own = _SHARED + _OWN * j + np.arange(_OWN)
        columns = random.normal(size=(_ROWS, _SHARED + _OWN)) * sizes
        signal = np.exp(error) * columns @ truth[[*range(_SHARED), *own]]
        signal += 0.01 * np.std(signal) * random.normal(size=_ROWS)
        X = np.column_stack([columns, np.zeros(_ROWS), signal])
        at = np.array([*range(_SHARED), *own, gains[j]])
        effort, known = np.eye(X.shape[1])[[-1, -2]]
        design = JointDesign(own, np.arange(_ROWS), 0, X, X.T @ X)
        joints.append(JointEquations(design, at, np.arange(_SHARED + _OWN), effort, known))
    mean = np.concatenate([np.ones(_SHARED), np.zeros(2 * _OWN + 2)])
    spread = np.concatenate([np.full(_SHARED, 0.3), np.full(2 * _OWN, 10.0), np.full(2, 1.0)])
    information, worth = np.diag(spread**-2.0), np.full(2, float(_ROWS))
    prior = mean, information, np.full(count, -np.inf)
    found = most_probable(joints, worth, prior, start=mean, gains=gains)

    def cost(x: np.ndarray) -> float:
        errors = [np.mean(np.subtract(*joint.needed(x)) ** 2) for joint in joints]
        return float((x - mean) @ information @ (x - mean) + worth @ np.log(errors))

    bounds = [(-0.7, 0.7) if i in gains else (None, None) for i in range(count)]
    best = minimize(cost, found.x, bounds=bounds)
    assert cost(found.x) < best.fun + 0.1
    errors = [np.mean(np.subtract(*joint.needed(found.x)) ** 2) for joint in joints]
    np.testing.assert_allclose(found.mse, errors, rtol=1e-6)
