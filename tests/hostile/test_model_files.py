"""Model files that are wrong, unlucky or meant to harm."""

import os
from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from good_files import DIRECTIVES, MJCF, SDF, URDF
from hostile import Row

GOOD = {"URDF": URDF, "SDF": SDF, "MJCF": MJCF, "DIRECTIVES": DIRECTIVES}
ROWS = Path(__file__).parent / "rows"


def file(name, content):
    """Makes a file of a text or of bytes."""

    def make(folder):
        (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)

    return make


def whole(name, content, *says, suffix="urdf", code=2, command="compare {} log.csv"):
    """A row of a model file with some content, or of several that are made."""
    path = f"bad.{suffix}"
    make = content if callable(content) else file(path, content)
    return Row(
        f"{suffix}: {name}", command.format(path), says, make, code, apart=suffix == "dmd.yaml"
    )


class Maker(yaml.SafeLoader):
    """A reader of rows whose tags make what is not a text."""


def _tag(name, make):
    def construct(loader, node):
        given = loader.construct_sequence(node) if name == "!changed" else [node.value]
        return lambda path: make(path, *given)

    Maker.add_constructor(name, construct)


def _changed(path, base, old="", new=""):
    count = -1 if old.startswith("/") else 1  # every one, after a slash
    path.write_text(GOOD[base].replace(old.removeprefix("/"), new, count), encoding="utf-8")


def included(uri):
    include = f"<include><uri>{uri}</uri></include>"
    return f'<sdf version="1.9"><model name="robot">{include}</model></sdf>'


def directives(uri):
    return f"directives:\n- add_directives: {{file: {uri}}}\n"


def in_folder(path, text):
    path.write_text(text.replace("{folder}", str(path.parent)), encoding="utf-8")


_tag("!link", lambda path, target: path.symlink_to(target))
_tag("!pipe", lambda path, _: os.mkfifo(path))
_tag("!folder", lambda path, _: path.mkdir())
_tag("!sparse", lambda path, size: (path.touch(), os.truncate(path, int(size))))
_tag("!deep", lambda path, count: path.write_text("<a>" * int(count), encoding="utf-8"))
_tag("!includes", lambda path, uri: in_folder(path, included(uri)))
_tag("!adds", lambda path, uri: in_folder(path, directives(uri)))
_tag("!changed", _changed)


def tree_rows():
    """Rows of several files."""
    found = yaml.load((ROWS / "model_files_apart.yaml").read_text(encoding="utf-8"), Maker)
    for end, rows in found.items():
        for kind, files, *says in rows:

            def make(folder, files=files):
                for name, content in files.items():
                    path = folder / name
                    path.parent.mkdir(parents=True, exist_ok=True)
                    if callable(content):
                        content(path)
                    else:
                        path.write_text(content, encoding="utf-8")

            first = next(iter(files))
            code = {"refused": 2, "read": 0}[end]
            apart = "://" in kind or "package" in kind or "circle" in kind
            command = f"compare {first} log.csv"
            yield Row(f"{first}: {kind}", command, says, make, code, apart=apart)


def chain(count, last=0):
    """SDF files each of which includes the next, and the last the one of a number."""

    def make(folder):
        for k in range(count):
            following = k + 1 if k + 1 < count else last
            name, target = ("bad" if x == 0 else x for x in (k, following))
            (folder / f"{name}.sdf").write_text(included(f"{target}.sdf"), encoding="utf-8")

    return make


def doubling(folder):
    for k in range(30):
        twice = f"<include><uri>{k + 1}.sdf</uri></include></model>"
        text = included(f"{k + 1}.sdf").replace("</model>", twice)
        (folder / f"{k or 'bad'}.sdf").write_text(text, encoding="utf-8")


def below(folder):
    (folder / "x" / "z").mkdir(parents=True)
    (folder / "x" / "y").symlink_to(".")
    (folder / "x" / "z" / "package.xml").write_text("hello", encoding="utf-8")


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


AT_3_HZ = "compare {} log.csv --bandwidth 3"  # where the robot's efforts tell none
IXX = '"0.0099667" iyy'
DEEP = '<body><joint/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/>'
BOMB = "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in pairwise("abcdefghijklm"))
MADE = [
    whole("inertia nan", URDF.replace(IXX, '"nan" iyy', 1), "lower_link", code=0, command=AT_3_HZ),
    whole("names of 100,000 letters", URDF.replace("lower_link", "x" * 100_000), code=0),
    whole("cut short", URDF[:2000], "not valid XML"),
    whole("no UTF-8", URDF.encode().replace(b"elbow", b"el\xff\xfebow"), "not valid XML"),
    whole("random bytes", bytes(range(256)) * 20, "not valid XML"),
    whole("UTF-16", URDF.replace('<?xml version="1.0"?>', "").encode("utf-16"), code=0),
    whole("UTF-32", URDF.replace('<?xml version="1.0"?>', "").encode("utf-32")),
    whole("UTF-8 with a mark", URDF.encode("utf-8-sig"), code=0),
    whole("Latin 1", URDF.replace('version="1.0"', 'version="1.0" encoding="latin-1"').replace(
        "lower_link", "lüfter").encode("latin-1"), code=0),
    whole("billion laughs", f'<!DOCTYPE robot [<!ENTITY a "ha">{LAUGHS}]><robot>&m;</robot>'),
    whole("quadratic entities",
        f'<!DOCTYPE robot [<!ENTITY a "{"x" * 100_000}">]><robot name="{"&a;" * 5000}"/>'),
    whole("elements 450 deep", "<robot>" + "<a>" * 450 + "</a>" * 450 + "</robot>"),
    whole("elements 100,000 deep", "<robot>" + "<a>" * 100_000 + "</a>" * 100_000 + "</robot>"),
    whole("2,000 links", many_links(2000), "has 2001 links", "up to 2000"),
    whole("attribute of 5 MB", f'<robot name="{"x" * 5_000_000}"/>'),
    whole("100,000 attributes", "<robot " + "".join(f"a{k}='' " for k in range(100_000)) + "/>"),
    whole("two models", SDF.replace("</sdf>", SDF[SDF.index("<model") :]), suffix="sdf"),
    whole("models 100 deep", '<sdf version="1.9">' + "".join(
        f'<model name="m{k}">' for k in range(100)) + "</model>" * 100 + "</sdf>", suffix="sdf"),
    whole("a circle further on", chain(7, last=4), suffix="sdf"),
    whole("a chain of 2,000", chain(2000, last="robot"), suffix="sdf"),
    whole("includes that double", doubling, suffix="sdf"),
    whole("includes a name of 300 letters", included("x" * 300), suffix="sdf"),
    whole("bodies 3,000 deep", "<mujoco><worldbody>" + "<body><joint/>" * 3000 + "</body>" * 3000
        + "</worldbody></mujoco>", suffix="xml"),
    whole("bodies 200 deep", "<mujoco><worldbody>" + DEEP * 200 + "</body>" * 200
        + "</worldbody></mujoco>", suffix="xml"),
    whole("adds 1,000 models", "directives:\n" + "".join(
        f"- add_model: {{name: a{k}, file: robot.urdf}}\n" for k in range(1000)),
        suffix="dmd.yaml"),
    whole("a bomb of anchors", f"a: &a [x, x]\n{BOMB}directives: *m\n", suffix="dmd.yaml"),
    whole("lists 1,000 deep", "directives: " + "[" * 1000 + "]" * 1000, suffix="dmd.yaml"),
    whole("lists 100,000 deep", "directives: " + "[" * 10**5 + "]" * 10**5, suffix="dmd.yaml"),
    whole("no UTF-8", DIRECTIVES.encode().replace(b"arm", b"a\xff\xferm"), suffix="dmd.yaml"),
]  # fmt: skip
NO_UTF8 = Row("a name that is no UTF-8", "compare \udcff.urdf log.csv --json new.json",
    (r"\udcff.urdf against log.csv",), lambda f: (f / "robot.urdf").rename(f / "\udcff.urdf"),
    code=0, writes=("new.json",))  # fmt: skip
PATHS = [
    NO_UTF8,
    Row("a missing name that is no UTF-8", "compare \udcff.urdf log.csv", ("does not exist",)),
    *(Row(f"ROS_PACKAGE_PATH {value}", "compare robot.urdf log.csv", (), below, code=0,
        apart=True, environment={"ROS_PACKAGE_PATH": value}) for value in ("x:::robot.urdf:", "/")),
]  # fmt: skip


def other(name, base, old, new, *says, code=2):
    """A row of a good file with another text in the place of one."""
    assert old in base, old
    suffix = {URDF: "urdf", SDF: "sdf", MJCF: "xml"}[base]
    return whole(name, base.replace(old, new, 1), *says, suffix=suffix, code=code)


TYPE, CHILD = 'name="elbow" type="revolute"', "<child>lower</child>"
ELBOW = '<joint name="elbow" axis="0 1 0"'
TEXTS = [
    other("axis inf", URDF, 'axis xyz="0 1 0"', 'axis xyz="0 inf 0"', "line 31"),
    other("limits inverted", URDF, 'lower="-6.2832"', 'lower="7"', "line 32", "lower end 7"),
    other("effort negative", URDF, 'effort="6"', 'effort="-6"', "effort='-6'", "below 0"),
    other("centre of mass of 1e10", URDF, "0 0 -0.2557", "0 0 1e10", "lower_link", "above 1e+12"),
    other("joints of several degrees", URDF, TYPE, TYPE.replace("revolute", "floating")),
    other("planar joint", URDF, TYPE, TYPE.replace("revolute", "planar")),
    other("mass nan", URDF, '"0.6256"', '"nan"', "lower_link", code=0),
    other("mass of 1e-300", URDF, '"0.6256"', '"1e-300"', "mass of 1e-300 kg", code=0),
    other("pose of five numbers", SDF, "0 0 -0.3 0 0 0", "0 0 -0.3 0 0", "6 to 7 numbers"),
    other("mass 1e300", SDF, "<mass>0.5", "<mass>1e300", "'upper' has 1e+300"),
    other("pose in a circle", SDF, CHILD, f'{CHILD}<pose relative_to="elbow"/>'),
    other("frames in a circle", SDF, "</model>",
        '<frame name="a" attached_to="b"/><frame name="b" attached_to="a"/></model>'),
    other("pose relative to nothing", SDF, CHILD, f'{CHILD}<pose relative_to="nobody"/>'),
    other("turn of zeros", MJCF, 'pos="0 0 -0.3"', 'quat="0 0 0 0"'),
    other("order of angles unknown", MJCF, "<default>", '<compiler eulerseq="abc"/><default>'),
    other("stiffness nan", MJCF, ELBOW, f'{ELBOW} stiffness="nan"'),
    other("unknown type of joint", MJCF, ELBOW, f'{ELBOW} type="rubber"'),
    other("geom of nan", MJCF, "<inertial ", '<geom type="sphere" size="nan"/><other '),
    other("geom of no density", MJCF, "<inertial ",
        '<geom type="sphere" size="1" density="nan"/><other '),
]  # fmt: skip
FILES = [*tree_rows(), *MADE, *PATHS, *TEXTS]


@pytest.mark.parametrize("row", [row for row in FILES if row.code], ids=str)
def test_files_that_are_refused(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("row", [row for row in FILES if not row.code], ids=str)
def test_what_is_read(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)
