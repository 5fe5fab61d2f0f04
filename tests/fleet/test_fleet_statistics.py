"""Statistics of fleets against dense fits, and changes of simulated fleets."""

from dataclasses import replace

import numpy as np
import pytest
from fleet_data import MEAN, NOISE, UNIT, P, Rows, columns, hypotheses, robot
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from geodrake.effects import CoulombFriction, EffortOffset, ViscousFriction
from geodrake.fleet import make_settings
from geodrake.fleet.changes import SCALES, calc_change_evidence, kind_of
from geodrake.fleet.changes import find_changes as find
from geodrake.fleet.fleet_run import parameter_levels
from geodrake.fleet.history import DAY
from geodrake.fleet.type_columns import Spread, body_factor, distance_factor, narrow_factor
from geodrake.fleet.type_layout import type_layout, with_joint_effects
from geodrake.fleet.type_learning import learn_type
from geodrake.fleet.type_model import Course, TypeModel
from geodrake.inertia import pullback_distance
from geodrake.logs import JointLog
from geodrake.model import load_model


def made(logs, **more):
    """Return a known type with logs of some robots."""
    known = {
        "mean": MEAN.copy(),
        "covariance": np.zeros((P, P)),
        "deviations": np.array([0.2, 0.1, 0.3]),
        "scatter": np.array([0.05, 0.02, 0.04]),
        "response": 0.2,
        "course": Course.zero(logs, 0),
        "robot_values": np.tile(MEAN, (len(logs), 1)),
        "excess": tuple(np.zeros((len(each.days), 3)) for each in logs),
    }
    return TypeModel(columns(), **{**known, **more})


def spread_covariance(scales):
    """Return the covariance of parameters by the model in the docstrings."""
    return np.diag((np.repeat(scales, [2, 1, 1]) * UNIT) ** 2)


def dense(model, A):
    """Return the covariance of all rows b of a robot, whose log t has rows A_t."""
    own, scatter = spread_covariance(model.deviations), spread_covariance(model.scatter)
    stacked = A.reshape(-1, P)
    each = block_diag(*[a @ scatter @ a.T for a in A])
    return stacked @ own @ stacked.T + each + NOISE**2 * np.eye(len(stacked))


def test_evidence_is_the_ratio_of_likelihoods_of_rows():
    """Logs of days since 1970 are a minute apart, two of them on one day."""
    rows = robot(np.random.default_rng(3), logs=6, rows=8)
    days = 20_000.0 + np.array([0.0, 2.0, 2.0, 3.0, 7.0, 8.0]) / 1440.0
    history = replace(rows.history(), days=days)
    logs = history.equations()
    model = made([logs])
    evidence = calc_change_evidence(model.fit(0, logs), history.days, hypotheses(), model.scale(0))
    V, b = dense(model, rows.A), rows.b.ravel()
    mean = rows.A.reshape(-1, P) @ MEAN
    before = multivariate_normal(mean, V).logpdf(b)
    for profiles, ratio in zip(evidence.profiles, evidence.ratio, strict=True):
        for h, hypothesis in enumerate(hypotheses()):
            if kind_of(profiles.form) not in hypothesis.kinds:
                assert np.isneginf(ratio[h]).all()
                continue
            D = UNIT[:, None] * hypothesis.factor
            for k, values in enumerate(profiles.values):
                X = (values[:, None, None] * (rows.A @ D)).reshape(len(b), -1)
                after = [multivariate_normal(mean, V + s**2 * X @ X.T).logpdf(b) for s in SCALES]
                expected = np.log(np.mean(np.exp(np.array(after) - before)))
                assert ratio[h, k] == pytest.approx(expected, abs=1e-7)
    assert np.exp(np.concatenate([p.ravel() for p in evidence.prior])).sum() == pytest.approx(1.0)


def test_units_change_nothing():
    """Bodies and friction in other units; the first body column is never seen."""
    rng = np.random.default_rng(10)
    rows = [robot(rng, logs=5) for _ in range(3)]
    for each in rows:
        each.A[:, :, 0] = 0.0
    u = np.array([1e8, 1.0, 1e8, 1.0])
    histories = [each.history() for each in rows]
    other = [Rows(each.A * u, each.b).history() for each in rows]
    known = replace(columns(), units=("kg", "kg·m", "N·m", "N·m·s"))
    bodies = Spread("bodies", known.spreads[0].factor / u[:, None])
    renamed = replace(known, prior=known.prior / u, spreads=(bodies, *known.spreads[1:]))
    found = learn_type(histories, known)
    again = learn_type(other, renamed)
    assert found.mean[0] == pytest.approx(1.1 * MEAN[0])
    np.testing.assert_allclose(again.mean * u, found.mean, rtol=1e-6)
    np.testing.assert_allclose(
        again.covariance * np.outer(u, u), found.covariance, rtol=1e-6, atol=1e-12
    )
    for name in ("deviations", "scatter"):
        np.testing.assert_allclose(getattr(again, name), getattr(found, name), rtol=1e-5)


def test_levels_cover_what_logs_have():
    rng = np.random.default_rng(6)
    rows = [robot(rng, logs=10) for _ in range(12)]
    logs = [each.history() for each in rows]
    found, errors = learn_type(logs, columns(), rounds=15), []
    for r, each in enumerate(history.equations() for history in logs):
        for column in (2, 3):
            values, deviation, shown = parameter_levels(found, r, each, found.fit(r, each), column)
            assert shown.all()
            errors.append((values - values.mean()) / deviation)
    inside = np.mean(np.abs(np.array(errors)) < 1.96)
    assert 0.92 < inside <= 0.995


def test_bodies_spread_by_their_geometric_distance():
    phi = np.array([2.0, 0.1, 0.0, 0.2, 0.09, 0.1, 0.05, 0.001, 0.002, -0.01])
    root = distance_factor(phi)
    step = 1e-3 * root @ np.ones(10)
    assert pullback_distance(phi + step, phi, phi) == pytest.approx(1e-3 * np.sqrt(10.0))
    B = np.random.default_rng(7).normal(size=(4, 20))
    seen = body_factor(root, 1, B, 6)
    assert not seen[4:].any()
    narrow = narrow_factor(seen[:4])
    assert narrow.shape == (4, 4)
    np.testing.assert_allclose(narrow @ narrow.T, B[:, 10:] @ root @ root.T @ B[:, 10:].T)


STEP = {2: lambda t: np.array([0.0, 0.0, 0.25, 0.0]) * (t >= 12)}
RAMP = {5: lambda t: np.array([0.0, 0.0, 0.0, 0.04]) * max(0, t - 10)}
LOAD = {7: lambda t: np.array([0.2, -0.3, 0.0, 0.0]) * (t < 6)}
BOTH = {
    8: lambda t: (
        np.array([0.0, 0.0, 0.3, 0.0]) * (t >= 6) + np.array([0.2, -0.3, 0.0, 0.0]) * (t >= 13)
    )
}
SEASON = 0.3 * np.sin(np.arange(20) / 6.0)


def fleet(seed, robots, changes, together=0.0, *, resting=False):
    rng = np.random.default_rng(seed)
    made = [robot(rng, change=changes.get(r), together=together) for r in range(robots)]
    for each in made if resting else ():
        each.A[::2, :, 2:4] = 0.0
    return [each.history(f"robot {r}") for r, each in enumerate(made)]


def find_changes(histories, known, **how):
    return find(
        histories, known, hypotheses(), lambda search: search.findings(search.find()), **how
    )


def sizes(finding):
    return {each.name: each for each in finding.parameters}


@pytest.fixture(scope="module")
def found():
    changes = {**STEP, **RAMP, **LOAD, **BOTH}
    return find_changes(fleet(1, 10, changes, SEASON), columns(course=True))


def test_changes_are_told_with_day_effect_and_kind(found):
    told = {r: each for r, each in enumerate(found[1]) if each}
    assert set(told) == {2, 5, 7, 8}
    (step,), (ramp,), (load,) = told[2], told[5], told[7]
    both = sorted((each.date / DAY, each.where) for each in told[8])
    assert both == [(6.0, "elbow"), (13.0, "hand")]
    finding = step
    told = finding.robot, finding.where, finding.kind, finding.date
    assert told == ("robot 2", "elbow", "step", 12.0 * DAY)
    assert "dry" in {finding.effect, *(rival.effect for rival in finding.rivals)}
    dry = sizes(step)["dry"]
    assert dry.share == pytest.approx(0.25, abs=4 * dry.deviation / 0.5)
    finding = ramp
    assert finding.kind == "ramp" and abs(finding.date / DAY - 10.0) <= 2.0
    assert finding.interval[0] <= finding.date <= finding.interval[1]
    assert sizes(ramp)["viscous"].share == pytest.approx(0.36, abs=0.08)
    finding = load
    assert (finding.effect, finding.kind, finding.date) == ("load", "step", 6.0 * DAY)
    found_sizes = [each.size for each in finding.parameters]
    np.testing.assert_allclose(found_sizes, [-0.4, -0.3], rtol=0.3)  # shares of its own
    assert all(each.false_alarm_probability < 1e-4 for each in (step, ramp, load))


def test_temperatures_tell_halls_apart():
    """Friction varies with the temperature of each hall, for which no common course exists."""
    rng, histories = np.random.default_rng(7), []
    for r in range(12):
        wave = (1.0 if r % 2 else -1.0) * SEASON
        made = robot(rng, together=wave).history(f"robot {r}")
        histories.append(replace(made, temperature=20.0 + 10.0 * wave))
    found = find_changes(histories, columns(course=True), passes=1)
    np.testing.assert_allclose(found[0].course.slope, 0.1, rtol=0.15)
    assert not any(found[1])


def test_odd_logs_and_joints_that_rest_are_no_changes():
    """Columns of resting joints are zero."""
    odd = {0: lambda t: np.array([0.0, 0.0, 0.5, 0.0]) * (t == 9)}
    histories = fleet(3, 7, odd, resting=True)
    assert not any(find_changes(histories, columns(), passes=1)[1])


def test_one_log_tells_no_change():
    rng = np.random.default_rng(5)
    histories = [robot(rng, logs=1).history() for _ in range(3)]
    assert not any(find_changes(histories, columns(), passes=1)[1])


CART = """<robot name="cart"><link name="base"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>"""


@pytest.fixture(scope="module")
def layout(tmp_path_factory):
    path = tmp_path_factory.mktemp("cart") / "cart.urdf"
    path.write_text(CART)
    model = with_joint_effects(load_model(path), [CoulombFriction, ViscousFriction, EffortOffset])
    time = np.arange(0.0, 20.0, 0.01)
    q = 0.2 * np.sin(3.0 * time + np.sin(time))
    v = np.gradient(q, time)
    effort = 2.0 * np.gradient(v, time) + 5.0 * v + np.tanh(50.0 * v)
    log = JointLog("log", ("slide",), time, q[:, None], effort[:, None])
    return type_layout(model, make_settings(model, log), np.array([500.0]))


def test_parameters_of_sliding_joints_are_in_their_units(layout):
    units = {(each.effect, each.name): each.unit for each in layout.parameters}
    assert units["coulomb_friction", "coulomb"] == "N"
    assert units["viscous_friction", "viscous"] == "N·s/m"
    assert units["effort_scale", "scale"] == ""
    assert layout.columns.units == tuple(each.unit for each in layout.parameters)


def test_offsets_differ_by_what_efforts_are_large(layout):
    spread = {each.name.partition(" ")[0]: each.factor.max() for each in layout.columns.spreads}
    change = {each.effect: each.factor.max() for each in layout.hypotheses}
    assert spread["effort_offset"] == change["effort_offset"] == 500.0
    assert spread["viscous_friction"] == change["viscous_friction"] == 1.0
    assert spread["effort_scale"] == 1.0
