"""Random MJCFs of many constructs, each as geodrake reads it and as MuJoCo itself does.

A file mixes nested default classes, frames, replicates, (nested) attached models, inertias from
geoms and from numbers, total and least masses, joints of every kind with armature, damping and
springs, powers of both, tendons of joints and between points, motors, compensated gravity, media
and flags. At random states, the effort of `load_model(...).effort` is compared with `mj_inverse`
plus dry friction, both without what a note says is left out.
"""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import numpy as np

from diagrams.harness import script_parser, tell
from geodrake import load_model
from geodrake.logs.motion import Motion
from geodrake.robot.files.mjcf_source import quiet_mujoco

TOLERANCE = 1e-9
_OFF = mujoco.mjtDisableBit


class Writer:
    """Writer of a random file, and of the files that it attaches, into a folder."""

    def __init__(self, rng: np.random.Generator, folder: Path) -> None:
        self.rng, self.folder, self.count = rng, folder, 0
        self.classed = False

    def numbers(self, size: int, low: float = -1.0, high: float = 1.0) -> str:
        """Return random numbers as text."""
        return " ".join(f"{x:.4f}" for x in self.rng.uniform(low, high, size))

    def chance(self, share: float) -> bool:
        """Return true with a given probability."""
        return bool(self.rng.random() < share)

    def name(self, kind: str) -> str:
        """Return a unique name, or none."""
        self.count += 1
        return f'name="{kind}{self.count}"'

    def turn(self) -> str:
        """Return an orientation in a random notation."""
        ways = {"quat": 4, "euler": 3, "axisangle": 4, "xyaxes": 6, "zaxis": 3}
        kind = self.rng.choice(list(ways))
        high = 60.0 if kind == "euler" else 1.0
        return f'{kind}="{self.numbers(ways[kind], 0.1, high)}"'

    def classes(self, depth: int = 0) -> str:
        """Return nested default classes, some of them empty."""
        joint = self.joint_numbers() if self.chance(0.6) else ""
        parts = [f"<joint {joint}/>"] if joint else []
        if self.chance(0.5):
            parts.append(f'<geom density="{self.rng.uniform(300, 3000):.1f}"/>')
        if self.chance(0.2):
            parts.append(f'<motor gear="{self.rng.uniform(2, 9):.2f}"/>')
        if depth < 3:
            parts.append(self.classes(depth + 1))
        head = "" if depth == 0 else f' class="c{depth}"'
        return f"<default{head}>{''.join(parts)}</default>"

    def joint_numbers(self) -> str:
        """Return armature, damping, springs and friction."""
        own = []
        if self.chance(0.5):
            own.append(f'armature="{self.numbers(1, 0, 0.1)}"')
        if self.chance(0.5):
            own.append(f'damping="{self.numbers(int(self.rng.integers(1, 4)), 0, 0.5)}"')
        if self.chance(0.4):
            powers = self.rng.uniform((0, -1, -1), 3) * (1, self.chance(0.3), self.chance(0.3))
            words = (f"{x:.3f}" for x in powers)
            own.append(f'stiffness="{" ".join(words)}" springref="{self.numbers(1, -20, 20)}"')
        if self.chance(0.3):
            own.append(f'frictionloss="{self.numbers(1, 0, 0.4)}"')
        return " ".join(own)

    def geom(self) -> str:
        """Return a random shape, with a given mass or a density."""
        kind = self.rng.choice(["sphere", "capsule", "cylinder", "box", "ellipsoid"])
        mass = f'mass="{self.rng.uniform(0.1, 2):.3f}"' if self.chance(0.4) else ""
        group = 'group="3"' if self.chance(0.1) else ""
        if kind != "sphere" and self.chance(0.4):
            ends = self.numbers(6, -0.2, 0.2)
            return f'<geom type="{kind}" fromto="{ends}" size="0.04 0.03 0.1" {mass} {group}/>'
        place = f'pos="{self.numbers(3, -0.2, 0.2)}" {self.turn()}'
        size = self.numbers(3, 0.03, 0.1)
        shell = 'shellinertia="true"' if kind in ("sphere", "box") and self.chance(0.1) else ""
        return f'<geom type="{kind}" size="{size}" {place} {mass} {group} {shell}/>'

    def inertial(self) -> str:
        """Return an inertia by numbers."""
        a, b = self.rng.uniform(0.01, 0.05, 2)
        moments = f"{a:.5f} {b:.5f} {self.rng.uniform(abs(a - b) + 1e-4, a + b - 1e-4):.5f}"
        place = f'pos="{self.numbers(3, -0.1, 0.1)}" mass="{self.rng.uniform(0.2, 2):.3f}"'
        return f'<inertial {place} {self.turn()} diaginertia="{moments}"/>'

    def joint(self, kind: str) -> str:
        """Return a joint, perhaps with a zero of its own."""
        own = f'{self.name("j")} type="{kind}" pos="{self.numbers(3, -0.1, 0.1)}"'
        if kind == "ball":
            own += ' armature="0.02" damping="0.1 0 0" stiffness="0 0 0" frictionloss="0"'
            return f"<joint {own}/>"
        own += f' axis="{self.numbers(3, 0.1, 1)}" {self.joint_numbers()}'
        if self.chance(0.3):
            own += f' ref="{self.numbers(1, -10, 10)}"'
        if self.chance(0.4):
            own += ' range="-40 50"'
        if self.classed and self.chance(0.3):
            own += f' class="c{self.rng.integers(1, 4)}"'
        return f"<joint {own}/>"

    def body(self, depth: int) -> str:
        """Return a body with its contents, perhaps in frames within frames."""
        joints = [self.joint("slide" if self.chance(0.25) else "hinge")]
        if self.chance(0.2):
            joints.append(self.joint("hinge"))
        if self.chance(0.08):
            joints = [self.joint("ball")]
        inside = [*joints, self.geom(), self.inertial() if self.chance(0.4) else ""]
        inside.append(f'<site {self.name("s")} pos="{self.numbers(3, -0.2, 0.2)}"/>')
        if self.chance(0.3):
            inside.append(self.geom())
        if depth < 3:
            inside += [self.below(depth) for _ in range(int(self.rng.integers(1, 3)))]
        if self.chance(0.25):
            inside[: len(joints) + 1] = [
                f'<frame pos="{self.numbers(3)}" {self.turn()}>'
                f"<frame {self.turn()}>{''.join(inside[: len(joints) + 1])}</frame></frame>"
            ]
        child = f'childclass="c{self.rng.integers(1, 4)}"' if self.chance(0.4) else ""
        lift = ""
        if self.chance(0.2):
            lift = f'gravcomp="{self.numbers(1, -0.5, 1.5)}"'
        place = f'pos="{self.numbers(3, -0.3, 0.3)}" {self.turn()}'
        return f"<body {self.name('b')} {place} {child} {lift}>{''.join(inside)}</body>"

    def below(self, depth: int) -> str:
        """Return the children of a body: another one, many of them, or one of another file."""
        draw = self.rng.random()
        if draw < 0.15:
            return (
                f'<replicate count="2" offset="{self.numbers(3)}" euler="10 20 30">'
                f'<replicate count="2" sep="_r{self.count}_" offset="{self.numbers(3)}">'
                f"{self.body(3)}</replicate></replicate>"
            )
        if draw < 0.3:
            return f'<frame pos="{self.numbers(3)}" {self.turn()}>{self.body(depth + 1)}</frame>'
        if draw < 0.4:
            self.count += 1
            return f'<attach model="part" body="root" prefix="p{self.count}_"/>'
        return self.body(depth + 1)

    def write(self) -> Path:
        """Write the file and what it attaches."""
        inner, outer, path = (self.folder / name for name in ("in.xml", "part.xml", "robot.xml"))
        leaf = f'<body name="leaf" pos="0 0 0.1">{self.joint("hinge")}{self.geom()}</body>'
        frame = f'<frame euler="5 6 7">{leaf}</frame>'
        inner.write_text(
            f'<mujoco model="in">{self.classes()}<worldbody>{leaf}</worldbody></mujoco>'
        )
        hangs = '<attach model="in" body="leaf" prefix="q_"/>'
        root = f'<body name="root" pos="0.1 0 0">{self.geom()}{hangs}{frame}</body>'
        outer.write_text(
            '<mujoco model="part"><compiler angle="radian"/>'
            f'<asset><model name="in" file="in.xml"/></asset><worldbody>{root}</worldbody></mujoco>'
        )
        self.classed = True
        trees = "".join(self.body(0) for _ in range(int(self.rng.integers(1, 3))))
        text = (
            f'<mujoco model="robot">{self.settings()}{self.classes()}{self.second_defaults()}'
            '<asset><model name="part" file="part.xml"/></asset>'
            f"<worldbody>{self.geom()}{trees}</worldbody>"
        )
        spec = mujoco.MjSpec.from_string(
            f"{text}</mujoco>",
            include={"part.xml": outer.read_bytes(), "in.xml": inner.read_bytes()},
        )
        ball = mujoco.mjtJoint.mjJNT_BALL
        names = [joint.name for joint in spec.joints if joint.type != ball]
        sites = [site.name for site in spec.sites if "_r" not in site.name]
        path.write_text(f"{text}{self.couplings(names, sites)}</mujoco>")
        return path

    def second_defaults(self) -> str:
        """Return a second section of the main class, as an included file would have."""
        more = f'<default class="main"><joint armature="{self.numbers(1, 0, 0.1)}"/></default>'
        return more if self.chance(0.3) else ""

    def settings(self) -> str:
        """Return settings of compiler, medium and gravity."""
        compiler, option = "", ""
        if self.chance(0.2):
            compiler += ' settotalmass="7"'
        if self.chance(0.2):
            compiler += ' boundmass="0.5" boundinertia="0.01"'
        if self.chance(0.1):
            compiler += ' inertiagrouprange="0 2"'
        if self.chance(0.2):
            compiler += ' inertiafromgeom="true"'
        if self.chance(0.2):
            compiler += ' eulerseq="ZYX"'
        if self.chance(0.15):
            option = f' density="{self.numbers(1, 0, 900)}" viscosity="{self.numbers(1, 0, 2)}"'
            option += f' wind="{self.numbers(3)}"' if self.chance(0.5) else ""
        if self.chance(0.4):
            option += f' gravity="{self.numbers(3, -9, 9)}"'
        off = [f for f in ("gravity", "spring", "damper") if self.chance(0.1)]
        flags = " ".join(f'{flag}="disable"' for flag in off)
        return f"<compiler{compiler}/><option{option}><flag {flags}/></option>"

    def couplings(self, names: list[str], sites: list[str]) -> str:
        """Return tendons of joints and over several points, and motors."""
        text = ""
        if len(sites) > 1 and self.chance(0.5):
            rest = f'springlength="{self.numbers(1, 0)}"' if self.chance(0.6) else ""
            count = int(self.rng.integers(2, min(len(sites), 4) + 1))
            chosen = self.rng.choice(sites, count, replace=False)
            ends = (f'<site site="{site}"/>' for site in chosen)
            text += (
                f'<spatial stiffness="{self.numbers(1, 0, 60)}" damping="{self.numbers(1, 0, 3)}" '
                f"{rest}>{''.join(ends)}</spatial>"
            )
        names = [name for name in names if "_r" not in name]
        if not names:
            return f"<tendon>{text}</tendon>"
        one, *others = self.rng.permutation(names).tolist()
        if self.chance(0.5):
            text += (
                f'<fixed name="single" stiffness="{self.numbers(1, 0, 3)}" '
                f'springlength="{self.numbers(1, 0, 0.5)}" damping="{self.numbers(1, 0, 0.5)}" '
                f'armature="0.02"><joint joint="{one}" coef="{self.numbers(1, -2, -0.3)}"/></fixed>'
            )
        if self.chance(0.5) and others:
            count = int(self.rng.integers(2, 5))
            pulled = [one, *others][:count]
            parts = (f'<joint joint="{j}" coef="{self.numbers(1, -2)}"/>' for j in pulled)
            rest = f'springlength="{self.numbers(1)}"' if self.chance(0.6) else ""
            text += (
                f'<fixed name="several" stiffness="{self.numbers(1, 0, 3)}" {rest} '
                f'damping="{self.numbers(1, 0, 0.5)}" armature="{self.numbers(1, 0, 0.1)}">'
                f"{''.join(parts)}</fixed>"
            )
        if self.chance(0.3) and others:
            sign = self.rng.choice([1, -1])
            text += (
                f'<fixed name="pair" stiffness="3" damping="0.2" frictionloss="0.4">'
                f'<joint joint="{one}" coef="0.7"/>'
                f'<joint joint="{others[-1]}" coef="{0.7 * sign}"/></fixed>'
            )
        motors = "".join(
            f'<motor name="m_{joint}" joint="{joint}"/>' for joint in names if self.chance(0.3)
        )
        if self.chance(0.4):
            motors += f'<general joint="{one}" gear="3" armature="0.01" damping="0.1 0.2 0.3"/>'
        if self.chance(0.4) and 'name="several"' in text:
            motors += '<general tendon="several" gear="2" armature="0.02" damping="0.3"/>'
        return f"<tendon>{text}</tendon><actuator>{motors}</actuator>"


def reference(path: Path, left_out: set[str]) -> mujoco.MjModel:
    """Return MuJoCo's reading of the file, without what geodrake's models lack."""
    with quiet_mujoco():
        model = mujoco.MjModel.from_xml_path(str(path))
    for tendon in left_out:
        model.tendon_stiffness[model.tendon(tendon).id] = 0.0
    model.opt.disableflags |= int(_OFF.mjDSBL_CONSTRAINT)
    return model


def difference(path: Path, rng: np.random.Generator) -> tuple[float, int, bool]:
    """Return the largest relative difference of efforts, joints, and whether parts are left out."""
    model = load_model(path)
    left_out = set(re.findall(r"The tendon (\w+) with stiffness", " ".join(model.left_out)))
    theirs = reference(path, left_out)
    if len(model.left_out) != len(left_out):
        raise RuntimeError(f"{path}: {model.left_out} is left out.")
    count = 6
    q, v, vd = rng.uniform(-0.7, 0.7, (3, count, len(model.joints)))
    data = mujoco.MjData(theirs)
    at = [
        mujoco.mj_name2id(theirs, mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in model.single_joints
    ]
    own = list(model.single_places)
    motion = Motion(_positions(model, q), _only(v, own), _only(vd, own))
    ours, others = model.effort(motion)[:, own], np.zeros((count, len(own)))
    friction = theirs.dof_frictionloss
    for k in range(count):
        data.qpos[:] = theirs.qpos0
        data.qvel[:] = data.qacc[:] = 0.0
        for joint, place in zip(at, own, strict=True):
            data.qpos[theirs.jnt_qposadr[joint]] = q[k, place]
            data.qvel[theirs.jnt_dofadr[joint]] = v[k, place]
            data.qacc[theirs.jnt_dofadr[joint]] = vd[k, place]
        mujoco.mj_inverse(theirs, data)
        dofs = theirs.jnt_dofadr[at]
        others[k] = data.qfrc_inverse[dofs] + friction[dofs] * np.sign(data.qvel[dofs])
        for tendon in range(theirs.ntendon):
            pull = np.zeros(theirs.nv)
            for wrap in range(theirs.tendon_num[tendon]):
                wrap += theirs.tendon_adr[tendon]  # noqa: PLW2901
                pull[theirs.jnt_dofadr[theirs.wrap_objid[wrap]]] += theirs.wrap_prm[wrap]
            rubs = theirs.tendon_frictionloss[tendon] * np.sign(pull @ data.qvel)
            others[k] += rubs * pull[dofs]
    errors = np.abs(ours - others).max(0) / np.abs(others).max()
    return float(errors.max()), len(model.joints), bool(left_out)


def _only(values: np.ndarray, places: list[int]) -> np.ndarray:
    kept = np.zeros_like(values)
    kept[:, places] = values[:, places]
    return kept


def _positions(model, q: np.ndarray) -> np.ndarray:
    """Return positions in Drake's order, with balls at zero."""
    found = np.zeros((len(q), model.tree.num_positions))
    found[:, model.single_places] = q[:, model.single_places]
    return found


def run(count: int, seed: int) -> dict[str, object]:
    """Compare `count` random files."""
    rng = np.random.default_rng(seed)
    worst, joints, refused, left = 0.0, 0, 0, 0
    for _ in range(count):
        with TemporaryDirectory() as folder:
            writer = Writer(rng, Path(folder))
            path = writer.write()
            try:
                mujoco.MjSpec.from_file(str(path))
                with quiet_mujoco():
                    mujoco.MjModel.from_xml_path(str(path))
            except ValueError:
                refused += 1  # MuJoCo's limits of inertias, mostly
                continue
            found, number, left_out = difference(path, rng)
            if not found <= TOLERANCE:
                raise RuntimeError(f"{path.read_text()}\n{found:g} apart")
            worst, joints, left = max(worst, found), joints + number, left + left_out
    return {
        "files": count,
        "refused by MuJoCo": refused,
        "joints": joints,
        "files with something left out": left,
        "largest relative difference": worst,
    }


def main() -> None:
    """Compare random files, and print how far the readings differ."""
    options = script_parser(__doc__, "20 files instead of 200").parse_args()
    table = run(20 if options.quick else 200, options.seed)
    tell(options, table)


if __name__ == "__main__":
    main()
