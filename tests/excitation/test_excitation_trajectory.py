"""Families of motions: derivatives, ends, and the forms that others take them in."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from excitation_robots import arm

from geodrake.errors import ArgumentError
from geodrake.excitation import (
    ExcitationTrajectory,
    FourierMotion,
    FreeSamples,
    SplineMotion,
    motion_limits,
    read_drake_trajectory,
    write_trajectory,
)
from geodrake.excitation.regressor_gradient import inverse_dynamics_regressor_gradient
from geodrake.excitation.trajectory import ros_joint_trajectory
from geodrake.logs import read_log
from geodrake.model import load_description
from geodrake.robot import inverse_dynamics

TIMED = [
    FourierMotion(),
    FourierMotion(10.0, 3, 0.3 * np.pi, offset=False),
    SplineMotion(),
    SplineMotion(3.0, 9, 3),
]


def trajectory_of(family, model, seed=0):
    coefficients = np.random.default_rng(seed).normal(size=(family.count, len(model.joints)))
    return ExcitationTrajectory(family, coefficients, model.joints)


@pytest.mark.parametrize("family", TIMED, ids=repr)
class TestTimed:
    def test_derivatives(self, family):
        times, h = np.linspace(0.1, family.length - 0.1, 30), 1e-5
        before, here, after = (family.basis(times + d) for d in (-h, 0.0, h))
        scale = np.abs(here[1:]).max((1, 2), keepdims=True)
        slopes = (after - before)[:2] / (2 * h)
        np.testing.assert_allclose(slopes / scale, here[1:] / scale, atol=1e-7)
        assert here.shape == (3, 30, family.count)

    def test_rest_at_both_ends(self, family):
        E = family.conditions(rest=True, start=True)
        assert np.linalg.matrix_rank(E) == len(E)
        c = np.random.default_rng(1).normal(size=family.count)
        c -= np.linalg.pinv(E) @ (E @ c)
        ends = family.basis([0.0, family.length]) @ c
        np.testing.assert_allclose(ends[1:], 0.0, atol=1e-9)
        assert ends[0, 0] == pytest.approx(0.0, abs=1e-9)
        assert np.abs(family.basis(family.times(20)) @ c).max() > 0.01

    def test_limits_hold_between_their_instants(self, family):
        """The greatest value of any motion is hardly greater than that at the instants."""
        coarse, fine = family.limit_times(), np.linspace(0.0, family.length, 4001)
        assert coarse[0] == 0.0 and coarse[-1] == family.length
        for seed in range(5):
            c = np.random.default_rng(seed).normal(size=(family.count, 4))
            found, peak = (np.abs(family.basis(t) @ c).max(1) for t in (coarse, fine))
            assert (peak <= 1.02 * found).all()

    def test_drake_trajectory_in_a_file(self, family, tmp_path):
        model, path = arm(joints="RPR"), tmp_path / "motion.drake.yaml"
        trajectory = trajectory_of(family, model)
        write_trajectory(trajectory, path, model)
        drake = read_drake_trajectory(path)
        fields = yaml.safe_load(path.read_text())
        assert fields.keys() == {"basis", "control_points"}
        assert fields["basis"].keys() == {"order", "knots"}
        times = np.linspace(0.0, family.length, 77)
        q, v, vd = trajectory.states(times)
        for order, expected in enumerate((q, v, vd)):
            found = np.array([drake.EvalDerivative(t, order).ravel() for t in times])
            scale = np.abs(expected).max()
            np.testing.assert_allclose(found, expected, atol=(1e-9, 1e-7, 1e-5)[order] * scale)

    def test_log_reads_back(self, family, tmp_path):
        model = arm(joints="RPR")
        trajectory = trajectory_of(family, model)
        write_trajectory(trajectory, tmp_path / "motion.csv", model, rate=50.0)
        log = read_log(tmp_path / "motion.csv")
        assert log.joints == model.joints
        assert log.time[-1] == family.length
        q, v, vd = trajectory.states(log.time)
        np.testing.assert_allclose(log.position, q)
        np.testing.assert_allclose(log.velocity, v)
        np.testing.assert_allclose(log.acceleration, vd)
        expected = inverse_dynamics(model.plant, q, v, vd, model.phi)
        np.testing.assert_allclose(log.effort, expected, atol=1e-9)


def test_free_samples():
    family, model = FreeSamples(4), arm()
    trajectory = trajectory_of(family, model)
    assert family.count == 12 and family.conditions(rest=True, start=True).shape == (0, 12)
    np.testing.assert_array_equal(
        trajectory.states(family.times(9))[1], trajectory.coefficients[4:8]
    )
    assert trajectory.motion(family.times(9)).time is None
    for form in (trajectory.to_drake, lambda: trajectory.log(model)):
        with pytest.raises(ArgumentError, match="are not ordered in time"):
            form()


@pytest.mark.parametrize("family", [*TIMED, FreeSamples(7)], ids=repr)
def test_gradient_by_coefficients(family):
    model, rng = arm(joints="RRP"), np.random.default_rng(2)
    trajectory, times = trajectory_of(family, model), family.times(7)
    weights, direction = rng.normal(size=(7, 3, 30)), rng.normal(size=(family.count, 3))

    def value(h):
        moved = replace(trajectory, coefficients=trajectory.coefficients + h * direction)
        motion = moved.motion(times)
        return (
            weights
            @ model.phi.ravel()
            * inverse_dynamics(model.plant, motion.q, motion.v, motion.vd, model.phi)
        ).sum()

    motion = trajectory.motion(times)
    rows = (weights @ model.phi.ravel())[:, :, None] * model.phi.ravel()
    gradient = inverse_dynamics_regressor_gradient(model.tree, motion.q, motion.v, motion.vd, rows)
    slope = (trajectory.coefficient_gradient(family.basis(times), gradient) * direction).sum()
    assert slope == pytest.approx((value(1e-6) - value(-1e-6)) / 2e-6, rel=1e-6)


def test_ros_trajectory(tmp_path):
    model = arm()
    trajectory = trajectory_of(FourierMotion(2.5), model)
    write_trajectory(trajectory, tmp_path / "motion.yaml", model, rate=20.0)
    text = (tmp_path / "motion.yaml").read_text()
    assert text == ros_joint_trajectory(trajectory, rate=20.0)
    message = yaml.safe_load(text)
    assert set(message) == {"header", "joint_names", "points"}
    assert message["joint_names"] == ["joint_0", "joint_1", "joint_2"]
    assert len(message["points"]) == 51
    stamps = [p["time_from_start"] for p in message["points"]]
    times = np.array([s["sec"] + 1e-9 * s["nanosec"] for s in stamps])
    np.testing.assert_allclose(times, np.linspace(0.0, 2.5, 51), atol=1e-9)
    for name, expected in zip(
        ("positions", "velocities", "accelerations"), trajectory.states(times), strict=True
    ):
        np.testing.assert_allclose([p[name] for p in message["points"]], expected, atol=1e-8)


def test_files_that_hold_no_drake_trajectory(tmp_path):
    (tmp_path / "ros.drake.yaml").write_text("points: []\n")
    for name in ("ros.drake.yaml", "missing.drake.yaml"):
        with pytest.raises(ArgumentError, match=name):
            read_drake_trajectory(tmp_path / name)


def test_rates():
    trajectory = trajectory_of(FourierMotion(1.05), arm())
    np.testing.assert_allclose(trajectory.instants(10.0), [*np.arange(11) / 10, 1.05])
    assert len(trajectory.instants(100.0)) == 106
    with pytest.raises(ArgumentError, match="A rate must be a positive"):
        trajectory.instants(0.0)


def test_balls_have_no_order(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j" type="ball"/>'
        '<geom size=".1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ArgumentError, match="several degrees"):
        motion_limits(load_description(path))
