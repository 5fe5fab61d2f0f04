"""What a log's columns are: mistakes in simulated and measured logs, and logs that have none.

Logs come from Pinocchio's inverse dynamics; the mistakes are written out here.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chain_logs import chain_log
from excitation_robots import arm as chain
from measurements import DATA, REFERENCE
from pendulum_logs import PENDULUM, body_effort
from pinocchio_logs import effort_log
from scipy.spatial.transform import Rotation

from diagrams.benchmarks.column_errors import DURATION, WrongLog, make_log
from diagrams.benchmarks.hidden.robots import make_engine, robot_file
from geodrake import load_model
from geodrake.cli.command import unchecked_words
from geodrake.diagnosis import Beliefs, check_columns, corrected
from geodrake.diagnosis.columns import ColumnFinding
from geodrake.diagnosis.columns.assignment import Assignment
from geodrake.diagnosis.columns.evidence import ColumnModel
from geodrake.diagnosis.columns.samples import column_samples
from geodrake.effects import FittedEffect, JointElasticity
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import prepared_as_measured
from geodrake.logs import JointLog, read_log

MODELS = Path(__file__).parents[2] / "models"
JOINTS = ("shoulder", "elbow")


@pytest.fixture(scope="module")
def pendulum():
    return load_model(MODELS / "double_pendulum.urdf")


@pytest.fixture(scope="module")
def right():
    """A log of a double pendulum whose bodies are a tenth off, with dry and viscous friction."""
    log = effort_log("double_pendulum", 3, off=0.1, duration=12.0, share=0.01).log
    v = log.velocity
    rubbing = 0.1 * log.effort.std(0) * (np.tanh(v / 0.01) + 0.3 * v)
    return replace(log, effort=log.effort + rubbing)


def times(log, quantity, joint, factor):
    """A log with a column multiplied."""
    values = getattr(log, quantity).copy()
    values[:, joint] *= factor
    return replace(log, **{quantity: values})


def swap(log, *quantities):
    return replace(log, **{name: getattr(log, name)[:, ::-1] for name in quantities})


def both(log, joint, factor):
    return times(times(log, "position", joint, factor), "velocity", joint, factor)


MISTAKES = {
    "effort_sign": lambda log: times(log, "effort", 1, -1.0),
    "position_sign": lambda log: both(log, 1, -1.0),
    "swapped_efforts": lambda log: swap(log, "effort"),
    "swapped_joints": lambda log: swap(log, "position", "velocity", "effort"),
    "effort_unit": lambda log: times(log, "effort", 0, 1e3),
    "position_unit": lambda log: both(log, 1, 180.0 / np.pi),
    "velocity_factor": lambda log: replace(log, velocity=20.0 * log.velocity),
    "time": lambda log: replace(log, time=0.1 * log.time),
}


def test_nothing_is_found_in_right_columns(pendulum, right):
    assert check_columns(pendulum, [right]) == ()


@pytest.mark.parametrize("kind", MISTAKES)
def test_mistakes_are_named_and_corrected(pendulum, right, kind):
    wrong = MISTAKES[kind](right)
    (found,) = check_columns(pendulum, [wrong])
    assert found.kind == kind
    assert found.probability > 0.5
    assert found.gain > 0.0
    after = corrected(wrong, [found])
    for name in ("time", "position", "velocity", "effort"):
        scale = np.abs(getattr(right, name)).max(axis=0)
        off = {"time": 1e-3, "velocity_factor": 1e-3}.get(kind, 1e-9)
        np.testing.assert_allclose(
            getattr(after, name) / scale, getattr(right, name) / scale, atol=off
        )


def test_magnitudes_of_efforts_are_said_to_be_magnitudes(pendulum, right):
    (found,) = check_columns(pendulum, [replace(right, effort=np.abs(right.effort))])
    assert (found.kind, found.joints) == ("effort_magnitude", JOINTS)
    assert not found.is_correctable
    assert "never change sign" in str(found)


def test_efforts_without_the_motion_in_them_are_no_mistake_of_a_kind(pendulum, right):
    """A passive joint's sensor noise, and efforts of some other motion."""
    rng = np.random.default_rng(4)
    noise = right.effort.copy()
    noise[:, 1] = 0.02 * rng.normal(size=len(noise))
    for effort in (noise, right.effort[::-1]):
        for found in check_columns(pendulum, [replace(right, effort=effort)]):
            assert found.probability < 0.9


def test_dry_friction_alone_is_no_limit_of_a_motor(pendulum, right):
    """Efforts that are about the same all the time look cut off."""
    rng, v = np.random.default_rng(1), right.velocity
    own = 0.02 * rng.normal(size=v.shape) + 0.3 * np.tanh(v / 0.005)
    effort = np.column_stack([right.effort[:, 0], own[:, 1]])
    kinds = [found.kind for found in check_columns(pendulum, [replace(right, effort=effort)])]
    assert "effort_limit" not in kinds


@pytest.mark.parametrize("velocity", ["in degrees", "in radians", "none"])
def test_degrees_at_all_joints_are_one_mistake(pendulum, right, velocity):
    factor = 180.0 / np.pi
    rates = {"in degrees": factor * right.velocity, "in radians": right.velocity, "none": None}
    wrong = replace(right, position=factor * right.position, velocity=rates[velocity])
    (found,) = check_columns(pendulum, [wrong])
    alone = "_alone" * (velocity == "in radians")
    assert (found.kind, found.joints) == (f"position{alone}_unit", JOINTS)
    assert "of all joints" in str(found)
    after = corrected(wrong, [found])
    np.testing.assert_allclose(after.position, right.position, rtol=1e-12)
    if velocity != "none":
        np.testing.assert_allclose(after.velocity, right.velocity, rtol=1e-12)


def test_another_zero_is_found_within_the_arm():
    """At the last joint, and that of a pendulum is, it is a body that has turned: a payload."""
    model, log, (secret,) = make_log(
        WrongLog("another zero", "arm6", "pinocchio", "fast", 6, 9, DURATION)
    )
    (found,) = check_columns(model, [log])
    assert (found.kind, found.joints) == ("position_zero", (model.joints[secret.joints[0]],))
    assert found.values[0] == pytest.approx(secret.value, abs=0.05)


@pytest.mark.parametrize(
    "drawn",
    [
        # Leaning by up to 0.3 rad, of bodies a fifth off: zeros and gains of wrists would make up.
        WrongLog("tilted base", "arm6", "mujoco", "fast", 6, 9, DURATION),
        # Of bodies 60 % off, one number for all efforts makes up for the total mass.
        WrongLog("bodies that differ", "arm6", "pinocchio", "slow", 1, 61, DURATION),
    ],
    ids=lambda drawn: drawn.mistake,
)
def test_what_is_not_of_the_columns_is_no_mistake_in_them(drawn):
    model, log, _ = make_log(drawn)
    assert check_columns(model, [log]) == ()


def test_a_gain_is_told_where_its_fit_has_converged(gain=0.29):
    """Its value is that of the answer, and no other gains are told beside it."""
    drawn = WrongLog("gain of a joint", "panda", "pinocchio", "point to point", 14, 9, DURATION)
    model, log, (secret,) = make_log(drawn)
    (j,) = secret.joints
    log = times(log, "effort", j, secret.value / gain)
    (found,) = check_columns(model, [log])
    assert (found.kind, found.joints) == ("effort_gain", (model.joints[j],))
    assert found.values[0] == pytest.approx(gain, rel=0.1)


def test_designs_of_a_leaning_base_are_efforts_under_its_gravity(pendulum, right):
    """Those of an engine whose gravity is turned the other way."""
    samples = column_samples(pendulum, *prepared_as_measured(pendulum, [right]))
    model, named = ColumnModel(samples, Beliefs()), Assignment.as_named(2)
    turned = np.zeros((2, len(model.mean)))
    turned[:, model.tilt] = [0.1, -0.2], [0.0, 0.05]
    leaning = model.moved(model.moved(named, turned[0]), turned[1])
    twice = Rotation.from_rotvec([0.0, -0.05, 0.0]) * Rotation.from_rotvec([-0.1, 0.2, 0.0])
    engine = make_engine("pinocchio", robot_file("double_pendulum"))
    for assignment, gravity in ((named, [0, 0, -9.81]), (leaning, twice.apply([0, 0, -9.81]))):
        engine.set_gravity(np.array(gravity))
        efforts, phi = engine.efforts(*samples.motion(assignment)), pendulum.phi.ravel()
        for j, design in enumerate(model.designs(assignment)):
            own = design.columns < phi.size
            found = design.X[:, : len(own)][:, own] @ phi[design.columns[own]]
            np.testing.assert_allclose(found, efforts[design.rows, j], atol=1e-9)


def test_two_mistakes_are_found_one_after_the_other(pendulum, right):
    wrong = replace(times(right, "effort", 0, 1e3), velocity=-right.velocity)
    found = check_columns(pendulum, [wrong])
    assert {each.kind for each in found} == {"effort_unit", "velocity_factor"}
    after = corrected(wrong, found)
    np.testing.assert_allclose(after.effort, right.effort)
    np.testing.assert_allclose(after.velocity, right.velocity, rtol=0.01)


class TestCorrected:
    FOUND = ColumnFinding(
        "position_sign", ("elbow",), (-1.0,), 50.0, 1.0, (), 1.0, 0.1, "The …", "Correct it."
    )

    def test_commands_go_with_positions(self, right):
        log = replace(right, command=right.position + 0.1)
        after = corrected(log, [self.FOUND])
        np.testing.assert_array_equal(after.command[:, 1], -log.command[:, 1])
        np.testing.assert_array_equal(after.command[:, 0], log.command[:, 0])
        np.testing.assert_array_equal(after.velocity[:, 1], -log.velocity[:, 1])
        np.testing.assert_array_equal(after.effort, log.effort)
        assert log.position is right.position  # not written to

    def test_what_was_taken_out_stays_so(self, right):
        found = replace(self.FOUND, kind="without_gravity", joints=("shoulder", "elbow"), values=())
        assert corrected(right, [found]) is right
        assert not found.is_correctable

    def test_unknown_joints_are_refused(self, right):
        with pytest.raises(ArgumentError, match="no joint 'wrist'"):
            corrected(right, [replace(self.FOUND, joints=("wrist",))])


@pytest.fixture(scope="module")
def arm():
    model = load_model(REFERENCE / "ur10e.urdf")
    return model, read_log(DATA / "ur10e_free_c.csv", joints=model.known_joints, partial=True)


@pytest.mark.measurements("data/ur10e_free_c.csv", "reference/ur10e.urdf")
class TestMeasured:
    def test_nothing_is_found_in_right_columns(self, arm):
        model, log = arm
        assert check_columns(model, [log]) == ()

    def test_swapped_efforts_are_not_taken_for_friction(self, arm):
        model, log = arm
        order = [0, 2, 1, 3, 4, 5]
        (found,) = check_columns(model, [replace(log, effort=log.effort[:, order])])
        assert (found.kind, found.joints) == ("swapped_efforts", model.joints[1:3])
        assert found.probability > 0.99
        # Bodies give way to columns that are swapped, so what is compared is less than plain nrms.
        assert found.error_after**2 < 0.1 * found.error_before**2


@pytest.mark.parametrize(("joints", "kinds"), [(4, ["effort_sign"]), (31, [])])
def test_robots_of_many_joints_are_not_checked(joints, kinds):
    """What may be wrong with them is too much to weigh: that is said, and left to the fit."""
    model = chain(1, joints="R" * joints)
    log = times(chain_log(model, 1, seconds=8.0, rate=50.0), "effort", 3, -1.0)
    assert [finding.kind for finding in check_columns(model, [log])] == kinds
    assert bool(unchecked_words(model)) == (not kinds)


def test_one_log_a_joint_makes_no_mistake_likely():
    """The usual protocol for friction: others rest, under efforts that dry friction holds."""
    rng, time = np.random.default_rng(0), np.arange(0.0, 25.0, 0.005)
    phase = 2.0 * np.pi * rng.uniform(0.1, 0.4, 3)[:, None] * time + rng.uniform(0.0, 6.0, (3, 1))
    rates = np.gradient(phase, time, axis=1)
    size = np.array([0.5, 0.3, 0.1])[:, None]
    logs = []
    for moving in (0, 1):
        q = np.tile([0.3, -0.6], (len(time), 1))
        v, vd = np.zeros_like(q), np.zeros_like(q)
        q[:, moving] += (size * np.sin(phase)).sum(axis=0)
        v[:, moving] = (size * rates * np.cos(phase)).sum(axis=0)
        vd[:, moving] = -(size * rates**2 * np.sin(phase)).sum(axis=0)
        effort = body_effort(q, v, vd) + rng.normal(0.0, 0.01, q.shape)
        effort[:, moving] += 0.4 * np.tanh(v[:, moving] / 1e-3) + 0.2 * v[:, moving]
        effort[:, 1 - moving] += rng.uniform(-0.3, 0.3)
        q += rng.normal(0.0, 1e-5, q.shape)
        logs.append(JointLog(f"joint {moving}", JOINTS, time, q, effort))
    assert check_columns(load_model(PENDULUM), logs) == ()


def test_columns_of_a_robot_with_soft_joints_are_checked():
    """What links give way by follows from samples in time, of which columns have none."""
    rng, time = np.random.default_rng(0), np.arange(0.0, 20.0, 0.005)
    q = np.sin(np.outer(time, [1.9, 3.1]))
    v, vd = [1.9, 3.1] * np.cos(np.outer(time, [1.9, 3.1])), -np.square([1.9, 3.1]) * q
    effort = body_effort(q, v, vd) + rng.normal(0.0, 0.01, q.shape)
    model = load_model(PENDULUM)
    soft = FittedEffect(JointElasticity("elbow"), np.array([1e-4]))
    model = replace(model, effects=(*model.effects, soft))
    log = JointLog("log", JOINTS, time, q, -effort * [1.0, -1.0])
    (found,) = check_columns(model, [log])
    assert (found.kind, found.joints) == ("effort_sign", ("shoulder",))
