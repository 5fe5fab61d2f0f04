"""What became of logs that were digested: words, a table, and plain numbers for JSON."""

from __future__ import annotations

from typing import Any

from geodrake.fleet.digest_folder import FAILED, MADE, THERE, DigestRow, DigestRun
from geodrake.fleet.log_places import date_text
from geodrake.fleet.settings import SETTINGS_FILE, DigestSettings
from geodrake.report.json_output import NoNumber, number_or
from geodrake.report.tables import Table, cells

_FROM = {"stamps": "its time stamps", "option": "--date", "file": "when its file was changed"}
_DIGITS = 12  # of a hash, in words


def digests_table(run: DigestRun) -> Table:
    """A row for each log that has a digest: its date, length, samples and what they are worth."""
    rows = tuple(_cells(row) for row in run.rows if row.status != FAILED)
    head = ("log", "digest", "", "began", "by", "s", "samples", "effective")
    return Table(head, rows, words=5)


def _cells(row: DigestRow) -> Any:
    about, name = row.about, row.digest
    if about is None or name is None or row.samples is None or row.effective is None:
        return cells(row.file.name, *("",) * 7)
    samples, effective = row.samples, row.effective
    return cells(
        row.file.name,
        name.name[:_DIGITS] + "…",
        row.status,
        date_text(about.date),
        _FROM[about.date_from],
        f"{about.seconds:.3g}",
        _between(samples.min(), samples.max()),
        _between(effective.min(), effective.max()),
    )


def _between(low: float, high: float) -> str:
    return f"{low:.0f}" if round(low) == round(high) else f"{low:.0f} to {high:.0f}"


def failures(run: DigestRun) -> list[str]:
    """Logs without a digest, each with the reason."""
    return [f"{row.file}: {row.reason}" for row in run.rows if row.status == FAILED]


def digest_notes(run: DigestRun) -> list[str]:
    """Return where settings are from, and what is to say of digests."""
    notes = list(run.repairs)
    notes += [
        f"{row.file}: {row.reason}" for row in run.rows if row.status != FAILED and row.reason
    ]
    if run.settings is not None and run.chosen:
        notes.append(
            f"settings of all digests of {run.folder} are chosen from {run.settings.chosen_from}: "
            f"bandwidth {run.settings.bandwidth:.3g} Hz, {len(run.settings.columns)} columns; they "
            f"are in {SETTINGS_FILE}"
        )
    if any(row.about is not None and row.about.date_from == "file" for row in run.rows):
        notes.append(
            "dates by when files were changed are those of copies, too: --date says others"
        )
    return notes


def digests_verdict(run: DigestRun) -> str:
    """Return how many logs have digests, in a sentence."""
    made, there, failed = (run.count(status) for status in (MADE, THERE, FAILED))
    words = f"{made} made, {there} there already, {failed} failed"
    if failed:
        return f"{words}: the exit code is 1."
    return f"{words}: every log has its digest in {run.folder}."


def digests_dict(run: DigestRun) -> dict[str, Any]:
    """Return what became of logs, as plain numbers for JSON."""
    return {
        "folder": str(run.folder),
        "settings": NoNumber("no log could be used")
        if run.settings is None
        else _settings(run.settings),
        "counts": {status: run.count(status) for status in (MADE, THERE, FAILED)},
        "logs": [_row(row, run.settings) for row in run.rows],
        "notes": digest_notes(run),
    }


def _settings(settings: DigestSettings) -> dict[str, Any]:
    return {
        "hash": settings.hash,
        "model": settings.model,
        "version": settings.version,
        "bandwidth": settings.bandwidth,
        "blocks": settings.blocks,
        "columns": len(settings.columns),
        "chosen_from": settings.chosen_from,
    }


def _row(row: DigestRow, settings: DigestSettings | None) -> dict[str, Any]:
    said: dict[str, Any] = {"log": str(row.file), "status": row.status, "reason": row.reason}
    about = row.about
    if about is None or settings is None or row.samples is None or row.effective is None:
        return said
    unknown = "it was not measured"
    temperature, position, speed = about.temperature, about.position, about.speed
    return {
        **said,
        "digest": str(row.digest),
        "date": date_text(about.date),
        "date_from": about.date_from,
        "seconds": about.seconds,
        "joints": {
            joint: {
                "samples": int(row.samples[j]),
                "effective": float(row.effective[j]),
                "noise_floor": float(about.noise_floor[j]),
                "position": position[:, j].tolist(),
                "speed": speed[:, j].tolist(),
                "temperature": number_or(float(temperature[j]), unknown),
            }
            for j, joint in enumerate(settings.joints)
        },
        "notes": list(about.notes),
    }
