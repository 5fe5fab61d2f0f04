"""Verdicts on errors: what is called noise must be known to be noise."""

import pytest

from geodrake.diagnosis.findings import verdict_of
from geodrake.diagnosis.results import Diagnosis
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, JointError
from geodrake.report.numbers import Units
from geodrake.report.words import diagnosis_verdict


@pytest.mark.parametrize(
    ("noise", "known", "verdict", "words"),
    [
        (0.1, True, "adequate", "Adequate: nothing is missing"),
        (0.1, False, "undecided", "the noise of elbow is not known"),
        (0.8, True, "undecided", "noise is as large as what the model explains"),
    ],
)
def test_nothing_is_adequate_where_noise_is_not_known(noise, known, verdict, words):
    joints = (
        JointError("shoulder", noise, 1.0, noise),
        JointError("elbow", noise, 1.0, noise, known),
    )
    table = ErrorTable(joints)
    assert verdict_of(table, found=False) == verdict
    comparison = Comparison(table, (), (), ())
    said = diagnosis_verdict(Diagnosis(verdict, (), table, table, comparison, ()), Units())
    assert words in said
    assert (
        verdict_of(ErrorTable((JointError("elbow", 0.9, 1.0, 0.1),)), found=True) == "unexplained"
    )
