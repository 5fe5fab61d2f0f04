"""Systems of Drake's that exist for several scalar types: floats, AutoDiffXd, Expression.

`add_scalar_types` is for systems whose laws are evaluated with numbers of any type. `differenced`
is for systems of floats, compiled ones say: their derivatives are differences.
"""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Sequence
from threading import RLock
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.symbolic import Expression
from pydrake.systems.framework import BasicVector_, LeafSystem, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from geodrake.inertia import Array
from geodrake.model.formulas.evaluation import Scalars

_TOLERANCE = 1e-10
_STEP = 6e-6  # cube root of the rounding of floats


def scalars(values: Any, scalar: type) -> Scalars:
    """Return an array of a scalar type, of entries of that type or floats."""
    if scalar is float:
        return np.asarray(values, float)
    array = np.asarray(values, object)
    flat = [x if isinstance(x, scalar) else scalar(x) for x in array.ravel()]
    found = np.empty(len(flat), object)
    found[:] = flat
    return found.reshape(array.shape)


def value_of(x: Scalars) -> Array:
    """Return the values (…) of an array of floats or of AutoDiffXd."""
    if np.asarray(x).dtype != object:
        return np.asarray(x, float)
    return ExtractValue(scalars(x, AutoDiffXd)).reshape(np.shape(x))


def slopes_of(x: Scalars) -> Array:
    """Return derivatives (n, d) of (n,) numbers; d = 0 where there are none."""
    return ExtractGradient(scalars(x, AutoDiffXd))


def solve(A: Scalars, b: Scalars) -> Scalars:
    """Return the solution (n,) of A x = b, with its derivatives dx = A⁻¹ (db − dA x).

    A (n, n) and b (n,) are of floats or AutoDiffXd.
    """
    if np.asarray(A).dtype != object and np.asarray(b).dtype != object:
        return np.linalg.solve(A, b)
    A_value, b_value = value_of(A), value_of(b)
    x = np.linalg.solve(A_value, b_value)
    # What b − A x changes by where x stays.
    change = slopes_of(scalars(b, AutoDiffXd) - scalars(A, AutoDiffXd) @ x)
    return InitializeAutoDiff(x, np.linalg.solve(A_value, change)).ravel()


def settled(before: Scalars, after: Scalars) -> bool:
    """Return whether numbers (n,), and their derivatives if they have any, change no more."""
    parts = [(value_of(before), value_of(after))]
    if after.dtype == object:
        parts.append((slopes_of(before), slopes_of(after)))
    return all(
        old.shape == new.shape
        and bool(np.abs(new - old).max(initial=0.0) <= _TOLERANCE * _size(new))
        for old, new in parts
    )


def _size(x: Array) -> float:
    return 1.0 + float(np.abs(x).max(initial=0.0))


def by_differences(function: Callable[[Array], Array], x: Scalars) -> Scalars:
    """Return a function of floats, from (n,) to (m,), at AutoDiffXd, its slopes by differences.

    Derivatives are exact to about 1e-9 of what they are differences of.
    """
    value, slopes = value_of(x), slopes_of(x)
    found = np.asarray(function(value), float)
    changes = np.zeros((len(found), slopes.shape[1]))
    known = np.isfinite(found)  # what is not has no slopes
    for k, direction in enumerate(slopes.T):
        moved = np.flatnonzero(direction)
        if len(moved):
            h = _STEP * _size(value[moved]) / np.abs(direction[moved]).max()
            ends = []
            for sign in (1.0, -1.0):
                there = value.copy()
                there[moved] += sign * h * direction[moved]
                ends.append(np.asarray(function(there), float)[known])
            changes[known, k] = (ends[0] - ends[1]) / (2.0 * h)
    return InitializeAutoDiff(found, changes).ravel()


System = TypeVar("System", bound=type)

if TYPE_CHECKING:

    class _Base(LeafSystem):
        """One of Drake's LeafSystems, of any scalar type."""

else:
    _Base = object


class ScalarSystem(_Base):
    """What systems of several scalar types have in common.

    A subclass declares ports and state in `_construct`, and in `_construct_copy` those of a copy of
    another scalar type; both begin with `_begin`. See `TemplateSystem` of pydrake.
    """

    _of: type = float

    def _begin(self, converter: Any) -> None:
        LeafSystem_[self._of].__init__(self, converter=converter)

    @property
    def scalar(self) -> type:
        """Return the scalar type: float, AutoDiffXd or Expression."""
        return self._of

    def Clone(self) -> Self:
        """Return a system like this one."""
        made = type(self)(self)
        made.set_name(self.get_name())
        return made

    def _vector(self, size_or_values: Any) -> Any:
        """Return a BasicVector of the scalar type."""
        if np.ndim(size_or_values) == 0:
            return BasicVector_[self._of](size_or_values)
        return BasicVector_[self._of](scalars(size_or_values, self._of))

    def _set(self, output: Any, values: Scalars) -> None:
        """Writes values, floats or of the scalar type, into an output or a state."""
        output.SetFromVector(scalars(values, self._of))


class _LazyTemplate(TemplateSystem):
    """The template of a system of floats, which begins as the first system is constructed.

    For each instantiation pydrake looks through the whole call stack. That is long, and slow to
    look through, while modules import one another: begun there, templates take seconds.
    """

    def __init__(
        self, made: type, other: Callable[[type], type], types: Sequence[type], constructor: Any
    ) -> None:
        """Gives the class a constructor that begins the template.

        Args:
            made: The system of floats, with `_construct` and `_construct_copy` of its own.
            types: The scalar types, float first.
        """
        kind: Any = made
        super().__init__(f"{made.__name__}_", list(types), scope=sys.modules[made.__module__])
        self._made, self._documented, self._lock = kind, constructor, RLock()

        @functools.wraps(constructor)
        def begin(system: Any, *args: Any, **options: Any) -> None:
            with self._lock:
                self.get_instantiation(float)  # which gives the class Drake's constructor
            kind.__init__(system, *args, **options)

        kind.__init__ = begin
        self.add_instantiations(
            lambda param: made if param == (float,) else other(param[0]), [(x,) for x in types]
        )

    def _on_add(self, param: Any, cls: Any, skip_rename: bool) -> Any:
        if cls is not self._made:
            return super()._on_add(param, cls, skip_rename)
        del cls.__init__
        super()._on_add(param, cls, skip_rename=True)
        functools.update_wrapper(cls.__init__, self._documented)
        return cls


def add_scalar_types(made: type, generic: type, *, symbolic: bool) -> TemplateSystem:
    """Lets a system be converted to Drake's other scalar types.

    Args:
        made: The system of floats: `generic` and LeafSystem, with `_construct` and
            `_construct_copy` of its own.
        generic: What it has for every scalar type.
        symbolic: Whether it can be one of Expression, beside AutoDiffXd.

    Returns:
        The template, for the module to have as the name of the system and `_`.
    """
    own, construct = vars(made), vars(made)["_construct"]

    def other(scalar: type) -> type:
        parts = {name: own[name] for name in ("_construct", "_construct_copy", "__doc__")}
        return type(made.__name__, (generic, LeafSystem_[scalar]), {**parts, "_of": scalar})

    types = [float, AutoDiffXd, *([Expression] if symbolic else [])]
    # That of `_construct`; pydrake's takes anything.
    of = inspect.signature(construct)
    shown = [p for name, p in of.parameters.items() if name not in ("self", "converter")]
    made.__signature__ = of.replace(parameters=shown)  # type: ignore[attr-defined]
    return _LazyTemplate(made, other, types, construct)


def differenced(made: System) -> System:
    """Lets a LeafSystem class be cloned, and converted to AutoDiffXd.

    A clone is made of the arguments of the constructor. AutoDiffXd has derivatives with inputs,
    states, numeric parameters and time, by central differences: exact to some 1e-9, where the
    system is smooth. There is no conversion to Expression.

    The class, or its base, gives its converter to LeafSystem: `LeafSystem.__init__(self,
    converter=self._converter)`. Its state is continuous and discrete, not abstract.
    """
    kind: Any = made
    init = kind.__init__

    def construct(self: Any, *args: Any, converter: Any = None, **options: Any) -> None:
        self._made_of = args, options  # (before Drake's constructor, which `init` calls)
        self._converter = converter
        init(self, *args, **options)

    def construct_copy(self: Any, other: Any, converter: Any = None) -> None:
        args, options = other._made_of
        construct(self, *args, converter=converter, **options)

    kind._construct, kind._construct_copy, kind.Clone = (
        construct,
        construct_copy,
        ScalarSystem.Clone,
    )

    def other(scalar: type) -> type:
        own = {name: vars(_Differenced)[name] for name in ("_construct", "_construct_copy")}
        return type(made.__name__, (_Differenced, LeafSystem_[scalar]), own)

    _LazyTemplate(made, other, (float, AutoDiffXd), init)
    return made


class _Differenced(ScalarSystem):
    """A system of AutoDiffXd whose values are those of one of floats."""

    _of = AutoDiffXd

    def _construct(self, *args: Any, converter: Any = None, **options: Any) -> None:
        raise TypeError("Make the system of floats, and convert it: system.ToAutoDiffXd().")

    def _construct_copy(self, other: Any, converter: Any = None) -> None:
        self._begin(converter)
        self._source = source = getattr(other, "_source", other)
        self._made_of = other._made_of
        context = source.CreateDefaultContext()
        ports = [source.get_input_port(i) for i in range(source.num_input_ports())]
        inputs = [self.DeclareVectorInputPort(p.get_name(), self._vector(p.size())) for p in ports]
        for i in range(context.num_numeric_parameter_groups()):
            self.DeclareNumericParameter(self._vector(context.get_numeric_parameter(i).value()))
        if context.num_continuous_states():
            state = context.get_continuous_state_vector().CopyToVector()
            self.DeclareContinuousState(self._vector(state))
        for i in range(context.num_discrete_state_groups()):
            self.DeclareDiscreteState(self._vector(context.get_discrete_state(i).value()))
        period = source.GetUniquePeriodicDiscreteUpdateAttribute()
        if period is not None:
            self.DeclarePeriodicDiscreteUpdateEvent(
                period.period_sec(), period.offset_sec(), self._update
            )
        inner = {self.all_state_ticket(), self.all_parameters_ticket(), self.time_ticket()}
        for j in range(source.num_output_ports()):
            port = source.get_output_port(j)
            through = [i for i in range(len(inputs)) if source.HasDirectFeedthrough(i, j)]
            self.DeclareVectorOutputPort(
                port.get_name(),
                self._vector(port.size()),
                functools.partial(self._calc_output, port.Eval, through),
                inner | {inputs[i].ticket() for i in through},
            )

    def _calc_output(self, function: Any, through: Sequence[int], context: Any, out: Any) -> None:
        out.SetFromVector(self._values(context, function, through))

    def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
        """Rates of the continuous states, per second."""
        if derivatives.size():
            rates = self._values(
                context, lambda inner: self._source.EvalTimeDerivatives(inner).CopyToVector()
            )
            derivatives.get_mutable_vector().SetFromVector(rates)

    def _update(self, context: Any, state: Any) -> None:
        groups = range(context.num_discrete_state_groups())

        def following(inner: Any) -> Array:
            after = self._source.EvalUniquePeriodicDiscreteUpdate(inner)
            return np.concatenate([after.value(i) for i in groups])

        sizes = [context.get_discrete_state(i).size() for i in groups]
        whole = self._values(context, following)
        for i, part in enumerate(np.split(whole, np.cumsum(sizes)[:-1])):
            state.set_value(i, part)

    def _values(
        self, context: Any, function: Callable[[Any], Array], inputs: Sequence[int] | None = None
    ) -> Scalars:
        """Return what a function (n,) of a Context of the source gives, with derivatives.

        Args:
            inputs: Indices of the inputs that matter; all if None.
        """
        chosen = range(self.num_input_ports()) if inputs is None else inputs
        known = [i for i in chosen if self.get_input_port(i).HasValue(context)]
        groups = range(context.num_numeric_parameter_groups())
        discrete = range(context.num_discrete_state_groups())
        parts = [
            *(self.get_input_port(i).Eval(context) for i in known),
            *(context.get_numeric_parameter(i).CopyToVector() for i in groups),
            context.get_continuous_state_vector().CopyToVector(),
            *(context.get_discrete_state(i).CopyToVector() for i in discrete),
            [context.get_time()],
        ]
        ends = np.cumsum([len(part) for part in parts])[:-1]
        scratch, source = self._source.CreateDefaultContext(), self._source

        def at(x: Array) -> Array:
            pieces = iter(np.split(x, ends))
            for i in known:
                source.get_input_port(i).FixValue(scratch, next(pieces))
            for i in groups:
                scratch.get_mutable_numeric_parameter(i).SetFromVector(next(pieces))
            states = next(pieces)
            if len(states):
                scratch.SetContinuousState(states)
            for i in discrete:
                scratch.SetDiscreteState(i, next(pieces))
            scratch.SetTime(float(next(pieces)[0]))
            return np.array(function(scratch), float)

        return by_differences(at, np.concatenate([scalars(part, AutoDiffXd) for part in parts]))
