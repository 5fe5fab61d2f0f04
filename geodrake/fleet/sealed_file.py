"""Files of fleets: dataclasses with arrays, compressed, with a checksum.

A file consists of a line with its format, the SHA-256 of the rest, and the dataclass as MessagePack
compressed by zlib. An array is stored as type, shape and bytes. Equal values result in equal files
on all machines.
"""

from __future__ import annotations

import hashlib
import zlib
from typing import Any, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.escaping import one_line
from geodrake.errors import ArgumentError

T = TypeVar("T")

LARGEST = 500_000_000
"""Maximum number of bytes of a file, also when unpacked."""

_DIGEST = hashlib.sha256().digest_size
_PREFIX = "geodrake "  # of all format names
_DAMAGED = ValueError, TypeError, OverflowError, MemoryError, zlib.error, msgspec.MsgspecError


class DamagedFileError(Exception):
    """Raised for bytes that were not written by `sealed`; the message is the reason."""


def sealed(value: object, form: str) -> bytes:
    """Return a value as the content of a file.

    Raises:
        ArgumentError: It contains a string, such as a file name, that is not UTF-8.
    """
    try:
        encoded = msgspec.msgpack.encode(value, enc_hook=_plain)
    except UnicodeEncodeError as error:
        raise ArgumentError(
            f"{error.object!a} is not UTF-8, which files of fleets require.",
            advice="Rename the file or folder.",
        ) from error
    packed = zlib.compress(encoded)
    return f"{form}\n".encode() + hashlib.sha256(packed).digest() + packed


def unsealed(data: bytes, form: str, kind: type[T], *, largest: int = LARGEST) -> T:
    """Return the value in a file of a format, or raise `DamagedFileError`."""
    head, _, rest = data.partition(b"\n")
    name = head.decode("ascii", "replace")
    if name != form:
        if not name.startswith(_PREFIX):
            raise DamagedFileError(f"it does not begin with {form!r}")
        raise DamagedFileError(
            f"it has format {name[:60]!r}, but this version of geodrake reads {form!r}"
        )
    if hashlib.sha256(rest[_DIGEST:]).digest() != rest[:_DIGEST]:
        raise DamagedFileError("its checksum is wrong")
    try:
        unpacked = zlib.decompressobj()
        text = unpacked.decompress(rest[_DIGEST:], largest)
        if unpacked.unconsumed_tail:
            raise DamagedFileError("its unpacked size exceeds the limit")
        return msgspec.msgpack.decode(text, type=kind, dec_hook=_array)
    except _DAMAGED as error:
        raise DamagedFileError(one_line(error)) from error


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    return value.item()  # a NumPy scalar


def _array(kind: Any, encoded: Any) -> NDArray[Any]:
    del kind
    dtype, shape, content = encoded
    return np.frombuffer(content, dtype).reshape(shape).copy()
