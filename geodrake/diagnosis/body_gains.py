"""Which body's inertia is wrong: what the logs say of each body moved alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geodrake.diagnosis.judgement import judge, judge_errors
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.criteria import FIXED, Criteria
from geodrake.identification.logs.cross_validation import HeldOut
from geodrake.identification.logs.hypothesis import Hypothesis, settle
from geodrake.inertia import PARAMETERS_PER_BODY


@dataclass(frozen=True)
class BodyGains:
    """What refitting one body alone gains.

    Attributes:
        gains: Body -> twice the held-out log-likelihood ratio against the model as it stands.
        enough: The body that leaves least held-out error if it does as well alone as all bodies
            together, or nothing.
    """

    gains: Mapping[str, float]
    enough: tuple[str, ...]


def gains_of_bodies(
    case: Case, refitted: Hypothesis, standing: HeldOut, criteria: Criteria
) -> BodyGains:
    """Refit one body after the other, all others fixed where the model has them.

    Args:
        case: The case.
        refitted: The model with all inertias refitted within their prior.
        standing: Errors of the model as it stands.
        criteria: How much less squared error counts as a reduction.
    """
    gains, left = dict[str, float](), dict[str, float]()
    for index, body in enumerate(case.model.bodies):
        alone = _alone(refitted, index, len(case.model.bodies))
        errors = standing, alone.held_out
        gains[body] = judge_errors(errors, alone.effective, parameters=PARAMETERS_PER_BODY).gain
        left[body] = judge(refitted, alone).left
    best = min(left, key=lambda body: left[body])
    return BodyGains(gains, (best,) if left[best] <= 1.0 + criteria.reduction else ())


def _alone(refitted: Hypothesis, index: int, bodies: int) -> Hypothesis:
    """The hypothesis with the inertial parameters of all bodies but one fixed."""
    scale = np.ones(len(refitted.unknowns.columns))
    scale[: bodies * PARAMETERS_PER_BODY] = 1.0 / FIXED
    scale[index * PARAMETERS_PER_BODY : (index + 1) * PARAMETERS_PER_BODY] = 1.0
    information = refitted.unknowns.information * scale[:, None] * scale
    return settle(replace(refitted, unknowns=replace(refitted.unknowns, information=information)))
