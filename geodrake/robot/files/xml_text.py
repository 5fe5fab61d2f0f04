"""XML parsing as in Drake, with prefixes as plain text, and with line numbers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat
from xml.sax.saxutils import escape, quoteattr

from geodrake.boundary.input_files import read_regular
from geodrake.errors import ModelError

SUPPORTED_FORMATS = "geodrake reads URDF, SDF, MJCF and Drake model directives (.dmd.yaml)."
LARGEST_FILE = 100_000_000  # bytes
_DEEPEST = 400  # elements within each other; Drake reads up to 500
_MOST_ELEMENTS = 1_000_000
_MOST_ATTRIBUTES = 100  # of one element; Drake's time grows with their square


class LocatedElement(Element):
    """An element with its location in a file."""

    path: Path
    line: int  # from one
    start: int  # of the start tag, in bytes from the start of the file
    end: int  # of the end tag
    model: Element | None = None  # the included model, for an include of SDF


def place_of(element: Element, path: Path | str = "") -> str:
    """Return the file and line of an element, or else a path."""
    if isinstance(element, LocatedElement):
        return f"{element.path}, line {element.line}"
    return str(path)


def wrong_at(element: Element, path: Path, what: str) -> ModelError:
    """Return an error with the location of an element and a problem."""
    return ModelError(f"{place_of(element, path)}: {what}", advice="Correct the file there.")


def parse_xml(path: Path) -> Element:
    """Return the root element of a file."""
    data = read_regular(path, "model file", ModelError, largest=LARGEST_FILE)
    return parse_xml_bytes(data, path)


def parse_xml_bytes(data: bytes, path: Path) -> Element:
    """Return the root element of the text of a file."""
    # ElementTree.parse would resolve namespaces, but Drake requires its prefix `drake:`, and many
    # files use undeclared prefixes.
    try:
        root = _read(data, path)
    except (expat.ExpatError, ValueError, LookupError) as error:  # the last two for encodings
        raise ModelError(
            f"{path} is not a robot description: it is not valid XML ({error}).",
            advice=f"{SUPPORTED_FORMATS} A model comes before its logs.",
        ) from error
    prefixes = [  # other prefixes of Drake's namespace, from generated files
        key.removeprefix("xmlns:")
        for key, value in root.attrib.items()
        if key.startswith("xmlns:") and key != "xmlns:drake" and "drake.mit.edu" in value
    ]
    for prefix in prefixes:
        for element in root.iter():
            element.tag = element.tag.replace(f"{prefix}:", "drake:")
            for key in [key for key in element.attrib if key.startswith(f"{prefix}:")]:
                element.set(key.replace(f"{prefix}:", "drake:"), element.attrib.pop(key))
    return root


def _read(data: bytes, path: Path) -> Element:
    """Return the root of located elements, within size limits."""
    parser, depth, count = expat.ParserCreate(), 0, 0

    def element(tag: str, attributes: dict[str, str]) -> Element:
        located = LocatedElement(tag, attributes)
        located.path, located.line = path, parser.CurrentLineNumber
        located.start = parser.CurrentByteIndex
        return located

    builder = TreeBuilder(element_factory=element)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        for what, number, most in (
            ("nested elements", depth, _DEEPEST),
            ("elements", count, _MOST_ELEMENTS),
            (f"attributes in <{tag[:50]}>", len(attributes), _MOST_ATTRIBUTES),
        ):
            if number > most:
                raise ModelError(
                    f"{path}, line {parser.CurrentLineNumber}: more than {most} {what}.",
                    advice="Check how the file was generated.",
                )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        ended = builder.end(tag)
        if isinstance(ended, LocatedElement):
            ended.end = parser.CurrentByteIndex

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler = builder.data
    parser.Parse(data, True)
    return builder.close()


def numbered_text(root: Element) -> tuple[str, list[str]]:
    """Return a description as text, and the location (`place_of`) of each of its lines."""
    lines, places = list[str](), list[str]()
    for line, element in _lines(root):
        lines.append(line)
        places.append(place_of(element) or (places[-1] if places else ""))
    return "\n".join(lines) + "\n", places


def _lines(root: Element) -> Iterator[tuple[str, Element]]:
    """Yield lines of text with their elements, depth first, without recursion."""
    waiting: list[tuple[Element, bool]] = [(root, True)]
    while waiting:
        element, opens = waiting.pop()
        if not opens:
            yield f"</{element.tag}>", element
            continue
        attributes = "".join(f" {key}={quoteattr(word)}" for key, word in element.attrib.items())
        words = escape(" ".join((element.text or "").split()))
        if len(element):
            yield f"<{element.tag}{attributes}>{words}", element
            waiting.append((element, False))
            waiting.extend((child, True) for child in reversed(element))
        else:
            yield f"<{element.tag}{attributes}>{words}</{element.tag}>", element
