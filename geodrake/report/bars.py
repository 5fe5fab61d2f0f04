"""Errors as bars on a page: step by step, of candidates, and joint by joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, log

import numpy as np

from geodrake.diagnosis.results import Candidate, Diagnosis, Explanation
from geodrake.identification.logs.model_errors import ErrorTable
from geodrake.report.numbers import number, shortened
from geodrake.report.words import effect_label, places_label, step_place
from geodrake.report.worst_joints import MOST_JOINTS, of_worst, worst_joints

_LEAST = 1e-6  # nrms, so that a perfect model has a place on a logarithmic axis
_MOST_CANDIDATES = 14
_MOST_LETTERS = 80


@dataclass(frozen=True)
class Color:
    """What a colour stands for.

    Attributes:
        name: Its name in the style sheet.
        opacity: How strong it is, from 0 to 1.
        label: What it stands for, in words.
        thin: Whether it is that of a mark rather than of bars.
    """

    name: str
    opacity: float = 1.0
    label: str = ""
    thin: bool = False


@dataclass(frozen=True)
class Bar:
    """A bar, or a mark across a row's bars.

    Attributes:
        end: Where it ends, as a share of the longest there may be.
        text: The number beside it; "" for none.
    """

    color: Color
    end: float
    text: str = ""


@dataclass(frozen=True)
class BarRow:
    """What belongs to one name."""

    label: str
    bars: tuple[Bar, ...]
    marks: tuple[Bar, ...] = ()


@dataclass(frozen=True)
class Bars:
    """A figure of bars.

    Attributes:
        note: What to know of it; "" for nothing.
    """

    caption: str
    legend: tuple[Color, ...]
    rows: tuple[BarRow, ...]
    note: str = ""

    @property
    def letters(self) -> int:
        """Most letters of a number, for which there is to be room beside the longest bar."""
        return max(len(bar.text) for row in self.rows for bar in row.bars)


_START, _END = Color("before", label="as it stands"), Color("after", label="refitted on the logs")
_NOISE = Color("noise", label="sensor noise", thin=True)


def step_bars(explanation: Explanation) -> Bars:
    """How the held-out nrms falls with each step, on a logarithmic axis."""
    start, floor = explanation.start, explanation.end.floor_nrms
    joints = [joint.joint for joint in start.joints]
    errors = [
        ("the model as it stands", start.nrms),
        ("its own parameters refitted", explanation.refitted.nrms),
    ]
    for step in explanation.steps:
        words = f"+ {effect_label(step.effect)}, {step_place(step, joints, most=3)}"
        errors.append((shortened(words, _MOST_LETTERS), step.error_after))
    axis = _LogAxis.of([nrms for _, nrms in errors], [floor])
    marks = axis.marks(floor)
    rows = tuple(
        BarRow(words, (axis.bar(_END if i else _START, nrms),), marks)
        for i, (words, nrms) in enumerate(errors)
    )
    caption = "The error on held-out data (nrms) falling with each step, on a logarithmic axis."
    return Bars(caption, (_START, _END, _NOISE), rows)


def candidate_bars(diagnosis: Diagnosis) -> Bars:
    """Held-out nrms that each candidate would leave, the chosen one first."""
    shown = diagnosis.candidates[:_MOST_CANDIDATES]
    joints = [joint.joint for joint in diagnosis.start.joints]
    floor, before = diagnosis.refitted.floor_nrms, diagnosis.refitted.nrms
    most = max([before, floor, *(c.error_after for c in shown)])
    without = Color("before", label="without it", thin=True)
    marks = tuple(Bar(c, x / most) for c, x in ((without, before), (_NOISE, floor)))
    rows = []
    for i, candidate in enumerate(shown):
        words = f"{effect_label(candidate.effect)}, {places_label(candidate.where, joints, most=3)}"
        text = number(candidate.error_after) + (", tied" if i and candidate.tied else "")
        bar = Bar(_rank_color(i, candidate), candidate.error_after / most, text)
        rows.append(BarRow(shortened(words, _MOST_LETTERS), (bar,), marks))
    colors = dict.fromkeys(row.bars[0].color for row in rows)
    count = len(diagnosis.candidates)
    return Bars(
        "The error on held-out data (nrms) that each candidate would leave.",
        (*colors, without, _NOISE),
        tuple(rows),
        f"The best {len(shown)} of {count} candidates." if count > len(shown) else "",
    )


def joint_bars(errors: ErrorTable, stages: Sequence[tuple[str, Sequence[float]]] = ()) -> Bars:
    """RMS error of each joint over its effort's deviation, on a logarithmic axis.

    Args:
        stages: Words and (nv,) RMS of every joint, N·m or N, after each step.
    """
    names = set(worst_joints(errors, MOST_JOINTS))
    at = [i for i, joint in enumerate(errors.joints) if joint.joint in names]
    shades = np.linspace(0.25, 1.0, len(stages)) if len(stages) > 1 else np.ones(len(stages))
    later = [
        Color("after", round(float(shade), 2), words)
        for shade, (words, _) in zip(shades, stages, strict=True)
    ]
    values = []
    for i in at:
        joint = errors.joints[i]
        values.append([rms / joint.std for rms in (joint.rms, *(rms[i] for _, rms in stages))])
    floors = [errors.joints[i].floor / errors.joints[i].std for i in at]
    axis = _LogAxis.of([x for own in values for x in own], floors)
    rows = tuple(
        BarRow(
            errors.joints[i].joint,
            tuple(map(axis.bar, (_START, *later), own)),
            axis.marks(floor),
        )
        for i, own, floor in zip(at, values, floors, strict=True)
    )
    caption = (
        "RMS error of each joint over the standard deviation of its effort, on a logarithmic axis."
    )
    return Bars(caption, (_START, *later, _NOISE), rows, of_worst(len(at), len(errors.joints)))


def step_joint_bars(explanation: Explanation) -> Bars:
    """The errors of joints at the start, and after each step of an explanation."""
    joints = [joint.joint for joint in explanation.start.joints]
    stages = [
        (f"+ {effect_label(s.effect)}", [s.rms_after.get(joint, np.nan) for joint in joints])
        for s in explanation.steps
    ]
    return joint_bars(explanation.start, stages)


@dataclass(frozen=True)
class _LogAxis:
    """A logarithmic axis between two values."""

    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float], floors: Sequence[float]) -> _LogAxis:
        """An axis on which errors, and noise where it is known, have their places."""
        known = [max(x, _LEAST) for x in (*values, *(f for f in floors if f > 0)) if isfinite(x)]
        known = known or [1.0]
        return cls(0.6 * min(known), 1.01 * max(known))

    def at(self, value: float) -> float:
        """A value's place, from 0 to 1."""
        return log(max(value, _LEAST) / self.low) / log(self.high / self.low)

    def bar(self, color: Color, value: float) -> Bar:
        """A bar that ends at a value."""
        return Bar(color, self.at(value), number(value)) if isfinite(value) else Bar(color, 0, "–")

    def marks(self, floor: float) -> tuple[Bar, ...]:
        """That of the noise, if it is known."""
        return (Bar(_NOISE, self.at(floor)),) if isfinite(floor) and floor > 0 else ()


def _rank_color(rank: int, candidate: Candidate) -> Color:
    if rank == 0:
        return Color("after", label="chosen")
    if candidate.tied:
        return Color("tied", label="as good, as far as the logs show")
    return Color("measured", label="less likely")
