"""Held-out errors, gains and deviations of fits, against regression on the stacked rows."""

from dataclasses import replace

import numpy as np
import pytest
from chain_logs import inverse_dynamics
from identified_bodies import TWO
from pendulum_logs import JOINTS, PENDULUM, friction, pendulum_log
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from scipy.optimize import lsq_linear

from geodrake import load_model
from geodrake.effects import (
    AsymmetricFriction,
    CoulombFriction,
    CoupledFriction,
    EffortOffset,
    JointSpring,
    ViscousFriction,
)
from geodrake.errors import IdentificationError
from geodrake.identification import FitProblem, normal_equations, solve_fit
from geodrake.identification.conic_fit import solve_with_fallback
from geodrake.identification.logs.hypothesis import CrossValidation, hold_out
from geodrake.identification.logs.model_fit import fit_model, model_unknowns
from geodrake.identification.logs.reduce import reduce_logs
from geodrake.identification.logs.unknowns import effect_prior, fit_problem
from geodrake.identification.models.identify import body_changes, common_factor_notes
from geodrake.identification.models.results import BodyChange
from geodrake.inertia import is_physical, pullback_metric
from geodrake.logs import KnownPayload
from geodrake.logs.folds import validation_blocks
from geodrake.logs.preparation import prepare_logs

WEIGHTS = np.array([30.0, 70.0])
EFFECTS = (
    *(effect(joint) for effect in (CoulombFriction, ViscousFriction) for joint in JOINTS),
    AsymmetricFriction("elbow"),
    CoupledFriction(JOINTS, 1),
    EffortOffset("shoulder"),
    JointSpring("elbow"),
)


MODEL = load_model(PENDULUM)


@pytest.fixture(scope="module")
def dataset():
    logs = [pendulum_log(seed, friction((0.2, 0.1), (0.1, 0.05))) for seed in (1, 2)]
    trajectories = prepare_logs(logs, bandwidth=6.0)
    folds = validation_blocks(trajectories, blocks=2)
    return reduce_logs(MODEL, trajectories, folds, effects=EFFECTS, delays=(0.0, 0.01))


def with_effects(dataset, unknowns, *effects):
    for effect in effects:
        mean, information = effect_prior(dataset, effect)
        unknowns = unknowns.with_effect(effect, dataset.effect_columns(effect), information, mean)
    return unknowns


def stacked(dataset, columns, fold, joint, delay):
    """Return rows A (K, p) over given columns, zero where a joint has none, and b (K,)."""
    data = dataset.data[joint]
    rows = data.rows[fold]
    A = np.zeros((sum(len(r.b) for r in rows), len(columns)))
    position = {column: i for i, column in enumerate(data.columns)}
    own = np.concatenate([r.A for r in rows])
    for i, column in enumerate(columns):
        if column in position:
            A[:, i] = own[:, position[column]]
    return A, np.concatenate([r.b[:, delay] for r in rows])


def ridge_fit(dataset, unknowns, *, without, delay):
    """Return the fit to all folds but one by bounded least squares on the rows themselves."""
    rows, sides = [], []
    for fold in range(len(dataset.folds)):
        for joint in range(len(dataset.joints)):
            if fold != without:
                A, b = stacked(dataset, unknowns.columns, fold, joint, delay[joint])
                rows.append(np.sqrt(WEIGHTS[joint]) * A)
                sides.append(np.sqrt(WEIGHTS[joint]) * b)
    values, vectors = np.linalg.eigh(unknowns.information)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    A, b = np.vstack([*rows, root]), np.concatenate([*sides, root @ unknowns.mean])
    scale = 1.0 / np.linalg.norm(A, axis=0)
    bounds = (unknowns.lower / scale, unknowns.upper / scale)
    return scale * lsq_linear(A * scale, b, bounds, method="bvls", tol=1e-14).x


def ridge_errors(dataset, unknowns, *, delay=(0, 0)):
    """Return squared held-out errors (F, nv) of such fits."""
    sse = np.empty((len(dataset.folds), len(dataset.joints)))
    for fold in range(len(dataset.folds)):
        x = ridge_fit(dataset, unknowns, without=fold, delay=delay)
        for joint in range(len(dataset.joints)):
            A, b = stacked(dataset, unknowns.columns, fold, joint, delay[joint])
            sse[fold, joint] = np.sum((b - A @ x) ** 2)
    return sse


@pytest.mark.parametrize(
    ("effects", "delay"),
    [((), (0, 0)), (EFFECTS[:4], (0, 1)), (EFFECTS[:4], (1, 0)), (EFFECTS[6:8], (1, 1))],
)
def test_held_out_errors_are_those_of_ridge_regression(dataset, effects, delay):
    unknowns = with_effects(dataset, model_unknowns(dataset, MODEL), *effects)
    cv = CrossValidation(dataset, unknowns, WEIGHTS, delay=delay)
    expected = ridge_errors(dataset, unknowns, delay=delay)
    np.testing.assert_allclose(cv.held_out.sse, expected, rtol=1e-5)
    x = ridge_fit(dataset, unknowns, without=None, delay=delay)
    for joint in range(2):
        A, _ = stacked(dataset, unknowns.columns, 0, joint, 0)
        np.testing.assert_allclose(A @ cv.fit_all, A @ x, atol=1e-5)


def negative(dataset):
    """Return the dataset with measured efforts of the opposite sign."""
    return replace(
        dataset,
        data=tuple(
            replace(
                data,
                factors=data.factors * np.r_[np.ones(len(data.columns)), -np.ones(2)],
                rows=tuple(
                    tuple(replace(rows, joined=np.hstack([rows.A, -rows.b])) for rows in blocks)
                    for blocks in data.rows
                ),
            )
            for data in dataset.data
        ),
    )


def test_bodies_stay_physical(dataset):
    """Where data would make bodies unphysical, fits equal those of Drake's conic solver."""
    unknowns = model_unknowns(dataset, MODEL, spread=3.0)
    wild = CrossValidation(negative(dataset), unknowns, WEIGHTS, physical=False)
    assert not is_physical(wild.held_out.x.reshape(-1, 10)).any()
    assert not wild.is_physical
    kept = CrossValidation(negative(dataset), unknowns, WEIGHTS)
    assert is_physical(kept.held_out.x.reshape(-1, 10)).all()
    assert is_physical(kept.fit_all.reshape(-1, 10)).all()
    problems = (fit_problem(negative(dataset), unknowns, WEIGHTS, without=f) for f in range(4))
    conic = [solve_fit(problem, shortcuts=False).x for problem in problems]
    found = hold_out(negative(dataset), unknowns.columns, np.array(conic))
    np.testing.assert_allclose(kept.held_out.rms, found.rms, rtol=1e-6)


WEIGHT = KnownPayload("lower_link", 1.0, (0.05, 0.0, -0.2))


def weight_effort(q, v, vd, load):
    """Return the further effort of a weight at the lower link, by Drake."""
    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(PENDULUM))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base_link"))
    point = UnitInertia.PointMass(WEIGHT.mass_center)
    inertia = SpatialInertia(WEIGHT.mass, WEIGHT.mass_center, point)
    weight = plant.AddRigidBody("weight", plant.GetModelInstanceByName("double_pendulum"), inertia)
    plant.WeldFrames(plant.GetFrameByName("lower_link"), weight.body_frame())
    plant.Finalize()
    return inverse_dynamics(plant, q, v, vd) - load


def carrying_log(seed, hidden=None, **more):
    """Return a log of the pendulum with the known weight."""

    def both(q, v, vd, load):
        rest = 0.0 if hidden is None else hidden(q, v, vd, load)
        return weight_effort(q, v, vd, load) + rest

    return replace(pendulum_log(seed, both, seconds=20.0, **more), payloads=(WEIGHT,))


def with_gains(logs, gains):
    return [replace(log, effort=log.effort * gains) for log in logs]


def reduced(model, logs, effects):
    trajectories = prepare_logs(logs, bandwidth=6.0)
    folds = validation_blocks(trajectories, blocks=2)
    return reduce_logs(model, trajectories, folds, effects=effects)


def test_gains_act_on_the_efforts_of_known_payloads_too():
    """Against a second fit, to logs whose efforts are 1 % larger at one joint."""
    hidden = friction((0.2, 0.1), (0.1, 0.05))
    logs = [pendulum_log(1, hidden, seconds=20.0), carrying_log(2, hidden)]
    fits = []
    for gains in (1.0, [1.01, 1.0], [1.0, 1.01]):
        data = reduced(MODEL, with_gains(logs, gains), EFFECTS[:4])
        unknowns = with_effects(data, model_unknowns(data, MODEL), *EFFECTS[:4])
        fits.append(fit_model(MODEL, data, unknowns, WEIGHTS))
    one, *others = fits
    for shifts, other in zip(one.gain_shifts, others, strict=True):
        moved = (other.result.x - one.result.x) / 0.01
        np.testing.assert_allclose(moved, shifts, atol=5e-3 * np.abs(shifts).max())


def test_gains_that_a_model_took_in_act_on_what_has_changed_since():
    """A model is fitted to one log; in the next there are friction and a known weight."""
    quiet = np.full(2, 1e-4)
    before = pendulum_log(1, seconds=20.0, noise=quiet)
    after = carrying_log(2, friction((0.5, 0.3)), noise=quiet)
    found = []
    for gain in (1.0, 1.01):
        first, then = with_gains([before, after], gain)
        data = reduced(MODEL, [first], ())
        fitted = fit_model(MODEL, data, model_unknowns(data, MODEL, spread=10.0), WEIGHTS).model
        data = reduced(fitted, [then], EFFECTS[:2])
        unknowns = with_effects(data, model_unknowns(data, fitted), *EFFECTS[:2])
        found.append(fit_model(fitted, data, unknowns, WEIGHTS))
    one, other = found
    added = slice(-2, None)
    moved = (other.result.x - one.result.x)[added] / 0.01
    np.testing.assert_allclose(one.gain_shifts.sum(axis=0)[added], moved, rtol=0.02)


def test_what_is_unexplained_moves_a_parameter_by_two_deviations_at_most(dataset):
    """By a second fit, to efforts with an error that varies with the parameter as no other does."""
    unknowns = with_effects(dataset, model_unknowns(dataset, MODEL), *EFFECTS[:4])
    worth, mse, joint = np.zeros(2), 1e-4, 0
    worth[joint] = WEIGHTS[joint] * mse * dataset.data[joint].samples.sum()
    share = np.arange(2) == joint
    fit = fit_model(MODEL, dataset, unknowns, WEIGHTS, effective=worth, of_motion=share)
    data = dataset.data[joint]
    local = data.local(unknowns.columns)
    rows = [np.concatenate([block.A for block in fold]) for fold in data.rows]
    efforts = [np.concatenate([block.b for block in fold]) for fold in data.rows]
    for k in range(len(unknowns.columns) - 4, len(unknowns.columns)):
        if local[k] < 0:
            continue
        own = np.zeros(len(data.columns))
        own[local[local >= 0]] = np.linalg.inv(fit.result.information)[k, local >= 0]
        errors = [A @ own for A in rows]
        size = np.sqrt(mse * data.samples.sum() / sum(e @ e for e in errors))
        factors = [
            np.linalg.qr(np.column_stack([A, b + size * e[:, None]]), "r")
            for A, b, e in zip(rows, efforts, errors, strict=True)
        ]
        other = list(dataset.data)
        other[joint] = replace(data, factors=np.array(factors))
        moved = solve_with_fallback(
            fit_problem(replace(dataset, data=tuple(other)), unknowns, WEIGHTS)
        )
        deviation = np.sqrt(fit.unexplained_covariance[k, k])
        assert moved.x[k] - fit.result.x[k] == pytest.approx(2.0 * deviation, rel=1e-3)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -2.0])
def test_one_matrix_of_many_that_has_no_factor_is_seen(wrong):
    root = np.random.default_rng(0).normal(size=(7, 4, 4))
    many = 0.1 * (root + np.swapaxes(root, 1, 2)) + np.eye(4)
    for matrix, factor in zip(many, normal_equations.cholesky(many), strict=True):
        np.testing.assert_allclose(np.tril(factor) @ np.tril(factor).T, matrix, atol=1e-8)
    many[3, 2, 1] = many[3, 1, 2] = wrong
    with pytest.raises(IdentificationError, match="not positive definite"):
        normal_equations.cholesky(many)


def fit_of(information):
    """Return a fit of two bodies with a prior information (20, 20) and no data."""
    problem = FitProblem(
        factor=np.zeros((1, 21)),
        inertia_blocks=(0, 10),
        prior_mean=TWO.ravel(),
        prior_information=information,
    )
    return solve_fit(problem)


def known(gammas):
    information = np.zeros((20, 20))
    for k, (gamma, metric) in enumerate(zip(gammas, pullback_metric(TWO), strict=True)):
        information[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = gamma * metric
    return information


def test_deviations_of_centres_of_mass_are_those_of_samples():
    fit = fit_of(known([1e4, 1e6]))
    changes = body_changes(("arm", "hand"), TWO, TWO, fit)
    samples = np.random.default_rng(0).multivariate_normal(fit.x, fit.covariance(), 4000)
    for k, change in enumerate(changes):
        mass, moment = samples[:, 10 * k], samples[:, 10 * k + 1 : 10 * k + 4]
        assert change.mass_deviation == pytest.approx(mass.std(), rel=0.05)
        spread = (moment / mass[:, None]).std(0)
        np.testing.assert_allclose(change.com_deviation, spread, rtol=0.05)
        assert change.distance == 0.0 and not change.at_boundary


def test_what_is_not_known_is_infinite_and_the_rest_is_not():
    information = known([1e4, 1e4])
    information[10:] = information[:, 10:] = 0.0
    information[12, 12] = 1e4  # of the hand, only the moment along y
    arm, hand = body_changes(("arm", "hand"), TWO, TWO, fit_of(information))
    assert np.isfinite(arm.mass_deviation) and np.isfinite(arm.com_deviation).all()
    assert np.isinf(hand.mass_deviation) and np.isinf(hand.com_deviation).all()


def test_what_rounding_leaves_of_a_deviation_is_unknown():
    """A mass and a moment that are known together alone, by information beyond all digits."""
    information = 1e-290 * known([1.0, 1.0])
    along = np.array([1.0, 0.3, -0.2, 0.1])
    information[:4, :4] += np.outer(along, along)
    for body in body_changes(("arm", "hand"), TWO, TWO, fit_of(information)):
        assert not np.isnan(body.com_deviation).any() and not np.isnan(body.mass_deviation)


def change(name, before, after):
    return BodyChange(name, (before, after), np.zeros((2, 3)), 0.1, np.zeros(3), False, 0.5)


@pytest.mark.parametrize("factor", [2.2, 1 / 2.2])
def test_the_factor_of_the_efforts_is_said(factor):
    bodies = [change("arm", 10.0, 10.0 * factor), change("hand", 3.3, 3.3 * factor)]
    (note,) = common_factor_notes(bodies)
    assert f"{13.3 * factor:.3g} kg instead of 13.3 kg" in note
    assert f"{1 / factor:.3g} times as large" in note
