"""Figures of the benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from diagrams.benchmarks.hidden.bars import Line
from geodrake.report import style

_REACHED, _MISSED, _OTHER = style.AFTER, style.BEFORE, style.MEASURED


def write_figures(
    folder: Path,
    lines: Sequence[Line],
    confused: Mapping[str, Mapping[str, int]],
    smallest: Sequence[Mapping[str, Any]],
) -> None:
    """Write all figures that there are numbers for into a folder as PNG."""
    folder.mkdir(parents=True, exist_ok=True)
    bars_figure(lines).savefig(folder / "hidden_effects.png")
    if confused:
        confusion_figure(confused).savefig(folder / "hidden_effects_confusions.png")
    if smallest:
        smallest_figure(smallest).savefig(folder / "hidden_effects_smallest.png")


def bars_figure(lines: Sequence[Line]) -> Figure:
    """What was reached, with its interval, against what was asked for."""
    shown = [line for line in lines if line.value is not None and not line.figure.count("seconds")]
    shares = [line for line in shown if "floor" not in line.figure]
    figure = style.new_figure(0.9 + 0.27 * len(shares))
    axes = figure.subplots()
    for k, line in enumerate(shares):
        color = {True: _REACHED, False: _MISSED, None: _OTHER}[line.reached]
        axes.plot([line.low, line.high], [k, k], color=color, linewidth=5.0, alpha=0.35)
        axes.plot(line.value, k, "o", color=color, markersize=6.0)
        for at in (line.bar, line.highest):
            if at is not None:
                axes.plot([at, at], [k - 0.38, k + 0.38], color=style.INK, linewidth=1.4)
        text = f"{100 * line.value:.1f} %  of {line.logs}"
        axes.text(1.03, k, text, va="center", **style.plain(style.SMALL, style.QUIET))
    axes.set_yticks(range(len(shares)), [line.figure for line in shares])
    axes.set(xlim=(-0.02, 1.02), ylim=(len(shares) - 0.4, -0.6))
    axes.set_xticks(
        np.arange(0.0, 1.01, 0.2), [f"{100 * x:.0f} %" for x in np.arange(0, 1.01, 0.2)]
    )
    style.polish(axes, grid="x")
    axes.set_title(
        "Hidden effects: share of logs, 95 % interval, and the bar (black)",
        loc="left",
        **style.plain(fontweight="bold"),
    )
    style.note_below(figure, "Blue: the bar is reached. Orange: missed. Grey: no bar.")
    return figure


def confusion_figure(confused: Mapping[str, Mapping[str, int]]) -> Figure:
    """What each hidden effect was called."""
    rows = list(confused)
    others = {answer for line in confused.values() for answer in line} - set(rows)
    columns = [*rows, *sorted(others)]
    counts = np.array([[confused[row].get(column, 0) for column in columns] for row in rows])
    share = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    figure = style.new_figure(2.2 + 0.27 * len(rows))
    axes = figure.subplots()
    axes.imshow(share, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        color = "white" if share[i, j] > 0.6 else style.INK
        axes.text(j, i, counts[i, j], ha="center", va="center", **style.plain(style.SMALL, color))
    axes.set_xticks(range(len(columns)), columns, rotation=55, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(rows)), rows)
    style.polish(axes, grid="none")
    axes.set_ylabel("hidden", **style.plain())
    axes.set_xlabel("named first", **style.plain())
    axes.set_title(
        "What hidden effects were called: logs of one effect, all motions and priors",
        loc="left",
        **style.plain(fontweight="bold"),
    )
    return figure


def smallest_figure(smallest: Sequence[Mapping[str, Any]]) -> Figure:
    """The smallest effects that are found."""
    figure = style.new_figure(1.0 + 0.27 * len(smallest))
    axes = figure.subplots()
    for k, line in enumerate(smallest):
        if line["smallest"] is not None:
            axes.plot(100 * line["smallest"], k, "o", color=_REACHED)
        else:
            axes.text(26.0, k, "not found", va="center", **style.plain(style.SMALL, _MISSED))
        if line["median"] is not None:
            axes.plot(100 * line["median"], k, "o", color=_REACHED, fillstyle="none")
    axes.set_yticks(range(len(smallest)), [line["effect"] for line in smallest])
    axes.set(ylim=(len(smallest) - 0.4, -0.6), xlim=(0.15, 40.0))
    style.polish(axes)
    style.log_scale(axes, "x")
    axes.set_xlabel("RMS of the effect, % of the deviation of the effort", **style.plain())
    logs = smallest[0]["logs"]
    axes.set_title(
        f"Smallest effect found in nine of ten logs (open: in half) at 1 % noise; {logs} logs each",
        loc="left",
        **style.plain(fontweight="bold"),
    )
    return figure
