"""What is ambiguous leads to a command, and the command can be run."""

import io

import pytest
from excitation_robots import MODELS
from rich.console import Console

from geodrake.cli.excite import rivals_in
from geodrake.diagnosis import Candidate, Diagnosis, Explanation, Step
from geodrake.diagnosis.ambiguity import distinguishing_commands
from geodrake.diagnosis.results import FittedRival
from geodrake.effects import catalogue
from geodrake.excitation import motion_limits
from geodrake.excitation.tell_apart import placed_rivals, separation_of
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, JointError
from geodrake.model import load_model
from geodrake.report import page_of, show_page

PREFIX = "geodrake excite MODEL --tell-apart "
JOINTS = ("shoulder", "elbow")
MODEL = load_model(MODELS / "double_pendulum.urdf")
START = ErrorTable(tuple(JointError(joint, 0.5, 1.0, 0.1) for joint in JOINTS))
SHOWN = Comparison(START, (), (), ())


def diagnosis(*found):
    """Candidates as (effect, where, tied), the best first."""
    candidates = tuple(Candidate(e, w, 1.0, 0.1, 9.0, 1e-6, tied) for e, w, tied in found)
    return Diagnosis("explained", candidates, START, START, SHOWN, ())


def explanation(*steps, model=MODEL):
    """Steps as (effect, where, rivals), each rival as (effect, where)."""
    rows = tuple(
        Step(
            effect, where, 1.0, 0.1, {}, {}, tuple(name for name, _ in rivals), 1e-6, 1.0, {}, {},
            tuple(FittedRival(*rival, (effect,), 0.1, 0.1, 0.2, 0.5) for rival in rivals),
        )
        for effect, where, rivals in steps
    )  # fmt: skip
    return Explanation("explained", rows, START, START, START, model, SHOWN, SHOWN, ())


def commands(found):
    """The commands that are told, without what they begin with."""
    return [each.removeprefix(PREFIX) for each in distinguishing_commands(found)]


@pytest.mark.parametrize(
    ("best", "tied", "words"),
    [
        (
            ("coulomb_friction", ("elbow",)),
            ("load_dependent_friction", ("elbow",)),
            "coulomb_friction,load_dependent_friction@elbow",
        ),
        (("joint_spring", ("elbow",)), ("gravity_tilt", ()), "joint_spring@elbow,gravity_tilt"),
        (
            ("coulomb_friction + viscous_friction", ("elbow",)),
            ("asymmetric_friction", ("elbow",)),
            "coulomb_friction,asymmetric_friction@elbow",
        ),
        (
            ("coupled_friction", JOINTS),
            ("coulomb_friction", ("shoulder",)),
            "coupled_friction@shoulder+elbow,coulomb_friction@shoulder",
        ),
        (
            ("payload + coulomb_friction", ("elbow", "lower_link")),
            ("gravity_tilt", ()),
            "payload@lower_link,gravity_tilt",
        ),
    ],
)
def test_commands_that_can_be_run(best, tied, words):
    assert commands(diagnosis((*best, True), (*tied, True))) == [words]
    separation, _ = separation_of(MODEL, *rivals_in(words), motion_limits(MODEL), noise=0.1)
    assert separation.pairs


@pytest.mark.parametrize(
    "rival", ["wrong_inertia", "effort_delay", "an_effect_of_ones_own", "coulomb_friction"]
)
def test_what_no_motion_settles_has_no_command(rival):
    best = ("coulomb_friction", ("elbow",), True)
    assert commands(diagnosis(best, (rival, ("elbow",), True))) == []


def test_only_ties_count_and_each_once():
    best = ("viscous_friction", ("elbow",), True)
    others = [("effort_offset", ("elbow",), tied) for tied in (False, True, True)]
    assert commands(diagnosis(best, others[0])) == []
    assert len(commands(diagnosis(best, *others))) == 1
    assert commands(diagnosis()) == []


@pytest.fixture(scope="module")
def arm():
    return load_model(MODELS / "arm6.urdf")


PLACES = {
    "joint": [("base_yaw",), ("elbow_pitch",), ("wrist_spin",), ("elbow_pitch", "wrist_spin")],
    "joint_pair": [("base_yaw", "shoulder_pitch"), ("wrist_pitch", "wrist_spin")],
    "body": [("column",), ("flange",), ("upper_arm", "flange")],
    "robot": [()],
}
STEPS = [(cls.name, where) for cls in catalogue() for where in PLACES.get(cls.places, [])]


@pytest.mark.parametrize(("effect", "where"), STEPS)
def test_every_command_is_understood(arm, effect, where):
    limits, told = motion_limits(arm), set()
    kinds = {cls.name: cls.places for cls in catalogue()}
    for cls in catalogue():
        place = where if cls.places == kinds[effect] else PLACES.get(cls.places, [()])[0]
        found = explanation((effect, where, ((cls.name, place),)), model=arm)
        for command in commands(found):
            rivals = placed_rivals(arm, *rivals_in(command), limits)
            assert [rival.name for rival in rivals] == [effect, cls.name]
            told.add(cls.name)
    settled = {cls.name for cls in catalogue()} - {
        "effort_delay",
        "wrong_inertia",
        "contact",
        "temporary_payload",
        effect,
    }
    of_one_log = effect in ("contact", "temporary_payload")
    assert told == (set() if of_one_log else settled)


def test_not_too_many():
    rivals = ("effort_offset", "joint_spring", "rotor_inertia", "torque_ripple", "effort_scale")
    found = explanation(("coulomb_friction", ("elbow",), [(r, ("elbow",)) for r in rivals]))
    assert len(commands(found)) == 4


def test_the_terminal_tells_the_commands_that_a_motion_can_settle():
    rivals = ("nonlinear_viscous_friction", ("elbow",)), ("wrong_inertia", ("lower_link",))
    found = explanation(("viscous_friction", ("elbow",), rivals), ("gravity_tilt", (), ()))
    told = "viscous_friction,nonlinear_viscous_friction@elbow"
    assert commands(found) == [told]
    console = Console(file=io.StringIO(), markup=False, highlight=False, width=160)
    show_page(console, page_of(found))
    assert f"- {PREFIX}{told} --save motion_1.csv" in console.file.getvalue().splitlines()
