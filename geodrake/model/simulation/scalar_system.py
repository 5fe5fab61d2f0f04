"""Systems of Drake's that exist for several scalar types: floats, AutoDiffXd, Expression."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from pydrake.autodiffutils import AutoDiffXd
from pydrake.symbolic import Expression
from pydrake.systems.framework import BasicVector_, LeafSystem, LeafSystem_
from pydrake.systems.scalar_conversion import TemplateSystem

from geodrake.model.formulas.evaluation import Scalars
from geodrake.model.simulation.lazy_template import LazyTemplate
from geodrake.model.simulation.scalars import scalars

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
        """The scalar type: float, AutoDiffXd or Expression."""
        return self._of

    def Clone(self) -> Self:
        """A system like this one."""
        made = type(self)(self)
        made.set_name(self.get_name())
        return made

    def _vector(self, size_or_values: Any) -> Any:
        """A BasicVector of the scalar type."""
        if np.ndim(size_or_values) == 0:
            return BasicVector_[self._of](size_or_values)
        return BasicVector_[self._of](scalars(size_or_values, self._of))

    def _set(self, output: Any, values: Scalars) -> None:
        """Writes values, floats or of the scalar type, into an output or a state."""
        output.SetFromVector(scalars(values, self._of))


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

    def other(scalar: type) -> type:
        own = {
            "_construct": made.__dict__["_construct"],
            "_construct_copy": made.__dict__["_construct_copy"],
            "_of": scalar,
            "__doc__": made.__doc__,
        }
        return type(made.__name__, (generic, LeafSystem_[scalar]), own)

    types = [float, AutoDiffXd, *([Expression] if symbolic else [])]
    made.__signature__ = _signature(made)  # type: ignore[attr-defined]
    return LazyTemplate(made, other, types, made.__dict__["_construct"])


def _signature(made: type) -> inspect.Signature:
    """That of the constructor, as `_construct` has it; pydrake's takes anything."""
    of = inspect.signature(made.__dict__["_construct"])
    own = [p for name, p in of.parameters.items() if name not in ("self", "converter")]
    return of.replace(parameters=own)
