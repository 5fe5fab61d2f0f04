"""The study of motions that tell effects apart: its robots are what they say, and what it shows."""

import re

import numpy as np
import pinocchio
import pytest
from commands import told

from diagrams.benchmarks import tell_apart as study
from diagrams.benchmarks.tell_apart import CASES, MOTIONS, Hidden
from geodrake.logs import read_log, write_log


def robot_log(hidden, motion, duration, *, noise=0.0):
    model = study.known_model()
    rows = study.simulate(study.real_robot(hidden), model, hidden, motion, duration)
    return rows, study.record("log", model, rows, np.full(2, noise), 0)


def held(hidden, postures):
    """Efforts that hold the robot itself in postures, by Drake."""
    plant = study.real_robot(hidden)
    context, efforts = plant.CreateDefaultContext(), []
    for q in postures:
        plant.SetPositions(context, q)
        efforts.append(-plant.CalcGravityGeneralizedForces(context))
    return np.array(efforts)


class TestRobots:
    @pytest.mark.sampled(3)
    @pytest.mark.parametrize("number", range(len(CASES)))
    def test_efforts_are_those_of_another_engine(self, number):
        """Pinocchio's inverse dynamics of the simulated motion, and the hidden effect's formula."""
        case = CASES[number]
        hidden = case.robot(case.size)
        motion = MOTIONS["long shuttle"][0](np.random.default_rng(1))
        (q, v, u), _ = robot_log(hidden, motion, 3.0)
        model = pinocchio.buildModelFromUrdf(str(study.ROBOT))
        data = model.createData()
        gravity = np.array([0.0, 0.0, -9.81])
        angles = np.array([*hidden.tilt, 0.0])
        model.gravity.linear = gravity + np.cross(gravity, angles)
        a = np.diff(v, axis=0) / study.STEP
        held = u[:-1]
        for k in range(200, len(a), 173):
            load = pinocchio.rnea(model, data, q[k], v[k], a[k])
            needed, _ = hidden.effort(q[k], v[k], load)
            assert held[k] == pytest.approx(load + needed, abs=0.02)

    def test_the_rivals_formulas_are_those_of_the_effects(self):
        """Each effect with its parameters for a size is what the robot hides, where it moves."""
        model, rng = study.known_model(), np.random.default_rng(2)
        for case in CASES:
            separation = study.separation_of(case)
            pair = next(p for p in separation.pairs if p.truth == case.truth)
            motion = study.Motion(*rng.uniform(0.3, 1.0, (3, 50, 2)))
            motion.v[::2] *= -1.0
            columns = separation.target.measure(motion).regressor
            at = np.flatnonzero(pair.effects.any(axis=0))
            effort = columns[:, :, at] @ (case.size * np.array(case.parameters))
            hidden = case.robot(case.size)
            expected = hidden.effort(motion.q, motion.v, model.motion(motion).load)[0]
            expected += held(hidden, motion.q) - held(Hidden.of(2), motion.q)
            np.testing.assert_allclose(effort, expected, rtol=1e-3, atol=1e-3)


def test_the_command_that_diagnose_prints_designs_the_motion(tmp_path):
    """From an ambiguous log to a motion file, with nothing but the command line."""
    case = CASES[1]
    motion = case.first_motion(np.random.default_rng(0))
    _, log = robot_log(case.robot(case.size), motion, study.FIRST, noise=study.NOISE)
    write_log(log, tmp_path / "first.csv")
    said = told("diagnose", study.ROBOT, tmp_path / "first.csv")
    pair = "coulomb_friction,load_dependent_friction@elbow"
    (words,) = re.findall(rf"- geodrake (excite \S+ --tell-apart {pair})", said)
    words = words.split()
    file = tmp_path / "motion.csv"
    fast = ("--seeds", 1, "--iterations", 5, "--limits", "velocity=1,acceleration=5")
    said = told(*words, *fast, "--noise", study.NOISE, "--save", file)
    assert "The hardest to distinguish are" in said
    assert np.abs(read_log(file).velocity).max() <= 1.0 + 1e-6
