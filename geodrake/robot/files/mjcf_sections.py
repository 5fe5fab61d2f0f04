"""Sections put at the end of the text of an MJCF file, which otherwise stays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from xml.etree.ElementTree import SubElement, fromstring

from geodrake.robot.files.joint_text import mjcf_joints
from geodrake.robot.files.source_text import check_in_itself, edited
from geodrake.robot.files.xml_text import parse_xml_bytes


def with_sections(
    data: bytes, path: Path, sections: Mapping[str, Sequence[str]], joints: Iterable[str]
) -> bytes:
    """Return an MJCF file with more sections, after all others; nameless joints in them get names.

    Sections are tags with their elements, a line each; empty ones are left out.
    """
    root = parse_xml_bytes(data, path)
    there = {name.rpartition("::")[2]: own for name, own in mjcf_joints(root, path).items()}
    check_in_itself(joints, there, path)
    for name in joints:
        there[name].set("name", there[name].get("name") or name)
    for tag, elements in sections.items():
        if elements:
            SubElement(root, tag).extend(map(fromstring, elements))
    return edited(data, path, root)
