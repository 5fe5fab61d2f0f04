"""The model of a robot type, its columns in fleet statistics, and hypotheses of changes.

The model has friction and an offset at each joint, so that differences between robots do not count
as model errors, residuals are noise, and the effective sample size is larger. Digests have columns
for all candidate effects. Fleet statistics use only those of the bodies and of the model's effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from geodrake.boundary.input_files import regular_file
from geodrake.boundary.showing import Short
from geodrake.effects import (
    Effect,
    FittedEffect,
    Role,
    catalogue,
    effect_class,
    load_effect_file,
)
from geodrake.effects.declarations import when_sliding
from geodrake.effects.lookup import effect_of
from geodrake.errors import ArgumentError, FleetError
from geodrake.fleet.digest_log import Wanted, model_of_digests
from geodrake.fleet.fleet_file import FleetType
from geodrake.fleet.hashes import file_hash
from geodrake.fleet.settings import DigestSettings
from geodrake.fleet.type_columns import (
    KINDS,
    STEP,
    ChangeHypothesis,
    Spread,
    TypeColumns,
    body_factor,
    distance_factor,
    narrow_factor,
)
from geodrake.identification.logs.criteria import SPREAD
from geodrake.identification.logs.dataset import Indices, column_starts
from geodrake.identification.logs.log_slices import Layout
from geodrake.identification.logs.unknowns import pullback_information
from geodrake.inertia import Array, from_mass_com_inertia, is_physical
from geodrake.logs.files import Reading, read_mapping
from geodrake.model.robot_model import RobotModel
from geodrake.model.saved_model import load_model
from geodrake.robot.base_parameters import BaseParameters, structural_base_parameters

USUAL = tuple(kind for kind in catalogue() if kind.complexity == 0 and "vd" not in kind.depends_on)
"""Friction and offsets, which almost all joints have. Rotors are included in the bodies."""

_CACHED_MODELS = 4
_LITTLE = 1e-6  # information on unknown parameters, 1/unit²


def type_source(kind: FleetType) -> tuple[RobotModel, Wanted]:
    """Return the model of a type, with effects added to each joint, and the digest options."""
    for path in kind.files:
        regular_file(path, f"file of type {kind.name}", FleetError)
    return _read_source(kind, file_hash(kind.files))


@lru_cache(_CACHED_MODELS)
def _read_source(kind: FleetType, files: str) -> tuple[RobotModel, Wanted]:
    """Return `type_source`, cached by the hash of the files."""
    del files
    extra: dict[str, type[Effect]] = {}
    for path in kind.own_effects:
        for effect in load_effect_file(path):
            if effect.name in extra:
                raise FleetError(f"Type {kind.name} has the effect {effect.name} from two files.")
            extra[effect.name] = effect
    user_effects = tuple(extra.values())
    model = _loaded(kind, kind.model, user_effects)
    mapping = None if kind.mapping is None else read_mapping(kind.mapping)
    reading = Reading(mapping=mapping, units=kind.units)
    return (
        with_joint_effects(model, _joint_effects(kind, user_effects)),
        Wanted(kind.bandwidth, kind.blocks, reading, user_effects),
    )


def own_model(kind: FleetType, path: Path) -> RobotModel:
    """Return the model of one robot, with the options of its type."""
    return _loaded(kind, path, type_source(kind)[1].extra)


def _loaded(kind: FleetType, path: Path, extra: Sequence[type[Effect]]) -> RobotModel:
    return load_model(
        path,
        floating=kind.floating,
        extra=extra,
        lock=kind.lock,
        transmission=kind.transmission,
    )


def _joint_effects(kind: FleetType, extra: Sequence[type[Effect]]) -> tuple[type[Effect], ...]:
    """Return the effects of each joint of a type."""
    if kind.effects is None:
        return USUAL
    effects = []
    for name in kind.effects:
        try:
            effect = effect_class(name, extra)
        except ArgumentError as error:
            raise FleetError(
                f"Type {kind.name} has invalid effects of joints: {error.problem}",
                advice=error.advice,
            ) from error
        if effect.places != "joint" or effect.shapes or not effect.parameters:
            raise FleetError(
                f"Type {kind.name} has the effect {name}, which needs more than one joint, "
                "or has shape parameters, or no parameters.",
                advice="Save a model with it, and use that for the type.",
            )
        effects.append(effect)
    return tuple(effects)


def with_joint_effects(model: RobotModel, kinds: Sequence[type[Effect]]) -> RobotModel:
    """Return a model with effects of unknown size added to joints without them."""
    existing = {(fitted.effect.name, fitted.effect.where) for fitted in model.effects}
    joints = [joint for joint in model.joints if joint in model.single_joints]
    added = [
        kind(joint)  # type: ignore[call-arg]
        for joint in joints
        for kind in kinds
        if (kind.name, (joint,)) not in existing
    ]
    if not added:
        return model
    information = model.information
    if information is None:
        sizes = [np.diag(1.0 / np.maximum(f.parameters**2, 1e-12)) for f in model.effects]
        information = block_diag(pullback_information(model.phi, SPREAD), *sizes)
    new = [FittedEffect(effect, np.zeros(len(effect.parameters))) for effect in added]
    sizes = [_LITTLE * np.eye(len(fitted.parameters)) for fitted in new]
    return replace(
        model,
        effects=(*model.effects, *new),
        information=block_diag(information, *sizes),
    )


BODIES = "bodies"
"""Name used for columns of bodies instead of an effect's."""

_TYPICAL_PAYLOAD = 0.1  # relative to the moving mass
_PAYLOAD_RADIUS = 0.1  # m
_TYPICAL_GAIN_CHANGE = 0.1
_PAYLOAD_NAMES = (("mass", "kg"), ("hx", "kg·m"), ("hy", "kg·m"), ("hz", "kg·m"))
_ROLES = (Role.FORCE, Role.DEFLECTION)
_LOAD, _GAIN = (effect_of(role).name for role in (Role.BODY, Role.SCALE))


@dataclass(frozen=True)
class FleetParameter:
    """A column of a type."""

    effect: str  # name of the effect; `BODIES` for combinations of inertial parameters
    where: str
    name: str
    unit: str


@dataclass(frozen=True, eq=False)
class TypeLayout(Short):
    """The p columns of a type: selected columns of digests, then a gain for each joint."""

    kept: Indices  # (p − n,) indices of the settings' columns
    parameters: tuple[FleetParameter, ...]  # (p,)
    columns: TypeColumns
    hypotheses: tuple[ChangeHypothesis, ...]
    base: BaseParameters  # base parameters of the bodies, the first columns


def type_layout(
    model: RobotModel,
    settings: DigestSettings,
    efforts: Array,
    *,
    payload: float | None = None,
    extra: Sequence[type[Effect]] = (),
) -> TypeLayout:
    """Return the columns of a type, and the hypotheses of changes of its robots.

    Args:
        efforts: (nv,) typical efforts of the joints, N·m or N.
        payload: Typical payload, kg; None for a tenth of the moving mass.
        extra: User-defined effects with columns.
    """
    model = model_of_digests(model, settings)
    effects = tuple(effect.made(extra) for effect in settings.effects)
    tree = Layout.of(model, effects, settings.sign_width, settings.still_speed).tree
    base = structural_base_parameters(tree)
    bodies = len(base.independent)
    values = _model_values(model, effects)
    kept = np.array([*base.independent.tolist(), *sorted(values)], np.intp)
    parameters = _parameters(settings, kept, model, base)
    n, p = len(model.joints), len(kept) + len(model.joints)
    prior = np.zeros(p)
    prior[:bodies] = base.matrix @ model.total_phi.ravel()
    prior[bodies : p - n] = [values[column][0] for column in kept[bodies:].tolist()]
    relative = np.zeros(p, bool)
    relative[bodies : p - n] = [values[column][1] for column in kept[bodies:].tolist()]
    # Typical size of each column: 1 if relative, otherwise the joint's typical effort.
    effort_of = dict(zip(model.joints, efforts.tolist(), strict=True))
    typical = np.array([max(effort_of.get(x.where, 1.0), 1e-9) for x in parameters])
    is_relative = relative | np.array([x.effect == _GAIN for x in parameters])
    sizes = np.where(is_relative, 1.0, typical)
    spreads = [
        Spread(f"{x.effect} of {x.where}: {x.name}", size * np.eye(p)[:, [k]])
        for k, (x, size) in enumerate(zip(parameters, sizes.tolist(), strict=True))
        if k >= bodies
    ]
    changes = _joint_changes(parameters, relative, sizes)
    mass = payload or _TYPICAL_PAYLOAD * float(model.total_phi[:, 0].sum())
    body_spreads, B = [], base.matrix
    for body, (name, phi) in enumerate(zip(model.bodies, model.total_phi, strict=True)):
        if not is_physical(phi):
            continue
        factor = narrow_factor(body_factor(distance_factor(phi), body, B, bodies))
        body_spreads.append(Spread(name, np.pad(factor, ((0, p - bodies), (0, 0)))))
        # A ball with the mass of a typical payload, at the body's centre of mass.
        ball = 0.4 * mass * _PAYLOAD_RADIUS**2 * np.eye(3)
        root = distance_factor(from_mass_com_inertia(mass, phi[1:4] / phi[0], ball))
        factor = body_factor(root, body, B, p)
        changes.append(ChangeHypothesis(_LOAD, name, factor, _PAYLOAD_NAMES, (STEP,), root[:4]))
    units = tuple(parameter.unit for parameter in parameters)
    columns = TypeColumns(prior, relative, relative.copy(), n, (*body_spreads, *spreads), units)
    return TypeLayout(kept, parameters, columns, tuple(changes), base)


def _model_values(model: RobotModel, effects: tuple[Effect, ...]) -> dict[int, tuple[float, bool]]:
    """Return column of an effect -> its value in the model, and whether it is nonnegative."""
    starts = column_starts(effects, model.bodies)
    return {
        starts[fitted.effect] + k: (float(value), parameter.lower >= 0.0)
        for fitted in model.effects
        if fitted.effect in starts and fitted.effect.role in _ROLES
        for k, (parameter, value) in enumerate(
            zip(fitted.effect.parameters, fitted.parameters, strict=True)
        )
    }


def _parameters(
    settings: DigestSettings, kept: Indices, model: RobotModel, base: BaseParameters
) -> tuple[FleetParameter, ...]:
    """Return the parameters of columns, with units for revolute or prismatic joints."""
    columns, labels = [settings.columns[k] for k in kept.tolist()], base.labels(model.bodies)
    parameters = [
        FleetParameter(BODIES, column.where[0], label, column.unit)
        for label, column in zip(labels, columns, strict=False)
    ]
    for column in columns[len(labels) :]:
        where, unit = ", ".join(column.where), "" if column.unit == "1" else column.unit
        if column.where[0] in model.sliding_joints:
            unit = when_sliding(unit)
        parameters.append(FleetParameter(column.name, where, column.parameter, unit))
    gains = [FleetParameter(_GAIN, joint, "scale", "") for joint in model.joints]
    return (*parameters, *gains)


def _joint_changes(
    parameters: Sequence[FleetParameter], relative: NDArray[np.bool_], sizes: Array
) -> list[ChangeHypothesis]:
    """Return hypotheses of each effect at each place, and of all friction of a joint together."""
    p, hypotheses = len(parameters), []
    effects: dict[tuple[str, str], list[int]] = {}
    for k, parameter in enumerate(parameters):
        if parameter.effect != BODIES:
            effects.setdefault((parameter.effect, parameter.where), []).append(k)
    relative_effects: dict[str, list[str]] = {}

    def change(effect: str, where: str, size: float, columns: Sequence[int]) -> ChangeHypothesis:
        names = tuple((parameters[k].name, parameters[k].unit) for k in sorted(columns))
        kinds = (STEP,) if effect == _GAIN else KINDS
        return ChangeHypothesis(effect, where, size * np.eye(p)[:, columns], names, kinds)

    for (effect, where), columns in effects.items():
        is_relative = effect != _GAIN and bool(relative[columns].all())
        size = 1.0 if is_relative else float(sizes[columns].max())
        size = _TYPICAL_GAIN_CHANGE if effect == _GAIN else size
        hypotheses.append(change(effect, where, size, columns))
        if is_relative:
            relative_effects.setdefault(where, []).append(effect)
    for where, names in relative_effects.items():
        if len(names) > 1:
            columns = [k for name in names for k in effects[name, where]]
            hypotheses.append(change("+".join(names), where, 1.0, columns))
    return hypotheses
