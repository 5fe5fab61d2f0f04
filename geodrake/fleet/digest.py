"""Digests: logs as a few normal matrices, over columns that all logs of a folder share.

Of each joint and block of a log a digest has the `JointData` that a fit is made from, without rows,
and how many independent samples what a fit leaves is worth. Fits, changes from day to day and
hierarchies of robots are small problems on these, and nobody goes back to samples. Digests of
several logs are one digest: their blocks side by side.

A file holds all of a digest, and the text of its settings. In a folder, its name is the key that it
holds, which is the hash of its log, of known payloads and of the settings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import file_path, instance, instances
from geodrake.boundary.input_files import read_regular
from geodrake.boundary.showing import Short
from geodrake.errors import ArgumentError, DigestError
from geodrake.fleet.sealed_file import LARGEST, DamagedFileError, sealed, unsealed
from geodrake.fleet.settings import FORMAT, DigestColumn, DigestSettings, settings_of
from geodrake.identification.logs.dataset import JointData
from geodrake.identification.logs.reduce import effort_deviation
from geodrake.inertia import Array
from geodrake.logs.known_payload import KnownPayload


@dataclass(frozen=True, eq=False)
class DigestedLog(Short):
    """Facts that a digest keeps of a log besides its normal matrices."""

    name: str
    content: str  # SHA-256 of the bytes of its file
    fingerprint: str
    key: str  # name of its digest: hash of content, settings and known payloads
    date: float  # when it began, s since 1970
    # Where the date is from: `stamps`, `option` or `file`, which is when the file was changed last.
    date_from: str
    seconds: float
    bandwidth: float  # of the filter that its period allows, nearest to the settings', Hz
    # Known payloads that the robot carried; their efforts are taken off.
    payloads: tuple[KnownPayload, ...]
    noise_floor: Array  # (nv,) estimated RMS of the sensor noise after filtering, N·m or N
    gain_deviations: Array  # (nv,) how well the gains of the efforts are known, as shares
    position: Array  # (2, nv) least and largest position of each joint, rad or m
    speed: Array  # (2, nv) least and largest velocity, rad/s or m/s
    temperature: Array  # (nv,) mean temperature of each joint, °C; NaN where it was not measured
    samples: NDArray[np.int_]  # (nv,) rows of each joint; 0 for one that rests
    # (nv,) independent samples that what the model leaves of each block is worth, refitted to the
    # others; 0 of a joint at rest.
    effective: Array
    residual_power: Array  # (nv,) sum of squares of that, (N·m)² or N²
    # (nv,) how large the effort of a joint without a motor could be, N·m or N; zeros at others.
    effort_scale: Array
    passive_inertia: Array | None  # as in `Dataset`
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Digest(Short):
    """The digest of one or several logs, over the columns of `settings`.

    The numbering of columns is that of `columns`: first inertial parameters of the bodies, then the
    parameters of effects, those of the model first. Bodies are those of the model and not
    differences from them: b is the whole measured effort (less what known payloads need).
    """

    settings: DigestSettings
    logs: tuple[DigestedLog, ...]  # one unless it is merged
    blocks: tuple[str, ...]
    joints: tuple[JointData, ...]

    @property
    def columns(self) -> tuple[DigestColumn, ...]:
        """The p columns."""
        return self.settings.columns

    @property
    def samples(self) -> NDArray[np.int_]:
        """(nv,) rows of each joint; 0 for one that rests."""
        return np.sum([log.samples for log in self.logs], axis=0)

    @property
    def effective(self) -> Array:
        """(nv,) independent samples that the residuals of each joint are worth."""
        return np.sum([log.effective for log in self.logs], axis=0)

    @property
    def effort_std(self) -> Array:
        """(nv,) standard deviation of the measured efforts, N·m or N; 0 of a joint at rest.

        Of joints without a motor, how large their efforts could be.
        """
        joints = self.settings.joints
        deviation = effort_deviation(joints, self.joints, joints)
        passive = np.isin(joints, self.settings.passive)
        return np.where(passive & (self.samples > 0), self.effort_scale, deviation)

    @property
    def effort_scale(self) -> Array:
        """(nv,) largest efforts of joints without a motor, N·m or N; zero at other joints."""
        return np.sqrt(np.mean([log.effort_scale**2 for log in self.logs], axis=0))

    @property
    def passive_inertia(self) -> Array | None:
        """Return `Dataset.passive_inertia`, the mean over logs; None if all joints have motors."""
        known = [log.passive_inertia for log in self.logs if log.passive_inertia is not None]
        return np.mean(known, axis=0) if known else None

    @property
    def noise_floor(self) -> Array:
        """(nv,) RMS of the sensor noise after filtering, N·m or N."""
        seconds = [log.seconds for log in self.logs]
        return np.sqrt(np.average([log.noise_floor**2 for log in self.logs], 0, seconds))

    def normal_matrices(self, *, delay: int = 0, block: int | None = None) -> Array:
        """Return (nv, p + 1, p + 1) G_j = [A | b]ᵀ[A | b] of every joint over all columns.

        The last row and column are the effort's. Rows of columns that are zero at a joint are zero.

        Args:
            delay: Index of the settings' delay by which efforts are advanced.
            block: Index of a block; the sum over all of them if None.
        """
        size = len(self.columns) + 1
        found = np.zeros((len(self.joints), size, size))
        for own, joint in zip(found, self.joints, strict=True):
            at = np.append(joint.columns, size - 1)
            kept = [*range(len(joint.columns)), len(joint.columns) + delay]
            gram = joint.gram if block is None else joint.grams[block]
            own[np.ix_(at, at)] = gram[np.ix_(kept, kept)]
        return found


_JOINED = "factors", "samples", "seen", "effort_sums", "carried"  # of blocks


def merge(digests: Sequence[Digest]) -> Digest:
    """Return one digest of the logs of several: as if they had been read together, exactly.

    Blocks stay what they are, so that any normal matrix is the sum of those of the digests, and
    triangular factors lose no digits.

    Raises:
        DigestError: Settings differ, or a log is there twice.
        ArgumentError: There is none.
    """
    digests = instances(digests, "digests", Digest)
    if not digests:
        raise ArgumentError("There are no digests to merge.", advice="Give at least one.")
    first = digests[0].settings
    digests = [by_settings(d, first, f"The digest of {d.logs[0].name}") for d in digests]
    logs = tuple(log for digest in digests for log in digest.logs)
    (twice, count), *_ = Counter(log.fingerprint for log in logs).most_common(1)
    if count > 1:
        names = [log.name for log in logs if log.fingerprint == twice]
        raise DigestError(
            f"Several digests have the same log: {', '.join(names)}.",
            advice="Use each log once.",
        )
    return Digest(
        first,
        logs,
        tuple(block for digest in digests for block in digest.blocks),
        tuple(_joined(parts) for parts in zip(*(digest.joints for digest in digests), strict=True)),
    )


def by_settings(digest: Digest, settings: DigestSettings, what: str) -> Digest:
    """Return the digest if it has these settings; raise DigestError with the differences if not."""
    if digest.settings.hash != settings.hash:
        words = ", ".join(digest.settings.differences(settings))
        raise DigestError(
            f"{what} has other settings: they differ in {words}.",
            advice="Digest the logs again with one model into one folder.",
        )
    return digest


def _joined(parts: Sequence[JointData]) -> JointData:
    """Return the joint's data of several digests."""
    together: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in _JOINED
    }
    together["rows"] = tuple(row for part in parts for row in part.rows)
    return replace(parts[0], peaks=np.max([part.peaks for part in parts], axis=0), **together)


def digest_content(digest: Digest) -> bytes:
    """Return the content of a digest's file: the same for the same digest on every machine."""
    instance(digest, "digest", Digest)
    parts = digest.logs, digest.blocks, digest.joints
    return sealed((digest.settings.text(), *parts), FORMAT)


def read_digest_of(path: Path, settings: DigestSettings) -> Digest:
    """Read the digest of one log in a folder, and check that it is of the log in its name."""
    digest = by_settings(read_digest(path), settings, str(path))
    if [log.key for log in digest.logs] != [path.stem]:
        names = ", ".join(log.name for log in digest.logs)
        raise DigestError(
            f"{path} has the digest of another log, {names}: it was copied or renamed.",
            advice="Delete it, and digest its log again.",
        )
    return digest


def read_digest(path: str | Path) -> Digest:
    """Read the digest that `geodrake digest` wrote.

    Raises:
        DigestError: It is no digest, damaged, or of another version of the format.
    """
    path = file_path(path)
    data = read_regular(path, "digest", DigestError, largest=LARGEST)
    try:
        settings, logs, blocks, joints = unsealed(
            data,
            FORMAT,
            tuple[str, tuple[DigestedLog, ...], tuple[str, ...], tuple[JointData, ...]],
        )
    except DamagedFileError as error:
        raise DigestError(
            f"{path} is not a digest, or damaged: {error}.",
            advice="Delete it, and digest its log again.",
        ) from error
    return Digest(settings_of(settings, path), logs, blocks, joints)
