"""`geodrake digest`: output, and exit codes for a cron job."""

import json
import shutil
from pathlib import Path

import pytest
from commands import contents, refused, run, told
from pendulum_logs import PENDULUM, pendulum_log

from geodrake.fleet import digest_files, read_digest
from geodrake.fleet.settings import read_settings
from geodrake.logs import write_log


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    here = tmp_path_factory.mktemp("logs")
    shutil.copy(PENDULUM, here / "robot.urdf")
    for seed in (1, 2):
        write_log(pendulum_log(seed, seconds=10.0), here / f"log_{seed}.csv")
    return here


@pytest.fixture(autouse=True)
def folder(logs, working_folder):
    shutil.copytree(logs, working_folder, dirs_exist_ok=True)


def words_of(words):
    return ("digest", "robot.urdf", *words.split(), "--quiet")


def test_logs_become_digests_once():
    weighed = "log_1.csv log_2.csv --to digests --known-payload log_2:lower_link:0.3"
    out = told(*words_of(f"{weighed} --date 2026-05-01 --json new.json"))
    assert "2 digested, 0 existed, 0 failed: every log has a digest in digests." in out
    assert "settings of all digests in digests, chosen from log_1" in out
    numbers = json.loads(Path("new.json").read_text(encoding="utf-8"))
    assert numbers["counts"] == {"made": 2, "there": 0, "failed": 0}
    assert numbers["settings"]["hash"] == read_settings("digests").hash
    for row, masses in zip(numbers["logs"], ([], [0.3]), strict=True):
        found = read_digest(row["digest"])
        assert [payload.mass for log in found.logs for payload in log.payloads] == masses
        assert row["date"] == "2026-05-01T00:00:00+00:00"
        assert row["date_from"] == "option"
        for at, (joint, said) in enumerate(row["joints"].items()):
            assert joint == found.settings.joints[at]
            assert said["samples"] == found.samples[at]
            assert said["effective"] == pytest.approx(found.effective[at])
    assert "0 digested, 2 existed" in told(*words_of(weighed))
    assert len(digest_files("digests")) == 2

    before = contents(Path("digests"))
    text = Path("robot.urdf").read_text(encoding="utf-8")
    Path("robot.urdf").write_text(text.replace('value="0.5235"', 'value="0.6"'), encoding="utf-8")
    err = refused(*words_of("log_2.csv --to digests"))
    assert "not of model robot.urdf" in err
    assert contents(Path("digests")) == before


def test_a_failing_log_gives_exit_code_1_and_a_row():
    Path("bad.csv").write_text("time,x\n1,2\n", encoding="utf-8")
    done = run(*words_of("bad.csv none.csv log_1.csv --to digests --json -"))
    assert done.exit_code == 1
    numbers = json.loads(done.stdout)
    assert [row["status"] for row in numbers["logs"]] == ["failed", "failed", "made"]
    assert "does not exist" in numbers["logs"][1]["reason"]
    assert "Logs without a digest" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(Path().glob("*.mapping.yaml"))
    done = run(*words_of("bad.csv --to nowhere --json none.json"))
    assert done.exit_code == 1
    assert "0 digested, 0 existed, 1 failed: exit code 1." in done.stdout
    assert json.loads(Path("none.json").read_text(encoding="utf-8"))["settings"] is None
    assert not Path("nowhere").exists()
