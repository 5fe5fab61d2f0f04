"""Effects that files state, in models with held joints, followers, motors, and in other files."""

import dataclasses

import mujoco
import numpy as np
import pytest
from mujoco_efforts import mujoco_efforts
from pydrake.systems.framework import DiagramBuilder

from geodrake import load_model, save_model
from geodrake.control.export_proof import export_to
from geodrake.effects import FittedEffect, catalogue, make_effect
from geodrake.effects.lookup import file_effects
from geodrake.errors import ArgumentError
from geodrake.logs import Motion
from geodrake.model import check_dynamics, holding

ARM = """<mujoco model="r"><option density="900" viscosity="2" wind=".3 -.1 .2"/><worldbody>
<site name="w" pos=".4 .3 .8"/><body name="a" pos="0 0 .3" gravcomp=".4"><site name="s"/>
<joint name="a" axis="0 1 .2" pos=".02 0 0"/>
<geom type="box" size=".05 .04 .1" pos=".1 0 .05"/>
<body name="b" pos=".1 0 .2"><joint name="b" axis="0 1 0" stiffness="3 1 -2" springref="20"/>
<geom type="capsule" size=".05 .1" pos="0 .1 .05"/>
<body name="c" pos=".1 0 .2" gravcomp="1.2"><joint name="c" axis="1 0 .3" stiffness="2"/>
<geom type="box" size=".05 .04 .1" pos=".1 0 .05"/><site name="u" pos=".1 .1 0"/></body></body>
</body></worldbody><tendon><spatial stiffness="30" damping="2" springlength=".3"><site site="w"/>
<site site="u"/></spatial><spatial stiffness="9"><site site="s"/><site site="u"/></spatial>
<fixed name="p" stiffness="5" springlength=".3" damping=".3" armature=".1">
<joint joint="a" coef="1"/><joint joint="b" coef="2"/><joint joint="c" coef="-.7"/></fixed></tendon>
{}</mujoco>"""
FOLLOWS = '<equality><joint joint1="c" joint2="a" polycoef=".2 -.5 0 0 0"/></equality>'


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(""), encoding="utf-8")
    return path


def theirs(path, *motion):
    """Return MuJoCo's efforts (N, nv) of its own coordinates."""
    return mujoco_efforts(mujoco.MjModel.from_xml_path(str(path)), "abc", *motion)


def random(count):
    return np.random.default_rng(3).uniform(-1, 1, (3, 8, count))


def test_a_held_joint_still_pulls(arm):
    q, v, vd = (
        np.insert(x, 2, value, axis=1) for x, value in zip(random(2), (0.4, 0, 0), strict=True)
    )
    expected = theirs(arm, q, v, vd)[:, :2]
    own = Motion(q[:, :2], v[:, :2], vd[:, :2])
    for model in (load_model(arm, lock={"c": 0.4}), holding(load_model(arm), {"c": 0.4})):
        assert model.joints == ("a", "b")
        np.testing.assert_allclose(model.effort(own), expected, atol=1e-9)
        assert not [note for note in model.notes if note.startswith("Not used")]


def test_a_held_joint_of_a_model_that_was_changed_is_told_of(arm):
    model = load_model(arm)
    held = holding(with_offset(model), {"c": 0.4})
    (said,) = [note for note in held.notes if note.startswith("Not used")]
    assert "joint_coupling of a & c" in said and "carried_weight of c" in said


def test_what_follows_pulls_at_its_leader(arm):
    arm.write_text(ARM.format(FOLLOWS), encoding="utf-8")
    model = load_model(arm)
    assert model.joints == ("a", "b") and not model.left_out
    J, (q, v, vd) = np.array([[1, 0], [0, 1], [-0.5, 0]]), random(2)
    whole = (q @ J.T + [0, 0, 0.2], v @ J.T, vd @ J.T)
    np.testing.assert_allclose(model.effort(Motion(q, v, vd)), theirs(arm, *whole) @ J, atol=1e-9)
    assert check_dynamics(model, samples=5).holds


def test_motors_that_compensate_gravity_bear_it_behind_followers_and_held_joints_too(arm):
    """MuJoCo's own: what the motor of b gives against gravity is none of the passive forces."""
    text = ARM.format("").replace('axis="0 1 0"', 'axis="0 1 0" actuatorgravcomp="true"')
    arm.write_text(text, encoding="utf-8")
    model, motion = load_model(arm), random(3)
    np.testing.assert_allclose(model.effort(Motion(*motion)), theirs(arm, *motion), atol=1e-9)
    carried = [f.effect.where for f in model.effects if f.effect.name == "carried_weight"]
    assert carried == [("a", "world"), ("c", "world"), ("c", "a"), ("c", "b")]
    q, v, vd = (np.insert(x, 1, y, axis=1) for x, y in zip(random(2), (0.4, 0, 0), strict=True))
    held = load_model(arm, lock={"b": 0.4})
    own = Motion(*(np.delete(x, 1, axis=1) for x in (q, v, vd)))
    np.testing.assert_allclose(held.effort(own), theirs(arm, q, v, vd)[:, ::2], atol=1e-9)
    arm.write_text(text.replace("</mujoco>", f"{FOLLOWS}</mujoco>"), encoding="utf-8")
    J, (q, v, vd) = np.array([[1, 0], [0, 1], [-0.5, 0]]), random(2)
    whole = (q @ J.T + [0, 0, 0.2], v @ J.T, vd @ J.T)
    found = load_model(arm).effort(Motion(q, v, vd))
    np.testing.assert_allclose(found, theirs(arm, *whole) @ J, atol=1e-9)


@pytest.mark.parametrize("coupled", [False, True])
def test_what_pulls_at_joints_pulls_at_their_motors(arm, coupled):
    """Behind a coupled wrist, springs of joints are those of no motor, and are told of."""
    gears = "gears:\n- {actuator: m, joint: c, ratio: -4, offset: 0.1}\n"
    wrist = "coupled:\n- {joints: {b: {m1: 0.5, m2: 0.5}, c: {m1: 0.3, m2: -0.3}}}\n"
    if coupled:
        text = arm.read_text(encoding="utf-8").replace('stiffness="2"', "")
        arm.write_text(text.replace('stiffness="3 1 -2"', ""), encoding="utf-8")
    way = arm.with_name("motors.yaml")
    way.write_text(wrist if coupled else gears, encoding="utf-8")
    model = load_model(arm, transmission=way)
    q, v, vd = random(3)
    (J,) = model.coordinates.jacobian(np.zeros((1, 3)))
    start = model.coordinates.joint_positions(np.zeros((1, 3)))
    whole = q @ J.T + start, v @ J.T, vd @ J.T
    np.testing.assert_allclose(model.effort(Motion(q, v, vd)), theirs(arm, *whole) @ J, atol=1e-9)
    assert not model.left_out


def test_a_saved_model_has_them(arm, tmp_path):
    model, motion = load_model(arm), Motion(*random(3))
    save_model(model, tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    saved = (tmp_path / "model.yaml").read_text(encoding="utf-8")
    (tmp_path / "model.yaml").write_text(saved.replace("where: [c, world]", "where: [c]"))
    assert [f.effect for f in load_model(tmp_path / "model.yaml").effects] == [
        f.effect for f in again.effects
    ]
    assert saved.count("where: [c, world]") == 1
    assert [each.effect for each in again.effects] == [each.effect for each in model.effects]
    np.testing.assert_allclose(again.effort(motion), model.effort(motion), rtol=1e-14)


def test_a_simulation_has_them(arm):
    model, q, v = load_model(arm), *random(3)[:2, 0]
    builder = DiagramBuilder()
    model.add_to_builder(builder)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    context.SetContinuousState(np.concatenate([q, v]))
    rates = diagram.EvalTimeDerivatives(context).CopyToVector()[3:]
    data = mujoco.MjData(reference := mujoco.MjModel.from_xml_path(str(arm)))
    reference.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(reference, data)
    np.testing.assert_allclose(rates, data.qacc, rtol=1e-7)


def with_offset(model):
    offset = FittedEffect(make_effect("effort_offset", ["a"]), np.array([1.0]))
    return dataclasses.replace(model, effects=(*model.effects, offset))


def test_an_mjcf_holds_them_as_long_as_the_model_is_that_of_its_file(arm, tmp_path):
    model = load_model(arm)
    same = export_to("mjcf", model, tmp_path / "same")
    assert not same.lacks and all(each.is_rounding for each in same.proof.differences)
    text = arm.read_text(encoding="utf-8")
    assert (tmp_path / "same" / "arm.xml").read_text(encoding="utf-8") == text
    other = export_to("mjcf", with_offset(model), tmp_path / "other")
    assert {"strut", "carried_weight", "medium_drag"} < {each.effect for each in other.lacks}
    assert len(other.proof.differences) == 2
    assert all(each.is_rounding for each in other.proof.differences)


def test_nobody_proposes_them():
    assert len(file_effects()) == 10 and not set(file_effects()) & set(catalogue())
    assert all(effect.law and effect.signature for effect in file_effects())
    with pytest.raises(ArgumentError, match="no effect 'medium_drags'"):
        make_effect("medium_drags", ["a"])
