"""Shapes of robots: meshes of all usual formats, and messages on invalid ones."""

import os
import struct

import numpy as np
import pytest
from meshcat_pages import drawn, tracks
from pydrake.geometry import Box, Mesh

from geodrake import load_model
from geodrake.errors import ModelError
from geodrake.excitation.collisions import CollisionWorld, corners_of, solids_of_file
from geodrake.report.meshcat_scene import replay_page
from geodrake.robot.files.load_options import Given
from geodrake.robot.shapes import MOST_TRIANGLES, regular_mesh, robot_shapes, wavefront

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])

COLLADA = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
 <asset><unit name="millimeter" meter="0.001"/><up_axis>Z_UP</up_axis></asset>
 <library_geometries><geometry id="box"><mesh>
  <source id="p"><float_array id="pa" count="24">{points}</float_array><technique_common>
   <accessor source="#pa" count="8" stride="3"><param name="X" type="float"/>
   <param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>
  </source>
  <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
  {faces}
 </mesh></geometry></library_geometries>
 <library_visual_scenes><visual_scene id="s"><node><translate>10 0 0</translate>
  <rotate>0 0 1 90</rotate><node><scale>2 2 2</scale><instance_geometry url="#box"/></node>
 </node></visual_scene></library_visual_scenes>
</COLLADA>
"""
INPUTS = (
    '<input semantic="VERTEX" source="#v" offset="0"/>'
    '<input semantic="NORMAL" source="#p" offset="1"/>'
)


def polylist():
    corners = " ".join(f"{c} 0" for quad in QUADS for c in quad)
    return f"<polylist count='6'>{INPUTS}<vcount>4 4 4 4 4 4</vcount><p>{corners}</p></polylist>"


def triangles():
    corners = " ".join(f"{c} 0" for triangle in TRIANGLES for c in triangle)
    return f"<triangles count='12'>{INPUTS}<p>{corners}</p></triangles>"


def polygons():
    quads = "".join(f"<p>{' '.join(f'{c} 0' for c in quad)}</p>" for quad in QUADS)
    return f"<polygons count='6'>{INPUTS}{quads}</polygons>"


def write_stl(path, corners=CORNERS, faces=TRIANGLES):
    with path.open("wb") as file:
        file.write(bytes(80) + struct.pack("<I", len(faces)))
        for face in faces:
            file.write(struct.pack("<12fH", 0, 0, 0, *corners[face].ravel(), 0))


def surface(text):
    lines = [line.split() for line in text.splitlines()]
    vertices = np.array([line[1:] for line in lines if line[0] == "v"], float)
    corners = [[c.partition("//")[0] for c in line[1:]] for line in lines if line[0] == "f"]
    return vertices, np.array(corners, int) - 1


def volume(vertices, faces):
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("faces", [polylist, triangles, polygons])
def test_a_collada_box_has_its_unit_and_place(tmp_path, faces):
    path = tmp_path / "box.dae"
    points = " ".join(map(str, CORNERS.ravel()))
    path.write_text(COLLADA.format(points=points, faces=faces()))
    vertices, corners = surface(wavefront(path))
    assert len(vertices) == 8 and len(corners) == 12
    np.testing.assert_allclose(vertices.min(0), [0.006, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(vertices.max(0), [0.010, 0.002, 0.006], atol=1e-9)
    assert abs(volume(vertices, corners)) == pytest.approx(0.004 * 0.002 * 0.006)


def test_fine_meshes_are_drawn_more_coarsely(tmp_path):
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 161), np.linspace(0, np.pi, 81), indexing="ij")
    sphere = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], -1).reshape(-1, 3)
    k = np.arange(161 * 81).reshape(161, 81)
    a, b, c, d = k[:-1, :-1].ravel(), k[1:, :-1].ravel(), k[1:, 1:].ravel(), k[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    write_stl(tmp_path / "sphere.stl", sphere, faces)
    vertices, corners = surface(wavefront(tmp_path / "sphere.stl"))
    assert 500 < len(corners) <= MOST_TRIANGLES < len(faces)
    assert abs(volume(vertices, corners)) == pytest.approx(4 / 3 * np.pi, rel=0.02)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.dae", "<COLLADA><library_visual_scenes/></COLLADA>"),
        ("a.dae", "no xml"),
        ("a.stl", "solid nothing"),
        ("a.dae", COLLADA.format(points="1 2", faces=triangles())),
        ("a.dae", COLLADA.format(points=" ".join(["1e999"] * 24), faces=triangles())),
    ],
)
def test_meshes_that_are_none_are_refused(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(ModelError):
        wavefront(tmp_path / name)


ROBOT = """<robot name="r"><link name="base"/>
<link name="arm"><inertial><mass value="1"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>{shapes}</link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
MESH = '<{kind}><geometry><mesh filename="{file}" scale="0.5 1 1"/></geometry></{kind}>'
BOX = '<collision><geometry><box size="1 1 1"/></geometry></collision>'


def robot(tmp_path, *shapes):
    path = tmp_path / "r.urdf"
    path.write_text(ROBOT.format(shapes="".join(shapes)))
    return load_model(path)


def test_an_stl_visual_is_shown_and_hides_collisions(tmp_path):
    write_stl(tmp_path / "arm.STL")
    model = robot(tmp_path, MESH.format(kind="visual", file="arm.STL"), BOX)
    shapes = robot_shapes(model.path, model.given)
    assert not shapes.notes
    ((only,),) = shapes.links.values()
    assert isinstance(only.shape, Mesh) and only.shape.scale3()[0] == 0.5
    page = replay_page(model, np.array([0.1, 0.2]), np.array([[0.0], [0.5]]))
    assert "/drake/robot/r::arm/shapes/0" in drawn(page)
    turned = tracks(page)["/drake/robot/r::arm", "quaternion"][1]
    np.testing.assert_allclose(turned[-1], [0, 0, np.sin(0.25), np.cos(0.25)], atol=1e-9)


@pytest.mark.parametrize("name", ["both.dmd.yaml", "both.sdf"])
def test_stl_meshes_of_models_in_other_files_are_shown_and_collide(tmp_path, name):
    folder = tmp_path / "arms"
    folder.mkdir()
    write_stl(folder / "arm.stl")
    (tmp_path / "package.xml").write_text("<package><name>x</name></package>")
    places = {"visual": "package://x/arms/arm.stl", "collision": "arm.stl"}
    shapes = "".join(MESH.format(kind=kind, file=file) for kind, file in places.items())
    (folder / "r.urdf").write_text(ROBOT.format(shapes=shapes))
    add = "- add_model: {{name: {0}, file: package://x/arms/r.urdf}}\n"
    include = "<include><name>{0}</name><uri>arms/r.urdf</uri></include>"
    text = "directives:\n" + "".join(map(add.format, "ab"))
    if name.endswith("sdf"):
        inside = "".join(map(include.format, "ab"))
        text = f'<sdf version="1.9"><world name="w">{inside}</world></sdf>'
    (tmp_path / name).write_text(text)
    found, solids = robot_shapes(tmp_path / name, Given()), solids_of_file(tmp_path / name, Given())
    assert not found.notes and {*found.links} == {"a::arm", "b::arm"}
    assert all(isinstance(own.shape, Mesh) for (own,) in found.links.values())
    for link in ("a::arm", "b::arm"):
        (own,) = solids[link]
        assert corners_of(own.shape).max(axis=0) == pytest.approx([0.5, 2.0, 3.0])


def test_missing_meshes_are_said_and_collision_shapes_shown(tmp_path):
    gone = (MESH.format(kind="visual", file=f"package://nowhere/{k}.dae") for k in range(2))
    model = robot(tmp_path, *gone, BOX)
    shapes = robot_shapes(model.path, model.given)
    ((only,),) = shapes.links.values()
    assert isinstance(only.shape, Box)
    (note,) = shapes.notes
    assert "package://nowhere/0.dae (unknown package 'nowhere') and 1 more" in note
    assert note.endswith("--package nowhere=FOLDER")


def test_without_any_shape_links_are_sticks_and_the_page_says_so(tmp_path):
    model = robot(tmp_path, MESH.format(kind="visual", file="gone.stl"))
    shapes = robot_shapes(model.path, model.given)
    assert not shapes.links and "gone.stl" in shapes.notes[0]
    page = replay_page(model, np.array([0.1, 0.2]), np.zeros((2, 1)))
    assert "/drake/robot/r::arm/shapes/0" in drawn(page)
    assert "meshes that are not shown: gone.stl" in page


MJCF = """<mujoco><compiler meshdir="meshes"/><asset><mesh name="m" file="m.obj"/></asset>
<worldbody><body name="arm"><joint name="j" type="hinge"/><inertial mass="1" pos="0 0 0"
diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
EMPTY_COLLADA = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><up_axis>Z_UP</up_axis></asset><library_visual_scenes><visual_scene id="s"/>
</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
COLLIDING = MESH.format(kind="collision", file="m.{}")
FORMATS = ("stl", "dae", "obj", "gltf", "vtk")


@pytest.mark.parametrize(
    ("name", "text", "mesh"),
    [
        *(("r.urdf", ROBOT.format(shapes=COLLIDING.format(end)), f"m.{end}") for end in FORMATS),
        ("r.xml", MJCF, "meshes/m.obj"),
    ],
)
def test_a_pipe_in_the_place_of_a_mesh_is_told(tmp_path, name, text, mesh):
    path = tmp_path / name
    path.write_text(text)
    (tmp_path / "meshes").mkdir()
    os.mkfifo(tmp_path / mesh)
    assert any("is a pipe" in note for note in robot_shapes(path, Given()).notes)
    with pytest.raises(ModelError, match="is a pipe"):
        CollisionWorld(load_model(path))


@pytest.mark.parametrize(
    ("mesh", "text", "pipe"),
    [
        ("m.obj", "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n", "m.mtl"),
        ("m.gltf", '{"images": [{"uri": "a%20texture.png"}]}', "a texture.png"),
    ],
)
def test_a_pipe_behind_a_mesh_is_told(tmp_path, mesh, text, pipe):
    path = tmp_path / "r.urdf"
    path.write_text(ROBOT.format(shapes=COLLIDING.format(mesh.partition(".")[2])))
    (tmp_path / mesh).write_text(text)
    os.mkfifo(tmp_path / pipe)
    assert any(f"{pipe} is a pipe" in note for note in robot_shapes(path, Given()).notes)
    with pytest.raises(ModelError, match=f"{pipe} is a pipe"):
        CollisionWorld(load_model(path))


def test_a_texture_that_is_a_pipe_is_told(tmp_path):
    (tmp_path / "m.obj").write_text("mtllib m.mtl\nv 0 0 0\n")
    (tmp_path / "m.mtl").write_text("newmtl a\nmap_Kd -blendu on wood.png\n")
    assert regular_mesh(tmp_path / "m.obj")
    os.mkfifo(tmp_path / "wood.png")
    with pytest.raises(ModelError, match=r"wood\.png is a pipe"):
        regular_mesh(tmp_path / "m.obj")


def test_a_mesh_without_triangles_is_told(tmp_path):
    (tmp_path / "m.dae").write_text(EMPTY_COLLADA)
    with pytest.raises(ModelError, match="has no triangles"):
        wavefront(tmp_path / "m.dae")
