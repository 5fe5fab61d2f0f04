"""Bodies drawn as ellipsoids, on pages and while they are adapted."""

from pathlib import Path

import numpy as np
import pytest
from adaptive_loops import CONTROL, MODEL, TRUTH, closed_loop, natural, perturbed, simulator
from meshcat_pages import commands, transform
from pydrake.geometry import Meshcat

from geodrake.control import PassivityBasedAdaptiveController
from geodrake.errors import ArgumentError, OutputError
from geodrake.inertia import Ellipsoid, change_frame, from_pseudo_inertia, pseudo_inertia
from geodrake.inertia.bodies import lumped_bodies
from geodrake.model import load_model
from geodrake.report import AdaptationView, save_recording
from geodrake.report.ellipsoids import (
    BOUNDARY,
    EllipsoidSet,
    ellipsoid_figure,
    ellipsoid_page,
    placed,
    skeleton,
    surface,
)
from geodrake.report.meshcat_scene import LEAST_THICKNESS
from geodrake.report.style import figure_bytes

ARM = Path(__file__).parents[2] / "models" / "arm6.urdf"


@pytest.fixture(scope="module")
def model():
    return load_model(ARM)


@pytest.fixture
def context(model):
    context = model.plant.CreateDefaultContext()
    angles = np.random.default_rng(0).uniform(-1, 1, model.plant.num_positions())
    model.plant.SetPositions(context, angles)
    return context


def flattened(phi, body):
    """Return bodies of which one is nearly flat."""
    values, axes = np.linalg.eigh(pseudo_inertia(phi[body]))
    values[0] *= 1e-9
    flat = phi.copy()
    flat[body] = from_pseudo_inertia(axes * values @ axes.T)
    return flat


def test_placed_ellipsoids_weigh_and_turn_like_the_bodies(model, context):
    bodies = placed(model.plant, context, model.phi)
    solid = Ellipsoid(bodies.center, bodies.semi_axes, bodies.rotation)
    in_world = solid.uniform_body(model.phi[:, 0])
    for body, phi, found in zip(lumped_bodies(model.plant), model.phi, in_world, strict=True):
        X_WB = model.plant.EvalBodyPoseInWorld(context, model.plant.get_body(body.body_index))
        expected = change_frame(phi, X_WB.rotation().matrix(), X_WB.translation())
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_points_are_on_the_surface(model, context):
    bodies = placed(model.plant, context, model.phi)
    points = surface(bodies, 12)
    assert points.shape == (len(model.bodies), 7, 13, 3)
    local = np.einsum("bji,bklj->bkli", bodies.rotation, points - bodies.center[:, None, None])
    scaled = np.linalg.norm(local / bodies.semi_axes[:, None, None], axis=-1)
    np.testing.assert_allclose(scaled, 1.0, rtol=1e-12)


def test_flat_bodies_stay_visible(model, context):
    bodies = placed(model.plant, context, flattened(model.phi, 1))
    assert bodies.semi_axes.min() == LEAST_THICKNESS


def test_the_skeleton_goes_from_joint_to_joint(model, context):
    lines = skeleton(model.plant, context)
    ends = lines.reshape(-1, 3)
    for body in lumped_bodies(model.plant):
        origin = model.plant.EvalBodyPoseInWorld(context, model.plant.get_body(body.body_index))
        assert np.linalg.norm(ends - origin.translation(), axis=1).min() < 1e-9
    assert np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).min() > 1e-6


@pytest.mark.parametrize(("kind", "start"), [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_the_figure_in_other_formats(model, kind, start):
    sets = [EllipsoidSet.of("prior", model.phi, at_boundary=[0])]
    figure = ellipsoid_figure(model.plant, sets)
    assert figure_bytes(figure, kind).startswith(start)


def test_nothing_to_draw(model, context):
    with pytest.raises(ArgumentError, match="nothing to draw"):
        ellipsoid_figure(model.plant, [])
    with pytest.raises(ArgumentError, match=r"shape \(nb, 10\)"):
        EllipsoidSet.of("wrong", model.phi[0])
    with pytest.raises(ArgumentError, match="2 bodies, but the plant has"):
        placed(model.plant, context, model.phi[:2])
    with pytest.raises(ArgumentError, match="are not physical"):
        placed(model.plant, context, -model.phi)


def test_pages_have_the_sets_beside_each_other(model, context):
    sets = [
        EllipsoidSet.of("prior", model.phi),
        EllipsoidSet.of("left/right", model.phi, at_boundary=[1]),
    ]
    said = commands(ellipsoid_page(model.plant, sets, context=context))
    poses = {
        one["path"]: np.reshape(one["matrix"], (4, 4)).T
        for one in said
        if one["type"] == "set_transform"
    }
    bodies = placed(model.plant, context, model.phi)
    shifts = []
    for name in ("prior", "left%2Fright"):
        for k, body in enumerate(model.bodies):
            X_WE = poses[f"/drake/ellipsoids/{name}/{body}"]
            np.testing.assert_allclose(X_WE[:3, :3], bodies.rotation[k], atol=1e-12)
            shifts.append(X_WE[:3, 3] - bodies.center[k])
    first, other = np.split(np.array(shifts), 2)
    np.testing.assert_allclose(first, 0.0, atol=1e-12)
    np.testing.assert_allclose(other - other[0], 0.0, atol=1e-12)
    assert other[0, 1] > 0.3 and not other[0, [0, 2]].any()


def test_the_page_is_one_file_with_a_legend(model):
    sets = [
        EllipsoidSet.of("prior <1>", model.phi),
        EllipsoidSet.of("euclidean", model.phi, at_boundary=[0]),
    ]
    page = ellipsoid_page(model.plant, sets)
    assert "prior &lt;1&gt;" in page
    assert "at the boundary of physically valid inertias" in page
    assert BOUNDARY in page
    assert 'src="http' not in page
    assert page.rstrip().endswith("</html>")


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


def test_invalid_inputs_leave_the_view_unchanged(meshcat):
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
