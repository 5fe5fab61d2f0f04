"""From a log to its digest, and from a model and its first log to the settings of all digests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import instance, instances, integer, number, typed
from geodrake.boundary.version import version
from geodrake.effects import Effect
from geodrake.errors import ArgumentError, LogError
from geodrake.fleet.autocovariance import with_autocovariances
from geodrake.fleet.digest import Digest, DigestedLog, JointDigest
from geodrake.fleet.digest_dataset import delays_of_joints, model_of_digests
from geodrake.fleet.log_dates import date_of_log
from geodrake.fleet.model_hash import model_hash, text_hash
from geodrake.fleet.settings import BLOCKS, LAGS, DigestEffect, DigestSettings, own_sources
from geodrake.identification.logs.candidate_effects import candidate_delays, candidate_effects
from geodrake.identification.logs.coherent_bandwidth import prepare_for_model
from geodrake.identification.logs.dataset import JointData
from geodrake.identification.logs.log_slices import Layout
from geodrake.identification.logs.model_fit import effects_of
from geodrake.identification.logs.noise import noise_floor
from geodrake.identification.logs.reduce import (
    STILL_SPEED,
    effort_deviation,
    least_sign_widths,
    peak_speeds,
    reduced_joints,
)
from geodrake.logs.files import Reading
from geodrake.logs.folds import validation_blocks
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.learnable import check_commands, check_saturation
from geodrake.logs.motion import JointLog, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.uniform_log import make_uniform
from geodrake.model.logged_joints import log_of_model, model_of_logs
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import in_efforts, kind_of
from geodrake.robot.base_parameters import structural_base_parameters
from geodrake.robot.reduction import triangular_factor

Array = NDArray[np.float64]

_MOST_BLOCKS = 100  # of a log
_STILL = 2e-3  # rad or m, by which a joint may move and still stand
_KEY = 32  # letters of a digest's name


@dataclass(frozen=True, eq=False)
class Wanted:
    """What settings are to be made like; None for what is chosen by the model and the first log.

    Attributes:
        bandwidth: Bandwidth of the filter, Hz.
        blocks: Blocks into which each log is cut.
        reading: How all logs are read.
        extra: Effect classes of the user's own, which get columns too.

    Raises:
        ArgumentError: One is not what it must be.
    """

    bandwidth: float | None = None
    blocks: int | None = None
    reading: Reading = field(default_factory=Reading)
    extra: tuple[type[Effect], ...] = ()

    def __post_init__(self) -> None:
        if self.bandwidth is not None:
            number(self.bandwidth, "bandwidth", lower=0.0, strict=True)
        if self.blocks is not None:
            integer(self.blocks, "blocks", lower=2, upper=_MOST_BLOCKS)
        instance(self.reading, "reading", Reading)
        object.__setattr__(self, "extra", instances(self.extra, "extra", type))


@dataclass(frozen=True)
class LogFacts:
    """What is known of a log beside what is in it.

    Attributes:
        content: SHA-256 of the bytes of its files.
        date: When it was recorded, s since 1970, if somebody says it.
        payloads: What the robot carried all the time, of known mass, that the model does not have.
        episode: Which episode of a dataset the log is; None for all.

    Raises:
        ArgumentError: One is not what it must be.
    """

    content: str
    files: tuple[Path, ...]
    date: float | None = None
    payloads: tuple[KnownPayload, ...] = ()
    episode: int | None = None

    def __post_init__(self) -> None:
        instance(self.content, "content", str)
        object.__setattr__(self, "files", instances(self.files, "files", Path))
        object.__setattr__(self, "payloads", instances(self.payloads, "payloads", KnownPayload))
        if self.date is not None:
            number(self.date, "date", lower=0.0, strict=True)
        if self.episode is not None:
            integer(self.episode, "episode", lower=0)

    def key(self, settings: DigestSettings) -> str:
        """Return what the digest of the log by some settings is called."""
        said = (settings.hash, self.content, self.payloads, self.episode)
        return text_hash(said)[:_KEY]


def said_of_reading(reading: Reading) -> dict[str, Any]:
    """How all logs are read, as settings have it; which episode of a dataset is each log's own."""
    said = asdict(reading)
    for name in ("episode", "ignored", "motorless"):
        said.pop(name)
    if said["mapping"] is not None:
        said["mapping"].pop("source")
    return said


@typed
def make_settings(
    model: RobotModel, log: JointLog, *, wanted: Wanted | None = None
) -> DigestSettings:
    """Return the settings of all digests of a robot's logs, chosen by its model and one of them.

    The bandwidth is that asked for, or else that of the model's last fit, or else chosen from the
    log, as are the speeds below which joints rest. A joint that stands still in this log is thought
    to become as fast as the fastest. Effects are those of the model and all that a diagnosis tries.

    Args:
        model: The model.
        log: A log that is like the others.
        wanted: What is asked for.

    Raises:
        LogError: The log cannot be used.
        ArgumentError: What is asked for cannot be.
    """
    wanted = wanted or Wanted()
    own = model_of_logs(model, [log], hold_resting=False)
    uniform = make_uniform(_in_efforts(log_of_model(log, own), own))
    fits = set(model.bandwidths.values())
    if wanted.bandwidth is not None:
        trajectory = prepare_logs([uniform], bandwidth=wanted.bandwidth)[0]
    elif len(fits) == 1:
        both = fits.pop()
        trajectory = prepare_logs([uniform], bandwidth=both[0], motion_bandwidth=both[1])[0]
    else:
        trajectory = prepare_for_model(own, [uniform])[0][0]
    peaks = peak_speeds([trajectory])
    peaks = np.where(peaks > 0.0, peaks, peaks.max())
    offered = candidate_effects(own, [trajectory], wanted.extra, speeds=peaks)
    # Shapes that a log's range or duration says are none of a robot's.
    settled = [e for e in offered if e.proposer is None or e.places == "joint_pair"]
    effects = (*effects_of(own), *settled)
    effects = tuple(effect for effect in dict.fromkeys(effects) if effect.parameters)
    widths = own.sign_widths(least_sign_widths(peaks, trajectory.speed_noise))
    layout = Layout.of(own, effects, widths, STILL_SPEED * peaks)
    base = structural_base_parameters(layout.tree)
    bandwidth, motion_bandwidth = trajectory.bandwidths
    validation_blocks([trajectory], blocks=wanted.blocks or BLOCKS)  # it is long enough
    return DigestSettings(
        model_hash(model),
        own.joints,
        own.bodies,
        {j: float(x) for j, x in own.held.items() if j not in model.held},
        float(bandwidth),
        float(motion_bandwidth),
        widths,
        layout.still_speed,
        candidate_delays(trajectory.filter.period, trajectory.filter.bandwidth),
        tuple(map(DigestEffect.of, effects)),
        base.independent,
        base.matrix,
        own_sources(wanted.extra),
        said_of_reading(wanted.reading),
        wanted.blocks or BLOCKS,
        LAGS,
        version(),
        chosen_from=log.name,
    )


def make_digest(
    model: RobotModel,
    log: JointLog,
    settings: DigestSettings,
    facts: LogFacts,
    *,
    extra: Sequence[type[Effect]] = (),
) -> Digest:
    """Return the digest of a log.

    Args:
        model: The model as it was given when the settings were made.
        log: The log, read as the settings say.
        settings: The settings.
        facts: What is known of the log.
        extra: Effect classes of the user's own that have columns.

    Raises:
        DigestError: It is another model.
        LogError: The log cannot be used, or not with the bandwidth of the settings.
    """
    instance(log, "log", JointLog)
    instance(facts, "facts", LogFacts)
    if log.passive:
        raise LogError(
            f"{log.passive[0]} of log {log.name!r} has no motor: digests are of measured efforts.",
            advice="`explain` fits bodies beside joints without a motor.",
        )
    extra = instances(extra, "extra", type)
    own = model_of_digests(model, settings)
    _check_held(log, settings)
    log = replace(log, payloads=facts.payloads) if facts.payloads else log
    log = _in_efforts(log_of_model(log, own), own)
    trajectory = _prepared(log, settings)
    folds = validation_blocks([trajectory], blocks=settings.blocks)
    effects = tuple(effect.made(extra) for effect in settings.effects)
    layout = Layout.of(own, effects, settings.sign_width, settings.still_speed)
    layout = layout.over_base(settings.base)
    advance = [*(delays_of_joints(settings) + own.delays)]
    data = reduced_joints(layout, [trajectory], folds, advance)
    effort_deviation(own.joints, data)  # refuses a joint whose sensor has nothing to say
    for joint, each in zip(own.joints, data, strict=True):
        if not np.isfinite(each.factors).all():
            raise LogError(f"Columns of {joint} are not finite in log {log.name!r}.")
    digest = Digest(
        settings,
        (_about(log, trajectory, own, settings, facts),),
        tuple(fold.name for fold in folds),
        np.zeros(len(folds), np.intp),
        tuple(_joint(*each, settings) for each in zip(own.joints, data, strict=True)),
    )
    return with_autocovariances(digest, model, data, extra=extra)


def _check_held(log: JointLog, settings: DigestSettings) -> None:
    """Refuse a log in which a joint moves that the settings hold.

    Raises:
        LogError: There is one.
    """
    for joint, place in settings.held.items():
        known = joint in log.joints
        if not known and joint not in log.standing:
            continue
        where = log.position[:, log.joints.index(joint)] if known else log.standing[joint]
        if not np.nanmax(np.abs(where - place), initial=0.0) <= _STILL or np.isnan(where).all():
            raise LogError(
                f"The settings of the digests hold {joint} at {place:.4g}, where it does not stand "
                f"in log {log.name!r}.",
                advice="Digest logs in which it moves into another folder.",
                joint=joint,
            )


def _in_efforts(log: JointLog, model: RobotModel) -> JointLog:
    """Return the log with efforts in the place of signals whose gains the model knows.

    Raises:
        LogError: There are others, which no log alone says.
    """
    check_commands(log)
    check_saturation(log)
    log = in_efforts(log, model.effort_signals) if model.effort_signals else log
    for joint in model.joints:
        silent = not np.isfinite(log.effort[:, log.joints.index(joint)]).any()
        if (kind := kind_of(log, joint)) != "effort" and (kind != "command" or silent):
            raise LogError(
                f"Log {log.name!r} has the {kind} of {joint} in the place of its effort, and the "
                "model does not know what makes an effort of it.",
                advice="Fit the model to such logs and save it first: geodrake identify --save.",
                joint=joint,
            )
    return log


def _prepared(log: JointLog, settings: DigestSettings) -> Trajectory:
    """Return the log at the bandwidths of the settings.

    Raises:
        LogError: It is sampled too rarely for them, is too short, or still throughout.
    """
    uniform = make_uniform(log)
    both = {"bandwidth": settings.bandwidth, "motion_bandwidth": settings.motion_bandwidth}
    try:
        return prepare_logs([uniform], **both, how="as the settings of the digests say")[0]
    except ArgumentError as error:
        raise LogError(
            f"Log {log.name!r} cannot bear the {settings.bandwidth:.3g} Hz of the settings of the "
            f"digests: it has {1.0 / uniform.period:.4g} samples a second.",
            advice="Log at a higher rate, or digest all logs into a new folder at a lower "
            "bandwidth.",
            period=uniform.period,
        ) from error


def _about(
    log: JointLog,
    trajectory: Trajectory,
    model: RobotModel,
    settings: DigestSettings,
    facts: LogFacts,
) -> DigestedLog:
    date, source = date_of_log(log, facts.files, facts.date)
    ranges = [
        (values.min(axis=0), values.max(axis=0))
        for stretch in trajectory.segments
        for _, chunk in stretch.chunks()
        for values in (np.stack([chunk.position, chunk.velocity], 1),)
    ]
    low, high = (np.array(ends) for ends in zip(*ranges, strict=True))
    position, speed = np.stack([low.min(axis=0), high.max(axis=0)], 1)
    return DigestedLog(
        log.name,
        facts.content,
        log.fingerprint,
        facts.key(settings),
        date,
        source,
        sum(map(len, trajectory.segments)) * trajectory.filter.period,
        trajectory.filter.period,
        trajectory.filter.bandwidth,
        facts.payloads,
        noise_floor([trajectory], model, sign_width=settings.sign_width),
        sum(map(len, trajectory.segments)),
        np.array(log.gain_deviations),
        position,
        speed,
        _mean_temperatures(log),
        (*log.notes, *trajectory.notes),
    )


def _mean_temperatures(log: JointLog) -> Array:
    """(nv,) mean temperature of each joint, °C; NaN without any."""
    if log.temperature is None:
        return np.full(len(log.joints), np.nan)
    known = np.isfinite(log.temperature)
    count, total = known.sum(axis=0), np.where(known, log.temperature, 0.0).sum(axis=0)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _joint(name: str, data: JointData, settings: DigestSettings) -> JointDigest:
    """What blocks say of a joint, numbered as digests number columns; autocovariances are none."""
    inertial, base = settings.base_matrix.shape[1], len(settings.independent)
    bodies = data.columns[data.columns < inertial]
    effects = data.columns[len(bodies) :] - inertial + base
    return JointDigest(
        name,
        np.concatenate([np.searchsorted(settings.independent, bodies), effects]),
        np.array([_upright(triangular_factor([factor])) for factor in data.factors]),
        data.samples,
        data.seen,
        data.effort_sums,
        data.carried,
        data.peaks,
        np.zeros((len(data.samples), settings.lags)),
    )


def _upright(factor: Array) -> Array:
    """Return a triangular factor with a diagonal that is not negative."""
    return np.where(np.diagonal(factor) < 0.0, -1.0, 1.0)[:, None] * factor
