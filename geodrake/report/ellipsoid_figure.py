"""A figure of bodies as ellipsoids: the robot's lines, one panel for each model of it."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import (  # type: ignore[import-untyped]
    Line3DCollection,
    Poly3DCollection,
)
from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.report import style
from geodrake.report.ellipsoids import (
    BOUNDARY,
    EllipsoidSet,
    PlacedEllipsoids,
    placed,
    skeleton,
)

_LIGHT = np.array([0.45, -0.6, 0.66])
_MOST_COLUMNS = 3
_OPAQUE = 0.62
_SEEN = 1.85  # side of what a 3-D axes shows, in matplotlib's units of a box
_DIAGONAL = 1.906  # of a box at zoom 1
_FILLED = 0.76  # share of a panel's width for the box; tick labels need the rest
_ABOVE, _BELOW, _TITLE = 0.62, 0.3, 0.75  # inches for the legend, the note, a title and ticks


@style.own_look()
def ellipsoid_figure(
    plant: MultibodyPlant,
    sets: Sequence[EllipsoidSet],
    *,
    context: Context | None = None,
    view: tuple[float, float] = (18.0, -62.0),
) -> Figure:
    """The equivalent uniform ellipsoids of every body over the robot, a panel for each set.

    Bodies at the boundary of physical consistency are red, with their edges drawn. All panels
    have the same scale.

    Args:
        context: The plant's context, for its positions; the default ones if None.

    Raises:
        ArgumentError: There is nothing to draw, or a set does not fit the plant.
    """
    if not sets:
        raise ArgumentError("There is nothing to draw.", advice="Give at least one set.")
    if context is None:
        context = plant.CreateDefaultContext()
    lines = skeleton(plant, context)
    drawn = [placed(plant, context, one.phi) for one in sets]
    center, reach = _box([*(e.points(8).reshape(-1, 3) for e in drawn), lines.reshape(-1, 3)])
    sheet = _Sheet.of(len(sets), reach, view)
    figure = style.new_figure(sheet.height)
    figure.set_layout_engine("none")
    for k, (one, bodies) in enumerate(zip(sets, drawn, strict=True)):
        ax: Axes3D = figure.add_axes(sheet.square(k), projection="3d", facecolor="none")
        _draw(ax, one, bodies, lines)
        _frame(ax, center, reach, view)
        ax.set_box_aspect(tuple(reach), zoom=sheet.zoom)
        figure.text(*sheet.title(k), one.name, ha="center", **style.plain(fontweight="bold"))
    _legend(figure, sets)
    words = (
        "Each body as the uniform ellipsoid with its mass, centre of mass and inertia; axes in m."
    )
    figure.text(0.012, 0.12 / sheet.height, words, **style.plain(style.SMALL, style.QUIET))
    return figure


@style.own_look()
def figure_bytes(figure: Figure, kind: str = "png") -> bytes:
    """A figure as the bytes of a file: "png", "pdf" or "svg"."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    dated = {"svg": "Date", "pdf": "CreationDate"}
    figure.savefig(buffer, format=kind, metadata={dated[kind]: None} if kind in dated else None)
    return buffer.getvalue()


@dataclass(frozen=True)
class _Sheet:
    """Where panels go: square axes, as matplotlib wants them, over panels that are as low as fits.

    Attributes:
        columns: Panels beside each other.
        width: Width of a panel, inches.
        panel: Height of a panel, inches.
        height: Height of the figure, inches.
    """

    columns: int
    width: float
    panel: float
    height: float
    zoom: float

    @classmethod
    def of(cls, count: int, reach: Array, view: tuple[float, float]) -> _Sheet:
        columns = min(_MOST_COLUMNS, count)
        width = style.WIDTH / columns
        up, around = np.deg2rad(view)
        right = np.abs([np.sin(around), np.cos(around), 0.0])
        above = np.abs([np.sin(up) * np.cos(around), np.sin(up) * np.sin(around), np.cos(up)])
        shape = _DIAGONAL * reach / np.linalg.norm(reach)
        zoom = _FILLED * _SEEN / max(right @ shape, above @ shape)
        panel = width * zoom * float(above @ shape) / _SEEN + _TITLE
        height = panel * -(-count // columns) + _ABOVE + _BELOW
        return cls(columns, width, float(panel), float(height), float(zoom))

    def title(self, k: int) -> tuple[float, float]:
        """Place of a panel's title, as shares of the figure."""
        return (k % self.columns + 0.5) * self.width / style.WIDTH, 1 - self._top(k) / self.height

    def square(self, k: int) -> tuple[float, float, float, float]:
        """Rectangle of a panel's axes, as shares of the figure."""
        middle = self._top(k) + 0.5 * self.panel - 0.1
        low = 1 - (middle + 0.5 * self.width) / self.height
        size = self.width / style.WIDTH, self.width / self.height
        return k % self.columns * size[0], low, *size

    def _top(self, k: int) -> float:
        return _ABOVE + k // self.columns * self.panel + 0.1


def _legend(figure: Figure, sets: Sequence[EllipsoidSet]) -> None:
    handles: list[Patch | Line2D] = [
        Patch(facecolor=one.color, alpha=_OPAQUE, label=one.name) for one in sets
    ]
    if any(one.at_boundary.any() for one in sets):
        words = "at the boundary of what a body can be"
        patch = Patch(facecolor=BOUNDARY, edgecolor=style.INK, hatch="////", label=words)
        handles.append(patch)
    handles.append(Line2D([], [], color=style.INK, linewidth=1.6, label="robot"))
    figure.legend(
        handles=handles,
        loc="upper left",
        ncols=4,
        frameon=False,
        fontsize=style.SMALL + 0.5,
        labelcolor=style.INK,
    )


def _draw(ax: Axes3D, one: EllipsoidSet, bodies: PlacedEllipsoids, lines: Array) -> None:
    """All faces of a panel in one collection, so that matplotlib sorts them by depth together."""
    points = bodies.points()
    corners = [points[:, :-1, :-1], points[:, 1:, :-1], points[:, 1:, 1:], points[:, :-1, 1:]]
    faces = np.stack(corners, 3)
    around = np.cross(faces[..., 2, :] - faces[..., 0, :], faces[..., 3, :] - faces[..., 1, :])
    length = np.linalg.norm(around, axis=-1, keepdims=True)
    bright = 0.75 + 0.25 * (around / np.where(length > 0, length, 1.0)) @ _LIGHT
    colors = np.array([to_rgb(one.body_color(k)) for k in range(len(points))])
    shaded = np.empty((*bright.shape, 4))
    shaded[..., :3] = colors[:, None, None] * bright[..., None]
    shaded[..., 3] = _OPAQUE
    marked = one.at_boundary[:, None, None, None]
    edges = np.where(marked, [*to_rgb(BOUNDARY), 0.9], 0.0 * shaded)
    mesh = Poly3DCollection(
        faces.reshape(-1, 4, 3),
        facecolors=np.clip(shaded, 0, 1).reshape(-1, 4),
        edgecolors=edges.reshape(-1, 4),
        linewidths=0.6,
    )
    ax.add_collection3d(mesh)
    robot = Line3DCollection(lines, colors=style.INK, linewidths=1.6)
    robot.set_zorder(10)
    ax.add_collection3d(robot)


def _box(clouds: Sequence[Array]) -> tuple[Array, Array]:
    """Middle and half lengths of what is drawn, m."""
    points = np.concatenate(clouds)
    low, high = points.min(0), points.max(0)
    least = 0.15 * (high - low).max()
    return 0.5 * (low + high), np.maximum(0.5 * (high - low), least) * 1.03


def _frame(ax: Axes3D, center: Array, reach: Array, view: tuple[float, float]) -> None:
    for axis, middle, half in zip("xyz", center, reach, strict=True):
        getattr(ax, f"set_{axis}lim")(middle - half, middle + half)
        getattr(ax, f"{axis}axis").set_pane_color((1.0, 1.0, 1.0, 0.0))
        getattr(ax, f"{axis}axis")._axinfo["grid"].update(color=style.RULE, linewidth=0.4)
    ax.view_init(*view)
    ax.locator_params(nbins=4)
    ax.tick_params(labelsize=6.5, labelcolor=style.QUIET, pad=-1)
