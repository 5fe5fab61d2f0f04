"""Prepare and reduce the logs that a model is compared with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, instances, integer, real_array
from geodrake.boundary.showing import Short
from geodrake.effects import catalogue
from geodrake.effects.base import Effect
from geodrake.errors import LogError
from geodrake.identification.logs.bandwidth import prepare_for_model
from geodrake.identification.logs.candidate_effects import candidate_delays, candidate_effects
from geodrake.identification.logs.dataset import Dataset, Delay
from geodrake.identification.logs.hypothesis import HeldOut
from geodrake.identification.logs.log_slices import MIXED_ROOM, ROOM, RowCache
from geodrake.identification.logs.model_errors import ErrorTable, JointError, Series
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.noise import filtered_below, known_noise
from geodrake.identification.logs.reduce import reduce_logs, sign_widths
from geodrake.identification.logs.signal_calibration import calibrate_efforts
from geodrake.identification.logs.unknowns import Unknowns
from geodrake.logs.files import read_log
from geodrake.logs.folds import Fold, share_motion, validation_blocks
from geodrake.logs.log_checks import (
    check_commands,
    check_repeated,
    check_saturation,
    constant_efforts,
    constant_notes,
)
from geodrake.logs.motion import NOT_MEASURED, UNMEASURED, JointLog, Trajectory
from geodrake.logs.preparation import motion_bandwidth_of, prepare_logs
from geodrake.logs.smoothing import Segment
from geodrake.logs.uniform_log import make_uniform
from geodrake.logs.units_of_values import (
    effort_hint,
    effort_unit_hint,
    position_limit_hint,
    position_unit_hint,
)
from geodrake.model.carried_payloads import payload_notes
from geodrake.model.effort_signal import COMMAND, signal_of
from geodrake.model.logged_joints import holding_resting, log_of_model, reading_for
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import kind_of

Array = NDArray[np.float64]
Logs = Sequence[JointLog | str | Path]
T = TypeVar("T")

_OTHER_SCALE = 0.1  # |log| of a time scale from which on time stamps are suspect


@dataclass(frozen=True, eq=False)
class CaseOptions:
    """Options with which a case was prepared."""

    logs: tuple[JointLog, ...]  # with joints in the model's order
    extra: tuple[type[Effect], ...]  # the user's effect classes
    bandwidth: float | None  # Hz; None if chosen from the data
    blocks: int | None


@dataclass(frozen=True, eq=False)
class Case(Short):
    """A model and its prepared and reduced logs."""

    model: RobotModel
    trajectories: tuple[Trajectory, ...]
    folds: tuple[Fold, ...]
    dataset: Dataset  # the reduced logs, with columns for the model's effects and the candidates
    fingerprints: tuple[str, ...]
    notes: tuple[str, ...]  # on the preparation of the logs, and on the model
    first: tuple[str, ...]  # the most important of these: doubts and unused data
    options: CaseOptions
    # The segments of all logs in memory, with the index of their log; filled on demand.
    segments: list[tuple[int, Segment]] = field(default_factory=list, repr=False)
    shared: RowCache = field(default_factory=RowCache, repr=False)  # cache of reductions
    # (nb, 10) inertial parameters for the loads in columns of effects; the model's if None.
    loads: Array | None = None

    @property
    def bandwidths(self) -> dict[str, tuple[float, float]]:
        """Bandwidths, Hz, of the logs of the model's fits and of these logs, by fingerprint."""
        of_logs = dict.fromkeys(self.fingerprints, self.trajectories[0].bandwidths)
        return {**self.model.bandwidths, **of_logs}

    @property
    def load_model(self) -> RobotModel:
        """The model for the load of every joint."""
        return self.model if self.loads is None else replace(self.model, phi=self.loads)

    @property
    def effect_classes(self) -> tuple[type[Effect], ...]:
        """All effects that a diagnosis considers: the catalogue's and the user's."""
        return (*catalogue(), *self.options.extra)


def prepare_case(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    candidates: bool,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    blocks: int | None = None,
    motion_bandwidth: float | None = None,
    hold_resting: bool = False,
) -> Case:
    """Prepare and reduce logs for a model, optionally with columns of `candidates`.

    The `bandwidth` of the filter, Hz, is by default that of the model's fit to the same logs, or
    chosen from the data. Every log is cut into `blocks` for validation; by default folds are whole
    logs if there are at least four, or about eight blocks in total. With `hold_resting`, joints
    that hardly move in any log are held.

    Raises:
        ArgumentError: There is no log, a log is given twice, the body of a known payload does not
            exist, or an option is invalid.
        LogError: A log cannot be used.
    """
    logs = checked_logs(model, logs, extra, bandwidth, blocks)
    model = model.with_volume if candidates else model  # required by fits
    matched = _matched(model, logs)
    if hold_resting and (held := holding_resting(model, matched)) is not model:
        model, matched = held, [log_of_model(log, held) for log in matched]
    # Fingerprints of raw signals, as efforts of servos depend on the model.
    measured = {log.name: log.fingerprint for log in matched}
    model, matched, gain_notes = calibrate_efforts(model, matched)
    _check_efforts(matched)
    matched, constant = _without_constant_efforts(matched)
    passive = tuple(j for j in matched[0].passive if j not in model.motorless) if matched else ()
    model = replace(model, motorless=(*model.motorless, *passive)) if passive else model

    def fingerprints_of(log: JointLog) -> tuple[str, str]:
        return measured[log.name], log.fingerprint  # older models have the latter

    def prepare(logs: Sequence[JointLog]) -> tuple[tuple[Trajectory, ...], list[str], list[str]]:
        uniform = [make_uniform(log) for log in logs]
        hints = [hint for each in uniform for hint in _hints(each.log, model)]
        keys = [[key for key in fingerprints_of(log) if key in model.bandwidths] for log in logs]
        fitted_at = {model.bandwidths[known[0]] if known else None for known in keys}
        with _naming_units(hints):
            if bandwidth is not None:
                motion = motion_bandwidth
                prepared = prepare_logs(uniform, bandwidth=bandwidth, motion_bandwidth=motion)
                return prepared, hints, []
            if len(fitted_at) == 1 and (fit := fitted_at.pop()) is not None:
                how = "of the model's fit"
                prepared = prepare_logs(uniform, bandwidth=fit[0], motion_bandwidth=fit[1], how=how)
                return prepared, hints, []
            trajectories, changed = prepare_for_model(model, uniform)
            return trajectories, hints, [changed] if changed else []

    (trajectories, hints, changed), matched, unused = _with_usable(matched, prepare)
    changed += payload_notes(model, matched)
    trained = [log for log in matched if not set(model.fitted_to).isdisjoint(fingerprints_of(log))]
    fitted = len(trained) == len(matched)
    with _naming_units(hints):
        folds = validation_blocks(trajectories, blocks=blocks)
    effects = effects_of(model)
    delays: tuple[float, ...] = (0.0,)
    if candidates:
        effects += candidate_effects(model, trajectories, extra)
        delays = candidate_delays(trajectories[0].filter)
    room = MIXED_ROOM if any(t.has_unknown_forces for t in trajectories) else ROOM
    # Without candidates, few columns are added later.
    shared = RowCache(room) if candidates else RowCache(room, signals=0)
    reduce = partial(
        reduce_logs,
        model,
        trajectories,
        effects=effects,
        delays=delays,
        fitted=fitted and not candidates,
        shared=shared,
    )
    folds, dataset = _reduced_evenly(folds, trajectories, reduce)
    changed += [_filtered_note(t, fitted=fitted or candidates) for t in trajectories]
    left_out = [f"{t.name}: {t.left_out}" for t in trajectories if t.left_out]
    training = [
        f"the model was fitted to {log.name} before: errors on it are training errors, and a "
        "fit counts it twice"
        for log in trained
    ]
    assumed = dict.fromkeys(note for log in matched for note in log.assumed)
    doubts = [*hints, *constant, *unused, *(_in_which(matched, note) for note in assumed)]
    first = tuple(dict.fromkeys([*doubts, *left_out, *training]))
    notes = [*first, *model.notes, *gain_notes, *filter(None, changed)]
    notes += [f"{t.name}: {x}" for t in trajectories for x in t.notes if x not in assumed]
    notes += [*_still_notes(dataset, trajectories), f"validated on {len(folds)} held-out folds"]
    return Case(
        model,
        trajectories,
        folds,
        dataset,
        tuple(measured[log.name] for log in matched),
        tuple(dict.fromkeys(notes)),
        first,
        CaseOptions(tuple(matched), tuple(extra), bandwidth, blocks),
        shared=shared,
    )


def _reduced_evenly(
    folds: tuple[Fold, ...],
    trajectories: Sequence[Trajectory],
    reduce: Callable[[tuple[Fold, ...]], Dataset],
) -> tuple[tuple[Fold, ...], Dataset]:
    """Return folds of which none has most of a joint's motion, and the reduced logs."""
    dataset = reduce(folds)
    samples = np.array([data.samples for data in dataset.data])
    times = [[[rows.time for rows in blocks] for blocks in data.rows] for data in dataset.data]
    shared = share_motion(folds, trajectories, samples, times)
    return (folds, dataset) if shared is folds else (shared, reduce(shared))


def checked_logs(
    model: RobotModel,
    logs: Logs,
    extra: Sequence[type[Effect]],
    bandwidth: float | None,
    blocks: int | None,
) -> tuple[JointLog | str | Path, ...]:
    """Return the logs or their files, after checking the types of all arguments."""
    instance(model, "model", RobotModel)
    instances(extra, "extra", type)
    if bandwidth is not None:
        real_array(bandwidth, "bandwidth", (), finite=False)
    if blocks is not None:
        integer(blocks, "blocks")
    many = (logs,) if isinstance(logs, JointLog | str | Path) else logs
    return instances(many, "logs", (JointLog, str, Path))


def prepared_as_measured(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    bandwidth: float | None = None,
    blocks: int | None = None,
) -> tuple[tuple[Trajectory, ...], tuple[Fold, ...], frozenset[str]]:
    """Return prepared logs, their folds, and joints with commands of gains fitted to these logs.

    The model's effort signals have no influence. The `bandwidth` of the filter, Hz, is by default
    chosen from the motion.
    """
    logs = checked_logs(model, logs, (), bandwidth, blocks)
    measured = _matched(model, logs)
    unknown = [joint for joint in model.joints if signal_of(model.effort_signals, joint) is None]
    fitted = {j for log in measured for j in unknown if kind_of(log, j) == COMMAND}
    _, matched, _ = calibrate_efforts(model, measured, simulate=False)

    def prepare(logs: Sequence[JointLog]) -> tuple[Trajectory, ...]:
        uniform = [make_uniform(log) for log in logs]
        if bandwidth is not None:
            return prepare_logs(uniform, bandwidth=bandwidth)
        # The bandwidth depends on time stamps, which may be wrong; velocities tell their scale.
        scale = float(np.median([log.time_scale for log in uniform]))
        is_wrong = abs(np.log(scale)) > _OTHER_SCALE
        chosen = motion_bandwidth_of(uniform, time_scale=scale if is_wrong else 1.0)
        return prepare_logs(uniform, bandwidth=chosen, how="chosen from the data")

    trajectories, _, _ = _with_usable(matched, prepare)
    return trajectories, validation_blocks(trajectories, blocks=blocks), frozenset(fitted)


def _with_usable(
    logs: Sequence[JointLog], prepare: Callable[[Sequence[JointLog]], T]
) -> tuple[T, list[JointLog], list[str]]:
    """Prepare logs without unusable ones; return the result, the used logs, and notes."""
    used, notes = list(logs), list[str]()
    while True:
        try:
            return prepare(used), used, notes
        except LogError as error:
            name = error.evidence.get("log")
            rest = [log for log in used if log.name != name]
            if not rest or len(rest) == len(used):
                raise
            used = rest
            notes.append(f"{name} is not used: {error.problem}")


def reduce_fitted(case: Case, model: RobotModel) -> Case:
    """Return the case with a model fitted to it, with columns of its effects only."""
    dataset = reduce_logs(
        model,
        case.trajectories,
        case.folds,
        effects=effects_of(model),
        fitted=True,
        shared=case.shared,
    )
    return replace(case, model=model, dataset=dataset, loads=None)


def reduced(
    case: Case,
    effects: Sequence[Effect],
    *,
    delays: Sequence[ArrayLike] | None = None,
    noise_of: RobotModel | None = None,
) -> Dataset:
    """Return the logs of a case, reduced with columns of other effects.

    Candidate `delays` beyond the model's, s, for all joints or (nv,) for each, are by default those
    of the case. The noise is that of the case, or with the model `noise_of`.
    """
    dataset = case.dataset
    noise = dataset.noise_floor, dataset.noise_known, dataset.motion_noise
    if noise_of is not None:
        widths = sign_widths(noise_of, case.trajectories)
        noise = known_noise(case.trajectories, noise_of, sign_width=widths)
    return reduce_logs(
        case.load_model,
        case.trajectories,
        case.folds,
        effects=effects,
        delays=[*dataset.delays] if delays is None else delays,
        noise=noise,
        shared=case.shared,
    )


def error_table(dataset: Dataset, held_out: HeldOut) -> ErrorTable:
    """Return the errors of every joint that has rows."""
    known = np.broadcast_to(dataset.noise_known, len(dataset.joints))
    columns = (held_out.rms, dataset.effort_std, dataset.noise_floor, known)
    errors = map(JointError, dataset.joints, *(c.tolist() for c in columns))
    return ErrorTable(tuple(e for e, has in zip(errors, dataset.has_rows, strict=True) if has))


def series(
    dataset: Dataset, unknowns: Unknowns, held_out: HeldOut, *, delay: Delay = 0
) -> tuple[Series, ...]:
    """Return measured and held-out predicted efforts of every joint and block."""
    blocks_of_joints, delays = list[Series](), dataset.delay_of_each(delay)
    for joint, data, delay_index in zip(dataset.joints, dataset.data, delays, strict=True):
        local = data.local(unknowns.columns)
        used = local >= 0
        for fold, blocks in enumerate(data.rows):
            x = held_out.x[fold][used]
            blocks_of_joints += [
                Series(
                    joint,
                    dataset.folds[fold],
                    rows.time,
                    rows.motion[:, 0],
                    rows.motion[:, 1],
                    rows.motion[:, 2],
                    rows.b[:, delay_index] + rows.carried,
                    rows.A[:, local[used]] @ x + rows.carried,
                )
                for rows in blocks
            ]
    return tuple(blocks_of_joints)


def _matched(model: RobotModel, logs: Sequence[JointLog | str | Path]) -> list[JointLog]:
    """Return the logs, with files read, in the model's joint order and with unique names."""
    known, reading = model.known_joints, reading_for(model)
    read = [
        log
        if isinstance(log, JointLog)
        else read_log(log, joints=known, partial=True, reading=reading)
        for log in logs
    ]
    matched = [log_of_model(log, model) for log in read]
    names = [log.name for log in matched]
    matched = [
        replace(log, name=f"{log.name} ({k + 1})") if names.count(log.name) > 1 else log
        for k, log in enumerate(matched)
    ]
    check_repeated(matched)
    for log in matched:
        check_commands(log)
        check_saturation(log)
    return matched


def _still_notes(dataset: Dataset, trajectories: Sequence[Trajectory]) -> list[str]:
    """Return a note that samples at rest are left out, if there are any."""
    still = np.where(dataset.has_rows, dataset.still, 0.0)
    most = int(still.argmax())
    if still[most] == 0.0:
        return []
    stands = any(trajectory.contacts is not None for trajectory in trajectories)
    also = " and of limbs on the ground" if stands else ""
    return [
        f"samples of resting joints{also} are not used, as dry friction is undetermined there: at "
        f"most {100 * still[most]:.0f} %, at {dataset.joints[most]}"
    ]


def _filtered_note(trajectory: Trajectory, *, fitted: bool) -> str:
    """Return a note if efforts were filtered before logging."""
    end = filtered_below(trajectory)
    if not np.isfinite(end):
        return ""
    return (
        f"{trajectory.name}: its efforts have almost no content above {end:.2g} Hz and seem "
        "to be filtered"
        + ("; the quietest part of the residuals is taken as noise" if fitted else "")
    )


def _check_efforts(logs: Sequence[JointLog]) -> None:
    """Raise if logs repeat each other, have no motor, or differ in which joints have one."""
    check_repeated(logs)  # again, now with efforts
    for log in logs:
        if len(log.passive) == len(log.joints):
            raise LogError(
                f"No joint of log {log.name!r} has a motor, so the scale of the masses is unknown.",
                advice="Omit --passive for joints with measured efforts.",
            )
        if differing := sorted(set(log.passive) ^ set(logs[0].passive)):
            raise LogError(
                f"{differing[0]} has a motor in only one of {log.name!r} and {logs[0].name!r}.",
                advice=f"Use --passive {differing[0]}, or measure its effort in each log.",
                joints=differing,
            )


def _without_constant_efforts(logs: Sequence[JointLog]) -> tuple[list[JointLog], list[str]]:
    """Return logs in which constant efforts count as unmeasured, and notes on these.

    Raises:
        LogError: All efforts of a log are constant.
    """
    varying, notes = list[JointLog](), list[str]()
    for log in logs:
        constant, kinds = constant_efforts(log), log.effort_kinds
        if constant and all(j in constant or kinds.get(j) in NOT_MEASURED for j in log.joints):
            raise LogError(
                f"The effort of {', '.join(constant)} is constant in log {log.name!r}.",
                advice="Check what is logged. If a joint is fixed, use --lock JOINT=POSITION; if "
                f"it has no motor, --passive {next(iter(constant))}.",
                joints=[*constant],
            )
        notes += [f"{log.name}: {words}" for words in constant_notes(constant)]
        unmeasured = {**log.effort_kinds, **dict.fromkeys(constant, UNMEASURED)}
        varying.append(replace(log, effort_kinds=unmeasured) if constant else log)
    return varying, notes


@contextmanager
def _naming_units(hints: Sequence[str]) -> Iterator[None]:
    """Add hints of wrong units to the advice of a LogError, as they may be its cause."""
    try:
        yield
    except LogError as error:
        if not hints:
            raise
        advice = f"{' '.join(hints)} {error.advice}"
        raise LogError(error.problem, advice=advice, **error.evidence) from error


def _in_which(logs: Sequence[JointLog], note: str) -> str:
    """Return an assumption of some logs with their names."""
    names = [log.name for log in logs if note in log.assumed]
    return f"{'all logs' if len(names) == len(logs) > 1 else ', '.join(names)}: {note}"


def _hints(log: JointLog, model: RobotModel) -> list[str]:
    limits, doubt = model.position_limits, position_unit_hint(log)
    hints = [doubt, effort_hint(log)]
    if doubt is None:  # otherwise limits are exceeded for that reason
        largest = np.array(model.effort_limits, float)
        for signal in model.effort_signals:  # with an unknown gain, efforts have no unit
            if signal.joint in log.joints and signal.deviation >= abs(signal.gain):
                largest[log.joints.index(signal.joint)] = np.inf
        hints.append(effort_unit_hint(log, largest))
        if len(limits[0]) == len(log.joints):
            hints.append(position_limit_hint(log, *limits))
    return [hint for hint in hints if hint]
