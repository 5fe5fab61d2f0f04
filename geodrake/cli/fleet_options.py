"""Options of fleet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from geodrake.cli.options import Debug, JsonFile, Quiet, ReportFile


@dataclass(frozen=True, kw_only=True)
class FleetOptions:
    """Options of fleet."""

    fleet: Annotated[
        Path,
        typer.Argument(
            metavar="FLEET.yaml",
            help="Types with a model each, robots with patterns of their logs, and the folder of "
            "digests and results.",
        ),
    ]
    json: JsonFile = None
    report: ReportFile = None
    workers: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Processes of this machine that work; 0 is the command's own, which also works "
            "where Dask is not installed. One on each core if absent.",
        ),
    ] = None
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="A Dask scheduler of your own, such as tcp://10.0.0.5:8786, whose workers see the "
            "same folders.",
        ),
    ] = None
    false_alarms: Annotated[
        float,
        typer.Option(
            metavar="RATE",
            help="At most how many robots in which nothing changed are named, a robot-month.",
        ),
    ] = 0.01
    watch: Annotated[
        bool,
        typer.Option(
            "--watch",
            help="Go on, and take in new logs as they come: each new finding is a line of JSON on "
            "standard output.",
        ),
    ] = False
    every: Annotated[
        float, typer.Option(metavar="SECONDS", help="Time between two looks for new logs.")
    ] = 60.0
    once: Annotated[
        bool,
        typer.Option(
            "--once",
            help="Look once and say what a watch would; exit code 3 if there is a new finding, "
            "for a cron job.",
        ),
    ] = False
    quiet: Quiet = False
    debug: Debug = False
