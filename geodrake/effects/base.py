"""Base classes of physical effects.

A robot model is a sum of effects, Eq. (1) of docs/design.md:

    effort needed = Y_rb(q, v, v̇) φ + Σ_e Y_e(motion; s_e) μ_e

An effect instance is bound to its place (a joint, a pair of joints, a body) and to its shape
parameters s_e; its linear parameters μ_e are what a fit finds.
"""

from __future__ import annotations

import abc
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from itertools import product
from numbers import Real
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from geodrake.boundary.arguments import instance, real_array
from geodrake.boundary.showing import Short
from geodrake.effects.body_motion import RobotBodies
from geodrake.effects.column_checks import rows_of, stacked
from geodrake.effects.declarations import (
    PLACES,
    CheckedFields,
    Parameter,
    Proposer,
    Role,
    Shape,
    require_positive,
)
from geodrake.effects.gradient import RobotGradient, difference_slopes, joint_gradient
from geodrake.effects.robot_motion import JointMotion, RobotMotion
from geodrake.errors import ArgumentError
from geodrake.manifolds import Interval, Manifold

__all__ = [
    "Array",
    "BodyEffect",
    "Effect",
    "FittedEffect",
    "JointEffect",
    "JointMotion",
    "JointPairEffect",
    "Parameter",
    "Proposer",
    "RobotEffect",
    "RobotMotion",
    "Role",
    "Shape",
    "require_positive",
]

Array = NDArray[np.float64]
Values = dict[str, float]
Rows = Mapping[str, Array]
Slopes = Sequence[Mapping[str, ArrayLike]]

SIGNALS = frozenset({"q", "v", "vd", "load", "time", "bodies", "history", "temperature"})
"""Dependencies of columns; see `Effect`."""

BEYOND_MOTION = frozenset({"time", "history", "temperature"})
"""Those of them that a formula of the present q, v and v̇ does not have."""


class Effect(CheckedFields, abc.ABC):
    """A physical effect at its place.

    Subclasses are frozen dataclasses whose fields are the place and the shape parameters. They
    define `name`, `parameters` and columns; all else has a default that suits most effects.

    Class attributes, what it is:
        name: Name in commands, files and reports.
        label: Name in sentences, where it is not the name with spaces, proper names in capitals.
        law: The needed effort in a line, for the table of effects.
        signature: What the effect looks like, in words.
        role: What it does to the efforts.
        places: "joint", "joint_pair", "body", "body_pair", "bodies", "robot" or "log": what it is
            bound to.
        parameters: The linear parameters, in the order of the regressor's columns.
        shapes: Unit and usual values of its shape parameters.
        positive: Names of shape parameters that are above 0.
        depends_on: The signals that its columns depend on: positions "q", velocities "v" and
            accelerations "vd" of the joints, "load", the effort that the joints need otherwise,
            the "time" since a log began, where "bodies" are and how they move, the "history" of
            the motion, and the "temperature" of the joints: without one in a log nobody tries it
            there. One that leaves it out is tried (see `dependencies`); a dependence on
            the history or the temperature must be declared.
        state_count: How many hidden states it has, decided by the motion so far.
        summary: The reported value that stands for all of them in a line.

    How a diagnosis looks for it, and its relations to others:
        complexity: Of effects that the data cannot tell apart, the least complex one is named. 0
            for what any joint may have: unknown gains of efforts are found beside it.
        turning_only: Whether the effect makes sense at joints that turn only.
        needs_known_inertia: Whether only inertias or payloads known from elsewhere can tell it.
        of_force_sensor: Whether it is tried only at bodies whose contact forces a log has.
        proposer: What in a residual proposes it, instead of trying all `candidates`; effects of
            pairs of joints that follow each other are tried all the same.
        contains: Effects of the same place that it replaces.
        companion: The effect that is offered beside it as a pair, and fitted beside it at the end.
        jumps: Whether it jumps where a joint reverses, as dry friction does.
        of_motor: Whether it is of a motor, its gear or its sensor of efforts, or varies with the
            effort of one: passive joints have none.
        by_drive: Whether it is the drive that does it, so that nothing in a robot's file can.
        taken_out_as: What drives that take it out of the efforts that they report call it.
    """

    name: ClassVar[str]
    label: ClassVar[str] = ""
    law: ClassVar[str] = ""
    signature: ClassVar[str] = ""
    role: ClassVar[Role] = Role.FORCE
    places: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    shapes: ClassVar[tuple[Shape, ...]] = ()
    positive: ClassVar[tuple[str, ...]] = ()
    depends_on: ClassVar[frozenset[str]] = frozenset({"q", "v", "vd", "load"})
    state_count: ClassVar[int] = 0
    summary: ClassVar[str] = ""

    complexity: ClassVar[int] = 2
    turning_only: ClassVar[bool] = False
    needs_known_inertia: ClassVar[bool] = False
    of_force_sensor: ClassVar[bool] = False
    proposer: ClassVar[Proposer | None] = None
    contains: ClassVar[tuple[type[Effect], ...]] = ()
    companion: ClassVar[type[Effect] | None] = None
    jumps: ClassVar[bool] = False
    of_motor: ClassVar[bool] = False
    by_drive: ClassVar[bool] = False
    taken_out_as: ClassVar[str] = ""

    @property
    def where(self) -> tuple[str, ...]:
        """Names of the joints or bodies that the effect acts at."""
        field = PLACES[self.places].field
        named = getattr(self, field, None) if field else None
        return () if named is None else (named,) if isinstance(named, str) else tuple(named)

    @property
    def place(self) -> str:
        """Return where it acts, in words."""
        return " & ".join(self.where) or "base"

    @property
    def at_motor(self) -> bool:
        """Whether it acts at motors, as friction does, and not at bodies (`DeflectionEffect`)."""
        return self.places in ("joint", "joint_pair")

    @abc.abstractmethod
    def rows(self, motion: RobotMotion) -> Rows:
        """Return the regressor columns, one entry per joint whose effort the effect changes.

        Returns:
            Joint name -> (N, k) columns, k = len(parameters), so that the effort needed at the
            joint is columns @ parameters. Effects *add* to the effort needed.
        """

    def fit_rows(self, motion: RobotMotion) -> Rows:
        """Return the columns of fits: changes of the effort with the parameters.

        They are `rows`, but for effects that are not linear and have `in_bodies`.
        """
        return rows_of(self, motion)

    def formula_rows(self, motion: RobotMotion) -> Rows:
        """`rows` with NumPy functions only, for recording (`geodrake.model.source`).

        An effect whose `rows` run compiled code defines it, too. One that depends on the time or
        on history is as if it had gone on for long.
        """
        return self.rows(motion)

    def regressor(self, motion: RobotMotion) -> Array:
        """Return the dense regressor Y_e, (N, nv, k)."""
        dense = np.zeros((len(motion.v), len(motion.joints), len(self.parameters)))
        for joint, columns in rows_of(self, motion).items():
            dense[:, motion.index(joint)] = columns
        return dense

    def effort(self, motion: RobotMotion, mu: Array) -> Array:
        """Return effort (N, nv) needed because of the effect with linear parameters mu (k,), SI."""
        return self.regressor(motion) @ np.asarray(mu, float)

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Return the gradient of Σ weights ∘ regressor with respect to the motion, for excitation.

        Args:
            weights: (N, nv, k) weights of the regressor's entries.

        Returns:
            The gradient, or None if the effect does not know it: it is then taken by differences.
        """
        del motion, weights
        return None

    def state_rates(self, motion: RobotMotion, state: Array) -> Array:
        """Return rates (N, s) of the hidden states (N, s), for simulation."""
        raise NotImplementedError

    def states_along(self, motion: RobotMotion) -> Array:
        """Hidden states (N, s) after a series and its history; zero if unknown."""
        return np.zeros((len(motion.v), self.state_count))

    @property
    def manifold(self) -> Manifold:
        """Return the barrier-Hessian manifold that the linear parameters live on."""
        every = self.parameters
        return _interval(tuple(p.lower for p in every), tuple(p.upper for p in every))

    @property
    def shape(self) -> dict[str, Any]:
        """Return the fields that are not the place: the shape parameters by name."""
        place = {"joint", "joints", "body", "bodies"}
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in place}  # type: ignore[arg-type]

    @property
    def reported_shape(self) -> dict[str, float]:
        """Return the shape parameters that results report: those that are numbers."""
        shape = self.shape.items()
        return {name: float(value) for name, value in shape if isinstance(value, Real)}

    def reported(self, parameters: Array, deviations: Array) -> tuple[Values, Values]:
        """Values of parameters and shape as results report them, and standard deviations, by name.

        Args:
            parameters: (k,) linear parameters.
            deviations: (k,) their standard deviations, NaN where they are not known.
        """
        names = [parameter.name for parameter in self.parameters]
        values = dict(zip(names, map(float, parameters), strict=True)) | self.reported_shape
        return values, dict(zip(names, map(float, deviations), strict=True))

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Return the SI unit of a reported value at joints that turn; "1" for plain numbers."""
        units = {shape.name: shape.unit for shape in cls.shapes}
        units |= {parameter.name: parameter.unit for parameter in cls.parameters}
        return units.get(name, "1")

    @property
    def free_shapes(self) -> int:
        """Return the number of shape parameters that are fitted, besides the linear ones."""
        return sum(isinstance(value, float) for value in self.shape.values())

    @property
    def refines(self) -> tuple[tuple[type[Effect], ...], ...]:
        """Sets of effects, one of which must already be at its place.

        Nothing for most effects. Alone, a refinement would be a compromise of what it refines,
        unless an empty set is among them.
        """
        return ()

    def expanded_about(self, parameters: Array, bodies: RobotBodies) -> Effect:
        """Return the effect with columns exact near values (k,) of its parameters.

        An effect defines it whose columns are slopes of something not linear in the parameters.
        `bodies` are the robot's, in no configuration.
        """
        del parameters, bodies
        return self

    def settled(self, parameters: Array, bodies: RobotBodies) -> tuple[Effect, Array]:
        """Return the effect, and parameters (k,), whose `rows` do what a fit by `fit_rows` says."""
        del bodies
        return self, parameters

    def gravity_of_bodies(self, gravity: Array) -> Array | None:
        """Gravity for columns of bodies with the effect; None for the model's.

        An effect that changes gravity (3,), m/s², is a product of its parameters with those of
        bodies. About that gravity it is linear in both.
        """
        del gravity
        return None

    @property
    def in_bodies(self) -> Array:
        """(k,) parameters that the columns of bodies contain at `gravity_of_bodies`."""
        return np.zeros(len(self.parameters))

    def course(self, along: Array) -> Array:
        """Return how it varies with time or along a path, for proposers that try it on a residual.

        Args:
            along: (N,) instants since the log began, s, or positions of the joint, by `proposer`.
        """
        raise NotImplementedError(f"{self.name} has no course() for {len(along)} samples.")

    @property
    def distinct(self) -> bool:
        """Whether the shape keeps the effect apart from simpler ones, so that it may be chosen."""
        return True

    @classmethod
    def shaped(cls, *place: Any, **scales: float) -> tuple[Self, ...]:
        """Instances at a place with every combination of the values on the grids of `shapes`.

        Args:
            place: Where it acts; nothing for an effect of the whole robot.
            scales: Sizes that grids are shares of, such as `speed`, by the names of `Shape.scale`.

        Raises:
            ArgumentError: The effect has shape parameters without a default or a grid.
        """
        make: Callable[..., Self] = cls
        tried = {shape.name: shape.values(scales) for shape in cls.shapes}
        grids = {name: values for name, values in tried.items() if values}
        try:
            return tuple(
                make(*place, **dict(zip(grids, values, strict=True)))
                for values in product(*grids.values())
            )
        except TypeError as error:
            raise ArgumentError(
                f"{cls.name} cannot be constructed from its place "
                f"{', '.join(map(repr, place))} alone: {error}.",
                advice="Give its shape parameters defaults, or define candidates().",
            ) from error

    @classmethod
    def candidates(cls, *args: Any, **kwargs: Any) -> Iterable[Effect]:
        """Return instances a diagnosis should try at a place: one for every shape on the grids.

        Args:
            *args: The place, as `places` says: a joint and its largest speed (rad/s or m/s), a pair
                of joints, a body, or nothing.
            **kwargs: Not used; a subclass may take arguments of its own by name.
        """
        del kwargs
        place, speed = args[:1], args[1:2]
        return cls.shaped(*place, **({"speed": speed[0]} if speed else {}))


@cache
def _interval(lower: tuple[float, ...], upper: tuple[float, ...]) -> Interval:
    return Interval(lower, upper)


@dataclass(frozen=True)
class JointEffect(Effect):
    """An effect of one joint's own motion. Subclasses define `name`, `parameters`, `columns`."""

    joint: str
    places: ClassVar[str] = "joint"

    @abc.abstractmethod
    def columns(self, joint: JointMotion) -> Sequence[ArrayLike]:
        """Return one column per parameter, (N,) or a number, from the motion of the joint."""

    def rows(self, motion: RobotMotion) -> Rows:
        """Return the columns at the joint itself, or at the joints that move it.

        Raises:
            ArgumentError: There is no such joint, or `columns` gave something unusable.
        """
        columns = self.columns(motion.joint(self.joint))
        own = stacked(self, columns, self.joint, len(motion.v))
        return motion.efforts_at(self.joint, own)

    def formula_rows(self, motion: RobotMotion) -> Rows:
        """Return the columns at the joint itself; see `Effect.formula_rows`."""
        if type(self).rows is not JointEffect.rows and not self.depends_on & BEYOND_MOTION:
            return self.rows(motion)
        columns = self.columns(motion.joint(self.joint))
        shaped = [np.broadcast_to(column, (len(motion.v),)) for column in columns]
        return motion.efforts_at(self.joint, np.stack(shaped, -1))

    def slopes(self, joint: JointMotion) -> Slopes | None:
        """The derivative of each column by `JointMotion` fields; missing ones are zero.

        `sign_v` is a field of its own: how it depends on v is known. None if the effect does not
        know them: they are then taken by differences.
        """
        del joint
        return None

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Gradient of Σ weights ∘ regressor with respect to the motion; see `Effect.gradient`."""
        if type(self).rows is not JointEffect.rows or self.joint not in motion.joints:
            return None
        joint = motion.joint(self.joint)
        slopes = self.slopes(joint) or difference_slopes(self.columns, joint, self.depends_on)
        return joint_gradient(motion, self.joint, slopes, weights)


@dataclass(frozen=True)
class JointPairEffect(Effect):
    """An effect that ties two joints together. Subclasses define `name`, `parameters`, `rows`."""

    joints: tuple[str, str]
    places: ClassVar[str] = "joint_pair"

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.joints) != 2 or self.joints[0] == self.joints[1]:
            raise ArgumentError(f"{self.name} needs two different joints; got {self.joints}.")


@dataclass(frozen=True)
class BodyEffect(Effect):
    """An effect that acts on a body. Subclasses define `name`, `parameters`, `rows`."""

    body: str
    places: ClassVar[str] = "body"
    depends_on: ClassVar[frozenset[str]] = frozenset({"q", "v", "vd", "load", "bodies"})


@dataclass(frozen=True)
class RobotEffect(Effect):
    """An effect of the whole robot. Subclasses define `name`, `parameters`, `rows`."""

    places: ClassVar[str] = "robot"
    depends_on: ClassVar[frozenset[str]] = frozenset({"q", "v", "vd", "load", "bodies"})


@dataclass(frozen=True, eq=False)
class FittedEffect(Short):
    """An effect with the values of its linear parameters.

    Attributes:
        effect: The effect at its place.
        parameters: (k,) values, in the order and units of `effect.parameters`.
        deviations: (k,) their standard deviations; None for values that were not fitted.
    """

    effect: Effect
    parameters: Array
    deviations: Array | None = None

    def __post_init__(self) -> None:
        shape = (len(instance(self.effect, "effect", Effect).parameters),)
        name = f"{self.effect.name} of {self.effect.place}"
        values = real_array(self.parameters, f"parameters of {name}", shape)
        object.__setattr__(self, "parameters", values)
        if self.deviations is not None:
            values = real_array(self.deviations, f"deviations of {name}", shape, finite=False)
            if np.isnan(values).any():
                raise ArgumentError(
                    f"deviations of {name} have NaN; unknown ones must be infinite."
                )
            object.__setattr__(self, "deviations", values)
