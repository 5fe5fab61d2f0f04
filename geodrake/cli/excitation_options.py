"""Options of the commands of excitation: excite and identifiable."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from geodrake.cli.model_options import ModelOptions
from geodrake.cli.options import (
    Debug,
    EffectNames,
    JsonFile,
    ModelFile,
    Quiet,
    ReportFile,
    ValidationOptions,
)

_NOISE_HELP = "Deviation of the {what}, N·m or N: one number, or JOINT=NUMBER,…; {default}."


@dataclass(frozen=True, kw_only=True)
class IdentifiableOptions(ValidationOptions):
    """Options of identifiable."""

    threshold: Annotated[
        float,
        typer.Option(
            metavar="VARIANCE",
            help="Largest relative variance of what counts as identifiable; 0.01 is a deviation "
            "of 10 %.",
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
    effects: EffectNames = None


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Which motions excite chooses from."""

    trajectory: Annotated[
        str,
        typer.Option(
            metavar="FAMILY",
            help="fourier, spline, or free: samples that need not follow each other, the best that "
            "any motion could do.",
        ),
    ] = "fourier"
    duration: Annotated[float, typer.Option(metavar="SECONDS", help="Length of the motion.")] = 10.0
    harmonics: Annotated[
        int | None, typer.Option(metavar="N", help="Harmonics of a Fourier motion; 5 if absent.")
    ] = None
    frequency: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Base frequency of a Fourier motion; once in its length if absent, and three "
            "times with --tell-apart, so that every block of the log shows the difference.",
        ),
    ] = None
    points: Annotated[
        int | None,
        typer.Option(metavar="N", help="Control points of a spline motion; 16 if absent."),
    ] = None
    samples: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Samples by which information is counted; 300 if absent, or 50 free ones.",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class _Robot:
    """What excite may do with the robot."""

    limits: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LIMIT,…",
            help="Limits in place of the model file's: 0.5 for half of all of them, "
            "velocity=1.5 or velocity=50% for all joints, JOINT.position=-1:0.5 for one; also "
            "acceleration and effort, and current, voltage and pwm of models fitted to such logs. "
            "Repeatable.",
        ),
    ] = None
    start: Annotated[
        str | None,
        typer.Option(
            metavar="POSITION", help="Where the motion starts: one number, or JOINT=NUMBER,…"
        ),
    ] = None
    clearance: Annotated[
        float,
        typer.Option(metavar="METRES", help="Least distance of the robot from itself."),
    ] = 0.01
    collisions: Annotated[
        bool,
        typer.Option(
            "--collisions/--no-collisions",
            help="Whether the collision geometry of the file counts.",
        ),
    ] = True
    floor: Annotated[
        bool,
        typer.Option(
            "--floor/--no-floor",
            help="Whether nothing may go below the base, as on a table or a floor. A robot that "
            "hangs below its base where it starts has none.",
        ),
    ] = True


@dataclass(frozen=True, kw_only=True)
class _Choosing:
    """How excite judges motions and looks for the best one."""

    criterion: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="e_optimality, a_optimality, d_optimality or condition_number.",
        ),
    ] = "e_optimality"
    normalization: Annotated[
        str, typer.Option(metavar="NAME", help="geometric, diagonal or none.")
    ] = "geometric"
    noise: Annotated[
        str | None,
        typer.Option(
            metavar="NOISE",
            help=_NOISE_HELP.format(
                what="measured efforts",
                default="what the model's last fit left, or 1 % of the limits of effort, if absent",
            ),
        ),
    ] = None
    seeds: Annotated[int, typer.Option(metavar="N", help="Random motions to start from.")] = 3
    seed: Annotated[int, typer.Option(metavar="N", help="Number of the first of them.")] = 0
    seconds: Annotated[
        float, typer.Option(metavar="SECONDS", help="Most time for the whole search.")
    ] = 180.0
    iterations: Annotated[
        int, typer.Option(metavar="N", help="Most iterations of the solver, for each stage.")
    ] = 300
    solver: Annotated[str, typer.Option(metavar="NAME", help="snopt or ipopt.")] = "snopt"


@dataclass(frozen=True, kw_only=True)
class ExciteOptions(ModelOptions, _Motion, _Robot, _Choosing):
    """Options of excite."""

    model: ModelFile
    effects: EffectNames = None
    tell_apart: Annotated[
        str | None,
        typer.Option(
            metavar="EFFECT,EFFECT[@PLACE]",
            help="Two effects that logs so far cannot distinguish: the motion on which their "
            "predictions differ most, once everything else is refitted.",
        ),
    ] = None
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv|.npz|.yaml|.drake.yaml",
            help="Write the motion: a log with the predicted efforts, a ROS JointTrajectory, or a "
            "Drake BsplineTrajectory.",
        ),
    ] = None
    rate: Annotated[
        float, typer.Option(metavar="HZ", help="Samples a second of what --save writes.")
    ] = 100.0
    json: JsonFile = None
    report: ReportFile = None
    meshcat: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Write a page that replays the motion."),
    ] = None
    quiet: Quiet = False
    debug: Debug = False
