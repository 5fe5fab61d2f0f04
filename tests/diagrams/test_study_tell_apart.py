"""The study of motions that tell effects apart: its robots are what they say, and what it shows."""

import re

import numpy as np
import pinocchio
import pytest
from commands import told

from diagrams.benchmarks import tell_apart as study
from diagrams.benchmarks.tell_apart import CASES, MOTIONS, Hidden
from diagrams.harness import script_parser
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
    @pytest.mark.parametrize("name", MOTIONS)
    def test_first_motions_are_smooth(self, name):
        """Velocity and acceleration are derivatives, and the motion is slow and small."""
        motion = MOTIONS[name][0](np.random.default_rng(0))
        t = np.linspace(0.0, study.FIRST, 4001)
        q, v, vd = motion(t)
        h = 1e-5
        ahead, behind = motion(t + h), motion(t - h)
        np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * h), v, atol=1e-7)
        np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * h), vd, atol=1e-5)
        assert np.abs(v).max() < 0.6 * study.SPEED
        assert np.ptp(q, axis=0).max() < 1.6

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


class TestTold:
    def test_robots_are_drawn_until_enough_are_ambiguous(self, monkeypatch):
        def fake(draw, *, iterations):
            del iterations
            row = {"told": True, "wrong": False, "tied": []}
            logs = dict.fromkeys(study.LOGS, row)
            more = {f"{log}_deviations": 1.0 for log in study.LOGS}
            ambiguous = draw.case == 0 and draw.seed % 2 == 1
            return {"case": draw.case, "seed": draw.seed, "ambiguous": ambiguous, **logs, **more}

        monkeypatch.setattr(study, "run", fake)
        plan = study.Plan(cases=(0, 1), wanted=3, most=8)
        parser = script_parser("A study.", draws=True)
        draws = study.draws_of(plan, parser, parser.parse_args(["--quick"]))
        first, second = (study.summary(case, draws) for case in plan.cases)
        assert (first["robots"], first["ambiguous"]) == (6, 3)
        assert (second["robots"], second["ambiguous"]) == (8, 0)
        assert first["designed"] == {"told": 3, "wrong": 0, "deviations": 1.0}
        assert second["designed"]["deviations"] is None


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
