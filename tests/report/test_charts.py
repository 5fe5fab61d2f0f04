"""Charts and bars: small, true to the data, and marked where a model fails."""

import base64
import json
import re

import numpy as np
import pytest
from report_results import (
    ABOUT,
    comparison,
    diagnosis,
    errors,
    explanation,
    friction,
    joint_names,
    page,
    step,
)

from geodrake.errors import OutputError
from geodrake.identification.logs.model_errors import (
    Comparison,
    ErrorTable,
    JointError,
    Series,
    worst_windows,
)
from geodrake.report import Units, figures_of, page_of, save_figures
from geodrake.report.charts import decimated, packed
from geodrake.report.error_charts import (
    AFTER,
    BEFORE,
    MEASURED,
    effort_chart,
    joint_bars,
    residual_chart,
    worst_joints,
)

UNITS = Units()


def series(residual, joint="elbow", block="a 0.00–10.00 s"):
    time = np.linspace(0.0, 10.0, len(residual))
    zero = np.zeros(len(residual))
    return Series(joint, block, time, zero, zero, zero, residual, zero)


def unpacked(pack):
    offset, scale, text = pack
    whole = np.frombuffer(base64.b64decode(text), "<i2").astype(float)
    return np.where(whole == -32768, np.nan, offset + scale * whole)


def test_packed_values_come_back():
    for values in ([1.0, np.nan, -3.0, 2.0], [5.0, 5.0], [np.nan], []):
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
    curves[:, ::3] = np.nan  # too many gaps to show
    time, thin = decimated(time, curves, 2000)
    assert len(time) <= 2000 and np.isfinite(thin).any()


def test_the_worst_stretch_of_time_is_found():
    rng = np.random.default_rng(2)
    residual = 0.1 * rng.normal(size=1000)
    residual[300:360] += 2.0
    (worst,) = worst_windows([series(residual)])
    assert (worst.start, worst.end) == pytest.approx((3.0, 3.6), abs=0.2)
    assert worst.share > 0.9 and worst.rms > 1.0
    assert not worst_windows([series(np.ones(1000))])
    assert not worst_windows([series(np.zeros(1000)), series(np.empty(0))])
    assert len(worst_windows([series(residual), series(residual)], most=1)) == 1


def test_a_chart_holds_what_was_measured_and_left():
    joints = joint_names(2)
    before, after = comparison(joints, 1.0), comparison(joints, 0.2)
    panel = json.loads(effort_chart({BEFORE: before, AFTER: after}, UNITS).data)["panels"][1]
    assert panel["title"] == joints[1]
    own = [s for s in before.series if s.joint == joints[1]]
    efforts, residuals = (plot["curves"] for plot in panel["plots"])
    assert efforts[AFTER.key] is None  # the page has the measured effort and the residual
    for values, name in ((efforts[MEASURED.key], "measured"), (residuals[BEFORE.key], "residual")):
        found = unpacked(values)
        expected = np.concatenate([getattr(s, name) for s in own])
        np.testing.assert_allclose(found[np.isfinite(found)], expected, atol=2e-4)
    assert len(np.frombuffer(base64.b64decode(panel["time"]), "<f4")) == len(found)


def test_residuals_are_drawn_over_the_motion():
    one = comparison(("elbow",), 1.0)
    (panel,) = residual_chart({BEFORE: one}, UNITS).panels
    assert [plot.axis for plot in panel.plots] == [
        *("velocity, rad/s", "position, rad", "load (predicted effort), N·m")
    ]
    for plot, name in zip(panel.plots, ("velocity", "position", "predicted"), strict=True):
        (curve,), (trend,) = plot.curves.values(), plot.trends.values()
        values = np.concatenate([getattr(s, name) for s in one.series])
        residual = np.concatenate([s.residual for s in one.series])
        order = np.argsort(values)
        np.testing.assert_array_equal(plot.over, values[order])
        np.testing.assert_array_equal(curve, residual[order])
        bins = np.array_split(residual[order], len(trend.mean))
        np.testing.assert_allclose(trend.mean, [b.mean() for b in bins])
        np.testing.assert_allclose(trend.rms, [np.sqrt((b**2).mean()) for b in bins])


def test_the_worst_joints_are_named_and_shown():
    """One of nine joints errs most; two hardly move, so that their error has no scale."""
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
    chart = effort_chart({BEFORE: Comparison(table, (), one.series, ())}, UNITS)
    assert [panel.title for panel in chart.panels] == list(joints)
    assert next(panel for panel in chart.panels if panel.title == joints[6]).shown
    assert sum(panel.shown for panel in chart.panels) == 8
    assert any("worst joint" in panel.badge for panel in chart.panels if panel.shown)


def test_steps_can_be_chosen_where_their_predictions_are_known():
    joints = joint_names(2)
    between = comparison(joints, 0.5).series
    steps = (step("payload", ("hand",), {}, {}, joints=joints, series=between), friction(joints))
    html = page(explanation(joints, steps))
    assert re.findall(r'data-stage="(after \d: .*) \(line\)" aria-pressed="(\w+)"', html) == [
        ("after 1: + payload", "false")
    ]


def test_undefined_errors_have_empty_bars():
    for rms, text in ((np.nan, "–"), (np.inf, "–"), (0.0, "0")):
        joints = joint_names(2)
        then = dict(zip(joints, (rms, 0.1), strict=True))
        bars = joint_bars(errors(joints, 0.5), [("then", then)])
        assert np.isfinite([bars.end(x) for row in bars.rows for x in row.bars.values()]).all()
        _, last = bars.rows[0].bars.values()
        assert bars.rows[0].text(last) == text


def test_figures_have_the_right_axes():
    joints = joint_names(3)
    figures = figures_of(page_of(explanation(joints), ABOUT))
    axes = {name: len(figure.axes) for name, figure in figures.items()}
    assert axes == {"steps": 1, "joint_errors": 1, "efforts": 6, "residuals": 9}
    assert len(figures["joint_errors"].axes[0].patches) == 2 * len(joints)
    labels = [label.get_text() for label in figures["steps"].axes[0].get_yticklabels()]
    assert labels[-1] == "+ Coulomb friction, all 3 joints"
    assert len(figures_of(page_of(diagnosis(joints), ABOUT))["candidates"].axes[0].patches) == 3


def test_figures_are_saved(tmp_path):
    figures = figures_of(page_of(comparison(("elbow",), 1.0), ABOUT))
    paths = save_figures(figures, tmp_path / "new")
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == sorted(p.name for p in paths)
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in paths)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file cannot be created"):
        save_figures(figures, tmp_path / "file")
