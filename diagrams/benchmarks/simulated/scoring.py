"""What is found beside what is true: steps of a diagnosis, and the lines of a report."""

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
"""Effect -> where it is."""
SURE = 0.9


# Steps


def explained(model: RobotModel, recording: Recording, *, is_off: bool) -> dict[str, Any]:
    """Return what `explain` says of logs, and what of it is right.

    Where bodies of the file are off (`is_off`), wrong inertias are right.
    """
    began = time.process_time()
    try:
        found = explain(model, list(recording.logs))
    except GeodrakeError as error:
        return {"failed": str(error), "steps": [], "missing": ["everything"], "wrong": []}
    said = {
        "failed": None,
        "seconds": time.process_time() - began,
        "verdict": found.verdict,
        "start_nrms": found.start.nrms,
        "end_nrms": found.end.nrms,
        "notes": list(found.notes),
    }
    right: Places = {**recording.beside, **recording.hidden}
    if is_off:
        right = {**right, WRONG_INERTIA: model.bodies}
    rows = [step_row(step, right) for step in found.steps]
    missing = not_found(rows, recording.hidden)
    return said | judged(rows, missing, recording.hidden.get(HELD, ()), recording.mass)


def step_row(step: Step | Row, right: Places) -> dict[str, Any]:
    """Return the row of a step, or of one as JSON has it, and whether it is right."""
    said = step.__getitem__ if isinstance(step, Mapping) else partial(getattr, step)
    effect, where = said("effect"), list(said("where"))
    return {
        "effect": effect,
        "where": where,
        "probability": float(said("probability")),
        "rivals": list(said("indistinguishable_from")),
        **{name: plain(said(name)) for name in ("parameters", "deviations", "systematic")},
        "right": effect in right and set(where) <= set(right[effect]),
    }


def judged(
    rows: Sequence[Row], missing: Sequence[str], held_by: Sequence[str], mass: float
) -> dict[str, Any]:
    """Return rows of steps, what is missing and wrong among them, and a payload's mass."""
    wrong = [step_words(row) for row in rows if not row["right"]]
    return {"steps": rows, "missing": missing, "wrong": wrong, **_mass_row(rows, held_by, mass)}


def not_found(rows: Sequence[Row], wanted: Places) -> list[str]:
    """Return wanted effects at places at which no step has them."""
    found = {(row["effect"], place) for row in rows for place in row["where"]}
    at = [(name, place) for name, places in wanted.items() for place in places]
    return [f"{name} at {place}" for name, place in at if (name, place) not in found]


def step_words(step: Row) -> str:
    """Return a step in writing."""
    return f"{step['effect']} at {', '.join(step['where'])} ({step['probability']:.3f})"


def _mass_row(rows: Sequence[Row], held_by: Sequence[str], truth: float) -> dict[str, Any]:
    """Return a payload's mass as found, and how well it is said to be known; nothing without."""
    found = [row for row in rows if row["effect"] == HELD and set(row["where"]) & set(held_by)]
    if not found:
        return {}
    step = found[-1]
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
    """Return whether anything is missing, or named and wrong."""
    return bool(row["failed"] or row["missing"] or row["wrong"])


def missed_words(row: Row) -> str:
    """Return what a draw was and hid, then what was missed and what was right, in a line."""
    about = takewhile(lambda item: item[0] != "failed", plain(row).items())
    words = [f"{name} {', '.join(x) if isinstance(x, dict) else x}" for name, x in about if x]
    titles = [title for title in ("failed", "missing", "wrong") if row[title]]
    words += [f"{title.upper()} {row[title]}" for title in titles]
    right = [step_words(step) for step in row["steps"] if step["right"]]
    return ", ".join([*words, f"right: {'; '.join(right) or 'nothing'}"])


def is_clean(row: Row) -> bool:
    """Return whether no name is wrong."""
    return not (row["wrong"] or row["failed"])


def is_sure_and_wrong(row: Row) -> bool:
    """Return whether a name is wrong and said to be sure."""
    return any(step["probability"] > SURE and not step["right"] for step in row["steps"])


# Lines


@dataclass(frozen=True)
class Line:
    """A line of a report: what was to be reached, and what was."""

    figure: str
    bar: float | None  # what was asked for, None where nothing was
    most: bool  # whether the bar is an upper one
    value: float | None = None  # what was reached
    # low, high: 95 % interval of it, by Wilson for shares; None for medians.
    low: float | None = None
    high: float | None = None
    logs: int = 0
    highest: float | None = None  # what it must not be above, where `bar` is a lower bound

    @property
    def reached(self) -> bool | None:
        """Whether the bar is reached; None where there is none, or no log."""
        if self.bar is None or self.value is None:
            return None
        if self.most:
            return self.value <= self.bar
        return self.bar <= self.value <= (1.0 if self.highest is None else self.highest)


def told(lines: Sequence[Line]) -> list[dict[str, Any]]:
    """Return lines as a file has them."""
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
    """Print the report of robots and the draws in which something was missed, and write them."""
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
    """Return a line of a share."""
    if not rows:
        return Line(figure, bar, most, highest=highest)
    of_wilson = binomtest(sum(rows), len(rows)).proportion_ci(0.95, "wilson")
    value, interval = float(np.mean(rows)), (float(of_wilson.low), float(of_wilson.high))
    return Line(figure, bar, most, value, *interval, len(rows), highest)


def median(figure: str, values: Sequence[float], bar: float | None = None) -> Line:
    """Return a line of a median, with the interval that ranks give."""
    if not values:
        return Line(figure, bar, True)
    ranked, n = np.sort(values), len(values)
    half = 1.96 * np.sqrt(n) / 2.0
    low, high = max(int(n / 2 - half), 0), min(int(n / 2 + half) + 1, n - 1)
    value = float(np.median(ranked))
    return Line(figure, bar, True, value, float(ranked[low]), float(ranked[high]), n)


def quantiles(figure: str, values: Sequence[float], bar: float | None = None) -> list[Line]:
    """Return the median, which the bar is for, and what nine of ten are below."""
    if not values:
        return [Line(f"{figure}, median", bar, True), Line(f"{figure}, 90 %", None, True)]
    ends = min(values), max(values)
    return [
        Line(f"{figure}, {name}", most, True, float(np.quantile(values, at)), *ends, len(values))
        for name, at, most in (("median", 0.5, bar), ("90 %", 0.9, None))
    ]


BINS = ((0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.0))


def calibration(rows: Sequence[Row]) -> list[Line]:
    """Return how many of the things said with a probability in a bin are true."""
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
