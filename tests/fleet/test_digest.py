"""Digests against readings of the logs themselves, their files, and joints without a motor."""

import json
import os
from dataclasses import replace
from pathlib import Path

import coupled_arm
import numpy as np
import pytest
from acrobot_logs import HEADER, simulated, text
from chain_logs import chain_log
from own_transmission import OwnTransmission

from geodrake import load_model
from geodrake.errors import DigestError, LogError
from geodrake.fleet import (
    Digest,
    LogFacts,
    digest_content,
    digest_dataset,
    make_digest,
    make_settings,
    merge,
    read_digest,
)
from geodrake.fleet.digest_log import Wanted
from geodrake.fleet.hashes import model_hash, text_hash
from geodrake.fleet.history import RobotHistory, weighted_grams
from geodrake.fleet.log_places import date_of_log, date_seconds
from geodrake.fleet.sealed_file import sealed, unsealed
from geodrake.fleet.settings import FORMAT, settings_of
from geodrake.fleet.type_layout import type_layout
from geodrake.identification.logs.case import open_case, reduced
from geodrake.identification.logs.hypothesis import CrossValidation, first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns
from geodrake.logs import KnownPayload, read_log
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
    """Three logs; the first is the fastest, so that a reading of all chooses what it does."""
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
    """The `Dataset` of logs that are read together: it knows nothing of digests."""
    how = {"bandwidth": settings.bandwidth, "motion_bandwidth": settings.motion_bandwidth}
    case = open_case(model, logs, candidates=True, blocks=settings.blocks, **how)
    return reduced(case, [each.made() for each in settings.effects])


@pytest.fixture(scope="module")
def together(logs, settings):
    return read_together(MODEL, logs, settings)


def assert_same_normal_matrices(found, expected):
    for own, other in zip(found.data, expected.data, strict=True):
        assert np.array_equal(own.columns, other.columns)
        sizes = np.sqrt(np.einsum("fii->fi", other.grams))
        sizes[sizes == 0.0] = 1.0
        change = (own.grams - other.grams) / (sizes[:, :, None] * sizes[:, None, :])
        assert np.abs(change).max() < 1e-10
        assert np.abs(own.grams - other.grams).max() < 1e-10 * np.abs(other.grams).max()
        assert np.allclose(own.carried, other.carried, rtol=1e-10, atol=1e-10)


def test_merged_digests_are_those_of_a_reading_of_all_logs(digests, together):
    found = digest_dataset(merge(digests), MODEL)
    assert found.effects == together.effects
    assert found.folds == together.folds
    assert found.logs == together.logs
    assert np.array_equal(found.delays, together.delays)
    assert np.array_equal(found.samples, together.samples)
    assert_same_normal_matrices(found, together)
    for name in ("effort_std", "noise_floor", "still", "gain_uncertainty", "payload"):
        assert np.allclose(getattr(found, name), getattr(together, name), rtol=1e-12), name
    own = slice(10 * len(MODEL.bodies), None)  # those that priors of effects are made from
    assert np.allclose(found.column_peak[own], together.column_peak[own], rtol=1e-12)


def test_merging_goes_in_any_order_and_in_steps(digests):
    at_once = merge(digests).normal_matrices()
    size = np.sqrt(np.einsum("jii->ji", at_once))
    least = 1e-12 * size[:, :, None] * size[:, None, :]
    others = [merge(digests[::-1]), merge([merge(digests[:2]), digests[2]])]
    apart = sum(digest.normal_matrices() for digest in digests)
    for other in [*(each.normal_matrices() for each in others), apart]:
        assert np.all(np.abs(other - at_once) <= least)


def test_normal_matrices_are_those_of_the_named_columns(settings):
    """With the robot's own parameters by the names of columns, hardly any effort is left."""
    log = chain_log(MODEL, 5, resisted, seconds=22.0, share=0.0)
    digest = digested(MODEL, log, settings)
    x = np.zeros(len(digest.columns) + 1)
    x[: MODEL.phi.size] = MODEL.phi.ravel()
    for at, column in enumerate(digest.columns):
        if column.kind == "effect" and column.name in ("coulomb_friction", "viscous_friction"):
            size = FRICTION if column.name == "coulomb_friction" else VISCOUS
            x[at] = size[MODEL.joints.index(column.where[0])]
    x[-1] = -1.0
    matrices = digest.normal_matrices()
    rms = np.sqrt(np.einsum("i,jik,k->j", x, matrices, x) / digest.samples)
    assert np.all(rms < 0.02 * digest.effort_std)
    assert np.allclose(matrices, np.swapaxes(matrices, 1, 2))
    late = digest.normal_matrices(delay=3)  # whose efforts are those of another instant
    moved = np.sqrt(np.einsum("i,jik,k->j", x, late, x) / digest.samples)
    assert np.all(moved > rms)
    blocks = [digest.normal_matrices(block=block) for block in range(len(digest.blocks))]
    assert np.allclose(sum(blocks), matrices)
    power = matrices[:, -1, -1]
    sums = np.array([joint.effort_sums.sum(axis=0) for joint in digest.joints])
    assert np.allclose(power, sums[:, 1])


def test_samples_are_worth_what_residuals_of_the_library_say(digests, logs, settings):
    for digest, log in zip(digests[:2], logs, strict=False):
        alone = read_together(MODEL, [log], settings)
        known = first_hypothesis(alone, model_unknowns(alone, MODEL)).effective
        assert np.allclose(digest.effective, known, rtol=0.1)
        assert np.all(digest.effective < 0.7 * digest.samples)  # friction is missing
    white = digested(MODEL, chain_log(MODEL, 7, seconds=22.0, share=0.3), settings)
    assert np.median(white.effective / white.samples) > 0.7


def test_a_log_is_worth_no_more_than_its_sensors_are(digests):
    """A model may leave hardly anything of a log of few rows."""
    log = replace(digests[1].logs[0], residual_power=np.zeros(len(digests[1].joints)))
    digest = replace(digests[1], logs=(log,))
    found, squares = weighted_grams(digest, np.arange(len(digest.columns)))
    for joint, square, noise in zip(found, squares, digest.noise_floor, strict=True):
        assert joint.grams[0, -1, -1] <= square / noise**2


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
    """The digest through a file."""
    path = folder / "x.digest"
    path.write_bytes(digest_content(digest))
    return read_digest(path)


def test_a_file_holds_all_of_a_digest(digests, tmp_path):
    for digest in (digests[0], merge(digests)):
        found = read_back(digest, tmp_path)
        assert isinstance(found, Digest)
        assert found.settings.hash == digest.settings.hash
        assert found.settings.columns == digest.columns
        assert np.array_equal(found.normal_matrices(), digest.normal_matrices())
        assert np.array_equal(found.effective, digest.effective)
        assert digest_content(found) == digest_content(digest)


def test_the_same_log_gives_the_same_file(logs, settings, digests):
    again = digested(MODEL, logs[0], make_settings(MODEL, logs[0]))
    assert digest_content(again) == digest_content(digests[0])


def test_a_joint_that_rests_all_the_time_has_no_samples(logs, settings, digests):
    rng = np.random.default_rng(0)
    position, effort = logs[1].position.copy(), logs[1].effort.copy()
    position[:, 3] = 0.2 + 1e-7 * rng.normal(size=len(position))
    log = replace(logs[1], position=position, effort=effort)
    digest = digested(MODEL, log, settings)
    assert digest.samples[3] == 0
    assert np.all(np.delete(digest.samples, 3) > 100)
    assert digest.joints[3].still == 1.0
    assert not digest.normal_matrices()[3].any()
    assert digest.effective[3] == 0.0
    merged = merge([digests[0], digest])
    assert merged.samples[3] == digests[0].samples[3]
    assert np.allclose(merged.normal_matrices()[3], digests[0].normal_matrices()[3])
    first = make_settings(MODEL, log)  # also where the first log is such one
    named = {(column.name, column.where) for column in first.columns}
    assert ("stribeck_friction", (MODEL.joints[3],)) in named
    assert np.all(first.still_speed > 0.0)


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
    """The bytes of a digest whose settings say something else."""
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
    """The model, two logs of a robot with a heavier elbow, their settings and digests."""
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
    case = open_case(model, logs, candidates=True, blocks=settings.blocks, **how)
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
    """The normal equations of the shoulder alone have the robot's scale, not the least residual."""
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
