"""Logs that are odd but ordinary: other clocks, joints that move in turn or not at all."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum_logs import JOINTS, PENDULUM, body_effort, friction, pendulum_log

from geodrake import load_model
from geodrake.diagnosis import add, compare, explain
from geodrake.errors import LogError
from geodrake.logs.motion import JointLog


@pytest.fixture(scope="module")
def model():
    return load_model(PENDULUM)


def bump(time, start, stop):
    """Smooth swings between two instants, still outside: position, velocity and acceleration."""
    phase = np.clip((time - start) / (stop - start), 0.0, 1.0)
    angle = 12 * np.pi * phase
    q = np.sin(angle) ** 3 * np.sin(np.pi * phase) ** 2
    v = np.gradient(q, time)
    return q, v, np.gradient(v, time)


def test_joints_that_move_in_turn(model):
    """Folds in which a joint does not move say nothing about its friction."""
    time = np.arange(0.0, 60.0, 0.005)
    parts = [bump(time, 1.0, 29.0), bump(time, 31.0, 59.0)]
    q, v, vd = (np.stack(signals, 1) for signals in zip(*parts, strict=True))
    rng = np.random.default_rng(0)
    effort = body_effort(q, v, vd) + np.array([0.5, 0.2]) * np.tanh(v / 0.003)
    effort += np.array([0.03, 0.015]) * rng.normal(size=effort.shape)
    log = JointLog("turn", JOINTS, time, q + 1e-6 * rng.normal(size=q.shape), effort)
    found = explain(model, [log])
    (step,) = found.steps
    assert step.effect == "coulomb_friction"
    assert step.where == JOINTS


def test_joint_that_is_exactly_at_rest(model):
    log = pendulum_log(6)
    q = log.position.copy()
    q[:, 1] = 0.3
    v = np.gradient(q, log.time, axis=0)
    effort = body_effort(q, v, np.gradient(v, log.time, axis=0))
    effort += 0.02 * np.random.default_rng(1).normal(size=effort.shape)
    assert explain(model, [replace(log, position=q, effort=effort)]).steps == ()


def test_constant_effort_is_named(model):
    log = pendulum_log(7)
    flat = replace(log, effort=np.column_stack([log.effort[:, 0], np.full(len(log), 5.0)]))
    with pytest.raises(LogError, match="effort of elbow never changes"):
        compare(model, [flat])


def test_a_place_named_twice_counts_once(model):
    log = pendulum_log(8, friction((0.5, 0.2)))
    once = add("coulomb_friction", model, [log], where=["elbow"])
    twice = add("coulomb_friction", model, [log], where=["elbow", "elbow"])
    assert twice.steps[0].parameters == once.steps[0].parameters


def test_without_a_step_the_model_stays(model):
    found = explain(model, [pendulum_log(9)])
    assert found.steps == ()
    assert found.model is model


def test_lists_do_for_a_log():
    log = JointLog("lists", ("a",), [0.0, 0.1], [[1.0], [2.0]], [[0.0], [1.0]])
    assert log.position.shape == (2, 1)


def test_a_log_too_short_for_a_lower_bandwidth(model):
    """Soft joints, which show at half the bandwidth, are looked for as far as samples reach."""

    def oscillation(q, v, vd, load):
        wave = 0.8 * np.sin(0.44 * np.arange(len(q)))
        return np.stack([wave, np.zeros_like(wave)], 1)

    log = pendulum_log(3, oscillation, rate=10.0, seconds=12.0)
    assert explain(model, [log]).verdict == "unexplained"
