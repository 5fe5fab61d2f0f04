"""The human study: the source's table 3.1, equal residuals, and bodies that stay bodies."""

import json

import numpy as np
import pytest
from scripts import call

from diagrams.studies.human_identification import Human, blocks

NEEDED = pytest.mark.measurements("data/human_force_plate.npz")
TABLE = {  # [Lee2019] table 3.1, training: N, cm, cm
    "prior": (13.79, 2.09, 1.58),
    "euclidean": (12.89, 1.61, 0.82),
    "pullback": (12.52, 1.66, 0.81),
    "entropic": (12.51, 1.66, 0.81),
}


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    folder = tmp_path_factory.mktemp("human")
    options = ("--json", folder / "table.json", "--figures", folder)
    call("human_identification", "--quick", *options)
    assert len(list(folder.glob("human_*.png"))) == 3
    return json.loads((folder / "table.json").read_text(encoding="utf-8"))


@pytest.mark.thorough
@NEEDED
def test_blocks_that_were_not_fitted_are_predicted_better_than_by_the_prior(tables):
    found = {line["regularizer"]: np.array(line["test"]) for line in tables["errors"]}
    np.testing.assert_allclose(found["prior"], TABLE["prior"], atol=0.005)
    for name in set(found) - {"prior"}:
        assert (found[name] < 0.95 * found["prior"]).all(), name
        trained = next(e["train"] for e in tables["errors"] if e["regularizer"] == name)
        assert (found[name][1:] > trained[1:]).all(), name


@pytest.mark.thorough
@NEEDED
def test_residuals_and_bodies(tables):
    assert len(tables["fits"]) == 10
    for row in tables["fits"]:
        assert abs(row["mismatch"]) < 1e-5
        assert sum(row["masses"]) == pytest.approx(64.0, rel=1e-7)
        if row["regularizer"] == "euclidean":
            assert len(row["degenerate"]) >= 8  # as in figure 3.13
        else:
            assert not row["degenerate"] and row["least"] > 0.1
        assert row["starts_agree"] in ((True,) if row["regularizer"] == "riemannian" else (None,))


def test_errors_are_those_of_forces_and_points():
    """A body of 10 kg at (0.3, 0.1) m, seen as 12 kg at (0.2, 0.1) m."""
    rows = np.zeros((3, 10))
    rows[0, 2] = rows[1, 1] = rows[2, 0] = 9.81
    seen = np.array([12.0, 2.4, 1.2, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    human = Human(rows, rows @ seen, np.ones(3), *(np.zeros((1, 4, 4)),) * 3)
    phi = np.array([[10.0, 3.0, 1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(human.errors(phi), [[-2 * 9.81, 10.0, 0.0]], atol=1e-12)


def test_blocks_hold_every_step_once_and_training_keeps_away():
    found = list(blocks(33, 3, 2))
    np.testing.assert_array_equal(np.concatenate([test for _, test in found]), np.arange(33))
    for training, test in found:
        apart = np.abs(training[:, None] - test).min()
        assert apart == 3
        assert len(training) + len(test) in (29, 31)
