"""A motion replayed over the robot: one HTML page with MeshCat's recording in it."""

from __future__ import annotations

from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.report.robot_scene import (
    FRAMES,
    Extent,
    RobotScene,
    calm_meshcat,
    draw_floor,
    place_camera,
)
from geodrake.robot.files.description import drake_messages

__all__ = ["FRAMES", "replay_page"]


def replay_page(model: RobotModel, times: Array, q: Array) -> str:
    """One HTML page that loads nothing from elsewhere and replays a motion.

    The robot looks as its file says, meshes included; where that cannot be shown, bodies are
    ellipsoids of their inertia.

    Args:
        model: The robot.
        times: (N,) instants, s.
        q: (N, nq) positions in the order of the model's plant.
    """
    with drake_messages():
        meshcat = calm_meshcat()
        scene = RobotScene(meshcat, model)
        extent = Extent.of(model, q)
        draw_floor(meshcat, "", extent)
        place_camera(meshcat, extent)
        meshcat.StartRecording(frames_per_second=FRAMES, set_visualizations_while_recording=False)
        for time, posture in zip(times.tolist(), q, strict=True):
            scene.move(posture, time)
        meshcat.StopRecording()
        meshcat.PublishRecording()
        return str(meshcat.StaticHtml())
