"""A folder of digests: one file per log, named by the hash of its inputs, and their settings.

A digest that is there is not made again, so that the same command may be run whenever logs have
come. Files appear whole or not at all: a run that was stopped goes on where it was.
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
    said_of_reading,
)
from geodrake.fleet.hashes import file_hash, text_hash
from geodrake.fleet.log_places import date_text
from geodrake.fleet.settings import SETTINGS_FILE, DigestSettings, own_sources, read_settings
from geodrake.logs.files import check_log, parts_of, read_log
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.motion import JointLog
from geodrake.model.logged_joints import reading_for
from geodrake.model.robot_model import RobotModel

Told = Callable[[str, float | None], None]
"""Called with the current step and the share of the work that is done, if known."""

MADE, THERE, FAILED = "made", "there", "failed"
"""The outcome for a log: digested, digest already there, or no digest."""

_SUFFIX = ".digest"


@dataclass(frozen=True, eq=False)
class DigestRow(Short):
    """The outcome for one log."""

    file: Path
    status: str
    digest: Path | None = None
    about: DigestedLog | None = None
    reason: str = ""  # why there is no digest; or what else is to say of it


@dataclass(frozen=True, eq=False)
class DigestRun(Short):
    """Outcome of digesting several logs."""

    folder: Path
    # Their settings; None if no log could be used, so that none are chosen.
    settings: DigestSettings | None
    rows: tuple[DigestRow, ...]
    chosen: bool = False
    repairs: tuple[str, ...] = ()  # what of the model's file is not believed

    def count(self, status: str) -> int:
        """Return how many logs have a status."""
        return sum(row.status == status for row in self.rows)


@dataclass(eq=False)
class _Folder:
    """A folder of digests, the model, and how logs are read."""

    path: Path
    model: RobotModel
    wanted: Wanted
    settings: DigestSettings | None = None
    chosen: bool = False

    def add(self, log: Path, facts: LogFacts) -> DigestRow:
        """Return the digest of a log, made unless it is there."""
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
                self.take_settings()  # another run was quicker to choose them
                return self.add(log, facts)
        return DigestRow(log, MADE, file, digest.logs[0], reason)

    def _chosen_from(self, log: JointLog) -> DigestSettings:
        """Return settings by the first log."""
        try:
            return make_settings(self.model, log, wanted=self.wanted)
        except ArgumentError as error:
            if self.wanted.bandwidth is None:
                raise
            raise DigestError(error.problem, advice=error.advice) from error

    def take_settings(self) -> None:
        """Take the settings that the folder has, if it has any."""
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
    told: Told = lambda words, share: None,
) -> DigestRun:
    """Digest logs into a folder; logs whose digests are there are not read.

    A log that cannot be read or used is a row with its reason, and the others go on.

    Args:
        to: The folder. If it has settings, they count; else they are chosen by the model and the
            first log that can be used, and written.
        date: When logs were recorded whose stamps do not say it, s since 1970.
        payloads: Log -> what the robot carried all the time, of known mass, beyond its model.

    Raises:
        DigestError: The folder's settings are damaged, of another version or model, or not what is
            wanted.
        ArgumentError: A setting is no usable number, or there is no log.
        OutputError: The folder cannot be written to.
    """
    files = [file_path(log) for log in instances(logs, "logs", (str, Path))]
    if not files:
        raise ArgumentError("There are no logs to digest.", advice="Give at least one.")
    wanted = wanted or Wanted()
    carried = {}
    for log, own in instance(payloads or {}, "payloads", Mapping).items():
        if log not in files:
            names = ", ".join(map(str, files))
            raise ArgumentError(
                f"There are payloads for {log!r}, which is not a log.", advice=f"Logs are {names}."
            )
        carried[log] = instances(own, f"payloads of {log}", KnownPayload)
    if date is not None:
        number(date, "date", lower=0.0, strict=True)
    path = file_path(to)
    _check_folder(path)
    folder = _Folder(path, model, wanted)
    folder.take_settings()
    rows = []
    for at, log in enumerate(files):
        told(f"Digesting {log.name}", at / len(files))
        rows.append(_row(folder, log, date, carried.get(log, ())))
    return DigestRun(path, folder.settings, tuple(rows), folder.chosen, model.repairs)


def digest_files(folder: str | Path) -> tuple[Path, ...]:
    """Return the files of digests in a folder, by name."""
    path = file_path(folder)
    try:
        return tuple(sorted(each for each in path.iterdir() if each.suffix == _SUFFIX))
    except OSError as error:
        raise DigestError(
            f"{path} is not a folder of digests: {error.strerror}.", advice="Check the path."
        ) from error


def _row(
    folder: _Folder, log: Path, date: float | None, payloads: tuple[KnownPayload, ...]
) -> DigestRow:
    """Return the outcome for a log, whatever error it has."""
    try:
        files = parts_of(log)
        for file in files:
            check_log(file)
        episode = folder.wanted.reading.episode
        facts = LogFacts(file_hash(files), files, date, payloads, episode)
        row = folder.add(log, facts)
    except (OutputError, DigestError):  # which are not of this log alone
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
    """Raise if a folder cannot be written to, before the work."""
    try:
        check_writable(path / f"digest{_SUFFIX}" if os.path.lexists(path) else path)
    except OutputError as error:
        raise OutputError(
            f"Digests cannot be written to {path}: {error.evidence.get('reason', error)}.",
            advice="Choose another folder.",
        ) from error


def check_settings(settings: DigestSettings, model: RobotModel, wanted: Wanted) -> None:
    """Raise if the settings are for something other than what is wanted."""
    if settings.version != (own := version()):
        raise _other(
            f"are from geodrake {settings.version}, but this is {own}: columns may differ.",
            "Digest the logs again into a new folder.",
        )
    model_of_digests(model, settings)
    asked = {"bandwidth": wanted.bandwidth, "blocks": wanted.blocks}
    for name, value in asked.items():
        there = getattr(settings, name)
        if value is not None and not np.isclose(value, there, rtol=1e-9, atol=0.0):
            raise _other(
                f"have {name} {there:g}, but {value:g} was requested.",
                "Omit it, or choose a new folder.",
            )
    said = said_of_reading(wanted.reading)
    odd = [name for name in said if text_hash(said[name]) != text_hash(settings.reading.get(name))]
    if odd:
        raise _other(
            f"have other reading options: {', '.join(odd)} differ.",
            "Use the options of the first digest, or choose a new folder.",
        )
    given = own_sources(wanted.extra)
    if given != dict(settings.extra):
        names = [", ".join(each) or "none" for each in (settings.extra, given)]
        raise _other(
            f"have user-defined effects {names[0]}, but now {names[1]}, or their source has "
            "changed.",
            "Use the same files with --effects, or choose a new folder.",
        )
    for effect in settings.effects:
        effect.made(wanted.extra)


def _other(words: str, advice: str) -> DigestError:
    return DigestError(f"The settings of the digests {words}", advice=advice)
