"""Joints that follow others, against Pinocchio's mimic joints, MuJoCo's equalities, and J."""

import numpy as np
import pytest
from known_robots import assert_close

from geodrake import load_model, save_model
from geodrake.errors import ModelError
from geodrake.excitation.reverse_recursion import reverse_recursion
from geodrake.logs import JointLog, Motion
from geodrake.model import holding
from geodrake.model.logged_joints import log_of_model
from geodrake.robot import KinematicTree, inverse_dynamics, inverse_dynamics_regressor
from geodrake.robot.effort_slopes import effort_slopes

INERTIA = 'ixx="0.02" iyy="0.03" izz="0.025" ixy="0.001" ixz="0.002" iyz="-0.001"'


def link(name, mass, com):
    return (
        f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>'
        f"<inertia {INERTIA}/></inertial></link>"
    )


def joint(name, parent, child, axis, extra="", kind="revolute"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0.2 -0.3" rpy="0.3 0.1 -0.2"/><axis xyz="{axis}"/>'
        f'<limit lower="-2" upper="2" effort="5" velocity="3"/>{extra}</joint>'
    )


def follow(leader, multiplier, offset=0.0):
    return f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/>'


def gripper(follows=True):
    """Two arms; a geared rotor beside one, a chain behind the other, and a sliding finger."""
    own = follow if follows else (lambda *_: "")
    damping = '<dynamics damping="0.3" friction="0.2"/>'
    return (
        '<robot name="gripper"><link name="base"/>'
        + link("a", 2.0, "0.1 0 0.2") + link("b", 1.0, "0 0.1 -0.2") + link("rotor", 0.5, "0 0 0")
        + link("c", 0.4, "0 0.02 0.1") + link("d", 0.7, "0.1 0 0.1")
        + link("finger", 0.3, "0 0 0.1")
        + joint("ja", "base", "a", "0 0 1", damping)
        + joint("jb", "a", "b", "0 1 0")
        + joint("spin", "base", "rotor", "1 0 0", damping + own("ja", 9.0))
        + joint("jc", "b", "c", "0 1 0", own("jb", -0.7, 0.4))
        + joint("jd", "c", "d", "1 0 0", own("jc", 0.5, 0.1))
        + joint("slide", "d", "finger", "0 0.6 0.8", own("jb", 0.2, 0.05), kind="prismatic")
        + "</robot>"
    )  # fmt: skip


def loaded(tmp_path, text=None, name="robot.urdf", **options):
    path = tmp_path / name
    path.write_text(text or gripper())
    return load_model(path, **options)


def motion_of(count=8, width=2, seed=0):
    return Motion(*np.random.default_rng(seed).uniform(-1.2, 1.2, (3, count, width)))


def test_efforts_are_those_of_pinocchios_mimic_joints(tmp_path):
    pinocchio = pytest.importorskip("pinocchio")
    text = gripper()
    text = text.replace(follow("jc", 0.5, 0.1), follow("jb", -0.35, 0.3))  # no chains there
    model, whole = loaded(tmp_path), pinocchio.buildModelFromXML(text, True)
    assert whole.nv == 2 and model.joints == ("ja", "jb")
    order = [whole.joints[whole.getJointId(name)].idx_v for name in model.joints]
    motion, data = motion_of(), whole.createData()
    rows = np.stack([motion.q, motion.v, motion.vd], axis=1)[:, :, np.argsort(order)]
    expected = np.array([pinocchio.rnea(whole, data, *row)[order] for row in rows])
    assert_close(model.motion(motion).load, expected)


def test_efforts_regressors_and_gradients_are_those_through_the_jacobian(tmp_path):
    model, apart = loaded(tmp_path), loaded(tmp_path, gripper(follows=False), "apart.urdf")
    motion, tree = motion_of(), KinematicTree.from_plant(apart.plant)
    phi, J = model.phi, model.coordinates.constant
    samples = model.plant_positions(motion.q), motion.v @ J.T, motion.vd @ J.T
    own = motion.q, motion.v, motion.vd
    Y = inverse_dynamics_regressor(model.tree, *own)
    expected = np.swapaxes(J[None], 1, 2) @ inverse_dynamics_regressor(tree, *samples)
    assert_close(Y, expected)
    assert_close(inverse_dynamics(model.tree, *own, phi), Y @ phi.ravel())
    ours, theirs = effort_slopes(model.tree, *own, phi), effort_slopes(tree, *samples, phi)
    for name in ("position", "velocity", "acceleration"):
        assert_close(getattr(ours, name), J.T @ getattr(theirs, name) @ J)
    weights = np.random.default_rng(1).normal(size=Y.shape)
    slopes = reverse_recursion(model.tree, (motion.q, motion.v, motion.v, motion.vd), weights)
    q, v, vd = samples
    others = reverse_recursion(tree, (q, v, v, vd), J[None] @ weights)
    for name in ("q", "v", "vd"):
        assert_close(getattr(slopes, name), getattr(others, name) @ J)


def test_damping_friction_and_limits_are_those_of_all_that_move_together(tmp_path):
    model = loaded(tmp_path)
    values = {(f.effect.name, f.effect.where): f.parameters[0] for f in model.effects}
    assert values == {
        ("viscous_friction", ("ja",)): pytest.approx(0.3 * (1 + 81)),
        ("coulomb_friction", ("ja",)): pytest.approx(0.2 * (1 + 9)),
    }
    np.testing.assert_allclose(model.velocity_limits, [3 / 9, 3.0])
    lower, upper = model.position_limits
    np.testing.assert_allclose(lower, [-2 / 9, -2.0])
    np.testing.assert_allclose(upper, [2 / 9, 2.0])
    assert model.sliding_joints == () and model.joint_pairs == (("ja", "jb"),)
    assert any("jd follows jb" in note for note in model.notes)


def test_a_held_leader_holds_its_followers(tmp_path):
    model = loaded(tmp_path)
    held = holding(model, {"jb": 0.5})
    assert held.joints == ("ja",) and held.known_joints == model.known_joints
    motion = motion_of(width=1)
    at = Motion(
        np.insert(motion.q, 1, 0.5, 1), *(np.insert(x, 1, 0.0, 1) for x in (motion.v, motion.vd))
    )
    assert_close(held.motion(motion).load, model.motion(at).load[:, :1])
    save_model(held, tmp_path / "held.yaml")
    again = load_model(tmp_path / "held.yaml")
    assert_close(again.motion(motion).load, held.motion(motion).load)
    for refuse in (lambda: holding(model, {"jc": 0.0}), lambda: loaded(tmp_path, lock={"jc": 0.0})):
        with pytest.raises(ModelError, match="'jc' cannot be held, as it follows 'jb'"):
            refuse()


@pytest.mark.parametrize(
    "mimics",
    [
        {"spin": follow("jx", 1.0)},
        {"spin": follow("jb", 0.0)},
        {"spin": follow("jb", "nan")},
        {"jc": follow("jd", 1.0), "jd": follow("jc", 1.0)},
    ],
)
def test_what_cannot_follow_moves_by_itself_and_a_note_says_so(mimics, tmp_path):
    text = gripper(follows=False)
    for name, mimic in mimics.items():
        opened = f'<joint name="{name}" type="revolute">'
        text = text.replace(opened, opened + mimic)
    model = loaded(tmp_path, text)
    assert len(model.joints) == 6
    assert any("<mimic> is ignored" in note and name in note for note in model.notes)


SDF = """<sdf version="1.9"><model name="m"><link name="base"/>{}
<joint name="weld" type="fixed"><parent>world</parent><child>base</child></joint>
<joint name="j" type="revolute"><parent>base</parent><child>a</child><axis><xyz>0 1 0</xyz></axis>
</joint><joint name="k" type="revolute"><parent>a</parent><child>b</child><axis><xyz>0 1 0</xyz>
<mimic joint="j"><multiplier>-2</multiplier><offset>0.3</offset><reference>0.1</reference></mimic>
</axis></joint></model></sdf>"""


def test_sdf_followers(tmp_path):
    links = "".join(
        f'<link name="{n}"><pose>0 0 {z} 0 0 0</pose></link>' for n, z in (("a", 1), ("b", 2))
    )
    model = loaded(tmp_path, SDF.format(links), "m.sdf")
    assert model.joints == ("j",)
    (follower,) = model.followers
    assert (follower.ratio, follower.offset) == (-2.0, pytest.approx(0.5))


def test_efforts_of_followers_are_added_to_their_leaders(tmp_path):
    model, time = loaded(tmp_path), np.arange(0.0, 1.0, 0.01)
    names = ("ja", "jb", "spin", "slide")
    values = np.random.default_rng(0).normal(size=(4, len(time))).cumsum(axis=1).T
    log = log_of_model(JointLog("log", names, time, values, values), model)
    assert log.joints == ("ja", "jb")
    np.testing.assert_allclose(log.effort[:, 0], values[:, 0] + 9.0 * values[:, 2])
    np.testing.assert_allclose(log.effort[:, 1], values[:, 1] + 0.2 * values[:, 3])
    assert any("spin is added" in note for note in log.notes)
