"""`geodrake digest`: exit codes that a cron job understands, and what is said."""

import json
import shutil
from pathlib import Path

import pytest
from pendulum_logs import PENDULUM, pendulum_log
from typer.testing import CliRunner

from geodrake.cli.app import app
from geodrake.fleet import digest_files, read_digest, read_settings
from geodrake.logs.files import write_log


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    here = tmp_path_factory.mktemp("logs")
    for seed in (1, 2):
        write_log(pendulum_log(seed, seconds=20.0), here / f"log_{seed}.csv")
    return here


@pytest.fixture
def folder(logs, tmp_path, monkeypatch):
    for path in logs.iterdir():
        shutil.copy(path, tmp_path)
    shutil.copy(PENDULUM, tmp_path / "robot.urdf")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def digest(words):
    result = CliRunner().invoke(app, ["digest", "robot.urdf", *words.split(), "--quiet"])
    return result.exit_code, result.stdout, result.stderr


def test_logs_become_digests_once(folder):
    code, out, _ = digest("log_1.csv log_2.csv --to digests --date 2026-05-01 --json new.json")
    assert code == 0
    assert "2 made, 0 there already, 0 failed: every log has its digest in digests." in out
    assert "settings of all digests of digests are chosen from log_1" in out
    numbers = json.loads(Path("new.json").read_text(encoding="utf-8"))
    assert numbers["counts"] == {"made": 2, "there": 0, "failed": 0}
    assert numbers["settings"]["hash"] == read_settings("digests").hash
    for row in numbers["logs"]:
        found = read_digest(row["digest"])
        assert row["date"] == "2026-05-01T00:00:00+00:00"
        assert row["date_from"] == "option"
        for at, (joint, said) in enumerate(row["joints"].items()):
            assert joint == found.settings.joints[at]
            assert said["samples"] == found.samples[at]
            assert said["effective"] == pytest.approx(found.effective[at])
    code, out, _ = digest("log_1.csv log_2.csv --to digests")
    assert code == 0
    assert "0 made, 2 there already" in out
    assert len(digest_files("digests")) == 2


def test_a_log_that_fails_is_exit_code_1_and_a_row(folder):
    Path("bad.csv").write_text("time,x\n1,2\n", encoding="utf-8")
    code, out, err = digest("bad.csv none.csv log_1.csv --to digests --json -")
    assert code == 1
    numbers = json.loads(out)
    assert [row["status"] for row in numbers["logs"]] == ["failed", "failed", "made"]
    assert "does not exist" in numbers["logs"][1]["reason"]
    assert "Logs without a digest" in err
    assert "Traceback" not in err
    assert not list(folder.glob("*.mapping.yaml"))
    code, out, _ = digest("bad.csv --to nowhere --json none.json")
    assert code == 1
    assert "0 made, 0 there already, 1 failed: the exit code is 1." in out
    assert json.loads(Path("none.json").read_text(encoding="utf-8"))["settings"] is None
    assert not Path("nowhere").exists()


def test_known_payloads_go_with_their_log(folder):
    code, _, _ = digest("log_1.csv log_2.csv --to digests --known-payload log_2:lower_link:0.3")
    assert code == 0
    carried = {
        log.name: log.payloads for path in digest_files("digests") for log in read_digest(path).logs
    }
    assert carried["log_1"] == ()
    assert [payload.mass for payload in carried["log_2"]] == [0.3]


def test_what_does_not_fit_the_folder_is_one_line_and_exit_code_2(folder):
    assert digest("log_1.csv --to digests")[0] == 0
    before = {path: path.read_bytes() for path in Path("digests").iterdir()}
    text = Path("robot.urdf").read_text(encoding="utf-8")
    Path("robot.urdf").write_text(text.replace('value="0.5235"', 'value="0.6"'), encoding="utf-8")
    code, out, err = digest("log_2.csv --to digests")
    assert (code, out) == (2, "")
    assert "of another model than robot.urdf" in err
    assert len(err.strip().splitlines()) == 1
    assert {path: path.read_bytes() for path in Path("digests").iterdir()} == before
