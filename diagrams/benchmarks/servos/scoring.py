"""One log of a servo: explained by geodrake, and compared with what was hidden."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from diagrams.benchmarks.servos.draws import (
    ServoDraw,
    ServoLog,
    limited_model,
    make_servo_log,
    servo_model,
)
from geodrake.control.rollout import commanded_motions, roll_out
from geodrake.diagnosis import Explanation, explain
from geodrake.effects import CoulombFriction, FittedEffect, RotorInertia, ViscousFriction
from geodrake.model import EffortSignal, RobotModel

ARMATURE = "rotor_inertia"
HIDDEN = {
    "coulomb_friction": "coulomb",
    "viscous_friction": "viscous",
    ARMATURE: "inertia",
}
"""Effects that every joint has, and the parameter of each that is reported."""

_NOTABLE = 0.05  # of a joint's torque, above which a hidden effect is to be named
_WINDOWS = 6  # of rollouts
_SIDES = 2.0  # standard deviations of an interval


def score_servo(draw: ServoDraw) -> dict[str, Any]:
    """A row of the table."""
    made, model = make_servo_log(draw), servo_model(draw.robot)
    if draw.limited:
        model = limited_model(draw.robot, made.log.joints, made.servos.limit)
    began = time.process_time()
    found = explain(model, [made.log])
    seconds = time.process_time() - began
    return {
        **asdict(draw),
        "joints": len(model.joints),
        "samples": len(made.log),
        "seconds": seconds,
        "verdict": found.verdict,
        "at limit": np.mean(np.abs(made.torques) >= made.servos.limit, axis=0).tolist(),
        "limits found": [bool(np.isfinite(s.limit)) for s in found.model.effort_signals],
        "steps": [[step.effect, list(step.where)] for step in found.steps],
        "extra": sorted({s.effect for s in found.steps} - {*HIDDEN, "effort_delay"}),
        "nrms": [found.start.nrms, found.refitted.nrms, found.end.nrms],
        **_in_set(made, model, found),
        **_motion(made, model, found),
        "values": [*_gains(made, found.model), *_effects(made, model, found)],
    }


def _truths(made: ServoLog, model: RobotModel) -> Mapping[str, Mapping[str, float]]:
    """Effect -> joint -> true value, in the order of the model's joints.

    A servo that damps the velocity alone is viscous friction to its joint.
    """
    servos, names = made.servos, made.log.joints
    viscous = servos.viscous + (0.0 if servos.knows_rate else servos.damping)
    values = {
        "coulomb_friction": servos.coulomb,
        "viscous_friction": viscous,
        ARMATURE: servos.armature,
    }
    return {e: dict(zip(names, v.tolist(), strict=True)) for e, v in values.items()}


def _in_set(made: ServoLog, model: RobotModel, found: Explanation) -> dict[str, Any]:
    """Whether every notable effect is among what was found, or what cannot be told from it."""
    position = made.log.position
    velocity = np.gradient(position, made.log.time, axis=0)
    motions = {
        "coulomb_friction": np.sign(velocity),
        "viscous_friction": velocity,
        ARMATURE: np.gradient(velocity, made.log.time, axis=0),
    }
    torque = made.torques.std(axis=0)
    named = {name for s in found.steps for name in (s.effect, *s.indistinguishable_from)}
    missing = []
    for effect, values in _truths(made, model).items():
        share = motions[effect].std(axis=0) * np.array([*values.values()]) / torque
        if effect == ARMATURE:
            share[0] = 0.0  # at the first joint it is as if its link were heavier
        if share.max() > _NOTABLE and effect not in named:
            missing.append(effect)
    return {"in_set": not missing, "missing": missing}


def _motion(made: ServoLog, model: RobotModel, found: Explanation) -> dict[str, Any]:
    """Departures from the motion under the commands: of what was found and of the true model.

    They are shares of what each joint moves; those on the way are before and after every step.
    """
    servos, joints = made.servos, made.log.joints
    true = [
        *(CoulombFriction(joint) for joint in joints),
        *(ViscousFriction(joint) for joint in joints),
        *(RotorInertia(joint) for joint in joints),
    ]
    values = np.concatenate([servos.coulomb, servos.viscous, servos.armature])
    damping = servos.damping if servos.knows_rate else np.zeros(len(joints))
    if not servos.knows_rate:
        values[len(joints) : 2 * len(joints)] += servos.damping
    truth = replace(
        model,
        effects=tuple(
            FittedEffect(effect, np.array([value]))
            for effect, value in zip(true, values.tolist(), strict=True)
        ),
        effort_signals=tuple(
            EffortSignal(
                joint, "command", kp, damping=kd, delay=servos.delay, integral=ki, limit=limit
            )
            for joint, kp, kd, ki, limit in zip(
                joints,
                servos.stiffness.tolist(),
                damping.tolist(),
                servos.integral.tolist(),
                servos.limit.tolist(),
                strict=True,
            )
        ),
    )
    between = [step.model for step in found.steps if step.model is not None]
    began = time.process_time()
    motions = commanded_motions(model, found.model, [made.log], between=between)
    seconds = time.process_time() - began
    if motions is None:
        raise RuntimeError("A log of commands has servos.")
    best = roll_out(truth, [made.log], most=_WINDOWS, commands=True)
    on_the_way = [[joint.relative for joint in motion.joints] for motion in motions]
    return {
        "seconds of motions": seconds,
        "motion": on_the_way[-1],
        "motion on the way": on_the_way,
        "motion of the true model": [joint.relative for joint in best.joints],
    }


def _gains(made: ServoLog, model: RobotModel) -> list[dict[str, Any]]:
    """Stiffness, damping, and the integral where there or found one, beside the truth."""
    rows = []
    for signal in model.effort_signals:
        at = made.log.joints.index(signal.joint)
        stiffness = float(made.servos.stiffness[at])
        rows.append(_row("kp", signal.joint, signal.gain, signal.deviation, stiffness))
        if made.servos.knows_rate:
            damping = float(made.servos.damping[at])
            spread = float(np.hypot(signal.damping_deviation, signal.uncertainty * signal.damping))
            rows.append(_row("kd", signal.joint, signal.damping, spread, damping))
        integral = float(made.servos.integral[at])
        if integral or signal.integral:
            rough = signal.uncertainty * signal.integral
            spread = float(np.hypot(signal.integral_deviation, rough))
            rows.append(_row("ki", signal.joint, signal.integral, spread, integral))
    return rows


def _effects(made: ServoLog, model: RobotModel, found: Explanation) -> list[dict[str, Any]]:
    """Values of effects, beside the truth."""
    rows = []
    truths = _truths(made, model)
    for step in found.steps:
        if step.effect not in truths:
            continue
        name = HIDDEN[step.effect]
        for joint, values in step.parameters.items():
            key = name if name in values else next(iter(values))
            spread = np.hypot(
                step.deviations.get(joint, {}).get(key, np.nan),
                step.systematic.get(joint, {}).get(key, 0.0),
            )
            truth = truths[step.effect][joint]
            rows.append(_row(step.effect, joint, values[key], float(spread), truth))
    return rows


def _row(what: str, joint: str, value: float, spread: float, truth: float) -> dict[str, Any]:
    return {
        "what": what,
        "joint": joint,
        "value": value,
        "deviation": spread,
        "truth": truth,
        "inside": bool(abs(value - truth) <= _SIDES * spread),
        "ratio": value / truth if truth else None,
    }
