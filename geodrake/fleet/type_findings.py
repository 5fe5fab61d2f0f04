"""Statistics of all robots of a type, from their histories, as results in units and dates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import FleetError
from geodrake.fleet.change_evidence import ChangePlace
from geodrake.fleet.changes import RobotChange, RobotSearch, SearchState
from geodrake.fleet.fleet_changes import FleetChanges, find_changes
from geodrake.fleet.fleet_result import (
    ChangedParameter,
    FleetFinding,
    OwnParameter,
    ParameterHistory,
    RobotResult,
)
from geodrake.fleet.levels import parameter_levels
from geodrake.fleet.robot_logs import DAY, RobotLogs
from geodrake.fleet.type_layout import BODIES, TypeLayout
from geodrake.fleet.type_model import own_parameters

Array = NDArray[np.float64]


def type_findings(
    name: str,
    robots: Sequence[RobotLogs],
    layout: TypeLayout,
    models: Mapping[str, Array],
    *,
    false_alarms: float,
) -> list[RobotResult]:
    """What changed in robots of a type, in their order.

    Args:
        name: Name of the type.
        robots: Their logs; at least one.
        layout: The columns of the type.
        models: Robot -> (p,) what its own model file says; others have that of the type.
        false_alarms: At most how many robots in which nothing changed are named, a robot-month.
    """
    histories = [robot.history for robot in robots]
    try:
        found = find_changes(
            histories, layout.columns, layout.hypotheses, false_alarms=false_alarms
        )
    except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        raise FleetError(
            f"Robots of type {name} cannot be compared: what they share has no solution ({error}).",
            advice="More robots, or logs with more motion, may help; their digests are kept.",
        ) from error
    results = []
    for at, robot in enumerate(robots):
        own = found.model.own[at]
        search = RobotSearch(found.model, at, robot.history, own, layout.hypotheses)
        state = search.state(found.places[at])
        results.append(
            RobotResult(
                robot.history.robot,
                name,
                robot.logs,
                robot.history.days * DAY,
                _findings(found, at, layout, state),
                _histories(found, at, layout, state),
                _own(found, at, layout, state, models.get(robot.history.robot)),
            )
        )
    return results


def _findings(
    found: FleetChanges, robot: int, layout: TypeLayout, state: SearchState
) -> tuple[FleetFinding, ...]:
    """Changes of a robot, the surest first."""
    findings, end = [], state.fit.design.shape[2]
    pairs = list(zip(found.changes[robot], found.places[robot], strict=True))
    for change, place in reversed(pairs):  # as the columns of changes are the last of the design
        part = slice(end - layout.hypotheses[place.hypothesis].factor.shape[1], end)
        end = part.start
        findings.append(_finding(change, place, layout, state, part))
    order = sorted(findings, key=lambda each: (each.false_alarm_probability, each.date))
    return tuple(order)


def _finding(
    change: RobotChange, place: ChangePlace, layout: TypeLayout, state: SearchState, part: slice
) -> FleetFinding:
    if place.hypothesis in layout.payload_roots:
        parameters = _payload(layout, place, state, part)
    else:
        parameters = _columns(change, layout, place)
    low, high = change.interval
    return FleetFinding(
        change.robot,
        change.effect,
        change.where,
        change.kind,
        change.day * DAY,
        (low * DAY, high * DAY),
        parameters,
        change.probability,
        change.rivals,
        change.false_alarm_probability,
    )


def _columns(
    change: RobotChange, layout: TypeLayout, place: ChangePlace
) -> tuple[ChangedParameter, ...]:
    """What changed of columns that are parameters themselves."""
    moved = np.flatnonzero(layout.hypotheses[place.hypothesis].factor.any(axis=1))
    relative = layout.columns.relative
    return tuple(
        ChangedParameter(
            layout.parameters[at].name,
            layout.parameters[at].unit,
            float(change.size[at]),
            float(change.deviation[at]),
            float(change.share[at]) if relative[at] else np.nan,
        )
        for at in moved.tolist()
    )


def _payload(
    layout: TypeLayout, place: ChangePlace, state: SearchState, part: slice
) -> tuple[ChangedParameter, ...]:
    """Mass that was put on or taken off, and its first moment in the frame of the body.

    Of what logs do not tell apart, the least change is told, and a deviation that says so.
    """
    factor, root = (
        layout.hypotheses[place.hypothesis].factor,
        layout.payload_roots[place.hypothesis],
    )
    at_last = state.fit.design[-1][:, part]
    scale = float(np.linalg.norm(at_last) / np.linalg.norm(factor))
    theta, covariance = state.fit.theta[part], state.fit.covariance[part, part]
    rows = scale * root[:4]
    size, spread = rows @ theta, np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows))
    names = (("mass", "kg"), ("hx", "kg·m"), ("hy", "kg·m"), ("hz", "kg·m"))
    return tuple(
        ChangedParameter(name, unit, float(x), float(deviation), np.nan)
        for (name, unit), x, deviation in zip(names, size, spread, strict=True)
    )


def _histories(
    found: FleetChanges, robot: int, layout: TypeLayout, state: SearchState
) -> tuple[ParameterHistory, ...]:
    """Parameters of effects and gains over time; those of bodies are only known together."""
    histories = []
    for at, parameter in enumerate(layout.parameters):
        if parameter.effect == BODIES:
            continue
        levels = parameter_levels(found.model, robot, state.logs, state.fit, [at])
        histories.append(
            ParameterHistory(
                parameter, levels.values[:, 0], levels.with_scatter[:, 0], levels.shown[:, 0]
            )
        )
    return tuple(histories)


def _own(
    found: FleetChanges,
    robot: int,
    layout: TypeLayout,
    state: SearchState,
    of_model: Array | None,
) -> tuple[OwnParameter, ...]:
    """A robot's parameters without changes, beside those of others."""
    values, covariance = own_parameters(found.model, state.fit)
    deviations = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    squares = [np.square(factor).sum(axis=1) for factor in found.model.deviation_factors()]
    spreads = np.sqrt(np.sum(squares, axis=0))
    of_model = layout.columns.prior if of_model is None else of_model
    columns = zip(
        layout.parameters, values, deviations, found.model.mean, spreads, of_model, strict=True
    )
    return tuple(
        OwnParameter(parameter, *(float(number) for number in numbers))
        for parameter, *numbers in columns
    )
