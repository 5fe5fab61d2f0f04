"""Notes on a final fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geodrake.diagnosis.findings import Finding, Unnamed
from geodrake.diagnosis.results import Step
from geodrake.diagnosis.search import SearchResult
from geodrake.effects import Role
from geodrake.effects.declarations import when_sliding
from geodrake.effects.episode import Episode
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.model_fit import ModelFit
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.identification.models.identify import common_factor_notes
from geodrake.identification.models.results import BodyChange
from geodrake.model.carried_payloads import joints_with_known_gain
from geodrake.model.robot_model import RobotModel

_LATE = 0.005  # s, least start time on a log's clock to be reported
_ALIKE = 0.01
"""Largest difference of equal gains."""


def notes_of(
    result: SearchResult, case: Case, fit: ModelFit, bodies: Sequence[BodyChange]
) -> list[str]:
    """Return notes on a final fit to a case, and on its bodies."""
    return [
        *_companions(result.model.unknowns_of(result.fit.choice), fit),
        *fit.result.notes,
        *_fading(case.model, fit.model),
        *_episodes(case, fit.model),
        *_stated_mass(case, fit.model),
        *common_factor_notes(bodies),
    ]


def unnamed_notes(rest: Unnamed) -> list[str]:
    """Return notes on evidence that is not a finding."""
    unknown = [
        f"the remaining error at {each.joint} varies with {each.words}, which no effect "
        "describes; `--draft-effect FILE` searches for a formula"
        for each in rest.motion
    ]
    loads = [_load_note(body, p) for body, p in rest.loads.items()]
    return [*unknown, *loads, *gain_notes(rest)]


def _load_note(body: str, probability: float) -> str:
    return (
        f"{body} may carry a payload ({probability:.0%}), which these logs cannot separate from "
        "wrong inertias: add a log without the payload"
    )


def gain_notes(rest: Unnamed, *, beyond: float = 0.0) -> list[str]:
    """Return notes on errors of gains beyond a number of their deviations."""
    return [
        f"efforts of {joint} are {abs(error):.1%} {'larger' if error > 0.0 else 'smaller'} "
        f"than the model's: {abs(error) / known:.1f} standard deviations of their gain, which is "
        f"known to {known:.1%} (--effort-uncertainty)"
        for joint, (error, known) in rest.gains.items()
        if abs(error) > beyond * known
    ]


def left_out_notes(findings: Sequence[Finding], steps: Sequence[Step]) -> list[str]:
    """Return notes on findings, or their places, that are not in the steps."""
    places, notes = dict[str, set[str]](), []
    for step in steps:
        places.setdefault(step.effect, set()).update(step.where)
    for finding in findings:
        missing = [place for place in finding.places if place not in places.get(finding.name, ())]
        carries = (t.is_whole and not isinstance(t.effect, Episode) for t in finding.terms)
        if missing and any(carries):
            notes += [_load_note(body, finding.certainty.probability) for body in missing]
        elif missing or finding.name not in places:
            where = f" at {', '.join(missing)}" if missing else ""
            reason = "is zero in the final fit, or removes too little of the held-out error"
            if finding.name in places:
                reason = "does not lower the held-out error there"
            notes.append(f"{finding.name}{where} was found, but {reason}")
    return notes


def changed_notes(model: RobotModel, steps: Sequence[Step]) -> list[str]:
    """Return notes on effects of the model whose values changed."""
    notes = list[str]()
    for step in steps:
        fitted = [f for f in model.effects if f.effect.name == step.effect]
        changed = [f for f in fitted if f.effect.place in step.parameters and len(f.parameters)]
        shown = [
            f"{f.effect.place} {' and '.join(f'{value:.3g}' for value in f.parameters)}"
            for f in changed
        ]
        if shown and changed[0].effect.role is not Role.BODY:
            notes.append(f"the model had {step.effect} with other values: {', '.join(shown)}")
    return notes


def _companions(found: Unknowns, fit: ModelFit) -> list[str]:
    """Return notes on effects that were fitted without being a step."""
    added = [f for f in fit.model.effects if f.effect not in found.effects and len(f.parameters)]
    sliding = set(fit.model.sliding_joints)
    notes = []
    for fitted in added:
        unit = fitted.effect.parameters[0].unit
        unit = when_sliding(unit) if sliding.issuperset(fitted.effect.where) else unit
        notes.append(
            f"{fitted.effect.name.replace('_', ' ')} of {fitted.effect.place} was fitted, "
            f"but is too small to be a step: {fitted.parameters[0]:.3g} {unit}"
        )
    return notes


def _fading(before: RobotModel, after: RobotModel) -> list[str]:
    """Return notes on the speeds below which dry friction fades."""
    speeds, known = after.sign_widths(0.0), before.sign_widths(0.0)
    rubbing = {p for f in after.effects if f.effect.jumps for p in f.effect.where}
    return [
        f"dry friction of {joint} fades below {speeds[j]:.2g} "
        f"{'m/s' if joint in after.sliding_joints else 'rad/s'}"
        for j, joint in enumerate(after.joints)
        if joint in rubbing and speeds[j] not in (0.0, known[j])
    ]


def _episodes(case: Case, model: RobotModel) -> list[str]:
    """Return notes on the logs of episodes, and their times on the logs' clocks."""
    notes = list[str]()
    for effect in [f.effect for f in model.effects if isinstance(f.effect, Episode)]:
        for log in case.trajectories:
            if effect.window[3] != log_number(log.name):
                continue
            where = f" of {log.name}" if len(case.trajectories) > 1 else ""
            edges = [edge for edge in effect.window[:2] if edge is not None]
            if not edges:
                notes.append(f"{effect.name} of {effect.where[0]} is present throughout {log.name}")
                continue
            clock = " and ".join(f"{log.began + edge:.2f} s" for edge in edges)
            by_clock = f"; {clock} on its clock" if abs(log.began) >= _LATE else ""
            if where or by_clock:
                name = f"{effect.name} of {effect.place}"
                notes.append(
                    f"times of {name} are relative to the start{where or ' of the log'}{by_clock}"
                )
    return notes


def _stated_mass(case: Case, fitted: RobotModel) -> list[str]:
    """Return a note if a wrong known mass explains the fitted gains.

    It does if all joints that bear it, or all but one, have the same gain, as the bodies absorb the
    rest. Bodies known from other logs cannot.
    """
    known = joints_with_known_gain(
        case.model, [trajectory.payloads for trajectory in case.trajectories]
    )
    scales = [f for f in fitted.effects if f.effect.role is Role.SCALE]
    gains = np.array([1.0 + f.parameters[0] for f in scales if f.effect.where[0] in known])
    if case.model.information is not None or not len(gains):
        return []
    common = float(np.median(gains))
    count = int(np.sum(np.abs(gains - common) <= _ALIKE))
    if count < max(2, len(known) - 1):
        return []
    return [
        f"{count} of {len(known)} joints that bear the known payload have gain {common:.3g}: "
        f"all are right if its mass is {common:.3g} times the stated one, so weigh it again"
    ]
