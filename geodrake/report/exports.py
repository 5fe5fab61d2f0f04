"""Pages of `export`, `check`, `digest` and `log`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geodrake.control.export_proof.export import ProvenExport
from geodrake.control.export_proof.joints import exported_joints
from geodrake.diagnosis.columns import ColumnFinding
from geodrake.fleet.digest_folder import FAILED, MADE, THERE, DigestRun
from geodrake.fleet.log_places import date_text
from geodrake.fleet.settings import SETTINGS_FILE
from geodrake.logs.inspection import LogInspection, UnderstoodColumn
from geodrake.model.dynamics_check import TOLERANCE, Agreement, DynamicsCheck
from geodrake.report.charts import Chart, Panel, Plot, Shade, Stage
from geodrake.report.explaining import effect_cell, first_section, notes_section
from geodrake.report.json_output import picked, record
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import About, Page, Section, Table, Tile, View, cells

_DATE_SOURCES = {"stamps": "its time stamps", "option": "--date", "file": "when its file changed"}
_DIGITS = 12  # shown digits of a hash
_MOST_NAMED = 3  # effects, gaps or rests named in a sentence
_SI = {"current": "A", "voltage": "V", "pwm": "share"}  # units of quantities without one
_POSITION, _COMMAND = Stage("position", "after"), Stage("command", "quiet")
_EFFORT = Stage("effort", "before")


def export_page(found: ProvenExport, about: About) -> Page:
    """Return the page of an export."""
    units, costs, ignored = about.units, found.costs, ", ".join(found.proof.ignored)
    tiles = [Tile("format", found.form.name, ", ".join(found.exported.files))]
    if costs is not None:
        tiles += [
            Tile("model", number(costs.whole), "nrms"),
            Tile("files", number(costs.held), "nrms of the files"),
        ]
        if costs.ignored is not None:
            tiles.append(Tile("simulated", number(costs.ignored), f"nrms without {ignored}"))
    names = [lost.effect for lost in found.lacks]
    headline, facts = "The files have the whole model", dict[str, str]()
    if names:
        lacks = ", ".join(names) if len(names) <= _MOST_NAMED else f"{len(names)} effects"
        headline = f"The files have the model except {lacks}"
    if costs is not None:
        of_files = f"; nrms {number(costs.whole)} of the model, {number(costs.held)} of the files"
        headline += of_files if names else f", nrms {number(costs.whole)}"
    if ignored:
        engine = found.proof.differences[0].engine.partition(" ")[0]
        cost = "" if costs is None or costs.ignored is None else f": nrms {number(costs.ignored)}"
        facts["Ignored"] = f"{ignored} by {engine}{cost}"
    deviating = [difference for difference in found.proof.differences if not difference.is_rounding]
    if deviating:
        facts["Simulators"] = f"{deviating[0].engine} differs by more than rounding"
    elif found.proof.differences:
        facts["Simulators"] = "simulators agree with geodrake to rounding"
    nrms_note = "" if costs is None else f" nrms without each, {number(costs.whole)} with all."
    log_names = f", on {', '.join(about.logs)}" if about.logs else ""
    return Page(
        about,
        f"{headline}.",
        (
            Section(
                "Exported",
                "Values in the files, in addition to the inertias.",
                "Friction that the format cannot express is approximated by least squares "
                "over the motion.",
                tables=(_values_table(found, units),),
            ),
            Section(
                "Not exported",
                f"Effects that are approximated or omitted.{nrms_note}",
                tables=(_lacks_table(found, units),),
            ),
            Section(
                "Simulators",
                "Each simulator loaded the files, and is compared with the exported model.",
                "Efforts are those of the motion; positions those of rollouts from states "
                "of the motion, in steps of a millisecond.",
                tables=(_proof_table(found, units),),
            ),
            notes_section(found.notes),
        ),
        of=f"{about.model} to {found.form.name}{log_names}",
        verdict="exported",
        facts=facts,
        tiles=tuple(tiles),
        footer="Made by geodrake: a model written for a simulator, and loaded again.",
    )


def _values_table(found: ProvenExport, units: Units) -> Table:
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
            texts = (
                f"{number(value)} {units.at(joint, unit)}" if value else "0"
                for unit, value in terms.items()
            )
            rest = f"{number(values.rest)} {units.at(joint, 'rad')}" if values.stiffness else ""
            rows.append(cells(joint, *texts, rest))
    head = ("joint", "damping", "dry friction", "rotor inertia", "spring", "at rest")
    return Table(head, tuple(rows))


def _lacks_table(found: ProvenExport, units: Units) -> Table:
    """Return the effects that the files lack, and the nrms without each."""
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
    headline, facts = _check_answer(found)
    return Page(
        about,
        headline,
        (
            Section(
                "Largest differences",
                "In N·m or N, for the mass matrix in kg·m² or kg, with the largest value.",
                tables=(table,),
            ),
            notes_section(found.notes),
        ),
        verdict="checked",
        facts=facts,
        of=f"{about.model} against MultibodyPlant, {states}",
    )


def _check_answer(found: DynamicsCheck) -> tuple[str, dict[str, str]]:
    """Return the outcome of a check in a sentence, and the differences with advice."""
    worst, second = found.worst, found.second
    facts = {
        "Largest difference": f"{_largest(worst)}, relative to the largest value",
        "Second opinion": f"none: {found.by}",
    }
    if second is not None:
        outcome = (
            "agrees" if second.holds and not found.repairs else f"differs by {_largest(second)}"
        )
        facts["Second opinion"] = f"{found.by}, which reads the file itself, {outcome}"
    if found.repairs and found.is_rounding:
        inertias = len(found.repairs) > len(found.left_out)
        parts = ["has invalid inertias"] if inertias else []
        parts += ["has forces or parts that geodrake does not model"] if found.left_out else []
        facts["Next"] = "correct the inertias in the file" * inertias
        return f"The checked model differs from the file, which {' and '.join(parts)}.", facts
    if found.is_rounding and second is not None and not second.holds:
        facts["Next"] = "please report it with the file"
        return f"geodrake reads the file differently from {found.by}.", facts
    if found.holds:
        return "geodrake and MultibodyPlant agree.", facts
    facts["Next"] = "this is a bug in geodrake: please report it with the model"
    facts["Largest difference"] += f"; rounding stays below {TOLERANCE:g}"
    return "geodrake and MultibodyPlant disagree.", facts


def _largest(each: Agreement) -> str:
    return f"{each.relative:.0e} at {' & '.join(each.where)} ({each.quantity})"


def digests_page(run: DigestRun, about: About) -> Page:
    """Return the page of digested logs."""
    made, there, failed = (run.count(status) for status in (MADE, THERE, FAILED))
    headline = f"{made} digested, {there} existed, {failed} failed: "
    headline += "exit code 1." if failed else f"every log has a digest in {run.folder}."
    rows = []
    for row in (row for row in run.rows if row.status != FAILED):
        about_log, name = row.about, row.digest
        if about_log is None or name is None:
            rows.append(cells(row.file.name, *("",) * 7))
            continue
        samples = about_log.samples, about_log.effective
        ranges = [(f"{n.min():.0f}", f"{n.max():.0f}") for n in samples]
        counts = (low if low == high else f"{low} to {high}" for low, high in ranges)
        date = date_text(about_log.date), _DATE_SOURCES[about_log.date_from]
        rows.append(
            cells(
                *(row.file.name, name.name[:_DIGITS] + "…", row.status, *date),
                *(f"{about_log.seconds:.3g}", *counts),
            )
        )
    head = ("log", "digest", "", "began", "by", "s", "samples", "effective")
    failures = [f"{row.file}: {row.reason}" for row in run.rows if row.status == FAILED]
    return Page(
        about,
        headline,
        (
            Section(f"Digests in {run.folder}", tables=(Table(head, rows, words=5),)),
            Section("Logs without a digest", items=tuple(failures)),
            notes_section(digest_notes(run)),
        ),
        verdict="digested",
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
    """Inspected logs by name, and the check of their columns."""

    logs: Sequence[tuple[str, LogInspection]]
    columns: Sequence[ColumnFinding] = ()  # mistakes in columns
    # Why columns were not compared with the model; "" if they were, or there is no model.
    unchecked: str = ""
    repairs: Sequence[str] | None = None  # of the model's file; None without a model
    beyond: Sequence[str] = ()  # positions beyond the model's limits, in sentences
    unread: Sequence[str] = ()  # logs that cannot be read, in sentences

    @property
    def beside_model(self) -> dict[str, Any]:
        """Return unread logs and the findings that need a model, for JSON; may be empty."""
        if self.repairs is None:
            return {"notes": self.unread} if self.unread else {}
        notes = [*self.unread, *self.repairs, *self.beyond, *filter(None, [self.unchecked])]
        return {"columns": self.columns, "notes": notes}


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
            Section(name, "Ranges in SI units.", tables=(_columns_table(each.columns),)),
            Section("Base and feet", tables=(_columns_table(each.floating, "quantity"),)),
            Section("Rows", items=_row_words(each)),
            notes_section(each.notes, each.first),
        ]
    words = [f"{name}: {words}" for name, each in found.logs for words in each.first]
    first = first_section([*found.unread, *words])
    return Page(about, "", tuple(sections), of="", verdict="", first=(first,))


def _columns_table(columns: Sequence[UnderstoodColumn], what: str = "joint") -> Table:
    """Return the range of each quantity in SI units, and its column, with a row for each joint."""
    quantities = list(dict.fromkeys(each.quantity for each in columns))
    rows = {each.joint: dict.fromkeys(quantities, "") for each in columns}
    for each in columns:
        lines = [f"{number(each.lowest)} … {number(each.highest)}"]
        factor = "" if np.isclose(each.factor, 1.0, rtol=1e-12) else f"× {number(each.factor, 4)}"
        column = each.column if each.column != f"{each.joint}.{each.quantity}" else ""
        source = ", ".join(filter(None, (column, f"{each.unit} {factor}".strip())))
        lines += [source] if source else []
        lines += [f"{each.empty} empty"] if each.empty else []
        rows[each.joint][each.quantity] = "\n".join(lines)
    head = (what, *(f"{q}, {_SI[q]}" if q in _SI else q for q in quantities))
    entries = [cells(joint, *texts.values()) for joint, texts in rows.items()]
    return Table(head, entries, words=len(head))


def _row_words(found: LogInspection) -> tuple[str, ...]:
    """Return the rows, rates, gaps and rests of a log in words."""
    log, rate = found.log, len(found.log) / found.seconds
    column = found.time_column
    source = f"time from column {column}" if column else "no time column, constant rate"
    words = [
        f"{len(log)} rows in {number(found.seconds)} s, typically every "
        f"{number(1e3 * found.period)} ms, {number(rate, 4)} Hz on average; {source}"
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

    Commands are drawn with the positions; joints without efforts show command − position.
    """
    log, panels = found.log, []
    rests = tuple(Shade(_POSITION, first, last, "no joint moves") for first, last in found.rests)
    for row, joint in enumerate(log.joints):
        positions = {_POSITION: log.position[:, row]}
        kind, effort = log.effort_kinds.get(joint, "effort"), log.effort[:, row]
        words = {"pwm": "duty cycle, share of 1", "effort": "effort, N·m or N"}.get(
            kind, f"{kind}, {_SI.get(kind, '')}"
        )
        command = None if log.command is None else log.command[:, row]
        if command is not None and np.isfinite(command).any():
            positions[_COMMAND] = command
        if command is not None and not np.isfinite(effort).any():
            effort, words = command - log.position[:, row], "command − position, rad or m"
        plots = Plot("position, rad or m", positions), Plot(words, {_EFFORT: effort})
        panels.append(Panel(joint, "", log.time, plots, rests))
    caption = "Shaded: no joint moves." if found.rests else ""
    return Chart("log", caption, tuple(panels), axis="time, s")


def _digest_values(run: DigestRun) -> dict[str, Any]:
    """Return the outcome for each log."""
    settings, logs = run.settings, []
    for row in run.rows:
        about, entry = row.about, {"log": row.file, "status": row.status, "reason": row.reason}
        if about is not None and settings is not None:
            values = (
                *(about.samples, about.effective, about.noise_floor),
                *(about.position.T, about.speed.T, about.temperature),
            )
            entry |= {
                **picked(about, "date_from", "seconds", "notes"),
                "digest": row.digest,
                "date": date_text(about.date),
                "joints": dict(zip(settings.joints, zip(*values, strict=True), strict=True)),
            }
        logs.append(entry)
    return {
        "settings": settings and record("DigestSettings", settings, columns=len(settings.columns)),
        "counts": {status: run.count(status) for status in (MADE, THERE, FAILED)},
        "logs": logs,
        "notes": digest_notes(run),
    }


def _costs(found: ProvenExport) -> dict[str, float]:
    """Return the nrms of the model and of its files, by JSON key."""
    costs = found.costs
    if costs is None:
        return {}
    simulated = {} if costs.ignored is None else {"simulated_nrms": costs.ignored}
    return {"nrms": costs.whole, "held_nrms": costs.held, **simulated}


VIEWS = {
    ProvenExport: View(
        export_page,
        "Export",
        lambda found: {
            "lacks": [
                picked(lost, "effect", "where", "into", *([] if lost.nrms is None else ["nrms"]))
                for lost in found.lacks
            ],
            "error": _costs(found),
        },
    ),
    DynamicsCheck: View(
        check_page,
        "Check",
        lambda found: {
            "repaired": len(found.repairs) > len(found.left_out),
            "tolerance": TOLERANCE,
            "second_opinion": {
                "by": found.by,
                **({} if found.second is None else record("Agreement", found.second)),
            },
        },
    ),
    DigestRun: View(digests_page, "Digests", _digest_values),
    InspectedLogs: View(
        logs_page,
        "InspectedLogs",
        lambda found: {
            "logs": [record("InspectedLog", each, rows=len(each.log)) for _, each in found.logs],
            **found.beside_model,
        },
    ),
}
"""Type of result -> its view."""
