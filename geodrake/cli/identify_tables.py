"""An identification as tables and a sentence in a terminal, or as plain text in a pipe."""

from __future__ import annotations

from math import isfinite

import numpy as np
from rich.console import Console

from geodrake.cli.tables import head, number_columns, say, show_list, table_of
from geodrake.cli.wording import Wording, listed, number
from geodrake.model_identification import BodyChange, ModelIdentification


def show_identification(console: Console, found: ModelIdentification, wording: Wording) -> None:
    """Errors per joint, bodies and effects before and after, the verdict, notes."""
    _show_errors(console, found, wording)
    _show_bodies(console, found)
    _show_effects(console, found, wording)
    if found.alternatives:
        _show_alternatives(console, found)
    say(console, "Verdict", identification_verdict(found))
    show_list(console, "Notes", found.notes)


def identification_verdict(found: ModelIdentification) -> str:
    """What an identification amounts to, in a few sentences."""
    before, after = found.before, found.after
    words = (
        f"held-out nrms {before.nrms:.3f} -> {after.nrms:.3f} with the {found.regularizer} "
        f"regularizer, gamma {_gamma(found.gamma)}"
    )
    if found.sweep:
        words += f" (chosen by held-out error from {len(found.sweep)})"
    if after.floor_nrms > 0:
        words += f"; the sensor noise is {after.floor_nrms:.3f}"
    words += "."
    if found.at_boundary:
        words += (
            f" {listed(found.at_boundary)} ended at the boundary of what a body can be: nothing "
            "but that keeps the data from asking for the impossible."
        )
    return words


def _show_errors(console: Console, found: ModelIdentification, wording: Wording) -> None:
    head(console, f"Error of each joint, RMS in {wording.effort_unit} on held-out data")
    table = table_of(console, "joint")
    number_columns(table, "std", "before", "after", "noise")
    for before, after in zip(found.before.joints, found.after.joints, strict=True):
        values = (after.std, before.rms, after.rms, after.floor)
        table.add_row(after.joint, *map(number, values))
    table.add_section()
    levels = (found.before.nrms, found.after.nrms, found.after.floor_nrms)
    table.add_row("nrms", "", *(f"{level:.3f}" for level in levels))
    console.print(table)


def _show_bodies(console: Console, found: ModelIdentification) -> None:
    head(console, "Bodies; mass in kg, centre of mass in mm in the body's frame")
    table = table_of(console, "body")
    number_columns(table, "mass", "identified", "centre of mass", "identified")
    table.add_column("")
    for body in found.bodies:
        table.add_row(
            body.name,
            number(body.mass[0]),
            _with_deviation(body.mass[1], body.mass_deviation),
            _millimetres(body, 0),
            _millimetres(body, 1),
            "at the boundary" if body.at_boundary else "",
        )
    table.add_section()
    table.add_row("total", *(number(sum(body.mass[k] for body in found.bodies)) for k in (0, 1)))
    console.print(table)


def _with_deviation(value: float, deviation: float) -> str:
    return f"{number(value)} ± {deviation:.2g}" if np.isfinite(deviation) else number(value)


def _millimetres(body: BodyChange, at: int) -> str:
    texts = [f"{1e3 * x:.0f}" for x in body.com[at] + 0.0]
    words = " ".join("0" if text == "-0" else text for text in texts)
    if at == 1:
        words += f" ± {1e3 * np.linalg.norm(body.com_deviation):.0f}"
    return words


def _show_effects(console: Console, found: ModelIdentification, wording: Wording) -> None:
    rows = [f for f in found.model.effects if len(f.parameters) and f.effect.name != "payload"]
    if not rows:
        return
    head(console, "Effects")
    table = table_of(console, "effect", "where")
    number_columns(table, "parameter", "value")
    table.add_column("")
    for fitted in rows:
        deviations = fitted.deviations
        for k, parameter in enumerate(fitted.effect.parameters):
            deviation = np.nan if deviations is None else float(deviations[k])
            unit = wording.unit(fitted.effect.name, parameter.name, fitted.effect.where)
            table.add_row(
                fitted.effect.name if k == 0 else "",
                ", ".join(fitted.effect.where) if k == 0 else "",
                parameter.name,
                _with_deviation(float(fitted.parameters[k]), deviation),
                unit if unit != "1" else "",
            )
    console.print(table)


def _gamma(value: float) -> str:
    """The weight of a regularizer, which a loose bound leaves as large as one likes."""
    return number(value) if isfinite(value) else "without end"


def _show_alternatives(console: Console, found: ModelIdentification) -> None:
    head(console, "Regularizers at the same training residual")
    table = table_of(console, "regularizer")
    number_columns(table, "gamma", "training residual", "held-out nrms")
    table.add_column("at the boundary")
    for other in found.alternatives:
        table.add_row(
            other.regularizer,
            _gamma(other.gamma),
            f"{other.residual:.6g}",
            f"{other.errors.nrms:.4f}",
            ", ".join(other.at_boundary) or "-",
        )
    console.print(table)
