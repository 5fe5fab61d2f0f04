"""Results without a robot, and the files of the demo, for tests of reports."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from geodrake.diagnosis import Candidate, Diagnosis, Explanation, Step
from geodrake.diagnosis.results import FittedRival
from geodrake.identification.logs.model_errors import (
    Comparison,
    ErrorTable,
    Failing,
    JointError,
    Series,
)
from geodrake.report import About, page_of, render

DEMO = Path(str(files("geodrake") / "demo"))
URDF, LOG, JOINT = DEMO / "demo.urdf", DEMO / "demo.csv", "shoulder_pitch"
ABOUT = About("arm.urdf", ("a.csv", "b.csv"), "explain")
BLOCKS = (("a 0.00–4.00 s", 0.0), ("a 5.00–9.00 s", 5.0), ("b 2.00–6.00 s", 2.0))


def page(result, **about):
    """Return the HTML page of a result."""
    return render(page_of(result, replace(ABOUT, **about)))


def joint_names(count):
    return tuple(f"joint_{i}" for i in range(count))


def errors(joints, share):
    return ErrorTable(
        tuple(JointError(j, share * (1 + i % 5), 5.0 * (1 + i), 0.02) for i, j in enumerate(joints))
    )


def comparison(joints, share):
    rng = np.random.default_rng(3)
    series = []
    for joint in joints:
        for block, start in BLOCKS:
            time = start + np.arange(40) / 10.0
            motion = rng.normal(size=(3, 40))
            measured = 5.0 * np.sin(time)
            predicted = measured + share * rng.normal(size=40)
            series.append(Series(joint, block, time, *motion, measured, predicted))
    failing = (Failing(joints[0], "at speeds below 0.05 rad/s", 0.3, 0.1, 0.6, 0.2),)
    return Comparison(errors(joints, share), failing, tuple(series), ("left out 1.5 s",))


def step(effect, where, parameters, deviations, **more):
    joints = more.pop("joints", where)
    return Step(
        **{
            "effect": effect,
            "where": where,
            "error_before": 0.4,
            "error_after": 0.1,
            "parameters": parameters,
            "deviations": deviations,
            "indistinguishable_from": ("stribeck_friction",),
            "rivals": (FittedRival("stribeck_friction", where, (effect,), 0.11, 0.1, 0.1, 0.1),),
            "false_alarm_probability": 1e-30,
            "agreement": 0.75,
            "rms_before": dict.fromkeys(joints, 1.0),
            "rms_after": dict.fromkeys(joints, 0.2),
            **more,
        }
    )


def friction(joints):
    return step(
        "coulomb_friction",
        joints,
        {joint: {"coulomb": 3.084} for joint in joints},
        {joint: {"coulomb": 0.012} for joint in joints},
    )


def model_of(joints, prismatic=()):
    """Return the parts of a RobotModel that reports use: its joints' kinds, effects, no bodies."""
    tree = SimpleNamespace(mobilizers=())
    return SimpleNamespace(
        effort_signals=(),
        sliding_joints=tuple(prismatic),
        base_joints=(),
        joints=joints,
        effects=(),
        tree=tree,
        joint_tree=tree,
    )


def explanation(joints, steps=None, *, verdict="unexplained", prismatic=()):
    steps = (friction(joints),) if steps is None else steps
    before = comparison(joints, 1.0)
    after = comparison(joints, 0.2) if steps else before
    return Explanation(
        verdict,
        steps,
        before.errors,
        errors(joints, 0.9),
        after.errors,
        model_of(joints, prismatic),
        before,
        after,
        ("a: bandwidth 4 Hz chosen from the data",),
    )


def diagnosis(joints, candidates=True):
    before = comparison(joints, 1.0)
    found = (
        Candidate("coulomb_friction + viscous_friction", joints, 0.4, 0.05, 200.0, 1e-40, True),
        Candidate("asymmetric_friction", joints, 0.4, 0.051, 190.0, 1e-38, True),
        Candidate("payload", ("hand",), 0.4, 0.3, 20.0, 1e-3, False),
    )
    return Diagnosis(
        "explained" if candidates else "unexplained",
        found if candidates else (),
        before.errors,
        errors(joints, 0.9),
        before,
        (),
    )
