"""Designed motions: limits, starts, time, and trajectories in files."""

from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
import pytest
import yaml
from chain_logs import inverse_dynamics
from excitation_robots import MODELS, arm, assert_jacobian
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform

from geodrake.boundary.interrupts import StopSearch
from geodrake.effects import CoulombFriction, FittedEffect, ViscousFriction
from geodrake.errors import ArgumentError
from geodrake.excitation import (
    CollisionWorld,
    DesignOptions,
    ExcitationTrajectory,
    FourierMotion,
    FreeSamples,
    MotionLimits,
    Objective,
    Solid,
    SplineMotion,
    design_excitation,
    make_target,
    motion_limits,
    read_drake_trajectory,
    write_trajectory,
)
from geodrake.excitation.problem import make_problem
from geodrake.excitation.trajectory import ros_joint_trajectory
from geodrake.model import EffortSignal, load_description

FAST = DesignOptions(samples=60, iterations=40, sharpness=(8.0,))
SHORT = FourierMotion(4.0, 2)

PLANAR = """<robot name="planar">
  <link name="base"/>
  {links}
</robot>"""
LINK = """<link name="link_{i}">
    <inertial><origin xyz="0.25 0.02 0"/><mass value="2"/>
      <inertia ixx="0.02" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.25 0 0" rpy="0 1.5707963 0"/>
      <geometry><cylinder radius="0.03" length="0.4"/></geometry></collision>
  </link>
  <joint name="joint_{i}" type="revolute">
    <parent link="{parent}"/><child link="link_{i}"/>
    <origin xyz="{offset} 0 0"/><axis xyz="0 {y} {z}"/>
    <limit lower="-2.5" upper="2.5" effort="{effort}" velocity="2"/>
  </joint>"""


def planar(tmp_path, *, effort=60.0, count=2):
    """Return a chain of links with collision geometry, which turn about z, then about y."""
    links = "".join(
        LINK.format(
            i=i,
            parent="base" if i == 0 else f"link_{i - 1}",
            offset=0.5 if i else 0.0,
            y=i % 2,
            z=1 - i % 2,
            effort=effort,
        )
        for i in range(count)
    )
    path = Path(tmp_path) / "planar.urdf"
    path.write_text(PLANAR.format(links=links))
    return load_description(path)


def limits_of(model, **changes):
    nv = len(model.joints)
    values = {
        "lower": np.full(nv, -2.0),
        "upper": np.full(nv, 2.0),
        "velocity": np.full(nv, 2.0),
        "acceleration": np.full(nv, 8.0),
        "effort": np.full(nv, np.inf),
    }
    return MotionLimits(model.joints, **(values | changes))


def problem_of(model, limits, family=SHORT, **options):
    chosen = replace(FAST, **options)
    return make_problem(Objective(make_target(model, noise=0.1)), limits, family, chosen)


def assert_limits_are_kept(result, model):
    """Check the limits on a fine grid, independently of the design."""
    limits, trajectory = result.limits, result.trajectory
    times = np.linspace(0.0, trajectory.family.length, 2003)
    q, v, vd = trajectory.states(times)
    slack = 1e-5
    assert (q <= limits.upper + slack).all() and (q >= limits.lower - slack).all()
    assert (np.abs(v) <= limits.velocity * (1 + slack)).all()
    assert (np.abs(vd) <= limits.acceleration * (1 + slack)).all()
    effort = inverse_dynamics(model.plant, q[::10], v[::10], vd[::10], model.create_context())
    assert (np.abs(effort) <= limits.effort * (1 + slack)).all()
    assert result.use.is_within


class TestProgram:
    @pytest.mark.parametrize(
        ("family", "start"),
        [(SHORT, None), (SplineMotion(3.0, 9), [0.5, -0.3, 0.2]), (FreeSamples(8), None)],
        ids=repr,
    )
    def test_gradients(self, family, start):
        friction = [
            FittedEffect(CoulombFriction("joint_1"), np.array([2.0])),
            FittedEffect(ViscousFriction("joint_2"), np.array([1.0])),
        ]
        model = arm(effects=friction)
        problem = problem_of(model, limits_of(model, effort=np.full(3, 50.0)), family, start=start)
        y = np.random.default_rng(0).uniform(-0.5, 0.5, problem.scale.size)
        for function in (problem.cost, problem.efforts):
            assert_jacobian(function, y)

    def test_gradients_of_collisions(self, tmp_path):
        model = planar(tmp_path)
        world = CollisionWorld(
            model, obstacles=[Solid("ball", Sphere(0.2), RigidTransform([0.75, 0.3, 0.0]))]
        )
        problem = problem_of(model, limits_of(model), collisions=world)
        y = np.random.default_rng(1).uniform(-0.3, 0.3, problem.scale.size)
        assert assert_jacobian(problem.nearness, y, rtol=1e-5).max() > 1.0  # some are too near


class TestDesigns:
    @pytest.mark.parametrize(
        ("family", "solver"), [(SHORT, "ipopt"), (SplineMotion(4.0, 9), "snopt")], ids=repr
    )
    def test_within_limits_and_better_than_random(self, family, solver):
        model = arm()
        effort = np.array([60.0, 35.0, 12.0])
        result = design_excitation(
            make_target(model, noise=0.1),
            limits_of(model, effort=effort),
            trajectory=family,
            options=replace(FAST, solver=solver),
            seeds=2,
        )
        assert_limits_are_kept(result, model)
        ends = result.trajectory.states([0.0, family.length])
        np.testing.assert_allclose(ends[1:], 0.0, atol=1e-8)
        for outcome in result.outcomes:
            assert outcome.value < 0.3 * outcome.random_value
            assert outcome.evaluations > 10
        assert result.value == min(outcome.value for outcome in result.outcomes)
        assert result.value == pytest.approx(1.0 / result.eigenvalues[0])
        assert len(result.motion) == result.samples == 60
        assert result.use.velocity.max() > 0.9

    def test_solvers_agree_on_what_is_an_optimum(self):
        model = arm(joints="RR")
        options = replace(FAST, iterations=200, quick=False)
        asked = {"criterion": "d_optimality", "trajectory": SHORT}
        target, limits = make_target(model), limits_of(model)
        found = design_excitation(target, limits, options=options, seeds=3, **asked)
        guess = 0.8 * found.trajectory.coefficients
        options = replace(options, solver="ipopt", guess=guess)
        again = design_excitation(target, limits, options=options, seeds=1, **asked)
        back = again.outcomes[-1]  # from a smaller motion to SNOPT's optimum, or to a better one
        assert back.value - found.value < 0.02 * (back.random_value - found.value)

    @pytest.mark.parametrize("begun", [1, 2])
    def test_a_stopped_design_is_the_best_motion_so_far(self, begun):
        model, told = arm(joints="RR"), []

        def stop(progress):
            told.append(progress)
            if progress.seed == begun - 1 and progress.evaluations >= 8 and not progress.is_stopped:
                try:
                    raise StopSearch
                except StopSearch as error:
                    if begun == 2:  # as compilers do
                        raise RuntimeError("cannot compile") from error
                    raise

        result = design_excitation(
            model, limits_of(model), trajectory=SHORT, options=FAST, seeds=3, progress=stop
        )
        assert result.is_interrupted and told[-1].is_stopped
        interrupted = [o.status == "interrupted" for o in result.outcomes]
        assert interrupted == [False] * (begun - 1) + [True]
        assert result.value <= min(o.random_value for o in result.outcomes)
        assert result.notes[0].startswith("the search was interrupted")
        assert f"{3 - begun} initial motions were not tried, as it was interrupted" in result.notes
        assert_limits_are_kept(result, model)


class TestCollisions:
    def test_obstacles_are_avoided(self, tmp_path):
        model = planar(tmp_path)
        ball = Solid("ball", Sphere(0.15), RigidTransform([0.3, 0.8, 0.0]))
        world = CollisionWorld(model, obstacles=[ball], clearance=0.02)
        limits = limits_of(model, acceleration=np.full(2, 4.0))
        settings = {"trajectory": SHORT, "seeds": 1}
        free = design_excitation(model, limits, options=FAST, **settings)
        kept = design_excitation(model, limits, options=replace(FAST, collisions=world), **settings)
        times = np.linspace(0.0, 4.0, 400)
        assert world.distances(free.trajectory.motion(times).q)[0].min() < 0.0
        assert world.distances(kept.trajectory.motion(times).q)[0].min() > 0.0195
        assert kept.use.is_within and kept.use.distance >= 0.02 - 1e-6
        assert kept.value >= 0.99 * free.value

    def test_start_in_collision_and_no_way_out(self, tmp_path):
        model = planar(tmp_path)
        ball = Solid("ball", Sphere(0.15), RigidTransform([0.7, 0.0, 0.0]))
        cage = Solid("cage", Sphere(3.0), RigidTransform())
        for obstacle, start, message in (
            (ball, [0.0, 0.0], r"start is in collision: .*ball"),
            (cage, None, r"collides in all of \d+ postures.*cage"),
        ):
            world = CollisionWorld(model, obstacles=[obstacle])
            options = replace(FAST, collisions=world, start=start)
            with pytest.raises(ArgumentError, match=message):
                design_excitation(model, limits_of(model), trajectory=SHORT, options=options)


class TestBadInput:
    def test_infinite_limits(self):
        model, known = arm(joints="RPR"), {"joint_1": (-1, 1)}
        with pytest.raises(ArgumentError, match=r"velocity of joint 'joint_0' is unlimited"):
            motion_limits(model, position=known)
        with pytest.raises(ArgumentError, match=r"position of joint 'joint_1' is not limited"):
            motion_limits(model, velocity=1.0)
        limits = motion_limits(model, position=known, velocity=1.0)
        np.testing.assert_allclose(limits.upper, [np.pi, 1.0, np.pi])
        assert np.isinf(limits.acceleration).all()
        with pytest.raises(ArgumentError, match=r"acceleration of joint 'joint_0'.*free samples"):
            design_excitation(model, limits, trajectory=FreeSamples(20))

    def test_a_motion_keeps_jerks_and_ramps_too(self):
        model = arm()
        limits = limits_of(model, jerk=np.full(3, 10.0))
        result = design_excitation(
            model, limits, trajectory=SHORT, options=replace(FAST, stand=[0.1, 0.2, 0.3]), seeds=1
        )
        times = np.linspace(0.0, 4.0, 4001)
        jerk = np.gradient(result.trajectory.states(times)[2], times, axis=0)
        assert np.abs(jerk).max() <= 10.0 * (1 + 1e-3)
        assert result.use.peaks["jerk"].max() == pytest.approx(np.abs(jerk).max(), rel=1e-2)
        q = result.executed.states([0.0, result.executed.length])[0]
        np.testing.assert_allclose(q, [[0.1, 0.2, 0.3]] * 2)
        path = result.executed.to_drake()
        for time in np.linspace(0.0, result.executed.length, 57):
            state = result.executed.states([time])
            np.testing.assert_allclose(path.value(time)[:, 0], state[0, 0], atol=1e-4)

    def test_limits_of_a_file(self):
        model = load_description(MODELS / "arm7.urdf")
        limits = motion_limits(model, velocity={"joint_2": 0.5}, acceleration=[4.0] * 7)
        assert limits.velocity.tolist() == [1.6, 0.5, 1.9, 1.9, 2.2, 3.0, 3.0]
        assert limits.upper.tolist() == [2.9, 2.0, 2.9, 2.0, 2.9, 2.0, 3.0]
        assert limits.effort.tolist() == [320, 320, 180, 180, 110, 45, 45]
        half = limits.scaled(0.5)
        np.testing.assert_allclose(half.upper, 0.5 * limits.upper)
        np.testing.assert_allclose(half.effort, 0.5 * limits.effort)
        weak = EffortSignal(model.joints[1], "effort", 1.0, limit=90.0)
        told = motion_limits(replace(model, effort_signals=(weak,)))
        assert told.effort.tolist() == [320, 90, 180, 180, 110, 45, 45]
        for given, message in (
            ({"effort": {"elbow": 1.0}}, r"joint must be .*'elbow'"),
            ({"velocity": [1.0, 2.0]}, r"shape \(2,\)"),
            ({"position": {"joint_1": 2.0}}, r"must be \(2,\)"),
        ):
            with pytest.raises(ArgumentError, match=message):
                motion_limits(model, **given)
        with pytest.raises(ArgumentError, match="share"):
            limits.scaled(0.0)

    def test_gravity_stronger_than_the_robot(self, tmp_path):
        model, narrow = planar(tmp_path), {"lower": np.full(2, -0.5), "upper": np.full(2, 0.5)}
        for room, start, message in (
            ({}, [0.0, 0.0], r"'joint_1' needs .* hold the robot at the start"),
            (narrow, None, r"cannot hold itself against gravity.*joint_1 .*'joint_1' needs"),
        ):
            weak = limits_of(model, effort=np.array([10.0, 1.0]), **room)
            options = replace(FAST, start=start)
            with pytest.raises(ArgumentError, match=message):
                design_excitation(model, weak, trajectory=SHORT, options=options)


# In a time, with the best motion found by then

SLACK = 1.0  # s, for what cannot be interrupted
LAST_LOOK = 2.1  # s, at all thousand postures of the motion, which is always taken
WALL = Solid("wall", Box(0.1, 2.0, 2.0), RigidTransform([0.0, -3.0, 0.0]))


class Clock:
    """The CPU time of this process, plus simulated waiting."""

    def __init__(self):
        self.waited = 0.0

    def monotonic(self):
        return process_time() + self.waited

    def wait(self, seconds):
        self.waited += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("geodrake.excitation.solve.time", clock)
    monkeypatch.setattr(SlowWorld, "wait", clock.wait)
    return clock


class SlowWorld(CollisionWorld):
    """A world that takes long to check a posture, as with large meshes."""

    seconds = 0.002
    wait = None

    def distances(self, q):
        self.wait(self.seconds * len(q))
        return np.full(len(q), np.inf), ("",) * len(q)

    def nearest(self, q):
        self.wait(self.seconds * len(q))
        return {}

    def constraint(self, q):
        self.wait(self.seconds * len(q))
        return np.zeros(len(q)), np.zeros(q.shape)


def designed(clock, seconds, seeds):
    model, motion = load_description(MODELS / "arm7.urdf"), FourierMotion(10.0, 5)
    world = SlowWorld(model, obstacles=[WALL], use_file=False)
    options = DesignOptions(seconds=seconds, collisions=world, samples=100)
    begin = clock.monotonic()
    result = design_excitation(
        model, limits_of(model), trajectory=motion, options=options, seeds=seeds
    )
    return result, clock.monotonic() - begin


def test_starts_share_the_time(clock):
    result, took = designed(clock, 1.5, seeds=4)
    assert took < 1.1 * 1.5 + SLACK + LAST_LOOK
    assert result.use.is_within
    assert any(outcome.status == "out of time" for outcome in result.outcomes)
    assert result.value <= min(outcome.random_value for outcome in result.outcomes)


def test_starts_for_which_there_is_no_time_are_said(clock):
    result, took = designed(clock, 0.01, seeds=3)
    assert took < SLACK + LAST_LOOK + 0.5
    assert [outcome.seed for outcome in result.outcomes] == [0]
    assert "2 initial motions were not tried, as time was up" in result.notes


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
    with pytest.raises(ArgumentError, match="rate must be a finite number"):
        trajectory.instants(0.0)


def test_balls_have_no_order(tmp_path):
    path = tmp_path / "ball.xml"
    path.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j" type="ball"/>'
        '<geom size=".1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ArgumentError, match="several degrees"):
        motion_limits(load_description(path))
