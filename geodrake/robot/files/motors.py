"""What model files state of motors behind transmissions.

Most logs of robots with such files are of joints all the same, so that this counts only where it
is asked for. URDF has the transmissions of ros_control, whose formulas are (reductions n_a of
actuators and n_j of joints, offsets θ₀):

    Simple:        θ = q / (n_a n_j) + θ₀
    Differential:  θ₁ = (q₁/n_a1 + q₂/n_a2) / (2 n_j1) + θ₀₁,  θ₂ the same with a difference
    FourBar:       θ₁ = q₁ / (n_j1 n_a1) + θ₀₁,  θ₂ = (q₂/n_a2 − q₁/(n_j1 n_a1)) / n_j2 + θ₀₂

MJCF has gears of actuators at joints, q = gear θ, and fixed tendons, q = gear Σ coef θ.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from geodrake.errors import ModelError
from geodrake.inertia import Array
from geodrake.robot.files.checks import numbers
from geodrake.robot.files.mjcf_source import load_mujoco
from geodrake.robot.files.mjcf_terms import actuator_shares
from geodrake.robot.transmission.statements import Coupled, Gear, Statement

_KINDS = ("SimpleTransmission", "DifferentialTransmission", "FourBarLinkageTransmission")
_REDUCTIONS = ("mechanicalReduction", "mechanical_reduction")


def urdf_motors(elements: Sequence[Element], path: Path) -> tuple[Statement, ...]:
    """Return what transmissions of a URDF state."""
    return tuple(part for e in elements for part in _transmission(e, path))


def _transmission(element: Element, path: Path) -> Iterator[Statement]:
    words = element.findtext("type") or element.findtext("plugin") or element.get("type") or ""
    kind = words.strip().rpartition("/")[2]
    if kind not in _KINDS:
        return
    what = f"{path}: the transmission {element.get('name', '')!r}"
    joints, actuators = (_in_roles(element, tag) for tag in ("joint", "actuator"))
    count = 1 if kind == "SimpleTransmission" else 2
    if len(joints) != count or len(actuators) != count:
        raise ModelError(
            f"{what} has {len(joints)} joints and {len(actuators)} actuators instead of {count}.",
            advice="Correct it there, or write a transmission file.",
        )
    names = [[e.get("name", "") for e in group] for group in (joints, actuators)]
    nj, na = ([_reduction(e, what) for e in group] for group in (joints, actuators))
    shifts = [_value(e, ("offset",), 0.0, what) for e in joints]
    (j1, *j2), (a1, *a2) = names
    if kind == "SimpleTransmission":
        yield Gear(a1, j1, na[0] * nj[0], shifts[0])
        return
    if kind == "DifferentialTransmission":
        first = {a1: 0.5 / (nj[0] * na[0]), a2[0]: 0.5 / (nj[0] * na[1])}
        second = {a1: 0.5 / (nj[1] * na[0]), a2[0]: -0.5 / (nj[1] * na[1])}
    else:
        through = 1.0 / (nj[0] * na[0])
        first = {a1: through}
        second = {a1: -through / nj[1], a2[0]: 1.0 / (nj[1] * na[1])}
    yield Coupled({j1: first, j2[0]: second}, dict(zip(names[0], shifts, strict=True)))


def mjcf_motors(m: Any, path: Path) -> tuple[Statement, ...]:
    """Return what actuators of a compiled MJCF state: gears at joints, and fixed tendons."""
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
    """Groups of joints that tendons move together, θ = C⁻¹ q of q = C θ."""
    left = dict(pulled)
    while left:
        group, joints = [next(iter(left))], set(left[next(iter(left))])
        while more := [n for n in left if n not in group and joints.intersection(left[n])]:
            group += more
            joints |= {joint for name in more for joint in left[name]}
        names = list(dict.fromkeys(joint for name in group for joint in left[name]))
        rows = [left.pop(name) for name in group]
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


def _in_roles(element: Element, tag: str) -> list[Element]:
    """Return its joints or actuators in the order of their roles, such as joint1 and joint2."""
    found = element.findall(tag)
    return sorted(found, key=lambda e: (e.get("role") or e.findtext("role") or "").strip())


def _reduction(element: Element, what: str) -> float:
    value = _value(element, _REDUCTIONS, 1.0, what)
    if not value:
        raise ModelError(f"{what} has a reduction of 0.", advice="Correct it there.")
    return value


def _value(element: Element, tags: Sequence[str], default: float, what: str) -> float:
    text = next((t for tag in tags if (t := element.findtext(tag)) is not None), None)
    value = default if text is None else float(numbers(text.strip() or "none", 1)[0])
    if not np.isfinite(value):
        raise ModelError(f"{what} has {text!r:.52}, which is no number.", advice="Correct it.")
    return value
