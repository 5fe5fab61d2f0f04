"""Tables of identifications as plain data, and their verdict."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

import numpy as np

from geodrake.effects import Role
from geodrake.identification.models import ModelIdentification
from geodrake.identification.models.results import BodyChange
from geodrake.inertia import Array
from geodrake.report.numbers import UNKNOWN, Units, estimate, number, with_deviation
from geodrake.report.tables import Cell, Table, cells
from geodrake.report.words import effect_label, listed, places_label

_MILLIMETRES = 1e3
_FAR = 1e6  # mm, from which deviations are told as multiples of a power of ten


def bodies_table(bodies: Sequence[BodyChange]) -> Table:
    """Mass and centre of mass of every body before and after, in kg and mm.

    Args:
        bodies: The bodies, in the order of the rows.
    """
    rows = [
        cells(
            body.name,
            number(body.mass[0]),
            with_deviation(body.mass[1], body.mass_deviation),
            _place(body.com[0]),
            _centre(body),
            "at the boundary" if body.at_boundary else "",
        )
        for body in bodies
    ]
    masses = [number(sum(body.mass[k] for body in bodies)) for k in (0, 1)]
    head = ("body", "mass", "identified", "centre of mass", "identified", "")
    return Table(head, (*rows, cells("total", *masses, "", "", "")), total=1)


def fitted_effects_table(found: ModelIdentification, units: Units) -> Table:
    """Parameters of the effects that were fitted, without payloads, which are bodies."""
    rows = []
    for fitted in found.model.effects:
        if fitted.effect.role is Role.BODY:
            continue
        where = fitted.effect.where
        for k, parameter in enumerate(fitted.effect.parameters):
            deviation = np.nan if fitted.deviations is None else float(fitted.deviations[k])
            rows.append(
                cells(
                    Cell(effect_label(fitted.effect.name), typed=fitted.effect.name)
                    if k == 0
                    else "",
                    places_label(where, units.joints) if k == 0 else "",
                    parameter.name,
                    estimate(float(fitted.parameters[k]), deviation),
                    units.parameter(fitted.effect.name, parameter.name, " & ".join(where)),
                )
            )
    return Table(("effect", "where", "parameter", "value", "unit"), tuple(rows), words=3)


def regularizers_table(found: ModelIdentification) -> Table:
    """What every regularizer makes of the same training residual."""
    rows = tuple(
        cells(
            other.regularizer,
            ", ".join(other.at_boundary) or UNKNOWN,
            gamma_words(other.gamma),
            number(other.residual, 6),
            number(other.errors.nrms, 4),
        )
        for other in found.alternatives
    )
    head = ("regularizer", "at the boundary", "gamma", "training residual", "held-out nrms")
    return Table(head, rows, words=2)


def identification_verdict(found: ModelIdentification) -> str:
    """What an identification amounts to, in a few sentences."""
    before, after = number(found.before.nrms), number(found.after.nrms)
    words = (
        f"held-out nrms {before} -> {after} with the {found.regularizer} regularizer, gamma "
        f"{gamma_words(found.gamma)}"
    )
    if found.sweep:
        words += f" (chosen by held-out error from {len(found.sweep)})"
    if found.after.shows_noise:
        words += f"; the sensor noise is {number(found.after.floor_nrms)}"
    words += "."
    if found.at_boundary:
        words += (
            f" {listed(found.at_boundary)} ended at the boundary of what a body can be: nothing "
            "but that keeps the data from asking for the impossible."
        )
    return words


def gamma_words(value: float) -> str:
    """The weight of a regularizer, which a loose bound leaves as large as one likes."""
    return number(value) if isfinite(value) else "without end"


def _place(com: Array) -> str:
    """A point in whole millimetres."""
    return ", ".join(f"{x:.0f}".replace("-", "−") for x in np.round(_MILLIMETRES * com) + 0.0)


def _centre(body: BodyChange) -> Cell:
    """The centre of mass found, and every coordinate with its deviation."""
    com, deviation = _MILLIMETRES * body.com[1], _MILLIMETRES * body.com_deviation
    pairs = zip(com.tolist(), deviation.tolist(), strict=True)
    each = ", ".join(with_deviation(x, sigma) for x, sigma in pairs)
    size = float(np.linalg.norm(deviation))
    words = f"{size:.0f}" if size < _FAR else number(size)
    return Cell(f"{_place(body.com[1])} ± {words}", note=each)
