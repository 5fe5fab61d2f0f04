"""One log of a servo: explained by geodrake, and compared with what was hidden."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from geodrake.diagnosis import Explanation, explain
from geodrake.model import RobotModel
from servos.draws import ServoDraw, ServoLog, make_servo_log, servo_model

HIDDEN = {
    "coulomb_friction": "coulomb",
    "viscous_friction": "viscous",
    "rotor_inertia": "inertia",
}
"""Effects that every joint has, and the parameter of each that is reported."""

_NOTABLE = 0.05  # of a joint's torque, above which a hidden effect is to be named
_SIDES = 2.0  # standard deviations of an interval


def score_servo(draw: ServoDraw) -> dict[str, Any]:
    """A row of the table."""
    made, model = make_servo_log(draw), servo_model(draw.robot)
    began = time.process_time()
    found = explain(model, [made.log])
    seconds = time.process_time() - began
    return {
        **asdict(draw),
        "joints": len(model.joints),
        "samples": len(made.log),
        "seconds": seconds,
        "verdict": found.verdict,
        "steps": [[step.effect, list(step.where)] for step in found.steps],
        "extra": sorted({s.effect for s in found.steps} - {*HIDDEN, "effort_delay"}),
        "nrms": [found.start.nrms, found.refitted.nrms, found.end.nrms],
        **_in_set(made, model, found),
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
        "rotor_inertia": servos.armature,
    }
    return {e: dict(zip(names, v.tolist(), strict=True)) for e, v in values.items()}


def _in_set(made: ServoLog, model: RobotModel, found: Explanation) -> dict[str, Any]:
    """Whether every notable effect is among what was found, or what cannot be told from it."""
    position = made.log.position
    velocity = np.gradient(position, made.log.time, axis=0)
    motions = {
        "coulomb_friction": np.sign(velocity),
        "viscous_friction": velocity,
        "rotor_inertia": np.gradient(velocity, made.log.time, axis=0),
    }
    torque = made.torques.std(axis=0)
    named = {name for s in found.steps for name in (s.effect, *s.indistinguishable_from)}
    missing = []
    for effect, values in _truths(made, model).items():
        share = motions[effect].std(axis=0) * np.array([*values.values()]) / torque
        if share.max() > _NOTABLE and effect not in named:
            missing.append(effect)
    return {"in_set": not missing, "missing": missing}


def _gains(made: ServoLog, model: RobotModel) -> list[dict[str, Any]]:
    """Stiffness and damping, beside the truth."""
    rows = []
    for signal in model.effort_signals:
        at = made.log.joints.index(signal.joint)
        stiffness = float(made.servos.stiffness[at])
        rows.append(_row("kp", signal.joint, signal.gain, signal.deviation, stiffness))
        if made.servos.knows_rate:
            damping = float(made.servos.damping[at])
            spread = signal.damping_deviation
            rows.append(_row("kd", signal.joint, signal.damping, spread, damping))
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
