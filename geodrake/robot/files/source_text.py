"""XML as the user wrote it, changed where its elements were changed and nowhere else.

A parsed and rewritten file loses comments, attribute order and white space. So elements know where
they stand in the bytes of their file (`LocatedElement`), and just the bytes of what is other than
it was are replaced.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from xml.etree.ElementTree import Element, indent, tostring
from xml.sax.saxutils import escape, quoteattr

from geodrake.boundary.escaping import printable
from geodrake.errors import ModelError
from geodrake.robot.files.xml_text import LocatedElement, parse_xml_bytes, place_of

_SPACE = re.compile(rb"\s*?(\r?\n[ \t]*)(?=\S)")
_LAST_SPACE = re.compile(rb"\r?\n[ \t]*\Z")
_TAG = re.compile(rb"<[^\s/>]+")
_ATTRIBUTE = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")


def edited(data: bytes, path: Path, root: Element) -> bytes:
    """Return the bytes of a file with what was changed in its elements.

    Those are attributes, texts and new elements before or after all others; none may be missing.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in data[:4]:
        raise ModelError(
            f"{path} is encoded in UTF-16 or UTF-32, in which geodrake cannot change it.",
            advice="Save it in UTF-8.",
        )
    edits = _Edits(data)
    for element, old in zip(
        (each for each in root.iter() if isinstance(each, LocatedElement)),
        parse_xml_bytes(data, path).iter(),
        strict=True,
    ):
        if isinstance(old, LocatedElement):
            edits.compare(element, old)
    return edits.made()


class _Edits:
    def __init__(self, data: bytes) -> None:
        self._data, self._edits = data, list[tuple[int, int, int, bytes]]()

    def made(self) -> bytes:
        """Return the bytes with all edits made."""
        data = self._data
        for low, high, _, text in sorted(self._edits, reverse=True):
            data = data[:low] + text + data[high:]
        return data

    def compare(self, element: Element, old: LocatedElement) -> None:
        """Edit what is other in an element than it was."""
        own, was = (element.text or "").strip(), (old.text or "").strip()
        children = list(element)
        if element.attrib == old.attrib and own == was and len(children) == len(old):
            return
        spans = self._attributes(old)
        begin = max((match.end() for match in spans.values()), default=self._named(old))
        inside = self._data.index(b">", begin) + 1
        self._change_attributes(element.attrib, old.attrib, spans, begin)
        there = [k for k, each in enumerate(children) if isinstance(each, LocatedElement)]
        first, last = (there[0], there[-1]) if there else (len(children), len(children))
        before, after = children[:first], children[last + 1 :]
        empty = self._data[inside - 2 : inside] == b"/>"
        if empty and (own or children):
            lines = [escape(own), *(line.strip() for each in children for line in _lines(each))]
            self._edit(inside - 2, inside, f">{''.join(lines)}</{old.tag}>")
        elif not empty:
            if own != was:
                self._change_text(own, was.encode(), inside, old.end)
            self._insert(before, inside)
            self._append(after, inside, old)

    def _change_attributes(
        self,
        new: Mapping[str, str],
        old: Mapping[str, str],
        spans: Mapping[str, re.Match[bytes]],
        begin: int,
    ) -> None:
        """Edit attributes; a new one takes the place of one that is gone."""
        gone, added = [key for key in old if key not in new], [key for key in new if key not in old]
        for key in old.keys() & new.keys():
            if new[key] != old[key]:
                low, high = spans[key].span(2)
                word = escape(new[key], {'"': "&quot;", "'": "&apos;"})
                self._edit(low + 1, high - 1, word)
        for was, key in zip(gone, added, strict=False):
            self._edit(spans[was].start(1), spans[was].end(), f"{key}={quoteattr(new[key])}")
        for was in gone[len(added) :]:
            self._edit(*spans[was].span(), "")
        for key in added[len(gone) :]:
            self._edit(begin, begin, f" {key}={quoteattr(new[key])}")

    def _change_text(self, text: str, old: bytes, low: int, high: int) -> None:
        """Edit a text; white space and comments around it stay."""
        inside = self._data[low:high]
        if old and inside.count(old) == 1:
            low += inside.index(old)
            high = low + len(old)
        self._edit(low, high, escape(text))

    def _insert(self, elements: Sequence[Element], inside: int) -> None:
        """Put elements before all others, indented like them."""
        space = _SPACE.match(self._data, inside)
        before = space[1].decode() if space else ""
        if before and self._data.startswith(b"</", space.end() if space else 0):
            before += "  "
        self._put(elements, before, inside)

    def _append(self, elements: Sequence[Element], inside: int, old: LocatedElement) -> None:
        """Put elements after all others and comments, indented like them."""
        last = next((each for each in reversed(old) if isinstance(each, LocatedElement)), old)
        space = _LAST_SPACE.search(self._data, 0, last.start)
        at = inside + len(self._data[inside : old.end].rstrip())
        self._put(elements, space[0].decode() if space else "", at)

    def _put(self, elements: Sequence[Element], before: str, at: int) -> None:
        lines = [line for each in elements for line in _lines(each)]
        text = "".join(before + line if before else line.strip() for line in lines)
        if text:
            self._edit(at, at, text)

    def _edit(self, low: int, high: int, text: str) -> None:
        self._edits.append((low, high, len(self._edits), text.encode()))

    def _named(self, element: LocatedElement) -> int:
        """Return where the tag of an element ends."""
        tag = _TAG.match(self._data, element.start)
        if tag is None:
            raise ModelError(
                f"{place_of(element)}: <{element.tag}> stands in an entity, and cannot be changed.",
                advice="Write it where the entity is.",
            )
        return tag.end()

    def _attributes(self, element: LocatedElement) -> Mapping[str, re.Match[bytes]]:
        """Find each attribute with the space before it; groups are its name and quoted value."""
        at, found = self._named(element), {}
        while match := _ATTRIBUTE.match(self._data, at):
            found[match[1].decode()] = match
            at = match.end()
        return found


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
