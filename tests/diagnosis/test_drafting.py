"""Effects that no catalogue has: a formula is found, written out, and runs as it is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from geodrake import load_model
from geodrake.control.systems import EffectForce
from geodrake.diagnosis.drafting import Draft, draft_effects, source_of
from geodrake.diagnosis.drafting.formula import Factor, Formula, FormulaTerm
from geodrake.diagnosis.drafting.results import DraftedEffect
from geodrake.diagnosis.drafting.vocabulary import vocabulary
from geodrake.diagnosis.explain import explain
from geodrake.effects import load_effect_file
from geodrake.identification.logs.model_errors import ErrorTable, JointError
from geodrake.logs.motion import Motion

pytest.importorskip("pinocchio")

from pinocchio_logs import MODELS, effort_log

JOINTS = load_model(MODELS / "arm6.urdf").joints
YAW, SHOULDER, ELBOW, ROLL, PITCH, SPIN = JOINTS


def smooth_sign(v):
    return v / np.hypot(v, 5e-3)


GYROSCOPE = "gyroscope that the file knows nothing of"
INVENTED = {
    "brake that another joint's position tightens": (
        lambda q, v: {2: 3.0 * (1.2 + np.sin(q[3])) * smooth_sign(v[2])},
        ELBOW,
        {(ELBOW, "sign_v"), (ROLL, "q")},
    ),
    "spring that acts past an angle": (
        lambda q, v: {1: 0.6 * np.log1p(np.exp((q[1] - 0.2) / 0.02))},
        SHOULDER,
        {(SHOULDER, "q")},
    ),
    "friction that grows with a neighbour's speed": (
        lambda q, v: {3: 0.9 * abs(v[2]) * smooth_sign(v[3])},
        ROLL,
        {(ROLL, "sign_v"), (ELBOW, "v")},
    ),
    "hose that hangs from the sum of two angles": (
        lambda q, v: {4: 0.5 * np.cos(q[4] + q[3])},
        PITCH,
        {(PITCH, "q"), (ROLL, "q")},
    ),
    "damper that another joint's position opens": (
        lambda q, v: {0: 4.0 * q[1] * v[0]},
        YAW,
        {(YAW, "v"), (SHOULDER, "q")},
    ),
    GYROSCOPE: (
        lambda q, v: {3: 0.3 * v[4] * v[5]},
        ROLL,
        {(PITCH, "v"), (SPIN, "v")},
    ),
}
"""Law, joint, and the signals that it is a function of."""


@cache
def drafted(name):
    """The log of an invented effect of an arm whose bodies are off, and its draft."""
    law = INVENTED[name][0]
    log = effort_log("arm6", 3, lambda seen: law(seen.q.T, seen.v.T), off=0.2, share=0.04).log
    return log, *draft_effects(load_model(MODELS / "arm6.urdf"), [log])


@pytest.mark.thorough
@pytest.mark.parametrize("name", INVENTED)
def test_invented_effects(name, tmp_path):
    _, joint, signals = INVENTED[name]
    _, explanation, draft = drafted(name)
    assert explanation.verdict == "unexplained"
    (effect,) = draft.effects
    assert effect.formula.joint == joint
    assert frozenset().union(*(term.signals for term in effect.formula.terms)) == signals
    assert draft.after.nrms < 1.15 * draft.after.floor_nrms
    before, after = np.square([effect.rms_before, effect.rms_after]) - effect.floor**2
    assert after < 0.09 * before  # of what is more than noise
    assert any(c.joint == joint and c.share > 0.5 for c in draft.correlates)

    file = tmp_path / "my_effect.py"
    file.write_text(source_of(draft))
    (written,) = load_effect_file(file)
    assert written().where == (joint,)
    assert written.candidates("another joint", 1.0) == []


def test_a_written_effect_explains(tmp_path):
    """The file as `--effects` takes it: the verdict is then that all is explained."""
    log, _, draft = drafted(GYROSCOPE)
    file = tmp_path / "my_effect.py"
    file.write_text(source_of(draft))
    (written,) = load_effect_file(file)
    found = explain(load_model(MODELS / "arm6.urdf"), [log], extra=[written])
    joint = INVENTED[GYROSCOPE][1]
    assert [(step.effect, step.where) for step in found.steps] == [(written.name, (joint,))]
    assert found.verdict == "explained"


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
    model, six = load_model(MODELS / "arm6.urdf"), np.arange(6.0)
    drafted = DraftedEffect(formula, six, six, 2.0, 1.0, 0.9, 0.0, (), six, six, six)
    errors = ErrorTable((JointError(ELBOW, 1.0, 3.0, 0.9),))
    draft = Draft((drafted,), (), (), errors, errors, ("a log",))
    file = tmp_path / "written.py"
    file.write_text(source_of(draft))
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


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda t: 0.6 * np.sin(2 * np.pi * 1.37 * t), "swings at 1.37 Hz"),
        (lambda t: 2.0 * (t / 24.0) ** 2, "drifts slowly"),
    ],
)
def test_what_follows_the_clock(law, words):
    log = effort_log("arm6", 6).log
    effort = log.effort + np.outer(law(log.time), np.eye(6)[4])
    draft = draft_effects(load_model(MODELS / "arm6.urdf"), [replace(log, effort=effort)])[1]
    first = next(c for c in draft.correlates if c.joint == PITCH)
    assert words in first.words
    assert first.share > 0.9


def test_nothing_to_draft():
    draft = draft_effects(
        load_model(MODELS / "arm6.urdf"), [effort_log("arm6", 4, duration=16.0).log]
    )[1]
    assert draft.effects == ()
    assert draft.correlates == ()
    assert draft.before.nrms == draft.after.nrms


def test_coloured_noise_is_no_formula():
    log = effort_log("double_pendulum", 101, colour=0.8, duration=16.0).log
    assert draft_effects(load_model(MODELS / "double_pendulum.urdf"), [log])[1].effects == ()


def test_vocabulary_has_nothing_twice():
    terms = vocabulary(YAW, JOINTS, dict.fromkeys(JOINTS, (-1.0, 2.0)))
    assert len({frozenset(term.factors) for term in terms}) == len(terms) > 500
    assert FormulaTerm(()) in terms


def test_the_short_vocabulary_has_nothing_twice_and_nothing_else():
    joints = ("a", "b", "c")
    short = vocabulary("a", joints)
    every = vocabulary("a", joints, dict.fromkeys(joints, (-1.0, 1.0)))
    assert len({frozenset(term.factors) for term in short}) == len(short) < len(every) / 2
    assert {frozenset(t.factors) for t in short} <= {frozenset(t.factors) for t in every}


def test_words_and_units():
    term = FormulaTerm((Factor(ELBOW, "sign_v"), Factor(ROLL, "q", "sine")))
    assert term.words(ELBOW) == "its direction of motion times sine of the position of wrist_roll"
    assert term.unit == "N·m"
    assert FormulaTerm((Factor(ELBOW, "v"), Factor(ROLL, "v", "size"))).unit == "N·m/(rad/s·rad/s)"
    assert FormulaTerm((Factor(ELBOW, "q", "above", 0.25),)).words(ELBOW) == (
        "its position beyond 0.25 upwards"
    )
