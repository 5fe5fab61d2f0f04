"""Bodies as ellipsoids in MeshCat, over a robot that is there or over its lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Ellipsoid, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import Context

from geodrake.boundary.escaping import html_text, path_part
from geodrake.inertia.bodies import lumped_bodies
from geodrake.report.ellipsoids import (
    AT_BOUNDARY,
    BOUNDARY,
    EllipsoidSet,
    SkeletonLines,
    placed,
    skeleton,
)
from geodrake.report.robot_scene import calm_meshcat
from geodrake.robot.files.description import drake_messages

_OPAQUE = 0.55
_INK = Rgba(0.12, 0.16, 0.22, 1.0)
_LEAST_GAP = 0.3  # m


class MeshcatEllipsoids:
    """Ellipsoids of one or more models of a robot in a running MeshCat.

    Each set is a folder of the scene, to be shown or hidden in MeshCat's controls. `update` moves
    the ellipsoids with the robot; called with a time it adds to MeshCat's recording.

    Args:
        path: Folder of the scene to draw in; what was in it is deleted.
        spacing: Distance in y by which sets are drawn beside each other, m; 0 to draw them over
            each other.

    Raises:
        ArgumentError: A set does not fit the plant, or is not physical.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        plant: MultibodyPlant,
        sets: Sequence[EllipsoidSet],
        *,
        path: str = "ellipsoids",
        spacing: float = 0.0,
    ) -> None:
        self._meshcat, self._plant, self._sets = meshcat, plant, tuple(sets)
        self._shifts = [np.array([0.0, k * spacing, 0.0]) for k in range(len(self._sets))]
        names = [path_part(body.name) for body in lumped_bodies(plant)]
        self._paths = [
            [f"{path}/{path_part(one.name)}/{name}" for name in names] for one in self._sets
        ]
        context = plant.CreateDefaultContext()
        meshcat.Delete(path)
        for one, paths in zip(self._sets, self._paths, strict=True):
            bodies = placed(plant, context, one.phi)
            for k, (place, semi_axes) in enumerate(zip(paths, bodies.semi_axes, strict=True)):
                opaque = 0.8 if one.at_boundary[k] else _OPAQUE
                color = Rgba(*to_rgb(one.body_color(k)), opaque)
                meshcat.SetObject(place, Ellipsoid(*semi_axes), color)
        self.update(context)

    def update(self, context: Context, time: float | None = None) -> None:
        """Put the ellipsoids where the bodies are.

        Args:
            time: Time in MeshCat's recording, s; None to move them now only.
        """
        for one, paths, shift in zip(self._sets, self._paths, self._shifts, strict=True):
            bodies = placed(self._plant, context, one.phi)
            for place, R_WE, center in zip(paths, bodies.rotation, bodies.center, strict=True):
                X_WE = RigidTransform(RotationMatrix(R_WE), center + shift)
                self._meshcat.SetTransform(place, X_WE, time)


def ellipsoid_page(
    plant: MultibodyPlant, sets: Sequence[EllipsoidSet], *, context: Context | None = None
) -> str:
    """Return one HTML page that loads nothing from elsewhere, with the sets side by side."""
    context = plant.CreateDefaultContext() if context is None else context
    lines = skeleton(plant, context)
    ends = lines.reshape(-1, 3)
    clouds = [placed(plant, context, one.phi).points(8).reshape(-1, 3) for one in sets]
    # Distance at which the sets do not overlap, m.
    spacing = float(1.1 * np.ptp(np.concatenate([*clouds, ends])[:, 1]) + _LEAST_GAP)
    with drake_messages():  # where MeshCat listens does not matter for a page
        meshcat = calm_meshcat()
        MeshcatEllipsoids(meshcat, plant, sets, spacing=spacing).update(context)
        for k, one in enumerate(sets):
            path, shift = f"robot/{path_part(one.name)}", np.array([0.0, k * spacing, 0.0])
            SkeletonLines(meshcat, path, len(lines), _INK).move(lines + shift)
        middle = ends.mean(0) + np.array([0.0, 0.5 * (len(sets) - 1) * spacing, 0.0])
        size = np.ptp(ends, axis=0).max()
        far = max(0.55 * spacing * len(sets), 0.6 * size) + 0.5 * size
        meshcat.SetCameraPose(middle + far * np.array([0.9, -0.2, 0.4]), middle)
        page = meshcat.StaticHtml()
    entries = [(one.color, one.name) for one in sets]
    if any(one.at_boundary.any() for one in sets):
        entries.append((BOUNDARY, AT_BOUNDARY))
    return legend(page, entries)


def legend(page: str, entries: Sequence[tuple[str, str]]) -> str:
    """Return a page of MeshCat's with what its colours mean over the scene."""
    spans = "".join(
        f'<div><span style="display:inline-block;width:12px;height:12px;margin-right:8px;'
        f'border-radius:6px;background:{color}"></span>{html_text(name)}</div>'
        for color, name in entries
    )
    box = (
        '<div style="position:absolute;left:16px;top:16px;padding:10px 14px;background:#ffffffd0;'
        f'font:14px/1.6 sans-serif;color:#1f2a37;pointer-events:none">{spans}</div>'
    )
    head, _, foot = page.rpartition("</body>")
    return f"{head}{box}</body>{foot}"
