"""Bodies whose inertia is not that of the model file: which one it is, and what it gains alone."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import explain
from geodrake.diagnosis.steps import _carried

ARM = load_model(MODELS / "arm6.urdf")
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


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("joint", [2, 3])
def test_one_body(joint, seed):
    found = explain(ARM, [effort_log("arm6", seed, lighter(joint, 0.7)).log])
    (step,) = found.steps
    assert (step.effect, step.where) == ("wrong_inertia", (BODIES[joint - 1],))
    values = step.parameters[BODIES[joint - 1]]
    assert values["gain_alone"] > 100.0
    assert values["distance_from_prior"] > 0.1
    assert found.verdict == "explained"


def test_many_bodies():
    found = explain(ARM, [effort_log("arm6", 3, off=0.2).log])
    (step,) = found.steps
    assert step.effect == "wrong_inertia"
    assert len(step.where) > 1
    assert all("gain_alone" in values for values in step.parameters.values())


@pytest.mark.parametrize(
    ("flange", "forearm", "payload"),
    [
        (1.2, 1.0, True),  # heavier at the end
        (1.2, 1.5, True),  # … and elsewhere, where it moved the farthest
        (1.02, 2.0, False),  # … but hardly, next to a body that moved far
        (0.8, 1.5, False),  # lighter
    ],
)
def test_a_heavier_last_body_may_carry_something(flange, forearm, payload):
    phi = ARM.phi.copy()
    phi[BODIES.index("flange")] *= flange
    phi[BODIES.index("forearm")] *= forearm
    rivals = _carried(SimpleNamespace(model=ARM), ["forearm"], phi)
    assert rivals == (("payload",) if payload else ())


def test_a_last_body_that_is_named_may_carry_something():
    assert _carried(SimpleNamespace(model=ARM), ["flange"], ARM.phi) == ("payload",)
