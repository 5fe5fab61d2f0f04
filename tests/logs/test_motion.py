"""Logs and motions, their preparation, and the folds that validation uses."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measurements import DATA

from geodrake.errors import ArgumentError, LogError
from geodrake.logs import JointLog, Motion, read_log
from geodrake.logs.filtering import design_filter
from geodrake.logs.folds import validation_blocks
from geodrake.logs.motion import Trajectory, check_joints
from geodrake.logs.preparation import motion_bandwidth_of, prepare_logs
from geodrake.logs.smoothing import Piece, Stretch
from geodrake.logs.uniform_log import make_uniform

JOINTS = ("shoulder", "elbow")
RATES = 2 * np.pi * np.array([0.3, 0.5])


def _make_log(time, **changes):
    """Two joints on sinusoids; the effort is its own time stamp, so that it can be traced."""
    log = JointLog(
        "made",
        JOINTS,
        time,
        np.sin(RATES * time[:, None]),
        np.stack([time, time], 1),
        RATES * np.cos(RATES * time[:, None]),
    )
    return replace(log, **changes)


def _uniform(seconds=30.0, period=0.01):
    return period * np.arange(round(seconds / period))


def _error(segment):
    """Largest relative errors of position, velocity and acceleration."""
    phase = RATES * segment.time[:, None]
    return [
        np.abs((measured - truth) / scale).max()
        for measured, truth, scale in (
            (segment.position, np.sin(phase), 1.0),
            (segment.velocity, RATES * np.cos(phase), RATES),
            (segment.acceleration, -(RATES**2) * np.sin(phase), RATES**2),
        )
    ]


@pytest.mark.parametrize("measured", [True, False])
def test_jittered_stamps_give_smooth_uniform_signals(measured):
    steps = np.random.default_rng(0).choice([0.01, 0.012, 0.03], 2500, p=[0.7, 0.29, 0.01])
    log = _make_log(np.cumsum(steps))
    segment = prepare_logs([log if measured else replace(log, velocity=None)])[0].segments[0][:]
    assert segment.period == pytest.approx(0.01)
    assert np.allclose(np.diff(segment.time), 0.01)
    assert max(_error(segment)) < 1e-3
    assert np.allclose(segment.effort, segment.time[:, None])


@pytest.mark.parametrize("measured", [True, False])
def test_a_slow_log_keeps_accelerations_up_to_the_bandwidth_of_efforts(measured):
    """At 50 Hz efforts pass up to 12.5 Hz: the motion is not to be smoothed there once more."""
    time, rate = np.arange(0.0, 30.0, 0.02), 2.0 * np.pi * 10.0
    ripple = 1e-3 * np.sin(rate * time)[:, None]
    log = _make_log(time)
    velocity = log.velocity + rate * 1e-3 * np.cos(rate * time)[:, None]
    log = replace(log, position=log.position + ripple, velocity=velocity if measured else None)
    (trajectory,) = prepare_logs([log], bandwidth=12.5)
    segment = trajectory.segments[0][:]
    phase = RATES * segment.time[:, None]
    fast = segment.acceleration + RATES**2 * np.sin(phase)
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
        keep = (log.time < 20.0) | (log.time > 20.3)
        log = _make_log(log.time[keep])
    else:
        values = getattr(log, hole).copy()
        values[2000:2030] = np.nan
        log = replace(log, **{hole: values})
    trajectory = prepare_logs([log], bandwidth=4.0)[0]
    low_pass = trajectory.filter
    assert len(trajectory.segments) == 2
    assert any("split into 2 pieces" in note for note in trajectory.notes)
    for segment in (stretch[:] for stretch in trajectory.segments):
        assert max(_error(segment)) < 1e-3
        center = segment.time[low_pass.output_indices(len(segment))]
        reach = low_pass.halfwidth * low_pass.period
        assert np.all((center + reach < 20.0) | (center - reach > 20.0))


def test_cells_that_are_empty_for_less_than_a_gap_are_bridged():
    time = _uniform(40.0)
    log, rows = _make_log(time), np.arange(100, len(time), 100)
    log.position[rows, 0] = log.effort[rows + 50, 1] = np.nan
    trajectory = prepare_logs([log], bandwidth=4.0)[0]
    (stretch,) = trajectory.segments
    assert max(_error(stretch[:])) < 1e-3


def test_pieces_too_short_are_dropped_with_a_note():
    time = _uniform(40.0)
    keep = (time < 20.0) | ((time > 21.0) & (time < 21.5)) | (time > 22.0)
    trajectory = prepare_logs([_make_log(time[keep])], bandwidth=4.0)[0]
    assert len(trajectory.segments) == 2
    assert "0.49 s in 1 of 3 pieces" in trajectory.left_out
    assert "1.51 s in gaps" in trajectory.left_out


def _with_standstills(lead, pause, tail, period=0.01):
    """Smooth strokes of 6 s each, with standstills before, between and after."""
    stroke = 0.5 * (1 - np.cos(np.pi * np.arange(0, 6, period) / 6)) ** 2 / 2
    hold = [np.full(round(seconds / period), value) for seconds, value in
            ((lead, 0.0), (pause, stroke[-1]), (tail, 0.0))]  # fmt: skip
    q = np.concatenate([hold[0], stroke, hold[1], stroke[::-1], hold[2]])
    time = period * np.arange(len(q))
    noise = 1e-5 * np.random.default_rng(0).standard_normal((len(q), 2))
    return JointLog("strokes", JOINTS, time, np.stack([q, 2 * q], 1) + noise, noise)


def test_standstills_at_the_ends_go_and_those_inside_stay():
    trajectory = prepare_logs([_with_standstills(5.0, 3.0, 4.0)], bandwidth=4.0)[0]
    (stretch,) = trajectory.segments
    segment = stretch[:]
    reach = trajectory.filter.halfwidth * trajectory.filter.period
    assert 5.0 - reach - 0.2 < segment.time[0] < 6.0 - reach
    assert 20.0 + reach - 1.0 < segment.time[-1] < 20.2 + reach
    assert "s of standstill at the start" in trajectory.left_out
    assert "s of standstill at the end" in trajectory.left_out


def test_parts_that_are_left_out_add_up():
    """A first piece that hardly moves goes as a whole, and not its standstill beside it."""
    log = _with_standstills(5.0, 3.0, 4.0)
    kept = (log.time < 7.0) | (log.time > 8.0)
    names = ("time", "position", "effort")
    log = replace(log, **{name: getattr(log, name)[kept] for name in names})
    (trajectory,) = prepare_logs([log], bandwidth=2.0)
    total, *parts = map(float, re.findall(r"([\d.]+) (?:of [\d.]+ )?s\b", trajectory.left_out))
    assert "in 1 of 2 pieces" in trajectory.left_out
    assert sum(parts) == pytest.approx(total, abs=0.05)


def test_still_throughout():
    noise = 1e-4 * np.random.default_rng(0).standard_normal((1000, 2))
    log = _make_log(_uniform(10.0), position=noise)
    with pytest.raises(LogError, match=r"No joint moves .*: in its 10 s") as caught:
        prepare_logs([log])[0]
    assert "back and forth" in caught.value.advice


def test_rows_out_of_order():
    """Shuffled rows, as of benchmarks of regression, have no velocities."""
    log = _make_log(_uniform(10.0))
    order = np.random.default_rng(0).permutation(len(log))
    with pytest.raises(LogError, match="not sorted by time"):
        prepare_logs([replace(log, position=log.position[order])])


def test_too_short():
    with pytest.raises(LogError, match=r"its 3 s give .* samples at a bandwidth of 4") as caught:
        prepare_logs([_make_log(_uniform(3.0))], bandwidth=4.0)[0]
    assert "Record at least 4.08 s" in caught.value.advice
    with pytest.raises(LogError, match="8 successive rows"):
        prepare_logs([_make_log(_uniform(0.05))], bandwidth=4.0)[0]


def test_time_in_other_units():
    log = _make_log(_uniform())
    with pytest.raises(LogError, match="too slow") as caught:
        prepare_logs([replace(log, time=1e3 * log.time)])
    assert "--units time=ms converts it to s" in caught.value.advice
    assert caught.value.evidence["period"] == pytest.approx(10.0)


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
    assert max(_error(trajectory.segments[0][:])) < 1e-3
    assert any(words in note for note in trajectory.notes)


def test_velocities_are_used_joint_by_joint():
    """Those of the elbow are wrong; positions of the shoulder are noisier than its velocities."""
    log, rng = _make_log(_uniform()), np.random.default_rng(0)
    velocity = RATES * np.cos(RATES * log.time[:, None]) * [1.0, 1.3]
    position = log.position + [3e-3, 0.0] * rng.normal(size=log.position.shape)
    log = replace(log, position=position, velocity=velocity)
    trajectory = prepare_logs([log], bandwidth=8.0)[0]
    assert trajectory.segments[0].derived.tolist() == [False, True]
    assert any("velocities of elbow are not used" in note for note in trajectory.notes)
    segment = trajectory.segments[0][:]
    truth = RATES * np.cos(RATES * segment.time[:, None])
    np.testing.assert_allclose(segment.velocity, truth, atol=2e-3)
    assert trajectory.acceleration_noise[0] < 1e-3


def test_a_gait_beside_a_slow_sway_lowers_no_bandwidth():
    """Accelerations by the impacts of a gait have no valley, so that all seems to be noise."""
    time, rng = _uniform(40.0, 0.005), np.random.default_rng(0)
    frequency = np.fft.rfftfreq(len(time), 0.005)
    slow = (frequency > 0.2) & (frequency < 1.8)
    sway = np.where(slow, np.maximum(frequency / 0.3, 1.0), 0.0)
    gait = np.where(frequency >= 1.8, 60.0, 0.0)

    def made(power):
        """Return positions whose accelerations have a spectrum."""
        phases = rng.uniform(0.0, 2.0 * np.pi, (len(frequency), 2))
        size = np.sqrt(power) / np.maximum(frequency, 0.1) ** 2
        return np.fft.irfft(size[:, None] * np.exp(1j * phases), len(time), axis=0)

    noise = 1e-4 * made(sway).std() * rng.normal(size=(2, len(time), 2))
    positions = made(sway) + noise[0], 0.5 * made(sway) + made(gait) + noise[1]
    logs = [make_uniform(replace(_make_log(time), position=each)) for each in positions]
    alone = [motion_bandwidth_of([log]) for log in logs]
    assert motion_bandwidth_of(logs) >= min(alone) > 5.0


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
    """One trajectory for each tuple of segment lengths, in filtered samples."""
    low_pass = design_filter(0.01, 5.0)

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
            np.zeros(len(JOINTS)),
            np.zeros(len(JOINTS)),
        )
        for k, outputs in enumerate(lengths)
    ]


@settings(max_examples=40)
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


@pytest.mark.measurements("data/ur10e_*.csv", "data/tx40.csv", "data/double_pendulum_c1_*.csv")
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("ur10e_free_a", 3.5, 10),
        ("ur10e_changed", 3.5, 10),
        ("ur10e_ptp", 3.5, 10),
        ("tx40", 10, 40),
        ("double_pendulum_c1_143339", 6, 30),
    ],
)
def test_measured_logs(name, low, high):
    log = read_log(DATA / f"{name}.csv")
    trajectory = prepare_logs([log])[0]
    (stretch,) = trajectory.segments
    segment = stretch[:]
    assert low < trajectory.filter.bandwidth < high
    assert len(validation_blocks([trajectory])) == 8
    position = np.stack([np.interp(segment.time, log.time, column) for column in log.position.T], 1)
    assert np.abs(segment.position - position).max() < 0.01 * np.ptp(position, axis=0).max()
    if log.velocity is not None:
        assert not any("velocities of" in note for note in trajectory.notes)
    if name == "tx40":
        assert 7.4 < segment.time[-1] < 7.9
