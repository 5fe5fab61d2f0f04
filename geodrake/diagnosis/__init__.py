"""What a model is missing: compare it with measurements, diagnose, add, explain."""

from geodrake.diagnosis.add import add
from geodrake.diagnosis.compare import compare
from geodrake.diagnosis.diagnose import diagnose
from geodrake.diagnosis.evidence import Criteria
from geodrake.diagnosis.explain import explain
from geodrake.diagnosis.results import (
    Candidate,
    Comparison,
    Diagnosis,
    ErrorTable,
    Explanation,
    Failing,
    JointError,
    Series,
    Step,
)

__all__ = [
    "Candidate",
    "Comparison",
    "Criteria",
    "Diagnosis",
    "ErrorTable",
    "Explanation",
    "Failing",
    "JointError",
    "Series",
    "Step",
    "add",
    "compare",
    "diagnose",
    "explain",
]
