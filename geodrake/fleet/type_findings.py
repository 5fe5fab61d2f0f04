"""Statistics of all robots of a type, from their histories, as results in units and dates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from geodrake.errors import FleetError
from geodrake.fleet.change_evidence import ChangePlace
from geodrake.fleet.changes import (
    FleetChanges,
    RobotChange,
    RobotSearch,
    SearchState,
    find_changes,
)
from geodrake.fleet.fleet_result import (
    ChangedParameter,
    FleetFinding,
    OwnParameter,
    ParameterHistory,
    RobotResult,
)
from geodrake.fleet.history import DAY, KeptHistory, LogEquations
from geodrake.fleet.type_columns import narrow_factor
from geodrake.fleet.type_layout import BODIES, TypeLayout
from geodrake.fleet.type_model import RobotFit, TypeModel, calc_marginal, own_parameters
from geodrake.fleet.workers import Workers
from geodrake.inertia import Array

_LOOSE = 100.0  # deviations of the type that a parameter may be off where a log says nothing


def parameter_levels(
    model: TypeModel, robot: int, logs: LogEquations, fit: RobotFit, column: int
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return what each log says of a parameter, where all others are those of the robot.

    No log is smoothed by others: levels before and after a change are independent but for what is
    not known of the robot.

    Returns:
        (T,) values; (T,) standard deviations of these as those of the robot in these days, with
        what logs scatter beyond their noise, as models are never exact; and (T,) whether the log
        says more of it than that it is one of the type.
    """
    at = np.array([column])
    touch = [spread.factor[column].any() for spread in model.columns.spreads]
    scale = model.scale(robot)[:, None]
    parts = zip(model.columns.spreads, model.scatter, touch, strict=True)
    rest = [tau * scale * s.factor for s, tau, touched in parts if not touched]
    factor = narrow_factor(np.hstack([np.zeros_like(scale), *rest]))
    M, m = calc_marginal(logs.information, logs.right, factor, at)
    mean = model.parameters(robot, logs, fit)
    usual = sum(float(np.square(f[column]).sum()) for f in model.deviation_factors())
    usual = max(usual, np.finfo(float).tiny ** 0.5)
    covariance = 1.0 / (M[:, column] + 1.0 / (_LOOSE**2 * usual))
    score = m - np.einsum("tpc,tp->tc", M, mean)
    # What is not known of the other parameters moves all logs' levels together.
    M[:, column] = 0.0
    moved = fit.mapped(covariance[..., None] * np.swapaxes(M, 1, 2))[:, 0]
    variance = covariance[:, 0] + np.sum(moved * fit.solve(moved.T).T, axis=1)
    scattered = 0.0
    for tau, spread, touched in zip(model.scatter, model.columns.spreads, touch, strict=True):
        if touched:
            scattered += tau**2 * np.square(scale[column] * spread.factor[column]).sum()
    values = mean[:, column] + (covariance * score)[:, 0]
    return values, np.sqrt(variance + scattered), variance < usual


def type_findings(
    name: str,
    histories: Sequence[KeptHistory],
    layout: TypeLayout,
    models: Mapping[str, Array],
    *,
    false_alarms: float,
    team: Workers,
) -> list[RobotResult]:
    """Return what changed in robots of a type, in their order.

    Args:
        models: Robot -> (p,) what its own model file says; others have that of the type.
    """
    tell = partial(_result, kind=name, layout=layout, models=models)
    found: FleetChanges[RobotResult]
    try:
        found = find_changes(
            histories,
            layout.columns,
            layout.hypotheses,
            false_alarms=false_alarms,
            tell=tell,
            team=team,
        )
    except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        raise FleetError(
            f"Robots of type {name} cannot be compared: what they share has no solution ({error}).",
            advice="More robots, or logs with more motion, may help; their digests are kept.",
        ) from error
    logs = {each.robot: each.logs for each in histories}
    return [replace(each, logs=logs[each.robot]) for each in found.changes]


def _result(
    search: RobotSearch, *, kind: str, layout: TypeLayout, models: Mapping[str, Array]
) -> RobotResult:
    places, history, model = search.find(), search.history, search.model
    state, changes = search.state(places), search.told(places)
    return RobotResult(
        history.robot,
        kind,
        len(history.days),
        history.days * DAY,
        _findings(changes, places, layout),
        _histories(model, layout, state),
        _own(model, layout, state, models.get(history.robot)),
    )


def _findings(
    changes: Sequence[RobotChange], places: Sequence[ChangePlace], layout: TypeLayout
) -> tuple[FleetFinding, ...]:
    """Return changes of a robot, the surest first."""
    pairs = zip(changes, places, strict=True)
    findings = [_finding(change, place.hypothesis, layout) for change, place in pairs]
    return tuple(sorted(findings, key=lambda each: (each.false_alarm_probability, each.date)))


def _finding(change: RobotChange, hypothesis: int, layout: TypeLayout) -> FleetFinding:
    if hypothesis in layout.payload_roots:
        parameters = _payload(change, layout.payload_roots[hypothesis])
    else:
        parameters = _columns(change, layout, hypothesis)
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
    change: RobotChange, layout: TypeLayout, hypothesis: int
) -> tuple[ChangedParameter, ...]:
    """Return what changed of columns that are parameters themselves."""
    moved = np.flatnonzero(layout.hypotheses[hypothesis].factor.any(axis=1))
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


def _payload(change: RobotChange, root: Array) -> tuple[ChangedParameter, ...]:
    """Mass that was put on or taken off, and its first moment in the frame of the body.

    Of what logs do not tell apart, the least change is told, and a deviation that says so.
    """
    rows = root[:4]
    size = rows @ change.coordinates
    spread = np.sqrt(np.einsum("ij,jk,ik->i", rows, change.covariance, rows))
    names = (("mass", "kg"), ("hx", "kg·m"), ("hy", "kg·m"), ("hz", "kg·m"))
    return tuple(
        ChangedParameter(name, unit, float(x), float(deviation), np.nan)
        for (name, unit), x, deviation in zip(names, size, spread, strict=True)
    )


def _histories(
    model: TypeModel, layout: TypeLayout, state: SearchState
) -> tuple[ParameterHistory, ...]:
    """Return parameters of effects and gains over time; those of bodies are only known together."""
    histories = []
    for at, parameter in enumerate(layout.parameters):
        if parameter.effect == BODIES:
            continue
        levels = parameter_levels(model, 0, state.logs, state.fit, at)
        histories.append(ParameterHistory(parameter, *levels))
    return tuple(histories)


def _own(
    model: TypeModel, layout: TypeLayout, state: SearchState, of_model: Array | None
) -> tuple[OwnParameter, ...]:
    """A robot's parameters without changes, beside those of others."""
    values, covariance = own_parameters(model, state.fit)
    deviations = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    squares = [np.square(factor).sum(axis=1) for factor in model.deviation_factors()]
    spreads = np.sqrt(np.sum(squares, axis=0))
    of_model = layout.columns.prior if of_model is None else of_model
    columns = zip(layout.parameters, values, deviations, model.mean, spreads, of_model, strict=True)
    return tuple(
        OwnParameter(parameter, *(float(number) for number in numbers))
        for parameter, *numbers in columns
    )
