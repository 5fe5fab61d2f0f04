"""Files of digests: NPZ archives of arrays, with a header and the settings in JSON.

A file ends in the SHA-256 of all bytes before it, as the comment of the archive. In a folder, its
name is the key that it holds, which is the hash of its log, of known payloads and of the settings.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import file_path, instance
from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import open_regular, regular_file
from geodrake.errors import DigestError
from geodrake.fleet.digest import Digest, DigestedLog, JointDigest, check_same
from geodrake.fleet.settings import FORMAT, DigestSettings, settings_of
from geodrake.logs.known_payload import KnownPayload

Array = NDArray[np.float64]

_LARGEST_FILE = 500_000_000  # bytes, also of what an archive says it unpacks to
_SEAL = hashlib.sha256().digest_size
_NUMBERS = ("noise_floor", "gain_deviations", "position", "speed", "temperature")
_INTEGERS = ("columns", "samples", "seen")

DAMAGED = (
    *(OSError, EOFError, ValueError, TypeError, KeyError, IndexError, AttributeError),
    *(zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, MemoryError),
    OverflowError,
)
"""What reading an NPZ archive raises whose bytes are not those that were written."""


def digest_content(digest: Digest) -> bytes:
    """Return what the file of a digest holds: the same for the same digest, wherever it is made.

    An NPZ archive of `header` and `settings`, which are JSON in bytes, and of the arrays of every
    joint k, such as `k.samples`. Of triangular factors, the upper triangles are there, row by row.
    """
    instance(digest, "digest", Digest)
    header = {
        "format": FORMAT,
        "settings": digest.settings.hash,
        "logs": [_said_of_log(log) for log in digest.logs],
        "blocks": digest.blocks,
        "block_logs": digest.block_logs.tolist(),
    }
    arrays: dict[str, NDArray[Any]] = {
        "header": _bytes(json.dumps(header)),
        "settings": _bytes(digest.settings.text()),
    }
    for k, joint in enumerate(digest.joints):
        for name in _ARRAYS:
            arrays[f"{k}.{name}"] = getattr(joint, name)
        upper = np.triu_indices(joint.factors.shape[1])
        arrays[f"{k}.factors"] = joint.factors[:, upper[0], upper[1]]
    return sealed(arrays)


def sealed(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return an NPZ archive that ends in the SHA-256 of all that is before it."""
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    with zipfile.ZipFile(file, "a") as archive:
        archive.comment = bytes(_SEAL)
    content = file.getvalue()[:-_SEAL]
    return content + hashlib.sha256(content).digest()


def read_digest_of(path: Path, settings: DigestSettings) -> Digest:
    """Read a digest of one log in a folder, which must be the one that its name says.

    Raises:
        DigestError: It is no digest, damaged, by other settings, or that of another log.
    """
    digest = read_digest(path)
    check_same(digest.settings, settings, str(path))
    if [log.key for log in digest.logs] != [path.stem]:
        names = ", ".join(log.name for log in digest.logs)
        raise DigestError(
            f"{path} holds the digest of another log, {names}: it was copied or renamed.",
            advice="Delete it, and digest its log again.",
            path=path,
        )
    return digest


def read_digest(path: str | Path) -> Digest:
    """Read the digest that `geodrake digest` wrote.

    Args:
        path: The file.

    Raises:
        DigestError: It is no digest, damaged, or of another version of the format.
    """
    path = regular_file(file_path(path), "digest", DigestError, largest=_LARGEST_FILE)
    try:
        with open_regular(path, "digest", DigestError) as file:
            data = file.read()
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > _LARGEST_FILE:
                raise ValueError("it unpacks to more than any digest has")
            arrays = {
                entry.filename.removesuffix(".npy"): np.lib.format.read_array(
                    io.BytesIO(archive.read(entry)), allow_pickle=False
                )
                for entry in archive.infolist()
            }
        header = json.loads(_text(arrays, "header"))
        if isinstance(header, dict) and header.get("format") != FORMAT:
            raise DigestError(
                f"{path} is a digest of the format {header.get('format')!r}; this version of "
                f"geodrake reads {FORMAT!r}.",
                advice="Digest its log again.",
                path=path,
            )
        if hashlib.sha256(data[:-_SEAL]).digest() != data[-_SEAL:]:
            raise ValueError("its checksum is another one")
        settings = settings_of(_text(arrays, "settings"), path)
        if settings.hash != header["settings"]:
            raise ValueError("its settings are not those of its header")
        return _digest(header, settings, arrays)
    except DigestError:
        raise
    except DAMAGED as error:
        raise DigestError(
            f"{path} is no digest, or damaged: {one_line(error)}.",
            advice="Delete it, and digest its log again.",
            path=path,
        ) from error


_ARRAYS = tuple(f.name for f in fields(JointDigest) if f.name not in ("joint", "factors"))


def _bytes(text: str) -> NDArray[np.uint8]:
    return np.frombuffer(text.encode(), np.uint8)


def _text(arrays: Mapping[str, NDArray[Any]], name: str) -> str:
    return bytes(np.asarray(arrays[name], np.uint8)).decode()


def _said_of_log(log: DigestedLog) -> dict[str, Any]:
    """Return a log as JSON has it; null where there is no temperature."""
    said = {f.name: getattr(log, f.name) for f in fields(log)}
    for name in _NUMBERS:
        known = said[name].astype(object)
        known[np.isnan(said[name])] = None
        said[name] = known.tolist()
    said["payloads"] = [asdict(payload) for payload in log.payloads]
    return said


def _log(said: Mapping[str, Any], nv: int) -> DigestedLog:
    found = dict(said)
    for name in _NUMBERS:
        shape = (2, nv) if name in ("position", "speed") else (nv,)
        found[name] = np.array(said[name], float).reshape(shape)
        if name != "temperature" and not np.isfinite(found[name]).all():
            raise ValueError(f"its {name} is not finite")
    found["payloads"] = tuple(KnownPayload(**each) for each in said["payloads"])
    found["notes"] = tuple(map(str, said["notes"]))
    for name in ("date", "seconds", "period", "bandwidth", "noise_weight"):
        if not 0 < float(said[name]) < np.inf:
            raise ValueError(f"its {name} is {said[name]!r}")
    return DigestedLog(**found)


def _digest(
    header: Mapping[str, Any], settings: DigestSettings, arrays: Mapping[str, NDArray[Any]]
) -> Digest:
    logs = tuple(_log(said, len(settings.joints)) for said in header["logs"])
    blocks = tuple(map(str, header["blocks"]))
    block_logs = np.array(header["block_logs"], np.intp).reshape(len(blocks))
    if not blocks or not 0 <= block_logs.min() <= block_logs.max() < len(logs):
        raise ValueError("its blocks are of no log")
    joints = tuple(
        _joint(name, {n: arrays[f"{k}.{n}"] for n in ("factors", *_ARRAYS)}, settings, len(blocks))
        for k, name in enumerate(settings.joints)
    )
    return Digest(settings, logs, blocks, block_logs, joints)


def _joint(
    name: str, arrays: Mapping[str, NDArray[Any]], settings: DigestSettings, blocks: int
) -> JointDigest:
    """Return a joint of a digest, its arrays of the shapes that they must have."""
    columns = np.asarray(arrays["columns"], np.intp).ravel()
    p = len(columns)
    size = p + len(settings.delays)
    if p and not (np.diff(columns) > 0).all():
        raise ValueError(f"columns of {name} are not in order")
    if p and not 0 <= columns[0] <= columns[-1] < len(settings.columns):
        raise ValueError(f"columns of {name} are none of the settings'")
    shapes = {
        "columns": (p,),
        "factors": (blocks, size * (size + 1) // 2),
        "samples": (blocks,),
        "seen": (blocks,),
        "effort_sums": (blocks, 2),
        "carried": (blocks, p),
        "peaks": (p,),
        "autocovariances": (blocks, settings.lags),
    }
    found = {}
    for each, shape in shapes.items():
        values = np.asarray(arrays[each], np.intp if each in _INTEGERS else float)
        if values.shape != shape or not np.isfinite(values).all():
            raise ValueError(f"{each} of {name} has the shape {values.shape}, or no numbers")
        found[each] = values
    factors = np.zeros((blocks, size, size))
    factors[:, *np.triu_indices(size)] = found["factors"]
    return JointDigest(name, **{**found, "factors": factors})
