"""The benchmark of ordinary robots: its robots, its logs, and how it scores."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pinocchio")

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
    ROTOR,
    TOOL,
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
