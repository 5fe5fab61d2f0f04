"""Templates of systems whose instantiations are made when they are first needed."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Sequence
from threading import RLock
from typing import Any

from pydrake.systems.scalar_conversion import TemplateSystem


class LazyTemplate(TemplateSystem):
    """The template of a system of floats, which begins as the first system is constructed.

    For each instantiation pydrake looks through the whole call stack. That is long, and slow to
    look through, while modules import one another: begun there, templates take seconds.
    """

    def __init__(
        self, made: type, other: Callable[[type], type], scalars: Sequence[type], constructor: Any
    ) -> None:
        """Constructs the template, and gives the class a constructor that begins it.

        Args:
            made: The system of floats, with `_construct` and `_construct_copy` of its own.
            other: Gives the system of another scalar type.
            scalars: The scalar types, float first.
            constructor: What the constructor is documented as.
        """
        kind: Any = made
        module = sys.modules[made.__module__]
        super().__init__(f"{made.__name__}_", list(scalars), scope=module)
        self._made, self._documented, self._lock = kind, constructor, RLock()

        @functools.wraps(constructor)
        def begin(system: Any, *args: Any, **options: Any) -> None:
            with self._lock:
                self.get_instantiation(float)  # which gives the class Drake's constructor
            kind.__init__(system, *args, **options)

        kind.__init__ = begin
        self.add_instantiations(
            lambda param: made if param == (float,) else other(param[0]), [(x,) for x in scalars]
        )

    def _on_add(self, param: Any, cls: Any, skip_rename: bool) -> Any:
        if cls is not self._made:
            return super()._on_add(param, cls, skip_rename)
        del cls.__init__
        super()._on_add(param, cls, skip_rename=True)
        functools.update_wrapper(cls.__init__, self._documented)
        return cls
