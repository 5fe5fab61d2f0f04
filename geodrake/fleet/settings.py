"""Settings that all digests of a folder share: their columns, and how logs are read.

Everything that a diagnosis chooses from its logs (a bandwidth, speeds at which joints rest, effects
to try) is chosen once, by the model and the first log, and kept in a file. Digests by the same
settings add up; others are refused, with what differs.
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
"""Blocks of a log, each with its own factor."""

_SETTINGS = 4  # that a process keeps
_LARGEST_FILE = 50_000_000  # bytes
_MOST_LETTERS = 24  # of a value that a message shows


@dataclass(frozen=True)
class DigestColumn:
    """A column of a digest."""

    kind: str
    name: str  # `Izz of arm`, for example; the name of the effect
    where: tuple[str, ...]  # the body; joints or bodies of the effect
    parameter: str  # `Izz`, for example; the parameter's name
    unit: str
    shape: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class DigestEffect:
    """An effect that digests have columns for."""

    name: str
    where: tuple[str, ...]
    shape: Mapping[str, float]
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    in_bodies: bool  # whether its columns are those of the bodies, as a payload's are
    source: str = ""  # SHA-256 of the source of an effect of the user's own

    @classmethod
    def of(cls, effect: Effect) -> DigestEffect:
        """Return an effect in words and numbers."""
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
        """Return the effect itself."""
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
    held: Mapping[str, float]  # joint that no log says anything of -> where it is held, rad or m
    bandwidth: float  # that efforts and regressors are filtered to, Hz
    motion_bandwidth: float  # that of the smoothed motion, Hz
    sign_width: Array  # (nv,) speed below which dry friction fades, rad/s or m/s
    still_speed: Array  # (nv,) speed below which a joint counts as at rest, rad/s or m/s
    # Delays between motion and effort that have a column of efforts, on top of the model's, s; the
    # first is 0.
    delays: tuple[float, ...]
    # What has columns beside the bodies: the model's effects, then candidates.
    effects: tuple[DigestEffect, ...]
    # Effect of the user's own that may have columns -> SHA-256 of its source.
    extra: Mapping[str, str]
    reading: Mapping[str, Any]  # how logs are read, as far as that is the same for all
    blocks: int
    version: str
    format: str = FORMAT
    chosen_from: str = ""  # the log by which they were chosen
    passive: tuple[str, ...] = ()  # joints without a motor

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all of them, whichever log they were chosen from."""
        return text_hash(replace(self, chosen_from="").plain)

    @property
    def plain(self) -> dict[str, Any]:
        """Return the settings as JSON has them."""
        return dict(msgspec.to_builtins(self, enc_hook=np.ndarray.tolist))

    @cached_property
    def columns(self) -> tuple[DigestColumn, ...]:
        """The p columns: the ten parameters of each body, then the effects' parameters."""
        of_bodies = [
            DigestColumn("body", f"{name} of {body}", (body,), name, unit)
            for body in self.bodies
            for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)
        ]
        of_effects = [
            DigestColumn("effect", effect.name, effect.where, name, unit, effect.shape)
            for effect in self.effects
            if not effect.in_bodies
            for name, unit in zip(effect.parameters, effect.units, strict=True)
        ]
        return (*of_bodies, *of_effects)

    def differences(self, other: DigestSettings) -> list[str]:
        """Return in words how settings differ from others; empty if their digests can be added."""
        own, others = self.plain, other.plain
        return [
            f"{_WORDS.get(name, name)} ({_shown(own[name])} and {_shown(others[name])})"
            for name in own
            if name != "chosen_from" and text_hash(own[name]) != text_hash(others[name])
        ]

    def text(self) -> str:
        """Return the text of the settings file, which `settings_of` reads."""
        said = self.plain | {"hash": self.hash}
        lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in said.items()]
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


@lru_cache(_SETTINGS)  # all digests of a folder hold the same
def _settings_of(text: str) -> DigestSettings:
    said = json.loads(text)
    if said.get("format") != FORMAT:
        raise ValueError(
            f"it has format {said.get('format')!r}, but this version of geodrake reads {FORMAT!r}"
        )
    found = msgspec.convert(
        said, DigestSettings, dec_hook=lambda _, values: np.array(values, float)
    )
    if found.hash != said.get("hash"):
        raise ValueError("its hash belongs to other settings")
    return found


def read_settings(folder: str | Path) -> DigestSettings | None:
    """Read the settings of a folder of digests; None if it has none yet.

    Raises:
        DigestError: The file cannot be read, is damaged, of another version, or not there while
            digests are.
    """
    path = file_path(folder) / SETTINGS_FILE
    if not path.exists() and not path.is_symlink():
        if any(re.fullmatch(DIGEST_NAME, each.name) for each in path.parent.glob("*.digest")):
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
    """Name of an effect of the user's own -> SHA-256 of its source."""
    return {kind.name: source_hash(kind) for kind in extra}
