"""Recordings of playbacks for Rerun, and as MCAP for Foxglove and PlotJuggler."""

from __future__ import annotations

from collections.abc import Callable
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
from geodrake.report.drawn_robots import GRAYS, link_triangles
from geodrake.report.playback import Moment, Playback, PlayedModel, PlayedRobot
from geodrake.report.robot_scene import PosedLink

_MARK = 0.05  # m, of the balls whose colour is a joint's error


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


def _poses(robot: PlayedRobot, poses: tuple[RigidTransform, ...]) -> tuple[Array, Array]:
    """Return positions (F, 3), m, and quaternions (F, 4), x y z w, of poses in the world."""
    turned: list[Quaternion] = [X_WB.rotation().ToQuaternion() for X_WB in poses]
    wxyz = np.array([each.wxyz() for each in turned])
    return np.array([X.translation() for X in poses]) + robot.place, np.roll(wxyz, -1, axis=1)


def _joint_values(played: PlayedModel) -> dict[str, Array]:
    """Return what is plotted of a model, by name: (F, nv) arrays, NaN where nothing is compared."""
    return {
        "measured": played.measured,
        "predicted": played.predicted,
        "residual": played.measured - played.predicted,
    }


def _moment_words(found: Playback, moment: Moment) -> str:
    return f"{found.models[moment.played].title}: {found.moment_words(moment)}"


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
            where, turned = _poses(robot, link.X_WB)
            send(entity, rr.Transform3D.columns(translation=where, quaternion=turned))
            if link.joint is not None:
                send(entity, rr.Mesh3D.columns(albedo_factor=robot.colors[:, link.joint]))
            said = [words for words, at in robot.findings if at == link.name]
            if said:
                label = rr.Points3D([[0.0, 0.0, 0.0]], labels=["; ".join(said)], radii=[0.01])
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
    if moments := sorted(found.moments, key=lambda moment: moment.frame):
        at = found.times[[moment.frame for moment in moments]]
        rr.send_columns(
            "worst_moments",
            indexes=[rr.TimeColumn("time", duration=at)],
            columns=rr.TextLog.columns(
                text=[_moment_words(found, moment) for moment in moments],
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
    row = {"type": "object", "properties": numbers}
    joints = {printable(joint): row for joint in found.joints}
    schema = {"title": "geodrake.Joints", "type": "object", "properties": joints}
    with foxglove.open_mcap(str(path), context=context):
        scene = channels.SceneUpdateChannel("/robot", context=context)
        marks = channels.SceneUpdateChannel("/errors", context=context)
        frames = channels.FrameTransformsChannel("/tf", context=context)
        findings = channels.LogChannel("/findings", context=context)
        plots = [
            foxglove.Channel(f"/joints/{robot.name}", schema=schema, context=context)
            for robot in robots
        ]
        entities = [e for robot in robots for e in _entities(kinds, robot)]
        scene.log(kinds.SceneUpdate(entities=entities), log_time=0)
        for robot in robots:
            for words, _ in robot.findings:
                message = f"{robot.played.title}: {words}"
                level = kinds.LogLevel.Info
                findings.log(kinds.Log(level=level, message=message, name=title), log_time=0)
        moments = {moment.frame: moment for moment in found.moments}
        poses = [[_poses(r, link.X_WB) for link in _shown(r)] for r in robots]
        values = [_joint_values(robot.played) for robot in robots]
        for frame, instant in enumerate(instants.tolist()):
            stamp = kinds.Timestamp(sec=instant // 10**9, nsec=instant % 10**9)
            transforms = [
                kinds.FrameTransform(
                    timestamp=stamp,
                    parent_frame_id="world",
                    child_frame_id=_frame_id(robot, link.name),
                    translation=kinds.Vector3(**_xyz(where[frame])),
                    rotation=kinds.Quaternion(**_xyz(turned[frame])),
                )
                for robot, own in zip(robots, poses, strict=True)
                for link, (where, turned) in zip(_shown(robot), own, strict=True)
            ]
            frames.log(kinds.FrameTransforms(transforms=transforms), log_time=instant)
            balls = [e for r in robots for e in _error_marks(kinds, r, frame, stamp)]
            marks.log(kinds.SceneUpdate(entities=balls), log_time=instant)
            for channel, own_values in zip(plots, values, strict=True):
                row = _joint_row(found, own_values, frame)
                channel.log(row, log_time=instant)
            if moment := moments.get(frame):
                words = _moment_words(found, moment)
                level = kinds.LogLevel.Warning
                message = kinds.Log(timestamp=stamp, level=level, message=words, name=title)
                findings.log(message, log_time=instant)


def _frame_id(robot: PlayedRobot, link: str) -> str:
    return f"{robot.name}/{printable(link)}"


def _xyz(values: Array) -> dict[str, float]:
    return dict(zip("xyzw", values.tolist(), strict=False))


def _entities(kinds: Any, robot: PlayedRobot) -> list[Any]:
    """Return the links of a robot as entities of a scene, and what was found at their places."""
    found = []
    for link in _shown(robot):
        vertices, faces = link_triangles(link.shapes)
        mesh = kinds.TriangleListPrimitive(
            points=[kinds.Point3(**_xyz(vertex)) for vertex in vertices],
            indices=faces.ravel().tolist(),
            color=_color(kinds, GRAYS[0]),
        )
        said = "; ".join(words for words, at in robot.findings if at == link.name)
        black = kinds.Color(r=0.1, g=0.1, b=0.1, a=1.0)
        label = kinds.TextPrimitive(
            text=said, billboard=True, font_size=14.0, scale_invariant=True, color=black
        )
        name = _frame_id(robot, link.name)
        found.append(
            kinds.SceneEntity(
                frame_id=name,
                id=name,
                frame_locked=True,
                triangles=[mesh],
                texts=[label] if said else [],
            )
        )
    return found


def _error_marks(kinds: Any, robot: PlayedRobot, frame: int, stamp: Any) -> list[Any]:
    """Return a ball at each link that a joint moves, of the colour of the joint's error."""
    size = kinds.Vector3(x=_MARK, y=_MARK, z=_MARK)
    return [
        kinds.SceneEntity(
            timestamp=stamp,
            frame_id=_frame_id(robot, link.name),
            id=f"error of {_frame_id(robot, link.name)}",
            frame_locked=True,
            spheres=[kinds.SpherePrimitive(size=size, color=_color(kinds, color))],
        )
        for link in _shown(robot)
        if link.joint is not None
        for color in [robot.colors[frame, link.joint]]
    ]


def _color(kinds: Any, rgba: Any) -> Any:
    return kinds.Color(**dict(zip("rgba", (np.asarray(rgba) / 255.0).tolist(), strict=True)))


def _joint_row(playback: Playback, values: dict[str, Array], frame: int) -> dict[str, Any]:
    """Return the numbers of a frame by joint, without those that are unknown."""
    row: dict[str, Any] = {}
    for j, joint in enumerate(playback.joints):
        named = {name: float(column[frame, j]) for name, column in values.items()}
        known = {name: value for name, value in named.items() if np.isfinite(value)}
        row[printable(joint)] = {"position": float(playback.q[frame, j]), **known}
    return row


_Writer = Callable[[Any, Path, Playback, str], None]

_VIEWERS: dict[str, tuple[str, str, _Writer]] = {
    "rerun": (".rrd", "rerun", _write_rerun),
    "mcap": (".mcap", "foxglove", _write_mcap),
}
"""Viewer -> suffix of its files, its module, and what writes them."""
