"""Model files that are wrong, unlucky or meant to harm; what one changed value makes is swept."""

import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from good_files import DIRECTIVES, MJCF, SAVED, SDF, UNINFORMED, URDF, information
from hostile import Row, link, put

GOOD = {"URDF": URDF, "SDF": SDF, "MJCF": MJCF, "DIRECTIVES": DIRECTIVES}
COMPARE = "compare {} log.csv"
ROWS = Path(__file__).parent / "rows"


def whole(name, content, *says, file="bad.urdf", code=2, command=COMPARE, beside=()):
    """A row of a model file with some content, beside other files."""
    says = (*says, file) if code and file == "saved.yaml" else says
    files = {**dict(beside), file: content}
    apart = file == "bad.dmd.yaml"
    return Row(f"{file}: {name}", command.format(file), says, files, code, apart=apart)


class Maker(yaml.SafeLoader):
    """A reader of rows whose tags make what is not a text."""


def _tag(name, make):
    def construct(loader, node):
        given = loader.construct_sequence(node) if name == "!changed" else [node.value]
        return lambda path: make(path, *given)

    Maker.add_constructor(name, construct)


def _changed(path, base, old="", new=""):
    assert old.removeprefix("/") in GOOD[base], old
    count = -1 if old.startswith("/") else 1  # every one, after a slash
    path.write_text(GOOD[base].replace(old.removeprefix("/"), new, count), encoding="utf-8")


def included(*uris):
    includes = "".join(f"<include><uri>{uri}</uri></include>" for uri in uris)
    return f'<sdf version="1.9"><model name="robot">{includes}</model></sdf>'


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
    found = yaml.load((ROWS / "model_files.yaml").read_text(encoding="utf-8"), Maker)
    for code, rows in ((2, found["refused"]), (0, found["read"])):
        for kind, files, *says in rows:
            first = next(iter(files))
            apart = "://" in kind or "package" in kind or "circle" in kind
            command = f"compare {first} log.csv"
            yield Row(f"{first}: {kind}", command, says, files, code, apart=apart)


def chain(count, last=0):
    """SDF files each of which includes the next, and the last the one of a number."""

    def make(path):
        names = ["bad" if k == 0 else k for k in (*range(count), last)]
        for name, following in pairwise(names):
            text = included(f"{following}.sdf")
            (path.parent / f"{name}.sdf").write_text(text, encoding="utf-8")

    return make


def doubling(path):
    for k in range(30):
        text = included(f"{k + 1}.sdf", f"{k + 1}.sdf")
        (path.parent / f"{k or 'bad'}.sdf").write_text(text, encoding="utf-8")


def below(folder):
    put(folder, {"x/z/package.xml": "hello", "x/y": link(".")})


def anchors(form):
    """Anchors, each of which unfolds to nine of the one before."""
    names = pairwise("abcdefghijk")
    lines = (f"_{b}: &{b} {form.format(', '.join([f'*{a}'] * 9))}\n" for a, b in names)
    return "".join(lines)


LAUGHS = "".join(
    f'<!ENTITY {name} "{f"&{before};" * 10}">' for before, name in pairwise("abcdefghijklm")
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
    whole("two models", SDF.replace("</sdf>", SDF[SDF.index("<model") :]), file="bad.sdf"),
    whole("models 100 deep", '<sdf version="1.9">' + "".join(
        f'<model name="m{k}">' for k in range(100)) + "</model>" * 100 + "</sdf>", file="bad.sdf"),
    whole("a circle further on", chain(7, last=4), file="bad.sdf"),
    whole("a chain of 2,000", chain(2000, last="robot"), file="bad.sdf"),
    whole("includes that double", doubling, file="bad.sdf"),
    whole("includes a name of 300 letters", included("x" * 300), file="bad.sdf"),
    whole("bodies 3,000 deep", "<mujoco><worldbody>" + "<body><joint/>" * 3000 + "</body>" * 3000
        + "</worldbody></mujoco>", file="bad.xml"),
    whole("bodies 200 deep", "<mujoco><worldbody>" + DEEP * 200 + "</body>" * 200
        + "</worldbody></mujoco>", file="bad.xml"),
    whole("adds 1,000 models", "directives:\n" + "".join(
        f"- add_model: {{name: a{k}, file: robot.urdf}}\n" for k in range(1000)),
        file="bad.dmd.yaml"),
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


HEAD = UNINFORMED.partition("inertial_parameters")[0]
DIGEST = HEAD.partition("base_sha256: ")[2][:64]


def damaged(file, good, word, head):
    """Rows of damage to a YAML file, or to a word in it."""
    changes = {
        "null characters": good.replace(word, "a\0b"),
        "bytes that are no UTF-8": good.encode().replace(word.encode(), b"a\xff\xfe"),
        "tags that run": good.replace(word, '!!python/object/apply:os.system ["touch x"]'),
        "an anchor in itself": good.replace(word, "&a [*a]"),
        "cut off": good[: len(good) * 6 // 10],
        "a list": "- a\n- b\n",
        "tabs": f"{head}a:\n\t- a\n",
        "lists 1,000 deep": f"{head}{'[' * 1000}{']' * 1000}",
        "lists 100,000 deep": f"{head}{'[' * 100_000}{']' * 100_000}",
        "mappings 1,500 deep": f"{head}{'{a: ' * 1500}{'}' * 1500}",
        "a bomb of anchors": f"_a: &a [x, x]\n{anchors('[{}]')}{head}*k\n",
        "merges that double": f"_a: &a {{x: 1}}\n{anchors('{{<<: [{}]}}')}{head}*k\n",
    }
    return [whole(name, content, file=file) for name, content in changes.items()]


def told(name, change, *says):
    """A row of an information matrix that was changed."""
    content = UNINFORMED + information(change)
    return whole(name, content, "information", *says, file="saved.yaml")


def saved(name, content, *says, **more):
    return whole(name, content, *says, file="saved.yaml", **more)


def based(name, *says, make=None):
    """A row of a model that is based on another file."""
    beside = {name: make} if make else {}
    return saved(f"base {name[:20]}", SAVED.replace("robot.urdf", name), *says, beside=beside)


def entry(value, i, j):
    """Put a value into a symmetric matrix."""

    def change(matrix):
        matrix[i, j] = matrix[j, i] = value

    return change


TWICE = """effects:
- {name: coulomb_friction, where: [shoulder], shape: {}, parameters: [0.3], deviations: []}
"""
NAN_READERS = ("rollout {} log.csv", "digest {} log.csv --to new", "excite {}",
    "rollout robot.urdf log.csv --before {}", "identifiable {} log.csv")  # fmt: skip
SAVED_ROWS = [
    saved("all in order", SAVED, code=0),
    saved("nothing but bodies", UNINFORMED.partition("effects:")[0], code=0),
    saved("base that has changed", UNINFORMED.replace(DIGEST, "a" * 64), "has changed", code=0),
    saved("off by rounding", UNINFORMED + information(lambda m: m.__setitem__((3, 4), 1e-12)),
        code=0),
    saved("byte order mark", SAVED.encode("utf-8-sig"), code=0),
    saved("comments and quotes", "# by hand\n" + SAVED.replace("geodrake model 1",
        "'geodrake model 1'"), code=0),
    told("an entry nan", entry(np.nan, 1, 2)),
    told("a zero on the diagonal with something beside it", lambda m: (entry(0.0, 3, 3)(m),
        entry(0.5, 3, 4)(m))),
    told("not symmetric", lambda m: m.__setitem__((3, 4), 0.5), "symmetric"),
    told("not positive", entry(100.0, 3, 4), "semidefinite"),
    told("all zeros", lambda m: m.fill(0.0)),
    saved("a row too few", SAVED.rsplit("- ", 1)[0], "information"),
    saved("a number too few", SAVED.replace("- [1.0, 0.0,", "- [1.0,", 1), "information"),
    based("none.urdf", "is based on"),
    based("p.urdf", "is a pipe", make=os.mkfifo),
    based("other.yaml", "saved model itself", make=SAVED),
    based("l.yaml", "saved model itself", make=link("saved.yaml")),
    based("d.dmd.yaml", make="directives:\n- add_model: {name: a, file: saved.yaml}\n"),
    based("/dev/zero", "is based on"),
    based("x" * 300, "is based on"),
    saved("another robot's", SAVED.replace("upper_link", "thigh").replace("lower_link", "shank"),
        "thigh"),
    saved("digest of other letters", SAVED.replace(DIGEST, f"{DIGEST.upper()}x"), "base_sha256"),
    saved("an effect twice", UNINFORMED.replace("effects:\n", TWICE), "twice"),
    saved("rows of one alias", f"{HEAD}_a: &a [{', '.join(['1'] * 2000)}]\n"
        f"information: [{', '.join(['*a'] * 2000)}]\n", "unfold"),
    saved("UTF-16", SAVED.encode("utf-16")),
    saved("150 MB", HEAD + "#" * 150_000_000, "MB are read"),
    *(saved(f"a mass of nan for {command}", UNINFORMED.replace("[0.5235", "[.nan"), "upper_link",
        command=command) for command in NAN_READERS),
]  # fmt: skip
DAMAGED = [
    *damaged("bad.dmd.yaml", DIRECTIVES, "arm", "directives: "),
    *damaged("saved.yaml", SAVED, "abc", f"{HEAD}information: "),
]
FILES = [*tree_rows(), *MADE, *PATHS, *SAVED_ROWS, *DAMAGED]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("row", FILES, ids=str)
def test_row(row, tmp_path):
    row.check(tmp_path)
    assert not (tmp_path / "PWNED").exists()
