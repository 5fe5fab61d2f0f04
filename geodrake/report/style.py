"""Style of figures, and their files; matplotlib's global settings are not changed."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib import rc_context, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.axis import XAxis, YAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from PIL import Image

from geodrake.report.numbers import shortened

INK = "#1f2a37"
QUIET = "#6b7683"
RULE = "#d8dee6"
MEASURED = "#a9b4c0"
BEFORE = "#e08a3c"
AFTER = "#1b6ca8"
FLOOR = "#3f9c6b"
TIED = "#9cc3e0"

COLORS = {
    "ink": INK,
    "quiet": QUIET,
    "measured": MEASURED,
    "before": BEFORE,
    "after": AFTER,
    "noise": FLOOR,
    "tied": TIED,
    "step-1": "#a8508c",
    "step-2": "#0b8a72",
    "step-3": "#7a6bc4",
    "step-4": "#8a7a1c",
}
"""Colours by their names in the style sheet of pages."""

WIDTH = 10.0  # width of every figure, inches
DPI = 130
SMALL, NORMAL = 8.0, 9.0
_MOST_LETTERS = 160
_FONT = "DejaVu Sans"  # comes with matplotlib
_SETTINGS = {
    **{name: value for name, value in rcParamsDefault.items() if not name.startswith("backend")},
    "text.parse_math": False,
    "font.family": _FONT,
}


@contextmanager
def own_look() -> Iterator[None]:
    """Use matplotlib's default settings rather than the user's; `$` is not mathematics."""
    with rc_context(_SETTINGS):
        yield


def new_figure(height: float) -> Figure:
    """Return an empty figure of the common width and the given height, inches."""
    return Figure(figsize=(WIDTH, height), dpi=DPI, facecolor="white", layout="constrained")


def polish(ax: Axes, *, grid: str = "both") -> Axes:
    """Give axes the common look."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(RULE)
    ax.tick_params(labelcolor=QUIET, labelsize=SMALL, length=3, color=RULE)
    ax.tick_params(which="minor", length=2, color=RULE)
    ax.set_axisbelow(True)
    if grid != "none":
        ax.grid(True, axis=grid, color=RULE, linewidth=0.5, alpha=0.7)  # type: ignore[arg-type]
    return ax


def plain(size: float = NORMAL, color: str = INK, **more: Any) -> dict[str, Any]:
    """Return text properties that do not parse `$` in names as mathematics."""
    return {"fontsize": size, "color": color, "parse_math": False, **more}


def label(text: str, most: int = _MOST_LETTERS) -> str:
    """Return a shortened text for a figure; characters missing in the font become �."""
    font = get_font(findfont(_FONT))
    return "".join(c if font.get_char_index(ord(c)) else "�" for c in shortened(text, most))


def log_scale(ax: Axes, axis: str = "y") -> None:
    """Make an axis logarithmic, with plain numbers as labels."""
    scale: XAxis | YAxis = ax.xaxis if axis == "x" else ax.yaxis
    ax.set(**{f"{axis}scale": "log"})
    low, high = scale.get_view_interval()
    subs = (1.0, 2.0, 5.0) if high / low < 3e3 else (1.0,)
    scale.set_major_locator(LogLocator(subs=subs, numticks=12))
    scale.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    scale.set_minor_formatter(NullFormatter())


def legend_above(figure: Figure, handles: Sequence[Any]) -> None:
    """Add a legend above the whole figure."""
    figure.legend(
        handles=list(handles),
        loc="outside upper left",
        ncols=5,
        frameon=False,
        fontsize=SMALL + 0.5,
        labelcolor=INK,
        handlelength=1.8,
        columnspacing=1.8,
    )


def note_below(figure: Figure, text: str) -> None:
    """Add a remark under a figure."""
    if text:
        figure.supxlabel(text, x=0.01, ha="left", **plain(SMALL, QUIET))


@own_look()
def figure_bytes(figure: Figure, kind: str = "png") -> bytes:
    """Return a figure as a reproducible "png", "pdf" or "svg" file."""
    canvas, buffer = FigureCanvasAgg(figure), io.BytesIO()
    if kind == "png":  # 256 colours take a third of the size
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        image = Image.fromarray(pixels).convert("RGB").quantize(256, dither=Image.Dither.NONE)
        image.save(buffer, "PNG", optimize=True, dpi=(DPI, DPI))
    else:
        undated = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
        figure.savefig(buffer, format=kind, metadata=undated[kind])
    return buffer.getvalue()
