"""Drafts of effects for robots and logs of odd names: code of one meaning."""

import ast

import numpy as np
import pytest
from odd_names import IN_FILES, IN_XML

from geodrake.boundary.escaping import printable
from geodrake.diagnosis.drafting import Draft, source_of
from geodrake.diagnosis.drafting.formula import Factor, Formula, FormulaTerm
from geodrake.diagnosis.drafting.results import DraftedEffect
from geodrake.effects import load_effect_file


def drafted(joints, logs):
    """A draft with a formula for each joint, in all of them."""
    effects = tuple(
        DraftedEffect(
            formula=Formula(joint, (FormulaTerm(tuple(Factor(j, "q") for j in joints)),)),
            coefficients=np.array([1.0]),
            deviations=np.array([0.1]),
            rms_before=1.0,
            rms_after=0.5,
            floor=0.1,
            false_alarm_probability=1e-6,
            rivals=(),
            time=np.arange(3.0),
            residual=np.zeros(3),
            effort=np.zeros(3),
        )
        for joint in joints
    )
    return Draft(effects, (), (), None, None, logs)


@pytest.mark.parametrize("what", IN_XML)
def test_a_draft_is_code_of_one_meaning(what, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = IN_XML[what]
    joints, logs = (name, f"{name} ", f"-{name}-"), (name, *IN_FILES.values())
    source = source_of(drafted(joints, logs))
    (tmp_path / "draft.py").write_bytes(source.encode())
    effects = load_effect_file(tmp_path / "draft.py")
    assert [effect().joint for effect in effects] == list(joints)
    assert len({effect.name for effect in effects}) == len(joints)
    assert not (tmp_path / "PWNED").exists()
    docstring = ast.get_docstring(ast.parse(source), clean=False)
    assert printable(f"What is missing at {', '.join(joints)}.") in docstring
    for log in logs:
        assert printable(log) in docstring


def test_joints_that_differ_in_punctuation_alone_have_classes_of_their_own():
    source = source_of(drafted(("a_1", "a1", "a-1"), ("log",)))
    classes = [node.name for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    assert len(set(classes)) == 3
