"""`geodrake fleet`: output, files, and exit codes for a cron job."""

import json
import re
import shutil
from pathlib import Path
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest
from commands import contents, refused, run
from pyarrow import parquet
from small_fleet import FROM, HEAVY, LOGS, STICKY, date_of, write_file, write_fleet

from geodrake.errors import DigestError, FleetError
from geodrake.fleet import FleetFinding, FleetResult
from geodrake.fleet.fleet_logs import FleetDigests
from geodrake.fleet.fleet_result import ChangedParameter, RobotResult

STEADY = "first"
THREE = (STEADY, HEAVY, STICKY)


@pytest.fixture(scope="module")
def there(tmp_path_factory):
    """Return the folder of a fleet with its digests."""
    folder = tmp_path_factory.mktemp("fleet")
    write_fleet(folder, robots=THREE)
    assert run("fleet", folder / "fleet.yaml", "-q", "--workers", "0").exit_code == 0
    return folder


@pytest.fixture
def folder(there, working_folder):
    shutil.copytree(there, working_folder, dirs_exist_ok=True)
    write_file(working_folder, THREE)
    return working_folder


def fleet(words="", file="fleet.yaml"):
    result = run("fleet", file, "--workers", "0", "-q", *words.split())
    return result.exit_code, result.stdout, result.stderr


def test_findings_are_printed_and_written(folder):
    first = folder / STICKY / f"{date_of(0)}.csv"
    shutil.copy(first, first.with_name(f"{date_of(1)}\udcff.csv"))
    code, out, err = fleet("--json new.json --report page.html")
    assert (code, err) == (0, "")
    assert "2 of 3 robots changed; 1 log not used." in out and "payload" in out
    assert "Saved the report: page.html" in out
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
    (unused,) = parquet.read_table("results/unused_logs.parquet").to_pylist()
    assert unused["log"].endswith(rf"{date_of(1)}\udcff.csv") and "not UTF-8" in unused["reason"]
    assert msgspec.json.decode(text)["unused"][0]["log"] == unused["log"]

    page = Path("page.html").read_text(encoding="utf-8")
    assert "2 of 3 robots changed; 1 log not used." in page
    for section in ("Overview", "What changed", *(HEAVY, STICKY)):
        assert f"<h2>{section}</h2>" in page
    assert f"<h2>{STEADY}</h2>" not in page
    charts = [json.loads(each) for each in re.findall(r"json\">(.*?)</script>", page)]
    assert [chart["unit"] for chart in charts] == ["days"] * 2
    first = charts[1]["panels"][0]  # the joint that changed comes first
    assert first["title"] == "elbow"
    (shade,) = first["shades"]
    assert shade[1:] == [FROM - 1, FROM]  # after the log before, up to the first that shows it
    assert len(first["plots"]) == 4


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


def test_a_watch_continues_when_a_store_does_not_answer(folder, monkeypatch):
    found = FleetResult((), (), 0.01, {}), FleetDigests({}, (), {}, 0)
    silent = FleetError("Logs 's3://x' cannot be listed: TimeoutError.")
    look = Mock(side_effect=[found, silent, DigestError("There are digests of something else.")])
    monkeypatch.setattr("geodrake.cli.fleet.look_at_fleet", look)
    code, out, err = fleet("--watch --every 0.1")
    assert (code, out, look.call_count) == (2, "", 3)
    assert err.splitlines() == [
        "Logs 's3://x' cannot be listed: TimeoutError. Retrying in 0.1 s.",
        "Error: There are digests of something else.",
    ]


def test_errors_are_one_line_and_leave_no_file(folder, monkeypatch):
    monkeypatch.setattr("geodrake.fleet.workers._TIMEOUT", 0.5)
    before = contents(folder)
    for words, says in (
        ("--workers -1", "workers must be"),
        ("--workers 0 --false-alarms 0", "--false-alarms must be"),
        ("--workers 0 --every 0 --watch", "--every must be"),
        ("--workers 0 --watch --once", "exclude each other"),
        ("--workers 0 --once --json -", "Name a file"),
        ("--workers 0 --json fleet.yaml", "--json"),
        ("--workers 0 --report x.txt", "--report"),
        ("--workers 0 --scheduler nowhere", "The scheduler nowhere cannot be reached"),
    ):
        assert says in refused("fleet", "fleet.yaml", "-q", *words.split())
    for file in ("none.yaml", HEAVY):
        assert file in refused("fleet", file, "--workers", "0", "-q")
    assert contents(folder) == before
