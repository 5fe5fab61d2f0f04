"""Compare, diagnose, add and explain from Python, on logs of a pendulum with known efforts.

Some of the logs are odd, but ordinary: of other clocks, or too short.
"""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pendulum_logs
import pytest
from pendulum_logs import JOINTS, NOISE, PENDULUM, friction

from geodrake import load_model
from geodrake.diagnosis import Beliefs, add, compare, diagnose, explain
from geodrake.effects import CoulombFriction, FittedEffect, ViscousFriction
from geodrake.errors import ArgumentError, LogError
from geodrake.inertia import is_physical
from geodrake.logs import write_log
from geodrake.logs.filtering import design_filter

BANDWIDTH = 6.0
pendulum_log = partial(pendulum_logs.pendulum_log, seconds=20.0)
HIDDEN = friction((0.2, 0.1), (0.1, 0.04))
WHERE = {"coulomb_friction": JOINTS, "viscous_friction": JOINTS}
FLOOR = NOISE * design_filter(1 / 200.0, BANDWIDTH).noise_gain


MODEL = load_model(PENDULUM)


@pytest.fixture(scope="module")
def logs():
    return [pendulum_log(seed, HIDDEN) for seed in (1, 2)]


@pytest.fixture(scope="module")
def explained(logs):
    told = []
    found = explain(MODEL, logs, bandwidth=BANDWIDTH, progress=told.append)
    return found, told


@pytest.fixture(scope="module")
def fitted(explained):
    return explained[0].model


def places(explanation):
    return {step.effect: step.where for step in explanation.steps}


def parameters(model):
    """Return the parameters of a model's effects by name and place."""
    return {(f.effect.name, f.effect.where): f.parameters for f in model.effects}


def rms(errors):
    return np.array([joint.rms for joint in errors.joints])


def with_friction(model):
    """Return the right model."""
    values = zip((CoulombFriction, ViscousFriction), ((0.2, 0.1), (0.1, 0.04)), strict=True)
    effects = [
        FittedEffect(effect(joint), np.array([value]))
        for effect, both in values
        for joint, value in zip(JOINTS, both, strict=True)
    ]
    return replace(model, effects=tuple(effects))


def test_logs_of_a_fit_keep_its_bandwidth(fitted, logs):
    again, asked = compare(fitted, logs), compare(fitted, logs, bandwidth=BANDWIDTH)
    assert any("of the model's fit" in note for note in again.notes)
    np.testing.assert_allclose(rms(again.errors), rms(asked.errors))
    other = compare(fitted, [pendulum_log(3, HIDDEN)])
    assert any("chosen from the data" in note for note in other.notes)


def test_compare_measures_the_hidden_effort(logs):
    """The error of the unfitted model is the filtered hidden effort and noise."""
    found = compare(MODEL, logs, bandwidth=BANDWIDTH)
    assert [joint.joint for joint in found.errors.joints] == list(JOINTS)
    kernel = design_filter(1 / 200.0, BANDWIDTH).kernel
    hidden = []
    for seed in (1, 2):
        extra = pendulum_log(seed, HIDDEN).effort - pendulum_log(seed).effort
        hidden.append(np.stack([np.convolve(u, kernel, mode="valid") for u in extra.T], 1))
    expected = np.sqrt(np.mean(np.concatenate(hidden) ** 2, axis=0) + FLOOR**2)
    np.testing.assert_allclose(rms(found.errors), expected, rtol=0.03)
    residuals = np.concatenate([s.residual for s in found.series if s.joint == "shoulder"])
    assert np.sqrt(np.mean(residuals**2)) == pytest.approx(found.errors.joints[0].rms)
    measured = np.concatenate([s.measured for s in found.series if s.joint == "shoulder"])
    assert measured.std() == pytest.approx(found.errors.joints[0].std)
    ratios = [joint.rms / joint.std for joint in found.errors.joints]
    assert found.errors.nrms == pytest.approx(np.sqrt(np.mean(np.square(ratios))))


def test_compare_names_where_it_fails():
    """There is further effort while the elbow moves forwards."""

    def hidden(q, v, vd, load):
        return np.stack([np.zeros(len(q)), 0.3 * (v[:, 1] > 0)], 1)

    found = compare(MODEL, [pendulum_log(3, hidden)], bandwidth=BANDWIDTH)
    worst = found.failing[0]
    assert worst.joint == "elbow"
    assert worst.circumstance == "while moving forwards"
    assert worst.share > 0.9


def test_explain_finds_the_planted_friction_and_reaches_the_floor(explained):
    found, told = explained
    assert places(found) == WHERE
    assert found.verdict == "explained"
    np.testing.assert_allclose(rms(found.end), FLOOR, rtol=0.15)
    assert (rms(found.end) < 0.5 * rms(found.start)).all()
    assert told[0].after < told[0].before
    assert told[-1].after <= told[-1].floor


def test_steps_tell_values_with_their_deviations(explained):
    found, _ = explained
    for step in found.steps:
        name = {"coulomb_friction": "coulomb", "viscous_friction": "viscous"}[step.effect]
        for joint in JOINTS:
            deviation = step.deviations[joint][name]
            value = step.parameters[joint][name]
            truth = {"coulomb": (0.2, 0.1), "viscous": (0.1, 0.04)}[name][JOINTS.index(joint)]
            assert 0.0 < deviation < 0.02
            assert abs(value - truth) < 5.0 * deviation
        assert step.false_alarm_probability < 0.01
        assert step.error_after < step.error_before
        assert set(step.rms_after) == set(JOINTS)
    assert all(one.error_after == next_.error_before for one, next_ in pairwise(found.steps))
    assert found.steps[0].error_before == pytest.approx(found.refitted.nrms)
    assert found.steps[-1].error_after == pytest.approx(found.end.nrms)
    *before, last = found.steps
    assert last.model is None  # after which it is that of the explanation
    for count, step in enumerate(before, 1):
        names = {fitted.effect.name for fitted in step.model.effects}
        assert names == {s.effect for s in found.steps[:count]}


def test_fitted_model_predicts_new_motions_and_needs_nothing_more(fitted):
    """It predicts another log without any fit to it."""
    new = [pendulum_log(51, HIDDEN)]
    errors = compare(fitted, new, bandwidth=BANDWIDTH).errors
    np.testing.assert_allclose(rms(errors), FLOOR, rtol=0.15)
    assert is_physical(fitted.total_phi).all()
    found = explain(fitted, new, bandwidth=BANDWIDTH)
    assert (found.steps, found.bodies, found.verdict) == ((), (), "adequate")
    assert found.end == found.start and found.model is fitted


def test_something_that_no_effect_explains_is_said_to_be_left():
    """Loud coloured disturbances are unrelated to the motion; the verdict must not be noise."""
    log = pendulum_log(80)
    rng = np.random.default_rng(80)
    steps = 0.3 * rng.normal(size=(int(log.time[-1]) * 2 + 2, 2))
    wind = np.stack([np.interp(log.time * 2, np.arange(len(s)), s) for s in steps.T], 1)
    log = replace(log, effort=log.effort + wind)
    found = explain(MODEL, [log], bandwidth=BANDWIDTH)
    assert found.verdict == "unexplained"
    assert found.end.nrms > 2.0 * found.end.floor_nrms
    diagnosis = diagnose(MODEL, [log], bandwidth=BANDWIDTH)
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.candidates == ()
    assert all(0.5 < joint.removable < 1.0 for joint in found.end.joints)


def test_time_order_of_joints_and_files_change_nothing(logs, fitted, tmp_path):
    paths = [tmp_path / "a.csv", tmp_path / "b.npz"]
    for log, path in zip(logs, paths, strict=True):
        write_log(replace(log, time=log.time + 1000.0).select(JOINTS[::-1]), path)
    found = explain(MODEL, paths, bandwidth=BANDWIDTH).model
    values, expected = parameters(found), parameters(fitted)
    assert values.keys() == expected.keys()
    for key, value in expected.items():
        np.testing.assert_allclose(values[key], value, rtol=1e-4)
    np.testing.assert_allclose(found.phi, fitted.phi, rtol=1e-4, atol=1e-4)


def test_diagnose_names_the_simplest_that_does():
    """Friction that differs by direction fits as well as dry and viscous friction, and is more."""
    log = pendulum_log(2, friction((0.3, 0.15), (0.3, 0.12)))
    diagnosis = diagnose(MODEL, [log], bandwidth=BANDWIDTH)
    first, *others = diagnosis.candidates
    assert diagnosis.verdict == "explained"
    assert first.effect in {"coulomb_friction", "viscous_friction"}
    assert (first.where, first.tied) == (JOINTS, True)
    (asymmetric,) = [other for other in others if other.effect == "asymmetric_friction"]
    assert len({candidate.effect for candidate in (first, *others)}) == 1 + len(others)
    for candidate in (first, *others):
        assert candidate.error_before == pytest.approx(diagnosis.refitted.nrms, rel=0.02)
        assert candidate.error_after < candidate.error_before
        assert candidate.false_alarm_probability <= 0.01
    found = explain(MODEL, [log], bandwidth=BANDWIDTH)
    assert places(found) == WHERE
    assert first.error_after == pytest.approx(found.steps[0].error_after, rel=0.02)
    assert found.end.nrms < 1.2 * asymmetric.error_after  # which is of the fit itself


def test_diagnose_says_that_the_bodies_alone_are_wrong():
    """The lower link of the model is 40 % too heavy, and its friction is right."""
    wrong = MODEL.phi.copy()
    wrong[-1] *= 1.4
    wrong, log = replace(MODEL, phi=wrong), pendulum_log(64)
    found = diagnose(wrong, [log], bandwidth=BANDWIDTH)
    (candidate,) = found.candidates
    assert (found.verdict, candidate.effect) == ("explained", "wrong_inertia")
    assert "lower_link" in candidate.where
    assert candidate.error_before == pytest.approx(found.refitted.nrms)
    assert candidate.error_after < 0.2 * found.start.nrms
    assert candidate.false_alarm_probability < 0.01
    added = add("wrong_inertia", wrong, [log], bandwidth=BANDWIDTH)
    assert "lower_link" in added.steps[0].where
    np.testing.assert_allclose(rms(added.end), FLOOR, rtol=0.15)


@pytest.mark.parametrize(("rubbing", "share"), [(4, 1.0), (3, 0.75)])
def test_logs_without_the_effect_do_not_agree(rubbing, share):
    """Friction fitted to logs that have it makes that one worse which has none."""
    hidden = [friction((0.3, 0.2)) if i < rubbing else None for i in range(4)]
    logs = [pendulum_log(i, each) for i, each in enumerate(hidden)]
    (step,) = add("coulomb_friction", MODEL, logs, bandwidth=BANDWIDTH).steps
    assert step.agreement == share


def test_nothing_is_found_that_is_believed_to_be_nothing(logs):
    """Effects of a millionth of the efforts, and bodies known to a millionth."""
    none = Beliefs(
        size=1e-6, unknown=1e-6, widths=(1e-6,), free=(1e-6,), payloads=(1e-6,), delays=1e30
    )
    found = explain(MODEL, logs, bandwidth=BANDWIDTH, beliefs=none)
    assert found.steps == ()
    assert found.verdict == "unexplained"


def test_add_puts_an_effect_where_it_is_told(logs):
    """A place that is named twice counts once; only joints where it acts count."""
    found = add("coulomb_friction", MODEL, logs, where=["elbow", "elbow"], bandwidth=BANDWIDTH)
    (step,) = found.steps
    assert (step.effect, step.where) == ("coulomb_friction", ("elbow",))
    dry = [f.effect.where for f in found.model.effects if f.effect.name == step.effect]
    assert dry == [("elbow",)]
    assert found.certificate.holds and found.certificate.solver == "clarabel"
    assert step.rms_after["elbow"] < 0.7 * step.rms_before["elbow"]
    assert step.agreement == 1.0


def test_uncertain_gains_of_efforts_are_a_second_deviation(logs):
    """Friction varies with the efforts; a shape does not. Of gains the logs say something, too."""
    shares = (0.0, 0.05, 0.2, 0.4)
    none, once, far, farther = (
        add(
            "stribeck_friction",
            MODEL,
            [replace(log, effort_uncertainty=share) for log in logs],
            where=["elbow"],
            bandwidth=BANDWIDTH,
        ).steps[0]
        for share in shares
    )
    assert set(once.parameters["elbow"]) > set(once.systematic["elbow"]) > set()
    for name, systematic in once.systematic["elbow"].items():
        unexplained, *by_gains = (step.systematic["elbow"][name] for step in (none, far, farther))
        # How far bodies may be off is told beside gains, which changes what stays unexplained.
        assert systematic == pytest.approx(unexplained, rel=0.01)
        by_gains = [np.sqrt(s**2 - unexplained**2) for s in by_gains]
        assert 0.03 * unexplained < by_gains[0] < by_gains[1] < 2.05 * by_gains[0]
        # The noise is estimated beside gains that may move, which changes it by a hundredth of a %.
        assert none.deviations["elbow"][name] == pytest.approx(
            once.deviations["elbow"][name], rel=1e-3
        )


def test_add_to_all_joints_by_default(logs):
    found = add("coulomb_friction", MODEL, logs, bandwidth=BANDWIDTH)
    assert found.steps[0].where == JOINTS
    more = add("viscous_friction", found.model, logs, bandwidth=BANDWIDTH)
    np.testing.assert_allclose(rms(more.end), FLOOR, rtol=0.15)


@pytest.mark.parametrize(
    ("effect", "where", "words"),
    [
        ("coulomb_fricton", None, "Did you mean coulomb_friction"),
        ("nonsense", None, "There is no effect 'nonsense'.*Effects are"),
        ("coulomb_friction", ["elbo"], "no joint or body 'elbo'.*shoulder, elbow"),
        ("coulomb_friction", ["lower_link"], "at lower_link.*places: shoulder, elbow"),
        ("payload", ["elbow"], "cannot be added at elbow.*places: upper_link, lower_link"),
        ("coupled_friction", ["elbow"], "cannot be added at elbow.*places: shoulder & elbow"),
        ("effort_delay", ["lower_link"], "no joint 'lower_link'.*shoulder, elbow"),
        ("wrong_inertia", ["elbow"], "applies to the whole robot, so it takes no place"),
        ("effort_scale", None, "known inertias or payloads"),
        ("contact", ["lower_link"], "found in the residual, so it takes no place"),
        ("contact", None, "These logs show no contact"),
    ],
)
def test_add_refuses_what_cannot_be(logs, effect, where, words):
    with pytest.raises(ArgumentError, match=words):
        add(effect, MODEL, logs[:1], where=where, bandwidth=BANDWIDTH)


def test_add_refuses_what_is_there(logs):
    for where in (["elbow"], None):
        with pytest.raises(ArgumentError, match=r"cannot be added: the model already has it"):
            add("coulomb_friction", with_friction(MODEL), logs[:1], where=where)


def test_add_delays_of_joints(logs):
    """Each named joint gets its own delay, even where another one is later."""
    shifts = {"shoulder": 0.0, "elbow": 0.015}

    def late(log):
        lags = zip(shifts.values(), log.effort.T, strict=True)
        moved = [np.interp(log.time - lag, log.time, effort) for lag, effort in lags]
        return replace(log, effort=np.stack(moved, 1))

    logs, known = [late(log) for log in logs], with_friction(MODEL)
    found = add("effort_delay", known, logs, where=["elbow"], bandwidth=BANDWIDTH)
    (step,) = found.steps
    assert step.where == ("elbow",)
    assert step.parameters["elbow"]["delay"] == pytest.approx(0.015, abs=1e-3)
    assert step.deviations["elbow"]["delay"] < 1e-3
    np.testing.assert_allclose(found.model.delays, [0.0, step.parameters["elbow"]["delay"]])
    np.testing.assert_allclose(rms(found.end), FLOOR, rtol=0.2)


def test_log_of_other_joints_is_refused(logs):
    with pytest.raises(LogError, match="knee"):
        explain(MODEL, [replace(logs[0], joints=("shoulder", "knee"))])
    with pytest.raises(LogError, match="elbow"):
        explain(MODEL, [logs[0].select(["shoulder"])])
