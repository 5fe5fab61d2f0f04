"""Figures of matplotlib as parts of a page."""

from __future__ import annotations

import base64
from collections.abc import Mapping

from markupsafe import Markup
from matplotlib.figure import Figure

from geodrake.report.page import Picture
from geodrake.report.style import png, svg

_LARGEST_SVG = 120_000
"""Figures of more letters are shown as pixels."""


def picture(figure: Figure, caption: str) -> Picture:
    """A figure as an image that is part of the page."""
    drawn = svg(figure)
    if len(drawn) <= _LARGEST_SVG:
        return Picture("", caption, Markup(drawn))  # matplotlib escapes what it writes
    return Picture(f"data:image/png;base64,{base64.b64encode(png(figure)).decode()}", caption)


def pictures(figures: Mapping[str, Figure], captions: Mapping[str, str]) -> tuple[Picture, ...]:
    """The figures that have captions, in the order of the captions."""
    return tuple(picture(figures[name], text) for name, text in captions.items() if name in figures)
