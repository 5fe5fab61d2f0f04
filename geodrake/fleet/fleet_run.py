"""A fleet from its file to its findings: digests, histories, and the statistics of each type."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, integer, number, typed
from geodrake.boundary.showing import Short
from geodrake.errors import FleetError
from geodrake.fleet.changes import RobotSearch, SearchState, find_changes
from geodrake.fleet.digest_folder import Told
from geodrake.fleet.fleet_file import Fleet, FleetRobot, FleetType
from geodrake.fleet.fleet_logs import (
    FleetDigests,
    LogRecord,
    check_places,
    digest_fleet,
    find_tasks,
    write_record,
)
from geodrake.fleet.fleet_result import (
    FleetResult,
    OwnParameter,
    ParameterHistory,
    RobotResult,
)
from geodrake.fleet.history import DAY, HistoryTask, LogEquations, RobotHistory, read_history
from geodrake.fleet.settings import DigestSettings
from geodrake.fleet.type_columns import narrow_factor
from geodrake.fleet.type_layout import BODIES, TypeLayout, own_model, type_layout, type_source
from geodrake.fleet.type_model import RobotFit, TypeModel, calc_marginal, own_parameters
from geodrake.fleet.workers import Workers, workers
from geodrake.inertia import Array
from geodrake.model.holding import holding


@dataclass(frozen=True)
class FleetWork(Short):
    """Workers, and the rate of false alarms.

    Attributes:
        workers: Processes of this machine, or 0 for this one; None for one on each core.
        scheduler: Address of a scheduler of the user's own; None for processes of this machine.
        false_alarms: At most how many robots in which nothing changed are named, a robot-month.
    """

    workers: int | None = None
    scheduler: str | None = None
    false_alarms: float = 0.01

    def __post_init__(self) -> None:
        if self.workers is not None:
            integer(self.workers, "workers", lower=0, upper=10_000)
        if self.scheduler is not None:
            instance(self.scheduler, "scheduler", str)
        number(self.false_alarms, "false_alarms", lower=0.0, upper=1.0, strict=True)


@typed
def run_fleet(
    fleet: Fleet,
    work: FleetWork | None = None,
    *,
    told: Told = lambda words, share: None,
    said: Callable[[str], None] = lambda line: None,
) -> tuple[FleetResult, FleetDigests]:
    """Digest the logs of a fleet, and find which robots changed.

    Args:
        said: Called with what is worth a line that stays.

    Returns:
        What was found, which is the same however often the run was stopped; and what became of the
        logs in this run.

    Raises:
        FleetError: Logs, models or the scheduler cannot be used as the file says.
        DigestError: There are digests of another model, version, or other settings.
        OutputError: The folder cannot be written to.
    """
    result, digests = look_at_fleet(fleet, work or FleetWork(), told=told, said=said)
    return cast("FleetResult", result), digests  # a first look always has a result


def look_at_fleet(
    fleet: Fleet,
    work: FleetWork,
    seen: FleetDigests | None = None,
    *,
    told: Told = lambda words, share: None,
    said: Callable[[str], None] = lambda line: None,
) -> tuple[FleetResult | None, FleetDigests]:
    """Do the work of `run_fleet`; return no result if nothing changed since the last look.

    Logs that failed then are not tried again until they have changed.
    """
    instance(fleet, "fleet", Fleet)
    repairs = check_places(fleet, local=work.workers == 0 and work.scheduler is None)
    told("Looking for logs", None)
    tasks, known = find_tasks(fleet, () if seen is None else seen.failed)
    pieces = max(len(tasks), len(fleet.robots)) if seen is None or tasks else 0
    with workers(pieces, count=work.workers, scheduler=work.scheduler, told=said) as team:
        digests = replace(digest_fleet(fleet, tasks, known, team, told), repairs=repairs)
        there = digests.records, digests.failed
        if seen is not None and not digests.made and there == (seen.records, seen.failed):
            return None, digests
        return _result(fleet, digests, work.false_alarms, told, team), digests


def _result(
    fleet: Fleet, digests: FleetDigests, false_alarms: float, told: Told, team: Workers
) -> FleetResult:
    unused = [*digests.failed]
    robots: list[RobotResult] = []
    for kind in fleet.types.values():
        own = fleet.of_type(kind.name)
        records = {}
        for robot in own:
            records[robot.name], twice = _once(digests.records.get(robot.name, ()))
            unused += twice
        settings, found = digests.settings[kind.name], list[RobotResult]()
        if settings is not None:
            told(f"Looking for changes in {kind.name}", None)
            found, damaged = _of_type(
                fleet, kind, records, settings, false_alarms=false_alarms, team=team
            )
            unused += damaged
        seen = {result.robot for result in found}
        lacking = [robot.name for robot in own if robot.name not in seen]
        robots += found
        robots += [RobotResult(name, kind.name, 0, np.zeros(0)) for name in lacking]
    hashes = {name: each.hash for name, each in digests.settings.items() if each is not None}
    worst_first = tuple(sorted(robots, key=_badness))
    known = hashes, digests.repairs, fleet.folder, digests.made
    return FleetResult(worst_first, tuple(unused), false_alarms, *known)


def _once(records: Sequence[LogRecord]) -> tuple[list[LogRecord], list[LogRecord]]:
    """Return logs of a robot, those of the same bytes once; and the others."""
    seen: dict[str, str] = {}
    kept, twice = [], []
    for record in records:
        if record.digest in seen:
            reason = f"It has the same content as {seen[record.digest]}, and is used once."
            twice.append(replace(record, reason=reason))
        else:
            seen[record.digest] = record.address
            kept.append(record)
    return kept, twice


def _of_type(
    fleet: Fleet,
    kind: FleetType,
    records: Mapping[str, Sequence[LogRecord]],
    settings: DigestSettings,
    *,
    false_alarms: float,
    team: Workers,
) -> tuple[list[RobotResult], list[LogRecord]]:
    """Return findings in robots of a type that have logs, and logs whose digest is damaged."""
    (model, wanted), folder = type_source(kind), fleet.folder / kind.name
    layout_of = partial(type_layout, model, settings, payload=kind.payload, extra=wanted.extra)
    kept = layout_of(np.ones(len(settings.joints))).kept
    tasks = [HistoryTask(name, own, folder, settings, kept) for name, own in records.items() if own]
    histories, damaged = list[RobotHistory](), list[LogRecord]()
    for history, refused in team.in_order(read_history, tasks):
        histories += [] if history is None else [history]
        for record, problem in refused:
            write_record(folder, replace(record, stamp=""))  # so that it is looked at again
            reason = f"{problem} The next run digests it again, if the log exists."
            damaged.append(replace(record, reason=reason))
    if not histories:
        return [], damaged
    efforts = np.sqrt(np.mean([each.effort**2 for each in histories], axis=0))
    efforts[efforts == 0.0] = 1.0  # of joints at rest
    layout = layout_of(efforts)
    models = {
        robot.name: _own_values(kind, robot, layout, settings)
        for robot in fleet.of_type(kind.name)
        if robot.model is not None
    }
    tell = partial(_robot_result, kind=kind.name, layout=layout, models=models)
    find = partial(find_changes, false_alarms=false_alarms, team=team)
    try:
        _, found = find(histories, layout.columns, layout.hypotheses, tell)
    except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        raise FleetError(
            f"Robots of type {kind.name} cannot be compared: their common parameters have no "
            f"solution ({error}).",
            advice="More robots, or logs with more motion, may help; their digests are kept.",
        ) from error
    return found, damaged


def _own_values(
    kind: FleetType, robot: FleetRobot, layout: TypeLayout, settings: DigestSettings
) -> Array:
    """Return (p,) values of the columns in a robot's own model; NaN for effects that it lacks."""
    own = holding(own_model(kind, robot.model or kind.model), settings.held)
    values = {
        (f.effect.name, ", ".join(f.effect.where), parameter.name): float(x)
        for f in own.effects
        for parameter, x in zip(f.effect.parameters, f.parameters, strict=True)
    }
    found = np.array(
        [values.get((each.effect, each.where, each.name), np.nan) for each in layout.parameters]
    )
    base = layout.base.matrix @ own.total_phi.ravel()
    found[: len(base)] = base
    return found


def _badness(robot: RobotResult) -> tuple[int, float, float, str]:
    """Return robots with findings, the surest first; then those without logs; then the others."""
    if robot.findings:
        return 0, robot.findings[0].false_alarm_probability, 0.0, robot.robot
    farthest = robot.farthest
    apart = 0.0 if farthest is None else -abs(farthest.apart)
    return (2 if robot.logs else 1), 0.0, apart, robot.robot


_LOOSE = 100.0  # deviations of the type that a parameter may be off where a log says nothing


def parameter_levels(
    model: TypeModel, robot: int, logs: LogEquations, fit: RobotFit, column: int
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the values of a parameter that each log suggests, with all others those of the robot.

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


def _robot_result(
    search: RobotSearch, *, kind: str, layout: TypeLayout, models: Mapping[str, Array]
) -> RobotResult:
    """Return the result for a robot; (p,) are the values in its own model file, or its type's.

    Parameters of bodies are only known together.
    """
    places, history, model = search.find(), search.history, search.model
    state, findings = search.state(places), search.told(places)
    histories = (
        ParameterHistory(each, *parameter_levels(model, 0, state.logs, state.fit, at))
        for at, each in enumerate(layout.parameters)
        if each.effect != BODIES
    )
    return RobotResult(
        history.robot,
        kind,
        history.logs or len(history.days),
        history.days * DAY,
        tuple(sorted(findings, key=lambda each: (each.false_alarm_probability, each.date))),
        tuple(histories),
        _own(model, layout, state, models.get(history.robot)),
    )


def _own(
    model: TypeModel, layout: TypeLayout, state: SearchState, of_model: Array | None
) -> tuple[OwnParameter, ...]:
    """Return a robot's parameters without changes, compared with those of others."""
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
