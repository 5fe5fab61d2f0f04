"""Arguments checked by what a function's annotations say of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from functools import cache, wraps
from types import UnionType
from typing import Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import numpy as np

from geodrake.boundary.arguments.objects import instance

F = TypeVar("F", bound=Callable[..., Any])
_TRUTH = (bool, np.bool_, int)
_OPEN = (float, int, complex, object, Any)


def typed(function: F) -> F:
    """Return the function with a check of all arguments that are to be of a class, or None.

    What is in collections, and numbers, which have bounds as well, are left to the function.

    Raises:
        ArgumentError: The function is called with something else.
    """
    signature = inspect.signature(function)

    @cache
    def kinds() -> Mapping[str, tuple[type, ...]]:
        hints = get_type_hints(function)
        return {name: _kinds(hints.get(name, Any)) for name in signature.parameters}

    @wraps(function)
    def checked(*args: Any, **named: Any) -> Any:
        for name, value in signature.bind(*args, **named).arguments.items():
            if wanted := kinds()[name]:
                instance(value, name, wanted)
        return function(*args, **named)

    return cast(F, checked)


def _kinds(hint: Any) -> tuple[type, ...]:
    """Return the classes that an annotation admits; none if classes cannot express it."""
    if get_origin(hint) in (Union, UnionType):
        each = [_kinds(part) for part in get_args(hint)]
        return tuple(kind for kinds in each for kind in kinds) if all(each) else ()
    kind = get_origin(hint) or hint
    if kind is bool:
        return _TRUTH
    if not isinstance(kind, type) or kind in _OPEN:
        return ()
    if kind is tuple and ... not in get_args(hint):
        return (tuple,)
    collection = issubclass(kind, Iterable) and not issubclass(kind, str | Mapping)
    return () if collection else (kind,)
