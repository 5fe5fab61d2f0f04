"""The studies of the Cheetah-like leg show what they claim to show."""

import json
from pathlib import Path

import numpy as np
import pytest
from scripts import call

from diagrams.studies import cheetah_gallop as gallop
from diagrams.studies.cheetah import leg as cheetah
from geodrake.inertia import inertial_parameters, is_physical, pseudo_inertia
from geodrake.robot.base_parameters import base_parameters
from geodrake.robot.floating_base import base_wrench_regressor, body_poses
from geodrake.robot.plant import load_plant
from geodrake.robot.regressor import inverse_dynamics

MODELS = Path(__file__).parents[2] / "models"


AWARE = ("point_mass_euclidean", "pullback", "entropic")


@pytest.fixture(
    scope="module",
    params=[3, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (0, 1, 2, 4))],
)
def quick_leg(request, tmp_path_factory):
    """The table of the quick run; with seed 3 and one more the prior is better than most fits."""
    folder = tmp_path_factory.mktemp("leg")
    options = ("--json", folder / "table.json", "--figures", folder)
    call("cheetah_leg", "--quick", "--seed", request.param, *options)
    assert len(list(folder.glob("cheetah_leg_*.png"))) == 2
    return json.loads((folder / "table.json").read_text(encoding="utf-8"))


def test_distance_aware_regularizers_win_at_thirty_samples(quick_leg):
    few = {row["regularizer"]: row for row in quick_leg if row["samples"] == 30 and row["stretch"]}
    assert few["euclidean"]["median"] > few["euclidean"]["prior"]
    for kind in AWARE:
        assert few[kind]["median"] < 0.9 * few["euclidean"]["median"]
        assert few[kind]["test"] < 0.9 * few["euclidean"]["test"]
    assert few["riemannian"]["median"] < few["euclidean"]["median"]
    for kind in ("euclidean", "point_mass_euclidean", "pullback"):  # fair: as good in training
        assert few[kind]["train"] == pytest.approx(few["entropic"]["train"], rel=1e-5)


def test_all_samples_tell_the_same_with_every_regularizer(quick_leg):
    most = max(row["samples"] for row in quick_leg)
    everything = {row["regularizer"]: row for row in quick_leg if row["samples"] == most}
    assert len(everything) == 5
    test = [row["test"] for row in everything.values()]
    assert max(test) < 1.02 * min(test)
    (few,) = (
        row
        for row in quick_leg
        if (row["samples"], row["stretch"], row["regularizer"]) == (30, True, "entropic")
    )
    assert max(test) < 0.3 * few["median"]


def test_motion_of_a_leg_tells_32_combinations_and_its_base_wrench_more():
    """Of 60, geared rotors counted; on a fixed base the wrench is not measured."""
    leg = cheetah.load_leg(gallop.GEARS)
    time = np.linspace(0.0, 1.0 / gallop.STRIDE, 200, endpoint=False)
    motion = gallop.leg_motion(time, gallop.PHASES["front_left"])
    rows = leg.regressor(motion).reshape(-1, 60)
    assert base_parameters(rows).rank == 32
    moved = leg.transmission.joint_motion(motion)
    base = base_wrench_regressor(leg.plant, moved.q, moved.v, moved.vd).reshape(-1, 60)
    assert base_parameters(np.vstack([rows, base])).rank > 32


def test_point_masses_amount_to_the_leg():
    leg = cheetah.load_leg()
    for number in (264, 300, 687):
        points = leg.point_masses(number)
        assert len(points.prior) == number and (points.prior > 0).all()
        np.testing.assert_allclose(points.parameters(), leg.prior, rtol=1e-9, atol=1e-13)
        for place, Q in zip(points.positions, leg.ellipsoids, strict=True):
            lifted = np.column_stack([place, np.ones(len(place))])
            assert np.einsum("ni,ij,nj->n", lifted, Q, lifted).min() > -1e-9


def test_leg_has_the_stated_bodies():
    leg = cheetah.load_leg()
    assert leg.tree.bodies[:3] == ("hip", "thigh", "shank")
    np.testing.assert_allclose(leg.prior[:, 0], [1.5, 0.5, 0.5, 0.5, 0.5, 0.5])
    # A box 0.342 m long and 0.06 m thick, half of it below the hip.
    thigh = leg.prior[1]
    np.testing.assert_allclose(thigh[1:4], [0, 0, -0.0855], atol=1e-9)
    assert thigh[6] == pytest.approx(0.5 / 12 * 2 * 0.06**2)
    assert is_physical(leg.prior, tolerance=1e-4).all()
    inside = np.einsum("bij,bji->b", pseudo_inertia(leg.prior), leg.ellipsoids)
    assert (inside > 0).all()


def test_condensed_data_have_the_residual_of_all():
    rng = np.random.default_rng(0)
    A = rng.normal(size=(50, 4)) @ rng.normal(size=(4, 10))
    b = rng.normal(size=50)
    data = cheetah.Condensed.of(A, b)
    assert data.A.shape == (4, 10)
    for x in rng.normal(size=(3, 10)):
        residual = np.square(data.A @ x - data.b).sum() + data.rest
        assert residual == pytest.approx(np.square(A @ x - b).sum(), rel=1e-12)


def test_gallop_is_one_motion():
    """Velocities and accelerations are the derivatives of the positions."""
    step = 1e-5
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


def test_quantities_are_the_inverse_dynamics():
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
    axes = np.broadcast_to(np.eye(3)[::-1], R_WB.shape).copy()  # of yaw, pitch and roll, here
    axes[:, 2] = R_WB[:, :, 0]
    moment = np.linalg.solve(axes, efforts[:, 3:6, None])[:, :, 0]
    for wrench, name in ((moment, "body moment"), (efforts[:, :3], "body force")):
        rows = quantities[name].rows @ change.ravel()
        local = np.einsum("nji,nj->ni", R_WB, wrench)
        np.testing.assert_allclose(rows.reshape(2, 3), local, atol=1e-8 * np.abs(efforts).max())
    # At a joint: the link's effort, and that of its rotor, geared.
    torque = (quantities["joint torque"].rows @ change.ravel()).reshape(2, 12)
    order = list(gallop.joint_names(plant))
    knee, rotor = order.index("rear_left_knee"), order.index("rear_left_knee_rotor")
    expected = efforts[:, knee] + gallop.GEARS[2] * efforts[:, rotor]
    np.testing.assert_allclose(torque[:, 8], expected, atol=1e-8 * np.abs(efforts).max())


def test_whole_robot_weighs_what_its_parts_do():
    plant = load_plant(MODELS / "cheetah.dmd.yaml", floating=True).plant
    phi = inertial_parameters(plant)
    assert is_physical(phi).all()
    assert phi[:, 0].sum() == pytest.approx(26.6 + 4 * (1.5 + 5 * 0.5))
    q = plant.GetPositions(plant.CreateDefaultContext())[None]
    still = np.zeros((1, plant.num_velocities()))
    needed = base_wrench_regressor(plant, q, still, still)[0] @ phi.ravel()
    assert needed[5] == pytest.approx(phi[:, 0].sum() * 9.81)
