"""LeafSystems of floats that convert to AutoDiffXd by finite differences."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import RLock
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient, ExtractValue, InitializeAutoDiff
from pydrake.systems.framework import BasicVector_, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from geodrake.inertia import Array

Scalars = NDArray[Any]
"""An array of floats, or of AutoDiffXd."""

_STEP = 3e-5  # at most a thirtieth of the width over which friction's sign is smoothed
_SHARE = 1e-3  # relative step of small parameters
_LEAST_STEP = 1e-9


def scalars(values: Any, scalar: type) -> Scalars:
    """Return an array of a scalar type from entries of that type or floats."""
    if scalar is float:
        return np.asarray(values, float)
    array = np.asarray(values, object)
    flat = [x if isinstance(x, scalar) else scalar(x) for x in array.ravel()]
    result = np.empty(len(flat), object)
    result[:] = flat
    return result.reshape(array.shape)


def by_differences(
    function: Callable[[Array], Array], x: Scalars, parameters: slice = slice(0)
) -> Scalars:
    """Evaluate a function of floats, from (n,) to (m,), at AutoDiffXd by finite differences.

    Differences are central, of fourth order, with relative errors of about 1e-9. Steps of small
    parameters are relative, because forces may be divided by them, as by a compliance.
    """
    scalars_in = scalars(x, AutoDiffXd)
    value, slopes = ExtractValue(scalars_in).ravel(), ExtractGradient(scalars_in)
    result = np.asarray(function(value), float)
    changes = np.zeros((len(result), slopes.shape[1]))
    known = np.isfinite(result)  # others have no derivatives
    steps = _STEP * (1.0 + np.abs(value))
    size = np.abs(value[parameters])
    steps[parameters] = np.where(size > 0, np.clip(_SHARE * size, _LEAST_STEP, _STEP), _STEP)
    for k, direction in enumerate(slopes.T):
        moved = np.flatnonzero(direction)
        if len(moved):
            h = (steps[moved] / np.abs(direction[moved])).min()
            for share, weight in ((1.0, 8.0), (2.0, -1.0)):
                for sign in (1.0, -1.0):
                    point = value.copy()
                    point[moved] += sign * share * h * direction[moved]
                    changes[known, k] += sign * weight * np.asarray(function(point), float)[known]
            changes[known, k] /= 12.0 * h
    return InitializeAutoDiff(result, changes).ravel()


System = TypeVar("System", bound=type)
_ONE_AT_A_TIME = RLock()


def differenced(leaf: System) -> System:
    """Make a LeafSystem class clonable, and convertible to AutoDiffXd.

    A clone is constructed with the same arguments. Derivatives with respect to inputs, states,
    numeric parameters and time are finite differences, with errors of about 1e-9 where the system
    is smooth. There is no conversion to Expression.

    The class, or its base, must pass its converter on: `LeafSystem.__init__(self,
    converter=self._converter)`. It must have no abstract state.
    """
    kind: Any = leaf
    init = kind.__init__

    def construct(self: Any, *args: Any, converter: Any = None, **options: Any) -> None:
        self._made_of = args, options  # (before Drake's constructor, which `init` calls)
        self._converter = converter
        init(self, *args, **options)

    def construct_copy(self: Any, other: Any, converter: Any = None) -> None:
        args, options = other._made_of
        construct(self, *args, converter=converter, **options)

    def clone(self: Any) -> Any:
        """Return a system like this one."""
        leaf = type(self)(self)
        leaf.set_name(self.get_name())
        return leaf

    kind._construct, kind._construct_copy, kind.Clone = construct, construct_copy, clone

    def other() -> type:
        own = {name: vars(_Differenced)[name] for name in ("_construct", "_construct_copy")}
        return type(leaf.__name__, (_Differenced, LeafSystem_[AutoDiffXd]), {**own, "Clone": clone})

    def make_template() -> None:
        del kind.__init__  # Drake adds a constructor
        scope, types = sys.modules[leaf.__module__], [float, AutoDiffXd]
        template = TemplateSystem(f"{leaf.__name__}_", types, scope=scope)
        template.add_instantiation((float,), kind, skip_rename=True)
        template.add_instantiations(lambda _: other(), [(AutoDiffXd,)])
        functools.update_wrapper(kind.__init__, init)

    # pydrake inspects the whole call stack for each instantiation, which is slow in notebooks and
    # during imports. The stack of a new thread is short.
    @functools.wraps(init)
    def begin(system: Any, *args: Any, **options: Any) -> None:
        with _ONE_AT_A_TIME:
            if kind.__init__ is begin:
                with ThreadPoolExecutor(1) as thread:
                    thread.submit(make_template).result()
        kind.__init__(system, *args, **options)

    kind.__init__ = begin
    return leaf


class _Differenced:
    """A system of AutoDiffXd that evaluates one of floats."""

    def _construct(self: Any, *args: Any, converter: Any = None, **options: Any) -> None:
        raise TypeError("Construct the system with floats, and convert it: system.ToAutoDiffXd().")

    def _construct_copy(self: Any, other: Any, converter: Any = None) -> None:
        LeafSystem_[AutoDiffXd].__init__(self, converter=converter)
        self._source = source = getattr(other, "_source", other)
        self._made_of = other._made_of
        context = source.CreateDefaultContext()
        ports = [source.get_input_port(i) for i in range(source.num_input_ports())]
        inputs = [self.DeclareVectorInputPort(p.get_name(), _vector(p.size())) for p in ports]
        for i in range(context.num_numeric_parameter_groups()):
            self.DeclareNumericParameter(_vector(context.get_numeric_parameter(i).value()))
        if context.num_continuous_states():
            state = context.get_continuous_state_vector().CopyToVector()
            self.DeclareContinuousState(_vector(state))
        for i in range(context.num_discrete_state_groups()):
            self.DeclareDiscreteState(_vector(context.get_discrete_state(i).value()))
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
                _vector(port.size()),
                functools.partial(self._calc_output, port.Eval, through),
                inner | {inputs[i].ticket() for i in through},
            )

    def _calc_output(
        self: Any, function: Any, through: Sequence[int], context: Any, out: Any
    ) -> None:
        out.SetFromVector(self._values(context, function, through))

    def DoCalcTimeDerivatives(self: Any, context: Any, derivatives: Any) -> None:
        """Calculate the rates of the continuous states, per second."""
        if derivatives.size():
            rates = self._values(
                context, lambda inner: self._source.EvalTimeDerivatives(inner).CopyToVector()
            )
            derivatives.get_mutable_vector().SetFromVector(rates)

    def _update(self: Any, context: Any, state: Any) -> None:
        groups = range(context.num_discrete_state_groups())

        def following(inner: Any) -> Array:
            after = self._source.EvalUniquePeriodicDiscreteUpdate(inner)
            return np.concatenate([after.value(i) for i in groups])

        sizes = [context.get_discrete_state(i).size() for i in groups]
        values = self._values(context, following)
        for i, part in enumerate(np.split(values, np.cumsum(sizes)[:-1])):
            state.set_value(i, part)

    def _values(
        self: Any,
        context: Any,
        function: Callable[[Any], Array],
        inputs: Sequence[int] | None = None,
    ) -> Scalars:
        """Return the values (n,) of a function of the source's Context, with derivatives.

        `inputs` are the indices of relevant input ports; all if None.
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

        variables = np.concatenate([scalars(part, AutoDiffXd) for part in parts])
        first, last = np.concatenate([[0], ends])[[len(known), len(known) + len(groups)]]
        return by_differences(at, variables, slice(first, last))


def _vector(size_or_values: Any) -> Any:
    """Return a BasicVector of AutoDiffXd."""
    if np.ndim(size_or_values):
        size_or_values = scalars(size_or_values, AutoDiffXd)
    return BasicVector_[AutoDiffXd](size_or_values)
