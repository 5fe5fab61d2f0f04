"""Folders of digests: made once, whole or not at all, by settings that all of them share."""

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pendulum_logs import PENDULUM, pendulum_log

from geodrake.boundary.whole_files import write_new
from geodrake.effects import JointEffect, Parameter
from geodrake.errors import ArgumentError, DigestError, OutputError
from geodrake.fleet import (
    digest_dataset,
    digest_files,
    digest_folder,
    digest_logs,
    merge,
    read_digest,
)
from geodrake.fleet.digest_log import Wanted
from geodrake.fleet.settings import FORMAT, SETTINGS_FILE, read_settings
from geodrake.logs import KnownPayload, Reading, write_log
from geodrake.model import load_model

MODEL = load_model(PENDULUM)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three logs, and a folder of digests of two of them."""
    here = tmp_path_factory.mktemp("logs")
    for seed in (1, 2, 3):
        write_log(pendulum_log(seed, seconds=20.0), here / f"log_{seed}.csv")
    run = digest_logs(MODEL, [here / "log_1.csv", here / "log_2.csv"], here / "digests")
    assert [row.status for row in run.rows] == ["made", "made"]
    assert run.chosen
    return here


@pytest.fixture
def folder(made, tmp_path):
    """A copy of that folder."""
    copy = tmp_path / "digests"
    copy.mkdir()
    for path in (made / "digests").iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    return copy


def files_of(folder):
    """Which files there are, and when they were written: reading changes nothing of it."""
    return {
        path.name: (path.stat().st_ino, path.stat().st_mtime_ns, path.stat().st_size)
        for path in folder.iterdir()
    }


def test_a_digest_that_is_there_is_not_made_again(made, folder):
    before = files_of(folder)
    told = []
    run = digest_logs(
        MODEL, [made / "log_2.csv", made / "log_1.csv"], folder, told=lambda *w: told.append(w)
    )
    assert [row.status for row in run.rows] == ["there", "there"]
    assert not run.chosen
    assert [share for _, share in told] == [0.0, 0.5]
    assert files_of(folder) == before
    more = digest_logs(MODEL, [made / "log_3.csv", made / "log_3.csv"], folder)
    assert [row.status for row in more.rows] == ["made", "there"]
    assert len(digest_files(folder)) == 3
    moved = made / "moved.csv"  # what counts are the bytes, not the name
    moved.write_bytes((made / "log_3.csv").read_bytes())
    assert digest_logs(MODEL, [moved], folder).rows[0].status == "there"


def test_logs_that_cannot_be_read_leave_the_others_alone(made, tmp_path):
    bad, short, pipe = (made / name for name in ("bad.csv", "short.csv", "folder.csv"))
    bad.write_text("time,x\n1,2\n", encoding="utf-8")
    lines = (made / "log_1.csv").read_text(encoding="utf-8").splitlines()
    short.write_text("\n".join(lines[:60]), encoding="utf-8")
    pipe.mkdir(exist_ok=True)
    logs = [bad, made / "none.csv", made / "log_1.csv", short, pipe, made / "log_2.csv"]
    run = digest_logs(MODEL, logs, tmp_path / "digests")
    statuses = ["failed", "failed", "made", "failed", "failed", "made"]
    assert [row.status for row in run.rows] == statuses
    assert (run.count("failed"), run.count("made"), run.count("there")) == (4, 2, 0)
    assert all(bool(row.reason) == (row.status == "failed") for row in run.rows)
    assert "does not exist" in run.rows[1].reason
    assert "\n" not in "".join(row.reason for row in run.rows)
    nothing = digest_logs(MODEL, [bad], tmp_path / "empty")
    assert nothing.settings is None
    assert not (tmp_path / "empty").exists()


def test_settings_of_something_else_are_refused_by_name(made, folder):
    log, before = [made / "log_3.csv"], files_of(folder)
    own = read_settings(folder)
    cases = {
        "not of model": {"model": replace(MODEL, phi=1.01 * MODEL.phi)},
        "have bandwidth .*, but 3 was requested": {"wanted": Wanted(bandwidth=3.0)},
        "have blocks 4, but 5 was requested": {"wanted": Wanted(blocks=5)},
        "other reading options: units differ": {
            "wanted": Wanted(reading=Reading(units={"position": "deg"}))
        },
        "user-defined effects none, but now wobble": {"wanted": Wanted(extra=(Wobble,))},
    }
    for words, how in cases.items():
        with pytest.raises(DigestError, match=words):
            digest_logs(how.pop("model", MODEL), log, folder, **how)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(digest_folder, "version", lambda: "77.0")
        with pytest.raises(DigestError, match=r"are from geodrake .*, but this is 77\.0"):
            digest_logs(MODEL, log, folder)
    same = Wanted(bandwidth=own.bandwidth, blocks=4)
    assert digest_logs(MODEL, log, folder, wanted=same).rows[0].status == "made"
    assert before.items() <= files_of(folder).items()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda text: text[: len(text) // 2], "has no valid settings"),
        (lambda text: "", "is empty"),
        (lambda text: text.replace(FORMAT, "geodrake digest 9"), "has format"),
        (lambda text: text.replace('"blocks": 4', '"blocks": "four"'), "has no valid settings"),
        (lambda text: text.replace('"blocks": 4', '"blocks": NaN'), "has no valid settings"),
        (lambda text: text.replace("viscous_friction", "nobody's"), "its hash belongs to other"),
    ],
)
def test_damaged_settings_are_refused(made, folder, change, words):
    path = folder / SETTINGS_FILE
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    before = files_of(folder)
    with pytest.raises(DigestError, match=words):
        digest_logs(MODEL, [made / "log_3.csv"], folder)
    assert files_of(folder) == before


def test_a_digest_by_other_settings_is_made_again(made, folder, tmp_path):
    other = tmp_path / "other"
    wanted = Wanted(bandwidth=4.0)
    stranger = digest_logs(MODEL, [made / "log_1.csv"], other, wanted=wanted).rows[0].digest
    own = digest_logs(MODEL, [made / "log_1.csv"], folder).rows[0].digest
    assert stranger.name != own.name
    own.write_bytes(stranger.read_bytes())
    run = digest_logs(MODEL, [made / "log_1.csv"], folder)
    assert run.rows[0].status == "made"
    assert "differ in bandwidth" in run.rows[0].reason


def test_a_full_disk_leaves_nothing_half_written(made, folder, monkeypatch):
    before = files_of(folder)

    def full(self, target):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        digest_logs(MODEL, [made / "log_3.csv"], folder)
    assert files_of(folder) == before
    with pytest.raises(OutputError, match="No space left"):
        digest_logs(MODEL, [made / "log_3.csv"], folder.parent / "new")
    assert not digest_files(folder.parent / "new")
    monkeypatch.undo()  # the settings that are there do
    assert digest_logs(MODEL, [made / "log_3.csv"], folder.parent / "new").count("made") == 1


def test_settings_that_are_lost_are_not_made_anew(made, folder):
    (folder / SETTINGS_FILE).unlink()
    before = files_of(folder)
    with pytest.raises(DigestError, match=rf"{SETTINGS_FILE} of the digests is missing"):
        digest_logs(MODEL, [made / "log_1.csv"], folder)
    assert files_of(folder) == before


def test_a_folder_that_cannot_be_is_refused_before_the_work(made, tmp_path):
    for to, words in (
        (made / "log_1.csv", "Not a directory"),
        (tmp_path / "none" / "digests", "No such file"),
        (made / "log_1.csv" / "digests", "Not a directory"),
        (Path("/proc/digests"), "annot"),
        (tmp_path / ("x" * 300), "too long"),
    ):
        with pytest.raises(OutputError, match=words):
            digest_logs(MODEL, [made / "none.csv"], to)
    with pytest.raises(ArgumentError, match="no logs to digest"):
        digest_logs(MODEL, [], tmp_path / "digests")


def test_settings_that_another_run_has_made_meanwhile_are_taken(made, folder, tmp_path):
    other, asked = tmp_path / "other", []

    def meanwhile(words, share):
        if asked.append(words) is None and len(asked) == 1:
            other.mkdir()

    def slowly(*how):
        text = (folder / SETTINGS_FILE).read_text(encoding="utf-8").replace("log_1", "another")
        (other / SETTINGS_FILE).write_text(text, encoding="utf-8")
        return write_new(*how)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(digest_folder, "write_new", slowly)
        run = digest_logs(MODEL, [made / "log_3.csv"], other, told=meanwhile)
    assert run.settings.hash == read_settings(folder).hash
    assert (run.chosen, run.settings.chosen_from) == (False, "another")
    assert read_digest(digest_files(other)[0]).settings.hash == run.settings.hash


def test_payloads_and_dates_are_kept(made, folder):
    log = made / "log_3.csv"
    carried = {log: (KnownPayload("lower_link", 0.3),)}
    bare = digest_logs(MODEL, [log], folder, date=1.7e9).rows[0]
    loaded = digest_logs(MODEL, [log], folder, payloads=carried).rows[0]
    assert bare.digest != loaded.digest
    assert (bare.about.date, bare.about.date_from) == (1.7e9, "option")
    assert loaded.about.date_from == "file"
    assert read_digest(loaded.digest).logs[0].payloads == carried[log]
    again = digest_logs(MODEL, [log], folder, date=1.8e9).rows[0]
    assert again.status == "there"
    assert "its date is still 2023-11-14T22:13:20+00:00" in again.reason


def test_logs_without_a_joint_hold_it_for_all(tmp_path):
    log = pendulum_log(4, seconds=20.0)
    alone = log.select(("shoulder",))
    write_log(alone, tmp_path / "alone.csv")
    write_log(log, tmp_path / "both.csv")
    run = digest_logs(MODEL, [tmp_path / "alone.csv", tmp_path / "both.csv"], tmp_path / "digests")
    assert [row.status for row in run.rows] == ["made", "failed"]
    assert "fix elbow at 0, where it is not in log 'both'" in run.rows[1].reason
    assert run.settings.joints == ("shoulder",)
    assert list(run.settings.held) == ["elbow"]
    digest = read_digest(run.rows[0].digest)
    assert digest_dataset(digest, MODEL).joints == ("shoulder",)
    other = digest_logs(MODEL, [tmp_path / "both.csv"], tmp_path / "both")
    lacking = digest_logs(MODEL, [tmp_path / "alone.csv"], tmp_path / "both")
    assert other.settings.joints == MODEL.joints
    assert lacking.rows[0].status == "failed"
    assert "elbow" in lacking.rows[0].reason


class Wobble(JointEffect):
    """An effect of a user's own: effort = a sin 7q."""

    name = "wobble"
    parameters = (Parameter("size", "N·m"),)
    law = "a sin 7q"
    signature = "wobbles"
    depends_on = frozenset({"q"})

    def columns(self, joint):
        return [np.sin(7.0 * joint.q)]


def test_effects_of_a_users_own_have_columns(made, tmp_path):
    wanted = Wanted(extra=(Wobble,))
    logs = [made / "log_1.csv", made / "log_2.csv"]
    run = digest_logs(MODEL, logs, tmp_path / "digests", wanted=wanted)
    merged = merge([read_digest(path) for path in digest_files(tmp_path / "digests")])
    named = [column for column in merged.columns if column.name == "wobble"]
    assert {column.where for column in named} == {("shoulder",), ("elbow",)}
    assert run.count("made") == 2
    with pytest.raises(DigestError, match="user-defined effects wobble, but now none"):
        digest_logs(MODEL, logs, tmp_path / "digests")
    assert digest_logs(MODEL, logs, tmp_path / "digests", wanted=wanted).count("there") == 2
    with pytest.raises(DigestError, match="wobble, which cannot be constructed"):
        digest_dataset(merged, MODEL)
    assert digest_dataset(merged, MODEL, extra=(Wobble,)).effects
