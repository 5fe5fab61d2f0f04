"""An adaptive loop in MeshCat: it follows the robot and the estimate, and can be recorded."""

import numpy as np
import pytest
from adaptive_loops import CONTROL, MODEL, TRUTH, closed_loop, natural, perturbed, simulator
from pydrake.geometry import Meshcat
from pydrake.systems.framework import DiagramBuilder

from geodrake.control.systems import PassivityBasedAdaptiveController
from geodrake.errors import ArgumentError, OutputError
from geodrake.report import AdaptationView, save_recording
from geodrake.report.ellipsoids import placed


def transform(meshcat, path):
    packed = np.frombuffer(meshcat._GetPackedTransform(path)[-16 * 9 :], np.uint8).reshape(16, 9)
    return packed[:, 1:].copy().view(">f8").reshape(4, 4).T


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat()


def test_follows_robot_and_estimate(meshcat, tmp_path):
    start = perturbed(0.3)
    controller = PassivityBasedAdaptiveController(CONTROL, natural(), parameters=start)
    builder, loop = closed_loop(controller, log_period=None)
    AdaptationView.AddToBuilder(builder, loop, meshcat, period=0.1)
    diagram = builder.Build()
    meshcat.StartRecording()
    found = simulator(diagram, loop.context(diagram))
    found.Initialize()
    found.AdvanceTo(0.4)
    found.AdvancePendingEvents()
    root = found.get_context()
    bodies = placed(
        loop.plant,
        loop.plant.GetMyContextFromRoot(root),
        CONTROL.phi(controller.parameters(controller.GetMyContextFromRoot(root))),
    )
    for k, body in enumerate(MODEL.bodies):
        X_WE = transform(meshcat, f"adaptation/estimate/{body}")
        np.testing.assert_allclose(X_WE[:3, 3], bodies.center[k], atol=1e-4)  # one step later
    page = tmp_path / "loop.html"
    save_recording(meshcat, page)
    text = page.read_text()
    assert "<html" in text
    assert len(text) > 100_000
    with pytest.raises(OutputError):
        save_recording(meshcat, tmp_path / "nowhere" / "loop.html")


def fixed_view(meshcat, parameters):
    builder = DiagramBuilder()
    view = builder.AddSystem(AdaptationView(MODEL.plant, meshcat, len(parameters), path="view"))
    context = view.CreateDefaultContext()
    q = np.array([0.3, -0.7])
    for name, value in (
        ("state", [*q, 0.0, 0.0]),
        ("desired_state", [0.0, 0.0, 0.0, 0.0]),
        ("parameters", parameters),
    ):
        view.GetInputPort(name).FixValue(context, value)
    view.ForcedPublish(context)
    return q


def test_ellipsoids_are_where_the_estimate_puts_them(meshcat):
    estimate = perturbed(0.3)
    q = fixed_view(meshcat, estimate)
    context = MODEL.plant.CreateDefaultContext()
    MODEL.plant.SetPositions(context, q)
    bodies = placed(MODEL.plant, context, CONTROL.phi(estimate))
    for k, body in enumerate(MODEL.bodies):
        X_WE = transform(meshcat, f"view/estimate/{body}")
        np.testing.assert_allclose(X_WE[:3, 3], bodies.center[k], atol=1e-12)
        np.testing.assert_allclose(X_WE[:3, :3], bodies.rotation[k], atol=1e-12)


@pytest.mark.parametrize("port", ["state", "desired_state"])
def test_a_robot_that_cannot_be_seen_stays_where_it_was(meshcat, port):
    view = AdaptationView(MODEL.plant, meshcat, len(TRUTH), path="unseen")
    context = view.CreateDefaultContext()
    view.GetInputPort("parameters").FixValue(context, TRUTH)
    shown = []
    for q in (0.4, np.nan):
        for name in ("state", "desired_state"):
            value = [q if name == port else 0.1, 0.0, 0.0, 0.0]
            view.GetInputPort(name).FixValue(context, value)
        view.ForcedPublish(context)
        paths = ("robot/0", "desired/0", f"estimate/{MODEL.bodies[1]}")
        shown.append([transform(meshcat, f"unseen/{path}") for path in paths])
    np.testing.assert_array_equal(*shown)


def test_estimates_of_too_few_bodies_are_refused(meshcat):
    with pytest.raises(ArgumentError, match="ten parameters"):
        AdaptationView(MODEL.plant, meshcat, 19)


@pytest.mark.parametrize("bad", [np.nan, -1.0])
def test_estimates_that_cannot_be_drawn(meshcat, bad):
    estimate = perturbed(0.0)
    estimate[0] = bad
    fixed_view(meshcat, estimate)
