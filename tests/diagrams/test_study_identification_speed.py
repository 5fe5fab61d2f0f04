"""The study of the speed of identification: its table says what it claims."""

import json
from contextlib import redirect_stdout
from io import StringIO

import pytest
from scripts import call

pytestmark = pytest.mark.thorough  # three processes that use the memory of a large program


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    folder = tmp_path_factory.mktemp("speed")
    options = ("--json", folder / "table.json", "--figures", folder, "--shared", folder)
    with redirect_stdout(StringIO()) as told:  # without measurements
        call("identification_speed", "--quick", "--seed", 3, *options)
    assert "There are no measurements in" in told.getvalue()
    assert (folder / "identification_speed.png").stat().st_size > 10_000
    return json.loads((folder / "table.json").read_text(encoding="utf-8"))


def test_all_solvers_have_the_same_cost(table):
    assert table["arm"]["size"] == [2100, 107]
    single = table["arm"]["from the factor"]
    assert abs(single["cost difference, drake"]) < 1e-6
    assert table["arm"]["sweep"]["largest cost difference"] < 1e-6
    if table["cvxpy"]:
        assert abs(single["cost difference, cvxpy"]) < 1e-4


def test_newton_is_faster(table):
    # Times of a busy machine: only the direction, the study itself measures the size.
    assert table["arm"]["from the factor"]["newton / drake"] < 0.8
    assert table["arm"]["sweep"]["drake / newton"] > 2.0


def test_memory_is_that_of_the_solve(table):
    for solver in ("clarabel", "newton"):
        memory = table["arm"]["memory, MB"][solver]
        assert 0.9 * memory["made"] < memory["solved"] < memory["made"] + 500.0


def test_geodesic_least_squares_is_a_minimum_and_better_than_the_prior(table):
    (row,) = table["arm"]["geodesic least squares"]
    assert row["curvature"] > 0
    assert row["entropic residual"] == pytest.approx(row["residual"], rel=1e-3)
    for kind in ("geodesic", "entropic"):
        assert row[kind]["error"] < 0.5 * row["prior"]["error"]
