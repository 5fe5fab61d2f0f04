"""An adapting arm in MeshCat: its estimate as ellipsoids, the desired pose as a ghost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    EventStatus,
    LeafSystem,
    OutputPort,
)

from geodrake.boundary.arguments import typed
from geodrake.boundary.escaping import path_part
from geodrake.boundary.whole_files import write_whole
from geodrake.control.loops import AdaptiveLoop
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical
from geodrake.inertia.bodies import lumped_bodies
from geodrake.report import style
from geodrake.report.ellipsoids import BOUNDARY, IDENTIFIED, SkeletonLines, placed, skeleton

FRAME_PERIOD = 1.0 / 32.0  # time between two pictures, s: that of MeshCat's recordings, nearly


class AdaptationView(LeafSystem):
    """Shows an arm, the ellipsoids of its estimated bodies, and the desired pose.

    .. pydrake_system::

        name: AdaptationView
        input_ports:
        - state
        - desired_state
        - parameters

    Every body is drawn as the uniform ellipsoid that has its estimated inertia; it turns red, and
    keeps its last shape, where the estimate is not physical. The robot is drawn as lines, the
    desired pose as paler ones; what is not finite stays where it was last. While MeshCat records,
    all of it is recorded.

    Args:
        parameters: Length of the port `parameters`, inertial parameters first.
        path: Folder of the scene to draw in; what was in it is deleted.
        period: Time between two pictures, s.

    Raises:
        ArgumentError: The parameters are fewer than ten a body.
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
        self._draw_objects()

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
            ArgumentError: The plant holds more than the robot.
        """
        if loop.robot is None or loop.robot.name is not None:
            raise ArgumentError(
                "A view of adaptation needs a plant with one robot only.",
                advice="Show the whole scene with MeshcatVisualizer.AddToBuilder.",
            )
        size = loop.parameters.size()
        view = builder.AddSystem(
            AdaptationView(loop.plant, meshcat, size, path=path, period=period)
        )
        ports: tuple[tuple[str, OutputPort], ...] = (
            ("state", loop.state),
            ("desired_state", loop.desired_state),
            ("parameters", loop.parameters),
        )
        for name, port in ports:
            builder.Connect(port, view.GetInputPort(name))
        return view

    def _draw_objects(self) -> None:
        meshcat = self._meshcat
        meshcat.Delete(self._path)
        ends = skeleton(self._plant, self._scratch)
        points = ends.reshape(-1, 3)
        middle, size = points.mean(0), float(np.ptp(points, axis=0).max())
        meshcat.SetCameraPose(middle + size * np.array([1.4, -1.1, 0.7]), middle)
        self._lines = {
            name: SkeletonLines(
                meshcat, f"{self._path}/{name}", len(ends), Rgba(*to_rgb(color), opaque)
            )
            for name, color, opaque in (("robot", style.INK, 1.0), ("desired", IDENTIFIED, 0.25))
        }
        for name in self._bodies:
            for shape, color in (("shape", IDENTIFIED), ("unphysical", BOUNDARY)):
                rgba = Rgba(*to_rgb(color), 0.5)
                meshcat.SetObject(f"{self._path}/estimate/{name}/{shape}", Sphere(1.0), rgba)

    def _draw(self, context: Context) -> EventStatus:
        time, n = context.get_time(), self._plant.num_positions()
        desired, q = (port.Eval(context)[:n] for port in (self._desired, self._state))
        if np.isfinite(desired).all():
            self._plant.SetPositions(self._scratch, desired)
            self._lines["desired"].move(skeleton(self._plant, self._scratch), time)
        if np.isfinite(q).all():
            self._plant.SetPositions(self._scratch, q)
            self._lines["robot"].move(skeleton(self._plant, self._scratch), time)
            phi = self._estimate.Eval(context)[: PARAMETERS_PER_BODY * len(self._bodies)]
            self._draw_bodies(phi.reshape(-1, PARAMETERS_PER_BODY), time)
        return EventStatus.Succeeded()

    def _draw_bodies(self, phi: Array, time: float) -> None:
        physical = np.isfinite(phi).all(1) & is_physical(np.nan_to_num(phi))
        shown = np.where(physical[:, None], phi, _POINT)
        bodies = placed(self._plant, self._scratch, shown)
        for k, name in enumerate(self._bodies):
            path = f"{self._path}/estimate/{name}"
            for shape, visible in (("shape", physical[k]), ("unphysical", not physical[k])):
                self._meshcat.SetProperty(f"{path}/{shape}", "visible", bool(visible), time)
            if physical[k]:
                X_WE = RigidTransform(RotationMatrix(bodies.rotation[k]), bodies.center[k])
                self._meshcat.SetTransform(path, X_WE, time)
                for shape in ("shape", "unphysical"):
                    scale = bodies.semi_axes[k].tolist()
                    self._meshcat.SetProperty(f"{path}/{shape}", "scale", scale, time)


_POINT = np.array([1.0, 0.0, 0.0, 0.0, 1e-6, 1e-6, 1e-6, 0.0, 0.0, 0.0])
"""Replaces bodies that cannot be drawn."""


@typed
def save_recording(meshcat: Meshcat, path: str | Path) -> None:
    """Publish MeshCat's recording, and write the scene as one HTML file that plays it."""
    meshcat.StopRecording()
    meshcat.PublishRecording()
    write_whole(path, meshcat.StaticHtml())
