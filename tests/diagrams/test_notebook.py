"""Notebooks run from the first cell to the last, and contain the outputs of such a run."""

import json
import warnings
from functools import cache
from importlib.resources import files
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
from meshcat_pages import tracks

from geodrake import diagnosis, load_model
from geodrake.logs import read_log

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "diagrams" / "examples"
CELLS = {
    path.stem: json.loads(path.read_text(encoding="utf-8"))["cells"]
    for path in sorted(NOTEBOOKS.glob("*.ipynb"))
}


@cache
def explained():
    """Explain the demo's log, with which several notebooks begin."""
    demo = files("geodrake") / "demo"
    return diagnosis.explain(load_model(demo / "demo.urdf"), [read_log(demo / "demo.csv")])


@pytest.fixture
def explain_once(monkeypatch):
    """Explain the demo once a process."""
    explain, first = diagnosis.explain, explained()

    def found(model, logs, **options):
        same = [log.fingerprint for log in logs] == list(first.model.fitted_to)
        if same and not options and not model.effects:
            return first
        return explain(model, logs, **options)

    monkeypatch.setattr(diagnosis, "explain", found)


@pytest.fixture
def names_after(tmp_path, monkeypatch):
    """Return a function that runs the cells of a notebook and returns its names."""
    (tmp_path / "diagrams" / "examples").mkdir(parents=True)
    (tmp_path / "models").symlink_to(ROOT / "models")
    monkeypatch.chdir(tmp_path / "diagrams" / "examples")
    monkeypatch.delenv("GEODRAKE_MEASUREMENTS", raising=False)  # the logs that come with geodrake

    def run(notebook):
        names = {"__name__": "__main__"}
        with mpl.rc_context({"backend": "agg"}), warnings.catch_warnings():
            warnings.simplefilter("error")
            for number, cell in enumerate(CELLS[notebook]):
                if cell["cell_type"] == "code":
                    source = "".join(cell["source"]).replace("plt.show()", f"shown_({number})")
                    names["shown_"] = lambda k: (plt.savefig(f"figure_{k}.png"), plt.close("all"))
                    exec(compile(source, f"{notebook} cell {number}", "exec"), names)
        left = [path for path in Path.cwd().iterdir() if not path.name.startswith("figure_")]
        assert not left, "a notebook leaves nothing in its folder"
        return names

    return run


@pytest.mark.parametrize("notebook", CELLS)
def test_outputs_are_those_of_one_run_from_top_to_bottom(notebook):
    code = [cell for cell in CELLS[notebook] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert all(output["output_type"] != "error" for output in outputs)


def test_a_log_is_explained_and_the_model_kept(names_after, explain_once):
    names = names_after("explain_a_log")
    assert names["explanation"].verdict == "explained"
    assert names["again"].errors.nrms < 0.02 * names["before"].errors.nrms


def test_a_user_effect_explains_the_log(names_after, explain_once):
    found = names_after("an_effect_of_your_own")["found"]
    assert [step.effect for step in found.steps] == ["spring_over_two_joints"]
    (values,) = found.steps[0].parameters.values()
    assert values["stiffness"] == pytest.approx(6.0, abs=0.05)


def test_a_designed_motion_identifies_more(names_after):
    names = names_after("which_motion_next")
    assert names["best"] < 0.1 * names["first"]


def test_distances_between_bodies_help_where_samples_are_few(names_after):
    names = names_after("regularizers")
    assert names["rms"]["entropic"] < min(names["rms"]["model file"], names["rms"]["least squares"])
    assert (names["least"] < 0).any()


def test_an_adaptive_loop_stays_physical(names_after):
    names = names_after("adaptive_loop")
    late = names["late"]
    assert late["natural"] < 0.2 * late["no adaptation"]
    shares = {name: names["share_unphysical"](logs) for name, logs in names["runs"].items()}
    assert shares["natural"] == 0.0
    assert shares["Euclidean"] > 0.3
    assert names["page"].stat().st_size > 100_000
    names["page"].unlink()


def test_the_fitted_model_falls_differently_from_its_file(names_after, explain_once):
    names = names_after("fitted_model_in_simulation")
    assert len(names["fitted"].effects) == 5
    assert abs(names["by_file"][-1, 2] - names["by_fit"][-1, 2]) > 0.1
    assert tracks(names["meshcat"].StaticHtml())  # the fall, recorded
