"""Links of URDF, SDF and MJCF, and inertias written into them; orientations of frames stay."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.errors import ModelError
from geodrake.inertia import Array, to_mass_com_inertia
from geodrake.robot.files.source_text import check_in_itself, edited
from geodrake.robot.files.values import UPPER, numbers, rotation, tensor_words, words
from geodrake.robot.files.xml_text import SUPPORTED_FORMATS, LocatedElement, parse_xml_bytes

_TURNS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
_OF_MASSES = (
    "settotalmass",
    "boundmass",
    "boundinertia",
    "balanceinertia",
    "inertiafromgeom",
    "inertiagrouprange",
)


def with_inertias(data: bytes, path: Path, inertias: Mapping[str, Array]) -> bytes:
    """Return a model file with other inertial parameters of some links.

    Numbers inside of `inertial` elements change, and what those lack is added; orientations of
    inertial frames stay, but in MJCF, where a full inertia has none.

    Args:
        path: The file, for messages and for the name of a model that has none.
        inertias: Scoped link name -> (10,) inertial parameters of mass above zero.
    """
    root = parse_xml_bytes(data, path)
    if root.tag not in _FORMATS:
        raise ModelError(
            f"{path} has the root element <{root.tag}>, into which no inertias can be written.",
            advice=SUPPORTED_FORMATS,
        )
    there = dict(_FORMATS[root.tag][0](root, path))
    check_in_itself(inertias, there, path)
    for name, phi in inertias.items():
        put_inertia(root, there[name], phi)
    return edited(data, path, root)


def put_inertia(root: Element, link: Element, phi: Array) -> None:
    """Write inertial parameters (10,) into a link of a URDF, SDF or MJCF with a root element."""
    _FORMATS[root.tag][1](link, phi)


def without_mass_settings(data: bytes, path: Path) -> bytes:
    """Return an MJCF without settings by which MuJoCo changes masses; others as they are."""
    root = parse_xml_bytes(data, path)
    for compiler in root.findall("compiler") if root.tag == "mujoco" else ():
        for key in _OF_MASSES:
            compiler.attrib.pop(key, None)
    return edited(data, path, root)


def link_names(data: bytes, path: Path) -> frozenset[str]:
    """Return scoped names of the links that stand in a file itself."""
    root = parse_xml_bytes(data, path)
    return (
        frozenset(dict(_FORMATS[root.tag][0](root, path))) if root.tag in _FORMATS else frozenset()
    )


def sdf_models(parent: Element, scope: str = "", first: str = "") -> Iterator[tuple[str, Element]]:
    """Yield models within models and worlds, with their scoped names.

    Args:
        scope: Its scoped name; nothing for a file.
        first: Name of the models of a file; nothing for their own.
    """
    for model in [*parent.findall("model"), *parent.findall("world/model")]:
        own = model.get("name", "")
        name = f"{scope}::{own}" if scope else first or own
        yield name, model
        yield from sdf_models(model, name)


def mjcf_bodies(root: Element, path: Path) -> Iterator[tuple[str, str, Element]]:
    """Yield the name of the model of an MJCF and those of its bodies, as geodrake calls them."""
    scope = root.get("model") or path.stem
    numbered = {id(body): k for k, body in enumerate(root.iter("body"))}
    for world in root.findall("worldbody"):
        for body in world.iter("body"):
            yield scope, body.get("name") or f"body_{numbered[id(body)]}", body


def _urdf_links(root: Element, path: Path) -> Iterator[tuple[str, Element]]:
    scope = root.get("name") or path.stem
    yield from ((f"{scope}::{link.get('name')}", link) for link in root.findall("link"))


def _sdf_links(root: Element, path: Path) -> Iterator[tuple[str, Element]]:
    del path
    for name, model in sdf_models(root):
        yield from ((f"{name}::{link.get('name')}", link) for link in model.findall("link"))


def _mjcf_links(root: Element, path: Path) -> Iterator[tuple[str, Element]]:
    yield from ((f"{scope}::{name}", body) for scope, name, body in mjcf_bodies(root, path))


def _put_urdf(link: Element, phi: Array) -> None:
    """Write inertial parameters (10,) into a link of a URDF."""
    mass, com, inertia = to_mass_com_inertia(phi)
    inertial = child_of(link, "inertial")
    origin = child_of(inertial, "origin")
    turn = rotation(numbers(origin.get("rpy", ""), 3))
    if "rpy" not in origin.attrib or not np.isfinite(turn).all():
        turn = np.eye(3)
        origin.attrib |= {"xyz": words(com), "rpy": "0 0 0"}
    origin.set("xyz", words(com))
    child_of(inertial, "mass").set("value", words(mass))
    child_of(inertial, "inertia").attrib.update(tensor_words(turn.T @ inertia @ turn))


def _put_sdf(link: Element, phi: Array) -> None:
    """Write inertial parameters (10,) into a link of an SDF."""
    mass, com, inertia = to_mass_com_inertia(phi)
    inertial = child_of(link, "inertial")
    if inertial.get("auto") == "true":
        inertial.set("auto", "false")
    pose = child_of(inertial, "pose")
    turn, rest = _sdf_turn(pose)
    pose.text = f"{words(com)} {rest}"
    child_of(inertial, "mass").text = words(mass)
    tensor = child_of(inertial, "inertia")
    for key, word in tensor_words(turn.T @ inertia @ turn).items():
        child_of(tensor, key).text = word


def _put_mjcf(body: Element, phi: Array) -> None:
    """Write inertial parameters (10,) into a body of an MJCF."""
    mass, com, inertia = to_mass_com_inertia(phi)
    inertial = child_of(body, "inertial")
    for key in (*_TURNS, "diaginertia"):
        inertial.attrib.pop(key, None)
    inertial.attrib |= {
        "pos": words(com),
        "mass": words(mass),
        "fullinertia": words(inertia[UPPER]),
    }


def child_of(parent: Element, tag: str, *, new: bool = False) -> Element:
    """Return the child of a tag; where there is none, a new one before those of the file."""
    found = None if new else parent.find(tag)
    if found is None:
        found = Element(tag)
        parent.insert(sum(not isinstance(each, LocatedElement) for each in parent), found)
    return found


def _sdf_turn(pose: Element) -> tuple[Array, str]:
    """Return the rotation of an inertial frame, and its words in the file."""
    text = pose.text or ""
    quaternion = pose.get("rotation_format") == "quat_xyzw"
    values = numbers(text, 7 if quaternion else 6)
    angles = values[[6, 3, 4, 5]] if quaternion else values[3:]
    if not quaternion and pose.get("degrees") == "true":
        angles = np.deg2rad(angles)
    turn, parts = rotation(angles), text.split()[3:]
    if not parts or not np.isfinite(turn).all():
        return np.eye(3), "0 0 0 1" if quaternion else "0 0 0"
    return turn, " ".join(parts)


_Links = Callable[[Element, Path], Iterator[tuple[str, Element]]]
_FORMATS: Mapping[str, tuple[_Links, Callable[[Element, Array], None]]] = {
    "robot": (_urdf_links, _put_urdf),
    "sdf": (_sdf_links, _put_sdf),
    "mujoco": (_mjcf_links, _put_mjcf),
}
"""Root element -> the links of a format with their scoped names, and what writes into one."""
