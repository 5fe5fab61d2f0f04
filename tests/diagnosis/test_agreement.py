"""In how many blocks an effect lowers the error is told of each step."""

import io

import numpy as np
import pytest
from pendulum_logs import JOINTS, PENDULUM, friction, pendulum_log
from rich.console import Console

from geodrake import load_model
from geodrake.diagnosis import add, explain
from geodrake.report import page_of, show_page
from geodrake.report.json_output import explanation_dict

MODEL = load_model(PENDULUM)


@pytest.mark.parametrize(("rubbing", "share"), [(4, 1.0), (3, 0.75)])
def test_logs_without_the_effect_do_not_agree(rubbing, share):
    """Friction fitted to logs that have it makes that one worse which has none."""
    hidden = [friction((0.3, 0.2)) if i < rubbing else None for i in range(4)]
    logs = [pendulum_log(i, each, seconds=20.0) for i, each in enumerate(hidden)]
    (step,) = add("coulomb_friction", MODEL, logs, bandwidth=6.0).steps
    assert step.agreement == share


def test_only_the_joints_where_it_acts_count():
    """The elbow's error falls by more than half, whatever the shoulder's does."""

    def hidden(q, v, vd, load):
        return np.stack([-0.06 * vd[:, 0], 0.05 * np.sign(v[:, 1])], 1)

    log = pendulum_log(0, hidden, seconds=20.0)
    (step,) = add("coulomb_friction", MODEL, [log], where=["elbow"], bandwidth=6.0).steps
    assert step.rms_after["elbow"] < 0.5 * step.rms_before["elbow"]
    assert step.agreement == 1.0


@pytest.fixture(scope="module")
def moved():
    """An explanation by bodies that are wrong alone: the forearm is heavier than in the file."""

    def hidden(q, v, vd, load):
        return 0.25 * load

    return explain(MODEL, [pendulum_log(1, hidden)], bandwidth=6.0)


def test_refitted_bodies_are_judged_block_by_block(moved):
    """From the residuals that the comparisons show, before and after."""
    (step,) = moved.steps
    assert step.effect == "wrong_inertia"
    loss = {}
    for table, shown in (("before", moved.before), ("after", moved.after)):
        for series in shown.series:
            key = (table, series.block, series.joint)
            loss[key] = loss.get(key, 0.0) + float(np.square(series.residual).sum())
    blocks = {block for _, block, _ in loss}
    falls = [
        sum(loss["after", b, j] for j in JOINTS) < sum(loss["before", b, j] for j in JOINTS)
        for b in blocks
    ]
    assert step.agreement == np.mean(falls)


def test_terminal_report_and_numbers_tell_it(moved):
    console = Console(file=io.StringIO(), markup=False, highlight=False, width=160)
    page = page_of(moved)
    show_page(console, page)
    lines = console.file.getvalue().splitlines()
    assert any("wrong_inertia" in line and "100 %" in line for line in lines)
    table = page.shown_sections[0].tables[0]
    assert table.rows[-1][table.head.index("blocks better")].text == "100 %"
    assert explanation_dict(moved)["steps"][0]["agreement"] == 1.0
