"""The hash of a model: two are the same if everything is that a digest's columns depend on."""

from __future__ import annotations

import dataclasses
import hashlib
import inspect
import json
from collections.abc import Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from geodrake.boundary.arguments import instance
from geodrake.boundary.input_files import sha256_of
from geodrake.effects import Effect
from geodrake.effects.column_checks import of_geodrake
from geodrake.errors import GeodrakeError, LogError
from geodrake.model.robot_model import RobotModel
from geodrake.robot.transmission import Transmission

_POSITIONS, _REACH = 20, 0.5  # at which transmissions are looked at; rad or m
_DIGITS = 9  # behind the point, of which machines that compute differ in none


def model_hash(model: RobotModel) -> str:
    """Return the SHA-256 of a model's joints, bodies and effects.

    Where its file lies and what notes say does not count.
    """
    instance(model, "model", RobotModel)
    said = (
        model.joints,
        model.joint_tree,
        model.transmission,
        model.phi,
        tuple((f.effect, source_hash(type(f.effect)), f.parameters) for f in model.effects),
        model.information,
        model.fading_speed,
        model.effort_signals,
        *([model.followers] if model.followers else []),
    )
    return text_hash(said)


def source_hash(kind: type[Effect]) -> str:
    """Return the SHA-256 of the source of a user's own effect; empty for geodrake's."""
    if of_geodrake(kind):
        return ""
    try:
        return hashlib.sha256(inspect.getsource(kind).encode()).hexdigest()
    except (OSError, TypeError):  # made in a console: there is no file
        return "unknown"


def text_hash(value: object) -> str:
    """Return the SHA-256 of numbers, words, arrays, dataclasses, and containers of them."""
    words = json.dumps(_plain(value), sort_keys=True, ensure_ascii=True, allow_nan=True)
    return hashlib.sha256(words.encode()).hexdigest()


def file_hash(paths: Iterable[Path]) -> str:
    """Return SHA-256 of the bytes of files, and of all files in folders."""
    found = hashlib.sha256()
    for path in paths:
        inside = sorted(each for each in path.rglob("*") if each.is_file())
        for each in inside if path.is_dir() else [path]:
            name = str(each.relative_to(path)) if path.is_dir() else ""
            try:
                own = sha256_of(each)
            except GeodrakeError as error:
                raise LogError(error.problem, advice=error.advice) from error
            found.update(f"{name!a} {own}\n".encode())
    return found.hexdigest()


def _plain(value: Any) -> Any:
    """Return plain JSON data that differs whenever the values differ."""
    plain: Any
    if isinstance(value, Enum):
        plain = [type(value).__name__, value.name]
    elif value is None or isinstance(value, str | int | float | bool):
        plain = value
    elif isinstance(value, np.ndarray | np.generic):
        array = np.ascontiguousarray(value)
        plain = [str(array.dtype), array.shape, hashlib.sha256(array.tobytes()).hexdigest()]
    elif dataclasses.is_dataclass(value):
        own = {
            f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.compare
        }
        plain = [type(value).__qualname__, own]
    elif isinstance(value, msgspec.Struct):
        plain = [type(value).__qualname__, _plain(msgspec.structs.asdict(value))]
    elif isinstance(value, Mapping):
        plain = {str(key): _plain(each) for key, each in value.items()}
    elif isinstance(value, set | frozenset):  # whose order changes from run to run
        plain = sorted(json.dumps(_plain(each), sort_keys=True) for each in value)
    elif isinstance(value, slice):
        plain = [value.start, value.stop, value.step]
    elif isinstance(value, Iterable):
        plain = [_plain(each) for each in value]
    else:  # such as a function, of a transmission made in Python
        plain = str(getattr(value, "__qualname__", type(value).__qualname__))
    return [plain, _values_of(value)] if isinstance(value, Transmission) else plain


def _values_of(transmission: Transmission) -> list[str]:
    """Return a transmission's values at some positions, as its functions cannot be hashed."""
    size = (_POSITIONS, transmission.num_actuators)
    found = []
    for q in np.random.default_rng(0).uniform(-_REACH, _REACH, size):
        try:
            at = transmission.inside(q[None])
            values = [*transmission.joint_positions(at).flat, *transmission.jacobian(at).flat]
        except Exception as error:  # functions of users' own may raise anything
            found.append(type(error).__name__)
        else:
            rounded = np.round(values, _DIGITS) + 0.0  # no −0
            found.append(" ".join(f"{value:.{_DIGITS}f}" for value in rounded))
    return found
