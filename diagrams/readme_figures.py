"""The figures of the README: the demo's efforts before and after, and the error falling.

Run it as `python diagrams/readme_figures.py --figures diagrams/figures`.
"""

from __future__ import annotations

import argparse
import json
from importlib.resources import as_file, files
from pathlib import Path

from geodrake import load_model
from geodrake.diagnosis import Explanation, explain
from geodrake.report import effort_figure, save_figures, step_figure

ROOT = Path(__file__).parents[1]


def explain_demo() -> Explanation:
    """What `geodrake demo` finds."""
    with as_file(files("geodrake") / "demo") as demo:
        return explain(load_model(demo / "demo.urdf"), [demo / "demo.csv"])


def main() -> None:
    """Draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the same: it takes seconds")
    parser.add_argument("--seed", type=int, default=0, help="nothing here is random")
    parser.add_argument("--json", type=Path, help="write the held-out errors here")
    parser.add_argument("--figures", type=Path, default=ROOT / "diagrams" / "figures")
    options = parser.parse_args()
    found = explain_demo()
    figures = {
        "demo_efforts": effort_figure(found.before, after=found.after, most=3),
        "demo_steps": step_figure(found),
    }
    for path in save_figures(figures, options.figures):
        print(path)
    if options.json:
        steps = [{"effect": s.effect, "nrms": s.error_after} for s in found.steps]
        options.json.write_text(json.dumps({"start": found.start.nrms, "steps": steps}, indent=1))


if __name__ == "__main__":
    main()
