"""Digests of a robot with a joint without a motor say what a reading of its logs says."""

from dataclasses import replace

import numpy as np
import pytest
from acrobot_logs import HEADER, simulated, text

from geodrake import load_model
from geodrake.errors import LogError
from geodrake.fleet import (
    LogFacts,
    digest_content,
    digest_dataset,
    make_digest,
    make_settings,
    merge,
    read_digest,
)
from geodrake.fleet.history import RobotHistory, weighted_grams
from geodrake.fleet.settings import settings_of
from geodrake.fleet.type_layout import type_layout
from geodrake.identification.logs.case import open_case, reduced
from geodrake.identification.logs.hypothesis import CrossValidation, first_hypothesis
from geodrake.identification.logs.model_fit import model_unknowns
from geodrake.logs import read_log
from geodrake.model.logged_joints import log_of_model, reading_for


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
