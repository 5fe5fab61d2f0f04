"""The model of a type of robots as digests have it: with friction and an offset at every joint.

What robots of a type scatter by is then no error of the model, and what a fit leaves is noise:
samples are worth more. A process reads a model once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from geodrake.boundary.input_files import regular_file
from geodrake.effects import (
    Effect,
    FittedEffect,
    catalogue,
    effect_class,
    load_effect_file,
)
from geodrake.errors import ArgumentError, FleetError
from geodrake.fleet.fleet_file import FleetType
from geodrake.fleet.making import Wanted
from geodrake.fleet.model_hash import file_hash
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.logs.files import Reading, read_mapping
from geodrake.model.robot_model import RobotModel
from geodrake.model.saved_model import load_model

USUAL = tuple(kind for kind in catalogue() if kind.complexity == 0 and "vd" not in kind.depends_on)
"""Friction and offsets: effects that hardly any joint is without, but rotors, which bodies have."""

_MODELS = 4  # that a process keeps
_LITTLE = 1e-6  # information on parameters of which nothing is known, 1/unit²


@dataclass(frozen=True, eq=False)
class TypeSource:
    """What digests of a type are made by.

    Attributes:
        model: The model, with what each joint has beside what its file says.
        wanted: How logs are read, and what settings are to be like.
    """

    model: RobotModel
    wanted: Wanted


def type_source(kind: FleetType) -> TypeSource:
    """The model of a type, and how its logs are read.

    Raises:
        GeodrakeError: The model or another file cannot be read, or an effect is not known.
    """
    for path in kind.files:
        regular_file(path, f"file of type {kind.name}", FleetError)
    return _read(_Key(kind, file_hash(kind.files)))


@dataclass(frozen=True)
class _Key:
    """A type by what its files hold."""

    kind: FleetType
    files: str

    def __hash__(self) -> int:
        return hash((self.kind.name, self.files))


@lru_cache(_MODELS)
def _read(key: _Key) -> TypeSource:
    kind = key.kind
    extra: dict[str, type[Effect]] = {}
    for path in kind.own_effects:
        for effect in load_effect_file(path):
            if effect.name in extra:
                raise FleetError(f"Type {kind.name} has the effect {effect.name} of two files.")
            extra[effect.name] = effect
    own = tuple(extra.values())
    model = _loaded(kind, kind.model, own)
    mapping = None if kind.mapping is None else read_mapping(kind.mapping)
    reading = Reading(mapping=mapping, units=kind.units)
    return TypeSource(
        with_joint_effects(model, _of_joints(kind, own)),
        Wanted(kind.bandwidth, kind.blocks, reading, own),
    )


def own_model(kind: FleetType, path: Path) -> RobotModel:
    """The model of one robot, read as that of its type.

    Raises:
        GeodrakeError: It cannot be read.
    """
    return _loaded(kind, path, type_source(kind).wanted.extra)


def _loaded(kind: FleetType, path: Path, extra: Sequence[type[Effect]]) -> RobotModel:
    return load_model(
        path,
        floating=kind.floating,
        extra=extra,
        lock=kind.lock,
        transmission=kind.transmission,
    )


def _of_joints(kind: FleetType, extra: Sequence[type[Effect]]) -> tuple[type[Effect], ...]:
    """Effects that each joint of a type has.

    Raises:
        FleetError: There is no such effect, or it is none of joints that adds effort.
    """
    if kind.effects is None:
        return USUAL
    found = []
    for name in kind.effects:
        try:
            effect = effect_class(name, extra)
        except ArgumentError as error:
            raise FleetError(
                f"Type {kind.name} has effects of joints: {error.problem}", advice=error.advice
            ) from error
        if effect.places != "joint" or effect.shapes or not effect.parameters:
            raise FleetError(
                f"Type {kind.name} has the effect {name}, which is none of a joint alone without "
                "shape parameters.",
                advice="Give the type a model that was saved with it.",
            )
        found.append(effect)
    return tuple(found)


def with_joint_effects(model: RobotModel, kinds: Sequence[type[Effect]]) -> RobotModel:
    """A model with effects at all joints where it has none of the kind, of unknown sizes."""
    there = {(fitted.effect.name, fitted.effect.where) for fitted in model.effects}
    joints = [joint for joint in model.joints if joint in model.single_joints]
    added = [
        kind(joint)  # type: ignore[call-arg]
        for joint in joints
        for kind in kinds
        if (kind.name, (joint,)) not in there
    ]
    if not added:
        return model
    information = model.information
    if information is None:
        sizes = [np.diag(1.0 / np.maximum(f.parameters**2, 1e-12)) for f in model.effects]
        information = block_diag(pullback_information(model.phi, SPREAD), *sizes)
    new = [FittedEffect(effect, np.zeros(len(effect.parameters))) for effect in added]
    sizes = [_LITTLE * np.eye(len(each.parameters)) for each in new]
    return replace(
        model,
        effects=(*model.effects, *new),
        information=block_diag(information, *sizes),
    )
