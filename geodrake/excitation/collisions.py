"""Collision geometry of robots, scenes and obstacles, and distances and their gradients.

Drake measures distances to the convex hulls of meshes, so meshes become convex hulls in memory.
This also admits STL files, which Drake does not read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    Convex,
    Cylinder,
    GeometrySet,
    Mesh,
    Role,
    Shape,
    SignedDistancePair,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.inverse_kinematics import MinimumDistanceLowerBoundConstraint
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull, QhullError

from geodrake.boundary.arguments import instance, instances, number, typed
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel
from geodrake.robot.files import Given, read_description
from geodrake.robot.files.checks import drop
from geodrake.robot.files.description import Where, drake_errors, drake_messages
from geodrake.robot.plant import arrange_as
from geodrake.robot.shapes import (
    SHAPES_ADVICE,
    geometries_of,
    mjcf_geoms,
    move_meshes,
    regular_mesh,
    scene_of,
    stl_vertices,
)

FLOOR, ITSELF = "floor", "itself"
_HALF = 10.0, 0.5  # half the width and the depth of a floor, m
_CONTACT = CoulombFriction(0.5, 0.5)  # unused here, but required by Drake
_MAX_CORNERS, _GRID = 1000, 2e-4  # hulls with more corners are rounded to a grid, m
_FARTHEST = 100.0  # m, largest clearance
_INFLUENCE = 0.05  # m beyond the clearance at which the constraint becomes active
_POSTURES = 40
_ALWAYS = 0.9  # share of random postures from which an overlap counts as intended
_SHAPES = {"box": (Box, 3), "sphere": (Sphere, 1), "cylinder": (Cylinder, 2), FLOOR: (None, 1)}
_SCENES, _MESHES = (".urdf", ".sdf", ".xml", ".xacro", ".yaml", ".yml"), (".obj", ".stl", ".vtk")
_FORMS = (
    "Write box:0.6,0.8,0.05@0.5,0,0.4 (sizes @ x, y, z of the centre, then optionally roll, "
    "pitch, yaw), sphere:0.1@…, cylinder:RADIUS,LENGTH@…, floor:HEIGHT, or a file: a mesh "
    f"({', '.join(_MESHES)}) or a scene ({', '.join(_SCENES)}), optionally with @x,y,z. A "
    "name may come first: table=box:…."
)


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape of an obstacle or a link.

    Attributes:
        shape: Drake's shape, such as `Box(0.5, 0.5, 0.1)`.
        X_BG: Pose in the link's frame; for an obstacle, in the world.
    """

    name: str
    shape: Shape
    X_BG: RigidTransform

    def __post_init__(self) -> None:
        instance(self.name, "name", str)
        instance(self.shape, "shape", Shape)
        instance(self.X_BG, "X_BG", RigidTransform)


@typed
def floor_of(model: RobotModel, *, below: float = 0.0) -> Solid:
    """Return a level floor at the height of the robot's base, lowered by `below`, m.

    For a robot on its feet the floor is the ground.
    """
    plant = model.plant
    context = plant.CreateDefaultContext()
    welded = plant.GetBodiesWeldedTo(plant.world_body())
    bases = [body for body in welded if body.index() != plant.world_body().index()]
    heights = [plant.EvalBodyPoseInWorld(context, body).translation()[2] for body in bases]
    return _floor(FLOOR, min(heights, default=0.0) - below)


def _floor(name: str, height: float) -> Solid:
    box = Box(2.0 * _HALF[0], 2.0 * _HALF[0], 2.0 * _HALF[1])
    return Solid(name, box, RigidTransform([0.0, 0.0, height - _HALF[1]]))


def read_obstacles(texts: Iterable[str]) -> tuple[Solid, ...]:
    """Return obstacles from texts such as `table=box:0.6,0.8,0.05@0.5,0,0.4`, or from files.

    Args:
        texts: Shapes with their sizes and poses in the world, m and rad; meshes; or scenes, all of
            whose collision geometry becomes obstacles at its place in the file.
    """
    obstacles: list[Solid] = []
    for k, text in enumerate(instances(texts, "texts", str), 1):
        body, at, place = text.rpartition("@") if "@" in text else (text, "", "")
        label, equals, source = body.partition("=")
        label, source = (label.strip(), source.strip()) if equals else ("", body.strip())
        pose = _pose(place, text) if at else RigidTransform()
        kind, colon, sizes = source.partition(":")
        path = Path(source)
        suffix = path.suffix.lower()
        if colon and kind in _SHAPES:
            obstacles.append(_plain(label or f"{kind} {k}", kind, _numbers(sizes, text), pose))
        elif suffix in _MESHES:
            shape = Convex(points=_points(path).T, label=label or path.stem)
            obstacles.append(Solid(label or path.stem, shape, pose))
        elif suffix in _SCENES:
            obstacles += _scene(path, label or path.stem, pose)
        else:
            raise ArgumentError(f"{text!r} is not an obstacle.", advice=_FORMS)
    return tuple(obstacles)


def _numbers(text: str, whole: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not values or not np.isfinite(values).all():
        raise ArgumentError(f"{text!r} of obstacle {whole!r} is not numeric.", advice=_FORMS)
    return values


def _pose(text: str, whole: str) -> RigidTransform:
    values = _numbers(text, whole)
    if len(values) not in (3, 6):
        raise ArgumentError(
            f"The pose of obstacle {whole!r} needs 3 numbers, or 6 with rotation; got "
            f"{len(values)}.",
            advice=_FORMS,
        )
    return RigidTransform(RollPitchYaw(*(*values[3:], 0.0, 0.0, 0.0)[:3]), values[:3])


def _plain(name: str, kind: str, sizes: list[float], pose: RigidTransform) -> Solid:
    shape, count = _SHAPES[kind]
    if len(sizes) != count:
        raise ArgumentError(f"A {kind} needs {count} sizes; got {sizes}.", advice=_FORMS)
    if shape is None:
        return _floor(name, sizes[0])
    if not min(sizes) > 0:
        raise ArgumentError(f"Sizes of a {kind} must be positive; got {sizes}.", advice=_FORMS)
    return Solid(name, shape(*sizes), pose)


def _points(path: Path) -> Array:
    """Return points (n, 3) with the same convex hull as a mesh."""
    if path.suffix.lower() == ".stl":
        return stl_vertices(path)
    regular_mesh(path)
    with drake_messages(), drake_errors(path, how=" as a mesh", advice="Use an .obj or an .stl."):
        return corners_of(Mesh(str(path)))


def corners_of(shape: Mesh | Convex) -> Array:
    """Return the corners (n, 3) of a convex hull, m."""
    hull = shape.GetConvexHull()
    return np.array([hull.vertex(i) for i in range(hull.num_vertices())])


def _scene(path: Path, name: str, X_WS: RigidTransform) -> list[Solid]:
    """Return all collision geometry of a file in its default posture."""
    plant = MultibodyPlant(0.0)
    with drake_messages(), drake_errors(path):
        read_description(path).add_to(plant)
        plant.Finalize()
    context, scene = plant.CreateDefaultContext(), []
    poses = {plant.world_body().scoped_name().get_full(): RigidTransform()}
    for i in range(plant.num_bodies()):
        body = plant.get_body(BodyIndex(i))
        poses[body.scoped_name().get_full()] = plant.EvalBodyPoseInWorld(context, body)
    for scope, solids in solids_of_file(path, Given()).items():
        for solid in solids if scope in poses else ():
            label = f"{name}: {solid.name.partition('_')[2] or scope.rpartition('::')[2]}"
            scene.append(Solid(label, solid.shape, X_WS @ poses[scope] @ solid.X_BG))
    if not scene:
        raise ArgumentError(
            f"Scene {path} has no collision geometry.",
            advice="Add <collision> elements to its links, or use boxes instead.",
        )
    return scene


def solids_of_file(path: Path, given: Given) -> dict[str, list[Solid]]:
    """Return collision geometry by scoped link name, read by MuJoCo from MJCF, else by Drake."""
    mjcf = mjcf_geoms(path, given, hulls=True)
    if mjcf is not None:
        geoms, _ = mjcf
        return {
            link: [
                Solid(f"{k}_{g.name}", g.shape, g.X_BG) for k, g in enumerate(geom) if g.collides
            ]
            for link, geom in geoms.items()
        }
    solids, how = dict[str, list[Solid]](), " with its collision geometry"
    errors = drake_errors(path, how=how, advice=SHAPES_ADVICE)
    with drake_messages(), errors, TemporaryDirectory() as folder:
        files = (Path(folder) / f"{at}.obj" for at in count())
        plant, scene = scene_of(path, given, lambda root, where: _prepare(root, where, files))
        inspector = scene.model_inspector()
        for link, geometries in geometries_of(plant, scene, Role.kProximity):
            solids[link] = []
            for k, geometry in enumerate(geometries):
                name = f"{k}_{inspector.GetName(geometry).split('::')[-1]}"
                shape = _in_memory(inspector.GetShape(geometry), name)
                solids[link].append(Solid(name, shape, inspector.GetPoseInFrame(geometry)))
    return solids


def _prepare(root: Element, where: Where, files: Iterator[Path]) -> None:
    """Keep only the collision geometry, and replace STL files by OBJ files of their hulls."""
    drop(root, "visual")
    move_meshes(root, lambda name: _readable(name, where, next(files)))


def _in_memory(shape: Shape, label: str) -> Shape:
    """Return a shape that needs no file, the convex hull of a mesh."""
    if not isinstance(shape, Mesh | Convex):
        return shape.Clone()
    corners = corners_of(shape)
    if len(corners) > _MAX_CORNERS:
        corners = np.unique(_GRID * np.round(corners / _GRID), axis=0)
    return Convex(points=corners.T, label=label)


def _readable(name: str, where: Where, replacement: Path) -> Path:
    """Return the file of a mesh, or the file that replaces an STL file."""
    path: str | Path = name
    try:
        path = where(name)
        if path.suffix.lower() != ".stl":
            return regular_mesh(path)
        vertices = stl_vertices(path)
    except ModelError as error:
        reason = error.problem.replace(f"Mesh {path} ", "it ").rstrip(".")
        raise ModelError(
            f"Mesh {path} cannot be used for collisions: {reason}.",
            advice="Correct the file, or pass the shapes of links as `links` and ignore those of "
            "the model's file (use_file=False).",
            mesh=str(path),
        ) from error
    faces = np.arange(len(vertices)).reshape(-1, 3)
    with suppress(QhullError):  # a flat mesh has no hull
        hull = ConvexHull(vertices)
        corners = np.sort(hull.vertices)
        vertices, faces = vertices[corners], np.searchsorted(corners, hull.simplices)
    with replacement.open("w", encoding="utf-8") as file:
        np.savetxt(file, vertices, "v %.9g %.9g %.9g")
        np.savetxt(file, 1 + faces, "f %d %d %d")
    return replacement


class CollisionWorld:
    """A robot with collision geometry among obstacles.

    Neighbours in the tree may touch, and so may links that overlap in nearly all postures, as this
    is presumably intended; `notes` lists these.

    Args:
        links: Body name -> further shapes of the link.
        clearance: Least distance to keep, m.
        use_file: Whether to use the collision geometry of the model's file.
    """

    @typed
    def __init__(
        self,
        model: RobotModel,
        *,
        obstacles: Sequence[Solid] = (),
        links: Mapping[str, Sequence[Solid]] | None = None,
        clearance: float = 0.01,
        use_file: bool = True,
    ) -> None:
        instance(model, "model", RobotModel)
        obstacles = instances(obstacles, "obstacles", Solid)
        links = {} if links is None else instance(links, "links", Mapping)
        links = {body: instances(s, f"links[{body!r}]", Solid) for body, s in links.items()}
        number(clearance, "clearance", lower=0.0, upper=_FARTHEST)
        file_solids = solids_of_file(model.path, model.given) if use_file else {}
        self.clearance, self._model, self._solids = clearance, model, (file_solids, links)
        self._place(obstacles)

    @typed
    def among(self, obstacles: Sequence[Solid]) -> CollisionWorld:
        """Return the robot among other obstacles, without reading its meshes again."""
        world = copy(self)
        world._place(instances(obstacles, "obstacles", Solid))
        return world

    def _place(self, obstacles: Sequence[Solid]) -> None:
        model, builder, (file_solids, links) = self._model, DiagramBuilder(), self._solids
        self.obstacles = tuple(solid.name for solid in obstacles)
        plant, self._scene = AddMultibodyPlantSceneGraph(builder, 0.0)
        with drake_messages(), drake_errors(model.path):
            read_description(model.path, model.given).add_to(plant)
            arrange_as(plant, model.plant)
        bodies = [plant.get_body(BodyIndex(i)) for i in range(plant.num_bodies())]
        by_scope = {body.scoped_name().get_full(): body for body in bodies}
        shapes: list[tuple[RigidBody, Sequence[Solid]]] = [
            *(
                (by_scope[scope], solids)
                for scope, solids in file_solids.items()
                if scope in by_scope
            ),
            (plant.world_body(), obstacles),
        ]
        for name, further in links.items():
            matches = [
                body for body in bodies if name in (body.name(), body.scoped_name().get_full())
            ]
            if not matches:
                raise ArgumentError(
                    f"There is no link {name!r}.",
                    advice=f"Links are: {', '.join(body.name() for body in bodies[1:])}.",
                )
            shapes.append((matches[0], further))
        for body, solids in shapes:
            for solid in solids:
                geometry = solid.X_BG, solid.shape, solid.name, _CONTACT
                plant.RegisterCollisionGeometry(body, *geometry)
        plant.Finalize()
        if not self._scene.model_inspector().NumGeometriesWithRole(Role.kProximity):
            raise ArgumentError(
                f"{model.path} has no collision geometry, and there are no obstacles.",
                advice="Pass the shapes of links as `links`, or omit collisions.",
            )
        self._plant, self._diagram = plant, builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = plant.GetMyMutableContextFromRoot(self._root)
        self.notes = self._allow_overlaps()
        self._constraint = MinimumDistanceLowerBoundConstraint(
            plant=plant,
            bound=self.clearance,
            plant_context=self._context,
            influence_distance_offset=_INFLUENCE,
        )

    def distances(self, q: Array) -> tuple[Array, tuple[str, ...]]:
        """Return the least signed distances (N,), m, and N pairs of names such as "hand and table".

        Distances beyond `clearance` + 0.05 m are infinite.
        """
        distances, names = np.full(len(q), np.inf), [""] * len(q)
        for i, pairs in enumerate(self._near(q)):
            if pairs:
                nearest = min(pairs, key=lambda pair: pair.distance)
                distances[i], names[i] = nearest.distance, " and ".join(self._names(nearest))
        return distances, tuple(names)

    def nearest(self, q: Array) -> dict[str, tuple[float, str]]:
        """Return "itself" or obstacle -> least distance over postures (N, nq), m, and the pair.

        Obstacles beyond `clearance` + 0.05 m are omitted.
        """
        found: dict[str, tuple[float, str]] = {}
        for pairs in self._near(q):
            for pair in pairs:
                names = self._names(pair)
                party = next((name for name in names if name in self.obstacles), ITSELF)
                if pair.distance < found.get(party, (np.inf, ""))[0]:
                    found[party] = pair.distance, " and ".join(names)
        return found

    def constraint(self, q: Array) -> tuple[Array, Array]:
        """Return smooth values (N,), at most 1 where the clearance is kept, and gradients (N, nq).

        They are those of Drake's `MinimumDistanceLowerBoundConstraint`.
        """
        postures = self._model.plant_positions(q)
        values, gradients = np.empty(len(q)), np.zeros(postures.shape)
        for i, posture in enumerate(postures):
            result = self._constraint.Eval(InitializeAutoDiff(posture).ravel())
            values[i] = ExtractValue(result).item()
            gradient = ExtractGradient(result).ravel()
            if gradient.size:
                gradients[i] = gradient
        J = self._model.coordinates.jacobian(q)
        return values, np.einsum("nij,ni->nj", J, gradients)

    def _near(self, q: Array) -> Iterator[list[SignedDistancePair]]:
        """Yield Drake's signed distances of close pairs, for each posture of the model."""
        return self._pairs(self._model.plant_positions(q), self.clearance + _INFLUENCE)

    def _pairs(self, q: Array, within: float) -> Iterator[list[SignedDistancePair]]:
        """Yield Drake's signed distances up to `within`, for each posture of the plant."""
        for posture in q:
            self._plant.SetPositions(self._context, posture)
            query = self._plant.get_geometry_query_input_port().Eval(self._context)
            yield query.ComputeSignedDistancePairwiseClosestPoints(within)

    def _bodies(self, pair: SignedDistancePair) -> list[RigidBody]:
        inspector = self._scene.model_inspector()
        frames = (inspector.GetFrameId(geometry) for geometry in (pair.id_A, pair.id_B))
        return [self._plant.GetBodyFromFrameId(frame) for frame in frames]

    def _names(self, pair: SignedDistancePair) -> tuple[str, str]:
        inspector, world = self._scene.model_inspector(), self._plant.world_body().index()
        names = [
            inspector.GetName(geometry).split("::")[-1] if body.index() == world else body.name()
            for geometry, body in zip((pair.id_A, pair.id_B), self._bodies(pair), strict=True)
        ]
        return names[0], names[1]

    def _allow_overlaps(self) -> tuple[str, ...]:
        """Ignore collisions of links that nearly always overlap, and return notes."""
        plant, world = self._plant, self._plant.world_body().index()
        lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
        bounded = np.isfinite(lower) & np.isfinite(upper)
        lower, upper = np.where(bounded, lower, -np.pi), np.where(bounded, upper, np.pi)
        q = np.random.default_rng(0).uniform(lower, upper, (_POSTURES, len(lower)))
        count, words = Counter[tuple[int, ...]](), dict[tuple[int, ...], str]()
        for pairs in self._pairs(q, 0.0):
            keys = [tuple(sorted(int(b.index()) for b in self._bodies(pair))) for pair in pairs]
            words |= {k: " and ".join(self._names(p)) for k, p in zip(keys, pairs, strict=True)}
            count.update(set(keys))
        context = self._scene.GetMyMutableContextFromRoot(self._root)
        manager, notes = self._scene.collision_filter_manager(context), []
        for key, times in count.items():
            if times < _ALWAYS * _POSTURES or int(world) in key:  # obstacles are in the world
                continue
            bodies = (plant.get_body(BodyIndex(index)) for index in key)
            sets = (GeometrySet(plant.GetCollisionGeometriesForBody(body)) for body in bodies)
            manager.Apply(CollisionFilterDeclaration().ExcludeBetween(*sets))
            notes.append(
                f"{words[key]} of {self._model.path.name} overlap in nearly all postures, so their "
                "collisions are ignored."
            )
        return tuple(notes)
