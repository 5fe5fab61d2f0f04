"""Conversion of logs to digests, and of digests to data for fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from geodrake.boundary.arguments import instance, instances, integer, number, typed
from geodrake.boundary.input_files import sha256_of
from geodrake.boundary.version import version
from geodrake.effects import Effect
from geodrake.errors import ArgumentError, DigestError, LogError
from geodrake.fleet.digest import Digest, DigestedLog
from geodrake.fleet.hashes import model_hash, text_hash
from geodrake.fleet.log_places import date_of_log
from geodrake.fleet.settings import BLOCKS, DigestEffect, DigestSettings, own_sources
from geodrake.identification.logs.bandwidth import prepare_for_model
from geodrake.identification.logs.candidate_effects import candidate_delays, candidate_effects
from geodrake.identification.logs.dataset import Dataset, JointData
from geodrake.identification.logs.hypothesis import Hypothesis, first_hypothesis
from geodrake.identification.logs.log_slices import Layout
from geodrake.identification.logs.model_fit import effects_of, model_unknowns
from geodrake.identification.logs.noise import known_noise
from geodrake.identification.logs.reduce import (
    gain_uncertainty,
    least_sign_widths,
    least_still_speeds,
    peak_speeds,
    reduce_over,
)
from geodrake.identification.logs.unknowns import payload_reference
from geodrake.logs.files import Reading
from geodrake.logs.folds import validation_blocks
from geodrake.logs.known_payload import KnownPayload
from geodrake.logs.log_checks import check_commands, check_saturation
from geodrake.logs.motion import USUAL_GAIN_DEVIATION, JointLog, Trajectory
from geodrake.logs.preparation import prepare_logs
from geodrake.logs.uniform_log import make_uniform
from geodrake.model.holding import holding
from geodrake.model.logged_joints import log_of_model, model_of_logs
from geodrake.model.robot_model import RobotModel
from geodrake.model.signal_efforts import in_efforts, kind_of
from geodrake.robot.reduction import triangular_factor

_MOST_BLOCKS = 100  # of a log
_STILL = 2e-3  # rad or m, tolerance of a fixed position
_KEY = 32  # letters of a digest's name


@dataclass(frozen=True, eq=False)
class Wanted:
    """Requested settings; None for those to be chosen from the model and the first log."""

    bandwidth: float | None = None  # of the filter, Hz
    blocks: int | None = None
    reading: Reading = field(default_factory=Reading)
    extra: tuple[type[Effect], ...] = ()  # user-defined effects, which also get columns

    def __post_init__(self) -> None:
        if self.bandwidth is not None:
            number(self.bandwidth, "bandwidth", lower=0.0, strict=True)
        if self.blocks is not None:
            integer(self.blocks, "blocks", lower=2, upper=_MOST_BLOCKS)
        instance(self.reading, "reading", Reading)
        object.__setattr__(self, "extra", instances(self.extra, "extra", type))


@dataclass(frozen=True)
class LogFacts:
    """Facts about a log that it does not contain.

    Attributes:
        content: SHA-256 of the bytes of its files.
        date: Date given by the user, s since 1970, if any.
        payloads: Payloads of known mass, not in the model, carried during the whole log.
        episode: Episode of a dataset; None for all.
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
        """Return the key of the log's digest under some settings."""
        return text_hash((settings.hash, self.content, self.payloads, self.episode))[:_KEY]


def reading_settings(reading: Reading) -> dict[str, Any]:
    """Return the reading options common to all logs, as plain data."""
    options = asdict(reading)
    for name in ("episode", "ignored", "motorless", "limits", "sliding", "links"):
        options.pop(name)
    if reading.usual_deviation == USUAL_GAIN_DEVIATION:  # missing in older folders
        options.pop("usual_deviation")
    dbc = options.pop("dbc")
    if dbc is not None:
        options["dbc"] = sha256_of(dbc)
    if options["mapping"] is not None:
        options["mapping"].pop("source")
    return options


@typed
def make_settings(
    model: RobotModel, log: JointLog, *, wanted: Wanted | None = None
) -> DigestSettings:
    """Return settings for digests of a robot's logs, chosen from its model and one log.

    The bandwidth is the requested one, or that of the model's last fit, or chosen from the log.
    Speeds of joints at rest are chosen from the log; a joint that rests in this log is assumed to
    reach the speed of the fastest one. Effects are those of the model and all candidates of a
    diagnosis.
    """
    wanted = wanted or Wanted()
    log_model = model_of_logs(model, [log], hold_resting=False)
    uniform = make_uniform(_in_efforts(log_of_model(log, log_model), log_model))
    fits = set(model.bandwidths.values())
    if wanted.bandwidth is not None:
        trajectory = prepare_logs([uniform], bandwidth=wanted.bandwidth)[0]
    elif len(fits) == 1:
        bandwidth, motion = fits.pop()
        trajectory = prepare_logs([uniform], bandwidth=bandwidth, motion_bandwidth=motion)[0]
    else:
        trajectory = prepare_for_model(log_model, [uniform])[0][0]
    peaks = peak_speeds([trajectory])
    peaks = np.where(peaks > 0.0, peaks, peaks.max())
    offered = candidate_effects(log_model, [trajectory], wanted.extra, speeds=peaks)
    # Without shapes that depend on a log's range or duration.
    candidates = [e for e in offered if e.proposer is None or e.places == "joint_pair"]
    # Sorted, so that the order does not depend on that of the catalogue.
    candidates.sort(key=lambda e: (e.name, e.where, str(sorted(e.shape.items()))))
    effects = (*effects_of(log_model), *candidates)
    effects = tuple(effect for effect in dict.fromkeys(effects) if effect.parameters)
    widths = log_model.sign_widths(least_sign_widths(peaks, trajectory.speed_noise))
    bandwidth, motion_bandwidth = trajectory.bandwidths
    validation_blocks([trajectory], blocks=wanted.blocks or BLOCKS)  # raises if it is too short
    return DigestSettings(
        model_hash(model),
        log_model.joints,
        log_model.bodies,
        {j: float(x) for j, x in log_model.held.items() if j not in model.held},
        float(bandwidth),
        float(motion_bandwidth),
        widths,
        least_still_speeds(peaks, trajectory.speed_noise),
        candidate_delays(trajectory.filter),
        tuple(map(DigestEffect.of, effects)),
        own_sources(wanted.extra),
        reading_settings(wanted.reading),
        wanted.blocks or BLOCKS,
        version(),
        chosen_from=log.name,
        passive=tuple(joint for joint in log_model.joints if joint in log.passive),
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
        model: The model from which the settings were made.
        extra: User-defined effects with columns.

    Raises:
        DigestError: It is another model.
        LogError: The log is invalid, or does not support the bandwidth of the settings.
    """
    instance(log, "log", JointLog)
    instance(facts, "facts", LogFacts)
    instance(settings, "settings", DigestSettings)
    if differing := sorted(set(log.passive) ^ set(settings.passive)):
        where = "in the logs before" if differing[0] in settings.passive else f"in {log.name!r}"
        raise LogError(
            f"{differing[0]} has no motor {where}, but the digests of a folder are of one robot.",
            advice=f"Use --passive {differing[0]} for all of them, or measure its effort in all.",
        )
    extra = instances(extra, "extra", type)
    digest_model = model_of_digests(model, settings)
    _check_held(log, settings)
    log = replace(log, payloads=facts.payloads) if facts.payloads else log
    log = _in_efforts(log_of_model(log, digest_model), digest_model)
    trajectory = _prepared(log, settings)
    if trajectory.has_unknown_forces:
        raise LogError(
            f"Forces at contacts are unknown in log {log.name!r}, which digests do not support.",
            advice="Log the wrenches at the contacts.",
        )
    folds = validation_blocks([trajectory], blocks=settings.blocks)
    effects = tuple(effect.made(extra) for effect in settings.effects)
    layout = Layout.of(digest_model, effects, settings.sign_width, settings.still_speed)
    noise = known_noise([trajectory], digest_model, sign_width=settings.sign_width)
    dataset = reduce_over(layout, [trajectory], folds, delays=settings.delays, noise=noise)
    for joint, data in zip(digest_model.joints, dataset.data, strict=True):
        if not np.isfinite(data.factors).all():
            raise LogError(f"Columns of {joint} are not finite in log {log.name!r}.")
    refitted = first_hypothesis(dataset, model_unknowns(dataset, digest_model))
    about = _about(log, trajectory, refitted, settings, facts)
    return Digest(settings, (about,), dataset.folds, tuple(map(_without_rows, dataset.data)))


def _check_held(log: JointLog, settings: DigestSettings) -> None:
    """Raise if a joint moves in a log although the settings fix it."""
    for joint, fixed in settings.held.items():
        is_logged = joint in log.joints
        if not is_logged and joint not in log.standing:
            continue
        q = log.position[:, log.joints.index(joint)] if is_logged else log.standing[joint]
        if not np.nanmax(np.abs(q - fixed), initial=0.0) <= _STILL or np.isnan(q).all():
            raise LogError(
                f"The settings of the digests fix {joint} at {fixed:.4g}, where it is not in "
                f"log {log.name!r}.",
                advice="Digest logs in which it moves into another folder.",
            )


def _in_efforts(log: JointLog, model: RobotModel) -> JointLog:
    """Return the log with signals converted to efforts by the model's gains."""
    check_commands(log)
    check_saturation(log)
    log = in_efforts(log, model.effort_signals) if model.effort_signals else log
    for joint in model.joints:
        has_no_effort = not np.isfinite(log.effort[:, log.joints.index(joint)]).any()
        if (kind := kind_of(log, joint)) != "effort" and (kind != "command" or has_no_effort):
            raise LogError(
                f"Log {log.name!r} has the {kind} of {joint} instead of its effort, but the "
                "model has no gain for it.",
                advice="Fit the model to such logs first, and save it: geodrake identify --save.",
            )
    return log


def _prepared(log: JointLog, settings: DigestSettings) -> Trajectory:
    """Return the log at the bandwidths of the settings."""
    uniform = make_uniform(log)
    bandwidths = {"bandwidth": settings.bandwidth, "motion_bandwidth": settings.motion_bandwidth}
    try:
        return prepare_logs([uniform], **bandwidths, how="of the settings of the digests")[0]
    except ArgumentError as error:
        raise LogError(
            f"Log {log.name!r} is too slow for the bandwidth of {settings.bandwidth:.3g} Hz "
            f"of the digests: its sampling rate is {1.0 / uniform.period:.4g} Hz.",
            advice="Log at a higher rate, or digest all logs into a new folder with a lower "
            "bandwidth.",
        ) from error


def _about(
    log: JointLog,
    trajectory: Trajectory,
    refitted: Hypothesis,
    settings: DigestSettings,
    facts: LogFacts,
) -> DigestedLog:
    """Return the data of a log, given the model refitted to it."""
    dataset = refitted.dataset
    date, source = date_of_log(log, facts.files, facts.date)
    ranges = [
        (values.min(axis=0), values.max(axis=0))
        for stretch in trajectory.segments
        for _, chunk in stretch.chunks()
        for values in (np.stack([chunk.position, chunk.velocity], 1),)
    ]
    low, high = (np.array(ends) for ends in zip(*ranges, strict=True))
    position, speed = np.stack([low.min(axis=0), high.max(axis=0)], 1)
    temperature, passive = np.full(len(log.joints), np.nan), np.isin(log.joints, settings.passive)
    if log.temperature is not None:
        count = np.isfinite(log.temperature).sum(axis=0)
        np.divide(np.nansum(log.temperature, axis=0), count, out=temperature, where=count > 0)
    return DigestedLog(
        log.name,
        facts.content,
        log.fingerprint,
        facts.key(settings),
        date,
        source,
        sum(map(len, trajectory.segments)) * trajectory.filter.period,
        trajectory.filter.bandwidth,
        facts.payloads,
        dataset.noise_floor,
        np.array(log.gain_deviations),
        position,
        speed,
        temperature,
        dataset.samples.sum(axis=0),
        np.where(dataset.has_rows, refitted.effective, 0.0),
        refitted.held_out.sse.sum(axis=0),
        np.where(passive, dataset.effort_std, 0.0),
        dataset.passive_inertia,
        (*log.notes, *trajectory.notes),
    )


def _without_rows(data: JointData) -> JointData:
    """Return a joint's data without rows, with triangular factors of nonnegative diagonal."""
    factors = [triangular_factor([factor]) for factor in data.factors]
    factors = [np.where(np.diagonal(R) < 0.0, -1.0, 1.0)[:, None] * R for R in factors]
    return replace(data, factors=np.array(factors), rows=tuple(() for _ in data.samples))


def model_of_digests(model: RobotModel, settings: DigestSettings) -> RobotModel:
    """Return the model that digests refer to, with joints fixed that their logs lack."""
    instance(model, "model", RobotModel)
    instance(settings, "settings", DigestSettings)
    if (digest := model_hash(model)) != settings.model:
        raise DigestError(
            f"The digests are not of model {model.path.name}: its hash is {digest[:12]}, theirs "
            f"{settings.model[:12]}.",
            advice="Use their model, or digest the logs into a new folder.",
        )
    return (holding(model, settings.held) if settings.held else model).with_volume


def digest_dataset(
    digest: Digest, model: RobotModel, *, extra: Sequence[type[Effect]] = ()
) -> Dataset:
    """Return the `Dataset` of a digest's logs, without rows.

    Its folds are the digest's blocks, and all ten inertial columns of each body are present, so
    that fits and held-out errors equal those of the logs. Residuals are not available; use
    `Digest.effective` for the effective sample size.

    Args:
        model: The model from which the settings were made.
        extra: User-defined effects with columns.

    Raises:
        DigestError: It is another model, or an effect cannot be constructed.
    """
    settings, extra = instance(digest, "digest", Digest).settings, instances(extra, "extra", type)
    model = model_of_digests(model, settings)
    effects = tuple(effect.made(extra) for effect in settings.effects)
    return Dataset(
        model.joints,
        model.bodies,
        effects,
        np.outer(settings.delays, np.ones(len(settings.joints))),
        digest.blocks,
        tuple(log.name for log in digest.logs),
        digest.joints,
        digest.effort_std,
        digest.noise_floor,
        digest.logs[0].bandwidth,
        np.array([joint.still for joint in digest.joints]),
        payload_reference(model.phi),
        gain_uncertainty(
            model, [t.payloads for t in digest.logs], [t.gain_deviations for t in digest.logs]
        ),
        passive_inertia=digest.passive_inertia,
    )
