"""`geodrake check` reports agreement with MultibodyPlant, and finds differences."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known_robots import robots
from pendulum_logs import point_pendulum
from typer.testing import CliRunner

from geodrake import load_model, save_model
from geodrake.cli.app import app
from geodrake.effects.base import FittedEffect
from geodrake.effects.bodies import Payload
from geodrake.effects.friction import ViscousFriction
from geodrake.inertia import is_physical
from geodrake.logs import Motion
from geodrake.model import check_dynamics, dynamics_check, save_export
from geodrake.model.dynamics_check import QUANTITIES
from geodrake.model.robot_model import load_description

MODELS = Path(__file__).parents[2] / "models"
ARM, DOUBLE = MODELS / "arm6.urdf", MODELS / "double_pendulum.urdf"


def off_by(share, name="inverse_dynamics"):
    """Return geodrake's dynamics, wrong by a share at the third joint."""
    real = getattr(dynamics_check, name)

    def wrong(tree, q, v, vd, *phi):
        found = real(tree, q, v, vd, *phi)
        found[:, 2] *= 1.0 + share
        return found

    return wrong


@pytest.fixture(scope="module")
def arm():
    return load_model(ARM)


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("name", ["talos_data/robots/talos_reduced.urdf", "cheetah.dmd.yaml"])
def test_robots_agree(name, floating):
    path = robots() / name if "/" in name else MODELS / name
    found = check_dynamics(load_model(path, floating=floating), samples=5)
    assert found.holds and found.worst.relative < 1e-12
    assert found.second is not None and found.second.relative < 1e-12
    assert tuple(each.quantity for each in found.agreements) == QUANTITIES
    assert all(each.size > 0 for each in found.agreements)


@pytest.mark.parametrize("name", ["inverse_dynamics", "inverse_dynamics_regressor"])
def test_a_wrong_recursion_is_found_with_its_joint(arm, monkeypatch, name):
    monkeypatch.setattr(dynamics_check, name, off_by(1e-6, name))
    found = check_dynamics(arm, samples=10)
    assert not found.holds and "elbow_pitch" in found.worst.where
    wrong = {each.quantity for each in found.agreements if not each.holds}
    regressor = {"regressor"}
    assert wrong == (regressor if "regressor" in name else {*QUANTITIES} - regressor)
    assert 1e-8 < found.worst.relative < 1e-5


def test_point_masses_are_those_of_the_file_and_fits_start_beside_them(tmp_path):
    model = load_model(point_pendulum(tmp_path / "pendulum.urdf", 0.4))
    found = check_dynamics(model, samples=5)
    assert found.holds and found.by.startswith("Pinocchio") and found.second.relative < 1e-12
    motion = Motion(*np.random.default_rng(0).uniform(-1, 1, (3, 9, 2)))
    q, v, vd = motion.q, motion.v, motion.vd  # of the textbook
    turned, both, ml2, mgl = q[:, 1], q.sum(axis=1), 2.0 * 0.4**2, 2.0 * 9.81 * 0.4
    rates, accelerations = v.sum(axis=1), vd.sum(axis=1)
    outer = ml2 * (accelerations + np.cos(turned) * vd[:, 0] + np.sin(turned) * v[:, 0] ** 2)
    outer += mgl * np.sin(both)
    inner = ml2 * (2 * vd[:, 0] + np.cos(turned) * accelerations - np.sin(turned) * rates**2)
    inner += 2 * mgl * np.sin(q[:, 0])
    efforts = np.stack([inner + outer, outer], axis=1)
    np.testing.assert_allclose(model.effort(motion), efforts, atol=1e-9)
    assert is_physical(model.with_volume.phi, tolerance=1e-6).all()
    assert not save_export(model, tmp_path / "same.urdf").links
    save_model(model, tmp_path / "saved.yaml")
    again = load_model(tmp_path / "saved.yaml")
    np.testing.assert_array_equal(again.effort(motion), model.effort(motion))


def test_what_pinocchio_does_not_read_drake_reads_once_more(tmp_path):
    elbow = '<joint name="elbow" type="revolute"'
    text = DOUBLE.read_text().replace(elbow, elbow.replace("revolute", "planar"))
    (tmp_path / "planar.urdf").write_text(text)
    found = check_dynamics(load_model(tmp_path / "planar.urdf"), samples=3)
    assert "original file (Pinocchio has other joints)" in found.by
    assert found.second is not None and found.second.relative < 1e-12


def test_the_command_prints_and_writes_and_its_exit_code_tells(tmp_path, monkeypatch):
    numbers = tmp_path / "n.json"
    words = ["check", str(ARM), "--samples", "5", "--seed", "3", "--lock", "wrist_spin=0.5"]
    done = CliRunner().invoke(app, [*words, "--json", str(numbers)])
    assert done.exit_code == 0 and "MultibodyPlant agree" in done.output
    told = json.loads(numbers.read_text())
    assert told["agrees"] and (told["samples"], told["seed"]) == (5, 3)
    assert "wrist_spin" not in told["joints"] and set(told["quantities"]) == set(QUANTITIES)
    monkeypatch.setattr(dynamics_check, "inverse_dynamics", off_by(1e-3))
    done = CliRunner().invoke(app, [*words, "--json", "-"])
    assert done.exit_code == 1 and not json.loads(done.stdout)["agrees"]
    assert "disagree" in done.stderr and "elbow_pitch" in done.stderr
    assert "Traceback" not in done.output


MJCF = """<mujoco model="m"><worldbody><body name="a"><joint name="j" axis="0 1 0" damping=".3"/>
<geom type="capsule" size=".05 .2" pos=".1 0 0"/></body></worldbody></mujoco>"""
URDF = """<robot name="r"><link name="base"/><link name="a">
<inertial><origin xyz=".1 0 0"/><mass value="2"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="continuous"><parent link="base"/><child link="a"/><axis xyz="0 1 0"/></joint>
<gazebo reference="a"><turnGravityOff>true</turnGravityOff></gazebo></robot>"""


def written(path, text):
    path.write_text(text, encoding="utf-8")
    return load_model(path)


def with_effects(model, *more):
    return replace(model, effects=(*model.effects, *more))


@pytest.mark.parametrize("name", ["m.xml", "r.urdf"])
def test_a_model_with_something_added_has_no_second_opinion(tmp_path, name):
    model = written(tmp_path / name, MJCF if name == "m.xml" else URDF)
    found = check_dynamics(model, samples=3)
    assert found.holds and found.second is not None
    payload = FittedEffect(
        Payload("a"), np.array([1.0, 0.1, *np.zeros(2), *[0.1] * 3, *np.zeros(3)])
    )
    damping = FittedEffect(ViscousFriction("j"), np.array([0.5]))
    for more in (payload, *([damping] if name == "m.xml" else [])):
        found = check_dynamics(with_effects(model, more), samples=3)
        assert found.holds and found.second is None
        assert found.by == "the model was changed after loading its file"


def test_a_model_whose_file_is_gone_has_no_second_opinion(tmp_path):
    model = written(tmp_path / "m.xml", MJCF)
    (tmp_path / "m.xml").unlink()
    found = check_dynamics(model, samples=3)
    assert found.is_rounding and found.by.startswith("the model's file cannot be read again: ")


def test_what_follows_a_held_joint_is_held_in_the_second_opinion(tmp_path):
    inner = """<body name="b" pos=".1 0 .2"><joint name="b" axis="0 1 0"/>
    <geom type="box" size=".1 .1 .2"/><body name="c" pos=".1 0 .2"><joint name="c"/>
    <geom size=".1" pos=".1 0 0"/></body></body></body>"""
    follow = '<equality><joint joint1="b" joint2="j" polycoef=".1 1 0 0 0"/></equality></mujoco>'
    text = MJCF.replace("</body>", inner).replace("</mujoco>", follow)
    (tmp_path / "m.xml").write_text(text, encoding="utf-8")
    found = check_dynamics(load_description(tmp_path / "m.xml", held={"j": 0.3}), samples=3)
    assert found.joints == ("c",) and found.holds and found.second is not None


SDF = """<sdf version="1.9"><model name="r"><link name="base"/><joint name="w" type="fixed">
<parent>world</parent><child>base</child></joint><link name="a"><inertial><pose>.1 0 0 0 0 0</pose>
<mass>2</mass><inertia><ixx>.1</ixx><iyy>.1</iyy><izz>.1</izz></inertia></inertial></link>
<joint name="j" type="revolute"><parent>base</parent><child>a</child><axis><xyz>0 1 0</xyz></axis>
</joint></model></sdf>"""


def test_entities_of_a_urdf_are_read_by_both(tmp_path):
    text = '<!DOCTYPE robot [<!ENTITY m "3">]>' + URDF.replace('value="2"', 'value="&m;"')
    found = check_dynamics(written(tmp_path / "r.urdf", text), samples=3)
    assert found.holds and found.second.relative < 1e-12


@pytest.mark.parametrize("mass", [2, 2.1])
def test_an_sdf_is_read_once_more_as_it_stands(tmp_path, mass):
    model = written(tmp_path / "r.sdf", SDF)
    model.path.write_text(SDF.replace("<mass>2", f"<mass>{mass}"))
    found = check_dynamics(model, samples=3)
    assert found.is_rounding and found.holds is (mass == 2)
    assert found.by.startswith("Drake") and found.second is not None


FREE = """<mujoco model="m"><option density="100" viscosity="1" gravity="1 2 -7"/><worldbody>
<body name="a" pos="0 0 1" quat="1 .2 .3 .1"><freejoint name="root"/>
<geom type="box" size=".1 .2 .3" pos=".1 0 0"/><body name="b" pos=".3 0 0" euler="10 20 30">
<joint name="ball" type="ball" pos=".1 0 .1" damping=".3" armature=".02"/>
<geom type="box" size=".1 .2 .3" pos=".1 0 .3"/><body name="c" pos=".3 0 0">
<joint name="h" axis="1 2 3" stiffness="2 1"/><geom type="box" size=".1 .2 .3" pos=".1 0 .3"/>
</body></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("floating", [False, True])
def test_free_bodies_and_balls_have_a_second_opinion_in_their_own_coordinates(tmp_path, floating):
    (tmp_path / "m.xml").write_text(FREE, encoding="utf-8")
    model = load_description(tmp_path / "m.xml", floating=floating)
    found = check_dynamics(model, samples=20)
    assert found.holds and len(found.joints) == (10 if floating else 4)
    assert found.second.relative < 1e-12 and found.second.size > 1.0
    wrong = FREE.replace('gravity="1 2 -7"', 'gravity="1 2 -7.001"')
    (tmp_path / "m.xml").write_text(wrong, encoding="utf-8")
    assert not check_dynamics(model, samples=20).second.holds


def test_a_floating_base_has_a_second_opinion(tmp_path):
    path = tmp_path / ARM.name
    path.write_bytes(ARM.read_bytes())
    model = load_model(path, floating=True)
    # Of 500 random pitches in half a turn either way, some would be within 0.5° of 90°.
    found = check_dynamics(model, samples=500)
    assert found.holds and found.by.startswith("Pinocchio") and found.second.relative < 1e-12
    text = path.read_text(encoding="utf-8")
    path.write_text(
        re.sub(r'mass value="([0-9.]+)"', r'mass value="\g<1>1"', text), encoding="utf-8"
    )
    assert not check_dynamics(model, samples=20).second.holds


BENT = """<mujoco model="r"><compiler angle="radian"/><worldbody><body name="a" pos="0 0 .3">
<joint name="a" axis="0 1 .2"/><geom type="box" size=".05 .04 .1" pos=".1 0 .05"/>
<body name="t" pos=".1 0 .2"><joint name="t" axis="0 1 0" {}/>
<geom type="box" size=".05 .04 .1" pos=".1 0 .05"/></body></body></worldbody><equality>
<joint joint1="t" joint2="a" polycoef=".1 .5 .3 0 0"/></equality>{}</mujoco>"""
TENDON = """<tendon><fixed name="p" stiffness="5" springlength=".3" damping=".3" armature=".1">
<joint joint="a" coef="1"/><joint joint="t" coef="2"/></fixed></tendon>"""


@pytest.mark.parametrize("tendon", ["", TENDON])
def test_what_a_joint_has_that_follows_along_a_curve_is_no_bug(tmp_path, tendon):
    has = 'damping=".1 .2 .3" armature=".1" stiffness="2 1 -1"'
    found = check_dynamics(written(tmp_path / "m.xml", BENT.format(has, tendon)), samples=10)
    assert found.holds and found.joints == ("a",) and found.second.relative < 1e-12
