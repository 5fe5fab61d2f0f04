"""Options of export."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from geodrake.cli.model_options import ModelOptions
from geodrake.cli.options import Debug, EffectFiles, JsonFile, ModelFile, Quiet, ReportFile
from geodrake.cli.reading_options import ReadingOptions


@dataclass(frozen=True, kw_only=True)
class ExportOptions(ReadingOptions, ModelOptions):
    """Options of export."""

    model: ModelFile
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="LOG",
            help="Logs on whose motion what the format lacks is fitted, and the error that it "
            "costs is measured; without any, random motion within the robot's limits serves.",
        ),
    ] = None
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder of the files; made if it is not there.")
    ]
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="urdf, sdf, mjcf, drake (with model directives), isaac (a URDF, and values of "
            "actuators), python, cpp (a function effort(q, v, vd)), ros2 (a controller of "
            "ros2_control); an unknown name lists them.",
        ),
    ]
    force: Annotated[
        bool, typer.Option("--force", help="Replace files of these names that are there.")
    ] = False
    json: JsonFile = None
    report: ReportFile = None
    quiet: Quiet = False
    effects: EffectFiles = None
    bandwidth: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Bandwidth of the filter of logs; if absent, that of the model's fit to the same "
            "logs, or chosen from the data.",
        ),
    ] = None
    debug: Debug = False
