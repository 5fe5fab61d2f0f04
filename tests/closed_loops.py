"""Robots with closed loops as MJCF, and their constrained dynamics by MuJoCo."""

from dataclasses import dataclass

import mujoco
import numpy as np

JOINT = '<joint name="{0}" type="hinge" axis="0 1 0" {1}/>'


def body(name, pos, joint, inertial, children="", extra=""):
    mass, com, moments = inertial
    return (
        f'<body name="{name}" pos="{pos}">{JOINT.format(joint, extra)}'
        f'<inertial mass="{mass}" pos="{com}" diaginertia="{moments}"/>{children}</body>'
    )


def mjcf(bodies, equality, motors, head=""):
    driven = "".join(f'<motor joint="{joint}"/>' for joint in motors.split())
    return (
        f'<mujoco model="r"><compiler angle="radian"/>{head}<worldbody>{bodies}</worldbody>'
        f"<equality>{equality}</equality><actuator>{driven}</actuator></mujoco>"
    )


CONNECT = '<connect body1="coupler" body2="rocker" anchor="0.25 0 0.1"/>'


def four_bar(equality=CONNECT, motors="crank", rocker='damping=".1" armature=".01"', mass=1.1):
    coupler = body(
        "coupler", "0.1 0 0", "coupler", (0.8, ".15 .01 .02", ".003 .004 .0025"),
        extra='damping=".02"',
    )  # fmt: skip
    crank = body("crank", "0 0 0", "crank", (0.5, ".05 0 .01", ".001 .002 .0015"), coupler)
    spring = 'stiffness="2" springref="0.2"'
    other = body(
        "rocker", "0.3 0 -0.1", "rocker", (mass, ".02 0 .1", ".005 .004 .0035"),
        extra=f"{spring} {rocker}",
    )  # fmt: skip
    return mjcf(crank + other, equality, motors)


def finger(side, sign):
    tip = body(
        f"{side}_tip", "0 0 .05", f"{side}_tip", (0.08, f"{sign * 0.005} 0 .02", "2e-5 2e-5 1e-5")
    )
    crank = body(
        f"{side}_crank", f"{-sign * 0.03} 0 .05", side, (0.05, "0 0 .025", "1e-5 1e-5 1e-5"), tip,
        'damping=".01"',
    )  # fmt: skip
    return crank + body(
        f"{side}_bar", f"{-sign * 0.05} 0 .05", f"{side}_bar", (0.03, "0 0 .025", "1e-5 1e-5 1e-5"),
        extra='damping=".002"',
    )  # fmt: skip


def gripper(polynomial="0 -1 0 0 0"):
    """Return an arm with a hand, whose two fingers on parallelograms move together."""
    hand = (
        '<body name="hand" pos="0 0 .4"><inertial mass=".6" pos="0 0 .03" '
        f'diaginertia=".001 .001 .001"/>{finger("left", 1)}{finger("right", -1)}</body>'
    )
    arm = body("arm", "0 0 .5", "arm", (2, "0 0 .2", ".02 .02 .01"), hand)
    ends = "".join(
        f'<connect body1="{side}_bar" body2="{side}_tip" anchor="0 0 .05"/>'
        for side in ("left", "right")
    )
    tie = f'<joint joint1="right" joint2="left" polycoef="{polynomial}"/>'
    return mjcf(arm, ends + tie, "arm left")


def leg():
    """Return a leg with two springs, a rod between balls, and a flat linkage."""
    foot = body("foot", ".4 0 .02", "foot", (0.3, ".02 0 -.03", "5e-4 8e-4 6e-4"))
    plantar = body("plantar", ".03 .01 -.05", "plantar", (0.2, ".18 0 0", "1e-4 2e-3 2e-3"))
    crank = body(
        "crank", ".06 .02 0", "crank", (0.15, ".01 0 -.02", "1e-4 1e-4 1e-4"), plantar,
        'armature=".01"',
    )  # fmt: skip
    heel = body(
        "heel", "-.04 .02 .05", "heel", (0.15, "-.01 0 0", "1e-4 1e-4 1e-4"),
        extra='stiffness="1250"',
    )  # fmt: skip
    tarsus = body(
        "tarsus", ".25 0 -.35", "tarsus", (0.9, ".1 .01 .05", ".002 .01 .01"), heel + crank + foot,
        'damping=".1"',
    )  # fmt: skip
    shin = body(
        "shin", ".06 0 -.06", "shin", (0.6, ".1 0 -.2", ".01 .01 .001"), tarsus, 'stiffness="1500"'
    )
    knee = body(
        "knee", ".1 0 -.3", "knee", (0.8, ".02 0 -.02", ".002 .003 .002"), shin, 'armature=".03"'
    )
    rod = (
        '<body name="rod" pos=".03 .05 -.25"><joint name="rod" type="ball"/>'
        '<inertial mass=".17" pos=".15 -.01 -.2" diaginertia=".011 .012 .004"/></body>'
    )
    thigh = body("thigh", "0 0 1", "hip", (5, ".05 .01 -.1", ".05 .06 .02"), knee + rod)
    ends = (
        '<connect body1="rod" body2="heel" anchor=".31 -.02 -.41"/>'
        '<connect body1="plantar" body2="foot" anchor=".35 0 .02"/>'
    )
    return mjcf(thigh, ends, "hip knee crank")


LEG = {  # link -> its parent, its place there, and its inertia, as in `leg`
    "hip": ("base", (0, 0, 1), (5, ".05 .01 -.1", ".05 .06 .02")),
    "knee": ("hip", (0.1, 0, -0.3), (0.8, ".02 0 -.02", ".002 .003 .002")),
    "shin": ("knee", (0.06, 0, -0.06), (0.6, ".1 0 -.2", ".01 .01 .001")),
    "tarsus": ("shin", (0.25, 0, -0.35), (0.9, ".1 .01 .05", ".002 .01 .01")),
    "heel": ("tarsus", (-0.04, 0.02, 0.05), (0.15, "-.01 0 0", "1e-4 1e-4 1e-4")),
    "crank": ("tarsus", (0.06, 0.02, 0), (0.15, ".01 0 -.02", "1e-4 1e-4 1e-4")),
    "plantar": ("crank", (0.03, 0.01, -0.05), (0.2, ".18 0 0", "1e-4 2e-3 2e-3")),
    "foot": ("tarsus", (0.4, 0, 0.02), (0.3, ".02 0 -.03", "5e-4 8e-4 6e-4")),
    "rod": ("hip", (0.03, 0.05, -0.25), (0.17, ".15 -.01 -.2", ".011 .012 .004")),
}


def leg_sdf(rod="ball"):
    """Return `leg` as SDF without armature, whose rod has a joint of a kind at the thigh."""
    places, links, joints = {"base": np.zeros(3)}, [], []
    limit, stiff = "<limit><effort>9</effort></limit>", {"shin": 1500, "heel": 1250}
    for name, (parent, place, inertial) in LEG.items():
        places[name] = places[parent] + place
        links.append((f"{name}_link", " ".join(map(str, places[name])), inertial))
        terms = limit if name in ("hip", "knee", "crank") else ""
        terms += dynamics(spring_stiffness=stiff[name]) if name in stiff else ""
        terms += dynamics(damping=0.1) if name == "tarsus" else ""
        ends = parent if parent == "base" else f"{parent}_link", f"{name}_link"
        kind, axis = (rod, "1 0 0") if name == "rod" else ("revolute", "0 1 0")
        joints.append((name, kind, ends, " ".join(map(str, place)), axis, terms))
    pins = {"heel": ("rod", ".31 -.02 -.41"), "foot": ("plantar", ".35 0 .02")}
    for child, (parent, place) in pins.items():
        ends = f"{parent}_link", f"{child}_link"
        joints.append((f"{child}_pin", "ball", ends, place, "", ""))
    second = "<axis><xyz>1 0 0</xyz><dynamics><damping>.3</damping><friction>.2</friction>"
    second += "</dynamics></axis><axis2><xyz>0 1 0</xyz><dynamics><damping>.4</damping></dynamics>"
    return sdf(links, joints).replace("<axis><xyz>1 0 0</xyz></axis>", f"{second}</axis2>")


@dataclass
class Constrained:
    """MuJoCo's model of a text, with its constraints as equations.

    Attributes:
        m: The compiled model.
        free: (n,) independent velocities.
    """

    m: object
    free: np.ndarray

    @classmethod
    def of(cls, text, free):
        m = mujoco.MjModel.from_xml_string(text)
        return cls(m, np.array([m.joint(name).dofadr[0] for name in free]))

    def closed(self, qpos):
        """Return the nearest positions at which all equalities hold, and G (nv, n)."""
        data, m = mujoco.MjData(self.m), self.m
        data.qpos[:] = qpos
        others = [k for k in range(m.nv) if k not in self.free]
        for _ in range(20):
            J, c = self.equations(data)
            if np.abs(c).max() < 1e-15:
                break
            step = np.zeros(m.nv)
            step[others] = -np.linalg.lstsq(J[:, others], c, rcond=None)[0]
            mujoco.mj_integratePos(m, data.qpos, step, 1.0)
        J, c = self.equations(data)
        assert np.abs(c).max() < 1e-12
        G = np.zeros((m.nv, len(self.free)))
        G[self.free] = np.eye(len(self.free))
        G[others] = -np.linalg.lstsq(J[:, others], J[:, self.free], rcond=None)[0]
        return np.array(data.qpos), G

    def equations(self, data):
        """Return J and c of the equalities."""
        mujoco.mj_fwdPosition(self.m, data)
        own = data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        J = np.array(data.efc_J).reshape(-1, self.m.nv)[own]
        return J, np.array(data.efc_pos)[own]

    def bias(self, qpos, G, v, step=1e-5):
        """Return Ġ v (nv,) by differences along the motion."""
        there = []
        for sign in (1.0, -1.0):
            moved = np.array(qpos)
            mujoco.mj_integratePos(self.m, moved, G @ v, sign * step)
            there.append(self.closed(moved)[1])
        return (there[0] - there[1]) @ v / (2.0 * step)

    def inverse(self, qpos, qvel, qacc):
        """Return efforts (nv,) of the open tree, with springs, damping and armature."""
        data, flags = mujoco.MjData(self.m), self.m.opt.disableflags
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos, qvel, qacc
        self.m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        mujoco.mj_inverse(self.m, data)
        self.m.opt.disableflags = flags
        return np.array(data.qfrc_inverse)

    def acceleration(self, qpos, qvel, effort):
        """Return q̈ (nv,) under efforts (nv,), from M q̈ + Jᵀ λ = τ − h and J q̈ = −J̇ q̇."""
        m, h = self.m, 1e-6
        data = mujoco.MjData(m)
        data.qpos[:] = qpos
        J, _ = self.equations(data)
        rates = []
        for sign in (1.0, -1.0):
            near = mujoco.MjData(m)
            near.qpos[:] = qpos
            mujoco.mj_integratePos(m, near.qpos, qvel, sign * h)
            rates.append(self.equations(near)[0] @ qvel)
        still = np.zeros(m.nv)
        drift = self.inverse(qpos, qvel, still)
        M = np.array([self.inverse(qpos, qvel, e) - drift for e in np.eye(m.nv)]).T
        K = np.block([[M, J.T], [J, np.zeros((len(J), len(J)))]])
        right = np.concatenate([effort - drift, -(rates[0] - rates[1]) / (2.0 * h)])
        return np.linalg.lstsq(K, right, rcond=1e-12)[0][: m.nv]


def sdf(links, joints):
    """Return an SDF of links (name, place, inertial) and of joints with type, ends and terms."""
    text = '<link name="base"/><joint name="fixed" type="fixed"><parent>world</parent>'
    text += "<child>base</child></joint>"
    for name, place, (mass, com, moments) in links:
        xx, yy, zz = moments.split()
        text += (
            f'<link name="{name}"><pose>{place} 0 0 0</pose><inertial><pose>{com} 0 0 0</pose>'
            f"<mass>{mass}</mass><inertia><ixx>{xx}</ixx><iyy>{yy}</iyy><izz>{zz}</izz></inertia>"
            "</inertial></link>"
        )
    for name, kind, (parent, child), place, axis, terms in joints:
        moves = "" if kind in ("ball", "fixed") else f"<axis><xyz>{axis}</xyz>{terms}</axis>"
        text += (
            f'<joint name="{name}" type="{kind}"><pose relative_to="{parent}">{place} 0 0 0</pose>'
            f"<parent>{parent}</parent><child>{child}</child>{moves}</joint>"
        )
    return f'<sdf version="1.9"><model name="r">{text}</model></sdf>'


BARS = (
    ("crank_link", "0 0 0", (0.5, ".05 0 .01", ".001 .002 .0015")),
    ("coupler_link", "0.1 0 0", (0.8, ".15 .01 .02", ".003 .004 .0025")),
    ("rocker_link", "0.3 0 -0.1", (1.1, ".02 0 .1", ".005 .004 .0035")),
)


def dynamics(**terms):
    words = "".join(f"<{name}>{value}</{name}>" for name, value in terms.items())
    return f"<dynamics>{words}</dynamics>"


def four_bar_sdf(pin=("revolute", ""), limits=None):
    """Return `four_bar` as SDF with a joint that closes the loop, without armature."""
    rocker = dynamics(damping=0.1, spring_stiffness=2, spring_reference=0.2)
    joints = [
        ("crank", "revolute", ("base", "crank_link"), "0 0 0", ""),
        ("coupler", "revolute", ("crank_link", "coupler_link"), "0.1 0 0", dynamics(damping=0.02)),
        ("rocker", "revolute", ("base", "rocker_link"), "0.3 0 -0.1", rocker),
        ("pin", pin[0], ("coupler_link", "rocker_link"), "0.25 0 0.1", pin[1]),
    ]
    limit = "<limit><effort>{}</effort></limit>"
    effort = {name: limit.format(value) for name, value in (limits or {}).items()}
    return sdf(BARS, [(*own, "0 1 0", terms + effort.get(own[0], "")) for *own, terms in joints])


def underactuated():
    """Return a hand of two coupled fingers of four joints each, one of which springs hold."""

    def side(name, sign):
        coupler = body(
            f"{name}_coupler", "0 .0315 -.0041", f"{name}_coupler",
            (0.014, "0 .003 .0232", "4e-6 3.5e-6 9e-7"),
        )  # fmt: skip
        driver = body(
            f"{name}_driver", f"0 {sign * 0.0306} .0549", name,
            (0.009, "0 .0177 .001", "1.7e-6 1.6e-6 3.2e-7"), coupler,
            'range="0 .8" armature=".005" damping=".1"',
        )  # fmt: skip
        follower = body(
            f"{name}_follower", "0 .055 .0375", f"{name}_follower",
            (0.0125, "0 -.011 .0125", "2.7e-6 2.5e-6 6e-7"),
        )  # fmt: skip
        spring = body(
            f"{name}_bar", f"0 {sign * 0.0132} .0609", f"{name}_bar",
            (0.022, "0 .018 .0213", "9e-6 6.7e-6 2.6e-6"), follower,
            'range="-.29 .8" stiffness=".05" springref="2.62" damping=".00125"',
        )  # fmt: skip
        turned = "" if sign > 0 else ' quat="0 0 0 1"'
        text = (driver + spring).replace('axis="0 1 0"', 'axis="1 0 0"')
        return text.replace('.0549"', f'.0549"{turned}').replace('.0609"', f'.0609"{turned}')

    hand = (
        '<body name="hand"><inertial mass=".78" pos="0 0 .035" diaginertia="3e-4 2e-4 1.5e-4"/>'
        f"{side('right', 1)}{side('left', -1)}</body>"
    )
    ends = "".join(
        f'<connect body1="{name}_follower" body2="{name}_coupler" anchor="0 -.024 .0115"/>'
        for name in ("right", "left")
    )
    tie = '<joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/>'
    text = mjcf(hand, ends + tie, "")
    shares = "".join(f'<joint joint="{name}" coef=".5"/>' for name in ("right", "left"))
    split = f'<fixed name="split">{shares}</fixed>'
    motor = '<actuator><motor tendon="split"/></actuator>'
    return text.replace("<actuator></actuator>", f"<tendon>{split}</tendon>{motor}")
