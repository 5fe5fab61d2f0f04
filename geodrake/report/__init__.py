"""Pages, figures and JSON of results, for terminals, HTML and notebooks.

`render(page_of(result))` is a self-contained HTML page, `figures_of(page_of(result))` its charts as
matplotlib figures.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geodrake.report.ellipsoids import AdaptationView, save_recording
    from geodrake.report.figures import figures_of, save_figures
    from geodrake.report.html import render
    from geodrake.report.numbers import Units
    from geodrake.report.page import About, Page
    from geodrake.report.terminal import show_page
    from geodrake.report.views import page_of

__all__ = [
    "About",
    "AdaptationView",
    "Page",
    "Units",
    "figures_of",
    "page_of",
    "render",
    "save_figures",
    "save_recording",
    "show_page",
]

_MODULES = ("numbers", "page", "html", "terminal", "views", "figures", "ellipsoids")


def __getattr__(name: str) -> Any:
    """Import matplotlib when a figure is first requested."""
    if name in __all__:
        for module in _MODULES:
            found = vars(import_module(f"geodrake.report.{module}"))
            if name in found:
                return found[name]
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
