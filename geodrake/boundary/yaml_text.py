"""Text of YAML files, refused where aliases would unfold it without end."""

from __future__ import annotations

from pathlib import Path

import yaml  # type: ignore[import-untyped]

from geodrake.boundary.input_files import regular_file
from geodrake.errors import ModelError

LARGEST_FILE = 100_000_000  # bytes
_MOST_NODES = 1_000_000  # with aliases unfolded


def yaml_text(path: Path) -> str:
    """The text of a YAML file.

    Raises:
        ModelError: It cannot be read, is not in UTF-8, or its aliases unfold without end.
    """
    regular_file(path, "model file", ModelError, largest=LARGEST_FILE)
    try:
        text = path.read_bytes().decode("utf-8-sig")
        if "\0" in text:
            raise yaml.YAMLError("it has null characters")
        nodes = _unfolded(yaml.compose(text, yaml.SafeLoader), {}) if "*" in text else 0
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())[:300]
        raise ModelError(
            f"{path} is not valid YAML: {reason}.", advice="Correct the file there.", path=path
        ) from error
    if nodes > _MOST_NODES:
        raise ModelError(
            f"{path} has aliases that unfold to more than {_MOST_NODES} nodes.",
            advice="Write out what it needs.",
            path=path,
        )
    return text


def _unfolded(node: yaml.Node | None, known: dict[int, float]) -> float:
    """Number of nodes below a node, each as often as it is referred to; inf if it holds itself."""
    if not isinstance(node, yaml.CollectionNode):
        return 1.0
    if id(node) not in known:
        known[id(node)] = float("inf")
        pairs = isinstance(node, yaml.MappingNode)
        children = [part for pair in node.value for part in pair] if pairs else node.value
        known[id(node)] = 1.0 + sum(_unfolded(child, known) for child in children)
    return known[id(node)]
