"""Logs as robots are driven every day: joints in turn, efforts a little late, large offsets."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from pendulum_logs import JOINTS, PENDULUM, body_effort, pendulum_log
from pinocchio_logs import MODELS, effort_log, robot

from geodrake import load_model
from geodrake.diagnosis import explain
from geodrake.diagnosis.moves import neighbours
from geodrake.diagnosis.refinements import common_delay
from geodrake.diagnosis.search import Search, searched
from geodrake.identification.logs.bandwidth import prepare_for_model
from geodrake.identification.logs.case import open_case
from geodrake.logs import JointLog

DRY, WET = np.array([0.3, 0.15]), np.array([0.2, 0.1])


@pytest.fixture(scope="module")
def model():
    return load_model(PENDULUM)


def places(explanation):
    return {step.effect: set(step.where) for step in explanation.steps}


def in_turn(seconds=30.0, rate=100.0, noise=(0.003, 1e-5), rotors=(0.0, 0.0)):
    """A log in which the shoulder moves for a while, and then the elbow, both with friction.

    Its noise is that of efforts, N·m, and of positions, rad.
    """
    rng, time = np.random.default_rng(5), np.arange(0.0, seconds, 1.0 / rate)
    half = seconds / 2.0
    q = np.zeros((len(time), 2))
    for joint in range(2):
        since = time - joint * half
        moves = (since >= 0.0) & (since < half)
        swing = 1.2 * np.sin(2.0 * since[moves]) * np.sin(np.pi * since[moves] / half) ** 2
        q[moves, joint] = swing
    v = np.gradient(q, time, axis=0)
    vd = np.gradient(v, time, axis=0)
    effort = body_effort(q, v, vd) + DRY * np.tanh(v / 0.003) + WET * v + rotors * vd
    effort, measured = (
        each + size * rng.normal(size=q.shape)
        for each, size in zip((effort, q), noise, strict=True)
    )
    return JointLog("in turn", JOINTS, time, measured, effort)


@pytest.mark.thorough
def test_common_effects_in_turn_are_not_taken_for_rare_ones():
    """In 40 s at 50 Hz: friction of six joints and a tool, which compensators could imitate."""
    rng, arm, time = np.random.default_rng(3), robot("arm6"), np.arange(0.0, 40.0, 0.02)
    tool = pin.Inertia(
        0.06 * sum(i.mass for i in arm.inertias), np.array([0.02, 0.01, 0.06]), 1e-3 * np.eye(3)
    )
    arm.inertias[arm.njoints - 1] += tool
    each, q = 40.0 / arm.nv, np.zeros((len(time), arm.nv))
    for joint in range(arm.nv):
        since, size = np.clip(time - joint * each, 0.0, each), rng.uniform(0.6, 1.0)
        swing = np.sin(rng.uniform(1.0, 2.0) * since) * np.sin(np.pi * since / each) ** 2
        q[:, joint] = size * swing
    v = np.gradient(q, time, axis=0)
    rows = zip(q, v, np.gradient(v, time, axis=0), strict=True)
    load = np.array([pin.rnea(arm, arm.createData(), *row) for row in rows])
    dry, wet = (rng.uniform(*r, arm.nv) * np.abs(load).max(0) for r in ((0.02, 0.1), (0.01, 0.05)))
    effort = load + dry * np.tanh(v / 0.005) + wet * v
    effort += 0.008 * effort.std(0) * rng.normal(size=q.shape)
    joints, measured = tuple(arm.names)[1:], q + 2e-4 * rng.normal(size=q.shape)
    known = load_model(MODELS / "arm6.urdf")
    found = explain(known, [JointLog("in turn", joints, time, measured, effort)])
    friction = {"coulomb_friction": {*joints}, "viscous_friction": {*joints}}
    assert places(found) == {**friction, "payload": {known.bodies[-1]}}


def test_friction_of_joints_that_move_in_turn_is_found_and_predicted(model):
    """That the elbow rubs against the shoulder, no log of joints in turn can tell."""
    found = explain(model, [in_turn()], blocks=2)
    assert places(found) == {"coulomb_friction": {*JOINTS}, "viscous_friction": {*JOINTS}}
    assert found.end.nrms < 0.03


def test_heavy_rotors_behind_noise_of_accelerations_are_found_at_a_lower_bandwidth(model):
    log = in_turn(noise=(0.003, 3e-5), rotors=np.array([20.0, 5.0]))
    found = explain(model, [log])
    assert any("noise of accelerations makes up" in note for note in found.notes)
    every = {*JOINTS}
    assert places(found) == {
        "coulomb_friction": every,
        "viscous_friction": every,
        "rotor_inertia": every,
    }
    (rotors,) = (s.parameters for s in found.steps if s.effect == "rotor_inertia")
    assert rotors["shoulder"]["inertia"] == pytest.approx(20.0, rel=0.02)


def test_a_lower_bandwidth_leaves_enough_samples_of_every_log(model):
    noisy = in_turn(noise=(0.0003, 1e-4), rotors=np.array([20.0, 5.0]))
    begin = noisy.time < 6.0
    short = replace(
        noisy,
        name="short",
        time=noisy.time[begin],
        position=noisy.position[begin],
        effort=noisy.effort[begin],
    )
    (long, kept), words = prepare_for_model(model, [noisy, short])
    assert "lowered" in words
    assert min(map(sum, (long.output_counts, kept.output_counts))) >= 10


def test_an_offset_may_be_many_times_the_deviation_of_an_effort(model):
    usual = pendulum_log(3).effort.std(axis=0)[1]
    log = pendulum_log(3, lambda q, v, vd, load: np.full_like(q, 40 * usual) * [0.0, 1.0])
    (step,) = explain(model, [log]).steps
    assert (step.effect, step.where) == ("effort_offset", ("elbow",))
    assert step.parameters["elbow"]["offset"] == pytest.approx(40 * usual, rel=0.01)


def test_offset_and_symmetric_friction_are_simpler_than_asymmetric_friction(model):
    """Also beside a rotor, where three effects take the place of one of two."""

    def hidden(q, v, vd, load):
        friction = DRY * np.tanh(v / 0.003) + WET * v + np.array([0.0, 0.08])
        return friction + np.array([0.3, 0.1]) * vd

    found = explain(model, [pendulum_log(4, hidden, noise=(0.003, 0.002))])
    assert places(found) == {
        "coulomb_friction": {*JOINTS},
        "viscous_friction": {*JOINTS},
        "rotor_inertia": {*JOINTS},
        "effort_offset": {"elbow"},
    }


def test_a_delay_takes_the_place_of_viscous_friction_at_all_joints(model):
    """Friction that makes up for a delay goes when all efforts are late."""
    log = pendulum_log(3, rate=250.0)
    seconds = Search(open_case(model, [log], candidates=True)).model.dataset.delays[1, 0]
    efforts = [np.interp(log.time - seconds, log.time, each) for each in log.effort.T]
    late = replace(log, effort=np.stack(efforts, 1))
    log_model = Search(open_case(model, [late], candidates=True)).model
    wet = [term for term in log_model.terms if term.name == "viscous_friction"]
    choice = log_model.choice(log_model.bare(np.ones(2)).choice, wet)
    found = neighbours(log_model, log_model.unbounded(choice, np.ones(2)))
    delays = [log_model.lateness(choice) for choice in found if not choice.terms]
    assert any(np.allclose(delay, seconds) for delay in delays)


def sampled_late(steps):
    """A log at 100 Hz of a robot with heavy rotors, its efforts late by so many steps of 1 ms."""
    how = {"rate": 1000.0, "share": 0.003}
    log = effort_log("double_pendulum", 6, lambda seen: 0.4 * seen.a, **how).log
    late = np.vstack([log.effort[:1]] * steps + [log.effort[: len(log.effort) - steps]])
    return JointLog("late", log.joints, log.time[::10], log.position[::10], late[::10])


def test_efforts_that_are_late_by_a_part_of_a_sample_are_late():
    """With heavy rotors this would look like viscous friction."""
    found = explain(load_model(MODELS / "double_pendulum.urdf"), [sampled_late(2)])
    assert {step.effect for step in found.steps} >= {"rotor_inertia", "effort_delay"}
    (delay,) = (step for step in found.steps if step.effect == "effort_delay")
    assert delay.parameters["all joints"]["delay"] == pytest.approx(2e-3, abs=5e-4)


def test_efforts_that_are_late_by_a_tenth_of_a_sample_are_not():
    """No log is more synchronous than that, as its signals are read one after the other."""
    found = explain(load_model(MODELS / "double_pendulum.urdf"), [sampled_late(1)])
    assert {step.effect for step in found.steps} == {"rotor_inertia"}


@pytest.mark.parametrize("seed", [0, 1])
def test_noise_of_accelerations_that_a_found_rotor_carries_is_noise(model, seed):
    """The file's light bodies carry a part of it; the rest would count as a model error."""
    rng = np.random.default_rng(seed)
    log = pendulum_log(seed, lambda q, v, vd, load: np.array([0.6, 0.2]) * vd, noise=(3e-3, 2e-3))
    noisy = replace(log, position=log.position + 3e-4 * rng.normal(size=log.position.shape))
    case = open_case(model, [noisy], candidates=True, bandwidth=8.0)
    found = searched(case)
    left = np.sqrt(found.fit.variance)
    assert {term.name for term in found.fit.terms} == {"rotor_inertia"}
    assert np.all(left > 2.0 * case.dataset.noise_floor)
    np.testing.assert_allclose(found.model.dataset.noise_floor, left, rtol=0.15)


def test_a_common_delay_is_that_of_the_joints_that_know_it_best():
    delays, deviations = np.array([0.0, 4e-3, 5e-3]), np.array([np.inf, 1e-5, 1e-3])
    assert common_delay(delays, deviations) == pytest.approx(4e-3, rel=1e-3)
    assert common_delay(delays, np.full(3, np.inf)) == pytest.approx(4.5e-3)
    assert common_delay(np.full(3, 4e-3), deviations) is None
    assert common_delay(np.zeros(3), deviations) is None
