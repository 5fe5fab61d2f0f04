"""Inertias written into the text of a URDF, SDF or MJCF file, which otherwise stays as it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from geodrake.errors import ModelError
from geodrake.inertia import Array, to_mass_com_inertia
from geodrake.robot.files.source_text import SourceElement, SourceText, check_in_itself
from geodrake.robot.files.values import TENSOR, UPPER, numbers, rotation, tensor_words, words
from geodrake.robot.files.xml_text import SUPPORTED_FORMATS

_TURNS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
_OF_MASSES = (
    "settotalmass",
    "boundmass",
    "boundinertia",
    "balanceinertia",
    "inertiafromgeom",
    "inertiagrouprange",
)
_Writer = Callable[[SourceText, SourceElement, Array], None]


def with_inertias(data: bytes, path: Path, inertias: Mapping[str, Array]) -> bytes:
    """A model file with other inertial parameters of some links.

    Numbers inside of `inertial` elements change, and what those lack is added; orientations of
    inertial frames stay, but in MJCF, where a full inertia has none.

    Args:
        data: The bytes of the file.
        path: The file, for messages and for the name of a model that has none.
        inertias: Scoped link name -> (10,) inertial parameters of mass above zero.

    Returns:
        The bytes with the new numbers.

    Raises:
        ModelError: A link is not in the file itself, or it is no such file.
    """
    text = SourceText(data, path)
    if text.root.tag not in _FORMATS:
        raise ModelError(
            f"{path} has the root element <{text.root.tag}>, into which no inertias can be "
            "written.",
            advice=SUPPORTED_FORMATS,
        )
    named, write = _FORMATS[text.root.tag]
    links = dict(named(text.root, path))
    check_in_itself(inertias, links, path)
    for name, phi in inertias.items():
        write(text, links[name], phi)
    return text.edited()


def without_mass_settings(data: bytes, path: Path) -> bytes:
    """An MJCF file without the settings by which MuJoCo changes masses; other files as they are.

    Args:
        data: Bytes of the file.
        path: Where they are from, for messages.
    """
    text = SourceText(data, path)
    for compiler in text.root.all("compiler") if text.root.tag == "mujoco" else ():
        for key in _OF_MASSES:
            if key in compiler.attributes:
                text.remove_attribute(compiler, key)
    return text.edited()


def link_names(data: bytes, path: Path) -> frozenset[str]:
    """Scoped names of the links that stand in a file itself.

    Args:
        data: Bytes of the file.
        path: Where they are from, for messages.
    """
    root = SourceText(data, path).root
    return (
        frozenset(dict(_FORMATS[root.tag][0](root, path))) if root.tag in _FORMATS else frozenset()
    )


def _urdf_links(root: SourceElement, path: Path) -> Iterator[tuple[str, SourceElement]]:
    scope = root.attributes.get("name") or path.stem
    for link in root.all("link"):
        yield f"{scope}::{link.attributes.get('name')}", link


def _sdf_links(
    parent: SourceElement, path: Path, scope: str = ""
) -> Iterator[tuple[str, SourceElement]]:
    models = [*parent.all("model"), *(m for w in parent.all("world") for m in w.all("model"))]
    for model in models:
        own = model.attributes.get("name", "")
        name = f"{scope}::{own}" if scope else own
        for link in model.all("link"):
            yield f"{name}::{link.attributes.get('name')}", link
        yield from _sdf_links(model, path, name)


def _mjcf_links(root: SourceElement, path: Path) -> Iterator[tuple[str, SourceElement]]:
    scope = root.attributes.get("model") or path.stem
    numbered = {id(b): k for k, b in enumerate(b for b in root.walk() if b.tag == "body")}
    for world in root.all("worldbody"):
        for body in world.walk():
            if body.tag == "body":
                name = body.attributes.get("name") or f"body_{numbered[id(body)]}"
                yield f"{scope}::{name}", body


def _write_urdf(text: SourceText, link: SourceElement, phi: Array) -> None:
    mass, com, inertia = to_mass_com_inertia(phi)
    inertial = link.find("inertial")
    if inertial is None:
        stated = " ".join(f'{key}="{word}"' for key, word in tensor_words(inertia).items())
        text.insert(
            link,
            "<inertial>",
            f'  <origin xyz="{words(com)}" rpy="0 0 0"/>',
            f'  <mass value="{words(mass)}"/>',
            f"  <inertia {stated}/>",
            "</inertial>",
        )
        return
    origin, turn = inertial.find("origin"), np.eye(3)
    new = []
    if origin is None:
        new.append(f'<origin xyz="{words(com)}" rpy="0 0 0"/>')
    else:
        turn = rotation(numbers(origin.attributes.get("rpy", ""), 3))
        if not np.isfinite(turn).all():
            turn = np.eye(3)
            text.set_attribute(origin, "rpy", "0 0 0")
        text.set_attribute(origin, "xyz", words(com))
    values = {"mass": {"value": words(mass)}, "inertia": tensor_words(turn.T @ inertia @ turn)}
    for tag, attributes in values.items():
        element = inertial.find(tag)
        if element is None:
            stated = " ".join(f'{key}="{word}"' for key, word in attributes.items())
            new.append(f"<{tag} {stated}/>")
        else:
            _set_attributes(text, element, attributes)
    if new:
        text.insert(inertial, *new)


def _set_attributes(
    text: SourceText, element: SourceElement, attributes: Mapping[str, str]
) -> None:
    for key, word in attributes.items():
        text.set_attribute(element, key, word)


def _write_sdf(text: SourceText, link: SourceElement, phi: Array) -> None:
    mass, com, inertia = to_mass_com_inertia(phi)
    inertial = link.find("inertial")
    if inertial is None:
        lines = ["<inertial>", *(f"  {line}" for line in _sdf_lines(com, mass)), "  <inertia>"]
        lines += [f"    <{k}>{word}</{k}>" for k, word in tensor_words(inertia).items()]
        text.insert(link, *lines, "  </inertia>", "</inertial>")
        return
    if inertial.attributes.get("auto") == "true":
        text.set_attribute(inertial, "auto", "false")
    pose, new, turn = inertial.find("pose"), [], np.eye(3)
    if pose is None:
        new.append(_sdf_lines(com, mass)[0])
    else:
        turn, rest = _sdf_turn(pose)
        text.set_text(pose, f"{words(com)} {rest}")
    element = inertial.find("mass")
    if element is None:
        new.append(_sdf_lines(com, mass)[1])
    else:
        text.set_text(element, words(mass))
    moments, tensor = tensor_words(turn.T @ inertia @ turn), inertial.find("inertia")
    if tensor is None:
        new.append(f"<inertia>{_sdf_tensor(moments)}</inertia>")
    else:
        _set_sdf_tensor(text, tensor, moments)
    if new:
        text.insert(inertial, *new)


def _set_sdf_tensor(text: SourceText, tensor: SourceElement, moments: Mapping[str, str]) -> None:
    absent = [key for key in moments if tensor.find(key) is None]
    for key in moments:
        entry = tensor.find(key)
        if entry is not None:
            text.set_text(entry, moments[key])
    if absent:
        text.insert(tensor, *(f"<{key}>{moments[key]}</{key}>" for key in absent))


def _sdf_lines(com: Array, mass: Array) -> tuple[str, str]:
    return f"<pose>{words(com)} 0 0 0</pose>", f"<mass>{words(mass)}</mass>"


def _sdf_tensor(moments: Mapping[str, str]) -> str:
    return "".join(f"<{key}>{moments[key]}</{key}>" for key in TENSOR)


def _sdf_turn(pose: SourceElement) -> tuple[Array, str]:
    """Rotation of an inertial frame, and its words in the file."""
    quaternion = pose.attributes.get("rotation_format") == "quat_xyzw"
    values = numbers(pose.text, 7 if quaternion else 6)
    angles = values[[6, 3, 4, 5]] if quaternion else values[3:]
    if not quaternion and pose.attributes.get("degrees") == "true":
        angles = np.deg2rad(angles)
    turn = rotation(angles)
    parts = pose.text.split()[3:]
    if not parts or not np.isfinite(turn).all():
        return np.eye(3), "0 0 0 1" if quaternion else "0 0 0"
    return turn, " ".join(parts)


def _write_mjcf(text: SourceText, body: SourceElement, phi: Array) -> None:
    mass, com, inertia = to_mass_com_inertia(phi)
    inertial, full = body.find("inertial"), words(inertia[UPPER])
    if inertial is None:
        values = f'pos="{words(com)}" mass="{words(mass)}" fullinertia="{full}"'
        text.insert(body, f"<inertial {values}/>")
        return
    for key in _TURNS:
        text.remove_attribute(inertial, key)
    text.set_attribute(inertial, "pos", words(com))
    text.set_attribute(inertial, "mass", words(mass))
    text.set_attribute(inertial, "fullinertia", full, old="diaginertia")


_FORMATS: Mapping[str, tuple[Callable[..., Iterator[tuple[str, SourceElement]]], _Writer]] = {
    "robot": (_urdf_links, _write_urdf),
    "sdf": (_sdf_links, _write_sdf),
    "mujoco": (_mjcf_links, _write_mjcf),
}
"""Root element -> the links of a format with their scoped names, and what writes into one."""
