"""Long logs: slices are those of the whole, and memory does not grow beyond the log itself."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from pendulum_logs import JOINTS, PENDULUM

from geodrake.diagnosis import compare
from geodrake.errors import LogError
from geodrake.identification.logs import noise, reduce
from geodrake.logs import JointLog, read_log, smoothing, uniform_log, write_log
from geodrake.logs.preparation import prepare_logs
from geodrake.model import load_model


def long_log(samples, *, velocity=False, seed=0):
    """Sines with dry friction, at 500 Hz with jitter."""
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


def test_what_is_kept_of_a_short_log_cannot_be_written_to():
    (stretch,) = prepare_logs([long_log(3000)], bandwidth=6.0)[0].segments
    part = stretch[5:50]
    signals = (part.time, part.position, part.velocity, part.acceleration, part.effort)
    assert not any(signal.flags.writeable for signal in signals)


def test_trimming_does_not_depend_on_chunks(monkeypatch):
    log = long_log(9000)
    still = np.clip(log.time, 3.0, 15.0)
    log = replace(log, position=np.sin(np.array([2.0, 3.3]) * (still[:, None] - 3.0)))
    (whole,) = prepare_logs([log], bandwidth=6.0)[0].segments
    monkeypatch.setattr(smoothing, "CHUNK", 333)
    monkeypatch.setattr(smoothing, "_KEPT", 333)
    (cut,) = prepare_logs([log], bandwidth=6.0)[0].segments
    assert (cut.first, cut.stop) == (whole.first, whole.stop)
    assert cut.first > 0
    assert cut.stop < len(cut.piece)


def test_choices_look_at_a_part_of_a_long_log(monkeypatch):
    log = long_log(9000)
    monkeypatch.setattr(uniform_log, "_PART", 1_000)
    monkeypatch.setattr(uniform_log, "_LOOKED_AT", 2_000)
    parts = list(uniform_log.make_uniform(log).sample_parts())
    assert [len(part) for part in parts] == pytest.approx([250] * 8, abs=1)
    assert parts[0].time[0] == log.time[0]
    assert parts[-1].time[-1] > 0.85 * log.time[-1]


def test_memory_grows_with_the_log_alone(monkeypatch, tmp_path):
    """A sample of two joints is 40 bytes; smoothed copies and regressors would be hundreds more."""
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
            compare(model, [path], bandwidth=8.0)  # what is compiled and factored once
        tracemalloc.start()
        try:
            compare(model, [path], bandwidth=8.0)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    grown = (peaks[1] - peaks[0]) / (lengths[1] - lengths[0])
    assert 40 < grown < 110  # and rows, steps and gaps for a moment


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
