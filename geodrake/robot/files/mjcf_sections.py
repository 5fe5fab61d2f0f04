"""Sections put at the end of the text of an MJCF file, which otherwise stays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from geodrake.robot.files.joint_text import mjcf_joints
from geodrake.robot.files.source_text import SourceText, check_in_itself


def with_sections(
    data: bytes, path: Path, sections: Mapping[str, Sequence[str]], joints: Iterable[str]
) -> bytes:
    """An MJCF file with more sections, after all others; nameless joints in them get names.

    Args:
        data: Bytes of the file.
        path: Where they are from, for messages, and for the name of a model that has none.
        sections: Tag of a section -> its elements, a line each; empty ones are left out.
        joints: Names of the joints that the sections name.

    Raises:
        ModelError: A joint is not in the file itself.
    """
    text = SourceText(data, path)
    scoped = mjcf_joints(text.root, path)
    there = {name.rpartition("::")[2]: joint for name, joint in scoped.items()}
    check_in_itself(joints, there, path)
    for name in joints:
        if not there[name].attributes.get("name"):
            text.set_attribute(there[name], "name", name)
    lines = list[str]()
    for tag, elements in sections.items():
        if elements:
            lines += [f"<{tag}>", *(f"  {element}" for element in elements), f"</{tag}>"]
    text.append(text.root, *lines)
    return text.edited()
