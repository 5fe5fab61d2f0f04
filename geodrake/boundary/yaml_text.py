"""Reading of YAML files, with a limit on the expansion of aliases."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import yaml  # type: ignore[import-untyped]

from geodrake.boundary.escaping import one_line
from geodrake.boundary.input_files import read_regular
from geodrake.errors import ArgumentError, GeodrakeError, ModelError

T = TypeVar("T")

LARGEST_FILE = 100_000_000  # bytes
_MOST_NODES = 1_000_000  # with aliases expanded


def yaml_text(path: Path, what: str = "model file", error: type[GeodrakeError] = ModelError) -> str:
    """Return the text of a YAML file.

    Raises:
        GeodrakeError: Of the kind `error`: the file cannot be read, is not UTF-8, or its aliases
            expand to too many nodes.
    """
    data = read_regular(path, what, error, largest=LARGEST_FILE)
    try:
        text = data.decode("utf-8-sig")
        if "\0" in text:
            raise yaml.YAMLError("it has null characters")
        nodes = _expanded_count(yaml.compose(text, yaml.SafeLoader), {}) if "*" in text else 0
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as problem:
        raise error(
            f"{path} is not valid YAML: {one_line(problem)}.",
            advice="Correct the file there.",
            path=path,
        ) from problem
    if nodes > _MOST_NODES:
        raise error(
            f"{path} has aliases that expand to more than {_MOST_NODES} nodes.",
            advice="Write them out.",
            path=path,
        )
    return text


def yaml_content(path: Path, what: str, error: type[GeodrakeError], *, advice: str) -> object:
    """Return the content of a YAML file; raise if a table has a repeated key."""
    text = yaml_text(path, what, error)
    try:
        _check_keys(yaml.compose(text, yaml.SafeLoader))
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as problem:
        raise error(
            f"The {what} {path} is not valid YAML: {one_line(problem)}.", advice=advice, path=path
        ) from problem


def made_of_yaml(
    path: Path, what: str, error: type[GeodrakeError], make: Callable[[object], T], *, advice: str
) -> T:
    """Return `make(content)` of a YAML file, with errors that name it; see `yaml_content`."""
    content = yaml_content(path, what, error, advice=advice)
    try:
        return make(content)
    except ArgumentError as problem:
        raise error(
            f"{what.capitalize()} {path}: {problem.problem}", advice=problem.advice or advice
        ) from problem


def _check_keys(node: yaml.Node | None) -> None:
    """Raise if a table has a repeated key."""
    if isinstance(node, yaml.MappingNode):
        keys: set[str] = set()
        for key, value in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in keys:
                raise yaml.YAMLError(
                    f"it has {key.value!r} twice, again in line {key.start_mark.line + 1}"
                )
            keys.add(str(key.value))
            _check_keys(value)
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            _check_keys(value)


def _expanded_count(node: yaml.Node | None, counts: dict[int, float]) -> float:
    """Return the number of nodes below a node with aliases expanded; inf for a cycle."""
    if not isinstance(node, yaml.CollectionNode):
        return 1.0
    if id(node) not in counts:
        counts[id(node)] = float("inf")
        is_mapping = isinstance(node, yaml.MappingNode)
        children = [part for pair in node.value for part in pair] if is_mapping else node.value
        counts[id(node)] = 1.0 + sum(_expanded_count(child, counts) for child in children)
    return counts[id(node)]
