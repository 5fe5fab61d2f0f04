"""A quadruped of twelve joints, as a URDF."""

import numpy as np

LEGS = ("fl", "fr", "hl", "hr")
FEET = tuple(f"{leg}_foot" for leg in LEGS)
JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("roll", "pitch", "knee"))


def link_text(name: str, mass: float, size: tuple[float, float, float], z: float = 0.0) -> str:
    x, y, h = size
    inertia = mass / 12.0 * np.array([y * y + h * h, x * x + h * h, x * x + y * y])
    tensor = " ".join(f'i{a}="{v}"' for a, v in zip(("xx", "yy", "zz"), inertia, strict=True))
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {z}"/><mass value="{mass}"/>'
        f'<inertia {tensor} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint_text(name: str, parent: str, child: str, xyz: str, axis: str) -> str:
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/></joint>'
    )


def quadruped(ball: float = 0.0) -> str:
    """Return its URDF; its feet may be balls of a radius, m, a little off their frames."""
    shape = (
        '<collision><origin xyz="0.01 0 -0.01"/><geometry>'
        f'<sphere radius="{ball}"/></geometry></collision>'
        if ball
        else ""
    )
    parts = [link_text("trunk", 8.0, (0.4, 0.2, 0.1))]
    for leg in LEGS:
        x, y = 0.2 * (1 if leg[0] == "f" else -1), 0.1 * (1 if leg[1] == "l" else -1)
        parts += [
            link_text(f"{leg}_hip", 0.6, (0.08, 0.08, 0.08)),
            joint_text(f"{leg}_roll", "trunk", f"{leg}_hip", f"{x} {y} 0", "1 0 0"),
            link_text(f"{leg}_thigh", 1.0, (0.05, 0.05, 0.2), -0.1),
            joint_text(f"{leg}_pitch", f"{leg}_hip", f"{leg}_thigh", f"0 {y / 2} 0", "0 1 0"),
            link_text(f"{leg}_calf", 0.3, (0.03, 0.03, 0.2), -0.1),
            joint_text(f"{leg}_knee", f"{leg}_thigh", f"{leg}_calf", "0 0 -0.2", "0 1 0"),
            f'<link name="{leg}_foot">{shape}</link><joint name="{leg}_ankle" type="fixed">'
            f'<parent link="{leg}_calf"/><child link="{leg}_foot"/>'
            '<origin xyz="0 0 -0.2"/></joint>',
        ]
    return f'<robot name="quadruped">{"".join(parts)}</robot>'
