"""What columns of a type are of."""

import numpy as np
import pytest

from geodrake.effects import CoulombFriction, EffortOffset, ViscousFriction
from geodrake.fleet import make_settings
from geodrake.fleet.type_layout import type_layout, with_joint_effects
from geodrake.logs import JointLog
from geodrake.model import load_model

CART = """<robot name="cart"><link name="base"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>"""


@pytest.fixture(scope="module")
def layout(tmp_path_factory):
    path = tmp_path_factory.mktemp("cart") / "cart.urdf"
    path.write_text(CART)
    model = with_joint_effects(load_model(path), [CoulombFriction, ViscousFriction, EffortOffset])
    time = np.arange(0.0, 20.0, 0.01)
    q = 0.2 * np.sin(3.0 * time + np.sin(time))
    v = np.gradient(q, time)
    effort = 2.0 * np.gradient(v, time) + 5.0 * v + np.tanh(50.0 * v)
    log = JointLog("log", ("slide",), time, q[:, None], effort[:, None])
    return type_layout(model, make_settings(model, log), np.array([500.0]))


def test_parameters_of_sliding_joints_are_in_their_units(layout):
    units = {(each.effect, each.name): each.unit for each in layout.parameters}
    assert units["coulomb_friction", "coulomb"] == "N"
    assert units["viscous_friction", "viscous"] == "N·s/m"
    assert units["effort_scale", "scale"] == ""
    assert layout.columns.units == tuple(each.unit for each in layout.parameters)


def test_offsets_differ_by_what_efforts_are_large(layout):
    spread = {each.name.partition(" ")[0]: each.factor.max() for each in layout.columns.spreads}
    change = {each.effect: each.factor.max() for each in layout.hypotheses}
    assert spread["effort_offset"] == change["effort_offset"] == 500.0
    assert spread["viscous_friction"] == change["viscous_friction"] == 1.0
    assert spread["effort_scale"] == 1.0
