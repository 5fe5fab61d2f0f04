"""The command `geodrake check`: the model's dynamics against MultibodyPlant's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import typer
from rich.console import Console

from geodrake.boundary.version import version
from geodrake.cli.check_options import CheckOptions
from geodrake.cli.guard import INTERNAL_ERROR
from geodrake.cli.model_options import read_model
from geodrake.cli.progress import progress
from geodrake.cli.session import own_effects
from geodrake.cli.surroundings import print_whole, printing
from geodrake.cli.tables import head, make_console, say, show_list, show_saved, show_table
from geodrake.cli.targets import STDOUT, Targets
from geodrake.model.dynamics_check import TOLERANCE, Agreement, DynamicsCheck, check_dynamics
from geodrake.report.json_output import number_or, to_json
from geodrake.report.tables import Table, cells


def run_check(options: CheckOptions) -> None:
    """Run the command; its exit code is 1 unless the two agree on the file as it stands.

    Raises:
        GeodrakeError: Something about the input, or about the target, does not do.
    """
    targets, files = Targets(json=options.json), options.effects or ()
    targets.check([options.model, *files])
    with progress(f"Reading {options.model.name}", quiet=options.quiet) as update:
        extra = own_effects(files)
        model = read_model(options.model, options, update, extra)
        targets.check([options.model, *files, model.path])
        update("Comparing with MultibodyPlant, and with a program that reads the file itself")
        found = check_dynamics(model, samples=options.samples, seed=options.seed)
        notes = tuple(dict.fromkeys((*found.repairs, *model.notes)))
        numbers = to_json({"version": version(), "command": "check", **check_dict(found, notes)})
        written = targets.write(model, {"json": lambda: numbers})
    with printing():
        if options.json == STDOUT:
            print_whole(numbers)
        console = make_console(stderr=options.json == STDOUT)
        show_check(console, found, notes, name=options.model.name)
        show_saved(console, written)
    if not found.holds:
        raise typer.Exit(INTERNAL_ERROR)


def check_dict(found: DynamicsCheck, notes: Sequence[str]) -> dict[str, Any]:
    """Return a check as plain numbers, for JSON.

    Args:
        notes: What is to be known of the model, repairs first.
    """
    return {
        "agrees": found.holds,
        "repaired": len(found.repairs) > len(found.left_out),
        "left_out": list(found.left_out),
        "tolerance": TOLERANCE,
        "samples": found.samples,
        "seed": found.seed,
        "bodies": found.bodies,
        "joints": found.joints,
        "quantities": {each.quantity: _numbers(each) for each in found.agreements},
        "second_opinion": {"by": found.by} | (_numbers(found.second) if found.second else {}),
        "worst": found.worst.quantity,
        "notes": list(notes),
    }


def _numbers(each: Agreement) -> dict[str, Any]:
    why = "a computed value is no number"
    return {
        "difference": number_or(each.difference, why),
        "size": number_or(each.size, why),
        "relative": number_or(each.relative, why),
        "where": each.where,
    }


def show_check(console: Console, found: DynamicsCheck, notes: Sequence[str], *, name: str) -> None:
    """The largest difference of every quantity, and whether they are rounding."""
    states = "1 random state" if found.samples == 1 else f"{found.samples} random states"
    console.print(f"{name} against MultibodyPlant, {states}", soft_wrap=True)
    head(
        console,
        "Largest differences, N·m or N, of the mass matrix kg·m² or kg, and the largest value",
    )
    rows = tuple(
        cells(
            each.quantity,
            " & ".join(each.where),
            f"{each.difference:.1e}",
            f"{each.size:.3g}",
            f"{each.relative:.1e}",
        )
        for each in (*found.agreements, *([found.second] if found.second else []))
    )
    titles = ("quantity", "largest at", "difference", "of", "relative")
    show_table(console, Table(titles, rows, words=2))
    show_list(console, "Notes", notes)
    say(console, "Verdict", check_verdict(found))


def _words(each: Agreement) -> str:
    return f"{each.relative:.0e} at {' & '.join(each.where)} ({each.quantity})"


def check_verdict(found: DynamicsCheck) -> str:
    """Return what a check amounts to, in a sentence."""
    worst = found.worst
    most, second = _words(worst), found.second
    file = ""
    if second is not None:
        file = f" {found.by}, which reads the file itself, differs by {_words(second)}."
    inertias = len(found.repairs) > len(found.left_out)
    if found.repairs and found.is_rounding:
        parts = ["has inertias that cannot be used"] if inertias else []
        parts += ["states forces or parts that geodrake does not model"] if found.left_out else []
        return (
            f"the file {' and '.join(parts)}, so what was checked is not the file as it stands "
            f"(see Notes). Of what is used instead, the largest relative difference to "
            f"MultibodyPlant is {most}.{file}"
            + (" Correct the inertias in the file." if inertias else "")
        )
    if found.is_rounding and second is not None and not second.holds:
        return (
            f"geodrake and MultibodyPlant agree, but geodrake reads the file differently from "
            f"{found.by}: efforts differ by {_words(second)}. Please report it with the file."
        )
    if found.holds:
        others = f", as does {found.by}, which reads the file itself" if second is not None else ""
        alone = f" There is no second opinion on the file: {found.by}." if second is None else ""
        largest = max((worst, *([second] if second else [])), key=lambda each: each.relative)
        return (
            f"geodrake and MultibodyPlant agree{others}; the largest relative difference is "
            f"{_words(largest)}.{alone}"
        )
    return (
        f"geodrake and MultibodyPlant disagree: a relative difference is {most}, where rounding is "
        f"below {TOLERANCE:g}. This is a bug in geodrake; please report it with the model."
    )
