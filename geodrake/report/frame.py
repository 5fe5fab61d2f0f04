"""The part of the plane that a plot shows, and paths in it as SVG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WIDTH, HEIGHT = 1000, 240
"""Size of the SVG's own coordinates, which are whole numbers."""


@dataclass(frozen=True)
class Frame:
    """The part of the plane that a plot shows."""

    x: tuple[float, float]
    y: tuple[float, float]

    def across(self, x: Array) -> Array:
        """Horizontal places in the SVG's coordinates."""
        return (x - self.x[0]) * (WIDTH / (self.x[1] - self.x[0]))

    def down(self, y: Array) -> Array:
        """Vertical places in the SVG's coordinates, a little beyond its ends at most."""
        places = (self.y[1] - y) * (HEIGHT / (self.y[1] - self.y[0]))
        return np.clip(places, -0.5 * HEIGHT, 1.5 * HEIGHT)

    def line(self, x: Array, y: Array) -> str:
        """A path that breaks where a value is missing.

        Args:
            x: (K,) horizontal values.
            y: (K,) vertical values.
        """
        known = np.isfinite(x) & np.isfinite(y)
        whole = np.zeros((len(x), 2), int)
        whole[known] = np.round(np.column_stack([self.across(x), self.down(y)])[known])
        parts, runs = [], np.flatnonzero(np.diff(np.concatenate([[False], known, [False]])))
        for first, last in zip(runs[::2].tolist(), runs[1::2].tolist(), strict=True):
            start, steps = whole[first], np.diff(whole[first:last], axis=0)
            rest = " ".join(f"{dx},{dy}" for dx, dy in steps.tolist())
            parts.append(f"M{start[0]},{start[1]}l{rest or '0,0'}")
        return "".join(parts)

    def dots(self, x: Array, y: Array) -> str:
        """A path of dots, each a line of no length.

        Args:
            x: (K,) horizontal values.
            y: (K,) vertical values.
        """
        known = np.isfinite(x) & np.isfinite(y)
        places = np.round(np.column_stack([self.across(x), self.down(y)])[known]).astype(int)
        steps = np.diff(places, axis=0, prepend=np.zeros((1, 2), int))
        return "".join(f"m{dx},{dy}h0" for dx, dy in steps.tolist())
