"""Options of the commands of excitation: excite and identifiable."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from geodrake.cli.options import Options

_NOISE_HELP = "Deviation of the {what}, N·m or N: one number, or JOINT=NUMBER,…; {default}."


@dataclass(frozen=True, kw_only=True)
class IdentifiableOptions(Options):
    """What identifiable is told."""

    threshold: Annotated[
        float,
        typer.Option(
            metavar="VARIANCE",
            help="Largest relative variance of what counts as told; 0.01 is a deviation of 10 %.",
        ),
    ] = 1e-2
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="NOISE",
            help=_NOISE_HELP.format(
                what="filtered efforts",
                default="what the refitted model leaves on held-out data if absent",
            ),
        ),
    ] = None
    effects: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="NAME,…|FILE.py",
            help="Effects to tell beside the model's, such as viscous_friction,coulomb_friction "
            "or payload@BODY; a FILE.py brings effects that may be named. Repeatable.",
        ),
    ] = None
