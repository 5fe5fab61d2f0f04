"""Each construct of MJCF against MuJoCo's own inverse dynamics."""

import threading

import mujoco
import numpy as np
import pytest
from mujoco_efforts import mujoco_efforts
from pydrake.geometry import Box, Capsule, Mesh

from geodrake import load_model, save_model
from geodrake.errors import ModelError
from geodrake.logs.motion import Motion
from geodrake.model import check_dynamics
from geodrake.robot.files import mjcf_source
from geodrake.robot.files.load_options import Given
from geodrake.robot.shapes import mjcf_geoms, robot_shapes

HEAD = '<mujoco model="r">{head}<worldbody>{world}</worldbody>{tail}</mujoco>'
GEOM = '<geom type="box" size=".05 .04 .1" pos=".1 0 .05"/>'
ARM = '<body name="a" pos="0 0 .3"><joint name="a" axis="0 1 .2" pos=".02 0 0"/>{}{}</body>'
CORNERS = [(x, y, z) for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)]
FACES = "124 143 578 586 156 162 348 387 137 175 268 284"
CUBE = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "".join(
    f"f {' '.join(face)}\n" for face in FACES.split()
)


def mjcf(inside="", *, head="", tail="", arm=GEOM):
    return HEAD.format(head=head, world=ARM.format(arm, inside), tail=tail)


def tip(joint="", geom=GEOM):
    return f'<body name="t" pos=".1 0 .2"><joint name="t" axis="0 1 0" {joint}/>{geom}</body>'


def write(folder, text, **others):
    for name, data in others.items():
        (folder / f"{name}.xml").write_text(data, encoding="utf-8")
    (folder / "cube.obj").write_text(CUBE, encoding="utf-8")
    path = folder / "robot.xml"
    path.write_text(text, encoding="utf-8")
    return path


def with_dry(theirs, joints, q, v, vd, closed=True):
    """Return MuJoCo's efforts (N, n) with its dry friction."""
    dry = [theirs.dof_frictionloss[theirs.joint(joint).dofadr[0]] for joint in joints]
    return mujoco_efforts(theirs, joints, q, v, vd, closed=closed) + dry * np.sign(v)


def assert_as_mujoco(folder, text, joints="", change=lambda theirs: None):
    """Check that the model moves as MuJoCo's at all joints of the file, or at given ones."""
    path = write(folder, text)
    model, theirs = load_model(path), mujoco.MjModel.from_xml_path(str(path))
    change(theirs)
    theirs.opt.enableflags = 0
    every = {theirs.joint(k).name for k in range(theirs.njnt)}
    assert set(model.joints) == (set(joints.split()) or every)
    motion = np.random.default_rng(0).uniform(-1, 1, (3, 4, 9))[..., : len(model.joints)]
    expected = with_dry(theirs, model.joints, *motion, closed=False)
    assert np.abs(model.effort(Motion(*motion)) - expected).max() <= 1e-9 * np.abs(expected).max()
    return model


PAIR = '<joint joint="a" coef="1"/><joint joint="t" coef="2"/>'

# Others are in the files of `diagrams.benchmarks.random_mjcf`.
TAKEN = {
    "no passive forces": (
        mjcf(
            tip('stiffness="3" damping="1"'),
            head='<option density="900"><flag spring="disable" damper="disable"/></option>',
        ).replace('<body name="t"', '<body name="t" gravcomp=".5"')
    ),
    "a flag of dry friction": (
        mjcf(tip('damping="1"'), head='<option><flag frictionloss="disable"/></option>')
    ),
    "settings of masses": (
        mjcf(
            tip(
                geom=GEOM + '<geom size=".1" group="4"/><body name="b"><inertial pos="0 0 0" '
                'mass="1" diaginertia=".1 .1 .5"/></body>'
            ),
            head='<compiler settotalmass="9" boundmass="2" boundinertia=".2" '
            'balanceinertia="true" inertiagrouprange="0 2"/>',
        )
    ),
    "a box from end to end, and the mass of a mesh": (
        mjcf(
            tip(geom='<geom type="mesh" mesh="cube" mass="2"/>'),
            arm='<geom type="box" fromto="0 0 0 .2 .1 .3" size=".02 .03 .01"/>',
            head='<asset><mesh file="cube.obj"/></asset>',
        )
    ),
    "tendons of one joint": (
        mjcf(
            tip('stiffness="1" springref="10"'),
            tail='<tendon><fixed stiffness="5" springlength=".2" damping=".3" armature=".1">'
            '<joint joint="t" coef="-1.5"/></fixed><fixed stiffness="5 2 1" springlength=".2" '
            'damping=".3 .1 .2"><joint joint="t" coef="-1.5"/></fixed></tendon>',
        )
    ),
    "a tendon of two joints": (
        mjcf(
            tip(),
            tail='<tendon><fixed stiffness="4" springlength=".1" damping=".3" armature=".2">'
            f"{PAIR}</fixed></tendon>",
        )
    ),
    "springs between two points": (
        mjcf(
            '<site name="w" pos=".1 .2 .9"/>'
            + tip(geom=GEOM + '<site name="u" pos="0 0 .1"/><site name="x" pos=".1 0 0"/>')
            + f'<body pos=".2 0 0" euler="9 8 7">{GEOM}<site name="v" pos=".1 .2 .3"/></body>',
            tail='<tendon><spatial stiffness="40" damping="3"><site site="w"/><site site="u"/>'
            '</spatial><spatial stiffness="20" springlength=".1" damping="2"><site site="v"/>'
            '<site site="u"/><site site="x"/></spatial><spatial stiffness="9"><site site="w"/>'
            '<site site="v"/></spatial></tendon>',
        )
    ),
    "a spring over pulleys": (
        mjcf(
            '<site name="w" pos=".1 .2 .9"/>' + tip(geom=GEOM + '<site name="u" pos="0 0 .1"/>'),
            arm=GEOM + '<site name="v" pos=".3 .2 .1"/>',
            tail='<tendon><spatial stiffness="40 0" damping="3" springlength=".3"><site site="w"/>'
            '<site site="v"/><pulley divisor="2"/><site site="w"/><site site="u"/></spatial>'
            "</tendon>",
        )
    ),
    "tendons of several parts that vary": (
        mjcf(
            '<site name="w" pos=".1 .2 .9"/>'
            + tip(geom=GEOM + '<site name="u" pos="0 0 .1"/><site name="x" pos=".1 .1 0"/>')
            + f'<body pos=".2 0 0" euler="9 8 7">{GEOM}<site name="v" pos=".1 .2 .3"/></body>',
            arm=GEOM + '<site name="s" pos="1 0 0"/>',
            tail='<tendon><spatial stiffness="40" damping="3" springlength=".2"><site site="s"/>'
            '<site site="u"/><site site="x"/><site site="v"/><site site="w"/><pulley divisor="2"/>'
            '<site site="w"/><site site="u"/><pulley divisor="3"/><site site="u"/><site site="v"/>'
            '<site site="u"/></spatial></tendon>',
        )
    ),
    "tendons from the world around geoms of the world, and around one of a body": (
        mjcf(
            '<site name="w" pos=".3 0 .6"/><site name="x" pos="-.2 .3 .4"/>'
            '<geom name="o" size=".1" pos=".2 0 .4"/>'
            '<geom name="c" type="cylinder" size=".1 .2" pos=".1 0 .5"/>'
            + tip(geom=GEOM + '<site name="u" pos="0 0 .1"/><geom name="g" size=".05"/>'),
            tail='<tendon><spatial stiffness="40" damping="3"><site site="w"/><geom geom="o"/>'
            '<site site="u"/><geom geom="c"/><site site="x"/><geom geom="g"/><site site="w"/>'
            '<geom geom="o"/><site site="x"/></spatial></tendon>',
        )
    ),
    "a rope that pulls alone, and one with a dead band over two parts": (
        mjcf(
            '<site name="w" pos=".1 .2 .9"/><site name="x" pos=".3 .2 .5"/>'
            + tip(geom=GEOM + '<site name="u" pos="0 0 .1"/>'),
            tail='<tendon><spatial stiffness="40" damping="3" springlength="0 .642"><site '
            'site="w"/><site site="u"/></spatial><spatial stiffness="30" springlength=".78 .81">'
            '<site site="w"/><site site="x"/><site site="u"/></spatial></tendon>',
        )
    ),
    "a medium around ellipsoids of each kind, and a body that counts as a box": (
        mjcf(
            tip(
                geom='<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/>'
                + "".join(
                    f'<geom type="{kind}" size="{size}" pos=".1 .2 {k}" euler="{20 * k} 30 9" '
                    f'fluidshape="ellipsoid" fluidcoef=".4 .3 1.2 .9 {0.5 * k}"/>'
                    for k, (kind, size) in enumerate(
                        [
                            ("sphere", ".1"),
                            ("capsule", ".1 .2"),
                            ("cylinder", ".2 .1"),
                            ("ellipsoid", ".1 .3 .2"),
                            ("box", ".3 .1 .2"),
                        ]
                    )
                )
                + f'<body pos=".1 0 .2"><joint name="b" axis="1 0 .3"/>{GEOM}</body>'
            ),
            head='<option density="90" viscosity="3" wind=".4 -.2 .3"/>',
        )
    ),
    "compensated gravity of all": (
        mjcf(tip())
        .replace('<body name="a"', '<body name="a" gravcomp=".8"')
        .replace('<body name="t"', '<body name="t" gravcomp=".8"')
    ),
    "gravity that the motor of the middle one of three joints compensates": (
        mjcf(
            tip(
                'actuatorgravcomp="true"',
                geom=GEOM + '<body name="b" pos=".1 0 .2" gravcomp="1.2"><joint name="b" '
                f'axis="1 0 .3"/>{GEOM}</body>',
            )
        ).replace('<body name="t"', '<body name="t" gravcomp=".5"')
    ),
    "a least inertia of a body without mass": mjcf(
        tip(geom=GEOM + '<body euler="9 8 7"/>'), head='<compiler boundinertia=".2"/>'
    ),
    "compensated gravity of a body that carries a point": mjcf(
        tip(geom=GEOM + '<body><inertial pos=".1 0 0" mass="2" diaginertia="0 0 0"/></body>')
    ).replace('<body name="t"', '<body name="t" gravcomp=".5"'),
    "inverse dynamics of a step": mjcf(
        tip('damping="1"'), head='<option><flag invdiscrete="enable"/></option>'
    ),
    "limits without an end": mjcf(tip('range="-inf inf"'), arm=GEOM + tip('range="0 inf"')).replace(
        'name="t"', 'name="u"', 2
    ),
    "a plugin that no element uses": mjcf(
        tip(), head='<extension><plugin plugin="mujoco.sensor.touch_grid"/></extension>'
    ),
    "a plugin of an actuator": mjcf(
        tip(),
        head='<extension><plugin plugin="mujoco.pid"><instance name="i"><config key="kp" '
        'value="4"/></instance></plugin></extension>',
        tail='<actuator><plugin joint="t" plugin="mujoco.pid" instance="i" actdim="0"/></actuator>',
    ),
    "a deformable body that is a part of a rigid one": mjcf(
        tip() + '<flexcomp name="f" type="grid" count="2 2 1" spacing=".1 .1 .1" mass="1" dim="2" '
        'radius=".01"><pin id="0 1 2 3"/></flexcomp>'
    ),
    "tendons that are switched off": (
        mjcf(
            tip(),
            head='<option><flag spring="disable" damper="disable"/></option>',
            tail='<tendon><fixed name="p" stiffness="4 1 2" damping=".3 .2 .1">'
            f"{PAIR}</fixed></tendon>",
        )
    ),
}


@pytest.mark.parametrize("what", TAKEN)
def test_a_construct_is_taken_as_mujoco_means_it(tmp_path, what):
    model = assert_as_mujoco(tmp_path, TAKEN[what])
    assert not model.left_out and not model.repairs


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
@pytest.mark.parametrize("has_side", [False, True])
def test_tendons_lead_around_geoms_as_in_mujoco(tmp_path, kind, has_side):
    rng, straight, around = np.random.default_rng(0), 0, 0
    sided, words = 'sidesite="side"' if has_side else "", '<site name="{}" pos="{} {} {}"/>'
    for _ in range(8):
        radius, start, end = rng.uniform(0.1, 0.2), *rng.uniform(-0.4, 0.4, (2, 3))
        middle, side = 0.5 * (start + end + [0.1, 0.0, 0.2]), rng.normal(size=3)
        side *= 1.5 * radius / np.linalg.norm(side)
        turn = "{} {} {}".format(*rng.uniform(-90, 90, 3))
        owner = (
            f'<body name="g" pos="{"{} {} {}".format(*middle)}" euler="{turn}"><joint name="g" '
            f'axis="1 0 0"/>{GEOM}<geom name="w" type="{kind}" size="{radius} .1" mass="0"/>'
            f"{words.format('side', *side)}</body>"
        )
        text = mjcf(
            words.format("s", *start) + owner + tip(geom=GEOM + words.format("u", *end)),
            tail='<tendon><spatial stiffness="40" damping="3" springlength=".1"><site site="s"/>'
            f'<geom geom="w" {sided}/><site site="u"/><pulley divisor="2"/><site site="u"/>'
            '<site site="side"/></spatial></tendon>',
        )
        path = write(tmp_path, text)
        model, theirs = load_model(path), mujoco.MjModel.from_xml_path(str(path))
        assert not model.left_out and "tendon" in {f.effect.name for f in model.effects}
        q, v, vd = rng.uniform(-1.5, 1.5, (3, 20, 3))
        expected = mujoco_efforts(theirs, model.joints, q, v, vd)
        found = model.effort(Motion(q, v, vd))
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
        data = mujoco.MjData(theirs)
        for each in q:
            data.qpos[:] = [each[model.joints.index(theirs.joint(j).name)] for j in range(3)]
            mujoco.mj_fwdPosition(theirs, data)
            wraps = data.wrap_obj.ravel()[: int(data.ten_wrapnum[0])].max() >= 0
            straight, around = straight + (not wraps), around + wraps
    assert min(straight, around) > 20
    save_model(model, tmp_path / "m.yaml")
    again = load_model(tmp_path / "m.yaml")
    np.testing.assert_array_equal(again.effort(Motion(q, v, vd)), found)
    assert [f.effect for f in again.effects] == [f.effect for f in model.effects]


def test_friction_of_a_tendon_of_two_joints_is_that_of_an_actuator(tmp_path):
    fixed = '<fixed name="p" frictionloss=".4"><joint joint="a" coef=".5"/>'
    tail = f'<tendon>{fixed}<joint joint="t" coef="{{}}"/></fixed></tendon>'
    for share in (0.5, -0.5):
        model = load_model(write(tmp_path, mjcf(tip(), tail=tail.format(share))))
        bare = load_model(write(tmp_path, mjcf(tip())))
        motion = Motion(*np.random.default_rng(0).uniform(-1, 1, (3, 9, 2)))
        along = np.array([0.5, share])
        rubs = 0.4 * np.sign(motion.v @ along)[:, None] * along
        assert np.allclose(model.effort(motion), bare.effort(motion) + rubs, atol=1e-12)
        assert not model.left_out
    alone = load_model(
        write(tmp_path, mjcf(tip(), tail=tail.format(0.0)).replace('"a" coef="', '"a" coef="-'))
    )
    rubs = 0.2 * np.sign(motion.v) * [1.0, 0.0]
    assert np.allclose(alone.effort(motion), bare.effort(motion) + rubs, atol=1e-12)
    (said,) = load_model(write(tmp_path, mjcf(tip(), tail=tail.format(0.7)))).left_out
    assert said == "The dry friction 0.4 of p is ignored, as its joints have unequal moment arms."


def zero(**tables):
    def change(theirs):
        for table, at in tables.items():
            getattr(theirs, table)[at] = 0.0

    return change


MOCAP = '<body name="m" mocap="true" pos="1 0 0"><geom size=".1"/></body>'

LEFT_OUT = {
    "robot.xml, line 1: <equality>: the constraint <weld> of m and t": (
        mjcf(tip(), tail='<equality><weld body1="m" body2="t"/></equality>').replace(
            "<worldbody>", f"<worldbody>{MOCAP}"
        ),
        zero(),
    ),
    "robot.xml, line 1: Actuator 0 with dampingpoly 0.1 0 is": (
        mjcf(
            tip(),
            tail=f'<tendon><fixed name="p">{PAIR}</fixed></tendon><actuator><motor tendon="p" '
            'damping="0 .1"/></actuator>',
        ),
        zero(actuator_dampingpoly=0),
    ),
    "Tendon p with stiffness 40, damping 2": (
        mjcf(
            tip(geom=GEOM + '<site name="u" pos="0 0 .1"/>'),
            arm=GEOM + '<site name="s" pos="1 0 0"/><geom name="g" size=".02"/><site name="in"/>',
            tail='<tendon><spatial name="p" stiffness="40" damping="2"><site site="s"/>'
            '<geom geom="g" sidesite="in"/><site site="u"/></spatial></tendon>',
        ),
        zero(tendon_stiffness=0, tendon_damping=0),
    ),
    "Tendon p with stiffness 5 is": (
        mjcf(
            tip(),
            tail='<tendon><fixed name="p" stiffness="5" springlength=".1 .2" damping=".3">'
            f"{PAIR}</fixed></tendon>",
        ),
        zero(tendon_stiffness=0),
    ),
    "Tendon p with stiffnesspoly 2 1, dampingpoly 0.1 0 is": (
        mjcf(
            tip(),
            tail='<tendon><fixed name="p" stiffness="5 2 1" damping=".3 .1">'
            f"{PAIR}</fixed></tendon>",
        ),
        zero(tendon_stiffnesspoly=0, tendon_dampingpoly=0),
    ),
}


@pytest.mark.parametrize("words", LEFT_OUT)
def test_what_is_left_out_is_said_with_its_value(tmp_path, words):
    text, change = LEFT_OUT[words]
    model = assert_as_mujoco(tmp_path, text, change=change)
    (said,) = model.left_out
    assert words in said and said in model.notes and said.endswith("is ignored.")


def test_a_joint_whose_body_is_connected_to_its_parent_does_not_move(tmp_path):
    tail = '<equality><connect body1="a" body2="t" anchor="0 0 0"/></equality>'
    model = assert_as_mujoco(tmp_path, mjcf(tip(), tail=tail), "a")
    assert model.held == {"t": 0.0} and not model.left_out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<mujoco>\n<worldbody>\n<bode/></worldbody></mujoco>", "xml, line 3: Schema violation"),
        (mjcf(tip(geom='<inertial pos="0 0 0" mass="1" diaginertia="1 1 5"/>')), "A \\+ B >= C"),
        (mjcf('<attach model="x" prefix="y"/>'), "could not find model 'x'"),
        (mjcf('<replicate count="99999999"><geom size="1"/></replicate>'), "makes 99999999 copies"),
        (mjcf(f'<replicate count="20">{tip()}</replicate>'), "has 21 links; geodrake"),
        (
            mjcf(f'{2 * """<replicate count="2000">"""}<geom size="1"/>{2 * "</replicate>"}'),
            "makes 4000000 copies",
        ),
        (mjcf(head='<asset><model name="s" file="robot.xml"/></asset>'), "attaches itself"),
        (mjcf(head='<asset><model name="s" file="/dev/zero"/></asset>'), "is a device"),
        (mjcf(head='<asset><model name="s" file="part.xml"/></asset>'), "root element is <robot>"),
        (mjcf('<flexcomp name="f" type="grid" count="99 99 99"/>'), "makes 970299 copies"),
    ],
)
def test_what_mujoco_refuses_is_said_in_its_words(tmp_path, monkeypatch, text, words):
    monkeypatch.setattr("geodrake.robot.files.description._MOST_LINKS", 20)
    path = write(tmp_path, text, part='<robot name="r"/>')
    with pytest.raises(ModelError, match=words):
        load_model(path)


def test_a_plant_that_is_not_mujocos_is_refused(tmp_path, monkeypatch):
    path = write(tmp_path, mjcf(tip()))
    monkeypatch.setattr("geodrake.robot.files.mjcf.UPPER", ([0, 0, 2, 0, 0, 1], [0, 0, 2, 1, 2, 2]))
    with pytest.raises(
        ModelError, match="reads joint a, or what it moves, differently from MuJoCo: ef"
    ):
        load_model(path)


LOOKS = """<mujoco model="r"><asset><mesh name="m" file="cube.obj" scale="2 2 2"/>
<material name="red" rgba="1 0 0 1"/><texture name="x" type="2d" file="nowhere.png"/></asset>
<default><default class="visual"><geom contype="0" conaffinity="0" material="red"/></default>
</default><worldbody><geom type="plane" size="1 1 1"/><frame pos="0 0 1"><body name="a">
<joint name="j"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
<geom class="visual" type="mesh" mesh="m"/><geom type="mesh" mesh="gone" class="visual"/>
<frame euler="90 0 0"><geom type="capsule" size=".1 .2" pos="0 1 0" group="3"/></frame></body>
</frame></worldbody></mujoco>"""


def test_shapes_are_those_that_mujoco_compiles(tmp_path):
    gone = '<asset><mesh name="gone" file="gone.stl"/></asset>'
    path = write(tmp_path, LOOKS.replace("<asset>", f"{gone}<asset>", 1))
    assert load_model(path).notes == ()
    (shown,) = robot_shapes(path, Given()).links["r::a"]
    assert isinstance(shown.shape, Mesh) and shown.color.rgba == pytest.approx([1, 0, 0, 1])
    geoms, _ = mjcf_geoms(path, Given(), hulls=True)
    (capsule,) = [geom for geom in geoms["r::a"] if geom.collides]
    assert isinstance(capsule.shape, Capsule) and capsule.shape.length() == 0.4
    np.testing.assert_allclose(capsule.X_BG.translation(), [0, 0, 1], atol=1e-12)
    hull, _ = geoms["r::a"]
    surface = hull.shape.GetConvexHull()
    points = np.array([hull.X_BG @ surface.vertex(k) for k in range(surface.num_vertices())])
    np.testing.assert_allclose(points.min(0), [0, 0, 0], atol=1e-7)
    np.testing.assert_allclose(points.max(0), [0.2, 0.4, 0.6], atol=1e-7)


def test_meshes_that_are_not_there_are_told_of(tmp_path):
    gone = '<asset><mesh name="gone" file="gone.stl"/></asset>'
    path = write(tmp_path, LOOKS.replace("<asset>", f"{gone}<asset>", 1))
    (note,) = robot_shapes(path, Given()).notes
    assert note.startswith("Some shapes of a are meshes that are missing")
    text = path.read_text(encoding="utf-8").replace('mesh="gone" class="visual"', 'mesh="gone"')
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match="meshes that are missing") as refused:
        mjcf_geoms(path, Given(), hulls=True)
    assert "use_file=False" in str(refused.value)
    mesh = '<geom type="mesh" mesh="gone" {}/>'
    groups = '<compiler inertiagrouprange="0 2"/>'
    for light, head in (('mass="0"', ""), ('density="0"', ""), ('group="3"', groups)):
        text = mjcf(arm=GEOM + mesh.format(light), head=gone + head)
        assert not load_model(write(tmp_path, text)).repairs
    heavy = mjcf(arm='<geom type="mesh" mesh="gone"/>', head=gone)
    assert "inertia of a is computed without meshes" in " ".join(
        load_model(write(tmp_path, heavy)).repairs
    )


def test_what_stands_in_the_world_is_there_for_collisions_alone(tmp_path):
    table = '<geom name="table" type="box" size="1 1 1"/>'
    gone = '<geom type="mesh" mesh="gone" class="visual"/>'
    text = LOOKS.replace(gone, "").replace("<frame", f"{table}<frame", 1)
    path = write(tmp_path, text)
    geoms, _ = mjcf_geoms(path, Given(), hulls=True)
    ground, box = geoms["WorldModelInstance::world"]
    assert box.name == "table" and isinstance(ground.shape, Box)
    assert (ground.X_BG @ [0, 0, 0.5 * ground.shape.height()])[2] == pytest.approx(0.0)
    assert set(robot_shapes(path, Given()).links) == {"r::a"}


def test_a_plugin_of_a_body_is_told(tmp_path):
    text = mjcf(tip(geom=GEOM + '<plugin plugin="own.drag"/>'))
    (said,) = load_model(write(tmp_path, text)).left_out
    assert "robot.xml, line 1: the plugin own.drag is ignored." in said


@pytest.mark.parametrize("other", ["", 'body2="m"'])
def test_a_weld_of_a_free_base_is_told_where_it_is_free(tmp_path, other):
    text = mjcf(tip(), tail=f'<equality><weld body1="b" {other}/></equality>')
    free = f'{MOCAP}<body name="b"><freejoint/>{GEOM}'
    text = text.replace("<worldbody>", f"<worldbody>{free}")
    path = write(tmp_path, text.replace("</worldbody>", "</body></worldbody>"))
    assert not load_model(path).left_out
    (said,) = load_model(path, floating=True).left_out
    assert "line 1: <equality>: the constraint <weld> of b and " in said


def test_springs_of_ball_joints_are_as_in_mujoco(tmp_path):
    ball = f'<joint name="{{}}" type="ball" stiffness="{{}}" damping=".4"/>{GEOM}'
    inner = f'<body euler="5 6 7"><body pos=".1 0 .2" euler="40 -20 70">{ball.format("j", 3)}'
    inner += f'<body name="u" euler="3 4 5">{GEOM}</body></body></body>'
    world = f'<body name="a" euler="10 20 30">{ball.format("i", 2)}{inner}</body>'
    model = load_model(write(tmp_path, HEAD.format(head="", world=world, tail="")))
    assert not model.left_out and check_dynamics(model, samples=5).second.holds


def test_how_long_muscles_are_does_not_matter(tmp_path):
    path = write(tmp_path, mjcf(tip(), tail='<actuator><muscle joint="t"/></actuator>'))
    with pytest.raises(ValueError, match="Lengthrange"):
        mujoco.MjModel.from_xml_path(str(path))
    assert load_model(path).joints == ("a", "t")


def test_angles_of_an_attached_model_are_read_by_its_own_compiler(tmp_path):
    body = f'<body name="g" euler="0 .5 0">{GEOM}{tip()}</body>'.replace('"t"', '"u"')
    part = f'<mujoco model="s"><compiler angle="radian"/><worldbody>{body}</worldbody></mujoco>'
    text = mjcf(
        tip() + '<attach model="s" body="g" prefix="x"/>',
        head='<compiler fusestatic="{}"/><asset><model name="s" file="part.xml"/></asset>',
    )
    one, two = (load_model(write(tmp_path, text.format(x), part=part)) for x in ("true", "false"))
    np.testing.assert_array_equal(one.phi, two.phi)
    (said,) = set(one.notes) - set(two.notes)
    assert "with fusestatic, MuJoCo reads angles of attached models" in said
    text = text.replace("fusestatic", 'angle="radian" fusestatic')
    assert not load_model(write(tmp_path, text.format("true"), part=part)).notes


FOLLOW = '<joint joint1="t" joint2="a" polycoef="0 {} {} 0 0"/>'
BACK = '<joint joint1="a" joint2="t" polycoef="0 1 .2 0 0"/>'


@pytest.mark.parametrize(
    "both", [FOLLOW.format(1, 0.2) + FOLLOW.format(2, 0), FOLLOW.format(1, 0) + BACK]
)
def test_a_second_constraint_of_a_joint_is_left_out(tmp_path, both):
    path = write(tmp_path, mjcf(tip(), tail=f"<equality>{both}</equality>"))
    model = load_model(path)
    (said,) = model.left_out
    assert "line 1: <equality>: the constraint <joint> of " in said and said in model.repairs
    assert len(model.joints) == 1


def test_a_joint_that_follows_by_a_ratio_of_zero_is_fixed(tmp_path):
    text = mjcf(
        tip('ref="20"') + f'<body><joint name="b" type="hinge"/>{GEOM}</body>',
        tail='<equality><joint joint1="t" joint2="b" polycoef=".1 0 0 0 0"/></equality>',
    )
    path = write(tmp_path, text)
    model, theirs = load_model(path), mujoco.MjModel.from_xml_path(str(path))
    assert (model.joints, model.left_out) == (("a", "b"), ())
    data = mujoco.MjData(theirs)
    data.joint("t").qpos[:] = model.held["t"]
    mujoco.mj_forward(theirs, data)
    assert data.efc_pos[: data.ne] == pytest.approx([0.0], abs=1e-12)


def test_deformable_bodies_are_read_and_their_elasticity_is_told(tmp_path):
    flex = """<flexcomp name="f" type="grid" count="2 2 1" spacing=".1 .1 .1" mass="1" dim="2"
    radius=".01"/>"""
    text = mjcf().replace("</worldbody>", f"{flex}</worldbody>")
    model = load_model(write(tmp_path, text))
    assert len(model.joints) == 13
    (said,) = model.left_out
    assert said.startswith("<flex> of 1 deformable bodies")


def test_names_between_joints_are_those_of_no_body(tmp_path):
    text = mjcf(
        f'<body name="b"><joint name="x"/><joint name="y" axis="0 1 0"/>{GEOM}'
        f'<body name="b_x"><joint name="z"/>{GEOM}</body></body>'
    )
    model = assert_as_mujoco(tmp_path, text)
    assert len(set(model.bodies)) == len(model.bodies)


@pytest.mark.skipif(not hasattr(mujoco.mjtBias, "mjBIAS_DCMOTOR"), reason="of MuJoCo 4")
def test_what_is_inside_of_a_motor_is_told(tmp_path):
    body = '<body name="b"><joint name="j"/><geom size=".1"/></body>'
    motor = '<dcmotor name="m" joint="j" motorconst=".05" resistance=".5" {}/>'.format
    for stated, told in (
        ('cogging=".2 7 .3"', "cogging of 0.2"),
        ('cogging=".2 7 .3" lugre="100 1 .4 .5 .01"', "cogging of 0.2 and friction of 0.4"),
        ('damping=".1"', ""),
    ):
        text = f"<worldbody>{body}</worldbody>\n<actuator>{motor(stated)}</actuator>"
        (tmp_path / "m.xml").write_text(f"<mujoco>{text}</mujoco>")
        notes = " ".join(load_model(tmp_path / "m.xml").notes)
        assert (f"line 2: the effort of the motor m includes {told} inside" in notes) is bool(told)
        assert ("inside of it" in notes) is bool(told)


def test_a_yield_of_a_spring_is_told(tmp_path):
    tendon = '<tendon><fixed name="p" {}>' + PAIR + "</fixed></tendon>"
    of_tendon = mjcf(tip(), tail=tendon.format('stiffness="4" springyield=".1"'))
    of_joint = mjcf(tip('stiffness="4" springyield=".1"'))
    for text in (of_tendon, of_joint):
        (said,) = load_model(write(tmp_path, text)).left_out
        assert "yield" in said


def test_springs_of_a_finger_that_follows_are_at_its_leader(tmp_path):
    text = mjcf(
        tip('stiffness="3 0 2" springref="30" damping=".3 .2 .1" frictionloss=".2" armature=".1"'),
        tail='<equality><joint joint1="t" joint2="a" polycoef=".1 -2 0 0 0"/></equality>',
    ).replace('pos=".02 0 0"/>', 'pos=".02 0 0" stiffness="1" springref="10"/>')
    model = load_model(write(tmp_path, text))
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    motion, J = np.random.default_rng(0).uniform(-1, 1, (3, 5, 1)), np.array([1.0, -2.0])
    expected = (
        with_dry(theirs, "at", *(motion * J + np.multiply.outer([1, 0, 0], [[0.0, 0.1]]))) @ J
    )
    np.testing.assert_allclose(model.effort(Motion(*motion))[:, 0], expected, rtol=1e-9)
    assert model.joints == ("a",) and not model.left_out


@pytest.mark.parametrize(
    ("tendons", "equality"),
    [
        (f'<fixed name="p">{PAIR}</fixed>', '<tendon tendon1="p" polycoef=".3 0 0 0 0"/>'),
        (
            '<fixed name="p"><joint joint="a" coef="2"/></fixed>'
            '<fixed name="q"><joint joint="t" coef="3"/></fixed>',
            '<tendon tendon1="p" tendon2="q" polycoef=".1 -.7 0 0 0"/>',
        ),
    ],
)
def test_tendons_that_tie_two_joints_have_one_follow_the_other(tmp_path, tendons, equality):
    motor = '<actuator><motor joint="t"/></actuator>'
    tail = f"<tendon>{tendons}</tendon><equality>{equality}</equality>{motor}"
    path = write(tmp_path, mjcf(tip('ref="20"'), tail=tail))
    model, theirs = load_model(path), mujoco.MjModel.from_xml_path(str(path))
    assert model.joints == ("t",) and not model.left_out
    ((_, (offset, ratio)),) = model.followers.values()
    data = mujoco.MjData(theirs)
    for q in (-0.4, 0.0, 0.9):
        data.qpos[:] = (ratio * q + offset, q)
        mujoco.mj_forward(theirs, data)
        assert data.efc_pos[: data.ne] == pytest.approx([0.0], abs=1e-12)


@pytest.mark.parametrize(
    ("tie", "moving", "held"),
    [
        ('<tendon tendon1="q" tendon2="r" polycoef=".1 2 0 0 0"/>', ("a",), {}),
        ('<joint joint1="t" joint2="b" polycoef=".1 3 0 0 0"/>', ("a",), {}),
        ('<joint joint1="t" polycoef=".3"/>', ("b",), {"a": pytest.approx(0.15 / 2)}),
        (
            '<joint joint1="t" joint2="b" polycoef=".3 0 0 0 0"/>',
            ("b",),
            {"a": pytest.approx(0.15 / 2)},
        ),
    ],
)
def test_what_ties_a_joint_that_follows_already_ties_the_other(tmp_path, tie, moving, held):
    inner = tip().replace(GEOM, f'{GEOM}<body><joint name="b" axis="1 0 0"/>{GEOM}</body>')
    tendons = '<fixed name="q"><joint joint="t" coef="1"/></fixed>'
    tendons += '<fixed name="r"><joint joint="b" coef="3"/></fixed>'
    follow = '<joint joint1="t" joint2="a" polycoef=".15 2 0 0 0"/>'
    tail = f"<tendon>{tendons}</tendon><equality>{follow}{tie}</equality>"
    path = write(tmp_path, mjcf(inner, tail=tail))
    model, theirs = load_model(path), mujoco.MjModel.from_xml_path(str(path))
    assert (model.joints, model.left_out) == (moving, ())
    assert {joint: model.held[joint] for joint in held} == held
    if not held:
        data = mujoco.MjData(theirs)
        data.qpos[:] = model.plant_positions(np.array([[0.7]]))[0]
        mujoco.mj_forward(theirs, data)
        assert data.efc_pos[: data.ne] == pytest.approx([0.0, 0.0], abs=1e-12)


@pytest.mark.parametrize(
    ("tail", "wrong"),
    [
        ('<equality><weld body1="t" relpose="0 0 0 0 0 0 nan"/></equality>', "<weld> has relpose"),
        ('<equality><joint joint1="t" polycoef="1e300"/></equality>', r"1e\+300 is above 1e\+12"),
        ('<tendon><fixed><joint joint="t" coef="nan"/></fixed></tendon>', "coef='nan'"),
        ('<option viscosity="-1"/>', "-1 is below 0"),
    ],
)
def test_numbers_that_mujoco_takes_and_no_robot_has_are_refused(tmp_path, tail, wrong):
    path = write(tmp_path, mjcf(tip(), tail=tail))
    mujoco.MjModel.from_xml_path(str(path))
    with pytest.raises(ModelError, match=wrong):
        load_model(path)


def test_frames_within_frames_without_end_are_read_or_refused(tmp_path):
    opens = '<frame pos="0 0 0.001">'
    nameless = tip().replace('<joint name="t"', "<joint")
    path = write(tmp_path, mjcf(opens * 390 + nameless + "</frame>" * 390))
    assert load_model(path).joints == ("a", "t_joint_0")
    path = write(tmp_path, mjcf(opens * 500 + "</frame>" * 500))
    with pytest.raises(ModelError, match="more than 400 nested elements"):
        load_model(path)


def test_one_thread_at_a_time_takes_mujocos_warnings():
    there = threading.Event()

    def enter():
        with mjcf_source.quiet_mujoco():
            there.set()

    other = threading.Thread(target=enter)
    with mjcf_source.quiet_mujoco():
        other.start()
        assert not there.wait(0.2)
    other.join(10.0)
    assert there.is_set()


def test_models_attached_to_models_ever_more_often_end(tmp_path):
    def write(uses, models, depth=12):
        for k in range(depth):
            own = range(models) if k < depth - 1 else ()
            assets = "".join(f'<model name="m{i}" file="{k + 1}.xml"/>' for i in own)
            attached = "".join(
                f'<body><attach model="m{i % models}" body="root" prefix="p{i}_"/></body>'
                for i in (range(uses) if k < depth - 1 else ())
            )
            (tmp_path / f"{k}.xml").write_text(
                f'<mujoco model="f{k}"><asset>{assets}</asset><worldbody><body name="root">'
                f'<joint name="j" axis="0 1 0"/><geom size="0.1"/>{attached}</body></worldbody>'
                "</mujoco>"
            )
        return tmp_path / "0.xml"

    assert len(load_model(write(2, 1, 3)).joints) == 7
    with pytest.raises(ModelError, match=r"line 1: with <attach> there are \d+ bodies"):
        load_model(write(10, 1))
    with pytest.raises(ModelError, match="attaches more than 300 models"):
        load_model(write(4, 4))
