"""Plots over time: small, true to the data, and with the stretches in which a model fails."""

import base64
import json
import re

import numpy as np
import pytest
from report_results import NAMES, comparison, explanation, friction, joint_names, step

from geodrake.errors import ArgumentError
from geodrake.identification.logs.model_errors import Comparison, ErrorTable, JointError, Series
from geodrake.identification.logs.worst_windows import worst_windows
from geodrake.report import render_comparison, render_explanation
from geodrake.report.curves import decimated, gap_filled, packed
from geodrake.report.effort_chart import effort_chart
from geodrake.report.worst_joints import worst_joints


def series(residual, joint="elbow", block="a 0.00–10.00 s"):
    time = np.linspace(0.0, 10.0, len(residual))
    zero = np.zeros(len(residual))
    return Series(joint, block, time, zero, zero, zero, residual, zero)


def unpacked(pack):
    offset, scale, text = pack
    whole = np.frombuffer(base64.b64decode(text), "<i2").astype(float)
    return np.where(whole == -32768, np.nan, offset + scale * whole)


@pytest.mark.parametrize("values", [[1.0, np.nan, -3.0, 2.0], [5.0, 5.0], [np.nan], []])
def test_packed_values_come_back(values):
    np.testing.assert_allclose(unpacked(packed(np.array(values))), values, atol=5e-5)


def test_decimated_curves_keep_their_extremes_and_gaps():
    rng = np.random.default_rng(1)
    time, curves = np.arange(50_000.0), rng.normal(size=(3, 50_000))
    curves[1, 31_000], curves[2, 7] = 40.0, -60.0
    curves[:, 20_000] = np.nan
    thin_time, thin = decimated(time, curves, 2000)
    assert 1500 < len(thin_time) <= 2000
    assert (np.diff(thin_time) > 0).all()
    assert np.isnan(thin).all(0).sum() == 1
    np.testing.assert_array_equal(np.nanmax(thin, 1), np.nanmax(curves, 1))
    np.testing.assert_array_equal(np.nanmin(thin, 1), np.nanmin(curves, 1))
    at = thin_time[np.argmax(thin[1] == 40.0)]
    assert abs(at - 31_000) < 100
    same = decimated(time[:100], curves[:, :100], 2000)
    np.testing.assert_array_equal(same[1], curves[:, :100])


def test_many_gaps_do_not_make_many_points():
    curves = np.sin(np.arange(30_000.0))[None].copy()
    curves[:, ::3] = np.nan
    time, thin = decimated(np.arange(30_000.0), curves, 2000)
    assert len(time) <= 2000 and np.isfinite(thin).all()


def test_gaps_have_an_instant():
    np.testing.assert_array_equal(gap_filled(np.array([0, 1, np.nan, 5])), [0, 1, 3, 5])
    assert len(gap_filled(np.array([np.nan]))) == 0


def test_the_worst_stretch_of_time_is_found():
    rng = np.random.default_rng(2)
    residual = 0.1 * rng.normal(size=1000)
    residual[300:360] += 2.0
    (worst,) = worst_windows([series(residual)])
    assert worst.start == pytest.approx(3.0, abs=0.2)
    assert worst.end == pytest.approx(3.6, abs=0.2)
    assert worst.share > 0.9 and worst.rms > 1.0
    assert not worst_windows([series(np.ones(1000))])
    assert not worst_windows([series(np.zeros(1000)), series(np.empty(0))])
    assert len(worst_windows([series(residual), series(residual)], most=1)) == 1


def test_a_chart_holds_what_was_measured_and_left():
    joints = joint_names(2)
    before, after = comparison(joints, 1.0), comparison(joints, 0.2)
    chart = effort_chart(before, after)
    panel = json.loads(chart.data)["panels"][1]
    assert panel["title"] == joints[1]
    own = [s for s in before.series if s.joint == joints[1]]
    efforts, residuals = (plot["curves"] for plot in panel["plots"])
    assert efforts["after"] is None  # the page has the measured effort and the residual
    for values, name in ((efforts["measured"], "measured"), (residuals["before"], "residual")):
        found = unpacked(values)
        expected = np.concatenate([getattr(s, name) for s in own])
        np.testing.assert_allclose(found[np.isfinite(found)], expected, atol=2e-4)
    assert len(np.frombuffer(base64.b64decode(panel["time"]), "<f4")) == len(found)


def test_the_worst_joints_are_named_and_shown():
    """One of nine joints errs most, and two that hardly move have no error over std."""
    joints = joint_names(9)
    table = ErrorTable(
        tuple(
            JointError(j, 0.1 + (i == 6), 2.0 if i < 7 else 1e-9, 0.0) for i, j in enumerate(joints)
        )
    )
    assert joints[6] in worst_joints(table)
    unknown = ErrorTable((*table.joints[:8], JointError(joints[8], np.nan, 1.0, 0.0)))
    assert joints[8] in worst_joints(unknown)
    one = comparison(joints, 1.0)
    chart = effort_chart(Comparison(table, (), one.series, ()))
    assert [panel.title for panel in chart.panels] == list(joints)
    assert next(panel for panel in chart.panels if panel.title == joints[6]).shown
    assert sum(panel.shown for panel in chart.panels) == 8
    assert any("worst joint" in panel.badge for panel in chart.panels if panel.shown)


def test_steps_can_be_chosen_where_their_predictions_are_known():
    joints = joint_names(2)
    between = comparison(joints, 0.5).series
    steps = (step("payload", ("hand",), {}, {}, joints=joints, series=between), friction(joints))
    html = render_explanation(explanation(joints, steps), **NAMES)
    assert re.findall(r'data-stage="(step\d)" aria-pressed="(\w+)"', html) == [("step1", "false")]
    assert "after 1: + payload" in html


@pytest.mark.parametrize("address", ["replay.html", "../a b.html", "https://example.org/x"])
def test_links_lead_to_pages(address):
    html = render_comparison(comparison(("a",), 1.0), **NAMES, links={"On the robot": address})
    assert f'<a href="{address}">On the robot</a>' in html


@pytest.mark.parametrize("address", ["javascript:alert(1)", "data:text/html,x", "JavaScript:x"])
def test_links_to_scripts_are_refused(address):
    with pytest.raises(ArgumentError, match="leads to"):
        render_comparison(comparison(("a",), 1.0), **NAMES, links={"Click": address})
