"""The studies of the Cheetah-like leg show what they claim to show."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from geodrake.inertia import inertial_parameters, is_physical, pseudo_inertia
from geodrake.robot.base_parameters import structural_base_parameters
from geodrake.robot.floating_base import base_wrench_regressor, body_poses
from geodrake.robot.plant import load_plant
from geodrake.robot.regressor import inverse_dynamics

ROOT = Path(__file__).parents[2]
MODELS = ROOT / "models"


@pytest.fixture(scope="module")
def study():
    """The two studies, and the modules that they share."""
    sys.path.insert(0, str(ROOT / "diagrams"))
    try:
        import cheetah_gallop
        import cheetah_leg
        from cheetah import fits, gallop, leg, swing
    finally:
        sys.path.remove(str(ROOT / "diagrams"))
    names = ("fits", "gallop", "leg", "swing", "leg_study", "gallop_study")
    return SimpleNamespace(
        **dict(zip(names, (fits, gallop, leg, swing, cheetah_leg, cheetah_gallop), strict=True))
    )


def test_distance_aware_regularizers_win_at_thirty_samples(study):
    rows = study.leg_study.run(seed=0, sizes=(30,), draws=4).rows
    few = {row.regularizer: row for row in rows if row.samples == 30 and row.stretch}
    assert few["euclidean"].test > few["euclidean"].prior
    for kind in ("pullback", "entropic", "riemannian"):
        assert few[kind].test < 0.8 * few["euclidean"].test
    for kind in ("euclidean", "pullback"):  # fair: as good in training
        assert few[kind].train == pytest.approx(few["entropic"].train, rel=1e-5)
    everything = [row.test for row in rows if row.samples > 30]
    assert len(everything) == 4
    assert max(everything) < 1.02 * min(everything)
    assert max(everything) < 0.3 * few["entropic"].test


def test_distance_aware_regularizers_carry_over_to_the_floating_base(study):
    rows, rank = study.gallop_study.run(seed=0, truths=4)
    assert rank == 32
    found = {(row.regularizer, row.quantity): row for row in rows}
    for quantity in ("body force", "body moment"):
        euclidean = found["euclidean", quantity]
        for kind in ("pullback", "entropic"):
            assert found[kind, quantity].mean < 0.8 * euclidean.mean
            assert found[kind, quantity].train == pytest.approx(euclidean.train, rel=1e-4)


def test_leg_has_the_stated_bodies(study):
    leg = study.leg.load_leg()
    assert leg.tree.bodies[:3] == ("hip", "thigh", "shank")
    np.testing.assert_allclose(leg.prior[:, 0], [1.5, 0.5, 0.5, 0.5, 0.5, 0.5])
    # A box 0.342 m long and 0.06 m thick, half of it below the hip.
    thigh = leg.prior[1]
    np.testing.assert_allclose(thigh[1:4], [0, 0, -0.0855], atol=1e-9)
    assert thigh[6] == pytest.approx(0.5 / 12 * 2 * 0.06**2)
    assert is_physical(leg.prior, tolerance=1e-4).all()
    inside = np.einsum("bij,bji->b", pseudo_inertia(leg.prior), leg.ellipsoids)
    assert (inside > 0).all()


def test_condensed_data_have_the_residual_of_all(study):
    rng = np.random.default_rng(0)
    A = rng.normal(size=(50, 4)) @ rng.normal(size=(4, 10))
    b = rng.normal(size=50)
    data = study.fits.Condensed.of(A, b)
    assert data.A.shape == (4, 10)
    for x in rng.normal(size=(3, 10)):
        residual = np.square(data.A @ x - data.b).sum() + data.rest
        assert residual == pytest.approx(np.square(A @ x - b).sum(), rel=1e-12)


def test_gallop_is_one_motion(study):
    """Velocities and accelerations are the derivatives of the positions."""
    gallop, step = study.gallop, 1e-5
    plant = gallop.whole_robot()
    time = np.array([0.1, 0.23])
    before, here, after = (gallop.gallop(plant, time + h) for h in (-step, 0.0, step))
    context = plant.CreateDefaultContext()
    for i in range(2):
        plant.SetPositions(context, here.q[i])
        change = (after.q[i] - before.q[i]) / (2 * step)
        np.testing.assert_allclose(plant.MapQDotToVelocity(context, change), here.v[i], atol=1e-6)
        acceleration = (after.v[i] - before.v[i]) / (2 * step)
        np.testing.assert_allclose(acceleration, here.vd[i], atol=1e-4)


def test_quantities_are_the_inverse_dynamics(study):
    gallop = study.gallop
    plant = gallop.whole_robot()
    motion = gallop.gallop(plant, np.array([0.05, 0.31]))
    quantities = gallop.quantities(plant, motion)
    change = np.random.default_rng(0).normal(size=(6, 10))
    names = list(gallop.KinematicTree.from_plant(plant).bodies)
    phi = np.zeros((25, 10))
    for name in gallop.LEGS:
        phi[[k for k, body in enumerate(names) if body.startswith(name)]] = change
    efforts = inverse_dynamics(plant, motion.q, motion.v, motion.vd, phi)
    R_WB = body_poses(plant, motion.q)[:, names.index("trunk"), :3, :3]
    for at, name in ((slice(0, 3), "body moment"), (slice(3, 6), "body force")):
        rows = quantities[name].rows @ change.ravel()
        local = np.einsum("nji,nj->ni", R_WB, efforts[:, at])
        np.testing.assert_allclose(rows.reshape(2, 3), local, atol=1e-8 * np.abs(efforts).max())
    # At a joint: the link's effort, and that of its rotor, geared.
    torque = (quantities["joint torque"].rows @ change.ravel()).reshape(2, 12)
    order = list(gallop.joint_names(plant))
    knee, rotor = order.index("rear_left_knee"), order.index("rear_left_knee_rotor")
    expected = efforts[:, knee] + gallop.GEARS[2] * efforts[:, rotor]
    np.testing.assert_allclose(torque[:, 8], expected, atol=1e-8 * np.abs(efforts).max())


def test_what_a_fixed_base_does_not_tell(study):
    """A leg on a fixed base tells 32 combinations of 60; the base wrench tells more of them."""
    leg = study.leg.load_leg()
    rng = np.random.default_rng(1)
    q, v, vd = rng.uniform(-2, 2, (3, 60, 3))
    motion = study.swing.Motion(q, v, vd)
    structural = structural_base_parameters(leg.plant)  # rotors that turn by themselves
    base = study.gallop.base_wrench_regressor(leg.tree, *_joints(leg, motion))
    geared = study.fits.Condensed.of(leg.regressor(motion).reshape(-1, 60), np.zeros(180))
    assert len(geared.A) == 32
    rank = np.linalg.matrix_rank(np.vstack([geared.A, base.reshape(-1, 60)]), 1e-9)
    assert rank > 32
    assert structural.rank >= 32


def _joints(leg, motion):
    moved = leg.transmission.joint_motion(motion)
    return moved.q, moved.v, moved.vd


def test_whole_robot_weighs_what_its_parts_do():
    plant = load_plant(MODELS / "cheetah.dmd.yaml", floating=True).plant
    phi = inertial_parameters(plant)
    assert is_physical(phi).all()
    assert phi[:, 0].sum() == pytest.approx(26.6 + 4 * (1.5 + 5 * 0.5))
    q = plant.GetPositions(plant.CreateDefaultContext())[None]
    still = np.zeros((1, plant.num_velocities()))
    needed = base_wrench_regressor(plant, q, still, still)[0] @ phi.ravel()
    assert needed[5] == pytest.approx(phi[:, 0].sum() * 9.81)
