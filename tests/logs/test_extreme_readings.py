"""Numbers that no sensor has are told of in words, not by warnings of NumPy (which fail here)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pendulum_logs import PENDULUM, pendulum_log

from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs.compare import compare
from geodrake.logs.files.reading import Reading
from geodrake.logs.inspection import inspect_log
from geodrake.logs.unit_hints import effort_unit_hint
from geodrake.model.logged_joints import model_of_logs
from geodrake.model.saved_model import load_model


@pytest.fixture(scope="module")
def log():
    return pendulum_log(1, seconds=10.0)


@pytest.mark.parametrize("size", [1e308, -1e200, 1e-200])
def test_efforts_of_any_size_are_compared_or_refused(log, size):
    wrong = replace(log, effort=size * np.sin(log.effort))
    model = load_model(PENDULUM)
    assert model_of_logs(model, [wrong]).joints == model.joints
    try:
        found = compare(model, [wrong])
    except LogError as error:
        assert "no robot in SI units has that" in error.problem or "never changes" in error.problem
    else:
        assert np.isfinite(found.errors.nrms)


@pytest.mark.parametrize("factor", [1e200, 1e-200])
def test_times_of_any_length_are_inspected_or_refused(log, tmp_path, factor):
    path = Path(tmp_path, "log.csv")
    rows = np.column_stack([factor * log.time, log.position, log.effort])
    names = ["time", *(f"{j}.{q}" for q in ("position", "effort") for j in log.joints)]
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="")
    if factor > 1.0:
        with pytest.raises(LogError, match=r"Time in log 'log' reaches .* which no log does"):
            inspect_log(path)
    else:
        assert not inspect_log(path).rests


def test_limits_that_are_next_to_nothing_say_nothing_of_units(log):
    assert effort_unit_hint(log, 1e-308) is None
    strong = replace(log, effort=np.full_like(log.effort, 1e308))
    assert "other units" in effort_unit_hint(strong, 1e-8)


@pytest.mark.parametrize("rate", [10**400, -(10**400), np.inf, np.nan])
def test_rates_that_no_log_has_are_refused(rate):
    with pytest.raises(ArgumentError, match="rate"):
        Reading(rate=rate)
