"""Small files that are in order, which rows and the fuzzer change: a double pendulum, effects."""

from hostile import PENDULUM

URDF = PENDULUM.read_text(encoding="utf-8")
_LINK = """<link name="{}"><inertial><pose>0 0 -0.2 0 0 0</pose><mass>0.5</mass><inertia>
<ixx>0.01</ixx><iyy>0.01</iyy><izz>0.001</izz></inertia></inertial></link>"""
_JOINT = """<joint name="{}" type="revolute"><parent>{}</parent><child>{}</child><axis>
<xyz>0 1 0</xyz><limit><lower>-6</lower><upper>6</upper><effort>5</effort></limit><dynamics>
<damping>0.1</damping><friction>0.2</friction></dynamics></axis></joint>"""
SDF = f"""<sdf version="1.9"><model name="robot">
{_LINK.format("upper")}
{_LINK.format("lower").replace("<inertial>", "<pose>0 0 -0.3 0 0 0</pose><inertial>", 1)}
{_JOINT.format("shoulder", "world", "upper")}
{_JOINT.format("elbow", "upper", "lower")}
</model></sdf>
"""
MJCF = """<mujoco model="robot"><default><joint damping="0.1"/></default><worldbody>
<body name="upper"><joint name="shoulder" axis="0 1 0" range="-6 6" armature="0.01"/>
<inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.01 0.01 0.001"/>
<body name="lower" pos="0 0 -0.3"><joint name="elbow" axis="0 1 0" frictionloss="0.2"/>
<inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.01 0.01 0.001"/></body></body></worldbody>
<actuator><motor name="m" joint="elbow" gear="2" ctrlrange="-1 1" forcerange="-3 3"/></actuator>
</mujoco>
"""
DIRECTIVES = "directives:\n- add_model: {name: arm, file: robot.urdf}\n"

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
