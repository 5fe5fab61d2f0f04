"""MJCF compiled by MuJoCo, which defines the format.

MuJoCo gets texts and bytes that geodrake has read, under keys of their own, so that it opens no
file itself: includes are put in their places, and meshes and attached models are named anew.
"""

from __future__ import annotations

import re
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.boundary.input_files import read_regular
from geodrake.errors import ModelError
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.mjcf_balls import split_balls
from geodrake.robot.files.values import drop
from geodrake.robot.files.xml_text import (
    LARGEST_FILE,
    LocatedElement,
    numbered_text,
    parse_xml,
    place_of,
)

_NO_DYNAMICS = (
    "sensor",
    "keyframe",
    "visual",
    "statistic",
    "custom",
    "contact",
    "size",  # which would ask for memory
    "camera",
    "light",
    "skin",
    "texture",
    "layer",
)
_FOLDERS = ("meshdir", "assetdir", "texturedir", "strippath")
_MESHES = (".obj", ".stl", ".msh")
_MOST_ELEMENTS = 200_000  # with those that MuJoCo makes of others
_MOST_MADE = 2000  # bodies that one element makes
_DEEPEST = 30  # models attached to models
Sizes = dict[str, tuple[int, int]]
"""Name of a model that is attached -> how many elements and how many bodies it has."""

_ONE_AT_A_TIME = threading.RLock()  # as where warnings go is one place of the whole process
_LINE = re.compile(r",? *line (\d+)")


def mujoco_or_none() -> ModuleType | None:
    """Return MuJoCo, where it is installed and new enough."""
    try:
        import mujoco
    except ImportError:
        return None
    flags = getattr(mujoco, "mjtDisableBit", None)  # without springs' before 3.5
    return mujoco if hasattr(mujoco, "MjSpec") and hasattr(flags, "mjDSBL_SPRING") else None


@contextmanager
def quiet_mujoco(mujoco: ModuleType) -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which it would print, and write into a file where it runs."""
    said: list[str] = []
    with _ONE_AT_A_TIME:
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(said.append)
        try:
            with warnings.catch_warnings(record=True) as raised:
                warnings.simplefilter("always")
                yield said
        finally:
            mujoco.set_mju_user_warning(before)
    said += (str(each.message) for each in raised)


@dataclass(eq=False)
class CompiledMjcf:
    """What MuJoCo makes of a file.

    Attributes:
        elements: Names of bodies -> their elements in the file; without those made by MuJoCo.
        unknown: Names of bodies whose inertia follows from meshes that are not there alone.
        lost: Sentences on meshes that are not there.
        touching: Names of bodies of whose meshes that are not there some touch others.
        plugins: Places of plugins, which are left out.
        split: Sentences on ball joints of closed loops, which are three hinges.
        about: Sentences on what of them is not quite the same.
    """

    model: Any
    elements: dict[str, Element] = field(default_factory=dict)
    unknown: frozenset[str] = frozenset()
    lost: tuple[str, ...] = ()
    touching: tuple[str, ...] = ()
    plugins: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    split: tuple[str, ...] = ()
    about: tuple[str, ...] = ()


def compiled(root: Element, path: Path, mujoco: ModuleType, *, geoms: bool = False) -> CompiledMjcf:
    """Return what MuJoCo makes of a file whose includes are in their places.

    Args:
        geoms: Keep geoms that have no part in inertias, for pictures and collisions.

    Raises:
        ModelError: MuJoCo refuses it, in MuJoCo's words, or a file that it names is missing.
    """
    return _Compiler(path, mujoco, geoms).read(root)


@dataclass
class _Absent:
    """Meshes that are not there: bodies that have such, by what follows from that.

    Attributes:
        where: Folders in which they are not.
        unknown: Bodies of whose inertia nothing else tells.
        heavy: Bodies whose inertia follows from them, alone or in part.
        seen: Bodies whose inertia does not.
        touching: Bodies of which some touch others.
    """

    where: str = ""
    unknown: set[str] = field(default_factory=set)
    heavy: list[str] = field(default_factory=list)
    seen: list[str] = field(default_factory=list)
    touching: list[str] = field(default_factory=list)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return what is said of them."""
        gone = f"meshes that are not there or not .obj, .stl or .msh (in {self.where})"
        found = list[str]()
        if self.heavy:
            found.append(
                f"The inertia of {', '.join(self.heavy)} follows from {gone}; these meshes do not "
                "count."
            )
        if self.seen:
            found.append(f"The shapes of {', '.join(self.seen)} are, in part, {gone}.")
        return tuple(found)


@dataclass
class _Compiler:
    path: Path
    mujoco: ModuleType
    geoms: bool
    models: dict[str, bytes] = field(default_factory=dict)
    meshes: dict[str, Path] = field(default_factory=dict)
    plugins: list[str] = field(default_factory=list)

    def read(self, root: Element) -> CompiledMjcf:
        self._prepare(root, self.path, "", (self.path.resolve(),))
        bodies = {e.get("name", ""): e for w in root.findall("worldbody") for e in w.iter("body")}
        text, places = numbered_text(root)
        with self._refusals(places), quiet_mujoco(self.mujoco) as said:
            spec = self.mujoco.MjSpec.from_string(text, include=self.models or None)
            spec.compiler.usethread = False
            _name_joints(spec)
            absent = self._take_meshes(spec)
            model = spec.compile()
            free = unused({joint.name for joint in spec.joints})
            split, about = split_balls(spec, model, self.mujoco, free)
            if split:
                model = spec.compile()
        self._check_finite(model)
        return CompiledMjcf(
            model,
            bodies,
            frozenset(absent.unknown),
            absent.sentences,
            tuple(absent.touching),
            tuple(self.plugins),
            tuple(said),
            split,
            about,
        )

    def _prepare(self, root: Element, path: Path, prefix: str, chain: tuple[Path, ...]) -> Sizes:
        """Leaves what bears on dynamics; return how many elements each attached model has."""
        drop(root, *_NO_DYNAMICS)
        self._take_plugins(root)
        folders = _take_folders(root)
        if not self.geoms:
            _drop_idle_geoms(root)
        _name_bodies(root, prefix)
        sizes: Sizes = {}
        for element in [e for e in root.iter() if e.get("file") or e.tag == "hfield"]:
            if element.tag == "model":
                name, size = self._attach(element, path, chain)
                sizes[name] = size
            elif element.tag == "hfield":
                element.set("name", element.get("name") or Path(element.get("file", "")).stem)
                for key in ("file", "elevation", "content_type"):
                    element.attrib.pop(key, None)
                element.attrib.update(nrow="2", ncol="2")
            elif element.tag in ("mesh", "flexcomp"):
                self._name_mesh(element, path, folders)
            else:
                element.attrib.pop("file")
        for material in root.iter("material"):
            material.attrib.pop("texture", None)
        _check_size(root, sizes, path)
        return sizes

    def _take_plugins(self, root: Element) -> None:
        for plugin in root.iter("plugin"):
            if plugin.get("plugin") or plugin.get("instance"):
                name = plugin.get("plugin") or plugin.get("instance")
                self.plugins.append(f"the plugin {name} ({place_of(plugin) or self.path})")
        drop(root, "extension", "plugin")

    def _attach(
        self, element: Element, path: Path, chain: tuple[Path, ...]
    ) -> tuple[str, tuple[int, int]]:
        """Makes a model known under a key, and return its name and how many elements it has."""
        file = path.parent / element.get("file", "")
        data = parse_xml(file)
        if data.tag != "mujoco":
            reason = f"attaches {file}, whose root element is <{data.tag}> instead of <mujoco>"
            raise _wrong(f"{place_of(element) or path} {reason}.", path)
        if file.resolve() in chain or len(chain) > _DEEPEST:
            raise _wrong(f"{path} cannot be read: {file} attaches itself.", path)
        Includes(file, {}).insert_elements(data)
        name = element.get("name") or data.get("model") or file.stem
        element.set("name", name)
        sizes = self._prepare(data, file, f"{name}_", (*chain, file.resolve()))
        key = f"model_{len(self.models)}.xml"
        element.set("file", key)
        element.attrib.pop("content_type", None)
        self.models[key] = numbered_text(data)[0].encode()
        return name, _size(data, sizes)

    def _name_mesh(self, element: Element, path: Path, folders: Sequence[str]) -> None:
        """Names a mesh's file by a key, and the mesh itself as MuJoCo would."""
        place, strip = Path(element.get("file", "")), folders[1] == "true"
        place = Path(place.name) if strip else place
        if element.tag == "mesh":
            element.set("name", element.get("name") or place.stem)
        key = f"{len(self.meshes)}_{place.name}"
        self.meshes[key] = path.parent / folders[0] / place
        element.set("file", key)

    def _take_meshes(self, spec: Any) -> _Absent:
        """Gives the meshes that are there, and return what is said of the others."""
        used = {geom.meshname for geom in spec.geoms if geom.meshname}
        assets, absent = dict[str, bytes](), dict[str, Path]()
        for mesh in list(spec.meshes):
            file = self.meshes.get(mesh.file)
            if mesh.name not in used:
                spec.delete(mesh)
            elif file is not None:
                if not file.exists() or file.suffix.lower() not in _MESHES:
                    absent[mesh.name] = file
                else:
                    assets[mesh.file] = read_regular(file, "mesh", ModelError, largest=LARGEST_FILE)
        spec.assets = assets
        return self._without(spec, absent) if absent else _Absent()

    def _without(self, spec: Any, absent: dict[str, Path]) -> _Absent:
        """Take geoms out whose meshes are not there, and return what follows from that."""
        where = ", ".join(dict.fromkeys(str(file.parent) for file in absent.values()))
        found, always = _Absent(where), int(self.mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE)
        by_geoms = int(spec.compiler.inertiafromgeom) == always
        for body in spec.bodies:
            gone = [geom for geom in body.geoms if geom.meshname in absent]
            if any(geom.contype or geom.conaffinity for geom in gone):
                found.touching.append(body.name)
            for geom in gone:
                spec.delete(geom)
            heavy = body.explicitinertial or body.name == "world"
            if gone:
                follows = body.name != "world" and (by_geoms or not heavy)
                (found.heavy if follows else found.seen).append(body.name)
            if (
                gone
                and not heavy
                and not any(geom.mass != 0.0 and geom.density != 0.0 for geom in body.geoms)
            ):
                found.unknown.add(body.name)
                body.explicitinertial = True
                body.mass, body.inertia, body.ipos = 1.0, [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]
        for mesh in list(spec.meshes):
            if mesh.name in absent:
                spec.delete(mesh)
        return found

    def _check_finite(self, model: Any) -> None:
        for at in range(model.nbody):
            tables = (model.body_mass, model.body_ipos, model.body_inertia, model.body_iquat)
            places = (model.body_pos, model.body_quat)
            if not all(np.isfinite(table[at]).all() for table in (*tables, *places)):
                name = self.mujoco.mj_id2name(model, self.mujoco.mjtObj.mjOBJ_BODY, at)
                raise _wrong(f"{self.path}: the body {name!r} has what is no number.", self.path)

    @contextmanager
    def _refusals(self, places: Sequence[str]) -> Iterator[None]:
        """Turns what MuJoCo raises into a `ModelError` with its words, the file and the line."""
        try:
            yield
        except (ModelError, OSError, MemoryError):
            raise
        except Exception as error:  # ValueError, and FatalError of MuJoCo's own
            words = " ".join(str(error).split())[:400]
            found = _LINE.findall(words)
            at = int(found[-1]) - 1 if found else -1
            place = places[at] if 0 <= at < len(places) and not self.models else ""
            for key, file in self.meshes.items():
                words = words.replace(key, str(file))
            words = _LINE.sub("", words).removeprefix("XML Error: ").removeprefix("Error: ")
            raise _wrong(
                f"MuJoCo refuses {place or self.path}: {words.rstrip('.')}.", self.path
            ) from error


def _wrong(words: str, path: Path) -> ModelError:
    return ModelError(words, advice="Correct the file there.", path=path)


def _take_folders(root: Element) -> tuple[str, str]:
    """Return the folder of meshes, and whether names of files keep theirs; settles the rest."""
    found = dict.fromkeys(_FOLDERS, "")
    for compiler in root.findall("compiler"):
        for key in _FOLDERS:
            found[key] = compiler.attrib.pop(key, found[key])
        # Bodies keep their names and frames, whatever makes a simulation faster.
        for key in ("fusestatic", "alignfree", "discardvisual", "usethread"):
            compiler.attrib.pop(key, None)
        if not compiler.attrib:
            root.remove(compiler)
    return found["meshdir"] or found["assetdir"], found["strippath"]


def _drop_idle_geoms(root: Element) -> None:
    """Drop geoms that have no part in inertias or in a medium, whose meshes need not be there."""
    if any(element.get("fluidshape") for element in root.iter()):
        return
    settings = [each.get("inertiafromgeom") for each in root.findall("compiler")]
    always = next((each for each in reversed(settings) if each), "auto") == "true"
    wrapped = {e.get("geom") for group in root.findall("tendon") for e in group.iter("geom")}

    def within(element: Element, idle: bool) -> None:
        for child in list(element):
            if child.tag == "body":
                within(child, not always and child.find("inertial") is not None)
            elif child.tag in ("frame", "replicate"):
                within(child, idle)
            elif child.tag == "geom" and idle and child.get("name", "") not in wrapped - {None}:
                element.remove(child)

    for world in root.findall("worldbody"):
        within(world, True)


def _name_bodies(root: Element, prefix: str) -> None:
    """Gives bodies and joints names where they have none."""
    every = [body for body in root.iter("body") if body.get("name") or len(body)]
    taken = {body.get("name") for body in every}
    free = unused(taken)
    joints = unused({joint.get("name") for body in every for joint in body.iter("joint")})
    worlds = [body for world in root.findall("worldbody") for body in world.iter("body")]
    numbers = {id(body): k for k, body in enumerate(root.iter("body"))}
    for body in worlds:
        if not body.get("name"):
            body.set("name", free(f"{prefix}body_{numbers[id(body)]}"))
        for i, joint in enumerate(_own_joints(body)):
            if not joint.get("name"):
                joint.set("name", joints(f"{body.get('name')}_joint_{i}"))


def _name_joints(spec: Any) -> None:
    """Give names to joints that MuJoCo made."""
    free = unused({joint.name for joint in spec.joints})
    for body in spec.bodies:
        for i, joint in enumerate(body.joints):
            joint.name = joint.name or free(f"{body.name}_joint_{i}")


def _own_joints(body: Element) -> Iterator[Element]:
    for child in body:
        if child.tag == "joint":
            yield child
        elif child.tag in ("frame", "replicate"):
            yield from _own_joints(child)


def unused(taken: set[str | None]) -> Callable[[str], str]:
    """Return what makes a name that is not taken out of one, and takes it."""

    def name(wanted: str) -> str:
        while wanted in taken:
            wanted += "_"
        taken.add(wanted)
        return wanted

    return name


def _check_size(root: Element, sizes: Sizes, path: Path) -> None:
    """Refuses files of which MuJoCo would make more than a robot has, before it does."""
    for element in root.iter():
        if element.tag in ("composite", "flexcomp"):
            made = 1
            for word in (element.get("count") or "1").split():
                made *= _whole(word)
            if made > _MOST_MADE:
                raise _wrong(
                    f"{place_of(element) or path}: <{element.tag}> makes {made} bodies, and "
                    f"geodrake reads up to {_MOST_MADE}.",
                    path,
                )
        if element.tag == "mesh" and element.get("builtin"):
            words = (element.get("params") or "").split()
            if any(_whole(word) > 100 for word in words):
                raise _wrong(f"{place_of(element) or path}: <mesh> is too fine.", path)
    elements, bodies = _size(root, sizes)
    for what, made, most in (("elements", elements, _MOST_ELEMENTS), ("links", bodies, _MOST_MADE)):
        if made > most:
            raise _wrong(
                f"{path} cannot be read: MuJoCo would make more than {most} {what} of it.", path
            )


def _size(element: Element, sizes: Sizes) -> tuple[int, int]:
    """Return how many elements MuJoCo makes of one, and how many bodies of them, at most."""
    elements, bodies = 1, int(element.tag == "body")
    if element.tag == "attach":
        more = sizes.get(element.get("model", ""), (0, 0))
        elements, bodies = elements + more[0], bodies + more[1]
    for child in element:
        more = _size(child, sizes)
        elements, bodies = elements + more[0], bodies + more[1]
    count = max(1, _whole(element.get("count") or "1")) if element.tag == "replicate" else 1
    return min(count * elements, 10 * _MOST_ELEMENTS), min(count * bodies, 10 * _MOST_ELEMENTS)


def _whole(word: str) -> int:
    try:
        return abs(int(float(word)))
    except (ValueError, OverflowError):
        return 0  # which MuJoCo refuses


def located(tag: str, attributes: dict[str, str], like: Element | None) -> Element:
    """Return an element that was read where another one was."""
    if not isinstance(like, LocatedElement):
        return Element(tag, attributes)
    made = LocatedElement(tag, attributes)
    made.path, made.line = like.path, like.line
    return made
