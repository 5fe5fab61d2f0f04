"""Changes are found where they are, and hardly ever where nothing changed."""

from dataclasses import replace

import numpy as np
import pytest
from fleet_data import MEAN, columns, hypotheses, robot

from geodrake.fleet.changes import find_changes as find
from geodrake.fleet.history import DAY
from geodrake.fleet.type_learning import learn_type

STEP = {2: lambda t: np.array([0.0, 0.0, 0.25, 0.0]) * (t >= 12)}
RAMP = {5: lambda t: np.array([0.0, 0.0, 0.0, 0.04]) * max(0, t - 10)}
LOAD = {7: lambda t: np.array([0.2, -0.3, 0.0, 0.0]) * (t < 6)}
BOTH = {
    8: lambda t: (
        np.array([0.0, 0.0, 0.3, 0.0]) * (t >= 6) + np.array([0.2, -0.3, 0.0, 0.0]) * (t >= 13)
    )
}
SEASON = 0.3 * np.sin(np.arange(20) / 6.0)


def fleet(seed, robots, changes, together=0.0, *, resting=False):
    rng = np.random.default_rng(seed)
    made = [robot(rng, change=changes.get(r), together=together) for r in range(robots)]
    for each in made if resting else ():
        each.A[::2, :, 2:4] = 0.0
    return [each.history(f"robot {r}") for r, each in enumerate(made)]


def find_changes(histories, known, **how):
    return find(histories, known, hypotheses(), lambda search: search.told(search.find()), **how)


def sizes(finding):
    return {each.name: each for each in finding.parameters}


@pytest.fixture(scope="module")
def found():
    changes = {**STEP, **RAMP, **LOAD, **BOTH}
    return find_changes(fleet(1, 10, changes, SEASON), columns(course=True))


def test_changes_are_told_with_day_effect_and_kind(found):
    told = {r: each for r, each in enumerate(found[1]) if each}
    assert set(told) == {2, 5, 7, 8}
    (step,), (ramp,), (load,) = told[2], told[5], told[7]
    both = sorted((each.date / DAY, each.where) for each in told[8])
    assert both == [(6.0, "elbow"), (13.0, "hand")]
    finding = step
    told = finding.robot, finding.where, finding.kind, finding.date
    assert told == ("robot 2", "elbow", "step", 12.0 * DAY)
    assert "dry" in {finding.effect, *(rival.effect for rival in finding.rivals)}
    dry = sizes(step)["dry"]
    assert dry.share == pytest.approx(0.25, abs=4 * dry.deviation / 0.5)
    finding = ramp
    assert finding.kind == "ramp" and abs(finding.date / DAY - 10.0) <= 2.0
    assert finding.interval[0] <= finding.date <= finding.interval[1]
    assert sizes(ramp)["viscous"].share == pytest.approx(0.36, abs=0.08)
    finding = load
    assert (finding.effect, finding.kind, finding.date) == ("load", "step", 6.0 * DAY)
    found_sizes = [each.size for each in finding.parameters]
    np.testing.assert_allclose(found_sizes, [-0.4, -0.3], rtol=0.3)  # shares of its own
    assert all(each.false_alarm_probability < 1e-4 for each in (step, ramp, load))


def test_a_season_is_of_all_and_of_no_single_robot(found):
    (course,) = {tuple(found[0].course.values[:, 0])}
    wave = SEASON - SEASON.mean()
    assert np.corrcoef(course, wave)[0, 1] > 0.98
    alone = fleet(1, 10, {}, SEASON)
    assert (learn_type(alone, columns()).scatter[1:] > 3.0 * found[0].scatter[1:]).all()


def test_temperatures_tell_halls_apart():
    """Friction varies with each hall's own temperature, which no common course could say."""
    rng, histories = np.random.default_rng(7), []
    for r in range(12):
        wave = (1.0 if r % 2 else -1.0) * SEASON
        made = robot(rng, together=wave).history(f"robot {r}")
        histories.append(replace(made, temperature=20.0 + 10.0 * wave))
    found = find_changes(histories, columns(course=True), passes=1)
    np.testing.assert_allclose(found[0].course.slope, 0.1, rtol=0.15)
    assert not any(found[1])


def test_odd_logs_and_joints_that_rest_are_no_changes():
    """Columns of resting joints are zero."""
    odd = {0: lambda t: np.array([0.0, 0.0, 0.5, 0.0]) * (t == 9)}
    histories = fleet(3, 7, odd, resting=True)
    assert not any(find_changes(histories, columns(), passes=1)[1])


def test_one_log_tells_no_change():
    rng = np.random.default_rng(5)
    histories = [robot(rng, logs=1).history() for _ in range(3)]
    assert not any(find_changes(histories, columns(), passes=1)[1])


def test_changes_are_found_however_large():
    """Logs before them are as odd as any, and a robot may be one of its type after them only."""
    size = 10.0
    load = {7: lambda t: size * LOAD[7](t)}
    less = {3: lambda t: size * np.array([0.0, 0.0, 0.3, 0.0]) * (t < 9)}
    changes = find_changes(fleet(1, 10, {**load, **less}), columns())[1]
    findings = [(r, c) for r, each in enumerate(changes) for c in each]
    told = [(r, each.effect, each.kind, each.date / DAY) for r, each in findings]
    assert told == [(3, "dry", "step", 9.0), (7, "load", "step", 6.0)]
    assert sizes(changes[3][0])["dry"].share == pytest.approx(-0.3 * size, rel=0.1)
    expected = [-0.2 * size * MEAN[0], 0.3 * size * MEAN[1]]
    put_on = [each.size for each in changes[7][0].parameters]
    np.testing.assert_allclose(put_on, expected, rtol=0.2)
