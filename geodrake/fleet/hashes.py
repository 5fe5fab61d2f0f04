"""Hashes of models, effects and files, which identify digests."""

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

_POSITIONS, _REACH = 20, 0.5  # sampled positions of transmissions, and their range, rad or m
_DIGITS = 9  # decimal places that are equal on all machines


def model_hash(model: RobotModel) -> str:
    """Return the SHA-256 of everything in a model that a digest's columns depend on.

    It does not depend on the path of its file and on notes.
    """
    instance(model, "model", RobotModel)
    content = (
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
    return text_hash(content)


def source_hash(kind: type[Effect]) -> str:
    """Return the SHA-256 of the source of a user-defined effect; empty for geodrake's."""
    if of_geodrake(kind):
        return ""
    try:
        return hashlib.sha256(inspect.getsource(kind).encode()).hexdigest()
    except (OSError, TypeError):  # defined in a console, without a file
        return "unknown"


def text_hash(value: object) -> str:
    """Return the SHA-256 of numbers, strings, arrays, dataclasses, and containers of them."""
    text = json.dumps(_plain(value), sort_keys=True, ensure_ascii=True, allow_nan=True)
    return hashlib.sha256(text.encode()).hexdigest()


def file_hash(paths: Iterable[Path]) -> str:
    """Return the SHA-256 of the contents of files, and of all files in folders."""
    total = hashlib.sha256()
    for path in paths:
        inside = sorted(file for file in path.rglob("*") if file.is_file())
        for file in inside if path.is_dir() else [path]:
            name = str(file.relative_to(path)) if path.is_dir() else ""
            try:
                content = sha256_of(file)
            except GeodrakeError as error:
                raise LogError(error.problem, advice=error.advice) from error
            total.update(f"{name!a} {content}\n".encode())
    return total.hexdigest()


def _plain(value: Any) -> Any:
    """Return JSON data that differ if the values differ."""
    plain: Any
    if isinstance(value, Enum):
        plain = [type(value).__name__, value.name]
    elif value is None or isinstance(value, str | int | float | bool):
        plain = value
    elif isinstance(value, np.ndarray | np.generic):
        array = np.ascontiguousarray(value)
        plain = [str(array.dtype), array.shape, hashlib.sha256(array.tobytes()).hexdigest()]
    elif dataclasses.is_dataclass(value):
        fields = {
            f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value) if f.compare
        }
        plain = [type(value).__qualname__, fields]
    elif isinstance(value, msgspec.Struct):
        plain = [type(value).__qualname__, _plain(msgspec.structs.asdict(value))]
    elif isinstance(value, Mapping):
        plain = {str(key): _plain(item) for key, item in value.items()}
    elif isinstance(value, set | frozenset):  # the order differs between runs
        plain = sorted(json.dumps(_plain(item), sort_keys=True) for item in value)
    elif isinstance(value, slice):
        plain = [value.start, value.stop, value.step]
    elif isinstance(value, Iterable):
        plain = [_plain(item) for item in value]
    else:  # such as a function of a transmission defined in Python
        plain = str(getattr(value, "__qualname__", type(value).__qualname__))
    return [plain, _values_of(value)] if isinstance(value, Transmission) else plain


def _values_of(transmission: Transmission) -> list[str]:
    """Return a transmission's values at sampled positions, as its functions cannot be hashed."""
    size = (_POSITIONS, transmission.num_actuators)
    texts = []
    for sample in np.random.default_rng(0).uniform(-_REACH, _REACH, size):
        try:
            q = transmission.inside(sample[None])
            values = [*transmission.joint_positions(q).flat, *transmission.jacobian(q).flat]
        except Exception as error:  # users' functions may raise anything
            texts.append(type(error).__name__)
        else:
            rounded = np.round(values, _DIGITS) + 0.0  # no −0
            texts.append(" ".join(f"{value:.{_DIGITS}f}" for value in rounded))
    return texts
