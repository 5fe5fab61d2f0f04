"""What a compiled MJCF has beside rigid bodies: at joints, and what no model of geodrake takes.

What is not taken is said with its value, and taken out of the copy of the compiled model that the
robot is compared with (`geodrake.robot.mujoco_check`), as are carried weights, media and struts.
MuJoCo's forces are (its modeling and XML reference, joint, tendon and option)

    spring   −(q − q₀) (k + k₁ (q − q₀) + k₂ (q − q₀)²)      damper   −v (d + d₁ |v| + d₂ v²)

and those of a fixed tendon the same in its length Σ cᵢ qᵢ, so that one of a single joint is a
spring there. Contacts and limits of joints are no part of any model.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from types import ModuleType
from typing import Any

import numpy as np
from pydrake.math import RigidTransform

from geodrake.inertia import Array
from geodrake.robot.closure import WORLD, Closure
from geodrake.robot.files.mjcf_source import CompiledMjcf
from geodrake.robot.files.mjcf_tree import fixed_tendon, name_of, pose_of
from geodrake.robot.followers import Follower, leads_back
from geodrake.robot.stated import BoxInMedium, Spring, StatedStrut, Tendon
from geodrake.robot.transmission.statements import Followers

_KINDS = ("free", "ball", "slide", "hinge")
_LEAST_INERTIA = 1e-15  # kg·m², as MuJoCo has it


@dataclass(eq=False)
class MjcfTerms:
    """What a compiled MJCF states of joints, by their names, and the rest in words.

    Attributes:
        reference: The compiled model without what is left out.
        gravity: (3,) gravity, less what compensates that of all bodies alike, m/s².
        of_joints: Name of a quantity, as in `ModelText` -> joint -> its value, SI.
        springs: Joint -> its spring.
        tendons: Tendons over several joints, by their names.
        coupled_inertia: Two joints, or one twice, and what tendons are there in the mass matrix.
        carried: Body -> which share of its weight something else carries.
        boxes: Bodies as what a medium acts on.
        struts: Spatial tendons between two sites.
        followers: Joint -> leader, ratio and offset.
        bent: Leader -> joint -> coefficients of a polynomial.
        closures: Number of a constraint of MuJoCo's -> how it closes a loop, bodies by their own
            names.
        left_out: Sentences on what bears on efforts and no model takes.
        notes: Sentences on what was taken otherwise than it is stated.
    """

    reference: Any
    gravity: Array
    of_joints: dict[str, dict[str, float]]
    springs: dict[str, Spring] = field(default_factory=dict)
    tendons: list[Tendon] = field(default_factory=list)
    coupled_inertia: list[tuple[str, str, float]] = field(default_factory=list)
    carried: dict[str, float] = field(default_factory=dict)
    boxes: list[BoxInMedium] = field(default_factory=list)
    struts: list[StatedStrut] = field(default_factory=list)
    followers: list[Follower] = field(default_factory=list)
    bent: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    closures: dict[int, Closure] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def followers_in(self, scope: str) -> list[Follower]:
        """Return the followers with names that have their model's."""
        return [
            Follower(f"{scope}::{f.joint}", f"{scope}::{f.leader}", f.ratio, f.offset)
            for f in self.followers
        ]

    def closures_in(self, scope: str) -> list[Closure]:
        """Return what closes loops, with names of bodies that have their model's."""

        def full(body: str) -> str:
            return body if body == WORLD else f"{scope}::{body}"

        return [
            replace(each, bodies=(full(each.bodies[0]), full(each.bodies[1])))
            for each in self.closures.values()
        ]

    @property
    def bent_followers(self) -> list[Followers]:
        """Return the joints that follow others by a ratio that changes."""
        return [Followers(leader, own) for leader, own in self.bent.items()]


_OF_JOINTS = ("friction", "armature", "damping", "damping_2", "damping_3", "start", "fixed")
QUANTITIES = (*_OF_JOINTS, "effort")


def terms_of(source: CompiledMjcf, mujoco: ModuleType) -> MjcfTerms:
    """Return what a compiled file states of joints, and what is left out."""
    return _Terms(source, mujoco).found


class _Terms:
    def __init__(self, source: CompiledMjcf, mujoco: ModuleType) -> None:
        self.mujoco, self.m = mujoco, source.model
        self.found = MjcfTerms(
            copy.copy(source.model), np.array(self.m.opt.gravity), {q: {} for q in QUANTITIES}
        )
        self.found.left_out += (f"{plugin} is left out." for plugin in source.plugins)
        off = mujoco.mjtDisableBit
        if self._disabled(off.mjDSBL_GRAVITY):
            self.found.gravity = np.zeros(3)
        self._take_joints(
            springs=not self._disabled(off.mjDSBL_SPRING),
            dampers=not self._disabled(off.mjDSBL_DAMPER),
            friction=not self._disabled(off.mjDSBL_FRICTIONLOSS, off.mjDSBL_CONSTRAINT),
        )
        self._take_tendons()
        self._take_actuators()
        if not (self._disabled(off.mjDSBL_SPRING) and self._disabled(off.mjDSBL_DAMPER)):
            self._take_gravcomp()  # without both, MuJoCo has no passive forces at all
            self._take_medium()
        if not self._disabled(off.mjDSBL_EQUALITY, off.mjDSBL_CONSTRAINT):
            self._take_equalities()
        if self.m.nflex:
            self._leave(f"<flex> of {self.m.nflex} deformable bodies: their elasticity")
        self.found.reference.opt.disableflags |= int(off.mjDSBL_CONSTRAINT)

    def _disabled(self, *flags: Any) -> bool:
        return any(self.m.opt.disableflags & int(flag) for flag in flags)

    def _leave(self, what: str) -> None:
        self.found.left_out.append(f"{what} is left out.")

    def _name(self, kind: str, at: int) -> str:
        return name_of(self.m, self.mujoco, kind, at) or f"{kind.lower()} {at}"

    def _add(self, quantity: str, joint: int, value: float) -> None:
        name, values = self._name("JOINT", joint), self.found.of_joints[quantity]
        values[name] = values.get(name, 0.0) + float(value)

    def _single(self, joint: int) -> bool:
        return _KINDS[int(self.m.jnt_type[joint])] in ("slide", "hinge")

    def _take_joints(self, *, springs: bool, dampers: bool, friction: bool) -> None:
        m, reference = self.m, self.found.reference
        for joint in range(m.njnt):
            dof, name = int(m.jnt_dofadr[joint]), self._name("JOINT", joint)
            count = {"free": 6, "ball": 3}.get(_KINDS[int(m.jnt_type[joint])], 1)
            self._add("armature", joint, m.dof_armature[dof])
            self._add("friction", joint, m.dof_frictionloss[dof] if friction else 0.0)
            poly = _row(m, "dof_dampingpoly", dof)
            if count == 6:
                self._leave_of_free(dof, name)
                continue
            if dampers:
                self._add("damping", joint, m.dof_damping[dof])
                for power, value in zip((2, 3), poly if count == 1 else (), strict=False):
                    self._add(f"damping_{power}", joint, value)
                if count > 1 and poly.any():
                    self._leave(f"The damping polynomial {_list(poly)} of the joint {name}")
                    reference.dof_dampingpoly[dof : dof + count] = 0.0
            if springs and m.jnt_stiffness[joint] + np.abs(self._poly(joint)).sum():
                self._take_spring(joint, name, count)
            self._take_limit(joint, count)
            if count == 1:
                self._add("start", joint, m.qpos0[m.jnt_qposadr[joint]])

    def _leave_of_free(self, dof: int, name: str) -> None:
        m = self.m
        has = {"damping": m.dof_damping, "armature": m.dof_armature}
        has["frictionloss"] = m.dof_frictionloss
        parts = [f"{what} {values[dof]:g}" for what, values in has.items() if values[dof]]
        if parts:
            self._leave(f"The free joint {name} with {', '.join(parts)}")

    def _poly(self, joint: int) -> Array:
        return _row(self.m, "jnt_stiffnesspoly", joint)

    def _take_spring(self, joint: int, name: str, count: int) -> None:
        m, reference, poly = self.m, self.found.reference, self._poly(joint)
        if count > 1:
            numbers = np.append(m.jnt_stiffness[joint], poly)
            self._leave(f"The stiffness {_list(numbers)} of the joint {name}")
            reference.jnt_stiffness[joint] = 0.0
            if len(poly):
                reference.jnt_stiffnesspoly[joint] = 0.0
            return
        rest = float(m.qpos_spring[m.jnt_qposadr[joint]])
        self._add_spring(joint, Spring(rest, (0.0, float(m.jnt_stiffness[joint]), *_two(poly))))
        if np.any(_row(m, "jnt_springyield", joint)):
            self._leave(f"The yield of the spring of the joint {name}")
            reference.jnt_springyield[joint] = 0.0

    def _add_spring(self, joint: int, spring: Spring) -> None:
        name, springs = self._name("JOINT", joint), self.found.springs
        springs[name] = springs[name] + spring if name in springs else spring

    def _take_limit(self, joint: int, count: int) -> None:
        if count == 1 and self.m.jnt_actfrclimited[joint]:
            self._limit(joint, float(np.abs(self.m.jnt_actfrcrange[joint]).max()))

    def _limit(self, joint: int, most: float) -> None:
        name, limits = self._name("JOINT", joint), self.found.of_joints["effort"]
        limits[name] = min(most, limits.get(name, np.inf))

    def _take_tendons(self) -> None:
        """Fixed tendons of one joint are terms of it; of others is said what no tendon here has."""
        m, off = self.m, self.mujoco.mjtDisableBit
        springs = not self._disabled(off.mjDSBL_SPRING)
        dampers = not self._disabled(off.mjDSBL_DAMPER)
        rubs = not self._disabled(off.mjDSBL_FRICTIONLOSS, off.mjDSBL_CONSTRAINT)
        for at in range(m.ntendon):
            has = {
                "stiffness": springs * _row(m, "tendon_stiffness", at),
                "stiffnesspoly": springs * _row(m, "tendon_stiffnesspoly", at),
                "damping": dampers * _row(m, "tendon_damping", at),
                "dampingpoly": dampers * _row(m, "tendon_dampingpoly", at),
                "frictionloss": rubs * _row(m, "tendon_frictionloss", at),
                "armature": _row(m, "tendon_armature", at),
                "springyield": springs * _row(m, "tendon_springyield", at),
            }
            low, high = (float(x) for x in m.tendon_lengthspring[at])
            shares = fixed_tendon(m, self.mujoco, at)
            name = self._name("TENDON", at)
            self._take_along(name, shares, has, low if low == high else None)
            self._take_strut(at, has, low if low == high else None)
            self._leave_rest(f"The tendon {name}", has, "tendon", at)

    def _take_along(
        self, name: str, shares: dict[int, float], has: dict[str, Array], length: float | None
    ) -> None:
        """Take from what a length Σ c q has (numbers of each kind) all that effects are; L₀ given.

        What is taken is zero in `has` afterwards.
        """
        shares = {joint: share for joint, share in shares.items() if share}
        if not shares or not all(map(self._single, shares)):
            return
        stiffness = [0.0] if length is None else _pop(has, "stiffness")
        damping = _pop(has, "damping")
        friction, (inertia, *_) = _pop(has, "frictionloss"), _pop(has, "armature")
        if len(shares) > 1:
            for pair in combinations_with_replacement(shares, 2) if inertia else ():
                if self._in_a_chain(*pair):  # as MuJoCo's mass matrix has no other entries
                    first, second = (self._name("JOINT", joint) for joint in pair)
                    own = inertia * shares[pair[0]] * shares[pair[1]]
                    self.found.coupled_inertia.append((first, second, own))
            named = {self._name("JOINT", joint): share for joint, share in shares.items()}
            if stiffness[0] or damping[0] or friction[0]:
                numbers = (stiffness[0], length or 0.0, damping[0], friction[0])
                self.found.tendons.append(Tendon(name, named, *numbers))
            return
        ((joint, share),) = shares.items()
        powers = [0.0, 0.0] if length is None else _pop(has, "stiffnesspoly")
        spring = Spring(length or 0.0, (0.0, stiffness[0], *_two(powers)))
        if not spring.is_none:
            self._add_spring(joint, spring.through(share, 0.0))
        for power, value in enumerate((*damping[:1], *_two(_pop(has, "dampingpoly"))), start=1):
            key = "damping" if power == 1 else f"damping_{power}"
            self._add(key, joint, abs(share) ** (power + 1) * value)
        self._add("friction", joint, abs(share) * friction[0])
        self._add("armature", joint, share**2 * inertia)

    def _take_strut(self, at: int, has: dict[str, Array], length: float | None) -> None:
        """Take the spring and the damper of a tendon between two sites."""
        m, first = self.m, int(self.m.tendon_adr[at])
        wraps = range(first, first + int(m.tendon_num[at]))
        sites = [int(m.wrap_objid[k]) for k in wraps]
        kinds = {int(m.wrap_type[k]) for k in wraps}
        straight = kinds == {int(self.mujoco.mjtWrap.mjWRAP_SITE)} and len(sites) == 2
        if not straight or has["stiffness"][0] < 0.0:
            return
        (stiffness,) = [0.0] if length is None else _pop(has, "stiffness")
        (damping,) = _pop(has, "damping")
        one, two = (self._name("BODY", int(m.site_bodyid[site])) for site in sites)
        points = np.array(m.site_pos[sites[0]]), np.array(m.site_pos[sites[1]])
        strut = StatedStrut((one, two), points, stiffness, length or 0.0, damping)
        if stiffness or damping:
            self.found.struts.append(strut)
        for what in ("stiffness", "damping"):
            getattr(self.found.reference, f"tendon_{what}")[at] = 0.0

    def _in_a_chain(self, first: int, second: int) -> bool:
        """Return whether one of two joints moves the other."""
        ends = [int(self.m.jnt_bodyid[joint]) for joint in (first, second)]
        for body, other in (ends, ends[::-1]):
            while body and body != other:
                body = int(self.m.body_parentid[body])  # noqa: PLW2901
            if body == other:
                return True
        return False

    def _leave_rest(self, what: str, has: dict[str, Array], kind: str, at: int) -> None:
        """Say what of a tendon or an actuator is left, and take it out of the reference."""
        parts = [f"{key} {_list(value)}" for key, value in has.items() if value.any()]
        if parts:
            self._leave(f"{what} with {', '.join(parts)}")
        for key, value in has.items():
            if value.any() and key != "frictionloss":
                getattr(self.found.reference, f"{kind}_{key}")[at] = 0.0

    def _take_actuators(self) -> None:
        """Limits of efforts, and the armature and damping that motors add to joints."""
        m, mujoco = self.m, self.mujoco
        at_joints = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        dampers = not self._disabled(mujoco.mjtDisableBit.mjDSBL_DAMPER)
        for at in range(len(m.actuator_trntype)):
            name, on = self._name("ACTUATOR", at), int(m.actuator_trnid[at][0])
            kind, gear = int(m.actuator_trntype[at]), float(m.actuator_gear[at][0])
            has = {
                "armature": _row(m, "actuator_armature", at),
                "damping": dampers * _row(m, "actuator_damping", at),
                "dampingpoly": dampers * _row(m, "actuator_dampingpoly", at),
            }
            shares = dict[int, float]()
            if kind in at_joints and self._single(on):
                self._limit_of_motor(at, on, gear)
                shares = {on: gear}
                for power, value in zip((2, 3), _pop(has, "dampingpoly"), strict=True):
                    self._add(f"damping_{power}", on, gear**2 * value)  # not gear³, as of tendons
            elif kind == int(mujoco.mjtTrn.mjTRN_TENDON):
                pulled = fixed_tendon(m, mujoco, on)
                if all(map(self._single, pulled)):
                    shares = {joint: gear * share for joint, share in pulled.items()}
            self._take_along(name, shares, has, None)
            self._leave_rest(f"The actuator {name}", has, "actuator", at)

    def _limit_of_motor(self, at: int, joint: int, gear: float) -> None:
        m, mujoco = self.m, self.mujoco
        ranges = [m.actuator_forcerange[at]] if m.actuator_forcelimited[at] else []
        fixed = int(m.actuator_gaintype[at]) == int(mujoco.mjtGain.mjGAIN_FIXED)
        plain = int(m.actuator_biastype[at]) == int(mujoco.mjtBias.mjBIAS_NONE)
        still = int(m.actuator_dyntype[at]) == int(mujoco.mjtDyn.mjDYN_NONE)
        limited = getattr(m, "actuator_ctrllimited")  # noqa: B009, as older versions have it, too
        if fixed and plain and still and len(limited) > at and limited[at]:
            ranges.append(float(m.actuator_gainprm[at][0]) * np.asarray(m.actuator_ctrlrange[at]))
        if ranges and gear:
            self._limit(joint, min(abs(gear) * float(np.abs(each).max()) for each in ranges))

    def _take_gravcomp(self) -> None:
        """Compensation of the weight of all moving bodies alike is less gravity."""
        m, reference = self.m, self.found.reference
        if not np.any(m.body_gravcomp > 0.0) or not self.found.gravity.any():  # as MuJoCo counts
            return
        moving = [b for b in range(m.nbody) if m.body_weldid[b] and m.body_mass[b] > 0.0]
        shares = m.body_gravcomp[moving]
        by_motors = np.asarray(m.jnt_actgravcomp).astype(bool)
        if by_motors.all():
            return  # as MuJoCo counts it among the efforts of the actuators
        if len(shares) and np.ptp(shares) == 0.0 and not by_motors.any():
            self.found.gravity = self.found.gravity * (1.0 - float(shares[0]))
            self.found.notes.append(
                f"gravcomp={shares[0]:g} of all bodies is kept as that much less gravity."
            )
            return
        for body in moving:
            if m.body_gravcomp[body] and by_motors.any():
                self._leave(f"gravcomp={m.body_gravcomp[body]:g} of {self._name('BODY', body)}")
            elif m.body_gravcomp[body]:
                self.found.carried[self._name("BODY", body)] = float(m.body_gravcomp[body])
        reference.body_gravcomp[:] = 0.0

    def _take_medium(self) -> None:
        """Take what a medium does to bodies as boxes; bodies with ellipsoids are told of."""
        m, option, own = self.m, self.m.opt, self.found.reference.opt
        if not (option.density or option.viscosity):
            return
        own.density = own.viscosity = 0.0
        others = list[str]()
        for body in np.flatnonzero(m.body_weldid).tolist():
            first, mass = int(m.body_geomadr[body]), float(m.body_mass[body])
            geoms = range(first, first + int(m.body_geomnum[body]))
            if any(m.geom_fluid[geom][0] > 0.0 for geom in geoms):
                others.append(self._name("BODY", body))
            elif mass > 0.0:
                inertia = np.array(m.body_inertia[body])
                edges = np.maximum(inertia.sum() - 2.0 * inertia, _LEAST_INERTIA)
                self.found.boxes.append(
                    BoxInMedium(
                        self._name("BODY", body),
                        np.sqrt(6.0 * edges / mass),
                        pose_of(m.body_ipos[body], m.body_iquat[body]),
                        float(option.density),
                        float(option.viscosity),
                        np.array(option.wind),
                    )
                )
        if others:
            wind = f" wind={_list(option.wind)}" if np.any(option.wind) else ""
            self._leave(
                f"The medium of <option density={option.density:g} viscosity={option.viscosity:g}"
                f"{wind}>, whose drag acts on the ellipsoids of {', '.join(others)},"
            )

    def _take_equalities(self) -> None:
        m, kinds = self.m, self.mujoco.mjtEq
        names = {
            int(getattr(kinds, each)): each[5:].lower() for each in dir(kinds) if "EQ_" in each
        }
        for at in range(m.neq):
            first, second = int(m.eq_obj1id[at]), int(m.eq_obj2id[at])
            kind = names[int(m.eq_type[at])]
            sites = int(m.eq_objtype[at]) == int(self.mujoco.mjtObj.mjOBJ_SITE)
            of = {"joint": "JOINT", "tendon": "TENDON", "flex": "FLEX"}.get(kind)
            of = of or ("SITE" if sites else "BODY")
            what = " and ".join(self._name(of, each) for each in (first, second) if each >= 0)
            if not m.eq_active0[at]:
                self.found.notes.append(
                    f"<equality>: the constraint <{kind}> of {what} is not active, and not used."
                )
            elif kind == "joint" and second >= 0:
                self._follow(first, second, np.array(m.eq_data[at][:5]))
            elif kind == "joint":
                place = float(m.qpos0[m.jnt_qposadr[first]] + m.eq_data[at][0])
                self.found.of_joints["fixed"][self._name("JOINT", first)] = place
            elif kind in ("connect", "weld") and self._close(at, f"<{kind}> of {what}"):
                continue
            elif kind != "tendon" or not self._follow_tendon(first, second, m.eq_data[at][:5]):
                self._leave(
                    f"<equality>: the constraint <{kind}> of {what}, which makes a closed loop or "
                    "holds something (the robot is read as an open tree),"
                )

    def _close(self, at: int, name: str) -> bool:
        """Return whether a constraint of points or frames closes a loop of the robot.

        It does not where it holds what is free: a body on a table, say.
        """
        m = self.m
        numbers = [int(m.eq_obj1id[at]), int(m.eq_obj2id[at])]
        data, welds = (
            np.array(m.eq_data[at]),
            int(m.eq_type[at]) == int(self.mujoco.mjtEq.mjEQ_WELD),
        )
        turns = welds and float(data[10]) != 0.0  # the scale of the torque
        if int(m.eq_objtype[at]) == int(self.mujoco.mjtObj.mjOBJ_SITE):
            poses = [pose_of(m.site_pos[each], m.site_quat[each]) for each in numbers]
            numbers = [int(m.site_bodyid[each]) for each in numbers]
        elif welds:  # the second point stands first
            poses = [pose_of(data[3:6], data[6:10]), RigidTransform(data[:3])]
        else:
            poses = [RigidTransform(data[:3]), RigidTransform(data[3:6])]
        roots = [self._free_root(each) for each in numbers]
        if roots[0] != roots[1]:
            return False
        first, second = (self._name("BODY", each) if each else WORLD for each in numbers)
        closure = Closure(name, (first, second), (poses[0], poses[1]), turns)
        self.found.closures[at] = closure
        return True

    def _free_root(self, body: int) -> int:
        """Number of the free body that a body hangs from, or is; 0 for none."""
        m, free = self.m, int(self.mujoco.mjtJoint.mjJNT_FREE)
        while body:
            joints = range(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])
            if any(int(m.jnt_type[joint]) == free for joint in joints):
                return body
            body = int(m.body_parentid[body])
        return 0

    def _follow_tendon(self, first: int, second: int, data: Array) -> bool:
        """Return whether L − L₀ = a₀ + a₁ (M − M₀) of fixed tendons has a joint follow another."""
        m, known = self.m, self.found.followers
        shares = dict(fixed_tendon(m, self.mujoco, first))
        length = float(m.tendon_length0[first]) + float(data[0])
        if second >= 0:
            other = fixed_tendon(m, self.mujoco, second)
            length -= float(data[1]) * float(m.tendon_length0[second])
            shares = shares if other else {}
            for joint, share in other.items():
                shares[joint] = shares.get(joint, 0.0) - float(data[1]) * share
        shares = {joint: share for joint, share in shares.items() if share}
        if len(shares) != 2 or np.any(data[2:]) or not all(map(self._single, shares)):
            return False
        # A joint that a motor drives leads; otherwise the first.
        joints = (int(self.mujoco.mjtTrn.mjTRN_JOINT), int(self.mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        driven = {
            int(on[0])
            for on, kind in zip(m.actuator_trnid, m.actuator_trntype, strict=True)
            if int(kind) in joints
        }
        leader, own = sorted(shares, key=lambda joint: joint not in driven)
        names = self._name("JOINT", own), self._name("JOINT", leader)
        if self._follows_already(*names):
            return False
        known.append(Follower(*names, -shares[leader] / shares[own], length / shares[own]))
        return True

    def _follow(self, first: int, second: int, data: Array) -> None:
        """Take that Y − y₀ = p(x − x₀), y₀ and x₀ at the file's own pose."""
        own, leader = self._name("JOINT", first), self._name("JOINT", second)
        if self._follows_already(own, leader):
            self._leave(
                f"<equality>: the constraint <joint> of {own} and {leader}, as {own} follows a "
                f"joint already, or is followed by {leader},"
            )
            return
        starts = [float(self.m.qpos0[self.m.jnt_qposadr[j]]) for j in (first, second)]
        polynomial = np.polynomial.Polynomial(data)(np.polynomial.Polynomial([-starts[1], 1.0]))
        coefficients = np.zeros(5)
        coefficients[: len(polynomial.coef)] = polynomial.coef
        coefficients[0] += starts[0]
        if data[2:].any():
            self.found.bent.setdefault(leader, {})[own] = coefficients.tolist()
        else:
            self.found.followers.append(
                Follower(own, leader, float(coefficients[1]), float(coefficients[0]))
            )

    def _follows_already(self, own: str, leader: str) -> bool:
        """Return whether a joint follows another one, or is followed by what it would follow."""
        leaders = {follower.joint: follower.leader for follower in self.found.followers}
        leaders |= {joint: first for first, bent in self.found.bent.items() for joint in bent}
        return own in leaders or leads_back(own, leader, leaders)


def _row(m: Any, name: str, at: int) -> Array:
    """A row of a compiled model's table, (k,); zeros in versions of MuJoCo without it."""
    table = getattr(m, name, None)
    return np.zeros(2) if table is None else np.atleast_1d(np.array(table[at], float))


def _pop(has: dict[str, Array], key: str) -> list[float]:
    """Return the numbers of a kind, which are zero afterwards; none where there is no such kind."""
    values = has.get(key, np.zeros(2))
    has[key] = np.zeros_like(values)
    return [float(value) for value in values]


def _two(values: Any) -> tuple[float, float]:
    first, second = (float(value) for value in values)
    return first, second


def _list(values: Array) -> str:
    return " ".join(f"{value:g}" for value in np.atleast_1d(values))
