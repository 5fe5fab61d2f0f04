"""Settings shared by all digests of a folder: their columns, and how logs are read.

Values that a diagnosis would choose from its logs (bandwidth, speeds of joints at rest, candidate
effects) are chosen once, from the model and the first log, and kept in a file. Only digests with
the same settings can be added.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from geodrake.boundary.arguments import file_path
from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import read_regular
from geodrake.boundary.showing import Short
from geodrake.effects import Effect, make_effect
from geodrake.errors import ArgumentError, DigestError
from geodrake.fleet.hashes import source_hash, text_hash
from geodrake.identification.logs.dataset import is_payload
from geodrake.inertia import Array
from geodrake.inertia.parameters import PARAMETER_NAMES, PARAMETER_UNITS

SETTINGS_FILE = "digest_settings.json"
"""Name of the settings file in a folder of digests."""

DIGEST_NAME = r"[0-9a-f]{32}\.digest"
"""Pattern of the names of digest files."""

FORMAT = "geodrake digest 4"
"""Name and version of the format of settings and digests."""

BLOCKS = 4
"""Default number of blocks of a log, each with its own factor."""

_CACHED_SETTINGS = 4
_LARGEST_FILE = 50_000_000  # bytes
_MOST_LETTERS = 24  # of a value in a message


@dataclass(frozen=True)
class DigestColumn:
    """A column of a digest."""

    kind: str
    name: str  # such as `Izz of arm`, or the name of the effect
    where: tuple[str, ...]  # the body, or joints or bodies of the effect
    parameter: str  # such as `Izz`, or the name of the effect's parameter
    unit: str
    shape: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class DigestEffect:
    """An effect with columns in digests."""

    name: str
    where: tuple[str, ...]
    shape: Mapping[str, float]
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    in_bodies: bool  # whether its columns are those of the bodies, as a payload's are
    source: str = ""  # SHA-256 of the source of a user-defined effect

    @classmethod
    def of(cls, effect: Effect) -> DigestEffect:
        """Return the description of an effect."""
        return cls(
            effect.name,
            tuple(effect.where),
            {name: float(value) for name, value in effect.shape.items() if value is not None},
            tuple(parameter.name for parameter in effect.parameters),
            tuple(parameter.unit for parameter in effect.parameters),
            is_payload(effect),
            source_hash(type(effect)),
        )

    def made(self, extra: Sequence[type[Effect]] = ()) -> Effect:
        """Return the effect."""
        try:
            effect = make_effect(self.name, self.where, self.shape, extra)
        except ArgumentError as error:
            raise DigestError(
                f"Digests have columns of {self.name}, which cannot be constructed: "
                f"{error.problem}",
                advice="If it is an effect of your own, give its file.",
            ) from error
        if DigestEffect.of(effect) != self:
            raise DigestError(
                f"The effect {self.name} has changed since the settings were made.",
                advice="Use its old source, or a new folder.",
            )
        return effect


@dataclass(frozen=True, eq=False)
class DigestSettings(Short):
    """Settings that all digests of a folder share."""

    model: str  # hash of the model; see `model_hash`
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    held: Mapping[str, float]  # joint without data in logs -> its fixed position, rad or m
    bandwidth: float  # of the filter for efforts and regressors, Hz
    motion_bandwidth: float  # of the smoothed motion, Hz
    sign_width: Array  # (nv,) speed below which dry friction fades, rad/s or m/s
    still_speed: Array  # (nv,) speed below which a joint counts as at rest, rad/s or m/s
    # Delays with a column of efforts, in addition to the model's, s; the first is 0.
    delays: tuple[float, ...]
    effects: tuple[DigestEffect, ...]  # effects with columns: the model's, then candidates
    extra: Mapping[str, str]  # user-defined effect -> SHA-256 of its source
    reading: Mapping[str, Any]  # reading options common to all logs
    blocks: int
    version: str
    format: str = FORMAT
    chosen_from: str = ""  # name of the log from which they were chosen
    passive: tuple[str, ...] = ()  # joints without a motor

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the settings, except for `chosen_from`."""
        return text_hash(replace(self, chosen_from="").plain)

    @property
    def plain(self) -> dict[str, Any]:
        """The settings as JSON data."""
        return dict(msgspec.to_builtins(self, enc_hook=np.ndarray.tolist))

    @cached_property
    def columns(self) -> tuple[DigestColumn, ...]:
        """The p columns: the ten parameters of each body, then the effects' parameters."""
        body_columns = [
            DigestColumn("body", f"{name} of {body}", (body,), name, unit)
            for body in self.bodies
            for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)
        ]
        effect_columns = [
            DigestColumn("effect", effect.name, effect.where, name, unit, effect.shape)
            for effect in self.effects
            if not effect.in_bodies
            for name, unit in zip(effect.parameters, effect.units, strict=True)
        ]
        return (*body_columns, *effect_columns)

    def differences(self, other: DigestSettings) -> list[str]:
        """Return descriptions of differences; empty if the digests can be added."""
        first, second = self.plain, other.plain
        return [
            f"{_WORDS.get(name, name)} ({_shown(first[name])} and {_shown(second[name])})"
            for name in first
            if name != "chosen_from" and text_hash(first[name]) != text_hash(second[name])
        ]

    def text(self) -> str:
        """Return the text of the settings file, for `settings_of`."""
        data = self.plain | {"hash": self.hash}
        lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in data.items()]
        return "{\n" + ",\n".join(lines) + "\n}\n"


_WORDS = {
    "extra": "effects of your own",
    "motion_bandwidth": "bandwidth of the motion",
    "passive": "joints without a motor",
    "sign_width": "widths of signs",
    "still_speed": "speeds of rest",
    "reading": "how logs are read",
    "version": "version of geodrake",
}


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _MOST_LETTERS else f"{text[:_MOST_LETTERS]}…"


def settings_of(text: str, source: str | Path) -> DigestSettings:
    """Return settings from the text of `DigestSettings.text`."""
    try:
        return _settings_of(text)
    except (ArithmeticError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise DigestError(
            f"{source} has no valid settings of digests: {one_line(error)}.",
            advice="Restore it from a copy, or digest the logs again into a new folder.",
        ) from error


@lru_cache(_CACHED_SETTINGS)  # all digests of a folder contain the same text
def _settings_of(text: str) -> DigestSettings:
    data = json.loads(text)
    if data.get("format") != FORMAT:
        raise ValueError(
            f"it has format {data.get('format')!r}, but this version of geodrake reads {FORMAT!r}"
        )
    settings = msgspec.convert(
        data, DigestSettings, dec_hook=lambda _, values: np.array(values, float)
    )
    if settings.hash != data.get("hash"):
        raise ValueError("its hash belongs to other settings")
    return settings


def read_settings(folder: str | Path) -> DigestSettings | None:
    """Read the settings of a folder of digests; None if it has no digests yet.

    Raises:
        DigestError: The file cannot be read, is damaged or of another version, or is missing.
    """
    path = file_path(folder) / SETTINGS_FILE
    if not path.exists() and not path.is_symlink():
        if any(re.fullmatch(DIGEST_NAME, file.name) for file in path.parent.glob("*.digest")):
            raise DigestError(
                f"The settings file {path} of the digests is missing.",
                advice="Restore it from a copy, or digest the logs again into a new folder.",
            )
        return None
    data = read_regular(path, "settings file", DigestError, largest=_LARGEST_FILE)
    try:
        return settings_of(data.decode(), path)
    except UnicodeDecodeError as error:
        raise DigestError(
            f"The settings file {path} cannot be read: {one_line(error)}.",
            advice="Restore it from a copy.",
        ) from error


def own_sources(extra: Sequence[type[Effect]]) -> dict[str, str]:
    """Return name of each user-defined effect -> SHA-256 of its source."""
    return {kind.name: source_hash(kind) for kind in extra}
