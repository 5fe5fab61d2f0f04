"""Payloads that are picked up or put down in a log, found with mass and instant.

Logs are Pinocchio's inverse dynamics of a link that is heavier for a while, with friction on top.
"""

import dataclasses
import json

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from pinocchio_logs import MODELS, effort_log
from pydrake.multibody.tree import default_model_instance
from pydrake.systems.framework import DiagramBuilder

from geodrake import load_model
from geodrake.diagnosis import add, explain
from geodrake.effects import FittedEffect, TemporaryPayload
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import open_case
from geodrake.inertia import from_mass_com_inertia
from geodrake.model import save_model
from geodrake.model.export import export_model
from geodrake.report import Units
from geodrake.report.json_output import to_json
from geodrake.report.views import numbers_of
from geodrake.report.words import finding

MASS, CENTRE = 0.4, np.array([0.02, 0.0, 0.05])
COULOMB, VISCOUS = np.array([0.3, 0.2]), np.array([0.2, 0.15])
BODY = "lower_link"


@pytest.fixture(scope="module")
def pendulum():
    return load_model(MODELS / "double_pendulum.urdf")


def held(weight):
    """Efforts of friction, and of a ball at the last link that weighs in at w(t)."""

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
    """Accelerations of a robot in a diagram at an instant, some state and efforts."""
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
    """A log in which something is picked up, and its explanation."""
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
    """What was found in one log changes no prediction of another, and is found there anew."""
    first, quiet = picked_up[1].model, a_log(4, np.zeros_like)
    dataset = open_case(first, [quiet], candidates=False).dataset
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
    """The robot moves as one with a heavier link does, from when it is picked up."""
    phi = from_mass_com_inertia(MASS, CENTRE, 1e-4 * np.eye(3))
    fitted = FittedEffect(TemporaryPayload(BODY, start=1.0), phi)
    heavier = dataclasses.replace(pendulum, phi=pendulum.phi + phi * [[0.0], [1.0]])
    expected = heavier if time > 1.0 else pendulum
    moved = [
        acceleration(model, time)
        for model in (dataclasses.replace(pendulum, effects=(fitted,)), expected)
    ]
    np.testing.assert_allclose(*moved, rtol=1e-7)
