"""Verdicts on errors: what is called noise must be known to be noise."""

import pytest

from geodrake.diagnosis.findings import verdict_of
from geodrake.diagnosis.results import Diagnosis
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, JointError
from geodrake.report import page_of


@pytest.mark.parametrize(
    ("noise", "known", "verdict", "words"),
    [
        (0.1, True, "adequate", "The model is adequate: nothing worth adding is missing."),
        (0.1, False, "undecided", "The noise of elbow is not known"),
        (0.8, True, "undecided", "Noise is as large as what the model explains"),
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
    said = page_of(Diagnosis(verdict, (), table, table, comparison, ())).sentence
    assert words in said
    assert (
        verdict_of(ErrorTable((JointError("elbow", 0.9, 1.0, 0.1),)), found=True) == "unexplained"
    )
