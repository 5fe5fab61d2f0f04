"""Base classes of physical effects.

A robot model is a sum of effects, Eq. (1) of docs/design.md:

    effort needed = Y_rb(q, v, v̇) φ + Σ_e Y_e(motion; s_e) μ_e

An effect instance is bound to its place (a joint, a pair of joints, a body) and to its shape
parameters s_e. A fit estimates its linear parameters μ_e.
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
    FileTerm,
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
    "FileTerm",
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
"""Signals that columns may depend on; see `Effect`."""

BEYOND_MOTION = frozenset({"time", "history", "temperature"})
"""Signals that a formula of the present q, v and v̇ cannot use."""


class Effect(CheckedFields, abc.ABC):
    """A physical effect at its place.

    Subclasses are frozen dataclasses whose fields are the place and the shape parameters. They
    define `name`, `parameters` and columns; everything else has a default that suits most effects.

    Class attributes that describe the effect:
        name: Name in commands, files and reports.
        label: Name in sentences, if it differs from the name with spaces; proper names in capitals.
        law: One-line formula of the needed effort, for the table of effects.
        signature: Description of the effect's trace in a residual.
        role: How it changes the efforts.
        places: Kind of place it is bound to: "joint", "joint_pair", "body", "body_pair",
            "body_path", "bodies", "robot" or "log".
        parameters: The linear parameters, in the order of the regressor's columns.
        shapes: Unit and usual values of its shape parameters.
        positive: Names of shape parameters that must be above 0.
        depends_on: The signals that its columns depend on: positions "q", velocities "v" and
            accelerations "vd" of the joints; "load", the effort that the joints need otherwise;
            "time" since the log began; poses and motion of the "bodies"; "history" of the motion;
            and "temperature" of the joints (logs without it do not get the effect as a candidate).
            An effect without this declaration is evaluated to find out (see `dependencies`), but
            dependence on history or temperature must be declared.
        state_count: Number of hidden states, which depend on the motion so far.
        summary: Name of the reported value that represents the effect in one line.

    Class attributes for diagnosis, and relations to other effects:
        complexity: If the data cannot distinguish effects, the least complex one is named. 0 means
            that any joint may have it; unknown effort gains are estimated alongside it.
        turning_only: Whether the effect exists only at revolute joints.
        needs_known_inertia: Whether it can be identified only with known inertias or payloads.
        of_force_sensor: Whether it is a candidate only at bodies whose contact forces are logged.
        proposer: Residual pattern that proposes it, instead of all `candidates`. Effects of
            adjacent joint pairs are always candidates.
        contains: Effects at the same place that it replaces.
        companion: Effect that is proposed together with it, and fitted together at the end.
        jumps: Whether the effort jumps where a joint reverses, as dry friction does.
        of_motor: Whether it belongs to a motor, its gear or its effort sensor, or depends on the
            motor's effort. Passive joints do not have it.
        by_drive: Whether the drive causes it, so that no robot file can describe it.
        taken_out_as: Name used by drives that subtract it from the efforts they report.
        file_term: Its names in model files and fits of servos.
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
    file_term: ClassVar[FileTerm] = FileTerm()

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
        """Whether it acts at motors, as friction does, rather than at bodies."""
        return self.places in ("joint", "joint_pair")

    @abc.abstractmethod
    def rows(self, motion: RobotMotion) -> Rows:
        """Return the regressor columns, one entry per joint whose effort the effect changes.

        Returns:
            Joint name -> (N, k) columns, k = len(parameters), so that the effort needed at the
            joint is columns @ parameters. Effects *add* to the effort needed.
        """

    def fit_rows(self, motion: RobotMotion) -> Rows:
        """Return the derivatives of the effort with respect to the parameters, for fits.

        They equal `rows`, except for nonlinear effects with `in_bodies`.
        """
        return rows_of(self, motion)

    def formula_rows(self, motion: RobotMotion) -> Rows:
        """Return `rows`, using NumPy functions only, for recording (`geodrake.model.source`).

        Effects whose `rows` run compiled code must override it. Effects that depend on time or
        history return their steady state.
        """
        return self.rows(motion)

    def regressor(self, motion: RobotMotion) -> Array:
        """Return the dense regressor Y_e, (N, nv, k)."""
        dense = np.zeros((len(motion.v), len(motion.joints), len(self.parameters)))
        for joint, columns in rows_of(self, motion).items():
            dense[:, motion.index(joint)] = columns
        return dense

    def effort(self, motion: RobotMotion, mu: Array) -> Array:
        """Return the effort (N, nv) that the effect adds, with linear parameters mu (k,)."""
        return self.regressor(motion) @ np.asarray(mu, float)

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Return the gradient of Σ weights ∘ regressor with respect to the motion, for excitation.

        Args:
            weights: (N, nv, k) weights of the regressor's entries.

        Returns:
            The gradient, or None to have it computed by finite differences.
        """
        del motion, weights
        return None

    def state_rates(self, motion: RobotMotion, state: Array) -> Array:
        """Return rates (N, s) of the hidden states (N, s), for simulation."""
        raise NotImplementedError

    def states_along(self, motion: RobotMotion) -> Array:
        """Return the hidden states (N, s) along the motion and its history; zero if unknown."""
        return np.zeros((len(motion.v), self.state_count))

    @property
    def manifold(self) -> Manifold:
        """Return the barrier-Hessian manifold that the linear parameters live on."""
        lower = tuple(parameter.lower for parameter in self.parameters)
        return _interval(lower, tuple(parameter.upper for parameter in self.parameters))

    @property
    def shape(self) -> dict[str, Any]:
        """Return the shape parameters by name: all fields except the place."""
        place = {"joint", "joints", "body", "bodies"}
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in place}  # type: ignore[arg-type]

    @classmethod
    def fields_of(cls, where: Sequence[str], shape: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields other than the place of an instance with a shape."""
        del where
        return dict(shape)

    @property
    def reported_shape(self) -> dict[str, float]:
        """Return the numeric shape parameters, which results report."""
        shape = self.shape.items()
        return {name: float(value) for name, value in shape if isinstance(value, Real)}

    def reported(self, parameters: Array, deviations: Array) -> tuple[Values, Values]:
        """Return reported parameter and shape values, and standard deviations, by name.

        Args:
            parameters: (k,) linear parameters.
            deviations: (k,) their standard deviations, NaN if unknown.
        """
        names = [parameter.name for parameter in self.parameters]
        values = dict(zip(names, map(float, parameters), strict=True)) | self.reported_shape
        return values, dict(zip(names, map(float, deviations), strict=True))

    @classmethod
    def unit_of(cls, name: str) -> str:
        """Return the SI unit of a reported value at revolute joints; "1" for plain numbers."""
        units = {shape.name: shape.unit for shape in cls.shapes}
        units |= {parameter.name: parameter.unit for parameter in cls.parameters}
        return units.get(name, "1")

    @property
    def free_shapes(self) -> int:
        """Return the number of fitted shape parameters."""
        return sum(isinstance(value, float) for value in self.shape.values())

    @property
    def refines(self) -> tuple[tuple[type[Effect], ...], ...]:
        """Alternative sets of effects, one of which must already be present at its place.

        Most effects require none. Without the effects that it refines, a refinement would absorb
        part of them. An empty set among the alternatives allows it to stand alone.
        """
        return ()

    def expanded_about(self, parameters: Array, bodies: RobotBodies) -> Effect:
        """Return the effect linearized about the parameters (k,).

        Override it if the columns are derivatives of a nonlinear effort. `bodies` are those of the
        robot, without configurations.
        """
        del parameters, bodies
        return self

    def settled(self, parameters: Array, bodies: RobotBodies) -> tuple[Effect, Array]:
        """Convert parameters (k,) fitted with `fit_rows` to an effect and parameters for `rows`."""
        del bodies
        return self, parameters

    def gravity_of_bodies(self, gravity: Array) -> Array | None:
        """Return the gravity (3,), m/s², for the columns of bodies; None for the model's.

        The effort of an effect that changes gravity contains products of its parameters and those
        of bodies. About the returned gravity it is linear in both.
        """
        del gravity
        return None

    @property
    def in_bodies(self) -> Array:
        """(k,) parameters already included in the body columns under `gravity_of_bodies`."""
        return np.zeros(len(self.parameters))

    def course(self, along: Array) -> Array:
        """Return the effect's variation (N,) with time or position, for proposers.

        Args:
            along: (N,) time since the log began, s, or joint positions, depending on `proposer`.
        """
        raise NotImplementedError(f"{self.name} has no course() for {len(along)} samples.")

    @property
    def distinct(self) -> bool:
        """Whether the shape distinguishes the effect enough from simpler ones to be chosen."""
        return True

    @classmethod
    def shaped(cls, *place: Any, **scales: float) -> tuple[Self, ...]:
        """Return instances at a place for all combinations of shape values on the grids.

        Args:
            place: Where it acts; empty for an effect of the whole robot.
            scales: Reference sizes of relative grids, such as `speed`, keyed by `Shape.scale`.

        Raises:
            ArgumentError: The effect has shape parameters without a default or a grid.
        """
        make: Callable[..., Self] = cls
        by_name = {shape.name: shape.values(scales) for shape in cls.shapes}
        grids = {name: values for name, values in by_name.items() if values}
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
        """Return the candidates of a diagnosis at a place: one for every shape on the grids.

        Args:
            *args: The place, of the kind `places`: a joint and its peak speed (rad/s or m/s), a
                pair of joints, a body, or nothing.
            **kwargs: Unused; subclasses may accept keyword arguments.
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

    @classmethod
    def fitted(cls, joint: str, value: float, deviation: float) -> FittedEffect:
        """Return the effect with the value and standard deviation of its only parameter."""
        return FittedEffect(cls.shaped(joint)[0], np.array([value]), np.array([deviation]))

    @abc.abstractmethod
    def columns(self, joint: JointMotion) -> Sequence[ArrayLike]:
        """Return one column per parameter, (N,) or scalar, from the motion of the joint."""

    def rows(self, motion: RobotMotion) -> Rows:
        """Return the columns at the joint itself, or at the joints that move it.

        Raises:
            ArgumentError: There is no such joint, or `columns` returned invalid values.
        """
        columns = self.columns(motion.joint(self.joint))
        checked = stacked(self, columns, self.joint, len(motion.v))
        return motion.efforts_at(self.joint, checked)

    def formula_rows(self, motion: RobotMotion) -> Rows:
        """Return the columns at the joint itself; see `Effect.formula_rows`."""
        if type(self).rows is not JointEffect.rows and not self.depends_on & BEYOND_MOTION:
            return self.rows(motion)
        columns = self.columns(motion.joint(self.joint))
        shaped = [np.broadcast_to(column, (len(motion.v),)) for column in columns]
        return motion.efforts_at(self.joint, np.stack(shaped, -1))

    def slopes(self, joint: JointMotion) -> Slopes | None:
        """Return each column's derivatives by `JointMotion` field; missing ones are zero.

        Treat `sign_v` as independent of v. Return None to have finite differences used.
        """
        del joint
        return None

    def gradient(self, motion: RobotMotion, weights: Array) -> RobotGradient | None:
        """Return the gradient of Σ weights ∘ regressor; see `Effect.gradient`."""
        if type(self).rows is not JointEffect.rows or self.joint not in motion.joints:
            return None
        joint = motion.joint(self.joint)
        slopes = self.slopes(joint) or difference_slopes(self.columns, joint, self.depends_on)
        return joint_gradient(motion, self.joint, slopes, weights)


@dataclass(frozen=True)
class JointPairEffect(Effect):
    """An effect that couples two joints. Subclasses define `name`, `parameters`, `rows`."""

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
