"""Values in messages."""

from __future__ import annotations

from typing import Any

_LONGEST = 60  # characters of a value that a message shows


def shown(value: Any) -> str:
    """A value in a message, shortened, with its type where that says more."""
    text = repr(value) if isinstance(value, str | bytes | int | float | list | tuple) else ""
    if not text or len(text) > _LONGEST:
        return f"of type {type(value).__name__}"
    return text
