"""Marks on a robot in MeshCat: efforts as arrows at the joints, effects at their places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from geodrake.boundary.escaping import path_part, printable
from geodrake.effects import FittedEffect
from geodrake.effects.episode import Episode, PointEpisode
from geodrake.effects.robot_motion import log_number
from geodrake.identification.logs.dataset import is_body
from geodrake.inertia import Array, is_physical
from geodrake.model.robot_model import RobotModel
from geodrake.report import style
from geodrake.report.numbers import Units, number
from geodrake.report.playback import Excerpt
from geodrake.report.robot_scene import JointPlace, RobotScene, clock, draw_ellipsoid
from geodrake.report.words import effect_label

MEASURED, PREDICTED, CONTACT = "#64748b", style.AFTER, "#c026a3"
"""Colours of arrows."""

_SMALLEST = 0.01  # scale of an arrow: one of no length has no direction
_LARGEST = 1.6
_AROUND, _ACROSS = 32, 10  # corners of a ring


@dataclass(frozen=True)
class Mark:
    """Words at a place of the scene.

    Attributes:
        path: Folder of the scene that is there.
        place: The joint or body, or what else the effect is of.
    """

    path: str
    words: str
    place: str


class EffortArrows:
    """Measured and predicted effort at every joint, as arrows along its axis.

    The direction is that of the right hand for joints that turn. Arrows of a joint's largest
    measured effort have one length at all joints.

    Args:
        measured: (F, nv) efforts, N·m or N; NaN where there is none.
        predicted: (F, nv) the same, of the model.
        size: Size of the robot, m.
    """

    def __init__(
        self,
        meshcat: Meshcat,
        places: Sequence[JointPlace],
        measured: Array,
        predicted: Array,
        size: float,
    ) -> None:
        self._meshcat, self._paths = meshcat, []
        peak = np.nanmax(np.abs(measured), axis=0, initial=1e-12)
        scale = np.nan_to_num(np.stack([measured, predicted], -1) / peak[:, None])
        way = np.where(scale < 0, -1.0, 1.0)
        self._scale = way * np.clip(np.abs(scale), _SMALLEST, _LARGEST)
        for place in places:
            folder = f"{place.link}/efforts/{path_part(place.joint)}"
            meshcat.SetTransform(folder, place.X_BJ)
            pair = []
            for name, color, side in (("measured", MEASURED, -1), ("predicted", PREDICTED, 1)):
                aside = RigidTransform([0.02 * size * side, 0.0, 0.0])
                meshcat.SetTransform(f"{folder}/{name}", aside)
                draw_arrow(meshcat, f"{folder}/{name}/arrow", 0.22 * size, color)
                pair.append(f"{folder}/{name}/arrow")
            self._paths.append(pair)

    def show(self, frame: int) -> None:
        """Record the arrows of a frame."""
        for joint, pair in enumerate(self._paths):
            for kind, path in enumerate(pair):
                scale = [1.0, 1.0, float(self._scale[frame, joint, kind])]
                self._meshcat.SetProperty(path, "scale", scale, clock(frame))


class EffectMarks:
    """The effects of a model at their places: bodies, contacts, rings at joints.

    Attributes:
        marks: What to say where; of effects of the whole robot at its foot.
    """

    def __init__(
        self, meshcat: Meshcat, scene: RobotScene, model: RobotModel, units: Units, size: float
    ) -> None:
        self._meshcat, self._scene, self._size, self._units = meshcat, scene, size, units
        self._places = {place.joint: place for place in scene.joint_places()}
        self._episodes: list[tuple[Episode, str]] = []
        self._context = model.plant.CreateDefaultContext()
        self._model, self.marks = model, []
        for k, fitted in enumerate(model.effects):
            self.marks += self._draw(k, fitted)

    def start(self, excerpts: Sequence[Excerpt]) -> None:
        """Record when contacts, and what is held for a while, are there."""
        for effect, path in self._episodes:
            shown = np.concatenate([_during(effect, excerpt) for excerpt in excerpts])
            last, changes = len(shown) - 1, 1 + np.flatnonzero(np.diff(shown))
            for frame in sorted({0, *changes.tolist(), last}):
                self._meshcat.SetProperty(path, "visible", bool(shown[frame]), clock(frame))

    def show(self, frame: int, q: Array) -> None:
        """Record the places of what keeps its direction in the world.

        Args:
            frame: Number of the frame.
            q: (nq,) positions of the model.
        """
        (whole,) = self._model.plant_positions(np.atleast_2d(q))
        for effect, path in self._episodes:
            if isinstance(effect, PointEpisode) and not effect.turning:
                plant = self._model.plant
                plant.SetPositions(self._context, whole)
                body = self._scene.body(effect.body)
                X_WB = plant.EvalBodyPoseInWorld(self._context, body)
                place = RigidTransform(X_WB.multiply(effect.point))
                self._meshcat.SetTransform(path, place, clock(frame))

    def _draw(self, number_: int, fitted: FittedEffect) -> list[Mark]:
        effect, words = fitted.effect, effect_words(fitted, self._units)
        own = f"effects/{number_} {path_part(effect.name)}"
        if is_body(effect) and is_physical(fitted.parameters):
            path = f"{self._scene.body_path(effect.where[0])}/{own}"
            draw_ellipsoid(self._meshcat, path, fitted.parameters, _rgba(style.AFTER, 0.6))
            if isinstance(effect, Episode):
                self._episodes.append((effect, path))
            return [Mark(path, words, effect.place)]
        if isinstance(effect, PointEpisode):
            return [Mark(self._draw_contact(effect, fitted, own), words, effect.place)]
        if effect.places == "body":
            path = f"{self._scene.body_path(effect.where[0])}/{own}"
            self._meshcat.SetObject(path, Sphere(0.02 * self._size), _rgba(style.AFTER, 0.8))
            return [Mark(path, words, effect.place)]
        marks = []
        for joint in effect.where:
            place = self._places.get(joint) or self._scene.place_behind(joint)
            path = f"{place.link}/ring {path_part(joint)}"
            vertices, faces = ring(0.06 * self._size, 0.005 * self._size)
            self._meshcat.SetTriangleMesh(path, vertices.T, faces.T, _rgba(style.AFTER, 0.9))
            self._meshcat.SetTransform(path, place.X_BJ)
            marks.append(Mark(path, words, joint))
        return marks or [Mark(f"{self._scene.path}/floor", words, effect.place)]

    def _draw_contact(self, effect: PointEpisode, fitted: FittedEffect, own: str) -> str:
        """Return an arrow of the force that the robot applies, at the point where it does."""
        above = self._scene.body_path(effect.body) if effect.turning else self._scene.path
        path, force = f"{above}/{own}", fitted.parameters[:3]
        if effect.turning:
            self._meshcat.SetTransform(path, RigidTransform(effect.point))
        size = float(np.linalg.norm(force))
        axis = force / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
        turned = RigidTransform(RotationMatrix.MakeFromOneVector(axis, 2))
        draw_arrow(self._meshcat, f"{path}/arrow", 0.35 * self._size, CONTACT)
        self._meshcat.SetTransform(f"{path}/arrow", turned)
        self._episodes.append((effect, path))
        return path


def effect_words(fitted: FittedEffect, units: Units) -> str:
    """Return an effect and its most telling value, such as `payload 2.49 kg`."""
    effect = fitted.effect
    label = printable(effect.label or effect_label(effect.name))
    values, _ = effect.reported(fitted.parameters, np.full(len(fitted.parameters), np.nan))
    names = [effect.summary] if effect.summary in values else list(values)
    if isinstance(effect, PointEpisode):
        return f"{label} {number(float(np.linalg.norm(fitted.parameters[:3])))} N"
    if not names:
        return label
    place = " & ".join(effect.where)
    shown = number(units.shown(effect.name, names[0], values[names[0]]))
    return f"{label} {shown} {units.parameter(effect.name, names[0], place)}".strip()


def draw_arrow(meshcat: Meshcat, path: str, length: float, color: str) -> None:
    """Draw an arrow from the origin of a folder along its z."""
    head, width = 0.3 * length, 0.028 * length
    meshcat.SetObject(f"{path}/shaft", Cylinder(width, length - head), _rgba(color))
    middle = RigidTransform([0.0, 0.0, 0.5 * (length - head)])
    meshcat.SetTransform(f"{path}/shaft", middle)
    meshcat.SetObject(f"{path}/head", MeshcatCone(head, 3 * width, 3 * width), _rgba(color))
    down = RotationMatrix.MakeXRotation(np.pi)
    meshcat.SetTransform(f"{path}/head", RigidTransform(down, [0.0, 0.0, length]))


def ring(radius: float, thickness: float) -> tuple[Array, NDArray[np.int32]]:
    """Return a ring about z.

    Args:
        radius: From the axis to the middle of the ring, m.
        thickness: Radius of the ring's section, m.

    Returns:
        (n, 3) vertices and (m, 3) corners of triangles.
    """
    u, v = np.meshgrid(
        np.linspace(0, 2 * np.pi, _AROUND, endpoint=False),
        np.linspace(0, 2 * np.pi, _ACROSS, endpoint=False),
        indexing="ij",
    )
    far = radius + thickness * np.cos(v)
    vertices = np.stack([far * np.cos(u), far * np.sin(u), thickness * np.sin(v)], -1)
    number_ = np.arange(_AROUND * _ACROSS).reshape(_AROUND, _ACROSS)
    right, up = np.roll(number_, -1, 0), np.roll(number_, -1, 1)
    both = np.roll(right, -1, 1)
    faces = np.stack([number_, right, both, number_, both, up], -1).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces.astype(np.int32)


def _during(effect: Episode, excerpt: Excerpt) -> NDArray[np.bool_]:
    """Return (F,) whether what acts in a window of one log is there."""
    since = excerpt.time - excerpt.began
    return np.asarray((effect.weight(since) >= 0.5) & effect.is_of(log_number(excerpt.log)))


def _rgba(color: str, opaque: float = 1.0) -> Rgba:
    return Rgba(*to_rgb(color), opaque)
