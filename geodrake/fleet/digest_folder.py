"""A folder of digests: one file per log, named by the hash of its inputs, and their settings.

Existing digests are not computed again, so that the same command can be run whenever there are new
logs. Files are written atomically, so that an interrupted run can be resumed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from geodrake.boundary.arguments import file_path, instance, instances, number, typed
from geodrake.boundary.showing import Short
from geodrake.boundary.version import version
from geodrake.boundary.whole_files import check_writable, made_folder, write_new, write_whole
from geodrake.errors import ArgumentError, DigestError, GeodrakeError, OutputError
from geodrake.fleet.digest import DigestedLog, digest_content, read_digest_of
from geodrake.fleet.digest_log import (
    LogFacts,
    Wanted,
    make_digest,
    make_settings,
    model_of_digests,
    reading_settings,
)
from geodrake.fleet.hashes import file_hash, text_hash
from geodrake.fleet.log_places import date_text
from geodrake.fleet.settings import SETTINGS_FILE, DigestSettings, own_sources, read_settings
from geodrake.logs.files import check_log, parts_of, read_log
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog
from geodrake.model.logged_joints import reading_for
from geodrake.model.robot_model import RobotModel

Progress = Callable[[str, float | None], None]
"""Called with the current step and the fraction of the work that is done, if known."""

MADE, THERE, FAILED = "made", "there", "failed"
"""Status of a log: newly digested, digest exists, or no digest."""

_SUFFIX = ".digest"


@dataclass(frozen=True, eq=False)
class DigestRow(Short):
    """Result for one log."""

    file: Path
    status: str
    digest: Path | None = None
    about: DigestedLog | None = None
    reason: str = ""  # for the lack of a digest, or a note


@dataclass(frozen=True, eq=False)
class DigestRun(Short):
    """Result of digesting several logs."""

    folder: Path
    settings: DigestSettings | None  # None if no log was valid
    rows: tuple[DigestRow, ...]
    chosen: bool = False  # whether this run chose the settings
    repairs: tuple[str, ...] = ()  # repairs of the model file

    def count(self, status: str) -> int:
        """Return the number of logs with a status."""
        return sum(row.status == status for row in self.rows)


@dataclass(eq=False)
class _Folder:
    """A folder of digests, with the model and options."""

    path: Path
    model: RobotModel
    wanted: Wanted
    settings: DigestSettings | None = None
    chosen: bool = False

    def add(self, log: Path, facts: LogFacts) -> DigestRow:
        """Return the digest of a log, computed unless it exists."""
        reason = ""
        if self.settings is not None and (file := self._file(self.settings, facts)).exists():
            try:
                (about,) = read_digest_of(file, self.settings).logs
                return DigestRow(log, THERE, file, about)
            except DigestError as error:
                reason = f"digested again: {error.problem}"
        known, reading = self.model.known_joints, reading_for(self.model, self.wanted.reading)
        read = read_log(log, joints=known, partial=True, reading=reading)
        settings = self.settings or self._chosen_from(read)
        digest = make_digest(self.model, read, settings, facts, extra=self.wanted.extra)
        file, content = self._file(settings, facts), digest_content(digest)
        with made_folder(self.path):
            if self.settings is not None:
                write_whole(file, content)
            elif write_new(self.path / SETTINGS_FILE, settings.text(), {file: content}):
                self.settings, self.chosen = settings, True
            else:
                self.take_settings()  # another run chose them first
                return self.add(log, facts)
        return DigestRow(log, MADE, file, digest.logs[0], reason)

    def _chosen_from(self, log: JointLog) -> DigestSettings:
        """Return settings chosen from the first log."""
        try:
            return make_settings(self.model, log, wanted=self.wanted)
        except ArgumentError as error:
            if self.wanted.bandwidth is None:
                raise
            raise DigestError(error.problem, advice=error.advice) from error

    def take_settings(self) -> None:
        """Use the settings of the folder, if any."""
        self.settings = read_settings(self.path)
        if self.settings is not None:
            check_settings(self.settings, self.model, self.wanted)

    def _file(self, settings: DigestSettings, facts: LogFacts) -> Path:
        return self.path / f"{facts.key(settings)}{_SUFFIX}"


@typed
def digest_logs(
    model: RobotModel,
    logs: Sequence[str | Path],
    to: str | Path,
    *,
    wanted: Wanted | None = None,
    date: float | None = None,
    payloads: Mapping[Path, Sequence[KnownPayload]] | None = None,
    progress: Progress = lambda words, share: None,
) -> DigestRun:
    """Digest logs into a folder; logs with existing digests are not read.

    An invalid log results in a row with the reason; the others are still digested.

    Args:
        to: The folder. Its settings are used; if it has none, they are chosen from the model and
            the first valid log, and written.
        wanted: Requested settings.
        date: Date of logs whose time stamps are not dates, s since 1970.
        payloads: Log -> payloads of known mass, not in the model, carried during the whole log.
        progress: Called with the progress.

    Raises:
        DigestError: The folder's settings are damaged, of another version or model, or differ from
            the requested ones.
        ArgumentError: A setting is invalid, or there is no log.
        OutputError: The folder cannot be written to.
    """
    files = [file_path(log) for log in instances(logs, "logs", (str, Path))]
    if not files:
        raise ArgumentError("There are no logs to digest.", advice="Give at least one.")
    wanted = wanted or Wanted()
    carried = {}
    for log, log_payloads in instance(payloads or {}, "payloads", Mapping).items():
        if log not in files:
            names = ", ".join(map(str, files))
            raise ArgumentError(
                f"There are payloads for {log!r}, which is not a log.", advice=f"Logs are {names}."
            )
        carried[log] = instances(log_payloads, f"payloads of {log}", KnownPayload)
    if date is not None:
        number(date, "date", lower=0.0, strict=True)
    path = file_path(to)
    _check_folder(path)
    folder = _Folder(path, model, wanted)
    folder.take_settings()
    rows = []
    for k, log in enumerate(files):
        progress(f"Digesting {log.name}", k / len(files))
        rows.append(_row(folder, log, date, carried.get(log, ())))
    return DigestRun(path, folder.settings, tuple(rows), folder.chosen, model.repairs)


def digest_files(folder: str | Path) -> tuple[Path, ...]:
    """Return the digest files in a folder, sorted by name."""
    path = file_path(folder)
    try:
        return tuple(sorted(file for file in path.iterdir() if file.suffix == _SUFFIX))
    except OSError as error:
        raise DigestError(
            f"{path} is not a folder of digests: {error.strerror}.", advice="Check the path."
        ) from error


def _row(
    folder: _Folder, log: Path, date: float | None, payloads: tuple[KnownPayload, ...]
) -> DigestRow:
    """Return the result for a log, including its errors."""
    try:
        files = parts_of(log)
        for file in files:
            check_log(file)
        episode = folder.wanted.reading.episode
        facts = LogFacts(file_hash(files), files, date, payloads, episode)
        row = folder.add(log, facts)
    except (OutputError, DigestError):  # these concern all logs
        raise
    except GeodrakeError as error:
        return DigestRow(log, FAILED, reason=str(error))
    except (OSError, MemoryError) as error:
        return DigestRow(log, FAILED, reason=f"{log} cannot be read: {error}.")
    about = row.about
    if about is None or row.status != THERE or about.date_from == "stamps":
        return row
    if date is None or date == about.date:
        return row
    return replace(
        row, reason=f"its date is still {date_text(about.date)}: delete the digest to change it"
    )


def _check_folder(path: Path) -> None:
    """Raise if a folder cannot be written to, before expensive work."""
    try:
        check_writable(path / f"digest{_SUFFIX}" if os.path.lexists(path) else path)
    except OutputError as error:
        raise OutputError(
            f"Digests cannot be written to {path}: {error.evidence.get('reason', error)}.",
            advice="Choose another folder.",
        ) from error


def check_settings(settings: DigestSettings, model: RobotModel, wanted: Wanted) -> None:
    """Raise if the settings differ from the requested ones."""
    if settings.version != (current := version()):
        raise _mismatch(
            f"are from geodrake {settings.version}, but this is {current}: columns may differ.",
            "Digest the logs again into a new folder.",
        )
    model_of_digests(model, settings)
    requested = {"bandwidth": wanted.bandwidth, "blocks": wanted.blocks}
    for name, value in requested.items():
        existing = getattr(settings, name)
        if value is not None and not np.isclose(value, existing, rtol=1e-9, atol=0.0):
            raise _mismatch(
                f"have {name} {existing:g}, but {value:g} was requested.",
                "Omit it, or choose a new folder.",
            )
    reading = reading_settings(wanted.reading)
    differing = [
        name
        for name, value in reading.items()
        if text_hash(value) != text_hash(settings.reading.get(name))
    ]
    if differing:
        raise _mismatch(
            f"have other reading options: {', '.join(differing)} differ.",
            "Use the options of the first digest, or choose a new folder.",
        )
    sources = own_sources(wanted.extra)
    if sources != dict(settings.extra):
        names = [", ".join(effects) or "none" for effects in (settings.extra, sources)]
        raise _mismatch(
            f"have user-defined effects {names[0]}, but now {names[1]}, or their source has "
            "changed.",
            "Use the same files with --effects, or choose a new folder.",
        )
    for effect in settings.effects:
        effect.made(wanted.extra)


def _mismatch(words: str, advice: str) -> DigestError:
    return DigestError(f"The settings of the digests {words}", advice=advice)
