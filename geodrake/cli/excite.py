"""The command `geodrake excite`: the most informative motion that a robot can execute."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import typer

from geodrake.boundary.version import version
from geodrake.cli.excitation_options import ExciteOptions
from geodrake.cli.excite_tables import show_excitation
from geodrake.cli.guard import INTERRUPTED
from geodrake.cli.identify import named_effects
from geodrake.cli.model_options import read_model
from geodrake.cli.option_values import joint_values, limits_of, split_effects
from geodrake.cli.progress import STOPPING, Activity, progress
from geodrake.cli.session import Maker, own_effects
from geodrake.cli.surroundings import print_whole, printing
from geodrake.cli.tables import make_console, show_saved
from geodrake.cli.targets import STDOUT, Targets
from geodrake.cli.tell_apart import check_alone, separation_of
from geodrake.effects import Effect
from geodrake.errors import ArgumentError, ModelError
from geodrake.excitation import (
    CRITERIA,
    NORMALIZATIONS,
    CollisionWorld,
    Criterion,
    DesignOptions,
    ExcitationResult,
    FourierMotion,
    FreeSamples,
    MotionFamily,
    MotionLimits,
    Objective,
    SplineMotion,
    Target,
    make_target,
)
from geodrake.excitation.budget import Budget
from geodrake.excitation.design import design_objective
from geodrake.excitation.design_results import DesignProgress
from geodrake.excitation.effect_sizes import SIZE_WORDS, sized_effects
from geodrake.excitation.trajectory_files import trajectory_content
from geodrake.identification.logs.dataset import is_payload
from geodrake.model.robot_model import RobotModel
from geodrake.report.excitation_json import excitation_dict
from geodrake.report.json_output import to_json
from geodrake.robot.files import read_description
from geodrake.robot.files.meshes import mesh_notes

_SAVE = (".csv", ".npz", ".txt", ".yaml", ".yml")
_FAMILIES = {"fourier": ("harmonics", "frequency"), "spline": ("points",), "free": ()}
_NOISE_SHARE = 0.01  # of the limits of effort
_LEAST_SECONDS = 1e-3  # when collision geometry took all
_UPDATED_EVERY = 5  # evaluations
_SAMPLES = 300
_FARTHEST, _LAST_SEED = 100.0, 1 << 32
_REPEATS = 3  # of a motion that distinguishes effects: a diagnosis holds out blocks of its log


def run_excite(options: ExciteOptions) -> None:
    """Run the command.

    Raises:
        GeodrakeError: Something about the input, or about the targets, does not do.
    """
    family = family_of(options)
    _check(options)
    files, names = split_effects(options.effects)
    check_alone(options, names)
    more = {"save": options.save, "meshcat": options.meshcat}
    targets = Targets(None, options.json, options.report, more, {"save": _SAVE})
    targets.check([options.model, *files, *options.transmission_files])
    # matplotlib is slow to import and only the page needs it
    pages = importlib.import_module("geodrake.report") if options.report else None
    with progress(f"Reading {options.model.name}", quiet=options.quiet) as update:
        extra = own_effects(files)
        model = read_model(options.model, options, update, extra)
        targets.check([options.model, *files, model.path])  # a saved model reads another one
        result = _designed(options, model, _Effects(names, extra), family, update)
        update("Writing")
        numbers = to_json({"version": version(), "command": "excite", **excitation_dict(result)})

        def page() -> str:
            name = options.model.name
            return str(pages.render_excitation(result, title=f"{name}: excite", model_name=name))  # type: ignore[union-attr]

        makers: dict[str, Maker] = {
            "json": lambda: numbers,
            "report": page,
            "save": lambda: trajectory_content(
                result.trajectory,
                options.save or "motion.csv",
                result.objective.target.model,
                rate=options.rate,
            ),
            "meshcat": lambda: _replay(result),
        }
        written = targets.write(model, makers)
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        console = make_console(stderr=options.json == STDOUT)
        show_excitation(console, result, options.model.name)
        show_saved(console, written, {"save": "motion", "meshcat": "replay of the motion"})
    if result.is_interrupted:
        raise typer.Exit(INTERRUPTED)


def family_of(options: ExciteOptions) -> MotionFamily:
    """Return the family of motions that options ask for.

    Raises:
        ArgumentError: There is no such family, or it has no such option or value.
    """
    name = options.trajectory
    if name not in _FAMILIES:
        raise ArgumentError(
            f"There is no trajectory {name!r}.", advice=f"Use one of {', '.join(_FAMILIES)}."
        )
    for other, keys in _FAMILIES.items():
        for key in keys:
            if other != name and getattr(options, key) is not None:
                raise ArgumentError(f"--{key} is for --trajectory {other}, not {name}.")
    if name == "free":
        wanted = [o for o in ("save", "meshcat") if getattr(options, o) is not None]
        if wanted:
            raise ArgumentError(
                f"Free samples do not follow each other in time: there is nothing for "
                f"--{wanted[0]} to write.",
                advice="Use --trajectory fourier or spline.",
            )
        return FreeSamples(50 if options.samples is None else options.samples)
    if name == "spline":
        return SplineMotion(options.duration, 16 if options.points is None else options.points)
    frequency = options.frequency
    if frequency is None and options.tell_apart is not None and 0 < options.duration < np.inf:
        frequency = _REPEATS / options.duration
    rate = None if frequency is None else 2.0 * np.pi * frequency
    harmonics = 5 if options.harmonics is None else options.harmonics
    return FourierMotion(options.duration, harmonics, rate)


def _check(options: ExciteOptions) -> None:
    """Refuses what can be refused before the model is read."""
    for what, given, known in (
        ("criterion", options.criterion, CRITERIA),
        ("normalization", options.normalization, NORMALIZATIONS),
    ):
        if given not in known:
            raise ArgumentError(
                f"There is no {what} {given!r}.", advice=f"Use one of {', '.join(known)}."
            )
    for what, value, most in (
        ("seeds", options.seeds, 1000),
        ("seconds", options.seconds, 1e6),
        ("iterations", options.iterations, 1e6),
        ("rate", options.rate, 1e4),
        ("samples", 1 if options.samples is None else options.samples, 10_000),
    ):
        if not 0 < value <= most:
            raise ArgumentError(f"--{what} is a positive number up to {most:g}; got {value}.")
    if not 0 <= options.clearance <= _FARTHEST:
        raise ArgumentError(
            f"--clearance is a distance in m, up to {_FARTHEST:g}; got {options.clearance}."
        )
    if not 0 <= options.seed < _LAST_SEED:
        raise ArgumentError(f"--seed is not negative, and below 2^32; got {options.seed}.")


@dataclass(frozen=True)
class _Effects:
    """Effects that are asked for by name, and those of the user's own."""

    names: Sequence[str]
    extra: tuple[type[Effect], ...]


def _designed(
    options: ExciteOptions,
    model: RobotModel,
    effects: _Effects,
    family: MotionFamily,
    update: Activity,
) -> ExcitationResult:
    """Return the design that options ask for."""
    budget = Budget.of(options.seconds)
    limits = limits_of(options.limits, model)
    collisions, notes = _collisions(options, model)
    if options.meshcat is not None:
        notes = (*notes, *mesh_notes(read_description(model.path, model.given)))
    objective, more = _objective(options, model, limits, effects)
    start = None if options.start is None else joint_values(options.start, model, "--start")
    design = DesignOptions(
        samples=_SAMPLES if options.samples is None else options.samples,
        start=start,
        collisions=collisions,
        solver=options.solver,
        iterations=options.iterations,
        seconds=max(budget.left, _LEAST_SECONDS),
    )
    update("Designing")
    result = design_objective(
        objective,
        limits,
        trajectory=family,
        options=design,
        seeds=range(options.seed, options.seed + options.seeds),
        progress=_updating(update, budget, options.seconds),
    )
    return replace(result, notes=(*result.notes, *notes, *more))


def _objective(
    options: ExciteOptions, model: RobotModel, limits: MotionLimits, effects: _Effects
) -> tuple[Objective, tuple[str, ...]]:
    """Return what the motion is for, and what to say of that."""
    if options.tell_apart is not None:
        noise, notes = noise_of(options.noise, model)
        separation, more = separation_of(
            options.tell_apart, model, limits, noise=noise, extra=effects.extra
        )
        return separation, (*notes, *more)
    target, notes = _target(options, model, named_effects(effects.names, model, effects.extra))
    return Objective(target, Criterion(options.criterion), options.normalization), notes


def _target(
    options: ExciteOptions, model: RobotModel, effects: tuple[Effect, ...]
) -> tuple[Target, tuple[str, ...]]:
    """Return what is unknown and how well it is measured, and what to say of that."""
    known = [fitted for fitted in model.effects if not is_payload(fitted.effect)]
    noise, notes = noise_of(options.noise, model)
    if effects:
        target = make_target(model, noise=noise, effects=effects)
        known += sized_effects(target)
        notes = (*notes, f"effects of unknown size are thought to take {SIZE_WORDS}")
    return make_target(model, noise=noise, effects=known), notes


def noise_of(text: str | None, model: RobotModel) -> tuple[np.ndarray, tuple[str, ...]]:
    """(nv,) noise of the measured efforts, and where it comes from if nobody said so.

    Args:
        text: What `--noise` says; None if it is not given.
    """
    if text is not None:
        return joint_values(text, model, "--noise"), ()
    if model.effort_noise is not None:
        return model.effort_noise, ("noise: what the model's last fit left on held-out data",)
    limits = model.effort_limits
    if np.isfinite(limits).all() and (limits > 0).all():
        return _NOISE_SHARE * limits, (
            f"noise: {100 * _NOISE_SHARE:.0f} % of the limits of effort, as nothing is known of it",
        )
    return np.ones(len(limits)), ("noise: 1 N·m or N at every joint, as nothing is known of it",)


def _collisions(
    options: ExciteOptions, model: RobotModel
) -> tuple[CollisionWorld | None, tuple[str, ...]]:
    """Return what the robot may not hit, and what to say where that is nothing.

    Raises:
        ModelError: The file has collision geometry that cannot be read.
    """
    if not options.collisions:
        return None, ("collisions of the robot with itself were not looked at, as asked for",)
    try:
        return CollisionWorld(model, clearance=options.clearance), ()
    except ArgumentError:
        return None, (
            f"{model.path.name} has no collision geometry: nothing keeps the robot from hitting "
            "itself but the limits of its joints",
        )
    except ModelError as error:
        raise ModelError(
            error.problem, advice="Correct the file, or leave collisions out: --no-collisions."
        ) from error


def _updating(update: Activity, budget: Budget, seconds: float) -> Callable[[DesignProgress], None]:
    def updated(now: DesignProgress) -> None:
        if now.is_stopped:
            update.history(STOPPING)
        elif now.evaluations % _UPDATED_EVERY == 0:
            update(
                f"Start {now.seed + 1} of {now.seeds}, log criterion {now.value:.3f}",
                1.0 - budget.left / seconds,
            )

    return updated


def _replay(result: ExcitationResult) -> str:
    from geodrake.report.replay import FRAMES, replay_page

    times = result.trajectory.instants(FRAMES)
    motion = result.trajectory.motion(times)
    return replay_page(result.objective.target.model, times, motion.q)
