"""Gears whose friction grows with the square of their load, and that brake: every simulation."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from servo_logs import PENDULUM, command

from geodrake import load_model
from geodrake.control.rollout.passages import chosen_passages
from geodrake.control.rollout.simulation import simulations
from geodrake.control.rollout.stepping import stepping
from geodrake.effects import CoulombFriction, FittedEffect, RotorInertia, ViscousFriction
from geodrake.effects.of_files import SquaredLoadFriction
from geodrake.errors import ArgumentError, ModelError
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.joint_motions import motions_of
from geodrake.identification.logs.signal_calibration import signals_as_efforts
from geodrake.logs import JointLog, Motion
from geodrake.logs.preparation import prepare_logs
from geodrake.model import EffortSignal
from geodrake.model.admissible import check_effect
from geodrake.model.simulation.force_law import ForceLaw
from geodrake.model.simulation.terms import PlantMotion, PlantState

KP, DAMPING, DRY, ARMATURE, FACTOR = 60.0, 2.0, 0.3, 0.01, 0.25
MASS, WEIGHT = 0.05 + 2.0 * 0.4**2, 2.0 * 0.4 * 9.81  # of the pendulum, kg·m² and N·m
WIDTH = 2e-3  # rad/s
GEAR = SquaredLoadFriction.fitted("hinge", FACTOR, 0.0)
BOUND = GEAR.effect.braking_load


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A pendulum whose weight alone would lock the gear without a bound: 2 k l > 1."""
    path = tmp_path_factory.mktemp("gear") / "pendulum.urdf"
    path.write_text(PENDULUM)
    assert 2.0 * FACTOR * WEIGHT > 3.0
    values = ((ViscousFriction, DAMPING), (CoulombFriction, DRY), (RotorInertia, ARMATURE))
    plain = tuple(FittedEffect(kind("hinge"), np.array([value])) for kind, value in values)
    servo = EffortSignal("hinge", "command", KP)
    return replace(load_model(path), effects=(*plain, GEAR), effort_signals=(servo,))


def acceleration(q, v, push):
    """Of the pendulum, by a search: what pushes is what bodies, rotor and friction need."""
    sign = np.tanh(v / WIDTH)

    def missing(a):
        load = MASS * a + WEIGHT * np.sin(q)
        along = load if load * v >= 0.0 else np.clip(load, -BOUND, BOUND)
        dry = (DRY + FACTOR * along**2) * sign
        return load + ARMATURE * a + DAMPING * v + dry - push

    return brentq(missing, -1e5, 1e5, xtol=1e-10)


@pytest.fixture(scope="module")
def log():
    """Its motion under commands, exactly."""

    def rates(t, state):
        q, v = state
        return [v, acceleration(q, v, KP * (command(t) - q))]

    time = 0.004 * np.arange(2000)
    start = [command(0.0), 0.0]
    moved = solve_ivp(rates, (0.0, time[-1]), start, "LSODA", time, rtol=1e-8, atol=1e-9).y
    q, v = moved
    a = np.array([acceleration(*each) for each in zip(q, v, KP * (command(time) - q), strict=True)])
    brakes = -(MASS * a + WEIGHT * np.sin(q)) * np.sign(v)
    assert 0.1 < np.mean(brakes > BOUND) < 0.9  # it brakes at its bound much of the time
    none = np.full((len(time), 1), np.nan)
    return JointLog("gear", ("hinge",), time, q[:, None], none, command=command(time)[:, None])


def test_a_joint_alone_moves_as_it_does(model, log):
    sharp = prepare_logs(signals_as_efforts([log], ["command"]), bandwidth=5.0, motion_bandwidth=20)
    (motions,) = motions_of(replace(model, effects=()), [log], sharp, [0]).values()
    servo = [KP, 0.0, DAMPING, DRY, ARMATURE, 0.0, 0.0]
    assert motions.rms(motions.servo(servo)) > 0.02
    assert motions.rms(motions.servo([*servo, FACTOR])) < 1e-3


def test_steps_and_drake_move_it_as_it_does(model, log):
    case = open_case(model, [log], candidates=False)
    passages = chosen_passages(case, 0.5, 4)
    found = stepping(case, passages, commands=True).positions()
    drake = simulations(case, passages, commands=True)(log.name)
    for passage, steps in zip(passages, found, strict=True):
        assert np.ptp(passage.logged) > 0.2
        exact = drake.positions(passage)
        assert np.abs(exact - passage.logged).max() < 5e-3  # which begins with smoothed velocities
        assert np.abs(steps - exact).max() < 1e-3


def test_an_arm_has_one_acceleration():
    """However strongly it brakes: where the effort that it needs is what acts."""
    arm, rng = load_model(files("geodrake.demo") / "demo.urdf"), np.random.default_rng(4)
    count = len(arm.joints)
    for _ in range(40):
        factors = 10.0 ** rng.uniform(-2.0, 1.0, count)
        gears = [
            SquaredLoadFriction.fitted(joint, factor, 0.0)
            for joint, factor in zip(arm.joints, factors.tolist(), strict=True)
        ]
        law = ForceLaw(PlantMotion(arm.plant, WIDTH), gears, spring_damping=0.0)
        q, v = rng.uniform(-3.0, 3.0, count), rng.normal(size=count)
        push = 10.0 ** rng.uniform(0.0, 2.5) * rng.normal(size=count)
        found = law.response(PlantState(q, v, 0.0, np.zeros(0)), push, (law.mu, law.phi))
        motion = Motion(*(x[None] for x in (arm.positions(q[None])[0], v, found.acceleration)))
        whole = replace(arm, effects=tuple(gears))
        np.testing.assert_allclose(
            whole.effort(motion, sign_width=WIDTH)[0], push, atol=1e-4 * np.abs(push).max()
        )


@pytest.mark.parametrize(("largest", "seconds"), [(1e-2, 1.0), (1e-4, 0.1)])
def test_energy_falls(model, largest, seconds):
    """Of two that swing free, by steps however short."""
    builder = DiagramBuilder()
    added = replace(model, effort_signals=()).add_to_builder(builder, sign_width=WIDTH)
    simulator = Simulator(builder.Build())
    root = simulator.get_mutable_context()
    added.set_state(root, [2.5], [6.0])
    context = added.plant.GetMyContextFromRoot(root)
    simulator.get_mutable_integrator().set_maximum_step_size(largest)
    energy = []
    for instant in np.linspace(0.0, seconds, 101):
        simulator.AdvanceTo(instant)
        v = added.plant.GetVelocities(context)
        whole = added.plant.EvalKineticEnergy(context) + 0.5 * ARMATURE * v @ v
        energy.append(whole + added.plant.EvalPotentialEnergy(context))
    energy = np.array(energy)
    assert (np.diff(energy) < 1e-6).all()
    assert energy[-1] < energy[0] - 5.0 * seconds


def test_a_gear_that_locks_is_refused():
    with pytest.raises(ModelError, match=r"squared_load_factor = 0\.2, outside"):
        check_effect(FittedEffect(SquaredLoadFriction("hinge", 3.0), np.array([0.2])))
    with pytest.raises(ArgumentError, match="braking_load"):
        SquaredLoadFriction("hinge", 0.0)
