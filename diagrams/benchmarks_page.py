"""Make docs/benchmarks.md: its text from `benchmarks.md.jinja`, its figures from `benchmarks.json`.

    python -m diagrams.benchmarks_page                       make the page
    python -m diagrams.benchmarks_page --run fleet_study     run a benchmark by its command first
    python -m diagrams.benchmarks_page --read FOLDER         read FOLDER/fleet_study.json and others

`benchmarks.json` has a command and its figures for each name. `from` is a Jinja expression that
finds a figure in `it`, what the command writes with `--json`. Figures are saved after each run.
"""

from __future__ import annotations

import argparse
import json
import shlex
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from datetime import date
from itertools import groupby
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, TemplateError
from scipy.stats import binomtest

HERE = Path(__file__).parent
FIGURES = HERE / "benchmarks.json"
PAGE = HERE.parent / "docs" / "benchmarks.md"


def shown(value: Any) -> Any:
    """Format a number for the page: integers in full, others with two digits."""
    if isinstance(value, float) and value:
        number = float(f"{value:.2g}")
        return f"{number:,.0f}" if abs(number) >= 10 else f"{number:#.2g}".replace("e-0", "e-")
    return f"{value:,.0f}" if isinstance(value, int | float) else value


def where(rows: Iterable[Mapping[str, Any]], *pairs: Any) -> list[Mapping[str, Any]]:
    """Return the rows with a value of a column, or of several."""
    wanted = list(zip(pairs[::2], pairs[1::2], strict=True))
    return [row for row in rows if all(row[name] == value for name, value in wanted)]


def hits(line: Mapping[str, Any]) -> int:
    """Return the number of successes of a line of shares (`benchmarks/simulated/scoring.py`)."""
    return round(line["value"] * line["logs"])


def of(count: int, total: int) -> str:
    """Format "3 of 4" with the 95 % interval of the share."""
    interval = binomtest(count, total).proportion_ci(0.95, "wilson")
    return f"{count} of {total} ({100 * interval.low:.0f}–{100 * interval.high:.0f} %)"


def environment() -> Environment:
    """Return the Jinja environment, with errors for unknown names, and the template."""
    made = Environment(
        loader=FileSystemLoader(HERE),
        undefined=StrictUndefined,
        finalize=shown,
        keep_trailing_newline=True,
    )
    made.filters |= {"where": where, "hits": hits, "of": of, "median": statistics.median}
    return made


def read(run: Mapping[str, Any], table: Any) -> dict[str, Any]:
    """Return a run with the figures that its command wrote today."""
    pick, figures = environment().compile_expression, {}
    for name, place in run["from"].items():
        try:
            figures[name] = pick(place, undefined_to_none=False)(it=table)
        except (TemplateError, TypeError, ValueError) as error:
            sys.exit(f"{run['command']} wrote no {name}: {place!r} is not there ({error}).")
    return {**run, "measured": date.today().isoformat(), "figures": figures}


def made_page(runs: Mapping[str, Any]) -> str:
    """Return the page, in which runs have their figures by name, their commands and days."""

    def day_of(name: str) -> str:
        return str(runs[name]["measured"])

    told = {
        name: {**run["figures"], "command": f"`{run['command']}`"} for name, run in runs.items()
    }
    days = groupby(sorted(runs, key=day_of), key=day_of)
    return environment().get_template("benchmarks.md.jinja").render(told, measured=days)


def main() -> None:
    """Run benchmarks or read what they wrote, as asked for, and make the page."""
    runs = json.loads(FIGURES.read_text(encoding="utf-8"))
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", nargs="+", choices=runs, default=[], help="run these benchmarks")
    parser.add_argument("--read", type=Path, help="folder of NAME.json that benchmarks wrote")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.read or Path(temporary)
        for name in options.run:
            words = shlex.split(runs[name]["command"])[1:]
            command = [sys.executable, *words, "--json", str(folder / f"{name}.json")]
            subprocess.run(command, check=True)
            keep(runs, name, folder)
        for name in runs if options.read else ():
            if (folder / f"{name}.json").is_file():
                keep(runs, name, folder)
    PAGE.write_text(made_page(runs), encoding="utf-8")


def keep(runs: dict[str, Any], name: str, folder: Path) -> None:
    """Save the figures of a benchmark in `benchmarks.json`."""
    table = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    runs[name] = read(runs[name], table)
    text = json.dumps(runs, indent=1, ensure_ascii=False)
    FIGURES.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
