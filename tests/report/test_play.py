"""Logs played over a robot: postures, colours, marks and moments."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from commands import told
from meshcat_pages import drawn, tracks
from pendulum_logs import PENDULUM, pendulum_log, welded_plant
from report_results import JOINT, LOG, URDF

from geodrake import load_model, save_model
from geodrake.control import roll_out
from geodrake.control.rollout import Rollout
from geodrake.control.rollout.roll_out import Window
from geodrake.diagnosis import compare
from geodrake.errors import ArgumentError
from geodrake.logs import read_log
from geodrake.report.meshcat_scene import play_page, rollout_replay_page
from geodrake.report.playback import play_back
from geodrake.report.robot_scene import COLORS, FRAMES, UNKNOWN, levels


def page_of(playback, *names):
    """Return the page of a playback of logs of some names."""
    title, *logs = names or ("demo: <play>", "demo.csv")
    return play_page(playback, title=title, log_names=logs)


@pytest.fixture(scope="module")
def playback(before, after):
    return play_back(after, [LOG], before=before)


@pytest.fixture(scope="module")
def page(short):
    return page_of(short)


def test_links_follow_the_log(short, page):
    plant, log = welded_plant(URDF), read_log(LOG)
    context = plant.CreateDefaultContext()
    (excerpt,) = short.excerpts
    found = tracks(page)
    for k, title in enumerate(("before", "after")):
        frames, positions = found[f"/drake/robot/{k} {title}/arm6::flange", "position"]
        assert frames == list(range(len(excerpt.time)))
        for frame in (0, 20, len(frames) - 1):
            q = [np.interp(excerpt.time[frame], log.time, x) for x in log.position.T]
            for joint, value in zip(log.joints, q, strict=True):
                plant.GetJointByName(joint).set_angle(context, value)
            X_WB = plant.EvalBodyPoseInWorld(context, plant.GetBodyByName("flange"))
            place = X_WB.translation() + short.robots[k].place
            np.testing.assert_allclose(positions[frame], place, atol=2e-3)


def test_ghosts_follow_rollouts_on_request(after, cut, page):
    playback = play_back(after, [cut], ghost=0.2)
    (played,) = playback.models
    there = np.isfinite(played.simulated).all(1)
    assert there.mean() > 0.7 and np.isnan(played.simulated[~there]).all()
    apart = np.abs(played.simulated - playback.q)[there]
    assert apart.max() > 0.05 and np.median(apart) < 0.05
    assert apart.max() < 1.5  # one radian, and the motion between two frames
    (excerpt,) = playback.excerpts
    rolled = roll_out(after, [cut], horizon=0.2, most=1000).windows
    window = next(w for w in rolled if w.time[0] > excerpt.time[0])
    inside = (excerpt.time >= window.time[0]) & (excerpt.time <= window.time[-1])
    at = excerpt.time[inside]
    near = np.stack([np.interp(at, window.time, x) for x in window.simulated.T], -1)
    np.testing.assert_allclose(played.simulated[inside][0], near[0], atol=1e-6)
    html = page_of(playback)
    seen, own = tracks(html), "/drake/ghost/0"
    shown = seen[own, "visible"][1]
    assert shown == there.tolist()
    link = f"{own}/arm6::flange"
    assert len(seen[link, "position"][0]) == there.sum()
    assert 'id="gd-ghosts"' in html
    assert 'id="gd-ghosts"' not in page and not [p for p, _ in tracks(page) if "ghost" in p]


def test_arrows_have_the_lengths_and_directions_of_the_efforts(short, page):
    found, j = tracks(page), short.joints.index(JOINT)
    after = short.models[1]
    folder = f"/drake/robot/1 after/arm6::upper_arm/efforts/{JOINT}"
    for kind in ("measured", "predicted"):
        length = np.array(found[f"{folder}/{kind}/arrow", "scale"][1])[:, 2]
        effort = getattr(after, kind)[:, j] / np.nanmax(np.abs(after.measured[:, j]))
        large = np.isfinite(effort) & (np.abs(effort) > 0.05)
        assert large.sum() > 20
        np.testing.assert_allclose(length[large], effort[large], rtol=1e-9)


def test_colours_are_the_errors(playback, before, after):
    assert [played.title for played in playback.models] == ["before", "after"]
    for played, model in zip(playback.models, (before, after), strict=True):
        nrms = compare(model, [LOG]).errors.nrms  # at another bandwidth
        assert played.comparison.errors.nrms == pytest.approx(nrms, rel=0.3)
    played, (excerpt,) = playback.models[0], playback.excerpts
    colors, j = levels(played.relative, playback.top), playback.joints.index(JOINT)
    std = played.comparison.errors.joints[j].std
    own = [s for s in played.comparison.series if s.joint == JOINT]
    time, residual = (np.concatenate([getattr(s, n) for s in own]) for n in ("time", "residual"))
    assert (colors[:, j] != UNKNOWN).mean() > 0.9
    for frame in range(30, len(excerpt.time) - 30, 50):
        near = np.abs(time - excerpt.time[frame]) <= 0.15
        if near.any():
            rms = np.sqrt((residual[near] ** 2).mean())
            expected = 254 * min(rms / std / playback.top, 1.0)
            assert abs(int(colors[frame, j]) - expected) <= 1
    assert levels(playback.models[1].relative, playback.top)[:, j].mean() < colors[:, j].mean()


def test_the_worst_moments_are_the_worst_and_apart(playback):
    for played in playback.models:
        moments = played.moments
        assert moments[0].relative == np.nanmax(played.relative)
        sizes = [m.relative for m in moments]
        assert sizes == sorted(sizes, reverse=True) and 3 <= len(moments) <= 5
        for m in moments:
            assert m.relative == played.relative[m.frame, playback.joints.index(m.joint)]
            assert (m.log, m.time) == playback.instants[m.frame]
            same = [o for o in moments if o.joint == m.joint and o is not m]
            assert all(abs(o.frame - m.frame) >= FRAMES for o in same)


def test_the_worst_parts_of_long_logs_are_played(before, playback):
    some = play_back(before, [LOG], seconds=6.0)
    assert sum(len(e.time) for e in some.excerpts) / FRAMES <= 6.0
    assert some.seconds_left_out == pytest.approx(23.76 - 6.0, abs=0.3)
    worst = playback.models[0].moments[0]
    assert any(e.time[0] <= worst.time <= e.time[-1] for e in some.excerpts)
    page = page_of(some)
    assert "s of the logs are not (--seconds)" in page


def test_effects_are_at_their_places(short, page):
    paths, found = drawn(page), tracks(page)
    root = "/drake/robot/1 after"
    assert f"{root}/arm6::flange/effects/0 payload" in paths
    assert f"{root}/arm6::upper_arm/disc {JOINT}" in paths
    frames, there = found[f"{root}/effects/2 contact", "visible"]
    (excerpt,) = short.excerpts
    since = [excerpt.time[frame] - excerpt.began for frame in frames]
    assert there == [False, True, False, False]
    np.testing.assert_allclose(since[1:3], [1.0, 2.0], atol=1 / FRAMES)
    assert not [path for path in paths if "0 before" in path and "effects" in path]
    for words in ("payload 2.50 kg", "Coulomb friction 8.00 N·m", "contact 5.00 N", "tilt"):
        assert words in page


def test_the_page_says_what_is_held_out_and_loads_nothing(page, after, before):
    assert "<title>demo: &lt;play&gt;</title>" in page
    assert page.count("held-out data") == 2 and "training data" not in page
    outside = re.findall(r"(?:src|href)=[\"']?(?!data:)[^\"'> ]+", page.rpartition("gd-side")[2])
    assert not outside
    log = read_log(LOG)
    trained = replace(after, fitted_to=(log.fingerprint,))
    found = play_back(trained, [LOG], before=before, seconds=1.0)
    assert [played.trained for played in found.models] == [False, True]
    assert "training data" in page_of(found)


def test_a_joint_whose_effort_is_unknown_has_no_error(before):
    log = replace(read_log(LOG), effort_kinds={"wrist_spin": "unmeasured"})
    (played,) = play_back(before, [log]).models
    assert np.isnan(played.relative).all(axis=0).tolist() == [False] * 5 + [True]


def test_models_of_other_robots_are_refused(before):
    with pytest.raises(ArgumentError, match="Use two models of one robot"):
        play_back(before, [LOG], before=load_model(PENDULUM))


def test_the_command_plays_a_saved_model_beside_its_file(tmp_path, after):
    saved, out, numbers = (tmp_path / name for name in ("arm.yaml", "play.html", "n.json"))
    save_model(after, saved)
    said = told("play", saved, LOG, "--out", out, "--seconds", 2, "--json", numbers)
    assert "Saved the page that plays the logs: " in said
    assert "Before: nrms 0.8" in said and ": error " in said
    found = json.loads(numbers.read_text())
    assert [m["title"] for m in found["models"]] == ["before", "after"]
    first = found["models"][0]["worst_moments"][0]
    assert first["joint"] in said and first["relative"] > 1
    assert "/drake/robot/1 after/arm6::flange" in {path for path, _ in tracks(out.read_text())}
    assert out.stat().st_size < 4e6


PLOTTED = """() => {
    const canvas = document.getElementById("gd-plots");
    const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    const colors = new Set();
    for (let k = 0; k < data.length; k += 4)
        if (data[k + 3] === 255) colors.add(data.slice(k, k + 3).join());
    return colors.size;
}"""


SHOWN = """() => {
    const paint = object => {
        let color = null;
        object.traverse(o => { if (o.material) color = o.material.color; });
        return color;
    };
    const find = path => viewer.scene_tree.find(path.split("/").filter(p => p)).object;
    return [viewer.animator.time, find(%r).scale.z, paint(find(%r)).getHexString()];
}"""


def test_a_browser_opens_it_and_jumps(browser, tmp_path, page, short):
    file = tmp_path / "play.html"
    file.write_text(page)
    moment = short.models[0].moments[0]
    link = {"wrist_spin": "flange", "wrist_roll": "wrist_barrel", "elbow_pitch": "forearm"}
    joint = moment.joint
    body = f"/drake/robot/0 before/arm6::{link.get(joint, 'flange')}"
    arrow = f"/drake/robot/0 before/arm6::upper_arm/efforts/{JOINT}/measured/arrow"
    seen = []
    view = browser.new_page(viewport={"width": 640, "height": 700})
    view.on("console", lambda m: seen.append(m.text) if m.type == "error" else None)
    view.on("pageerror", lambda error: seen.append(str(error)))
    view.on("request", lambda r: seen.append(r.url) if r.url.startswith("http") else None)
    view.goto(file.as_uri())
    view.wait_for_selector("html[data-ready=yes]", state="attached", timeout=60_000)
    button = view.locator(".gd-moment").first
    assert joint in button.inner_text()
    button.click()
    view.wait_for_selector('.gd-moment[aria-pressed="true"]')
    view.locator("#gd-now", has_text=f"{joint} errs most").wait_for()  # at the next frame
    time, length, color = view.evaluate(SHOWN % (arrow, f"{body}/shapes"))
    assert view.locator("#gd-play").inner_text() == "Play"
    chosen = view.locator("#gd-joint option:checked").inner_text()
    before = view.evaluate("viewer.camera.position.toArray()")
    view.keyboard.press("4")
    above = view.evaluate("viewer.camera.position.toArray()")
    view.keyboard.press("ArrowLeft")
    view.wait_for_timeout(300)
    later = view.evaluate("viewer.animator.time")
    view.locator("body").press(" ")
    view.locator("#gd-play", has_text="Pause").wait_for()
    drawn_plots = view.evaluate(PLOTTED)
    view.close()
    assert not seen
    assert time == pytest.approx(moment.frame / FRAMES, abs=1e-3)
    expected = tracks(page)[arrow, "scale"][1][moment.frame][2]
    assert length == pytest.approx(expected, abs=1e-5)
    assert chosen == joint  # whose effort, residual and position are plotted
    assert later == pytest.approx(time - 1 / FRAMES, abs=1e-3)
    assert above[1] > before[1] and np.hypot(above[0], above[2]) < np.hypot(before[0], before[2])
    assert drawn_plots > 3
    if joint in link:
        assert f"#{color}" == COLORS[-1]


def test_malicious_names_stay_text(tmp_path):
    name, joint = "</script><b>`${1}\u2028", "shoulder"
    text = PENDULUM.read_text().replace(f'"{joint}"', f'"{name.replace("<", "&lt;")}"')
    (tmp_path / "r.urdf").write_text(text)
    log = replace(pendulum_log(1, seconds=20.0), name=name, joints=(name, "elbow"))
    found = play_back(load_model(tmp_path / "r.urdf"), [log], seconds=1.0, bandwidth=5.0)
    page = page_of(found, name, name)
    assert "<b>`" not in page and "\u2028" not in page
    (data,) = re.findall(r"const data = (\{.*\});\n", page)
    assert json.loads(data)["joints"][0].startswith("</script><b>`${1}")


def test_a_rollout_is_replayed_as_a_measured_and_a_simulated_robot(before):
    time = np.linspace(3.0, 3.2, 21)
    measured = np.outer(time - 3.0, np.arange(6.0))
    simulated = measured + 0.1
    simulated[11:] = np.nan  # broke off
    window = Window("demo", time, measured, simulated)
    found = Rollout((), (window, window), 0.2)
    page = rollout_replay_page(before, found, found)
    recorded = tracks(page)
    frames, turned = recorded["/drake/measured/arm6::column", "quaternion"]
    assert frames == list(range(14))
    assert frames == recorded["/drake/simulated/arm6::flange", "position"][0]
    column = np.array(recorded["/drake/simulated before/arm6::column", "quaternion"][1])
    np.testing.assert_allclose(2 * np.arcsin(column[:7, 2]), 0.1, atol=1e-9)
    flange = np.array(recorded["/drake/simulated/arm6::flange", "position"][1])
    np.testing.assert_array_equal(flange[4:7], flange[[4, 4, 4]])  # it stays where it broke off
    for words in ("measured", "simulated before", "simulated"):
        assert f"</span>{words}</div>" in page
    assert np.ptp(np.array(turned)[:, 2]) < 1e-9  # the first joint stands still


def test_rollout_writes_its_replay(tmp_path):
    out, report = tmp_path / "r.html", tmp_path / "report.html"
    windows = ("--windows", 2, "--horizon", 0.2)
    said = told("rollout", URDF, LOG, *windows, "--meshcat", out, "--report", report)
    assert "Saved the replay of measured and simulated motion: " in said
    link = '<a href="r.html">Replay of measured and simulated motion</a>'
    assert link in report.read_text(encoding="utf-8")
    assert ("/drake/measured/arm6::flange", "position") in tracks(out.read_text())
