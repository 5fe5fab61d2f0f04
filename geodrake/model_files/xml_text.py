"""XML as Drake reads it: prefixes are plain text."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from geodrake.errors import ModelError

SUPPORTED_FORMATS = "geodrake reads URDF, SDF, MJCF and Drake model directives (.dmd.yaml)."


def parse_xml(path: Path) -> Element:
    """The root element of a file.

    Raises:
        ModelError: The file is not XML.
    """
    return parse_xml_bytes(path.read_bytes(), path)


def parse_xml_bytes(data: bytes, path: Path) -> Element:
    """The root element of what is, or will be, in a file.

    Raises:
        ModelError: It is not XML.
    """
    # Without namespaces, unlike ElementTree.parse: Drake wants its prefix `drake:` kept as it is,
    # and many files use prefixes that they do not declare.
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise ModelError(
            f"{path} is not a robot description: it is not valid XML ({error}).",
            advice=SUPPORTED_FORMATS,
            path=path,
        ) from error
    root = builder.close()
    for prefix in _drake_prefixes(root):
        for element in root.iter():
            element.tag = element.tag.replace(f"{prefix}:", "drake:")
            for key in [key for key in element.attrib if key.startswith(f"{prefix}:")]:
                element.set(key.replace(f"{prefix}:", "drake:"), element.attrib.pop(key))
    return root


def _drake_prefixes(root: Element) -> list[str]:
    """Other prefixes that a program gave to Drake's namespace when it wrote the file."""
    return [
        key.removeprefix("xmlns:")
        for key, value in root.attrib.items()
        if key.startswith("xmlns:") and key != "xmlns:drake" and "drake.mit.edu" in value
    ]
