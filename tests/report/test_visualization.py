"""Figures and reports: complete, self-contained, and safe whatever joints are called."""

import dataclasses
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from report_results import (
    BLOCKS,
    NAMES,
    comparison,
    diagnosis,
    errors,
    explanation,
    friction,
    joint_names,
    step,
)

from geodrake import load_model
from geodrake.errors import OutputError
from geodrake.identification.logs.model_errors import (
    ErrorTable,
    Failing,
    JointError,
)
from geodrake.identification.models import BodyChange
from geodrake.report import (
    Units,
    candidate_figure,
    comparison_figures,
    effort_figure,
    joint_error_figure,
    render_comparison,
    render_diagnosis,
    render_explanation,
    report_figures,
    residual_figure,
    save_figures,
    step_figure,
    step_stages,
)
from geodrake.report.json_output import NoNumber, comparison_dict
from geodrake.report.numbers import chance, is_noticed, number, percent, shortened, with_deviation
from geodrake.report.style import png
from geodrake.report.tables import Cell, errors_table
from geodrake.report.words import (
    addition_verdict,
    comparison_verdict,
    effect_label,
    failing_list,
    failing_words,
    listed,
    places_label,
)

EVIL = "<script>alert('$x_{1')</script>&\"$"
FIELDS = ("time", "position", "velocity", "acceleration", "measured", "predicted")


class Reader(HTMLParser):
    """Collects text, tags and what is loaded; checks that tags close in order."""

    EMPTY = ("meta", "img", "link", "wbr")

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.sources, self.text = [], [], [], []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] not in (["script"], ["style"]):
            self.text.append(data)


def check_self_contained(html):
    page = Reader(html)
    assert not page.open
    assert not re.search(r"@import|url\((?!#)", html)
    assert not {"link", "iframe", "object"} & set(page.tags)
    assert all(source.startswith(("data:image/png;base64,", "#")) for source in page.sources)
    assert "default-src 'none'" in html
    assert len(html) < 1_000_000
    return " ".join("".join(page.text).replace("\N{NO-BREAK SPACE}", " ").split())


@pytest.mark.sampled(3)
@pytest.mark.parametrize("count", [1, 6, 30])
def test_pages_hold_all_joints(count):
    joints = joint_names(count)
    pages = (
        render_explanation(explanation(joints), **NAMES),
        render_diagnosis(diagnosis(joints), **NAMES),
        render_comparison(comparison(joints, 1.0), **NAMES),
    )
    for html in pages:
        text = check_self_contained(html)
        assert all(re.search(rf"\b{joint}\b", text) for joint in joints)
        assert "arm.urdf against a.csv, b.csv" in text
        assert "errs most at speeds below 0.05 rad/s" in text
        assert "geodrake" in text
        assert "How errors were measured" in text


def test_an_explanation_says_what_was_found():
    joints = joint_names(3)
    text = check_self_contained(render_explanation(explanation(joints), **NAMES))
    assert "Missing: Coulomb friction (all 3 joints)." in text
    assert "explained in part" in text
    assert "3.084 ± 0.012" in text
    assert "Coulomb, N·m" in text
    assert "75 %" in text
    assert "Stribeck friction" in text
    assert "< 10⁻⁶" in text
    assert "a: bandwidth 4 Hz" in text


def test_bodies_are_shown_before_and_after():
    com = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    body = BodyChange("hand", (2.0, 2.5), com, 0.1, np.full(3, 0.002), False, 0.4)
    found = explanation(joint_names(2))
    page = render_explanation(dataclasses.replace(found, bodies=(body,)), **NAMES)
    assert "Bodies" in page and "2.50 ± 0.10" in check_self_contained(page)
    assert "Bodies" not in check_self_contained(render_explanation(found, **NAMES))


def test_names_are_escaped():
    joints = (EVIL, "elbow")
    shown = dataclasses.replace(explanation(joints), notes=("<b>note</b>",))
    for html in (
        render_explanation(shown, title=EVIL, model_name="<i>", log_names=["<img src=x>"]),
        render_diagnosis(diagnosis(joints), **NAMES),
        render_comparison(comparison(joints, 1.0), **NAMES),
    ):
        text = check_self_contained(html)
        assert "<script>alert" not in html
        assert "<img src" not in html
        assert EVIL in text


def test_effects_without_a_class_and_without_deviations():
    joints = joint_names(2)
    steps = (
        step(
            "wrong_inertia",
            ("forearm",),
            {"forearm": {"mass": 2.5, "distance_from_prior": 1.25}},
            {},
            joints=joints,
        ),
        step("effort_delay", (), {"all joints": {"delay": 0.0162}}, {}, joints=joints),
        step(
            "my_hose", joints[:1], {joints[0]: {"cosine": 1.5}}, {joints[0]: {"cosine": math.nan}}
        ),
        step(
            "payload", ("hand",), {"hand": {"mass": 3.0, "com_x": 0.033}}, {"hand": {"mass": 0.1}}
        ),
    )
    shown = explanation(joints, steps)
    text = check_self_contained(render_explanation(shown, **NAMES))  # draws such names, too
    for words in ("wrong inertia", "delay, ms", "16.2", "the whole robot", "my hose", "1.5"):
        assert words in text
    for words in ("3.00 ± 0.10", "CoM x, m", "mass, kg", "0.033", "1.25"):
        assert words in text
    assert "nan" not in text


@pytest.mark.parametrize(
    ("verdict", "words"),
    [("adequate", "The model is adequate"), ("unexplained", "that no known effect explains")],
)
def test_an_explanation_without_steps(verdict, words):
    shown = explanation(joint_names(2), (), verdict=verdict)
    text = check_self_contained(render_explanation(shown, **NAMES))
    assert words in text
    assert "Parameters found" not in text
    assert set(report_figures(shown)) == {"efforts", "residuals_before", "joint_errors"}
    assert len(step_figure(shown).axes[0].get_yticks()) == 1


def test_steps_without_evidence_are_not_called_missing():
    joints = joint_names(3)
    doubtful = step("rotor_inertia", joints, {}, {}, false_alarm_probability=0.6)
    useless = step("joint_spring", joints, {}, {}, error_after=0.5)
    text = check_self_contained(
        render_explanation(explanation(joints, (doubtful, useless)), **NAMES)
    )
    assert "Missing:" not in text
    assert "Added without convincing evidence: rotor inertia and joint spring" in text


def test_a_diagnosis_tells_ties_and_silence():
    joints = joint_names(3)
    text = check_self_contained(render_diagnosis(diagnosis(joints), **NAMES))
    assert "Missing: Coulomb friction + viscous friction (all 3 joints)." in text
    assert "In its place there may be asymmetric friction." in text
    assert "geodrake excite MODEL --tell-apart coulomb_friction,asymmetric_friction." in text
    silent = diagnosis(joints, candidates=False)
    text = check_self_contained(render_diagnosis(silent, **NAMES))
    assert "no known effect explains" in text
    assert candidate_figure(silent).axes


def test_figures_have_the_axes_they_should():
    joints = joint_names(3)
    shown = explanation(joints)
    figures = report_figures(shown)
    axes = {name: len(figure.axes) for name, figure in figures.items()}
    assert axes == {
        "steps": 1,
        "joint_errors": 1,
        "efforts": 6,
        "residuals_before": 9,
        "residuals_after": 9,
    }
    bars = figures["joint_errors"].axes[0].patches
    assert len(bars) == 2 * len(joints)
    labels = [label.get_text() for label in figures["steps"].axes[0].get_yticklabels()]
    assert labels[0] == "the model as it stands"
    assert labels[-1] == "+ Coulomb friction, all 3 joints"
    assert len(candidate_figure(diagnosis(joints)).axes[0].patches) == 3


def test_many_joints_are_limited_to_the_worst():
    joints = joint_names(30)
    many = comparison(joints, 1.0)
    figure = effort_figure(many, most=4)
    assert len(figure.axes) == 8
    assert "The 4 joints of largest nrms, of 30." in figure.get_supxlabel()
    worst = sorted(many.errors.joints, key=lambda joint: -joint.nrms)[:3]
    largest = max(many.errors.joints, key=lambda joint: joint.rms)
    titles = {ax.get_title(loc="left") for ax in figure.axes} - {""}
    assert titles == {joint.joint for joint in (*worst, largest)}
    assert len(residual_figure(many).axes) == 24
    bars = joint_error_figure(many.errors, step_stages(explanation(joints)), most=5)
    assert len(bars.axes[0].get_xticks()) == 5


def test_gaps_stay_gaps_and_logs_keep_their_own_time():
    one = comparison(("elbow",), 1.0)
    missing = [dataclasses.replace(s, **{f: getattr(s, f)[np.arange(40) != 17] for f in FIELDS})
               for s in one.series]  # fmt: skip
    figure = effort_figure(dataclasses.replace(one, series=tuple(missing)))
    x, y = figure.axes[0].lines[0].get_data()
    assert np.isnan(y).sum() == 2 * len(BLOCKS)
    assert (np.diff(x[np.isfinite(x)]) > 0).all()
    png(figure)
    labels = [label.get_text() for label in figure.axes[-1].get_xticklabels()]
    assert labels == ["0", "2", "4", "6", "8", "2", "4"]


def test_a_block_without_motion_is_left_out():
    one = comparison(("elbow",), 1.0)
    first, *others = one.series
    empty = dataclasses.replace(first, **{f: getattr(first, f)[:0] for f in FIELDS})
    figure = effort_figure(dataclasses.replace(one, series=(empty, *others)))
    assert np.isfinite(figure.axes[0].lines[0].get_data()[1]).sum() == 40 * len(others)
    png(figure)


def test_perfect_models_and_nan_positions_can_be_drawn():
    one = comparison(("elbow",), 1.0)
    perfect = dataclasses.replace(
        one,
        errors=ErrorTable((JointError("elbow", 0.0, 1.0, 0.0),)),
        failing=(),
        series=tuple(
            dataclasses.replace(s, predicted=s.measured, position=np.full(40, np.nan))
            for s in one.series
        ),
    )
    html = render_comparison(perfect, **NAMES)
    check_self_contained(html)
    assert "not seen" in html and "not seen" not in render_comparison(one, **NAMES)


def test_units_of_prismatic_joints():
    shown = explanation(("slide", "elbow"), prismatic=("slide",))
    text = check_self_contained(render_explanation(shown, **NAMES))
    assert "3.084 ± 0.012 N " in text
    assert "3.084 ± 0.012 N·m" in text
    units = Units.of(shown.model)
    assert units.effort(["slide"]) == "N"
    assert units.effort(["slide", "elbow"]) == "N·m or N"
    assert units.parameter("viscous_friction", "viscous", "slide") == "N·s/m"
    assert units.parameter("rotor_inertia", "inertia", "slide") == "kg"
    assert units.parameter("load_dependent_friction", "load_factor", "elbow") == ""


def test_units_of_a_model():
    model = load_model(Path(__file__).parents[2] / "models" / "double_pendulum.urdf")
    assert Units.of(model).effort(model.joints) == "N·m"


@pytest.mark.parametrize("joints", [("elbow",), joint_names(30), (EVIL,)])
def test_figures_can_be_drawn(joints):
    text = check_self_contained(render_explanation(explanation(joints), **NAMES))
    assert "sensor noise" in text


@pytest.mark.thorough
def test_reports_are_reproducible():
    shown = explanation(("elbow",))
    assert render_explanation(shown, **NAMES) == render_explanation(shown, **NAMES)


def test_figures_are_saved(tmp_path):
    figures = comparison_figures(comparison(("elbow",), 1.0))
    paths = save_figures(figures, tmp_path / "new")
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == sorted(p.name for p in paths)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file cannot be made"):
        save_figures(figures, tmp_path / "file")


@pytest.mark.parametrize(
    ("value", "deviation", "text"),
    [
        (3.0839, 0.0412, "3.08 ± 0.04"),
        (3.0839, 0.0121, "3.084 ± 0.012"),
        (21.015, 0.459, "21.0 ± 0.5"),
        (-0.1635, 0.00299, "−0.164 ± 0.003"),
        (0.0764, 0.0996, "0.08 ± 0.10"),
        (12345.0, 678.0, "12300 ± 700"),
        (3.2e-6, 1.4e-7, "(3.20 ± 0.14)·10⁻⁶"),
        (0.0, 0.1, "0.00 ± 0.10"),
        (2.5, math.nan, "2.50"),
        (2.5, 0.0, "2.50"),
        (math.nan, 1.0, "–"),
    ],
)
def test_values_with_deviations(value, deviation, text):
    assert with_deviation(value, deviation) == text


@pytest.mark.parametrize(
    ("systematic", "text"),
    [
        (0.0035, "3.084 ± 0.012"),
        (0.0037, "3.084 ± 0.012 ± 0.004"),
        (0.1542, "3.084 ± 0.012 ± 0.154"),
        (math.nan, "3.084 ± 0.012"),
    ],
)
def test_a_second_deviation_is_shown_where_it_is_not_small(systematic, text):
    assert with_deviation(3.0839, 0.0121, systematic) == text
    assert with_deviation(3.0839, math.nan, systematic) == "3.08"
    assert is_noticed(0.0121, systematic) == (text.count("±") == 2)


@pytest.mark.parametrize("systematic", [0.003, 0.154])
def test_a_second_deviation_is_explained_where_one_is_shown(systematic):
    joints = joint_names(2)
    own = {joint: {"coulomb": systematic} for joint in joints}
    found = explanation(joints, (dataclasses.replace(friction(joints), systematic=own),))
    text = check_self_contained(render_explanation(found, **NAMES))
    assert ("A second deviation comes from the gains" in text) == (systematic > 0.1)


def test_numbers_in_words():
    assert [number(v) for v in (0.0381, 92.24, 1234.0, 1e-7, -2.5e9, math.inf, 9.999)] == [
        "0.0381", "92.2", "1230", "1.00·10⁻⁷", "−2.50·10⁹", "–", "10.0",
    ]  # fmt: skip
    assert [percent(v) for v in (0.5, 0.998, 0.99981, 0.012, 0.0001, 1.0, 0.0, -0.03)] == [
        "50 %", "99.8 %", "> 99.9 %", "1.2 %", "< 0.1 %", "100 %", "0 %", "−3 %",
    ]  # fmt: skip
    assert [chance(v) for v in (1e-200, 0.0123, 1.0)] == ["< 10⁻⁶", "0.012", "1.0"]
    assert shortened("a_very_long_joint_name", 9) == "a_ve…name"
    assert effect_label("load_dependent_friction") == "load-dependent friction"
    assert [listed(list(names), "or") for names in ("a", "ab", "abc")] == [
        "a",
        "a or b",
        "a, b or c",
    ]
    assert places_label(("a", "b"), ("a", "b")) == "a and b"
    assert places_label(("a", "b", "d", "e"), tuple("abcde"), most=3) == "4 joints"


def test_where_only_noise_is_left_no_better_model_is_promised():
    text = render_explanation(explanation(joint_names(3), verdict="explained"), **NAMES)
    assert "only sensor noise is left. Sensor noise alone would make" in text
    assert "a better model could" not in text


def test_where_no_noise_is_seen_nothing_is_called_removable():
    found = comparison(joint_names(3), 0.5)
    quiet = tuple(dataclasses.replace(joint, floor=0.0) for joint in found.errors.joints)
    found = dataclasses.replace(found, errors=ErrorTable(quiet))
    html = render_comparison(found, **NAMES)
    assert "not seen" in html
    assert "100\N{NO-BREAK SPACE}%" not in html
    assert "could remove" not in html + comparison_verdict(found)
    *_, noise, _, nrms, removable = errors_table({"RMS": found.errors}, Units()).rows[0]
    assert (noise.text, removable) == ("–", Cell("–"))
    assert nrms.text != "–"
    written = comparison_dict(found)
    assert written["joints"]["joint_0"]["removable"] == NoNumber("the logs show no sensor noise")


def test_an_added_effect_that_makes_things_worse_is_said_to():
    joints = joint_names(3)
    useless = step("joint_spring", joints, {}, {}, error_before=0.565, error_after=0.569)
    added = explanation(joints, (useless,))
    added = dataclasses.replace(added, end=errors(joints, 1.01))
    words = "though it does not lower the held-out error (nrms 0.565 -> 0.569)"
    assert words in addition_verdict(added, Units())
    text = render_explanation(added, **NAMES)
    assert "none of the squared error is gone" in text
    assert "explained in part" not in text


def test_the_worst_joint_is_named_where_it_errs_throughout():
    """Of the five joints, the first fails under a circumstance and the last errs most."""
    one = comparison(joint_names(5), 1.0)
    even = dataclasses.replace(one, errors=errors(joint_names(5)[::-1], 1.0))
    first, second = failing_list(even)
    assert first == "joint_4 errs most of all joints (nrms 0.200), and does throughout."
    assert second.startswith("joint_0 errs most at speeds below")
    assert first in check_self_contained(render_comparison(even, **NAMES))


def test_where_a_joint_fails_has_its_unit_and_three_digits():
    case = Failing("slide", "at speeds below 0.05 m/s", 1.67, 1.0, 0.6, 0.2, "N")
    assert "RMS 1.67 N there, 1.00 otherwise" in failing_words(case)
    assert "RMS 167 N·m there" in failing_words(dataclasses.replace(case, rms=167.0, unit="N·m"))


def test_figures_are_the_same_whatever_matplotlib_is_told():
    found = comparison(["a"], 1.0)
    usual = render_comparison(found, **NAMES)
    told = {"text.usetex": True, "font.family": "monospace", "axes.grid": True, "font.size": 30}
    with matplotlib.rc_context(told):
        assert render_comparison(found, **NAMES) == usual
        assert matplotlib.rcParams["font.size"] == 30
