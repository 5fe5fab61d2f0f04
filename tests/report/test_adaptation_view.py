"""An adaptive loop in MeshCat: it follows the robot and the estimate, and can be recorded."""

import numpy as np
import pytest
from adaptive_loops import CONTROL, MODEL, TRUTH, closed_loop, natural, perturbed, simulator
from meshcat_pages import transform
from pydrake.geometry import Meshcat

from geodrake.control import PassivityBasedAdaptiveController
from geodrake.errors import ArgumentError, OutputError
from geodrake.report import AdaptationView, save_recording
from geodrake.report.ellipsoids import placed


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


def test_what_cannot_be_seen_stays_where_it_was(meshcat):
    view = AdaptationView(MODEL.plant, meshcat, len(TRUTH), path="view")
    context = view.CreateDefaultContext()
    paths = ("robot/0", "desired/0", f"estimate/{MODEL.bodies[1]}")

    def shown(**fixed):
        for name, value in fixed.items():
            view.GetInputPort(name).FixValue(context, value)
        view.ForcedPublish(context)
        return [transform(meshcat, f"view/{path}") for path in paths]

    good = {"state": [0.1, 0, 0, 0], "desired_state": [0.4, 0, 0, 0], "parameters": TRUTH}
    first, unknown, impossible = shown(**good), perturbed(0.0), perturbed(0.0)
    unknown[0], impossible[0] = np.nan, -1.0
    for port, bad in (
        ("state", [np.nan, 0, 0, 0]),
        ("desired_state", [np.nan, 0, 0, 0]),
        ("parameters", unknown),
        ("parameters", impossible),
    ):
        np.testing.assert_array_equal(shown(**{**good, port: bad}), first)


def test_estimates_of_too_few_bodies_are_refused(meshcat):
    with pytest.raises(ArgumentError, match="ten parameters"):
        AdaptationView(MODEL.plant, meshcat, 19)
