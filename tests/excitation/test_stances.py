"""Motions of robots on their feet, against Pinocchio's dynamics without a stance."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from excitation_robots import MODELS, assert_gradient, assert_jacobian
from free_robots import FreeRobot
from quadruped import FEET as DOG_FEET
from quadruped import JOINTS, quadruped

from geodrake.effects import CoulombFriction, FittedEffect, ViscousFriction, make_effect
from geodrake.errors import ArgumentError
from geodrake.excitation import (
    DesignOptions,
    Foot,
    FourierMotion,
    FreeSamples,
    Objective,
    design_excitation,
    make_rival,
    make_separation,
    make_stance,
    make_target,
    motion_limits,
    random_excitation,
)
from geodrake.excitation.problem import make_problem
from geodrake.excitation.starts import at_rest
from geodrake.logs import Motion
from geodrake.model import load_model
from geodrake.robot.transmission.schema import (
    Coupled,
    FourBarLinkage,
    Gear,
    LinearActuator,
    PositionTable,
    drives_of,
)

BIPED = MODELS / "biped.urdf"
FEET = ("l_foot", "r_foot")
BENT = {"leg_hpy": -0.4, "leg_kny": 0.8, "leg_aky": -0.4}
FAMILY = FourierMotion(5.0, 2)
BALL = (0.01, 0.0, -0.01)  # center of the dog's feet in their frames


@cache
def biped():
    return load_model(BIPED, floating=True)


@cache
def standing(*feet, **given):
    model = biped()
    posture = [BENT.get(name[2:], 0.0) for name in motion_limits(model).joints]
    return make_stance(model, feet, **{"posture": posture} | given)


def balanced(stance):
    """Return a nearby posture in which the efforts of the motors are balanced."""
    q = stance.balanced(stance.posture[None], stance.limits())
    return stance.motor_states(np.stack([q, 0 * q, 0 * q]))[0, 0]


def few_states(stance, count=6):
    """Return some states within the limits, in balance at rest."""
    limits, rng = stance.limits(), np.random.default_rng(0)
    spread = rng.uniform(limits.lower, limits.upper, (count, len(limits.joints)))
    q = stance.balanced(spread, limits)
    v, vd = 0.3 * rng.uniform(-1.0, 1.0, (2, *q.shape)) * limits.reach
    return Motion(q, v, vd)


@cache
def designed(*feet):
    stance = standing(*feet)
    options = DesignOptions(
        samples=60, stance=stance, iterations=3, seconds=600.0, stand=balanced(stance)
    )
    target = stance.target(noise=1.0)
    return design_excitation(
        target, options=options, trajectory=FAMILY, criterion="d_optimality", seeds=1
    )


def whole_motion(stance, motion):
    """Return positions, velocities and accelerations of all joints and the base, and names."""
    robot = stance.robot
    theta, rates, accelerations, _ = stance.model.coordinates.tree_samples(
        motion.q, motion.v, motion.vd
    )
    return robot.joints, theta, rates, accelerations


@pytest.mark.parametrize("feet", [("l_foot",), FEET], ids=["one foot", "two feet"])
class TestAgainstPinocchio:
    def test_feet_stay_and_carry_the_robot(self, feet):
        """And what the motors give with the ground's forces is what the motion needs."""
        result, stance = designed(*feet), standing(*feet)
        times = np.linspace(0.0, result.executed.length, 60)
        motion = result.executed.motion(times)
        efforts = result.executed.efforts(stance.model, times)
        joints, *samples = whole_motion(stance, motion)
        engine = FreeRobot(BIPED.read_text(), joints[6:])
        motors = [joints.index(name) for name in stance.motors]
        weight = 9.81 * stance.model.phi[:, 0].sum()
        corners, middle = stance.corners, stance.corners.mean(axis=0)
        poses, wrenches = [], []
        for tau, q, v, vd in zip(efforts, *samples, strict=True):
            needed = engine.efforts(q, v, vd)
            poses.append(np.concatenate([x.ravel() for foot in feet for x in engine.pose(foot)]))
            wrenches.append(engine.wrench())
            needed[motors] -= tau
            J = np.vstack([engine.jacobian(foot) for foot in feet]).T
            left = needed - J @ np.linalg.lstsq(J, needed, rcond=None)[0]
            assert np.abs(left).max() < 1e-8 * weight
        assert np.ptp(poses, axis=0).max() < 1e-9
        nx, ny, nz, fx, fy, fz = np.array(wrenches).T
        assert (fz > 0.5 * weight).all()
        assert (np.hypot(fx, fy) <= 0.5 * fz).all()
        turning = nz + middle[1] * fx - middle[0] * fy
        assert (np.abs(turning) < 0.5 * fz * np.abs(corners - middle).max()).all()
        zmp = np.stack([-ny / fz, nx / fz], -1)
        own = stance.zero_moment_points(motion)
        np.testing.assert_allclose(own, zmp, atol=1e-9)
        inner = middle + stance.margin * (corners - middle)
        ahead = np.roll(inner, -1, axis=0) - inner
        for corner, way in zip(inner, ahead, strict=True):  # inside is on the left of each side
            off = zmp - corner
            assert (way[0] * off[:, 1] - way[1] * off[:, 0] > -1e-9).all()

    def test_gradients(self, feet):
        """Legs with friction follow the base on two feet."""
        stance, family = standing(*feet), FAMILY if len(feet) > 1 else FreeSamples(12)
        effects = (
            FittedEffect(ViscousFriction("l_leg_kny"), np.array([1.0])),
            FittedEffect(CoulombFriction("r_leg_hpy"), np.array([2.0])),
        )
        stance = replace(stance, model=replace(stance.model, effects=effects))
        options, target = DesignOptions(samples=12, stance=stance), stance.target(noise=1.0)
        problem = make_problem(Objective(target), None, family, options)
        begin = random_excitation(target, trajectory=family, options=options)
        y = problem.variables(begin.coefficients).ravel()
        for function in (problem.cost, problem.excess):
            assert_jacobian(function, y, rtol=1e-4)


def test_a_force_plate_measures_what_the_ground_gives():
    """Of one foot, the plate is a fixed robot's base sensor under the same robot, welded there."""
    stance = standing("l_foot")
    target = stance.target(noise=[0.5] * 3 + [1.5] * 3, on_plate=True)
    motion = stance.random_motion()[:20]
    wrench = target.measure(motion).regressor @ target.prior
    np.testing.assert_allclose(wrench, stance.wrenches(motion), atol=1e-9)
    assert target.rows == ("nx", "ny", "nz", "fx", "fy", "fz")
    held = stance.wrenches(at_rest(stance.posture[None]))
    np.testing.assert_allclose(held[0, 5], 9.81 * 57.5, rtol=1e-3)
    np.testing.assert_allclose(held[0, 3:5], 0.0, atol=1e-9)


class TestFeet:
    def test_soles_of_collision_geometry(self):
        """Boxes of 0.24 × 0.12 m in the file have their middle 0.04 m before the ankle."""
        stance = standing("l_foot")
        ends = np.sort(stance.corners, axis=0)
        np.testing.assert_allclose(ends[[0, -1]], [[-0.12, -0.06], [0.12, 0.06]], atol=1e-9)
        both = standing(*FEET)
        np.testing.assert_allclose(np.ptp(both.corners, axis=0), [0.24, 0.30], atol=1e-9)
        np.testing.assert_allclose(both.middle, 0.0, atol=1e-9)
        given = standing(*(Foot.sole(foot, 0.1, 0.08) for foot in FEET))
        np.testing.assert_allclose(np.ptp(given.corners, axis=0), [0.1, 0.26], atol=1e-9)

    def test_balls_are_points(self, tmp_path):
        text = BIPED.read_text()
        for name in FEET:
            at = text.index(f'<link name="{name}">')
            end = text.index("</collision>", at)
            ball = '<collision><geometry><sphere radius="0.03"/></geometry>'
            text = text[: text.index("<collision>", at)] + ball + text[end:]
        path = tmp_path / "balls.urdf"
        path.write_text(text)
        model = load_model(path, floating=True)
        with pytest.raises(ArgumentError, match="l_foot, r_foot touch the ground at a point or"):
            make_stance(model, FEET)

    @pytest.mark.parametrize(
        ("feet", "given", "message"),
        [
            ([], {}, "at least one foot"),
            (["l_hand"], {}, "no link 'l_hand' to stand on.*Links: pelvis"),
            (["l_forearm"], {}, "'l_forearm' has no collision geometry"),
            (["l_foot", "trunk"], {}, "feet are not on one plane"),
            (["l_foot"], {"friction": 0.0}, "friction"),
            (["l_foot"], {"margin": 1.5}, "margin"),
        ],
    )
    def test_what_cannot_stand(self, feet, given, message):
        with pytest.raises(ArgumentError, match=message):
            stance = standing.__wrapped__(*feet, **given)
            stance.limits()

    def test_postures_beyond_the_limits_and_held_bases(self):
        model = biped()
        names = motion_limits(model).joints
        with pytest.raises(ArgumentError, match=r"'l_leg_kny' is at -0.2, but its range is 0 to 2"):
            make_stance(model, FEET, posture=[-0.2 * (n == "l_leg_kny") for n in names])
        with pytest.raises(ArgumentError, match=r"biped\.urdf has 0"):
            make_stance(load_model(BIPED), FEET)
        with pytest.raises(ArgumentError, match="'x' has 2 points"):
            Foot("x", np.zeros((2, 3)))
        with pytest.raises(ArgumentError, match=r"has 3 points and a radius of 0\.02 m"):
            Foot("x", np.eye(3), radius=0.02)

    def test_robots_that_fall_over(self):
        """No design begins with a trunk that leans back over the heel."""
        stance = standing("l_foot")
        names = stance.motors
        back = stance.placed + 0.6 * np.array([n == "l_leg_aky" for n in names])
        options = DesignOptions(stance=stance, stand=back)
        with pytest.raises(ArgumentError, match="falls over at the robot's stand"):
            design_excitation(stance.target(noise=1.0), options=options, trajectory=FAMILY)

    def test_designs_ask_for_what_holds_the_base(self):
        with pytest.raises(ArgumentError, match="nothing supports it"):
            design_excitation(make_target(biped(), noise=1.0), trajectory=FAMILY)
        stance = standing("l_foot")
        other = make_target(replace(stance.model), noise=1.0)
        with pytest.raises(ArgumentError, match="another robot than the stance"):
            design_excitation(other, options=DesignOptions(stance=stance), trajectory=FAMILY)
        limits = motion_limits(load_model(MODELS / "arm6.urdf"), bounded=True)
        with pytest.raises(ArgumentError, match="but the motors are"):
            stance.within(limits)


class RollingDog:
    """A quadruped on balls, with a motion of its trunk, also in MuJoCo."""

    radius, rate, seconds = 0.04, 250.0, 4.0
    posture = tuple(0.6 * ("pitch" in name) - 1.2 * ("knee" in name) for name in JOINTS)

    def __init__(self, folder):
        path = folder / "dog.urdf"
        path.write_text(quadruped(self.radius))
        self.robot = load_model(path, floating=True)
        most = [dict.fromkeys(JOINTS, value) for value in (5.0, 50.0, 60.0)]
        self.limits = motion_limits(
            self.robot, velocity=most[0], acceleration=most[1], effort=most[2], bounded=True
        )
        assert self.limits.joints == JOINTS

    def stance(self, feet=DOG_FEET):
        return make_stance(self.robot, feet, posture=self.posture, limits=self.limits)

    def motion(self, stance):
        """Return the trunk's motion, that of all joints, and the motors' efforts."""
        size = np.array([0.024, 0.018, 0.012, 0.09, 0.09, 0.09])
        pace = 2.0 * np.pi / self.seconds * np.array([1, 2, 1, 1, 2, 1])
        times = np.arange(0.0, self.seconds, 1.0 / self.rate)[:, None]
        angle, phase = pace * times + np.arange(6.0), np.arange(6.0)
        q = stance.posture + size * (np.sin(angle) - np.sin(phase))
        motion = Motion(q, size * pace * np.cos(angle), -size * pace**2 * np.sin(angle))
        return motion, whole_motion(stance, motion), stance.efforts(motion)

    def compiled(self):
        """Return MuJoCo's model, which stands on the ground."""
        spec = mujoco.MjSpec.from_file(str(self.robot.path))
        spec.body("trunk").add_freejoint()
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        spec.option.timestep = 1.0 / (8 * self.rate)
        for geom in spec.geoms:
            geom.solref, geom.solimp = [4e-3, 1.0], [0.99, 0.999, 1e-3, 0.5, 2.0]
        return spec.compile()

    def lacking(self, stance, moved):
        """Return the speed of the balls' lowest points, m/s, and efforts that no force explains.

        The latter is relative to the weight.
        """
        weight = 9.81 * self.robot.total_phi[:, 0].sum()
        _, (joints, *samples), efforts = moved
        engine = FreeRobot(self.robot.path.read_text(), joints[6:])
        motors, slip, left = [joints.index(name) for name in stance.motors], 0.0, 0.0
        for q, v, vd, tau in list(zip(*samples, efforts, strict=True))[::25]:
            needed = engine.efforts(q, v, vd)
            lowest = [engine.pose(foot)[0] @ BALL - [0.0, 0.0, self.radius] for foot in DOG_FEET]
            J = np.vstack(list(map(engine.jacobian_at, DOG_FEET, lowest)))
            needed[motors] -= tau
            needed -= J.T @ np.linalg.lstsq(J.T, needed, rcond=None)[0]
            slip, left = max(slip, np.abs(J @ v).max()), max(left, np.abs(needed).max())
        return slip, left / weight

    def height_error(self, stance, moved):
        """Return how far MuJoCo's trunk is from the motion in height, the rms, m."""
        model = self.compiled()
        data, (motion, (joints, q, v, _), efforts) = mujoco.MjData(model), moved
        pose = np.array([*stance.base_columns(motion).values()]).T
        own, order = [model.joint(name) for name in JOINTS], [joints.index(n) for n in JOINTS]
        places, dofs = [joint.qposadr[0] for joint in own], [joint.dofadr[0] for joint in own]
        efforts = efforts[:, [stance.motors.index(name) for name in JOINTS]]
        data.qpos[:7], data.qpos[places] = pose[0], q[0, order]
        heights, settling = [], round(self.rate)
        for k in [0] * settling + [*range(len(q))]:
            rates = v[k, order] if len(heights) >= settling else 0.0
            for _ in range(8):
                push = 800.0 * (q[k, order] - data.qpos[places]) + 8.0 * (rates - data.qvel[dofs])
                data.qfrc_applied[dofs] = efforts[k] + push
                mujoco.mj_step(model, data)
            heights.append(data.qpos[2])
        return np.std(np.array(heights[settling:]) - pose[:, 2])


def test_feet_that_are_balls_roll(tmp_path):
    """MuJoCo's roll as planned; feet that turn about one point would slip and lift the trunk."""
    dog = RollingDog(tmp_path)
    rolling = dog.stance()
    assert [foot.radius for foot in rolling.feet] == [0.04] * 4
    turn = np.array([[np.cos(0.6), 0.0, np.sin(0.6)], [0, 1, 0], [-np.sin(0.6), 0.0, np.cos(0.6)]])
    lowest = np.array(BALL) - 0.04 * turn[:, 2]  # calves lean by 0.6 − 1.2 rad
    turning = dog.stance([Foot(foot, lowest[None]) for foot in DOG_FEET])
    both = [(stance, dog.motion(stance)) for stance in (rolling, turning)]
    (slip, left), (most_slip, most_left) = (dog.lacking(*each) for each in both)
    assert slip < 0.3 * most_slip and left < min(0.1 * most_left, 1e-3)
    error, most = (dog.height_error(*each) for each in both)
    assert error < min(0.3 * most, 1e-4)


def test_load_is_shared_by_all_motors():
    """With equal limits, efforts have the least norm that moves the robot."""
    stance = standing(*FEET)
    equal = replace(stance.motor_limits, effort=np.full(len(stance.motors), 100.0))
    stance = stance.within(equal)
    q = stance.posture[None]
    still = at_rest(q)
    tau = stance.efforts(still)[0]
    G = stance.model.coordinates.jacobian(q)[0]
    joints = stance.robot.joints
    rows = np.array([G[joints.index(name)] for name in stance.motors])
    np.testing.assert_allclose(rows.T @ tau, stance.model.effort(still)[0], atol=1e-9)
    np.testing.assert_allclose(rows @ np.linalg.lstsq(rows, tau, rcond=None)[0], tau, atol=1e-9)


DRIVES = (
    Gear(actuator="l_knee_motor", joint="l_leg_kny", ratio=-50.0, offset=0.2),
    Gear(actuator="r_leg_kny", joint="r_leg_kny", ratio=20.0),
    Coupled(joints={"l_leg_aky": {"l_a": 0.5, "l_b": 0.5}, "l_leg_akx": {"l_a": 0.3, "l_b": -0.3}}),
    LinearActuator(
        actuator="r_cylinder", joint="r_leg_aky", base=0.3, lever=0.08, length=0.3, angle=1.4
    ),
    FourBarLinkage(
        actuator="l_crank",
        joint="l_leg_hpy",
        **{"ground": 0.3, "crank": 0.1, "coupler": 0.3, "rocker": 0.12},
        **{"crank_angle": 1.5, "rocker_angle": 1.6},
    ),
)


@cache
def geared():
    drives = drives_of([(f"[{k}]", drive) for k, drive in enumerate(DRIVES)])
    return load_model(BIPED, floating=True, transmission=drives)


def geared_stance(*feet, **given):
    """Return the biped with gears in its legs, in the same posture as without."""
    robot = geared()
    bent = [[BENT.get(name[2:], 0.0) for name in robot.coordinates.joints]]
    at = dict(zip(robot.joints, robot.coordinates.nearest(np.array(bent))[0], strict=True))
    posture = [at[name] for name in motion_limits(robot).joints]
    return make_stance(robot, feet, **{"posture": posture} | given)


def left_of_efforts(stance, motion, needed, jacobians):
    """Return the largest effort at the robot's own coordinates that no force explains.

    Those needed and the Jacobians of forces are at the plant's joints, in its order.
    """
    robot, joints = stance.robot, stance.robot.coordinates
    own, worst = stance.motor_states(np.stack([motion.q, motion.v, motion.vd]))[0], 0.0
    theta = stance.model.coordinates.joint_positions(motion.q)
    q = np.stack([theta[:, joints.joints.index(n)] for n in robot.base_joints], 1)
    at = [robot.joints.index(name) for name in (*robot.base_joints, *stance.motors)]
    places = np.empty((len(q), len(at)))
    places[:, at] = np.hstack([q, own])
    found, ratios, _ = joints.along(places)
    np.testing.assert_allclose(found, theta, atol=1e-12)  # as the robot itself moves
    for J, tau, effort, rows in zip(ratios, stance.efforts(motion), needed, jacobians, strict=True):
        left = J.T @ effort
        left[at[6:]] -= tau
        forces = (rows @ J).T
        left -= forces @ np.linalg.lstsq(forces, left, rcond=None)[0]
        worst = max(worst, np.abs(left).max())
    return worst


@pytest.mark.parametrize("feet", [("r_foot",), FEET], ids=["one foot", "two feet"])
def test_legs_with_transmissions_stand(feet):
    """Gears, two motors on one ankle, a cylinder and a linkage, by Pinocchio at the joints."""
    stance = geared_stance(*feet)
    motion, coordinates = few_states(stance), stance.model.coordinates
    names = [coordinates.joints.index(name) for name in biped().joints]
    back = np.argsort(names)
    engine = FreeRobot(BIPED.read_text(), biped().joints[6:])
    *samples, _ = coordinates.tree_samples(motion.q, motion.v, motion.vd)
    needed, jacobians, poses = [], [], []
    for state in zip(*(sample[:, names] for sample in samples), strict=True):
        needed.append(engine.efforts(*state)[back])
        jacobians.append(np.vstack([engine.jacobian(foot) for foot in feet])[:, back])
        poses.append(np.concatenate([x.ravel() for foot in feet for x in engine.pose(foot)]))
    assert np.ptp(poses, axis=0).max() < 1e-12
    assert left_of_efforts(stance, motion, needed, jacobians) < 1e-9
    check_excess(stance, motion)


def check_excess(stance, motion):
    """The gradient of what is beyond the limits is that of differences."""
    width = np.full(motion.q.shape[1], 1)
    gradient = stance.excess(motion, width)[1]

    def excess(there):
        return stance.excess(there, width)[0]

    assert_gradient(excess, motion, gradient, rtol=1e-4, step=1e-6)


def pantographs():
    """Return an MJCF of a trunk on three legs, whose lower parts rods move from the trunk."""
    legs, ends = [], []
    for k, place in enumerate(("0.25 0 0", "-0.2 0.2 0", "-0.2 -0.2 0")):
        inertial = '<inertial mass=".4" pos="0 0 -.1" diaginertia=".002 .002 .001"/>'
        hinge = '<joint name="{0}{1}" type="hinge" axis="{2}" range="-2 2"/>'.format
        lower = (
            f'<body name="lower{k}" pos="0 0 -.25">{hinge("lower", k, "0 1 0")}{inertial}'
            f'<body name="foot{k}" pos="0 0 -.25"/></body>'
        )
        rod = f'<body name="rod{k}" pos=".06 0 0">{hinge("rod", k, "0 1 0")}{inertial}</body>'
        legs.append(
            f'<body name="hip{k}" pos="{place}">{hinge("roll", k, "1 0 0")}{inertial}'
            f'<body name="upper{k}">{hinge("pitch", k, "0 1 0")}{inertial}{lower}</body>'
            f'<body name="crank{k}">{hinge("crank", k, "0 1 0")}{inertial}{rod}</body></body>'
        )
        ends.append(f'<connect body1="rod{k}" body2="lower{k}" anchor="0 0 -.25"/>')
    motors = [f'<motor joint="{n}{k}"/>' for k in range(3) for n in ("roll", "pitch", "crank")]
    return (
        '<mujoco model="r"><compiler angle="radian"/><worldbody><body name="trunk"><freejoint/>'
        '<inertial mass="6" pos="0 0 0" diaginertia=".05 .08 .1"/>'
        f"{''.join(legs)}</body></worldbody><equality>{''.join(ends)}</equality>"
        f"<actuator>{''.join(motors)}</actuator></mujoco>"
    )


def test_legs_with_closed_loops_stand(tmp_path):
    """At rest in MuJoCo, forces of loops and of the ground explain all but the motors' efforts."""
    (tmp_path / "r.xml").write_text(pantographs())
    robot, feet = load_model(tmp_path / "r.xml", floating=True), [f"foot{k}" for k in range(3)]
    motors = tuple(name for name in robot.joints if name not in robot.base_joints)
    bent = [{"pitch": 0.6, "crank": -0.6}.get(name[:-1], 0.1) for name in motors]
    most = [dict.fromkeys(motors, value) for value in (5.0, 50.0, 60.0)]
    limits = motion_limits(
        robot, velocity=most[0], acceleration=most[1], effort=most[2], bounded=True
    )
    points = [Foot(foot, np.zeros((1, 3))) for foot in feet]
    stance = make_stance(robot, points, posture=bent, limits=limits)
    assert stance.motors == motors and len(stance.following) == 9
    motion = few_states(stance)
    check_excess(stance, motion)
    motion = at_rest(motion.q)
    m = mujoco.MjModel.from_xml_path(str(robot.path))
    data, pose = mujoco.MjData(m), np.array([*stance.base_columns(motion).values()]).T
    theta, joints = stance.model.coordinates.joint_positions(motion.q), robot.coordinates.joints
    dofs, places = [m.joint(name).dofadr[0] for name in motors], []
    for base, q, tau in zip(pose, theta, stance.efforts(motion), strict=True):
        data.qpos[:7] = base
        for k in range(1, m.njnt):
            data.qpos[m.jnt_qposadr[k]] = q[joints.index(m.joint(k).name)]
        mujoco.mj_forward(m, data)
        assert data.ne == 9 and np.abs(data.efc_pos[:9]).max() < 1e-9
        left, rows = data.qfrc_bias.copy(), [data.efc_J.reshape(-1, m.nv)[:9]]
        left[dofs] -= tau
        for foot in feet:
            rows.append(np.zeros((3, m.nv)))
            mujoco.mj_jacBody(m, data, rows[-1], None, m.body(foot).id)
        J = np.vstack(rows).T
        assert np.abs(left - J @ np.linalg.lstsq(J, left, rcond=None)[0]).max() < 1e-7
        places.append(np.array([data.body(foot).xpos for foot in feet]))
    assert np.ptp(places, axis=0).max() < 1e-9 < np.ptp(theta, axis=0).min()


def test_motors_keep_their_speed_where_the_base_moves_along_one_axis():
    stance = standing(*FEET)
    limits, motors, h = stance.limits(), stance.motor_limits.velocity, 1e-6
    q = np.random.default_rng(1).uniform(limits.lower, limits.upper, (100, len(limits.joints)))
    for axis in np.flatnonzero(np.isin(limits.joints, stance.robot.base_joints)).tolist():
        step = h * np.eye(len(limits.joints))[axis]
        ahead, behind = (stance.coordinates.joint_positions(q + s * step) for s in (1, -1))
        speeds = np.abs(ahead - behind) / (2.0 * h) * limits.velocity[axis]
        assert (speeds / motors).max() < 1.1, limits.joints[axis]


def test_legs_that_follow_tables_cannot_stand():
    drive = PositionTable(
        actuator="m", joint="l_leg_kny", actuator_positions=[-9, 0, 9], joint_positions=[-3, 0, 3]
    )
    robot = load_model(BIPED, floating=True, transmission=drives_of([("[0]", drive)]))
    with pytest.raises(ArgumentError, match=r"formula: l_leg_kny \(of m\)\. .* without that"):
        make_stance(robot, ["l_foot"])


@pytest.mark.parametrize("place", ["l_leg_kny", "back_bkz"])
def test_effects_are_told_apart_on_two_feet(place):
    """One leg follows the base, one motor does not, and efforts are those of motors."""
    stance, names = standing(*FEET), ("coulomb_friction", "viscous_friction")
    limits = stance.motor_limits
    rivals = [make_rival(name, stance.robot, limits, where=[place]) for name in names]
    width = 0.02 * stance.limits().velocity
    separation = make_separation(stance.model, *rivals, noise=1.0, sign_width=width, stance=stance)
    assert {pair.truth for pair in separation.pairs} == {*names}
    motion = few_states(stance, 12)
    gradient = separation.value_and_gradient(motion)[1]

    def value(there):
        return separation.value_and_gradient(there)[0]

    assert_gradient(value, motion, gradient, rtol=1e-4)
    seen = stance.model.motion(motion, sign_width=width)
    rubbing = FittedEffect(make_effect("viscous_friction", (place,)), np.array([2.0]))
    added = replace(stance, model=replace(stance.model, effects=(rubbing,)))
    at = stance.motors.index(place)
    speeds = stance.motor_states(np.stack([motion.q, motion.v, motion.vd]))[1][:, at]
    more = added.efforts(motion) - stance.efforts(motion)
    G = stance.coordinates.jacobian(motion.q)
    expected = 2.0 * speeds[:, None] * G[:, at]
    np.testing.assert_allclose(
        (np.swapaxes(G, 1, 2) @ more[..., None])[..., 0], expected, atol=1e-9
    )
    np.testing.assert_allclose(rubbing.effect.regressor(seen)[..., 0] * 2.0, expected, atol=1e-9)
