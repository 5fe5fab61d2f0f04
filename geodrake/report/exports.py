"""Pages of `export`, `check`, `digest` and `log`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.control.export_proof.export import ProvenExport
from geodrake.control.export_proof.joints import exported_joints
from geodrake.diagnosis.columns import ColumnFinding
from geodrake.fleet.digest_folder import FAILED, MADE, THERE, DigestRow, DigestRun
from geodrake.fleet.log_places import date_text
from geodrake.fleet.settings import SETTINGS_FILE, DigestSettings
from geodrake.logs.inspection import LogInspection
from geodrake.model.dynamics_check import TOLERANCE, Agreement, DynamicsCheck
from geodrake.report.charts import Chart, Panel, Plot, Shade, Stage
from geodrake.report.explaining import effect_cell, first_section, notes_section
from geodrake.report.json_output import picked, record
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import About, Cell, Page, Section, Table, Tile, View, cells
from geodrake.report.words import capitalized

_NAMED = 3  # effects, at most, that a sentence names
_FROM = {"stamps": "its time stamps", "option": "--date", "file": "when its file was changed"}
_DIGITS = 12  # of a hash, in words
_MOST_NAMED = 3  # gaps or rests that are named
_SI = {"current": "A", "voltage": "V", "pwm": "share"}  # which names of quantities do not say
_POSITION, _COMMAND = Stage("position", "after"), Stage("command", "quiet")
_EFFORT = Stage("effort", "before")


def export_page(found: ProvenExport, about: About) -> Page:
    """Return the page of an export."""
    units, costs = about.units, found.costs
    tiles = [Tile("format", found.form.name, ", ".join(found.exported.files))]
    if costs is not None:
        tiles += [
            Tile("model", number(costs.whole), "nrms"),
            Tile("files", number(costs.held), "nrms of the files"),
        ]
        if costs.ignored is not None:
            left = ", ".join(found.proof.ignored)
            tiles.append(Tile("simulated", number(costs.ignored), f"nrms without {left}"))
    headline, _, rest = _export_words(found).partition(". ")
    costed = "" if costs is None else f" nrms without each, {number(costs.whole)} with all."
    on = f", on {', '.join(about.logs)}" if about.logs else ""
    return Page(
        about,
        "exported",
        f"{capitalized(headline.removesuffix('.'))}.",
        (
            Section(
                "Exported",
                "Values in the files, in addition to the inertias.",
                "Friction that the format cannot express is approximated by least squares "
                "over the motion.",
                tables=(_holds_table(found, units),),
            ),
            Section(
                "Not exported",
                f"Effects that are approximated or omitted.{costed}",
                tables=(_lacks_table(found, units),),
            ),
            Section(
                "Loaded again",
                "Each simulator loaded the files, and is compared with the exported model.",
                "Efforts are those of the motion; positions those of rollouts from states "
                "of the motion, in steps of a millisecond.",
                tables=(_proof_table(found, units),),
            ),
            notes_section(found.notes),
        ),
        of=f"{about.model} to {found.form.name}{on}",
        lead=(rest,) if rest else (),
        tiles=tuple(tiles),
        footer="Made by geodrake: a model written for a simulator, and loaded again.",
    )


def _export_words(found: ProvenExport) -> str:
    """Return the content of an export and its consequences, in sentences."""
    names = [lost.effect for lost in found.lacks]
    lacks = ", ".join(names) if len(names) <= _NAMED else f"{len(names)} effects"
    words = (
        f"the files have the model except {lacks}" if lacks else "the files have the whole model"
    )
    if found.costs is not None:
        whole, held = number(found.costs.whole), number(found.costs.held)
        words += f"; nrms {whole} of the model, {held} of the files" if lacks else f", nrms {whole}"
    if found.proof.ignored:
        engine = found.proof.differences[0].engine.partition(" ")[0]
        words += f". {engine} ignores {', '.join(found.proof.ignored)} in them"
        if found.costs is not None and found.costs.ignored is not None:
            words += f": nrms {number(found.costs.ignored)}"
    off = [difference for difference in found.proof.differences if not difference.is_rounding]
    if off:
        words += f". {off[0].engine} differs from geodrake by more than rounding"
    elif found.proof.differences:
        words += ". The simulators that load them agree with geodrake to rounding"
    return f"{words}."


def _holds_table(found: ProvenExport, units: Units) -> Table:
    """Return damping, dry friction, rotors and springs in the files, by joint."""
    rows = []
    for joint, values in exported_joints(found.held).items():
        terms = {
            "N·m·s/rad": values.damping,
            "N·m": values.friction,
            "kg·m²": values.armature,
            "N·m/rad": values.stiffness,
        }
        if any(terms.values()):
            told = (
                f"{number(value)} {units.at(joint, unit)}" if value else "0"
                for unit, value in terms.items()
            )
            rest = f"{number(values.rest)} {units.at(joint, 'rad')}" if values.stiffness else ""
            rows.append(cells(joint, *told, rest))
    head = ("joint", "damping", "dry friction", "rotor inertia", "spring", "at rest")
    return Table(head, tuple(rows))


def _lacks_table(found: ProvenExport, units: Units) -> Table:
    """Return the effects that the files lack, and the loss of accuracy of each."""
    rows = []
    for lost in found.lacks:
        where, into = lost.where, " and ".join(lost.into)
        everywhere = not where or set(where) == set(found.held.joints)
        rows.append(
            cells(
                effect_cell(lost.effect, units),
                "all" if everywhere else ", ".join(where),
                f"fitted into {into}" if into else "left out",
                *([] if lost.nrms is None else [number(lost.nrms)]),
            )
        )
    head = ("effect", "where", "in the files", *(() if found.costs is None else ("nrms",)))
    return Table(head, tuple(rows), words=3)


def _proof_table(found: ProvenExport, units: Units) -> Table:
    """Return the differences of each simulator from the model."""
    rows = []
    for each in found.proof.differences:
        unit = units.at(each.joint, "N·m" if each.what == "effort" else "rad")
        part = "" if each.compared == 1.0 else f", {percent(each.compared)} of samples"
        without = ", ".join(each.without) or "nothing"
        largest, typical = f"{number(each.largest, 2)} {unit}", f"{number(each.typical)} {unit}"
        rows.append(cells(each.engine, f"{each.what}{part}", without, each.joint, largest, typical))
    head = ("loaded by", "compared", "without", "worst joint", "largest difference", "of RMS")
    return Table(head, rows, words=4)


def check_page(found: DynamicsCheck, about: About) -> Page:
    """Return the page of a comparison with MultibodyPlant."""
    states = "1 random state" if found.samples == 1 else f"{found.samples} random states"
    rows = [
        cells(
            *(each.quantity, " & ".join(each.where)),
            *(f"{each.difference:.1e}", f"{each.size:.3g}", f"{each.relative:.1e}"),
        )
        for each in (*found.agreements, *([found.second] if found.second else []))
    ]
    table = Table(("quantity", "largest at", "difference", "of", "relative"), rows, words=2)
    return Page(
        about,
        "checked",
        _check_words(found),
        (
            Section(
                "Largest differences",
                "In N·m or N, for the mass matrix in kg·m² or kg, with the largest value.",
                tables=(table,),
            ),
            notes_section(found.notes),
        ),
        of=f"{about.model} against MultibodyPlant, {states}",
    )


def _check_words(found: DynamicsCheck) -> str:
    """Return the outcome of a check, in a sentence."""
    worst, second = found.worst, found.second
    file = ""
    if second is not None:
        file = f" {found.by}, which reads the file itself, differs by {_largest(second)}."
    inertias = len(found.repairs) > len(found.left_out)
    if found.repairs and found.is_rounding:
        parts = ["has invalid inertias"] if inertias else []
        parts += ["has forces or parts that geodrake does not model"] if found.left_out else []
        return (
            f"the file {' and '.join(parts)}, so the checked model differs from the file "
            "(see Notes). Its largest relative difference to MultibodyPlant is "
            f"{_largest(worst)}.{file}" + (" Correct the inertias in the file." if inertias else "")
        )
    if found.is_rounding and second is not None and not second.holds:
        return (
            "geodrake and MultibodyPlant agree, but geodrake reads the file differently "
            f"from {found.by}: efforts differ by {_largest(second)}. Please report it with "
            "the file."
        )
    if found.holds:
        others = f", as does {found.by}, which reads the file itself" if second is not None else ""
        alone = f" No other program could check the file: {found.by}." if second is None else ""
        most = max((worst, *([second] if second else [])), key=lambda each: each.relative)
        return (
            f"geodrake and MultibodyPlant agree{others}; the largest relative difference is "
            f"{_largest(most)}.{alone}"
        )
    return (
        f"geodrake and MultibodyPlant disagree: a relative difference is {_largest(worst)}, "
        f"where rounding stays below {TOLERANCE:g}. This is a bug in geodrake; please report "
        "it with the model."
    )


def _largest(each: Agreement) -> str:
    return f"{each.relative:.0e} at {' & '.join(each.where)} ({each.quantity})"


def digests_page(run: DigestRun, about: About) -> Page:
    """Return the page of digested logs."""
    made, there, failed = (run.count(status) for status in (MADE, THERE, FAILED))
    headline = f"{made} digested, {there} existed, {failed} failed: "
    headline += "exit code 1." if failed else f"every log has a digest in {run.folder}."
    rows = tuple(_digest_cells(row) for row in run.rows if row.status != FAILED)
    head = ("log", "digest", "", "began", "by", "s", "samples", "effective")
    failures = [f"{row.file}: {row.reason}" for row in run.rows if row.status == FAILED]
    return Page(
        about,
        "digested",
        headline,
        (
            Section(f"Digests in {run.folder}", tables=(Table(head, rows, words=5),)),
            Section("Logs without a digest", items=tuple(failures)),
            notes_section(digest_notes(run)),
        ),
    )


def _digest_cells(row: DigestRow) -> tuple[Cell, ...]:
    about, name = row.about, row.digest
    if about is None or name is None:
        return cells(row.file.name, *("",) * 7)
    ends = (
        f"{values.min():.0f} to {values.max():.0f}" for values in (about.samples, about.effective)
    )
    ends = (text.partition(" ")[0] if len({*text.split(" to ")}) == 1 else text for text in ends)
    return cells(
        row.file.name,
        name.name[:_DIGITS] + "…",
        row.status,
        date_text(about.date),
        _FROM[about.date_from],
        f"{about.seconds:.3g}",
        *ends,
    )


def digest_notes(run: DigestRun) -> list[str]:
    """Return the source of the settings, and notes on digests."""
    notes = list(run.repairs)
    notes += [
        f"{row.file}: {row.reason}" for row in run.rows if row.status != FAILED and row.reason
    ]
    if run.settings is not None and run.chosen:
        notes.append(
            f"settings of all digests in {run.folder}, chosen from "
            f"{run.settings.chosen_from}: bandwidth {run.settings.bandwidth:.3g} Hz, "
            f"{len(run.settings.columns)} columns; see {SETTINGS_FILE}"
        )
    if any(row.about is not None and row.about.date_from == "file" for row in run.rows):
        notes.append(
            "dates are the files' modification times, which copying may change; --date sets them"
        )
    return notes


@dataclass(frozen=True, eq=False)
class InspectedLogs:
    """Logs as they were read, by name, and the check of their columns."""

    logs: Sequence[tuple[str, LogInspection]]
    columns: Sequence[ColumnFinding] = ()  # what is wrong with columns
    # Why columns were not compared with the model; "" if they were, or there is none.
    unchecked: str = ""
    # What of the model's file is not believed; None without a model.
    repairs: Sequence[str] | None = None
    beyond: Sequence[str] = ()  # where positions are beyond the model's limits, in sentences


def logs_page(found: InspectedLogs, about: About) -> Page:
    """Return the page of logs; a single log is also drawn."""
    sections = [
        Section("Columns with mistakes", items=tuple(map(str, found.columns))),
        Section(
            "Columns were not compared with the model",
            items=(found.unchecked,) if found.unchecked else (),
        ),
        Section("Positions beyond the model's limits", items=tuple(found.beyond)),
    ]
    for name, each in found.logs:
        sections += [
            Section(name, tables=(_columns_table(each),)),
            Section("Rows", items=_row_words(each)),
            notes_section(each.notes, each.first),
        ]
    first = first_section([f"{name}: {words}" for name, each in found.logs for words in each.first])
    return Page(about, "understood", "", tuple(sections), of="", verdict="", first=(first,))


def _columns_table(found: LogInspection) -> Table:
    """Return the joint and quantity of each column."""
    rows = []
    for each in found.columns:
        unit = each.unit or _SI.get(each.quantity, "")
        if not np.isclose(each.factor, 1.0, rtol=1e-12, atol=0.0):
            unit = f"{unit} × {number(each.factor, 4)}".strip()
        names = each.joint, each.quantity, each.column, unit
        rows.append(cells(*names, each.lowest, each.highest, each.empty or ""))
    head = ("joint", "quantity", "column", "unit", "least", "largest", "empty")
    return Table(head, rows, words=4)


def _row_words(found: LogInspection) -> tuple[str, ...]:
    """Return rows, rates, gaps and rest, in sentences."""
    log, mean = found.log, len(found.log) / found.seconds
    column = found.time_column
    source = f"time from {column}" if column else "no column of time, constant rate"
    words = [
        f"{len(log)} rows in {number(found.seconds)} s, typically every "
        f"{number(1e3 * found.period)} ms, {number(mean, 4)} Hz on average; {source}"
    ]
    if found.jitter > 1e-3 * found.period:
        words.append(f"jitter {number(1e3 * found.jitter)} ms (standard deviation)")
    gaps = [f"{number(length)} s at t = {instant:.2f} s" for instant, length in found.gaps]
    if gaps:
        words.append(f"{len(gaps)} gap{'s' if len(gaps) > 1 else ''}: {_named(gaps)}")
    rests = [f"t = {first:.2f} to {last:.2f} s" for first, last in found.rests]
    if rests:
        share = percent(found.rest / found.seconds)
        words.append(f"at rest for {number(found.rest)} s, {share}: {_named(rests)}")
    return tuple(words)


def _named(words: Sequence[str]) -> str:
    return ", ".join(words[:_MOST_NAMED]) + (" …" if len(words) > _MOST_NAMED else "")


def log_chart(found: LogInspection) -> Chart:
    """Return positions and efforts of every joint over time, with rest shaded.

    Commands are beside positions; without efforts, how far they are from there.
    """
    log, panels = found.log, []
    rests = tuple(Shade(_POSITION, first, last, "no joint moves") for first, last in found.rests)
    for row, joint in enumerate(log.joints):
        positions = {_POSITION: log.position[:, row]}
        if log.command is not None and np.isfinite(log.command[:, row]).any():
            positions[_COMMAND] = log.command[:, row]
        effort, words = _effort_curve(found, row)
        plots = Plot("position, rad or m", positions), Plot(words, {_EFFORT: effort})
        panels.append(Panel(joint, "", log.time, plots, rests))
    caption = "Shaded: no joint moves." if found.rests else ""
    return Chart("log", caption, tuple(panels), axis="time, s")


def _effort_curve(found: LogInspection, row: int) -> tuple[NDArray[np.float64], str]:
    """Return (N,) the effort signal of a joint, and its kind."""
    log = found.log
    kind = log.effort_kinds.get(log.joints[row], "effort")
    effort = log.effort[:, row]
    if log.command is not None and not np.isfinite(effort).any():
        return log.command[:, row] - log.position[:, row], "command − position, rad or m"
    words = {"pwm": "duty cycle, share of 1", "effort": "effort, N·m or N"}
    return effort, words.get(kind, f"{kind}, {_SI.get(kind, '')}")


def _export_values(found: ProvenExport) -> dict[str, Any]:
    """Return what an export lacks, and the loss of accuracy."""
    error, costs = dict[str, float](), found.costs
    if costs is not None:
        error = {"nrms": costs.whole, "held_nrms": costs.held}
        error |= {} if costs.ignored is None else {"simulated_nrms": costs.ignored}
    lacks = [
        picked(lost, "effect", "where", "into", *([] if lost.nrms is None else ["nrms"]))
        for lost in found.lacks
    ]
    return {"lacks": lacks, "error": error}


def _digest_values(run: DigestRun) -> dict[str, Any]:
    """Return the outcome for each log."""
    settings = run.settings
    return {
        "settings": settings and record("DigestSettings", settings, columns=len(settings.columns)),
        "counts": {status: run.count(status) for status in (MADE, THERE, FAILED)},
        "logs": [_digest_row(row, settings) for row in run.rows],
        "notes": digest_notes(run),
    }


def _digest_row(row: DigestRow, settings: DigestSettings | None) -> dict[str, Any]:
    about, said = row.about, {"log": row.file, "status": row.status, "reason": row.reason}
    if about is None or settings is None:
        return said
    values = (
        *(about.samples, about.effective, about.noise_floor),
        *(about.position.T, about.speed.T, about.temperature),
    )
    return {
        **said,
        **picked(about, "date_from", "seconds", "notes"),
        "digest": row.digest,
        "date": date_text(about.date),
        "joints": dict(zip(settings.joints, zip(*values, strict=True), strict=True)),
    }


def _log_values(found: InspectedLogs) -> dict[str, Any]:
    logs = [record("InspectedLog", each, rows=len(each.log)) for _, each in found.logs]
    if found.repairs is None:
        return {"logs": logs}
    notes = [*found.repairs, *found.beyond, *filter(None, [found.unchecked])]
    return {"logs": logs, "columns": found.columns, "notes": notes}


def _check_values(found: DynamicsCheck) -> dict[str, Any]:
    second = {} if found.second is None else record("Agreement", found.second)
    return {
        "repaired": len(found.repairs) > len(found.left_out),
        "tolerance": TOLERANCE,
        "second_opinion": {"by": found.by, **second},
    }


VIEWS = {
    ProvenExport: View(export_page, "Export", _export_values),
    DynamicsCheck: View(check_page, "Check", _check_values),
    DigestRun: View(digests_page, "Digests", _digest_values),
    InspectedLogs: View(logs_page, "InspectedLogs", _log_values),
}
"""How each type of result is shown."""
