"""Xacro files are expanded as by the package xacro, unless they ask for more than values."""

import os
from pathlib import Path

import pytest
import yaml

from geodrake.errors import ModelError
from geodrake.robot.files import xacro_file
from geodrake.robot.files.load_options import Given
from geodrake.robot.files.xacro_file import read_expanded

xacro = pytest.importorskip("xacro")

HEAD = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:property name="x" value="2"/>"""


def written(folder: Path, body: str, name: str = "r.urdf.xacro") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(f"{HEAD}{body}</robot>" if name.endswith("xacro") else body)
    return path


@pytest.fixture
def package(tmp_path):
    """Return a package with a macro, values in YAML, and a folder for the model."""
    folder = tmp_path / "parts"
    written(folder, "<package><name>parts</name></package>", "package.xml")
    written(folder / "config", "a: {x: 1.5, names: [p, q], angle: !degrees 90}\nb: 3\n", "v.yaml")
    written(folder / "urdf", '<xacro:property name="inner" value="7"/><l v="${inner}"/>', "i.xacro")
    return folder


CONSTRUCTS = {
    "expressions": '<a v="${1+2*3-4/5} ${7//2} ${2**10} ${6^3} ${1&lt;&lt;4} ${x or 1}"/>'
    "<a v=\"${'one' if x == 1 else 'more'} ${[1, *[2, 3]][1:]} ${'%.3f %s' % (x, 'y')}\"/>"
    "<a v=\"${'a,b'.split(',')[1]} ${'A'.lower()+'b'.replace('b', 'c')} ${'r' in 'arm'}\"/>",
    "functions": '<a v="${sin(pi/6)} ${math.radians(90)} ${atan2(1,2)} ${python.sum((1, 2))}"/>'
    "<a v=\"${dict(a=1, **dict(b=2))['b']} ${sorted([2, 1], reverse=True)} ${round(2.345, 1)}\"/>"
    "<a v=\"${[(i, j) for i in range(3) if i for j in 'ab']} ${dict((k, 2*k) for k in [x])}\"/>"
    "<a v=\"${xacro.tokenize('1, 2;3')} ${xacro.warning('seen')}\"/>",
    "yaml": '<xacro:property name="v" value="${xacro.load_yaml(\'../config/v.yaml\')}"/>'
    "<a v=\"${v.a.x} ${v['a']['names'][1]} ${v.b} ${v.a.angle} ${list(v.keys())} ${'b' in v}\"/>"
    '<xacro:property name="d" value="${xacro.dotify(dict(k=dict(x=4)))}"/><a v="${d.k.x}"/>',
    "includes": '<xacro:include filename="i.xacro"/><a v="${inner}"/>'
    '<xacro:include filename="i.xacro" ns="n"/><a v="${n.inner + 1}"/>'
    '<xacro:include filename="[i].xacro"/><xacro:include filename="none.xacro" optional="true"/>',
    "arguments": '<xacro:arg name="side" default="left"/><a v="$(arg side) $(arg given)"/>'
    '<a v="${$(arg mapping)[1]} ${list($(arg mapping))}"/>'
    '<a v="$(env HOME) $(optenv NO_SUCH_NAME none) $(cwd) $$(arg x) $${x} $(eval 1 + 2)"/>'
    '<a v="$(eval given + 1) $(eval [given, 2*pi][1]) $(eval True)"/>',
}


def test_a_file_called_xacro_needs_no_elements_of_it(tmp_path):
    (tmp_path / "r.xacro").write_text('<robot name="$(optenv NO_SUCH_NAME r)"/>')
    assert b'name="r"' in read_expanded(tmp_path / "r.xacro", Given())


@pytest.mark.parametrize("construct", CONSTRUCTS)
def test_files_expand_as_the_package_expands_them(package, construct, monkeypatch):
    path = written(package / "urdf", CONSTRUCTS[construct])
    monkeypatch.chdir(package)
    given = {"given": "3", "mapping": "{1: {2, 3}}"}
    expected = xacro.process_file(str(path), mappings=dict(given)).toxml(encoding="utf-8")
    for trust in (False, True):
        assert read_expanded(path, Given(xacro=given, trust_xacro=trust)) == expected


CLIMB = "__class__.__base__.__subclasses__()"
ESCAPES = (
    f"(lambda: [c for c in ().{CLIMB}][0])()",
    "'x'.format(1)",
    "'x'.format_map(dict())",
    "(i for i in [1]).gi_frame",
    "(i for i in [1]).gi_code.co_consts",
    "[f.f_back for f in [1]]",
    "python.type(1)",
    "python['type'](1)",
    "list(map(*[list((python | dict()).values())[-3:-2], [[1]]][0], [1]))",
    "python.vars(math)",
    "math.sin.__self__",
    "xacro.load_yaml.__globals__",
    "str.mro()",
    "__import__('os')",
)


@pytest.mark.parametrize(
    "body",
    [
        *(f'<xacro:property name="p" value="${{{text}}}"/>${{p}}' for text in ESCAPES),
        '<a v="$(eval [f.gi_frame for f in [1]])"/>',
        '<xacro:property name="p" value="${python.type}"/><a v="${p(1)}"/>',
        '<xacro:macro name="m" params="f:=${python.vars}"><a v="${f(math)}"/></xacro:macro>'
        "<xacro:m/>",
    ],
)
def test_a_file_that_asks_for_more_than_values_is_refused(tmp_path, monkeypatch, body):
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, body)
    with pytest.raises(ModelError, match="is used"):
        read_expanded(path, Given())
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("text", ["${open}", "$(eval [getattr][0])"])
def test_builtins_of_python_are_unknown(tmp_path, text):
    path = written(tmp_path, f'<a v="{text}"/>')
    with pytest.raises(ModelError, match=r"name '\w+' is not defined"):
        read_expanded(path, Given())


def test_trust_lets_any_expression_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = written(tmp_path, f'<a v="${{len((lambda: ().{CLIMB})()) > 9}}"/>')
    with pytest.raises(ModelError, match=r"is used .*--trust-xacro"):
        read_expanded(path, Given())
    assert b'v="True"' in read_expanded(path, Given(trust_xacro=True))


def test_a_python_tag_in_yaml_makes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path, "a: !!python/object/apply:os.system ['touch seen']", "v.yaml")
    path = written(tmp_path, "<a v=\"${xacro.load_yaml('v.yaml')}\"/>")
    with pytest.raises(ModelError, match="could not determine a constructor"):
        read_expanded(path, Given(trust_xacro=True))
    assert not (tmp_path / "seen").exists()


def test_yaml_evaluates_no_units_once_a_file_is_expanded(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    known = yaml.SafeLoader.yaml_constructors  # to which the package adds when other tests use it
    plain = {tag: each for tag, each in known.items() if tag != "!degrees"}
    monkeypatch.setattr(yaml.SafeLoader, "yaml_constructors", plain)
    written(tmp_path, "a: !degrees 180", "v.yaml")
    path = written(tmp_path, "<a v=\"${xacro.load_yaml('v.yaml').a}\"/>")
    assert b'v="3.14' in read_expanded(path, Given(trust_xacro=True))
    with pytest.raises(yaml.YAMLError, match="could not determine a constructor"):
        yaml.safe_load("a: !degrees 180")


@pytest.mark.parametrize("body", ['<xacro:include filename="{}"/>', "${{xacro.load_yaml('{}')}}"])
def test_only_regular_files_are_read(tmp_path, body):
    os.mkfifo(tmp_path / "pipe")
    for place, words in (
        ("pipe", "is a pipe"),
        (".", "is a folder"),
        ("/dev/zero", "is a device"),
        ("none.yaml", "No such file"),
    ):
        path = written(tmp_path, body.format(place))
        with pytest.raises(ModelError, match=words):
            read_expanded(path, Given())


def test_includes_that_never_end_are_an_error(tmp_path):
    written(tmp_path, '<xacro:include filename="b.xacro"/>', "a.xacro")
    written(tmp_path, '<xacro:include filename="a.xacro"/>', "b.xacro")
    path = written(tmp_path, '<xacro:include filename="a.xacro"/>')
    with pytest.raises(ModelError, match="files include themselves"):
        read_expanded(path, Given())


def test_files_that_include_each_other_ever_more_often_are_an_error(tmp_path):
    for k in range(30):
        written(tmp_path, f'<xacro:include filename="{k + 1}.xacro"/>' * 2, f"{k}.xacro")
    written(tmp_path, "<g/>", "30.xacro")
    with pytest.raises(ModelError, match="reads more than 500 files"):
        read_expanded(tmp_path / "0.xacro", Given(trust_xacro=True))


def doubling(levels: int) -> str:
    calls = "".join(
        f'<xacro:macro name="m{k}"><xacro:m{k + 1}/><xacro:m{k + 1}/></xacro:macro>'
        for k in range(levels)
    )
    return f'{calls}<xacro:macro name="m{levels}"><g/></xacro:macro><xacro:m0/>'


def long_text(levels: int) -> str:
    properties = "".join(
        f'<xacro:property name="p{k + 1}" value="${{p{k}}}${{p{k}}}"/>' for k in range(levels)
    )
    return f'<xacro:property name="p0" value="long"/>{properties}<a v="${{p{levels}}}"/>'


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (doubling(28), "called more than"),
        ('<a v="${[0] * 10**15}"/>', "makes more than"),
        (long_text(28), "MB of text"),
    ],
)
def test_what_takes_too_much_is_ended(tmp_path, body, words):
    with pytest.raises(ModelError, match=words):
        read_expanded(written(tmp_path, body), Given())


def test_a_file_is_expanded_again_only_if_something_in_it_has_changed(tmp_path, monkeypatch):
    top, part, given = tmp_path / "top.xacro", tmp_path / "part.xacro", Given()
    name = '<robot xmlns:xacro="x"><xacro:property name="n" value="{}"/></robot>'
    top.write_text(
        '<robot xmlns:xacro="x"><xacro:include filename="part.xacro"/><link name="${n}"/></robot>'
    )
    counted = []
    expanded = xacro_file._expanded
    monkeypatch.setattr(xacro_file, "_expanded", lambda *a: counted.append(1) or expanded(*a))
    for value, times in (("a", 1), ("a", 1), ("b", 2), ("a", 3)):
        part.write_text(name.format(value))
        assert f'name="{value}"'.encode() in read_expanded(top, given)
        assert len(counted) == times
    top.write_text(top.read_text().replace("<link", '<link name="c"/><link'))
    assert b'name="c"' in read_expanded(top, given)
    part.unlink()
    with pytest.raises(ModelError, match=r"part\.xacro"):
        read_expanded(top, given)


@pytest.mark.parametrize("trust", [False, True])
@pytest.mark.parametrize(
    "expression",
    [
        "len([0] * 10**9)",
        "10**10**10",
        "len('a' * 10**9)",
        "1 << 10**10",
        "len([x for x in range(10**9)])",
    ],
)
def test_what_expressions_make_has_a_largest_size(tmp_path, expression, trust):
    evaluated = [] if "(" in expression else [f"$(eval {expression} + 0)"]
    for words in (f"${{{expression}}}", *evaluated):
        path = written(tmp_path, f'<link name="a" v="{words.replace("<", "&lt;")}"/>')
        with pytest.raises(ModelError, match="expression that makes more than"):
            read_expanded(path, Given(trust_xacro=trust))
    path = written(
        tmp_path, '<link name="a" v="${[2 * 3, (1,) * 2, 1 &lt;&lt; 3, 2**0.5, \'a\' * 2]}"/>'
    )
    expanded = read_expanded(path, Given(trust_xacro=trust))
    assert b"[6, (1, 1), 8, 1.4142135623730951, 'aa']" in expanded


@pytest.mark.parametrize("words", ["$(eval 1 +)", "$(eval arg('n')", "${1 +}", "$(eval [1, 2)"])
def test_an_unfinished_expression_is_named(tmp_path, words):
    path = written(tmp_path, f'<link name="a" v="{words}"/>')
    with pytest.raises(ModelError, match=r"the expression .* is incomplete or not valid Python"):
        read_expanded(path, Given())
