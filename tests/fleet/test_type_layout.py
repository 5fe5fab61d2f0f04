"""What columns of a type are of."""

import numpy as np

from geodrake.effects import CoulombFriction, ViscousFriction
from geodrake.fleet.making import make_settings
from geodrake.fleet.type_layout import type_layout
from geodrake.fleet.type_source import with_joint_effects
from geodrake.logs.motion import JointLog
from geodrake.model.saved_model import load_model

CART = """<robot name="cart"><link name="base"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>"""


def test_parameters_of_sliding_joints_are_in_their_units(tmp_path):
    (tmp_path / "cart.urdf").write_text(CART)
    model = load_model(tmp_path / "cart.urdf")
    model = with_joint_effects(model, [CoulombFriction, ViscousFriction])
    time = np.arange(0.0, 20.0, 0.01)
    q = 0.2 * np.sin(3.0 * time + np.sin(time))
    v = np.gradient(q, time)
    effort = 2.0 * np.gradient(v, time) + 5.0 * v + np.tanh(50.0 * v)
    log = JointLog("log", ("slide",), time, q[:, None], effort[:, None])
    layout = type_layout(model, make_settings(model, log), np.ones(1))
    units = {(each.effect, each.name): each.unit for each in layout.parameters}
    assert units["coulomb_friction", "coulomb"] == "N"
    assert units["viscous_friction", "viscous"] == "N·s/m"
    assert units["effort_scale", "scale"] == ""
    assert layout.columns.units == tuple(each.unit for each in layout.parameters)
