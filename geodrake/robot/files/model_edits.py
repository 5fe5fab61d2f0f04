"""Edits of numbers in a URDF, SDF or MJCF file, whose other text is unchanged.

Rewriting a parsed file would lose comments, attribute order and white space. Therefore elements
have their byte ranges in the file (`LocatedElement`), and only changed bytes are replaced.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from geodrake.boundary.escaping import printable
from geodrake.errors import ModelError
from geodrake.inertia import Array, to_mass_com_inertia
from geodrake.robot.files.checks import UPPER, numbers, rotation, tensor_words, words
from geodrake.robot.files.mjcf_source import own_frames, own_joints
from geodrake.robot.files.xml_text import (
    SUPPORTED_FORMATS,
    LocatedElement,
    parse_xml_bytes,
    place_of,
)

Change = Mapping[str, float]
"""New values of damping, friction, armature, stiffness and rest of a joint, SI."""

_DRAKE = "http://drake.mit.edu"
_SDF_TAGS = {
    "damping": "damping",
    "friction": "friction",
    "stiffness": "spring_stiffness",
    "rest": "spring_reference",
}
_MJCF_NAMES = {
    "damping": "damping",
    "friction": "frictionloss",
    "armature": "armature",
    "stiffness": "stiffness",
    "rest": "springref",
}
_TURNS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
_OF_MASSES = ("settotalmass", "boundmass", "boundinertia", "balanceinertia", "inertiafromgeom")
_TENDONS = ("tendon", "fixed", "spatial")
MOTORS = (
    *("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder"),
    *("muscle", "pid", "dcmotor"),
)
"""Tags of the actuators of an MJCF."""

_PASSIVE: Mapping[str, tuple[str, ...]] = {
    "option": ("density", "viscosity", "wind"),
    "body": ("gravcomp",),
    "joint": ("springdamper",),  # would replace stiffness and damping
    **dict.fromkeys(_TENDONS, ("stiffness", "damping", "armature", "frictionloss")),
    **dict.fromkeys(MOTORS, ("armature", "damping")),
}
"""Tag of an MJCF -> attributes of forces other than those of single joints."""
_MJCF_ASSETS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}
_MJCF_FILES = ("file", "fileright", "fileleft", "fileup", "filedown", "fileback")


DRAKES_SPRINGS: Mapping[str, str | None] = {
    "drake:revolute_spring": "nominal_angle",
    "drake:prismatic_spring": "nominal_position",
    "drake:linear_spring_damper": None,
}
"""Tag of a spring -> key of its rest position; None for a spring between two points."""


class EditedFile:
    """A URDF, SDF or MJCF with changed elements and otherwise unchanged text."""

    def __init__(self, data: bytes, path: Path) -> None:
        """Parse the text of a file; the path is for messages, and names a model without a name."""
        self._data, self.path, self.root = data, path, parse_xml_bytes(data, path)
        if self.root.tag not in _FORMATS:
            raise ModelError(
                f"{path} has the root element <{self.root.tag}>, into which inertias cannot "
                "be written.",
                advice=SUPPORTED_FORMATS,
            )
        self._format = _FORMATS[self.root.tag]

    @property
    def content(self) -> bytes:
        """Return the text with all changes."""
        return edited(self._data, self.path, self.root)

    @property
    def links(self) -> Mapping[str, Element]:
        """Return the links in the file itself, by scoped name."""
        return dict(self._format.links(self.root, self.path))

    def set_inertias(self, inertias: Mapping[str, Array]) -> None:
        """Change inertial parameters (10,), with positive mass, of links by scoped name.

        Numbers in `inertial` elements change, and missing elements are added. Orientations of
        inertial frames stay, except in MJCF, where a full inertia has none and is not in a <frame>.
        """
        elements = self.links
        check_in_itself(inertias, elements, self.path)
        for name, phi in inertias.items():
            for frame in own_frames(elements[name]):
                for inertial in frame.findall("inertial"):
                    frame.remove(inertial)
            self._format.put_inertia(elements[name], phi)

    def set_joint_numbers(self, changes: Mapping[str, Change]) -> None:
        """Change numbers of joints by scoped name."""
        changes = {name: change for name, change in changes.items() if change}
        there = dict(self._format.joints(self.root, self.path))
        check_in_itself(changes, there, self.path)
        for name, change in changes.items():
            self._format.put_numbers(self.root, there[name], change)

    def drop_mass_settings(self) -> bool:
        """Remove settings by which MuJoCo changes masses; return whether there were any."""
        compilers = self.root.findall("compiler") if self.root.tag == "mujoco" else []
        found = [c.attrib.pop(key, None) for c in compilers for key in _OF_MASSES]
        return any(value is not None for value in found)

    def drop_passive_forces(self) -> bool:
        """Remove forces of tendons, motors, media and gravity compensation from an MJCF.

        Polynomial springs of joints are removed, too, and polynomial dampers become linear.
        """
        has_changed = False
        for element in self.root.iter() if self.root.tag == "mujoco" else ():
            before = dict(element.attrib)
            for key in _PASSIVE.get(element.tag, ()):
                element.attrib.pop(key, None)
            stated = {key: element.get(key, "").split() for key in ("damping", "stiffness")}
            if element.tag == "joint" and len(stated["stiffness"]) > 1:
                element.set("stiffness", "0")
            if element.tag == "joint" and len(stated["damping"]) > 1:
                element.set("damping", stated["damping"][0])
            has_changed |= before != element.attrib
        return has_changed

    def set_gravity(self, gravity: Array) -> None:
        """Change the gravity (3,) of an MJCF in the world's frame, m/s²."""
        options = self.root.findall("option") or [child_of(self.root, "option")]
        stated = [option for option in options if "gravity" in option.attrib]
        (stated or options)[-1].set("gravity", words(gravity))

    def add_sections(
        self, sections: Mapping[str, Sequence[Element]], joints: Iterable[str]
    ) -> None:
        """Add nonempty sections, tag -> elements, at the end of an MJCF, and name `joints`."""
        named = _mjcf_joints(self.root, self.path)
        by_name = {name.rpartition("::")[2]: own for name, own in named}
        check_in_itself(joints, by_name, self.path)
        for name in joints:
            by_name[name].set("name", by_name[name].get("name") or name)
        for tag, elements in sections.items():
            if elements:
                SubElement(self.root, tag).extend(elements)

    def move_references(self, folder: Path) -> bool:
        """Make relative paths relative to another folder; return whether any changed."""
        base, target, changed = self.path.resolve().parent, Path(os.path.realpath(folder)), False
        for element, attribute in _references(self.root):
            named = element.attrib[attribute] if attribute else (element.text or "").strip()
            if not named or "://" in named or Path(named).is_absolute():
                continue
            moved = Path(os.path.relpath(base / named, target)).as_posix()
            if Path(moved) == Path(named):
                continue
            changed = True
            if attribute:
                element.set(attribute, moved)
            else:
                element.text = moved
        return changed

    def add_comments(self, sentences: Sequence[str]) -> None:
        """Add comments at the beginning."""
        self.root[:0] = [Comment(comment_words(sentence)) for sentence in sentences]


def put_inertia(root: Element, link: Element, phi: Array) -> None:
    """Write inertial parameters (10,) into a link of a URDF, SDF or MJCF."""
    _FORMATS[root.tag].put_inertia(link, phi)


def put_numbers(root: Element, joint: Element, change: Change) -> None:
    """Write numbers into a joint of a URDF, SDF or MJCF."""
    _FORMATS[root.tag].put_numbers(root, joint, change)


def _references(root: Element) -> Iterator[tuple[Element, str]]:
    """Yield elements that name files, with the attribute, or "" for their text."""
    settings = root.findall("compiler") if root.tag == "mujoco" else []
    kinds = ("assetdir", "meshdir", "texturedir")
    folders = {name for each in settings for name in kinds if name in each.attrib}
    for compiler in settings:
        yield from ((compiler, name) for name in sorted(folders) if name in compiler.attrib)
    for element in root.iter():
        if root.tag == "mujoco":
            inside = _MJCF_ASSETS.get(element.tag)
            apart = inside and not folders & {inside, "assetdir"}
            if apart or element.tag in ("include", "model"):
                yield from ((element, name) for name in _MJCF_FILES if name in element.attrib)
        elif element.tag in ("mesh", "texture") and "filename" in element.attrib:
            yield element, "filename"
        elif root.tag == "sdf" and element.tag == "uri":
            yield element, ""


def sdf_models(parent: Element, scope: str = "", first: str = "") -> Iterator[tuple[str, Element]]:
    """Yield scoped names and elements of all models; `first` replaces the name of a top model."""
    for model in [*parent.findall("model"), *parent.findall("world/model")]:
        own = model.get("name", "")
        name = f"{scope}::{own}" if scope else first or own
        yield name, model
        yield from sdf_models(model, name)


def sdf_joints(root: Element, first: str = "") -> Iterator[tuple[str, str, Element]]:
    """Yield joints with their scoped names in SDF and in Drake.

    In Drake, a joint belongs to the model of its child link.
    """
    for scope, model in sdf_models(root, first=first):
        for joint in model.findall("joint"):
            name, child = joint.get("name"), joint.findtext("child", "").strip()
            yield f"{scope}::{name}", f"{_home(scope, model, child)}::{name}", joint


def _home(scope: str, model: Element, frame: str) -> str:
    """Return the scoped name of the model that owns the link of a frame."""
    own, seen, models = dict(_parts(model)), set[str](), ("model", "robot")
    while frame not in seen:
        seen.add(frame)
        if frame in ("", "__model__"):
            links = (name for tags in (("link",), models) for name in own if own[name].tag in tags)
            frame = model.get("canonical_link") or next(links, "")
        head, _, rest = frame.partition("::")
        part = own.get(head)
        kind = "" if part is None else part.tag
        if part is not None and kind in models:
            return _home(f"{scope}::{head}", part, rest)
        if part is not None and kind in ("frame", "joint"):
            child = part.findtext("child", "").strip()
            frame = part.get("attached_to", "") if kind == "frame" else child
    return scope


def _parts(model: Element) -> Iterator[tuple[str, Element]]:
    """Yield names and elements in a model, with included models in place of includes."""
    for part in model:
        inside = part.model if isinstance(part, LocatedElement) else None
        if inside is None:
            yield part.get("name", ""), part
        elif merges(part):
            yield from _parts(inside)
        else:
            yield part.findtext("name", inside.get("name", "")).strip(), inside


def merges(include: Element) -> bool:
    """Return whether an include merges the parts of its model into the surrounding model."""
    return include.get("merge", "").strip().lower() in ("true", "1")


def sdf_pose(pose: Element) -> tuple[Array, Array]:
    """Return the position (3,) of a <pose>, and roll, pitch, yaw or a quaternion w, x, y, z."""
    quaternion = pose.get("rotation_format") == "quat_xyzw"
    values = numbers(pose.text or "", 7 if quaternion else 6)
    if quaternion:
        return values[:3], values[[6, 3, 4, 5]]
    return values[:3], np.deg2rad(values[3:]) if pose.get("degrees") == "true" else values[3:]


def child_of(parent: Element, tag: str, *, new: bool = False) -> Element:
    """Return the child with a tag, or a new one before those of the file."""
    child = None if new else parent.find(tag)
    if child is None:
        child = Element(tag)
        parent.insert(sum(not isinstance(each, LocatedElement) for each in parent), child)
    return child


_Named = Iterator[tuple[str, Element]]


def _of_urdf(*tags: str) -> Callable[[Element, Path], _Named]:
    def named(root: Element, path: Path) -> _Named:
        scope = root.get("name") or path.stem
        every = (each for tag in tags for each in root.findall(tag))
        yield from ((f"{scope}::{each.get('name')}", each) for each in every)

    return named


def _sdf_links(root: Element, _: Path) -> _Named:
    for name, model in sdf_models(root):
        yield from ((f"{name}::{each.get('name')}", each) for each in model.findall("link"))


def _sdf_joints(root: Element, _: Path) -> _Named:
    yield from ((name, joint) for _, name, joint in sdf_joints(root))


def _mjcf_links(root: Element, path: Path) -> _Named:
    """Yield bodies, with geodrake's names for nameless ones."""
    scope = root.get("model") or path.stem
    numbered = {id(body): k for k, body in enumerate(root.iter("body"))}
    for world in root.findall("worldbody"):
        for body in world.iter("body"):
            yield f"{scope}::{body.get('name') or f'body_{numbered[id(body)]}'}", body


def _mjcf_joints(root: Element, path: Path) -> _Named:
    for name, body in _mjcf_links(root, path):
        scope, _, own = name.rpartition("::")
        for i, joint in enumerate(own_joints(body)):
            yield f"{scope}::{joint.get('name') or f'{own}_joint_{i}'}", joint


def _put_urdf_inertia(link: Element, phi: Array) -> None:
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


def _put_sdf_inertia(link: Element, phi: Array) -> None:
    none = 0.0, np.zeros(3), np.zeros((3, 3))
    mass, com, inertia = to_mass_com_inertia(phi) if phi.any() else none
    inertial = child_of(link, "inertial")
    inertial.attrib.pop("auto", None)
    pose = child_of(inertial, "pose")
    angles = sdf_pose(pose)[1]
    turn, rest = rotation(angles), " ".join((pose.text or "").split()[3:])
    if not rest or not np.isfinite(turn).all():
        turn, rest = np.eye(3), "0 0 0 1" if len(angles) > 3 else "0 0 0"
    pose.text = f"{words(com)} {rest}"
    child_of(inertial, "mass").text = words(mass)
    tensor = child_of(inertial, "inertia")
    for key, word in tensor_words(turn.T @ inertia @ turn).items():
        child_of(tensor, key).text = word


def _put_mjcf_inertia(body: Element, phi: Array) -> None:
    mass, com, inertia = to_mass_com_inertia(phi)
    inertial = child_of(body, "inertial")
    for key in (*_TURNS, "diaginertia"):
        inertial.attrib.pop(key, None)
    inertial.attrib |= {
        "pos": words(com),
        "mass": words(mass),
        "fullinertia": words(inertia[UPPER]),
    }


def _put_urdf_numbers(root: Element, joint: Element, change: Change) -> None:
    given = {name: words(change[name]) for name in ("damping", "friction") if name in change}
    if given:
        child_of(joint, "dynamics").attrib.update(given)
    if "armature" in change:
        _put_rotor(root, joint.get("name", ""), change["armature"])
    if "stiffness" in change:
        _put_springs(root, joint.get("name", ""), change["stiffness"], change.get("rest", 0.0))


def _put_springs(root: Element, joint: str, stiffness: float, rest: float) -> None:
    """Write a joint's spring into the first one of Gazebo or Drake, and 0 into others."""
    for spring, keys in stated_springs(root, joint):
        for key, value in zip(keys, (stiffness, rest), strict=True):
            stated = child_of(spring, key)
            as_text = root.tag == "sdf" or spring.tag == "gazebo"
            stated.attrib.pop("value", None)
            stated.text = words(value) if as_text else None
            if not as_text:
                stated.set("value", words(value))
        stiffness = 0.0


def stated_springs(root: Element, joint: str) -> list[tuple[Element, tuple[str, str]]]:
    """Return springs of Gazebo or Drake at a joint, with tags of stiffness and rest."""
    springs = list[tuple[Element, tuple[str, str]]]()
    for each in root.iter():
        keys, name = ("springStiffness", "springReference"), each.get("reference")
        if rest := DRAKES_SPRINGS.get(each.tag):
            keys, name = (f"{each.tag}_stiffness", f"{each.tag}_{rest}"), of_drake(each, "joint")
        elif each.tag != "gazebo" or each.find(keys[0]) is None:
            continue
        if name == joint:
            springs.append((each, keys))
    return springs


def of_drake(element: Element, key: str) -> str:
    """Return the value of a child of one of Drake's elements, by key."""
    child = element.find(f"{element.tag}_{key}")
    words = () if child is None else (child.get("name"), child.get("value"), child.text)
    return next((word.strip() for word in words if word and word.strip()), "")


def _put_rotor(root: Element, joint: str, armature: float) -> None:
    """Write Drake's rotor inertia, with the gear ratio of the file, if any."""
    root.attrib.setdefault("xmlns:drake", _DRAKE)
    actuators = [  # in transmissions that Drake reads
        actuator
        for transmission in root.findall("transmission")
        if any("SimpleTransmission" in (e.text or "") for e in transmission.findall("type"))
        and any(each.get("name") == joint for each in transmission.findall("joint"))
        for actuator in transmission.findall("actuator")
    ]
    if actuators:
        ratio = actuators[0].find("drake:gear_ratio")
        gear = 1.0 if ratio is None else _gear(ratio.get("value", "1"))
        rotor = child_of(actuators[0], "drake:rotor_inertia")
        rotor.set("value", words(armature / (gear or 1.0) ** 2))
        if ratio is not None and not gear:
            ratio.set("value", "1.0")
        return
    transmission = child_of(root, "transmission", new=True)
    transmission.set("name", f"{joint}_rotor")
    SubElement(transmission, "type").text = "transmission_interface/SimpleTransmission"
    SubElement(transmission, "joint", name=joint)
    actuator = SubElement(transmission, "actuator", name=f"{joint}_motor")
    SubElement(actuator, "drake:rotor_inertia", value=words(armature))
    SubElement(actuator, "drake:gear_ratio", value="1.0")


def _gear(text: str) -> float:
    """Return a gear ratio; 0 if it is invalid."""
    gear = float(numbers(text, 1)[0])
    return gear if np.isfinite(gear) else 0.0


def _put_sdf_numbers(root: Element, joint: Element, change: Change) -> None:
    axis = joint.find("axis")
    if axis is None:
        raise ModelError(f"{joint.get('name')} has no <axis> to write to.")
    if "stiffness" in change:
        _put_springs(root, joint.get("name", ""), 0.0, 0.0)
    for name, tag in _SDF_TAGS.items():
        if name in change:
            child_of(child_of(axis, "dynamics"), tag).text = words(change[name])
    if "armature" in change:
        root.attrib.setdefault("xmlns:drake", _DRAKE)
        ratio = joint.find("drake:gear_ratio")
        gear = 0.0 if ratio is None else _gear(ratio.text or "")
        child_of(joint, "drake:rotor_inertia").text = words(change["armature"] / (gear or 1.0) ** 2)
        if not gear:
            child_of(joint, "drake:gear_ratio").text = "1.0"


def _put_mjcf_numbers(_: Element, joint: Element, change: Change) -> None:
    joint.attrib.update({_MJCF_NAMES[name]: words(value) for name, value in change.items()})


@dataclass(frozen=True)
class _Format:
    """Links and joints of a format by scoped name, and functions that write to them."""

    links: Callable[[Element, Path], _Named]
    joints: Callable[[Element, Path], _Named]
    put_inertia: Callable[[Element, Array], None]
    put_numbers: Callable[[Element, Element, Change], None]


_FORMATS: Mapping[str, _Format] = {
    "robot": _Format(
        _of_urdf("link"), _of_urdf("joint", "drake:joint"), _put_urdf_inertia, _put_urdf_numbers
    ),
    "sdf": _Format(_sdf_links, _sdf_joints, _put_sdf_inertia, _put_sdf_numbers),
    "mujoco": _Format(_mjcf_links, _mjcf_joints, _put_mjcf_inertia, _put_mjcf_numbers),
}
"""Root element -> format."""


_SPACE = re.compile(rb"\s*?(\r?\n[ \t]*)(?=\S)")
_END = re.compile(rb"</[^>]*>")
_LAST_SPACE = re.compile(rb"\r?\n[ \t]*\Z")
_ATTRIBUTE = re.compile(rb"""(\s+)([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")
_START = re.compile(rb"(<[^\s/>]+)((?:" + _ATTRIBUTE.pattern + rb")*)\s*(/?>)")


def edited(data: bytes, path: Path, root: Element) -> bytes:
    """Return the bytes of a file with changed attributes, texts, and added or removed elements.

    New elements must come before or after all others; removed ones must have no children.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in data[:4]:
        raise ModelError(
            f"{path} is encoded in UTF-16 or UTF-32, which geodrake cannot edit.",
            advice="Save it in UTF-8.",
        )
    current = {each.start: each for each in root.iter() if isinstance(each, LocatedElement)}
    edits = list[tuple[int, int, bytes]]()
    for old in parse_xml_bytes(data, path).iter():
        if isinstance(old, LocatedElement) and old.start in current:
            edits += _edits_of(current[old.start], old, data)
        elif isinstance(old, LocatedElement):
            end = _END.match(data, old.end)
            edits.append((old.start, end.end() if end else old.end, b""))
    for low, high, text in sorted(edits, key=lambda edit: edit[:2], reverse=True):
        data = data[:low] + text + data[high:]
    return data


def _edits_of(
    element: Element, old: LocatedElement, data: bytes
) -> Iterator[tuple[int, int, bytes]]:
    """Yield the byte ranges of a changed element and their replacements."""
    new_text, previous = (element.text or "").strip(), (old.text or "").strip()
    children = list(element)
    if element.attrib == old.attrib and new_text == previous and len(children) == len(old):
        return
    start = _START.match(data, old.start)
    if start is None:
        raise ModelError(
            f"{place_of(old)}: <{old.tag}> is in an entity, and cannot be edited.",
            advice="Write it where the entity is used.",
        )
    yield *start.span(2), _attributes(element.attrib, old.attrib, start[2])
    located = [k for k, each in enumerate(children) if isinstance(each, LocatedElement)]
    first, last = (located[0], located[-1]) if located else (len(children), len(children))
    inside = start.end()
    if start[6] == b"/>":
        if new_text or children:
            lines = [escape(new_text), *(x.strip() for each in children for x in _lines(each))]
            yield *start.span(6), f">{''.join(lines)}</{old.tag}>".encode()
        return
    if new_text != previous:
        low, high, text = inside, old.end, previous.encode()
        if text and data[low:high].count(text) == 1:  # keep white space and comments around it
            low = data.index(text, low)
            high = low + len(text)
        yield low, high, escape(new_text).encode()
    space = _SPACE.match(data, inside)
    before = space[1].decode() if space else ""
    if before and data.startswith(b"</", space.end() if space else 0):
        before += "  "
    yield inside, inside, _indented(children[:first], before)
    final = next((each for each in reversed(old) if isinstance(each, LocatedElement)), old)
    space = _LAST_SPACE.search(data, 0, final.start)
    at = inside + len(data[inside : old.end].rstrip())  # after all others and comments
    yield at, at, _indented(children[last + 1 :], space[0].decode() if space else "")


def _attributes(new: Mapping[str, str], old: Mapping[str, str], text: bytes) -> bytes:
    """Return the text of attributes, changed only where values differ."""

    def written(match: re.Match[bytes]) -> bytes:
        key = match[2].decode()
        if key not in new:
            return b""
        return match[0] if new[key] == old[key] else _written(match[1], key, new[key])

    added = (_written(b" ", key, new[key]) for key in new if key not in old)
    return b"".join([_ATTRIBUTE.sub(written, text), *added])


def _written(space: bytes, key: str, word: str) -> bytes:
    return space + f"{key}={quoteattr(word)}".encode()


def _indented(elements: Sequence[Element], before: str) -> bytes:
    """Return the text of new elements, each line with the same indentation."""
    lines = [line for each in elements for line in _lines(each)]
    return "".join(before + line if before else line.strip() for line in lines).encode()


def _lines(element: Element) -> list[str]:
    """Return the lines of a new element, indented by two spaces."""
    indented = deepcopy(element)
    if any(len(child) or child.attrib for child in element):
        indent(indented)
    return tostring(indented, encoding="unicode").replace(" />", "/>").splitlines()


def comment_words(sentence: str) -> str:
    """Return a sentence for an XML comment, without consecutive hyphens."""
    return f" {re.sub('-(?=-)', '- ', printable(sentence))} "


def check_in_itself(names: Iterable[str], there: Container[str], path: Path) -> None:
    """Raise for names of elements in included files."""
    missing = sorted(name for name in names if name not in there)
    if missing:
        raise ModelError(
            f"{', '.join(name.rpartition('::')[2] for name in missing)} is not in {path} itself.",
            advice="Copy included files into the model; MuJoCo writes out what an MJCF replicates "
            "or attaches: mujoco.mj_saveLastXML(NAME, mujoco.MjModel.from_xml_path(...)).",
        )
