"""Pages are complete, self-contained, and safe for any names of joints."""

import dataclasses
import math
import re
from html import unescape
from html.parser import HTMLParser

import numpy as np
import pytest
from report_results import (
    comparison,
    diagnosis,
    errors,
    explanation,
    friction,
    joint_names,
    page,
    step,
)

from geodrake.errors import ArgumentError
from geodrake.identification.logs.model_errors import ErrorTable, Failing, JointError
from geodrake.identification.models import BodyChange
from geodrake.report import Units, page_of
from geodrake.report.explaining import (
    Explained,
    errors_table,
    failing_table,
    parameters_table,
    steps_table,
)
from geodrake.report.json_output import NoNumber
from geodrake.report.numbers import chance, is_noticed, number, percent, shortened, with_deviation
from geodrake.report.page import Cell
from geodrake.report.views import numbers_of
from geodrake.report.words import effect_label, listed, places_label

EVIL = "<script>alert('$x_{1')</script>&\"$"


class Reader(HTMLParser):
    """A parser that collects text, tags and sources, and checks that tags close in order."""

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
    read = Reader(html)
    assert not read.open
    assert not re.search(r"@import|url\((?!#)", html)
    assert not {"link", "iframe", "object"} & set(read.tags)
    assert all(source.startswith(("data:image/png;base64,", "#")) for source in read.sources)
    assert "default-src 'none'" in html
    assert len(html) < 1_000_000
    return " ".join("".join(read.text).replace("\N{NO-BREAK SPACE}", " ").split())


def test_pages_contain_all_joints_and_findings():
    joints = joint_names(6)
    texts = [
        check_self_contained(page(result))
        for result in (explanation(joints), diagnosis(joints), comparison(joints, 1.0))
    ]
    for text in texts:
        assert all(re.search(rf"\b{joint}\b", text) for joint in joints)
        for words in (
            "arm.urdf against a.csv, b.csv",
            "at speeds below 0.05 rad/s",
            "geodrake",
            "How errors were measured",
        ):
            assert words in text
    for words in (
        *("Missing Coulomb friction (all 6 joints)", "Explained in part, nrms", "3.084 ± 0.012"),
        *("Coulomb, N·m", "75 %", "Stribeck friction", "< 10⁻⁶", "a: bandwidth 4 Hz"),
    ):
        assert words in texts[0]


def test_doubtful_findings_say_what_is_more_likely():
    joints = joint_names(1)
    alone = dataclasses.replace(friction(joints), rivals=(), unknown_probability=0.1)
    likely, doubtful = (
        page_of(explanation(joints, (each,))).facts
        for each in (alone, dataclasses.replace(alone, unknown_probability=0.62))
    )
    assert likely["Missing"] and not likely["Less certain"] and not doubtful["Missing"]
    assert (
        doubtful["Less certain"]
        == "Coulomb friction (joint_0), 38 % (something unknown is more likely)"
    )


def test_bodies_are_shown_before_and_after():
    com = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])
    body = BodyChange("hand", (2.0, 2.5), com, 0.1, np.full(3, 0.002), False, 0.4)
    found = explanation(joint_names(2))
    html = page(dataclasses.replace(found, bodies=(body,)))
    assert "Bodies" in html and "2.50 ± 0.10" in check_self_contained(html)
    assert "Bodies" not in check_self_contained(page(found))


def test_names_are_escaped():
    joints = (EVIL, "elbow")
    shown = dataclasses.replace(explanation(joints), notes=("<b>note</b>",))
    for html in (
        page(shown, model=EVIL, logs=("<img src=x>",)),
        page(diagnosis(joints)),
        page(comparison(joints, 1.0)),
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
    text = check_self_contained(page(shown))  # draws such names, too
    for words in ("wrong inertia", "delay, ms", "16.2", "the whole robot", "my hose", "1.5"):
        assert words in text
    for words in ("3.00 ± 0.10", "CoM x, m", "mass, kg", "0.033", "1.25"):
        assert words in text
    assert "nan" not in text


def test_verdicts_without_steps():
    for verdict, words in (
        ("adequate", "Adequate. No effect is worth adding."),
        ("unexplained", "Unexplained. No known effect explains"),
    ):
        text = check_self_contained(page(explanation(joint_names(2), (), verdict=verdict)))
        assert words in text
        assert "Parameters" not in text


def test_a_diagnosis_names_ties_or_nothing():
    joints = joint_names(3)
    text = unescape(check_self_contained(page(diagnosis(joints), saved="my arm.yaml")))
    assert "Coulomb friction + viscous friction (all 3 joints) are missing." in text
    assert "Alternatives asymmetric friction" in text
    command = "geodrake excite 'my arm.yaml' --tell-apart coulomb_friction,asymmetric_friction"
    assert f"{command} --save motion_1.csv" in text
    text = check_self_contained(page(diagnosis(joints, candidates=False)))
    assert "No known effect explains" in text


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
    html = page(perfect)
    check_self_contained(html)
    assert "the logs show none" in html and "the logs show none" not in page(one)


def test_units_of_prismatic_joints():
    shown = explanation(("slide", "elbow"), prismatic=("slide",))
    text = check_self_contained(page(shown))
    assert "3.084 ± 0.012 N " in text
    assert "3.084 ± 0.012 N·m" in text
    units = Units.of(shown.model)
    assert units.effort(["slide"]) == "N"
    assert units.effort(["slide", "elbow"]) == "N·m or N"
    assert units.parameter("viscous_friction", "viscous", "slide") == "N·s/m"
    assert units.parameter("rotor_inertia", "inertia", "slide") == "kg"
    assert units.parameter("load_dependent_friction", "load_factor", "elbow") == ""


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


def test_a_second_deviation_is_shown_unless_it_is_small():
    joints = joint_names(2)
    for systematic, text in (
        (0.0035, "3.084 ± 0.012"),
        (0.0037, "3.084 ± 0.012 ± 0.004"),
        (0.1542, "3.084 ± 0.012 ± 0.154"),
        (math.nan, "3.084 ± 0.012"),
    ):
        assert with_deviation(3.0839, 0.0121, systematic) == text
        assert with_deviation(3.0839, math.nan, systematic) == "3.08"
        assert is_noticed(0.0121, systematic) == (text.count("±") == 2)
        own = {joint: {"coulomb": systematic} for joint in joints}
        found = explanation(joints, (dataclasses.replace(friction(joints), systematic=own),))
        told = "A second ± is from uncertain effort gains" in check_self_contained(page(found))
        assert told == (text.count("±") == 2)


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
    words = [listed(list(names), "or") for names in ("a", "ab", "abc")]
    assert words == ["a", "a or b", "a, b or c"]
    assert places_label(("a", "b"), ("a", "b")) == "a and b"
    assert places_label(("a", "b", "d", "e"), tuple("abcde"), most=3) == "4 of 5 joints"


def test_many_places_are_counted_without_those_of_a_base():
    joints = joint_names(30)
    found = explanation(joints, [friction(joints[:20])])
    for base, words in ((0, "20 of 30 joints"), (6, "20 of 24 joints"), (10, "all 20 joints")):
        units = Units(joints, base=frozenset(joints[30 - base :]))
        assert steps_table(found, units).rows[-1][1].text == words
    assert [row[0].text for row in parameters_table(found.steps[0], units).rows] == list(
        joints[:20]
    )


def test_without_a_noise_floor_nothing_is_removable():
    found = comparison(joint_names(3), 0.5)
    quiet = tuple(dataclasses.replace(joint, floor=0.0) for joint in found.errors.joints)
    found = dataclasses.replace(found, errors=ErrorTable(quiet))
    html = page(found)
    assert "the logs show none" in html
    assert "100\N{NO-BREAK SPACE}%" not in html
    assert "the logs show no noise" in html
    *_, nrms, noise, removable = errors_table({"RMS": found.errors}, Units()).rows[0]
    assert (noise.text, removable) == ("–", Cell("–"))
    assert nrms.text != "–"
    written = numbers_of(found)
    assert written["joints"]["joint_0"]["removable"] == NoNumber("the logs show no sensor noise")


def test_a_useless_added_effect_is_reported():
    joints = joint_names(3)
    useless = step("joint_spring", joints, {}, {}, error_before=0.565, error_after=0.569)
    added = explanation(joints, (useless,))
    added = dataclasses.replace(added, end=errors(joints, 1.01))
    answer = page_of(Explained.of(added, added=True)).answer
    assert answer["Did not help"] == "joint spring (nrms 0.565 → 0.569)"
    assert answer["Effect"] == "joint spring (all 3 joints)"
    text = page(added)
    assert "explained none of the squared error" in " ".join(Reader(text).text)
    assert "xplained in part" not in text


def test_the_worst_joint_is_named_if_it_fails_throughout():
    """The first of five joints fails at some speeds, and the last errs most."""
    one = comparison(joint_names(5), 1.0)
    even = dataclasses.replace(one, errors=errors(joint_names(5)[::-1], 1.0))
    first, second = ([cell.text for cell in row] for row in failing_table(even).rows)
    assert first[:2] == ["joint_4", "throughout: nrms 0.200"]
    assert second[0] == "joint_0" and second[1].startswith("at speeds below")
    assert "throughout: nrms 0.200" in check_self_contained(page(even))


def test_failures_of_joints_have_a_unit_and_three_digits():
    for rms, unit, words in ((1.67, "N", "1.67 N"), (167.0, "N·m", "167 N·m")):
        case = Failing("slide", "at speeds below 0.05 m/s", rms, 1.0, 0.6, 0.2, unit)
        found = dataclasses.replace(comparison(("slide",), 1.0), failing=(case,))
        ((_, where, there, elsewhere, *shares),) = failing_table(found).rows
        assert (where.text, there.text, elsewhere.text) == (
            case.circumstance,
            words,
            f"1.00 {unit}",
        )
        assert [cell.text for cell in shares] == ["60 %", "20 %"]


def test_the_remaining_error_is_described_by_its_size():
    joints = joint_names(2)
    for share, mark in ((0.02, "Explained to practical noise, "), (0.5, "Explained in part, ")):
        found = dataclasses.replace(explanation(joints), end=errors(joints, share))
        assert page_of(found).headline.startswith(mark)
    for share, words in ((0.3, "positions and velocities, 30 % at joint_0"), (0.01, "neither")):
        told = dataclasses.replace(explanation(joints), of_motion={"joint_0": share})
        assert page_of(told).answer["Depends on"].startswith(words)


def test_links_lead_to_pages_and_run_nothing():
    for address in ("../a b.html", "https://example.org/x"):
        html = page(comparison(("a",), 1.0), links={"On the robot": address})
        assert f'<a href="{address}">On the robot</a>' in html
    for address in ("data:text/html,x", "JavaScript:x"):
        with pytest.raises(ArgumentError, match="points to"):
            page(comparison(("a",), 1.0), links={"Click": address})
