"""Options of check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import typer

from geodrake.cli.model_options import ModelOptions
from geodrake.cli.options import Debug, EffectFiles, JsonFile, ModelFile, Quiet


@dataclass(frozen=True, kw_only=True)
class CheckOptions(ModelOptions):
    """Options of check."""

    model: ModelFile
    samples: Annotated[
        int, typer.Option(metavar="N", help="Random states, within the limits of the robot.")
    ] = 100
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the random numbers.")] = 0
    effects: EffectFiles = None
    json: JsonFile = None
    quiet: Quiet = False
    debug: Debug = False
