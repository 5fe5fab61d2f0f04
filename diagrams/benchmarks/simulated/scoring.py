"""Scores of diagnoses against the truth, and the lines of a report."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import takewhile
from typing import Any

import numpy as np
from scipy.stats import binomtest

from diagrams.benchmarks.simulated.recording import Recording
from diagrams.benchmarks.simulated.truths import HELD, WRONG_INERTIA
from diagrams.harness import plain, show, write
from geodrake.diagnosis import Step, explain
from geodrake.errors import GeodrakeError
from geodrake.model import RobotModel

Row = Mapping[str, Any]
Places = Mapping[str, Sequence[str]]
"""Effect -> its places."""
SURE = 0.9


# Steps


def explained(model: RobotModel, recording: Recording, *, is_off: bool) -> dict[str, Any]:
    """Explain the logs of a recording, and score the result.

    If bodies of the file are wrong (`is_off`), wrong inertias are right.
    """
    start = time.process_time()
    try:
        diagnosis = explain(model, list(recording.logs))
    except GeodrakeError as error:
        return {"failed": str(error), "steps": [], "missing": ["everything"], "wrong": []}
    summary = {
        "failed": None,
        "seconds": time.process_time() - start,
        "verdict": diagnosis.verdict,
        "start_nrms": diagnosis.start.nrms,
        "end_nrms": diagnosis.end.nrms,
        "notes": list(diagnosis.notes),
    }
    right: Places = {**recording.beside, **recording.hidden}
    if is_off:
        right = {**right, WRONG_INERTIA: model.bodies}
    rows = [step_row(step, right) for step in diagnosis.steps]
    missing = not_found(rows, recording.hidden)
    return summary | judged(rows, missing, recording.hidden.get(HELD, ()), recording.mass)


def step_row(step: Step | Row, right: Places) -> dict[str, Any]:
    """Return the row of a step, or of its JSON form, with whether it is right."""
    value = step.__getitem__ if isinstance(step, Mapping) else partial(getattr, step)
    effect, where = value("effect"), list(value("where"))
    return {
        "effect": effect,
        "where": where,
        "probability": float(value("probability")),
        "rivals": list(value("indistinguishable_from")),
        **{name: plain(value(name)) for name in ("parameters", "deviations", "systematic")},
        "right": effect in right and set(where) <= set(right[effect]),
    }


def judged(
    rows: Sequence[Row], missing: Sequence[str], held_by: Sequence[str], mass: float
) -> dict[str, Any]:
    """Return rows of steps, the missing and wrong ones, and a payload's mass."""
    wrong = [step_words(row) for row in rows if not row["right"]]
    return {"steps": rows, "missing": missing, "wrong": wrong, **_mass_row(rows, held_by, mass)}


def not_found(rows: Sequence[Row], wanted: Places) -> list[str]:
    """Describe wanted effects at places where no step has them."""
    found = {(row["effect"], place) for row in rows for place in row["where"]}
    pairs = [(name, place) for name, places in wanted.items() for place in places]
    return [f"{name} at {place}" for name, place in pairs if (name, place) not in found]


def step_words(step: Row) -> str:
    """Describe a step in words."""
    return f"{step['effect']} at {', '.join(step['where'])} ({step['probability']:.3f})"


def _mass_row(rows: Sequence[Row], held_by: Sequence[str], truth: float) -> dict[str, Any]:
    """Return the estimate of a payload's mass and its uncertainty, if there is one."""
    steps = [row for row in rows if row["effect"] == HELD and set(row["where"]) & set(held_by)]
    if not steps:
        return {}
    step = steps[-1]
    body = next(place for place in step["where"] if place in held_by)
    mass, deviation = step["parameters"][body]["mass"], step["deviations"][body]["mass"]
    systematic = step["systematic"].get(body, {}).get("mass", 0.0)
    half = 2.0 * float(np.hypot(deviation, systematic))
    return {
        "found_mass": mass,
        "mass_deviation": deviation,
        "mass_systematic": systematic,
        "mass_inside": bool(abs(mass - truth) <= half),
        "mass_half_width": half / truth,
        "mass_error": abs(mass - truth) / truth,
    }


def is_missed(row: Row) -> bool:
    """Return whether an effect is missing or wrong."""
    return bool(row["failed"] or row["missing"] or row["wrong"])


def missed_words(row: Row) -> str:
    """Describe a draw, its missing and wrong effects, and the right ones, in a line."""
    settings = takewhile(lambda item: item[0] != "failed", plain(row).items())
    words = [f"{name} {', '.join(x) if isinstance(x, dict) else x}" for name, x in settings if x]
    titles = [title for title in ("failed", "missing", "wrong") if row[title]]
    words += [f"{title.upper()} {row[title]}" for title in titles]
    right = [step_words(step) for step in row["steps"] if step["right"]]
    return ", ".join([*words, f"right: {'; '.join(right) or 'nothing'}"])


def is_clean(row: Row) -> bool:
    """Return whether no effect is wrong."""
    return not (row["wrong"] or row["failed"])


def is_sure_and_wrong(row: Row) -> bool:
    """Return whether a wrong effect has a high probability."""
    return any(step["probability"] > SURE and not step["right"] for step in row["steps"])


# Lines


@dataclass(frozen=True)
class Line:
    """A line of a report: a goal and the value reached."""

    figure: str
    bar: float | None  # goal; None without one
    most: bool  # whether the bar is an upper bound
    value: float | None = None
    # low, high: its 95 % interval; of quantiles the range of values.
    low: float | None = None
    high: float | None = None
    logs: int = 0
    highest: float | None = None  # upper bound of the interval's low end, if `bar` is a lower bound

    @property
    def reached(self) -> bool | None:
        """Whether the bar is reached; None without a bar or a log."""
        if self.bar is None or self.value is None:
            return None
        if self.most:
            return self.value <= self.bar
        is_below = self.highest is None or self.low is None or self.low <= self.highest
        return self.bar <= self.value and is_below


def told(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return lines for a file."""
    return [{**asdict(line), "reached": line.reached} for line in lines]


def show_lines(title: str, lines: Sequence[Line]) -> None:
    """Print lines, shares in percent."""
    shown = []
    for line in lines:
        is_share = "seconds" not in line.figure and "floor" not in line.figure
        number = ("{:.1%}" if is_share else "{:.2f}").format
        asked = None if line.bar is None else f"{'≤' if line.most else '≥'} {number(line.bar)}"
        if line.bar is not None and line.highest is not None:
            asked = f"{number(line.bar)} – {number(line.highest)}"
        is_measured = line.value is not None
        shown.append(
            {
                "figure": line.figure,
                "asked": asked,
                "reached": number(line.value) if is_measured else None,
                "interval": f"{number(line.low)} – {number(line.high)}" if is_measured else None,
                "of": line.logs,
                "": {True: "reached", False: "missed", None: ""}[line.reached],
            }
        )
    show(title, shown)


def tell_draws(
    options: Namespace,
    title: str,
    lines: Sequence[Line],
    rows: Sequence[Row],
    is_missed: Callable[[Row], bool] = is_missed,
) -> None:
    """Print and write the report and the missed draws."""
    show_lines(title, lines)
    missed = [missed_words(row) for row in rows if is_missed(row)]
    print(f"Missed, {len(missed)} of {len(rows)} draws:", *missed, sep="\n- ")
    write(options, {"lines": told(lines), "rows": rows})


def share(
    figure: str,
    rows: Sequence[bool],
    bar: float | None = None,
    *,
    most: bool = False,
    highest: float | None = None,
) -> Line:
    """Return the line of a share, with its Wilson interval."""
    if not rows:
        return Line(figure, bar, most, highest=highest)
    wilson = binomtest(sum(rows), len(rows)).proportion_ci(0.95, "wilson")
    value, interval = float(np.mean(rows)), (float(wilson.low), float(wilson.high))
    return Line(figure, bar, most, value, *interval, len(rows), highest)


def median(figure: str, values: Sequence[float], bar: float | None = None) -> Line:
    """Return the line of a median, with its interval from ranks."""
    if not values:
        return Line(figure, bar, True)
    ranked, n = np.sort(values), len(values)
    half = 1.96 * np.sqrt(n) / 2.0
    low, high = max(int(n / 2 - half), 0), min(int(n / 2 + half) + 1, n - 1)
    value = float(np.median(ranked))
    return Line(figure, bar, True, value, float(ranked[low]), float(ranked[high]), n)


def quantiles(figure: str, values: Sequence[float], bar: float | None = None) -> list[Line]:
    """Return lines of the median, with the bar, and the 90 % quantile."""
    if not values:
        return [Line(f"{figure}, median", bar, True), Line(f"{figure}, 90 %", None, True)]
    ends = min(values), max(values)
    return [
        Line(f"{figure}, {name}", most, True, float(np.quantile(values, level)), *ends, len(values))
        for name, level, most in (("median", 0.5, bar), ("90 %", 0.9, None))
    ]


BINS = ((0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.0))


def calibration(rows: Sequence[Row]) -> list[Line]:
    """Return the shares of right steps by bins of their probability."""
    steps = [step for row in rows for step in row.get("steps", ())]
    bars = {(0.9, 0.99): {"bar": 0.85, "highest": 0.99}}
    return [
        share(
            f"said at {low:g} – {high:g}: true" if high < 1.0 else f"said at > {low:g}: true",
            [step["right"] for step in steps if low < step["probability"] <= high],
            **bars.get((low, high), {}),
        )
        for low, high in BINS
    ]
