"""Forces that a robot has and its model lacks are found, named and placed.

Logs are inverse dynamics by Pinocchio of bodies that are 20 % off, with the force in a formula of
its own on top. Friction and other effects of older date are in test_hidden_effects.py.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import pinocchio as pin
from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import add, diagnose, explain
from geodrake.effects import JointEffect, Parameter, Proposer
from geodrake.identification.logs.noise import prepare_for_model
from geodrake.logs.motion import Motion
from geodrake.model.saved_model import save_model

MARGIN = 1.15
"""Largest held-out error, as a multiple of the error that the noise alone makes."""

SEEDS = (1, pytest.param(2, marks=pytest.mark.thorough))


@cache
def model_file(name):
    return load_model(MODELS / f"{name}.urdf")


def assert_found(model, recording, expected, *, margin=MARGIN):
    """The expected effects, at their places and no others, and only the noise is left."""
    found = explain(model, [recording.log])
    assert {step.effect: set(step.where) for step in found.steps} == {
        effect: set(where) for effect, where in expected.items()
    }
    trajectories, _ = prepare_for_model(model, [recording.log])
    noise = recording.noise * trajectories[0].filter.noise_gain
    stds = [joint.std for joint in found.end.joints]
    floor = np.sqrt(np.mean((noise / stds) ** 2))
    assert found.end.nrms < margin * floor
    assert found.verdict == "explained"
    return {step.effect: step.parameters for step in found.steps}, found


def size_of(values):
    """Amplitude of the waves of two parameters."""
    return np.hypot(values["sine"], values["cosine"])


def wave(joint, amplitude, order, phase=0.4):
    return lambda seen: {joint: amplitude * np.sin(order * seen.q[:, joint] - phase)}


@pytest.mark.thorough  # test_bodies_or_effects.py has one, too
class TestGravityCompensator:
    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.parametrize(
        ("joint", "name"),
        [(0, "base_yaw"), (1, "shoulder_pitch")],
    )
    def test_found(self, joint, name, seed):
        recording = effort_log("arm6", seed, wave(joint, (6.0, 20.0)[joint], 1.0), off=0.2)
        steps, _ = assert_found(model_file("arm6"), recording, {"gravity_compensator": (name,)})
        values = steps["gravity_compensator"][name]
        assert size_of(values) == pytest.approx((6.0, 20.0)[joint], rel=0.05)


class TestTorqueRipple:
    def test_found_in_a_pendulum_under_friction(self):
        """Ripple of an eighteenth of the friction."""

        def hidden(seen):
            dry = 0.9 * np.tanh(seen.v[:, 1] / 0.01)
            return {1: wave(1, 0.05, 40.0)(seen)[1] + dry}

        recording = effort_log("double_pendulum", 3, hidden, duration=40.0)
        expected = {"coulomb_friction": ("elbow",), "torque_ripple": ("elbow",)}
        steps, _ = assert_found(model_file("double_pendulum"), recording, expected)
        values = steps["torque_ripple"]["elbow"]
        assert values["order"] == pytest.approx(40.0, abs=0.1)
        assert size_of(values) == pytest.approx(0.05, rel=0.06)

    def test_named_by_one_diagnosis(self):
        recording = effort_log("double_pendulum", 3, wave(1, 0.05, 40.0), duration=40.0)
        found = diagnose(model_file("double_pendulum"), [recording.log])
        assert found.candidates[0].effect == "torque_ripple"
        assert found.candidates[0].where == ("elbow",)

    def test_added_by_name(self):
        recording = effort_log("double_pendulum", 3, wave(1, 0.05, 40.0), duration=40.0)
        found = add("torque_ripple", model_file("double_pendulum"), [recording.log])
        (step,) = found.steps
        assert step.where == ("elbow",)
        assert step.parameters["elbow"]["order"] == pytest.approx(40.0, abs=0.1)
        assert found.end.nrms < 0.5 * found.start.nrms


@dataclasses.dataclass(frozen=True)
class TwoHarmonics(JointEffect):
    """A user's wave with a second harmonic, of an order that the residual tells."""

    order: float

    name = "two_harmonics"
    proposer = Proposer.WAVES
    depends_on = frozenset({"q"})
    parameters = tuple(Parameter(name, "N·m") for name in ("a", "b", "c", "d"))

    def columns(self, joint):
        angle = self.order * joint.q
        return [np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)]


class TestUsersWave:
    """The residual proposes effects of a user's own as it does those of the catalogue."""

    def recording(self):
        first, second = wave(1, 0.05, 40.0), wave(1, 0.045, 80.0)

        def hidden(seen):
            return {1: first(seen)[1] + second(seen)[1]}

        return effort_log("double_pendulum", 3, hidden, duration=40.0)

    def test_explained(self):
        model, log = model_file("double_pendulum"), self.recording().log
        (step,) = explain(model, [log], extra=[TwoHarmonics]).steps
        assert (step.effect, step.where) == ("two_harmonics", ("elbow",))
        assert step.parameters["elbow"]["order"] == pytest.approx(40.0, abs=0.1)

    def test_added(self):
        model, log = model_file("double_pendulum"), self.recording().log
        (step,) = add("two_harmonics", model, [log], extra=[TwoHarmonics]).steps
        assert step.where == ("elbow",)
        assert step.parameters["elbow"]["order"] == pytest.approx(40.0, abs=0.1)


def tilted(x, y):
    """Effort of a base that is turned about x, then y, by Pinocchio with another gravity."""

    def hidden(seen):
        leaning = pin.Model(seen.model)
        leaning.gravity.linear = pin.rpy.rpyToMatrix(x, y, 0.0).T @ np.array([0.0, 0.0, -9.81])
        data = leaning.createData()
        samples = zip(seen.q, seen.v, seen.a, strict=True)
        return np.array([pin.rnea(leaning, data, *sample) for sample in samples]) - seen.load

    return hidden


class TestGravityTilt:
    @pytest.mark.parametrize(
        ("name", "angles", "seed"),
        [
            ("arm6", (0.03, -0.05), 1),
            *(
                pytest.param(name, angles, seed, marks=pytest.mark.thorough)
                for name in ("arm6", "arm7")
                for angles in ((0.03, -0.05), (-1.5, 0.0))
                for seed in (1, 2)
                if (name, angles, seed) != ("arm6", (0.03, -0.05), 1)
            ),
        ],
    )
    def test_found_and_saved(self, name, angles, seed, tmp_path):
        """A slope shows moments of the first body that a level base hides; a wall does so fully."""
        recording = effort_log(name, seed, tilted(*angles), off=0.2)
        steps, found = assert_found(model_file(name), recording, {"gravity_tilt": ()})
        values = steps["gravity_tilt"]["base"]
        assert set(values) == {"tilt_x", "tilt_y"}
        near = 2e-3 if max(map(abs, angles)) < 0.1 else 5e-3
        assert [*values.values()] == pytest.approx(angles, abs=near)
        save_model(found.model, tmp_path / "arm.yaml")
        other = effort_log(name, seed, tilted(*angles), off=0.2, share=0.031)
        assert explain(load_model(tmp_path / "arm.yaml"), [other.log]).steps == ()


def dragged(joint, point, drag):
    """Effort of drag at a point of a joint's body, by Pinocchio's Jacobian of that body."""

    def hidden(seen):
        effort = np.empty_like(seen.q)
        for i, (q, v) in enumerate(zip(seen.q, seen.v, strict=True)):
            J = pin.computeJointJacobian(seen.model, seen.data, q, joint)  # about and in the body
            linear = J[:3] - pin.skew(np.array(point)) @ J[3:]
            velocity = linear @ v
            effort[i] = drag * linear.T @ velocity * np.linalg.norm(velocity)
        return effort

    return hidden


class TestAerodynamicDrag:
    def test_found_on_the_smallest_robot(self):
        """Which moves in a plane, where two coordinates of the centre of pressure show."""
        recording = effort_log(
            "double_pendulum", 1, dragged(2, (0.0, 0.0, -0.3), 3.0), off=0.2, duration=16, rate=100
        )
        places = {"aerodynamic_drag": ("lower_link",)}
        steps, _ = assert_found(model_file("double_pendulum"), recording, places)
        values = steps["aerodynamic_drag"]["lower_link"]
        assert values["drag"] == pytest.approx(3.0, rel=0.05)
        center = [values[axis] + values[f"drag_lever_{axis}"] / values["drag"] for axis in "xz"]
        np.testing.assert_allclose(center, (0.0, -0.3), atol=0.02)


class TestFrictionDrift:
    @pytest.mark.thorough
    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.parametrize(
        ("joint", "name", "size"),
        [
            (1, "shoulder_pitch", 5.0),
            pytest.param(3, "wrist_roll", 0.25, marks=pytest.mark.thorough),
        ],
    )
    def test_found(self, joint, name, size, seed):
        """Friction that falls as 1 / (1 + t / 8 s) from one and a half times its last value."""

        def hidden(seen):
            v = seen.v[:, joint]
            warm = 1.0 + 0.5 / (1.0 + seen.time / 8.0)
            return {joint: size * warm * (v / np.sqrt(v**2 + 1e-4) + v)}

        recording = effort_log("arm6", seed, hidden, off=0.2)
        found = ("coulomb_friction", "viscous_friction", "friction_drift")
        wanted = dict.fromkeys(found, (name,))  # which falls by another law
        steps, _ = assert_found(model_file("arm6"), recording, wanted, margin=1.5 * MARGIN)
        values = steps["friction_drift"][name]
        settled = steps["coulomb_friction"][name]["coulomb"]
        assert settled + values["coulomb_change"] == pytest.approx(1.5 * size, rel=0.1)

    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.thorough
    def test_that_settles_at_none(self, seed):
        def hidden(seen):
            v = seen.v[:, 1]
            return {1: 8.0 * (1.0 + seen.time / 6.0) ** -3 * (v / np.sqrt(v**2 + 1e-4) + v)}

        steps = explain(model_file("arm6"), [effort_log("arm6", seed, hidden).log]).steps
        assert ("friction_drift", ("shoulder_pitch",)) in [(s.effect, s.where) for s in steps]
        beside = {"coulomb_friction", "viscous_friction"}
        assert {step.effect for step in steps} <= {"friction_drift"} | beside

    @pytest.mark.parametrize("seed", SEEDS)
    @pytest.mark.thorough
    def test_not_where_friction_stays(self, seed):
        steps = explained_rubbing(seed).steps
        assert {step.effect for step in steps} == {"coulomb_friction", "viscous_friction"}


def rubbing(seen):
    size = np.array([3.0, 3.0, 3.0, 0.15, 0.15, 0.15])
    return size * (np.tanh(seen.v / 0.01) + 0.7 * seen.v)


@cache
def explained_rubbing(seed):
    """What explains friction at all joints of an arm."""
    return explain(model_file("arm6"), [effort_log("arm6", seed, rubbing).log])


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """An arm whose inertias are known from another log."""
    model = explained_rubbing(1).model
    path = tmp_path_factory.mktemp("known") / "arm6.yaml"
    save_model(model, path)
    return load_model(path)


class TestEffortScale:
    """A gain can be told once the inertias are known from another log."""

    @pytest.mark.parametrize(
        ("joint", "name"),
        [(1, "shoulder_pitch"), (4, "wrist_pitch")],
    )
    @pytest.mark.thorough
    def test_found(self, known, joint, name):
        def hidden(seen):
            effort = rubbing(seen)
            effort[:, joint] += 0.08 * (seen.load + effort)[:, joint]
            return effort

        recording = effort_log("arm6", 7, hidden)
        log = dataclasses.replace(recording.log, effort_uncertainty=0.0)
        recording = dataclasses.replace(recording, log=log)
        steps, found = assert_found(known, recording, {"effort_scale": (name,)})
        assert steps["effort_scale"][name]["gain_error"] == pytest.approx(0.08, abs=4e-3)
        motion = Motion(*random_states(), time=None)
        scaled, plain = found.model.effort(motion), known.effort(motion)
        np.testing.assert_allclose(scaled[:, joint], 1.08 * plain[:, joint], rtol=0.03, atol=0.05)

    @pytest.mark.parametrize(
        ("uncertainty", "named"),
        [(0.05, False), (0.02, True)],
    )
    @pytest.mark.thorough
    def test_only_if_it_is_unusual(self, known, uncertainty, named):
        """Gains of torque constants that are known to 5 % may be off by 8 %."""

        def hidden(seen):
            effort = rubbing(seen)
            effort[:, 1] += 0.08 * (seen.load + effort)[:, 1]
            return effort

        log = effort_log("arm6", 7, hidden).log
        log = dataclasses.replace(log, effort_uncertainty=uncertainty)
        found = explain(known, [log])
        assert ("effort_scale" in {step.effect for step in found.steps}) == named
        told = [note for note in found.notes if note.startswith("efforts of shoulder_pitch are ")]
        assert len(told) == (not named)

    @pytest.mark.thorough
    def test_nothing_where_nothing_changed(self, known):
        assert explain(known, [effort_log("arm6", 8, rubbing).log]).steps == ()

    @pytest.mark.parametrize(
        "name", ["double_pendulum", pytest.param("arm6", marks=pytest.mark.thorough)]
    )
    def test_not_offered_to_a_model_file(self, name):
        def hidden(seen):
            return 0.08 * seen.load * np.eye(seen.load.shape[1])[1]

        found = explain(model_file(name), [effort_log(name, 7, hidden).log])
        assert "effort_scale" not in {step.effect for step in found.steps}
        assert "effort_scale" not in {
            name for step in found.steps for name in step.indistinguishable_from
        }


def random_states(n=50, nv=6):
    return np.random.default_rng(3).normal(size=(3, n, nv))


class TestGearEfficiency:
    """Of a joint that moves, other losses in driving than in braking are a gain of its load."""

    @staticmethod
    def geared(driving, braking, uncertainty, seed=7):
        def hidden(seen):
            effort, v, load = rubbing(seen), seen.v[:, 1], seen.load[:, 1]
            loss = np.where(load * v > 0.0, driving, braking) * np.abs(load)
            effort[:, 1] += loss * v / np.hypot(v, 5e-3)
            return effort

        recording = effort_log("arm6", seed, hidden)
        log = dataclasses.replace(recording.log, effort_uncertainty=uncertainty)
        return dataclasses.replace(recording, log=log)

    @pytest.mark.parametrize("seed", [7, pytest.param(8, marks=pytest.mark.thorough)])
    def test_found(self, known, seed):
        recording = self.geared(0.25, 0.1, 0.0, seed)
        steps, _ = assert_found(known, recording, {"gear_efficiency": ("shoulder_pitch",)})
        losses = steps["gear_efficiency"]["shoulder_pitch"]
        assert losses["driving_loss"] == pytest.approx(0.25, abs=0.01)
        assert losses["braking_loss"] == pytest.approx(0.1, abs=0.01)

    @pytest.mark.thorough
    def test_only_where_losses_differ(self, known):
        steps = explain(known, [self.geared(0.12, 0.12, 0.0).log]).steps
        names = [step.effect for step in steps]
        assert "load_dependent_friction" in names
        assert "gear_efficiency" not in names
