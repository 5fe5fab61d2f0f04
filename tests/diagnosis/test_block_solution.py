"""Normal equations of blocks and base parameters of bodies against dense algebra."""

import numpy as np
import pytest

from geodrake.diagnosis.base_unknowns import BaseUnknowns
from geodrake.diagnosis.block_solution import (
    prior_distance,
    prior_matrix,
    shared_prior,
    solve_blocks,
    structure_of,
)
from geodrake.identification.logs.unknowns import Unknowns

# Bodies (0 to 2), a payload (3, 4), and terms of joints: 5, 6 of joint 0, 7 of joint 1, none of 2.
GROUPS = np.array([-1, -1, -1, -1, -1, 0, 0, 1])
COLUMNS = ([0, 1, 4, 5, 6], [1, 2, 3, 7], [0, 2], [0, 1, 4, 5, 6])  # the last: reversals of joint 0
FIRST_BLOCKS = np.array([0, 1, 2, 0])


def information(rng, size):
    root = rng.normal(size=(size, size))
    return root @ root.T + np.eye(size)


def the_prior(rng):
    own, first = np.zeros((len(GROUPS), 2)), np.array([0, 1, 2, 3, 3, 5, 5, 7])
    own[3:5], own[5:7], own[7, 0] = information(rng, 2), information(rng, 2), 2.0
    return information(rng, 3), own, first, rng.normal(size=len(GROUPS))


@pytest.mark.parametrize("ridge", [0.0, 1e-2])
def test_blocks_are_solved_as_the_dense_equations(ridge):
    rng = np.random.default_rng(0)
    prior, weights, right = the_prior(rng), rng.uniform(0.5, 2.0, 4), rng.normal(size=8)
    A, triangles = prior_matrix(prior), []
    np.testing.assert_array_equal(A, A.T)
    deviation = rng.normal(size=8)
    assert prior_distance(prior, deviation) == pytest.approx(deviation @ A @ deviation)
    for columns, weight in zip(COLUMNS, weights, strict=True):
        rows = rng.normal(size=(9, len(columns)))
        gram = rows.T @ rows
        A[np.ix_(columns, columns)] += weight * gram
        triangles.append(gram[np.tril_indices(len(columns))])
    A += ridge * np.diag(np.diag(A))
    ends = np.cumsum([0, *map(len, COLUMNS)])
    packed = np.concatenate(COLUMNS), ends, np.concatenate(triangles)
    structure, x = structure_of(GROUPS, FIRST_BLOCKS), right.copy()
    factor = shared_prior(prior, structure)
    logarithm = solve_blocks((packed, weights), prior, structure, (factor, x), ridge)
    np.testing.assert_allclose(x, np.linalg.solve(A, right), rtol=1e-10)
    assert logarithm == pytest.approx(np.linalg.slogdet(A)[1])
    covariance = np.linalg.inv(A)[:5, :5]  # of shared unknowns
    np.testing.assert_allclose(np.linalg.inv(factor @ factor.T), covariance, atol=1e-10)


def rows_of_bodies(rng, kind):
    """Return rows (80, 20) of two bodies, whose columns depend on each other."""
    if kind == "independent":
        return rng.normal(size=(80, 20))
    rows = rng.normal(size=(80, 7)) @ rng.normal(size=(7, 20))
    if kind == "a body at rest":
        rows[:, :10] = 0.0
    return 0.0 * rows if kind == "no rows" else rows


@pytest.mark.parametrize("width", [0.3, 1.0, 3.0])
@pytest.mark.parametrize(
    ("kind", "rank"),
    [("dependent", 7), ("independent", 20), ("a body at rest", 7), ("no rows", 0)],
)
def test_base_unknowns_have_the_evidence_and_values_of_all(kind, rank, width):
    """Also if parameters of effects correlate with bodies, as in a saved model."""
    rng = np.random.default_rng(1)
    bodies, p = rows_of_bodies(rng, kind), 23
    A, b = np.hstack([bodies, rng.normal(size=(80, 3))]), rng.normal(size=80)
    unbounded = np.full(p, np.inf)
    own = rng.normal(size=p), information(rng, p)
    unknowns = Unknowns(np.arange(p), *own, -unbounded, unbounded, (0, 10))
    base = BaseUnknowns.of(unknowns, bodies.T @ bodies)
    assert base.bodies == rank and len(base.kept) == rank + 3

    def solved(rows, mean, prior):
        """Return the solution, its covariance, and twice the log of the evidence."""
        H = prior + rows.T @ rows
        x = np.linalg.solve(H, prior @ mean + rows.T @ b)
        squares = np.sum(np.square(b - rows @ x)) + (x - mean) @ prior @ (x - mean)
        logarithms = [np.linalg.slogdet(matrix)[1] for matrix in (prior, H)]
        return x, np.linalg.inv(H), logarithms[0] - logarithms[1] - squares

    scale = np.where(np.arange(p) < 20, width, 1.0)
    x, covariance, evidence = solved(A, own[0], own[1] / scale / scale[:, None])
    scale = base.scales(width)
    prior = base.information / scale / scale[:, None]
    y, small, own_evidence = solved(A[:, base.kept], base.mean, prior)
    np.testing.assert_allclose(base.all_of(y, width), x, atol=1e-9)
    assert own_evidence == pytest.approx(evidence, abs=1e-8)
    volumes = [np.linalg.slogdet(matrix)[1] for matrix in (base.information, own[1])]
    assert base.log_volume == pytest.approx(volumes[0] - volumes[1], abs=1e-8)
    slopes, rest = base.slopes_of_body(1, width), base.rest_root(1, width)
    np.testing.assert_allclose(
        slopes @ small @ slopes.T + rest.T @ rest, covariance[10:20, 10:20], atol=1e-9
    )
