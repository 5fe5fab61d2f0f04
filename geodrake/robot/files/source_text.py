"""XML as the user wrote it, changed at a few places and nowhere else.

A parsed and rewritten file loses comments, attribute order and white space. So elements remember
where they stand in the bytes of the file, and edits replace just those bytes.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

from geodrake.boundary.escaping import printable
from geodrake.errors import ModelError

_SPACE = re.compile(rb"\s*?(\r?\n[ \t]*)(?=\S)")
_LAST_SPACE = re.compile(rb"\r?\n[ \t]*\Z")
_ATTRIBUTE = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass(eq=False)
class SourceElement:
    """An element and where it stands, in bytes from the start of the file.

    Attributes:
        tag: Its tag, prefix included.
        attributes: Its attributes as they read.
        start: Where its start tag begins.
        inside: Where its start tag ends.
        end: Where its end tag begins; equal to `inside` for `<a/>`.
        children: Elements directly below.
        text: Its own text.
    """

    tag: str
    attributes: dict[str, str]
    start: int
    inside: int = 0
    end: int = 0
    children: list[SourceElement] = field(default_factory=list)
    text: str = ""

    def find(self, tag: str) -> SourceElement | None:
        """Return the first child with a tag."""
        return next(self.all(tag), None)

    def all(self, tag: str) -> Iterator[SourceElement]:
        """The children with a tag."""
        return (child for child in self.children if child.tag == tag)

    def walk(self) -> Iterator[SourceElement]:
        """This element and all below it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()


class SourceText:
    """A file and the edits to be made in it.

    Args:
        data: The bytes of the file.
        path: Where they are from, for messages.

    Raises:
        ModelError: The file is no XML, or its encoding is not one of single bytes or UTF-8.
    """

    def __init__(self, data: bytes, path: Path) -> None:
        if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in data[:4]:
            raise ModelError(
                f"{path} is encoded in UTF-16 or UTF-32, in which geodrake cannot change it.",
                advice="Save it in UTF-8.",
            )
        self.data, self._edits = data, list[tuple[int, int, int, bytes]]()
        self.root = self._parse(path)

    def set_attribute(self, element: SourceElement, name: str, value: str, old: str = "") -> None:
        """Gives an attribute a value, in the place of the attribute `old` if there is one.

        Args:
            element: The element in the file.
            name: Name of the attribute.
            value: Its value, unescaped.
            old: Attribute whose place it takes if it is not there yet; "" for none.
        """
        spans = self._attributes(element)
        if name in spans:
            low, high = spans[name].span(2)
            self._edit(low + 1, high - 1, escape(value, {'"': "&quot;", "'": "&apos;"}))
        elif old in spans:
            self._edit(spans[old].start(1), spans[old].end(), f"{name}={quoteattr(value)}")
        else:
            at = max((match.end() for match in spans.values()), default=_named(element))
            self._edit(at, at, f" {name}={quoteattr(value)}")

    def remove_attribute(self, element: SourceElement, name: str) -> None:
        """Takes an attribute away, if it is there.

        Args:
            element: The element in the file.
            name: Name of the attribute.
        """
        if name in (spans := self._attributes(element)):
            self._edit(*spans[name].span(), "")

    def set_text(self, element: SourceElement, text: str) -> None:
        """Gives an element without children a text; white space and comments around it stay.

        Args:
            element: The element in the file, without children.
            text: Its text, unescaped.
        """
        if self._is_empty(element):
            self._open(element, escape(text))
            return
        inside, old = self.data[element.inside : element.end], element.text.strip().encode()
        low, high = element.inside, element.end
        if old and inside.count(old) == 1:
            low += inside.index(old)
            high = low + len(old)
        self._edit(low, high, escape(text))

    def insert(self, parent: SourceElement, *lines: str) -> None:
        """Puts lines of XML before all other children, indented like them.

        Args:
            parent: The element that the lines go into.
            *lines: Lines of XML, escaped; spaces before them are indentation within the parent.
        """
        if self._is_empty(parent):
            self._open(parent, "".join(line.strip() for line in lines))
            return
        space = _SPACE.match(self.data, parent.inside)
        before = space[1].decode() if space else ""
        if before and self.data.startswith(b"</", space.end() if space else 0):
            before += "  "
        if not before:
            lines = tuple(line.strip() for line in lines)
        self._edit(parent.inside, parent.inside, "".join(before + line for line in lines))

    def append(self, parent: SourceElement, *lines: str) -> None:
        """Puts lines of XML after all other children and comments, indented like the children.

        Args:
            parent: The element that the lines go into.
            *lines: Lines of XML, escaped; spaces before them are indentation within the parent.
        """
        if not parent.children:
            self.insert(parent, *lines)
            return
        space = _LAST_SPACE.search(self.data, 0, parent.children[-1].start)
        before = space[0].decode() if space else ""
        if not before:
            lines = tuple(line.strip() for line in lines)
        at = parent.inside + len(self.data[parent.inside : parent.end].rstrip())
        self._edit(at, at, "".join(before + line for line in lines))

    def edited(self) -> bytes:
        """Return the bytes with all edits made."""
        data = self.data
        for low, high, _, text in sorted(self._edits, reverse=True):
            data = data[:low] + text + data[high:]
        return data

    def _edit(self, low: int, high: int, text: str) -> None:
        self._edits.append((low, high, len(self._edits), text.encode()))

    def _is_empty(self, element: SourceElement) -> bool:
        return self.data[element.inside - 2 : element.inside] == b"/>"

    def _open(self, element: SourceElement, content: str) -> None:
        """Turns `<a/>` into `<a>content</a>`."""
        self._edit(element.inside - 2, element.inside, f">{content}</{element.tag}>")

    def _attributes(self, element: SourceElement) -> Mapping[str, re.Match[bytes]]:
        """Each attribute with the space before it; groups are its name and its quoted value."""
        at, found = _named(element), {}
        while match := _ATTRIBUTE.match(self.data, at):
            found[match[1].decode()] = match
            at = match.end()
        return found

    def _parse(self, path: Path) -> SourceElement:
        parser, stack = expat.ParserCreate(), [SourceElement("", {}, 0)]

        def start(tag: str, attributes: dict[str, str]) -> None:
            element = SourceElement(tag, attributes, parser.CurrentByteIndex)
            at = max((m.end() for m in self._attributes(element).values()), default=_named(element))
            element.inside = element.end = self.data.index(b">", at) + 1
            stack[-1].children.append(element)
            stack.append(element)

        def end(_: str) -> None:
            element = stack.pop()
            if not self._is_empty(element):
                element.end = parser.CurrentByteIndex

        def text(words: str) -> None:
            stack[-1].text += words

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.CharacterDataHandler = text
        try:
            parser.Parse(self.data, True)
        except (expat.ExpatError, ValueError) as error:
            raise ModelError(f"{path} cannot be changed: it is not plain XML ({error}).") from error
        return stack[0].children[0]


def with_comments(data: bytes, path: Path, sentences: Sequence[str]) -> bytes:
    """Return an XML file with comments before all else in it.

    Args:
        data: The bytes of the file.
        path: Where they are from, for messages.
        sentences: What the comments say.
    """
    if not sentences:
        return data
    text = SourceText(data, path)
    text.insert(text.root, *(f"<!--{comment_words(each)}-->" for each in sentences))
    return text.edited()


def comment_words(sentence: str) -> str:
    """Return a sentence as an XML comment may have it, which has no two hyphens in a row.

    Args:
        sentence: What it says, names of a file included.
    """
    return f" {re.sub('-(?=-)', '- ', printable(sentence))} "


def _named(element: SourceElement) -> int:
    """Return where the tag of an element ends."""
    return element.start + 1 + len(element.tag.encode())


def check_in_itself(names: Iterable[str], there: Container[str], path: Path) -> None:
    """Refuse to write to what a file includes.

    Args:
        names: Scoped names of links or joints that are to be written.
        there: Those that stand in the file itself.
        path: The file.

    Raises:
        ModelError: One is not in the file itself.
    """
    missing = sorted(name for name in names if name not in there)
    if missing:
        raise ModelError(
            f"{', '.join(name.rpartition('::')[2] for name in missing)} is not in {path} itself.",
            advice="Put included files into the model, so that all is in one file.",
            missing=missing,
        )
