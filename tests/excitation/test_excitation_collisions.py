"""Collision geometry of model files, with meshes in any place, and of public robots."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from known_robots import robots
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform

from geodrake.errors import ArgumentError, ModelError
from geodrake.excitation import (
    CollisionWorld,
    DesignOptions,
    ExcitationTrajectory,
    FourierMotion,
    Objective,
    Solid,
    make_target,
    motion_limits,
)
from geodrake.excitation.collisions import read_obstacles
from geodrake.excitation.problem import make_problem
from geodrake.excitation.starts import with_ramps
from geodrake.model import load_description
from geodrake.robot import joint_names
from geodrake.robot.shapes import stl_vertices

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
SQUARES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = [face for a, b, c, d in SQUARES for face in ((a, b, c), (a, c, d))]
TRIANGLES = CORNERS[np.array(FACES)]
ARM = """<robot name="arm">
  <link name="base"/>
  <link name="head">
    <inertial><mass value="1"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="1 0 0"/><geometry><mesh filename="{place}" scale="0.1 0.2 0.3"/>
      </geometry></collision>
  </link>
  <joint name="neck" type="revolute"><parent link="base"/><child link="head"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="2"/></joint>
</robot>"""


def write_binary(path):
    facets = np.zeros(12, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    facets["corners"] = TRIANGLES
    path.write_bytes(b"solid but binary".ljust(80) + np.uint32(12).tobytes() + facets.tobytes())


def write_text(path):
    lines = ["solid cube"]
    for triangle in TRIANGLES:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"  vertex {x:e} {y} {z}" for x, y, z in triangle]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid cube"]))


def write_wavefront(path):
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    path.write_text("\n".join(lines + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]))


WRITERS = {"binary.stl": write_binary, "text.STL": write_text, "cube.obj": write_wavefront}


def arm_with_mesh(tmp_path, name, place):
    """Return an arm with a head of 0.2 × 0.4 × 0.6 m, one metre from its joint."""
    folder = tmp_path / "my robot" / "meshes"
    folder.mkdir(parents=True)
    WRITERS[name](folder / name)
    path = tmp_path / "my robot" / "urdf" / "arm.urdf"
    path.parent.mkdir()
    path.write_text(ARM.format(place=place.format(folder=folder, name=name)))
    return load_description(path)


def test_unusable_meshes(tmp_path):
    contents = b"", b"solid\nendsolid", b"vertex 1 2 x", b"vertex 1 2 3"
    for number, content in enumerate(contents):
        path = tmp_path / f"{number}.stl"
        path.write_bytes(content)
        with pytest.raises(ModelError, match=rf"{number}\.stl cannot be read"):
            stl_vertices(path)
    missing = arm_with_mesh(tmp_path, "text.STL", "../meshes/none.stl")
    with pytest.raises(
        ModelError, match=r"none\.stl cannot be used for collisions: .* does not exist"
    ):
        CollisionWorld(missing)
    missing.path.write_text(ARM.format(place="package://other/none.stl"))
    with pytest.raises(ModelError, match=r"unknown package 'other'"):
        CollisionWorld(missing)
    wall = Solid("wall", Box(1, 1, 1), RigidTransform())
    CollisionWorld(missing, obstacles=[wall], use_file=False)


def neighbours(path):
    """Return pairs of links that a joint or a weld connects."""
    joints = [
        (j.find("parent").get("link"), j.find("child").get("link"), j.get("type") == "fixed")
        for j in ElementTree.parse(path).getroot().iter("joint")
        if j.find("parent") is not None
    ]
    group = {name: name for pair in joints for name in pair[:2]}
    for parent, child, welded in joints:
        if welded:
            old, new = group[child], group[parent]
            group = {name: new if g == old else g for name, g in group.items()}
    pairs = {frozenset(pair[:2]) for pair in joints}
    return pairs | {frozenset((a, b)) for a in group for b in group if group[a] == group[b]}


@pytest.mark.parametrize(
    "name", ["panda_description/urdf/panda_collision.urdf", "ur_description/urdf/ur5_robot.urdf"]
)
def test_distances_of_public_robots_are_pinocchios(name):
    """Of meshes in STL files, whose convex hulls count, and of primitives."""
    pin, coal = pytest.importorskip("pinocchio"), pytest.importorskip("coal")
    path = robots() / name
    model = load_description(path)
    world = CollisionWorld(model, clearance=1.0)
    robot = pin.buildModelFromUrdf(str(path))
    shapes = pin.buildGeomFromUrdf(
        robot, str(path), pin.GeometryType.COLLISION, package_dirs=[str(path.parents[4])]
    )
    for shape in shapes.geometryObjects:
        if isinstance(shape.geometry, coal.BVHModelBase):
            shape.geometry.buildConvexHull(True, "Qt")
            shape.geometry = shape.geometry.convex
    near, links = neighbours(path), [s.name.rpartition("_")[0] for s in shapes.geometryObjects]
    allowed = {frozenset(note.partition(" of ")[0].split(" and ")) for note in world.notes}
    for i, first in enumerate(links):
        for j, second in enumerate(links[:i]):
            if frozenset((first, second)) not in near | allowed:
                shapes.addCollisionPair(pin.CollisionPair(j, i))
    limits = motion_limits(model)
    q = np.random.default_rng(0).uniform(limits.lower, limits.upper, (30, len(model.joints)))
    order = [joint_names(model.plant).index(joint) for joint in robot.names[1:]]
    data, found = robot.createData(), shapes.createData()
    expected = []
    for one in model.plant_positions(q):  # fingers that follow each other
        pin.computeDistances(robot, data, shapes, found, one[order])
        expected.append(min(result.min_distance for result in found.distanceResults))
    distances, _ = world.distances(q)
    apart = np.array(expected) > 1e-3  # depths of overlaps are a matter of definition
    assert apart.sum() > 3 and not apart.all()
    np.testing.assert_allclose(distances[apart], np.array(expected)[apart], atol=1e-5)
    assert (distances[~apart] < 2e-3).all()


def test_a_table_of_an_mjcf_stands_in_the_way(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco model="m"><worldbody>
        <geom name="table" type="box" size=".1 .1 .1" pos=".88 0 0"/>
        <body name="hub"><joint name="i" axis="0 0 1" range="-180 180"/><geom size=".05"/>
        <body name="arm"><joint name="j" axis="0 0 1" range="-180 180"/>
        <geom type="capsule" fromto=".4 0 0 .7 0 0" size=".05"/></body></body>
        </worldbody></mujoco>""",
        encoding="utf-8",
    )
    world = CollisionWorld(load_description(path))
    distances, names = world.distances(np.array([[0.0, 0.0], [np.pi, 0.0]]))
    assert distances[0] == pytest.approx(0.03, abs=1e-6)
    assert set(names[0].split(" and ")) == {"arm", "0_table"}
    assert distances[1] == np.inf
    ground = '<worldbody><geom name="ground" type="plane" size="1 1 1" pos="0 0 -.07"/>'
    text = path.read_text(encoding="utf-8").replace("<worldbody>", ground)
    path.write_text(text, encoding="utf-8")
    distances, names = CollisionWorld(load_description(path)).distances(np.array([[np.pi, 0.0]]))
    assert distances[0] == pytest.approx(0.02, abs=1e-6) and "0_ground" in names[0]


SCENE = """<sdf version="1.9"><model name="cell"><static>true</static><link name="shelf">
  <pose>1 0 0.5 0 0 0</pose>
  <collision name="board"><pose>0 0 0.1 0 0 0</pose>
    <geometry><box><size>0.2 0.4 0.1</size></box></geometry></collision></link></model></sdf>"""


def test_obstacles_as_people_write_them(tmp_path):
    """Nearest distances from a ball at the origin are known."""
    scene, mesh = tmp_path / "cell.sdf", tmp_path / "cube.stl"
    scene.write_text(SCENE)
    write_binary(mesh)
    texts = {
        "table=box:0.4,0.2,0.2@0.5,0,0": ("table", 0.3),
        "box:0.4,0.2,0.2@0,0,0.5,0,1.5707963,0": ("box 1", 0.3),
        "sphere:0.1@0,0.5,0": ("sphere 1", 0.4),
        "cylinder:0.2,0.6@0,0,-0.5": ("cylinder 1", 0.2),
        "floor:-0.25": ("floor 1", 0.25),
        f"{mesh}@3,0,0": ("cube", 2.0),
        f"{scene}": ("cell: board", np.hypot(0.9, 0.55)),
    }
    path = tmp_path / "ball.urdf"
    ball = '<geometry><sphere radius="0.01"/></geometry>'
    path.write_text(re.sub("<origin.*</geometry>", ball, ARM, flags=re.DOTALL))
    model = load_description(path)
    for text, (name, distance) in texts.items():
        world = CollisionWorld(model, obstacles=read_obstacles([text]), clearance=5.0)
        [(party, (least, names))] = world.nearest(np.zeros((1, 1))).items()
        assert party == name and name in names
        assert least == pytest.approx(distance - 0.01, abs=1e-6)


def test_ramps_lead_around_what_is_in_the_way(tmp_path):
    """They pass another posture, at rest at both ends, at half of the limits."""
    model = arm_with_mesh(tmp_path, "cube.obj", "../meshes/{name}")
    post = Solid("post", Sphere(0.1), RigidTransform([1.0, 0.0, 0.0]))
    limits = motion_limits(model, bounded=True)
    still = FourierMotion(4.0, 1)
    motion = ExcitationTrajectory(still, np.array([[0.6], [0.0], [0.0]]), model.joints)

    def ramped(world, stand):
        options = DesignOptions(collisions=world)
        objective = Objective(make_target(model, noise=1.0))
        problem = make_problem(objective, limits, still, options)
        return with_ramps(problem, motion, np.array([stand]))

    free = ramped(CollisionWorld(model), -0.6)
    times = np.linspace(0.0, free.length, 2001)
    q, v, vd = free.states(times)
    np.testing.assert_allclose([q[0], q[-1]], -0.6)
    assert q[1000] == pytest.approx(0.6)
    for values, most in ((v, limits.velocity), (vd, limits.acceleration)):
        assert 0.4 * most < np.abs(values).max() <= 0.5 * most + 1e-9 or np.abs(values).max() < most
        np.testing.assert_allclose(values[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.gradient(q[:, 0], times), v[:, 0], atol=2e-2)
    there = ramped(CollisionWorld(model), 0.6)
    assert there is motion
    with pytest.raises(ArgumentError, match=r"No ramp leads .* --start"):
        ramped(CollisionWorld(model, obstacles=[post]), -0.6)
