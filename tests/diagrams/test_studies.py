"""Robots, logs and measures of studies and benchmarks."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from commands import told
from pydrake.multibody.tree import MultibodyForces
from scripts import call

from diagrams.benchmarks import hidden_effects as logs
from diagrams.benchmarks import tell_apart as study
from diagrams.benchmarks.simulated.engines import (
    MuJoCoEngine,
    PinocchioEngine,
    congruent,
    pseudo,
    robot_file,
    robot_model,
    robot_names,
)
from diagrams.benchmarks.simulated.faults import FAULTS, spoiled
from diagrams.benchmarks.simulated.motions import FAST
from diagrams.benchmarks.simulated.truths import OUTSIDE, TRUTHS
from diagrams.benchmarks.tell_apart import CASES, MOTIONS
from diagrams.studies import atlas_identification as atlas
from diagrams.studies import cheetah_gallop as gallop
from diagrams.studies import scara_excitation as scara
from diagrams.studies.adaptive import laws
from diagrams.studies.ambidex import arm as robot
from diagrams.studies.cheetah import leg as cheetah
from geodrake.diagnosis import diagnose
from geodrake.excitation import ExcitationTrajectory, FreeSamples
from geodrake.logs import JointLog, Motion, read_log, write_log
from geodrake.robot import base_parameters, base_wrench_regressor, inverse_dynamics, joint_names
from geodrake.robot.regressor import body_poses


@pytest.fixture(scope="module")
def arm():
    return robot.Arm.load()


class TestArm:
    def test_regressor_gives_what_drake_needs(self, arm):
        """Compare with Drake's inverse dynamics of ten joints, virtual work, and rotors."""
        rng = np.random.default_rng(1)
        q, v, vd = (30.0 * rng.uniform(-1, 1, (6, 7)) for _ in range(3))
        torque = arm.regressor(Motion(q, v, vd)) @ arm.phi.ravel()
        J = np.zeros((10, 7))
        for joint, motor in zip((0, 1, 2, 5), (0, 1, 2, 4), strict=True):
            J[joint, motor] = 1 / 30
        J[3:5, 3] = 1 / 60
        J[6:8, 5:] = 1 / 120
        J[8:10, 5:] = [1 / 120, -1 / 120]
        context = arm.plant.CreateDefaultContext()
        for k in range(len(q)):
            arm.plant.SetPositions(context, J @ q[k])
            arm.plant.SetVelocities(context, J @ v[k])
            needed = arm.plant.CalcInverseDynamics(context, J @ vd[k], MultibodyForces(arm.plant))
            needed -= arm.plant.CalcGravityGeneralizedForces(context)
            expected = J.T @ needed + robot.ROTOR_INERTIA * vd[k]
            np.testing.assert_allclose(torque[k], expected, rtol=1e-10, atol=1e-12)


MODELS = Path(__file__).parents[2] / "models"


def test_motion_of_a_leg_tells_32_combinations_and_its_base_wrench_more():
    """There are 60 with geared rotors; on a fixed base the wrench is not measured."""
    leg = cheetah.load_leg(gallop.GEARS)
    time = np.linspace(0.0, 1.0 / gallop.STRIDE, 200, endpoint=False)
    motion = gallop.leg_motion(time, gallop.PHASES["front_left"])
    rows = leg.regressor(motion).reshape(-1, 60)
    assert base_parameters(rows).rank == 32
    base = base_wrench_regressor(leg.model.tree, motion.q, motion.v, motion.vd).reshape(-1, 60)
    assert base_parameters(np.vstack([rows, base])).rank > 32


def test_quantities_are_the_inverse_dynamics():
    """Drake's plant has rotors, which turn by the gear ratio."""
    robot, motion = gallop.whole_robot(), gallop.gallop(np.array([0.05, 0.31]))
    assert robot.joints[6:] == gallop.ACTUATORS
    quantities, plant = gallop.quantities(robot, motion), robot.plant
    change = np.random.default_rng(0).normal(size=(6, 10))
    names, order = list(robot.bodies), list(joint_names(plant))
    phi = np.zeros((25, 10))
    for name in gallop.LEGS:
        phi[[k for k, body in enumerate(names) if body.startswith(name)]] = change
    whole = np.zeros((3, 2, len(order)))
    for part, values in zip(whole, (motion.q, motion.v, motion.vd), strict=True):
        for k, name in enumerate(robot.joints):
            part[:, order.index(name)] = values[:, k]
        for name, gear in zip(gallop.ACTUATORS, 4 * gallop.GEARS, strict=True):
            part[:, order.index(f"{name}_rotor")] = gear * part[:, order.index(name)]
    efforts = inverse_dynamics(plant, *whole, phi)
    R_WB = body_poses(plant, whole[0])[:, names.index("trunk"), :3, :3]
    axes = np.broadcast_to(np.eye(3)[::-1], R_WB.shape).copy()  # of yaw, pitch and roll, here
    axes[:, 2] = R_WB[:, :, 0]
    moment = np.linalg.solve(axes, efforts[:, 3:6, None])[:, :, 0]
    for wrench, name in ((moment, "body moment"), (efforts[:, :3], "body force")):
        rows = quantities[name].rows @ change.ravel()
        local = np.einsum("nji,nj->ni", R_WB, wrench)
        np.testing.assert_allclose(rows.reshape(2, 3), local, atol=1e-8 * np.abs(efforts).max())
    # At a joint: the link's effort, and that of its rotor, geared.
    torque = (quantities["joint torque"].rows @ change.ravel()).reshape(2, 12)
    knee, rotor = order.index("rear_left_knee"), order.index("rear_left_knee_rotor")
    expected = efforts[:, knee] + gallop.GEARS[2] * efforts[:, rotor]
    np.testing.assert_allclose(torque[:, 8], expected, atol=1e-8 * np.abs(efforts).max())


class TestScara:
    def test_frames_are_of_one_robot(self):
        rng, efforts = np.random.default_rng(0), []
        motion = Motion(*rng.uniform(-2, 2, (3, 10, 2)))
        for frame in scara.FRAMES:
            model = scara.scara(frame, scara.payload(*scara.PRIOR))
            efforts.append(model.effort(motion))
        for other in efforts[1:]:
            np.testing.assert_allclose(other, efforts[0], rtol=1e-10, atol=1e-12)

    def test_expected_errors_are_those_of_drawn_noise(self):
        rng = np.random.default_rng(1)
        trajectory = ExcitationTrajectory(
            FreeSamples(50), rng.uniform(-2, 2, (150, 2)), ("shoulder", "elbow")
        )
        target, model = scara.payload_target("3"), scara.scara("3", scara.payload(*scara.TRUTH))
        A = target.measure(trajectory.motion(np.zeros(50))).regressor.reshape(100, -1)[
            :, [0, 1, 2, 6]
        ]
        truth = model.phi[1, [0, 1, 2, 6]]
        noise = scara.NOISE * rng.normal(size=(100, 4000))
        m, hx, hy, izz = truth[:, None] + np.linalg.lstsq(A, noise)[0]
        expected = scara.errors(trajectory)
        drawn = {
            "m": (m - 4.0).std(),
            "px": 1e3 * (hx / m).std(),
            "py": 1e3 * (hy / m).std(),
            "rz": 1e3 * (np.sqrt(izz / m) - 0.08165).std(),
        }
        for key, value in drawn.items():
            assert expected[key] == pytest.approx(value, rel=0.05)


class TestOneFoot:
    def test_motions_are_in_balance(self):
        """Drake's centre of mass is over the foot, which does not move."""
        stance, plan = atlas.standing_robot(None), atlas.Plan(None)
        motion = atlas.sampled(stance, atlas.one_motion(0, plan=plan), 30.0)
        plant, sole = stance.robot.plant, []
        context = plant.CreateDefaultContext()
        for q in stance.model.plant_positions(motion.q):
            plant.SetPositions(context, q)
            center = plant.CalcCenterOfMassPositionInWorld(context)
            assert (np.abs(center[:2]) < 1.2 * np.array([0.12, 0.06])).all()
            X = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("l_foot"))
            sole.append(X.GetAsMatrix4())
        assert np.ptp(sole, axis=0).max() < 1e-9
        assert np.abs(motion.v[[0, -1]]).max() < 1e-9


pytest.importorskip("pinocchio")


PLAIN = {
    "robot": "arm6",
    "motion": FAST,
    "prior": logs.EXACT,
    "noise": 0.01,
    "duration": 16.0,
    "rate": 125.0,
}


@pytest.fixture(params=robot_names())
def engines(request):
    file = robot_file(request.param)
    return PinocchioEngine(file), MuJoCoEngine(file)


class TestEngines:
    def test_agree_on_other_bodies_and_gravity(self, engines):
        rng = np.random.default_rng(0)
        bodies = congruent(engines[0].bodies(), 0.2, rng)
        samples = rng.normal(size=(3, 5, len(bodies)))
        for engine in engines:
            engine.set_bodies(bodies)
            engine.set_gravity(np.array([1.0, -2.0, -9.0]))
            np.testing.assert_allclose(engine.bodies(), bodies, rtol=1e-9, atol=1e-12)
        efforts, others = (engine.efforts(*samples) for engine in engines)
        np.testing.assert_allclose(efforts, others, rtol=1e-9, atol=1e-9 * np.abs(efforts).max())
        point = np.array([0.1, -0.2, 0.3])
        found = (engine.frames(len(bodies) - 1, point, samples[0]) for engine in engines)
        for one, other in zip(*found, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9)


def test_congruent_bodies_are_physical_and_as_far_as_asked():
    P = np.repeat(
        pseudo(2.0, np.array([0.1, 0.0, 0.2]), np.diag([0.02, 0.03, 0.04]))[None], 4000, 0
    )
    found = congruent(P, 0.2, np.random.default_rng(0))
    assert np.linalg.eigvalsh(found).min() > 0.0
    L = np.linalg.cholesky(P[0])
    whitened = np.linalg.solve(L, np.linalg.solve(L, found).transpose(0, 2, 1))
    distance = np.sqrt((np.log(np.linalg.eigvalsh(whitened)) ** 2).sum(1))
    assert np.sqrt(np.mean(distance**2)) == pytest.approx(0.2 * np.sqrt(10.0), rel=0.05)
    assert np.log(found[:, 3, 3] / 2.0).std() == pytest.approx(0.2, rel=0.1)


class TestLogs:
    @pytest.mark.parametrize("name", [*TRUTHS, *OUTSIDE])
    def test_effects_have_the_size_that_was_asked_for(self, name):
        draw = logs.draw("one", (name,), 0, 0, **{**PLAIN, "duration": 5.0, "shares": (0.04,)})
        made = logs.make_recording(draw, robot_model("arm6").bodies)
        (secret,) = made.secrets
        assert secret.share == pytest.approx(0.04, rel=0.1)
        assert set(secret.where) <= {*robot_model("arm6").joints, *robot_model("arm6").bodies}


def test_the_rivals_formulas_are_those_of_the_effects():
    """Compare each effect with the effort that the robot hides, where it moves.

    Sizes are a tenth of the usual ones, as a rival's base turns little.
    """
    rng = np.random.default_rng(2)
    for case in CASES:
        separation = study.separation_of(case)
        pair = next(p for p in separation.pairs if p.truth == case.truth)
        q, v, a = rng.uniform(0.3, 1.0, (3, 50, 2))
        v[::2] *= -1.0
        columns = separation.target.measure(Motion(q, v, a)).regressor
        at = np.flatnonzero(pair.effects.any(axis=0))
        size = 0.1 * case.size
        effort = columns[:, :, at] @ (size * np.array(case.parameters))
        seen = case.seen(lambda t, moved=(q, v, a): moved, np.arange(50.0))
        expected = case.effort(seen, size)
        np.testing.assert_allclose(effort, expected, rtol=1e-3, atol=1e-4)


def test_a_motion_in_one_direction_is_diagnosed():
    """For some effects there are neither data nor a prior, so they stay as they are."""
    case = next(case for case in CASES if case.motion == "sweep")
    motion = MOTIONS["sweep"][0](np.random.default_rng(0))
    log = study.measured(study.Draw(CASES.index(case), 0), "first", case.size, motion, study.FIRST)
    found = diagnose(study.known_model(), [log])
    assert study.stands(found, case.truth) or study.stands(found, case.rival)


def test_the_command_that_diagnose_prints_designs_the_motion(tmp_path):
    """The command line alone leads from an ambiguous log to a motion."""
    case = CASES[1]
    motion = MOTIONS[case.motion][0](np.random.default_rng(0))
    log = study.measured(study.Draw(1, 0), "first", case.size, motion, study.FIRST)
    write_log(log, tmp_path / "first.csv")
    robot_path = MODELS / "double_pendulum.urdf"
    said = told("diagnose", robot_path, tmp_path / "first.csv")
    pair = "coulomb_friction,load_dependent_friction@elbow"
    (words,) = re.findall(rf"- geodrake (excite \S+ --tell-apart {pair})", said)
    words = words.split()
    file = tmp_path / "motion.csv"
    fast = ("--seeds", 1, "--iterations", 5, "--limits", "velocity=1,acceleration=5")
    said = told(*words, *fast, "--noise", study.NOISE, "--save", file)
    assert "The hardest to distinguish are" in said
    assert np.abs(read_log(file).velocity).max() <= 1.0 + 1e-6


def test_controllers_are_compared(tmp_path):
    table = tmp_path / "table.json"
    call("wam_adaptation", "--quick", "--controllers", "--json", table)
    rows = json.loads(table.read_text(encoding="utf-8"))["summary"]
    found = {(row["controller"], row["noise"] > 0.0, row["law"]) for row in rows}
    assert len(found) == len(rows) == 16
    assert not any(row["lost"] for row in rows if row["law"] != laws.EUCLIDEAN)


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_recording_change_a_log_and_keep_its_motion(fault):
    """Rows stay in order, and most of them as they were measured."""
    rng, time = np.random.default_rng(4), np.arange(0.0, 20.0, 0.008)
    angles = np.sin(time[:, None] * [1.1, 1.7])
    speeds = np.gradient(angles, time, axis=0) + 1e-3 * rng.normal(size=angles.shape)
    log = JointLog("log", ("a", "b"), time, angles, 3.0 * angles + speeds, speeds)
    found = spoiled(log, (fault,), np.array([10.0, 10.0]), np.random.default_rng(5))
    assert 0.7 * len(time) < len(found.time) <= len(time)
    rows = np.searchsorted(time, found.time - 0.008)
    assert np.abs(found.position - log.position[rows]).max() < 0.05
    assert np.median(np.abs(found.effort - log.effort[rows])) < 0.15
    same = [np.array_equal(getattr(found, n), getattr(log, n)) for n in ("time", "position")]
    same += [np.array_equal(getattr(found, n), getattr(log, n)) for n in ("effort", "velocity")]
    assert not all(same)
