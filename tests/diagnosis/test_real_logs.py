"""Explanations of measurements of real robots, which are public but not in the package."""

import time
from pathlib import Path

import pytest
from measurements import DATA, REFERENCE

from geodrake import load_model
from geodrake.diagnosis import compare, explain
from geodrake.inertia import is_physical
from geodrake.model import save_model

MODELS = Path(__file__).parents[2] / "models"

pytestmark = pytest.mark.measurements(
    "data/ur10e_*.csv", "data/double_pendulum_c1_*.csv", "reference/ur10e.urdf"
)


def places(explanation):
    """Return the places where each effect was added."""
    return {step.effect: step.where for step in explanation.steps}


@pytest.fixture(scope="session")
def ur10e_free():
    """Return the explanation of the UR10e's two motions without payload, and its time."""
    start = time.process_time()
    model = load_model(REFERENCE / "ur10e.urdf")
    found = explain(model, [DATA / "ur10e_free_a.csv", DATA / "ur10e_free_b.csv"])
    return found, time.process_time() - start


@pytest.fixture(scope="session")
def ur10e_saved(ur10e_free, tmp_path_factory):
    """Return the model fitted to these motions, saved and read back."""
    path = tmp_path_factory.mktemp("ur10e") / "ur10e.yaml"
    save_model(ur10e_free[0].model, path)
    return load_model(path)


@pytest.fixture(scope="session")
def ur10e_changed(ur10e_saved):
    return explain(ur10e_saved, [DATA / "ur10e_changed.csv"])


@pytest.fixture(scope="session")
def pendulum():
    logs = sorted(DATA.glob("double_pendulum_c1_*.csv"))
    return explain(load_model(MODELS / "double_pendulum.urdf"), logs)


def test_ur10e_has_dry_and_viscous_friction(ur10e_free):
    found, _ = ur10e_free
    assert 0.78 < found.start.nrms < 0.9
    assert found.end.nrms <= 0.037
    joints = found.model.joints
    assert set(places(found)["coulomb_friction"]) == set(joints)
    # Two may not grow as the speed does: three logs that took no part bear them out.
    where = places(found)
    power = set(where.get("nonlinear_viscous_friction", ())) - set(where["viscous_friction"])
    assert power <= {"shoulder_pan_joint", "wrist_2_joint"}
    assert set(where["viscous_friction"]) | power == set(joints)
    assert found.steps[0].effect in ("coulomb_friction", "viscous_friction")


def test_ur10e_has_no_drag(ur10e_free):
    # The slopes of a drag of nothing, which have no sign, once stood for friction that drove.
    assert "aerodynamic_drag" not in places(ur10e_free[0])


def test_ur10e_is_quick(ur10e_free):
    assert ur10e_free[1] < 30.0


def test_ur10e_saved_model_holds_on_another_kind_of_motion(ur10e_free, ur10e_saved):
    """Friction from excitation motions explains most of the error of point-to-point motion."""
    log = [DATA / "ur10e_ptp.csv"]
    unfitted = compare(load_model(REFERENCE / "ur10e.urdf"), log).errors
    known = compare(ur10e_saved, log).errors.nrms
    assert known <= 0.056
    assert known < 0.1 * unfitted.nrms


def test_ur10e_carries_a_payload_after_the_change(ur10e_changed):
    found = ur10e_changed
    first = found.steps[0]
    assert (first.effect, first.where) == ("payload", ("wrist_3_link",))
    assert found.start.nrms > 0.4
    assert found.end.nrms <= 0.05
    mass, deviation = (
        values["wrist_3_link"]["mass"] for values in (first.parameters, first.deviations)
    )
    assert mass == pytest.approx(3.1, abs=0.2)
    assert 0.0 < deviation < 0.3


def test_pendulum_has_dry_friction_at_both_joints(pendulum):
    step = next(step for step in pendulum.steps if step.effect == "coulomb_friction")
    assert set(step.where) == {"shoulder", "elbow"}
    assert step.parameters["shoulder"]["coulomb"] == pytest.approx(0.16, rel=0.25)
    assert step.parameters["elbow"]["coulomb"] == pytest.approx(0.12, rel=0.25)


@pytest.mark.parametrize("robot", ["ur10e_free", "pendulum"])
def test_fitted_models_are_physical(robot, request):
    found = request.getfixturevalue(robot)
    model = (found[0] if robot == "ur10e_free" else found).model
    assert is_physical(model.total_phi).all()
    for fitted in model.effects:
        for parameter, value in zip(fitted.effect.parameters, fitted.parameters, strict=True):
            assert parameter.lower - 1e-9 <= value <= parameter.upper + 1e-9
