"""Escaping of names of joints, logs and files for each kind of text.

A name may contain quotes, line breaks, terminal escape sequences, or characters that change the
writing direction. Use `printable` for text, `html_text` (or Jinja's escaping) for HTML, and
`quoted` for code and YAML.
"""

from __future__ import annotations

import html
import re
import unicodedata
from collections.abc import Callable, Iterable
from keyword import iskeyword

_LONGEST = 300  # characters of other libraries' errors


def printable(text: str) -> str:
    r"""Return text in one line, with characters that Unicode counts as unprintable as `\x1b`."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escape(c) for c in text)


def one_line(error: BaseException) -> str:
    """Return an error's message in one line without full stop, or its kind if empty."""
    return " ".join(str(error).split())[:_LONGEST].rstrip(".") or type(error).__name__


def kind_and_line(error: BaseException) -> str:
    """Return an error's kind and message in one line."""
    kind, line = type(error).__name__, one_line(error)
    return kind if line == kind else f"{kind}: {line}"


def html_text(text: str) -> str:
    """Return text for the content or an attribute of an HTML element."""
    return html.escape(printable(text))


def quoted(text: str) -> str:
    """Return text as a double-quoted literal, valid in Python and YAML."""
    return f'"{_inside_quotes(text)}"'


def json_text(text: str) -> str:
    r"""Return JSON with unprintable characters escaped.

    Lone surrogates, as in file names that are not UTF-8, are invalid in JSON. They become text such
    as `\udcff`, as in `printable`.
    """
    return re.sub(r"[^\n -~]", lambda c: c[0] if c[0].isprintable() else _json_escape(c[0]), text)


def docstring_text(text: str) -> str:
    """Return text escaped for use in a docstring."""
    return _inside_quotes(printable(text))


def identifier(name: str) -> str:
    """Return a normalized Python identifier for a name, such as `elbow_joint`."""
    plain = unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", name).lower())
    letters = "".join(c if f"a{c}".isidentifier() else " " for c in plain)
    words = re.sub(r"[ _]+", "_", letters).strip("_") or "joint"
    if not words.isidentifier():
        words = f"joint_{words}"
    return f"{words}_" if iskeyword(words) else words


def identifiers(
    names: Iterable[str],
    *,
    taken: Iterable[str] = (),
    style: Callable[[str], str] = identifier,
) -> dict[str, str]:
    """Return distinct identifiers for names, with numbers where they would coincide."""
    used, chosen = set(taken), {}
    for name in names:
        stem = candidate = style(name)
        count = 1
        while candidate in used:
            count += 1
            candidate = f"{stem}_{count}"
        used.add(candidate)
        chosen[name] = candidate
    return chosen


def path_part(name: str) -> str:
    """Return a name as one component of a file or MeshCat path: no separators, `.` or `..`."""
    part = "".join(c if c.isprintable() and c not in "/\\%" else _percent(c) for c in name)
    return part.replace(".", "%2E") if set(part) <= {"."} else part


def _escape(letter: str) -> str:
    return letter.encode("unicode_escape").decode("ascii")


def _json_escape(letter: str) -> str:
    if "\ud800" <= letter <= "\udfff":
        return f"\\{_escape(letter)}"
    units = letter.encode("utf-16-be").hex()
    return "".join(f"\\u{units[k : k + 4]}" for k in range(0, len(units), 4))


def _inside_quotes(text: str) -> str:
    return "".join(f"\\{c}" if c in '"\\' else c if c.isprintable() else _escape(c) for c in text)


def _percent(letter: str) -> str:
    return "".join(f"%{byte:02X}" for byte in letter.encode("utf-8", "surrogatepass"))
