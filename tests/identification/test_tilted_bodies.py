"""Bodies on a slope: their columns and those of the slope are exact together, by Pinocchio."""

from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from pinocchio_logs import MODELS, perturbed, robot

from geodrake import load_model
from geodrake.effects import GravityTilt
from geodrake.identification.logs.log_slices import INERTIA, Layout
from geodrake.logs import Motion

ARM = load_model(MODELS / "arm6.urdf")
NV = len(ARM.joints)
ORDER = [0, 1, 2, 3, 4, 6, 9, 5, 8, 7]  # of Pinocchio's xx, xy, yy, xz, yz, zz among ours


def leaning(model, angles):
    """A robot whose base is turned by a rotation vector about x and y."""
    turned = pin.Model(model)
    turned.gravity.linear = pin.exp3(np.array([*angles, 0.0])).T @ np.array([0.0, 0.0, -9.81])
    return turned


def parameters(model):
    """(10 nb,) φ of Pinocchio's bodies, in the model's order."""
    bodies = [model.inertias[i].toDynamicParameters()[ORDER] for i in range(1, model.njoints)]
    return np.concatenate(bodies)


def columns(effects, motion):
    """Per joint, columns (N, p) of bodies and effects, and what the former have of the latter."""
    layout = Layout.of(ARM, effects, np.ones(NV), np.zeros(NV))
    known = SimpleNamespace(bandwidth=10.0)
    log = SimpleNamespace(payloads=(), name="a", filter=known, acceleration_noise=0.0)
    found, load = layout.evaluate(motion, log, layout.parts)
    parts = dict(zip(layout.parts, found, strict=True))
    inertial = parts.pop(INERTIA)
    held = [layout.in_bodies(j, parts) for j in range(NV)]
    return layout, inertial, parts, held, load


@pytest.mark.parametrize("angles", [(0.03, -0.05), (-0.7, 1.1)])
def test_efforts_of_any_bodies_are_exact_at_the_slope(angles):
    rng = np.random.default_rng(4)
    q, v, vd = rng.normal(size=(3, 20, NV))
    tilt, truth = (
        GravityTilt(about_x=angles[0], about_y=angles[1]),
        perturbed(robot("arm6"), rng, 0.4),
    )
    layout, inertial, parts, held, load = columns((tilt,), Motion(q, v, vd))
    phi = parameters(truth)
    found = np.empty_like(q)
    for j, own in enumerate(layout.columns):
        bodies = inertial[j] @ phi[own[own < phi.size]]
        found[:, j] = bodies - held[j] + parts[tilt][j] @ np.array(angles)
    for efforts, bodies in ((found, truth), (load, robot("arm6"))):
        turned = leaning(bodies, angles)
        data = turned.createData()
        wanted = [pin.rnea(turned, data, *sample) for sample in zip(q, v, vd, strict=True)]
        np.testing.assert_allclose(efforts, wanted, atol=1e-9 * np.abs(wanted).max())
