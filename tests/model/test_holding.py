"""Held joints against Pinocchio's reduced models, fixed joints, and Gaussian marginals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known_robots import assert_close, description

from geodrake import load_model, save_model
from geodrake.effects import CoulombFriction, CoupledFriction, FittedEffect, Payload
from geodrake.errors import LogError, ModelError
from geodrake.inertia import from_mass_com_inertia
from geodrake.logs import JointLog, Motion
from geodrake.model import holding, model_of_logs
from geodrake.model.logged_joints import log_of_model

MODELS = Path(__file__).parents[2] / "models"
PANDA = "robots/panda_description/urdf/panda.urdf"
FINGERS = {"panda_finger_joint1": 0.01, "panda_finger_joint2": 0.03}
POINT = np.array(from_mass_com_inertia(1.5, [0.02, 0.0, 0.1], np.diag([0.02, 0.03, 0.01])))


def model_of(text, tmp_path, **options):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    return load_model(path, **options)


def motion_of(model, count=6, seed=0):
    q, v, vd = np.random.default_rng(seed).uniform(-1.5, 1.5, (3, count, len(model.joints)))
    return Motion(q, v, vd)


def test_efforts_are_those_of_pinocchios_reduced_model(tmp_path):
    held = {"panda_joint1": 0.7, "panda_joint4": -1.2, **FINGERS}
    pinocchio = pytest.importorskip("pinocchio")
    text = description(PANDA)
    model = holding(model_of(text, tmp_path), held)
    whole = pinocchio.buildModelFromXML(text)
    posture = pinocchio.neutral(whole)
    for joint, value in held.items():
        posture[whole.joints[whole.getJointId(joint)].idx_q] = value
    locked = [whole.getJointId(joint) for joint in held]
    reduced = pinocchio.buildReducedModel(whole, locked, posture)
    assert tuple(reduced.names)[1:] == model.joints
    motion, data = motion_of(model), reduced.createData()
    rows = zip(motion.q, motion.v, motion.vd, strict=True)
    expected = np.array([pinocchio.rnea(reduced, data, *row) for row in rows])
    assert_close(model.motion(motion).load, expected)


def fitted_arm(seed=1):
    """Return an arm with effects and payloads, and with the information of a fit."""
    model, rng = load_model(MODELS / "arm6.urdf"), np.random.default_rng(seed)
    last, before = model.bodies[-1], model.bodies[-2]
    effects = (
        FittedEffect(CoulombFriction(model.joints[0]), np.array([2.0])),
        FittedEffect(CoulombFriction(model.joints[5]), np.array([1.0])),
        FittedEffect(CoupledFriction(model.joints[4:6], 1), np.array([0.5, 0.1])),
        FittedEffect(Payload(last), POINT),
        FittedEffect(Payload(before), 0.5 * POINT),
    )
    size = model.phi.size + sum(len(f.parameters) for f in effects)
    root = rng.normal(size=(size + 5, size)) * 10.0 ** rng.uniform(-2, 2, size)
    noise = rng.uniform(0.1, 1.0, 6)
    return model.with_fit(model.phi, effects, information=root.T @ root, effort_noise=noise)


def test_what_is_known_is_the_marginal_of_what_was_known():
    model = fitted_arm()
    held = holding(model, {model.joints[5]: 0.4})
    # One payload of both; friction of joint 1 stays, that of the held joint goes.
    assert [f.effect.name for f in held.effects] == ["coulomb_friction", "payload"]
    assert held.effort_noise.tolist() == model.effort_noise[:5].tolist()
    motion = motion_of(held)
    at_old = np.insert(motion.q, 5, 0.4, axis=1)
    still = (np.insert(x, 5, 0.0, axis=1) for x in (motion.v, motion.vd))
    old = model.motion(Motion(at_old, *still))
    assert_close(held.motion(motion).load, old.load[:, :5])
    # Predictions and their deviations agree: Y' Σ' Y'ᵀ = Y Σ Yᵀ where the joint stands.
    Y = [*(old.body_columns(b) for b in model.bodies), *_columns(model, old)]
    Z = held.motion(motion)
    Z = [*(Z.body_columns(b) for b in held.bodies), *_columns(held, Z)]
    Y, Z = np.concatenate(Y, axis=2)[:, :5], np.concatenate(Z, axis=2)
    moved = [k for k, f in enumerate(model.effects) if f.effect.where[-1] == model.joints[5]]
    starts = model.phi.size + np.cumsum([0, *(len(f.parameters) for f in model.effects)])
    for k in moved:  # friction that is not there any more
        Y[:, :, starts[k] : starts[k + 1]] = 0.0
    before = Y @ np.linalg.solve(model.information, np.swapaxes(Y, 1, 2))
    after = Z @ np.linalg.solve(held.information, np.swapaxes(Z, 1, 2))
    np.testing.assert_allclose(after, before, rtol=1e-6, atol=1e-9 * np.abs(before).max())


def _columns(model, seen):
    return [fitted.effect.regressor(seen) for fitted in model.effects]


def test_a_saved_model_remembers_what_it_holds(tmp_path):
    model = fitted_arm()
    model = holding(model, {model.joints[5]: 0.4})
    save_model(model, tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again.held == model.held and again.joints == model.joints
    np.testing.assert_array_equal(again.phi, model.phi)
    np.testing.assert_allclose(again.information, model.information)
    motion = motion_of(model)
    np.testing.assert_array_equal(again.effort(motion), model.effort(motion))
    further = load_model(tmp_path / "model.yaml", lock={model.joints[4]: 0.1})
    assert set(further.held) == {model.joints[4], *model.held}


def test_coordinates_of_a_free_base_are_not_held():
    path = MODELS / "double_pendulum.urdf"
    (first, *_) = load_model(path, floating=True).base_joints
    with pytest.raises(ModelError, match=f"'{first}' is a coordinate of the free base"):
        load_model(path, floating=True, lock={first: 0.0})


SWAY = np.sin(np.arange(200))  # an effort that changes at rest


def log_of(joints, *, name="log", standing=None, **columns):
    time = np.arange(0.0, 2.0, 0.01)
    moving = np.sin(np.outer(time, 1.0 + np.arange(len(joints))))
    position, effort = moving.copy(), np.cos(moving)
    for joint, (place, torque) in columns.items():
        position[:, joints.index(joint)], effort[:, joints.index(joint)] = place, torque
    return JointLog(name, tuple(joints), time, position, effort, standing=standing or {})


def test_joints_without_data_are_held_where_they_stand_or_by_default(tmp_path):
    model = model_of(description(PANDA), tmp_path)
    arm = model.joints[:7]
    assert model_of_logs(model, [log_of(model.joints)]) is model
    absent = model_of_logs(model, [log_of(arm)])
    assert absent.joints == arm and absent.held == dict.fromkeys(FINGERS, 0.0)
    assert any("panda_finger_joint1 at 0" in note and "no log" in note for note in absent.notes)
    standing = model_of_logs(model, [log_of(arm, standing=FINGERS), log_of(arm, name="b")])
    assert standing.held == FINGERS
    silent = log_of(model.joints, panda_finger_joint1=(0.02, 0.0), panda_finger_joint2=(0.02, 0.0))
    held = model_of_logs(model, [silent])
    assert held.held == pytest.approx(dict.fromkeys(FINGERS, 0.02))
    assert log_of_model(silent, held).joints == arm
    # Zero is no place for a joint whose limits leave it out.
    without = model_of_logs(model, [log_of([j for j in model.joints if j != "panda_joint4"])])
    assert without.held["panda_joint4"] == pytest.approx(model.limits_of("panda_joint4")[1])


def test_joints_that_hardly_move_in_any_log_are_held_at_their_mean():
    model = load_model(MODELS / "arm7.urdf")
    rng = np.random.default_rng(0)
    noisy = 0.3 + 1e-4 * rng.normal(size=200)
    log = log_of(model.joints, joint_1=(noisy, rng.normal(size=200)), joint_5=(-0.8, SWAY))
    held = model_of_logs(model, [log])
    assert held.held == pytest.approx({"joint_1": 0.3, "joint_5": -0.8}, abs=1e-4)
    assert held.joints == log_of_model(log, held).joints
    (note,) = (note for note in held.notes if "--no-auto-lock" in note)
    assert "joint_1 at 0.3" in note and "joint_5 at -0.8" in note
    assert model_of_logs(model, [log], hold_resting=False) is model
    # Joints that move in another log, or rest elsewhere there, are joints.
    moves = log_of(model.joints, name="b", joint_5=(-0.6, SWAY))
    assert model_of_logs(model, [log, moves]) is model
    # A model keeps the joints that it was fitted with.
    fitted = replace(model, fitted_to=(log.fingerprint,))
    assert model_of_logs(fitted, [log]) is fitted


def test_logs_that_disagree_or_move_are_refused(tmp_path):
    model = model_of(description(PANDA), tmp_path)
    arm = model.joints[:7]
    apart = [
        log_of(arm, name=name, standing=dict.fromkeys(FINGERS, at))
        for name, at in (("a", 0.0), ("b", 0.04))
    ]
    with pytest.raises(LogError, match=r"different positions: 0 in 'a', 0.04 in 'b'.*--lock"):
        model_of_logs(model, apart)
    with pytest.raises(
        LogError, match=r"has positions but no efforts of panda_finger_joint1, which moves"
    ):
        model_of_logs(model, [log_of(arm, standing=dict.fromkeys(FINGERS, np.nan))])
    with pytest.raises(LogError, match=r"has no joint 'panda_joint7'.*--lock"):
        log_of_model(log_of(arm[:6]), model)
