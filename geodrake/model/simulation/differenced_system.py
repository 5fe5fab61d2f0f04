"""Systems of floats, compiled ones say, that can be cloned and have derivatives by differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.systems.framework import BasicVector_, LeafSystem_

from geodrake.inertia import Array
from geodrake.model.formulas.evaluation import Scalars
from geodrake.model.simulation.lazy_template import LazyTemplate
from geodrake.model.simulation.scalars import by_differences, scalars

System = TypeVar("System", bound=type)


def differenced(made: System) -> System:
    """Lets a LeafSystem class be cloned, and converted to AutoDiffXd.

    A clone is made of the arguments of the constructor. AutoDiffXd has derivatives with inputs,
    states, numeric parameters and time, by central differences: exact to some 1e-9, where the
    system is smooth. There is no conversion to Expression.

    The class, or its base, gives its converter to LeafSystem: `LeafSystem.__init__(self,
    converter=self._converter)`. Its state is continuous and discrete, not abstract.

    Args:
        made: The class, with an `__init__` of its own.
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

    def clone(self: Any) -> Any:
        """A system like this one."""
        copy = type(self)(self)
        copy.set_name(self.get_name())
        return copy

    for name, method in (
        ("_construct", construct),
        ("_construct_copy", construct_copy),
        ("Clone", clone),
    ):
        setattr(made, name, method)

    def other(scalar: type) -> type:
        own = {name: _Differenced.__dict__[name] for name in ("_construct", "_construct_copy")}
        return type(made.__name__, (_Differenced, LeafSystem_[scalar]), own)

    LazyTemplate(made, other, (float, AutoDiffXd), init)
    return made


class _Differenced:
    """A system of AutoDiffXd whose values are those of one of floats."""

    def _construct(self, *args: Any, converter: Any = None, **options: Any) -> None:
        raise TypeError("Make the system of floats, and convert it: system.ToAutoDiffXd().")

    def _construct_copy(self: Any, other: Any, converter: Any = None) -> None:
        LeafSystem_[AutoDiffXd].__init__(self, converter=converter)
        self._source, self._made_of = other, other._made_of
        context = other.CreateDefaultContext()
        ports = [other.get_input_port(i) for i in range(other.num_input_ports())]
        inputs = [self.DeclareVectorInputPort(p.get_name(), _vector(p.size())) for p in ports]
        for i in range(context.num_numeric_parameter_groups()):
            self.DeclareNumericParameter(_vector(context.get_numeric_parameter(i).value()))
        if context.num_continuous_states():
            state = context.get_continuous_state_vector().CopyToVector()
            self.DeclareContinuousState(_vector(state))
        for i in range(context.num_discrete_state_groups()):
            self.DeclareDiscreteState(_vector(context.get_discrete_state(i).value()))
        period = other.GetUniquePeriodicDiscreteUpdateAttribute()
        if period is not None:
            self.DeclarePeriodicDiscreteUpdateEvent(
                period.period_sec(), period.offset_sec(), self._update
            )
        inner = {self.all_state_ticket(), self.all_parameters_ticket(), self.time_ticket()}
        for j in range(other.num_output_ports()):
            port = other.get_output_port(j)
            through = {
                each.ticket() for i, each in enumerate(inputs) if other.HasDirectFeedthrough(i, j)
            }
            self.DeclareVectorOutputPort(
                port.get_name(), _vector(port.size()), self._output(port), inner | through
            )

    def _output(self: Any, port: Any) -> Callable[[Any, Any], None]:
        def calc(context: Any, output: Any) -> None:
            through = [
                i
                for i in range(self.num_input_ports())
                if self._source.HasDirectFeedthrough(i, port.get_index())
            ]
            output.SetFromVector(self._values(context, port.Eval, through))

        return calc

    def DoCalcTimeDerivatives(self: Any, context: Any, derivatives: Any) -> None:
        """Rates of the continuous states; see `LeafSystem`.

        Args:
            context: Context of this system.
            derivatives: Receives the rates, per second.
        """
        if not derivatives.size():
            return

        def rates(scratch: Any) -> Array:
            return np.asarray(self._source.EvalTimeDerivatives(scratch).CopyToVector())

        derivatives.get_mutable_vector().SetFromVector(self._values(context, rates))

    def _update(self: Any, context: Any, state: Any) -> None:
        groups = range(context.num_discrete_state_groups())

        def following(scratch: Any) -> Array:
            after = self._source.EvalUniquePeriodicDiscreteUpdate(scratch)
            return np.concatenate([after.value(i) for i in groups])

        whole = self._values(context, following)
        sizes = [context.get_discrete_state(i).size() for i in groups]
        for i, part in enumerate(np.split(whole, np.cumsum(sizes)[:-1])):
            state.set_value(i, part)

    def _values(
        self: Any, context: Any, function: Callable[[Any], Array], inputs: Any = None
    ) -> Scalars:
        """What a function of a Context of floats gives, with derivatives.

        Args:
            context: Context of this system.
            function: Gives (n,) of a Context of the source.
            inputs: Indices of the inputs that matter; all if None.
        """
        chosen = range(self.num_input_ports()) if inputs is None else inputs
        known = [i for i in chosen if self.get_input_port(i).HasValue(context)]
        parts = [self.get_input_port(i).Eval(context) for i in known]
        groups = range(context.num_numeric_parameter_groups())
        parts += [context.get_numeric_parameter(i).CopyToVector() for i in groups]
        parts.append(context.get_continuous_state_vector().CopyToVector())
        count = context.num_discrete_state_groups()
        parts += [context.get_discrete_state(i).CopyToVector() for i in range(count)]
        parts.append(scalars([context.get_time()], AutoDiffXd))
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
            for i in range(count):
                scratch.SetDiscreteState(i, next(pieces))
            scratch.SetTime(float(next(pieces)[0]))
            return np.array(function(scratch), float)

        return by_differences(at, np.concatenate([scalars(p, AutoDiffXd) for p in parts]))


def _vector(size_or_values: Any) -> Any:
    """A BasicVector of AutoDiffXd."""
    if np.ndim(size_or_values) == 0:
        return BasicVector_[AutoDiffXd](size_or_values)
    return BasicVector_[AutoDiffXd](scalars(size_or_values, AutoDiffXd))
