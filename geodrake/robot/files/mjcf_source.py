"""MJCF compiled by MuJoCo, which defines the format.

MuJoCo opens no file itself. geodrake reads all files and passes them under keys: includes are
inserted, and meshes and attached models are renamed.

Ball joints of closed loops become three hinges, because a loop's joints need one coordinate each.
The last hinge points to the closing point of the loop: a rod with balls at both ends turns about
its own axis without moving anything else.
"""

from __future__ import annotations

import importlib
import re
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from geodrake.boundary.input_files import read_regular
from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files.checks import drop
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.xml_text import LARGEST_FILE, numbered_text, parse_xml, place_of, wrong_at

_NO_DYNAMICS = (
    *("sensor", "keyframe", "visual", "statistic", "custom", "contact", "camera", "light"),
    *("skin", "texture", "layer"),
    "size",  # would allocate memory
)
_OF_ACTUATORS = {
    *("name", "class", "group", "ctrlrange", "forcerange", "ctrllimited", "forcelimited", "gear"),
    *("joint", "jointinparent", "tendon", "site", "refsite", "cranksite", "slidersite"),
    *("cranklength", "body", "armature", "damping", "lengthrange"),
}
"""Attributes that actuators with a plugin share with others."""

_FOLDERS = ("meshdir", "assetdir", "texturedir", "strippath")
_MESHES = (".obj", ".stl", ".msh")
_MOST_MADE = 20_000  # copies or bodies made by one element and its ancestors
_DEEPEST, _MOST_MODELS = 30, 300  # nesting and number of attached models
_OF_BALLS = ("armature", "frictionloss", "damping")  # copied to each hinge, as an approximation
_SUFFIXES = ("_1", "_2", "_spin")

_ONE_AT_A_TIME = threading.RLock()  # the handler of warnings is global
_COUNT = re.compile(r"[-+]?\d{1,20}(\.\d*)?")
_LINE = re.compile(r",? *line (\d+)")


def load_mujoco() -> Any:
    """Return MuJoCo, imported on demand as it is slow to import."""
    return importlib.import_module("mujoco")


@contextmanager
def quiet_mujoco() -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which it would otherwise print and write to a file."""
    mujoco, said = load_mujoco(), list[str]()
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


class CompiledMjcf:
    """A file with resolved includes as compiled by MuJoCo.

    Attributes:
        model: MuJoCo's model.
        elements: Body name -> element in the file, without bodies made by MuJoCo.
        groups: Tendons, actuators, equalities and joints of the file itself, in order.
        said: MuJoCo's warnings.
        notes: Sentences on ball joints that became three hinges.
        left_out: Sentences on ignored properties of such joints, and on plugins.
        unknown: Names of bodies whose inertia depends only on missing meshes.
        lost: Sentences on missing meshes.
        touching: Names of bodies with missing meshes for collisions.
    """

    def __init__(self, root: Element, path: Path, *, geoms: bool = False) -> None:
        """Compile a file; with `geoms`, keep geoms that do not affect inertias, too."""
        self.path, self.geoms = path, geoms
        self.models, self.meshes = dict[str, bytes](), dict[str, Path]()
        self.notes, self.left_out, self.lost = list[str](), list[str](), list[str]()
        self.unknown, self.touching, self.wrapped = set[str](), list[str](), set[str]()
        self._angles = set[tuple[str, str]]()  # conventions of the models
        fuses = any(each.get("fusestatic") == "true" for each in root.findall("compiler"))
        self._prepare(root, path, "", (path.resolve(),))
        if fuses and len(self._angles) > 1:
            self.notes.append(
                f"{path}: with fusestatic, MuJoCo reads angles of attached models by the compiler "
                "of the file that attaches them; here they are read by their own."
            )
        worlds = root.findall("worldbody")
        self.elements = {e.get("name", ""): e for world in worlds for e in world.iter("body")}
        text, places = numbered_text(root)
        self.groups = {
            group: [element for each in root.findall(group) for element in each]
            for group in ("tendon", "actuator", "equality")
        }
        self.groups["joint"] = [e for body in self.elements.values() for e in own_joints(body)]
        plugins, self.left_out = self.left_out, list[str]()
        with self._refusals(places), quiet_mujoco() as said:
            spec = load_mujoco().MjSpec.from_string(text, include=self.models or None)
            spec.compiler.usethread = False
            spec.compiler.LRopt.mode = int(load_mujoco().mjtLRMode.mjLRMODE_NONE)  # of muscles
            free = unused({joint.name for joint in spec.joints})
            for body in spec.bodies:  # MuJoCo may have made joints
                for i, joint in enumerate(body.joints):
                    joint.name = joint.name or free(f"{body.name}_joint_{i}")
            if not geoms:
                self._drop_idle_geoms(spec)
            self._take_meshes(spec)
            self.model: Any = spec.compile()
            if self._split_balls(spec):
                self.model = spec.compile()
        m = self.model
        m.opt.enableflags = 0  # with invdiscrete, efforts would be those of a time step
        tables = m.body_mass, m.body_ipos, m.body_inertia, m.body_iquat, m.body_pos, m.body_quat
        for at in range(m.nbody):
            if not all(np.isfinite(table[at]).all() for table in tables):
                what = f"{path}: body {m.body(at).name!r} has a value that is not a number."
                raise _wrong(what)
        words = list(dict.fromkeys(" ".join(each.split()) for each in said))
        whole = [w for w in words if not any(o != w and o.startswith(w) for o in words)]
        self.said = [f"MuJoCo: {each}" for each in whole]
        self.left_out += plugins

    def _prepare(self, root: Element, path: Path, prefix: str, chain: tuple[Path, ...]) -> float:
        """Remove elements without effect on dynamics; return the number of bodies."""
        drop(root, *_NO_DYNAMICS)
        how = {"angle": "degree", "eulerseq": "xyz"}
        for compiler in root.findall("compiler"):
            how |= {key: compiler.get(key, how[key]) for key in how}
        self._angles.add((how["angle"], how["eulerseq"]))
        self._take_plugins(root)
        folders = _take_folders(root)
        tendons = (e for group in root.findall("tendon") for e in group.iter("geom"))
        self.wrapped |= {name for e in tendons if (name := e.get("geom"))}
        _name_bodies(root, prefix)
        sizes = dict[str, float]()
        for element in [e for e in root.iter() if e.get("file") or e.tag == "hfield"]:
            if element.tag == "model":
                size = self._attach(element, path, chain)
                sizes[element.get("name", "")] = size
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
        return _bodies_of(root, path, sizes)

    def _take_plugins(self, root: Element) -> None:
        """Remove plugins, with notes on those in use; actuators with plugins become motors."""
        drop(root, "extension")
        for plugin in [plugin for group in root.findall("actuator") for plugin in group]:
            if plugin.tag == "plugin":
                plugin.tag = "general"
                plugin[:] = []
                for key in set(plugin.attrib) - _OF_ACTUATORS:
                    del plugin.attrib[key]
        for plugin in root.iter("plugin"):
            name = plugin.get("plugin") or plugin.get("instance")
            self.left_out.append(f"{place_of(plugin, self.path)}: the plugin {name} is ignored.")
        drop(root, "plugin")

    def _attach(self, element: Element, path: Path, chain: tuple[Path, ...]) -> float:
        """Register an attached model under a key; return its number of bodies."""
        file = path.parent / element.get("file", "")
        data = parse_xml(file)
        if data.tag != "mujoco":
            what = f"attaches {file}, whose root element is <{data.tag}> instead of <mujoco>"
            raise _wrong(f"{place_of(element, path)} {what}.")
        if file.resolve() in chain or len(chain) > _DEEPEST:
            raise _wrong(f"{path} cannot be read: {file} attaches itself.")
        Includes(file, {}).insert_elements(data)
        if len(self.models) >= _MOST_MODELS:
            raise _wrong(f"{path} attaches more than {_MOST_MODELS} models.")
        name = element.get("name") or data.get("model") or file.stem
        element.set("name", name)
        key = f"model_{len(self.models)}.xml"
        self.models[key] = b""
        size = self._prepare(data, file, f"{name}_", (*chain, file.resolve()))
        element.set("file", key)
        element.attrib.pop("content_type", None)
        self.models[key] = numbered_text(data)[0].encode()
        return size

    def _name_mesh(self, element: Element, path: Path, folders: Sequence[str]) -> None:
        """Replace a mesh's file by a key, and name the mesh as MuJoCo would."""
        place, strip = Path(element.get("file", "")), folders[1] == "true"
        place = Path(place.name) if strip else place
        if element.tag == "mesh":
            element.set("name", element.get("name") or place.stem)
        key = f"{len(self.meshes)}_{place.name}"
        self.meshes[key] = path.parent / folders[0] / place
        element.set("file", key)

    def _drop_idle_geoms(self, spec: Any) -> None:
        """Drop geoms that do not affect inertias or media, as their meshes may be missing."""
        always = load_mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        if any(geom.fluid_ellipsoid for geom in spec.geoms):
            return
        for body in spec.bodies:
            compiler = getattr(body, "compiler", spec.compiler)  # of the body's file, if known
            stated = body.explicitinertial and compiler.inertiafromgeom != always
            for geom in list(body.geoms) if stated or body.name == "world" else ():
                if not geom.name.endswith(tuple(self.wrapped)):  # attached ones have a prefix
                    spec.delete(geom)

    def _take_meshes(self, spec: Any) -> None:
        """Load the existing meshes, and note the consequences of missing ones."""
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
        if absent:
            self._take_out(spec, absent)

    @contextmanager
    def _refusals(self, places: Sequence[str]) -> Iterator[None]:
        """Convert MuJoCo's exceptions to a `ModelError` with its message, file and line."""
        try:
            yield
        except (ModelError, OSError, MemoryError):
            raise
        except Exception as error:  # ValueError, or MuJoCo's FatalError
            words = " ".join(str(error).split())[:400]
            lines = _LINE.findall(words)
            at = int(lines[-1]) - 1 if lines else -1
            place = places[at] if 0 <= at < len(places) and not self.models else ""
            for key, file in self.meshes.items():
                words = words.replace(key, str(file))
            words = _LINE.sub("", words).removeprefix("XML Error: ").removeprefix("Error: ")
            what = f"MuJoCo refuses {place or self.path}: {words.rstrip('.')}."
            raise _wrong(what) from error

    def _take_out(self, spec: Any, absent: dict[str, Path]) -> None:
        """Remove missing meshes and their geoms, with notes on inertias and shown shapes."""
        always = load_mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
        by_geoms, heavy, shown = spec.compiler.inertiafromgeom == always, list[str](), list[str]()
        low, high = spec.compiler.inertiagrouprange

        def weighs(geom: Any) -> bool:
            return bool(geom.mass != 0.0 and geom.density != 0.0 and low <= geom.group <= high)

        for body in spec.bodies:
            gone = [geom for geom in body.geoms if geom.meshname in absent]
            if any(geom.contype or geom.conaffinity for geom in gone):
                self.touching.append(body.name)
            weighing = any(map(weighs, gone))
            for geom in gone:
                spec.delete(geom)
            stated = body.explicitinertial or body.name == "world"
            if gone:
                follows = weighing and body.name != "world" and (by_geoms or not stated)
                (heavy if follows else shown).append(body.name)
            if gone and not stated and not any(map(weighs, body.geoms)):
                self.unknown.add(body.name)
                body.explicitinertial = True
                body.mass, body.inertia, body.ipos = 1.0, [1.0, 1.0, 1.0], [0.0, 0.0, 0.0]
        for mesh in list(spec.meshes):
            if mesh.name in absent:
                spec.delete(mesh)
        where = ", ".join(dict.fromkeys(str(file.parent) for file in absent.values()))
        gone_ones = f"meshes that are missing or not .obj, .stl or .msh (in {where})"
        if heavy:
            self.lost.append(f"The inertia of {', '.join(heavy)} is computed without {gone_ones}.")
        if shown and self.geoms:
            self.lost.append(f"Some shapes of {', '.join(shown)} are {gone_ones}.")

    def _split_balls(self, spec: Any) -> bool:
        """Replace ball joints of closed loops by three hinges; return whether there were any."""
        m, free = self.model, unused({joint.name for joint in spec.joints})
        balls, hinge = _balls(m), load_mujoco().mjtJoint.mjJNT_HINGE
        for joint, axis in balls.items():
            name, body = m.joint(joint).name, m.body(int(m.jnt_bodyid[joint])).name
            old = next(each for each in spec.joints if each.name == name)
            across = np.linalg.svd(axis[None])[2][1:]
            names = [free(f"{name}{suffix}") for suffix in _SUFFIXES]
            numbers = {key: np.array(getattr(old, key), float) for key in (*_OF_BALLS, "stiffness")}
            place, holder = np.array(old.pos), next(b for b in spec.bodies if b.name == body)
            spec.delete(old)
            on_joint = load_mujoco().mjtTrn.mjTRN_JOINT, load_mujoco().mjtTrn.mjTRN_JOINTINPARENT
            for motor in list(spec.actuators):
                if motor.target == name and motor.trntype in on_joint:
                    spec.delete(motor)
                    what = f"actuator {motor.name} of ball joint {name} of a closed loop"
                    # Motors of older versions have neither armature nor damping.
                    has = [np.any(getattr(motor, key, 0.0)) for key in ("armature", "damping")]
                    notes = self.left_out if any(has) else self.notes
                    notes.append(f"The {what} is ignored.")
            for hinge_name, direction in zip(names, (*across, axis), strict=True):
                added = holder.add_joint(name=hinge_name, type=hinge, axis=direction, pos=place)
                for key in _OF_BALLS:
                    setattr(added, key, numbers[key] if numbers[key].ndim else float(numbers[key]))
            self.notes.append(
                f"Ball joint {name} of a closed loop is read as the hinges {', '.join(names)}."
            )
            for key in (key for key, value in numbers.items() if value.any()):
                how = "is that of each hinge, which is approximate"
                how = how if key in _OF_BALLS else "is ignored"
                self.left_out.append(f"The {key} of ball joint {name} of a closed loop {how}.")
        return bool(balls)


def _wrong(words: str) -> ModelError:
    return ModelError(words, advice="Correct the file there.")


def _take_folders(root: Element) -> tuple[str, str]:
    """Remove settings of folders and simplifications; return the mesh folder and `strippath`."""
    settings = dict.fromkeys(_FOLDERS, "")
    for compiler in root.findall("compiler"):
        for key in _FOLDERS:
            settings[key] = compiler.attrib.pop(key, settings[key])
        # Simplifications for speed would change names and frames of bodies.
        for key in ("fusestatic", "alignfree", "discardvisual", "usethread"):
            compiler.attrib.pop(key, None)
        if not compiler.attrib:
            root.remove(compiler)
    return settings["meshdir"] or settings["assetdir"], settings["strippath"]


def _name_bodies(root: Element, prefix: str) -> None:
    """Name bodies and joints without names."""
    bodies = [body for body in root.iter("body") if body.get("name") or len(body)]
    taken = {body.get("name") for body in bodies}
    free = unused(taken)
    joints = unused({joint.get("name") for body in bodies for joint in body.iter("joint")})
    worlds = [body for world in root.findall("worldbody") for body in world.iter("body")]
    numbers = {id(body): k for k, body in enumerate(root.iter("body"))}
    for body in worlds:
        if not body.get("name"):
            body.set("name", free(f"{prefix}body_{numbers[id(body)]}"))
        for i, joint in enumerate(own_joints(body)):
            if not joint.get("name"):
                joint.set("name", joints(f"{body.get('name')}_joint_{i}"))


def own_frames(body: Element) -> Iterator[Element]:
    """Yield the frames and replicates of a body, including nested ones."""
    for child in body:
        if child.tag in ("frame", "replicate"):
            yield child
            yield from own_frames(child)


def own_joints(body: Element) -> Iterator[Element]:
    """Yield the joints of a body, including those in frames."""
    for child in body:
        if child.tag == "joint":
            yield child
        elif child.tag in ("frame", "replicate"):
            yield from own_joints(child)


def unused(taken: set[str | None]) -> Callable[[str], str]:
    """Return a function that makes a name unique and reserves it."""

    def name(wanted: str) -> str:
        while wanted in taken:
            wanted += "_"
        taken.add(wanted)
        return wanted

    return name


def _bodies_of(root: Element, path: Path, sizes: Mapping[str, float]) -> float:
    """Return the number of bodies after replication and attachment; raise if it is too large.

    `sizes` has the numbers of bodies of models that may be attached.
    """
    pending, total = [(root, 1.0)], 0.0  # elements and their numbers of copies
    while pending:
        element, copies = pending.pop()
        for word in element.get("count", "").split():
            copies *= abs(float(word)) if _COUNT.fullmatch(word) else 1.0
        if element.tag in ("body", "attach"):
            total += copies * sizes.get(element.get("model", ""), 1.0)
        what = f"<{element.tag}> makes {copies:.0f} copies of its content"
        if total > _MOST_MADE >= copies:
            what = f"with <{element.tag}> there are {total:.0f} bodies"
        if max(copies, total) > _MOST_MADE:
            raise wrong_at(element, path, f"{what}; geodrake reads up to {_MOST_MADE}.")
        pending += [(child, copies) for child in element]
    return total


def _balls(m: Any) -> dict[int, Array]:
    """Return index of a ball joint in a closed loop -> axis to the closing point, in its body."""
    mujoco = load_mujoco()
    data, axes = mujoco.MjData(m), dict[int, Array]()
    mujoco.mj_kinematics(m, data)
    connect, weld = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD
    off = mujoco.mjtDisableBit.mjDSBL_EQUALITY, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    for at in range(0 if m.opt.disableflags & sum(map(int, off)) else m.neq):
        if not m.eq_active0[at] or int(m.eq_type[at]) not in (connect, weld):
            continue
        ends = closed_frames(m, at)
        first, X = ends[0]
        end = data.xpos[first] + data.xmat[first].reshape(3, 3) @ X.translation()
        chains = [set(chain_to_world(m, body)) for body, _ in ends]
        for body in chains[0] ^ chains[1]:
            joint = int(m.body_jntadr[body])
            if m.body_jntnum[body] == 1 and int(m.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_BALL:
                arm = data.xmat[body].reshape(3, 3).T @ (end - data.xanchor[joint])
                size = float(np.linalg.norm(arm))
                axes[joint] = arm / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    return axes


def closed_frames(m: Any, at: int) -> list[tuple[int, RigidTransform]]:
    """Return the two bodies of a <connect> or <weld>, and the coincident frames in them."""
    mujoco, data = load_mujoco(), m.eq_data[at]
    ends = [int(m.eq_obj1id[at]), int(m.eq_obj2id[at])]
    if int(m.eq_objtype[at]) == mujoco.mjtObj.mjOBJ_SITE:
        poses = [pose_of(m.site_pos[each], m.site_quat[each]) for each in ends]
        ends = [int(m.site_bodyid[each]) for each in ends]
    elif int(m.eq_type[at]) == mujoco.mjtEq.mjEQ_WELD:  # the second point comes first
        poses = [pose_of(data[3:6], data[6:10]), RigidTransform(data[:3])]
    else:
        poses = [RigidTransform(data[:3]), RigidTransform(data[3:6])]
    return list(zip(ends, poses, strict=True))


def pose_of(position: Array, quaternion: Array) -> RigidTransform:
    """Return the pose with a position (3,), m, and a quaternion w, x, y, z (4,)."""
    turn = RotationMatrix(Quaternion(np.array(quaternion, float)))
    return RigidTransform(turn, np.array(position))


def chain_to_world(m: Any, body: int) -> Iterator[int]:
    """Yield a body of a compiled model and its ancestors, without the world."""
    while body:
        yield body
        body = int(m.body_parentid[body])
