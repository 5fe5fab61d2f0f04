"""Figures, pages and a live view of bodies as uniform ellipsoids with the same inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.colors import LightSource, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]
from numpy.typing import NDArray
from pydrake import geometry
from pydrake.geometry import Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    EventStatus,
    LeafSystem,
)

from geodrake.boundary.arguments import typed
from geodrake.boundary.escaping import path_part
from geodrake.boundary.whole_files import write_whole
from geodrake.control.loops import AdaptiveLoop
from geodrake.errors import ArgumentError
from geodrake.identification.models import ModelIdentification
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical
from geodrake.inertia.bodies import lumped_bodies
from geodrake.inertia.ellipsoids import Ellipsoid, equivalent_ellipsoid
from geodrake.report import style
from geodrake.report.meshcat_scene import LEAST_THICKNESS, calm_meshcat, legend
from geodrake.robot.joints import joints_of

PRIOR, IDENTIFIED, TRUTH = "#8a94a0", "#1b6ca8", "#3f9c6b"
BOUNDARY, AT_BOUNDARY = "#c8322b", "at the boundary of physically valid inertias"
OTHERS = ("#7a4fa3", "#c78a1e", "#2a8f8f", "#a34f6e", "#5b7a2a")
"""Colours of prior, identified, truth, bodies at the boundary, and regularizers."""

FRAME_PERIOD = 1.0 / 32.0  # time between two pictures, s, close to that of MeshCat's recordings

_POINT = np.array([1.0, 0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6, 0.0, 0.0, 0.0])
"""Replaces bodies that cannot be drawn."""

_LINE_WIDTH, _SHORTEST = 0.006, 1e-4  # m
_LEAST_GAP = 0.3  # m
_LIGHT = LightSource(azdeg=143.0, altdeg=41.0)
_MOST_COLUMNS = 3
_OPACITY, _ZOOM, _VIEW = 0.62, 1.15, (18.0, -62.0)  # elevation and azimuth, degrees
_WORDS = (
    "Each body as the uniform ellipsoid with the same mass, centre of mass and inertia; axes in m."
)


@dataclass(frozen=True, eq=False)
class EllipsoidSet:
    """The bodies of one model of a robot."""

    name: str  # such as "prior" or "truth"
    color: str  # colour of its bodies, #rrggbb
    phi: Array  # (nb, 10) physical inertial parameters, bodies in the order of `lumped_bodies`
    # (nb,) whether a body is at the boundary of physical consistency.
    at_boundary: NDArray[np.bool_]

    @classmethod
    def of(
        cls, name: str, phi: Array, *, color: str = IDENTIFIED, at_boundary: Sequence[int] = ()
    ) -> EllipsoidSet:
        """Return a set of φ (nb, 10) with the given indices of bodies at the boundary."""
        phi = np.asarray(phi, float)
        if phi.ndim != 2 or phi.shape[1] != PARAMETERS_PER_BODY:
            raise ArgumentError(f"phi must have shape (nb, 10); got {phi.shape}.")
        marks = np.zeros(len(phi), bool)
        marks[list(at_boundary)] = True
        return cls(name, color, phi, marks)

    def body_color(self, body: int) -> str:
        """Return the colour of a body: the set's, or that of the boundary."""
        return BOUNDARY if self.at_boundary[body] else self.color


def surface(bodies: Ellipsoid, around: int = 20) -> Array:
    """Return a grid of points (nb, around // 2 + 1, around + 1, 3) on the surfaces."""
    polar = np.linspace(0.0, np.pi, around // 2 + 1)[:, None]
    azimuth = np.linspace(0.0, 2 * np.pi, around + 1)
    sides = np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)
    sphere = np.stack(np.broadcast_arrays(*sides), -1)
    local = sphere * bodies.semi_axes[:, None, None]
    return np.asarray(
        bodies.center[:, None, None] + np.einsum("bij,bklj->bkli", bodies.rotation, local)
    )


def placed(plant: MultibodyPlant, context: Context, phi: Array) -> Ellipsoid:
    """Return the ellipsoids of physical φ (nb, 10) in the world, in the posture of a context."""
    bodies = lumped_bodies(plant)
    if len(phi) != len(bodies):
        raise ArgumentError(f"phi has {len(phi)} bodies, but the plant has {len(bodies)}.")
    poses = [plant.EvalBodyPoseInWorld(context, plant.get_body(b.body_index)) for b in bodies]
    R_WB = np.array([pose.rotation().matrix() for pose in poses])
    p_WB = np.array([pose.translation() for pose in poses])
    local = equivalent_ellipsoid(phi, least_semi_axis=LEAST_THICKNESS)
    center = p_WB + np.einsum("bij,bj->bi", R_WB, local.center)
    return Ellipsoid(center, local.semi_axes, R_WB @ local.rotation)


def skeleton(plant: MultibodyPlant, context: Context) -> Array:
    """Return the robot as lines from joint to joint, by their ends (k, 2, 3) in the world, m."""
    ends = []
    for joint in joints_of(plant):
        parent = plant.EvalBodyPoseInWorld(context, joint.parent_body()).translation()
        child = plant.EvalBodyPoseInWorld(context, joint.child_body()).translation()
        on_parent = joint.frame_on_parent().CalcPoseInWorld(context).translation()
        on_child = joint.frame_on_child().CalcPoseInWorld(context).translation()
        ends += [(parent, on_parent), (on_parent, on_child), (on_child, child)]
    lines = np.array(ends).reshape(-1, 2, 3)
    return lines[np.linalg.norm(lines[:, 1] - lines[:, 0], axis=-1) > 1e-6]


class SkeletonLines:
    """Lines of a robot in MeshCat, each with a ball at its start."""

    def __init__(self, meshcat: Meshcat, path: str, count: int, color: Rgba) -> None:
        self._meshcat, self._path = meshcat, path
        for k in range(count):
            meshcat.SetObject(f"{path}/{k}/shape", Cylinder(_LINE_WIDTH, 1.0), color)
            meshcat.SetObject(f"{path}/{k}/end", Sphere(2 * _LINE_WIDTH), color)

    def move(self, lines: Array, time: float | None = None) -> None:
        """Move the lines to ends (k, 2, 3) as from `skeleton`, optionally at a time, s."""
        for k, (start, end) in enumerate(lines):
            length = float(np.linalg.norm(end - start))
            direction = (end - start) / length if length > 0 else np.array([0.0, 0.0, 1.0])
            R_WL = RotationMatrix.MakeFromOneVector(direction, 2)
            path = f"{self._path}/{k}"
            self._meshcat.SetTransform(path, RigidTransform(R_WL, 0.5 * (start + end)), time)
            scale = [1.0, 1.0, max(length, _SHORTEST)]
            self._meshcat.SetProperty(f"{path}/shape", "scale", scale, time)
            half = RigidTransform([0.0, 0.0, -0.5 * length])
            self._meshcat.SetTransform(f"{path}/end", half, time)


def identification_sets(found: ModelIdentification) -> tuple[EllipsoidSet, ...]:
    """Return the prior and identified bodies, and those of the other compared regularizers."""
    others = [other for other in found.alternatives if other.regularizer != found.regularizer]
    models = [
        (f"identified, {found.regularizer}", found.model.phi, found.at_boundary),
        *((other.regularizer, other.phi, other.at_boundary) for other in others),
    ]
    sets = [EllipsoidSet.of("prior", found.prior.phi, color=PRIOR)]
    for (name, phi, boundary), color in zip(models, cycle((IDENTIFIED, *OTHERS)), strict=False):
        indices = [k for k, body in enumerate(found.model.bodies) if body in boundary]
        sets.append(EllipsoidSet.of(name, phi, color=color, at_boundary=indices))
    return tuple(sets)


def ellipsoid_page(
    plant: MultibodyPlant, sets: Sequence[EllipsoidSet], *, context: Context | None = None
) -> str:
    """Return a self-contained HTML page with the sets side by side."""
    context = plant.CreateDefaultContext() if context is None else context
    lines = skeleton(plant, context)
    ends = lines.reshape(-1, 3)
    clouds = [
        surface(placed(plant, context, ellipsoids.phi), 8).reshape(-1, 3) for ellipsoids in sets
    ]
    # Distance at which the sets do not overlap, m.
    spacing = float(1.1 * np.ptp(np.concatenate([*clouds, ends])[:, 1]) + _LEAST_GAP)
    meshcat = calm_meshcat()
    for k, ellipsoids in enumerate(sets):
        name, shift = path_part(ellipsoids.name), np.array([0.0, k * spacing, 0.0])
        bodies = placed(plant, context, ellipsoids.phi)
        for body, lump in enumerate(lumped_bodies(plant)):
            path = f"ellipsoids/{name}/{path_part(lump.name)}"
            opacity = 0.8 if ellipsoids.at_boundary[body] else 0.55
            color = Rgba(*to_rgb(ellipsoids.body_color(body)), opacity)
            meshcat.SetObject(path, geometry.Ellipsoid(*bodies.semi_axes[body]), color)
            R_WE = RotationMatrix(bodies.rotation[body])
            meshcat.SetTransform(path, RigidTransform(R_WE, bodies.center[body] + shift))
        robot = SkeletonLines(meshcat, f"robot/{name}", len(lines), Rgba(*to_rgb(style.INK)))
        robot.move(lines + shift)
    middle = ends.mean(0) + np.array([0.0, 0.5 * (len(sets) - 1) * spacing, 0.0])
    size = np.ptp(ends, axis=0).max()
    distance = max(0.55 * spacing * len(sets), 0.6 * size) + 0.5 * size
    meshcat.SetCameraPose(middle + distance * np.array([0.9, -0.2, 0.4]), middle)
    entries = [(ellipsoids.color, ellipsoids.name) for ellipsoids in sets]
    if any(ellipsoids.at_boundary.any() for ellipsoids in sets):
        entries.append((BOUNDARY, AT_BOUNDARY))
    return legend(meshcat.StaticHtml(), entries)


@style.own_look()
def ellipsoid_figure(
    plant: MultibodyPlant, sets: Sequence[EllipsoidSet], *, context: Context | None = None
) -> Figure:
    """Return the equivalent uniform ellipsoids of every body on the robot, a panel for each set.

    Bodies at the boundary of physical consistency are red with drawn edges. Without a context, the
    robot is in its default posture.
    """
    if not sets:
        raise ArgumentError("There is nothing to draw.", advice="Give at least one set.")
    context = plant.CreateDefaultContext() if context is None else context
    lines = skeleton(plant, context)
    drawn = [placed(plant, context, ellipsoids.phi) for ellipsoids in sets]
    points = np.concatenate([*(surface(e, 8).reshape(-1, 3) for e in drawn), lines.reshape(-1, 3)])
    low, high = points.min(0), points.max(0)
    reach = 1.03 * np.maximum(0.5 * (high - low), 0.15 * (high - low).max())
    columns = min(_MOST_COLUMNS, len(sets))
    rows = -(-len(sets) // columns)
    figure = style.new_figure(0.8 + 0.95 * rows * style.WIDTH / columns)
    grid = figure.subplots(rows, columns, squeeze=False, subplot_kw={"projection": "3d"}).ravel()
    for ax in grid[len(sets) :]:
        ax.remove()
    for ax, ellipsoids, bodies in zip(grid, sets, drawn, strict=False):
        _draw_panel(ax, ellipsoids, bodies, lines)
        for axis, middle, half in zip("xyz", 0.5 * (low + high), reach, strict=True):
            getattr(ax, f"set_{axis}lim")(middle - half, middle + half)
            getattr(ax, f"{axis}axis").set_pane_color((1.0, 1.0, 1.0, 0.0))
            getattr(ax, f"{axis}axis")._axinfo["grid"].update(color=style.RULE, linewidth=0.4)
        ax.view_init(*_VIEW)
        ax.locator_params(nbins=4)
        ax.tick_params(labelsize=6.5, labelcolor=style.QUIET, pad=-1)
        ax.set_box_aspect(tuple(reach), zoom=_ZOOM)
        ax.set_title(ellipsoids.name, **style.plain(fontweight="bold"))
    handles: list[Patch | Line2D] = [
        Patch(facecolor=ellipsoids.color, alpha=_OPACITY, label=ellipsoids.name)
        for ellipsoids in sets
    ]
    if any(ellipsoids.at_boundary.any() for ellipsoids in sets):
        patch = Patch(facecolor=BOUNDARY, edgecolor=style.INK, hatch="////", label=AT_BOUNDARY)
        handles.append(patch)
    handles.append(Line2D([], [], color=style.INK, linewidth=1.6, label="robot"))
    style.legend_above(figure, handles)
    style.note_below(figure, _WORDS)
    return figure


def _draw_panel(ax: Axes3D, ellipsoids: EllipsoidSet, bodies: Ellipsoid, lines: Array) -> None:
    for body, points in enumerate(surface(bodies)):
        ax.plot_surface(
            *points[::-1].transpose(2, 0, 1),
            rstride=1,
            cstride=1,
            color=ellipsoids.body_color(body),
            alpha=_OPACITY,
            edgecolor=BOUNDARY if ellipsoids.at_boundary[body] else "none",
            lightsource=_LIGHT,
        )
    ax.add_collection3d(Line3DCollection(lines, colors=style.INK, linewidths=1.6))


class AdaptationView(LeafSystem):
    """Shows an arm, the ellipsoids of its estimated bodies, and the desired pose.

    .. pydrake_system::

        name: AdaptationView
        input_ports:
        - state
        - desired_state
        - parameters

    Every body is drawn as the uniform ellipsoid that has its estimated inertia. If an estimate is
    not physical, the body turns red and keeps its last shape. The robot is drawn as lines, the
    desired pose as paler ones; poses that are not finite are not drawn. MeshCat can record the
    view.

    Args:
        parameters: Length of the port `parameters`, inertial parameters first.
        path: Folder of the scene to draw in; its content is deleted.
        period: Time between two pictures, s.

    Raises:
        ArgumentError: There are fewer than ten parameters for each body.
    """

    @typed
    def __init__(
        self,
        plant: MultibodyPlant,
        meshcat: Meshcat,
        parameters: int,
        *,
        path: str = "adaptation",
        period: float = FRAME_PERIOD,
    ) -> None:
        LeafSystem.__init__(self)
        self._plant, self._meshcat, self._path = plant, meshcat, path
        self._scratch = plant.CreateDefaultContext()
        self._bodies = [path_part(body.name) for body in lumped_bodies(plant)]
        if parameters < PARAMETERS_PER_BODY * len(self._bodies):
            raise ArgumentError(
                f"{len(self._bodies)} bodies have ten parameters each, but the estimate has "
                f"{parameters}."
            )
        states = plant.num_positions() + plant.num_velocities()
        self._state = self.DeclareVectorInputPort("state", BasicVector(states))
        self._desired = self.DeclareVectorInputPort("desired_state", BasicVector(states))
        self._estimate = self.DeclareVectorInputPort("parameters", BasicVector(parameters))
        self.DeclarePeriodicPublishEvent(period, 0.0, self._draw)
        self.DeclareForcedPublishEvent(self._draw)
        meshcat.Delete(path)
        ends = skeleton(plant, self._scratch)
        points = ends.reshape(-1, 3)
        middle, size = points.mean(0), float(np.ptp(points, axis=0).max())
        meshcat.SetCameraPose(middle + size * np.array([1.4, -1.1, 0.7]), middle)
        self._lines = {
            name: SkeletonLines(meshcat, f"{path}/{name}", len(ends), Rgba(*to_rgb(color), opacity))
            for name, color, opacity in (("robot", style.INK, 1.0), ("desired", IDENTIFIED, 0.25))
        }
        for name in self._bodies:
            for shape, color in (("shape", IDENTIFIED), ("unphysical", BOUNDARY)):
                rgba = Rgba(*to_rgb(color), 0.5)
                meshcat.SetObject(f"{path}/estimate/{name}/{shape}", Sphere(1.0), rgba)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        loop: AdaptiveLoop,
        meshcat: Meshcat,
        *,
        path: str = "adaptation",
        period: float = FRAME_PERIOD,
    ) -> AdaptationView:
        """Add a view of an adaptive loop and connect it.

        Args:
            period: Time between two pictures, s.

        Raises:
            ArgumentError: The plant has more than one robot.
        """
        if loop.robot is None or loop.robot.name is not None:
            raise ArgumentError(
                "A view of adaptation needs a plant with a single robot.",
                advice="Show the whole scene with MeshcatVisualizer.AddToBuilder.",
            )
        size = loop.parameters.size()
        view = builder.AddSystem(
            AdaptationView(loop.plant, meshcat, size, path=path, period=period)
        )
        builder.Connect(loop.state, view.GetInputPort("state"))
        builder.Connect(loop.desired_state, view.GetInputPort("desired_state"))
        builder.Connect(loop.parameters, view.GetInputPort("parameters"))
        return view

    def _draw(self, context: Context) -> EventStatus:
        time, n = context.get_time(), self._plant.num_positions()
        desired, q = (port.Eval(context)[:n] for port in (self._desired, self._state))
        for name, posture in (("desired", desired), ("robot", q)):
            if np.isfinite(posture).all():
                self._plant.SetPositions(self._scratch, posture)
                self._lines[name].move(skeleton(self._plant, self._scratch), time)
        if not np.isfinite(q).all():
            return EventStatus.Succeeded()
        phi = self._estimate.Eval(context)[: PARAMETERS_PER_BODY * len(self._bodies)]
        phi = phi.reshape(-1, PARAMETERS_PER_BODY)
        physical = np.isfinite(phi).all(1) & is_physical(np.nan_to_num(phi))
        shown = np.where(physical[:, None], phi, _POINT)
        bodies = placed(self._plant, self._scratch, shown)
        for k, name in enumerate(self._bodies):
            path = f"{self._path}/estimate/{name}"
            for shape, visible in (("shape", physical[k]), ("unphysical", not physical[k])):
                self._meshcat.SetProperty(f"{path}/{shape}", "visible", bool(visible), time)
                if physical[k]:
                    scale = bodies.semi_axes[k].tolist()
                    self._meshcat.SetProperty(f"{path}/{shape}", "scale", scale, time)
            if physical[k]:
                X_WE = RigidTransform(RotationMatrix(bodies.rotation[k]), bodies.center[k])
                self._meshcat.SetTransform(path, X_WE, time)
        return EventStatus.Succeeded()


@typed
def save_recording(meshcat: Meshcat, path: str | Path) -> None:
    """Publish MeshCat's recording, and write the scene as one HTML file that plays it."""
    meshcat.StopRecording()
    meshcat.PublishRecording()
    write_whole(path, meshcat.StaticHtml())
