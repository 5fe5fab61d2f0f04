"""Whether a robot hits itself or obstacles, and how that depends on its posture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, Role, SignedDistancePair
from pydrake.multibody.inverse_kinematics import MinimumDistanceLowerBoundConstraint
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from geodrake.boundary.arguments import instance, instances, integer, number, typed
from geodrake.errors import ArgumentError
from geodrake.excitation.collision_geometry import Solid, add_collision_plant
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_INFLUENCE = 0.05  # m beyond the clearance at which the constraint begins to feel a distance
_POSTURES = 40
_ALWAYS = 0.9  # share of random postures in which parts overlap that are made to


class CollisionWorld:
    """A robot with collision geometry among obstacles.

    Neighbours in the tree may touch, and so may links that overlap in nearly all postures, since
    they are drawn so; `notes` says which.

    Args:
        model: The robot; collision geometry is read from its file.
        links: Body name -> further shapes of the link.
        clearance: Least distance to keep, m.
        use_file: Whether the file's own geometry counts.

    Raises:
        ModelError: The file cannot be read with its geometry.
        ArgumentError: There is no such body, nothing that can collide, or the clearance is
            negative.
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
        seed: int = 0,
    ) -> None:
        instance(model, "model", RobotModel)
        obstacles = instances(obstacles, "obstacles", Solid)
        links = {} if links is None else instance(links, "links", Mapping)
        links = {body: instances(each, f"links[{body!r}]", Solid) for body, each in links.items()}
        number(clearance, "clearance", lower=0.0)
        integer(seed, "seed", lower=0)
        builder = DiagramBuilder()
        self._plant, self._scene = add_collision_plant(
            builder, model, obstacles, links, use_file=use_file
        )
        if not self._scene.model_inspector().NumGeometriesWithRole(Role.kProximity):
            raise ArgumentError(
                f"{model.path} has no collision geometry and there are no obstacles.",
                advice="Give the links shapes with `links`, or leave collisions out.",
            )
        self._diagram = builder.Build()
        self._root = self._diagram.CreateDefaultContext()
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)
        self.clearance, self._model = clearance, model
        self.notes = self._allow_overlaps(model, seed)
        self._constraint = MinimumDistanceLowerBoundConstraint(
            plant=self._plant,
            bound=clearance,
            plant_context=self._context,
            influence_distance_offset=_INFLUENCE,
        )

    def distances(self, q: Array) -> tuple[Array, tuple[str, ...]]:
        """Least signed distances, m, and between what they are.

        Args:
            q: (N, nq) positions of the model.

        Returns:
            (N,) distances, negative where bodies overlap, and N pairs of names such as
            "hand and table"; no more than `clearance` + 0.05 m is distinguished from infinity.
        """
        found, names = np.full(len(q), np.inf), [""] * len(q)
        whole = self._model.plant_positions(q)
        for i, pairs in enumerate(self._pairs(whole, self.clearance + _INFLUENCE)):
            if pairs:
                nearest = min(pairs, key=lambda pair: pair.distance)
                found[i], names[i] = nearest.distance, " and ".join(self._names(nearest))
        return found, tuple(names)

    def constraint(self, q: Array) -> tuple[Array, Array]:
        """Return a smooth number that is at most one where the clearance is kept, and its gradient.

        Args:
            q: (N, nq) positions of the model.

        Returns:
            (N,) values and (N, nq) gradients of `MinimumDistanceLowerBoundConstraint`.
        """
        whole = self._model.plant_positions(q)
        values, gradients = np.empty(len(q)), np.zeros(whole.shape)
        for i, posture in enumerate(whole):
            result = self._constraint.Eval(InitializeAutoDiff(posture).ravel())
            values[i] = ExtractValue(result).item()
            gradient = ExtractGradient(result).ravel()
            if gradient.size:
                gradients[i] = gradient
        return values, self._model.robot_gradient(q, gradients)

    def _pairs(self, q: Array, within: float) -> list[list[SignedDistancePair]]:
        """For each posture, Drake's signed distances of pairs that are so near."""
        result = []
        for posture in q:
            self._plant.SetPositions(self._context, posture)
            query = self._plant.get_geometry_query_input_port().Eval(self._context)
            result.append(query.ComputeSignedDistancePairwiseClosestPoints(within))
        return result

    def _names(self, pair: SignedDistancePair) -> tuple[str, str]:
        inspector = self._scene.model_inspector()
        names = []
        for geometry in (pair.id_A, pair.id_B):
            body = self._plant.GetBodyFromFrameId(inspector.GetFrameId(geometry))
            is_world = body.index() == self._plant.world_body().index()
            names.append(inspector.GetName(geometry).split("::")[-1] if is_world else body.name())
        return names[0], names[1]

    def _allow_overlaps(self, model: RobotModel, seed: int) -> tuple[str, ...]:
        """Lets links overlap that always do; says which."""
        lower, upper = self._plant.GetPositionLowerLimits(), self._plant.GetPositionUpperLimits()
        bounded = np.isfinite(lower) & np.isfinite(upper)
        lower, upper = np.where(bounded, lower, -np.pi), np.where(bounded, upper, np.pi)
        q = np.random.default_rng(seed).uniform(lower, upper, (_POSTURES, len(lower)))
        count: Counter[tuple[int, int]] = Counter()
        words = {}
        inspector = self._scene.model_inspector()
        for pairs in self._pairs(q, 0.0):
            bodies = set()
            for pair in pairs:
                frames = (inspector.GetFrameId(g) for g in (pair.id_A, pair.id_B))
                key = sorted(int(self._plant.GetBodyFromFrameId(f).index()) for f in frames)
                bodies.add((key[0], key[1]))
                words[key[0], key[1]] = " and ".join(self._names(pair))
            count.update(bodies)
        world = int(self._plant.world_body().index())  # obstacles, which are not drawn to overlap
        overlapping = [
            key for key, times in count.items() if times >= _ALWAYS * _POSTURES and world not in key
        ]
        manager = self._scene.collision_filter_manager(
            self._scene.GetMyMutableContextFromRoot(self._root)
        )
        for first, second in overlapping:
            sets = (
                GeometrySet(
                    self._plant.GetCollisionGeometriesForBody(
                        self._plant.get_body(BodyIndex(index))
                    )
                )
                for index in (first, second)
            )
            manager.Apply(CollisionFilterDeclaration().ExcludeBetween(*sets))
        return tuple(
            f"{words[key]} of {model.path.name} overlap in nearly all postures: they may."
            for key in overlapping
        )
