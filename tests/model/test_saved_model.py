"""Saved models: they come back as they were, move with their base file and without, or say why."""

import shutil
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from every_effect import EFFECTS, LEFT_OUT
from servo_logs import PENDULUM, servo_log
from typer.testing import CliRunner

from geodrake import load_model
from geodrake.cli.app import app
from geodrake.diagnosis import compare, explain
from geodrake.effects import (
    FittedEffect,
    ViscousFriction,
    load_effect_file,
)
from geodrake.errors import ModelError
from geodrake.logs.motion import Motion
from geodrake.model import EffortSignal
from geodrake.model.saved_model import save_model

MODELS = Path(__file__).parents[2] / "models"
DEMO = Path(str(files("geodrake") / "demo" / "demo.urdf"))
HOSE = """
from dataclasses import dataclass
import numpy as np
from geodrake.effects import JointEffect, Parameter


@dataclass(frozen=True)
class HangingHose(JointEffect):
    name = "hanging_hose"
    parameters = (Parameter("cosine", "N·m"), Parameter("sine", "N·m"))

    def columns(self, joint):
        return [np.cos(joint.q), np.sin(joint.q)]
"""


@pytest.fixture
def fitted(tmp_path):
    """A model with all kinds of effects, whose base file lies in a folder of its own."""
    base = tmp_path / "robot" / "arm6.urdf"
    base.parent.mkdir()
    shutil.copy(MODELS / "arm6.urdf", base)
    model, rng = load_model(base), np.random.default_rng(3)
    effects = [
        FittedEffect(effect, np.array(values) / 3, rng.uniform(size=len(values)))
        for effect, values in (*EFFECTS, *LEFT_OUT)
    ]
    p = model.phi.size + sum(len(e.parameters) for e in effects)
    root = rng.normal(size=(p, p))
    fading = np.array([0.0, 0.01, 1 / 3, 0.0, 0.0, 0.0])
    signal = EffortSignal(model.joints[0], "current", np.float64(0.7), deviation=np.float64(0.1))
    known = {"bandwidths": {"abc": (3.0, np.float64(10 / 3))}, "effort_signals": (signal,)}
    return replace(model, fading_speed=fading, **known).with_fit(
        model.phi * rng.uniform(1.0, 1.1, (len(model.bodies), 1)),
        effects,
        information=root @ root.T,
        effort_noise=rng.uniform(size=len(model.joints)),
    )


@pytest.fixture
def saved(fitted, tmp_path):
    path = tmp_path / "fitted.yaml"
    save_model(fitted, path)
    return path


def test_comes_back_exactly(fitted, saved, tmp_path):
    again = load_model(saved)
    assert [f.effect for f in again.effects] == [f.effect for f in fitted.effects]
    for before, after in zip(fitted.effects, again.effects, strict=True):
        np.testing.assert_array_equal(after.parameters, before.parameters)
        np.testing.assert_array_equal(after.deviations, before.deviations)
    for name in ("phi", "total_phi", "information", "effort_noise", "fading_speed", "delays"):
        np.testing.assert_array_equal(getattr(again, name), getattr(fitted, name))
    for name in ("bandwidths", "effort_signals", "notes"):
        assert getattr(again, name) == getattr(fitted, name)
    shapes = {f.effect.name: f.effect.shape for f in again.effects}
    assert isinstance(shapes["coupled_friction"]["sign"], int)  # whole, as it is not to be fitted
    assert isinstance(shapes["joint_spring"]["exponent"], int)
    motion = Motion(*np.random.default_rng(4).normal(size=(3, 50, 6)))
    np.testing.assert_array_equal(again.effort(motion), fitted.effort(motion))
    save_model(again, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == saved.read_text()


def test_an_unfitted_floating_model_stays_so(tmp_path):
    path = tmp_path / "free.yaml"
    save_model(load_model(MODELS / "double_pendulum.urdf", floating=True), path)
    again = load_model(path)
    assert again.plant.num_velocities() == 8 and again.effects == ()
    assert again.information is again.effort_noise is again.fading_speed is None


def test_models_of_before_are_read(fitted, saved):
    """A file without what later versions write; other fields are as it says."""
    lines = saved.read_text().splitlines(keepends=True)
    later = ("motorless:", "leading:", "bandwidths:", "  abc:")
    saved.write_text("".join(line for line in lines if not line.startswith(later)))
    again = load_model(saved)
    assert (
        again.motorless == () and not again.bandwidths and len(again.effects) == len(fitted.effects)
    )


def test_a_base_that_changed_is_noted_and_another_robot_refused(fitted, saved):
    fitted.path.write_text(fitted.path.read_text() + "<!-- touched -->\n")
    assert load_model(saved).notes[-1] == "arm6.urdf has changed since the model was saved."
    shutil.copy(MODELS / "arm7.urdf", fitted.path)
    with pytest.raises(ModelError, match=r"does not match its base model.*Fit and save"):
        load_model(saved)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("floating: false", "floating: [", "is not a geodrake model"),
        (
            "floating: false",
            "floating: maybe",
            "is not a geodrake model: floating = maybe: expected",
        ),
        ("name: viscous_friction", "name: viscous_fiction", "viscous_friction"),
        ("name: viscous_friction", "name: hanging_hose", r"'hanging_hose', which.*--effects FILE"),
        ("[base_yaw]", "[base_jaw]", "base_jaw"),
        ("sign: -1", "sign: -2", "sign 1 or −1"),
        (
            "parameters: [",
            "parameters: [x, ",
            r"effects\[0\]\.parameters\[0\] = x: expected a number",
        ),
        ("parameters: [", "parmeters: [", r"field 'parmeters' \(was parameters meant\?\)"),
        ("pitch: 0.01\n", "pitch: .nan\n", "fading_speed"),
    ],
)
def test_corrupted_file_is_refused(saved, old, new, words):
    text = saved.read_text()
    assert old in text
    saved.write_text(text.replace(old, new, 1))
    with pytest.raises(ModelError, match=words):
        load_model(saved)


def test_what_does_not_fit_together_is_refused(fitted, saved):
    text = saved.read_text()
    for share in (0.2, 0.9):
        saved.write_text(text[: int(share * len(text))])
        with pytest.raises(ModelError):
            load_model(saved)
    save_model(replace(fitted, effects=fitted.effects[1:]), saved)  # with a row too many
    with pytest.raises(ModelError, match="information matrix"):
        load_model(saved)
    signals = (EffortSignal(fitted.joints[0], kind, 1.0) for kind in ("effort", "current"))
    save_model(replace(fitted, effort_signals=tuple(signals)), saved)
    with pytest.raises(ModelError, match=f"two signals for efforts of '{fitted.joints[0]}'"):
        load_model(saved)


def test_a_log_of_a_servo_is_known_again(tmp_path):
    """Its efforts are other ones by the fitted model: what was measured is what the model knows."""
    path = tmp_path / "pendulum.urdf"
    path.write_text(PENDULUM)
    log = servo_log(integral=90.0)
    found = explain(load_model(path), [log])
    save_model(found.model, tmp_path / "model.yaml")
    again = load_model(tmp_path / "model.yaml")
    assert again.fitted_to == (log.fingerprint,)
    notes = " ".join(compare(again, [log]).notes)
    assert "of the model's fit" in notes and "was fitted to servo before" in notes


class TestMovedFiles:
    """A saved model in one folder, whose base file is in another one."""

    @pytest.fixture
    def moving(self, tmp_path):
        base = tmp_path / "robots" / "arm.urdf"
        base.parent.mkdir()
        shutil.copy(DEMO, base)
        model = load_model(base)
        friction = FittedEffect(ViscousFriction(model.joints[0]), np.array([2.0]))
        path = tmp_path / "fits" / "arm.yaml"
        path.parent.mkdir()
        save_model(replace(model, phi=1.1 * model.phi, effects=(friction,)), path)
        return path

    @pytest.mark.parametrize("way", ["together", "into one folder", "alone", "beside another"])
    def test_the_base_is_found(self, way, moving, tmp_path, monkeypatch):
        path, base = moving, tmp_path / "robots" / "arm.urdf"
        (tmp_path / "new").mkdir()
        if way == "together":
            for folder in ("fits", "robots"):
                (tmp_path / folder).rename(tmp_path / "new" / folder)
            path, base = tmp_path / "new/fits/arm.yaml", tmp_path / "new/robots/arm.urdf"
        elif way == "into one folder":
            path, base = (
                moving.rename(tmp_path / "new/arm.yaml"),
                base.rename(tmp_path / "new/arm.urdf"),
            )
        elif way == "alone":
            path = moving.rename(tmp_path / "new/other.yaml")
        else:  # which is not the one that it was fitted to
            path = Path(shutil.copy(moving, tmp_path / "new/arm.yaml"))
            text = DEMO.read_text().replace('"2.6"', '"2.7"')
            (tmp_path / "new/arm.urdf").write_text(text + "<!-- -->")
        monkeypatch.chdir(path.parent)
        for name in (path, path.name):
            model = load_model(name)
            assert model.path.resolve() == base.resolve()
            np.testing.assert_allclose(model.phi, 1.1 * load_model(DEMO).phi)
            assert not any("changed" in note for note in model.notes)

    def test_a_base_that_is_gone(self, moving, tmp_path):
        (tmp_path / "robots" / "arm.urdf").unlink()
        with pytest.raises(ModelError, match=r"is based on '\.\./robots/arm\.urdf'") as caught:
            load_model(moving)
        assert "beside the saved model" in caught.value.advice
        assert caught.value.evidence["base"].resolve() == tmp_path / "robots" / "arm.urdf"


class TestOwnEffects:
    @pytest.fixture
    def folder(self, tmp_path, monkeypatch):
        (tmp_path / "my hose.py").write_text(HOSE, encoding="utf-8")
        shutil.copy(DEMO, tmp_path / "arm.urdf")
        (hose,) = load_effect_file(tmp_path / "my hose.py")
        model = load_model(tmp_path / "arm.urdf")
        own = FittedEffect(hose(model.joints[0]), np.array([1.0, 2.0]))
        save_model(replace(model, effects=(own,)), tmp_path / "arm.yaml")
        again = load_model(tmp_path / "arm.yaml", extra=[hose])
        assert again.effects[0].effect == own.effect
        monkeypatch.chdir(tmp_path)
        return tmp_path

    def test_their_file_is_named_where_it_is(self, folder, monkeypatch):
        with pytest.raises(ModelError) as caught:
            load_model(folder / "arm.yaml")
        assert "'hanging_hose', of the class HangingHose" in caught.value.problem
        assert "--effects 'my hose.py'" in caught.value.advice
        (folder / "elsewhere").mkdir()
        monkeypatch.chdir(folder / "elsewhere")
        with pytest.raises(ModelError) as caught:
            load_model("../arm.yaml")
        assert "--effects '../my hose.py'" in caught.value.advice
        (folder / "my hose.py").unlink()
        with pytest.raises(ModelError) as caught:
            load_model("../arm.yaml")
        assert "which was 'my hose.py': --effects FILE.py" in caught.value.advice

    def test_the_advice_works(self, folder):
        log = str(DEMO.with_suffix(".csv"))
        refused = CliRunner().invoke(app, ["compare", "arm.yaml", log])
        assert refused.exit_code == 2
        taken = CliRunner().invoke(app, ["compare", "arm.yaml", log, "--effects", "my hose.py"])
        assert taken.exit_code == 0, taken.output

    def test_nothing_is_run_unasked(self, folder):
        (folder / "my hose.py").write_text("open('RUN', 'w')", encoding="utf-8")
        with pytest.raises(ModelError):
            load_model("arm.yaml")
        assert not (folder / "RUN").exists()
