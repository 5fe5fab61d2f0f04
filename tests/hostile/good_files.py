"""Small good files, which rows, sweeps and the fuzzer change."""

import hashlib

import numpy as np
import yaml
from hostile import PENDULUM

URDF = PENDULUM.read_text(encoding="utf-8")
_DRY = '<parent link="upper_link"/><dynamics damping="0.1" friction="0.2"/>'
_MORE = """<transmission name="t"><type>SimpleTransmission</type><joint name="elbow"/>
<actuator name="m"><drake:gear_ratio value="2"/><drake:rotor_inertia value="1e-4"/></actuator>
</transmission><link name="tip"/><joint name="follower" type="revolute">
<parent link="lower_link"/><child link="tip"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="6" velocity="20"/>
<mimic joint="elbow" multiplier="2" offset="0.1"/></joint></robot>"""
FULL_URDF = URDF.replace('<parent link="upper_link"/>', _DRY).replace("</robot>", _MORE)
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
FULL_DIRECTIVES = """directives:
- add_model: {name: arm, file: robot.urdf, default_joint_positions: {elbow: [1.0]}}
- add_weld: {parent: world, child: "arm::base_link", X_PC: {translation: [0, 0, 1]}}
"""
FLEET = """to: new
types:
  arm: {model: robot.urdf, effects: [coulomb_friction], bandwidth: 8.0, blocks: 4, payload: 0.5,
    units: {position: rad}}
robots:
- {name: a, type: arm, logs: log.csv, dates: file, payloads: [{body: lower_link, mass: 0.1,
    mass_center: [0, 0, 0.1]}]}
- {name: b, type: arm, logs: [other.csv], model: robot.urdf}
"""
MAPPING = """time: {column: time, unit: s}
joints:
  shoulder: {position: shoulder.position, effort: {column: 3, unit: N·m, gain: 1.5}}
  elbow: {position: elbow.position, effort: elbow.effort}
"""
_EFFECTS = (
    ("torque_ripple", "elbow", "order: 2", "0.1, 0.1"),
    ("hysteresis", "elbow", "breakaway_angle: 0.01", "0.1"),
    ("nonlinear_viscous_friction", "elbow", "exponent: 2.0", "0.1"),
    ("friction_drift", "elbow", "time_constant: 9.0", "0.1, 0.1"),
    ("effort_scale", "elbow", "", "0.1"),
    ("gravity_tilt", "", "", "0.1, 0.0"),
    ("rotor_inertia", "elbow", "", "0.1"),
    ("joint_elasticity", "elbow", "", "0.001"),
    ("backlash", "elbow", "half_width: 0.01", "0.1"),
    ("aerodynamic_drag", "lower_link", "", "0.1, 0, 0, 0"),
    ("wrench_offset", "lower_link", "x: 0.1", "1, 0, 0, 0, 0, 0"),
    ("contact", "lower_link", "start: 1.0, end: 2.0, rise: 0.1, x: 0.0", "1, 0, 0, 0, 0, 0"),
)
_FORM = "- {{name: {}, where: [{}], shape: {{{}}}, parameters: [{}], deviations: []}}\n"
UNINFORMED = f"""format: geodrake model 1
base_model: robot.urdf
base_sha256: {hashlib.sha256(PENDULUM.read_bytes()).hexdigest()}
floating: false
inertial_parameters:
  upper_link: [0.5235, 0.0, 0.0, -0.1047, 0.03189, 0.03189, 0.001095, 0.0, 0.0, 0.0]
  lower_link: [0.6256, 0.0, 0.0, -0.16, 0.05087, 0.05087, 0.00099667, 0.0, 0.0, 0.0]
effects:
- {{name: coulomb_friction, where: [shoulder], shape: {{}}, parameters: [0.3], deviations: [0.01]}}
- {{name: joint_spring, where: [elbow], shape: {{exponent: 1.0, center: 0.2}},
   parameters: [0.5, 0.125], deviations: []}}
- {{name: stribeck_friction, where: [elbow], shape: {{stribeck_velocity: 0.1}},
   parameters: [0.1], deviations: []}}
- {{name: coupled_friction, where: [shoulder, elbow], shape: {{sign: 1.0}},
   parameters: [0.25, 0.75], deviations: [0.02, 0.03]}}
- {{name: payload, where: [lower_link], shape: {{}}, deviations: [],
   parameters: [0.2, 0.0, 0.0, -0.04, 0.0085, 0.0085, 0.001, 0.0, 0.0, 0.0]}}
- {{name: effort_delay, where: [], shape: {{delay: 0.002}}, parameters: [], deviations: []}}
effort_noise: {{shoulder: 0.0625, elbow: 0.03125}}
fading_speed: {{shoulder: 0.015625, elbow: 0.0}}
fitted_to: [abc]
bandwidths: {{abc: [5.0, 15.0]}}
"""
MANY_EFFECTS = UNINFORMED.replace(
    "effort_noise:", "".join(_FORM.format(*each) for each in _EFFECTS) + "effort_noise:"
)


def information(change=lambda matrix: None):
    """Return an information matrix of the parameters above as YAML, after a change."""
    matrix = np.diag(np.arange(1.0, 20 + 1 + 2 + 1 + 2 + 10 + 1))
    change(matrix)
    return yaml.safe_dump({"information": matrix.tolist()}, default_flow_style=None, width=10**6)


SAVED = UNINFORMED + information()

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
