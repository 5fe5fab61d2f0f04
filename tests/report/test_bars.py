"""Bars of a page: as long as their numbers, complete, and drawn without matplotlib."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from report_results import comparison, diagnosis, errors, explanation, friction, joint_names

from geodrake.report import render_comparison, render_explanation
from geodrake.report.bars import candidate_bars, joint_bars, step_bars, step_joint_bars
from geodrake.report.numbers import number
from geodrake.report.static_plot import round_values


def ends(bars):
    return [[bar.end for bar in row.bars] for row in bars.rows]


def test_equal_ratios_are_equal_lengths():
    table = errors(joint_names(3), 0.5)  # RMS 0.5, 1.0, 1.5; deviations 5, 10, 15
    halved = [0.5 * joint.rms for joint in table.joints]
    bars = joint_bars(table, [("half", halved), ("a quarter", [0.5 * x for x in halved])])
    lengths = np.array(ends(bars))
    np.testing.assert_allclose(np.diff(lengths, n=2), 0.0, atol=1e-12)
    assert (np.diff(lengths) < 0).all()
    assert lengths.min() > 0.0 and lengths.max() < 1.0
    assert [bar.text for bar in bars.rows[0].bars] == [number(0.1 * 0.5**k) for k in range(3)]
    assert [color.label for color in bars.legend] == [
        *("as it stands", "half", "a quarter"),
        "sensor noise",
    ]


def test_noise_is_where_an_error_as_large_would_end():
    (joint,) = errors(joint_names(1), 0.5).joints
    table = replace(errors(joint_names(1), 0.5), joints=(replace(joint, floor=0.25),))
    (row,) = joint_bars(table, [("at the noise", [0.25])]).rows
    assert row.marks[0].end == row.bars[1].end


@pytest.mark.parametrize("rms", [np.nan, np.inf, 0.0])
def test_errors_that_are_none_have_bars_of_nothing(rms):
    table = errors(joint_names(2), 0.5)
    bars = joint_bars(table, [("then", [rms, 0.1])])
    assert np.isfinite(ends(bars)).all()
    assert bars.rows[0].bars[1].text == ("0" if rms == 0.0 else "–")


def test_of_many_joints_the_worst_are_shown():
    bars = joint_bars(errors(joint_names(30), 0.5))
    assert len(bars.rows) == 8
    assert bars.note == "The 8 joints of largest nrms, of 30."


def test_steps_fall():
    joints = joint_names(2)
    found = explanation(joints, [friction(joints)])
    bars = step_bars(found)
    assert [row.label for row in bars.rows][:2] == [
        "the model as it stands",
        "its own parameters refitted",
    ]
    assert len(bars.rows) == 2 + len(found.steps)
    texts = [row.bars[0].text for row in bars.rows]
    assert texts[0] == number(found.start.nrms)
    assert texts[2:] == [number(step.error_after) for step in found.steps]
    assert len(step_joint_bars(found).rows[0].bars) == 1 + len(found.steps)


def test_candidates_are_as_long_as_their_errors():
    found = diagnosis(joint_names(2))
    bars = candidate_bars(found)
    lengths = np.array([row.bars[0].end for row in bars.rows])
    left = np.array([candidate.error_after for candidate in found.candidates])[: len(lengths)]
    np.testing.assert_allclose(lengths / lengths[0], left / left[0])
    assert bars.rows[0].bars[0].color.label == "chosen"
    assert lengths.max() <= 1.0


@pytest.mark.parametrize(
    ("low", "high", "most", "values"),
    [
        (0.0, 10.0, 5, [0, 2, 4, 6, 8, 10]),
        (-0.13, 0.13, 4, [-0.2, -0.1, 0.0, 0.1, 0.2]),
        (3.0, 3.0, 4, [3.0]),
        (0.3, 0.9, 3, [0.2, 0.4, 0.6, 0.8, 1.0]),
    ],
)
def test_numbers_beside_an_axis_are_round(low, high, most, values):
    found = round_values(low, high, most)
    np.testing.assert_allclose(found, values, atol=1e-12)


@pytest.mark.thorough
def test_pages_need_no_matplotlib():
    code = (
        "import sys; from geodrake.report import render_explained, render_comparison;"
        "assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_pages_have_their_bars():
    joints = joint_names(2)
    names = {"title": "t", "model_name": "m", "log_names": ["l"]}
    compared = render_comparison(comparison(joints, 0.2), **names)
    explained = render_explanation(explanation(joints, [friction(joints)]), **names)
    assert compared.count('<figure class="bars"') == 1
    assert explained.count('<figure class="bars"') == 2
