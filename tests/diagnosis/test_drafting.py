"""Effects outside the catalogue: a formula is found, written as code, and runs unchanged."""

import ast
from dataclasses import replace

import numpy as np
import pytest
from odd_names import IN_FILES, IN_XML
from pydrake.systems.framework import DiagramBuilder

from geodrake import load_model
from geodrake.boundary.escaping import printable
from geodrake.control import EffectForce
from geodrake.diagnosis import draft_effects, explain, source_of
from geodrake.diagnosis.drafting import Draft
from geodrake.diagnosis.drafting.formula import Factor, Formula, FormulaTerm
from geodrake.diagnosis.drafting.results import DraftedEffect
from geodrake.effects import load_effect_file
from geodrake.identification.logs.model_errors import ErrorTable, JointError
from geodrake.logs import Motion

pytest.importorskip("pinocchio")

from pinocchio_logs import MODELS, effort_log

JOINTS = load_model(MODELS / "arm6.urdf").joints
YAW, SHOULDER, ELBOW, ROLL, PITCH, SPIN = JOINTS


def test_a_written_effect_explains(tmp_path):
    """Of a pendulum whose bodies are off, and drag of a hose that the file knows nothing of.

    The file as `--effects` takes it: the verdict is then that all is explained.
    """
    model, file = load_model(MODELS / "double_pendulum.urdf"), tmp_path / "my_effect.py"
    shoulder, elbow = model.joints
    log = effort_log(
        "double_pendulum",
        3,
        lambda seen: {1: 0.3 * seen.v[:, 0] * seen.q[:, 1]},
        off=0.2,
        share=0.04,
    ).log
    explanation, draft = draft_effects(model, [log])
    assert explanation.verdict == "unexplained"
    (effect,) = draft.effects
    assert effect.formula.joint == elbow
    signals = frozenset().union(*(term.signals for term in effect.formula.terms))
    assert signals == {(shoulder, "v"), (elbow, "q")}
    assert draft.after.nrms < 1.15 * draft.after.floor_nrms
    before, after = np.square([effect.rms_before, effect.rms_after]) - effect.floor**2
    assert after < 0.09 * before  # of what is more than noise
    assert any(c.joint == elbow and c.share > 0.5 for c in draft.correlates)
    file.write_text(source_of(draft))
    (written,) = load_effect_file(file)
    assert written().where == (elbow,)
    assert written.candidates("another joint", 1.0) == []
    found = explain(model, [log], extra=[written])
    assert [(step.effect, step.where) for step in found.steps] == [(written.name, (elbow,))]
    assert found.verdict == "explained"


def draft_of(logs, *formulas):
    """Return a draft of formulas with made-up numbers."""
    effects = tuple(
        DraftedEffect(each, own, own, 2.0, 1.0, 0.9, 0.0, (), own, own, own)
        for each in formulas
        for own in [np.arange(float(len(each.terms)))]
    )
    errors = ErrorTable((JointError(ELBOW, 1.0, 3.0, 0.9),))
    return Draft(effects, (), (), errors, errors, logs)


def test_a_written_effect_is_its_formula_and_acts_on_a_plant(tmp_path):
    formula = Formula(
        ELBOW,
        (
            FormulaTerm(()),
            FormulaTerm((Factor(ELBOW, "sign_v"), Factor(ROLL, "q", "above", 0.25))),
            FormulaTerm((Factor(ELBOW, "v"), Factor(SPIN, "v", "drag"))),
            FormulaTerm((Factor(YAW, "vd"), Factor(YAW, "q", "cosine_twice"))),
            FormulaTerm((Factor(SHOULDER, "q", "below", -0.5),)),
            FormulaTerm((Factor(SHOULDER, "load", "size"), Factor(YAW, "q", "square"))),
        ),
    )
    model = load_model(MODELS / "arm6.urdf")
    file = tmp_path / "written.py"
    file.write_text(source_of(draft_of(("a log",), formula)))
    assert max(map(len, file.read_text().splitlines())) <= 100
    (written,) = load_effect_file(file)
    rng = np.random.default_rng(0)
    seen = model.motion(Motion(*rng.normal(size=(3, 20, 6))), sign_width=0.01)
    expected = formula.rows(seen)[ELBOW]
    np.testing.assert_allclose(written().rows(seen)[ELBOW], expected, rtol=1e-5, atol=1e-12)
    # By hand: the second column.
    q, v = seen.q, seen.v
    by_hand = np.tanh(v[:, 2] / 0.01) * np.maximum(q[:, 3] - 0.25, 0.0)
    np.testing.assert_allclose(expected[:, 1], by_hand, rtol=1e-12)

    direct = Formula(ELBOW, formula.terms[:3])
    plant = load_model(MODELS / "arm6.urdf").plant
    force = EffectForce(plant, [(direct, [0.5, 2.0, 3.0])], sign_width=0.01)
    builder = DiagramBuilder()
    builder.AddSystem(force)
    builder.ExportInput(force.GetInputPort("state"))
    builder.ExportOutput(force.GetOutputPort("generalized_force"))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.get_input_port(0).FixValue(context, np.concatenate([q[0], v[0]]))
    output = diagram.get_output_port(0).Eval(context)
    wanted = np.zeros(6)
    wanted[2] = -expected[0, :3] @ [0.5, 2.0, 3.0]
    np.testing.assert_allclose(output, wanted, rtol=1e-12)


def test_an_offset_that_each_log_has_anew_varies_with_the_log():
    model = load_model(MODELS / "double_pendulum.urdf")
    one, other = (effort_log("double_pendulum", n, duration=12.0).log for n in (102, 103))
    other = replace(other, effort=other.effort + np.array([0.0, 0.5]))
    draft = draft_effects(model, [one, other])[1]
    told = draft.correlates[0]
    assert told.joint == model.joints[1]
    assert told.words == "the log: its mean differs between logs"
    assert told.share > 0.9
    assert draft.effects == ()


def test_nothing_is_drafted_of_noise_or_of_what_follows_the_clock():
    """One joint swings, and the other drifts."""
    model, recording = load_model(MODELS / "double_pendulum.urdf"), ("double_pendulum", 101)
    draft = draft_effects(model, [effort_log(*recording, duration=8.0).log])[1]
    assert draft.effects == draft.correlates == ()
    assert draft.before.nrms == draft.after.nrms
    log = effort_log(*recording, colour=0.8, duration=12.0).log
    assert draft_effects(model, [log])[1].effects == ()
    swing = 0.6 * np.sin(2 * np.pi * 1.37 * log.time)
    moved = log.effort + np.stack([swing, 2.0 * (log.time / 24.0) ** 2], 1)
    told = draft_effects(model, [replace(log, effort=moved)])[1].correlates
    for joint, words in zip(model.joints, ("oscillation at 1.37 Hz", "slow drift"), strict=True):
        first = next(c for c in told if c.joint == joint)
        assert words in first.words and first.share > 0.9


def drafted(joints, logs):
    """Return a draft with a formula for each joint."""
    terms = (FormulaTerm(tuple(Factor(j, "q") for j in joints)),)
    return draft_of(logs, *(Formula(joint, terms) for joint in joints))


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
    assert printable(f"Missing effects at {', '.join(joints)}.") in docstring
    for log in logs:
        assert printable(log) in docstring


def test_joints_that_differ_in_punctuation_alone_have_classes_of_their_own():
    source = source_of(drafted(("a_1", "a1", "a-1"), ("log",)))
    classes = [node.name for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    assert len(set(classes)) == 3
