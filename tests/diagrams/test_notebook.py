"""The notebook runs from its first cell to its last, and shows what it says."""

import json
import warnings
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "diagrams").glob("*.ipynb"))


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_cells_run(notebook, tmp_path, monkeypatch):
    """Each code cell in one namespace, in the notebook's folder as far as models go."""
    (tmp_path / "diagrams").mkdir()
    (tmp_path / "models").symlink_to(notebook.parents[1] / "models")
    monkeypatch.chdir(tmp_path / "diagrams")
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    assert all(not cell.get("outputs") for cell in cells), "strip the outputs"
    names = {"__name__": "__main__"}
    with mpl.rc_context({"backend": "agg"}), warnings.catch_warnings():
        warnings.simplefilter("error")
        for number, cell in enumerate(cells):
            if cell["cell_type"] == "code":
                source = "".join(cell["source"]).replace("plt.show()", f"figure({number})")
                names["figure"] = lambda k: (plt.savefig(f"figure_{k}.png"), plt.close("all"))
                exec(compile(source, f"{notebook.name} cell {number}", "exec"), names)
    late = names["late"]
    assert late["natural"] < 0.2 * late["no adaptation"]
    shares = {name: names["share_unphysical"](logs) for name, logs in names["runs"].items()}
    assert shares["natural"] == 0.0
    assert shares["Euclidean"] > 0.3
    assert (tmp_path / "diagrams" / "adaptive_loop.html").stat().st_size > 100_000
