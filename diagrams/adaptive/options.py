"""What the scripts of adaptive control have in common on the command line."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from resumable.draws import results_of
from rich.console import Console
from rich.table import Table

VERSION = 2
"""Of what a draw is; one more when kept draws of older versions must not be used."""


def whole_number(text: str) -> int:
    """A whole number from zero on, of the command line."""
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"{number} is below zero")
    return number


def positive_number(text: str) -> int:
    """A whole number from one on, of the command line."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is below one")
    return number


def make_parser(doc: str) -> argparse.ArgumentParser:
    """A parser with the options that all of them have."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few and short draws")
    parser.add_argument("--seed", type=whole_number, default=0)
    jobs = min(2, os.cpu_count() or 1)
    parser.add_argument("--jobs", type=positive_number, default=jobs, help="processes")
    parser.add_argument("--cache", type=Path, help="file of draws (beside that of --json)")
    parser.add_argument("--json", type=Path, help="write the table here")
    parser.add_argument("--figures", type=Path, help="write figures into this folder")
    return parser


def add_gains(parser: argparse.ArgumentParser, default: str = "rule") -> None:
    """Options of how fast laws are."""
    parser.add_argument(
        "--gains",
        choices=("rule", "source"),
        default=default,
        help="adaptation speeds: by one rule for all laws, or of [Lee2019] §5.5 (%(default)s)",
    )
    parser.add_argument(
        "--choose-gains", action="store_true", help="apply that rule, and say what it chooses"
    )


def run_draws(
    parser: argparse.ArgumentParser,
    options: argparse.Namespace,
    task: Callable[..., Any],
    draws: Sequence[Any],
) -> list[Any]:
    """Results of all draws; `task` is called with a draw and the seed."""
    cache = options.cache
    if cache is None and options.json is not None:
        cache = options.json.with_suffix(".draws.jsonl")
    if cache is not None:
        cache.parent.mkdir(parents=True, exist_ok=True)
    key = {"version": VERSION, "study": Path(parser.prog).stem, "seed": options.seed}
    try:
        return results_of(
            partial(task, seed=options.seed), draws, key=key, cache=cache, workers=options.jobs
        )
    except KeyboardInterrupt:
        where = f"Finished draws are in {cache}; the same command goes on." if cache else ""
        parser.exit(130, f"Interrupted. {where}\n")


def write_json(path: Path | None, table: Mapping[str, Any]) -> None:
    """Writes the table of a study, if it is asked for."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(table, indent=1), encoding="utf-8")


def show(console: Console, title: str, columns: Mapping[str, str], lines: Sequence[Any]) -> None:
    """Prints columns of lines, each with a format such as ".2f" or "%"."""
    table = Table(*columns, title=title, title_justify="left")
    for line in lines:
        table.add_row(*(_shown(line.get(name), form) for name, form in columns.items()))
    console.print(table)


def _shown(value: Any, form: str) -> str:
    return "–" if value is None else format(value, form)
