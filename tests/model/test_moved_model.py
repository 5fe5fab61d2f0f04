"""Saved models that move, with their base file and without, and effects of the user's own."""

import shutil
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from geodrake import load_model, save_model
from geodrake.cli.app import app
from geodrake.effects import FittedEffect, ViscousFriction, load_effect_file
from geodrake.errors import ModelError

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
def saved(tmp_path):
    """A saved model in one folder, whose base file is in another one."""
    base = tmp_path / "robots" / "arm.urdf"
    base.parent.mkdir()
    shutil.copy(DEMO, base)
    model = load_model(base)
    friction = FittedEffect(ViscousFriction(model.joints[0]), np.array([2.0]))
    path = tmp_path / "fits" / "arm.yaml"
    path.parent.mkdir()
    save_model(replace(model, phi=1.1 * model.phi, effects=(friction,)), path)
    return path


def is_that_model(path, base):
    model = load_model(path)
    assert model.path.resolve() == base.resolve()
    np.testing.assert_allclose(model.phi, 1.1 * load_model(DEMO).phi)
    assert not any("changed" in note for note in model.notes)


def test_both_move_together(saved, tmp_path):
    shutil.copytree(tmp_path / "fits", tmp_path / "there" / "fits")
    shutil.copytree(tmp_path / "robots", tmp_path / "there" / "robots")
    for folder in ("fits", "robots"):
        shutil.rmtree(tmp_path / folder)
    is_that_model(tmp_path / "there/fits/arm.yaml", tmp_path / "there/robots/arm.urdf")


def test_both_move_into_one_folder(saved, tmp_path):
    (tmp_path / "new").mkdir()
    saved.rename(tmp_path / "new" / "arm.yaml")
    (tmp_path / "robots" / "arm.urdf").rename(tmp_path / "new" / "arm.urdf")
    is_that_model(tmp_path / "new" / "arm.yaml", tmp_path / "new" / "arm.urdf")


def test_the_saved_model_moves_alone(saved, tmp_path):
    (tmp_path / "far" / "away").mkdir(parents=True)
    saved.rename(tmp_path / "far" / "away" / "other.yaml")
    is_that_model(tmp_path / "far/away/other.yaml", tmp_path / "robots" / "arm.urdf")


def test_another_file_of_that_name_is_not_taken(saved, tmp_path):
    """A copy beside another arm.urdf is still of the one that it was fitted to."""
    shutil.copy(saved, tmp_path / "arm.yaml")
    (tmp_path / "arm.urdf").write_text(DEMO.read_text().replace('"2.6"', '"2.7"') + "<!-- -->")
    is_that_model(tmp_path / "arm.yaml", tmp_path / "robots" / "arm.urdf")


def test_from_another_working_directory(saved, tmp_path, monkeypatch):
    monkeypatch.chdir(saved.parent)
    is_that_model(Path("arm.yaml"), tmp_path / "robots" / "arm.urdf")
    monkeypatch.chdir(tmp_path / "robots")
    is_that_model(Path("../fits/arm.yaml"), tmp_path / "robots" / "arm.urdf")


def test_a_base_that_is_gone(saved, tmp_path):
    (tmp_path / "robots" / "arm.urdf").unlink()
    with pytest.raises(ModelError, match=r"is based on '\.\./robots/arm\.urdf'") as caught:
        load_model(saved)
    assert "beside the saved model" in caught.value.advice


class TestOwnEffects:
    @pytest.fixture
    def folder(self, tmp_path, monkeypatch):
        (tmp_path / "my hose.py").write_text(HOSE, encoding="utf-8")
        shutil.copy(DEMO, tmp_path / "arm.urdf")
        (hose,) = load_effect_file(tmp_path / "my hose.py")
        model = load_model(tmp_path / "arm.urdf")
        own = FittedEffect(hose(model.joints[0]), np.array([1.0, 2.0]))
        save_model(replace(model, effects=(own,)), tmp_path / "arm.yaml")
        monkeypatch.chdir(tmp_path)
        return tmp_path

    def test_their_file_is_named(self, folder):
        with pytest.raises(ModelError) as caught:
            load_model(folder / "arm.yaml")
        assert "'hanging_hose', of the class HangingHose" in caught.value.problem
        assert "--effects 'my hose.py'" in caught.value.advice

    def test_their_file_is_named_where_it_is(self, folder, monkeypatch):
        (folder / "elsewhere").mkdir()
        monkeypatch.chdir(folder / "elsewhere")
        with pytest.raises(ModelError) as caught:
            load_model("../arm.yaml")
        assert "--effects '../my hose.py'" in caught.value.advice

    def test_a_file_that_is_gone_is_named(self, folder):
        (folder / "my hose.py").unlink()
        with pytest.raises(ModelError) as caught:
            load_model("arm.yaml")
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
