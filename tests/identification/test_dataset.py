"""Reduction of logs: factors against dense columns, delays, noise floor and bandwidth."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from chain_logs import multisine
from pendulum_logs import JOINTS, NOISE, PENDULUM, body_effort, pendulum_log
from pinocchio_logs import MODELS, perturbed, robot
from scipy.signal import butter, sosfiltfilt

from geodrake import load_model
from geodrake.effects import (
    CoulombFriction,
    CoupledFriction,
    CoupledRotorInertia,
    EffortDelay,
    EffortScale,
    FittedEffect,
    GravityTilt,
    JointSpring,
    LoadDependentFriction,
    Payload,
)
from geodrake.errors import LogError
from geodrake.identification.logs import reduce
from geodrake.identification.logs.bandwidth import (
    ContactRowCache,
    coherent_bandwidth,
    prepare_for_model,
)
from geodrake.identification.logs.log_slices import INERTIA, Layout, RowCache
from geodrake.identification.logs.noise import filtered_below, known_noise
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.logs import JointLog, Motion
from geodrake.logs.folds import validation_blocks
from geodrake.logs.preparation import prepare_logs
from geodrake.robot import inverse_dynamics_regressor


def noise_floor(*arguments, **options):
    return known_noise(*arguments, **options)[0]


EFFECTS = (
    CoulombFriction("shoulder"),
    CoupledFriction(JOINTS, -1),
    Payload("lower_link"),
    JointSpring("elbow", exponent=3, center=0.1),
    CoupledRotorInertia(JOINTS),
    LoadDependentFriction("elbow"),
)


MODEL = load_model(PENDULUM)


@pytest.fixture(scope="module")
def trajectories():
    """Return two logs; the first has a gap."""
    log = pendulum_log(1)
    keep = (log.time < 15.0) | (log.time > 15.4)
    gap = JointLog("gap", JOINTS, log.time[keep], log.position[keep], log.effort[keep])
    return prepare_logs([gap, pendulum_log(2, seconds=25.0)], bandwidth=8.0)


@pytest.fixture(scope="module")
def folds(trajectories):
    return validation_blocks(trajectories, blocks=3)


@pytest.fixture(scope="module")
def dataset(trajectories, folds):
    return reduce_logs(MODEL, trajectories, folds, effects=EFFECTS)


def unfiltered(model, segment, width):
    """Return columns (N, 2, p) of the bodies and of EFFECTS without the payload, by formulas."""
    q, v, vd = segment.position, segment.velocity, segment.acceleration
    bodies = inverse_dynamics_regressor(model.plant, q, v, vd)
    load = bodies @ model.phi.ravel()
    sign = np.tanh(v / width)
    w = v[:, 0] - v[:, 1]
    sign_w = np.tanh(w / np.hypot(*width))
    n, zero = len(q), np.zeros(len(q))
    columns = [
        (sign[:, 0], zero),
        (sign_w, -sign_w),
        (w, -w),
        (zero, (q[:, 1] - 0.1) ** 3),
        (zero, np.ones(n)),
        (zero, np.abs(load[:, 1]) * sign[:, 1]),
    ]
    coupled = (vd[:, 1], vd[:, 0])
    columns.insert(5, coupled)
    return np.concatenate([bodies, np.stack([np.stack(c, 1) for c in columns], 2)], axis=2)


def decimated(low_pass, signal):
    """Return a plain convolution at every n-th sample."""
    return np.convolve(signal, low_pass.kernel, mode="valid")[:: low_pass.decimation]


def dense_rows(model, trajectories, fold, joint):
    """Return rows [A | b] of a fold and joint, computed directly from its definition."""
    speeds = [np.abs(s[:].velocity).max(0) for t in trajectories for s in t.segments]
    peak = np.max(speeds, axis=0)
    noise = np.max([t.speed_noise for t in trajectories], axis=0)
    width = np.maximum(0.002 * peak, 1.2 * noise)
    rows = []
    for block in fold.blocks:
        trajectory = trajectories[block.trajectory]
        segment, low_pass = trajectory.segments[block.segment][:], trajectory.filter
        columns = unfiltered(model, segment, width)[:, joint]
        signals = np.column_stack([columns, segment.effort[:, joint]])
        still = np.abs(segment.velocity[:, joint]) < 0.01 * peak[joint]
        moving = decimated(low_pass, still.astype(float)) <= 0.3
        kept = np.stack([decimated(low_pass, s) for s in signals.T], 1)
        part = slice(block.start, block.stop)
        rows.append(kept[part][moving[part]])
    return np.concatenate(rows)


def test_factors_are_those_of_the_dense_columns(trajectories, folds, dataset):
    for j in range(2):
        data = dataset.data[j]
        for f, fold in enumerate(folds):
            rows = dense_rows(MODEL, trajectories, fold, j)
            used = rows[:, [*data.columns, -1]]
            assert data.samples[f] == len(rows)
            assert len(rows) > 10
            scale = np.linalg.norm(used, axis=0)
            np.testing.assert_allclose(
                data.grams[f] / np.outer(scale, scale),
                used.T @ used / np.outer(scale, scale),
                atol=1e-9,
            )


def test_every_joint_has_delays_of_its_own():
    log = pendulum_log(3, noise=(0.0, 0.0))
    rate = np.array([3.0, 5.0])
    log = replace(log, effort=np.sin(rate * log.time[:, None]))
    trajectories = prepare_logs([log], bandwidth=10.0)
    late = replace(MODEL, effects=(FittedEffect(EffortDelay(0.007, "elbow"), np.empty(0)),))
    folds, delays = validation_blocks(trajectories), (0.0, [0.012, -0.02])
    dataset = reduce_logs(late, trajectories, folds, effects=(), delays=delays)
    np.testing.assert_array_equal(dataset.delays, [[0.0, 0.0], [0.012, -0.02]])
    for j, advance in enumerate(((0.0, 0.012), (0.007, -0.013))):
        for rows in (rows for blocks in dataset.data[j].rows for rows in blocks):
            truth = np.sin(rate[j] * (rows.time[:, None] + advance))
            np.testing.assert_allclose(rows.b, truth, atol=2e-3)


@pytest.mark.parametrize("noise", [0.0, 2e-3])  # rad, of positions
def test_joint_at_rest_has_no_rows_of_that_time(noise):
    """Dry friction of a resting joint is undetermined."""
    time, rng = np.arange(8000) / 200.0, np.random.default_rng(4)
    q = multisine(time, rng)[0]
    q[:, 1] *= np.clip(np.abs(time - 20.0) - 5.0, 0.0, 1.0) ** 3  # the elbow rests from 15 to 25 s
    log = replace(pendulum_log(4), time=time, position=q + noise * rng.normal(size=q.shape))
    trajectories = prepare_logs([log], bandwidth=8.0)
    dataset = reduce_logs(MODEL, trajectories, validation_blocks(trajectories), effects=())
    shoulder, elbow = (
        np.concatenate([rows.time for blocks in data.rows for rows in blocks])
        for data in dataset.data
    )
    assert not ((elbow > 15.5) & (elbow < 24.5)).any()
    assert ((shoulder > 15.5) & (shoulder < 24.5)).sum() > 80


def test_effort_that_never_changes_is_refused():
    log = pendulum_log(5, seconds=20.0)
    flat = replace(log, effort=np.column_stack([log.effort[:, 0], np.full(len(log), 3.3)]))
    trajectories = prepare_logs([flat], bandwidth=8.0)
    with pytest.raises(LogError, match=r"effort of elbow is constant in the log: 3\.3 "):
        reduce_logs(MODEL, trajectories, validation_blocks(trajectories), effects=())


@pytest.mark.parametrize("bandwidth", [4.0, 15.0])
def test_noise_floor_of_white_noise(bandwidth):
    """Known noise is under much larger efforts, some of which no model has."""

    def hidden(q, v, vd, load):
        return 0.5 * np.tanh(v / 0.2) + 0.3 * np.sin(3.0 * q)

    logs = [pendulum_log(10, hidden), pendulum_log(20, hidden)]
    trajectories = prepare_logs(logs, bandwidth=bandwidth)
    expected = NOISE * trajectories[0].filter.noise_gain
    np.testing.assert_allclose(noise_floor(trajectories), expected, rtol=0.1)


def test_noise_floor_of_efforts_that_are_held():
    """A source at a third of the log's rate repeats its noise, which has zeros above the motion."""
    log = pendulum_log(10)
    kept = np.arange(len(log.time)) // 3 * 3
    held = prepare_logs([replace(log, effort=log.effort[kept])], bandwidth=4.0)
    expected = np.sqrt(3.0) * NOISE * held[0].filter.noise_gain
    np.testing.assert_allclose(noise_floor(held), expected, rtol=0.1)
    np.testing.assert_allclose(noise_floor(held, MODEL), expected, rtol=0.1)


def test_noise_floor_of_efforts_that_were_filtered_before():
    """Below the cutoff, noise is the residual of a fitted model; above it there is none."""
    log, sections = pendulum_log(12), butter(8, 10.0, fs=200.0, output="sos")
    smooth = replace(log, effort=sosfiltfilt(sections, log.effort, axis=0))
    plain, filtered = (prepare_logs([each], bandwidth=5.0) for each in (log, smooth))
    expected = NOISE * plain[0].filter.noise_gain
    np.testing.assert_allclose(noise_floor(filtered, MODEL, fitted=True), expected, rtol=0.25)
    assert np.all(noise_floor(filtered, MODEL) < 0.01 * expected)  # nothing is taken for noise yet
    assert filtered_below(plain[0]) == np.inf
    assert filtered_below(filtered[0]) == pytest.approx(10.0, rel=0.4)


@pytest.mark.parametrize("tacho", [None, 1e-3])
def test_noise_floor_of_noise_in_the_motion(tacho):
    """Noise of encoders and tachometers enters predictions by accelerations."""
    rng = np.random.default_rng(5)
    log = pendulum_log(8, noise=(0.0, 0.0), reach=0.2)
    speed = multisine(log.time, np.random.default_rng(8), reach=0.2)[1]
    noisy = replace(
        log,
        position=log.position + 1e-4 * rng.normal(size=log.position.shape),
        velocity=None if tacho is None else speed + tacho * rng.normal(size=speed.shape),
    )
    trajectories = prepare_logs([noisy], bandwidth=8.0)
    segment, low_pass = trajectories[0].segments[0][:], trajectories[0].filter
    predicted = body_effort(segment.position, segment.velocity, segment.acceleration)
    rms = np.sqrt(np.mean(low_pass.apply(predicted - segment.effort) ** 2, axis=0))
    np.testing.assert_allclose(noise_floor(trajectories, MODEL), rms, rtol=0.1)
    assert np.all(noise_floor(trajectories) < 0.1 * rms)


def shaken(amplitude, *, at=18.0, seconds=60.0):
    """Return a log whose elbow vibrates behind its motor, without the motor's effort."""
    log = pendulum_log(8, seconds=seconds, rate=400.0)
    position = log.position.copy()
    position[:, 1] += amplitude * np.sin(2 * np.pi * at * log.time)
    return replace(log, position=position)


def test_vibration_that_efforts_do_not_know_lowers_the_bandwidth():
    trajectories = prepare_logs([shaken(5e-3)], bandwidth=30.0)
    limit = coherent_bandwidth(ContactRowCache(MODEL), trajectories)
    assert 1.0 < limit < 18.0
    (prepared,), words = prepare_for_model(MODEL, [shaken(5e-3)])
    assert prepared.filter.bandwidth < 18.0
    assert coherent_bandwidth(ContactRowCache(MODEL), [prepared]) is None
    assert words is None or "bandwidth" in words


def test_bandwidth_of_a_short_log_is_raised_as_far_as_accelerations_are_no_noise():
    log = pendulum_log(9, seconds=15.0, rate=500.0, noise=(0.3, 1e-3))
    shaky = np.random.default_rng(0).normal(size=(len(log.time), 1)) * [0.0, 1.0]
    chosen, raised = {}, {}
    for size in (0.0, 1e-4, 1e-2):
        (found,), words = prepare_for_model(
            MODEL, [replace(log, position=log.position + size * shaky)]
        )
        chosen[size], raised[size] = found.filter.bandwidth, "as the log is short" in (words or "")
    assert raised == {0.0: True, 1e-4: True, 1e-2: False}
    assert chosen[1e-4] < 0.5 * chosen[0.0]


def test_reductions_that_share_filtered_rows_are_those_that_do_not(
    trajectories, folds, monkeypatch
):
    monkeypatch.setattr(reduce, "CHUNK", 1111)
    cache, scale = RowCache(3_000), EffortScale("elbow")  # room for a part of the rows
    late = replace(MODEL, effects=(FittedEffect(EffortDelay(0.007), np.empty(0)),))
    scaled = replace(MODEL, effects=(FittedEffect(EFFECTS[0], np.array([0.3])),))
    for which, effects, delays in (
        (MODEL, EFFECTS[:3], (0.0,)),
        (MODEL, EFFECTS, (0.0, 0.01)),
        (MODEL, EFFECTS[::-1], (0.0, -0.01)),
        (replace(MODEL, phi=1.1 * MODEL.phi), EFFECTS, (0.0,)),
        (late, EFFECTS, (0.0, 0.01)),
        (MODEL, (scale, *EFFECTS[:2]), (0.0,)),
        (scaled, (scale, *EFFECTS[:2]), (0.0,)),
    ):
        options = {"effects": effects, "delays": delays}
        one = reduce_logs(which, trajectories, folds, **options)
        other = reduce_logs(which, trajectories, folds, shared=cache, **options)
        assert one.effects == other.effects
        np.testing.assert_array_equal(one.samples, other.samples)
        for a, b in zip(one.data, other.data, strict=True):
            np.testing.assert_array_equal(a.columns, b.columns)
            for few, many in zip(sum(a.rows, ()), sum(b.rows, ()), strict=True):
                np.testing.assert_array_equal(few.time, many.time)
                for part in ("motion", "A", "b"):
                    np.testing.assert_allclose(getattr(few, part), getattr(many, part), atol=1e-9)


def test_noise_is_not_known_from_a_model_that_leaves_less():
    """Ripple above the motion says nothing of noise in it, nor do efforts that were filtered."""
    log, rng = pendulum_log(14), np.random.default_rng(0)
    fast = butter(6, 7.0, fs=200.0, output="sos", btype="highpass")
    ripple = 20.0 * NOISE * sosfiltfilt(fast, rng.normal(size=log.effort.shape), axis=0)
    slow = butter(8, 10.0, fs=200.0, output="sos")
    for each, known in (
        (log, True),
        (replace(log, effort=log.effort + ripple), False),
        (replace(log, effort=sosfiltfilt(slow, log.effort, axis=0)), False),
    ):
        _, found, of_motion = known_noise(prepare_logs([each], bandwidth=5.0), MODEL, fitted=True)
        assert found.tolist() == [known, known] and not of_motion.any()


ARM = load_model(MODELS / "arm6.urdf")
NV = len(ARM.joints)
ORDER = [0, 1, 2, 3, 4, 6, 9, 5, 8, 7]  # of Pinocchio's xx, xy, yy, xz, yz, zz among ours


def leaning(model, angles):
    """Return a robot whose base is rotated by a vector about x and y."""
    turned = pin.Model(model)
    turned.gravity.linear = pin.exp3(np.array([*angles, 0.0])).T @ np.array([0.0, 0.0, -9.81])
    return turned


def parameters(model):
    """Return φ (10 nb,) of Pinocchio's bodies, in the model's order."""
    bodies = [model.inertias[i].toDynamicParameters()[ORDER] for i in range(1, model.njoints)]
    return np.concatenate(bodies)


def columns(effects, motion):
    """Per joint, columns (N, p) of bodies and effects, and what the former have of the latter."""
    layout = Layout.of(ARM, effects, np.ones(NV), np.zeros(NV))
    known = SimpleNamespace(bandwidth=10.0)
    log = SimpleNamespace(payloads=(), name="a", filter=known, acceleration_noise=0.0)
    found, load = layout.evaluate(motion, log, layout.parts)
    parts = dict(zip(layout.parts, found, strict=True))
    inertial = parts.pop(INERTIA)
    held = [layout.in_bodies(j, parts) for j in range(NV)]
    return layout, inertial, parts, held, load


@pytest.mark.parametrize("angles", [(0.03, -0.05), (-0.7, 1.1)])
def test_efforts_of_any_bodies_are_exact_at_the_slope(angles):
    rng = np.random.default_rng(4)
    q, v, vd = rng.normal(size=(3, 20, NV))
    tilt, truth = (
        GravityTilt(about_x=angles[0], about_y=angles[1]),
        perturbed(robot("arm6"), rng, 0.4),
    )
    layout, inertial, parts, held, load = columns((tilt,), Motion(q, v, vd))
    phi = parameters(truth)
    found = np.empty_like(q)
    for j, own in enumerate(layout.columns):
        bodies = inertial[j] @ phi[own[own < phi.size]]
        found[:, j] = bodies - held[j] + parts[tilt][j] @ np.array(angles)
    for efforts, bodies in ((found, truth), (load, robot("arm6"))):
        turned = leaning(bodies, angles)
        data = turned.createData()
        wanted = [pin.rnea(turned, data, *sample) for sample in zip(q, v, vd, strict=True)]
        np.testing.assert_allclose(efforts, wanted, atol=1e-9 * np.abs(wanted).max())
