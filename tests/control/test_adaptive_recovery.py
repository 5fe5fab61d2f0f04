"""Adaptive loops after a second of faults: the estimate is what it was, and tracking comes back."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adaptive_loops import CONTROL, MANIFOLD, MODEL, TRUTH, motion, natural, perturbed

from geodrake.control.adaptation import (
    PartialLaw,
    ProjectedLaw,
    adapted_parameters,
    euclidean_adaptation,
    limited,
    natural_adaptation,
    parameter_manifold,
    plausible_limits,
)
from geodrake.control.regressor import ControlModel
from geodrake.control.systems import (
    AdaptiveComputedTorqueController,
    PassivityBasedAdaptiveController,
    PredictionError,
    Safeguards,
)
from geodrake.control.systems.safeguards import Watch
from geodrake.errors import ArgumentError
from geodrake.inertia import change_frame, is_physical
from geodrake.manifolds import PhysicalInertia

sys.path.insert(0, str(Path(__file__).parents[2] / "diagrams"))

from adaptive.faults import FAULTS, Episode
from adaptive.faulty_loop import moments
from adaptive_soak import distances

LIMITS = np.array([8.0, 4.0])
START, STOP, END = 1.5, 2.5, 8.0  # of a fault, and of what is simulated, s
USUAL = 0.1  # rad, error of a joint under a sound sensor


def controller(kind, law, model, seed):
    """A controller of one of both kinds, and the distance of its estimates from the truth."""
    control, manifold = ControlModel.of(model), parameter_manifold(model)
    options = {
        "time_step": 2e-3,
        "parameters": perturbed(0.1, seed, control.prior, control),
        "safeguards": Safeguards(LIMITS),
    }
    chosen = (
        natural_adaptation(manifold, 0.02)
        if law == "natural"
        else euclidean_adaptation(len(control.prior), 50.0)
    )
    if kind == "passivity":
        return PassivityBasedAdaptiveController(control, chosen, **options)
    prediction = PredictionError(1.0, alone=True)
    return AdaptiveComputedTorqueController(
        control, chosen, rate=15.0, prediction=prediction, **options
    )


def distance(system, law, estimates):
    """Geodesic distances of estimates from the truth, or straight ones where they may be none."""
    if law == "natural":
        return distances(system.control, estimates)
    return np.linalg.norm(estimates - system.control.prior, axis=1)


ALWAYS = {
    ("passivity", "natural", True, "noise"),
    ("passivity", "natural", False, "huge"),
    ("passivity", "natural", True, "dropped"),
    ("computed torque", "natural", True, "stuck"),
    ("computed torque", "euclidean", True, "turns"),
    ("passivity", "euclidean", False, "weak actuators"),
}
ROWS = [
    pytest.param(*row, seed, marks=() if row in ALWAYS and seed == 0 else pytest.mark.thorough)
    for row in [
        (kind, law, friction, fault)
        for kind in ("passivity", "computed torque")
        for law in ("natural", "euclidean")
        for friction in (True, False)
        for fault in FAULTS
    ]
    for seed in range(3)
]


@pytest.mark.parametrize(("kind", "law", "friction", "fault", "seed"), ROWS)
def test_a_second_of_faults_ruins_no_estimate(kind, law, friction, fault, seed):
    model = MODEL if friction else replace(MODEL, effects=())
    system = controller(kind, law, model, seed)
    episode = Episode(fault, START, STOP)
    path = motion(duration=END + 1.0)
    found = list(moments(system, model, path, [episode], limits=LIMITS, end=END, seed=seed))
    time = np.array([moment.time for moment in found])
    estimates = np.array([moment.parameters for moment in found])
    error = np.array([np.abs(moment.error).max() for moment in found])
    off = distance(system, law, estimates)
    assert off[-1] <= 3.0 * off[time <= START][-1]
    assert error[time >= STOP + 5.0].max() < max(USUAL, 2.0 * error[time <= START].max())
    phi = estimates[:, : system.control.num_inertial].reshape(len(found), -1, 10)
    if law == "natural":
        assert is_physical(phi).all()
    masses = phi[:, :, 0] / system.control.phi(system.control.prior)[:, 0]
    assert masses.max() < 20.0


class TestWatch:
    """What is believed of a sensor."""

    PERIOD = 2e-3

    def watch(self):
        return Watch(1, self.PERIOD, 0.05, 0.02, 1.0)

    def states(self, seconds):
        t = np.arange(0.0, seconds, self.PERIOD)
        return np.stack([np.sin(3.0 * t), 3.0 * np.cos(3.0 * t)], axis=1)

    def believed(self, states):
        watch, memory = self.watch(), self.watch().start()
        told = []
        for state in states:
            seen, memory = watch.look(memory, state, np.zeros(2), np.zeros(1))
            told.append((bool(seen.q == state[:1]), seen.trusted, *seen.noise.ravel()))
        return np.array(told)

    def test_a_smooth_motion_is_believed_and_has_no_noise(self):
        told = self.believed(self.states(2.0))
        assert told[:, :2].all()
        assert told[:, 2].max() < 1e-6
        assert told[:, 3].max() < 1e-3

    def test_noise_is_measured(self):
        states = self.states(3.0)
        rng = np.random.default_rng(0)
        states += rng.normal(size=states.shape) * [1e-3, 0.05]
        told = self.believed(states)
        assert told[:, :2].mean() > 0.99
        assert 1e-3 < told[-500:, 2].mean() < 2e-3  # what velocities add up to is in it
        np.testing.assert_allclose(told[-500:, 3].mean(), 0.05, rtol=0.2)

    @pytest.mark.parametrize("wrong", [[2.0 * np.pi, 0.0], [0.0, 1e3], [1e12, 0.0]])
    def test_an_outlier_is_not_believed(self, wrong):
        states = self.states(2.5)
        states[500] += wrong
        told = self.believed(states)
        assert not told[500, 0] and told[499, 0] and told[501:, 0].all()
        waits = np.flatnonzero(told[:, 1] == 0)
        assert len(waits) == (1 if max(wrong) > 1e6 else 500)  # what is absurd is only missing

    def test_an_encoder_that_sticks_is_found_within_its_drift(self):
        states = self.states(1.2)
        states[500:, 0] = states[500, 0]
        told = self.believed(states)
        first = 500 + int(np.argmax(told[500:, 0] == 0))
        assert np.abs(states[500:first, 1]).sum() * self.PERIOD < 2 * 0.02
        assert not told[first:, 1].any()

    def test_a_step_that_stays_is_taken_in_the_end(self):
        states = self.states(2.0)
        states[500:, 0] += 1.0
        told = self.believed(states)
        again = int(np.argmax(told[501:, 0] == 1))
        assert 0.2 < again * self.PERIOD < 0.3
        assert told[501 + again :, 0].all()


class TestPlausibleLimits:
    START = perturbed(0.05)

    def values(self, estimate, factor=10.0):
        limits = plausible_limits(CONTROL, self.START, factor)
        return limits.violation(estimate)

    def test_model_and_first_estimate_are_inside_and_so_is_what_is_near(self):
        for scale in (0.2, 1.0, 5.0):
            assert not self.values(scale * TRUTH).any()
        assert not self.values(self.START).any()
        for scale in (0.03, 30.0):
            assert (self.values(scale * TRUTH) > 0).any()

    def test_no_frame_matters_to_the_size_of_a_body(self):
        """tr(P₀⁻¹ P) of bodies that are seen from elsewhere."""
        turned = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
        turned *= np.sign(np.linalg.det(turned))
        place = np.array([0.3, -0.2, 0.5])
        sizes = []
        for phi in (CONTROL.phi(TRUTH), change_frame(CONTROL.phi(TRUTH), turned, place)):
            wrong = phi * np.array([[1.5], [0.7]])
            sizes.append(
                [-PhysicalInertia().gradient(a) @ b for a, b in zip(phi, wrong, strict=True)]
            )
        np.testing.assert_allclose(*sizes, rtol=1e-6)

    def test_mass_matrices_are_within_four_times_the_factor(self):
        limits = plausible_limits(CONTROL, TRUTH, 10.0)
        law = ProjectedLaw(natural(), limits)
        rng = np.random.default_rng(2)
        for _ in range(5):
            p = law.project(perturbed(0.3, int(rng.integers(100))) * 1e3)
            sample = CONTROL.at(*rng.normal(size=(4, 2)))
            ratio = np.linalg.eigvals(
                np.linalg.solve(sample.mass_matrix(TRUTH), sample.mass_matrix(p))
            ).real
            assert ratio.max() < 40.0

    def test_laws_are_limited_once(self):
        limits = plausible_limits(CONTROL, TRUTH, 10.0)
        law = limited(natural(), limits)
        assert isinstance(law, ProjectedLaw)
        assert limited(law, limits) is law
        euler = natural_adaptation(MANIFOLD, integrator="euler")
        assert limited(euler, limits) is euler
        last = adapted_parameters(MODEL, [MODEL.bodies[-1]])
        partial = limited(PartialLaw(natural_adaptation(PhysicalInertia()), last), limits)
        assert partial.law.constraints.matrix.shape == (2, 10)
        b = -1e3 * np.ones(len(TRUTH))
        p = TRUTH
        for _ in range(20):
            p = partial.step(p, b, 1e-2)
        assert limits.violation(p).max() < 1e-9 and (p[last] != TRUTH[last]).any()

    @pytest.mark.parametrize("factor", [1.0, 0.0, np.nan])
    def test_a_factor_that_makes_no_sense_is_refused(self, factor):
        with pytest.raises(ArgumentError, match="factor"):
            plausible_limits(CONTROL, TRUTH, factor)
        with pytest.raises(ArgumentError, match="factor"):
            Safeguards(factor=factor)


def test_leakage_takes_the_estimate_to_the_model():
    """p̂̇ = −σ g⁻¹ (∇h(p̂) − ∇h(p₀)), by which D(p₀‖p̂) falls at a rate of σ at least."""
    law, p = natural(0.3), perturbed(0.2)
    before = float(MANIFOLD.divergence(TRUTH, p))
    expected = MANIFOLD.gradient(p) - MANIFOLD.gradient(TRUTH)
    np.testing.assert_allclose(law.leak(p, TRUTH), 0.3 * expected)
    after = law.step(p, 2.0 * law.leak(p, TRUTH), 1e-4)
    fallen = before - float(MANIFOLD.divergence(TRUTH, after))
    symmetric = float((TRUTH - p) @ -expected)  # D(p₀‖p̂) + D(p̂‖p₀)
    np.testing.assert_allclose(fallen, 2e-4 * symmetric, rtol=1e-2)
    assert ProjectedLaw(law, plausible_limits(CONTROL, p, 5.0)).leak(p, TRUTH) == pytest.approx(
        law.leak(p, TRUTH)
    )


@pytest.mark.parametrize("time_step", [0.0, 2e-3])
def test_leakage_acts_while_adaptation_waits(time_step):
    """At rest and on the motion, the tracking error moves nothing; leakage does."""
    moved = []
    for leakage in (0.0, 1.0):
        guards = Safeguards(leakage=leakage, dead_zone=1.0)
        system = PassivityBasedAdaptiveController(
            CONTROL, natural(), time_step=time_step, parameters=perturbed(0.1), safeguards=guards
        )
        context = system.CreateDefaultContext()
        for name, size in (("estimated_state", 4), ("desired_state", 4)):
            system.GetInputPort(name).FixValue(context, np.zeros(size))
        system.GetInputPort("desired_acceleration").FixValue(context, np.zeros(2))
        if time_step == 0:
            rate = system.EvalTimeDerivatives(context).CopyToVector()
        else:
            context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context))
            rate = system.parameters(context) - perturbed(0.1)
        moved.append(rate @ (MANIFOLD.gradient(perturbed(0.1)) - MANIFOLD.gradient(TRUTH)))
    assert moved[0] == 0.0 and moved[1] < 0.0


@pytest.mark.parametrize(
    "wrong",
    [
        {"drift": 0.0},
        {"settling_time": -1.0},
        {"fastest": 0.0},
        {"leakage": -1.0},
        {"drift": np.nan},
    ],
)
def test_safeguards_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ArgumentError, match=next(iter(wrong))):
        Safeguards(**wrong)
