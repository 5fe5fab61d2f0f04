"""Digests: logs as a few normal matrices, over columns shared by all logs of a folder.

A digest contains, for each joint and block of a log, the `JointData` of a fit without rows, and the
effective sample size of residuals. Fits, changes over time and hierarchical models of robots are
small problems on digests, and do not need the samples. Digests can be merged by concatenating their
blocks.

A file contains a digest and the text of its settings. In a folder its name is its key, the hash of
the log, known payloads and settings.
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
    """Data of a log in a digest besides its normal matrices."""

    name: str
    content: str  # SHA-256 of the bytes of its file
    fingerprint: str
    key: str  # name of its digest: hash of content, settings and known payloads
    date: float  # start of the log, s since 1970
    date_from: str  # source of the date: `stamps`, `option` or `file` (last modification)
    seconds: float
    bandwidth: float  # of the filter, closest to the settings' for the log's period, Hz
    payloads: tuple[KnownPayload, ...]  # known payloads, whose efforts are subtracted
    noise_floor: Array  # (nv,) estimated RMS of the sensor noise after filtering, N·m or N
    gain_deviations: Array  # (nv,) relative standard deviations of the gains of efforts
    position: Array  # (2, nv) minimum and maximum position of each joint, rad or m
    speed: Array  # (2, nv) minimum and maximum velocity, rad/s or m/s
    temperature: Array  # (nv,) mean temperature of each joint, °C; NaN if not measured
    samples: NDArray[np.int_]  # (nv,) rows of each joint; 0 at rest
    # (nv,) effective sample size of the residuals in each block of the model refitted to the other
    # blocks; 0 at rest.
    effective: Array
    residual_power: Array  # (nv,) sum of squares of these residuals, (N·m)² or N²
    effort_scale: Array  # (nv,) possible size of efforts of joints without a motor; 0 at others
    passive_inertia: Array | None  # as in `Dataset`
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Digest(Short):
    """The digest of one or several logs, over the columns of `settings`.

    The order of columns is that of `columns`: inertial parameters of the bodies, then parameters of
    effects, those of the model first. Inertial parameters are absolute, not relative to the model:
    b is the measured effort, minus that of known payloads.
    """

    settings: DigestSettings
    logs: tuple[DigestedLog, ...]  # one unless merged
    blocks: tuple[str, ...]
    joints: tuple[JointData, ...]

    @property
    def columns(self) -> tuple[DigestColumn, ...]:
        """The p columns."""
        return self.settings.columns

    @property
    def samples(self) -> NDArray[np.int_]:
        """(nv,) rows of each joint; 0 at rest."""
        return np.sum([log.samples for log in self.logs], axis=0)

    @property
    def effective(self) -> Array:
        """(nv,) effective sample size of the residuals of each joint."""
        return np.sum([log.effective for log in self.logs], axis=0)

    @property
    def effort_std(self) -> Array:
        """(nv,) standard deviation of the measured efforts, N·m or N; 0 at rest.

        For joints without a motor, the possible size of efforts.
        """
        joints = self.settings.joints
        deviation = effort_deviation(joints, self.joints, joints)
        passive = np.isin(joints, self.settings.passive)
        return np.where(passive & (self.samples > 0), self.effort_scale, deviation)

    @property
    def effort_scale(self) -> Array:
        """(nv,) possible size of efforts of joints without a motor, N·m or N; 0 at others."""
        return np.sqrt(np.mean([log.effort_scale**2 for log in self.logs], axis=0))

    @property
    def passive_inertia(self) -> Array | None:
        """`Dataset.passive_inertia`, the mean over logs; None if all joints have motors."""
        values = [log.passive_inertia for log in self.logs if log.passive_inertia is not None]
        return np.mean(values, axis=0) if values else None

    @property
    def noise_floor(self) -> Array:
        """(nv,) RMS of the sensor noise after filtering, N·m or N."""
        seconds = [log.seconds for log in self.logs]
        return np.sqrt(np.average([log.noise_floor**2 for log in self.logs], 0, seconds))

    def normal_matrices(self, *, delay: int = 0, block: int | None = None) -> Array:
        """Return (nv, p + 1, p + 1) G_j = [A | b]ᵀ[A | b] of each joint over all columns.

        The last row and column are those of the effort. Entries of columns that are zero at a joint
        are zero.

        Args:
            delay: Index of the settings' delay by which efforts are advanced.
            block: Index of a block; None for the sum over all blocks.
        """
        size = len(self.columns) + 1
        matrices = np.zeros((len(self.joints), size, size))
        for matrix, joint in zip(matrices, self.joints, strict=True):
            columns = np.append(joint.columns, size - 1)
            local = [*range(len(joint.columns)), len(joint.columns) + delay]
            gram = joint.gram if block is None else joint.grams[block]
            matrix[np.ix_(columns, columns)] = gram[np.ix_(local, local)]
        return matrices


_BLOCK_FIELDS = "factors", "samples", "seen", "effort_sums", "carried"


def merge(digests: Sequence[Digest]) -> Digest:
    """Return one digest of the logs of several digests.

    It is identical to a joint digest of the logs: blocks are not combined, so that triangular
    factors lose no precision.

    Raises:
        DigestError: Settings differ, or a log occurs twice.
        ArgumentError: There are no digests.
    """
    digests = instances(digests, "digests", Digest)
    if not digests:
        raise ArgumentError("There are no digests to merge.", advice="Give at least one.")
    first = digests[0].settings
    digests = [by_settings(d, first, f"The digest of {d.logs[0].name}") for d in digests]
    logs = tuple(log for digest in digests for log in digest.logs)
    (fingerprint, count), *_ = Counter(log.fingerprint for log in logs).most_common(1)
    if count > 1:
        names = [log.name for log in logs if log.fingerprint == fingerprint]
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
    """Return a digest; raise DigestError with the differences if it has other settings."""
    if digest.settings.hash != settings.hash:
        words = ", ".join(digest.settings.differences(settings))
        raise DigestError(
            f"{what} has other settings: they differ in {words}.",
            advice="Digest the logs again with one model into one folder.",
        )
    return digest


def _joined(parts: Sequence[JointData]) -> JointData:
    """Return a joint's data of several digests, concatenated."""
    joined: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in _BLOCK_FIELDS
    }
    joined["rows"] = tuple(row for part in parts for row in part.rows)
    return replace(parts[0], peaks=np.max([part.peaks for part in parts], axis=0), **joined)


def digest_content(digest: Digest) -> bytes:
    """Return the content of a digest's file, independent of the machine."""
    instance(digest, "digest", Digest)
    parts = digest.logs, digest.blocks, digest.joints
    return sealed((digest.settings.text(), *parts), FORMAT)


def read_digest_of(path: Path, settings: DigestSettings) -> Digest:
    """Read a digest in a folder, and check that its key matches its file name."""
    digest = by_settings(read_digest(path), settings, str(path))
    if [log.key for log in digest.logs] != [path.stem]:
        names = ", ".join(log.name for log in digest.logs)
        raise DigestError(
            f"{path} has the digest of another log, {names}: it was copied or renamed.",
            advice="Delete it, and digest its log again.",
        )
    return digest


def read_digest(path: str | Path) -> Digest:
    """Read a digest written by `geodrake digest`.

    Raises:
        DigestError: It is not a digest, damaged, or of another version of the format.
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
