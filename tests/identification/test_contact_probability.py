"""Unlogged contacts by heights and speeds of frames, and by efforts of their limbs."""

from dataclasses import replace

import numpy as np
import pytest
from quadruped import FEET, quadruped

from geodrake.diagnosis import compare
from geodrake.effects.body_motion import RobotBodies
from geodrake.excitation import (
    DesignOptions,
    Foot,
    FourierMotion,
    make_stance,
    make_target,
    motion_limits,
    placing,
    random_excitation,
)
from geodrake.model import load_description
from geodrake.model.base_motion import with_base
from geodrake.model.contact_probability import FrameSigns, touching_probability
from geodrake.model.ground_contacts import contact_frames

RATE, WEIGHT = 200.0, 150.0


def steps(rng, count, feet=4):
    """Return whether feet touch, in stance and swing phases of 0.2 to 0.5 s."""
    found = np.empty((count, feet), bool)
    for k in range(feet):
        lengths = rng.uniform(0.2, 0.5, 200)
        states = np.repeat(np.arange(200) % 2 == k % 2, (RATE * lengths).astype(int))
        found[:, k] = states[:count]
    return found


def signs(truth, rng, *, ground=0.0, heights=True, speeds=True, forces=True):
    """Return signals of such feet: at most 5 cm of lift, and the noise of good estimators."""
    count, feet = truth.shape
    nothing = np.full(truth.shape, np.nan)
    swing = np.zeros(truth.shape)
    for k in range(feet):
        edges = np.flatnonzero(np.diff(truth[:, k])) + 1
        for part in np.split(np.arange(count), edges):
            if not truth[part[0], k]:
                swing[part, k] = np.sin(np.pi * (np.arange(len(part)) + 0.5) / len(part))
    high = 0.05 * swing + ground + 0.005 * rng.normal(size=truth.shape)
    fast = np.abs(0.05 * rng.normal(size=truth.shape)) + 0.8 * swing
    load = WEIGHT / np.maximum(truth.sum(axis=1, keepdims=True), 1)
    force = 3.0 * rng.normal(size=(*truth.shape, 3))
    force[:, :, 2] += np.where(truth, load, 0.0)
    loads = np.abs(force / 3.5).max(axis=2)
    return FrameSigns(
        np.arange(count) / RATE,
        high if heights else nothing,
        fast if speeds else nothing,
        loads if forces else nothing,
    )


@pytest.mark.parametrize(
    "known",
    [
        {},
        {"heights": False},
        {"heights": False, "speeds": False},
        {"forces": False},
        {"ground": np.array([0.0, 0.06, 0.12, 0.0])},
    ],
    ids=["all", "no heights", "efforts alone", "kinematics alone", "steps of the ground"],
)
def test_probabilities_are_right_and_mean_what_they_say(known):
    rng = np.random.default_rng(0)
    truth = steps(rng, 8000)
    found = touching_probability(signs(truth, rng, **known))
    assert ((found > 0.5) == truth).mean() > (0.9 if "forces" in known else 0.95)
    missed = truth & (found < 0.01)
    assert missed.mean() < 0.01  # a contact that is left out counts as none
    sure = (found < 0.01) | (found > 0.99)
    assert sure.mean() > 0.7
    assert truth[~sure].mean() < found[~sure].mean() + 0.15  # a lift in doubt is a touch


@pytest.fixture(scope="module")
def on_steps(tmp_path_factory):
    """Return a quadruped that sways with two of its feet on a step, and its measurements."""
    path = tmp_path_factory.mktemp("robot") / "quadruped.urdf"
    path.write_text(quadruped(), encoding="utf-8")
    model = load_description(path, floating=True)
    joints = motion_limits(model, velocity=4.0, effort=80.0).joints
    knees = {"fl_knee": -1.5, "hr_knee": -1.5, "fl_pitch": 0.75, "hr_pitch": 0.75}
    usual = {"knee": -1.2, "pitch": 0.6, "roll": 0.0}
    posture = [knees.get(name, usual[name[3:]]) for name in joints]
    limits = motion_limits(model, velocity=4.0, effort=80.0, acceleration=20.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(placing, "_LEVEL", 0.2)  # a plane is all that stances know
        stance = make_stance(
            model, [Foot(foot, np.zeros((1, 3))) for foot in FEET], posture=posture, limits=limits
        )
    target = make_target(stance.model, noise=1.0)
    options = DesignOptions(stance=stance)
    sway = random_excitation(target, trajectory=FourierMotion(8.0, 4), options=options)
    return model, sway.log(stance.model, rate=100.0)


def heights_of(model, log):
    found = with_base(log, model)
    at = [found.joints.index(joint) for joint in model.joints]
    bodies = RobotBodies(model.tree, model.positions(found.position[:, at]), model.total_phi)
    return np.stack([frame.height(bodies) for frame in contact_frames(model, FEET)], -1)


def test_feet_on_a_step_are_found(on_steps):
    """Too high to touch level ground, they rest and carry what efforts do not explain."""
    model, log = on_steps
    heights = heights_of(model, log)
    assert np.ptp(heights, axis=0).max() < 1e-6  # feet rest
    assert np.ptp(heights[0]) > 0.03
    found = with_base(log, model)
    assert found.contacts.flags.all()
    (note,) = [note for note in found.notes if "contacts by heights" in note]
    assert all(f"{foot} in 100%" in note for foot in FEET) and "0% of them" in note
    assert compare(model, log).errors.nrms < 0.1


def test_without_efforts_feet_on_a_step_are_found_by_their_rest(on_steps):
    """Currents of unknown gains give no forces."""
    model, log = on_steps
    found = with_base(replace(log, effort_kinds=dict.fromkeys(log.joints, "current")), model)
    assert found.contacts.flags.all()


def test_gaps_and_short_logs_are_in_doubt(on_steps):
    model, log = on_steps
    gap = log.position.copy()
    gap[100:150, 3] = np.nan
    found = with_base(replace(log, position=gap), model)
    assert found.contacts.flags[100:150].all()
    short = replace(
        log,
        **{n: getattr(log, n)[:6] for n in ("time", "position", "effort")},
        velocity=None,
        acceleration=None,
        floating={name: values[:6] for name, values in log.floating.items()},
    )
    assert with_base(short, model).contacts.flags.shape == (6, 4)
