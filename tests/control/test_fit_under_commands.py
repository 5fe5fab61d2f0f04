"""Fits of soft joints under commands; logs are of two masses under a servo, by scipy and MuJoCo."""

import dataclasses

import numpy as np
import pytest
from two_masses import (
    ROTOR,
    STIFFNESS,
    followed,
    springy,
    swung,
)

from geodrake import effects
from geodrake.control.rollout import (
    FittedValue,
    RolloutFit,
    fit_rollouts,
    roll_out,
)
from geodrake.control.rollout.fit_rollouts import better_model
from geodrake.control.rollout.linearized_motion import LinearizedMotion
from geodrake.control.rollout.passages import chosen_passages
from geodrake.control.rollout.rollout_values import (
    rollout_values,
    values_at,
    with_values,
)
from geodrake.control.rollout.simulation import simulations
from geodrake.diagnosis import explain
from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs.case import open_case
from geodrake.model import EffortSignal
from geodrake.report import page_of, render
from geodrake.report.json_output import rollout_fit_dict
from geodrake.report.page import About
from geodrake.report.words import rollout_fit_words

PD = EffortSignal("hinge", "command", 100.0, damping=6.0, delay=0.013)
LIMITED = dataclasses.replace(PD, limit=6.5)
SERVOS = {
    "pd": PD,
    "weak": dataclasses.replace(PD, gain=40.0, damping=3.0),
    "stiff": dataclasses.replace(PD, gain=1000.0, damping=25.0),
    "pid": dataclasses.replace(PD, integral=200.0),
    "limited": LIMITED,
    "limited pid": dataclasses.replace(LIMITED, integral=200.0),
}


def servoed(model, share, *servos):
    """A pendulum with a spring of a share of the true compliance, and servos."""
    return dataclasses.replace(springy(model, share), effort_signals=servos)


def departures(case, compliance, horizon, most):
    """In the diagram and near the motion, window by window, and servos at their limits."""
    values = rollout_values(case.model)
    new = [compliance, *(value.value for value in values[1:])]
    model = with_values(case.model, values, new, new)
    passages = chosen_passages(case, horizon, most)
    case = dataclasses.replace(case, model=model)
    made = simulations(case, passages, commands=True)(case.asked.logs[0].name)
    couplings = made.law.soft.couplings(made.law.mu)
    for passage in passages:
        near, along = LinearizedMotion.of(made, passage), made.acting.along(passage)
        found, _ = near.departure(model.effects, couplings)
        exact = made.positions(passage) - passage.segment.position
        yield exact, found, bool((np.abs(along.effort) > along.gains.limit).any())


def check_changes(case, compliance, *, share=0.02, horizon=0.3, most=2):
    """Whether departures change with the compliance near the motion as in the diagram."""
    both = (departures(case, size * compliance, horizon, most) for size in (1.0, 1.1))
    held = []
    for (exact, found, at_limit), (exact_next, found_next, _) in zip(*both, strict=True):
        change = exact_next - exact
        error = found_next - found - change
        assert np.sqrt(np.mean(error**2)) < share * np.sqrt(np.mean(change**2))
        held.append(at_limit)
    return held


@pytest.mark.parametrize("name", ["limited", "pid"])
def test_near_the_motion_servos_are_as_in_the_diagram(pendulum, name):
    """Also where efforts are not what servos mean to give: a tenth less here."""
    servo = SERVOS[name]
    scale = effects.FittedEffect(effects.EffortScale("hinge"), np.array([0.1]))
    model = servoed(pendulum, 2.0, servo)
    model = dataclasses.replace(model, effects=(*model.effects, scale))
    log = followed(0, servo, seconds=1.5)
    case = open_case(model, [log], candidates=False, bandwidth=12.0)
    held = check_changes(case, 2.0 / STIFFNESS, horizon=0.15, most=3)
    assert any(held) == (name == "limited") and not all(held)


@pytest.mark.thorough
@pytest.mark.parametrize("noise", [1e-4, 1e-3])
@pytest.mark.parametrize("name", SERVOS)
@pytest.mark.parametrize("seed", range(2))
def test_what_is_off_is_found_and_what_is_right_stays_as_good(pendulum, seed, name, noise):
    """A stiff servo follows its command more closely than straight lines between samples do."""
    period = 1e-3 if name == "stiff" else 4e-3
    log = followed(seed, SERVOS[name], noise=noise, period=period)
    assert not np.isfinite(log.effort).any()
    ends = []
    for share in (0.5, 1.0, 2.0):
        found = fit_rollouts(servoed(pendulum, share, SERVOS[name]), [log], commands=True)
        before, after = found.held_out
        assert before.commands and after.commands
        assert not found.taken or after.relative <= before.relative
        value, *_ = found.values
        deviation = STIFFNESS * value.deviation
        assert abs(STIFFNESS * value.after - 1.0) < max(0.02, 3.5 * deviation)
        if share == 2.0 and noise == 1e-4:
            assert found.taken
        ends.append(STIFFNESS * value.after)
    assert np.ptp(ends) < max(0.02, deviation)  # wherever it begins


UNSURE = dataclasses.replace(PD, deviation=10.0, damping_deviation=0.6)


def test_what_is_free_of_a_servo(pendulum):
    """All that is not exact, and then the delay; the gain takes along what is beside it."""
    pid = dataclasses.replace(UNSURE, integral=200.0, integral_deviation=9.0)
    model = servoed(pendulum, 2.0, pid)
    springs = rollout_values(model)
    values = rollout_values(model, commands=True)
    assert values[: len(springs)] == springs
    assert [value.name for value in values[len(springs) :]] == [
        "gain",
        "damping",
        "integral",
        "delay",
    ]
    assert rollout_values(servoed(pendulum, 2.0, PD), commands=True) == springs
    new, _ = values_at(values, np.array([np.log(0.5), 0.0, 1.0, -1.0, 0.5, -2.0]))
    expected = [1.0 / STIFFNESS, 0.05, 110.0, 1.1 * (6.0 - 0.6), 1.1 * 210.0, 0.013 / 30.0]
    np.testing.assert_allclose(new, expected, rtol=1e-12)
    (servo,) = with_values(model, values, new, np.full(6, 0.1)).effort_signals
    assert (servo.gain, servo.damping, servo.integral, servo.delay) == tuple(new[2:])
    deviations = servo.deviation, servo.damping_deviation, servo.integral_deviation
    assert deviations == pytest.approx((11.0, 0.1, 0.1))


def test_what_is_free_of_a_motor(pendulum):
    """Friction and the rotor, as far as they are not exact; nothing that may be of either sign."""
    servo = EffortSignal("hinge", "command", 100.0, deviation=10.0)
    model = servoed(pendulum, 1.0, servo)
    beside = (
        effects.AsymmetricFriction("hinge"),
        effects.EffortOffset("hinge"),
        effects.GravityCompensator("hinge"),
        effects.RotorInertia("hinge"),
    )
    parameters = ([1.0, 0.5, 0.0, 0.2], [0.3], [2.0, 0.1], [0.4])
    deviations = ([0.1, 0.0, 0.1, 0.1], [0.1], [0.1, 0.1], [0.1])
    motors = map(effects.FittedEffect, beside, map(np.array, parameters), map(np.array, deviations))
    model = dataclasses.replace(model, effects=(model.effects[-1], *motors))
    p = model.phi.size + sum(len(fitted.parameters) for fitted in model.effects)
    model = dataclasses.replace(model, information=np.eye(p))
    values = rollout_values(model, commands=True)
    friction = "asymmetric_friction"
    assert [(value.effect, value.name) for value in values[4:]] == [
        (friction, "coulomb_positive"),
        (friction, "viscous_negative"),
        ("rotor_inertia", "inertia"),
    ]
    known = better_model(
        model, values, values_at(values, np.zeros(len(values)))[0], np.full(7, 0.5)
    )
    diagonal = np.diag(known.information)[model.phi.size + 1 :]
    np.testing.assert_allclose(diagonal, [4.0, 1.0, 100.0, 4.0, *np.ones(3), 4.0])


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_was_found_without_the_spring_is_found_with_it(pendulum, seed):
    """Friction and rotor, too, which made up for the spring: by half and more, and by a quarter."""
    log = followed(seed, PD, noise=1e-4)
    rigid = explain(pendulum, [log]).model
    spring = effects.JointElasticity("hinge")
    for share in (0.5, 2.0):
        soft = effects.FittedEffect(spring, np.array([share / STIFFNESS]))
        model = dataclasses.replace(rigid, effects=(*rigid.effects, soft), information=None)
        values = {(v.effect, v.name): v for v in fit_rollouts(model, [log], commands=True).values}
        expected = {
            ("joint_elasticity", "compliance"): 1.0 / STIFFNESS,
            ("servo", "delay"): PD.delay,
            ("servo", "damping"): PD.damping,
            ("rotor_inertia", "inertia"): ROTOR,
        }
        for key, value in expected.items():
            found = values[key]
            assert found.deviation < 0.3 * value
            assert abs(found.after - value) < 2.5 * found.deviation


def test_what_cannot_follow_commands_is_said(pendulum):
    log = followed(0, PD, seconds=1.5)
    with pytest.raises(LogError, match="commands of a servo"):
        fit_rollouts(servoed(pendulum, 0.5, PD), [swung(0)], commands=True)
    with pytest.raises(ArgumentError, match="commands"):
        fit_rollouts(servoed(pendulum, 0.5, PD), [log], commands="all")


def test_results_say_what_they_are_under(pendulum):
    model = servoed(pendulum, 0.5, PD)
    log = followed(0, PD, seconds=1.5)
    rollout = roll_out(model, [log], horizon=0.1, most=2, bandwidth=12.0, commands=True)
    found = RolloutFit(model, (), rollout, rollout, (False, True), 1.0, False)
    model = servoed(pendulum, 0.5, dataclasses.replace(PD, deviation=1.0))
    unsure = dataclasses.replace(found, model=model)
    assert "servos of hinge are not known exactly" in unsure.notes[-1]
    assert found.notes == rollout.notes
    doubtful = rollout_fit_words(dataclasses.replace(found, chance=0.2))
    assert "(probability 0.20, 1 windows): further logs or more" in doubtful
    late = FittedValue("servo", "hinge", "delay", 5.1e-3, 13e-3, 1e-5)
    fitted = dataclasses.replace(unsure, values=(late,))
    assert fitted.notes == rollout.notes
    about = About("arm", ("log",))
    page = render(page_of(fitted, about))
    assert "Soft joints, play, their servos and motors" in page
    for words in ("delay, ms", "5.10", "13.000"):
        assert words in page
    page = render(page_of(found, about))
    assert "arm under the commands of log" in page
    assert "under the logged commands" in page
    assert "logged efforts" not in page
    told = rollout_fit_dict(found)
    for part in ("fitted", "held_out"):
        assert {stage["under"] for stage in told[part].values()} == {"commands"}


def test_slopes_with_integrals_are_differences(pendulum):
    """They are one more of what a window begins with, and have no velocities."""
    servo = SERVOS["pid"]
    log = followed(0, servo, seconds=1.5)
    case = open_case(servoed(pendulum, 2.0, servo), [log], candidates=False, bandwidth=12.0)
    (passage,) = chosen_passages(case, 0.2, 1)
    made = simulations(case, [passage], commands=True)("followed0")
    near, law = LinearizedMotion.of(made, passage), made.law
    couplings = law.soft.couplings(law.mu)
    plain, slopes = near.departure(case.model.effects, couplings, slopes=True)
    assert slopes.shape[2] == 2 * 2 + 1
    more = near.servos.effort + servo.integral  # what an integral that is larger by 1 gives
    pushed = dataclasses.replace(near, servos=dataclasses.replace(near.servos, effort=more))
    found, _ = pushed.departure(case.model.effects, couplings)
    np.testing.assert_allclose(found - plain, slopes[..., -1], atol=1e-9)
