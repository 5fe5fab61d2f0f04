"""Preparation of logs: filters, smooth motion, long logs, and folds for validation."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pendulum_logs import JOINTS, PENDULUM
from scipy.interpolate import make_interp_spline

from geodrake import load_model
from geodrake.diagnosis import check_columns, compare
from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs import noise, reduce
from geodrake.identification.logs.noise import known_noise as noise_floor
from geodrake.logs import JointLog, Motion, read_log, smoothing, uniform_log, write_log
from geodrake.logs.filtering import (
    choose_bandwidth,
    design_filter,
    differentiate,
    resample,
    shifted,
    spline_coefficients,
)
from geodrake.logs.folds import validation_blocks
from geodrake.logs.motion import Trajectory, check_joints
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.smoothing import Piece, Stretch
from geodrake.logs.uniform_log import effort_steps, make_uniform

RATES = 2 * np.pi * np.array([0.3, 0.5])


def _make_log(time, **changes):
    """Return a log of two joints on sinusoids; each effort is its own time stamp."""
    phase = RATES * time[:, None]
    efforts, velocity = np.stack([time, time], 1), RATES * np.cos(phase)
    return replace(JointLog("made", JOINTS, time, np.sin(phase), efforts, velocity), **changes)


def _uniform(seconds=30.0, period=0.01):
    return period * np.arange(round(seconds / period))


def _error(segment):
    """Return the largest relative error of position, velocity and acceleration."""
    phase = RATES * segment.time[:, None]
    return max(
        np.abs((measured - truth) / scale).max()
        for measured, truth, scale in (
            (segment.position, np.sin(phase), 1.0),
            (segment.velocity, RATES * np.cos(phase), RATES),
            (segment.acceleration, -(RATES**2) * np.sin(phase), RATES**2),
        )
    )


@pytest.mark.parametrize("measured", [True, False])
def test_jittered_stamps_give_smooth_uniform_signals(measured):
    steps = np.random.default_rng(0).choice([0.01, 0.012, 0.03], 2500, p=[0.7, 0.29, 0.01])
    log = _make_log(np.cumsum(steps))
    segment = prepare_logs([log if measured else replace(log, velocity=None)])[0].segments[0][:]
    assert segment.period == pytest.approx(0.01)
    assert np.allclose(np.diff(segment.time), 0.01)
    assert _error(segment) < 1e-3
    assert np.allclose(segment.effort, segment.time[:, None])


@pytest.mark.parametrize("measured", [True, False])
def test_a_slow_log_keeps_accelerations_up_to_the_bandwidth_of_efforts(measured):
    """At 50 Hz efforts pass up to 12.5 Hz, where no further filter may smooth the motion."""
    time, rate = np.arange(0.0, 30.0, 0.02), 2.0 * np.pi * 10.0
    log, angle = _make_log(time), rate * time[:, None]
    velocity = log.velocity + rate * 1e-3 * np.cos(angle) if measured else None
    log = replace(log, position=log.position + 1e-3 * np.sin(angle), velocity=velocity)
    segment = prepare_logs([log], bandwidth=12.5)[0].segments[0][:]
    fast = segment.acceleration + RATES**2 * np.sin(RATES * segment.time[:, None])
    wave = -(rate**2) * 1e-3 * np.sin(rate * segment.time)
    assert (wave @ fast) / (wave @ wave) == pytest.approx(1.0, abs=0.05)


def test_joints_in_any_order():
    log = _make_log(_uniform())
    turned = log.select(("elbow", "shoulder"))
    assert np.array_equal(turned.position, log.position[:, ::-1])
    assert np.array_equal(turned.select(JOINTS).velocity, log.velocity)
    with pytest.raises(
        LogError, match=r"has joint 'elbow', but the model does not.*nearest: 'elbow_joint'"
    ):
        check_joints(log.name, JOINTS, ("shoulder", "elbow_joint"))
    with pytest.raises(LogError, match=r"no joint 'wrist'"):
        check_joints(log.name, JOINTS, (*JOINTS, "wrist"))
    with pytest.raises(ArgumentError, match="same joints"):
        prepare_logs([log, log.select(("elbow",))])


@pytest.mark.parametrize("hole", ["gap", "position", "effort", "velocity", "time"])
def test_holes_split_instead_of_being_bridged(hole):
    log = _make_log(_uniform(40.0))
    if hole == "gap":
        log = _make_log(log.time[(log.time < 20.0) | (log.time > 20.3)])
    else:
        values = getattr(log, hole).copy()
        values[2000:2030] = np.nan
        log = replace(log, **{hole: values})
    trajectory = prepare_logs([log], bandwidth=4.0)[0]
    low_pass = trajectory.filter
    assert len(trajectory.segments) == 2
    assert any("split into 2 pieces" in note for note in trajectory.notes)
    for segment in (stretch[:] for stretch in trajectory.segments):
        assert _error(segment) < 1e-3
        center = segment.time[low_pass.output_indices(len(segment))]
        reach = low_pass.halfwidth * low_pass.period
        assert np.all((center + reach < 20.0) | (center - reach > 20.0))


def test_cells_that_are_empty_for_less_than_a_gap_are_bridged():
    time = _uniform(40.0)
    log, rows = _make_log(time), np.arange(100, len(time), 100)
    log.position[rows, 0] = log.effort[rows + 50, 1] = np.nan
    (stretch,) = prepare_logs([log], bandwidth=4.0)[0].segments
    assert _error(stretch[:]) < 1e-3


def test_pieces_too_short_are_dropped_with_a_note():
    time = _uniform(40.0)
    keep = (time < 20.0) | ((time > 21.0) & (time < 21.5)) | (time > 22.0)
    trajectory = prepare_logs([_make_log(time[keep])], bandwidth=4.0)[0]
    assert len(trajectory.segments) == 2
    assert "0.49 s in 1 of 3 pieces" in trajectory.left_out
    assert "1.51 s in gaps" in trajectory.left_out


def test_standstills_at_the_ends_go_and_those_inside_stay():
    """Strokes of 6 s have 5 s of standstill before, 3 s between and 4 s after them."""
    period = 0.01
    stroke = 0.5 * (1 - np.cos(np.pi * np.arange(0, 6, period) / 6)) ** 2 / 2
    pause = np.full(300, stroke[-1])
    q = np.concatenate([np.zeros(500), stroke, pause, stroke[::-1], np.zeros(400)])
    noise = 1e-5 * np.random.default_rng(0).standard_normal((len(q), 2))
    position = np.stack([q, 2 * q], 1) + noise
    log = JointLog("strokes", JOINTS, period * np.arange(len(q)), position, noise)
    trajectory = prepare_logs([log], bandwidth=4.0)[0]
    (stretch,) = trajectory.segments
    segment = stretch[:]
    reach = trajectory.filter.halfwidth * trajectory.filter.period
    assert 5.0 - reach - 0.2 < segment.time[0] < 6.0 - reach
    assert 20.0 + reach - 1.0 < segment.time[-1] < 20.2 + reach
    assert not trajectory.left_out  # a standstill is no loss, but a note
    (note,) = [note for note in trajectory.notes if "are not used" in note]
    assert "s of standstill at the start" in note and "s of standstill at the end" in note


STILL = 1e-4 * np.random.default_rng(0).standard_normal((1000, 2))
SHUFFLED = np.random.default_rng(0).permutation(1000)
MADE = _make_log(_uniform(10.0))
UNUSABLE = {
    "still": (replace(MADE, position=STILL), r"No joint moves .*: in its 10 s", "back and forth"),
    "out of order": (replace(MADE, position=MADE.position[SHUFFLED]), "not sorted by time", ""),
    "short": (_make_log(_uniform(3.0)), "its 3 s leave .* a bandwidth of 4", "at least 4.08 s"),
    "a few rows": (_make_log(_uniform(0.05)), "8 successive rows", ""),
    "in ms": (
        replace(MADE, time=1e3 * MADE.time),
        r"a sample every 10 s .* too slow",
        "--units time=ms converts it to s",
    ),
}


@pytest.mark.parametrize("kind", UNUSABLE)
def test_logs_that_cannot_be_prepared(kind):
    log, words, advice = UNUSABLE[kind]
    bandwidth = 4.0 if kind in ("short", "a few rows") else None
    with pytest.raises(LogError, match=words) as caught:
        prepare_logs([log], bandwidth=bandwidth)
    assert advice in (caught.value.advice or "")


@pytest.mark.parametrize(
    ("measured", "words"),
    [
        (lambda time: RATES * np.cos(RATES * time) * [1.0, 1.3], "elbow differs by 30 %"),
        (lambda time: RATES * np.cos(RATES * (time - 0.005)), "5 ms late"),
    ],
)
def test_velocities_that_disagree_are_not_used_and_late_ones_moved(measured, words):
    log = _make_log(_uniform())
    log = replace(log, velocity=measured(log.time[:, None]))
    trajectory = prepare_logs([log], bandwidth=4.0)[0]
    assert _error(trajectory.segments[0][:]) < 1e-3
    assert any(words in note for note in trajectory.notes)


def test_coarse_velocities_are_derived_from_better_positions():
    log = _make_log(_uniform())
    log = replace(log, velocity=np.round(log.velocity / [0.1, 1e-6]) * [0.1, 1e-6])
    trajectory = prepare_logs([log], bandwidth=4.0)[0]
    assert _error(trajectory.segments[0][:]) < 1e-3
    note = "measured velocities of shoulder are not used: the derivatives of positions have less"
    assert any(note in each for each in trajectory.notes)


@pytest.mark.parametrize("every", [2, 3, 4])
@pytest.mark.parametrize("lost", [0.0, 0.03])
def test_efforts_of_a_slower_source_are_interpolated(every, lost):
    """Held efforts would be late by (every − 1) / 2 rows, and attenuated at high frequencies."""
    rng, time = np.random.default_rng(every), _uniform()
    clean = np.stack([np.sin(2 * np.pi * 3.0 * time), np.cos(2 * np.pi * 0.5 * time)], 1)
    kept = rng.random(len(time)) >= lost
    noise = 0.01 * rng.normal(size=clean.shape)
    held = (clean + noise)[np.arange(len(time)) // every * every]
    log = _make_log(time, effort=held).rows(kept)
    trajectory = prepare_logs([log], bandwidth=4.0)[0]
    segment = trajectory.segments[0][:]
    error = segment.effort[:, 0] - np.sin(2 * np.pi * 3.0 * segment.time)
    assert np.sqrt(np.mean(error**2)) < 0.03
    assert any(f"efforts change every {every} rows" in note for note in trajectory.notes)
    floor, known, _ = noise_floor([trajectory])
    assert known.all()
    np.testing.assert_allclose(floor, 0.01 * np.sqrt(4.0 * 0.02 * every), rtol=0.3)


def test_rows_without_new_positions_are_not_used():
    time = _uniform()
    log = _make_log(time)
    held = log.position[np.arange(len(time)) // 3 * 3]
    trajectory = prepare_logs([replace(log, position=held, velocity=None)], bandwidth=4.0)[0]
    assert trajectory.segments[0].period == pytest.approx(0.03)
    assert _error(trajectory.segments[0][:]) < 2e-3


def test_held_efforts_beside_a_joint_without_any():
    time = _uniform()
    held = np.sin(RATES * time[:, None])[np.arange(len(time)) // 3 * 3]
    held[:, 1] = np.nan
    with pytest.raises(LogError, match="none has effort"):
        make_uniform(_make_log(time, effort=held))


def test_coarse_efforts_of_a_slower_source_are_found():
    time = _uniform()
    coarse = np.round(np.sin(RATES * time[:, None])[np.arange(len(time)) // 3 * 3], 1)
    uniform = make_uniform(_make_log(time, effort=coarse))
    assert uniform.pieces[0].held == 3


def test_coarse_readings_are_not_held():
    """The values of an encoder of a slow joint change by one step, after varying times."""
    time = _uniform()
    log = _make_log(time)
    coarse = replace(log, position=np.round(log.position, 1), velocity=None)
    assert make_uniform(coarse.select(JOINTS[:1])).period == pytest.approx(0.01)


def test_shapes_and_time_are_checked():
    log = _make_log(_uniform())
    with pytest.raises(ArgumentError, match=r"effort .* N = 3000 and n = 2; .* \(3000, 1\)"):
        replace(log, effort=log.effort[:, :1])
    with pytest.raises(ArgumentError, match=r"time .* \(3000, 1\)"):
        replace(log, time=log.time[:, None])
    with pytest.raises(ArgumentError, match="joints must be a tuple"):
        replace(log, joints="ab")
    with pytest.raises(LogError, match=r"repeats .*row 3 .* 0.02 s and row 4 .* 0.02 s"):
        replace(log, time=np.where(np.arange(3000) == 3, 0.02, log.time))
    with pytest.raises(ArgumentError, match=r"vd .* N = 3 and nv = 2; .* \(2, 2\)"):
        Motion(np.zeros((3, 2)), np.zeros((3, 2)), np.zeros((2, 2)))


def _trajectories(*lengths):
    """Return a trajectory for each tuple of lengths of segments, in filtered samples."""
    low_pass, none = design_filter(0.01, 5.0), np.zeros(len(JOINTS))

    def stretch(start, outputs):
        n = 2 * low_pass.halfwidth + 1 + (outputs - 1) * low_pass.decimation
        still = np.zeros((n, 2))
        piece = Piece(start + 0.01 * np.arange(n), still, None, still, 0.01)
        return Stretch(piece, low_pass, None, 0, n)

    return [
        Trajectory(
            f"log{k}",
            JOINTS,
            tuple(map(stretch, range(0, 900, 300), outputs)),
            low_pass,
            none,
            none,
        )
        for k, outputs in enumerate(lengths)
    ]


@settings(max_examples=15)
@given(
    lengths=st.lists(
        st.lists(st.integers(1, 400), min_size=1, max_size=3).filter(lambda n: sum(n) >= 30),
        min_size=1, max_size=5,
    ),
    blocks=st.none() | st.integers(2, 9),
)  # fmt: skip
def test_folds_share_nothing(lengths, blocks):
    folds = validation_blocks(_trajectories(*lengths), blocks=blocks)
    used = [[np.zeros(count, int) for count in trajectory] for trajectory in lengths]
    for fold in folds:
        assert len(fold) >= 10
        for block in fold.blocks:
            used[block.trajectory][block.segment][block.start : block.stop] += 1
            assert 0 <= block.start < block.stop <= lengths[block.trajectory][block.segment]
    assert max(count.max() for trajectory in used for count in trajectory) == 1
    assert len(folds) == len({fold.name for fold in folds})


@pytest.mark.parametrize(("logs", "folds"), [(1, 8), (2, 8), (3, 6), (4, 4), (6, 6)])
def test_number_of_folds(logs, folds):
    made = validation_blocks(_trajectories(*[(600,)] * logs))
    assert len(made) == folds
    held = sum(map(len, made))
    assert held == 600 * logs if logs >= 4 else 0.94 * 600 * logs < held < 600 * logs


def test_nothing_to_hold_out():
    with pytest.raises(LogError, match="15 filtered samples"):
        validation_blocks(_trajectories((15,)))
    with pytest.raises(ArgumentError, match="no trajectories"):
        validation_blocks([])


SHORT = np.arange(0.0, 8.0, 0.01)
CLOCK_RATES = np.array([1.0, 1.7, 2.9])


def second(factors, *, clock=1.0):
    """Return how long a second is by velocities off by some factors, in a log whose time is off."""
    q, v = np.sin(CLOCK_RATES * SHORT[:, None]), CLOCK_RATES * np.cos(CLOCK_RATES * SHORT[:, None])
    log = JointLog("log", ("a", "b", "c"), SHORT / clock, q, q, velocity=v * factors)
    return make_uniform(log).time_scale


@pytest.mark.parametrize("clock", [0.1, 1.0, 20.0])
def test_velocities_tell_the_clock(clock):
    assert second([1.0, 1.0, 1.0], clock=clock) == pytest.approx(clock, rel=1e-2)
    assert second([1.0, -30.0, 1.0], clock=clock) == pytest.approx(clock, rel=1e-2)


@pytest.mark.parametrize("factors", [0.0, -1.0, 1e-3, 1e4, [1.0, -1.0, 0.0], [1.0, 20.0, 90.0]])
def test_inconsistent_velocities_give_no_clock(factors):
    assert np.isnan(second(factors))


def test_tiny_velocities_cause_no_error():
    q, v = np.sin(CLOCK_RATES[:2] * SHORT[:, None]), np.cos(CLOCK_RATES[:2] * SHORT[:, None])
    log = JointLog("log", JOINTS, SHORT, q, 5.0 * q, velocity=2e-3 * v)
    assert all(found.kind for found in check_columns(load_model(PENDULUM), [log]))


TIME = np.arange(3000) / 250.0
Q = np.sin(TIME[:, None] * np.array([2.0, 3.0]))
SMOOTH = 8.0 * np.cos(TIME * 2.1) + 3.0 * np.sin(TIME * 5.3)


def log_with(effort):
    """Return a log with efforts at its elbow, and smooth ones at its shoulder."""
    return JointLog("steps", JOINTS, TIME, Q, np.stack([SMOOTH, effort], 1))


@settings(max_examples=25)
@given(
    step=st.floats(0.06, 1.0),
    offset=st.floats(-1.0, 1.0),
    noise=st.sampled_from([0.0, 0.1, 0.3]),
    seed=st.integers(0, 2**31),
)
def test_the_step_of_a_converter_is_found(step, offset, noise, seed):
    """The noise before it is less than a third of a step; gain and zero are arbitrary."""
    rng = np.random.default_rng(seed)
    effort = step * np.rint((SMOOTH + noise * step * rng.normal(size=len(TIME))) / step) + offset
    assert effort_steps(log_with(effort)) == pytest.approx([0.0, step])


def test_steps_that_are_printed_with_few_digits():
    effort = np.round(0.366 * np.rint(SMOOTH / 0.366), 2)
    assert effort_steps(log_with(effort)) == pytest.approx([0.0, 0.366], abs=0.01)


def test_a_note_says_step_and_noise():
    log = log_with(0.24 * np.rint(SMOOTH / 0.24))
    (note,) = [note for note in make_uniform(log).notes if "quantized" in note]
    assert "elbow 0.24 (noise 0.069)" in note
    assert "shoulder" not in note
    assert not any("quantized" in note for note in make_uniform(log_with(SMOOTH)).notes)


PERIOD, BANDWIDTH = 0.002, 10.0
PASSBAND = 0.6  # of the bandwidth


@pytest.fixture
def low_pass():
    return design_filter(PERIOD, BANDWIDTH)


@pytest.mark.parametrize("frequency", [0.3, 3.0, PASSBAND * BANDWIDTH])
def test_passband_is_untouched_and_without_lag(low_pass, frequency):
    time = PERIOD * np.arange(5000)
    rate = 2 * np.pi * frequency
    inner = slice(low_pass.halfwidth, -low_pass.halfwidth)
    signal = np.sin(rate * time)
    position = low_pass.smooth(signal)
    assert np.abs(position - signal)[inner].max() < 1e-3
    assert np.abs(low_pass.apply(signal) - signal[low_pass.output_indices(5000)]).max() < 1e-3
    velocity = differentiate(position, PERIOD)
    acceleration = differentiate(velocity, PERIOD)
    assert np.abs(velocity - rate * np.cos(rate * time))[inner].max() < 1e-3 * rate
    assert np.abs(acceleration + rate**2 * np.sin(rate * time))[inner].max() < 1e-3 * rate**2


@pytest.mark.parametrize("share", [0.01, 0.13, 0.19, 0.25])
def test_filtered_white_noise_is_white_after_decimation(share):
    noise = np.random.default_rng(3).standard_normal((200_000, 1))
    low_pass = design_filter(PERIOD, share / PERIOD)
    filtered = low_pass.apply(noise)[:, 0]
    assert np.std(filtered) == pytest.approx(low_pass.noise_gain, rel=0.05)
    assert abs(np.corrcoef(filtered[1:], filtered[:-1])[0, 1]) < 0.15
    rate = 1 / low_pass.output_period
    assert 2 * low_pass.bandwidth - 1e-9 <= rate <= 2.1 * low_pass.bandwidth


def test_weighted_signals_are_filtered_as_their_products(low_pass):
    signal = np.random.default_rng(3).normal(size=(1500, 4, 3))
    weights = 1.0 / (1.0 + np.exp((700.3 - np.arange(1500)) / 20.0))
    expected = low_pass.apply(weights[:, None, None] * signal)
    np.testing.assert_allclose(low_pass.apply_weighted(signal, weights), expected, atol=1e-12)


def test_signals_are_shifted_before_or_after_the_filter_alike(low_pass):
    signal, steps = np.random.default_rng(3).normal(size=(4000, 3)), np.array([0.0, 0.4, -2.7])
    inner, spline = np.arange(500, 3500), make_interp_spline(np.arange(4000), signal, k=5)
    moved = np.stack([spline(inner + step)[:, j] for j, step in enumerate(steps)], 1)
    coefficients = spline_coefficients(signal)
    np.testing.assert_allclose(shifted(coefficients, inner, steps), moved, atol=1e-9)
    at = inner[low_pass.output_indices(len(inner))]
    found = shifted(low_pass.smooth(coefficients), at, steps)
    np.testing.assert_allclose(found, low_pass.apply(moved), atol=1e-9)


def test_invalid_filters():
    for bandwidth in (0.0, -1.0, 126.0, np.nan):
        with pytest.raises(ArgumentError, match="500 Hz"):
            design_filter(PERIOD, bandwidth)
    for period in (0.0, -0.1, np.nan):
        with pytest.raises(ArgumentError, match="must be positive"):
            design_filter(period, 1.0)
    with pytest.raises(ArgumentError, match="6 samples; got 5"):
        differentiate(np.zeros(5), PERIOD)
    with pytest.raises(LogError, match="32 samples"):
        choose_bandwidth([(np.zeros((20, 1)), 0.01)])


def test_resampled_efforts_do_not_overshoot():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.choice([0.01, 0.012, 0.03], 300, p=[0.7, 0.28, 0.02]))
    step = (time > 1.5).astype(float)[:, None]
    grid = np.arange(time[0], time[-1], 0.01)
    smooth = resample(time, np.sin(3 * time)[:, None], grid)
    sharp = resample(time, step, grid, sharp=True)
    assert np.abs(smooth[:, 0] - np.sin(3 * grid)).max() < 1e-4
    assert sharp.min() == 0.0
    assert sharp.max() == 1.0


def _motion(highest, noise, period=0.001, seconds=40.0):
    time = period * np.arange(int(seconds / period))
    rng = np.random.default_rng(1)
    rates = 2 * np.pi * highest * np.arange(1, 6) / 5
    waves = np.sin(rates[:, None] * time + rng.uniform(0, 6, (3, 5, 1))) / rates[:, None]
    return waves.sum(1).T + noise * rng.standard_normal((len(time), 3))


@pytest.mark.parametrize("highest", [0.4, 2.0, 7.0])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-4])
def test_bandwidth_holds_the_motion(highest, noise):
    chosen = choose_bandwidth([(_motion(highest, noise), 0.001)])
    assert 3.0 * highest < chosen < 12.0 * highest


def test_bandwidth_holds_a_gait_beside_a_slow_sway():
    """The spectrum is low between the two, but not noise."""
    sway, gait = _motion(0.4, 1e-5), _motion(10.0, 0.0)
    begins = 0.5 + 0.5 * np.tanh(2.0 * np.linspace(-20.0, 20.0, len(gait)))[:, None]
    for pieces in ([sway, sway + gait], [sway + begins * gait]):
        assert choose_bandwidth([(piece, 0.001) for piece in pieces]) > 12.0


def test_bandwidth_holds_a_trot_that_positions_hardly_show_beside_a_sway():
    """Impacts excite all frequencies, so that none is as quiet as the sway."""
    count, rng = 8000, np.random.default_rng(0)
    rates = np.fft.rfftfreq(count, 0.005)
    at = 0.23, 0.29, 0.41, 0.59, 0.93, 1.2, 1.5, 2.1, 2.8, 4.2, 5.0, 10.0, 100.0
    power = 1.6, 6.6, 2.9, 14.0, 6.0, 34.0, 15.0, 290.0, 27.0, 600.0, 200.0, 450.0, 400.0
    size = np.sqrt(np.interp(rates, at, power)) / np.maximum(rates, 0.2) ** 2
    phases = rng.uniform(0.0, 2.0 * np.pi, (len(rates), 18))
    position = np.fft.irfft(size[:, None] * np.exp(1j * phases), count, axis=0)
    assert choose_bandwidth([(position, 0.005)]) > 8.0


def long_log(samples, *, velocity=False, seed=0):
    """Return sines with dry friction, at 500 Hz with jitter."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.choice([0.002, 0.0021], samples))
    phase = np.array([2.0, 3.3]) * time[:, None]
    speed = np.array([2.0, 3.3]) * np.cos(phase)
    effort = 2.0 * np.sin(phase) + 0.3 * np.sign(speed) + rng.normal(0.0, 0.02, phase.shape)
    position = np.sin(phase) + rng.normal(0.0, 1e-5, phase.shape)
    late = 3.3 * np.cos(3.3 * (time[:, None] - 0.004)) if velocity else None
    measured = None if late is None else np.hstack([speed[:, :1], late])
    return JointLog("long", JOINTS, time, position, effort, measured)


@pytest.mark.parametrize("velocity", [False, True])
def test_slices_are_those_of_the_whole(monkeypatch, velocity):
    monkeypatch.setattr(smoothing, "CHUNK", 700)
    monkeypatch.setattr(smoothing, "_KEPT", 700)
    (stretch,) = prepare_logs([long_log(9000, velocity=velocity)], bandwidth=6.0)[0].segments
    whole = stretch[:]
    assert len(whole) == len(stretch)
    for first, chunk in stretch.chunks():
        part = whole[first : first + 700]
        assert np.array_equal(chunk.time, part.time)
        for signal, size in (("position", 1.0), ("velocity", 3.3), ("acceleration", 11.0)):
            error = np.abs(getattr(chunk, signal) - getattr(part, signal)).max()
            assert error < 1e-9 * size, signal
        assert np.array_equal(chunk.effort, part.effort)
    np.testing.assert_allclose(stretch.peak_speed, np.abs(whole.velocity).max(0), rtol=1e-9)
    assert len(stretch[5:5]) == 0


def test_cached_signals_are_read_only():
    (stretch,) = prepare_logs([long_log(3000)], bandwidth=6.0)[0].segments
    part = stretch[5:50]
    signals = (part.time, part.position, part.velocity, part.acceleration, part.effort)
    assert not any(signal.flags.writeable for signal in signals)


def test_memory_grows_with_the_log_alone(monkeypatch, tmp_path):
    """A sample of two joints takes 40 bytes; smoothed copies would take hundreds."""
    for module in (smoothing, reduce):
        monkeypatch.setattr(module, "CHUNK", 5_000)
    monkeypatch.setattr(smoothing, "_KEPT", 5_000)
    monkeypatch.setattr(uniform_log, "_PART", 5_000)
    monkeypatch.setattr(noise, "_SAMPLES", 10_000)
    model, peaks = load_model(PENDULUM), []
    lengths = (30_000, 90_000)
    for samples in lengths:
        path = tmp_path / f"{samples}.npz"
        write_log(long_log(samples), path)
        if not peaks:
            compare(model, [path], bandwidth=8.0)  # compile and factor what is used again
        tracemalloc.start()
        try:
            compare(model, [path], bandwidth=8.0)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    grown = (peaks[1] - peaks[0]) / (lengths[1] - lengths[0])
    assert 40 < grown < 110  # with temporary arrays


def test_csv_is_read_in_stretches(monkeypatch, tmp_path):
    monkeypatch.setattr("geodrake.logs.files.text_file._BLOCK", 300)
    log = long_log(50)
    path = tmp_path / "log.csv"
    write_log(log, path)
    assert np.array_equal(read_log(path).effort, log.effort)
    lines = path.read_text().splitlines()
    lines[20] = lines[20].rsplit(",", 1)[0] + ","  # an empty cell
    lines.insert(30, "")  # and an empty line
    path.write_text("\n".join(lines) + "\n")
    again = read_log(path, joints=JOINTS[::-1])
    assert again.joints == JOINTS[::-1]
    assert np.isnan(again.effort[19, 0])
    assert np.array_equal(again.effort[20:, ::-1], log.effort[20:])
    lines[40] = lines[40].replace(",", ",x", 1)
    path.write_text("\r\n".join(lines) + "\r\n")
    with pytest.raises(LogError, match="Row 39, column"):
        read_log(path)
    lines[40] = "1,2"
    path.write_text("\r".join(lines))
    with pytest.raises(LogError, match=r"Row 39 of log .* \(line 41\) has 2 cells"):
        read_log(path)
