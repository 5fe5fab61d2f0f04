"""One log: explained by geodrake as `geodrake explain` does, and compared with what it hides."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from diagrams.benchmarks.hidden.logs import (
    OFF,
    UNKNOWN,
    WRONG_INERTIA,
    Draw,
    Recording,
    Secret,
    make_recording,
)
from diagrams.benchmarks.hidden.robots import robot_model
from diagrams.benchmarks.hidden.truths import ANY, TIME, TRUTHS
from geodrake.diagnosis import Step, explain
from geodrake.diagnosis.drafting import Correlate
from geodrake.diagnosis.drafting.draft import draft_rest
from geodrake.diagnosis.explain import Investigation, investigate
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.compare import compare
from geodrake.model import RobotModel
from geodrake.report.words import correlate_words

_SIGNALS = {"position": ("position",), "speed": ("velocity", "direction of motion")}
_RANGE = (0.0005, 0.256)
_HALVINGS = 6


def score_draw(draw: Draw) -> dict[str, Any]:
    """Return a row of the table: the draw, what it hid, what was found, and what of it is right."""
    recording = make_recording(draw, robot_model(draw.robot).bodies)
    model = _told(draw, recording)
    began = time.process_time()
    case = open_case(model, [recording.log], candidates=True)
    found = investigate(case)
    seconds = time.process_time() - began
    explanation = found.explanation
    steps = explanation.steps
    row = {
        **asdict(draw),
        "secrets": [asdict(secret) for secret in recording.secrets],
        "steps": [
            {**_step_row(step), "right": _expected(step, draw, recording.secrets)} for step in steps
        ],
        "verdict": explanation.verdict,
        "over_floor": _over_floor(draw, recording, found),
        "start_nrms": explanation.start.nrms,
        "end_nrms": explanation.end.nrms,
        "seconds": seconds,
        "extra": [s.effect for s in steps if not _expected(s, draw, recording.secrets)],
        **_judged(steps, recording.secrets, draw),
    }
    if draw.case == UNKNOWN:
        row |= _drafted(found, recording.secrets[0])
    return row


def _told(draw: Draw, recording: Recording) -> RobotModel:
    """Return what geodrake knows of the robot: its model file, fitted to an earlier log if any."""
    model = robot_model(draw.robot)
    return model if recording.known is None else explain(model, [recording.known]).model


def _step_row(step: Step) -> dict[str, Any]:
    return {
        "effect": step.effect,
        "where": list(step.where),
        "rivals": list(step.indistinguishable_from),
        "before": step.error_before,
        "after": step.error_after,
        "probability": step.probability,
    }


def _over_floor(draw: Draw, recording: Recording, found: Investigation) -> float:
    """Final held-out error over that of the true model, which noise of all sensors makes alone."""
    bandwidth = found.case.trajectories[0].filter.bandwidth
    bare = compare(robot_model(draw.robot), [recording.bare], bandwidth=bandwidth).errors
    pairs = zip(bare.joints, found.explanation.end.joints, strict=True)
    floor = np.sqrt(np.mean([(alone.rms / joint.std) ** 2 for alone, joint in pairs]))
    return float(found.explanation.end.nrms / floor)


def _expected(step: Step, draw: Draw, secrets: Sequence[Secret]) -> bool:
    """Return whether a step is what was hidden, at its place, or something that comes with it."""
    if step.effect == WRONG_INERTIA and draw.prior == OFF:
        return True
    places = {
        place for secret in secrets if step.effect in _names(secret) for place in secret.where
    }
    names = {name for secret in secrets for name in _names(secret)}
    return step.effect in names and set(step.where) <= places


def _names(secret: Secret) -> tuple[str, ...]:
    """Return names of an effect and of those that it comes with."""
    truth = TRUTHS.get(secret.name)
    return (secret.name,) if truth is None else (truth.name, *truth.companions)


def _judged(steps: Sequence[Step], secrets: Sequence[Secret], draw: Draw) -> dict[str, Any]:
    """Return what is right about the steps; None where there is nothing to be right about."""
    row: dict[str, Any] = dict.fromkeys(("named", "first", "in_set", "placed"))
    if not secrets or any(secret.name not in TRUTHS for secret in secrets):
        return row
    named = [_named(steps, secret) for secret in secrets]
    row["named"] = all(named)
    row["in_set"] = all(
        any(s.effect == secret.name or secret.name in s.indistinguishable_from for s in steps)
        for secret in secrets
    )
    first = next((s for s in steps if s.effect != WRONG_INERTIA or draw.prior != OFF), None)
    first = first or next(iter(steps), None)
    if len(secrets) == 1:
        (secret,) = secrets
        row["first"] = first is not None and first.effect in _names(secret) and named[0]
        if secret.where:
            # What comes with the truth, a coupled rotor's own rotors, may come first.
            there = next((s for s in steps if s.effect == secret.name and row["first"]), first)
            row["placed"] = there is not None and set(there.where) == set(secret.where)
        row["answer"] = None if first is None else first.effect
    return row


def _named(steps: Sequence[Step], secret: Secret) -> bool:
    """Return whether a step has the effect, at its place if it has one."""
    return any(s.effect == secret.name and set(secret.where) <= set(s.where) for s in steps)


def _drafted(found: Investigation, secret: Secret) -> dict[str, Any]:
    """Return what geodrake says of the rest, and whether joint and kind are right."""
    began = time.process_time()
    draft = draft_rest(found)
    correlates = draft.correlates
    there = [c for c in correlates if c.joint in secret.joints]
    return {
        "correlates": [correlate_words(c) for c in correlates],
        "right_joint": bool(correlates) and correlates[0].joint in secret.joints,
        "right_correlate": any(_goes_with(c, secret) for c in there),
        "drafted_over_floor": draft.after.nrms / draft.after.floor_nrms,
        "draft_seconds": time.process_time() - began,
    }


def _goes_with(correlate: Correlate, secret: Secret) -> bool:
    """Return whether a correlate names a signal that the hidden effect is a function of."""
    for whose, what in secret.follows:
        if what == TIME:
            if correlate.words.startswith(("time", "the clock")):
                return True
        elif any(_says(correlate, whose, signal) for signal in _SIGNALS[what]):
            return True
    return False


def _says(correlate: Correlate, whose: str, signal: str) -> bool:
    if whose == ANY:
        return signal in correlate.words
    own = whose == correlate.joint and f"its {signal}" in correlate.words
    return own or f"{signal} of {whose}" in correlate.words


def smallest_of(draw: Draw) -> dict[str, Any]:
    """The smallest share of the effort at which an effect is found in one log, by bisection."""
    low, high = _RANGE
    bodies = robot_model(draw.robot).bodies
    known: RobotModel | None = None
    seconds, found_at = 0.0, None
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        recording = make_recording(replace(draw, shares=(middle,)), bodies)
        known = known or _told(draw, recording)
        began = time.process_time()
        steps = explain(known, [recording.log]).steps
        seconds += time.process_time() - began
        (secret,) = recording.secrets
        if _seen_at(steps, secret):
            high = found_at = min(middle, secret.share)
        else:
            low = middle
    return {**asdict(draw), "smallest": found_at, "seconds": seconds}


def _seen_at(steps: Sequence[Step], secret: Secret) -> bool:
    """Return whether a step has the effect among what it may be, at its place."""
    return any(
        (s.effect == secret.name or secret.name in s.indistinguishable_from)
        and set(secret.where) <= set(s.where)
        for s in steps
    )


def coverage_of(draw: Draw) -> dict[str, Any]:
    """Return how many of its standard deviations every found parameter is off."""
    recording = make_recording(draw, robot_model(draw.robot).bodies)
    secret, off = recording.secrets[0], list[float]()
    for step in explain(robot_model(draw.robot), [recording.log]).steps:
        if step.effect == secret.name:
            place = secret.where[0] if secret.where else next(iter(step.parameters))
            off = _deviations(step, place, secret)
    return {**asdict(draw), "off": off}


def _deviations(step: Step, place: str, secret: Secret) -> list[float]:
    """How many deviations, from noise and what is systematic, the secret's values are off."""
    found, own = step.parameters.get(place, {}), step.deviations.get(place, {})
    beside = step.systematic.get(place, {})
    return [
        float((found[name] - value) / np.hypot(own[name], beside.get(name, 0.0)))
        for name, value in secret.values.items()
        if name in found and own.get(name, np.nan) > 0.0
    ]
