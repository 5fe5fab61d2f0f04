"""Closed loops against MuJoCo's constrained dynamics, and against differences of positions."""

import re
from dataclasses import replace

import numpy as np
import pytest
from closed_loops import (
    BARS,
    CONNECT,
    Constrained,
    dynamics,
    four_bar,
    four_bar_sdf,
    gripper,
    leg,
    leg_sdf,
    sdf,
    underactuated,
)
from pydrake.systems.framework import DiagramBuilder

from geodrake import load_model, save_model
from geodrake.errors import ArgumentError, ModelError
from geodrake.logs import Motion
from geodrake.model import holding
from geodrake.model.dynamics_check import check_dynamics
from geodrake.robot import joint_names

COUPLER, ROCKER = 'diaginertia=".003 .004 .0025"/>', 'diaginertia=".005 .004 .0035"/>'


def by_sites():
    site = '<site name="{}" pos="{}" euler="1 2 3"/>'
    text = four_bar('<connect site1="p" site2="q"/>')
    text = text.replace(COUPLER, COUPLER + site.format("p", ".25 0 .1"))
    return text.replace(ROCKER, ROCKER + site.format("q", ".05 0 .2"))


ROBOTS = {
    "a four-bar": (four_bar(), "crank"),
    "closed at sites": (by_sites(), "crank"),
    "driven at the rocker": (four_bar(motors="rocker"), "rocker"),
    "a parallel gripper": (gripper(), "arm left"),
    "fingers that follow by a polynomial": (gripper("0 -1 .3 .1 0"), "arm left"),
    "an underactuated gripper": (underactuated(), "right_bar left left_bar"),
}


def load(folder, text, **options):
    path = folder / "robot.xml"
    path.write_text(text)
    return load_model(path, **options)


def states(model, count=6, seed=0, spread=0.6):
    rng, nv = np.random.default_rng(seed), len(model.joints)
    lower, upper = (np.clip(ends, -spread, spread) for ends in model.position_limits)
    return rng.uniform(lower, upper, (count, nv)), *rng.uniform(-2, 2, (2, count, nv))


def in_mujoco(model, constrained, q):
    """Return a posture (nq,) of the model in MuJoCo's order of the joints of the same names."""
    qpos, places = np.array(constrained.m.qpos0), model.plant_positions(q[None])[0]
    for k in range(constrained.m.njnt):
        joint = constrained.m.joint(k)
        qpos[joint.qposadr[0]] = places[model.plant.GetJointByName(joint.name).position_start()]
    return qpos


def assert_as_mujoco(model, constrained, motion, close=1e-10, share=1e-6):
    """Check that efforts (N, n) are those of MuJoCo with its own closed constraints."""
    for q, v, vd in zip(*motion, strict=True):
        ours = in_mujoco(model, constrained, q)
        qpos, G = constrained.closed(ours)
        assert np.abs(qpos - ours).max() < close
        qacc = G @ vd + constrained.bias(qpos, G, v)
        expected = G.T @ constrained.inverse(qpos, G @ v, qacc)
        found = model.effort(Motion(q[None], v[None], vd[None]))[0]
        assert np.abs(found - expected).max() <= share * np.abs(expected).max()


def test_a_leg_with_a_rod_between_balls_is_mujocos(tmp_path):
    """MuJoCo's has three hinges about the same axes in the place of the ball."""
    assert_has_a_spinning_rod(load(tmp_path, leg()), leg())


def assert_has_a_spinning_rod(model, text):
    """Check that a model is a leg in MJCF with three hinges in the place of the ball of a rod."""
    rod = "rod_1", "rod_2", "rod_spin"
    assert set(model.joints) == {"hip", "knee", "shin", "heel", "crank", "rod_spin"}
    assert any("rod_1, rod_2, rod_spin" in note for note in model.notes)
    axes = [model.plant.GetJointByName(name).revolute_axis() for name in rod]
    assert np.allclose(axes[2] * np.linalg.norm([0.31, -0.02, -0.41]), [0.31, -0.02, -0.41])
    hinges = "".join(
        f'<joint name="{name}" axis="{" ".join(map(repr, axis.tolist()))}"/>'
        for name, axis in zip(rod, axes, strict=True)
    )
    text = text.replace('<joint name="rod" type="ball"/>', hinges)
    assert_as_mujoco(model, Constrained.of(text, model.joints), states(model, spread=0.15))


BARE_LEG = re.sub(' armature="[^"]*"', "", leg())


def test_an_sdf_of_a_leg_with_a_rod_between_balls_is_its_twin(tmp_path):
    (tmp_path / "robot.sdf").write_text(leg_sdf())
    model = load_model(tmp_path / "robot.sdf")
    assert not model.left_out
    assert_has_a_spinning_rod(model, BARE_LEG)
    assert check_dynamics(model).holds
    motion = Motion(*states(model, spread=0.15))
    save_model(model, tmp_path / "m.yaml")
    again = load_model(tmp_path / "m.yaml")
    np.testing.assert_allclose(again.effort(motion), model.effort(motion), rtol=1e-12)


def test_damping_of_a_ball_of_an_sdf_in_a_loop_is_told(tmp_path):
    damped = "<axis><xyz>0 0 1</xyz><dynamics><damping>.3</damping></dynamics></axis>"
    parts = "<child>rod_link</child>", f"<child>rod_link</child>{damped}"
    (tmp_path / "robot.sdf").write_text(leg_sdf().replace(*parts))
    model = load_model(tmp_path / "robot.sdf")
    words = "The damping of ball joint rod of a closed loop is that of each hinge"
    assert words in " ".join(model.left_out)
    rod = {f.effect.place for f in model.effects if f.effect.name == "viscous_friction"}
    assert rod == {"tarsus", "rod_1", "rod_2", "rod_spin"}


def test_an_sdf_of_a_leg_with_a_universal_joint_is_its_twin(tmp_path):
    (tmp_path / "robot.sdf").write_text(leg_sdf("universal"))
    model = load_model(tmp_path / "robot.sdf")
    assert set(model.joints) == {"hip", "knee", "shin", "heel", "crank"} and not model.left_out
    assert (
        "The universal joint rod of a closed loop is read as the hinges rod_1, rod_2."
        in model.notes
    )
    hinges = (
        '<joint name="rod_1" axis="1 0 0" damping=".3"/>'
        '<joint name="rod_2" axis="0 1 0" damping=".4"/>'
    )
    text = BARE_LEG.replace('<joint name="rod" type="ball"/>', hinges)
    (dry,) = (f for f in model.effects if f.effect.name == "coulomb_friction")
    assert (dry.effect.where, dry.parameters.tolist()) == (("rod_1",), [0.2])
    model = replace(model, effects=tuple(f for f in model.effects if f is not dry))
    assert_as_mujoco(model, Constrained.of(text, model.joints), states(model, spread=0.15))


def test_a_loop_keeps_its_branch_whatever_the_order_of_samples(tmp_path):
    model = load(tmp_path, four_bar())
    (drive,) = model.transmission
    q = np.linspace(-6.0, 6.0, 301)[:, None]  # the crank goes around
    theta = drive.map.joint_positions(q)
    assert np.abs(np.diff(theta, axis=0)).max() < 0.2
    order = np.random.default_rng(0).permutation(len(q))
    np.testing.assert_allclose(drive.map.joint_positions(q[order]), theta[order], atol=1e-12)
    again = drive.map.joint_positions(q + 2.0 * np.pi)
    turns = (again - drive.map.joint_positions(q)) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.broadcast_to(np.round(turns[0]), turns.shape), atol=1e-9)


def test_a_loop_that_reaches_its_end_says_where(tmp_path):
    flat = four_bar(CONNECT.replace("0 0.1", "0 0.02"))
    flat = flat.replace('pos="0.3 0 -0.1"', 'pos="0.42 0 0"')
    model = load(tmp_path, flat)
    (drive,) = model.transmission
    (low,), (high,) = drive.map.range
    assert np.isfinite([low, high]).all() and low < 0.0 < high
    at_end = drive.map.jacobian(np.array([[low], [high]]))
    assert np.abs(at_end).max() > 3.0  # near a dead point
    with pytest.raises(ArgumentError, match=r"does not close at crank = .*it ends at crank ="):
        drive.map.joint_positions(np.array([[high + 0.1]]))
    assert (drive.map.inside(np.array([[9.0]])) <= high + 1e-6).all()
    assert model.position_limits[1][0] == pytest.approx(high, abs=1e-2)
    assert check_dynamics(model).holds


@pytest.mark.parametrize("name", ROBOTS)
def test_efforts_and_motions_are_mujocos_through_its_own_constraints(tmp_path, name):
    text, free = ROBOTS[name]
    model, constrained = load(tmp_path, text), Constrained.of(text, free.split())
    assert model.joints == tuple(free.split()) and not model.left_out
    assert_as_mujoco(model, constrained, states(model))
    builder = DiagramBuilder()
    robot = model.add_to_builder(builder)
    root = builder.Build().CreateDefaultContext()
    at_motors = robot.effort.get_system().GetMyMutableContextFromRoot(root)
    plant, theirs = (
        robot.plant,
        [constrained.m.joint(name).dofadr[0] for name in joint_names(model.plant)],
    )
    ours = [plant.GetJointByName(name).velocity_start() for name in joint_names(model.plant)]
    for q, v, effort in zip(*states(model, 3), strict=True):
        qpos, G = constrained.closed(in_mujoco(model, constrained, q))
        applied = np.zeros(constrained.m.nv)
        applied[constrained.free] = effort
        expected = constrained.acceleration(qpos, G @ v, applied)[theirs]
        robot.set_state(root, q, v)
        robot.effort.FixValue(at_motors, effort)
        port = plant.get_generalized_acceleration_output_port()
        found = port.Eval(plant.GetMyContextFromRoot(root))[ours]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_check_holds_and_sees_a_loop_that_is_not_mujocos(tmp_path, monkeypatch):
    found = check_dynamics(load(tmp_path, gripper()))
    assert found.holds and found.second is not None and found.second.relative < 1e-10
    monkeypatch.setattr("geodrake.robot.files.mjcf_source.pose_of", wrong_pose)
    with pytest.raises(ModelError, match="closes its loops differently from MuJoCo"):
        load(tmp_path, by_sites())


def wrong_pose(position, quaternion):
    from geodrake.robot.files.mjcf import pose_of

    return pose_of(np.array(position) + 0.01, quaternion)


def test_a_held_joint_holds_all_of_its_loop(tmp_path):
    model = load(tmp_path, gripper())
    q, v, vd = states(model, 3)
    at = [np.column_stack([x[:, :1], np.full(3, y)]) for x, y in ((q, 0.3), (v, 0), (vd, 0))]
    own, expected = Motion(q[:, :1], v[:, :1], vd[:, :1]), model.effort(Motion(*at))[:, :1]
    for held in (holding(model, {"left": 0.3}), load(tmp_path, gripper(), lock={"left": 0.3})):
        assert held.joints == ("arm",)
        np.testing.assert_allclose(held.effort(own), expected, rtol=1e-12)
    save_model(held, tmp_path / "held.yaml")
    again = load_model(tmp_path / "held.yaml")
    np.testing.assert_array_equal(again.effort(own), held.effort(own))
    with pytest.raises(ModelError, match=r"not close with left at 0\.3, left_bar at 0\.9"):
        load(tmp_path, gripper(), lock={"left": 0.3, "left_bar": 0.9})


def test_what_a_ball_of_a_loop_has_is_told(tmp_path):
    ball = '<joint name="rod" type="ball"'
    model = load(tmp_path, leg().replace(ball, f'{ball} damping=".1" stiffness="2"'))
    assert "The stiffness of ball joint rod of a closed loop is ignored." in model.left_out
    assert any("damping of ball joint rod" in words for words in model.left_out)
    assert not check_dynamics(model, samples=2).holds
    assert not load(tmp_path, leg()).left_out
    motor = f'<motor joint="{model.joints[0]}"/><motor name="m" joint="rod" {{}}/></actuator>'
    for more, told in (("", False), ('armature=".1"', True)):
        text = leg().replace("</actuator>", motor.format(more))
        left_out = load(tmp_path, text).left_out
        assert ("The actuator m of ball joint rod of a closed loop is ignored." in left_out) is told


def test_what_does_not_move_is_held_and_said(tmp_path):
    other = '<body name="x"><joint name="x"/><geom size=".1"/></body></worldbody>'
    text = four_bar(CONNECT + '<weld body1="crank"/>', motors="")
    model = load(tmp_path, text.replace("</worldbody>", other))
    assert model.joints == ("x",) and set(model.held) == {"crank", "coupler", "rocker"}
    assert any(
        "Fixed, as constraints of the file do not let them move: crank at 0" in n
        for n in model.notes
    )


def test_an_equality_that_is_not_active_is_not_used(tmp_path):
    off = CONNECT.replace("/>", ' active="false"/>')
    model = load(tmp_path, four_bar(off))
    assert set(model.joints) == {"crank", "coupler", "rocker"} and not model.left_out
    assert any("<connect> of coupler and rocker is inactive" in note for note in model.notes)
    off = '<option><flag equality="disable"/></option>'
    model = load(tmp_path, four_bar().replace("<worldbody>", f"{off}<worldbody>"))
    assert set(model.joints) == {"crank", "coupler", "rocker"}


WELD = '<weld body1="coupler" body2="rocker"/>'
HELD = four_bar(CONNECT + WELD)
FAR = by_sites().replace('pos=".25 0 .1"', 'pos=".9 0 .1"')
FLAT = four_bar().replace('pos="0.3 0 -0.1"', 'pos="0.45 0 0"').replace(".25 0 0.1", ".25 0 0")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (FAR, "<connect> of p and q cannot close near the posture of the file: the gap is 0.498 m"),
        (four_bar(CONNECT.replace("0.25", "nan")), "<connect> has anchor='nan 0 0.1'"),
        (four_bar(CONNECT.replace("0.25", "1e300")), "<connect> has anchor='1e300 0 0.1'"),
        (
            four_bar('<joint joint1="rocker" joint2="crank" polycoef="0.2 -0.5 0 0 0"/>' + WELD),
            "the gap is 0.0141 m or 0.0447 rad, and smallest at crank = 0.8",
        ),
        (HELD, "No joint of .* moves: constraints fix crank, coupler, rocker"),
        (FLAT, "is singular at crank, coupler, rocker as in the file"),
    ],
)
def test_loops_that_cannot_be_are_refused_with_names_and_values(tmp_path, text, words):
    with pytest.raises(ModelError, match=words):
        load(tmp_path, text)


def test_what_holds_a_free_body_is_left_out(tmp_path):
    free = '<body name="cup" pos="0 0 2"><freejoint/><geom size=".1"/></body></worldbody>'
    text = four_bar(CONNECT + '<weld body1="cup" body2="coupler"/>')
    model = load(tmp_path, text.replace("</worldbody>", free))
    assert model.joints == ("crank",)
    assert any("<weld> of cup and coupler" in words for words in model.left_out)


def assert_twins(folder, text, tail=""):
    """Check that a model of an SDF equals the four-bar of the same names in MJCF."""
    (folder / "robot.sdf").write_text(text)
    model = load_model(folder / "robot.sdf")
    other = four_bar(rocker='damping=".1"').replace("</mujoco>", f"{tail}</mujoco>")
    assert model.joints == ("crank",) and not model.left_out
    assert_as_mujoco(model, Constrained.of(other, ["crank"]), states(model, 5))
    return model


@pytest.mark.parametrize("pin", ["revolute", "ball"])
def test_a_loop_of_an_sdf_is_that_of_its_twin(tmp_path, pin):
    model = assert_twins(tmp_path, four_bar_sdf((pin, "")))
    assert any("the joint pin" in note for note in model.notes)
    assert check_dynamics(model).holds


def test_a_prismatic_joint_may_close_a_loop(tmp_path):
    bars = (*BARS[:2], ("slider_link", "0.35 0 0.1", (0.4, "0 0 0", "1e-4 1e-4 1e-4")))
    limit = "<limit><effort>9</effort></limit>"
    joints = [
        ("crank", "revolute", ("base", "crank_link"), "0 0 0", "0 1 0", limit),
        ("coupler", "revolute", ("crank_link", "coupler_link"), "0.1 0 0", "0 1 0", limit),
        ("pin", "revolute", ("coupler_link", "slider_link"), "0.25 0 0.1", "0 1 0", limit),
        ("slide", "prismatic", ("base", "slider_link"), "0.35 0 0.1", "1 0 0", dynamics(damping=2)),
    ]
    (tmp_path / "robot.sdf").write_text(sdf(bars, joints))
    model = load_model(tmp_path / "robot.sdf")
    text = four_bar()
    at = text.index('<body name="rocker"')
    slider = (
        '<body name="rocker" pos="0.35 0 0.1"><joint name="slide" type="slide" axis="1 0 0" '
        'damping="2"/><inertial mass=".4" pos="0 0 0" diaginertia="1e-4 1e-4 1e-4"/></body>'
    )
    plain = text[:at] + slider + text[text.index("</worldbody>") :]
    plain = plain.replace('damping=".02"', "")
    other, motion = load(tmp_path, plain), states(model)
    assert model.joints == other.joints == ("crank",) and "slide" in model.sliding_joints
    np.testing.assert_allclose(
        model.effort(Motion(*motion)), other.effort(Motion(*motion)), rtol=1e-9
    )
    assert_as_mujoco(other, Constrained.of(plain, ["crank"]), motion)


BALL = (
    '<drake:ball_constraint><drake:ball_constraint_body_A name="coupler_link"/>'
    '<drake:ball_constraint_body_B name="rocker_link"/>'
    '<drake:ball_constraint_p_AP value="0.25 0 0.1"/>'
    '<drake:ball_constraint_p_BQ value="0.05 0 0.2"/></drake:ball_constraint>'
)


def four_bar_urdf(ball=BALL):
    links = "".join(
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/><inertia '
        'ixx="{}" iyy="{}" izz="{}" ixy="0" ixz="0" iyz="0"/></inertial></link>'.format(
            *moments.split()
        )
        for name, _, (mass, com, moments) in BARS
    )
    parents = {"crank": "base", "coupler": "crank_link", "rocker": "base"}
    places = {"crank": "0 0 0", "coupler": "0.1 0 0", "rocker": "0.3 0 -0.1"}
    joints = "".join(
        f'<joint name="{name}" type="continuous"><parent link="{parents[name]}"/><child '
        f'link="{name}_link"/><origin xyz="{place}"/><axis xyz="0 1 0"/></joint>'
        for name, place in places.items()
    )
    return (
        '<robot name="r" xmlns:drake="http://drake.mit.edu"><link name="base"/>'
        f"{links}{joints}{ball}</robot>"
    )


PIN = (
    '<gazebo><joint name="pin" type="{}"><pose>.05 0 .2 0 .3 0</pose>'
    "<parent>coupler_link</parent><child>rocker_link</child><axis><xyz>0 -2 0</xyz></axis>"
    "</joint></gazebo>"
)


LOOP_JOINT = (
    '<loop_joint name="pin" {}><link1 link="coupler_link" xyz=".25 0 .1" rpy=".1 0 0"/>'
    '<link2 link="rocker_link" xyz=".05 0 .2" rpy=".1 0 0"/><axis xyz="{}"/></loop_joint>'
)
LOOP_JOINTS = (
    LOOP_JOINT.format("", "0 -.995004165278 .0998334166468"),
    LOOP_JOINT.format('type="ball"', "1 0 0"),
)


@pytest.mark.parametrize("closes", [BALL, PIN.format("ball"), PIN.format("revolute"), *LOOP_JOINTS])
def test_what_closes_a_loop_of_a_urdf_for_drake_or_gazebo_is_read(tmp_path, closes):
    (tmp_path / "robot.urdf").write_text(four_bar_urdf(closes))
    model = load_model(tmp_path / "robot.urdf")
    assert model.joints == ("crank",) and not model.left_out
    bare = re.sub(r'(damping|stiffness|springref|armature)="[^"]*"', "", four_bar())
    assert_as_mujoco(model, Constrained.of(bare, ["crank"]), states(model))
    assert check_dynamics(model, samples=3).second is not None


@pytest.mark.parametrize("kind", ["gripper", "leg", "urdf"])
def test_loops_of_two_robots_from_one_file_are_those_of_each(tmp_path, kind):
    own = "<axis><dynamics><damping>2</damping><friction>3</friction></dynamics>"
    urdf = four_bar_urdf(PIN.format("revolute").replace("<axis>", own))
    text = {"gripper": gripper(), "leg": leg(), "urdf": urdf}[kind]
    (path := tmp_path / f"robot.{'urdf' if kind == 'urdf' else 'xml'}").write_text(text)
    one, add = load_model(path), f"- add_model: {{{{name: {{}}, file: package://x/{path.name}}}}}\n"
    (tmp_path / "package.xml").write_text("<package><name>x</name></package>")
    two = tmp_path / "two.dmd.yaml"
    two.write_text("directives:\n" + "".join(map(add.format, "AB")))
    both = load_model(two)
    names = [[f"{arm}_{joint}" for joint in one.joints] for arm in "AB"]
    assert set(both.joints) == {*names[0], *names[1]}
    q, v, vd = states(one, 3)
    at = [(names[0] if joint in names[0] else names[1]).index(joint) for joint in both.joints]
    twice = both.effort(Motion(q[:, at], v[:, at], vd[:, at]))
    np.testing.assert_allclose(twice, one.effort(Motion(q, v, vd))[:, at], rtol=1e-8, atol=1e-9)


def test_a_joint_of_gazebo_in_a_urdf_has_its_damping_and_friction(tmp_path):
    own = "<axis><dynamics><damping>2</damping><friction>3</friction></dynamics>"
    (tmp_path / "robot.urdf").write_text(
        four_bar_urdf(PIN.format("revolute").replace("<axis>", own))
    )
    found = {f.effect.name: f for f in load_model(tmp_path / "robot.urdf").effects}
    assert {f.effect.where for f in found.values()} == {("pin",)}
    assert [found[f"{kind}_friction"].parameters.tolist() for kind in ("viscous", "coulomb")] == [
        [2.0],
        [3.0],
    ]
    base = '<gazebo><joint type="fixed"><parent>world</parent><child>base</child></joint></gazebo>'
    (tmp_path / "robot.urdf").write_text(four_bar_urdf(base))
    assert len(load_model(tmp_path / "robot.urdf").joints) == 3


@pytest.mark.parametrize("wrong", ['link="nobody"', 'xyz="nan 0 0"', 'type="screw"'])
def test_a_loop_joint_that_joins_nothing_is_refused(tmp_path, wrong):
    text = LOOP_JOINTS[1].replace('type="ball"', wrong) if "type" in wrong else LOOP_JOINTS[1]
    text = text.replace('link="rocker_link"', wrong).replace('xyz=".05 0 .2"', "", "xyz" in wrong)
    (tmp_path / "robot.urdf").write_text(four_bar_urdf(text))
    with pytest.raises(ModelError, match=r"line 1: <loop_joint> pin of the type (ball|screw) does"):
        load_model(tmp_path / "robot.urdf")


def test_a_ball_of_drake_names_bodies_that_are_there(tmp_path):
    (tmp_path / "robot.urdf").write_text(four_bar_urdf(BALL.replace("rocker_link", "nobody")))
    with pytest.raises(ModelError, match="has an unknown body 'nobody'"):
        load_model(tmp_path / "robot.urdf")
    (tmp_path / "robot.urdf").write_text(four_bar_urdf(BALL.replace('name="rocker_link"', "")))
    with pytest.raises(ModelError, match="does not name its two bodies"):
        load_model(tmp_path / "robot.urdf")


@pytest.mark.parametrize("name", ["pin", "rocker"])
def test_the_joint_with_a_motor_leads(tmp_path, name):
    (tmp_path / "robot.sdf").write_text(four_bar_sdf(limits={name: 5.0}))
    assert load_model(tmp_path / "robot.sdf").joints == (name,)


def with_universal_pin(text):
    before, _, pin = text.partition('<joint name="pin" type="revolute">')
    axes = "</axis>", "</axis><axis2><xyz>1 0 0</xyz></axis2>"
    return f'{before}<joint name="pin" type="universal">{pin.replace(*axes)}'


def test_a_universal_joint_stays_in_the_tree_and_another_one_closes_the_loop(tmp_path):
    models = []
    for text in (four_bar_sdf(), with_universal_pin(four_bar_sdf())):
        (tmp_path / "robot.sdf").write_text(text)
        models.append(load_model(tmp_path / "robot.sdf"))
    plain, universal = models
    assert plain.joints == universal.joints == ("crank",) and not universal.left_out
    motion = Motion(*states(plain))
    np.testing.assert_allclose(universal.effort(motion), plain.effort(motion), rtol=1e-9)


def test_a_loop_of_an_sdf_that_cannot_be_used_is_refused(tmp_path):
    limits = {"crank": 5.0, "coupler": 3.0, "rocker": 3.0}
    (tmp_path / "robot.sdf").write_text(with_universal_pin(four_bar_sdf(limits=limits)))
    with pytest.raises(ModelError, match="Joint 'pin' of type universal closes a kinematic loop"):
        load_model(tmp_path / "robot.sdf")


def test_limits_are_those_of_all_joints_and_motors_of_the_free_ones(tmp_path):
    limits = {"crank": 5.0, "rocker": 3.0}
    text = four_bar_sdf(limits=limits).replace(
        "<effort>3.0</effort>", "<effort>3.0</effort><lower>-0.2</lower><velocity>2</velocity>"
    )
    (tmp_path / "robot.sdf").write_text(text)
    model = load_model(tmp_path / "robot.sdf")
    assert model.effort_limits.tolist() == [5.0]
    low, high = model.position_limits
    q = np.linspace(low[0], high[0], 50)[:, None]
    rocker = model.transmission[0].joints.index("rocker")
    theta = model.transmission[0].map.joint_positions(q)[:, rocker]
    assert theta.min() == pytest.approx(-0.2, abs=0.01) and theta.min() >= -0.2 - 1e-9
    lever = np.abs(model.transmission[0].map.jacobian(q)[:, rocker, 0]).max()
    assert model.velocity_limits[0] == pytest.approx(2.0 / lever, rel=0.01)


TERMS = 'damping=".2"', 'armature=".03"', 'stiffness="3" springref=".1"', ""


def random_robot(seed):
    """Return two chains of joints with any axes on a common joint, whose ends are joined."""
    rng = np.random.default_rng(seed)
    words = lambda x: " ".join(f"{value:.12g}" for value in x)  # noqa: E731

    def chain(name, count, inner=""):
        text = inner
        for k in reversed(range(count)):
            kind = "slide" if rng.random() < 0.25 else "hinge"
            place, turn = words(rng.uniform(-0.3, 0.3, 3)), words(rng.uniform(-1, 1, 3))
            axis, com = words(rng.normal(size=3)), words(rng.uniform(-0.1, 0.1, 3))
            joint = f'<joint name="{name}{k}" type="{kind}" axis="{axis}" {rng.choice(TERMS)}/>'
            inertial = f'<inertial mass="1.5" pos="{com}" diaginertia=".02 .03 .025"/>'
            where = f'<body name="{name}{k}" pos="{place}" euler="{turn}">'
            text = f"{where}{joint}{inertial}{text}</body>"
        return text

    welds = rng.random() < 0.5
    count = 4 if welds else 3
    base = chain("base", 1, chain("a", count) + chain("b", count))
    anchor = "" if welds else f'anchor="{words(rng.uniform(-0.2, 0.2, 3))}"'
    ends = f'body1="a{count - 1}" body2="b{count - 1}" {anchor}'
    return (
        f'<mujoco model="r"><compiler angle="radian"/><worldbody>{base}</worldbody>'
        f"<equality><{'weld' if welds else 'connect'} {ends}/></equality></mujoco>"
    )


@pytest.mark.parametrize("seed", range(5))
def test_random_loops_in_space_are_mujocos(tmp_path, seed):
    text = random_robot(seed)
    model = load(tmp_path, text)
    constrained = Constrained.of(text, model.joints)
    assert len(model.joints) == 1 + (2 if "<weld" in text else 3) and not model.left_out
    (drive,) = model.transmission
    q, v, vd = states(model, 4, seed, spread=0.2)
    own = [model.joints.index(name) for name in drive.actuators]
    q[:, own] = drive.map.inside(q[:, own])
    assert_as_mujoco(model, constrained, (q, v, vd), 1e-9, 1e-5)


def test_a_loop_begins_where_the_file_draws_it(tmp_path):
    text = four_bar()
    for joint, ref in (("crank", 0.7), ("coupler", -0.4), ("rocker", 1.1)):
        text = text.replace(f'<joint name="{joint}"', f'<joint name="{joint}" ref="{ref}"')
    model, constrained = load(tmp_path, text), Constrained.of(text, ["crank"])
    plain = load(tmp_path, four_bar())
    assert model.default_position("crank") == pytest.approx(0.7)
    there = model.plant_positions(np.array([[0.7]]))[0]
    np.testing.assert_allclose(there, [0.7, -0.4, 1.1], atol=1e-12)
    assert_as_mujoco(model, constrained, states(model, 3))
    motion = Motion(*states(plain, 3))
    bare = [replace(m, effects=()) for m in (model, plain)]
    moved = Motion(motion.q + 0.7, motion.v, motion.vd)
    np.testing.assert_allclose(bare[0].effort(moved), bare[1].effort(motion), rtol=1e-9)


def test_what_the_file_states_of_the_joint_that_closes_a_loop_counts(tmp_path):
    terms = dynamics(damping=0.3, spring_stiffness=1.5, spring_reference=0.1)
    turns = (("rocker", 1), ("crank", -1), ("coupler", -1))  # how far the pin does
    joints = "".join(f'<joint joint="{name}" coef="{share}"/>' for name, share in turns)
    tendon = f'<fixed name="pin" damping=".3" stiffness="1.5" springlength=".1">{joints}</fixed>'
    tail = f"<tendon>{tendon}</tendon>"
    model = assert_twins(tmp_path, four_bar_sdf(("revolute", terms)), tail)
    assert {f.effect.place for f in model.effects} == {"coupler", "rocker", "pin"}


LINKAGE = """<sdf version="1.6"><model name="r"><link name="base"/>
<joint name="w" type="fixed"><parent>world</parent><child>base</child></joint>{parts}
<joint name="end" type="ball"><parent>rod</parent><child>rocker</child>
<pose>0 0 .2 0 0 0</pose></joint>
<joint name="gear" type="gearbox"><parent>motor</parent><child>rocker</child>
<gearbox_reference_body>base</gearbox_reference_body><gearbox_ratio>.05</gearbox_ratio>{axes}
</joint></model></sdf>"""


def test_a_geared_linkage_that_is_stretched_at_zero_is_put_within_its_limits(tmp_path):
    """As the feet of a known biped are drawn: all pivots in one line, beyond their limits."""
    turn = "<xyz>0 1 0</xyz><use_parent_model_frame>1</use_parent_model_frame>"
    parts = ""
    for name, parent, place, limits in (
        ("crank", "base", "0 0 0 0 .00001 0", "<lower>.5</lower><upper>2</upper>"),
        ("rod", "crank", "0 0 .2 0 0 0", ""),
        ("rocker", "base", "0 0 .3 0 0 0", "<lower>.5</lower><upper>2</upper>"),
        ("motor", "base", "0 .1 .3 .4 .3 .2", ""),
    ):
        parts += f"""<link name="{name}"><pose>{place}</pose><inertial><mass>1</mass></inertial>
        </link><joint name="{name}_turns" type="revolute"><parent>{parent}</parent>
        <child>{name}</child><axis>{turn}<limit>{limits}</limit></axis></joint>"""
    axes = f"<axis>{turn}</axis><axis2>{turn}</axis2>"
    path = tmp_path / "r.sdf"
    path.write_text(LINKAGE.format(parts=parts, axes=axes), encoding="utf-8")
    model = load_model(path)
    assert model.joints == ("rocker_turns",) and not model.left_out
    q = np.linspace(0.6, 1.9, 5)[:, None]
    places = model.plant_positions(q)
    names = joint_names(model.plant)
    crank, motor = (places[:, names.index(f"{name}_turns")] for name in ("crank", "motor"))
    assert (crank > 0.5).all() and (crank < 2.1).all()
    np.testing.assert_allclose(motor, -20.0 * q[:, 0])
    stretched = re.sub("<limit>.*?</limit>", "", LINKAGE.format(parts=parts, axes=axes))
    path.write_text(stretched, encoding="utf-8")
    with pytest.raises(ModelError, match="is singular at crank_turns, rod_turns"):
        load_model(path)
