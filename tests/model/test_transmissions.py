"""Transmissions against differences, formulas in Drake, and MuJoCo."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from chain_logs import inverse_dynamics as drakes_efforts
from closed_loops import gripper
from coupled_arm import CURVED, WRIST, arm, log_of, motion_of
from known_robots import assert_close
from own_code import OwnTransmission
from pydrake.systems.framework import DiagramBuilder

from geodrake import load_model, save_model
from geodrake.control.regressor import ControlModel
from geodrake.diagnosis import explain
from geodrake.effects import CoulombFriction, JointElasticity, RotorInertia
from geodrake.effects.base import FittedEffect
from geodrake.errors import ArgumentError, LogError, ModelError
from geodrake.excitation.regressor_gradient import (
    base_wrench_regressor_gradient,
    inverse_dynamics_regressor_gradient,
)
from geodrake.identification.logs.compare import compare
from geodrake.logs import JointLog, Motion
from geodrake.model import holding, python_source
from geodrake.model.logged_joints import model_of_logs
from geodrake.robot import base_wrench_regressor, inverse_dynamics_regressor, joint_names
from geodrake.robot.effort_slopes import effort_slopes
from geodrake.robot.regressor import inverse_dynamics
from geodrake.robot.transmission import (
    InSequence,
    LinearTransmission,
    SideBySide,
    gears,
    rolling_joint,
)
from geodrake.robot.transmission.schema import Drive, FourBarLinkage, LinearActuator

STEP = 1e-5
J = np.array([[-1 / 8, 0, 0], [0, 0.5, 0.5], [0, 0.4, -0.4]])


@pytest.fixture(scope="module")
def wrist(tmp_path_factory):
    return arm(tmp_path_factory.mktemp("wrist"))


@pytest.fixture(scope="module")
def curved(tmp_path_factory):
    return arm(tmp_path_factory.mktemp("curved"), CURVED)


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    path = tmp_path_factory.mktemp("loop") / "gripper.xml"
    path.write_text(gripper())
    return load_model(path)


def slopes_of(function, x):
    """Return central differences [..., j] of a function of x (N, n)."""
    units = STEP * np.eye(x.shape[1])
    return np.stack([(function(x + u) - function(x - u)) / (2 * STEP) for u in units], -1)


def test_efforts_are_those_of_drake_through_the_matrix(wrist):
    motion = motion_of(wrist, reach=1.0)
    assert wrist.joints == ("m1", "m2", "m3")
    at_joints = drakes_efforts(
        wrist.plant, motion.q @ J.T + [0.0, 0.0, 0.1], motion.v @ J.T, motion.vd @ J.T
    )
    seen = wrist.motion(motion)
    assert_close(seen.load, at_joints @ J)
    Y = inverse_dynamics_regressor(wrist.tree, motion.q, motion.v, motion.vd)
    assert_close(Y @ wrist.phi.ravel(), seen.load)
    assert_close(seen.body_columns("tool"), Y[:, :, 20:30])
    assert wrist.joint_pairs == (("m1", "m2"), ("m2", "m3")) and wrist.sliding_joints == ()


def test_efforts_of_curved_maps_are_those_of_drake_along_the_same_path(curved):
    """θ(t), θ̇ and θ̈ by differences of a path q(t); efforts by virtual work, Jᵀ from differences."""
    motion = motion_of(curved)
    path = lambda t: motion.q + t * motion.v + 0.5 * t**2 * motion.vd  # noqa: E731
    positions = curved.plant_positions
    h = 1e-4
    before, here, after = (positions(path(t)) for t in (-h, 0.0, h))
    rates, accelerations = (after - before) / (2 * h), (after - 2 * here + before) / h**2
    expected = np.einsum(
        "nji,nj->ni",
        slopes_of(positions, motion.q),
        drakes_efforts(curved.plant, here, rates, accelerations),
    )
    np.testing.assert_allclose(curved.motion(motion).load, expected, rtol=2e-4, atol=2e-5)
    assert curved.sliding_joints == ("screw",)


@pytest.mark.parametrize("name", ["curved", "loop"])
def test_slopes_and_jacobians_are_differences(name, request):
    model = request.getfixturevalue(name)
    motion = motion_of(model)
    q, v, vd = motion.q, motion.v, motion.vd
    phi, tree = model.total_phi, model.tree
    slopes = effort_slopes(tree, q, v, vd, phi)
    for found, function, x in (
        (slopes.position, lambda x: inverse_dynamics(tree, x, v, vd, phi), q),
        (slopes.velocity, lambda x: inverse_dynamics(tree, q, x, vd, phi), v),
        (slopes.acceleration, lambda x: inverse_dynamics(tree, q, v, x, phi), vd),
    ):
        np.testing.assert_allclose(found, slopes_of(function, x), rtol=1e-5, atol=1e-5)
    name = "left_tip" if name == "loop" else "tool"
    place = lambda x: model.motion(Motion(x, v, vd)).bodies.motion(name).position  # noqa: E731
    tool = model.motion(Motion(q, v, vd)).bodies.motion(name)
    np.testing.assert_allclose(tool.linear, slopes_of(place, q), atol=1e-8)
    assert tool.dofs == tuple(range(len(model.joints)))


@pytest.mark.parametrize("name", ["curved", "loop"])
def test_a_controllers_regressor_is_skew_and_conserves_momentum(name, request):
    model, h = request.getfixturevalue(name), 1e-5
    q, v, a = (x[0] for x in (motion_of(model).q, motion_of(model).v, motion_of(model).vd))
    whole, control = ControlModel.of(model), ControlModel.of(replace(model, effects=()))
    effort = whole.at(q, v, v, a).effort(whole.prior)
    assert_close(effort, model.effort(Motion(q[None], v[None], a[None]))[0])
    p, zero, own = control.prior, np.zeros(len(q)), control.at(q, v, v, a)
    M = lambda t: control.at(q + t * v, v, v, zero).mass_matrix(p)  # noqa: E731
    gravity = control.at(q, zero, zero, zero).effort(p)
    C = np.array([control.at(q, v, u, zero).effort(p) - gravity for u in np.eye(len(q))]).T
    rate = (M(h) - M(-h)) / (2 * h)
    np.testing.assert_allclose(rate - 2 * C, -(rate - 2 * C).T, atol=1e-6)
    momentum, drift = own.momentum_regressors
    assert_close(momentum @ p, M(0.0) @ v)
    np.testing.assert_allclose(drift @ p, C.T @ v - gravity, atol=1e-9)


@pytest.mark.parametrize(
    ("beside", "extra"),
    [
        (CURVED, ""),
        ("gears:\n- {actuator: m, joint: pitch, ratio: 9, rotor: roll}\n", ""),
        ("", '<mimic joint="pitch" multiplier="-0.5" offset="0.1"/>'),
    ],
)
def test_a_plant_in_a_diagram_moves_as_the_model_does(beside, extra, tmp_path):
    """q̈ of the model under some efforts, rotor inertia and friction at the actuators included."""
    model = arm(tmp_path, beside, extra=extra)
    first, last = model.joints[0], model.joints[-1]
    effects = (
        FittedEffect(RotorInertia(last), np.array([0.02])),
        FittedEffect(CoulombFriction(first), np.array([0.3])),
    )
    model = replace(model, effects=effects)
    motion = motion_of(model, count=1)
    effort = model.effort(motion, sign_width=1e-2)[0]
    builder = DiagramBuilder()
    robot = model.add_to_builder(builder)
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    robot.set_state(root, motion.q[0], motion.v[0])
    system = robot.effort.get_system()
    robot.effort.FixValue(system.GetMyMutableContextFromRoot(root), effort)
    context = robot.plant.GetMyContextFromRoot(root)
    state = robot.state.Eval(robot.state.get_system().GetMyContextFromRoot(root))
    assert_close(state, np.concatenate([motion.q[0], motion.v[0]]))
    found = robot.plant.get_generalized_acceleration_output_port().Eval(context)
    h = 1e-4
    places = [
        model.plant_positions(motion.q + t * motion.v + 0.5 * t**2 * motion.vd)[0]
        for t in (-h, 0.0, h)
    ]
    expected = (places[2] - 2 * places[1] + places[0]) / h**2
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)


def test_friction_is_found_at_the_motor_that_has_it(wrist):
    """The motor m2 with dry friction moves two joints."""
    rub = lambda v: np.tanh(v / 1e-3) * [0.0, 0.8, 0.0]  # noqa: E731
    found = explain(wrist, [log_of(wrist, 0, rub, seconds=12.0)])
    (step,) = found.steps
    (fitted,) = [f for f in found.model.effects if f.effect.name == "coulomb_friction"]
    assert fitted.effect.where == ("m2",) == tuple(step.where)
    np.testing.assert_allclose(fitted.parameters, 0.8, rtol=0.03)


def test_a_saved_model_has_its_transmission(wrist, curved, tmp_path):
    for model in (wrist, curved):
        fitted = model.with_fit(
            1.1 * model.phi,
            [FittedEffect(CoulombFriction(model.joints[1]), np.array([0.4]))],
            information=np.eye(model.phi.size + 1),
            effort_noise=np.full(3, 0.1),
        )
        save_model(fitted, tmp_path / "model.yaml")
        again = load_model(tmp_path / "model.yaml")
        assert again.joints == model.joints and again.effort_noise is not None
        assert_close(again.effort(motion_of(model)), fitted.effort(motion_of(model)))
    with pytest.raises(ModelError, match=r"model\.yaml is a saved model, which cannot take a tran"):
        load_model(tmp_path / "model.yaml", transmission="none")


@pytest.mark.parametrize(
    ("new", "problem"),
    [
        ("joint: knee", "joint 'knee', which is not an independent joint"),
        ("jiont: shoulder", r"gears\[0\] has .*jiont"),
    ],
)
def test_a_saved_transmission_that_does_not_fit_is_refused(wrist, new, problem, tmp_path):
    path = tmp_path / "model.yaml"
    save_model(wrist, path)
    path.write_text(path.read_text().replace("joint: shoulder", new))
    with pytest.raises(ModelError, match=problem):
        load_model(path)


def test_actuators_are_held_together_where_their_joints_then_stand(wrist):
    held = holding(wrist, {"m2": 0.4, "m3": 0.2})
    assert held.joints == ("m1",)
    assert held.held == pytest.approx({"pitch": 0.3, "roll": 0.18})
    motion = motion_of(held)
    whole = Motion(
        *(np.hstack([x, np.zeros((len(x), 2))]) for x in (motion.q, motion.v, motion.vd))
    )
    whole.q[:, 1:] = [0.4, 0.2]
    assert_close(held.motion(motion).load, wrist.motion(whole).load[:, :1])
    with pytest.raises(ModelError, match="'m2' cannot be fixed without m3: they move pitch, roll"):
        holding(wrist, {"m2": 0.4})


def test_logs_of_joints_are_not_taken_for_logs_of_motors(wrist):
    log = log_of(wrist, 0, seconds=2.0)
    for names in (("m1", "pitch", "roll"), ("shoulder", "pitch", "roll")):
        other = JointLog("joints", names, log.time, log.position, log.effort)
        with pytest.raises(LogError, match=r"shoulder|pitch"):
            compare(model_of_logs(wrist, [other]), [other])


def test_damping_and_limits_of_the_file_are_the_actuators(tmp_path):
    rub = '<dynamics damping="0.3" friction="0.2"/>'
    geared = "gears:\n- {actuator: m, joint: roll, ratio: 5}\n"
    model = arm(tmp_path, geared, extra=rub)
    values = {f.effect.name: (f.effect.where, f.parameters[0]) for f in model.effects}
    assert values == {
        "viscous_friction": (("m",), pytest.approx(0.3 / 25)),
        "coulomb_friction": (("m",), pytest.approx(0.2 / 5)),
    }
    np.testing.assert_allclose(model.position_limits[1], [2.0, 2.0, 10.0])
    np.testing.assert_allclose(model.velocity_limits, [3.0, 3.0, 15.0])
    np.testing.assert_allclose(model.effort_limits, [40.0, 40.0, 8.0])
    model = arm(tmp_path, WRIST, extra=rub)
    values = {(f.effect.name, *f.effect.where): f.parameters.tolist() for f in model.effects}
    assert values == {("viscous_friction", "roll"): [0.3], ("coulomb_friction", "roll"): [0.2]}
    motion = Motion(*np.random.default_rng(0).uniform(-0.5, 0.5, (3, 6, 3)))
    J = model.coordinates.constant
    (at,) = (k for k, name in enumerate(joint_names(model.plant)) if name == "roll")
    rate = motion.v @ J[at]
    rubbing = (0.3 * rate + 0.2 * np.sign(rate))[:, None] * J[at]
    bare = replace(model, effects=())
    np.testing.assert_allclose(model.effort(motion) - bare.effort(motion), rubbing, atol=1e-12)


def test_a_function_of_ones_own_serves_and_is_not_saved(wrist, tmp_path):
    square = OwnTransmission(
        (3, 3), lambda q: q @ J.T + [0.0, 0.0, 0.1], lambda q: np.broadcast_to(J, (len(q), 3, 3))
    )
    drive = Drive(wrist.joints, ("shoulder", "pitch", "roll"), square)
    own = arm(tmp_path, "", transmission=[drive])
    assert_close(own.motion(motion_of(wrist)).load, wrist.motion(motion_of(wrist)).load)
    with pytest.raises(ModelError, match="m1, m2, m3 is a user-defined function, which cannot be"):
        save_model(own, tmp_path / "model.yaml")


def test_source_code_has_the_transmission(wrist, curved):
    names = {}
    exec(python_source(wrist), names)
    motion = motion_of(wrist)
    rows = zip(motion.q.tolist(), motion.v.tolist(), motion.vd.tolist(), strict=True)
    assert_close(np.array([names["effort"](*row) for row in rows]), wrist.effort(motion))
    with pytest.raises(ModelError, match="with varying ratio"):
        python_source(curved)


@pytest.mark.parametrize("name", ["curved", "loop"])
def test_gradients_for_excitation_are_differences(name, request):
    model = request.getfixturevalue(name)
    motion, tree = motion_of(model), model.tree
    W = np.random.default_rng(1).normal(size=(6, len(model.joints), model.phi.size))
    V = np.random.default_rng(2).normal(size=(6, 6, model.phi.size))
    for gradient, regressor, weights in (
        (inverse_dynamics_regressor_gradient, inverse_dynamics_regressor, W),
        (base_wrench_regressor_gradient, base_wrench_regressor, V),
    ):
        found = gradient(tree, motion.q, motion.v, motion.vd, weights)

        def value(weights=weights, regressor=regressor, **moved):
            at = {"q": motion.q, "v": motion.v, "vd": motion.vd} | moved
            return np.einsum("nij,nij->n", weights, regressor(tree, at["q"], at["v"], at["vd"]))

        for key in ("q", "v", "vd"):
            expected = slopes_of(lambda x, key=key: value(**{key: x}), getattr(motion, key))
            np.testing.assert_allclose(getattr(found, key), expected, rtol=1e-5, atol=1e-5)


def test_soft_joints_behind_a_transmission_are_refused(wrist):
    soft = replace(wrist, effects=(FittedEffect(JointElasticity("m2"), np.array([1e-3])),))
    with pytest.raises(
        ModelError, match="joint_elasticity of m2 cannot be simulated with following joints"
    ):
        soft.add_to_builder(DiagramBuilder())


def random_motion(count=6, width=2, seed=0):
    q, v, vd = np.random.default_rng(seed).uniform(-2, 2, (3, count, width))
    return Motion(q, v, vd)


def crank(q):
    """Return a slider crank's angle and stroke, and a plain joint: 3 joints of 2 actuators."""
    a, b = q.T
    return np.stack([np.arcsin(0.4 * np.sin(a)), np.cos(a) + 0.3 * np.sin(a + b), b], -1)


def crank_jacobian(q):
    a, b = q.T
    J = np.zeros((len(q), 3, 2))
    J[:, 0, 0] = 0.4 * np.cos(a) / np.sqrt(1 - 0.16 * np.sin(a) ** 2)
    J[:, 1, 0] = -np.sin(a) + 0.3 * np.cos(a + b)
    J[:, 1, 1] = 0.3 * np.cos(a + b)
    J[:, 2, 1] = 1.0
    return J


CRANK = OwnTransmission((3, 2), crank, crank_jacobian)
BELTS = LinearTransmission.of([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.2, 0.0, 1.0]])
DIFFERENTIAL = LinearTransmission.of([[1.0, 0.0], [1.0, -1.0]], [0.1, -0.2])


@pytest.mark.parametrize(
    "part",
    [
        InSequence((gears([2.0, -3.0]), CRANK, BELTS)),
        SideBySide((InSequence((gears([7.0]), rolling_joint(0.3))), DIFFERENTIAL)),
    ],
)
def test_derivatives_are_differences_and_actuators_follow_from_the_joints(part):
    motion, step = random_motion(width=part.num_actuators), 1e-5
    q, v, J = motion.q, motion.v, part.jacobian(motion.q)
    assert J.shape == (6, part.num_joints, part.num_actuators)
    for i, direction in enumerate(np.eye(part.num_actuators)):
        ends = [part.joint_positions(q + h * direction) for h in (step, -step)]
        np.testing.assert_allclose(J[:, :, i], (ends[0] - ends[1]) / (2 * step), atol=1e-9)
    rate = (part.jacobian(q + step * v) - part.jacobian(q - step * v)) / (2 * step)
    np.testing.assert_allclose(part.jacobian_rate(q, v), rate, atol=1e-9)
    found = part.actuator_positions(part.joint_positions(q), start=q + 0.05)
    np.testing.assert_allclose(found, q, atol=1e-8)
    rows = np.random.default_rng(1).normal(size=(6, part.num_joints, 4))
    np.testing.assert_allclose(part.regressor(q, rows), np.einsum("nki,nkp->nip", J, rows))
    moved, h = part.joint_motion(motion), 1e-4
    before, here, after = (
        part.joint_positions(q + t * v + 0.5 * t**2 * motion.vd) for t in (-h, 0.0, h)
    )
    np.testing.assert_allclose(moved.v, (after - before) / (2 * h), atol=1e-6)
    np.testing.assert_allclose(moved.vd, (after - 2 * here + before) / h**2, atol=1e-5)


BARS = FourBarLinkage(
    actuator="m", joint="j", ground=0.1, crank=0.04, coupler=0.09, rocker=0.06,
    crank_angle=1.2, rocker_angle=1.5,
)  # fmt: skip
CYLINDER = LinearActuator(actuator="m", joint="j", base=0.5, lever=0.4, length=0.5, angle=1.16)


def rocker_of(bars, q):
    """Return the rocker's angle by the law of cosines for coupler, rocker and diagonal."""
    end = bars.crank * np.exp(1j * (q + bars.crank_angle)) - bars.ground
    sides = abs(end) ** 2 + bars.rocker**2 - bars.coupler**2
    bend = np.arccos(sides / (2 * bars.rocker * abs(end)))
    return np.angle(end) + (bend if bars.crossed else -bend) - bars.rocker_angle


def lever_of(cylinder, q):
    a, b = cylinder.base, cylinder.lever
    turned = np.arccos((a**2 + b**2 - (q + cylinder.length) ** 2) / (2 * a * b)) - cylinder.angle
    return -turned if cylinder.reversed else turned


@pytest.mark.parametrize(
    ("part", "angle", "reach"),
    [
        (BARS, rocker_of, 9.0),
        (msgspec.structs.replace(BARS, crossed=True), rocker_of, 9.0),
        (msgspec.structs.replace(BARS, crank=0.08, crank_angle=0.9), rocker_of, 0.6),
        (CYLINDER, lever_of, 0.39),
        (msgspec.structs.replace(CYLINDER, reversed=True), lever_of, 0.39),
    ],
)
def test_linkages_are_those_of_the_law_of_cosines(part, angle, reach):
    """A crank that goes around goes on through several turns, joint and all."""
    q, found = np.linspace(-reach, reach, 401)[:, None], Drive.of(part).map
    theta, J, rate = found.along(q, np.ones_like(q))
    turns = (theta[:, 0] - angle(part, q[:, 0])) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    assert np.abs(np.diff(theta[:, 0])).max() < 0.3
    slope = (angle(part, q + 1e-6) - angle(part, q - 1e-6)) / 2e-6
    np.testing.assert_allclose(J[:, 0], slope, atol=1e-6)
    bend = (found.jacobian(q + 1e-5) - found.jacobian(q - 1e-5)) / 2e-5
    np.testing.assert_allclose(rate, bend, rtol=1e-5, atol=1e-5)
    low, high = found.range
    assert low[0] <= -reach and high[0] >= reach


def test_linkages_say_where_they_do_not_close():
    assert np.abs(np.ravel(Drive.of(CYLINDER).map.range) - [-0.4, 0.4]).max() < 1e-3
    with pytest.raises(ArgumentError, match=r"loop of the cylinder m does not close at m = 0\.45"):
        Drive.of(CYLINDER).map.joint_positions(np.array([[0.45]]))
    with pytest.raises(ArgumentError, match="do not reach each other at q = 0 with the crank at 3"):
        Drive.of(msgspec.structs.replace(BARS, ground=0.2, crank_angle=3.0))


def test_bad_input():
    with pytest.raises(ArgumentError, match=r"'knees' is none of knee, hip"):
        LinearTransmission.from_ratios(["knee", "hip"], ["m"], {"knees": {"m": 1.0}})
    with pytest.raises(ArgumentError, match="rank n"):
        LinearTransmission.of([[1.0, 1.0], [2.0, 2.0]])
    with pytest.raises(ArgumentError, match="must not be zero"):
        gears([1.0, 0.0])
    with pytest.raises(ArgumentError, match="from 0 to 1"):
        rolling_joint(1.5)
    with pytest.raises(ArgumentError, match="but the next one 2"):
        InSequence((rolling_joint(), CRANK, DIFFERENTIAL))
    with pytest.raises(ArgumentError, match="actuators cannot reach"):
        rolling_joint().actuator_positions(np.array([[1.0, -1.0]]))
    with pytest.raises(ArgumentError, match=r"initial guess must have shape \(2,\)"):
        DIFFERENTIAL.actuator_positions(np.zeros((1, 2)), start=[1.0, 2.0, 3.0])
    for nothing in (SideBySide, InSequence):
        with pytest.raises(ArgumentError, match="at least one"):
            nothing(())
