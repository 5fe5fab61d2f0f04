"""Digests against readings of the logs themselves, and their files and folders."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import coupled_arm
import numpy as np
import pytest
from acrobot_logs import HEADER, simulated, text
from chain_logs import chain_log
from own_code import OwnTransmission, own_effect
from pendulum_logs import PENDULUM, pendulum_log

from geodrake import load_model
from geodrake.boundary.whole_files import write_new
from geodrake.errors import ArgumentError, DigestError, LogError, OutputError
from geodrake.fleet import (
    LogFacts,
    digest_content,
    digest_dataset,
    digest_files,
    digest_folder,
    digest_logs,
    make_digest,
    make_settings,
    merge,
    read_digest,
)
from geodrake.fleet.digest_log import Wanted, reading_settings
from geodrake.fleet.hashes import model_hash, text_hash
from geodrake.fleet.history import RobotHistory, weighted_grams
from geodrake.fleet.log_places import date_of_log, date_seconds
from geodrake.fleet.sealed_file import sealed, unsealed
from geodrake.fleet.settings import FORMAT, SETTINGS_FILE, read_settings, settings_of
from geodrake.fleet.type_layout import type_layout
from geodrake.identification.logs.case import prepare_case, reduced
from geodrake.identification.logs.hypothesis import CrossValidation, first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns
from geodrake.logs import KnownPayload, Reading, read_log, write_log
from geodrake.logs.motion import Trajectory
from geodrake.model.logged_joints import log_of_model, reading_for

MODELS = Path(__file__).parents[2] / "models"
FRICTION = np.array([6.0, 5.0, 4.0, 1.0, 1.0, 0.5])  # N·m
VISCOUS = np.array([3.0, 2.0, 2.0, 0.6, 0.5, 0.2])  # N·m·s/rad


def resisted(q, v, vd, load):
    return FRICTION * np.tanh(50.0 * v) + VISCOUS * v


MODEL = load_model(MODELS / "arm6.urdf")


@pytest.fixture(scope="module")
def logs():
    """Return three logs, of which the fastest comes first and determines the settings."""
    reaches = {1: 2.0, 2: 0.8, 3: 0.6}
    return [chain_log(MODEL, k, resisted, seconds=22.0, reach=r) for k, r in reaches.items()]


@pytest.fixture(scope="module")
def settings(logs):
    return make_settings(MODEL, logs[0])


def digested(model, log, settings, **facts):
    return make_digest(model, log, settings, LogFacts(log.name, (MODELS,), **facts))


@pytest.fixture(scope="module")
def digests(logs, settings):
    return [digested(MODEL, log, settings) for log in logs]


def read_together(model, logs, settings):
    """Return the `Dataset` of logs that are read together, without digests."""
    how = {"bandwidth": settings.bandwidth, "motion_bandwidth": settings.motion_bandwidth}
    case = prepare_case(model, logs, candidates=True, blocks=settings.blocks, **how)
    return reduced(case, [each.made() for each in settings.effects])


def assert_same_normal_matrices(found, expected):
    for own, other in zip(found.data, expected.data, strict=True):
        assert np.array_equal(own.columns, other.columns)
        sizes = np.sqrt(np.einsum("fii->fi", other.grams))
        sizes[sizes == 0.0] = 1.0
        change = (own.grams - other.grams) / (sizes[:, :, None] * sizes[:, None, :])
        assert np.abs(change).max() < 1e-10
        assert np.abs(own.grams - other.grams).max() < 1e-10 * np.abs(other.grams).max()
        assert np.allclose(own.carried, other.carried, rtol=1e-10, atol=1e-10)


def test_merging_goes_in_any_order_and_in_steps(digests):
    at_once = merge(digests).normal_matrices()
    size = np.sqrt(np.einsum("jii->ji", at_once))
    least = 1e-12 * size[:, :, None] * size[:, None, :]
    others = [merge(digests[::-1]), merge([merge(digests[:2]), digests[2]])]
    apart = sum(digest.normal_matrices() for digest in digests)
    for other in [*(each.normal_matrices() for each in others), apart]:
        assert np.all(np.abs(other - at_once) <= least)


def test_samples_are_worth_what_residuals_of_the_library_say(digests, logs, settings):
    for digest, log in zip(digests[:2], logs, strict=False):
        alone = read_together(MODEL, [log], settings)
        known = first_hypothesis(alone, model_unknowns(alone, MODEL)).effective
        assert np.allclose(digest.effective, known, rtol=0.1)
        assert np.all(digest.effective < 0.7 * digest.samples)  # friction is missing
    white = digested(MODEL, chain_log(MODEL, 7, seconds=22.0, share=0.3), settings)
    assert np.median(white.effective / white.samples) > 0.7


def test_behind_a_transmission_digests_are_exact_and_have_temperatures(tmp_path):
    arm = coupled_arm.arm(tmp_path)
    log = coupled_arm.log_of(arm, 1)
    warm = 20.0 + 3.0 * np.tile(log.time[:, None] / log.time[-1], len(log.joints))
    log = replace(log, temperature=warm)
    chosen = make_settings(arm, log)
    digest = digested(arm, log, chosen)
    assert_same_normal_matrices(digest_dataset(digest, arm), read_together(arm, [log], chosen))
    assert "thermal_friction" in {column.name for column in digest.columns}
    assert np.allclose(digest.logs[0].temperature, 21.5)


def test_signals_of_unknown_gain_are_refused(logs, settings):
    currents = replace(logs[1], effort_kinds=dict.fromkeys(MODEL.joints, "current"))
    with pytest.raises(LogError, match=r"has the current of base_yaw .* identify --save"):
        digested(MODEL, currents, settings)


def test_unknown_forces_at_contacts_are_refused(logs, settings, monkeypatch):
    monkeypatch.setattr(Trajectory, "has_unknown_forces", True)
    with pytest.raises(LogError, match="Forces at contacts are unknown in log 'log_2'"):
        digested(MODEL, logs[1], settings)


def test_a_joint_that_moves_under_one_effort_is_refused(logs, settings):
    effort = logs[1].effort.copy()
    effort[:, 2] = 3.0
    with pytest.raises(LogError, match=rf"effort of {MODEL.joints[2]} is constant .*: 3 "):
        digested(MODEL, replace(logs[1], effort=effort), settings)


def test_known_payloads_are_taken_off(logs, settings, tmp_path):
    carried = (KnownPayload(MODEL.bodies[-1], 2.0, (0.0, 0.02, 0.1)),)
    log = replace(logs[1], payloads=carried)
    merged = merge(
        [digested(MODEL, logs[0], settings), digested(MODEL, logs[1], settings, payloads=carried)]
    )
    expected = read_together(MODEL, [logs[0], log], settings)
    found = digest_dataset(read_back(merged, tmp_path), MODEL)
    assert found.effects == expected.effects
    assert_same_normal_matrices(found, expected)
    assert np.any(found.data[1].carried)
    assert np.array_equal(found.gain_uncertainty, expected.gain_uncertainty)


def read_back(digest, folder):
    """Return the digest after writing it to a file."""
    path = folder / "x.digest"
    path.write_bytes(digest_content(digest))
    return read_digest(path)


def test_the_same_log_gives_the_same_file(logs, digests):
    again = digested(MODEL, logs[0], make_settings(MODEL, logs[0]))
    assert digest_content(again) == digest_content(digests[0])


def test_what_motion_covers_is_that_of_the_log(digests, logs):
    for digest, log in zip(digests, logs, strict=True):
        (said,) = digest.logs
        assert np.allclose(said.position[0], log.position.min(axis=0), atol=0.02)
        assert np.allclose(said.position[1], log.position.max(axis=0), atol=0.02)
        speed = np.gradient(log.position, log.time, axis=0)
        assert np.allclose(said.speed[1], speed.max(axis=0), rtol=0.05)


def test_what_does_not_add_up_is_refused(logs, settings, digests):
    other = make_settings(MODEL, logs[0], wanted=Wanted(bandwidth=5.0, blocks=3))
    other = replace(other, version="2")
    stranger = digested(MODEL, logs[1], other)
    with pytest.raises(DigestError, match=r"log_2 .* differ in .*bandwidth.*version of geodrake"):
        merge([digests[0], stranger])
    with pytest.raises(DigestError, match="same log"):
        merge([digests[0], digests[1], digests[0]])
    heavier = replace(MODEL, phi=1.1 * MODEL.phi)
    with pytest.raises(DigestError, match=r"not of model arm6\.urdf"):
        digested(heavier, logs[1], settings)
    with pytest.raises(DigestError, match="not of model"):
        digest_dataset(digests[0], heavier)
    assert model_hash(MODEL) == model_hash(load_model(MODELS / "arm6.urdf"))
    assert model_hash(MODEL) != model_hash(heavier)


def test_transmissions_by_other_functions_are_others():
    def of(ratio):
        return OwnTransmission(
            (1, 1), lambda q: ratio * q, lambda q: np.full((len(q), 1, 1), ratio)
        )

    assert text_hash(of(2.0)) == text_hash(of(2.0))
    assert text_hash(of(2.0)) != text_hash(of(2.1))
    assert text_hash(of(np.nan)) != text_hash(of(2.0))  # where it is not known


def test_a_log_that_cannot_bear_the_settings_is_told_so(logs, settings):
    thinned = {name: getattr(logs[1], name)[::10] for name in ("time", "position", "effort")}
    slow = replace(logs[1], **thinned)
    wide = replace(settings, bandwidth=8.0, motion_bandwidth=24.0)
    with pytest.raises(LogError, match=r"too slow for the bandwidth of 8 Hz .* rate is 20 Hz"):
        digested(MODEL, slow, wide)
    with pytest.raises(LogError, match="too short"):
        digested(MODEL, logs[1], replace(settings, bandwidth=0.02, motion_bandwidth=0.06))


@pytest.mark.parametrize(
    "spoil",
    [
        lambda data: data[: len(data) // 2],
        lambda data: data[:5000] + bytes(100) + data[5100:],
        lambda data: data[:60] + bytes([7]) + data[61:],  # a block of no kind that is compressed
        lambda data: data[:-1] + bytes([data[-1] ^ 1]),
        lambda data: b"",
        lambda data: b"PK" + bytes(100),
        lambda data: data.replace(b"digest", b"digger", 1),
        lambda data: sealed({"settings": "{}"}, FORMAT),
        lambda data: rewritten(data, lambda s: {**s, "format": "geodrake digest 9"}),
        lambda data: rewritten(data, lambda s: {**s, "sign_width": [[1.0]]}),
        lambda data: rewritten(data, lambda s: {**s, "blocks": 10**30}),
    ],
)
def test_a_damaged_digest_is_refused(digests, tmp_path, spoil):
    path = tmp_path / "x.digest"
    path.write_bytes(spoil(digest_content(digests[0])))
    with pytest.raises(DigestError, match=r"x\.digest") as caught:
        read_digest(path)
    assert "\n" not in str(caught.value)


def rewritten(data, change):
    """Return the bytes of a digest with other settings."""
    settings, *parts = unsealed(data, FORMAT, list)
    return sealed((json.dumps(change(json.loads(settings))), *parts), FORMAT)


def test_dates_are_those_of_stamps_or_said(logs, tmp_path):
    log = logs[0]
    file = tmp_path / "log.csv"
    file.write_text("x", encoding="utf-8")
    assert date_of_log(log, [file]) == (file.stat().st_mtime, "file")
    said = date_seconds("2026-05-01T14:00:00+02:00")
    assert said == date_seconds("2026-05-01T12:00:00") == 1777636800.0
    assert date_of_log(log, [file], said) == (said, "option")
    absolute = replace(log, time=log.time + 1.7e9)
    assert date_of_log(absolute, [file], said) == (1.7e9, "stamps")
    since = replace(log, origin=1_777_636_800 * 10**9)
    assert date_of_log(since, [file]) == (said + log.time[0], "stamps")
    os.utime(file, (0.0, 0.0))
    with pytest.raises(
        LogError,
        match=r"The date of log .* is unknown.* modification time is 0 s since 1970.*--date",
    ):
        date_of_log(log, [file])
    assert date_of_log(log, [file], said) == (said, "option")


@pytest.mark.parametrize("text", ["", "yesterday", "2026-13-01", "1970-01-02", "1e9"])
def test_what_is_no_date_is_refused(text):
    with pytest.raises(ValueError, match="is not a date such as"):
        date_seconds(text)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return the model, two logs of a robot with a heavier elbow, their settings and digests."""
    folder = tmp_path_factory.mktemp("acrobot")
    (folder / "acrobot.xml").write_text(text())
    model, logs = load_model(folder / "acrobot.xml"), []
    for seed in (1, 2):
        path = folder / f"log{seed}.csv"
        np.savetxt(path, simulated(text(mass=1.0), seed), delimiter=",", header=HEADER, comments="")
        log = read_log(path, joints=model.joints, partial=True, reading=reading_for(model))
        logs.append(log_of_model(log, model))
    settings = make_settings(model, logs[0])
    digests = [
        make_digest(model, log, settings, LogFacts(f"{k:064x}", (model.path,)))
        for k, log in enumerate(logs)
    ]
    return model, logs, settings, digests


def test_settings_say_which_joints_have_no_motor(made):
    _, _, settings, _ = made
    assert settings.passive == ("shoulder",)
    assert settings_of(settings.text(), "settings").hash == settings.hash
    driven = replace(settings, passive=())
    assert driven.hash != settings.hash
    assert settings.differences(driven) == ['joints without a motor (["shoulder"] and [])']


def test_merged_digests_are_fitted_as_a_reading_of_the_logs(made, tmp_path):
    model, logs, settings, digests = made
    for k, digest in enumerate(digests):
        (tmp_path / f"{k}.digest").write_bytes(digest_content(digest))
    back = [read_digest(tmp_path / f"{k}.digest") for k in range(2)]
    dataset = digest_dataset(merge(back), model)
    how = {"bandwidth": settings.bandwidth, "motion_bandwidth": settings.motion_bandwidth}
    case = prepare_case(model, logs, candidates=True, blocks=settings.blocks, **how)
    read = reduced(case, [each.made() for each in settings.effects])
    j = model.joints.index("shoulder")
    assert np.allclose(dataset.passive_inertia, read.passive_inertia, rtol=1e-3, atol=1e-6)
    assert dataset.passive_inertia[j] @ model.phi.ravel() == pytest.approx(1.0, rel=1e-6)
    assert dataset.effort_std == pytest.approx(read.effort_std, rel=0.05)
    first = first_hypothesis(read, model_unknowns(read, model))
    fits = []
    for each in (dataset, read):
        x = first.held_out.x.mean(0)
        unknowns = model_unknowns(each, model).pulled(each, x, first.power)
        fits.append(CrossValidation(each, unknowns, first.weights).fit_all)
    assert fits[0] == pytest.approx(fits[1], rel=2e-3, abs=1e-4)
    assert fits[0][[0, 10]] == pytest.approx([1.2, 1.0], rel=0.1)


def test_histories_hold_what_such_a_joint_says_of_bodies(made, tmp_path):
    """Normal equations of the shoulder have the robot's scale, not the least residual."""
    model, _, settings, digests = made
    layout = type_layout(model, settings, np.ones(2))
    joints, squares = weighted_grams(digests[0], layout.kept)
    assert (squares > 0.0).all()
    history = RobotHistory("r", np.zeros(1), np.full(1, 20.0), len(layout.kept), tuple(joints))
    (tmp_path / "truth.xml").write_text(text(mass=1.0))
    x = layout.columns.prior[: history.columns]
    base = layout.base.matrix @ load_model(tmp_path / "truth.xml").phi.ravel()
    x[: len(base)] = base
    shoulder = joints[0]
    at, gram = shoulder.columns, shoulder.grams[0]
    scale = gram[:-1, -1] @ x[at] / (x[at] @ gram[:-1, :-1] @ x[at])
    assert 0.5 < scale < 2.0  # 0 by the residuals alone
    with_gains = replace(history, reference=x).equations()
    assert not with_gains.information[0, history.columns].any()  # nothing scales an effort of none
    assert with_gains.information[0, history.columns + 1].any()


def test_logs_that_differ_in_motors_are_refused(made):
    model, logs, settings, _ = made
    driven = replace(logs[1], effort_kinds={}, effort=np.sin(logs[1].position))
    with pytest.raises(LogError, match="shoulder has no motor in the logs before") as caught:
        make_digest(model, driven, settings, LogFacts("0" * 64, (model.path,)))
    assert "--passive shoulder" in caught.value.advice


SMALL = load_model(PENDULUM)


@pytest.fixture(scope="module")
def logged(tmp_path_factory):
    """Return three logs, and a folder of digests of two of them."""
    here = tmp_path_factory.mktemp("logs")
    for seed in (1, 2, 3):
        write_log(pendulum_log(seed, seconds=20.0), here / f"log_{seed}.csv")
    run = digest_logs(SMALL, [here / "log_1.csv", here / "log_2.csv"], here / "digests")
    assert [row.status for row in run.rows] == ["made", "made"]
    assert run.chosen
    return here


@pytest.fixture
def folder(logged, tmp_path):
    """Return a copy of that folder."""
    copy = tmp_path / "digests"
    copy.mkdir()
    for path in (logged / "digests").iterdir():
        (copy / path.name).write_bytes(path.read_bytes())
    return copy


def files_of(folder):
    """Return names and times of all files, which reading does not change."""
    return {
        path.name: (path.stat().st_ino, path.stat().st_mtime_ns, path.stat().st_size)
        for path in folder.iterdir()
    }


def test_settings_of_something_else_are_refused_by_name(logged, folder):
    log, before = [logged / "log_3.csv"], files_of(folder)
    own = read_settings(folder)
    cases = {
        "not of model": {"model": replace(SMALL, phi=1.01 * SMALL.phi)},
        "have bandwidth .*, but 3 was requested": {"wanted": Wanted(bandwidth=3.0)},
        "have blocks 4, but 5 was requested": {"wanted": Wanted(blocks=5)},
        "other reading options: units differ": {
            "wanted": Wanted(reading=Reading(units={"position": "deg"}))
        },
        "user-defined effects none, but now wobble": {"wanted": Wanted(extra=(Wobble,))},
    }
    for words, how in cases.items():
        with pytest.raises(DigestError, match=words):
            digest_logs(how.pop("model", SMALL), log, folder, **how)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(digest_folder, "version", lambda: "77.0")
        with pytest.raises(DigestError, match=r"are from geodrake .*, but this is 77\.0"):
            digest_logs(SMALL, log, folder)
    same = Wanted(bandwidth=own.bandwidth, blocks=4)
    assert digest_logs(SMALL, log, folder, wanted=same).rows[0].status == "made"
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
def test_damaged_settings_are_refused(logged, folder, change, words):
    path = folder / SETTINGS_FILE
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    before = files_of(folder)
    with pytest.raises(DigestError, match=words):
        digest_logs(SMALL, [logged / "log_3.csv"], folder)
    assert files_of(folder) == before


def test_a_full_disk_leaves_nothing_half_written(logged, folder, monkeypatch):
    before = files_of(folder)

    def full(self, target):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(OutputError, match="No space left"):
        digest_logs(SMALL, [logged / "log_3.csv"], folder)
    assert files_of(folder) == before
    with pytest.raises(OutputError, match="No space left"):
        digest_logs(SMALL, [logged / "log_3.csv"], folder.parent / "new")
    assert not digest_files(folder.parent / "new")
    monkeypatch.undo()  # the settings that are there do
    assert digest_logs(SMALL, [logged / "log_3.csv"], folder.parent / "new").count("made") == 1


def test_settings_that_are_lost_are_not_made_anew(logged, folder):
    (folder / SETTINGS_FILE).unlink()
    before = files_of(folder)
    with pytest.raises(DigestError, match=rf"{SETTINGS_FILE} of the digests is missing"):
        digest_logs(SMALL, [logged / "log_1.csv"], folder)
    assert files_of(folder) == before


def test_a_folder_that_cannot_be_is_refused_before_the_work(logged, tmp_path):
    for to, words in (
        (logged / "log_1.csv", "Not a directory"),
        (tmp_path / "none" / "digests", "No such file"),
        (logged / "log_1.csv" / "digests", "Not a directory"),
        (Path("/proc/digests"), "annot"),
        (tmp_path / ("x" * 300), "too long"),
    ):
        with pytest.raises(OutputError, match=words):
            digest_logs(SMALL, [logged / "none.csv"], to)
    with pytest.raises(ArgumentError, match="no logs to digest"):
        digest_logs(SMALL, [], tmp_path / "digests")


def test_settings_that_another_run_has_made_meanwhile_are_taken(logged, folder, tmp_path):
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
        run = digest_logs(SMALL, [logged / "log_3.csv"], other, progress=meanwhile)
    assert run.settings.hash == read_settings(folder).hash
    assert (run.chosen, run.settings.chosen_from) == (False, "another")
    assert read_digest(digest_files(other)[0]).settings.hash == run.settings.hash


def test_payloads_and_dates_are_kept(logged, folder):
    log = logged / "log_3.csv"
    carried = {log: (KnownPayload("lower_link", 0.3),)}
    bare = digest_logs(SMALL, [log], folder, date=1.7e9).rows[0]
    loaded = digest_logs(SMALL, [log], folder, payloads=carried).rows[0]
    assert bare.digest != loaded.digest
    assert (bare.about.date, bare.about.date_from) == (1.7e9, "option")
    assert loaded.about.date_from == "file"
    assert read_digest(loaded.digest).logs[0].payloads == carried[log]
    again = digest_logs(SMALL, [log], folder, date=1.8e9).rows[0]
    assert again.status == "there"
    assert "its date is still 2023-11-14T22:13:20+00:00" in again.reason


def test_logs_without_a_joint_hold_it_for_all(tmp_path):
    log = pendulum_log(4, seconds=20.0)
    alone = log.select(("shoulder",))
    write_log(alone, tmp_path / "alone.csv")
    write_log(log, tmp_path / "both.csv")
    run = digest_logs(SMALL, [tmp_path / "alone.csv", tmp_path / "both.csv"], tmp_path / "digests")
    assert [row.status for row in run.rows] == ["made", "failed"]
    assert "fix elbow at 0, where it is not in log 'both'" in run.rows[1].reason
    assert run.settings.joints == ("shoulder",)
    assert list(run.settings.held) == ["elbow"]
    digest = read_digest(run.rows[0].digest)
    assert digest_dataset(digest, SMALL).joints == ("shoulder",)
    other = digest_logs(SMALL, [tmp_path / "both.csv"], tmp_path / "both")
    lacking = digest_logs(SMALL, [tmp_path / "alone.csv"], tmp_path / "both")
    assert other.settings.joints == SMALL.joints
    assert lacking.rows[0].status == "failed"
    assert "elbow" in lacking.rows[0].reason


Wobble = own_effect(
    "wobble",
    law="a sin 7q",
    signature="wobbles",
    depends_on=frozenset({"q"}),
    columns=lambda self, joint: [np.sin(7.0 * joint.q)],
)
"""An effect of a user's own: effort = a sin 7q."""


def test_effects_of_a_users_own_have_columns(logged, tmp_path):
    wanted = Wanted(extra=(Wobble,))
    logs = [logged / "log_1.csv", logged / "log_2.csv"]
    run = digest_logs(SMALL, logs, tmp_path / "digests", wanted=wanted)
    merged = merge([read_digest(path) for path in digest_files(tmp_path / "digests")])
    named = [column for column in merged.columns if column.name == "wobble"]
    assert {column.where for column in named} == {("shoulder",), ("elbow",)}
    assert run.count("made") == 2
    with pytest.raises(DigestError, match="user-defined effects wobble, but now none"):
        digest_logs(SMALL, logs, tmp_path / "digests")
    assert digest_logs(SMALL, logs, tmp_path / "digests", wanted=wanted).count("there") == 2
    with pytest.raises(DigestError, match="wobble, which cannot be constructed"):
        digest_dataset(merged, SMALL)
    assert digest_dataset(merged, SMALL, extra=(Wobble,)).effects


def test_settings_say_what_those_of_older_folders_do(tmp_path):
    """Other words would give every folder other options."""
    names = "mapping columns rate units gains skip_bad_rows topic gain_deviations kinds motors"
    assert reading_settings(Reading()).keys() == {*names.split(), "of_base", "joints"}
    assert reading_settings(Reading(usual_deviation=0.2))["usual_deviation"] == 0.2
    dbc, digests = tmp_path / "a.dbc", set()
    for words in ("one", "two"):
        dbc.write_text(words)
        digests.add(json.dumps(reading_settings(Reading(dbc=dbc))["dbc"]))
    assert len(digests) == 2
