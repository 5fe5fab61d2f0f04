"""`geodrake fleet`: what is said and written, and exit codes that a cron job understands."""

import json
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from processes import limited
from pyarrow import parquet
from small_fleet import FROM, HEAVY, LOGS, STICKY, DayOf, date_of, write_file, write_fleet
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.errors import DigestError, FleetError
from geodrake.fleet.fleet_logs import FleetDigests
from geodrake.fleet.fleet_result import ChangedParameter, FleetFinding, FleetResult, RobotResult
from geodrake.logs.files import write_log

STEADY = "first"
THREE = (STEADY, HEAVY, STICKY)


@pytest.fixture(scope="module")
def there(tmp_path_factory):
    """A fleet whose digests are made."""
    folder = tmp_path_factory.mktemp("fleet")
    write_fleet(folder, robots=THREE)
    words = ["fleet", str(folder / "fleet.yaml"), "-q", "--workers", "0"]
    assert CliRunner().invoke(app, words).exit_code == 0
    return folder


@pytest.fixture
def folder(there, tmp_path, monkeypatch):
    shutil.copytree(there, tmp_path, dirs_exist_ok=True)
    write_file(tmp_path, THREE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def fleet(words="", file="fleet.yaml"):
    result = CliRunner().invoke(app, ["fleet", file, "--workers", "0", "-q", *words.split()])
    return result.exit_code, result.stdout, result.stderr


def test_findings_are_said_and_written(folder):
    code, out, err = fleet("--json new.json")
    assert (code, err) == (0, "")
    assert "2 of 3 robots changed." in out
    assert "payload" in out
    text = Path("new.json").read_text(encoding="utf-8")
    assert text == Path("results/fleet.json").read_text(encoding="utf-8")
    numbers = json.loads(text)
    assert numbers["counts"] == {"changed": 2, "steady": 1, "no logs": 0}
    rows = parquet.read_table("results/findings.parquet").to_pylist()
    assert {row["robot"] for row in rows} == {HEAVY, STICKY}
    assert {str(row["since"].date()) for row in rows} == {date_of(FROM)}
    for finding in numbers["findings"]:
        own = [row for row in rows if row["robot"] == finding["robot"]]
        assert {row["parameter"]: row["change"] for row in own} == {
            name: each["change"] for name, each in finding["parameters"].items()
        }
    times = parquet.read_table("results/parameters.parquet").to_pylist()
    assert len(times) == 3 * LOGS * len(numbers["robots"][0]["parameters"])
    assert parquet.read_table("results/unused_logs.parquet").num_rows == 0


def test_the_page_has_robots_joints_and_changes(folder):
    code, out, _ = fleet("--report page.html")
    assert code == 0
    assert "Saved the report: page.html" in out
    page = Path("page.html").read_text(encoding="utf-8")
    assert "2 of 3 robots changed." in page
    for section in ("The fleet at a glance", "What changed", *(HEAVY, STICKY)):
        assert f"<h2>{section}</h2>" in page
    assert f"<h2>{STEADY}</h2>" not in page
    charts = [json.loads(each) for each in re.findall(r"json\">(.*?)</script>", page)]
    assert [chart["unit"] for chart in charts] == ["days"] * 2
    first = charts[1]["panels"][0]  # the joint that changed comes first
    assert first["title"] == "elbow"
    (shade,) = first["shades"]
    assert shade[1:] == [FROM - 1, FROM]  # after the log before, up to the first that shows it
    assert len(first["plots"]) == 4


@pytest.mark.thorough
def test_a_finding_is_new_once(folder):
    code, out, _ = fleet("--once")
    assert code == 3
    lines = [json.loads(line)["finding"] for line in out.splitlines()]
    assert {line["robot"]: line["where"] for line in lines} == {
        HEAVY: "lower_link",
        STICKY: "elbow",
    }
    assert fleet("--once")[:2] == (0, "")
    write_log(DayOf(HEAVY, LOGS).log(), folder / HEAVY / f"{date_of(LOGS)}.csv")
    assert fleet("--once")[:2] == (0, "")  # the same finding with another log
    numbers = json.loads(Path("results/fleet.json").read_text(encoding="utf-8"))
    assert {robot["robot"]: robot["logs"] for robot in numbers["robots"]} == {
        HEAVY: LOGS + 1,
        STEADY: LOGS,
        STICKY: LOGS,
    }


@pytest.mark.thorough
def test_a_watch_takes_in_logs_as_they_come(folder):
    hidden = folder / "later"
    hidden.mkdir()
    for day in range(FROM, LOGS):
        (folder / STICKY / f"{date_of(day)}.csv").rename(hidden / f"{date_of(day)}.csv")
    shutil.rmtree(folder / "results" / "pendulum" / "logs")  # as if it had never been there
    words = ["fleet", "fleet.yaml", "--watch", "--every", "0.1", "--workers", "0", "-q"]
    run = subprocess.Popen(
        [sys.executable, "-m", "geodrake", *words], stdout=subprocess.PIPE, text=True
    )
    limited(run, 40)  # a line that never comes is no reason to wait
    try:
        first = json.loads(run.stdout.readline())["finding"]
        assert (first["robot"], first["effect"]) == (HEAVY, "payload")
        for path in sorted(hidden.iterdir()):
            path.rename(folder / STICKY / path.name)
        second = json.loads(run.stdout.readline())["finding"]
        assert second["robot"] == STICKY
        while not Path("results/told_findings.json").exists() and run.poll() is None:
            time.sleep(0.01)
    finally:
        run.terminate()
        run.communicate()
    assert run.returncode == 128 + 15


def test_once_exits_with_3_if_a_finding_is_new(folder, monkeypatch):
    finding = FleetFinding(
        *(STICKY, "coulomb_friction", "elbow", "step", 1.78e9, (1.78e9, 1.781e9)),
        (ChangedParameter("force", "N·m", 0.1, 0.01, 0.5),),
        *(0.9, (), 1e-4),
    )
    robot = RobotResult(STICKY, "pendulum", 8, np.array([1.77e9, 1.79e9]), (finding,))
    digests, result = FleetDigests({}, (), {}, 0), FleetResult((robot,), (), 0.01, {})
    monkeypatch.setattr("geodrake.cli.fleet.look_at_fleet", lambda *given, **how: (result, digests))
    code, out, _ = fleet("--once")
    (line,) = map(json.loads, out.splitlines())
    assert (code, line["finding"]["robot"], line["finding"]["where"]) == (3, STICKY, "elbow")
    assert fleet("--once") == (0, "", "")


def test_a_watch_goes_on_when_a_place_does_not_answer(folder, monkeypatch):
    looks = []

    def take_in(*given, **how):
        looks.append(len(looks))
        if looks[-1] == 1:
            raise FleetError("Logs 's3://x' cannot be looked for: TimeoutError.")
        if looks[-1] == 2:
            raise DigestError("There are digests of something else.")
        return FleetResult((), (), 0.01, {}), FleetDigests({}, (), {}, 0)

    monkeypatch.setattr("geodrake.cli.fleet.look_at_fleet", take_in)
    code, out, err = fleet("--watch --every 0.1")
    assert (code, out, looks) == (2, "", [0, 1, 2])
    assert err.splitlines() == [
        "Logs 's3://x' cannot be looked for: TimeoutError. It is tried again in 0.1 s.",
        "Error: There are digests of something else.",
    ]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--workers -1", "workers must be"),
        ("--false-alarms 0", "false_alarms must be"),
        ("--false-alarms nan", "false_alarms must be"),
        ("--every 0 --watch", "--every must be"),
        ("--watch --once", "Leave one of them out"),
        ("--once --json -", "Name a file"),
        ("--json fleet.yaml", "--json"),
        ("--report x.txt", "--report"),
        ("--scheduler nowhere", "The scheduler nowhere cannot be reached"),
    ],
)
def test_options_that_are_wrong(folder, words, says, monkeypatch):
    monkeypatch.setattr("geodrake.fleet.workers._SECONDS", 0.5)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    code, out, err = fleet(words)
    assert (code, out) == (2, "")
    assert says in err
    assert len(err.strip().splitlines()) == 1
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


def test_files_that_are_wrong_are_one_line(folder):
    for file, says in (("none.yaml", "none.yaml"), (HEAVY, HEAVY)):
        code, out, err = fleet(file=file)
        assert (code, out) == (2, "")
        assert says in err
        assert len(err.strip().splitlines()) == 1
