"""Effects: axioms for all of them, their equations, columns, and effects of a user."""

import dataclasses
import textwrap
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from effect_motions import JOINTS, hand_robot, instances, random_motion
from excitation_robots import MODELS
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from own_code import own_effect
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RotationMatrix
from pydrake.multibody.tree import JacobianWrtVariable

import geodrake.effects
from geodrake import effects, load_model
from geodrake.effects import BodyEffect, RobotMotion, sensors
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.effect_columns import dependencies
from geodrake.errors import ArgumentError, ModelError
from geodrake.manifolds import PhysicalInertia


def assert_gradient(effect, motion, atol):
    """Check gradients of Σ weights ∘ regressor against central differences of the motion."""
    weights = np.random.default_rng(1).normal(size=(*motion.v.shape, len(effect.parameters)))
    gradient, step = effect.gradient(motion, weights), 1e-5

    def change(name, entry):
        ends = []
        for by in (step, -step):
            values = getattr(motion, name).copy()
            values[entry] += by
            moved = dataclasses.replace(motion, **{name: values})
            ends.append((weights * effect.regressor(moved)).sum())
        return (ends[0] - ends[1]) / (2 * step)

    for name in ("q", "v", "vd", "load") if gradient is not None else ():
        found = getattr(gradient, name)
        expected = [change(name, entry) for entry in np.ndindex(found.shape)]
        np.testing.assert_allclose(found.ravel(), expected, atol=atol)


@pytest.mark.parametrize("effect", instances(), ids=lambda e: e.name)
class TestEveryEffect:
    def test_regressor(self, effect):
        motion, k = random_motion(), len(effect.parameters)
        mu = np.random.default_rng(1).normal(size=k)
        regressor = effect.regressor(motion)
        assert regressor.shape == (20, 3, k)
        np.testing.assert_allclose(effect.effort(motion, mu), regressor @ mu)
        assert set(effect.rows(motion)) <= set(JOINTS)

    def test_columns_depend_on_what_is_declared_only(self, effect):
        motion, other = random_motion(width=0.1), random_motion(width=0.1, seed=1)
        fields = {"v", "vd", "load", "time", "q"} - effect.depends_on
        moved = dataclasses.replace(motion, **{name: getattr(other, name) for name in fields})
        if "bodies" not in effect.depends_on:
            moved = dataclasses.replace(moved, bodies=None)
        np.testing.assert_array_equal(effect.regressor(moved), effect.regressor(motion))

    def test_gradient(self, effect):
        """Differences are None where those of the whole motion are left to the caller."""
        assert_gradient(effect, random_motion(6, width=0.7), atol=2e-8)

    def test_serial_form(self, effect):
        again = effects.make_effect(effect.name, effect.where, effect.shape)
        assert again == effect
        assert hash(again) == hash(effect)

    def test_manifold(self, effect):
        assert effect.manifold.dimension == len(effect.parameters)
        if isinstance(effect, (effects.Payload, effects.TemporaryPayload)):
            assert effect.manifold == PhysicalInertia()
        else:
            assert effect.manifold.lower == tuple(p.lower for p in effect.parameters)


# What friction gains with the temperature may be less.
RUBBING = [
    e.name for e in instances() if "friction" in e.name and "temperature" not in e.depends_on
]


@pytest.mark.parametrize("name", RUBBING)
def test_friction_brakes(name):
    effect = next(e for e in instances() if e.name == name)
    motion = random_motion(200, width=0.3)
    effort = effect.effort(motion, np.arange(1.0, 1 + len(effect.parameters)))
    power = (effort * motion.v).sum(-1)
    assert (power <= 0 if effect.by_drive else power >= 0).all()
    still = dataclasses.replace(motion, v=np.zeros_like(motion.v))
    np.testing.assert_array_equal(effect.effort(still, np.ones(len(effect.parameters))), 0.0)


MOTION = random_motion()
AT = SimpleNamespace(**{name: getattr(MOTION, name)[:, 1] for name in ("q", "v", "vd", "load")})
SIGN, WARM = np.sign(AT.v), MOTION.temperature[:, 1] - 30.0
ETA = 0.8

EQUATIONS = [
    (effects.ViscousFriction, (), [2.0], 2.0 * AT.v),
    (effects.CoulombFriction, (), [2.0], 2.0 * SIGN),
    (effects.FrictionOvercompensation, (), [2.0], -2.0 * SIGN),
    (
        effects.AsymmetricFriction,
        (),
        [1.0, 2.0, 3.0, 4.0],
        np.where(AT.v > 0, 1.0 + 3.0 * AT.v, -2.0 + 4.0 * AT.v),
    ),
    (
        effects.StribeckFriction,
        (0.2, 1.5),
        [2.5],
        2.5 * np.exp(-(np.abs(AT.v / 0.2) ** 1.5)) * SIGN,
    ),
    (effects.NonlinearViscousFriction, (2.0,), [3.0], 3.0 * AT.v * np.abs(AT.v)),
    (effects.LoadDependentFriction, (), [0.1], 0.1 * np.abs(AT.load) * SIGN),
    (  # driving takes τ / η, braking τ η
        effects.GearEfficiency,
        (),
        [1.0 / ETA - 1.0, 1.0 - ETA],
        np.where(AT.load * AT.v > 0.0, AT.load / ETA, AT.load * ETA) - AT.load,
    ),
    (
        effects.FrictionDrift,
        (0.05,),
        [2.0, 3.0],
        np.exp(-MOTION.time / 0.05) * (2.0 * SIGN + 3.0 * AT.v),
    ),
    (effects.ThermalFriction, (30.0,), [-0.2, -0.1], WARM * (-0.2 * SIGN - 0.1 * AT.v)),
    (effects.EffortOffset, (), [0.7], np.full_like(AT.q, 0.7)),
    (effects.ThermalOffset, (30.0,), [0.7, 0.1], 0.7 + 0.1 * WARM),
    (effects.JointSpring, (1, 0.3), [2.0, 2.0 * (0.3 - 0.7)], 2.0 * (AT.q - 0.7)),
    (effects.JointSpring, (3, 0.3), [2.0, 0.4], 2.0 * (AT.q - 0.3) ** 3 + 0.4),
    (
        effects.GravityCompensator,
        (),
        [3.0 * np.cos(0.4), -3.0 * np.sin(0.4)],
        3.0 * np.sin(AT.q - 0.4),
    ),
    (effects.TorqueRipple, (12.5,), [2.0, -1.0], ((2.0 + 1.0j) * np.exp(12.5j * AT.q)).real),
    (effects.RotorInertia, (), [2.0], 2.0 * AT.vd),
]


@pytest.mark.parametrize(("kind", "shape", "mu", "expected"), EQUATIONS, ids=lambda x: str(x)[:40])
def test_equations_of_joint_effects(kind, shape, mu, expected):
    effort = kind("elbow", *shape).effort(MOTION, np.array(mu))
    np.testing.assert_array_equal(effort[:, [0, 2]], 0.0)
    np.testing.assert_allclose(effort[:, 1], expected, atol=1e-12)


def test_without_time_or_temperature_friction_has_settled():
    readings = np.full_like(MOTION.temperature, 40.0)
    readings[::2] = np.nan  # not known: no change is added
    warm = effects.ThermalFriction("elbow", 30.0)
    some = warm.regressor(dataclasses.replace(MOTION, temperature=readings))[:, 1]
    np.testing.assert_array_equal(some[::2], 0.0)
    np.testing.assert_allclose(some[1::2, 1], 10.0 * AT.v[1::2])
    bare = dataclasses.replace(MOTION, temperature=None, time=None)
    for effect in (warm, effects.FrictionDrift("elbow", 5.0)):
        np.testing.assert_array_equal(effect.regressor(bare), 0.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_coupled_friction_has_the_power_of_its_actuator(sign):
    F, c, v = 2.0, 0.5, MOTION.v
    effort = effects.CoupledFriction(("elbow", "wrist"), sign).effort(MOTION, [F, c])
    w = v[:, 1] + sign * v[:, 2]
    np.testing.assert_allclose((effort * v).sum(-1), F * np.abs(w) + c * w**2)
    np.testing.assert_array_equal(effort[:, 0], 0.0)


def test_coupled_rotor_inertia_is_symmetric():
    effort = effects.CoupledRotorInertia(("elbow", "wrist")).effort(MOTION, [0.3])
    np.testing.assert_allclose(effort[:, 1:], 0.3 * MOTION.vd[:, :0:-1])


Hose = own_effect(
    "hose",
    parameters=(effects.Parameter("a", "N·m"), effects.Parameter("b", "N·m")),
    columns=lambda self, joint: [np.cos(joint.q) * joint.sign_v, 3.0],
)
"""A user's effect that tells no slopes."""


def test_gradients_of_what_tells_no_slopes_and_at_rest():
    motion = random_motion(6, width=0.7)
    assert_gradient(Hose("elbow"), motion, atol=1e-7)
    still = dataclasses.replace(motion, v=np.zeros((6, 3)))
    for exponent in (0.5, 1.0, 2.0):
        for effect in (
            effects.NonlinearViscousFriction("elbow", exponent),
            effects.StribeckFriction("elbow", 0.1, exponent),
            effects.AsymmetricFriction("elbow"),
        ):
            weights = np.ones((6, 3, len(effect.parameters)))
            assert np.isfinite(effect.gradient(still, weights).v).all()


def test_smooth_sign():
    smooth = random_motion(width=0.5)
    np.testing.assert_allclose(smooth.joint("elbow").sign_v, np.tanh(AT.v / 0.5))
    mixed = RobotMotion.direction(np.array([[-2.0, 0.3]]), np.array([0.0, 0.3]))
    np.testing.assert_allclose(mixed, [[-1.0, np.tanh(1.0)]])


class TestBodies:
    """Test effects on bodies against Drake's own kinematics and gravity."""

    motion = random_motion()

    def held_by_tilted_base(self, turn):
        """Return the change of efforts (N, nv) that hold the robot if R rotates its base."""
        plant, _, _ = hand_robot()
        context = plant.CreateDefaultContext()
        level = plant.gravity_field().gravity_vector()
        changes = []
        for q in self.motion.q:
            plant.SetPositions(context, q)
            held = []
            for gravity in (level, turn.inverse() @ level):
                plant.mutable_gravity_field().set_gravity_vector(gravity)
                held.append(-plant.CalcGravityGeneralizedForces(context))
            changes.append(held[1] - held[0])
        plant.mutable_gravity_field().set_gravity_vector(level)
        return np.array(changes)

    @given(arrays(float, 2, elements=st.floats(-1.5, 1.5)))
    @settings(max_examples=25)
    def test_tilt_is_exact_where_it_is_expanded(self, angles):
        angle = float(np.linalg.norm(angles))
        effect = effects.GravityTilt().expanded_about(angles, self.motion.bodies)
        level = effect == effects.GravityTilt()  # to second order of the angles
        assert not level or angle < 0.011
        found = effect.effort(self.motion, angles)
        axis = np.array([*angles, 0.0]) / angle if angle > 1e-9 else np.array([1.0, 0.0, 0.0])
        turn = RotationMatrix(AngleAxis(angle, axis))
        held = self.held_by_tilted_base(turn)
        np.testing.assert_allclose(found, held, atol=1e-9 + level * 100.0 * angle**2)
        assert effect.expanded_about(angles, self.motion.bodies) is effect

    @pytest.mark.parametrize("about", [(np.pi, 0.0), (-1.7, 2.5), (2.0, 0.4)])
    def test_far_from_level_columns_of_fits_are_slopes_of_further_turns(self, about):
        bodies, step = self.motion.bodies, 1e-5
        effect = effects.GravityTilt(*about)
        assert effect.expanded_about(np.array(about), bodies) is effect
        for k, turn in enumerate(step * np.eye(2)):
            moved, angles = effect.settled(np.array(about) + turn, bodies)
            assert moved == effects.GravityTilt(*angles)
            further = RotationMatrix(AngleAxis(step, np.eye(3)[k]))
            axis = np.array([*about, 0.0]) / np.hypot(*about)
            turned = RotationMatrix(AngleAxis(np.hypot(*about), axis))
            held = self.held_by_tilted_base(further @ turned)
            np.testing.assert_allclose(moved.effort(self.motion, angles), held, atol=1e-9)
            slope = (held - self.held_by_tilted_base(turned)) / step
            columns = np.stack(
                [effect.fit_rows(self.motion)[joint][:, k] for joint in self.motion.joints], 1
            )
            np.testing.assert_allclose(columns, slope, atol=1e-3)

    @staticmethod
    def drag_at(point, q, v):
        """Return efforts of drag 1 N·s²/m² at a point (3,) of the hand, and its velocity."""
        plant, _, _ = hand_robot()
        context = plant.CreateDefaultContext()
        plant.SetPositions(context, q)
        frame, world = plant.GetFrameByName("hand"), plant.world_frame()
        of_v = JacobianWrtVariable.kV
        J = plant.CalcJacobianTranslationalVelocity(context, of_v, frame, point, world, world)
        return J.T @ (np.linalg.norm(J @ v) * (J @ v))

    @pytest.mark.parametrize("point", [(0.1, -0.2, 0.3), None])
    def test_drag(self, point):
        effect = effects.AerodynamicDrag("hand", *(point or ()))
        found = effect.effort(self.motion, [0.7, 0.0, 0.0, 0.0])
        at = point or (0.1, 0.02, 0.2)  # the mass centre
        for i, (q, v) in enumerate(zip(self.motion.q, self.motion.v, strict=True)):
            np.testing.assert_allclose(found[i], 0.7 * self.drag_at(at, q, v), atol=1e-12)

    def test_drag_levers_are_slopes(self):
        columns = effects.AerodynamicDrag("hand", 0.1, -0.2, 0.3).regressor(self.motion)
        center, step = np.array([0.1, -0.2, 0.3]), 1e-5
        for i, (q, v) in enumerate(zip(self.motion.q, self.motion.v, strict=True)):
            for k, e in enumerate(step * np.eye(3)):
                slope = (self.drag_at(center + e, q, v) - self.drag_at(center - e, q, v)) / 2 / step
                np.testing.assert_allclose(columns[i, :, 1 + k], slope, atol=1e-6)

    def test_drag_is_expanded_where_its_parameters_say(self):
        effect = effects.AerodynamicDrag("hand")
        moved = effect.expanded_about(np.array([2.0, 0.2, 0.0, -0.4]), self.motion.bodies)
        assert (moved.x, moved.y, moved.z) == pytest.approx((0.2, 0.02, 0.0))
        assert moved.expanded_about(np.array([2.0, 1e-4, 0.0, 0.0]), self.motion.bodies) is moved
        assert moved.expanded_about(np.array([0.0, 1.0, 0.0, 0.0]), self.motion.bodies) is moved

    def test_poses_are_needed(self):
        unknown = dataclasses.replace(self.motion, bodies=None)
        with pytest.raises(ArgumentError, match="gravity_tilt needs poses"):
            effects.GravityTilt().regressor(unknown)

    def test_scale_is_of_all_that_is_needed(self):
        effect = effects.EffortScale("elbow")
        np.testing.assert_allclose(effect.regressor(self.motion)[:, 1, 0], self.motion.load[:, 1])
        total = np.random.default_rng(5).normal(size=self.motion.v.shape)
        whole = dataclasses.replace(self.motion, effort=lambda: total)
        np.testing.assert_allclose(effect.effort(whole, [0.1])[:, 1], 0.1 * total[:, 1])


class TestDelay:
    period = 0.002
    time = np.arange(2000) * period

    @pytest.mark.parametrize("delay", [0.0, 0.0031, 0.02, -0.0007])
    def test_shifts_a_sine(self, delay):
        def signal(t):
            return np.stack([np.sin(40 * t), np.cos(90 * t)], -1)

        delayed = effects.EffortDelay(delay).delayed(signal(self.time), self.period)
        inside = slice(30, -30)
        np.testing.assert_allclose(delayed[inside], signal(self.time - delay)[inside], atol=1e-5)
        ends = effects.EffortDelay(delay).delayed(self.time, self.period)[[0, -1]]
        held = np.clip(self.time[[0, -1]] - delay, *self.time[[0, -1]])
        np.testing.assert_allclose(ends, held, atol=1e-5)

    def test_several_signals(self):
        """Each is delayed by its own time; what makes delays is one effect where they are alike."""
        signals = np.stack([np.sin(40 * self.time), np.cos(90 * self.time)], -1)
        seconds = np.array([0.004, -0.0013])
        found = sensors.delayed_by(seconds, signals, self.period)
        for column, (delay, signal) in enumerate(zip(seconds, signals.T, strict=True)):
            alone = effects.EffortDelay(delay).delayed(signal, self.period)
            np.testing.assert_array_equal(found[:, column], alone)
        joints = ("a", "b")
        for some, count in ((seconds, 2), ([0.003, 0.003], 1), ([0.0, 0.01], 1), ([0, 0], 0)):
            made = sensors.effort_delays(some, joints)
            assert len(made) == count
            np.testing.assert_array_equal(sensors.delays_of(made, joints), some)


def test_every_effect_has_candidates():
    places = {
        "joint": ("elbow", 1.0),
        "joint_pair": (("elbow", "wrist"),),
        "body": ("hand",),
        "robot": (),
    }
    for cls in effects.catalogue():
        if cls.parameters:  # a delay or other inertias have no columns of their own
            found = tuple(cls.candidates(*places[cls.places]))
            assert found and all(isinstance(effect, cls) for effect in found)
            assert len(set(found)) == len(found)


class TestNames:
    def test_nearest_name(self):
        with pytest.raises(ArgumentError, match=r"Did you mean coulomb_friction") as caught:
            effects.effect_class("coulom_friction")
        assert caught.value.evidence["nearest"][0] == "coulomb_friction"
        with pytest.raises(ArgumentError, match="Effects are viscous_friction"):
            effects.effect_class("xyz")

    @pytest.mark.parametrize(
        ("name", "where", "shape", "message"),
        [
            ("coulomb_friction", (), {}, "one joint"),
            ("coupled_friction", ("elbow",), {}, "two joints"),
            ("coupled_friction", ("elbow", "elbow"), {}, "two different joints"),
            ("coupled_friction", ("elbow", "wrist"), {"sign": 2}, "sign 1 or −1"),
            ("effort_delay", ("a", "b"), {"delay": 0.1}, "one joint or none"),
            ("gravity_tilt", ("elbow",), {}, "the whole robot"),
            ("coulomb_friction", ("elbow",), {"width": 1.0}, "no shape parameter 'width'"),
            ("stribeck_friction", ("elbow",), {}, "stribeck_velocity"),
            (
                "stribeck_friction",
                ("elbow",),
                {"stribeck_velocity": -1.0},
                "stribeck_velocity of .* above 0",
            ),
            (
                "stribeck_friction",
                ("elbow",),
                {"stribeck_velocity": "fast"},
                "must be a finite real number",
            ),
            ("joint_spring", ("elbow",), {"exponent": 2}, "exponent 1 or 3"),
        ],
    )
    def test_bad_serial_form(self, name, where, shape, message):
        with pytest.raises(ArgumentError, match=message):
            effects.make_effect(name, where, shape)

    def test_unknown_joint(self):
        with pytest.raises(ArgumentError, match=r"no joint 'knee'.*shoulder"):
            effects.CoulombFriction("knee").regressor(random_motion())


def documented_lines():
    """Return the lines of a user's effect in the documentation."""
    text = geodrake.effects.__doc__
    block = text[text.index("    from dataclasses") :]
    lines = block[: block.index("\n\n`HangingHose")]
    return textwrap.dedent(lines)


class TestUsersEffect:
    def test_file(self, tmp_path):
        assert len([line for line in documented_lines().splitlines() if line.strip()]) <= 10
        path = tmp_path / "hose.py"
        path.write_text(documented_lines())
        extra = effects.load_effect_file(path)
        assert [cls.name for cls in extra] == ["hanging_hose"]
        hose = effects.make_effect("hanging_hose", ["elbow"], {}, extra)
        motion = random_motion()
        expected = 2.0 * np.cos(motion.q[:, 1]) + 3.0 * np.sin(motion.q[:, 1])
        np.testing.assert_allclose(hose.effort(motion, [2.0, 3.0])[:, 1], expected)
        assert hose.manifold.contains([-1.0, 5.0])
        assert tuple(extra[0].candidates("elbow", 1.0)) == (hose,)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("from geodrake.effects import CoulombFriction", "defines no effect"),
            (documented_lines().replace("hanging_hose", "payload"), "'payload' of another"),
            (documented_lines().replace("name =", "label ="), "lacks name"),
            (documented_lines().replace('"sine"', '"cosine"'), "two parameters 'cosine'"),
            *(
                (documented_lines().replace('name = "h', f'{line}\n    name = "h'), message)
                for line, message in (
                    ("complexty = 1", "complexty = 1, which is not used; it needs complexity"),
                    ("jumps = 'yes'", "jumps = 'yes'; it needs True or False"),
                    ("rows = None", "rows = None; it needs a method of that name"),
                    ("depends_on = {'x'}", "it needs some of bodies, history, load"),
                    ("shapes = ('a',)", "it needs a tuple of Shape"),
                    ("contains = (int,)", "it needs a tuple of classes of effects"),
                    ("from geodrake.effects import Role; role = Role.SCALE", "base EffortScale"),
                    (
                        "from geodrake.effects import Proposer; proposer = Proposer.PLAY",
                        "the base DeflectionEffect for it",
                    ),
                )
            ),
        ],
    )
    def test_bad_files(self, tmp_path, text, message):
        path = tmp_path / "mine.py"
        path.write_text(text)
        with pytest.raises(ModelError, match=message):
            effects.load_effect_file(path)

    def test_no_file(self, tmp_path):
        with pytest.raises(ModelError, match=r"absent\.py does not exist\. Check the path"):
            effects.load_effect_file(tmp_path / "absent.py")
        (tmp_path / "effects.txt").write_text("x = 1\n")
        with pytest.raises(ModelError, match="not a Python file"):
            effects.load_effect_file(tmp_path / "effects.txt")

    @pytest.mark.parametrize(
        ("field", "places", "place"),
        [("body", "body", "hand"), ("joints", "joint_pair", ("elbow", "wrist"))],
    )
    def test_candidates_without_a_base_of_its_kind(self, tmp_path, field, places, place):
        path = tmp_path / "bare.py"
        path.write_text(
            "from dataclasses import dataclass\n"
            "from geodrake.effects import Effect, Parameter\n"
            "@dataclass(frozen=True)\n"
            "class Bare(Effect):\n"
            f"    {field}: object\n"
            f"    name, places = 'bare', {places!r}\n"
            "    parameters = (Parameter('a', 'N'),)\n"
            "    where = ()\n"
            "    def rows(self, motion):\n"
            "        return {}\n"
        )
        (cls,) = effects.load_effect_file(path)
        assert tuple(cls.candidates(place)) == (cls(place),)
        path.write_text(path.read_text().replace(f"    {field}:", "    spot:"))
        with pytest.raises(ModelError, match=r"\['spot'\].*BodyEffect"):
            effects.load_effect_file(path)

    def test_speed_of_a_joint_is_no_shape(self):
        @dataclasses.dataclass(frozen=True)
        class Bare(effects.Effect):
            joint: str
            width: float = 0.1

            name, places, where = "bare", "joint", ()
            parameters = (effects.Parameter("a", "N·m"),)

            def rows(self, motion: RobotMotion):
                return {self.joint: np.tanh(motion.joint(self.joint).v / self.width)[:, None]}

        assert Bare.candidates("elbow", 3.87) == (Bare("elbow", 0.1),)
        Bare.shapes = (effects.Shape("width", "rad/s", (0.1, 0.5), "speed"),)
        assert Bare.candidates("elbow", 2.0) == (Bare("elbow", 0.2), Bare("elbow", 1.0))

    def test_words_are_no_values_that_results_report(self):
        @dataclasses.dataclass(frozen=True)
        class Tuned(effects.EffortOffset):
            kind: str = "loose"
            width: float = 0.1
            teeth: int = 3

        assert Tuned("elbow").reported_shape == {"width": 0.1, "teeth": 3.0}

    def test_body_effect(self):
        @dataclasses.dataclass(frozen=True)
        class Drag(effects.BodyEffect):
            area: float

            name = "drag"
            parameters = (effects.Parameter("d", "N·s²/m²", lower=0.0),)

            def rows(self, motion: RobotMotion):
                return {"elbow": motion.body_columns(self.body)[:, 1, :1]}

        drag = Drag("hand", 2.0)
        assert (drag.where, drag.places, drag.shape) == (("hand",), "body", {"area": 2.0})
        assert drag.regressor(random_motion()).shape == (20, 3, 1)
        assert drag.gradient(random_motion(), np.ones((20, 3, 1))) is None
        with pytest.raises(
            ArgumentError, match=r"drag cannot be constructed from its place 'hand' alone"
        ):
            Drag.candidates("hand")


EVERY = tuple(instances())


def trial(v, vd, load):
    """Return columns of the hand, which resemble those of gravity and accelerations."""
    motion = random_motion(len(v), width=0.1)
    columns = motion.body_columns("hand") * (1.0 + vd[:, :, None])
    return replace(motion, v=v, vd=vd, load=load, body_columns={"hand": columns}.__getitem__)


Flywheel = own_effect("flywheel", columns=lambda self, joint: [joint.vd * np.sin(joint.q)])


def by_name(self, joint):
    """Return another effect at every joint that uses its own sample only."""
    return [{"shoulder": 1.0, "elbow": -2.0}[self.joint] * joint.q]


def by_body(self, motion):
    return {j: motion.body_columns(self.body)[:, i, :1] for i, j in enumerate(motion.joints)}


ByName = own_effect("by_name", columns=by_name)
Weight = own_effect("weight", BodyEffect, rows=by_body)


@dataclass(frozen=True)
class Pressed(effects.CoulombFriction):
    """A user's effect that inherits the declarations of another one."""

    name = "pressed"

    def columns(self, joint):
        return [joint.load * joint.sign_v]


@dataclass(frozen=True)
class Declared(Flywheel):
    name = "declared"
    depends_on = frozenset({"q", "vd", "time"})


@pytest.mark.parametrize(
    ("effect", "found"),
    [
        (Flywheel("elbow"), {"q", "v", "vd"}),
        (Declared("elbow"), {"q", "vd", "time"}),
        (ByName("elbow"), {"q", "v"}),
        (Weight("hand"), {"q", "v", "vd", "bodies", "time"}),
        (Pressed("elbow"), {"q", "v", "load"}),
        (effects.RotorInertia("elbow"), {"vd"}),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_users_effects_are_tried(effect, found):
    assert dependencies(effect, trial, len(JOINTS)) == found


@pytest.mark.parametrize("robot", ["arm6", "double_pendulum", "ambidex_like"])
def test_poses_jacobians_and_weights(robot):
    model = load_model(MODELS / f"{robot}.urdf")
    plant, of_v, point = model.plant, JacobianWrtVariable.kV, np.array([0.1, -0.2, 0.3])
    q = np.random.default_rng(1).normal(size=(3, plant.num_positions()))
    bodies = RobotBodies(model.tree, q, model.phi)
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    weights = bodies.gravity_efforts(bodies.gravity[:, None])[..., 0]
    for i in range(len(q)):
        plant.SetPositions(context, q[i])
        held = -plant.CalcGravityGeneralizedForces(context)
        np.testing.assert_allclose(weights[i], held, atol=1e-9 * np.abs(held).max())
        for name in bodies.tree.bodies:
            motion, frame = bodies.motion(name), plant.GetFrameByName(name)
            X_WB = frame.CalcPoseInWorld(context)
            np.testing.assert_allclose(motion.rotation[i], X_WB.rotation().matrix(), atol=1e-12)
            np.testing.assert_allclose(motion.position[i], X_WB.translation(), atol=1e-12)
            for at, linear in ((np.zeros(3), motion.linear), (point, motion.jacobian_at(point))):
                J = plant.CalcJacobianSpatialVelocity(context, of_v, frame, at, world, world)
                np.testing.assert_allclose(np.vstack([motion.angular[i], linear[i]]), J, atol=1e-12)
            assert set(np.flatnonzero(np.abs(J).max(0)).tolist()) <= set(motion.dofs)
    for name in bodies.tree.bodies:
        welded = [b.index() for b in plant.GetBodiesWeldedTo(plant.GetBodyByName(name))]
        inertia = plant.CalcSpatialInertia(context, plant.GetFrameByName(name), welded)
        np.testing.assert_allclose(bodies.mass_center(name), inertia.get_com(), atol=1e-12)
    with pytest.raises(ArgumentError, match="no moving body 'moon'"):
        bodies.motion("moon")
