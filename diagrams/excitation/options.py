"""What the studies of excitation have in common on the command line."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

MODELS = Path(__file__).parents[2] / "models"


def study_parser(description: str) -> argparse.ArgumentParser:
    """A parser with the options of every study."""
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few seconds, for a first look")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the table here")
    parser.add_argument("--figures", type=Path, help="write figures into this folder")
    return parser


def write_table(path: Path | None, table: dict[str, Any]) -> None:
    """Writes the numbers of a study, if they were asked for."""
    if path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


def cache_beside(path: Path | None) -> Path | None:
    """File of finished designs beside that of a table."""
    return path and path.with_suffix(".designs.jsonl")
