"""Names that are code, markup, escape sequences or nothing that a language could hold."""

import ast
import json
import shlex
from itertools import product
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from hostile import PENDULUM, Row, put, read_json, table, write_log

from geodrake import load_model
from geodrake.boundary.escaping import (
    docstring_text,
    html_text,
    identifiers,
    json_text,
    path_part,
    printable,
    quoted,
)
from geodrake.cli.tables import make_console
from geodrake.diagnosis.drafting import Draft, source_of
from geodrake.diagnosis.drafting.formula import Factor, Formula, FormulaTerm
from geodrake.diagnosis.drafting.results import DraftedEffect
from geodrake.effects import load_effect_file
from geodrake.fleet import digest_files, read_digest
from geodrake.logs.files import read_log
from geodrake.logs.files import write_log as write_joint_log
from geodrake.logs.motion import JointLog

yaml = pytest.importorskip("yaml")

PWNED = '__import__("os").system("touch PWNED")'
IN_XML = {
    "code": f'x""" + str({PWNED}) + """',
    "code in single quotes": f"x''' + str({PWNED}) + '''",
    "code in a format": f"{{{PWNED}!r}} %s %(x)d",
    "a backslash": "run\\N1",
    "a backslash last": "x\\",
    "markup": "</script><img src=x onerror=alert(1)>\"'&amp;",
    "markup of rich": "[bold red]x[/] :smile: [/]",
    "mathematics": "$\\frac$",
    "half of mathematics": "a_$b^{",
    "YAML of a mapping": "a: b",
    "YAML of a list": "- x",
    "YAML of Python": '!!python/object/apply:os.system ["touch PWNED"]',
    "YAML of an anchor": "&a *a #c",
    "YAML of nothing": "null",
    "YAML of truth": "true",
    "YAML of a number": "1e3",
    "YAML of a tilde": "~",
    "a line end": "upper\nlower",
    "a carriage return": "upper\rlower",
    "a tab": "upper\tlower",
    "C1 escapes": "\x9b31mred\x85",
    "writing turned around": "a\u202eb\u2066c",
    "line separators": "a\u2028b\u2029c",
    "no width": "a\u200bb\ufeffc",
    "Chinese": "关节",
    "a letter beyond 16 bits": "a\U0001f916b",
    "two letters in one": "\ufb01nger",
    "a power": "x\u00b2",
    "a path": "../../etc/x",
    "a comma and a quote": 'a,b"c',
    "a keyword": "class",
    "a number": "1",
    "a name of the code": "motion",
    "a dot": "a.position",
    "hundreds of letters": "j" * 300,
}
"""Names that a model file may have."""
IN_FILES = {
    **{what: name.replace("/", ":")[:200] for what, name in IN_XML.items()},
    "colours": "\x1b[31mred\x1b[0m",
    "a title of the terminal": "\x1b]0;owned\x07",
    "a cleared terminal": "\x1b[2J\x1bc",
    "a letter taken back": "good\x08\x08\x08\x08evil",
    "deleted": "a\x7fb",
    "not UTF-8": "a\udcffb",
    "a dash": "-x",
}
"""Names that a file may have."""


def rename(folder, *, shoulder, link):
    """Give a joint and a link of the model another name, and the joint of the log."""
    text = PENDULUM.read_text(encoding="utf-8")
    for old, new in {"shoulder": shoulder, "upper_link": link}.items():
        attribute = quoteattr(new, {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})
        text = text.replace(f'"{old}"', attribute)
    columns = ["time", *(f"{j}.{q}" for q in ("position", "effort") for j in (shoulder, "elbow"))]
    header = ",".join(f'"{c.replace(chr(34), 2 * chr(34))}"' for c in columns)
    put(folder, {"robot.urdf": text, "log.csv": lambda path: write_log(path, table(), header)})


LOG_USES = {
    "compare robot.urdf {} --json new.json": ("new.json",),
    "digest robot.urdf {} --to new": None,
}


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("command", "what"), list(product(LOG_USES, IN_FILES)))
def test_logs(command, what, tmp_path):
    name = IN_FILES[what]
    command, writes = command.format(shlex.quote(f"./{name}.csv")), LOG_USES[command]
    files = {f"{name}.csv": lambda path: write_log(path, table())}
    Row(what, command, make=files, code=0, writes=writes).check(tmp_path)
    for path in digest_files(tmp_path / "new") if writes is None else ():
        assert read_digest(path).logs[0].name == name
    assert not (tmp_path / "PWNED").exists()


def check_saved(folder, names):
    assert tuple(read_json(folder / "new.json")["joints"]) == names
    assert load_model(folder / "new.yaml").joints == names
    assert names[0] in load_model(folder / "new.yaml").bodies


def check_page(folder, names):
    page = (folder / "new.html").read_text(encoding="utf-8")
    assert "<img src=x" not in page
    for name in names:
        assert html_text(name).replace("&quot;", "&#34;").replace("&#x27;", "&#39;") in page


def check_digest(folder, names):
    assert tuple(read_json(folder / "new.json")["logs"][0]["joints"]) == names
    (path,) = digest_files(folder / "new")
    assert read_digest(path).settings.joints == names


def check_export(folder, names):
    before, after = (load_model(folder / f"{name}.urdf") for name in ("robot", "new"))
    assert (after.bodies, after.joints) == (before.bodies, names)


def check_motion(folder, names):
    ros = yaml.safe_load((folder / "new.yaml").read_text(encoding="utf-8"))
    assert tuple(ros["joint_names"]) == names


EXCITE = "excite robot.urdf --limits velocity=2,acceleration=5,effort=50,position=-1:1"
USES = {
    "compare robot.urdf log.csv --json new.json --save new.yaml": check_saved,
    "compare robot.urdf log.csv --report new.html": check_page,
    "digest robot.urdf log.csv --to new --json new.json": check_digest,
    "identify robot.urdf log.csv --gamma 100 --export new.urdf": check_export,
    f"{EXCITE} --seeds 1 --iterations 2 --duration 4 --samples 30 --save new.yaml": check_motion,
}
"""What uses the names of joints and links -> what must become of them."""


@pytest.mark.sampled(7)
@pytest.mark.parametrize(("what", "command"), list(product(IN_XML, USES)))
def test_joints_and_links(what, command, tmp_path):
    name = IN_XML[what]

    def make(folder):
        rename(folder, shoulder=name, link=name)

    Row(what, command, make=make, code=0, writes=None).check(tmp_path)
    USES[command](tmp_path, (name, "elbow"))
    assert not (tmp_path / "PWNED").exists()


def drafted(joints, logs):
    """A draft with a formula for each joint, in all of them."""
    effects = tuple(
        DraftedEffect(
            formula=Formula(joint, (FormulaTerm(tuple(Factor(j, "q") for j in joints)),)),
            coefficients=np.array([1.0]),
            deviations=np.array([0.1]),
            rms_before=1.0,
            rms_after=0.5,
            floor=0.1,
            false_alarm_probability=1e-6,
            rivals=(),
            time=np.arange(3.0),
            residual=np.zeros(3),
            effort=np.zeros(3),
        )
        for joint in joints
    )
    return Draft(effects, (), (), None, None, logs)


@pytest.mark.parametrize("what", IN_XML)
def test_a_draft_is_code_of_one_meaning(what, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = IN_XML[what]
    joints, logs = (name, f"{name} ", f"-{name}-"), (name, *IN_FILES.values())
    source = source_of(drafted(joints, logs))
    (tmp_path / "draft.py").write_bytes(source.encode())
    effects = load_effect_file(tmp_path / "draft.py")
    assert [effect().joint for effect in effects] == list(joints)
    assert len({effect.name for effect in effects}) == len(joints)
    assert not (tmp_path / "PWNED").exists()
    docstring = ast.get_docstring(ast.parse(source), clean=False)
    assert printable(f"What is missing at {', '.join(joints)}.") in docstring
    for log in logs:
        assert printable(log) in docstring


def test_joints_that_differ_in_punctuation_alone_have_drafts_of_their_own():
    assert identifiers(["a-b", "a.b", "a_b_2", "a b", "A B"]) == {
        "a-b": "a_b",
        "a.b": "a_b_2",
        "a_b_2": "a_b_2_2",
        "a b": "a_b_3",
        "A B": "a_b_4",
    }
    source = source_of(drafted(("a_1", "a1", "a-1"), ("log",)))
    classes = [node.name for node in ast.parse(source).body if isinstance(node, ast.ClassDef)]
    assert len(set(classes)) == 3


@pytest.mark.parametrize("what", IN_FILES)
def test_each_kind_of_text_gives_the_name_back(what):
    name = IN_FILES[what]
    assert ast.literal_eval(quoted(name)) == name
    assert quoted(name).isprintable()
    assert printable(name).isprintable()
    if "\udcff" not in name:
        assert yaml.safe_load(quoted(name)) == name
    assert ast.literal_eval(f'"""{docstring_text(name)}"""') == printable(name)
    text = json.dumps(name, ensure_ascii=False)
    assert json.loads(json_text(text)) == name
    assert json_text(text).isprintable()
    assert all(i.isidentifier() for i in identifiers([name]).values())
    part = path_part(name)
    assert part.isprintable()
    assert not set(part) & {"/", "\\"}
    assert part not in ("", ".", "..")


def test_parts_of_paths_differ_where_names_do():
    names = [".", "..", "a/b", "a%2Fb", "a_b", "a\\b", "a\nb"]
    assert len({path_part(name) for name in names}) == len(names)


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
@pytest.mark.parametrize("what", IN_XML)
def test_a_written_log_has_the_names_that_it_was_given(what, suffix, tmp_path):
    rows = table(seconds=2.0)
    names = (IN_XML[what], "elbow")
    log = JointLog("log", names, rows[:, 0], rows[:, 1:3], rows[:, 3:])
    write_joint_log(log, tmp_path / f"log{suffix}")
    again = read_log(tmp_path / f"log{suffix}", joints=names)
    assert again.joints == names
    np.testing.assert_array_equal(again.effort, log.effort)


@pytest.mark.parametrize("what", IN_FILES)
def test_a_terminal_shows_a_name_as_one_line(what, monkeypatch):
    name = IN_FILES[what]
    monkeypatch.setenv("TERM", "xterm-256color")
    console = make_console()
    with console.capture() as captured:
        console.print(name, soft_wrap=True)
    assert captured.get() == f"{printable(name)}\n"


def test_a_model_beside_a_path_that_yaml_cannot_hold_is_not_saved(tmp_path):
    (folder := tmp_path / "a\udcffb").mkdir()
    command = "compare robot.urdf log.csv --save kept.yaml --json kept.json"
    Row("a folder that is not UTF-8", command, ("not UTF-8",)).check(folder)
