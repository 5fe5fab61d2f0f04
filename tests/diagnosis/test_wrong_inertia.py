"""Bodies whose inertia is not that of the model file: which one it is, and what it gains alone."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from effort_logs import MODELS, effort_log
from pendulum_logs import pendulum_log

from geodrake import load_model
from geodrake.diagnosis import explain

ARM = load_model(MODELS / "arm6.urdf")
PENDULUM = load_model(MODELS / "double_pendulum.urdf")
LOG_OF_PENDULUM = pendulum_log(1, seconds=20.0)
BODIES = ("column", "upper_arm", "forearm", "wrist_barrel", "wrist", "flange")


def lighter(joint, factor):
    """Effort that a robot saves with one body of a share of its mass and inertia."""

    def hidden(seen):
        other = pin.Model(seen.model)
        body = other.inertias[joint]
        other.inertias[joint] = pin.Inertia(
            factor * body.mass, body.lever, factor * np.array(body.inertia)
        )
        data = other.createData()
        samples = zip(seen.q, seen.v, seen.a, strict=True)
        return np.array([pin.rnea(other, data, *sample) for sample in samples]) - seen.load

    return hidden


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("joint", [pytest.param(2, marks=pytest.mark.thorough), 3])
def test_one_body(joint, seed):
    found = explain(ARM, [effort_log("arm6", seed, lighter(joint, 0.7)).log])
    (step,) = found.steps
    assert (step.effect, step.where) == ("wrong_inertia", (BODIES[joint - 1],))
    values = step.parameters[BODIES[joint - 1]]
    assert values["distance_from_prior"] > 0.1
    assert found.verdict == "explained"


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("upper", "lower", "body", "may_carry"),
    [
        (1.5, 1.2, "upper_link", False),  # heavier at the end, but a payload leaves the other one
        (0.5, 1.05, "upper_link", False),  # … but hardly, next to a body that moved far
        (1.5, 0.8, "upper_link", False),  # lighter
        (1.0, 0.8, "lower_link", True),  # what is at the end is named
    ],
)
def test_a_heavier_last_body_may_carry_something(upper, lower, body, may_carry):
    """Links that weigh so many times as much as in the model."""
    wrong = replace(PENDULUM, phi=PENDULUM.phi / [[upper], [lower]])
    (step,) = explain(wrong, [LOG_OF_PENDULUM], bandwidth=6.0).steps
    assert (step.effect, step.where) == ("wrong_inertia", (body,))
    assert set(step.indistinguishable_from) <= ({"payload"} if may_carry else set())
