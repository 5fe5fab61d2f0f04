"""Names of joints, logs and files put into text of another kind: one function for each kind.

A name is whatever somebody wrote: it may hold quotes, line ends, escape sequences of a terminal,
or letters that turn the direction of writing. What is shown to people goes through `printable`,
HTML through `html_text` (or Jinja's own escaping), code and YAML through `quoted`.
"""

from __future__ import annotations

import html
import re
import unicodedata
from collections.abc import Callable, Iterable
from keyword import iskeyword

_LONGEST = 300  # letters of what errors of others say


def printable(text: str) -> str:
    r"""Return a name as one readable line: `\x1b` for what moves, colours, turns or breaks it.

    Every letter that Unicode does not count as printable is written as Python writes it.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else _escape(c) for c in text)


def one_line(error: BaseException) -> str:
    """Return the text of a foreign error in a line without its full stop; else its kind."""
    return " ".join(str(error).split())[:_LONGEST].rstrip(".") or type(error).__name__


def kind_and_line(error: BaseException) -> str:
    """Return the kind of an error and its message in one line, if it has one."""
    kind, line = type(error).__name__, one_line(error)
    return kind if line == kind else f"{kind}: {line}"


def html_text(text: str) -> str:
    """Return a name in the text or in an attribute of an HTML page."""
    return html.escape(printable(text))


def quoted(text: str) -> str:
    """Return a name as a literal in double quotes, which Python and YAML read alike."""
    return f'"{_inside_quotes(text)}"'


def json_text(text: str) -> str:
    r"""Return JSON in which letters that would act on a terminal are escaped, as JSON does it.

    What is no letter, as in a file's name that is not UTF-8, has no form in JSON: it is the word
    that `printable` makes of it, such as `\udcff`.
    """
    return re.sub(r"[^\n -~]", lambda c: c[0] if c[0].isprintable() else _json_escape(c[0]), text)


def docstring_text(text: str) -> str:
    """Words that may stand between the triple quotes of a docstring, and read there as they are."""
    return _inside_quotes(printable(text))


def identifier(name: str) -> str:
    """Return a Python identifier for a name, in the form that Python compares: `elbow_joint`."""
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
    """Return identifiers for names, all different: those of "elbow-a" and "elbow.a" get numbers."""
    used, found = set(taken), {}
    for name in names:
        stem = free = style(name)
        count = 1
        while free in used:
            count += 1
            free = f"{stem}_{count}"
        used.add(free)
        found[name] = free
    return found


def path_part(name: str) -> str:
    """Return a name as one part of a path, of a file or in MeshCat: no separators, `.` or `..`."""
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
