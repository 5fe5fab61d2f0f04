"""Forces that URDF and SDF state are used, or reported with their line and value."""

import numpy as np
import pytest
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces, RevoluteSpring

from geodrake import load_model
from geodrake.errors import ModelError
from geodrake.logs.motion import Motion
from geodrake.model import check_dynamics

SDF = """<sdf version="1.9"><world name="w">{world}
<model name="r">{model}
<link name="l1">{one}<inertial><pose>0.1 0 0 0 0 0</pose><mass>2</mass>{inertial}
</inertial></link>
<joint name="a" type="revolute"><parent>world</parent><child>l1</child>
<axis><xyz>0 1 0</xyz></axis></joint>
<link name="l2"><pose>0.3 0 0 0 0 0</pose>{two}
<inertial><pose>0.1 0 0 0 0 0</pose><mass>1</mass></inertial></link>
<joint name="b" type="revolute"><parent>l1</parent><child>l2</child>
<axis><xyz>0 1 0</xyz>{axis}</axis></joint></model></world></sdf>"""
URDF = """<robot name="r"><link name="base"/>{robot}
<link name="l1"><inertial><origin xyz=".1 0 0"/><mass value="2"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>{link}</link>
<joint name="a" type="continuous"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
{joint}</joint></robot>"""


PARTS = ("world", "model", "one", "two", "inertial", "axis", "robot", "link", "joint")


def load(folder, text, **parts):
    path = folder / ("r.urdf" if "robot" in text[:10] else "r.sdf")
    path.write_text(text.format(**{**dict.fromkeys(PARTS, ""), **parts}), encoding="utf-8")
    return load_model(path)


def held(model):
    zero = np.zeros((1, len(model.joints)))
    return model.effort(Motion(zero, zero, zero))[0]


def test_gravity_of_a_world_and_what_is_no_number(tmp_path):
    earth, moon = load(tmp_path, SDF), load(tmp_path, SDF, world="<gravity>0 0 -1.62</gravity>")
    np.testing.assert_allclose(held(moon), held(earth) * 1.62 / 9.81)
    for at, wrong, words in (
        ("world", "<gravity>9 81</gravity>", "line 1: <gravity> has '9 81' instead of three"),
        (
            "axis",
            "<dynamics><spring_stiffness>nan</spring_stiffness></dynamics>",
            "line 10: <spring_stiffness> has 'nan' instead",
        ),
    ):
        with pytest.raises(ModelError, match=words):
            load(tmp_path, SDF, **{at: wrong})


def test_two_joints_in_one_of_gazebo_are_a_universal_joint(tmp_path):
    both = """<joint name="b" type="{}"><parent>l1</parent><child>l2</child><axis><xyz>0 0 1</xyz>
<dynamics><damping>.3</damping></dynamics></axis><axis2><xyz>0 1 0</xyz></axis2></joint>"""
    one, other = (
        load(tmp_path, SDF.partition('<joint name="b"')[0] + both.format(kind) + SDF[-24:])
        for kind in ("universal", "revolute2")
    )
    motion = Motion(*np.random.default_rng(0).uniform(-1, 1, (3, 4, 3)))
    assert one.joints == other.joints and len(one.joints) == 3
    np.testing.assert_array_equal(one.effort(motion), other.effort(motion))


def test_a_door_of_a_static_model_does_not_move(tmp_path):
    door = """<model name="house"><static>1</static><link name="wall"/><link name="door"/>
    <joint name="hinge" type="revolute"><parent>wall</parent><child>door</child>
    <axis><xyz>0 0 1</xyz></axis></joint></model>"""
    assert load(tmp_path, SDF, world=door).joints == ("a", "b")
    with pytest.raises(ModelError, match=r"as <static> of r says\. Remove <static>"):
        load(tmp_path, SDF, model="<static>1</static>")


def test_gravity_that_is_off(tmp_path):
    off = "<gravity>{}</gravity>"
    model = load(tmp_path, SDF, one=off.format("0"), two=off.format("false"))
    assert not held(model).any() and not model.repairs
    model = load(tmp_path, SDF, two=off.format("false"))
    alone = load(tmp_path, SDF.partition('<link name="l2"')[0] + "</model></world></sdf>")
    q = np.random.default_rng(0).uniform(-1, 1, (5, 2))
    weights, still = model.effort(Motion(q, *np.zeros((2, 5, 2)))), np.zeros((2, 5, 1))
    np.testing.assert_allclose(weights[:, :1], alone.effort(Motion(q[:, :1], *still)))
    np.testing.assert_allclose(weights[:, 1], 0.0, atol=1e-12)
    assert not model.left_out and model.total_phi[1, 0] == 1.0


def test_a_point_without_gravity_has_no_part_in_weight(tmp_path):
    point = """<link name="p"><inertial><mass value="3"/></inertial></link><joint name="w"
    type="fixed"><parent link="l1"/><child link="p"/><origin xyz=".2 0 0"/></joint>"""
    off = '<gazebo reference="{}"><gravity>0</gravity></gazebo>'.format
    load_of = {name: held(load(tmp_path, URDF, robot=point + off(name))) for name in ("p", "l1")}
    np.testing.assert_allclose(load_of["p"], held(load(tmp_path, URDF)))
    np.testing.assert_allclose(load_of["l1"], [-9.81 * 3.0 * 0.2])


UNREAD = {
    "one": {
        "<enable_wind>true</enable_wind>": "line 3: <enable_wind> true is",
        "<velocity_decay><linear>0.1</linear></velocity_decay>": "<velocity_decay> 0.1",
        "<kinematic>true</kinematic>": "<kinematic> true",
    },
    "model": {
        '<plugin name="b" filename="gz-sim-buoyancy-system"/>': "plugin gz-sim-buoyancy",
        "<enable_wind>1</enable_wind>": "<enable_wind> 1",
        '<plugin name="gz::sim::systems::Hydrodynamics" filename="x"/>': "systems::Hydro",
        '<joint name="g" type="gearbox"><parent>l1</parent></joint>': "g of the type gearbox",
    },
    "world": {'<plugin name="w" filename="gz-sim-apply-link-wrench-system"/>': "link-wrench"},
    "robot": {
        "<gazebo><static>1</static></gazebo>": "<static> 1",
        '<mujoco><option gravity="0 0 -3"/></mujoco>': "=0 0 -3 of <option>",
        '<mujoco><compiler settotalmass="9"/></mujoco>': "mass=9 of <compiler>",
        '<gazebo><plugin name="m" filename="libgazebo_motor_model.so"/></gazebo>': "motor_model.so",
        '<gazebo><joint name="j" type="gearbox"/></gazebo>': "<joint> j of the type gearbox",
        '<gazebo reference="l1"><inertial><mass>9</mass></inertial></gazebo>': "<inertial> 9",
        '<gazebo reference="a"><axis><damping>2</damping></axis></gazebo>': "<axis> 2",
        '<gazebo reference="l1"><dampingFactor>.1</dampingFactor></gazebo>': "Factor> .1",
        '<gazebo><plugin name="LiftDragPlugin"/></gazebo>': "LiftDragPlugin",
        '<gazebo><plugin filename="libuuv_x.so"/></gazebo>': "libuuv_x.so",
    },
    "joint": {
        '<origin xyz="0 0 0" quat_xyzw="0.6 0 0 0.8"/>': "quat_xyzw=0.6 0 0 0.8 of <origin>",
        '<dynamics damping="1" spring_stiffness="3"/>': "ness=3 of <dynamics>",
    },
    "link": {'<contact><inertia_scaling value="3"/></contact>': "<inertia_scaling> 3"},
}
"""Part of a file -> what it may state and nothing reads, and words of what is said of it."""


@pytest.mark.parametrize(
    ("part", "stated", "words"), [(p, *row) for p, rows in UNREAD.items() for row in rows.items()]
)
def test_what_a_file_states_and_nothing_reads(tmp_path, part, stated, words):
    text = URDF if part in ("robot", "joint", "link") else SDF
    (said,) = load(tmp_path, text, **{part: stated}).left_out
    assert words in said and ", line " in said and " is ignored" in said


def test_elements_with_the_same_attributes_are_said_once(tmp_path):
    """As every joint of a Panda has them."""
    own = '<dynamics damping="0.3" K="7000" mu="16"/>'
    (said,) = load(tmp_path, URDF, joint=f"{own}\n{own}").left_out
    assert said.endswith("K=7000, mu=16 of <dynamics>, and of 1 more like it, are ignored.")


@pytest.mark.parametrize(("text", "part"), [(SDF, "model"), (URDF, "robot")], ids=["sdf", "urdf"])
def test_what_ties_bodies_and_is_not_read_is_said_with_its_lines(tmp_path, text, part):
    ties = "<drake:linear_bushing_rpy/>\n<drake:weld_constraint/>\n<drake:linear_bushing_rpy/>"
    model = load(tmp_path, text, **{part: ties})
    start = text.partition(f"{{{part}}}")[0].count("\n") + 1
    tags = ("linear_bushing_rpy", "weld_constraint", "linear_bushing_rpy")
    for said, line, tag in zip(model.left_out, range(start, start + 3), tags, strict=True):
        assert f", line {line}: <drake:{tag}> is ignored: the robot" in said
    assert held(model) == pytest.approx(held(load(tmp_path, text)))


def test_moments_of_inertia_that_are_not_stated_are_told(tmp_path):
    model = load(tmp_path, URDF.replace('ixy="0" ixz="0" iyz="0"', 'iyz="0"'))
    np.testing.assert_array_equal(model.total_phi, load(tmp_path, URDF).total_phi)
    assert "line 3: <inertia> lacks ixy, ixz, which count as 0." in model.notes[0]


@pytest.mark.parametrize(
    ("part", "other"),
    [
        (
            "a><springStiffness>4</springStiffness><springReference>.5</springReference>",
            'a><springStiffness value="4"/></gazebo>'
            '<gazebo reference=a><springReference value=".5"/>',
        ),
        ("l1><turnGravityOff>true</turnGravityOff>", 'l1><turnGravityOff value="true"/>'),
        ("l1><gravity>1</gravity>", "l1><turnGravityOff>no</turnGravityOff>"),
    ],
)
def test_gazebo_is_written_in_several_ways(tmp_path, part, other):
    both = (f"<gazebo reference={each}</gazebo>" for each in (part, other))
    quoted = (text.replace("=a>", '="a">').replace("=l1>", '="l1">') for text in both)
    one, two = (held(load(tmp_path, URDF, robot=text)) for text in quoted)
    np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("auto", ["true", "1"])
def test_an_inertia_may_follow_from_collisions(tmp_path, auto):
    shape = "<geometry><box><size>.1 .1 .1</size></box></geometry>"
    ball = f"""<link name="l3"><inertial auto="{auto}"><density>5000</density></inertial>
    <collision name="c">{shape}</collision></link>
    <joint name="c" type="fixed"><parent>l1</parent><child>l3</child></joint>"""
    model = load(tmp_path, SDF.replace("1.9", "1.11"), model=ball)
    assert model.total_phi[0, 0] == pytest.approx(7.0)


def test_a_spring_of_gazebo_that_is_no_number(tmp_path):
    spring = "<springStiffness>4</springStiffness><springReference>0.2 0.3</springReference>"
    words = "line 1: <springReference> has '0.2 0.3' instead of a number"
    with pytest.raises(ModelError, match=words):
        load(tmp_path, URDF, robot=f'<gazebo reference="a">{spring}</gazebo>')
    (said,) = load(tmp_path, URDF, robot=f'<gazebo reference="l1">{spring}</gazebo>').left_out
    assert "line 1: <springStiffness>" in said and "of l1, which is not a joint, is ignored" in said


@pytest.mark.parametrize(
    ("name", "scenery"),
    [("Ground%20Plane/2", True), ("SunLight", True), ("lightweight_arm", False)],
)
def test_a_part_that_is_not_there_is_left_out_of_the_robot(tmp_path, name, scenery):
    include = f"<include><uri>model://nowhere/{name}</uri></include>"
    model = load(tmp_path, SDF, world=include)
    (said,) = model.notes
    assert name in said and (said in model.left_out) != scenery
    assert bool(model.repairs) != scenery


GEARBOX = """<joint name="g" type="gearbox"><parent>l2</parent><child>l3</child>
<pose>0 0 0 0 0 .4</pose><gearbox_reference_body>l1</gearbox_reference_body>
<gearbox_ratio>2</gearbox_ratio><axis><xyz>.389418342308651 .921060994002885 0</xyz></axis>
<axis2><xyz>.389418342308651 .921060994002885 0</xyz></axis2></joint>"""


def test_a_gearbox_has_a_joint_follow_another(tmp_path):
    third = """<link name="l3"/><joint name="c" type="revolute"><parent>l1</parent>
    <child>l3</child><axis><xyz>0 -1 0</xyz></axis></joint>"""
    links = INNER.replace("/></joint>", '/><axis xyz="0 1 0"/></joint>')
    links += links.replace("l2", "l3").replace('"b"', '"c"').replace("0 1 0", "0 -1 0")
    for text, parts in (
        (SDF, {"model": third + GEARBOX}),
        (URDF, {"robot": f"{links}<gazebo>{GEARBOX}</gazebo>"}),
    ):
        model = load(tmp_path, text, **parts)
        assert model.followers == {"r::c": ("r::b", (0.0, 2.0))} and not model.left_out
        assert check_dynamics(model, samples=3).second.holds
        askew = {part: stated.replace("-1 0", "-1 .1") for part, stated in parts.items()}
        alone = {part: stated.replace("nt>l2", "nt>l3") for part, stated in parts.items()}
        lacking = {part: stated.replace("body>l1", "body>none") for part, stated in parts.items()}
        still = {part: stated.replace("ratio>2", "ratio>0") for part, stated in parts.items()}
        for wrong, reason in (
            (askew, "its links turn about other axes"),
            (alone, "its links turn about other axes"),
            (lacking, "<gearbox_reference_body> 'none' is no link"),
            (still, "its ratio is 0"),
        ):
            (said,) = load(tmp_path, text, **wrong).left_out
            assert f"<joint> g of the type gearbox is ignored, as {reason}." in said


ABOUT = """<joint name="g" type="gearbox"><parent>{}</parent><child>{}</child>
<gearbox_reference_body>{}</gearbox_reference_body>{}<axis><xyz>0 1 0</xyz></axis>
<axis2><xyz>0 1 0</xyz></axis2></joint>"""


@pytest.mark.parametrize(
    ("stated", "tie"),
    [
        # θ₁ = a and θ₂ = a + b: b = −(1 + ratio) a.
        (("l1", "l2", "world", ""), ("r::b", "r::a", -2.0)),
        (("l1", "l2", "base", "<gearbox_ratio>0.5</gearbox_ratio>"), ("r::b", "r::a", -1.5)),
        # θ₁ = a + b and θ₂ = a: a = −ratio (a + b).
        (("l2", "l1", "world", "<gearbox_ratio>-3</gearbox_ratio>"), ("r::a", "r::b", -1.5)),
        # θ₁ = −a and θ₂ = b.
        (("world", "l2", "l1", ""), ("r::b", "r::a", 1.0)),
    ],
)
def test_a_gearbox_may_be_about_the_world_and_across_joints(tmp_path, stated, tie):
    text = SDF.replace("<parent>world</parent>", "<parent>base</parent>")
    base = """<link name="base"/><joint name="w" type="fixed"><parent>world</parent>
    <child>base</child></joint>"""
    model = load(tmp_path, text, model=base + ABOUT.format(*stated))
    follower, leader, ratio = tie
    assert not model.left_out and len(model.joints) == 1
    ((own, other),) = model.followers.items()
    assert own == follower and other[0] == leader
    np.testing.assert_allclose(other[1], [0.0, ratio], atol=1e-15)


MIMIC = """<plugin name="m" filename="libroboticsgroup_gazebo_mimic_joint_plugin.so">
<joint>a</joint><mimicJoint>b</mimicJoint><multiplier>-2</multiplier><offset>0.1</offset></plugin>"""


CONTROL = """<ros2_control name="x" type="system"><joint name="b"><param name="mimic">a</param>
<param name="multiplier">-2</param><param name="offset">0.1</param></joint></ros2_control>"""


INNER = """<link name="l2"><inertial><mass value="1"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="b" type="continuous"><parent link="l1"/><child link="l2"/></joint>"""


def test_a_plugin_that_has_a_joint_follow_is_read(tmp_path):
    for text, parts in (
        (SDF, {"model": MIMIC}),
        (URDF, {"robot": f"{INNER}<gazebo>{MIMIC}</gazebo>"}),
        (URDF, {"robot": INNER + CONTROL}),
    ):
        model = load(tmp_path, text, **parts)
        (tie,) = model.followers.values()
        assert (model.joints, tie.coefficients) == (("a",), (0.1, -2.0))


@pytest.mark.parametrize(
    "part",
    [
        INNER.replace("</joint>", '<mimic joint="a"/></joint>'),
        '<gazebo reference="l1"><turnGravityOff>true</turnGravityOff></gazebo>',
        '<gazebo reference="l1"><gravity>0</gravity></gazebo>',
        "",
    ],
)
def test_an_included_urdf_is_the_one_that_is_loaded_alone(tmp_path, part):
    part += '<gazebo reference="a"><springStiffness>4</springStiffness></gazebo>'
    alone = load(tmp_path, URDF, robot=part, joint='<dynamics friction="0.3"/>')
    include = "<include><uri>r.urdf</uri><name>in</name></include>"
    weld = '<joint name="{0}" type="fixed"><parent>{1}</parent><child>{2}</child></joint>'
    inside = include + weld.format("c", "l", "in::base") + weld.format("d", "world", "l")
    text = f'<sdf version="1.9"><model name="m"><link name="l"/>{inside}</model></sdf>'
    model = load(tmp_path, text)
    assert not model.left_out and not alone.left_out
    states = Motion(*np.random.default_rng(0).normal(size=(3, 4, len(alone.joints))))
    np.testing.assert_allclose(model.effort(states), alone.effort(states), atol=1e-12)
    assert [f.effect for f in model.effects] == [f.effect for f in alone.effects]
    second = check_dynamics(model, samples=3).second
    assert second is not None and second.holds


def test_what_an_include_changes_in_its_model_is_changed(tmp_path):
    one = '<link name="l3"><inertial><mass>1</mass></inertial></link>'
    (tmp_path / "p.sdf").write_text(f'<sdf version="1.9"><model name="p">{one}</model></sdf>')
    change = """<experimental:params><link element_id="l3" action="modify"><inertial><mass>4</mass>
    </inertial></link></experimental:params>"""
    model = """<include><uri>p.sdf</uri><pose>.5 0 0 0 0 0</pose>{}</include>
    <joint name="c" type="fixed"><parent>l1</parent><child>p::l3</child></joint>"""
    held_by = [held(load(tmp_path, SDF, model=model.format(x))) for x in ("", change)]
    np.testing.assert_allclose(held_by[1] - held_by[0], [-9.81 * 3.0 * 0.5, 0.0], atol=1e-12)
    fluid = change.replace("</mass>", "</mass><fluid_added_mass><xx>3</xx></fluid_added_mass>")
    (said,) = load(tmp_path, SDF, model=model.format(fluid)).left_out
    assert said.endswith("<fluid_added_mass> 3 is ignored.")


def test_damping_of_a_planar_joint_of_a_urdf_is_that_of_each_direction(tmp_path):
    text = URDF.replace("continuous", "planar")
    model = load(tmp_path, text, joint='<dynamics damping="0.3"/>')
    assert [f.parameters.tolist() for f in model.effects] == [[0.3]] * 3
    spring = '<gazebo reference="a"><springStiffness>4</springStiffness></gazebo>'
    (said,) = load(tmp_path, text, robot=spring).left_out
    assert "<springStiffness> 4 is ignored" in said


def drakes(tag, sdf, **stated):
    """Return an element of Drake's own as in URDF or SDF."""
    parts = ""
    for key, value in stated.items():
        name, kind = f"drake:{tag}_{key}", "value" if value[0] in "-.0123456789" else "name"
        parts += f"<{name}>{value}</{name}>" if sdf else f'<{name} {kind}="{value}"/>'
    return f"<drake:{tag}>{parts}</drake:{tag}>"


STRUT = {
    "p_AP": "0.1 0.2 0.7", "p_BQ": "0.2 0.1 -0.1", "free_length": "0.4", "stiffness": "30",
    "damping": "2",
}  # fmt: skip
AT_JOINT = {"joint": "a", "nominal_angle": "0.3", "stiffness": "5"}


@pytest.mark.parametrize("text", [URDF, SDF])
def test_springs_of_drake_are_those_of_its_force_elements(tmp_path, text):
    """Drake's parser reads the spring between two points; the one of a joint is added to it."""
    sdf, at = text == SDF, {URDF: "robot", SDF: "model"}[text]
    ends = {"body_A": "l2" if sdf else "base", "body_B": "l1"}
    strut = drakes("linear_spring_damper", sdf, **ends, **STRUT)
    spring = drakes("revolute_spring", sdf, **AT_JOINT)
    model = load(tmp_path, text, **{at: strut + spring})
    assert not model.left_out and model.plant.num_force_elements() == 1
    plant, whole = MultibodyPlant(0.0), text.format(**dict.fromkeys(PARTS, "") | {at: strut})
    Parser(plant).AddModelsFromString(whole, "sdf" if sdf else "urdf")
    if not sdf:
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.AddForceElement(RevoluteSpring(plant.GetJointByName("a"), 0.3, 5.0))
    plant.Finalize()
    assert plant.num_force_elements() == 3
    context, nv = plant.CreateDefaultContext(), plant.num_velocities()
    motion = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 5, nv))
    found, forces = model.effort(Motion(*motion)), MultibodyForces(plant)
    for q, v, vd, effort in zip(*motion, found, strict=True):
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        plant.CalcForceElementsContribution(context, forces)
        np.testing.assert_allclose(effort, plant.CalcInverseDynamics(context, vd, forces))
    assert check_dynamics(model, samples=3).holds


@pytest.mark.parametrize(
    ("tag", "stated", "words"),
    [
        ("revolute_spring", AT_JOINT | {"joint": "k"}, "names 'k', which is not a joint of"),
        ("revolute_spring", AT_JOINT | {"stiffness": "nan"}, "has no numbers as stiffness"),
        ("linear_spring_damper", {"body_A": "base", "body_B": "q", **STRUT}, "but base and q"),
        ("linear_spring_damper", {"body_A": "base", "body_B": "l1"}, "has no numbers as p_AP"),
    ],
)
def test_springs_of_drake_that_are_nowhere_are_refused(tmp_path, tag, stated, words):
    with pytest.raises(ModelError, match=f"line 1: <drake:{tag}> .*{words}"):
        load(tmp_path, URDF, robot=drakes(tag, False, **stated))


def test_where_gazebo_puts_a_model_counts_for_its_weight(tmp_path):
    """The twin is on a fixed joint that leans as much."""
    place = "<gazebo><pose>0 0 1 0.3 -0.2 0.5</pose></gazebo>"
    on_joint = """<link name="world"/><joint name="lean" type="fixed"><parent link="world"/>
    <child link="base"/><origin xyz="0 0 1" rpy="0.3 -0.2 0.5"/></joint>"""
    model, twin = load(tmp_path, URDF, robot=place), load(tmp_path, URDF, robot=on_joint)
    np.testing.assert_allclose(held(model), held(twin), rtol=1e-12)
    assert not np.allclose(held(model), held(load(tmp_path, URDF)), rtol=0.02)
    load(tmp_path, URDF, robot=place)
    assert any("the robot is placed by <pose> 0 0 1 0.3 -0.2 0.5" in note for note in model.notes)
    assert check_dynamics(model, samples=3).holds
    (said,) = load(tmp_path, URDF, robot=on_joint + place).left_out
    assert "<pose> 0 0 1 0.3 -0.2 0.5 of <gazebo> is ignored" in said
    upright = place.replace("0.3 -0.2", "0 0")
    assert not load(tmp_path, URDF, robot=on_joint + upright).left_out


def test_what_a_world_includes_and_is_not_there_refuses_no_robot(tmp_path):
    includes = "".join(
        f"<include><uri>{uri}</uri></include>"
        for uri in ("model://sun", "https://fuel.gazebosim.org/1.0/OpenRobotics/models/Sun")
    )
    model = load(tmp_path, SDF, world=includes)
    assert model.joints == ("a", "b") and not model.repairs
    assert [note.endswith("is omitted from the world.") for note in model.notes] == [True, True]
    (tmp_path / "w.sdf").write_text(f'<sdf version="1.9"><world name="w">{includes}</world></sdf>')
    with pytest.raises(ModelError, match="no model that can be found"):
        load_model(tmp_path / "w.sdf")


def test_textures_of_a_package_that_is_not_there_refuse_no_robot(tmp_path):
    material = '<material name="m"><texture filename="package://nowhere/m.png"/></material>'
    assert load(tmp_path, URDF, robot=material).joints == ("a",)
