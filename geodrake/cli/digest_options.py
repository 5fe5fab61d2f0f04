"""Options of digest."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from geodrake.cli.model_options import ModelOptions
from geodrake.cli.options import (
    Debug,
    EffectFiles,
    JsonFile,
    KnownPayloads,
    LogFiles,
    ModelFile,
    Quiet,
)
from geodrake.cli.reading_options import ReadingOptions


@dataclass(frozen=True, kw_only=True)
class DigestOptions(ReadingOptions, ModelOptions):
    """Options of digest."""

    model: ModelFile
    logs: LogFiles
    to: Annotated[
        Path,
        typer.Option(
            metavar="FOLDER",
            help="Folder of the digests, all of logs of robots with this model; made if it is not "
            "there. The first digest writes the settings that all of them share.",
        ),
    ]
    date: Annotated[
        str | None,
        typer.Option(
            metavar="DATE",
            help="When logs were recorded whose time stamps are no dates, such as 2026-05-01 or "
            "2026-05-01T12:00:00+02:00, UTC without a zone; when the file was changed if absent.",
        ),
    ] = None
    effects: EffectFiles = None
    bandwidth: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Bandwidth of the filter of all digests, if the folder has no settings yet; if "
            "absent, that of the model's fit, or chosen from the first log.",
        ),
    ] = None
    blocks: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Blocks that each log is cut into, if the folder has no settings yet; 4 if "
            "absent.",
        ),
    ] = None
    known_payload: KnownPayloads = None
    json: JsonFile = None
    quiet: Quiet = False
    debug: Debug = False
