"""`geodrake excite`: motions within limits, and files that can be read again."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from commands import refused, run, told
from excitation_robots import MODELS
from own_code import effect
from pendulum_logs import PENDULUM
from yaml import safe_load

from geodrake.boundary.interrupts import StopSearch
from geodrake.cli.excite import limits_of, rivals_in
from geodrake.cli.identify import named_effects
from geodrake.effects import CoulombFriction, FittedEffect
from geodrake.errors import ArgumentError
from geodrake.excitation.design import design_excitation
from geodrake.excitation.tell_apart import separation_of
from geodrake.logs import Motion, read_log
from geodrake.model import EffortSignal, load_model

SOON = ("--seeds", 1, "--iterations", 12)
FAST = (*SOON, "--samples", 40, "--duration", 4, "--harmonics", 2)

BALLS = """<robot name="balls"><link name="base"/>
  <link name="a"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>
  <joint name="j" type="revolute"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="{effort}" velocity="2"/></joint></robot>"""


def excite(*arguments):
    return told("excite", *arguments)


def test_everything_is_written(tmp_path):
    names = {"--save": "m.csv", "--json": "n.json", "--report": "r.html", "--meshcat": "m.html"}
    files = [word for option, name in names.items() for word in (option, tmp_path / name)]
    limits = ("--limits", "velocity=50%,elbow.acceleration=6", "--limits", "shoulder.position=-1:1")
    output = excite(PENDULUM, *FAST, *limits, "--effects", "coulomb_friction", *files)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names.values())
    assert not re.search("[─━│\x1b]", output)
    assert "Saved the motion: " in output and "better than the best random" in output

    numbers = json.loads((tmp_path / "n.json").read_text())
    model = load_model(PENDULUM)
    log = read_log(tmp_path / "m.csv")
    assert log.joints == model.joints
    assert log.time[-1] == pytest.approx(4.0)
    full = limits_of(None, model)
    assert (np.abs(log.velocity) <= 0.5 * full.velocity + 1e-9).all()
    assert np.abs(log.position[:, 0]).max() <= 1.0 + 1e-9
    assert np.abs(log.acceleration[:, 1]).max() <= 6.0 * (1 + 1e-6)
    expected = model.effort(Motion(log.position, log.velocity, log.acceleration))
    np.testing.assert_allclose(log.effort, expected, atol=1e-6)
    np.testing.assert_allclose(log.velocity[[0, -1]], 0.0, atol=1e-7)
    assert numbers["command"] == "excite" and numbers["value"] > 0
    assert len(numbers["eigenvalues"]) > 2 and numbers["improvement_over_random"] >= 1.0
    assert numbers["use"]["shoulder"]["position"] <= 1.0 + 1e-6
    assert "chart-motion" in (tmp_path / "r.html").read_text()
    assert "animation" in (tmp_path / "m.html").read_text()


def test_an_interrupted_design_is_written(monkeypatch):
    def told(progress):
        if progress.evaluations == 3:
            raise StopSearch

    def stopped(*given, **settings):
        return design_excitation(*given, **{**settings, "progress": told})

    monkeypatch.setattr("geodrake.cli.excite.design_excitation", stopped)
    result = run("excite", PENDULUM, *FAST, "--save", "m.csv", "--json", "m.json")
    assert result.exit_code == 130
    assert "the search was interrupted: a longer one" in result.output
    assert len(np.loadtxt("m.csv", delimiter=",", skiprows=1)) > 10
    assert json.loads(Path("m.json").read_text())["interrupted"] is True


def test_ros_trajectory_and_spline_are_the_same_again():
    settings = ("--trajectory", "spline", "--points", 9, "--criterion", "d_optimality")
    common = (*SOON, "--samples", 40, "--duration", 3, "--rate", 20, "--start", "0.2")
    for file in ("a.yaml", "b.yaml"):
        excite(PENDULUM, *common, *settings, "--save", file)
    message, again = (safe_load(Path(file).read_text()) for file in ("a.yaml", "b.yaml"))
    assert message == again
    assert message["joint_names"] == ["shoulder", "elbow"]
    assert len(message["points"]) == 61
    assert message["points"][0]["positions"] == pytest.approx([0.2, 0.2])
    assert message["points"][-1]["velocities"] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_free_samples_and_standard_output():
    free = ("--trajectory", "free", "--samples", 12, "--limits", "acceleration=10")
    result = run("excite", PENDULUM, *free, *SOON, "--json", "-")
    assert json.loads(result.stdout)["motion"]["family"] == "samples"


def test_collision_geometry_counts():
    ball = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
    lost = '<collision><geometry><mesh filename="package://nowhere/a.obj"/></geometry></collision>'
    for name, shape, effort in (("with", ball, 20), ("bare", "", 20), ("lost", lost, 20),
                                ("weak", "", 0.1)):  # fmt: skip
        Path(f"{name}.urdf").write_text(BALLS.format(shape=shape, effort=effort))
    assert "bare.urdf has no collision geometry" in excite("bare.urdf", *FAST)
    assert "which --obstacle needs" in refused("excite", "bare.urdf", "--obstacle", "floor:-1")
    assert "self-collisions were not checked" in excite("with.urdf", *FAST, "--no-collisions")
    assert "collision" not in excite("with.urdf", *FAST)
    assert "--no-collisions" in refused("excite", "lost.urdf", *FAST)
    assert "joint 'j' needs" in refused("excite", "weak.urdf", *FAST)
    for obstacle in ("floor:0.5", "box:4,4,4@0,0,0"):  # through the robot, and about it
        given = ("--quiet", "--obstacle", obstacle)
        assert "collides in all of" in refused("excite", "with.urdf", *FAST, *given)


class TestTellApart:
    PAIR = "coulomb_friction,load_dependent_friction"

    def test_everything_is_written(self, tmp_path):
        names = {"--save": "m.yaml", "--json": "n.json", "--report": "r.html"}
        files = [word for option, name in names.items() for word in (option, tmp_path / name)]
        limits = ("--limits", "velocity=4,acceleration=15")
        output = excite(PENDULUM, *FAST, *limits, "--tell-apart", f"{self.PAIR}@elbow", *files)
        assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names.values())
        assert "The hardest to distinguish are" in output
        assert "best imitation" not in output  # only on the page
        numbers = json.loads((tmp_path / "n.json").read_text())
        assert numbers["criterion"] == "separation"
        assert numbers["motion"]["frequency"] == pytest.approx(2 * np.pi * 3 / 4.0)
        assert {(p["truth"], p["rival"]) for p in numbers["pairs"]} == {
            ("coulomb_friction", "load_dependent_friction"),
            ("load_dependent_friction", "coulomb_friction"),
        }
        assert {tuple(p["where"]) for p in numbers["pairs"]} == {("elbow",)}
        least = min(p["deviations"] for p in numbers["pairs"])
        assert numbers["value"] == pytest.approx(least**-2)
        assert numbers["improvement_over_random"] > 1.2
        page = (tmp_path / "r.html").read_text()
        assert "Distinguishable effects" in page and "chart-pairs" in page

    def test_places_of_different_kinds_and_an_effect_of_the_users_own(self, tmp_path):
        unit = '"coefficient", "N·m·s³/rad³", lower=0.0'
        own = effect("return [joint.v**3]", name="cubic_friction", parameter=unit)
        (tmp_path / "own.py").write_text(own)
        pair = ("--tell-apart", "cubic_friction@elbow,gravity_tilt", "--effects", "own.py")
        output = excite(PENDULUM, *FAST, *pair, "--noise", 50)
        assert "Such a log will hardly distinguish them" in output
        assert "gravity_tilt the whole robot cubic_friction" in output
        assert "cubic_friction elbow gravity_tilt" in output

    def test_effects_of_a_saved_model_keep_their_size(self):
        model = load_model(PENDULUM)
        friction = FittedEffect(CoulombFriction("elbow"), np.array([0.05]))
        robot, pair = replace(model, effects=(friction,)), rivals_in(f"{self.PAIR}@elbow")
        separation, notes = separation_of(robot, *pair, limits_of(None, model), noise=0.1)
        assert separation.pairs[0].effects.max() == 0.05
        assert "effects have the sizes in the model" in notes[0]

    def test_effects_that_contain_their_rival_are_noted(self):
        model = load_model(PENDULUM)
        pair = rivals_in("coulomb_friction,asymmetric_friction")
        separation, notes = separation_of(model, *pair, limits_of(None, model), noise=0.1)
        assert {p.truth for p in separation.pairs} == {"asymmetric_friction"}
        assert notes[0] == (
            "asymmetric_friction can explain any effort of coulomb_friction, so only the reverse "
            "can be tested"
        )


class TestLimits:
    model = load_model(PENDULUM)

    def test_in_all_their_forms(self):
        plain = limits_of(None, self.model)
        given = ["0.5", "velocity=1.5,elbow.velocity=2", "acceleration=8", "elbow.effort=50%"]
        limits = limits_of([*given, "elbow.position=-0.5:1.5"], self.model)
        np.testing.assert_allclose(limits.velocity, [0.75, 1.0])
        np.testing.assert_allclose(limits.acceleration, 4.0)
        np.testing.assert_allclose(limits.effort, plain.effort * [0.5, 0.25])
        assert (limits.lower[1], limits.upper[1]) == (0.0, 1.0)
        np.testing.assert_allclose(limits.upper[0] - limits.lower[0], plain.reach[0])

    def test_limits_of_currents_become_limits_of_efforts(self):
        signals = (EffortSignal("elbow", "current", -2.0, 0.1),)
        driven = replace(self.model, effort_signals=signals)
        plain = limits_of(None, driven)
        for text in ("current=0.3", "elbow.current=0.3"):
            effort = limits_of([text], driven).effort
            np.testing.assert_allclose(effort, [plain.effort[0], 0.6])
        np.testing.assert_allclose(limits_of(["current=1e6"], driven).effort, plain.effort)
        both = limits_of(["effort=50%,current=0.3"], driven).effort
        np.testing.assert_allclose(both, [0.5 * plain.effort[0], 0.6])
        with pytest.raises(
            ArgumentError, match="the model has no current limit to take a share of"
        ):
            limits_of(["current=50%"], driven)
        for text in ("voltage=1", "shoulder.current=1"):
            with pytest.raises(ArgumentError, match="the model computes no efforts from a"):
                limits_of([text], driven)


STANDING = """<robot name="standing"><link name="base"/>
  <joint name="yaw" type="revolute"><parent link="base"/><child link="post"/><axis xyz="0 0 1"/>
    <origin xyz="0 0 0.3"/><limit lower="-2" upper="2" velocity="2" effort="50"/></joint>
  <link name="post"><inertial><mass value="2"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0"
    ixz="0" iyz="0"/></inertial></link>
  <joint name="pitch" type="revolute"><parent link="post"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="{lower}" upper="{upper}" velocity="3" effort="50"/></joint>
  <link name="arm"><inertial><origin xyz="0.2 0 0"/><mass value="1"/><inertia ixx="0.01"
    iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.5 0 0"/><geometry><sphere radius="0.05"/></geometry></collision>
  </link></robot>"""


def lowest_of(folder, *options, lower=-3.0, upper=3.0):
    """Return the least height of the arm's sphere in a motion by Pinocchio, m; and the output."""
    model, motion = folder / "standing.urdf", folder / "motion.csv"
    model.write_text(STANDING.format(lower=lower, upper=upper))
    output = excite(model, *SOON, "--seconds", 30, "--save", motion, *options)
    table = np.genfromtxt(motion, delimiter=",", names=True, deletechars="")
    robot = pinocchio.buildModelFromUrdf(str(model))
    data, heights = robot.createData(), []
    for q in np.column_stack([table["yaw.position"], table["pitch.position"]]):
        pinocchio.forwardKinematics(robot, data, q)
        heights.append(data.oMi[2].act(np.array([0.5, 0.0, 0.0]))[2] - 0.05)
    return min(heights), output


def test_a_motion_stays_above_the_floor_that_the_robot_stands_on(tmp_path):
    height, words = lowest_of(tmp_path)
    assert height >= 0.01 - 1e-3
    assert "the robot stays above its base" in words
    height, words = lowest_of(tmp_path, "--no-floor")
    assert height < -0.05
    height, words = lowest_of(tmp_path, lower=1.2, upper=2.0)  # hangs
    assert "no floor is assumed, as the robot is below its base in every posture" in words


BIPED = MODELS / "biped.urdf"
BENT = {"leg_hpy": -0.4, "leg_kny": 0.8, "leg_aky": -0.4}


class TestFeet:
    FAST = ("--duration", 4, "--harmonics", 2, "--samples", 20, "--seeds", 1, "--iterations", 1)

    def test_compare_reads_a_motion_on_two_feet(self, tmp_path):
        """Efforts agree with the model's apart from the unknown forces at both feet."""
        motion, numbers = tmp_path / "m.csv", tmp_path / "n.json"
        joints = load_model(BIPED).joints
        bent = ",".join(f"{name}={BENT.get(name[2:], 0.0)}" for name in joints)
        stand = ("--feet", "l_foot,r_foot", "--stand", bent, *self.FAST, "--json", numbers)
        output = excite(BIPED, *stand, "--effects", "viscous_friction@l_leg_kny", "--save", motion)
        assert "Balance: on l_foot and r_foot, the zero-moment point goes up to" in output
        found = json.loads(numbers.read_text())
        assert 0.0 < found["balance"]["polygon"] <= found["balance"]["margin"] == 0.9
        assert 0.0 < found["balance"]["friction"] <= 1.0
        assert set(found["limits"]) == set(joints)
        assert "pelvis_yaw" in found["motion"]["coefficients"]
        rubbing = named_effects(["viscous_friction"], load_model(BIPED, floating=True))
        assert {effect.where[0] for effect in rubbing} == set(joints)  # and none of the base
        told("compare", BIPED, motion, "--floating", "--json", numbers, "--quiet")
        error = json.loads(numbers.read_text())["error"]
        assert error["nrms"] < 0.03
        pair = ("--tell-apart", "coulomb_friction,load_dependent_friction@l_leg_kny")
        said = refused("excite", BIPED, *stand, *pair)
        assert "load_dependent_friction of l_leg_kny depends on the load there" in said

    def test_a_force_plate_under_one_foot(self, tmp_path):
        numbers = tmp_path / "n.json"
        plate = ("--feet", "l_foot", "--force-plate", "--friction", 0.7)
        output = excite(BIPED, *plate, *self.FAST, "--json", numbers)
        assert "of the friction coefficient 0.7" in output and "1 % of the weight" in output
        noise = json.loads(numbers.read_text())["noise"]
        assert noise["fz"] == pytest.approx(0.01 * 9.81 * 57.5, rel=1e-3)
