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
from geodrake.identification.logs.case import Case, open_case
from geodrake.identification.logs.compare import comparison
from geodrake.identification.logs.model_errors import Comparison
from geodrake.inertia import Array
from geodrake.logs.motion import JointLog
from geodrake.model.robot_model import RobotModel
from geodrake.report.charts import Stage
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
from geodrake.report.words import effect_label
from geodrake.robot.shapes import RobotShapes

MOST_SECONDS = 30.0
"""Maximum length of the excerpts, s."""

_PART = 5.0  # s, length of the parts among which the worst are chosen
_MEAN_OVER = 0.3  # s, over which an error is the RMS: residuals change their sign
_APART = 1.0  # s, between two moments at one joint
_APART_ANYWHERE = 0.25  # s, between two moments
_FARTHEST = 1.0  # rad or m, of a ghost's joint from the measured position
_LEAST_TOP = 1e-6  # relative error that the last colour stands for at least
_MOST_MOMENTS, _MOST_AT_ONE = 5, 2  # of a model, and at one joint


@dataclass(frozen=True, eq=False)
class Excerpt:
    """Part of a log that is played."""

    log: str
    began: float  # the log's first time stamp, s
    time: Array  # (F,) instants of the frames in the log's own time, s
    q: Array  # (F, nv) positions by joint, rad or m


@dataclass(frozen=True)
class Moment:
    """An instant at which a model errs most."""

    joint: str
    frame: int  # number of the frame
    log: str
    time: float  # in the log's own time, s
    error: float  # RMS error around it, N·m or N
    relative: float  # the same over the deviation of the joint's measured effort


@dataclass(frozen=True, eq=False)
class PlayedModel:
    """A model and its errors in every frame."""

    title: str  # what the copy of the robot is called
    model: RobotModel
    comparison: Comparison  # its errors on the whole logs
    # Whether the model was fitted to these logs, so that errors are those of training.
    trained: bool
    measured: Array  # (F, nv) filtered efforts, N·m or N; NaN where nothing is compared
    predicted: Array  # (F, nv) what the model predicts
    error: Array  # (F, nv) RMS of measured − predicted around each frame
    relative: Array  # (F, nv) the same over the deviation of the joint's measured effort
    simulated: Array  # (F, nv) positions of its ghost by joint, rad or m; NaN where there is none
    moments: tuple[Moment, ...]  # the worst ones, worst first

    @property
    def data(self) -> str:
        """Return the kind of data that its errors are on."""
        return "training data" if self.trained else "held-out data"


@dataclass(frozen=True, eq=False)
class PlayedRobot:
    """One copy of the robot."""

    played: PlayedModel
    name: str  # its title, as part of a path
    place: Array  # (3,) where it stands, m
    links: list[PosedLink]
    colors: NDArray[np.uint8]  # (F, nv, 4) of the joints, RGBA
    # What was found, and the link at which it is said; None for the whole robot.
    findings: list[tuple[str, str | None]]


@dataclass(frozen=True, eq=False)
class Playback:
    """Motions and errors in all frames, and the shapes of the robot."""

    joints: tuple[str, ...]
    excerpts: tuple[Excerpt, ...]  # what is played, one after another
    models: tuple[PlayedModel, ...]  # one model, or that before and that after
    seconds_left_out: float  # length of the logs that is not played, s

    @property
    def q(self) -> Array:
        """(F, nv) positions by joint in all frames, rad or m."""
        return np.concatenate([excerpt.q for excerpt in self.excerpts])

    @cached_property
    def instants(self) -> list[tuple[str, float]]:
        """Return the log of each frame, and its time there, s."""
        return _instants(self.excerpts)

    @property
    def top(self) -> float:
        """Relative error that has the last colour."""
        every = np.concatenate([played.relative.ravel() for played in self.models])
        return top_error(every, _LEAST_TOP)

    @property
    def times(self) -> Array:
        """Return the instants (F,) of the frames as they are played, s.

        Those of one passage of one log are the log's own; several follow one another from 0.
        """
        if len(self.excerpts) == 1:
            return self.excerpts[0].time
        return np.arange(len(self.q)) / FRAMES

    @property
    def units(self) -> Units:
        """Return the units of the last model."""
        return Units.of(self.models[-1].model)

    @cached_property
    def shapes(self) -> RobotShapes:
        """Return how the robot looks."""
        return drawn_shapes(self.models[-1].model)

    @cached_property
    def extent(self) -> Extent:
        """Return the bounding region of the motion."""
        model = self.models[-1].model
        return Extent.of(model, model.positions(self.q))

    @cached_property
    def robots(self) -> list[PlayedRobot]:
        """Return a copy of the robot for each model, one beside the other."""
        robots = []
        for k, played in enumerate(self.models):
            model, place = played.model, k * self.extent.beside
            where = {name: joint.link for name, joint in joint_places(model).items()}
            where |= body_links(model)
            findings = []
            for fitted in model.effects:
                effect = fitted.effect
                at = next((where[name] for name in effect.where if name in where), None)
                findings.append((f"{effect_words(fitted, self.units)} ({effect.place})", at))
            links = posed_links(model, model.positions(self.q), self.shapes, place)
            colors, name = error_colors(played.relative, self.top), path_part(played.title)
            robots.append(PlayedRobot(played, name, place, links, colors, findings))
        return robots

    @property
    def left_out(self) -> list[str]:
        """Return a note on what is not played."""
        left = self.seconds_left_out
        words = (
            f"only the windows of largest error are played; {left:.0f} s of the logs are "
            "not (--seconds)"
        )
        return [words] if left > 0.5 else []

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
    """Return what to play of logs: all of them, or the passages in which the models err most.

    A ghost is the model's robot alone with the measured efforts. It begins at the measured state
    again and again, as a robot under efforts drifts away soon. Where a joint of it is
    1 rad or 1 m off, it stays.

    Args:
        before: Another model of the same robot, to be played beside it.
        seconds: Length of what is played at most, s.
        ghost: For how long a ghost is alone each time, s; no ghosts if None.
        progress: Called with what is simulated for ghosts, and the share that is done.

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
    case = open_case(model, logs, candidates=False, extra=extra, bandwidth=bandwidth)
    cases = {model.path.name if before is None else "after": case}
    if before is not None:
        own, of_motion = case.trajectories[0].bandwidths
        other = open_case(
            before,
            case.options.logs,
            candidates=False,
            extra=extra,
            bandwidth=own,
            motion_bandwidth=of_motion,
        )
        cases = {"before": other, **cases}
    compared = {title: comparison(each) for title, each in cases.items()}
    excerpts, left_out = _excerpts(case, [*compared.values()], seconds)
    models = tuple(
        _played(title, each, compared[title], excerpts, _ghost(each, excerpts, ghost, progress))
        for title, each in cases.items()
    )
    return Playback(model.joints, excerpts, models, left_out)


def _instants(excerpts: Sequence[Excerpt]) -> list[tuple[str, float]]:
    return [(excerpt.log, time) for excerpt in excerpts for time in excerpt.time.tolist()]


def _samples(found: Comparison, joint: str, log: str) -> Array:
    """Return (3, K) time, measured and predicted effort of a joint in a log, in order of time."""
    own = [s for s in found.series if s.joint == joint and s.log == log]
    names = ("time", "measured", "predicted")
    columns = np.array([np.concatenate([[], *(getattr(s, n) for s in own)]) for n in names])
    return columns[:, np.argsort(columns[0], kind="stable")]


def _excerpts(
    case: Case, found: Sequence[Comparison], seconds: float
) -> tuple[tuple[Excerpt, ...], float]:
    """Return the excerpts, and the seconds that are not played."""
    stretches = [(t, s) for t in case.trajectories for s in t.segments]
    total = sum(len(s) * s.period for _, s in stretches)
    count = int(np.ceil(seconds / _PART))
    parts = []  # (stretch, first sample, first one after it)
    for k, (_, stretch) in enumerate(stretches):
        most = max(2, int(seconds / count / stretch.period))
        size = len(stretch) if total <= seconds else most
        parts += [(k, at, min(at + size, len(stretch))) for at in range(0, len(stretch), size)]
    if total > seconds:

        def score(part: tuple[int, int, int]) -> float:
            (trajectory, stretch), (_, first, stop) = stretches[part[0]], part
            start = float(stretch[first : first + 1].time[0])
            return _score(trajectory.name, start, start + (stop - first) * stretch.period, found)

        parts = sorted(sorted(parts, key=score, reverse=True)[:count])
    joined: list[tuple[int, int, int]] = []
    for k, first, stop in parts:
        if joined and joined[-1][0] == k and joined[-1][2] == first:
            first = joined.pop()[1]  # noqa: PLW2901
        joined.append((k, first, stop))
    excerpts = []
    for k, first, stop in joined:
        trajectory, segment = stretches[k][0], stretches[k][1][first:stop]
        time = np.arange(segment.time[0], segment.time[-1] + 1e-9, 1.0 / FRAMES)
        q = np.stack([np.interp(time, segment.time, x) for x in segment.position.T], -1)
        excerpts.append(Excerpt(trajectory.name, trajectory.began, time, q))
    return tuple(excerpts), max(0.0, total - sum(len(e.time) for e in excerpts) / FRAMES)


def _score(log: str, start: float, end: float, found: Sequence[Comparison]) -> float:
    """Return the errors between two instants, relative to each model's own error."""
    score = 0.0
    for one in found:
        stds, worst = {joint.joint: joint.std for joint in one.errors.joints}, 0.0
        for s in (s for s in one.series if s.log == log):
            inside = (s.time >= start) & (s.time < end)
            if inside.any():
                worst = max(worst, float(((s.residual[inside] / stds[s.joint]) ** 2).mean()))
        score += worst / max(one.errors.nrms, 1e-12) ** 2
    return score


def _ghost(
    case: Case,
    excerpts: Sequence[Excerpt],
    horizon: float | None,
    progress: Callable[[str, float], None] | None,
) -> Array:
    """Return (F, nv) simulated positions under the measured efforts; NaN outside windows."""
    parts = [np.full_like(excerpt.q, np.nan) for excerpt in excerpts]
    if horizon is None:
        return np.concatenate(parts)
    spans = [(e.log, float(e.time[0]), float(e.time[-1])) for e in excerpts]
    most = 1 + int(sum(last - first for _, first, last in spans) / horizon)
    found = case_rollout(case, horizon=horizon, most=most, progress=progress, within=spans)
    for window in found.windows:
        # It stops once one joint is too far from the measured position.
        near = np.nan_to_num(np.abs(window.departure), nan=np.inf).max(1) <= _FARTHEST
        count = len(near) if near.all() else max(1, int(near.argmin()))
        simulated = window.simulated[np.minimum(np.arange(len(near)), count - 1)]
        for excerpt, part in zip(excerpts, parts, strict=True):
            shown = (window.time[0] <= excerpt.time) & (excerpt.time <= window.time[-1])
            if excerpt.log == window.log and shown.any():
                at = excerpt.time[shown]
                part[shown] = np.stack([np.interp(at, window.time, x) for x in simulated.T], -1)
    return np.concatenate(parts)


def _played(
    title: str, case: Case, found: Comparison, excerpts: Sequence[Excerpt], simulated: Array
) -> PlayedModel:
    joints = case.model.joints
    measured, predicted, error = np.stack(
        [
            np.concatenate([_around(e.time, *_samples(found, j, e.log)) for e in excerpts], axis=1)
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
        any(print_ in case.model.fitted_to for print_ in case.fingerprints),
        measured,
        predicted,
        error,
        relative,
        simulated,
        tuple(_worst(error, relative, joints, _instants(excerpts))),
    )


def _around(frames: Array, time: Array, measured: Array, predicted: Array) -> Array:
    """Return (3, F) efforts and the RMS of their difference at each frame; NaN without samples."""
    if not len(time):
        return np.full((3, len(frames)), np.nan)
    period = float(np.median(np.diff(time))) if len(time) > 1 else _MEAN_OVER
    half = max(0.5 * _MEAN_OVER, 1.01 * period)
    first, stop = (np.searchsorted(time, frames + sign * half) for sign in (-1.0, 1.0))
    sums = np.concatenate([[0.0], np.cumsum((measured - predicted) ** 2)])
    count = stop - first
    mean = np.maximum(sums[stop] - sums[first], 0.0) / np.maximum(count, 1)
    values = [np.interp(frames, time, x) for x in (measured, predicted)]
    return np.where(count > 0, [*values, np.sqrt(mean)], np.nan)


def _worst(
    error: Array, relative: Array, joints: Sequence[str], instants: Sequence[tuple[str, float]]
) -> Iterator[Moment]:
    """Yield well separated instants of largest relative error."""
    left = np.nan_to_num(relative, nan=-1.0)
    counts = np.zeros(left.shape[1], int)
    near, close = round(_APART * FRAMES), round(_APART_ANYWHERE * FRAMES)
    for _ in range(_MOST_MOMENTS):
        frame, j = divmod(int(left.argmax()), left.shape[1])
        if left[frame, j] <= 0.0:
            return
        (log, time), size = instants[frame], float(error[frame, j])
        yield Moment(joints[j], frame, log, time, size, float(relative[frame, j]))
        left[max(0, frame - near) : frame + near + 1, j] = -1.0
        left[max(0, frame - close) : frame + close + 1] = -1.0
        counts[j] += 1
        left[:, counts >= _MOST_AT_ONE] = -1.0


def playback_page(playback: Playback, about: About) -> Page:
    """Return the page of a playback."""
    *_, last = playback.models
    lists = {}
    for played in playback.models:
        words = f"{played.title}, nrms {number(played.comparison.errors.nrms)} on {played.data}"
        stage = Stage(words, "after" if played is last else "before")
        lists[stage] = tuple(map(playback.moment_words, played.moments))
    page = comparison_page(last.comparison, about)
    *others, notes = page.sections
    notes = replace(notes, items=(*playback.left_out, *playback.shapes.notes, *notes.items))
    detailed = (replace(each, detailed=True) for each in others)
    sections = (Section("Worst moments", lists=lists), *detailed, notes)
    return replace(page, sections=sections, compared={})


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


VIEWS = {Playback: View(playback_page, "Played")}  # how to see this result
