"""Mistakes in columns at the command line: said first, and corrected where that is asked for."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from pinocchio_logs import effort_log
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.logs.files import write_log

MODEL = Path(__file__).parents[2] / "models" / "double_pendulum.urdf"


@pytest.fixture(scope="module")
def wrong(tmp_path_factory):
    log = effort_log("double_pendulum", 3, off=0.1, duration=8.0, share=0.01).log
    effort = log.effort.copy()
    effort[:, 1] *= -1.0
    path = tmp_path_factory.mktemp("wrong") / "wrong.csv"
    write_log(replace(log, effort=effort), path)
    return path


def geodrake(*arguments):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return result.output


def test_compare_says_it_first_and_goes_on_as_it_is(wrong, tmp_path):
    numbers, page = tmp_path / "numbers.json", tmp_path / "page.html"
    told = geodrake("compare", MODEL, wrong, "--json", numbers, "--report", page, "-q")
    words = "The effort of elbow has the wrong sign"
    assert told.index(words) < told.index("Joint by joint")
    assert "--gain elbow=-1" in told
    assert "--correct-columns" in told
    found = json.loads(numbers.read_text())
    (column,) = found["columns"]
    assert (column["kind"], column["joints"]) == ("effort_sign", ["elbow"])
    assert found["error"]["nrms"] > 1.0
    assert words in page.read_text(encoding="utf-8")


def test_corrected_columns_are_what_the_rest_works_on(wrong, tmp_path):
    numbers = tmp_path / "numbers.json"
    told = geodrake("compare", MODEL, wrong, "--correct-columns", "--json", numbers, "-q")
    assert "goes on with these columns corrected" in told
    assert json.loads(numbers.read_text())["error"]["nrms"] < 0.3


def test_log_says_it_if_there_is_a_model(wrong):
    words = "The effort of elbow has the wrong sign"
    assert words in geodrake("log", wrong, "--model", MODEL, "-q")
    assert words not in geodrake("log", wrong, "-q")
