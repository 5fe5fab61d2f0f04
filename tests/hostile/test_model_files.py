"""Model files that are wrong, unlucky or meant to harm."""

import os
import socket
from itertools import pairwise
from pathlib import Path

import pytest
from hostile import PENDULUM, Row

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
_SUFFIXES = {URDF: "urdf", SDF: "sdf", MJCF: "xml", DIRECTIVES: "dmd.yaml"}
_NO_NUMBERS = ("nan", "inf", "many", "0x10", "1e400", "1,5", "1e300")


def file(name, content):
    """Makes a file of a text or of bytes."""

    def make(folder):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return make


def every(*makes):
    """Makes several things."""

    def make(folder):
        for one in makes:
            one(folder)

    return make


def whole(name, content, *says, suffix="urdf", code=2, apart=False, command="compare {} log.csv"):
    """A row of a model file with some content."""
    path = f"bad.{suffix}"
    make = content if callable(content) else file(path, content)
    return Row(f"{suffix}: {name}", command.format(path), says, make, code, apart=apart)


def part(base, name, old, new, *says, code=2, **settings):
    """A row of a model file in which a text stands in the place of another."""
    assert old in base, old
    changed = base.replace(old, new, 1)
    return whole(name, changed, *says, suffix=_SUFFIXES[base], code=code, **settings)


def no_numbers(base, what, old, *says, wrong=_NO_NUMBERS):
    """Rows of a number that is none; `old` has it between marks «»."""
    before, _, rest = old.partition("«")
    number, _, after = rest.partition("»")
    return [
        part(
            base,
            f"{what} {word}",
            before + number + after,
            before + word + after,
            "line ",
            *says,
        )
        for word in wrong
    ]


def below(folder_name, make):
    """The same in a folder below."""

    def make_below(folder):
        (folder / folder_name).mkdir(exist_ok=True)
        make(folder / folder_name)

    return make_below


def pipe(name):
    return lambda folder: os.mkfifo(folder / name)


def link(name, target):
    return lambda folder: (folder / name).symlink_to(target)


def deaf_socket(name):
    def make(folder):
        before = Path.cwd()
        os.chdir(folder)  # as paths of sockets are short
        try:
            with socket.socket(socket.AF_UNIX) as server:
                server.bind(name)
        finally:
            os.chdir(before)

    return make


def sparse(name, size):
    def make(folder):
        with (folder / name).open("wb") as stream:
            stream.truncate(size)

    return make


def included(uri, tag="include"):
    return f'<sdf version="1.9"><model name="robot"><{tag}><uri>{uri}</uri></{tag}></model></sdf>'


def chain(count, last=0, suffix="sdf"):
    """Files each of which includes the next, and the last the one of a number."""

    def make(folder):
        for k in range(count):
            following = f"{k + 1 if k + 1 < count else last}.{suffix}"
            name = "bad" if k == 0 else str(k)
            target = following if following != f"0.{suffix}" else f"bad.{suffix}"
            text = included(target) if suffix == "sdf" else directives(target)
            (folder / f"{name}.{suffix}").write_text(text, encoding="utf-8")

    return make


def directives(uri):
    return f"directives:\n- add_directives: {{file: {uri}}}\n"


LAUGHS = (
    "".join(
        f'<!ENTITY {name} "{before * 10}">'
        for before, name in pairwise(["&a;", *(f"&{x};" for x in "bcdefghijklm")])
    )
    .replace("ENTITY &", "ENTITY ")
    .replace('; "', ' "')
)


def many_links(count):
    """A chain of links."""
    links = "".join(f'<link name="l{k}"/>' for k in range(count + 1))
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/></joint>'
        for k in range(count)
    )
    return f'<robot name="r">{links}{joints}</robot>'


def geared(ratio, inertia):
    """A transmission of the elbow, and the end of the robot."""
    return f"""<transmission name="t"><type>SimpleTransmission</type><joint name="elbow"/>
<actuator name="m"><drake:gear_ratio value="{ratio}"/><drake:rotor_inertia value="{inertia}"/>
</actuator></transmission></robot>"""


PACKAGE = "<package><name>{}</name></package>"
AT_3_HZ = "compare {} log.csv --bandwidth 3"  # where the robot's efforts tell none

ELBOW = '<parent link="upper_link"/>'
MASS, IXX, COM = '"0.6256"', '"0.0099667" iyy', '"0 0 -0.2557" rpy="0 0 0"/>\n      <mass'
LIMIT = '"-6.2832" upper="6.2832" effort="6" velocity="20"'

IN_URDF = [
    *no_numbers(URDF, "origin of a joint", 'xyz="0 0 «-0.2»" rpy="0 0 0"/>\n    <axis', "line 54"),
    part(
        URDF,
        "origin of two numbers",
        '0 0 -0.2" rpy="0 0 0"/>\n    <axis',
        '0 0"/>\n    <axis',
        "line 54",
        "3 numbers",
    ),
    *no_numbers(URDF, "turn of a joint", 'xyz="0 0 -0.2" rpy="0 0 «0»"/>\n    <axis'),
    part(
        URDF,
        "origin of four numbers",
        '0 0 -0.2" rpy="0 0 0"/>\n    <axis',
        '0 0 0 1"/>\n    <axis',
    ),
    *no_numbers(URDF, "axis", 'axis xyz="0 «1» 0"', "line 31"),
    part(URDF, "axis of zeros", 'axis xyz="0 1 0"', 'axis xyz="0 0 0"'),
    part(URDF, "axis of four numbers", 'axis xyz="0 1 0"', 'axis xyz="0 0 0 1"'),
    part(URDF, "axis of 1e-300", 'axis xyz="0 1 0"', 'axis xyz="0 1e-300 0"'),
    part(URDF, "limits inverted", 'lower="-6.2832"', 'lower="7"', "line 32", "lower end 7"),
    part(URDF, "effort negative", 'effort="6"', 'effort="-6"', "effort='-6'", "below 0"),
    part(URDF, "velocity negative", 'velocity="20"', 'velocity="-20"', "velocity='-20'", "below 0"),
    *no_numbers(URDF, "lower limit", 'lower="«-6.2832»"', wrong=("nan", "many")),
    *no_numbers(URDF, "effort limit", 'effort="«6»"', wrong=("nan", "many")),
    *no_numbers(URDF, "velocity limit", 'velocity="«20»"', wrong=("nan", "many")),
    part(
        URDF,
        "limits infinite",
        LIMIT,
        '"-inf" upper="inf" effort="inf" velocity="inf"',
        "line 32",
        "'-inf'",
    ),
    part(
        URDF,
        "limits of 1e308",
        LIMIT,
        '"-1e308" upper="1e308" effort="1e308" velocity="1e308"',
        code=0,
    ),
    *[
        part(URDF, f"mass {x}", MASS, f'"{x}"', "lower_link", code=0)
        for x in ("nan", "inf", "-1", "heavy", "", "0")
    ],
    *[part(URDF, f"mass {x}", MASS, f'"{x}"') for x in ("1e300", "1e100")],
    part(URDF, "mass 1e-300", MASS, '"1e-300"', "mass of 1e-300 kg", code=0),
    *[
        part(URDF, f"inertia {x}", IXX, f'"{x}" iyy', "lower_link", code=0, command=AT_3_HZ)
        for x in ("nan", "-1", "inf", "")
    ],
    *[part(URDF, f"inertia {x}", IXX, f'"{x}" iyy') for x in ("1e300",)],
    *[
        part(URDF, f"centre of mass {x}", COM, f'"0 0 {x}"/>\n      <mass', code=0)
        for x in ("nan",)
    ],
    part(URDF, "centre of mass 1e300", COM, '"0 0 1e300"/>\n      <mass', "lower_link", code=0),
    part(
        URDF,
        "centre of mass 1e10",
        COM,
        '"0 0 1e10"/>\n      <mass',
        "'lower_link' has",
        "above 1e+12",
    ),
    part(
        URDF,
        "inertia of 1e-300",
        'ixx="0.0099667" iyy="0.0099667" izz="0.00099667"',
        'ixx="1e-300" iyy="1e-300" izz="1e-300"',
        "lower_link",
        code=0,
    ),
    *[
        part(URDF, f"damping {x}", ELBOW, f'{ELBOW}<dynamics damping="{x}"/>')
        for x in ("nan", "inf", "-1", "1e300", "many", "1 2")
    ],
    *[
        part(URDF, f"friction {x}", ELBOW, f'{ELBOW}<dynamics friction="{x}"/>')
        for x in ("nan", "inf", "-1", "1e300", "many", "1 2")
    ],
    part(
        URDF,
        "gear of 0",
        "</robot>",
        geared("0", "1"),
        code=0,
    ),
    part(
        URDF,
        "gear nan",
        "</robot>",
        geared("nan", "1"),
    ),
    part(
        URDF,
        "rotor negative",
        "</robot>",
        geared("2", "-1"),
    ),
    part(
        URDF,
        "rotor of 1e300",
        "</robot>",
        geared("2", "1e300"),
    ),
    part(URDF, "two joints of one name", 'joint name="elbow"', 'joint name="shoulder"'),
    part(URDF, "two links of one name", 'link name="base_link"', 'link name="lower_link"'),
    part(URDF, "joint of an empty name", 'joint name="elbow"', 'joint name=""'),
    part(URDF, "joint without a name", 'joint name="elbow"', "joint"),
    part(URDF, "link of an empty name", 'link name="lower_link"', 'link name=""'),
    part(URDF, "link without a name", 'link name="base_link"', "link"),
    part(URDF, "joint without a type", 'name="elbow" type="revolute"', 'name="elbow"'),
    part(
        URDF,
        "joint of an unknown type",
        'name="elbow" type="revolute"',
        'name="elbow" type="rubber"',
    ),
    part(URDF, "joint without a parent", ELBOW, ""),
    part(URDF, "joint without a child", '<child link="lower_link"/>', ""),
    part(URDF, "parent that is not there", ELBOW, '<parent link="nobody"/>'),
    part(URDF, "child that is not there", '<child link="lower_link"/>', '<child link="nobody"/>'),
    part(URDF, "parent without a link", ELBOW, "<parent/>"),
    part(URDF, "link that is its own parent", ELBOW, '<parent link="lower_link"/>'),
    part(URDF, "links in a circle", '<parent link="base_link"/>', '<parent link="lower_link"/>'),
    part(
        URDF,
        "link of two parents",
        "</robot>",
        '<joint name="third" type="revolute"><parent link="base_link"/>'
        '<child link="lower_link"/></joint></robot>',
    ),
    part(
        URDF, "joint that mimics nothing", ELBOW, f'{ELBOW}<mimic joint="nobody"/>', "mimic", code=0
    ),
    part(
        URDF, "joint that mimics itself", ELBOW, f'{ELBOW}<mimic joint="elbow"/>', "mimic", code=0
    ),
    part(
        URDF,
        "mimic of nan",
        ELBOW,
        f'{ELBOW}<mimic joint="shoulder" multiplier="nan"/>',
        "mimic",
        code=0,
    ),
    part(URDF, "link with :: in its name", 'link name="base_link"', 'link name="a::b"'),
    whole("names with ::", URDF.replace("lower_link", "a::b"), "'a::b'", "line 58"),
    whole(
        "names of quotes and ampersands",
        URDF.replace("lower_link", "a&quot;&amp;&lt;b&apos;"),
        code=0,
    ),
    whole("names of spaces", URDF.replace("lower_link", " a  b "), code=0),
    whole("names of other scripts", URDF.replace("lower_link", "关节ü"), code=0),
    whole("names of 100,000 letters", URDF.replace("lower_link", "x" * 100_000), code=0),
    part(URDF, "robot without a name", '<robot name="double_pendulum">', "<robot>", code=0),
    part(
        URDF, "robot of an empty name", '<robot name="double_pendulum">', '<robot name="">', code=0
    ),
    part(
        URDF,
        "robot with :: in its name",
        '<robot name="double_pendulum">',
        '<robot name="a::b">',
        code=0,
    ),
    part(
        URDF,
        "robot called world",
        '<robot name="double_pendulum">',
        '<robot name="WorldModelInstance">',
    ),
    part(
        URDF,
        "joints of several degrees",
        'name="elbow" type="revolute"',
        'name="elbow" type="floating"',
    ),
    part(URDF, "planar joint", 'name="elbow" type="revolute"', 'name="elbow" type="planar"'),
    whole("nothing moves", URDF.replace('"revolute"', '"fixed"'), "No joint moves"),
    whole("robot without links", '<robot name="r"/>', "No joint moves"),
    whole(
        "joints without links",
        '<robot name="r"><joint name="a" type="revolute"><parent link="b"/><child link="c"/>'
        "</joint></robot>",
    ),
    whole("link called world", URDF.replace("base_link", "world"), code=0),
    whole("text between", URDF.replace("<link", "some words <link"), code=0),
    whole("xacro", URDF.replace("<link", "<xacro:if/><link", 1), "xacro"),
    whole("another root", "<house/>", "<house>"),
    whole("no XML", "hello", "not valid XML"),
    whole("two roots", "<robot/><robot/>", "not valid XML"),
    whole("cut short", URDF[:2000], "not valid XML"),
    whole("white space", " \n", "not valid XML"),
    whole("null characters", URDF.replace("elbow", "el\x00bow"), "not valid XML"),
    whole(
        "bytes that are no UTF-8",
        URDF.encode().replace(b"elbow", b"el\xff\xfebow"),
        "not valid XML",
    ),
    whole("random bytes", bytes(range(256)) * 20, "not valid XML"),
    *[
        whole(f"encoding {x}", f'<?xml version="1.0" encoding="{x}"?><robot/>')
        for x in (
            "klingon",
            "hex",
            "rot13",
            "idna",
            "utf-7",
            "utf-16",
            "base64",
            "undefined",
            "cp932",
            "x" * 10_000,
            "../../etc/passwd",
            "",
        )
    ],
    whole("UTF-16", URDF.replace('<?xml version="1.0"?>', "").encode("utf-16"), code=0),
    whole("UTF-32", URDF.replace('<?xml version="1.0"?>', "").encode("utf-32")),
    whole("UTF-8 with a mark", URDF.encode("utf-8-sig"), code=0),
    whole(
        "Latin 1",
        URDF.replace('version="1.0"', 'version="1.0" encoding="latin-1"')
        .replace("lower_link", "lüfter")
        .encode("latin-1"),
        code=0,
    ),
    whole(
        "billion laughs", "<!DOCTYPE robot [" + '<!ENTITY a "ha">' + LAUGHS + "]><robot>&m;</robot>"
    ),
    whole(
        "quadratic entities",
        f'<!DOCTYPE robot [<!ENTITY a "{"x" * 100_000}">]><robot name="{"&a;" * 5000}"/>',
    ),
    whole(
        "external entity",
        '<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="r">&a;</robot>',
    ),
    whole(
        "external entity in a name",
        '<!DOCTYPE robot [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="&a;"/>',
    ),
    whole(
        "external document type",
        URDF.replace("<robot", '<!DOCTYPE robot SYSTEM "http://127.0.0.1:9/x.dtd"><robot', 1),
        code=0,
    ),
    *[
        whole(f"elements {n:,} deep", "<robot>" + "<a>" * n + "</a>" * n + "</robot>")
        for n in (450, 600, 3_000, 100_000)
    ],
    *[
        whole(f"{n:,} links", many_links(n), f"has {n + 1} links", "up to 2000")
        for n in (2_000, 10_000)
    ],
    whole("attribute of 5 MB", f'<robot name="{"x" * 5_000_000}"/>'),
    whole("100,000 attributes", "<robot " + "".join(f"a{k}='' " for k in range(100_000)) + "/>"),
    whole("100 MB", sparse("bad.urdf", 99_000_000)),
]
IN_SDF = [
    *no_numbers(SDF, "pose", '<link name="lower"><pose>0 0 «-0.3» 0 0 0</pose>'),
    part(
        SDF, "pose of five numbers", "<pose>0 0 -0.3 0 0 0", "<pose>0 0 -0.3 0 0", "6 to 7 numbers"
    ),
    *[
        part(
            SDF,
            f"centre of mass {x}",
            "<pose>0 0 -0.2 0 0 0</pose>",
            f"<pose>0 0 {x} 0 0 0</pose>",
            "upper",
            code=0,
        )
        for x in ("nan", "1,5", "many")
    ],
    *no_numbers(SDF, "axis", "<xyz>0 «1» 0</xyz>"),
    *[
        part(SDF, f"mass {x}", "<mass>0.5</mass>", f"<mass>{x}</mass>", "upper has", code=0)
        for x in ("nan", "inf", "many", "1,5", "-1", "0", "1e-300")
    ],
    *[
        part(SDF, f"moment {x}", "<ixx>0.01</ixx>", f"<ixx>{x}</ixx>", "upper has", code=0)
        for x in ("nan", "inf", "many", "-1")
    ],
    *[
        part(SDF, f"{what} 1e300", f"<{what}>{old}", f"<{what}>1e300", "'upper' has 1e+300")
        for what, old in (("mass", "0.5"), ("ixx", "0.01"))
    ],
    *no_numbers(SDF, "damping", "<damping>«0.1»</damping>"),
    *no_numbers(SDF, "friction", "<friction>«0.2»</friction>"),
    *no_numbers(SDF, "lower limit", "<lower>«-6»</lower>", wrong=("nan", "many", "0x10", "1,5")),
    *no_numbers(SDF, "effort limit", "<effort>«5»</effort>", wrong=("nan", "many", "0x10", "1,5")),
    part(SDF, "limits infinite", "<lower>-6</lower>", "<lower>-inf</lower>", code=0),
    part(SDF, "fields empty", "<damping>0.1</damping>", "<damping/>", code=0),
    part(SDF, "axis of zeros", "<xyz>0 1 0</xyz>", "<xyz>0 0 0</xyz>"),
    part(SDF, "limits inverted", "<lower>-6</lower>", "<lower>7</lower>"),
    part(
        SDF,
        "effort negative, which stands for none",
        "<effort>5</effort>",
        "<effort>-1</effort>",
        code=0,
    ),
    part(
        SDF,
        "velocity negative, which stands for none",
        "<effort>5</effort>",
        "<velocity>-1</velocity>",
        code=0,
    ),
    *[
        part(SDF, f"damping {x}", "<damping>0.1</damping>", f"<damping>{x}</damping>")
        for x in ("-1", "1e300")
    ],
    *[
        part(SDF, f"friction {x}", "<friction>0.2</friction>", f"<friction>{x}</friction>")
        for x in ("-1", "1e300")
    ],
    part(
        SDF,
        "stiffness nan",
        "<friction>",
        "<spring_stiffness>nan</spring_stiffness><friction>",
        code=0,
    ),
    part(
        SDF,
        "pose in a circle",
        "<child>lower</child>",
        '<child>lower</child><pose relative_to="elbow"/>',
    ),
    part(
        SDF,
        "frames in a circle",
        "</model>",
        '<frame name="a" attached_to="b"/><frame name="b" attached_to="a"/></model>',
    ),
    part(
        SDF,
        "pose relative to nothing",
        "<child>lower</child>",
        '<child>lower</child><pose relative_to="nobody"/>',
    ),
    part(SDF, "parent that is not there", "<parent>upper</parent>", "<parent>nobody</parent>"),
    part(SDF, "joint without a child", "<child>lower</child>", ""),
    part(SDF, "joint without a name", 'joint name="elbow"', "joint"),
    part(
        SDF,
        "joint of an unknown type",
        'name="elbow" type="revolute"',
        'name="elbow" type="rubber"',
    ),
    part(SDF, "two joints of one name", 'joint name="elbow"', 'joint name="shoulder"'),
    part(SDF, "two links of one name", 'link name="lower"', 'link name="upper"'),
    part(SDF, "link without a name", 'link name="lower"', "link"),
    part(SDF, "link of an empty name", 'link name="lower"', 'link name=""'),
    part(SDF, "link with :: in its name", 'link name="lower"', 'link name="a::b"'),
    part(SDF, "links in a circle", "<parent>world</parent>", "<parent>lower</parent>"),
    part(SDF, "reserved name", 'link name="lower"', 'link name="__root__"'),
    part(SDF, "no version", ' version="1.9"', ""),
    part(SDF, "version of 99", ' version="1.9"', ' version="99"'),
    part(SDF, "version of words", ' version="1.9"', ' version="new"'),
    part(SDF, "model without a name", '<model name="robot">', "<model>"),
    whole("no model", '<sdf version="1.9"/>', suffix="sdf"),
    whole("two models", SDF.replace("</sdf>", SDF[SDF.index("<model") :]), suffix="sdf"),
    whole(
        "models 100 deep",
        '<sdf version="1.9">'
        + "".join(f'<model name="m{k}">' for k in range(100))
        + "</model>" * 100
        + "</sdf>",
        suffix="sdf",
    ),
    whole("includes itself", included("bad.sdf"), suffix="sdf"),
    whole(
        "includes itself in a world", included("bad.sdf").replace("model", "world"), suffix="sdf"
    ),
    whole(
        "includes itself in a model below",
        included("bad.sdf")
        .replace("<include>", '<model name="m"><include>')
        .replace("</include>", "</include></model>"),
        suffix="sdf",
    ),
    whole("includes itself by dots", included("./x/../bad.sdf"), suffix="sdf"),
    whole(
        "includes itself and itself",
        included("bad.sdf").replace("</model>", "<include><uri>bad.sdf</uri></include></model>"),
        suffix="sdf",
    ),
    whole("a circle of two", chain(2), suffix="sdf"),
    whole("a circle of seven", chain(7), suffix="sdf"),
    whole("a circle further on", chain(7, last=4), suffix="sdf"),
    whole("a chain of 2,000", chain(2000, last="robot"), suffix="sdf"),
    whole(
        "includes itself by a link",
        every(file("bad.sdf", included("x.sdf")), link("x.sdf", "bad.sdf")),
        suffix="sdf",
    ),
    whole(
        "includes itself by a link to the folder",
        every(file("bad.sdf", included("x/bad.sdf")), link("x", ".")),
        suffix="sdf",
    ),
    whole(
        "includes itself by a folder",
        every(file("bad.sdf", included("x")), file("x/model.sdf", included("../bad.sdf"))),
        suffix="sdf",
    ),
    whole(
        "includes itself by a package",
        every(
            file("bad.sdf", included("package://p/bad.sdf")),
            file("package.xml", PACKAGE.format("p")),
        ),
        suffix="sdf",
        apart=True,
    ),
    whole(
        "includes itself by model://",
        every(
            file("bad.sdf", included("model://p/bad.sdf")), file("package.xml", PACKAGE.format("p"))
        ),
        suffix="sdf",
    ),
    whole(
        "includes itself by file://",
        lambda f: file("bad.sdf", included(f"file://{f}/bad.sdf"))(f),
        suffix="sdf",
        apart=True,
    ),
    whole(
        "includes itself by its whole path",
        lambda f: file("bad.sdf", included(f"{f}/bad.sdf"))(f),
        suffix="sdf",
    ),
    whole(
        "a circle by a package",
        every(
            file("bad.sdf", included("package://p/b.sdf")),
            file("package.xml", PACKAGE.format("p")),
            file("b.sdf", included("bad.sdf")),
        ),
        suffix="sdf",
    ),
    whole(
        "a circle in a package",
        every(
            file("bad.sdf", included("package://p/b.sdf")),
            file("package.xml", PACKAGE.format("p")),
            file("b.sdf", included("c.sdf")),
            file("c.sdf", included("b.sdf")),
        ),
        suffix="sdf",
        apart=True,
    ),
    whole(
        "includes that double",
        lambda f: [
            file(
                f"{'bad' if k == 0 else k}.sdf",
                included(f"{k + 1}.sdf").replace(
                    "</model>", f"<include><uri>{k + 1}.sdf</uri></include></model>"
                ),
            )(f)
            for k in range(30)
        ],
        suffix="sdf",
    ),
    whole("includes what is not there", included("nobody.sdf"), suffix="sdf"),
    whole("includes nothing", included(""), suffix="sdf"),
    whole(
        "includes an empty folder",
        every(file("bad.sdf", included("x")), lambda f: (f / "x").mkdir()),
        suffix="sdf",
    ),
    whole(
        "includes a pipe", every(file("bad.sdf", included("x.sdf")), pipe("x.sdf")), suffix="sdf"
    ),
    whole("includes a device", included("/dev/zero"), suffix="sdf"),
    whole("includes a device by file://", included("file:///dev/zero"), suffix="sdf"),
    whole("includes a log", included("log.csv"), suffix="sdf"),
    whole("includes an unknown package", included("package://nobody/x.sdf"), suffix="sdf"),
    whole("includes from the network", included("http://127.0.0.1:9/x.sdf"), suffix="sdf"),
    whole(
        "includes a path out of its package",
        every(
            file("bad.sdf", included("package://p/../bad.sdf")),
            below("q", file("package.xml", PACKAGE.format("p"))),
        ),
        suffix="sdf",
    ),
    whole("includes a name of 300 letters", included("x" * 300), suffix="sdf"),
    whole("includes a name with a null", included("a%00b"), suffix="sdf"),
]
IN_MJCF = [
    *no_numbers(MJCF, "armature", 'armature="«0.01»"'),
    *no_numbers(MJCF, "frictionloss", 'frictionloss="«0.2»"'),
    *no_numbers(MJCF, "damping", 'damping="«0.1»"'),
    *no_numbers(MJCF, "gear", 'gear="«2»"'),
    *no_numbers(MJCF, "control range", 'ctrlrange="-1 «1»"', wrong=("nan", "many", "0x10", "1,5")),
    *no_numbers(MJCF, "force range", 'forcerange="«-3» 3"', wrong=("nan", "many", "0x10", "1,5")),
    *no_numbers(MJCF, "range", 'range="-6 «6»"', wrong=("nan", "many", "0x10", "1,5")),
    *no_numbers(MJCF, "axis", 'axis="0 «1» 0"'),
    *no_numbers(MJCF, "place of a body", 'pos="0 0 «-0.3»"'),
    *[
        part(MJCF, f"mass {x or 'empty'}", 'mass="0.5"', f'mass="{x}"', code=0)
        for x in ("nan", "many", "-1", "")
    ],
    part(MJCF, "mass 1e300", 'mass="0.5"', 'mass="1e300"', "'upper' has 1e+300"),
    part(MJCF, "mass 1e-300", 'mass="0.5"', 'mass="1e-300"', "upper has", code=0),
    part(MJCF, "range inverted", "-6 6", "6 -6"),
    part(MJCF, "range of three", "-6 6", "-6 0 6"),
    part(MJCF, "axis of zeros", 'axis="0 1 0"', 'axis="0 0 0"'),
    part(MJCF, "armature negative", 'armature="0.01"', 'armature="-1"'),
    part(MJCF, "armature of 1e300", 'armature="0.01"', 'armature="1e300"'),
    part(MJCF, "frictionloss negative", 'frictionloss="0.2"', 'frictionloss="-1"'),
    part(MJCF, "damping negative", 'damping="0.1"', 'damping="-1"'),
    part(MJCF, "damping of 1e300", 'damping="0.1"', 'damping="1e300"'),
    part(MJCF, "gear of 0", 'gear="2"', 'gear="0"', code=0),
    part(MJCF, "turn of zeros", 'pos="0 0 -0.3"', 'quat="0 0 0 0"'),
    part(MJCF, "turn of nan", 'pos="0 0 -0.3"', 'quat="nan 0 0 0"'),
    part(MJCF, "Euler angles of words", 'pos="0 0 -0.3"', 'euler="a b c"'),
    part(MJCF, "order of angles unknown", "<default>", '<compiler eulerseq="abc"/><default>'),
    part(
        MJCF,
        "stiffness nan",
        'axis="0 1 0" frictionloss',
        'axis="0 1 0" stiffness="nan" frictionloss',
    ),
    part(MJCF, "unknown type of joint", 'name="elbow"', 'name="elbow" type="rubber"'),
    part(MJCF, "two joints of one name", 'name="elbow"', 'name="shoulder"'),
    part(MJCF, "two bodies of one name", 'name="lower"', 'name="upper"'),
    part(MJCF, "motor of no joint", 'joint="elbow"', 'joint="nobody"'),
    part(MJCF, "no bodies", MJCF[MJCF.index("<worldbody") : MJCF.index("<actuator")], ""),
    part(
        MJCF,
        "body without inertia",
        '<body name="lower"',
        '<body name="foo"><joint/></body><body name="lower"',
        "foo_joint_0 at 0",
        code=0,
    ),
    part(
        MJCF,
        "geom of no size",
        '<inertial pos="0 0 -0.2"',
        '<geom type="sphere"/><inertial2 pos="0 0 -0.2"',
        code=0,
    ),
    part(
        MJCF,
        "geom of an unknown type",
        '<inertial pos="0 0 -0.2"',
        '<geom type="cloud" size="1"/><inertial2 pos="0 0 -0.2"',
    ),
    part(
        MJCF,
        "geom of nan",
        '<inertial pos="0 0 -0.2"',
        '<geom type="sphere" size="nan"/><inertial2 pos="0 0 -0.2"',
    ),
    part(
        MJCF,
        "geom of negative size",
        '<inertial pos="0 0 -0.2"',
        '<geom type="sphere" size="-1"/><inertial2 pos="0 0 -0.2"',
    ),
    part(
        MJCF,
        "density nan",
        '<inertial pos="0 0 -0.2"',
        '<geom type="sphere" size="1" density="nan"/><inertial2 pos="0 0 -0.2"',
    ),
    whole(
        "mesh that is a pipe",
        every(
            file(
                "bad.xml",
                MJCF.replace("<default>", '<asset><mesh name="x" file="x.obj"/></asset><default>'),
            ),
            pipe("x.obj"),
        ),
        suffix="xml",
        code=0,
    ),
    whole(
        "mesh that is a device",
        MJCF.replace("<default>", '<asset><mesh name="x" file="/dev/zero"/></asset><default>'),
        suffix="xml",
        code=0,
    ),
    whole(
        "a circle of two",
        every(
            file("bad.xml", MJCF.replace("<default>", '<include file="b.xml"/><default>')),
            file("b.xml", '<mujocoinclude><include file="bad.xml"/></mujocoinclude>'),
        ),
        "includes itself",
        suffix="xml",
    ),
    whole(
        "includes a pipe",
        every(
            file("bad.xml", MJCF.replace("<default>", '<include file="b.xml"/><default>')),
            pipe("b.xml"),
        ),
        "is a pipe",
        suffix="xml",
    ),
    part(MJCF, "includes nothing", "<default>", "<include/><default>", "is a folder"),
    whole(
        "includes its joints",
        every(
            file(
                "bad.xml",
                MJCF.replace(
                    '<joint name="elbow" axis="0 1 0" frictionloss="0.2"/>',
                    '<include file="b.xml"/>',
                ),
            ),
            file("b.xml", '<mujocoinclude><joint name="elbow" axis="0 1 0"/></mujocoinclude>'),
        ),
        suffix="xml",
        code=0,
    ),
    part(MJCF, "includes itself", "<default>", '<include file="bad.xml"/><default>'),
    part(MJCF, "includes what is not there", "<default>", '<include file="nobody.xml"/><default>'),
    whole(
        "bodies 3,000 deep",
        "<mujoco><worldbody>"
        + "<body><joint/>" * 3000
        + "</body>" * 3000
        + "</worldbody></mujoco>",
        suffix="xml",
    ),
    whole(
        "bodies 200 deep",
        "<mujoco><worldbody>"
        + '<body><joint/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/>' * 200
        + "</body>" * 200
        + "</worldbody></mujoco>",
        suffix="xml",
    ),
    whole("nothing", "<mujoco/>", suffix="xml"),
]
IN_DIRECTIVES = [
    whole("includes itself", directives("bad.dmd.yaml"), suffix="dmd.yaml"),
    whole(
        "includes itself by its path",
        lambda f: file("bad.dmd.yaml", directives(f"{f}/bad.dmd.yaml"))(f),
        suffix="dmd.yaml",
    ),
    whole(
        "includes itself by a package",
        every(
            file("bad.dmd.yaml", directives("package://p/bad.dmd.yaml")),
            file("package.xml", PACKAGE.format("p")),
        ),
        suffix="dmd.yaml",
        apart=True,
    ),
    whole(
        "includes itself by file://",
        lambda f: file("bad.dmd.yaml", directives(f"file://{f}/bad.dmd.yaml"))(f),
        suffix="dmd.yaml",
        apart=True,
    ),
    whole(
        "a circle of two",
        lambda f: [
            file("bad.dmd.yaml", directives(f"file://{f}/b.dmd.yaml"))(f),
            file("b.dmd.yaml", directives(f"file://{f}/bad.dmd.yaml"))(f),
        ],
        suffix="dmd.yaml",
        apart=True,
    ),
    whole(
        "a circle by a link",
        lambda f: [
            file("bad.dmd.yaml", directives(f"file://{f}/b.dmd.yaml"))(f),
            link("b.dmd.yaml", "bad.dmd.yaml")(f),
        ],
        suffix="dmd.yaml",
    ),
    whole(
        "adds itself as a model",
        "directives:\n- add_model: {name: a, file: bad.dmd.yaml}\n",
        suffix="dmd.yaml",
    ),
    whole(
        "adds itself as a model by file://",
        lambda f: file(
            "bad.dmd.yaml",
            f"directives:\n- add_model: {{name: a, file: 'file://{f}/bad.dmd.yaml'}}\n",
        )(f),
        suffix="dmd.yaml",
    ),
    whole(
        "adds an SDF that includes itself",
        every(
            file("bad.dmd.yaml", DIRECTIVES.replace("robot.urdf", "b.sdf")),
            file("b.sdf", included("b.sdf")),
        ),
        suffix="dmd.yaml",
    ),
    whole(
        "adds a pipe",
        every(file("bad.dmd.yaml", DIRECTIVES.replace("robot.urdf", "x.urdf")), pipe("x.urdf")),
        suffix="dmd.yaml",
    ),
    whole("adds a device", DIRECTIVES.replace("robot.urdf", "/dev/zero"), suffix="dmd.yaml"),
    whole(
        "adds what is not there",
        DIRECTIVES.replace("robot.urdf", "nobody.urdf"),
        "nobody.urdf",
        suffix="dmd.yaml",
    ),
    whole("adds a log", DIRECTIVES.replace("robot.urdf", "log.csv"), suffix="dmd.yaml"),
    whole(
        "adds from an unknown package",
        DIRECTIVES.replace("robot.urdf", "package://nobody/x.urdf"),
        suffix="dmd.yaml",
    ),
    whole(
        "adds from the network",
        DIRECTIVES.replace("robot.urdf", "http://127.0.0.1:9/x.urdf"),
        suffix="dmd.yaml",
    ),
    whole(
        "adds a nameless model",
        "directives:\n- add_model: {name: '', file: robot.urdf}\n",
        suffix="dmd.yaml",
    ),
    whole(
        "adds two models of one name", DIRECTIVES + DIRECTIVES.partition("\n")[2], suffix="dmd.yaml"
    ),
    whole(
        "adds 1,000 models",
        "directives:\n"
        + "".join(f"- add_model: {{name: a{k}, file: robot.urdf}}\n" for k in range(1000)),
        suffix="dmd.yaml",
    ),
    whole(
        "weld of nan",
        DIRECTIVES
        + "- add_weld: {parent: world, child: arm::base_link, X_PC: {translation: [.nan, 0, 0]}}\n",
        suffix="dmd.yaml",
    ),
    whole(
        "weld of 1e99",
        DIRECTIVES
        + "- add_weld: {parent: world, child: arm::base_link, X_PC: {translation: [0, 1e99, 0]}}\n",
        suffix="dmd.yaml",
    ),
    whole(
        "weld to nothing",
        DIRECTIVES + "- add_weld: {parent: world, child: arm::nobody}\n",
        suffix="dmd.yaml",
    ),
    whole(
        "weld in a circle",
        DIRECTIVES + "- add_weld: {parent: arm::lower_link, child: arm::base_link}\n",
        suffix="dmd.yaml",
    ),
    whole(
        "weld to itself",
        DIRECTIVES + "- add_weld: {parent: arm::base_link, child: arm::base_link}\n",
        suffix="dmd.yaml",
    ),
    whole(
        "position of a joint that is not there",
        DIRECTIVES.replace("}", ", default_joint_positions: {nobody: [1]}}"),
        suffix="dmd.yaml",
    ),
    whole(
        "position of too many numbers",
        DIRECTIVES.replace("}", ", default_joint_positions: {elbow: [1, 2, 3]}}"),
        suffix="dmd.yaml",
    ),
    whole(
        "position nan",
        DIRECTIVES.replace("}", ", default_joint_positions: {elbow: [.nan]}}"),
        suffix="dmd.yaml",
    ),
    whole("no directives", "directives: []\n", suffix="dmd.yaml"),
    whole("null", "directives:\n", suffix="dmd.yaml"),
    whole("a list", "- a\n- b\n", suffix="dmd.yaml"),
    whole("a word", "hello\n", suffix="dmd.yaml"),
    whole("another key", "models: []\n", suffix="dmd.yaml"),
    whole("no YAML", "directives: [\n", suffix="dmd.yaml"),
    whole("tabs", "directives:\n\t- a\n", suffix="dmd.yaml"),
    whole(
        "tags that run",
        'directives: !!python/object/apply:os.system ["touch PWNED"]\n',
        suffix="dmd.yaml",
    ),
    whole("an anchor in itself", "directives: &a [*a]\n", suffix="dmd.yaml", apart=True),
    whole(
        "a bomb of anchors",
        "a: &a [x, x]\n"
        + "".join(
            f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 9)}]\n"
            for k in range(12)
        )
        + "directives: *m\n",
        suffix="dmd.yaml",
        apart=True,
    ),
    *[
        whole(
            f"lists {n:,} deep", "directives: " + "[" * n + "]" * n, suffix="dmd.yaml", apart=True
        )
        for n in (1000, 100_000)
    ],
    whole("null characters", DIRECTIVES.replace("arm", "a\x00rm"), suffix="dmd.yaml"),
    whole(
        "bytes that are no UTF-8",
        DIRECTIVES.encode().replace(b"arm", b"a\xff\xferm"),
        suffix="dmd.yaml",
    ),
]
COMMANDS = (
    "compare {} log.csv",
    "diagnose {} log.csv",
    "add coulomb_friction {} log.csv",
    "explain {} log.csv",
    "rollout {} log.csv",
    "rollout robot.urdf log.csv --before {}",
    "identify {} log.csv",
    "identifiable {} log.csv",
    "digest {} log.csv --to new",
    "excite {}",
)
PATHS = [
    *[
        Row(
            f"{command.partition(' ')[0]} of a pipe",
            command.format(name),
            ("is a pipe, not a file",),
            pipe(name),
        )
        for command in COMMANDS
        for name in ("x.urdf", "x.yaml")
    ],
    *[
        Row(f"{path}", f"compare {path} log.csv", (words,), make)
        for path, words, make in (
            ("/dev/zero", "is a device", lambda f: None),
            ("/dev/null", "is a device", lambda f: None),
            ("/dev/stdin", "is a", lambda f: None),
            ("/dev/tty", "is a device", lambda f: None),
            (".", "is a folder", lambda f: None),
            ("x", "is a socket", deaf_socket("x")),
            ("x.urdf", "does not exist", link("x.urdf", "nobody")),
            ("x.urdf", "symbolic links", link("x.urdf", "x.urdf")),
            ("x.yaml", "symbolic links", link("x.yaml", "x.yaml")),
            ("robot.urdf/x.urdf", "Not a directory", lambda f: None),
            ("x" * 300 + ".urdf", "name too long", lambda f: None),
            ("y/" * 3000 + "x.urdf", "name too long", lambda f: None),
            ("x.urdf", "is empty", file("x.urdf", "")),
            ("x.yaml", "is empty", file("x.yaml", "")),
            ("x.urdf", "MB are read", sparse("x.urdf", 150_000_000)),
            ("x.yaml", "MB are read", sparse("x.yaml", 150_000_000)),
            ("''", "", lambda f: None),
            ("-", "", lambda f: None),
            ("nobody.urdf", "does not exist", lambda f: None),
        )
    ],
    Row("name that is no UTF-8", "compare \udcff\udcfe.urdf log.csv", ("does not exist",)),
    Row(
        "model whose name is no UTF-8",
        "compare \udcff.urdf log.csv --json new.json",
        (r"\udcff.urdf against log.csv",),
        lambda f: (f / "robot.urdf").rename(f / "\udcff.urdf"),
        code=0,
        writes=("new.json",),
    ),
    Row("null character in the path", "compare a\x00b.urdf log.csv", ("null",)),
]
NEAR = "compare p/robot.urdf log.csv"
ROBOT = below("p", file("robot.urdf", URDF))
PACKAGES = [
    *[
        Row(f"package.xml that is {name}", NEAR, (), every(ROBOT, below("p", make)), code=0)
        for name, make in (
            ("empty", file("package.xml", "")),
            ("no XML", file("package.xml", "hello")),
            ("without a name", file("package.xml", "<package/>")),
            ("of an empty name", file("package.xml", PACKAGE.format(""))),
            ("of another root", file("package.xml", "<a/>")),
            ("binary", file("package.xml", bytes(range(256)))),
            ("huge", sparse("package.xml", 10_000_000)),
            ("a folder", lambda f: (f / "package.xml").mkdir()),
            ("a pipe", pipe("package.xml")),
            ("a link to itself", link("package.xml", "package.xml")),
            ("a link to a device", link("package.xml", "/dev/zero")),
            ("of the name of another one", file("package.xml", PACKAGE.format("drake"))),
            ("3,000 deep", file("package.xml", "<a>" * 3000)),
        )
    ],
    Row(
        "two packages of one name",
        "compare p/q/robot.urdf log.csv",
        (),
        every(
            below("p", file("package.xml", PACKAGE.format("p"))),
            below(
                "p",
                below(
                    "q", every(file("robot.urdf", URDF), file("package.xml", PACKAGE.format("p")))
                ),
            ),
        ),
        code=0,
    ),
    *[
        Row(
            f"ROS_PACKAGE_PATH {value}",
            "compare robot.urdf log.csv",
            (),
            make,
            code=0,
            apart=True,
            environment={"ROS_PACKAGE_PATH": value},
        )
        for value, make in (
            ("/nowhere", lambda f: None),
            ("x:::robot.urdf:", lambda f: None),
            ("/", lambda f: None),
            (
                "x",
                every(
                    lambda f: (f / "x").mkdir(),
                    link("x/y", "."),
                    below("x", below("z", file("package.xml", "hello"))),
                ),
            ),
        )
    ],
]


@pytest.mark.sampled(5)
@pytest.mark.parametrize(
    "row", [*IN_URDF, *IN_SDF, *IN_MJCF, *IN_DIRECTIVES, *PATHS, *PACKAGES], ids=str
)
def test_row(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)
