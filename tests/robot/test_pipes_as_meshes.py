"""Meshes and what they name: a pipe or a device among them is told, never waited for."""

import json
import os

import pytest

from geodrake import load_model
from geodrake.errors import ModelError
from geodrake.excitation.collisions import CollisionWorld
from geodrake.robot.files.given import Given
from geodrake.robot.mesh_files import check_mesh
from geodrake.robot.shapes import robot_shapes

URDF = """<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><mesh filename="{place}"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
MJCF = """<mujoco><compiler meshdir="meshes"/><asset><mesh name="m" file="m.obj"/></asset>
<worldbody><body name="arm"><joint name="j" type="hinge"/><inertial mass="1" pos="0 0 0"
diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""
FORMATS = ("stl", "dae", "obj", "gltf", "vtk")
OBJ = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"


@pytest.mark.parametrize(
    ("name", "text", "mesh"),
    [
        *(("r.urdf", URDF.format(place=f"m.{end}"), f"m.{end}") for end in FORMATS),
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


@pytest.mark.parametrize("included", [False, True])
def test_a_pipe_of_an_sdf_is_told_where_it_would_give_an_inertia(tmp_path, included):
    link = f"""<link name="l"><inertial auto="true"/><collision name="c"><geometry><mesh>
<uri>file://{tmp_path}/m.obj</uri></mesh></geometry></collision></link>"""
    model = f'<sdf version="1.11"><model name="r">{link}</model></sdf>'
    if included:
        (tmp_path / "part").mkdir()
        (tmp_path / "part" / "model.sdf").write_text(model)
        (tmp_path / "part" / "model.config").write_text(
            '<model><name>r</name><sdf version="1.11">model.sdf</sdf></model>'
        )
        inside = f"<include><uri>file://{tmp_path}/part</uri></include>"
        model = f'<sdf version="1.11"><model name="r">{inside}</model></sdf>'
    path = tmp_path / "r.sdf"
    path.write_text(model)
    os.mkfifo(tmp_path / "m.obj")
    with pytest.raises(ModelError, match="is a pipe"):
        load_model(path)


def test_materials_and_images_of_meshes_are_files(tmp_path):
    mesh, material, image = tmp_path / "a.obj", tmp_path / "a.mtl", tmp_path / "a.png"
    mesh.write_text(OBJ)
    check_mesh(mesh)  # what is not there, nobody waits for
    material.write_text("newmtl a\nKd 1 1 1\nmap_Kd -s 1 1 1 a.png\n")
    image.write_bytes(b"png")
    check_mesh(mesh)
    image.unlink()
    os.mkfifo(image)
    with pytest.raises(ModelError, match=r"texture .*a\.png is a pipe"):
        check_mesh(mesh)
    material.unlink()
    material.symlink_to("/dev/zero")
    with pytest.raises(ModelError, match=r"material .*a\.mtl is a device"):
        check_mesh(mesh)
    scene = tmp_path / "a.gltf"
    scene.write_text(
        json.dumps({"images": [{"uri": "data:image/png;base64,AA"}, {"uri": "a.png"}]})
    )
    with pytest.raises(ModelError, match=r"a\.png is a pipe"):
        check_mesh(scene)
