"""One random robot as a URDF and as a different but equivalent SDF, and in Pinocchio."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from geodrake import load_model
from geodrake.logs import Motion
from geodrake.model import check_dynamics

KINDS, SHARES = ("revolute", "continuous", "prismatic", "fixed"), (0.5, 0.2, 0.15, 0.15)


def words(values):
    return " ".join(repr(float(value)) for value in values)


def random_pose(rng):
    return RigidTransform(RollPitchYaw(rng.uniform(-1.5, 1.5, 3)), rng.uniform(-0.5, 0.5, 3))


def random_links(rng):
    """Return links after the first one: parent, kind of joint, pose, axis, inertia."""
    for k in range(1, rng.integers(4, 9)):
        moments = rng.uniform(0.01, 0.1, 3)
        yield {
            "parent": int(rng.integers(k)),
            "kind": "revolute" if k == 1 else str(rng.choice(KINDS, p=SHARES)),
            "X_PL": random_pose(rng),
            "axis": (axis := rng.normal(size=3)) / np.linalg.norm(axis),
            "mass": float(rng.uniform(0.2, 3.0)),
            "X_LI": random_pose(rng),
            "moments": dict(
                zip(("ixx", "iyy", "izz"), (moments.sum() - moments).tolist(), strict=True)
            ),
            "rubs": {"damping": rng.choice([0.0, 0.3]), "friction": rng.choice([0.0, 0.2])},
            "ratio": float(rng.uniform(0.5, 2.0)) if k > 2 and rng.random() < 0.2 else None,
        }


def urdf_of(links):
    def origin(X):
        angles = words(RollPitchYaw(X.rotation()).vector())
        return f'<origin xyz="{words(X.translation())}" rpy="{angles}"/>'

    text = '<link name="l0"/>'
    for k, link in enumerate(links, start=1):
        moments = " ".join(f'{key}="{value!r}"' for key, value in link["moments"].items())
        text += (
            f'<link name="l{k}"><inertial>{origin(link["X_LI"])}<mass value="{link["mass"]!r}"/>'
        )
        text += f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial></link>'
        text += f'<joint name="j{k}" type="{link["kind"]}"><parent link="l{link["parent"]}"/>'
        text += f'<child link="l{k}"/>{origin(link["X_PL"])}<axis xyz="{words(link["axis"])}"/>'
        text += '<dynamics damping="{damping}" friction="{friction}"/>'.format(**link["rubs"])
        text += '<limit lower="-2" upper="2" effort="9" velocity="9"/>'
        if link["ratio"] is not None:
            text += f'<mimic joint="j1" multiplier="{link["ratio"]!r}" offset="0.1"/>'
        text += "</joint>"
    return f'<robot name="r">{text}</robot>'


def sdf_of(links, rng):
    def pose(X, relative_to=""):
        to = f' relative_to="{relative_to}"' if relative_to else ""
        place, angles = words(X.translation()), RollPitchYaw(X.rotation()).vector()
        w, *xyz = X.rotation().ToQuaternion().wxyz()
        return (
            f"<pose{to}>{place} {words(angles)}</pose>",
            f'<pose{to} degrees="true">{place} {words(np.rad2deg(angles))}</pose>',
            f'<pose{to} rotation_format="quat_xyzw">{place} {words([*xyz, w])}</pose>',
        )[rng.integers(3)]

    poses, text = [RigidTransform()], "<link name='l0'/>"
    for k, link in enumerate(links, start=1):
        poses.append(X_WL := poses[link["parent"]] @ link["X_PL"])
        other, X_F = int(rng.integers(k)), random_pose(rng)
        text += f'<frame name="f{k}" attached_to="l{other}">{pose(X_F, f"l{other}")}</frame>'
        X_FL = (poses[other] @ X_F).inverse() @ X_WL
        where = (pose(X_WL), pose(link["X_PL"], f"l{link['parent']}"), pose(X_FL, f"f{k}"))
        moments = "".join(f"<{key}>{value!r}</{key}>" for key, value in link["moments"].items())
        text += f'<link name="l{k}">{where[rng.integers(3)]}<inertial>{pose(link["X_LI"])}'
        text += f"<mass>{link['mass']!r}</mass><inertia>{moments}</inertia></inertial></link>"
        R_OL = (poses[other].inverse() @ X_WL).rotation().matrix()
        axis = f'<xyz expressed_in="l{other}">{words(R_OL @ link["axis"])}</xyz>'
        if link["ratio"] is not None:
            axis += f'<mimic joint="j1"><multiplier>{link["ratio"]!r}</multiplier>'
            axis += "<offset>0.1</offset><reference>0</reference></mimic>"
        axis += "<limit><lower>-2</lower><upper>2</upper></limit><dynamics>"
        axis += "".join(f"<{key}>{value}</{key}>" for key, value in link["rubs"].items())
        axis = "" if link["kind"] == "fixed" else f"<axis>{axis}</dynamics></axis>"
        text += f'<joint name="j{k}" type="{link["kind"]}"><parent>l{link["parent"]}</parent>'
        text += f"<child>l{k}</child>{axis}</joint>"
    return f'<sdf version="1.11"><model name="r">{text}</model></sdf>'


@pytest.mark.parametrize("seed", range(8))
def test_twins_need_the_same_efforts(tmp_path, seed):
    rng = np.random.default_rng(seed)
    links = list(random_links(rng))
    (tmp_path / "r.urdf").write_text(urdf_of(links))
    (tmp_path / "r.sdf").write_text(sdf_of(links, rng))
    one, twin = (load_model(tmp_path / name) for name in ("r.urdf", "r.sdf"))
    at = [twin.joints.index(joint) for joint in one.joints]
    assert len(at) == len(twin.joints)
    found = check_dynamics(one, samples=4)
    assert found.holds and found.by.startswith("Pinocchio")
    motion = rng.uniform(-1.0, 1.0, (3, 5, len(at)))
    theirs = np.zeros_like(motion)
    theirs[..., at] = motion
    efforts = one.effort(Motion(*motion))
    atol = 1e-11 * np.abs(efforts).max()
    np.testing.assert_allclose(twin.effort(Motion(*theirs))[:, at], efforts, rtol=0, atol=atol)
