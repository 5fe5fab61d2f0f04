"""Diagnosis of effects that a model is missing: compare, diagnose, add, explain."""

from geodrake.diagnosis.add import add
from geodrake.diagnosis.beliefs import Beliefs
from geodrake.diagnosis.columns import check_columns, corrected, with_motor_limits
from geodrake.diagnosis.diagnose import diagnose
from geodrake.diagnosis.drafting import draft_effects, rest_correlates, source_of
from geodrake.diagnosis.explain import explain
from geodrake.diagnosis.results import Candidate, Diagnosis, Explanation, Step
from geodrake.identification.logs.compare import compare

__all__ = [
    "Beliefs",
    "Candidate",
    "Diagnosis",
    "Explanation",
    "Step",
    "add",
    "check_columns",
    "compare",
    "corrected",
    "diagnose",
    "draft_effects",
    "explain",
    "rest_correlates",
    "source_of",
    "with_motor_limits",
]
