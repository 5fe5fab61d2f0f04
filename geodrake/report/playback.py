"""Data of replayed logs: excerpts, errors by joint and time, and the worst moments."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from geodrake.boundary.arguments import positive
from geodrake.boundary.escaping import path_part, printable
from geodrake.control.rollout import case_rollout
from geodrake.effects import Effect, FittedEffect
from geodrake.effects.episode import PointEpisode
from geodrake.errors import ArgumentError
from geodrake.identification.logs.case import Case, prepare_case
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.model_errors import Comparison
from geodrake.inertia import Array
from geodrake.logs.floating import FORCE, frames_of, vectors
from geodrake.logs.motion import JointLog
from geodrake.model.ground_contacts import ContactFrame, contact_frames
from geodrake.model.robot_model import RobotModel
from geodrake.report.explaining import comparison_page
from geodrake.report.numbers import Units, number, percent
from geodrake.report.page import About, Page, Section, View
from geodrake.report.robot_scene import (
    FRAMES,
    Extent,
    PosedLink,
    body_links,
    drawn_shapes,
    error_colors,
    joint_places,
    posed_links,
    top_error,
)
from geodrake.report.words import capitalized, effect_label
from geodrake.robot.shapes import RobotShapes

MOST_SECONDS = 30.0
"""Maximum length of the excerpts, s."""

_PART = 5.0  # s, length of the parts among which the worst are chosen
_RMS_WINDOW = 0.3  # s, as residuals change their sign
_JOINT_SPACING = 1.0  # s, between two moments at the same joint
_SPACING = 0.25  # s, between two moments at any joints
_FARTHEST = 1.0  # rad or m, of a ghost's joint from the measured position
_LEAST_TOP = 1e-6  # smallest relative error for the last colour
_MOST_MOMENTS, _MOST_AT_JOINT = 5, 2  # for each model


@dataclass(frozen=True, eq=False)
class Excerpt:
    """A played part of a log."""

    log: str
    began: float  # the log's first time stamp, s
    time: Array  # (F,) times of the frames in the log, s
    q: Array  # (F, nv) positions by joint, rad or m


@dataclass(frozen=True, eq=False)
class PlayedFoot:
    """What the ground does at a link in every frame."""

    frame: ContactFrame
    force: Array  # (F, 3) measured force of the ground, in the link's axes, N; NaN if none
    touches: NDArray[np.bool_]  # (F,) whether it may touch the ground without a measured force


@dataclass(frozen=True)
class Moment:
    """An instant of large error."""

    joint: str
    frame: int
    log: str
    time: float  # in the log, s
    error: float  # RMS error around it, N·m or N
    relative: float  # the same over the standard deviation of the joint's measured effort


@dataclass(frozen=True, eq=False)
class PlayedModel:
    """A model and its errors in every frame."""

    title: str  # of its copy of the robot
    model: RobotModel
    comparison: Comparison  # with the whole logs
    trained: bool  # whether the model was fitted to these logs
    measured: Array  # (F, nv) filtered efforts, N·m or N; NaN where nothing is compared
    predicted: Array  # (F, nv) efforts
    error: Array  # (F, nv) RMS of measured − predicted around each frame
    relative: Array  # (F, nv) the same over the standard deviation of the joint's measured effort
    simulated: Array  # (F, nv) positions of its ghost by joint, rad or m; NaN without a ghost
    moments: tuple[Moment, ...]  # worst first

    @property
    def data(self) -> str:
        """Return the kind of data for its errors."""
        return "training data" if self.trained else "held-out data"


@dataclass(frozen=True, eq=False)
class PlayedRobot:
    """One copy of the robot."""

    played: PlayedModel
    name: str  # its title, as part of a path
    place: Array  # (3,) position in the world, m
    links: list[PosedLink]
    colors: NDArray[np.uint8]  # (F, nv, 4) of the joints, RGBA
    findings: list[tuple[str, str | None]]  # words, and their link; None for the whole robot


@dataclass(frozen=True, eq=False)
class Playback:
    """Motions and errors in all frames, and the shapes of the robot."""

    joints: tuple[str, ...]
    excerpts: tuple[Excerpt, ...]  # in the order of play
    models: tuple[PlayedModel, ...]  # one model, or those before and after
    seconds_left_out: float  # length of the unplayed parts, s
    feet: tuple[PlayedFoot, ...] = ()  # of a robot with a free base

    @property
    def q(self) -> Array:
        """(F, nv) positions by joint in all frames, rad or m."""
        return np.concatenate([excerpt.q for excerpt in self.excerpts])

    @cached_property
    def instants(self) -> list[tuple[str, float]]:
        """Return the log of each frame, and the time in it, s."""
        return _instants(self.excerpts)

    @property
    def top(self) -> float:
        """Relative error of the last colour."""
        errors = np.concatenate([played.relative.ravel() for played in self.models])
        return top_error(errors, _LEAST_TOP)

    @property
    def times(self) -> Array:
        """Return the times (F,) of the frames, s: those of the log, or from 0 for several parts."""
        if len(self.excerpts) == 1:
            return self.excerpts[0].time
        return np.arange(len(self.q)) / FRAMES

    @property
    def units(self) -> Units:
        """Return the units of the last model."""
        return Units.of(self.models[-1].model)

    @cached_property
    def shapes(self) -> RobotShapes:
        """Return the shapes of the robot."""
        return drawn_shapes(self.models[-1].model)

    @cached_property
    def extent(self) -> Extent:
        """Return the bounding region of the motion."""
        model = self.models[-1].model
        return Extent.of(model, model.positions(self.q))

    @cached_property
    def robots(self) -> list[PlayedRobot]:
        """Return a copy of the robot for each model, side by side."""
        robots = []
        for k, played in enumerate(self.models):
            model, place = played.model, k * self.extent.beside
            where = {name: joint.link for name, joint in joint_places(model).items()}
            where |= body_links(model)
            findings = []
            for fitted in model.effects:
                effect = fitted.effect
                link = next((where[name] for name in effect.where if name in where), None)
                findings.append((f"{effect_words(fitted, self.units)} ({effect.place})", link))
            links = posed_links(model, model.positions(self.q), self.shapes, place)
            colors, name = error_colors(played.relative, self.top), path_part(played.title)
            robots.append(PlayedRobot(played, name, place, links, colors, findings))
        return robots

    @property
    def left_out(self) -> list[str]:
        """Return a note on unplayed parts, if there are any."""
        if self.seconds_left_out <= 0.5:
            return []
        return [
            f"only the windows of largest error are played; {self.seconds_left_out:.0f} s of the "
            "logs are not (--seconds)"
        ]

    def moment_words(self, moment: Moment) -> str:
        """Return a moment of large error, in words."""
        return (
            f"{moment.joint} at {moment.time:.2f} s of {moment.log}: error "
            f"{number(moment.error)} {self.units.effort([moment.joint])}, "
            f"{percent(moment.relative)} of the standard deviation of its effort"
        )


def play_back(
    model: RobotModel,
    logs: Sequence[JointLog | str | Path],
    *,
    before: RobotModel | None = None,
    extra: Sequence[type[Effect]] = (),
    bandwidth: float | None = None,
    seconds: float = MOST_SECONDS,
    ghost: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Playback:
    """Prepare logs for playing: all of them, or the parts of largest error.

    A ghost is the robot as simulated under the measured efforts. As it soon drifts away, it
    repeatedly restarts from the measured state; once a joint is off by 1 rad or 1 m, it stays.

    Args:
        before: Another model of the same robot, to be played beside it.
        seconds: Maximum length of the played parts, s.
        ghost: Length of each simulation of a ghost, s; no ghosts if None.
        progress: Called with a description and the share that is done while ghosts are simulated.

    Raises:
        ArgumentError: The other model has other joints, or a number of seconds is not positive.
        LogError: A log cannot be used.
    """
    positive(seconds, "seconds")
    if ghost is not None:
        positive(ghost, "ghost")
    if before is not None and before.joints != model.joints:
        raise ArgumentError(
            f"The other model has joints {', '.join(before.joints)}, but the model has "
            f"{', '.join(model.joints)}.",
            advice="Use two models of one robot.",
        )
    case = prepare_case(model, logs, candidates=False, extra=extra, bandwidth=bandwidth)
    cases = {model.path.name if before is None else "after": case}
    if before is not None:
        effort_bandwidth, motion_bandwidth = case.trajectories[0].bandwidths
        other = prepare_case(
            before,
            case.options.logs,
            candidates=False,
            extra=extra,
            bandwidth=effort_bandwidth,
            motion_bandwidth=motion_bandwidth,
        )
        cases = {"before": other, **cases}
    compared = {title: comparison(each) for title, each in cases.items()}
    excerpts, left_out = _excerpts(case, [*compared.values()], seconds)
    models = tuple(
        _played(title, each, compared[title], excerpts, _ghost(each, excerpts, ghost, progress))
        for title, each in cases.items()
    )
    return Playback(model.joints, excerpts, models, left_out, _feet(case, excerpts))


def _feet(case: Case, excerpts: Sequence[Excerpt]) -> tuple[PlayedFoot, ...]:
    """Return the forces and contacts of all links that have either in a log."""
    logs = {log.name: log for log in case.options.logs}
    flags = {t.name: t.contacts for t in case.trajectories if t.contacts is not None}
    names = [name for each in flags.values() for name in each.frames]
    names += [name for log in logs.values() for name in frames_of(log.floating, FORCE)]
    found = list[PlayedFoot]()
    for frame in contact_frames(case.model, [*dict.fromkeys(names)]):
        forces, touches = list[Array](), list[NDArray[np.bool_]]()
        for e in excerpts:
            log, contacts = logs[e.log], flags.get(e.log)
            force = vectors(log.floating, f"{frame.name}.force")
            columns = np.full((3, 1), np.nan) if force is None else force.T
            time = log.time[: columns.shape[1]]
            forces.append(np.stack([np.interp(e.time, time, x) for x in columns], 1))
            is_known = contacts is not None and frame.name in contacts.frames
            touches.append(np.zeros(len(e.time), bool))
            if contacts is not None and is_known:
                touches[-1] = contacts.at(e.time)[:, contacts.frames.index(frame.name)]
        found.append(PlayedFoot(frame, np.concatenate(forces), np.concatenate(touches)))
    return tuple(found)


def _instants(excerpts: Sequence[Excerpt]) -> list[tuple[str, float]]:
    return [(excerpt.log, time) for excerpt in excerpts for time in excerpt.time.tolist()]


def _samples(found: Comparison, joint: str, log: str) -> Array:
    """Return time, measured and predicted effort (3, K) of a joint in a log, in order of time."""
    series = [s for s in found.series if s.joint == joint and s.log == log]
    names = ("time", "measured", "predicted")
    columns = np.array([np.concatenate([[], *(getattr(s, n) for s in series)]) for n in names])
    return columns[:, np.argsort(columns[0], kind="stable")]


def _excerpts(
    case: Case, found: Sequence[Comparison], seconds: float
) -> tuple[tuple[Excerpt, ...], float]:
    """Return the excerpts, and the length of the unplayed parts, s."""
    segments = [(t, s) for t in case.trajectories for s in t.segments]
    total = sum(len(s) * s.period for _, s in segments)
    count = int(np.ceil(seconds / _PART))
    parts = []  # (segment, first sample, stop)
    for k, (_, segment) in enumerate(segments):
        most = max(2, int(seconds / count / segment.period))
        size = len(segment) if total <= seconds else most
        starts = range(0, len(segment), size)
        parts += [(k, first, min(first + size, len(segment))) for first in starts]
    if total > seconds:

        def score(part: tuple[int, int, int]) -> float:
            (trajectory, segment), (_, first, stop) = segments[part[0]], part
            start = float(segment[first : first + 1].time[0])
            return _score(trajectory.name, start, start + (stop - first) * segment.period, found)

        parts = sorted(sorted(parts, key=score, reverse=True)[:count])
    joined: list[tuple[int, int, int]] = []
    for k, first, stop in parts:
        if joined and joined[-1][0] == k and joined[-1][2] == first:
            first = joined.pop()[1]  # noqa: PLW2901
        joined.append((k, first, stop))
    excerpts = []
    for k, first, stop in joined:
        trajectory, part = segments[k][0], segments[k][1][first:stop]
        time = np.arange(part.time[0], part.time[-1] + 1e-9, 1.0 / FRAMES)
        q = np.stack([np.interp(time, part.time, x) for x in part.position.T], -1)
        excerpts.append(Excerpt(trajectory.name, trajectory.began, time, q))
    return tuple(excerpts), max(0.0, total - sum(len(e.time) for e in excerpts) / FRAMES)


def _score(log: str, start: float, end: float, found: Sequence[Comparison]) -> float:
    """Return the errors between two instants, relative to the overall error of each model."""
    score = 0.0
    for compared in found:
        errors, worst = compared.errors, 0.0
        stds = {joint.joint: joint.std for joint in errors.joints}
        for s in (s for s in compared.series if s.log == log):
            inside = (s.time >= start) & (s.time < end)
            if inside.any():
                worst = max(worst, float(((s.residual[inside] / stds[s.joint]) ** 2).mean()))
        score += worst / max(errors.nrms, 1e-12) ** 2
    return score


def _ghost(
    case: Case,
    excerpts: Sequence[Excerpt],
    horizon: float | None,
    progress: Callable[[str, float], None] | None,
) -> Array:
    """Return the positions (F, nv) simulated under the measured efforts; NaN outside windows."""
    parts = [np.full_like(excerpt.q, np.nan) for excerpt in excerpts]
    if horizon is None:
        return np.concatenate(parts)
    spans = [(e.log, float(e.time[0]), float(e.time[-1])) for e in excerpts]
    most = 1 + int(sum(last - first for _, first, last in spans) / horizon)
    rollout = case_rollout(case, horizon=horizon, most=most, progress=progress, within=spans)
    for window in rollout.windows:
        is_close = np.nan_to_num(np.abs(window.departure), nan=np.inf).max(1) <= _FARTHEST
        count = len(is_close) if is_close.all() else max(1, int(is_close.argmin()))
        simulated = window.simulated[np.minimum(np.arange(len(is_close)), count - 1)]
        for excerpt, part in zip(excerpts, parts, strict=True):
            shown = (window.time[0] <= excerpt.time) & (excerpt.time <= window.time[-1])
            if excerpt.log == window.log and shown.any():
                time = excerpt.time[shown]
                part[shown] = np.stack([np.interp(time, window.time, x) for x in simulated.T], -1)
    return np.concatenate(parts)


def _played(
    title: str, case: Case, found: Comparison, excerpts: Sequence[Excerpt], simulated: Array
) -> PlayedModel:
    joints = case.model.joints
    measured, predicted, error = np.stack(
        [
            np.concatenate([_at_frames(e.time, *_samples(found, j, e.log)) for e in excerpts], 1)
            for j in joints
        ],
        axis=-1,
    )
    stds = {joint.joint: joint.std for joint in found.errors.joints}
    relative = error / np.array([stds.get(joint, np.nan) for joint in joints])
    return PlayedModel(
        title,
        case.model,
        found,
        any(fingerprint in case.model.fitted_to for fingerprint in case.fingerprints),
        measured,
        predicted,
        error,
        relative,
        simulated,
        tuple(_worst_moments(error, relative, joints, _instants(excerpts))),
    )


def _at_frames(frames: Array, time: Array, measured: Array, predicted: Array) -> Array:
    """Return efforts and the RMS of their difference (3, F) at each frame; NaN without samples."""
    if not len(time):
        return np.full((3, len(frames)), np.nan)
    period = float(np.median(np.diff(time))) if len(time) > 1 else _RMS_WINDOW
    half = max(0.5 * _RMS_WINDOW, 1.01 * period)
    first, stop = (np.searchsorted(time, frames + sign * half) for sign in (-1.0, 1.0))
    sums = np.concatenate([[0.0], np.cumsum((measured - predicted) ** 2)])
    count = stop - first
    mean = np.maximum(sums[stop] - sums[first], 0.0) / np.maximum(count, 1)
    values = [np.interp(frames, time, x) for x in (measured, predicted)]
    return np.where(count > 0, [*values, np.sqrt(mean)], np.nan)


def _worst_moments(
    error: Array, relative: Array, joints: Sequence[str], instants: Sequence[tuple[str, float]]
) -> Iterator[Moment]:
    """Yield well separated instants of largest relative error."""
    candidates = np.nan_to_num(relative, nan=-1.0)
    counts = np.zeros(candidates.shape[1], int)
    joint_spacing, spacing = round(_JOINT_SPACING * FRAMES), round(_SPACING * FRAMES)
    for _ in range(_MOST_MOMENTS):
        frame, j = divmod(int(candidates.argmax()), candidates.shape[1])
        if candidates[frame, j] <= 0.0:
            return
        (log, time), size = instants[frame], float(error[frame, j])
        yield Moment(joints[j], frame, log, time, size, float(relative[frame, j]))
        candidates[max(0, frame - joint_spacing) : frame + joint_spacing + 1, j] = -1.0
        candidates[max(0, frame - spacing) : frame + spacing + 1] = -1.0
        counts[j] += 1
        candidates[:, counts >= _MOST_AT_JOINT] = -1.0


def playback_page(playback: Playback, about: About) -> Page:
    """Return the page of a playback."""
    *_, last = playback.models
    items = [
        f"{played.title}: {playback.moment_words(moment)}"
        for played in playback.models
        for moment in played.moments
    ]
    errors = {
        capitalized(played.title): f"nrms {number(played.comparison.errors.nrms)} on {played.data}"
        for played in playback.models
    }
    page = comparison_page(last.comparison, about)
    *others, notes = page.sections
    notes = replace(notes, items=(*playback.left_out, *playback.shapes.notes, *notes.items))
    detailed = (replace(each, detailed=True) for each in others)
    sections = (Section("Worst moments", items=tuple(items)), *detailed, notes)
    return replace(page, sections=sections, facts={**errors, **page.facts}, compared={})


def effect_words(fitted: FittedEffect, units: Units) -> str:
    """Return an effect and its main value, such as `payload 2.49 kg`."""
    effect = fitted.effect
    label = printable(effect.label or effect_label(effect.name))
    values, _ = effect.reported(fitted.parameters, np.full(len(fitted.parameters), np.nan))
    names = [effect.summary] if effect.summary in values else list(values)
    if isinstance(effect, PointEpisode):
        return f"{label} {number(float(np.linalg.norm(fitted.parameters[:3])))} N"
    if not names:
        return label
    place = " & ".join(effect.where)
    shown = number(units.shown(effect.name, names[0], values[names[0]]))
    return f"{label} {shown} {units.parameter(effect.name, names[0], place)}".strip()


VIEWS = {Playback: View(playback_page, "Played")}
"""Type of result -> its view."""
