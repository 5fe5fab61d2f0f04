"""The model of a type as digests have it, and its columns as statistics of fleets need them.

At every joint the model has friction and an offset: what robots of a type scatter by is then no
error of the model, and what a fit leaves is noise, so that samples are worth more. Digests have
columns of all that may be missing. A fleet's statistics need few: the bodies, what the model has,
and friction and offsets of joints; and hypotheses of what changes in a robot.
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
"""Friction and offsets: effects that hardly any joint is without, but rotors, which bodies have."""

_MODELS = 4  # that a process keeps
_LITTLE = 1e-6  # information on parameters of which nothing is known, 1/unit²


def type_source(kind: FleetType) -> tuple[RobotModel, Wanted]:
    """Return the model of a type, with the effects of each joint added to those in its file.

    Also return how its logs are read, and what settings are to be like.
    """
    for path in kind.files:
        regular_file(path, f"file of type {kind.name}", FleetError)
    return _read_source(kind, file_hash(kind.files))


@lru_cache(_MODELS)
def _read_source(kind: FleetType, files: str) -> tuple[RobotModel, Wanted]:
    """Do the same, cached while the files are unchanged."""
    del files
    extra: dict[str, type[Effect]] = {}
    for path in kind.own_effects:
        for effect in load_effect_file(path):
            if effect.name in extra:
                raise FleetError(f"Type {kind.name} has the effect {effect.name} from two files.")
            extra[effect.name] = effect
    own = tuple(extra.values())
    model = _loaded(kind, kind.model, own)
    mapping = None if kind.mapping is None else read_mapping(kind.mapping)
    reading = Reading(mapping=mapping, units=kind.units)
    return (
        with_joint_effects(model, _of_joints(kind, own)),
        Wanted(kind.bandwidth, kind.blocks, reading, own),
    )


def own_model(kind: FleetType, path: Path) -> RobotModel:
    """Return the model of one robot, read as that of its type."""
    return _loaded(kind, path, type_source(kind)[1].extra)


def _loaded(kind: FleetType, path: Path, extra: Sequence[type[Effect]]) -> RobotModel:
    return load_model(
        path,
        floating=kind.floating,
        extra=extra,
        lock=kind.lock,
        transmission=kind.transmission,
    )


def _of_joints(kind: FleetType, extra: Sequence[type[Effect]]) -> tuple[type[Effect], ...]:
    """Return effects that each joint of a type has."""
    if kind.effects is None:
        return USUAL
    found = []
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
        found.append(effect)
    return tuple(found)


def with_joint_effects(model: RobotModel, kinds: Sequence[type[Effect]]) -> RobotModel:
    """Return a model with effects of unknown sizes added to all joints that lack the kind."""
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


BODIES = "bodies"
"""Kind that columns of bodies have in place of an effect's."""

_USUAL_PAYLOAD = 0.1  # over the mass of all that moves
_PAYLOAD_RADIUS = 0.1  # m
_USUAL_GAIN = 0.1  # share by which a gain changes
_HELD = (("mass", "kg"), ("hx", "kg·m"), ("hy", "kg·m"), ("hz", "kg·m"))  # of a payload
_KEPT = (Role.FORCE, Role.DEFLECTION)
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
    """The p columns of a type: those of digests that count, then a gain for each joint."""

    kept: Indices  # (p − n,) which of the settings' columns they are
    parameters: tuple[FleetParameter, ...]  # (p,) what they are of
    columns: TypeColumns
    hypotheses: tuple[ChangeHypothesis, ...]
    base: BaseParameters  # those of the bodies, which come first


def type_layout(
    model: RobotModel,
    settings: DigestSettings,
    efforts: Array,
    *,
    payload: float | None = None,
    extra: Sequence[type[Effect]] = (),
) -> TypeLayout:
    """Return the columns of a type, and the changes to be considered in its robots.

    Args:
        efforts: (nv,) usual sizes of the joints' efforts, N·m or N.
        payload: Mass of a usual payload, kg; None for a tenth of all that moves.
        extra: Effect classes of the user's own that have columns.
    """
    model = model_of_digests(model, settings)
    effects = tuple(effect.made(extra) for effect in settings.effects)
    tree = Layout.of(model, effects, settings.sign_width, settings.still_speed).tree
    base = structural_base_parameters(tree)
    bodies = len(base.independent)
    own = _model_values(model, effects)
    kept = np.array([*base.independent.tolist(), *sorted(own)], np.intp)
    parameters = _parameters(settings, kept, model, base)
    n, p = len(model.joints), len(kept) + len(model.joints)
    prior = np.zeros(p)
    prior[:bodies] = base.matrix @ model.total_phi.ravel()
    prior[bodies : p - n] = [own[at][0] for at in kept[bodies:].tolist()]
    relative = np.zeros(p, bool)
    relative[bodies : p - n] = [own[at][1] for at in kept[bodies:].tolist()]
    # What is much of each column: of shares 1, of others what makes the usual efforts.
    of_joints = dict(zip(model.joints, efforts.tolist(), strict=True))
    usual = np.array([max(of_joints.get(each.where, 1.0), 1e-9) for each in parameters])
    shares = relative | np.array([each.effect == _GAIN for each in parameters])
    sizes = np.where(shares, 1.0, usual)
    spreads = [
        Spread(f"{each.effect} of {each.where}: {each.name}", size * np.eye(p)[:, [at]])
        for at, (each, size) in enumerate(zip(parameters, sizes.tolist(), strict=True))
        if at >= bodies
    ]
    changes = _joint_changes(parameters, relative, sizes)
    mass = payload or _USUAL_PAYLOAD * float(model.total_phi[:, 0].sum())
    of_bodies, B = [], base.matrix
    for body, (name, phi) in enumerate(zip(model.bodies, model.total_phi, strict=True)):
        if not is_physical(phi):
            continue
        factor = narrow_factor(body_factor(distance_factor(phi), body, B, bodies))
        of_bodies.append(Spread(name, np.pad(factor, ((0, p - bodies), (0, 0)))))
        # A ball of the size and mass of a usual payload, at the body's centre of mass.
        ball = 0.4 * mass * _PAYLOAD_RADIUS**2 * np.eye(3)
        root = distance_factor(from_mass_com_inertia(mass, phi[1:4] / phi[0], ball))
        factor = body_factor(root, body, B, p)
        changes.append(ChangeHypothesis(_LOAD, name, factor, _HELD, (STEP,), root[:4]))
    units = tuple(each.unit for each in parameters)
    spread = (*of_bodies, *spreads)
    columns = TypeColumns(prior, relative, relative.copy(), n, spread, units)
    return TypeLayout(kept, parameters, columns, tuple(changes), base)


def _model_values(model: RobotModel, effects: tuple[Effect, ...]) -> dict[int, tuple[float, bool]]:
    """Return column of effects -> its value in the model, and if it is never negative."""
    starts = column_starts(effects, model.bodies)
    return {
        starts[fitted.effect] + k: (float(value), parameter.lower >= 0.0)
        for fitted in model.effects
        if fitted.effect in starts and fitted.effect.role in _KEPT
        for k, (parameter, value) in enumerate(
            zip(fitted.effect.parameters, fitted.parameters, strict=True)
        )
    }


def _parameters(
    settings: DigestSettings, kept: Indices, model: RobotModel, base: BaseParameters
) -> tuple[FleetParameter, ...]:
    """Return the parameters of columns, units as their joints turn or slide."""
    columns, labels = [settings.columns[at] for at in kept.tolist()], base.labels(model.bodies)
    found = [
        FleetParameter(BODIES, column.where[0], label, column.unit)
        for label, column in zip(labels, columns, strict=False)
    ]
    for column in columns[len(labels) :]:
        where, unit = ", ".join(column.where), "" if column.unit == "1" else column.unit
        if column.where[0] in model.sliding_joints:
            unit = when_sliding(unit)
        found.append(FleetParameter(column.name, where, column.parameter, unit))
    gains = [FleetParameter(_GAIN, joint, "scale", "") for joint in model.joints]
    return (*found, *gains)


def _joint_changes(
    parameters: Sequence[FleetParameter], relative: NDArray[np.bool_], sizes: Array
) -> list[ChangeHypothesis]:
    """Return the possible changes: each effect at each place, and a joint's frictions together."""
    p, found = len(parameters), []
    effects: dict[tuple[str, str], list[int]] = {}
    for at, each in enumerate(parameters):
        if each.effect != BODIES:
            effects.setdefault((each.effect, each.where), []).append(at)
    joined: dict[str, list[str]] = {}

    def change(effect: str, where: str, size: float, columns: Sequence[int]) -> ChangeHypothesis:
        names = tuple((parameters[at].name, parameters[at].unit) for at in sorted(columns))
        kinds = (STEP,) if effect == _GAIN else KINDS
        return ChangeHypothesis(effect, where, size * np.eye(p)[:, columns], names, kinds)

    for (effect, where), columns in effects.items():
        shares = effect != _GAIN and bool(relative[columns].all())
        size = 1.0 if shares else float(sizes[columns].max())
        size = _USUAL_GAIN if effect == _GAIN else size
        found.append(change(effect, where, size, columns))
        if shares:
            joined.setdefault(where, []).append(effect)
    for where, names in joined.items():
        if len(names) > 1:
            together = [at for name in names for at in effects[name, where]]
            found.append(change("+".join(names), where, 1.0, together))
    return found
