"""The benchmark of hidden effects: its engines, its logs, how it scores, and what it must show."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from diagrams.benchmarks.hidden import logs, robots, scoring
from diagrams.benchmarks.hidden.robots import (
    MuJoCoEngine,
    PinocchioEngine,
    congruent,
    pseudo,
    robot_file,
    robot_model,
    robot_names,
)
from diagrams.benchmarks.hidden.truths import OUTSIDE, TRUTHS

PLAIN = {
    "robot": "arm6",
    "motion": robots.FAST,
    "prior": logs.EXACT,
    "noise": 0.01,
    "duration": 16.0,
    "rate": 125.0,
}


@pytest.fixture(params=robot_names())
def engines(request):
    file = robot_file(request.param)
    return PinocchioEngine(file), MuJoCoEngine(file)


class TestEngines:
    def test_agree_on_other_bodies_and_gravity(self, engines):
        rng = np.random.default_rng(0)
        bodies = congruent(engines[0].bodies(), 0.2, rng)
        samples = rng.normal(size=(3, 5, len(bodies)))
        for engine in engines:
            engine.set_bodies(bodies)
            engine.set_gravity(np.array([1.0, -2.0, -9.0]))
            np.testing.assert_allclose(engine.bodies(), bodies, rtol=1e-9, atol=1e-12)
        efforts, others = (engine.efforts(*samples) for engine in engines)
        np.testing.assert_allclose(efforts, others, rtol=1e-9, atol=1e-9 * np.abs(efforts).max())


def test_congruent_bodies_are_physical_and_as_far_as_asked():
    P = np.repeat(
        pseudo(2.0, np.array([0.1, 0.0, 0.2]), np.diag([0.02, 0.03, 0.04]))[None], 4000, 0
    )
    found = congruent(P, 0.2, np.random.default_rng(0))
    assert np.linalg.eigvalsh(found).min() > 0.0
    L = np.linalg.cholesky(P[0])
    whitened = np.linalg.solve(L, np.linalg.solve(L, found).transpose(0, 2, 1))
    distance = np.sqrt((np.log(np.linalg.eigvalsh(whitened)) ** 2).sum(1))
    assert np.sqrt(np.mean(distance**2)) == pytest.approx(0.2 * np.sqrt(10.0), rel=0.05)
    assert np.log(found[:, 3, 3] / 2.0).std() == pytest.approx(0.2, rel=0.1)


class TestLogs:
    @pytest.mark.parametrize(
        ("names", "together"),
        [
            (("joint_spring", "effort_offset"), False),
            (("asymmetric_friction", "coulomb_friction"), False),
            (("viscous_friction", "asymmetric_friction"), False),
            (("joint_spring", "viscous_friction"), True),
        ],
    )
    def test_what_no_log_can_tell_apart_is_not_at_one_joint(self, names, together):
        places = []
        for number in range(8):
            small = {**PLAIN, "robot": "double_pendulum", "duration": 4.0, "shares": (0.1, 0.1)}
            draw = logs.draw("two", names, number, 0, **small)
            made = logs.make_recording(draw, robot_model("double_pendulum").bodies)
            places.append([secret.where for secret in made.secrets])
        assert any(first == second for first, second in places) == together

    @pytest.mark.parametrize("name", [*TRUTHS, *OUTSIDE])
    def test_effects_have_the_size_that_was_asked_for(self, name):
        draw = logs.draw("one", (name,), 0, 0, **{**PLAIN, "duration": 5.0, "shares": (0.04,)})
        made = logs.make_recording(draw, robot_model("arm6").bodies)
        (secret,) = made.secrets
        assert secret.share == pytest.approx(0.04, rel=0.1)
        assert set(secret.where) <= {*robot_model("arm6").joints, *robot_model("arm6").bodies}


EASY = ("load_dependent_friction", "gravity_tilt")


class TestWhatItMustShow:
    def test_easy_effects(self):
        fixed = {**PLAIN, "robot": "double_pendulum", "shares": (0.12,)}
        rows = [scoring.score_draw(logs.draw("one", (n,), 0, 0, **fixed)) for n in EASY]
        assert all(row["first"] and row["in_set"] and not row["extra"] for row in rows)
        assert np.median([row["over_floor"] for row in rows]) < 1.1

    def test_outside_effects(self):
        name = "brake that another joint's position tightens"
        fixed = {**PLAIN, "robot": "double_pendulum", "shares": (0.15,)}
        row = scoring.score_draw(logs.draw("outside", (name,), 0, 0, **fixed))
        assert row["verdict"] == "unexplained"
        assert row["right_joint"]
        assert row["right_correlate"]
