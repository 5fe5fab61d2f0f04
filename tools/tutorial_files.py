"""The files that README and tutorial speak of: an arm whose truth is known, and its logs."""

from __future__ import annotations

import shutil
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np

from geodrake import load_model
from geodrake.effects import CoulombFriction, FittedEffect, Payload, ViscousFriction
from geodrake.inertia import Array, from_mass_com_inertia
from geodrake.logs import JointLog, write_log
from geodrake.logs.motion import Motion
from geodrake.model import RobotModel

WEIGHT = from_mass_com_inertia(2.0, np.array([0.0, 0.0, 0.05]), 1e-5 * np.eye(3))
SAME = {"log_1": "free_1", "log_2": "free_2", "log_with_something_new": "weight"}
"""README's names of logs -> the tutorial's."""


def write_files(folder: Path) -> None:
    """Write robot.urdf, two logs of free motion, and one with a weight of 2 kg."""
    urdf = files("geodrake") / "demo" / "demo.urdf"
    (folder / "robot.urdf").write_text(urdf.read_text(encoding="utf-8"), encoding="utf-8")
    model = load_model(folder / "robot.urdf")
    joints = model.joints[1:3]
    rubs = [FittedEffect(CoulombFriction(joint), np.array([3.0])) for joint in joints]
    rubs += [FittedEffect(ViscousFriction(joint), np.array([4.0])) for joint in joints]
    truth = replace(model, effects=(*model.effects, *rubs))
    for seed, (name, payload) in enumerate(
        (("free_1", None), ("free_2", None), ("weight", WEIGHT))
    ):
        write_log(_log(truth, name, seed, payload), folder / f"{name}.csv")
    for name, other in SAME.items():
        shutil.copy(folder / f"{other}.csv", folder / f"{name}.csv")


def _log(model: RobotModel, name: str, seed: int, payload: Array | None) -> JointLog:
    """Return a log of sines at all joints, with noise."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 20.0, 0.01)
    rates, phases = rng.uniform(0.5, 3.0, (3, 6)), rng.uniform(0.0, 6.0, (3, 6))
    ranges = np.minimum(*map(np.abs, model.position_limits)).clip(0.5, 1.5)
    sizes = 0.25 * ranges * rng.uniform(0.4, 1.0, (3, 6))
    angle = time[:, None, None] * rates + phases
    q, v = (sizes * np.sin(angle)).sum(1), (sizes * rates * np.cos(angle)).sum(1)
    vd = -(sizes * rates**2 * np.sin(angle)).sum(1)
    carried = () if payload is None else (FittedEffect(Payload("flange"), payload),)
    effort = replace(model, effects=(*model.effects, *carried)).effort(Motion(q, v, vd))
    effort += 0.01 * effort.std(axis=0) * rng.standard_normal(effort.shape)
    return JointLog(name, model.joints, time, q, effort, v)
