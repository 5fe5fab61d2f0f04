"""From a type's model and the settings of its digests to what statistics of fleets need.

Digests have columns of all that may be missing. A fleet's statistics need few: the bodies, what
the model has, and friction and offsets of joints; and hypotheses of what changes in a robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.showing import Short
from geodrake.effects import Role
from geodrake.effects.declarations import when_sliding
from geodrake.effects.lookup import effect_of
from geodrake.fleet.columns import Spread, TypeColumns, body_spread, column_spreads
from geodrake.fleet.digest_dataset import model_of_digests
from geodrake.fleet.hypotheses import ChangeHypothesis, body_change, column_change
from geodrake.fleet.profiles import STEP
from geodrake.fleet.settings import DigestSettings
from geodrake.inertia import PARAMETERS_PER_BODY, is_physical
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

BODIES = "bodies"
"""What columns of bodies are called in the place of an effect."""

_USUAL_PAYLOAD = 0.1  # over the mass of all that moves
_USUAL_GAIN = 0.1  # share by which a gain changes
_KEPT = (Role.FORCE, Role.DEFLECTION)
_LOAD, _GAIN = (effect_of(role).name for role in (Role.BODY, Role.SCALE))


@dataclass(frozen=True)
class FleetParameter:
    """What a column of a type is of.

    Attributes:
        effect: Name of the effect; `BODIES` for combinations of inertial parameters.
        where: Its joint, or the body that names it.
        name: Name of the parameter, or of the combination.
        unit: Its unit; empty for plain numbers, such as shares.
    """

    effect: str
    where: str
    name: str
    unit: str


@dataclass(frozen=True, eq=False)
class TypeLayout(Short):
    """The p columns of a type: those of digests that count, then a gain for each joint.

    Attributes:
        kept: (p − n,) which of the settings' columns they are.
        parameters: (p,) what they are of.
        columns: How robots differ in them.
        hypotheses: What may change in a robot.
        payload_roots: Hypothesis of a payload -> (10, 10) inertial parameters of its coordinates.
    """

    kept: Indices
    parameters: tuple[FleetParameter, ...]
    columns: TypeColumns
    hypotheses: tuple[ChangeHypothesis, ...]
    payload_roots: dict[int, Array]


def type_layout(
    model: RobotModel, settings: DigestSettings, efforts: Array, *, payload: float | None = None
) -> TypeLayout:
    """The columns of a type, and what may change in its robots.

    Args:
        model: The model as it was given when the settings were made.
        efforts: (nv,) usual sizes of the joints' efforts, N·m or N.
        payload: Mass of a usual payload, kg; None for a tenth of all that moves.

    Raises:
        DigestError: The settings are of another model.
    """
    model = model_of_digests(model, settings)
    bodies = len(settings.independent)
    own = _model_values(model, settings)
    kept = np.concatenate([np.arange(bodies), np.array(sorted(own), np.intp)]).astype(np.intp)
    parameters = _parameters(settings, kept, model)
    n, p = len(model.joints), len(kept) + len(model.joints)
    prior = np.zeros(p)
    prior[:bodies] = settings.base_matrix @ model.total_phi.ravel()
    prior[bodies : p - n] = [own[at][0] for at in kept[bodies:].tolist()]
    relative = np.zeros(p, bool)
    relative[bodies : p - n] = [own[at][1] for at in kept[bodies:].tolist()]
    sizes = _sizes(parameters, relative, dict(zip(model.joints, efforts.tolist(), strict=True)))
    columns = TypeColumns(
        prior,
        np.arange(p) < p - n,
        relative,
        relative.copy(),
        n,
        (*_body_spreads(model, settings, p), *_column_spreads(parameters, sizes, bodies)),
        tuple(each.unit for each in parameters),
    )
    hypotheses = _joint_changes(parameters, relative, sizes)
    mass = payload or _USUAL_PAYLOAD * float(model.total_phi[:, 0].sum())
    roots = {}
    for body, name in enumerate(model.bodies):
        phi = model.total_phi
        if is_physical(phi[body]):
            B, given = settings.base_matrix, (_LOAD, name, body, phi)
            part = slice(PARAMETERS_PER_BODY * body, PARAMETERS_PER_BODY * (body + 1))
            roots[len(hypotheses)] = body_change(*given, phi.size, mass=mass).factor[part]
            hypotheses.append(body_change(*given, p, mass=mass, matrix=B))
    return TypeLayout(kept, parameters, columns, tuple(hypotheses), roots)


def _model_values(model: RobotModel, settings: DigestSettings) -> dict[int, tuple[float, bool]]:
    """Column of settings -> value of the model's effect there, and whether it is never negative."""
    starts, at = {}, len(settings.independent)
    for each in settings.effects:
        if not each.in_bodies:
            starts[each.name, each.where, tuple(each.shape.items())] = at
            at += len(each.parameters)
    found = {}
    for fitted in model.effects:
        effect = fitted.effect
        shape = {name: float(x) for name, x in effect.shape.items() if x is not None}
        start = starts.get((effect.name, tuple(effect.where), tuple(shape.items())))
        if start is None or effect.role not in _KEPT:
            continue
        for k, parameter in enumerate(effect.parameters):
            found[start + k] = float(fitted.parameters[k]), parameter.lower >= 0.0
    return found


def _parameters(
    settings: DigestSettings, kept: Indices, model: RobotModel
) -> tuple[FleetParameter, ...]:
    """What columns are of; units of effects are those of joints that turn, unless theirs slides."""
    found = []
    for at in kept.tolist():
        column = settings.columns[at]
        if column.kind == "body":
            found.append(FleetParameter(BODIES, column.where[0], column.name, column.unit))
        else:
            where, unit = ", ".join(column.where), "" if column.unit == "1" else column.unit
            if column.where[0] in model.sliding_joints:
                unit = when_sliding(unit)
            found.append(FleetParameter(column.name, where, column.parameter, unit))
    gains = [FleetParameter(_GAIN, joint, "scale", "") for joint in model.joints]
    return (*found, *gains)


def _body_spreads(model: RobotModel, settings: DigestSettings, p: int) -> list[Spread]:
    """How each body differs from robot to robot."""
    found = []
    for body, name in enumerate(model.bodies):
        phi = np.full_like(model.total_phi, np.nan)
        phi[body] = model.total_phi[body]
        if is_physical(phi[body]):
            found.append(body_spread(name, phi, p, matrix=settings.base_matrix))
    return found


def _sizes(
    parameters: Sequence[FleetParameter], relative: NDArray[np.bool_], efforts: dict[str, float]
) -> Array:
    """(p,) what is much of each column: of shares 1, of others what makes the usual efforts."""
    usual = np.array([max(efforts.get(each.where, 1.0), 1e-9) for each in parameters])
    shares = relative | np.array([each.effect == _GAIN for each in parameters])
    return np.where(shares, 1.0, usual)


def _column_spreads(
    parameters: Sequence[FleetParameter], sizes: Array, first: int
) -> tuple[Spread, ...]:
    """How each column but those of bodies differs, each by itself."""
    names = [f"{each.effect} of {each.where}: {each.name}" for each in parameters[first:]]
    found = column_spreads(names, range(first, len(parameters)), len(parameters))
    return tuple(
        replace(spread, factor=size * spread.factor)
        for spread, size in zip(found, sizes[first:].tolist(), strict=True)
    )


def _joint_changes(
    parameters: Sequence[FleetParameter], relative: NDArray[np.bool_], sizes: Array
) -> list[ChangeHypothesis]:
    """Each effect at each place changes; frictions of a joint also together."""
    p, found = len(parameters), []
    effects: dict[tuple[str, str], list[int]] = {}
    for at, each in enumerate(parameters):
        if each.effect != BODIES:
            effects.setdefault((each.effect, each.where), []).append(at)
    joined: dict[str, list[str]] = {}
    for (effect, where), columns in effects.items():
        if effect == _GAIN:
            kind, size = (STEP,), _USUAL_GAIN
            found.append(column_change(effect, where, columns, p, size=size, kinds=kind))
            continue
        shares = bool(relative[columns].all())
        size = 1.0 if shares else float(sizes[columns].max())
        found.append(column_change(effect, where, columns, p, size=size))
        if shares:
            joined.setdefault(where, []).append(effect)
    for where, names in joined.items():
        if len(names) > 1:
            together = [at for name in names for at in effects[name, where]]
            found.append(column_change("+".join(names), where, together, p))
    return found
