"""Analysis of a fleet: digests, histories, and the statistics of each type."""

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
from geodrake.fleet.digest_folder import Progress
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
        workers: Number of local processes, or 0 for this process; None for one per core.
        scheduler: Address of a user's Dask scheduler; None for local processes.
        false_alarms: Maximum expected number of robots reported without a change, per robot-month.
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
    progress: Progress = lambda words, share: None,
    report: Callable[[str], None] = lambda line: None,
) -> tuple[FleetResult, FleetDigests]:
    """Digest the logs of a fleet, and find which robots changed.

    Args:
        progress: Called with the progress.
        report: Called with permanent messages.

    Returns:
        The result, which does not depend on interruptions; and the digests of this run.

    Raises:
        FleetError: Logs, models or the scheduler are invalid.
        DigestError: Existing digests are of another model or version, or have other settings.
        OutputError: The folder cannot be written to.
    """
    result, digests = look_at_fleet(fleet, work or FleetWork(), progress=progress, report=report)
    return cast("FleetResult", result), digests  # never None without `seen`


def look_at_fleet(
    fleet: Fleet,
    work: FleetWork,
    seen: FleetDigests | None = None,
    *,
    progress: Progress = lambda words, share: None,
    report: Callable[[str], None] = lambda line: None,
) -> tuple[FleetResult | None, FleetDigests]:
    """Do the work of `run_fleet`; return no result if nothing changed since a previous run.

    Args:
        seen: Digests of the previous run. Its failed logs are skipped until they change.
    """
    instance(fleet, "fleet", Fleet)
    repairs = check_places(fleet, local=work.workers == 0 and work.scheduler is None)
    progress("Looking for logs", None)
    tasks, known = find_tasks(fleet, () if seen is None else seen.failed)
    pieces = max(len(tasks), len(fleet.robots)) if seen is None or tasks else 0
    with workers(pieces, count=work.workers, scheduler=work.scheduler, report=report) as team:
        digests = replace(digest_fleet(fleet, tasks, known, team, progress), repairs=repairs)
        records = digests.records, digests.failed
        if seen is not None and not digests.made and records == (seen.records, seen.failed):
            return None, digests
        return _result(fleet, digests, work.false_alarms, progress, team), digests


def _result(
    fleet: Fleet, digests: FleetDigests, false_alarms: float, progress: Progress, team: Workers
) -> FleetResult:
    unused = [*digests.failed]
    robots: list[RobotResult] = []
    for kind in fleet.types.values():
        type_robots = fleet.of_type(kind.name)
        records = {}
        for robot in type_robots:
            records[robot.name], duplicates = _unique(digests.records.get(robot.name, ()))
            unused += duplicates
        settings, results = digests.settings[kind.name], list[RobotResult]()
        if settings is not None:
            progress(f"Looking for changes in {kind.name}", None)
            results, damaged = _type_results(
                fleet, kind, records, settings, false_alarms=false_alarms, team=team
            )
            unused += damaged
        with_results = {result.robot for result in results}
        missing = [robot.name for robot in type_robots if robot.name not in with_results]
        robots += results
        robots += [RobotResult(name, kind.name, 0, np.zeros(0)) for name in missing]
    hashes = {name: s.hash for name, s in digests.settings.items() if s is not None}
    worst_first = tuple(sorted(robots, key=_sort_key))
    run = hashes, digests.repairs, fleet.folder, digests.made
    return FleetResult(worst_first, tuple(unused), false_alarms, *run)


def _unique(records: Sequence[LogRecord]) -> tuple[list[LogRecord], list[LogRecord]]:
    """Return a robot's logs with unique content, and the duplicates."""
    addresses: dict[str, str] = {}
    unique, duplicates = [], []
    for record in records:
        if record.digest in addresses:
            reason = f"It has the same content as {addresses[record.digest]}, and is used once."
            duplicates.append(replace(record, reason=reason))
        else:
            addresses[record.digest] = record.address
            unique.append(record)
    return unique, duplicates


def _type_results(
    fleet: Fleet,
    kind: FleetType,
    records: Mapping[str, Sequence[LogRecord]],
    settings: DigestSettings,
    *,
    false_alarms: float,
    team: Workers,
) -> tuple[list[RobotResult], list[LogRecord]]:
    """Return the results for robots of a type with logs, and logs with damaged digests."""
    (model, wanted), folder = type_source(kind), fleet.folder / kind.name
    layout_of = partial(type_layout, model, settings, payload=kind.payload, extra=wanted.extra)
    kept = layout_of(np.ones(len(settings.joints))).kept
    tasks = [
        HistoryTask(name, of_robot, folder, settings, kept)
        for name, of_robot in records.items()
        if of_robot
    ]
    histories, damaged = list[RobotHistory](), list[LogRecord]()
    for history, refused in team.in_order(read_history, tasks):
        histories += [] if history is None else [history]
        for record, problem in refused:
            write_record(folder, replace(record, stamp=""))  # digest it again next time
            reason = f"{problem} The next run digests it again, if the log exists."
            damaged.append(replace(record, reason=reason))
    if not histories:
        return [], damaged
    efforts = np.sqrt(np.mean([history.effort**2 for history in histories], axis=0))
    efforts[efforts == 0.0] = 1.0  # joints at rest
    layout = layout_of(efforts)
    models = {
        robot.name: _values_of_model(kind, robot, layout, settings)
        for robot in fleet.of_type(kind.name)
        if robot.model is not None
    }
    report = partial(_robot_result, kind=kind.name, layout=layout, models=models)
    find = partial(find_changes, false_alarms=false_alarms, team=team)
    try:
        _, results = find(histories, layout.columns, layout.hypotheses, report)
    except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        raise FleetError(
            f"Robots of type {kind.name} cannot be compared: their common parameters have no "
            f"solution ({error}).",
            advice="More robots, or logs with more motion, may help; their digests are kept.",
        ) from error
    return results, damaged


def _values_of_model(
    kind: FleetType, robot: FleetRobot, layout: TypeLayout, settings: DigestSettings
) -> Array:
    """Return (p,) values of the columns in a robot's own model; NaN for missing effects."""
    model = holding(own_model(kind, robot.model or kind.model), settings.held)
    by_name = {
        (f.effect.name, ", ".join(f.effect.where), parameter.name): float(x)
        for f in model.effects
        for parameter, x in zip(f.effect.parameters, f.parameters, strict=True)
    }
    names = [(p.effect, p.where, p.name) for p in layout.parameters]
    values = np.array([by_name.get(name, np.nan) for name in names])
    base = layout.base.matrix @ model.total_phi.ravel()
    values[: len(base)] = base
    return values


def _sort_key(robot: RobotResult) -> tuple[int, float, float, str]:
    """Return a key that sorts robots by findings, then missing logs, then differences."""
    if robot.findings:
        return 0, robot.findings[0].false_alarm_probability, 0.0, robot.robot
    farthest = robot.farthest
    apart = 0.0 if farthest is None else -abs(farthest.apart)
    return (2 if robot.logs else 1), 0.0, apart, robot.robot


_PRIOR_SCALE = 100.0  # of a log's value, in standard deviations between robots


def parameter_levels(
    model: TypeModel, robot: int, logs: LogEquations, fit: RobotFit, column: int
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the value of a parameter by each log, given the robot's other parameters.

    Logs are not smoothed: values before and after a change are independent, except for the
    uncertainty of the other parameters.

    Returns:
        (T,) values; (T,) standard deviations, including scatter of logs beyond noise; and (T,)
        whether the log is more informative than the type's prior.
    """
    involves = [spread.factor[column].any() for spread in model.columns.spreads]
    scale = model.scale(robot)[:, None]
    parts = list(zip(model.columns.spreads, model.scatter, involves, strict=True))
    others = [tau * scale * s.factor for s, tau, is_involved in parts if not is_involved]
    factor = narrow_factor(np.hstack([np.zeros_like(scale), *others]))
    M, m = calc_marginal(logs.information, logs.right, factor, np.array([column]))
    mean = model.parameters(robot, logs, fit)
    prior_variance = sum(float(np.square(f[column]).sum()) for f in model.deviation_factors())
    prior_variance = max(prior_variance, np.finfo(float).tiny ** 0.5)
    covariance = 1.0 / (M[:, column] + 1.0 / (_PRIOR_SCALE**2 * prior_variance))
    score = m - np.einsum("tpc,tp->tc", M, mean)
    # Errors of the other parameters affect the values of all logs.
    M[:, column] = 0.0
    slopes = fit.mapped(covariance[..., None] * np.swapaxes(M, 1, 2))[:, 0]
    variance = covariance[:, 0] + np.sum(slopes * fit.solve(slopes.T).T, axis=1)
    scatter = 0.0
    for spread, tau, is_involved in parts:
        if is_involved:
            scatter += tau**2 * np.square(scale[column] * spread.factor[column]).sum()
    values = mean[:, column] + (covariance * score)[:, 0]
    return values, np.sqrt(variance + scatter), variance < prior_variance


def _robot_result(
    search: RobotSearch, *, kind: str, layout: TypeLayout, models: Mapping[str, Array]
) -> RobotResult:
    """Return the result for a robot, given values (p,) in the robots' own model files."""
    places, history, model = search.find(), search.history, search.model
    state, findings = search.state(places), search.findings(places)
    # Without parameters of bodies, which a log determines only in combination.
    histories = (
        ParameterHistory(parameter, *parameter_levels(model, 0, state.logs, state.fit, k))
        for k, parameter in enumerate(layout.parameters)
        if parameter.effect != BODIES
    )
    return RobotResult(
        history.robot,
        kind,
        history.logs or len(history.days),
        history.days * DAY,
        tuple(sorted(findings, key=lambda f: (f.false_alarm_probability, f.date))),
        tuple(histories),
        _own_parameters(model, layout, state, models.get(history.robot)),
    )


def _own_parameters(
    model: TypeModel, layout: TypeLayout, state: SearchState, of_model: Array | None
) -> tuple[OwnParameter, ...]:
    """Return a robot's parameters without changes, compared with other robots."""
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
