"""MJCF as compiled by MuJoCo: a plain tree for Drake, and terms other than rigid bodies.

Ignored properties are noted with their values, and removed from the copy of the compiled model with
which the robot is compared (`geodrake.model.other_programs`). MuJoCo's forces are (see its modeling
and XML reference: joint, tendon and option)

    spring   −(q − q₀) (k + k₁ (q − q₀) + k₂ (q − q₀)²)      damper   −v (d + d₁ |v| + d₂ v²)

and for a fixed tendon the same in its length Σ cᵢ qᵢ, which for a single joint is a spring there.
Contacts and limits of joints are not part of models.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from pydrake.common.eigen_geometry import AngleAxis
from pydrake.math import RigidTransform, RotationMatrix

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files.checks import (
    LARGEST,
    MJCF_NUMBERS,
    UPPER,
    check_limits,
    check_numbers,
    inertial_parameters_of,
    numbers,
    symmetric,
    words,
)
from geodrake.robot.files.includes import Includes
from geodrake.robot.files.mjcf_source import (
    CompiledMjcf,
    chain_to_world,
    closed_frames,
    load_mujoco,
    pose_of,
    unused,
)
from geodrake.robot.files.model_edits import MOTORS
from geodrake.robot.files.texts import ModelText
from geodrake.robot.files.xml_text import LocatedElement, place_of
from geodrake.robot.joints import Tie
from geodrake.robot.stated import (
    WORLD,
    WORLD_LINK,
    Closure,
    FileTerms,
    InMedium,
    Pulley,
    Spring,
    StatedBall,
    StatedLength,
    StatedTendon,
    TendonPart,
)
from geodrake.robot.transmission.schema import Coupled, Gear

_LEAST_INERTIA = 1e-15  # kg·m², as in MuJoCo
_KINDS = {
    **dict.fromkeys(("stiffness", "stiffnesspoly", "springyield"), "springs"),
    **dict.fromkeys(("damping", "dampingpoly"), "dampers"),
    "frictionloss": "friction",
    "armature": "",
}
"""Properties of joints, tendons and actuators -> flag that disables them."""
_SIDES_SINCE = 4  # version of MuJoCo
_FREE = 6  # velocities of a free joint
_OF_BALLS = "damping", "frictionloss", "armature"


def fixed_tendon(m: Any, at: int) -> dict[int, float]:
    """Return joint -> coefficient of a fixed tendon; empty for a spatial one."""
    coefficients = dict[int, float]()
    for k in range(m.tendon_adr[at], m.tendon_adr[at] + m.tendon_num[at]):
        if int(m.wrap_type[k]) != load_mujoco().mjtWrap.mjWRAP_JOINT:
            return {}
        joint = int(m.wrap_objid[k])
        coefficients[joint] = coefficients.get(joint, 0.0) + float(m.wrap_prm[k])
    return coefficients


def actuator_shares(m: Any, at: int) -> dict[int, float]:
    """Return joint of one degree of freedom -> gear of an actuator at it or its fixed tendon."""
    kinds, on_what = load_mujoco().mjtJoint, load_mujoco().mjtTrn
    kind, on = int(m.actuator_trntype[at]), int(m.actuator_trnid[at][0])
    shares = fixed_tendon(m, on) if kind == on_what.mjTRN_TENDON else {}
    if kind in (on_what.mjTRN_JOINT, on_what.mjTRN_JOINTINPARENT):
        single = int(m.jnt_type[on]) in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE)
        shares = {on: 1.0} if single else {}
    return {joint: float(m.actuator_gear[at][0]) * share for joint, share in shares.items()}


class MjcfTerms:
    """Terms of a compiled MJCF by scoped names; see `MjcfText` for `reference` and `closing`."""

    def __init__(self, source: CompiledMjcf, scope: str) -> None:
        """Read the terms of a compiled file."""
        self.mujoco, self.m, self.scope = load_mujoco(), source.model, scope
        self.source = source
        self.reference, self.closing = copy.copy(source.model), list[int]()
        self.found = FileTerms(
            notes=list(source.notes),
            left_out=list(source.left_out),
            lost=list(source.lost),
            gravity=np.array(self.m.opt.gravity),
        )
        off = self.mujoco.mjtDisableBit
        if self._disabled(off.mjDSBL_GRAVITY):
            self.found.gravity = np.zeros(3)
        self.springs = not self._disabled(off.mjDSBL_SPRING)
        self.dampers = not self._disabled(off.mjDSBL_DAMPER)
        self.friction = not self._disabled(off.mjDSBL_FRICTIONLOSS, off.mjDSBL_CONSTRAINT)
        self._take_joints()
        self._take_tendons()
        self._take_actuators()
        if self.springs or self.dampers:
            self._take_gravcomp()  # with both disabled, MuJoCo has no passive forces at all
            self._take_medium()
        if not self._disabled(off.mjDSBL_EQUALITY, off.mjDSBL_CONSTRAINT):
            self._take_equalities()
        if count := int((~np.asarray(self.m.flex_rigid, bool)).sum()):
            self._ignore(f"<flex> of {count} deformable bodies: their elasticity")
        self.found.notes += source.said
        self.reference.opt.disableflags |= int(off.mjDSBL_CONSTRAINT)

    def _disabled(self, *flags: Any) -> bool:
        return any(self.m.opt.disableflags & int(flag) for flag in flags)

    def _ignore(self, what: str, kind: str = "", at: int = 0, *, of_base: bool = False) -> None:
        """Add a note that something is ignored, with its location in the file."""
        said = self.found.of_bases if of_base else self.found.left_out
        where = self._where(kind, at)
        said.append(f"{where}: {what} is ignored." if where else f"{what} is ignored.")

    def _where(self, kind: str, at: int) -> str:
        """Return the file and line of an element, by name or else by index."""
        elements, name = self.source.groups.get(kind, ()), ""
        if kind == "body":
            elements, name = list(self.source.elements.values()), self._name("BODY", at)
        elif elements:
            name = getattr(self.m, kind)(at).name
        named = [element for element in elements if name and element.get("name") == name]
        counts = {"tendon": self.m.ntendon, "equality": self.m.neq}
        counts["actuator"] = len(self.m.actuator_trntype)
        if not named and len(elements) == counts.get(kind):
            named = [elements[at]]
        return place_of(named[0]) if named else ""

    def _name(self, kind: str, at: int) -> str:
        return getattr(self.m, kind.lower())(at).name or f"{kind.lower()} {at}"

    def _joint(self, at: int) -> str:
        return f"{self.scope}::{self._name('JOINT', at)}"

    def _body(self, at: int) -> str:
        return f"{self.scope}::{self._name('BODY', at)}"

    def _add(self, shares: Mapping[int, float], **stated: Any) -> None:
        """Add terms along a length, a linear combination of joints."""
        named = {self._joint(joint): share for joint, share in shares.items()}
        self.found.lengths.append(StatedLength(named, **stated))

    def _velocities(self, joint: int) -> int:
        kinds = self.mujoco.mjtJoint
        sizes = {int(kinds.mjJNT_FREE): _FREE, int(kinds.mjJNT_BALL): 3}
        return sizes.get(int(self.m.jnt_type[joint]), 1)

    def _numbers(self, where: Callable[[str], tuple[str, slice]]) -> dict[str, Array]:
        """Return the values of each kind in `_KINDS`, by table and row."""
        on = {"springs": self.springs, "dampers": self.dampers, "friction": self.friction}
        return {key: on.get(kind, True) * _row(self.m, *where(key)) for key, kind in _KINDS.items()}

    def _take_joints(self) -> None:
        m = self.m
        for joint in range(m.njnt):
            dof, count = int(m.jnt_dofadr[joint]), self._velocities(joint)
            rows = {"jnt": slice(joint, joint + 1), "dof": slice(dof, dof + count)}

            def where(key: str, rows: Mapping[str, slice] = rows) -> tuple[str, slice]:
                table = "jnt" if _KINDS[key] == "springs" else "dof"
                return f"{table}_{key}", rows[table]

            has = self._numbers(where)
            if count == 1:
                self._take_along("", {joint: 1.0}, has, float(m.qpos_spring[m.jnt_qposadr[joint]]))
                if m.jnt_actfrclimited[joint]:
                    self._limit(joint, float(np.abs(m.jnt_actfrcrange[joint]).max()))
                self.found.start[self._joint(joint)] = float(m.qpos0[m.jnt_qposadr[joint]])
            if count == 3:
                damping, friction, armature = (_pop(has, key)[0] for key in _OF_BALLS)
                losses = {"friction": friction, "armature": armature}
                self._add({joint: 1.0}, damping=_three([damping]), **losses)
                if friction:
                    name = self._name("JOINT", joint)
                    what = f"The dry friction of ball joint {name} is that about axes of its parent"
                    self.found.notes.append(f"{what}, not about its own as in MuJoCo.")
                if int(m.body_jntnum[m.jnt_bodyid[joint]]) == 1:
                    self._take_ball(joint, has)
            self._ignore_rest("joint", joint, has, where, of_base=count == _FREE)

    def _take_ball(self, joint: int, has: dict[str, Array]) -> None:
        """Read the spring of the only joint of a body, a ball."""
        m, body, at = self.m, int(self.m.jnt_bodyid[joint]), int(self.m.jnt_qposadr[joint])
        parent, none = int(m.body_parentid[body]), np.zeros(3)
        (stiffness,) = _pop(has, "stiffness")
        rest = pose_of(none, m.body_quat[body]) @ pose_of(none, m.qpos_spring[at : at + 4])
        bodies = self._body(body), self._body(parent) if parent else WORLD_LINK
        self.found.balls += [StatedBall(bodies, rest.rotation(), stiffness)] if stiffness else []

    def _limit(self, joint: int, most: float) -> None:
        name, limits = self._joint(joint), self.found.effort
        limits[name] = min(most, limits.get(name, np.inf))

    def _take_tendons(self) -> None:
        """Read tendons, with notes on what is ignored."""
        m = self.m
        for at in range(m.ntendon):
            low, high = (float(x) for x in m.tendon_lengthspring[at])
            length, name = low if low == high else None, self._name("TENDON", at)
            where = _rows_of("tendon", at)
            has = self._numbers(where)
            self._take_along(name, fixed_tendon(m, at), has, length)
            self._take_spatial(at, has, low, high)
            self._ignore_rest("tendon", at, has, where)

    def _take_along(
        self, name: str, shares: dict[int, float], has: dict[str, Array], length: float | None
    ) -> None:
        """Read all effects along a length Σ c q with rest length L₀, and set them to 0 in `has`."""
        shares = {joint: share for joint, share in shares.items() if share}
        if not shares or any(self._velocities(joint) > 1 for joint in shares):
            return
        single = len(shares) == 1
        forms = ("", "poly") if single else ("",)
        springs = forms if length is not None else ()
        stiffness = [x for form in springs for x in _pop(has, f"stiffness{form}")]
        damping = [x for form in forms for x in _pop(has, f"damping{form}")]
        (friction, *_), (inertia, *_) = _pop(has, "frictionloss"), _pop(has, "armature")
        pairs = combinations_with_replacement(shares, 2) if inertia and not single else ()
        for one, other in pairs:
            chains = [set(chain_to_world(self.m, int(self.m.jnt_bodyid[j]))) for j in (one, other)]
            if chains[0] <= chains[1] or chains[1] <= chains[0]:  # MuJoCo omits other entries
                entry = self._joint(one), self._joint(other), inertia * shares[one] * shares[other]
                self.found.coupled_inertia.append(entry)
        self._add(
            shares,
            spring=Spring(length or 0.0, (0.0, *_three(stiffness))),
            damping=_three(damping),
            friction=friction,
            armature=inertia if single else 0.0,
            name=name,
        )

    def _take_spatial(self, at: int, has: dict[str, Array], low: float, high: float) -> None:
        """Read spring and damper of a tendon over sites, pulleys, spheres and cylinders."""
        parts = self._parts(at)
        if not parts or has["stiffness"][0] < 0.0:
            return
        (stiffness,), (damping,) = _pop(has, "stiffness"), _pop(has, "damping")
        if stiffness or damping:
            tendon = StatedTendon(tuple(parts), stiffness, low, damping, high - low)
            self.found.tendons.append(tendon)

    def _parts(self, at: int) -> list[TendonPart]:
        """Return the parts of a spatial tendon; empty for others, and within geoms."""
        m, kinds, first = self.m, self.mujoco.mjtWrap, int(self.m.tendon_adr[at])
        parts, weight, last, around = list[TendonPart](), 1.0, -1, None
        for k in range(first, first + int(m.tendon_num[at])):
            kind, site = int(m.wrap_type[k]), int(m.wrap_objid[k])
            if kind == kinds.mjWRAP_PULLEY:
                weight, last = 1.0 / float(m.wrap_prm[k]), -1
                continue
            if kind in (kinds.mjWRAP_SPHERE, kinds.mjWRAP_CYLINDER):
                around = self._around(site, int(m.wrap_prm[k]))
                if around is None:
                    return []
                continue
            if kind != kinds.mjWRAP_SITE:
                return []
            if last >= 0:
                one, two = (int(m.site_bodyid[each]) for each in (last, site))
                names = [self._body(body) if body else WORLD_LINK for body in (one, two)]
                points = np.array(m.site_pos[last]), np.array(m.site_pos[site])
                parts.append(TendonPart((names[0], names[1]), points, weight, around))
            last, around = site, None
        return parts

    def _around(self, geom: int, site: int) -> Pulley | None:
        """Return the geom that a tendon leads around, on the side of a site if it is not −1.

        Return None if the site is inside of the geom, or belongs to another body, and in versions
        of MuJoCo before 4, which take other ways.
        """
        m, side, body = self.m, np.zeros(3), int(self.m.geom_bodyid[geom])
        X, radius = pose_of(m.geom_pos[geom], m.geom_quat[geom]), float(m.geom_size[geom][0])
        if site >= 0:
            side = X.inverse() @ np.array(m.site_pos[site])
            is_within = np.linalg.norm(side) < radius or int(m.site_bodyid[site]) != body
            if is_within or int(self.mujoco.__version__.partition(".")[0]) < _SIDES_SINCE:
                return None
        is_cylinder = int(m.geom_type[geom]) == self.mujoco.mjtGeom.mjGEOM_CYLINDER
        return Pulley(self._body(body) if body else WORLD_LINK, X, radius, is_cylinder, side)

    def _ignore_rest(
        self,
        kind: str,
        at: int,
        has: dict[str, Array],
        where: Callable[[str], tuple[str, slice]],
        *,
        of_base: bool = False,
    ) -> None:
        """Add a note on remaining values of an element, and remove them from the reference."""
        words = {key: " ".join(f"{x:g}" for x in value) for key, value in has.items()}
        parts = [f"{key} {words[key]}" for key, value in has.items() if value.any()]
        if parts:
            what = self._name(kind.upper(), at).removeprefix(f"{kind} ")
            with_what = f"{kind.capitalize()} {what} with {', '.join(parts)}"
            self._ignore(with_what, kind, at, of_base=of_base)
        for key, value in has.items():
            if value.any() and key != "frictionloss":
                table, rows = where(key)
                getattr(self.reference, table)[rows] = 0.0

    def _take_actuators(self) -> None:
        """Read effort limits, and armature and damping of motors."""
        m, on_tendon = self.m, self.mujoco.mjtTrn.mjTRN_TENDON
        for at in range(len(m.actuator_trntype)):
            name, shares = self._name("ACTUATOR", at), actuator_shares(m, at)
            where = _rows_of("actuator", at)
            has = self._numbers(where)
            self.found.driven |= set(map(self._joint, shares))
            if shares and int(m.actuator_trntype[at]) != on_tendon:
                ((on, gear),) = shares.items()
                self._limit_of_motor(at, on, gear)
                more = [gear**2 * c for c in _pop(has, "dampingpoly")]  # gear³ for tendons
                self._add({on: 1.0}, damping=_three([0.0, *more]))
            self._take_along(name, shares, has, None)
            self._ignore_rest("actuator", at, has, where)
            self._note_motor(at, name)

    def _note_motor(self, at: int, name: str) -> None:
        """Add a note on cogging and friction of a motor, which MuJoCo includes in its effort."""
        kind = getattr(self.mujoco.mjtBias, "mjBIAS_DCMOTOR", None)  # from version 4 on
        if kind is not None and int(self.m.actuator_biastype[at]) == int(kind):
            inside = zip(("cogging", "friction"), self.m.actuator_biasprm[at][[0, 3]], strict=True)
            if words := " and ".join(f"{what} of {size:g}" for what, size in inside if size):
                self.found.notes.append(
                    f"{self._where('actuator', at)}: the effort of the motor {name} includes "
                    f"{words} inside of it."
                )

    def _limit_of_motor(self, at: int, joint: int, gear: float) -> None:
        m, mujoco = self.m, self.mujoco
        ranges = [m.actuator_forcerange[at]] if m.actuator_forcelimited[at] else []
        plain = (
            int(m.actuator_gaintype[at]) == mujoco.mjtGain.mjGAIN_FIXED
            and int(m.actuator_biastype[at]) == mujoco.mjtBias.mjBIAS_NONE
            and int(m.actuator_dyntype[at]) == mujoco.mjtDyn.mjDYN_NONE
        )
        limited = getattr(m, "actuator_ctrllimited")  # noqa: B009, as older versions have it, too
        signals = getattr(m, "actuator_ctrladr", range(len(limited)))  # several of one actuator
        if plain and limited[signal := int(signals[at])]:
            most = np.asarray(m.actuator_ctrlrange[signal])
            ranges.append(float(m.actuator_gainprm[at][0]) * most)
        if ranges and gear:
            self._limit(joint, min(abs(gear) * float(np.abs(each).max()) for each in ranges))

    def _take_gravcomp(self) -> None:
        """Read gravity compensation; a uniform one is reduced gravity."""
        m = self.m
        gravity = np.asarray(self.found.gravity)
        if not np.any(m.body_gravcomp > 0.0) or not gravity.any():  # as in MuJoCo
            return
        moving = [b for b in range(m.nbody) if m.body_weldid[b] and m.body_mass[b] > 0.0]
        shares = m.body_gravcomp[moving]
        by_motors = np.asarray(m.jnt_actgravcomp).astype(bool)
        if by_motors.all():
            return  # MuJoCo includes it in the efforts of the actuators
        if len(shares) and np.ptp(shares) == 0.0 and not by_motors.any():
            self.found.gravity = gravity * (1.0 - float(shares[0]))
            self.found.notes.append(
                f"gravcomp={shares[0]:g} of all bodies is read as reduced gravity."
            )
            return
        self.found.carried = {
            self._body(body): float(m.body_gravcomp[body])
            for body in moving
            if m.body_gravcomp[body]
        }
        self.found.acting = {self._joint(joint) for joint in np.flatnonzero(by_motors).tolist()}

    def _take_medium(self) -> None:
        """Read the forces of a medium on boxes and ellipsoids."""
        m, option = self.m, self.m.opt
        medium = np.array([option.density, option.viscosity], float)
        for body in np.flatnonzero(m.body_weldid).tolist() if medium.any() else ():
            first, mass = int(m.body_geomadr[body]), float(m.body_mass[body])
            geoms = range(first, first + int(m.body_geomnum[body]))
            ellipsoids = [geom for geom in geoms if m.geom_fluid[geom][0] > 0.0]
            for geom in ellipsoids:
                share, *coefficients = m.geom_fluid[geom].tolist()
                X = pose_of(m.geom_pos[geom], m.geom_quat[geom])
                self._add_in_medium(body, self._semi_axes(geom), X, share * medium, coefficients)
            if mass > 0.0 and not ellipsoids:
                inertia = np.array(m.body_inertia[body])
                edges = np.maximum(inertia.sum() - 2.0 * inertia, _LEAST_INERTIA)
                X = pose_of(m.body_ipos[body], m.body_iquat[body])
                self._add_in_medium(body, np.sqrt(6.0 * edges / mass), X, medium)

    def _add_in_medium(
        self,
        body: int,
        size: Array,
        X_BP: RigidTransform,
        medium: Array,
        coefficients: Sequence[float] = (),
    ) -> None:
        density, viscosity = medium.tolist()
        wind, name = np.array(self.m.opt.wind), self._body(body)
        term = InMedium(name, size, X_BP, density, viscosity, wind, tuple(coefficients))
        self.found.in_medium.append(term)

    def _semi_axes(self, geom: int) -> Array:
        """Return the semi-axes (3,) of the equivalent ellipsoid of a geom, m."""
        kinds, kind = self.mujoco.mjtGeom, int(self.m.geom_type[geom])
        a, b, c = self.m.geom_size[geom].tolist()
        sizes = {
            int(kinds.mjGEOM_SPHERE): (a, a, a),
            int(kinds.mjGEOM_CAPSULE): (a, a, b + a),
            int(kinds.mjGEOM_CYLINDER): (a, a, b),
        }
        return np.array(sizes.get(kind, (a, b, c)))

    def _take_equalities(self) -> None:
        m, mujoco = self.m, self.mujoco
        for at in range(m.neq):
            first, second = int(m.eq_obj1id[at]), int(m.eq_obj2id[at])
            kind = mujoco.mjtEq(int(m.eq_type[at])).name.removeprefix("mjEQ_").lower()
            sites = int(m.eq_objtype[at]) == mujoco.mjtObj.mjOBJ_SITE
            of = {"joint": "JOINT", "tendon": "TENDON", "flex": "FLEX"}.get(kind)
            of = of or ("SITE" if sites else "BODY")
            what = " and ".join(self._name(of, each) for each in (first, second) if each >= 0)
            data = np.array(m.eq_data[at])
            if not m.eq_active0[at]:
                self.found.notes.append(
                    f"<equality>: the constraint <{kind}> of {what} is inactive, and ignored."
                )
            elif kind == "joint" and second >= 0:
                self._follow(at, first, second, data[:5])
            elif kind == "joint":
                place = float(m.qpos0[m.jnt_qposadr[first]] + data[0])
                self.found.fixed[self._joint(first)] = place
            elif not (
                (kind in ("connect", "weld") and self._close(at, f"<{kind}> of {what}"))
                or (kind == "tendon" and self._follow_tendon(first, second, data[:5]))
            ):
                self._ignore(
                    f"<equality>: the constraint <{kind}> of {what}, which closes a loop or "
                    "holds something (the robot is read as an open tree),",
                    "equality",
                    at,
                    of_base=kind == "weld" and self._holds_base(at),
                )

    def _holds_base(self, at: int) -> bool:
        """Return whether a weld fixes a free base."""
        ends = [body for body, _ in closed_frames(self.m, at)]
        moved = [each for each in ends if each and self.m.body_mocapid[each] < 0]
        return len(moved) == 1 and self._free_root(moved[0]) == moved[0]

    def _close(self, at: int, name: str) -> bool:
        """Add the closure by a constraint; return whether it is within one robot.

        It is not if it holds something free, such as a body on a table.
        """
        m, ends = self.m, closed_frames(self.m, at)
        if len({self._free_root(body) for body, _ in ends}) > 1:
            return False
        one, two = (self._body(body) if body else WORLD for body, _ in ends)
        welds = int(m.eq_type[at]) == self.mujoco.mjtEq.mjEQ_WELD
        turns = bool(welds and m.eq_data[at][10] != 0.0)  # scale of the torque
        self.found.closures.append(Closure(name, (one, two), (ends[0][1], ends[1][1]), turns))
        self.closing.append(at)
        return True

    def _free_root(self, body: int) -> int:
        """Return a body or its ancestor that is free or a mocap body; otherwise 0."""
        m, free = self.m, self.mujoco.mjtJoint.mjJNT_FREE
        for each in chain_to_world(m, body):
            joints = range(m.body_jntadr[each], m.body_jntadr[each] + m.body_jntnum[each])
            moved = int(m.body_mocapid[each]) >= 0
            if moved or any(int(m.jnt_type[joint]) == free for joint in joints):
                return each
        return 0

    def _follow_tendon(self, first: int, second: int, data: Array) -> bool:
        """Add a tie for L − L₀ = a₀ + a₁ (M − M₀) of fixed tendons; return whether it is one."""
        m = self.m
        shares = fixed_tendon(m, first)
        length = float(m.tendon_length0[first]) + float(data[0])
        if second >= 0:
            other = fixed_tendon(m, second)
            length -= float(data[1]) * float(m.tendon_length0[second])
            shares = shares if other else {}
            for joint, share in other.items():
                shares[joint] = shares.get(joint, 0.0) - float(data[1]) * share
        shares = {joint: share for joint, share in shares.items() if share}
        several = any(self._velocities(joint) > 1 for joint in shares)
        if len(shares) != 2 or np.any(data[2:]) or several:
            return False
        # A driven joint leads; otherwise the first.
        on_what, motors = self.mujoco.mjtTrn, zip(m.actuator_trnid, m.actuator_trntype, strict=True)
        at_joints = (on_what.mjTRN_JOINT, on_what.mjTRN_JOINTINPARENT)
        driven = {int(on[0]) for on, kind in motors if int(kind) in at_joints}
        leader, own = sorted(shares, key=lambda joint: joint not in driven)
        return self._tie(own, leader, length / shares[own], -shares[leader] / shares[own])

    def _tie(self, joint: int, leader: int, *coefficients: float) -> bool:
        """Let a joint follow another one, or vice versa if the ratio is constant.

        Return False if both follow a joint already, or each other.
        """
        trials = [(joint, leader, coefficients)]
        if len(coefficients) == 2 and coefficients[1]:
            trials.append(
                (leader, joint, (-coefficients[0] / coefficients[1], 1.0 / coefficients[1]))
            )
        for first, second, each in trials:
            name, end = self._joint(first), self._joint(second)
            ties = self.found.followers
            while end in ties:  # ties have no cycles
                end = ties[end].leader
            if name not in ties and end != name:
                ties[name] = Tie(self._joint(second), each)
                return True
        return False

    def _follow(self, at: int, first: int, second: int, data: Array) -> None:
        """Add the tie Y − y₀ = p(x − x₀), with y₀ and x₀ in the pose of the file."""
        starts = [float(self.m.qpos0[self.m.jnt_qposadr[j]]) for j in (first, second)]
        if not data[1:].any():
            self.found.fixed[self._joint(first)] = starts[0] + float(data[0])
            return
        c = data if data[2:].any() else data[:2]
        moved = np.zeros(len(c))
        polynomial = np.polynomial.Polynomial(c)(np.polynomial.Polynomial([-starts[1], 1.0]))
        moved[: len(polynomial.coef)] = polynomial.coef
        moved[0] += starts[0]
        if not self._tie(first, second, *moved.tolist()):
            name = self._name("JOINT", first)
            self._ignore(
                f"<equality>: the constraint <joint> of {name} and "
                f"{self._name('JOINT', second)}, as {name} already follows or leads a joint,",
                "equality",
                at,
            )


def _rows_of(thing: str, at: int) -> Callable[[str], tuple[str, slice]]:
    """Return a function from a property of a tendon or an actuator to its table and rows."""
    return lambda key: (f"{thing}_{key}", slice(at, at + 1))


def _row(m: Any, name: str, rows: slice) -> Array:
    """Return the first row of a table, (k,); zeros in versions of MuJoCo without it."""
    table = getattr(m, name, None)
    return np.zeros(2) if table is None else np.atleast_1d(np.array(table[rows][0], float))


def _pop(has: dict[str, Array], key: str) -> list[float]:
    """Return the numbers of a property, and set them to zero."""
    values, has[key] = has[key], np.zeros_like(has[key])
    return [float(value) for value in values]


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    first, second, third = (*values, 0.0, 0.0, 0.0)[:3]
    return first, second, third


class MjcfText(ModelText):
    """A MuJoCo model as compiled by MuJoCo.

    The text is a plain tree of bodies with inertias and joints, without geometry.

    Attributes:
        compiled: MuJoCo's model of the whole file.
        reference: MuJoCo's model without ignored properties, for comparison; None if inertias are
            unknown.
        closing: Indices of MuJoCo's constraints that close loops.
        degrees: Whether angles in the file are in degrees, as by default.
        timestep: Time step of the simulation, s; MuJoCo's default if the file has no valid one.
        actuator_defaults: Whether actuators without a class have defaults other than MuJoCo's.
    """

    kind = "xml"
    numeric = MJCF_NUMBERS

    def _read(self) -> None:
        root = self.root
        Includes(self.path, self.folders).insert_elements(root)
        check_numbers(root, self.numeric, self.path)
        check_limits(root, self.path)
        angles = [compiler.get("angle") for compiler in root.findall("compiler")]
        self.degrees = next(filter(None, reversed(angles)), "degree") == "degree"
        steps = [option.get("timestep") for option in root.findall("option")]
        step = float(numbers(next(filter(None, reversed(steps)), ""), 1)[0])
        self.timestep = step if step > 0.0 and np.isfinite(step) else 0.002
        self.actuator_defaults = any(
            child.tag in MOTORS for main in root.findall("default") for child in main
        )
        self.scope = scope = self.scope or root.get("model") or self.path.stem
        source = CompiledMjcf(root, self.path)
        read = MjcfTerms(source, scope)
        name = root.get("model") or scope
        self.root = plain_tree(source, name)
        self.compiled: Any = source.model
        self.reference: Any = None if source.lost else read.reference
        self.closing, self.terms = tuple(read.closing), read.found
        for body in self.root.iter("body"):
            link = f"{scope}::{body.get('name')}"
            self._links[link] = body
            if body.attrib.pop("between", ""):
                self.terms.between.add(link)

    def motors(self) -> tuple[Gear | Coupled, ...]:
        """Return gears of actuators, and fixed tendons."""
        return _motors(self.compiled, self.path)

    def _inertia(self, inertial: Element) -> Array:
        mass, com = numbers(inertial.get("mass", ""), 1)[0], numbers(inertial.get("pos", ""), 3)
        moments = symmetric(inertial.get("fullinertia", "").split())
        return inertial_parameters_of(mass, com, np.eye(3), moments)


def plain_tree(source: CompiledMjcf, name: str) -> Element:
    """Return the root element of a tree of bodies with inertias and joints, and motors.

    Angles are in radians. Positions are MuJoCo's: if the file's pose has a joint at `ref`, the pose
    of its body is moved back by that.
    """
    root, m = Element("mujoco", model=name), source.model
    SubElement(root, "compiler", angle="radian")
    elements = {0: SubElement(root, "worldbody")}
    free = unused({m.body(at).name for at in range(m.nbody)})
    data, massless = load_mujoco().MjData(m), dict[int, Array]()
    load_mujoco().mj_kinematics(m, data)
    poses, axes = data.xmat.reshape(-1, 3, 3), data.ximat.reshape(-1, 3, 3)
    inertias = (axes * m.body_inertia[:, None]) @ axes.swapaxes(1, 2)  # in the world
    for at in np.flatnonzero(m.body_mass == 0.0).tolist():  # inertia by <compiler boundinertia>
        welded = int(m.body_weldid[at])
        massless[welded] = massless.get(welded, 0.0) + inertias[at]
    for at in range(1, m.nbody):
        name_of_body, parent = m.body(at).name, elements[int(m.body_parentid[at])]
        like, X_PB = source.elements.get(name_of_body), pose_of(m.body_pos[at], m.body_quat[at])
        joints = range(m.body_jntadr[at], m.body_jntadr[at] + m.body_jntnum[at])
        for joint in joints:
            X_PB, between = X_PB @ _back(m, joint), joint != joints[-1]
            label = free(f"{name_of_body}_{m.joint(joint).name}") if between else name_of_body
            parent = _body(parent, label, X_PB, like)
            if between:
                parent.set("between", "true")
            _write_joint(parent, m, joint)
            X_PB = RigidTransform()
        elements[at] = parent if joints else _body(parent, name_of_body, X_PB, like)
        if m.body_mass[at] > 0.0 and name_of_body not in source.unknown:
            inertia = inertias[at] + massless.pop(int(m.body_weldid[at]), 0.0)
            inertia = poses[at].T @ inertia @ poses[at]
            SubElement(
                elements[at],
                "inertial",
                pos=words(m.body_ipos[at]),
                mass=words(m.body_mass[at]),
                fullinertia=words(inertia[UPPER]),
            )
    motors = SubElement(root, "actuator")
    for at, kind in enumerate(m.actuator_trntype):
        named = {"name": name_of_body} if (name_of_body := m.actuator(at).name) else {}
        for joint in actuator_shares(m, at) if kind != load_mujoco().mjtTrn.mjTRN_TENDON else ():
            SubElement(motors, "motor", {**named, "joint": m.joint(joint).name})
    return root


def _body(parent: Element, name: str, X: RigidTransform, like: Element | None) -> Element:
    """Add a body of the compiled file to its parent."""
    turn = words(X.rotation().ToQuaternion().wxyz())
    stated = {"name": name, "pos": words(X.translation()), "quat": turn}
    body = Element("body", stated)
    if isinstance(like, LocatedElement):
        body = located = LocatedElement("body", stated)
        located.path, located.line = like.path, like.line
    parent.append(body)
    return body


def _kind(m: Any, joint: int) -> str:
    kind = load_mujoco().mjtJoint(int(m.jnt_type[joint]))
    return str(kind.name).removeprefix("mjJNT_").lower()


def _write_joint(body: Element, m: Any, joint: int) -> None:
    kind, name = _kind(m, joint), m.joint(joint).name
    if kind == "free":
        SubElement(body, "freejoint", name=name)
        return
    stated = {"name": name, "type": kind, "pos": words(m.jnt_pos[joint])}
    if kind != "ball":
        stated |= {"axis": words(m.jnt_axis[joint])}
        if m.jnt_limited[joint] and np.isfinite(m.jnt_range[joint]).any():
            ends = np.clip(m.jnt_range[joint], -LARGEST, LARGEST)  # Drake cannot read infinity
            stated |= {"range": words(ends), "limited": "true"}
    SubElement(body, "joint", stated)


def _back(m: Any, joint: int) -> RigidTransform:
    """Return the motion of a body from its pose in the file to its joint's zero."""
    kind, ref = _kind(m, joint), float(m.qpos0[m.jnt_qposadr[joint]])
    if kind not in ("hinge", "slide") or not ref:
        return RigidTransform()
    axis, point = np.array(m.jnt_axis[joint]), np.array(m.jnt_pos[joint])
    if kind == "slide":
        return RigidTransform(-ref * axis)
    turn = RotationMatrix(AngleAxis(-ref, axis))
    return RigidTransform(turn, point - turn.multiply(point))


def _motors(m: Any, path: Path) -> tuple[Gear | Coupled, ...]:
    """Return the transmissions of actuators: gears, q = γ θ, or fixed tendons, q = γ Σ cᵢ θᵢ."""
    gears, pulled = list[Gear](), dict[str, dict[str, float]]()
    for at in range(len(m.actuator_trntype)):
        if not (shares := {m.joint(j).name: x for j, x in actuator_shares(m, at).items()}):
            continue
        if not m.actuator_gear[at][0]:
            what = f"{path}: an actuator has a gear of 0."
            raise ModelError(what, advice="Correct it there.")
        name, on = m.actuator(at).name, int(m.actuator_trnid[at][0])
        if int(m.actuator_trntype[at]) == load_mujoco().mjtTrn.mjTRN_TENDON:
            pulled[name or m.tendon(on).name or f"tendon_{on}"] = shares
        else:
            ((joint, gear),) = shares.items()
            gears.append(Gear(name or joint, joint, gear))
    return (*gears, *_coupled(pulled, path))


def _coupled(pulled: Mapping[str, Mapping[str, float]], path: Path) -> Iterator[Coupled]:
    """Yield groups of joints that tendons move together, θ = C⁻¹ q for q = C θ."""
    pending = dict(pulled)
    while pending:
        group, joints = [next(iter(pending))], set(pending[next(iter(pending))])
        while more := [n for n in pending if n not in group and joints.intersection(pending[n])]:
            group += more
            joints |= {joint for name in more for joint in pending[name]}
        names = list(dict.fromkeys(joint for name in group for joint in pending[name]))
        rows = [pending.pop(name) for name in group]
        C = np.array([[row.get(joint, 0.0) for joint in names] for row in rows])
        if len(names) != len(group) or np.linalg.matrix_rank(C) < len(names):
            raise ModelError(
                f"{path}: the tendons of {', '.join(group)} do not determine {', '.join(names)}.",
                advice="Write a transmission file: --transmission FILE.yaml.",
            )
        yield Coupled(_terms(names, group, np.linalg.inv(C)))


def _terms(
    joints: Sequence[str], actuators: Sequence[str], J: Array
) -> dict[str, dict[str, float]]:
    rows = zip(joints, J.tolist(), strict=True)
    return {joint: {a: x for a, x in zip(actuators, row, strict=True) if x} for joint, row in rows}
