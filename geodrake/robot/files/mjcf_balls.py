"""Ball joints of closed loops in an MJCF as three hinges, as a loop's joints have one coordinate.

The last hinge turns about the way to the point at which the loop is closed: a rod with balls at
both ends turns about itself, which moves nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np

from geodrake.inertia import Array

_COPIED = ("armature", "frictionloss", "damping")  # which is not quite the same
_LOST = ("stiffness",)
_SUFFIXES = ("_1", "_2", "_spin")


def split_balls(
    spec: Any, m: Any, mujoco: ModuleType, unused: Callable[[str], str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Put three hinges in the place of ball joints of closed loops.

    Returns:
        Sentences on them, and on what of them is lost by that.

    Args:
        spec: MuJoCo's editable model; changed where there are such joints.
    """
    balls, said, lost = _balls(m, mujoco), list[str](), list[str]()
    for joint, axis in balls.items():
        name = mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_JOINT, joint)
        body = mujoco.mj_id2name(m, mujoco.mjtObj.mjOBJ_BODY, int(m.jnt_bodyid[joint]))
        old = next(each for each in spec.joints if each.name == name)
        across = np.linalg.svd(axis[None])[2][1:]
        names, of_ball = [unused(f"{name}{suffix}") for suffix in _SUFFIXES], dict[str, Any]()
        for key in (*_COPIED, *_LOST):
            of_ball[key] = np.array(getattr(old, key), float)
        place, holder = np.array(old.pos), next(b for b in spec.bodies if b.name == body)
        spec.delete(old)
        for own, direction in zip(names, (*across, axis), strict=True):
            hinge = holder.add_joint(
                name=own, type=mujoco.mjtJoint.mjJNT_HINGE, axis=direction, pos=place
            )
            for key in _COPIED:
                setattr(hinge, key, of_ball[key] if of_ball[key].ndim else float(of_ball[key]))
        said.append(
            f"The ball joint {name} of a closed loop is read as the hinges {', '.join(names)}."
        )
        for key in (key for key, value in of_ball.items() if value.any()):
            how = (
                "is left out" if key in _LOST else "is that of each hinge, which is about the same"
            )
            lost.append(f"The {key} of the ball joint {name} of a closed loop {how}.")
    return tuple(said), tuple(lost)


def _balls(m: Any, mujoco: ModuleType) -> dict[int, Array]:
    """Number of a ball joint of a closed loop -> axis in its body to where the loop is closed."""
    data, found = mujoco.MjData(m), dict[int, Array]()
    mujoco.mj_kinematics(m, data)
    kinds = int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)
    for at in range(m.neq):
        if not m.eq_active0[at] or int(m.eq_type[at]) not in kinds:
            continue
        bodies = [int(m.eq_obj1id[at]), int(m.eq_obj2id[at])]
        if int(m.eq_objtype[at]) == int(mujoco.mjtObj.mjOBJ_SITE):
            end = np.array(data.site_xpos[bodies[0]])
            bodies = [int(m.site_bodyid[each]) for each in bodies]
        else:
            first = int(m.eq_type[at]) == kinds[0]  # whose first point is that of the first body
            R = data.xmat[bodies[0]].reshape(3, 3)
            end = data.xpos[bodies[0]] + R @ m.eq_data[at][slice(0, 3) if first else slice(3, 6)]
        chains = [_chain(m, body) for body in bodies]
        for body in set(chains[0]) ^ set(chains[1]):
            joint = int(m.body_jntadr[body])
            ball = int(m.body_jntnum[body]) == 1 and int(m.jnt_type[joint]) == int(
                mujoco.mjtJoint.mjJNT_BALL
            )
            if ball:
                arm = data.xmat[body].reshape(3, 3).T @ (end - data.xanchor[joint])
                size = float(np.linalg.norm(arm))
                found[joint] = arm / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    return found


def _chain(m: Any, body: int) -> list[int]:
    found = []
    while body:
        found.append(body)
        body = int(m.body_parentid[body])
    return found
