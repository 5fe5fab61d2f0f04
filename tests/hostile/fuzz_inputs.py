"""Small files that are in order, in the formats that the fuzzer changes: a double pendulum."""

_SDF_LINK = """
    <link name="{name}">
      <pose relative_to="{joint}">0 0 0 0 0 0</pose>
      <inertial>
        <pose>0 0 -0.2 0 0 0</pose>
        <mass>0.6</mass>
        <inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.002</izz><ixy>0</ixy></inertia>
      </inertial>
    </link>
    <joint name="{joint}" type="revolute">
      <pose relative_to="{parent}">0 0 -0.3 0 0 0</pose>
      <parent>{parent}</parent>
      <child>{name}</child>
      <axis>
        <xyz>0 1 0</xyz>
        <limit><lower>-3</lower><upper>3</upper><effort>20</effort><velocity>8</velocity></limit>
        <dynamics><damping>0.1</damping><friction>0.2</friction></dynamics>
      </axis>
    </joint>"""

SDF = (
    '<?xml version="1.0"?>\n<sdf version="1.9">\n  <model name="pendulum">\n    <link name="base"/>'
    + _SDF_LINK.format(name="upper", joint="shoulder", parent="base")
    + _SDF_LINK.format(name="lower", joint="elbow", parent="upper")
    + "\n  </model>\n</sdf>\n"
)

MJCF = """<mujoco model="pendulum">
  <compiler angle="radian"/>
  <default>
    <joint damping="0.1" frictionloss="0.2" armature="0.001"/>
  </default>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" type="hinge" axis="0 1 0" range="-3 3"/>
      <inertial pos="0 0 -0.2" mass="0.6" diaginertia="0.01 0.01 0.002"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" type="hinge" axis="0 1 0" range="-3 3"/>
        <inertial pos="0 0 -0.2" mass="0.6" quat="1 0 0 0" diaginertia="0.01 0.01 0.002"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.4"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="one" joint="shoulder" gear="10" ctrlrange="-2 2"/>
    <motor name="two" joint="elbow" gear="10" ctrlrange="-2 2"/>
  </actuator>
</mujoco>
"""

DIRECTIVES = """directives:
- add_model:
    name: arm
    file: robot.urdf
- add_weld:
    parent: world
    child: arm::base_link
    X_PC:
      translation: [0.1, 0.0, 0.5]
      rotation: !Rpy {deg: [0.0, 0.0, 30.0]}
- add_frame:
    name: tip
    X_PF:
      base_frame: arm::lower_link
      translation: [0.0, 0.0, -0.4]
"""

EFFECT = """from dataclasses import dataclass
import numpy as np
from geodrake.effects import JointEffect, Parameter


@dataclass(frozen=True)
class HangingHose(JointEffect):
    name = "hanging_hose"
    parameters = (Parameter("cosine", "N·m", 0.0, 10.0), Parameter("sine", "N·m"))
    signature = "a cosine of the position"

    def columns(self, joint):
        angle = 1.0 * joint.q + 0.5
        return [np.cos(angle), np.sin(angle) * np.sign(joint.v) ** 2]


@dataclass(frozen=True)
class Grease(JointEffect):
    name = "grease"
    parameters = (Parameter("grease", "N·m·s/rad", 0.0),)
    width: float = 0.5

    def columns(self, joint):
        return [np.tanh(joint.v / self.width)]
"""
