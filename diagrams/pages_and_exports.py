"""What the commands of a user take and give: CPU time, sizes of pages, first paint, exports.

Each command runs in a process of its own, as a user starts it, on the demo and on two public logs
of a UR10e. Pages are opened in headless Chromium, if it and playwright are installed. The fitted
models are exported to all formats, and what simulators make of them is compared with the model.

    python diagrams/pages_and_exports.py --json pages.json
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from long_log import MODELS, write_long_log
from public_data import add_folder_option, require
from rich.console import Console
from rich.table import Table

from geodrake import load_model
from geodrake.control.export_proof import export_to
from geodrake.model.exporting.formats import FORMATS

UR10E = ("reference/ur10e.urdf", "data/ur10e_free_a.csv", "data/ur10e_free_b.csv")
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = ("--no-sandbox", "--disable-gpu", "--disable-background-networking")
_PAINT = "performance.getEntriesByName('first-contentful-paint')[0].startTime"
_READY = "performance.getEntriesByType('navigation')[0].domInteractive"


def cpu_seconds(folder: Path, *words: str | Path) -> float:
    """CPU time of a command of `geodrake`, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "geodrake", *map(str, words), "--quiet"],
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        stdout=subprocess.DEVNULL,
        check=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def opened(page: Path) -> dict[str, float]:
    """Time to the first paint and until a page may be used, s; nothing without a browser."""
    path = next(filter(None, [os.environ.get("CHROMIUM"), *map(shutil.which, _BROWSERS)]), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return {}
    if path is None:
        return {}
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=list(_FLAGS))
        tab = browser.new_page(viewport={"width": 1200, "height": 900}, bypass_csp=True)
        tab.goto(page.resolve().as_uri())
        tab.wait_for_function("performance.getEntriesByName('first-contentful-paint').length")
        found = {"first_paint": tab.evaluate(_PAINT) / 1e3, "usable": tab.evaluate(_READY) / 1e3}
        browser.close()
    return found


def measured(
    folder: Path, model: Path, logs: Sequence[Path], formats: Sequence[str], seconds: float
) -> dict[str, Any]:
    """One robot: times, pages, a replay of some seconds, and exports of what `explain` saves."""
    page, saved = folder / "page.html", folder / "robot.yaml"
    explain = cpu_seconds(folder, "explain", model, *logs, "--report", page, "--save", saved)
    replay = ("--out", folder / "play.html", "--seconds", str(seconds))
    play = cpu_seconds(folder, "play", saved, *logs, *replay)
    fitted, exports = load_model(saved), {}
    for name in formats:
        found = export_to(name, fitted, folder / name, logs)
        exports[name] = {
            "simulators": [
                {"name": d.engine, "what": d.what, "largest": d.largest, "of": d.typical}
                for d in found.proof.differences
            ],
            "lacks": [cost.lost.effect for cost in found.lacks],
            "nrms": None if found.costs is None else [found.costs.whole, found.costs.held],
        }
    return {
        "explain, CPU s": explain,
        "page, bytes": page.stat().st_size,
        **{f"page, {key}, s": value for key, value in opened(page).items()},
        "play, CPU s": play,
        "play, bytes": (folder / "play.html").stat().st_size,
        "exports": exports,
    }


def show(name: str, found: dict[str, Any]) -> None:
    """Prints one robot."""
    console, table = Console(width=110), Table(title=f"{name}: exports")
    for key, value in found.items():
        if key != "exports":
            console.print(f"{name}: {key} {value:.3g}")
    for column in ("format", "simulator", "largest difference", "of RMS", "nrms, file holds"):
        table.add_column(column)
    for form, export in found["exports"].items():
        nrms = " -> ".join(f"{x:.4f}" for x in export["nrms"] or ())
        for k, row in enumerate(export["simulators"] or [{}]):
            words = [form, nrms] if not k else ["", ""]
            numbers = [f"{row[key]:.2g}" if row else "" for key in ("largest", "of")]
            said = f"{row['name']}, {row['what']}" if row else "–"
            table.add_row(words[0], said, *numbers, words[1])
    console.print(table)


def draw(found: dict[str, Any], path: Path) -> None:
    """Sizes of the pages."""
    from matplotlib.figure import Figure

    sizes = {
        f"{robot}: {page}": numbers[f"{page}, bytes"] / 1e6
        for robot, numbers in found.items()
        if isinstance(numbers, dict)
        for page in ("page", "play")
    }
    figure = Figure(figsize=(6.4, 1.0 + 0.4 * len(sizes)), layout="constrained")
    axes = figure.subplots()
    axes.bar_label(axes.barh(list(sizes)[::-1], list(sizes.values())[::-1]), fmt="%.2f", padding=3)
    axes.set_xlabel("size, MB")
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.12)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Measures, prints, and writes what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two joints, 8 s, one format")
    parser.add_argument("--seed", type=int, default=0, help="of the log of --quick")
    parser.add_argument("--json", type=Path, help="file for the numbers")
    parser.add_argument("--figures", type=Path, help="folder for the figure")
    add_folder_option(parser)
    options = parser.parse_args()
    if not options.quick:
        require(parser, options.shared, *UR10E)
    found: dict[str, Any] = {}
    formats = ("python",) if options.quick else tuple(FORMATS)
    seconds = 2.0 if options.quick else 30.0  # of replays
    with as_file(files("geodrake") / "demo") as demo, TemporaryDirectory() as name:
        folder = Path(name)
        if not options.quick:
            cpu_seconds(folder, "demo")  # compiles, if that was not done yet
            found["demo, CPU s"] = cpu_seconds(folder, "demo")
        if options.quick:
            model, log = MODELS / "double_pendulum.urdf", folder / "log.npz"
            write_long_log(log, model, samples=8000, seed=options.seed)
            robots = {"pendulum": (model, [log])}
        else:
            model, *logs = (options.shared.resolve() / path for path in UR10E)
            robots = {"demo": (demo / "demo.urdf", [demo / "demo.csv"]), "UR10e": (model, logs)}
        for robot, (model, logs) in robots.items():
            (folder / robot).mkdir()
            found[robot] = measured(folder / robot, model, logs, formats, seconds)
            show(robot, found[robot])
    if options.figures:
        draw(found, options.figures / "pages_and_exports.png")
    if options.json:
        options.json.parent.mkdir(parents=True, exist_ok=True)
        options.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
