"""The lines of the report: what was to be reached, and what was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import binomtest

from diagrams.benchmarks.hidden.logs import (
    COVERAGE,
    EXACT,
    KIND,
    LEAST_SHARE,
    NONE,
    OFF,
    ONE,
    TIMING,
    TWO,
    UNKNOWN,
)
from diagrams.benchmarks.hidden.robots import SLOW
from diagrams.benchmarks.hidden.truths import KINDS, TRUTHS
from diagrams.harness import show

Row = Mapping[str, Any]
FOUND_IN = 0.9
"""Share of the logs in which the smallest effect is found."""


@dataclass(frozen=True)
class Line:
    """One line."""

    figure: str
    bar: float | None  # what was asked for, None where nothing was
    most: bool  # whether the bar is an upper one
    value: float | None  # what was reached
    # low, high: 95 % interval of it, by Wilson for shares; None for medians.
    low: float | None
    high: float | None
    logs: int
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
    """Print lines."""
    shown = []
    for line in lines:
        is_share = "seconds" not in line.figure and "floor" not in line.figure
        number = ("{:.1%}" if is_share else "{:.2f}").format
        asked = None if line.bar is None else f"{'≤' if line.most else '≥'} {number(line.bar)}"
        if line.bar is not None and line.highest is not None:
            asked = f"{number(line.bar)} – {number(line.highest)}"
        found = line.value is not None
        shown.append(
            {
                "figure": line.figure,
                "asked": asked,
                "reached": number(line.value) if found else None,
                "interval": f"{number(line.low)} – {number(line.high)}" if found else None,
                "of": line.logs,
                "": {True: "reached", False: "missed", None: ""}[line.reached],
            }
        )
    show(title, shown)


def tell_draws(title: str, lines: Sequence[Line], missed: Sequence[str], draws: int) -> None:
    """Print the report of robots, and what was missed of how many draws."""
    show_lines(title, lines)
    print(f"Missed, {len(missed)} of {draws} draws:", *missed, sep="\n- ")


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
        return Line(figure, bar, most, None, None, None, 0, highest)
    of_wilson = binomtest(sum(rows), len(rows)).proportion_ci(0.95, "wilson")
    value, interval = float(np.mean(rows)), (float(of_wilson.low), float(of_wilson.high))
    return Line(figure, bar, most, value, *interval, len(rows), highest)


def median(figure: str, values: Sequence[float], bar: float | None = None) -> Line:
    """Return a line of a median, with the interval that ranks give."""
    if not values:
        return Line(figure, bar, True, None, None, None, 0)
    ranked, n = np.sort(values), len(values)
    half = 1.96 * np.sqrt(n) / 2.0
    low, high = max(int(n / 2 - half), 0), min(int(n / 2 + half) + 1, n - 1)
    value = float(np.median(ranked))
    return Line(figure, bar, True, value, float(ranked[low]), float(ranked[high]), n)


def bars(rows: Sequence[Row]) -> list[Line]:
    """Return the lines that draws of the product give."""
    one = [r for r in _of(rows, ONE) if r["secrets"][0]["share"] >= LEAST_SHARE]
    brisk = [r for r in one if r["motion"] != SLOW]
    main = [r for r in brisk if r["prior"] == EXACT]
    off = [r for r in brisk if r["prior"] == OFF]
    slow = [r for r in one if r["motion"] == SLOW]
    two = _of(rows, TWO)
    plain = [r for r in two if r["motion"] != SLOW and r["prior"] == EXACT]
    named = [r["over_floor"] for r in (*one, *two) if r["named"]]
    outside = _of(rows, UNKNOWN)
    return [
        share("one effect: truth first", _get(main, "first"), 0.95),
        share("… truth in the set", _get(main, "in_set"), 0.99),
        share("… right joint or body", _get(main, "placed"), 0.98),
        share("… and nothing else", [not r["extra"] for r in main]),
        *(
            share(
                f"nothing hidden, {colour} noise: false alarms",
                _alarms(rows, colour),
                0.01,
                most=True,
            )
            for colour in ("white", "coloured")
        ),
        share(
            "outside effects: unexplained, joint and correlate", [_honest(r) for r in outside], 0.95
        ),
        share("… unexplained", [r["verdict"] == "unexplained" for r in outside]),
        share("… right joint", _get(outside, "right_joint")),
        share("… right correlate", _get(outside, "right_correlate")),
        share("two effects: both, nothing else", [_both(r) for r in plain], 0.92),
        share(
            "… in slow motion or with inertia 20 % off", [_both(r) for r in two if r not in plain]
        ),
        *_sureness(rows),
        median("error after / noise floor where named, median", named, 1.05),
        share("inertia 20 % off: truth in the set", _get(off, "in_set"), 0.97),
        share("… truth first", _get(off, "first")),
        share(
            "slow motion: truth in the set",
            _get([r for r in slow if r["prior"] == EXACT], "in_set"),
            0.95,
        ),
        share(
            "… with inertia 20 % off, too", _get([r for r in slow if r["prior"] == OFF], "in_set")
        ),
        median(
            "seconds for one log of 24 s, median",
            [r["seconds"] for r in rows if r["case"] in (ONE, TWO, NONE, UNKNOWN)],
            10.0,
        ),
        median(
            "seconds for 6 joints, 10,000 samples", [r["seconds"] for r in _of(rows, TIMING)], 10.0
        ),
    ]


def _sureness(rows: Sequence[Row]) -> list[Line]:
    """Return how many findings are right, by the probability that they were given."""
    steps = [step for row in rows for step in row.get("steps", ())]
    return [
        share(
            f"findings given {words}: right",
            [step["right"] for step in steps if low <= step["probability"] < high],
            bar,
        )
        for words, low, high, bar in (
            ("99 % or more", 0.99, 2.0, None),
            ("90 to 99 %", 0.9, 0.99, 0.85),
            ("less than 90 %", -1.0, 0.9, None),
        )
    ]


def coverage_lines(rows: Sequence[Row]) -> list[Line]:
    """How often 95 % intervals hold the truth: under coloured noise, and beside outside effects."""
    lines = []
    for beside, hidden in (("coloured noise", 1), ("an outside effect beside", 2)):
        off = [z for r in _of(rows, COVERAGE) if len(r["hidden"]) == hidden for z in r["off"]]
        inside = [abs(z) <= 1.96 for z in off]
        lines.append(share(f"coverage of 95 % intervals, {beside}", inside, 0.9, highest=0.98))
    return lines


def kind_lines(rows: Sequence[Row]) -> list[Line]:
    """Return how often each of the hard kinds is among what a log may hide, and at its place."""
    hard = _of(rows, KIND)
    return [
        share(
            f"{name}: in the set, placed",
            [r["in_set"] and r["placed"] is not False for r in hard if r["hidden"] == [name]],
            0.9,
        )
        for name in KINDS
    ]


def smallest_lines(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the share of the effort at which each effect is found in nine of ten logs."""
    lines = []
    for name in TRUTHS:
        found = [r["smallest"] for r in rows if r["hidden"] == [name]]
        sizes = np.sort([np.inf if size is None else size for size in found])
        if len(sizes):
            # The least size with which at least this share of the logs gives the effect away.
            at = float(sizes[int(np.ceil(FOUND_IN * len(sizes))) - 1])
            lines.append(
                {
                    "effect": name,
                    "smallest": at if np.isfinite(at) else None,
                    "median": _finite(float(np.median(sizes))),
                    "logs": len(sizes),
                }
            )
    return lines


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _of(rows: Sequence[Row], case: str) -> list[Row]:
    return [row for row in rows if row["case"] == case]


def _get(rows: Sequence[Row], key: str) -> list[Any]:
    return [row[key] for row in rows if row.get(key) is not None]


def _alarms(rows: Sequence[Row], colour: str) -> list[bool]:
    return [bool(row["steps"]) for row in _of(rows, NONE) if row["colour"] == colour]


def _honest(row: Row) -> bool:
    return bool(row["verdict"] == "unexplained" and row["right_joint"] and row["right_correlate"])


def _both(row: Row) -> bool:
    return bool(row["named"] and not row["extra"])
