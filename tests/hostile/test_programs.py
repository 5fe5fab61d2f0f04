"""Ill-conditioned fits: a physical answer or a `GeodrakeError`, in time, and no process dies."""

import time

import numpy as np
import pytest
from hostile import HangError, limited
from measurements import DATA
from programs import apart, random_program, run

from geodrake.errors import GeodrakeError
from geodrake.identification import identify
from geodrake.inertia import is_physical

QUICK = [n for n in range(44) if random_program(1, n).solver != "csdp"]  # which takes its time


@pytest.mark.sampled(8)
@pytest.mark.parametrize("number", QUICK)
def test_random_program(number):
    outcome = run(1, number)
    assert outcome.end in ("solved", "refused"), outcome


@pytest.mark.measurements("data/solver_abort.npz")
@pytest.mark.parametrize("solver", [None, "newton", "clarabel"])
def test_what_once_ended_the_process(solver):
    data = np.load(DATA / "solver_abort.npz")
    options = {"gamma": float(data["gamma"]), "ellipsoids": data["ellipsoids"]}
    result = identify(
        data["A"], data["b"], data["prior"], regularizer="pullback", solver=solver, **options
    )
    assert np.all(is_physical(result.phi))
    cost = result.residual + result.gamma * result.divergence
    assert cost == pytest.approx(0.0039647747, rel=1e-3)  # at the boundary


def test_numbers_that_leave_no_digits_are_refused():
    prior = np.array([[1e-300, 0, 0, 0, 1e-300, 1e-300, 1e-300, 0, 0, 0]])
    with pytest.raises(GeodrakeError):
        identify(np.eye(10), np.ones(10), prior, regularizer="pullback", gamma=1.0)


def spin():
    while True:
        pass


def test_limits_of_time_count_the_processor():
    assert apart(spin, 1) == "hung"
    with pytest.raises(HangError, match="spin has not ended: SIGPROF"), limited("spin", 0.1):
        spin()
    with limited("a wait", 0.1):
        time.sleep(0.3)
