"""A figure of bodies as ellipsoids: the robot's lines, one panel for each model of it."""

from __future__ import annotations

import io
from collections.abc import Sequence

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
    AT_BOUNDARY,
    BOUNDARY,
    EllipsoidSet,
    PlacedEllipsoids,
    placed,
    skeleton,
)

_LIGHT = np.array([0.45, -0.6, 0.66])
_MOST_COLUMNS = 3
_OPAQUE, _ZOOM, _VIEW = 0.62, 1.15, (18.0, -62.0)  # of elevation and azimuth, degrees
_WORDS = "Each body as the uniform ellipsoid with its mass, centre of mass and inertia; axes in m."


@style.own_look()
def ellipsoid_figure(
    plant: MultibodyPlant,
    sets: Sequence[EllipsoidSet],
    *,
    context: Context | None = None,
) -> Figure:
    """Return the equivalent uniform ellipsoids of every body over the robot, a panel for each set.

    Bodies at the boundary of physical consistency are red, with their edges drawn. All panels
    have the same scale.

    Args:
        context: The plant's context, for its positions; the default ones if None.

    Raises:
        ArgumentError: There is nothing to draw, or a set does not fit the plant.
    """
    if not sets:
        raise ArgumentError("There is nothing to draw.", advice="Give at least one set.")
    context = plant.CreateDefaultContext() if context is None else context
    lines = skeleton(plant, context)
    drawn = [placed(plant, context, one.phi) for one in sets]
    points = np.concatenate([*(e.points(8).reshape(-1, 3) for e in drawn), lines.reshape(-1, 3)])
    low, high = points.min(0), points.max(0)
    reach = 1.03 * np.maximum(0.5 * (high - low), 0.15 * (high - low).max())
    columns = min(_MOST_COLUMNS, len(sets))
    rows = -(-len(sets) // columns)
    figure = style.new_figure(0.8 + 0.95 * rows * style.WIDTH / columns)
    grid = figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": "3d"}).ravel()
    for ax in grid[len(sets) :]:
        ax.remove()
    for ax, one, bodies in zip(grid, sets, drawn, strict=False):
        _draw(ax, one, bodies, lines)
        for axis, middle, half in zip("xyz", 0.5 * (low + high), reach, strict=True):
            getattr(ax, f"set_{axis}lim")(middle - half, middle + half)
            getattr(ax, f"{axis}axis").set_pane_color((1.0, 1.0, 1.0, 0.0))
            getattr(ax, f"{axis}axis")._axinfo["grid"].update(color=style.RULE, linewidth=0.4)
        ax.view_init(*_VIEW)
        ax.locator_params(nbins=4)
        ax.tick_params(labelsize=6.5, labelcolor=style.QUIET, pad=-1)
        ax.set_box_aspect(tuple(reach), zoom=_ZOOM)
        ax.set_title(one.name, **style.plain(fontweight="bold"))
    handles: list[Patch | Line2D] = [
        Patch(facecolor=one.color, alpha=_OPAQUE, label=one.name) for one in sets
    ]
    if any(one.at_boundary.any() for one in sets):
        patch = Patch(facecolor=BOUNDARY, edgecolor=style.INK, hatch="////", label=AT_BOUNDARY)
        handles.append(patch)
    handles.append(Line2D([], [], color=style.INK, linewidth=1.6, label="robot"))
    style.legend_above(figure, handles)
    style.note_below(figure, _WORDS)
    return figure


@style.own_look()
def figure_bytes(figure: Figure, kind: str = "png") -> bytes:
    """Return a figure as the bytes of a file: "png", "pdf" or "svg"."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    dated = {"svg": "Date", "pdf": "CreationDate"}
    figure.savefig(buffer, format=kind, metadata={dated[kind]: None} if kind in dated else None)
    return buffer.getvalue()


def _draw(ax: Axes3D, one: EllipsoidSet, bodies: PlacedEllipsoids, lines: Array) -> None:
    """Draw a panel's faces as one collection, so that matplotlib sorts them by depth together."""
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
