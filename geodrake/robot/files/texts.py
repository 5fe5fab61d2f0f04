"""Robot descriptions as texts that Drake accepts: common parts of formats, URDF and SDF.

Transmissions in URDFs are used only on request, because most logs of such robots are at the joints
nevertheless. They are those of ros_control (reductions n_a of actuators and n_j of joints, offsets
θ₀):

    Simple:        θ = q / (n_a n_j) + θ₀
    Differential:  θ₁ = (q₁/n_a1 + q₂/n_a2) / (2 n_j1) + θ₀₁,  θ₂ the same with a difference
    FourBar:       θ₁ = q₁ / (n_j1 n_a1) + θ₀₁,  θ₂ = (q₂/n_a2 − q₁/(n_j1 n_a1)) / n_j2 + θ₀₂
"""

from __future__ import annotations

import abc
import re
from collections.abc import Collection, Container, Iterator, Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import ClassVar
from xml.etree.ElementTree import Element

import numpy as np
from pydrake.math import RigidTransform

from geodrake.errors import ModelError
from geodrake.inertia import Array, is_physical
from geodrake.robot.files.checks import (
    ADDED_MASS,
    SDF_NUMBERS,
    TENSOR,
    URDF_NUMBERS,
    Numeric,
    added_mass_matrix,
    check_limits,
    check_link,
    check_numbers,
    drop,
    inertial_parameters_of,
    is_off,
    number,
    numbers,
    rotation,
    symmetric,
)
from geodrake.robot.files.includes import PACKAGE_ADVICE, Includes
from geodrake.robot.files.model_edits import (
    DRAKES_SPRINGS,
    merges,
    of_drake,
    put_inertia,
    sdf_joints,
    sdf_models,
    sdf_pose,
)
from geodrake.robot.files.xml_text import LocatedElement, parse_xml, place_of, wrong_at
from geodrake.robot.joints import Tie
from geodrake.robot.stated import (
    CLOSING,
    CUT,
    WORLD,
    WORLD_LINK,
    Closure,
    CutJoint,
    FileTerms,
    Gearbox,
    Spring,
    StatedLength,
    StatedTendon,
    TendonPart,
)
from geodrake.robot.transmission.schema import Coupled, Gear

URDF_UNREAD: Mapping[str, Collection[str]] = {
    "gazebo": (
        *("dampingFactor", "velocity_decay", "enable_wind", "kinematic", "static"),
        *("link", "model", "axis", "axis2", "inertial", "fluid_added_mass"),
    ),
    "actuator": ("motorInertia", "rotorInertia"),
    "contact": ("inertia_scaling",),
    "joint": ("joint_properties",),
}
SDF_UNREAD: Mapping[str, Collection[str]] = {
    "link": ("velocity_decay", "enable_wind", "kinematic"),
    "model": ("enable_wind",),
}
"""Tag -> tags of descendants that affect efforts unless they are zero."""

_CHANGED = {
    "dynamics": ("friction", "spring_stiffness"),
    "inertial": ("fluid_added_mass",),
}
"""The same in changes of an included model, which Drake applies."""

URDF_ATTRIBUTES: Mapping[str, Collection[str]] = {
    "origin": ("quat_xyzw",),
    "option": ("gravity", "density", "viscosity"),
    "compiler": ("settotalmass", "boundmass", "boundinertia"),
}
"""Tag of a URDF, or of MuJoCo's elements in one -> attributes that affect efforts."""

_FOREIGN = (
    *("physics", "scene", "light", "atmosphere", "magnetic_field", "wind", "audio", "gui"),
    *("spherical_coordinates", "state", "actor", "population", "road", "projector"),
    *("gripper", "battery", "particle_emitter", "initial_position"),
)
"""Tags of SDF without effect on dynamics; Drake refuses those unknown to it."""

DYNAMICS_READ = frozenset({"damping", "friction"})
"""Attributes of <dynamics> in a URDF that are read; others are specific to a simulator."""

_FORCES = re.compile(
    r"buoyan|lift.?drag|hydrodyn|wind(?!ow)|spring|apply.?(link.?)?(force|wrench)|thruster|"
    r"motor.?model|propell|uuv|underwater",
    re.I,
)


def unread(root: Element, table: Mapping[str, Collection[str]], path: Path) -> Iterator[str]:
    """Yield a sentence on each element that affects efforts and is not read.

    Elements with the same attributes share a sentence.
    """
    alike = dict[str, list[Element]]()
    for element in root.iter():
        for child in element if element.tag in table else ():
            yield from _of(child, table[element.tag], path)
        where = place_of(element, path)
        if element.tag == "plugin":
            file, name = element.get("filename", "").strip(), element.get("name", "").strip()
            name = name if "::" in name or not file else file  # other names are arbitrary
            if _FORCES.search(f"{file} {name}"):
                yield f"{where}: the plugin {name} is ignored."
        ignored = set(URDF_ATTRIBUTES.get(element.tag, ()))
        if element.tag == "dynamics":
            ignored = set(element.attrib) - DYNAMICS_READ
        values = {key: element.get(key, "").strip() for key in sorted(ignored)}
        stated = [f"{key}={value[:50]}" for key, value in values.items() if not is_off(value)]
        if stated and root.tag == "robot":
            alike.setdefault(f"{', '.join(stated)} of <{element.tag}>", []).append(element)
    for words, (first, *more) in alike.items():
        others = f", and of {len(more)} more like it," if more else ""
        verb = "are" if more or ", " in words else "is"
        yield f"{place_of(first, path)}: {words}{others} {verb} ignored."


def _of(element: Element, tags: Collection[str], path: Path) -> Iterator[str]:
    if element.tag not in tags:
        for child in element if element.tag == "dynamics" else ():
            yield from _of(child, tags, path)
        return
    words = [*element.attrib.values(), *(part.text or "" for part in element.iter())]
    stated = [word.strip() for word in words if not is_off(word)]
    if stated:
        value = " ".join(" ".join(stated).split())[:80]
        yield f"{place_of(element, path)}: <{element.tag}> {value} is ignored."


_ROUNDED = 1e-6  # relative size of eigenvalues that counts as rounding in a file
_TRUE = ("true", "1")
_BALL = "drake:ball_constraint"
_JOINTS = ("joint", "drake:joint")
_LOOPS = ("linear_bushing_rpy", "distance_constraint", "weld_constraint")


class ModelText(abc.ABC):
    """A robot description as text that Drake accepts.

    Attributes:
        numeric: Requirements on the numbers of the format.
        terms: Terms of the file that were removed from the text.
        inside: Elements that include other files, and the texts of those.
        shapeless: Scoped names of links of a URDF without geometry.
        folders: Package -> folder, which takes precedence over search.
        chain: Files that led to this one by includes, itself the last; empty for the first one.
    """

    kind: ClassVar[str]
    numeric: ClassVar[Numeric]

    def __init__(
        self,
        root: Element,
        path: Path,
        scope: str | None,
        folders: Mapping[str, Path],
        chain: tuple[Path, ...] = (),
    ) -> None:
        self.root, self.path, self.scope, self.folders = root, path, scope, folders
        self.terms, self.chain = FileTerms(), chain
        self.inside = list[tuple[Element, ModelText]]()
        self.shapeless = set[str]()
        self._links: dict[str, Element] = {}
        # Scoped names of fixed joints, and of joints of several degrees of freedom.
        self._still, self._several = set[str](), set[str]()
        self._read()
        check_numbers(self.root, self.numeric, path)
        check_limits(self.root, path)
        drop_friction(self.root)
        for name, link in self._links.items():
            phi = self._stated(link)
            check_link(link, phi, path)
            if phi is not None and not is_physical(phi):
                self.terms.set_aside[name] = phi
                self.set_inertia(name, None)

    @property
    def links(self) -> tuple[str, ...]:
        """Return the scoped names of the links."""
        return tuple(self._links)

    def every(self) -> Iterator[ModelText]:
        """Yield the text and all included ones."""
        yield self
        for _, text in self.inside:
            yield from text.every()

    def link_includes(self, root: Element, files: Mapping[ModelText, Path]) -> None:
        """Replace the file names of includes below a root of the text's file."""
        there = {e.start: e for e in root.iter("include") if isinstance(e, LocatedElement)}
        for include, text in self.inside:
            if isinstance(include, LocatedElement):
                there[include.start].findall("uri")[0].text = files[text].as_uri()

    @property
    def heavy(self) -> set[str]:
        """Return the scoped names of links with an inertia."""
        stated = {name for name, link in self._links.items() if link.find("inertial") is not None}
        return stated | {name for name, phi in self.terms.set_aside.items() if phi[0]}

    def included(self, links: Container[str]) -> dict[str, Path]:
        """Return link -> included file, for those links that are in one."""
        every = {name: link for text in self.every() for name, link in text._links.items()}
        found = {name.rpartition("::")[2]: e for name, e in every.items() if name in links}
        elements = {n: e for n, e in found.items() if isinstance(e, LocatedElement)}
        return {n: Path(e.path) for n, e in elements.items() if Path(e.path) != self.path}

    def stated_inertia(self, link: str) -> Array | None:
        """Return the inertial parameters (10,) of a link in the file, physical or not, or None."""
        if link in self.terms.set_aside or link not in self._links:
            return self.terms.set_aside.get(link)
        return self._stated(self._links[link])

    def _stated(self, link: Element) -> Array | None:
        inertial = link.find("inertial")
        if inertial is None or inertial.get("auto") in _TRUE:  # the latter in SDF
            return None
        return self._inertia(inertial)

    def motors(self) -> tuple[Gear | Coupled, ...]:
        """Return the transmissions of motors in the file itself."""
        return ()

    def set_inertia(self, link: str, phi: Array | None) -> bool:
        """Set the inertial parameters (10,) of a link, or none; return whether the text has it."""
        if link not in self._links:
            return False
        element = self._links[link]
        for inertial in element.findall("inertial"):  # not those of child bodies in MJCF
            element.remove(inertial)
        if phi is not None:
            put_inertia(self.root, element, phi)
        elif self.kind == "sdf":  # a link without an inertia would have 1 kg
            put_inertia(self.root, element, np.zeros(10))
        return True

    def _take_balls(self, scope: str, model: Element) -> None:
        """Move Drake's ball constraints, which close loops, from a model to the closures."""
        for ball in model.findall(_BALL):
            model.remove(ball)
            first, second = (of_drake(ball, key) for key in ("body_A", "body_B"))
            if not first or not second:
                raise wrong_at(ball, self.path, f"<{_BALL}> does not name its two bodies.")
            places = (numbers(of_drake(ball, key), 3) for key in ("p_AP", "p_BQ"))
            at, other = map(RigidTransform, places)
            bodies = f"{scope}::{first}", f"{scope}::{second}"
            name = f"<{_BALL}> of {first} and {second}"
            self.terms.closures.append(Closure(name, bodies, (at, other), False))

    def _take_drakes_springs(self, scope: str, model: Element) -> None:
        """Move Drake's springs, of joints or between two points, from a model to the terms."""
        joints = {e.get("name", ""): e.get("type") for e in model if e.tag in _JOINTS}
        known = {name for text in self.every() for name in text.links}
        for spring in [each for each in model if each.tag in DRAKES_SPRINGS]:
            model.remove(spring)

            def value(key: str, count: int = 1, spring: Element = spring) -> Array:
                values = numbers(of_drake(spring, key) or "none", count)
                if not np.isfinite(values).all():
                    raise wrong_at(spring, self.path, f"<{spring.tag}> has no numbers as {key}.")
                return values

            if (rest := DRAKES_SPRINGS[spring.tag]) is None:
                ends = [of_drake(spring, key) for key in ("body_A", "body_B")]
                links = [f"{scope}::{end}" for end in ends]
                if not {*links} <= known or links[0] == links[1]:
                    what = f"<{spring.tag}> does not name two links, but {' and '.join(ends)}."
                    raise wrong_at(spring, self.path, what)
                points = value("p_AP", 3), value("p_BQ", 3)
                keys = ("stiffness", "free_length", "damping")
                stiffness, length, damping = (float(value(key)[0]) for key in keys)
                pair = links[0], links[1]
                part = TendonPart(pair, points)
                self.terms.tendons.append(StatedTendon((part,), stiffness, length, damping))
                continue
            name = of_drake(spring, "joint")
            if joints.get(name) not in CUT:
                what = f"<{spring.tag}> names {name!r}, which is not a joint of a suitable type."
                raise wrong_at(spring, self.path, what)
            law = Spring.linear(float(value("stiffness")[0]), float(value(rest)[0]))
            self.terms.lengths.append(StatedLength({f"{scope}::{name}": 1.0}, law))

    def _drop_loops(self) -> None:
        tags = {f"{prefix}{tag}" for tag in _LOOPS for prefix in ("drake:", "")}
        for element in (each for each in self.root.iter() if each.tag in tags):
            what = f"{place_of(element, self.path)}: <{element.tag}> is ignored"
            self.terms.left_out.append(f"{what}: the robot is read as an open tree.")
        drop(self.root, *tags)

    def _take_axes(self, names: Sequence[str], joint: Element, *, damping: bool) -> None:
        """Move friction, springs and optionally damping of an SDF joint's axes to the terms."""
        axes = [axis for tag in ("axis", "axis2") for axis in joint.findall(tag)]
        for name, axis in zip(names, axes, strict=False):
            damps = (number(axis, "dynamics/damping") if damping else 0.0, 0.0, 0.0)
            friction = number(axis, "dynamics/friction")
            self.terms.lengths.append(StatedLength({name: 1.0}, damping=damps, friction=friction))
            for dynamics in axis.findall("dynamics"):
                self._take_spring(name, dynamics, *_SPRING)
                drop(dynamics, *_SPRING, *(["damping"] if damping else []))

    def _take_spring(self, joint: str, parent: Element, *tags: str) -> None:
        """Move the spring of a joint to the terms; `tags` are those of stiffness and rest."""
        if joint in self._several:
            self.terms.left_out += unread(parent, {parent.tag: tags[:1]}, self.path)
            return
        stated = [parent.find(tag) for tag in tags]
        texts = ["0" if each is None else each.text or "0" for each in stated]
        values = [float(numbers(text, 1)[0]) for text in texts]
        for element, text, value in zip(stated, texts, values, strict=True):
            if element is not None and not np.isfinite(value):
                what = f"<{element.tag}> has {text.strip()[:50]!r} instead of a number."
                raise wrong_at(element, self.path, what)
        self.terms.lengths.append(StatedLength({joint: 1.0}, Spring.linear(*values)))

    def _take_gearbox(self, scope: str, joint: Element, model_frame: str = "__model__") -> None:
        """Read an SDF gearbox, by which two links turn at a constant ratio about a third one."""
        name = f"{place_of(joint, self.path)}: <joint> {joint.get('name')} of the type gearbox"
        ratio = 1.0 if joint.find("gearbox_ratio") is None else number(joint, "gearbox_ratio")
        tags = "gearbox_reference_body", "parent", "child"
        ends = [joint.findtext(tag, "").strip() for tag in tags]
        known = {each for text in self.every() for each in text.links}
        names = [f"{scope}::{end}" for end in ends]
        reference, *links = (
            WORLD_LINK if end == WORLD and name not in known else name
            for end, name in zip(ends, names, strict=True)
        )
        pose, axes = joint.find("pose"), list[tuple[str, Array]]()
        for tag in ("axis", "axis2"):
            axis, frame, turn = joint.find(f"{tag}/xyz"), ends[-1], np.eye(3)
            if axis is not None and axis.get("expressed_in"):
                frame = axis.get("expressed_in", "")
            elif not is_off(joint.findtext(f"{tag}/use_parent_model_frame", "")):
                frame = model_frame
            elif pose is not None:
                frame, turn = pose.get("relative_to") or frame, rotation(sdf_pose(pose)[1])
            xyz = numbers((axis is not None and axis.text) or "0 0 1", 3)
            axes.append((f"{scope}::{frame}", turn @ xyz))
        is_finite = all(np.isfinite(axis).all() and axis.any() for _, axis in axes)
        missing = [
            f"<{tag}> {end!r} is no link"
            for tag, end, link in zip(tags, ends, (reference, *links), strict=True)
            if link not in known | {WORLD_LINK}
        ]
        if missing or not is_finite or not np.isfinite(ratio) or not ratio:
            reason = f"its ratio is {ratio:g}" if is_finite else "an axis has no direction"
            self.terms.left_out.append(f"{name} is ignored, as {[*missing, reason][0]}.")
            return
        box = Gearbox(name, reference, (links[0], links[1]), (axes[0], axes[1]), ratio)
        self.terms.gearboxes.append(box)

    def _take_added_mass(self, name: str, link: Element) -> None:
        """Move the inertia of the fluid around a link of an SDF to the terms."""
        for k, element in enumerate(link.findall("inertial/fluid_added_mass")):
            drop(link, element.tag)
            if k:  # sdformat reads the first one
                what = f"{place_of(element, self.path)}: another <{element.tag}> of {name}"
                self.terms.left_out.append(f"{what} is ignored.")
                continue
            stated = {each.tag: each.text or "" for each in element if isinstance(each.tag, str)}
            unknown = [f"<{tag}>" for tag in stated if tag not in ADDED_MASS]
            if unknown:
                what = f"{place_of(element, self.path)}: {', '.join(unknown)} of <{element.tag}>"
                self.terms.left_out.append(f"{what} ignored; its entries are xx, xy, … rr.")
            entries = [float(numbers(stated.get(tag, ""), 1)[0]) for tag in ADDED_MASS]
            if not np.isfinite(entries).all():
                tag = ADDED_MASS[np.isfinite(entries).argmin()]
                what = f"<{tag}> has {stated[tag].strip()[:50]!r} instead of a number."
                raise wrong_at(element, self.path, what)
            matrix = added_mass_matrix(entries)
            least, *_, most = np.linalg.eigvalsh(matrix)
            if least < -_ROUNDED * most:
                what = f"{place_of(element, self.path)}: <{element.tag}> is ignored"
                reason = f"it has the negative eigenvalue {least:g}"
                self.terms.left_out.append(f"{what}, as {reason}.")
            elif most:
                self.terms.added_mass[name] = matrix

    def _take_mimic(self, name: str, scope: str, joint: Element) -> None:
        """Move the mimic of a joint, by scoped name, to the followers."""
        for mimic in [e for e in joint.iter() if e.tag in ("mimic", "drake:mimic")]:
            stated = {each.tag: each.text or "" for each in mimic} | mimic.attrib
            self._follow(name, f"{scope}::{mimic.get('joint')}", stated)
        drop(joint, "mimic", "drake:mimic")

    def _take_more_mimics(
        self, scope: str, plugins: Sequence[Element], joints: Sequence[Element] = ()
    ) -> None:
        """Read further leaders of joints from Gazebo's plugins and ros2_control."""
        already = set(self.terms.followers)
        mimics = [{each.tag: each.text or "" for each in plugin} for plugin in plugins]
        for joint in joints:
            given = {e.get("name", ""): e.text or "" for e in joint.findall("param")}
            follower = joint.get("name", "") if given.get("mimic") else ""
            mimics.append({**given, "joint": given.get("mimic", ""), "mimicJoint": follower})
        for stated in mimics:
            leader, follower = (stated.get(key, "").strip() for key in ("joint", "mimicJoint"))
            if follower and f"{scope}::{follower}" not in already | self.terms.fixed.keys():
                self._follow(f"{scope}::{follower}", f"{scope}::{leader}", stated)

    def _follow(self, name: str, leader: str, stated: Mapping[str, str]) -> None:
        """Let a joint follow another one; it is fixed if the leader is."""
        if name in self._still:
            return
        ratio, offset, start = (
            float(numbers(stated.get(key) or default, 1)[0])
            for key, default in (("multiplier", "1"), ("offset", "0"), ("reference", "0"))
        )
        ratio = 0.0 if leader in self._still else ratio
        if ratio:
            self.terms.followers[name] = Tie(leader, (offset - ratio * start, ratio))
        else:
            self.terms.fixed[name] = offset

    @abc.abstractmethod
    def _read(self) -> None:
        """Read the file into the attributes, and remove elements that Drake must not read."""

    @abc.abstractmethod
    def _inertia(self, inertial: Element) -> Array:
        """Return the inertial parameters (10,) of an <inertial>."""


def drop_friction(root: Element) -> None:
    """Remove dry friction from a URDF: Drake warns of it, and then rejects included files."""
    for dynamics in root.iter("dynamics"):
        dynamics.attrib.pop("friction", None)


_SPRING = ("spring_stiffness", "spring_reference")


class SdfText(ModelText):
    """An SDF model or world."""

    kind = "sdf"
    numeric = SDF_NUMBERS

    def _read(self) -> None:
        terms = self.terms
        if not self.root.get("version"):
            raise wrong_at(self.root, self.path, "<sdf> has no version.")
        nowhere = self._take_includes()
        terms.left_out += unread(self.root, SDF_UNREAD, self.path)
        self._take_gravity()
        self._fix_static()
        for joint in self.root.iter("joint"):
            if joint.get("type") == "revolute2":  # moves like a universal joint
                joint.set("type", "universal")
        models = list(sdf_models(self.root, first=self.scope or ""))
        plugins = {name: model.findall("plugin") for name, model in models}
        for link in self.root.iter("link"):
            inertial = link.find("inertial")
            if inertial is None or inertial.get("auto") not in _TRUE:
                drop(link, "collision")
        drop(self.root, "visual", "sensor", "plugin", "drake:collision_filter_group", *_FOREIGN)
        for name, model in models:
            self._take_balls(name, model)
            self._links |= {f"{name}::{e.get('name')}": e for e in model.findall("link")}
        for name, link in self._links.items():
            self._take_added_mass(name, link)
        for name, model in models:
            self._take_drakes_springs(name, model)
            for joint in model.findall("joint[@type='gearbox']"):
                model.remove(joint)
                self._take_gearbox(name, joint)
        self._drop_loops()
        joints = list(sdf_joints(self.root, first=self.scope or ""))
        names = {stated: name for stated, name, _ in joints}
        self._still |= {stated for stated, _, joint in joints if joint.get("type") == "fixed"}
        for stated, name, joint in joints:
            self._take_mimic(stated, stated.rpartition("::")[0], joint)
            twice = joint.get("type") == "universal"
            axes = [f"{name}[{k}]" for k in range(2)] if twice else [name]
            self._several |= set(axes) if twice or joint.get("type") == "ball" else set()
            self._take_axes(axes, joint, damping=twice)
        for name, elements in plugins.items():
            self._take_more_mimics(name, elements)
        terms.fixed = {names.get(joint, joint): at for joint, at in terms.fixed.items()}
        terms.followers = {
            names.get(axes, axes): Tie(names.get(tie.leader, tie.leader), tie.coefficients)
            for axes, tie in terms.followers.items()
        }
        if nowhere and not any(text.links for text in self.every()):
            raise ModelError(
                f"{self.path} has no model that can be found: {nowhere[0]}", advice=PACKAGE_ADVICE
            )
        of_links = {name: link.findtext("gravity") for name, link in self._links.items()}
        off = [name for name, text in of_links.items() if text is not None and is_off(text)]
        terms.carried = dict.fromkeys(off, 1.0)

    def _take_includes(self) -> list[str]:
        """Read included files; return sentences on missing ones."""
        includes = Includes(self.path, self.folders, self.chain)
        includes.drop_absent(self.root)
        self.terms.notes += includes.absent
        self.terms.left_out += includes.missing
        places = [("", world) for world in self.root.iter("world")]
        places += sdf_models(self.root, first=self.scope or "")
        for scope, include in [(scope, e) for scope, at in places for e in at.findall("include")]:
            file, chain = includes.model_of(include)
            root = parse_xml(file)
            urdf, model = root.tag == "robot", root.find("model")
            model = root if urdf else model
            if model is None:
                what = f"<include> has the file {file}, which has no model."
                raise wrong_at(include, self.path, what)
            name = include.findtext("name", model.get("name", "")).strip()
            inner = scope if merges(include) else "::".join(filter(None, (scope, name)))
            text: ModelText = (UrdfText if urdf else SdfText)(
                root, file, inner, self.folders, chain
            )
            text.terms.floating = {}
            self.inside.append((include, text))
            self._still |= text._still
            self._several |= text._several
            if isinstance(include, LocatedElement):
                include.model = model
            for change in include.iter("experimental:params"):  # applied by Drake
                self.terms.left_out += unread(change, _CHANGED, self.path)
                drop(change, "collision", "fluid_added_mass")
        return [*includes.missing, *includes.absent]

    def _fix_static(self) -> None:
        """Fix the joints of static models."""
        for model in self.root.iter("model"):
            for joint in () if is_off(model.findtext("static", "")) else model.iter("joint"):
                joint.set("type", "fixed")
                drop(joint, "axis", "axis2")
                self.terms.static.add(model.get("name", ""))

    def _take_gravity(self) -> None:
        places = ("world/physics/gravity", "world/gravity")  # older versions first
        for stated in [each for place in places for each in self.root.findall(place)]:
            words = stated.text or ""
            vector = numbers(words, 3)
            if not np.isfinite(vector).all():
                what = f"<gravity> has {words[:50]!r} instead of three numbers."
                raise wrong_at(stated, self.path, what)
            if words.strip():
                self.terms.gravity = vector
        for inner in (each for _, text in self.inside for each in text.every()):
            if inner.terms.gravity is None:  # they share the world
                inner.terms.gravity = self.terms.gravity

    def _inertia(self, inertial: Element) -> Array:
        pose = inertial.find("pose")
        com, turn = (np.zeros(3), np.zeros(3)) if pose is None else sdf_pose(pose)
        inertia = symmetric(
            inertial.findtext(f"inertia/{key}", "1" if key in ("ixx", "iyy", "izz") else "0")
            for key in TENSOR
        )
        mass = numbers(inertial.findtext("mass", "1"), 1)[0]
        return inertial_parameters_of(mass, com, rotation(turn), inertia)


_SEVERAL = ("planar", "floating", "ball", "universal")
_KINDS = ("SimpleTransmission", "DifferentialTransmission", "FourBarLinkageTransmission")
_REDUCTIONS = ("mechanicalReduction", "mechanical_reduction")


class UrdfText(ModelText):
    """A URDF file."""

    kind = "urdf"
    numeric = URDF_NUMBERS

    def _read(self) -> None:
        root, terms = self.root, self.terms
        terms.left_out += unread(root, URDF_UNREAD, self.path)
        for inertia in root.iterfind("link/inertial/inertia"):
            if lacks := [key for key in TENSOR if key not in inertia.attrib]:
                what = f"<inertia> lacks {', '.join(lacks)}, which count as 0."
                terms.notes.append(f"{place_of(inertia, self.path)}: {what}")
        gazebo, shapes = _joined(root.findall("gazebo")), ("visual", "collision")
        links = [link for link in root.findall("link") if not any(map(link.findall, shapes))]
        drop(root, "visual", "collision", "gazebo", "material", "drake:collision_filter_group")
        self._transmissions = [deepcopy(e) for e in root.iter("transmission")]
        for transmission in root.findall("transmission"):
            # Only Drake's own rotor inertia and gear ratio matter; joints state their efforts.
            if not any(element.tag.startswith("drake:") for element in transmission.iter()):
                root.remove(transmission)
            for kind in transmission.findall("type"):
                if not (kind.text or "").strip():  # would abort Drake, and the process with it
                    transmission.remove(kind)
        self.scope = scope = self.scope or root.get("name") or self.path.stem
        self._take_balls(scope, root)
        self._drop_loops()
        root.set("name", root.get("name") or scope)
        self.shapeless = {f"{scope}::{link.get('name')}" for link in links}
        self._links = {f"{scope}::{e.get('name')}": e for e in root.findall("link")}
        joints = [joint for tag in _JOINTS for joint in root.findall(tag)]
        self._holding = {_end(joint, "child"): joint for joint in reversed(joints)}
        self._still = {f"{scope}::{e.get('name')}" for e in joints if e.get("type") == "fixed"}
        self._several = {f"{scope}::{e.get('name')}" for e in joints if e.get("type") in _SEVERAL}
        self._take_floating(scope, joints)
        joint_names = {e.get("name") for tag in ("joint", "drake:joint") for e in root.iter(tag)}
        self._take_gazebo(scope, [e for e in gazebo if e.get("reference")], joint_names)
        self._take_drakes_springs(scope, root)
        self._take_pose(scope, gazebo)
        self._take_gazebo_joints(scope, gazebo)
        self._take_loop_joints(scope)
        for joint in joints:
            name = f"{scope}::{joint.get('name')}"
            self._take_mimic(name, scope, joint)
            friction = number(joint, "dynamics", "friction")
            terms.lengths.append(StatedLength({name: 1.0}, friction=friction))
            terms.effort[name] = number(joint, "limit", "effort")
            limit = {} if (stated := joint.find("limit")) is None else stated.attrib
            if terms.effort[name] == 0.0:
                limit.pop("effort", None)  # with 0, Drake would ignore the rotor, too
            for key in [key for key, word in limit.items() if word.strip(" +-") == "inf"]:
                del limit[key]  # Drake's default, but Drake cannot read the word
            dynamics = joint.find("dynamics")
            if dynamics is not None and joint.get("type") == "planar":
                words = dynamics.get("damping", "").split()
                dynamics.set("damping", " ".join(words * (3 if len(words) == 1 else 1)))
        plugins = [plugin for element in gazebo for plugin in element.findall("plugin")]
        self._take_more_mimics(scope, plugins, root.findall("ros2_control/joint"))

    def _chain(self, link: str) -> list[Element]:
        """Return the joints from the root to a link."""
        chain, joint = list[Element](), self._holding.get(link)
        while joint is not None and joint not in chain:
            chain.insert(0, joint)
            joint = self._holding.get(_end(joint, "parent"))
        return chain

    def _pose(self, link: str) -> Array:
        """Return the pose (4, 4) of a link in its root, with all joints at zero."""
        X = np.eye(4)
        for joint in self._chain(link):
            X = X @ _matrix(*_origin(joint))
        return X

    def _take_floating(self, scope: str, joints: list[Element]) -> None:
        """Read floating joints, which Drake ignores; raise if a parent moves."""
        for joint in (each for each in joints if each.get("type") == "floating"):
            inner = self._chain(_end(joint, "parent"))
            if any(each.get("type") not in ("fixed", "floating") for each in inner):
                what = f"joint {joint.get('name')!r} is floating, but its parent moves."
                raise wrong_at(joint, self.path, what)
            link = _end(joint, "child")
            if np.isfinite(X := self._pose(link)).all():
                self.terms.floating[f"{scope}::{link}"] = RigidTransform(X)

    def _take_pose(self, scope: str, elements: list[Element]) -> None:
        """Read Gazebo's pose of the model, which applies to links without a parent joint."""
        of_model = (element for element in elements if not element.get("reference"))
        pose = next((each for e in of_model for each in e.findall("pose")), None)
        if pose is None or is_off(pose.text or ""):
            return
        X, words = _matrix(*sdf_pose(pose)), " ".join((pose.text or "").split())[:80]
        where = place_of(pose, self.path)
        roots = [e.get("name", "") for e in self.root.findall("link")]
        roots = [link for link in roots if link not in self._holding]
        held = "world" in roots or self.chain  # an including file sets the pose
        if held or pose.get("relative_to") or not np.isfinite(X).all():
            if not np.array_equal(X[:3, 2], [0.0, 0.0, 1.0]):  # otherwise efforts are the same
                self.terms.left_out.append(f"{where}: <pose> {words} of <gazebo> is ignored.")
            return
        placed = {f"{scope}::{link}": RigidTransform() for link in roots} | self.terms.floating
        self.terms.floating |= {link: RigidTransform(X) @ own for link, own in placed.items()}
        self.terms.notes.append(f"{where}: the robot is placed by <pose> {words} of <gazebo>.")

    def _take_gazebo_joints(self, scope: str, elements: list[Element]) -> None:
        """Read SDF joints in <gazebo>, which close loops or fix the base."""
        for joint in [joint for element in elements for joint in element.findall("joint")]:
            name, kind = joint.get("name", ""), joint.get("type", "")
            parent, child = (joint.findtext(tag, "").strip() for tag in ("parent", "child"))
            if (kind, parent) == ("fixed", "world") and f"{scope}::{parent}" not in self._links:
                continue
            if kind == "gearbox":
                first = self._chain(parent)[:1]
                self._take_gearbox(scope, joint, _end(first[0], "parent") if first else parent)
                continue
            stated, axis = joint.find("pose"), joint.find("axis")
            place = (np.zeros(3), np.zeros(3)) if stated is None else sdf_pose(stated)
            X_CJ, X_RC = _matrix(*place), self._pose(child)
            turn = numbers(joint.findtext("axis/xyz", "0 0 1"), 3)
            if axis is not None and not is_off(axis.findtext("use_parent_model_frame", "")):
                turn = (X_RC @ X_CJ)[:3, :3].T @ turn
            X_PJ = np.asarray(np.linalg.solve(self._pose(parent), X_RC @ X_CJ), float)
            cut = CutJoint.of(
                f"{scope}::{name}", turn, kind, number(joint, "axis/limit/effort") > 0
            )
            is_relative = stated is not None and stated.get("relative_to") is not None
            if is_relative or not self._close(scope, cut, kind, {parent: X_PJ, child: X_CJ}):
                where = place_of(joint, self.path)
                self.terms.left_out.append(f"{where}: <joint> {name} of <gazebo> is ignored.")
            else:
                self._take_axes([cut.scoped_name], joint, damping=True)

    def _take_loop_joints(self, scope: str) -> None:
        """Read joints that close loops, in a format of older versions of Drake."""
        for joint in self.root.findall("loop_joint"):
            self.root.remove(joint)
            name, kind = joint.get("name", ""), joint.get("type") or "continuous"
            end_elements = [end for tag in ("link1", "link2") for end in joint.findall(tag)]
            ends = {end.get("link", ""): _matrix(*_at(end)) for end in end_elements}
            axis = joint.find("axis")
            turn = numbers("1 0 0" if axis is None else axis.get("xyz", ""), 3)
            if not self._close(scope, CutJoint.of(f"{scope}::{name}", turn, kind), kind, ends):
                what = f"<loop_joint> {name} of the type {kind} does not join two links"
                raise wrong_at(joint, self.path, f"{what}, or has an invalid number.")

    def _close(self, scope: str, cut: CutJoint, kind: str, ends: Mapping[str, Array]) -> bool:
        """Add the closure by a joint at poses (4, 4) in two links; return whether it is valid."""
        links = [f"{scope}::{name}" for name in ends]
        known = kind in CLOSING and len(links) == 2 and self._links.keys() >= {*links}
        if not known or not np.isfinite([*np.ravel([*ends.values()]), *cut.axis]).all():
            return False
        (one, first), (two, second) = zip(links, map(RigidTransform, ends.values()), strict=True)
        self.terms.closures.append(Closure.by_joint(cut, kind, (one, two), (first, second)))
        return True

    def _take_gazebo(self, scope: str, elements: list[Element], joints: set[str | None]) -> None:
        """Read springs of joints, and links without gravity."""
        off = list[str]()
        for element in elements:
            name = f"{scope}::{element.get('reference')}"
            stated = element.findtext("springStiffness", "")
            if element.get("reference") in joints and stated.strip():
                self._take_spring(name, element, "springStiffness", "springReference")
            elif not is_off(stated):
                what = f"{place_of(element, self.path)}: <springStiffness> {stated.strip()[:50]}"
                not_there = f"of {element.get('reference')}, which is not a joint, is ignored."
                self.terms.left_out.append(f"{what} {not_there}")
            falls = [is_off(each.text or "") for each in element.findall("gravity")]
            falls += [not is_off(each.text or "") for each in element.findall("turnGravityOff")]
            if any(falls) and name in self._links:
                off.append(name)
        self.terms.carried = dict.fromkeys(off, 1.0)

    def motors(self) -> tuple[Gear | Coupled, ...]:
        """Return the transmissions of ros_control."""
        return tuple(part for e in self._transmissions for part in _motors(e, self.path))

    def _inertia(self, inertial: Element) -> Array:
        (com, rpy), tensor = _origin(inertial), inertial.find("inertia")
        moments = {} if tensor is None else tensor.attrib
        inertia = symmetric(moments.get(key, "0") for key in TENSOR)
        mass = number(inertial, "mass", "value")
        return inertial_parameters_of(mass, com, rotation(rpy), inertia)


def _joined(elements: Sequence[Element]) -> list[Element]:
    """Return one <gazebo> per reference, merged as in Gazebo."""
    by_reference = dict[str | None, Element]()
    for element in elements:
        for child in element:
            child.text = child.get("value") or child.text
        if (first := by_reference.setdefault(element.get("reference"), element)) is not element:
            first.extend(element)
    return list(by_reference.values())


def _end(joint: Element, tag: str) -> str:
    """Return the parent or child of a joint."""
    end = joint.find(tag)
    return "" if end is None else end.get("link", "")


def _matrix(place: Array, turn: Array) -> Array:
    """Return the pose (4, 4) of a position, and roll, pitch and yaw or a quaternion."""
    return np.block([[rotation(turn), place[:, None]], [np.zeros((1, 3)), np.eye(1)]])


def _origin(element: Element) -> tuple[Array, Array]:
    """Return the position (3,), and roll, pitch and yaw of an <origin>."""
    origin = element.find("origin")
    return (np.zeros(3), np.zeros(3)) if origin is None else _at(origin)


def _at(element: Element) -> tuple[Array, Array]:
    """Return the position (3,), and roll, pitch and yaw of an element."""
    return numbers(element.get("xyz", ""), 3), numbers(element.get("rpy", ""), 3)


def _motors(element: Element, path: Path) -> Iterator[Gear | Coupled]:
    """Yield the transmissions of a URDF."""
    words = element.findtext("type") or element.findtext("plugin") or element.get("type") or ""
    kind = words.strip().rpartition("/")[2]
    if kind not in _KINDS:
        return
    what = f"{path}: the transmission {element.get('name', '')!r}"
    joints, actuators = (sorted(element.findall(x), key=_role) for x in ("joint", "actuator"))
    count = 1 if kind == "SimpleTransmission" else 2
    if len(joints) != count or len(actuators) != count:
        raise ModelError(
            f"{what} has {len(joints)} joints and {len(actuators)} actuators instead of {count}.",
            advice="Correct it there, or write a transmission file.",
        )
    names = [[e.get("name", "") for e in group] for group in (joints, actuators)]
    nj, na = ([_value(e, what) for e in group] for group in (joints, actuators))
    shifts = [_value(e, what, ("offset",), 0.0) for e in joints]
    (j1, *j2), (a1, *a2) = names
    if kind == "SimpleTransmission":
        reduction = _value(element, what)  # in older files
        yield Gear(a1, j1, na[0] * nj[0] * reduction, shifts[0])
        return
    if kind == "DifferentialTransmission":
        first = {a1: 0.5 / (nj[0] * na[0]), a2[0]: 0.5 / (nj[0] * na[1])}
        second = {a1: 0.5 / (nj[1] * na[0]), a2[0]: -0.5 / (nj[1] * na[1])}
    else:
        through = 1.0 / (nj[0] * na[0])
        first = {a1: through}
        second = {a1: -through / nj[1], a2[0]: 1.0 / (nj[1] * na[1])}
    yield Coupled({j1: first, j2[0]: second}, dict(zip(names[0], shifts, strict=True)))


def _role(element: Element) -> str:
    """Return the role of a joint or an actuator in a transmission, such as joint1."""
    return (element.get("role") or element.findtext("role") or "").strip()


def _value(
    element: Element, what: str, tags: Sequence[str] = _REDUCTIONS, default: float = 1.0
) -> float:
    """Return the number in the first existing child of some tags, by default the reduction."""
    text = next((t for tag in tags if (t := element.findtext(tag)) is not None), None)
    value = default if text is None else float(numbers(text.strip() or "none", 1)[0])
    if not np.isfinite(value):
        raise ModelError(f"{what} has {text!r:.52}, which is not a number.", advice="Correct it.")
    if default and not value:
        raise ModelError(f"{what} has a reduction of 0.", advice="Correct it there.")
    return value
