"""Episodes: contacts and payloads during a part of a log."""

import dataclasses
import json
from contextlib import suppress

import numpy as np
import pinocchio as pin
import pytest
from pinocchio_logs import MODELS, effort_log
from pydrake.multibody.tree import default_model_instance
from pydrake.systems.framework import DiagramBuilder
from scipy.special import expit

from geodrake import load_model
from geodrake.boundary.interrupts import StopSearch
from geodrake.diagnosis import add, compare, explain
from geodrake.diagnosis.contact_window import ResidualWindow, columns, refined, with_point
from geodrake.diagnosis.search import Search
from geodrake.effects import Contact, FittedEffect, TemporaryPayload
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import prepare_case
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs.filtering import design_filter
from geodrake.model import save_model
from geodrake.model.export import export_model
from geodrake.report import Units
from geodrake.report.json_output import to_json
from geodrake.report.views import numbers_of
from geodrake.report.words import finding

pytest.importorskip("pinocchio")


ARM = load_model(MODELS / "arm6.urdf")
PENDULUM = load_model(MODELS / "double_pendulum.urdf")
LINK, POINT = "lower_link", (0.0, 0.0, -0.3)
BRIEF = {"off": 0.2, "duration": 16.0, "rate": 125.0}


def pushed(joint, point, force, window, *, turning=False, rise=0.015):
    """Return efforts against a force (3,) along the axes of the world or body, at a point."""

    def hidden(seen):
        start, end = window
        on = expit((seen.time - start) / rise) - expit((seen.time - end) / rise)
        effort = np.zeros_like(seen.v)
        for i in np.flatnonzero(on > 1e-9):
            pin.forwardKinematics(seen.model, seen.data, seen.q[i])
            J = pin.computeJointJacobian(seen.model, seen.data, seen.q[i], joint)
            velocity = J[:3] - pin.skew(np.array(point)) @ J[3:]
            R = seen.data.oMi[joint].rotation
            effort[i] -= on[i] * velocity.T @ (force if turning else R.T @ force)
        return effort

    return hidden


def found_in(hidden, seed, **options):
    return explain(PENDULUM, [effort_log("double_pendulum", seed, hidden, **options).log])


def assert_is_saved(found, folder):
    save_model(found.model, folder / "robot.yaml")
    again = load_model(folder / "robot.yaml")
    assert [f.effect for f in again.effects] == [f.effect for f in found.model.effects]
    return again


class TestDiagnosis:
    """The benchmark of hidden effects has further robots, points and forces."""

    def test_a_force_that_turns_with_its_body(self, tmp_path):
        """The components of a jet or a tool along the body's axes are constant."""
        force = np.array([3.0, 0.0, -1.5])
        found = found_in(pushed(2, POINT, force, (8.0, 11.0), turning=True), 1, **BRIEF)
        (step,) = found.steps
        assert (step.effect, step.where, found.verdict) == ("contact", (LINK,), "explained")
        ((place, values),) = step.parameters.items()
        assert place.startswith(f"{LINK}, turning with it, ")
        assert (values["start"], values["end"]) == pytest.approx((8.0, 11.0), abs=0.02)
        pushing = [-values[f"force_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose(pushing, force, atol=0.05 * np.linalg.norm(force))
        assert_is_saved(found, tmp_path)

    def test_a_long_push_in_slow_motion(self):
        """Bodies and what reversals leave follow it, unless a fit gives little weight to it."""
        push = pushed(4, (0.0, 0.02, 0.1), np.array([1.5, -1.0, 1.2]), (8.0, 10.5))
        found = explain(ARM, [effort_log("arm6", 3, push, share=0.01, pace=0.15).log])
        assert [(s.effect, s.where) for s in found.steps] == [("contact", ("wrist_barrel",))]
        assert found.verdict == "explained"

    @pytest.mark.thorough
    def test_a_push_that_comes_slowly(self):
        """Before its edges are found, the right body's wrench predicts less than others' do.

        Without it, friction and delays of three joints follow the push.
        """
        force, push = np.array([-5.0, 9.5, 0.1]), (6.0, 9.2)
        hidden = pushed(6, (0.08, -0.05, 0.08), force, push, rise=0.05)
        log = effort_log("arm7", 4, hidden, share=0.005, rate=125.0).log
        (step,) = explain(load_model(MODELS / "arm7.urdf"), [log]).steps
        ((_, values),) = step.parameters.items()
        assert (step.effect, step.where) == ("contact", ("link_6",))
        assert (values["start"], values["end"]) == pytest.approx(push, abs=0.03)
        pushing = [-values[f"force_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose(pushing, force, atol=0.05 * np.linalg.norm(force))

    def test_two_pushes_and_another_log(self, tmp_path):
        first = pushed(2, POINT, np.array([2.0, 0.0, 0.0]), (5.0, 6.0))
        second = pushed(2, POINT, np.array([-1.5, 0.0, 1.0]), (17.0, 18.5))
        found = found_in(lambda seen: first(seen) + second(seen), 4)
        (step,) = found.steps
        assert (step.effect, step.where, len(step.parameters)) == ("contact", (LINK,), 2)
        again = assert_is_saved(found, tmp_path)
        as_it_stands = compare(again, [effort_log("double_pendulum", 5).log]).errors
        assert as_it_stands.nrms < 0.03  # and nothing of the pushes

    def test_a_guess_of_times_and_point_is_refined(self):
        """The residual is that of a force at a point, from 1.3 to 2.6 s, and much above noise."""
        time, rng = np.arange(0.0, 4.0, 0.01), np.random.default_rng(0)
        waves = rng.uniform(0.5, 2.0, 6) * time[:, None] + rng.uniform(0.0, 6.0, 6)
        bodies = RobotBodies(ARM.tree, ARM.positions(np.sin(waves)), ARM.total_phi)
        low_pass = design_filter(0.01, 8.0)
        outputs = time[low_pass.output_indices(len(time))]
        nothing = np.zeros((len(outputs), 6))
        window = ResidualWindow(
            1.0, 3.0, time, bodies, outputs, nothing, np.full(6, 0.01), low_pass
        )
        true = Contact("wrist_barrel", 1.3, 2.6, 0.06, x=0.05, y=-0.1, z=0.15)
        efforts = columns(window, true) @ [3.0, -2.0, 1.0, 0.0, 0.0, 0.0]
        window = dataclasses.replace(window, residual=efforts)
        found = refined(window, with_point(window, Contact("wrist_barrel", 1.1, 2.8, 0.03)))
        times = found.start, found.end, found.rise
        assert times == pytest.approx((true.start, true.end, true.rise), abs=1e-4)
        assert found.point == pytest.approx(true.point, abs=1e-3)

    def test_a_stop_while_contacts_are_tried_keeps_what_was_found(self, monkeypatch):
        push, climbed = pushed(2, POINT, np.array([2.0, 0.0, 0.0]), (5.0, 6.0)), []
        climb = Search._climb

        def stopped_among_contacts(search, **settings):
            if search._suggested_for and not climbed:
                climbed.append(search)
                raise StopSearch
            climb(search, **settings)

        monkeypatch.setattr(Search, "_climb", stopped_among_contacts)
        found = found_in(lambda seen: push(seen) + 2.0 * seen.v, 4)
        assert climbed and found.is_interrupted
        assert "viscous_friction" in {step.effect for step in found.steps}


pytest.importorskip("pinocchio")


MASS, CENTRE = 0.4, np.array([0.02, 0.0, 0.05])
COULOMB, VISCOUS = np.array([0.3, 0.2]), np.array([0.2, 0.15])
BODY = "lower_link"


def test_a_stop_in_a_second_climb_keeps_the_answer_before(monkeypatch):
    push, states = pushed(2, POINT, np.array([3.0, 0.0, -1.5]), (8.0, 11.0), turning=True), []
    log = effort_log("double_pendulum", 1, push, **BRIEF).log
    search = Search(prepare_case(PENDULUM, [log], candidates=True))

    def stop(*_):
        raise StopSearch

    def stopped_at_its_end(search, start, climb=Search._climb_from):
        states.append((search.fit, search.model))
        monkeypatch.setattr(Search, "_refitted", stop)
        climb(search, start)

    monkeypatch.setattr(Search, "_climb_from", stopped_at_its_end)
    with suppress(StopSearch):  # raised again if there is no step yet
        search.run()
    ((fit, model),) = states
    assert search.fit is fit and search.model is model


@pytest.fixture(scope="module")
def pendulum():
    return load_model(MODELS / "double_pendulum.urdf")


def held(weight):
    """Return efforts of friction, and of a ball at the last link with the weight w(t)."""

    ball = pin.Inertia(MASS, CENTRE, 0.4 * MASS * 0.03**2 * np.eye(3))

    def hidden(seen):
        more = seen.with_body(seen.model.njoints - 1, lambda own: own + ball)
        friction = COULOMB * seen.v / np.hypot(seen.v, 5e-3) + VISCOUS * seen.v
        return weight(seen.time)[:, None] * more + friction

    return hidden


def a_log(seed, weight, **options):
    options = {"duration": 16.0, "rate": 125.0, "share": 0.01, **options}
    return effort_log("double_pendulum", seed, held(weight), **options).log


def acceleration(model, time):
    """Return accelerations of a robot in a diagram at an instant, state and efforts."""
    builder = DiagramBuilder()
    robot = model.add_to_builder(builder)
    builder.ExportInput(robot.effort, "effort")
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    context.SetTime(time)
    diagram.get_input_port(0).FixValue(context, [0.4, -0.2])
    own = robot.plant.GetMyContextFromRoot(context)
    robot.plant.SetPositionsAndVelocities(own, [0.3, 0.5, -0.4, 0.7])
    return robot.plant.get_generalized_acceleration_output_port(default_model_instance()).Eval(own)


START = 6.3


@pytest.fixture(scope="module")
def picked_up(pendulum):
    """Return a log in which a payload is picked up, and its explanation."""
    log = a_log(1, lambda t: (t >= START).astype(float))
    return log, explain(pendulum, [log])


def test_found(pendulum, picked_up, tmp_path):
    log, found = picked_up
    steps = {step.effect: step for step in found.steps}
    assert set(steps) == {"temporary_payload", "coulomb_friction", "viscous_friction"}
    step = steps["temporary_payload"]
    assert step.where == (BODY,)
    ((place, values),) = step.parameters.items()
    np.testing.assert_allclose(values["mass"], MASS, rtol=0.03)
    assert "end" not in values
    assert abs(values["start"] - START) < 0.04  # half a period of the filter
    (effect,) = [f.effect for f in found.model.effects if isinstance(f.effect, TemporaryPayload)]
    assert effect.log == log_number(log.name)
    assert place == effect.place == f"{BODY}, {effect.when}"
    assert place in finding(step, Units.of(found.model))
    np.testing.assert_allclose(found.model.phi[:, 0], pendulum.phi[:, 0], rtol=0.05)
    told = json.loads(to_json(numbers_of(found)))
    (told,) = [each for each in told["steps"] if each["effect"] == "temporary_payload"]
    assert told["where"] == [BODY]
    assert place in told["parameters"]
    save_model(found.model, tmp_path / "fitted.yaml")
    again = load_model(tmp_path / "fitted.yaml")
    assert [f.effect for f in again.effects] == [f.effect for f in found.model.effects]
    notes = " ".join(export_model(again).notes)
    assert f"temporary_payload of {place} is not in the files: it belongs to one log" in notes


def test_is_none_of_another_log(picked_up):
    """An episode of one log changes no prediction of another, where it is found anew."""
    first, quiet = picked_up[1].model, a_log(4, np.zeros_like)
    dataset = prepare_case(first, [quiet], candidates=False).dataset
    (effect,) = [f.effect for f in first.effects if isinstance(f.effect, TemporaryPayload)]
    assert not dataset.column_peak[dataset.effect_columns(effect)].any()
    assert explain(first, [quiet]).steps == ()
    late = a_log(5, lambda t: ((t >= 4.2) & (t < 9.0)).astype(float))
    again = explain(first, [dataclasses.replace(late, time=late.time + 1000.0)])
    ((place, values),) = again.steps[0].parameters.items()
    assert [step.effect for step in again.steps] == ["temporary_payload"]
    assert (values["start"], values["end"]) == pytest.approx((4.2, 9.0), abs=0.04)
    (told,) = [note for note in again.notes if "clock" in note]
    assert place in told
    assert "; 1004.2" in told or "; 1004.1" in told


def test_what_one_log_of_two_shows_throughout_is_held_there(pendulum):
    empty, loaded = a_log(7, np.zeros_like), a_log(8, np.ones_like)
    found = explain(pendulum, [empty, loaded])
    steps = {step.effect: step for step in found.steps}
    assert set(steps) == {"temporary_payload", "coulomb_friction", "viscous_friction"}
    ((place, values),) = steps["temporary_payload"].parameters.items()
    np.testing.assert_allclose(values["mass"], MASS, rtol=0.03)
    assert place == f"{BODY}, all of one log"
    assert f"temporary_payload of {BODY} is present throughout {loaded.name}" in found.notes
    assert found.verdict == "explained"


def test_ordinary_logs_show_none(pendulum):
    log = a_log(6, np.zeros_like)
    effects = {step.effect for step in explain(pendulum, [log]).steps}
    assert effects == {"coulomb_friction", "viscous_friction"}
    with pytest.raises(ArgumentError, match="These logs show no temporary_payload"):
        add("temporary_payload", pendulum, [log])


@pytest.mark.parametrize("time", [0.5, 1.5])
def test_in_a_simulation(pendulum, time):
    """From the instant of picking up, the robot moves like one with a heavier link."""
    phi = from_mass_com_inertia(MASS, CENTRE, 1e-4 * np.eye(3))
    fitted = FittedEffect(TemporaryPayload(BODY, start=1.0), phi)
    heavier = dataclasses.replace(pendulum, phi=pendulum.phi + phi * [[0.0], [1.0]])
    expected = heavier if time > 1.0 else pendulum
    moved = [
        acceleration(model, time)
        for model in (dataclasses.replace(pendulum, effects=(fitted,)), expected)
    ]
    np.testing.assert_allclose(*moved, rtol=1e-7)
