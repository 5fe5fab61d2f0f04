"""Distances of a robot from itself and from obstacles, and how they depend on its posture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, Role, SignedDistancePair
from pydrake.multibody.inverse_kinematics import MinimumDistanceLowerBoundConstraint
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import DiagramBuilder

from geodrake.boundary.arguments import instance, instances, number, typed
from geodrake.errors import ArgumentError
from geodrake.excitation.collision_geometry import Solid, add_collision_plant, solids_of_file
from geodrake.inertia import Array
from geodrake.model.robot_model import RobotModel

ITSELF = "itself"

_INFLUENCE = 0.05  # m beyond the clearance at which the constraint begins to feel a distance
_POSTURES = 40
_ALWAYS = 0.9  # share of random postures in which parts overlap that are made to


class CollisionWorld:
    """A robot with collision geometry among obstacles.

    Neighbours in the tree may touch, and so may links that overlap in nearly all postures, since
    they are drawn so; `notes` says which.

    Args:
        links: Body name -> further shapes of the link.
        clearance: Least distance to keep, m.
        use_file: Whether the file's own geometry counts.
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
        links = {body: instances(each, f"links[{body!r}]", Solid) for body, each in links.items()}
        number(clearance, "clearance", lower=0.0)
        own = solids_of_file(model.path, model.given) if use_file else {}
        self.clearance, self._model, self._solids = clearance, model, (own, links)
        self._place(obstacles)

    @typed
    def among(self, obstacles: Sequence[Solid]) -> CollisionWorld:
        """Return the same robot among other obstacles; its meshes are not read again."""
        world = copy(self)
        world._place(instances(obstacles, "obstacles", Solid))
        return world

    def _place(self, obstacles: Sequence[Solid]) -> None:
        model, builder = self._model, DiagramBuilder()
        self.obstacles = tuple(solid.name for solid in obstacles)
        self._plant, self._scene = add_collision_plant(builder, model, obstacles, *self._solids)
        if not self._scene.model_inspector().NumGeometriesWithRole(Role.kProximity):
            raise ArgumentError(
                f"{model.path} has no collision geometry, and there are no obstacles.",
                advice="Pass the shapes of links as `links`, or omit collisions.",
            )
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)
        self.notes = self._allow_overlaps(model)
        self._constraint = MinimumDistanceLowerBoundConstraint(
            plant=self._plant,
            bound=self.clearance,
            plant_context=self._context,
            influence_distance_offset=_INFLUENCE,
        )

    def distances(self, q: Array) -> tuple[Array, tuple[str, ...]]:
        """Return the least signed distances (N,), m, and N pairs of names such as "hand and table".

        No more than `clearance` + 0.05 m is distinguished from infinity.
        """
        found, names = np.full(len(q), np.inf), [""] * len(q)
        whole = self._model.plant_positions(q)
        for i, pairs in enumerate(self._pairs(whole, self.clearance + _INFLUENCE)):
            if pairs:
                nearest = min(pairs, key=lambda pair: pair.distance)
                found[i], names[i] = nearest.distance, " and ".join(self._names(nearest))
        return found, tuple(names)

    def nearest(self, q: Array) -> dict[str, tuple[float, str]]:
        """Return by how much a robot clears itself and each obstacle over postures (N, nq).

        Returns:
            "itself" or an obstacle's name -> least distance, m, and between what it is. What is
            never within `clearance` + 0.05 m is left out.
        """
        found: dict[str, tuple[float, str]] = {}
        for pairs in self._pairs(self._model.plant_positions(q), self.clearance + _INFLUENCE):
            for pair in pairs:
                names = self._names(pair)
                party = next((name for name in names if name in self.obstacles), ITSELF)
                if pair.distance < found.get(party, (np.inf, ""))[0]:
                    found[party] = pair.distance, " and ".join(names)
        return found

    def constraint(self, q: Array) -> tuple[Array, Array]:
        """Return smooth numbers (N,), at most 1 where the clearance is kept; gradients (N, nq).

        These are those of `MinimumDistanceLowerBoundConstraint` at positions (N, nq) of the model.
        """
        whole = self._model.plant_positions(q)
        values, gradients = np.empty(len(q)), np.zeros(whole.shape)
        for i, posture in enumerate(whole):
            result = self._constraint.Eval(InitializeAutoDiff(posture).ravel())
            values[i] = ExtractValue(result).item()
            gradient = ExtractGradient(result).ravel()
            if gradient.size:
                gradients[i] = gradient
        J = self._model.coordinates.jacobian(q)
        return values, np.einsum("nij,ni->nj", J, gradients)

    def _pairs(self, q: Array, within: float) -> list[list[SignedDistancePair]]:
        """Return, for each posture, Drake's signed distances of pairs that are so near."""
        result = []
        for posture in q:
            self._plant.SetPositions(self._context, posture)
            query = self._plant.get_geometry_query_input_port().Eval(self._context)
            result.append(query.ComputeSignedDistancePairwiseClosestPoints(within))
        return result

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

    def _allow_overlaps(self, model: RobotModel) -> tuple[str, ...]:
        """Allow collisions of links that always overlap, with notes."""
        lower, upper = self._plant.GetPositionLowerLimits(), self._plant.GetPositionUpperLimits()
        bounded = np.isfinite(lower) & np.isfinite(upper)
        lower, upper = np.where(bounded, lower, -np.pi), np.where(bounded, upper, np.pi)
        q = np.random.default_rng(0).uniform(lower, upper, (_POSTURES, len(lower)))
        count: Counter[tuple[int, ...]] = Counter()
        words: dict[tuple[int, ...], str] = {}
        for pairs in self._pairs(q, 0.0):
            found = {}
            for pair in pairs:
                key = tuple(sorted(int(body.index()) for body in self._bodies(pair)))
                found[key] = " and ".join(self._names(pair))
            words |= found
            count.update(found.keys())
        world = int(self._plant.world_body().index())  # obstacles, which are not drawn to overlap
        overlapping = [
            key for key, times in count.items() if times >= _ALWAYS * _POSTURES and world not in key
        ]
        context = self._scene.GetMyMutableContextFromRoot(self._root)
        manager = self._scene.collision_filter_manager(context)
        for key in overlapping:
            bodies = (self._plant.get_body(BodyIndex(index)) for index in key)
            sets = (GeometrySet(self._plant.GetCollisionGeometriesForBody(b)) for b in bodies)
            manager.Apply(CollisionFilterDeclaration().ExcludeBetween(*sets))
        return tuple(
            f"{words[key]} of {model.path.name} overlap in nearly all postures, so their "
            "collisions are ignored."
            for key in overlapping
        )
