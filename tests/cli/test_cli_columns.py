"""Mistakes in columns at the command line: said first, and corrected where that is asked for."""

import json
from dataclasses import replace

from commands import told
from pendulum_logs import PENDULUM
from pinocchio_logs import effort_log

from geodrake.logs.files import write_log

WORDS = "The effort of elbow has the wrong sign"


def test_a_wrong_sign_is_said_first_and_corrected_where_that_is_asked_for(tmp_path):
    log = effort_log("double_pendulum", 3, off=0.1, duration=8.0, share=0.01).log
    wrong, numbers, page = (tmp_path / name for name in ("wrong.csv", "n.json", "page.html"))
    write_log(replace(log, effort=log.effort * [1.0, -1.0]), wrong)
    said = told("compare", PENDULUM, wrong, "--json", numbers, "--report", page, "-q")
    assert said.index(WORDS) < said.index("Joint by joint")
    assert "--gain elbow=-1" in said and "--correct-columns" in said
    found = json.loads(numbers.read_text())
    (column,) = found["columns"]
    assert (column["kind"], column["joints"]) == ("effort_sign", ["elbow"])
    assert found["error"]["nrms"] > 1.0
    assert WORDS in page.read_text(encoding="utf-8")

    said = told("compare", PENDULUM, wrong, "--correct-columns", "--json", numbers, "-q")
    assert "results use the corrected columns" in said
    assert json.loads(numbers.read_text())["error"]["nrms"] < 0.3
    assert WORDS in told("log", wrong, "--model", PENDULUM, "-q")
    assert WORDS not in told("log", wrong, "-q")
