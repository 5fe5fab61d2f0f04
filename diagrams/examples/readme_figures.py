"""The figures of the README and the tutorial: the demo's error, and its pages.

With `--pages` also the pages of commands, as Chromium draws them. Run it as
`python -m diagrams.examples.readme_figures --pages --figures docs/figures`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.resources import as_file, files
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

from diagrams.harness import first_samples, script_parser, write
from geodrake import load_model, save_model
from geodrake.diagnosis import Explanation, explain
from geodrake.logs.files import read_log
from geodrake.report import figures_of, page_of, save_figures

ROOT = Path(__file__).parents[2]


def explain_demo(*, quick: bool) -> Explanation:
    """Return the findings of `geodrake demo`; if quick, of the first 6 s of its log."""
    with as_file(files("geodrake") / "demo") as demo:
        log = read_log(demo / "demo.csv")
        if quick:
            log = first_samples(log, 1200)
        return explain(load_model(demo / "demo.urdf"), [log])


def pictures_of_pages(found: Explanation, folder: Path) -> None:
    """Draw the pages that commands write about the demo and its fitted model."""
    with as_file(files("geodrake") / "demo") as demo, TemporaryDirectory() as work:
        model, log, saved = demo / "demo.urdf", demo / "demo.csv", Path(work) / "arm.yaml"
        save_model(found.model, saved)
        before = ("--before", model, "--horizon", "0.2")
        for name, words, size in (
            ("play", ("play", saved, log, "--ghost", "0.2", "--out"), (1200, 760)),
            ("page", ("explain", model, log, "--report"), (1280, 1210)),
            ("compare", ("compare", model, log, "--report"), (1280, 1060)),
            ("excite", ("excite", saved, "--report"), (1280, 1100)),
            ("rollout", ("rollout", saved, log, *before, "--report"), (1280, 900)),
        ):
            page = Path(work) / f"{name}.html"
            command = [sys.executable, "-m", "geodrake", *map(str, (*words, page)), "--quiet"]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            _picture(page, folder / f"demo_{name}.png", size)


def _picture(page: Path, path: Path, size: tuple[int, int]) -> None:
    """Draw a page as Chromium shows it."""
    from playwright.sync_api import sync_playwright

    browsers = (os.environ.get("CHROMIUM"), shutil.which("chromium"), shutil.which("google-chrome"))
    flags = ["--no-sandbox", "--disable-background-networking", "--enable-unsafe-swiftshader"]
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=next(filter(None, browsers)), args=flags)
        tab = browser.new_page(viewport={"width": size[0], "height": size[1]})
        tab.goto(page.as_uri())
        tab.wait_for_timeout(4000)  # until meshes are there and the robots have moved
        tab.screenshot(path=path)
        browser.close()
    smaller = Image.open(path).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    smaller.save(path, optimize=True)


def main() -> None:
    """Draw the figures."""
    parser = script_parser(__doc__, "6 s of the log", figures=True)
    parser.set_defaults(figures=ROOT / "docs" / "figures")
    parser.add_argument("--pages", action="store_true", help="pictures of pages, too")
    options = parser.parse_args()
    found = explain_demo(quick=options.quick)
    steps = figures_of(page_of(found))["steps"]
    for path in save_figures({"demo_steps": steps}, options.figures):
        print(path)
    if options.pages:
        pictures_of_pages(found, options.figures)
    fallen = [{"effect": s.effect, "nrms": s.error_after} for s in found.steps]
    write(options, {"start": found.start.nrms, "steps": fallen})


if __name__ == "__main__":
    main()
