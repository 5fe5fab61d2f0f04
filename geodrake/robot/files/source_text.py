"""XML as the user wrote it, changed where its elements were changed and nowhere else.

A parsed and rewritten file loses comments, attribute order and white space. So elements know where
they stand in the bytes of their file (`LocatedElement`), and just the bytes of what is other than
it was are replaced.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from xml.etree.ElementTree import Element, indent, tostring
from xml.sax.saxutils import escape, quoteattr

from geodrake.boundary.escaping import printable
from geodrake.errors import ModelError
from geodrake.robot.files.xml_text import LocatedElement, parse_xml_bytes, place_of

_SPACE = re.compile(rb"\s*?(\r?\n[ \t]*)(?=\S)")
_LAST_SPACE = re.compile(rb"\r?\n[ \t]*\Z")
_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")
_START = re.compile(rb"(<[^\s/>]+)((?:" + _ATTRIBUTE.pattern + rb")*)\s*(/?>)")


def edited(data: bytes, path: Path, root: Element) -> bytes:
    """Return the bytes of a file with what was changed in its elements.

    Those are attributes, texts and new elements before or after all others; none may be missing.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in data[:4]:
        raise ModelError(
            f"{path} is encoded in UTF-16 or UTF-32, in which geodrake cannot change it.",
            advice="Save it in UTF-8.",
        )
    edits = list[tuple[int, int, bytes]]()
    for element, old in zip(
        (each for each in root.iter() if isinstance(each, LocatedElement)),
        parse_xml_bytes(data, path).iter(),
        strict=True,
    ):
        if isinstance(old, LocatedElement):
            edits += _edits_of(element, old, data)
    for low, high, text in sorted(edits, key=lambda edit: edit[:2], reverse=True):
        data = data[:low] + text + data[high:]
    return data


def _edits_of(
    element: Element, old: LocatedElement, data: bytes
) -> Iterator[tuple[int, int, bytes]]:
    """Yield from and to where bytes are replaced, and what by, as an element is not what it was."""
    own, was = (element.text or "").strip(), (old.text or "").strip()
    children = list(element)
    if element.attrib == old.attrib and own == was and len(children) == len(old):
        return
    start = _START.match(data, old.start)
    if start is None:
        raise ModelError(
            f"{place_of(old)}: <{old.tag}> stands in an entity, and cannot be changed.",
            advice="Write it where the entity is.",
        )
    yield *start.span(2), _attributes(element.attrib, old.attrib, start[2])
    there = [k for k, each in enumerate(children) if isinstance(each, LocatedElement)]
    first, last = (there[0], there[-1]) if there else (len(children), len(children))
    inside = start.end()
    if start[6] == b"/>":
        if own or children:
            lines = [escape(own), *(line.strip() for each in children for line in _lines(each))]
            yield *start.span(6), f">{''.join(lines)}</{old.tag}>".encode()
        return
    if own != was:
        low, high, text = inside, old.end, was.encode()
        if text and data[low:high].count(text) == 1:  # white space and comments around it stay
            low = data.index(text, low)
            high = low + len(text)
        yield low, high, escape(own).encode()
    space = _SPACE.match(data, inside)
    before = space[1].decode() if space else ""
    if before and data.startswith(b"</", space.end() if space else 0):
        before += "  "
    yield inside, inside, _indented(children[:first], before)
    final = next((each for each in reversed(old) if isinstance(each, LocatedElement)), old)
    space = _LAST_SPACE.search(data, 0, final.start)
    at = inside + len(data[inside : old.end].rstrip())  # after all others and comments
    yield at, at, _indented(children[last + 1 :], space[0].decode() if space else "")


def _attributes(new: Mapping[str, str], old: Mapping[str, str], text: bytes) -> bytes:
    """Return the text of attributes, of which those change that are other than they were."""

    def written(match: re.Match[bytes]) -> bytes:
        key = match[2].decode()
        if key not in new:
            return b""
        return match[0] if new[key] == old[key] else _written(match[1], key, new[key])

    added = (_written(b" ", key, new[key]) for key in new if key not in old)
    return b"".join([_ATTRIBUTE.sub(written, text), *added])


def _written(space: bytes, key: str, word: str) -> bytes:
    return space + f"{key}={quoteattr(word)}".encode()


def _indented(elements: Sequence[Element], before: str) -> bytes:
    """Return the text of new elements, each line after the same white space."""
    lines = [line for each in elements for line in _lines(each)]
    return "".join(before + line if before else line.strip() for line in lines).encode()


def _lines(element: Element) -> list[str]:
    """Return lines of a new element, indented by two spaces within it."""
    made = deepcopy(element)
    if any(len(child) or child.attrib for child in element):
        indent(made)
    return tostring(made, encoding="unicode").replace(" />", "/>").splitlines()


def comment_words(sentence: str) -> str:
    """Return a sentence as an XML comment may have it, which has no two hyphens in a row."""
    return f" {re.sub('-(?=-)', '- ', printable(sentence))} "


def check_in_itself(names: Iterable[str], there: Container[str], path: Path) -> None:
    """Refuse to write to what a file includes."""
    missing = sorted(name for name in names if name not in there)
    if missing:
        raise ModelError(
            f"{', '.join(name.rpartition('::')[2] for name in missing)} is not in {path} itself.",
            advice="Put included files into the model, so that all is in one file.",
            missing=missing,
        )
