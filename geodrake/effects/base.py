"""What a physical effect is: the base classes of the family.

A robot model is a sum of effects, DESIGN's Eq. (1):

    effort needed = Y_rb(q, v, v̇) φ + Σ_e Y_e(motion; s_e) μ_e

An effect instance is bound to its place (a joint, a pair of joints, a body) and to its shape
parameters s_e; its linear parameters μ_e are what a fit finds.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.columns import rows_of, stacked
from geodrake.effects.gradient import RobotGradient, joint_gradient
from geodrake.effects.parameter import CheckedFields, Parameter, require_positive
from geodrake.effects.robot_motion import JointMotion, RobotMotion
from geodrake.errors import ArgumentError
from geodrake.manifolds import Interval, Manifold

__all__ = [
    "Array",
    "BodyEffect",
    "Effect",
    "JointEffect",
    "JointMotion",
    "JointPairEffect",
    "Parameter",
    "RobotMotion",
    "require_positive",
]

Array = NDArray[np.float64]


class Effect(CheckedFields, abc.ABC):
    """A physical effect at its place: regressor, parameters, force law, and what it looks like.

    Subclasses are frozen dataclasses whose fields are the place and the shape parameters.

    Class attributes:
        name: Name in commands, files and reports.
        parameters: The linear parameters, in the order of the regressor's columns.
        signature: What the effect looks like in a residual, in words.
        confused_with: Names of effects that a log may not tell apart from this one.
        places: "joint", "joint_pair", "body", "robot" or "log": what an instance is bound to.
        turning_only: Whether the effect makes sense at joints that turn only.
        from_residual: Whether a diagnosis finds its shape in the residual, instead of trying
            `candidates`.
        needs_known_inertia: Whether only inertias or payloads known from elsewhere can tell it.
        expandable: Whether the columns are slopes of something not linear in the parameters.
        sees_bodies: Whether the effect depends on where bodies are and how they move.
        sees_time: Whether the effect depends on the time since a log began.
        is_force: Whether it is a force on the robot, so that a simulation can have it.
        state_count: How many hidden states it has, decided by the motion so far.
    """

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    signature: ClassVar[str] = ""
    confused_with: ClassVar[tuple[str, ...]] = ()
    places: ClassVar[str]
    turning_only: ClassVar[bool] = False
    from_residual: ClassVar[bool] = False
    needs_known_inertia: ClassVar[bool] = False
    expandable: ClassVar[bool] = False
    sees_bodies: ClassVar[bool] = False
    sees_time: ClassVar[bool] = False
    is_force: ClassVar[bool] = True
    state_count: ClassVar[int] = 0

    @property
    @abc.abstractmethod
    def where(self) -> tuple[str, ...]:
        """Names of the joints or bodies that the effect acts at."""

    @property
    def place(self) -> str:
        """Where it acts, in words."""
        return " & ".join(self.where) or "base"

    @abc.abstractmethod
    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """Regressor columns, one entry per joint whose effort the effect changes.

        Returns:
            Joint name -> (N, k) columns, k = len(parameters), so that the effort needed at the
            joint is columns @ parameters. Effects *add* to the effort needed.
        """

    def regressor(self, motion: RobotMotion) -> Array:
        """The dense regressor Y_e, (N, nv, k)."""
        dense = np.zeros((len(motion.v), len(motion.joints), len(self.parameters)))
        for joint, columns in rows_of(self, motion).items():
            dense[:, motion.index(joint)] = columns
        return dense

    def effort(self, motion: RobotMotion, mu: Array) -> Array:
        """Effort needed because of the effect, (N, nv): the force law is its negative."""
        return self.regressor(motion) @ np.asarray(mu, float)

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Gradient of Σ weights ∘ regressor with respect to the motion, for excitation.

        Args:
            motion: The motion, of N samples.
            weights: (N, nv, k) weights of the regressor's entries.

        Returns:
            The gradient, or None if the effect does not know it: it is then taken by differences.
        """
        del motion, weights
        return None

    def state_rates(self, motion: RobotMotion, state: Array) -> Array:
        """Rates (N, s) of the hidden states (N, s), for simulation."""
        raise NotImplementedError

    def states_along(self, motion: RobotMotion) -> Array:
        """Hidden states (N, s) that a series and what was before it leave; zero if not known."""
        return np.zeros((len(motion.v), self.state_count))

    @property
    def manifold(self) -> Manifold:
        """The barrier-Hessian manifold that the linear parameters live on."""
        every = self.parameters
        return Interval(tuple(p.lower for p in every), tuple(p.upper for p in every))

    @property
    def shape(self) -> dict[str, Any]:
        """The fields that are not the place: the shape parameters by name."""
        place = {"joint", "joints", "body"}
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in place}  # type: ignore[arg-type]

    @property
    def told_shape(self) -> dict[str, Any]:
        """The shape parameters that a result tells of."""
        return self.shape

    @property
    def free_shapes(self) -> int:
        """How many shape parameters the data choose, beside the linear ones."""
        return sum(isinstance(value, float) for value in self.shape.values())

    def expanded_about(self, parameters: Array, bodies: RobotBodies) -> Effect:
        """The effect with columns exact near some values of its parameters, if `expandable`.

        Args:
            parameters: (k,) values.
            bodies: The robot's bodies, in no configuration.
        """
        del parameters, bodies
        return self

    @property
    def distinct(self) -> bool:
        """Whether the shape keeps the effect apart from simpler ones, so that it may be chosen."""
        return True

    @classmethod
    def candidates(cls, *args: Any, **kwargs: Any) -> Iterable[Effect]:
        """Instances a diagnosis should try at a place: one, unless the effect has shapes to try.

        A diagnosis calls it with a joint and its largest speed, with a pair of joints, or with a
        body, as `places` says.

        Raises:
            ArgumentError: The effect has shape parameters without a default.
        """
        make: Callable[..., Effect] = cls
        try:
            return (make(args[0]),)
        except TypeError as error:
            raise ArgumentError(
                f"{cls.name} cannot be made of its place {args[0]!r} alone: {error}.",
                advice="Give its shape parameters defaults, or define candidates().",
            ) from error


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect of one joint's own motion. Subclasses define `name`, `parameters`, `columns`."""

    joint: str
    places: ClassVar[str] = "joint"

    @property
    def where(self) -> tuple[str, ...]:
        """The joint."""
        return (self.joint,)

    @abc.abstractmethod
    def columns(self, joint: JointMotion) -> Sequence[ArrayLike]:
        """One column per parameter, (N,) or a number, from the motion of the joint."""

    def rows(self, motion: RobotMotion) -> Mapping[str, Array]:
        """The columns at the joint itself.

        Raises:
            ArgumentError: There is no such joint, or `columns` gave something unusable.
        """
        columns = self.columns(motion.joint(self.joint))
        return {self.joint: stacked(self, columns, self.joint, len(motion.v))}

    def slopes(self, joint: JointMotion) -> Sequence[Mapping[str, ArrayLike]] | None:
        """Of each column, its derivatives by `JointMotion` field; fields left out have none.

        `sign_v` is a field of its own: how it depends on v is known. None if the effect does not
        know them: they are then taken by differences.
        """
        del joint
        return None

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Gradient of Σ weights ∘ regressor with respect to the motion; see `Effect.gradient`."""
        if type(self).rows is not JointEffect.rows:
            return None
        slopes = self.slopes(motion.joint(self.joint))
        return joint_gradient(motion, self.joint, self.columns, slopes, weights)

    @classmethod
    def candidates(cls, joint: str, peak_speed: float) -> Iterable[Effect]:
        """Instances a diagnosis should try at a joint: one, or one for every shape on a grid.

        Args:
            joint: Name of the joint.
            peak_speed: Largest speed of the joint in the log, rad/s or m/s.
        """
        del peak_speed
        return super().candidates(joint)


@dataclass(frozen=True)
class JointPairEffect(Effect):
    """An effect that ties two joints together. Subclasses define `name`, `parameters`, `rows`."""

    joints: tuple[str, str]
    places: ClassVar[str] = "joint_pair"

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.joints) != 2 or self.joints[0] == self.joints[1]:
            raise ArgumentError(f"{self.name} needs two different joints; it got {self.joints}.")

    @property
    def where(self) -> tuple[str, ...]:
        """The two joints."""
        return self.joints

    @classmethod
    def candidates(cls, joints: tuple[str, str]) -> Iterable[Effect]:
        """Instances a diagnosis should try at a pair of joints."""
        return super().candidates(joints)


@dataclass(frozen=True)
class BodyEffect(Effect):
    """An effect that acts on a body. Subclasses define `name`, `parameters`, `rows`."""

    body: str
    places: ClassVar[str] = "body"

    @property
    def where(self) -> tuple[str, ...]:
        """The body."""
        return (self.body,)

    @classmethod
    def candidates(cls, body: str) -> Iterable[Effect]:
        """Instances a diagnosis should try at a body."""
        return super().candidates(body)
