"""Recordings of playbacks for Rerun, and as MCAP for Foxglove and PlotJuggler."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform

from geodrake.boundary.arguments import one_of
from geodrake.boundary.escaping import printable
from geodrake.boundary.optional_packages import optional_package
from geodrake.errors import OutputError
from geodrake.inertia import Array
from geodrake.report.pictures import link_triangles
from geodrake.report.playback import Playback, PlayedModel, PlayedRobot
from geodrake.report.robot_scene import GRAYS, PosedLink

_BALL = 0.05  # m, diameter of the balls with the colour of a joint's error


def check_viewer(to: str, file: Path) -> None:
    """Raise if a viewer is unknown or not installed, or the file has another suffix."""
    suffix, module, _ = _VIEWERS[one_of(to, "--to", _VIEWERS)]
    if file.suffix.lower() != suffix:
        raise OutputError(
            f"Cannot write --to {to} {file}: it does not end in {suffix}.",
            advice=f"Name it {file.stem or 'play'}{suffix}.",
            path=file,
        )
    optional_package(module, "viewers", f"recordings for {to}", OutputError)


def recording(to: str, found: Playback, *, title: str) -> bytes:
    """Return a recording for "rerun" or "mcap": robots, joints, efforts and findings."""
    _, module, write = _VIEWERS[one_of(to, "to", _VIEWERS)]
    package = optional_package(module, "viewers", f"recordings for {to}", OutputError)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording"
        write(package, path, found, printable(title))
        return path.read_bytes()


def _shown(robot: PlayedRobot) -> list[PosedLink]:
    return [link for link in robot.links if link.shapes]


def _poses(poses: Sequence[RigidTransform]) -> tuple[Array, Array]:
    """Return positions (F, 3), m, and quaternions (F, 4), x y z w, of poses in the world."""
    rotations: list[Quaternion] = [X_WB.rotation().ToQuaternion() for X_WB in poses]
    wxyz = np.array([rotation.wxyz() for rotation in rotations])
    return np.array([X.translation() for X in poses]), np.roll(wxyz, -1, axis=1)


def _joint_values(played: PlayedModel) -> dict[str, Array]:
    """Return the plotted efforts (F, nv) of a model by name; NaN where nothing is compared."""
    return {
        "measured": played.measured,
        "predicted": played.predicted,
        "residual": played.measured - played.predicted,
    }


def _moments(found: Playback) -> list[tuple[int, str]]:
    """Return the frames and descriptions of the worst moments, in order of time."""
    moments = [
        (moment.frame, f"{played.title}: {found.moment_words(moment)}")
        for played in found.models
        for moment in played.moments
    ]
    return sorted(moments, key=lambda moment: moment[0])


def _write_rerun(rr: Any, path: Path, found: Playback, title: str) -> None:
    robots = found.robots
    record = rr.RecordingStream("geodrake", send_properties=False)
    record.save(path)
    record.send_recording_name(title)
    times = rr.TimeColumn("time", duration=found.times)

    def send(entity: str, columns: Any) -> None:
        rr.send_columns(entity, indexes=[times], columns=columns, recording=record)

    def path_of(*parts: str) -> str:
        return str(rr.new_entity_path([printable(part) for part in parts]))

    record.log("robots", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for robot in robots:
        for link in _shown(robot):
            entity = path_of("robots", robot.name, link.name)
            vertices, faces = link_triangles(link.shapes)
            mesh = rr.Mesh3D(
                vertex_positions=vertices, triangle_indices=faces, albedo_factor=GRAYS[0]
            )
            record.log(entity, mesh, static=True)
            positions, rotations = _poses(link.X_WB)
            send(entity, rr.Transform3D.columns(translation=positions, quaternion=rotations))
            if link.joint is not None:
                send(entity, rr.Mesh3D.columns(albedo_factor=robot.colors[:, link.joint]))
            words = [words for words, place in robot.findings if place == link.name]
            if words:
                label = rr.Points3D([[0.0, 0.0, 0.0]], labels=["; ".join(words)], radii=[0.01])
                record.log(f"{entity}/findings", label, static=True)
        for name, values in _joint_values(robot.played).items():
            for joint, column in zip(found.joints, values.T, strict=True):
                entity = path_of("efforts", joint, name, robot.name)
                send(entity, rr.Scalars.columns(scalars=column))
        lines = [f"# {robot.played.title}", *(f"- {words}" for words, _ in robot.findings)]
        text = rr.TextDocument("\n".join(lines), media_type="text/markdown")
        record.log(path_of("findings", robot.name), text, static=True)
    for joint, q in zip(found.joints, found.q.T, strict=True):
        send(path_of("positions", joint), rr.Scalars.columns(scalars=q))
    if moments := _moments(found):
        instants = found.times[[frame for frame, _ in moments]]
        rr.send_columns(
            "worst_moments",
            indexes=[rr.TimeColumn("time", duration=instants)],
            columns=rr.TextLog.columns(
                text=[words for _, words in moments],
                level=["WARN"] * len(moments),
            ),
            recording=record,
        )
    record.flush()
    record.disconnect()


def _write_mcap(foxglove: Any, path: Path, found: Playback, title: str) -> None:
    robots = found.robots
    kinds, channels = foxglove.messages, foxglove.channels
    context = foxglove.Context()
    instants = np.rint(1e9 * (found.times - found.times[0])).astype(int)
    names = ("position", *_joint_values(found.models[0]))
    numbers = {name: {"type": "number"} for name in names}
    joints = [printable(joint) for joint in found.joints]
    rows = {joint: {"type": "object", "properties": numbers} for joint in joints}
    schema = {"title": "geodrake.Joints", "type": "object", "properties": rows}
    with foxglove.open_mcap(str(path), context=context):
        scene = channels.SceneUpdateChannel("/robot", context=context)
        marks = channels.SceneUpdateChannel("/errors", context=context)
        frames = channels.FrameTransformsChannel("/tf", context=context)
        findings = channels.LogChannel("/findings", context=context)
        scene.log(
            kinds.SceneUpdate(entities=[_entity(kinds, r, o) for r in robots for o in _shown(r)]),
            log_time=0,
        )
        for robot in robots:
            for words, _ in robot.findings:
                message = f"{robot.played.title}: {words}"
                level = kinds.LogLevel.Info
                findings.log(kinds.Log(level=level, message=message, name=title), log_time=0)
        for frame, words in _moments(found):
            instant, level = int(instants[frame]), kinds.LogLevel.Warning
            message = kinds.Log(
                timestamp=_stamp(kinds, instant), level=level, message=words, name=title
            )
            findings.log(message, log_time=instant)
        parts = [
            (
                robot,
                foxglove.Channel(f"/joints/{robot.name}", schema=schema, context=context),
                {"position": found.q, **_joint_values(robot.played)},
                [(link, *_poses(link.X_WB)) for link in _shown(robot)],
            )
            for robot in robots
        ]
        size = kinds.Vector3(x=_BALL, y=_BALL, z=_BALL)
        for frame, instant in enumerate(instants.tolist()):
            stamp, transforms, balls = _stamp(kinds, instant), [], []
            for robot, plot, values, links in parts:
                for link, positions, rotations in links:
                    frame_id = _frame_id(robot, link)
                    transforms.append(
                        kinds.FrameTransform(
                            timestamp=stamp,
                            parent_frame_id="world",
                            child_frame_id=frame_id,
                            translation=kinds.Vector3(**_xyz(positions[frame])),
                            rotation=kinds.Quaternion(**_xyz(rotations[frame])),
                        )
                    )
                    if link.joint is not None:
                        color = _color(kinds, robot.colors[frame, link.joint])
                        balls.append(
                            kinds.SceneEntity(
                                timestamp=stamp,
                                frame_id=frame_id,
                                id=f"error of {frame_id}",
                                frame_locked=True,
                                spheres=[kinds.SpherePrimitive(size=size, color=color)],
                            )
                        )
                now = {name: column[frame].tolist() for name, column in values.items()}
                known = {
                    joint: {name: row[j] for name, row in now.items() if np.isfinite(row[j])}
                    for j, joint in enumerate(joints)
                }
                plot.log(known, log_time=instant)
            frames.log(kinds.FrameTransforms(transforms=transforms), log_time=instant)
            marks.log(kinds.SceneUpdate(entities=balls), log_time=instant)


def _stamp(kinds: Any, instant: int) -> Any:
    return kinds.Timestamp(sec=instant // 10**9, nsec=instant % 10**9)


def _frame_id(robot: PlayedRobot, link: PosedLink) -> str:
    return f"{robot.name}/{printable(link.name)}"


def _xyz(values: Array) -> dict[str, float]:
    return dict(zip("xyzw", values.tolist(), strict=False))


def _color(kinds: Any, rgba: Any) -> Any:
    return kinds.Color(**dict(zip("rgba", (np.asarray(rgba) / 255.0).tolist(), strict=True)))


def _entity(kinds: Any, robot: PlayedRobot, link: PosedLink) -> Any:
    """Return a link as an entity of a scene, labelled with its findings."""
    vertices, faces = link_triangles(link.shapes)
    mesh = kinds.TriangleListPrimitive(
        points=[kinds.Point3(**_xyz(vertex)) for vertex in vertices],
        indices=faces.ravel().tolist(),
        color=_color(kinds, GRAYS[0]),
    )
    findings = "; ".join(words for words, place in robot.findings if place == link.name)
    black = kinds.Color(r=0.1, g=0.1, b=0.1, a=1.0)
    label = kinds.TextPrimitive(
        text=findings, billboard=True, font_size=14.0, scale_invariant=True, color=black
    )
    return kinds.SceneEntity(
        frame_id=_frame_id(robot, link),
        id=_frame_id(robot, link),
        frame_locked=True,
        triangles=[mesh],
        texts=[label] if findings else [],
    )


_Writer = Callable[[Any, Path, Playback, str], None]

_VIEWERS: dict[str, tuple[str, str, _Writer]] = {
    "rerun": (".rrd", "rerun", _write_rerun),
    "mcap": (".mcap", "foxglove", _write_mcap),
}
"""Viewer -> suffix of its files, its module, and their writer."""
