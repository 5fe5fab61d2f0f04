"""A design ends in its time, with the best motion found by then, or says that there is none."""

from time import process_time

import numpy as np
import pytest
from excitation_robots import MODELS, arm
from pydrake.geometry import Box
from pydrake.math import RigidTransform

from geodrake.excitation import (
    CollisionWorld,
    DesignOptions,
    FourierMotion,
    MotionLimits,
    Solid,
    design_excitation,
)
from geodrake.model.robot_model import load_description

SLACK = 1.0  # s, for what cannot be interrupted
WALL = Solid("wall", Box(0.1, 2.0, 2.0), RigidTransform([0.0, -3.0, 0.0]))


class Clock:
    """The processor's seconds of this process, and those for which it pretends to wait."""

    def __init__(self):
        self.waited = 0.0

    def monotonic(self):
        return process_time() + self.waited

    def wait(self, seconds):
        self.waited += seconds


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("geodrake.excitation.solve.time", clock)
    monkeypatch.setattr(SlowWorld, "wait", clock.wait)
    return clock


class SlowWorld(CollisionWorld):
    """A world in which looking at a posture takes its time, as with large meshes."""

    seconds = 0.002
    wait = None

    def distances(self, q):
        self.wait(self.seconds * len(q))
        return np.full(len(q), np.inf), ("",) * len(q)

    def nearest(self, q):
        self.wait(self.seconds * len(q))
        return {}

    def constraint(self, q):
        self.wait(self.seconds * len(q))
        return np.zeros(len(q)), np.zeros(q.shape)


def limits_of(model):
    most = np.full(len(model.joints), 2.0)
    return MotionLimits(model.joints, -most, most, most, 4.0 * most, np.inf * most)


def designed(clock, seconds, seeds):
    model, motion = load_description(MODELS / "arm7.urdf"), FourierMotion(10.0, 5)
    world = SlowWorld(model, obstacles=[WALL], use_file=False)
    options = DesignOptions(seconds=seconds, collisions=world, samples=100)
    begin = clock.monotonic()
    result = design_excitation(
        model, limits_of(model), trajectory=motion, options=options, seeds=seeds
    )
    return result, clock.monotonic() - begin


@pytest.mark.usefixtures("clock")
def test_what_ends_by_itself_is_the_same_with_more_time():
    model, motion, values = arm(), FourierMotion(4.0, 2), []
    for seconds in (60.0, 600.0):
        options = DesignOptions(samples=60, iterations=10, sharpness=(8.0,), seconds=seconds)
        found = design_excitation(
            model, limits_of(model), trajectory=motion, options=options, seeds=2
        )
        values.append(found.value)
    assert values[0] == values[1]


def test_starts_share_the_time(clock):
    result, took = designed(clock, 1.5, seeds=4)
    assert took < 1.1 * 1.5 + SLACK
    assert result.use.is_within
    assert any(outcome.status == "out of time" for outcome in result.outcomes)
    assert result.value <= min(outcome.random_value for outcome in result.outcomes)


def test_no_time_for_a_close_look_is_said(clock):
    result, took = designed(clock, 0.01, seeds=3)
    assert took < SLACK + 0.5
    assert [outcome.seed for outcome in result.outcomes] == [0]
    assert "2 starts were not begun, as time was up" in result.notes
    assert any("collisions were looked for every 0.3" in note for note in result.notes)
