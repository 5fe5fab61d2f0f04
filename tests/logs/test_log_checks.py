"""Faults of sensors, joints that rest, and hints at units."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measurements import DATA

from geodrake.errors import ArgumentError, LogError
from geodrake.logs import JointLog, read_log
from geodrake.logs.log_checks import check_repeated
from geodrake.logs.resting import logged_ranges, resting
from geodrake.logs.sensor_faults import LARGEST, without_faults
from geodrake.logs.uniform_log import make_uniform
from geodrake.logs.units_of_values import (
    effort_hint,
    effort_unit_hint,
    position_limit_hint,
    position_unit_hint,
)

ROOT = Path(__file__).parents[2]
LOGS = (ROOT / "geodrake" / "demo" / "demo.csv", *sorted(DATA.glob("*.csv")))
SERVOS = sorted((DATA / "so101").glob("*.state_motor.csv"))


def test_a_joint_that_only_pushes_has_no_magnitudes_beside_one_with_both_signs():
    time = np.arange(0.0, 10.0, 0.01)
    position = np.sin(2.0 * time[:, None] * [1.0, 1.3])
    lifted = np.maximum(np.sin(3.0 * time), 0.0)
    log = JointLog("legs", ("hip", "knee"), time, position, np.stack([lifted, lifted], 1))
    assert "hip, knee are never negative" in effort_hint(log)
    signed = np.stack([lifted, np.sin(3.0 * time)], 1)
    assert effort_hint(replace(log, effort=signed)) is None


def swing(*, seconds=20.0, rate=200.0, velocity=True, seed=0):
    """Return a log of two joints that swing, with noise of encoders and efforts."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1 / rate)
    phase = time[:, None] * np.array([1.7, 2.9]) + seed
    position = np.round(np.sin(phase) / 1e-4) * 1e-4
    speed = np.array([1.7, 2.9]) * np.cos(phase)
    effort = 3 * np.sin(phase) + 0.5 * np.sign(speed) + rng.normal(0, 0.02, phase.shape)
    velocity = speed if velocity else None
    return JointLog(f"swing {seed}", ("a", "b"), time, position, effort, velocity)


def changed(log, quantity, rows, joint, value):
    array = getattr(log, quantity).copy()
    array[rows, joint] = value
    return replace(log, **{quantity: array})


def lost(log, quantity, joint):
    """Return the rows in which a joint has no value."""
    return np.flatnonzero(np.isnan(getattr(log, quantity)[:, joint]))


@pytest.mark.parametrize("path", [*LOGS, *SERVOS], ids=lambda path: path.stem)
def test_nothing_is_wrong_with_real_logs(path):
    log = read_log(path)
    assert without_faults(log) is log


def knocked(log):
    """Apply 30 times the effort for five rows, and throw the joint by 0.1 rad."""
    log = changed(log, "effort", slice(1000, 1005), 0, 100.0)
    return changed(log, "position", slice(1000, 1003), 0, log.position[1000, 0] + 0.05)


def in_steps(log):
    """Round encoders to 1 mrad, and hold rounded efforts for ten rows."""
    effort = np.round(log.effort[(np.arange(len(log)) // 10) * 10], 1)
    return replace(log, position=np.round(log.position, 3), effort=effort)


def paused(log):
    """Let the joints rest for five seconds in the middle of the log."""
    pause = np.clip(log.time, None, 10.0) + np.clip(log.time - 15.0, 0, None)
    return replace(log, position=np.sin(pause[:, None] * [1.7, 2.9]), velocity=None)


def saturated(log):
    return replace(log, effort=np.clip(log.effort, -1.5, 1.5))


def switched_off(log):
    return changed(log, "effort", slice(1000, 2000), 0, 0.0)


def part_of(log, rows, *, later=0.0):
    signals = {name: getattr(log, name)[rows] for name in ("position", "effort")}
    return replace(log, name=str(rows), time=log.time[rows] + later, velocity=None, **signals)


def with_a_gap(log):
    return replace(log, time=log.time + 3600.0 * (np.arange(len(log)) > 2000))


def spinning(log):
    """Let a joint start from rest and reach 200 rad/s in the last tenth of the log."""
    late = np.clip(log.time - 18.0, 0, None)
    position = np.stack([100.0 * late**2, np.sin(log.time)], 1)
    return replace(log, position=position, velocity=None)


def noisy_in_motion(log):
    """Let efforts and velocities have noise only while a joint moves, which it seldom does."""
    rng = np.random.default_rng(3)
    moving = (np.arange(len(log)) // 400 % 5 == 0)[:, None]
    noise = np.where(moving, 1.0, 1e-3) * rng.normal(size=log.effort.shape)
    return replace(log, effort=noise, velocity=noise)


def pushed(log):
    return changed(log, "effort", slice(2000, 2003), 1, 120.0)


def flickering(log):
    """Let a joint rest, but for two readings of its encoder."""
    still = changed(log, "position", slice(None), 1, 0.3)
    still = changed(still, "velocity", slice(None), 1, 0.0)
    return changed(still, "position", [700, 1500], 1, 0.3001)


ODD = (knocked, in_steps, paused, saturated, switched_off, with_a_gap, spinning, noisy_in_motion)


@pytest.mark.parametrize("happen", [*ODD, pushed, flickering])
def test_normal_behaviour_is_no_fault(happen):
    log = happen(swing())
    assert without_faults(log) is log


@pytest.mark.parametrize("rows", [[3999], [0, 1, 2], [700, 701, 703, 2000]])
@pytest.mark.parametrize("value", [50.0, 1e300])
def test_spikes_and_only_they_are_left_out(rows, value):
    log = swing()
    found = without_faults(changed(log, "position", rows, 1, value))
    gone = lost(found, "position", 1)
    assert set(rows) <= set(gone)
    assert len(gone) <= len(rows) + 6  # some rows between two spikes go with them
    kept = np.isfinite(found.position[:, 1])
    assert np.array_equal(found.position[kept], log.position[kept])
    assert found.effort is log.effort
    (note,) = found.notes
    count = f"{len(rows)} outliers, the first" if len(rows) > 1 else "an outlier"
    assert note.startswith(f"the position of b has {count} at t = ")
    assert without_faults(found) is found


@pytest.mark.parametrize("quantity", ["position", "effort"])
def test_readings_that_often_drop_to_zero_are_left_out(quantity):
    log, rows = swing(), np.arange(37, 3900, 40)
    rows = np.sort(np.append(rows, rows[::5] + 1))  # some for two rows
    found = without_faults(changed(log, quantity, rows, 1, 0.0))
    gone, truth = lost(found, quantity, 1), np.abs(getattr(log, quantity)[rows, 1])
    assert set(rows[truth > 0.5 * truth.max()]) <= set(gone) <= set(rows)
    (note,) = found.notes
    assert note.startswith(f"the {quantity} of b drops to 0 in {len(gone)} rows, the first at t = ")
    assert without_faults(found) is found


def test_zero_is_a_level_of_coarse_efforts():
    log, coarse = swing(), np.ones(4000)
    coarse[np.arange(37, 3900, 40)] = 0.0
    steps = changed(log, "effort", slice(None), 1, coarse[: len(log)])
    assert without_faults(steps) is steps


FEW = [5, 640, 641, 1240, 1242, 3996]


@pytest.mark.parametrize(
    ("quantity", "height", "rows"),
    [
        ("effort", 120.0, FEW),
        ("velocity", -6.0, FEW),
        ("position", 0.4, FEW),
        ("position", 1e4, [*range(7, 4000, 400)]),
    ],
)
def test_brief_spikes_that_a_robot_could_make_otherwise_are_found(quantity, height, rows):
    log = swing()
    readings = getattr(log, quantity)[:, 1]
    found = without_faults(changed(log, quantity, rows, 1, readings[rows] + height))
    assert lost(found, quantity, 1).tolist() == rows


def test_lower_spikes_are_found_unless_there_are_small_ones_too():
    log, rows = swing(), [640, 1240, 2700]
    efforts = log.effort[:, 1]
    spiked = changed(log, "effort", rows, 1, efforts[rows] + 25.0)
    assert lost(without_faults(spiked), "effort", 1).tolist() == rows
    struck = changed(spiked, "effort", [3300], 1, efforts[3300] + 8.0)  # as by links with play
    assert without_faults(struck) is struck


@pytest.mark.parametrize("low", [-np.pi, 0.0])
@pytest.mark.parametrize("velocity", [True, False])
def test_wraps_are_unwrapped(low, velocity):
    log = swing(velocity=velocity)
    turning = replace(log, position=3.0 * log.position)
    wrapped = replace(log, position=(turning.position - low) % (2 * np.pi) + low)
    found = without_faults(wrapped)
    offset = found.position - turning.position
    np.testing.assert_allclose(offset, offset[:1] + np.zeros_like(offset), atol=1e-9)
    assert all("unwrapped" in note for note in found.notes)


def test_turns_from_zero_on_are_unwrapped_about_zero():
    log = swing()
    small = replace(log, position=log.position - log.position.mean(axis=0))
    found = without_faults(replace(small, position=small.position % (2 * np.pi)))
    np.testing.assert_allclose(found.position, small.position, atol=1e-9)


def test_a_frozen_position_is_left_out():
    log = swing()
    stuck = changed(log, "position", slice(1000, 1800), 0, log.position[1000, 0])
    for measured in (stuck, replace(stuck, velocity=None)):
        gone = lost(without_faults(measured), "position", 0)
        assert 795 < len(gone) < 805
        assert abs(gone[0] - 1000) < 3
    with pytest.raises(LogError, match=r"position of a is stuck at .* locked"):
        without_faults(changed(log, "position", slice(0, 3000), 0, 0.0))


def test_a_frozen_effort_is_left_out():
    found = without_faults(changed(swing(), "effort", slice(1000, 1800), 1, 1.234))
    assert lost(found, "effort", 1).tolist() == [*range(1000, 1800)]
    assert "the effort of b is stuck at 1.234 for 4 s from t = 5.00 s on" in found.notes[0]


@pytest.mark.parametrize("quantity", ["position", "velocity", "effort"])
def test_impossible_values_name_joint_row_and_value(quantity):
    log = changed(swing(), quantity, slice(2000, None), 1, 3 * LARGEST)
    with pytest.raises(LogError, match=f"Row 2001 .* 3e\\+09 as the {quantity} of b"):
        without_faults(log)


def test_logs_that_are_there_twice():
    log, other = swing(), swing(seed=1)
    part = part_of(log, slice(500, 3000), later=7.0)
    for logs in ([log, other, part], [part, log], [log, replace(log, name="again")]):
        with pytest.raises(ArgumentError, match="so it would be validated against"):
            check_repeated(logs)
    rest = replace(log, position=np.zeros_like(log.position), effort=np.ones_like(log.effort))
    halves = [part_of(log, slice(0, 2000)), part_of(log, slice(2000, None))]
    for logs in ([log, other], halves, [rest, replace(rest, name="the same rest")]):
        check_repeated(logs)


TIME = np.arange(0.0, 20.0, 0.01)
SWING = np.sin(TIME)


NOISE = np.random.default_rng(1).normal(size=(3, len(TIME)))
STILL = np.full_like(SWING, 0.1)
WILD, ONCE = SWING.copy(), STILL.copy()
WILD[[100, 101]], ONCE[7] = (1e308, -1e308), -1e308
RESTING = {
    "a flickering encoder": [(SWING, 0.7 + 1e-5 * np.rint(0.7 * NOISE[0])), (False, True)],
    "a coarse one": [
        (1.5e-3 * np.round(SWING / 1.5e-3), 0.7 + 1.5e-3 * np.rint(0.7 * NOISE[0])),
        (False, True),
    ],
    **{
        f"potentiometers of {n}": [
            (SWING + n * NOISE[0], n * NOISE[1], 0.2 * SWING + n * NOISE[2]),
            (False, True, False),
        ]
        for n in (1e-4, 5e-3)
    },
    "mrad by which a held joint yields, and a small motion": [
        (SWING, 2e-3 * SWING, 0.02 * SWING),
        (False, True, False),
    ],
    "a fifteenth of the other's motion": [(0.03 * SWING, 2e-3 * SWING), (False, False)],
    "8 of 100 Hz": [(SWING, 0.1 * np.sin(2 * np.pi * 8.0 * TIME)), (False, False)],
    "beside a wheel and a slide": [(3.0 * TIME, 0.1 * SWING, 0.02 * SWING), (False,) * 3],
    "one log": [(SWING, STILL), (False, True)],
    "nothing measured": [(SWING, np.full_like(SWING, np.nan)), (False, False)],
    "beyond what may overflow": [(WILD, ONCE), (False, True)],
}
"""Motions of the joints of a log, and which of them rest."""


@pytest.mark.parametrize("what", RESTING)
def test_joints_that_rest(what):
    positions, expected = RESTING[what]
    low, high, noise = logged_ranges([np.column_stack(positions)])
    slides = np.array([False, False, "slide" in what])[: len(low)]
    assert tuple(resting(low, high, slides, noise)) == expected


def test_all_logs_count_together():
    logs = [np.column_stack(each) for each in ((SWING, STILL), (SWING, STILL + 0.3))]
    low, high, noise = logged_ranges(logs)
    assert not resting(low, high, np.zeros(2), noise).any()


LOW, HIGH = np.array([0.2, -2.0]), np.array([1.2, 2.0])


def log(first):
    time = np.arange(200) * 0.01
    position = np.stack([first, np.sin(3.0 * time)], 1)
    return JointLog("run", ("a", "b"), time, position, np.cos(position))


WITHIN = 0.7 + 0.4 * np.sin(np.arange(200) * 0.05)


SPIKE = np.where(np.arange(200) == 7, 30.0, WITHIN)
EVERYWHERE = np.full(2, np.inf)


@pytest.mark.parametrize(
    ("first", "low", "high", "words"),
    [
        (-WITHIN, LOW, HIGH, "With the opposite sign they are within"),
        (WITHIN - np.pi, LOW, HIGH, "Shifted by +180° they are within"),
        (np.rad2deg(WITHIN), LOW, HIGH, "Divided by 57.3 they are within"),
        (3.0 * WITHIN, LOW, HIGH, "the same joints, zeros and units?"),
        (WITHIN, np.deg2rad(LOW), np.deg2rad(HIGH), "Within limits 57.3 times as wide"),
        (WITHIN, np.deg2rad(LOW), np.deg2rad(HIGH), "joints beyond: 2"),
        (WITHIN, LOW, HIGH, None),
        (SPIKE, LOW, HIGH, None),
        (9.0 * WITHIN, -EVERYWHERE, EVERYWHERE, None),
    ],
)
def test_positions_beyond_limits_have_a_likely_cause(first, low, high, words):
    said = position_limit_hint(log(first), low, high)
    assert words in said if words else said is None
    if words and low is LOW:
        outside = np.mean((first < 0.19) | (first > 1.21))
        assert f"a in {100 * outside:.0f} % of the samples of log 'run'" in said
        assert "beyond 0.2 … 1.2" in said


@pytest.mark.parametrize("scale", [1e4, 250.0])
def test_large_integer_positions_are_refused_early(scale):
    ticks = np.rint(scale * log(WITHIN).position)
    raw = replace(log(WITHIN), position=ticks)
    with pytest.raises(LogError, match=r"no joint reaches in rad or m\. .*mm .*rev/4096@2048"):
        make_uniform(raw)
    apart = replace(raw, position=ticks + 0.5)
    make_uniform(apart)
    assert position_unit_hint(raw) is None
    assert ("neither rad nor degrees" in position_unit_hint(apart)) == (scale > 3600.0)
    turning = np.mod(np.linspace(-200.0, 300.0, len(raw))[:, None] + [0.0, 70.0], 16384.0)
    with pytest.raises(LogError, match=r"They fill 16384: --units position=rev/16384 if"):
        make_uniform(replace(raw, position=np.rint(turning)))


def test_units_of_positions_and_efforts():
    swing = log(WITHIN)
    swing = replace(swing, effort=100.0 * swing.effort)
    largest = np.abs(swing.effort).max(0)
    assert position_unit_hint(swing) is None
    assert "degrees" in position_unit_hint(replace(swing, position=np.degrees(swing.position)))
    assert effort_unit_hint(swing, [largest[0], np.inf]) is None
    assert effort_unit_hint(swing, [0.0, np.inf]) is None
    assert "30 times" in effort_unit_hint(swing, [largest[0], largest[1] / 30.0])
    assert "1 %" in effort_unit_hint(swing, 105.0 * largest)


@pytest.mark.parametrize("kinds", [{}, {"a": "current", "b": "current"}])
def test_efforts_without_sign_are_reported(kinds):
    waves = np.sin(0.01 * np.arange(200)[:, None] * np.array([11.0, 13.0]))

    def hint(efforts):
        return effort_hint(replace(log(WITHIN), effort=efforts, effort_kinds=kinds))

    assert "magnitudes" in hint(np.abs(waves))
    assert hint(waves) is None
    assert hint(2.0 + waves) is None
    assert hint(np.zeros_like(waves)) is None


@pytest.mark.parametrize(
    ("scale", "kind"), [(3000.0, "current"), (30.0, "current"), (3e3, "effort")]
)
def test_currents_of_hundreds_of_amperes_are_counts(scale, kind):
    counts = np.rint(scale * np.sin(np.arange(len(WITHIN))))[:, None] * np.ones(2)
    kinds = dict.fromkeys(log(WITHIN).joints, kind)
    hint = effort_hint(replace(log(WITHIN), effort=counts, effort_kinds=kinds))
    assert (hint is not None and "counts or mA" in hint) == (scale > 300.0 and kind == "current")
