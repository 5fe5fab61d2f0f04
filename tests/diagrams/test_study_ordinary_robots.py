"""The benchmark of ordinary robots: its robots, its logs, and how it scores."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from diagrams.benchmarks import ordinary_robots as scoring
from diagrams.benchmarks.hidden.robots import (
    FAST,
    POINTS,
    MuJoCoEngine,
    PinocchioEngine,
    robot_file,
    robot_model,
)
from diagrams.benchmarks.ordinary import logs
from diagrams.benchmarks.ordinary.logs import (
    ARMS,
    DRY,
    KINDS,
    ORDINARY,
    OUTSIDE,
    QUIET,
    ROTOR,
    TOOL,
    all_draws,
    draw,
    make_recording,
)
from geodrake.inertia import pseudo_inertia

SHORT = {"duration": 6.0, "rate": 100.0, "noise": 0.01, "velocities": True, "quantised": False}


@pytest.mark.parametrize("name", ARMS)
def test_bodies_are_those_that_geodrake_reads(name):
    model = robot_model(name)
    for engine in (PinocchioEngine(robot_file(name)), MuJoCoEngine(robot_file(name))):
        assert engine.joints == model.joints
        P = pseudo_inertia(model.phi)
        np.testing.assert_allclose(engine.bodies(), P, rtol=1e-6, atol=1e-6 * np.abs(P).max())


def test_draws_have_all_cases_early_and_all_kinds():
    draws = all_draws(0)
    assert {each.case for each in draws[:4]} == {ORDINARY, OUTSIDE, QUIET}
    assert sorted(each.kind for each in draws if each.case == OUTSIDE) == sorted(KINDS)
    assert {each.robot for each in draws if each.case == ORDINARY} == set(ARMS)
    assert draws != all_draws(1)


def test_same_draw_is_the_same_log():
    made = [make_recording(draw(ORDINARY, "z1", 2, 5, **SHORT)).logs[1] for _ in range(2)]
    np.testing.assert_array_equal(made[0].effort, made[1].effort)
    np.testing.assert_array_equal(made[0].position, made[1].position)


class TestRecording:
    def test_friction_and_rotors_have_the_size_that_was_drawn(self):
        own = draw(ORDINARY, "ur5", 0, 1, **{**SHORT, "noise": 0.0, "tool": 0.0, "off": 0.0})
        own = replace(own, rotors=True)
        bare = make_recording(replace(own, friction=False, rotors=False))
        full, dry = make_recording(own), make_recording(replace(own, rotors=False))
        sizes = np.array(full.values[DRY])
        assert (sizes > 0.0).all()
        for k, log in enumerate(dry.logs):
            rubbing = np.abs(log.effort - bare.logs[k].effort).max(0)
            assert (rubbing > 0.9 * sizes).all()
            assert (rubbing < 2.6 * sizes).all()
            rotors = full.logs[k].effort - log.effort
            assert np.abs(rotors).max() > 0.0
        assert set(full.hidden) == {DRY, "viscous_friction", ROTOR}

    def test_tool_hangs_at_the_last_link(self):
        own = draw(ORDINARY, "z1", 0, 1, **{**SHORT, "noise": 0.0, "tool": 0.1, "off": 0.0})
        own = replace(own, friction=False, rotors=False)
        made = make_recording(own)
        total = float(robot_model("z1").phi.reshape(-1, 10)[:, 0].sum())
        assert made.mass == pytest.approx(0.1 * total)
        assert made.hidden == {TOOL: (robot_model("z1").bodies[-1],)}
        assert (
            np.abs(
                made.logs[0].effort - make_recording(replace(own, tool=0.0)).logs[0].effort
            ).max()
            > 0.1
        )

    @pytest.mark.parametrize("kind", KINDS)
    def test_effects_of_no_catalogue_have_a_usual_size(self, kind):
        own = draw(OUTSIDE, "ur5", 0, 2, **{**SHORT, "kind": kind})
        engine = MuJoCoEngine(robot_file("ur5"))
        motions = [logs._moved(own, engine, each) for each in (FAST, POINTS)]
        largest = np.max([np.abs(seen.load).max(0) for seen in motions], 0)
        site = logs._site(own, motions, largest)
        effort = logs._sized(own, site, motions)
        efforts = np.concatenate([effort(seen, 1.0) for seen in motions])
        shares = np.sqrt(np.mean(efforts**2, 0))
        shares /= np.concatenate([seen.load for seen in motions]).std(0)
        assert 0.045 < shares.max() < 0.27
        if kind not in {"pendulum in a link", "slipping belt"}:  # which act on other joints, too
            acting = set(np.flatnonzero(shares).tolist())
            assert site.joint in acting <= {site.joint, site.other}


def _step(effect, where, probability=0.95):
    return SimpleNamespace(
        effect=effect,
        where=where,
        probability=probability,
        indistinguishable_from=(),
        parameters={},
        deviations={},
        systematic={},
    )


class TestScores:
    RECORDING = SimpleNamespace(
        hidden={DRY: ("a", "b")}, beside={"effort_offset": ("a",)}, mass=0.0, joints=()
    )

    @pytest.mark.parametrize(
        ("effect", "where", "off", "right"),
        [
            (DRY, ("a",), 0.0, True),
            (DRY, ("a", "c"), 0.0, False),
            ("effort_offset", ("a",), 0.0, True),
            ("effort_offset", ("b",), 0.0, False),
            ("wrong_inertia", ("link",), 0.0, False),
            ("wrong_inertia", ("link",), 0.3, True),
        ],
    )
    def test_right_at_all_its_places(self, effect, where, off, right):
        own = SimpleNamespace(off=off)
        assert scoring._step_row(_step(effect, where), own, self.RECORDING)["right"] is right

    def test_missing_is_said_place_by_place(self):
        found = scoring._missing([_step(DRY, ("b",))], {DRY: ("a", "b"), TOOL: ("link",)})
        assert found == [f"{DRY} at a", f"{TOOL} at link"]

    def test_calibration_counts_by_bins(self):
        said = [(0.6, True), (0.6, False), (0.95, True), (0.999, True), (0.3, False)]
        rows = [{"steps": [{"probability": p, "right": r} for p, r in said]}]
        found = [(line.value, line.logs) for line in scoring.calibration(rows)]
        assert found == [(0.5, 2), (None, 0), (1.0, 1), (1.0, 1)]
