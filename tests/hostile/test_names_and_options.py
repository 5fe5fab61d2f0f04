"""Bad, unlucky and malicious names and options."""

import os
import shlex
import socket
from contextlib import chdir
from dataclasses import fields
from itertools import product
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
import typer.main
import yaml
from good_files import FLEET
from hostile import PENDULUM, Row, link, put, read_json, table, write_log
from odd_names import IN_FILES, IN_XML

from geodrake import load_model
from geodrake.boundary.escaping import html_text
from geodrake.cli.app import app
from geodrake.cli.input_options import ReadingOptions
from geodrake.fleet import digest_files, read_digest


def rename(folder, *, shoulder, link):
    """Rename a joint and a link of the model, and the joint in the log."""
    text = PENDULUM.read_text(encoding="utf-8")
    for old, new in {"shoulder": shoulder, "upper_link": link}.items():
        attribute = quoteattr(new, {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})
        text = text.replace(f'"{old}"', attribute)
    columns = ["time", *(f"{j}.{q}" for q in ("position", "effort") for j in (shoulder, "elbow"))]
    header = ",".join(f'"{c.replace(chr(34), 2 * chr(34))}"' for c in columns)
    put(folder, {"robot.urdf": text, "log.csv": lambda path: write_log(path, table(), header)})


LOG_USES = {
    "compare robot.urdf {} --json new.json --series new.parquet": ("new.json", "new.parquet"),
    "digest robot.urdf {} --to new": None,
}


LOG_CASES = [
    (c, w) for c, w in product(LOG_USES, IN_FILES) if (c[:6], w) != ("digest", "not UTF-8")
]


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("command", "what"), LOG_CASES)
def test_logs(command, what, tmp_path):
    name = IN_FILES[what]
    command, writes = command.format(shlex.quote(f"./{name}.csv")), LOG_USES[command]
    files = {f"{name}.csv": lambda path: write_log(path, table())}
    Row(what, command, make=files, code=0, writes=writes).check(tmp_path)
    for path in digest_files(tmp_path / "new") if writes is None else ():
        assert read_digest(path).logs[0].name == name
    assert not (tmp_path / "PWNED").exists()


def test_a_log_with_an_invalid_name_is_refused_and_others_are_digested(tmp_path):
    for name in ("a\udcffb", "good"):
        write_log(tmp_path / f"{name}.csv", table())
    (tmp_path / "robot.urdf").write_text(PENDULUM.read_text(encoding="utf-8"), encoding="utf-8")
    command = "digest robot.urdf './a\udcffb.csv' ./good.csv --to new"
    with chdir(tmp_path):
        code, out, err = Row("not UTF-8", command).run()
    assert code == 1
    assert "1 digested, 0 existed, 1 failed" in out + err
    assert r"'a\udcffb' is not UTF-8, which files of fleets require. Rename" in out + err
    (path,) = digest_files(tmp_path / "new")
    assert read_digest(path).logs[0].name == "good"


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
"""Commands that use the names of joints and links -> a check of the names in their results."""


@pytest.mark.sampled(14)
@pytest.mark.parametrize(("what", "command"), list(product(IN_XML, USES)))
def test_joints_and_links(what, command, tmp_path):
    name = IN_XML[what]

    def make(folder):
        rename(folder, shoulder=name, link=name)

    Row(what, command, make=make, code=0, writes=None).check(tmp_path)
    USES[command](tmp_path, (name, "elbow"))
    assert not (tmp_path / "PWNED").exists()


def test_a_model_in_a_folder_with_an_invalid_name_is_not_saved(tmp_path):
    (folder := tmp_path / "a\udcffb").mkdir()
    command = "compare robot.urdf log.csv --save kept.yaml --json kept.json"
    Row("a folder that is not UTF-8", command, ("not UTF-8",)).check(folder)


DATA = "robot.urdf log.csv"
SHORTLY = "excite robot.urdf --limits acceleration=10 --seeds 1 --iterations 2 --seconds 5 --quiet"
COMMANDS = {
    **{name: f"{name} {DATA}" for name in ("compare", "diagnose", "explain", "identify")},
    **{name: f"{name} {DATA}" for name in ("rollout", "identifiable")},
    "play": f"play {DATA} --out new.html",
    "add": f"add coulomb_friction {DATA}",
    "digest": f"digest {DATA} --to new",
    "check": "check robot.urdf --samples 2",
    "log": "log log.csv",
    "export": "export robot.urdf new --to urdf",
    "fleet": "fleet fleet.yaml --workers 0",
    "excite": f"{SHORTLY} --samples 30 --duration 4",
}
"""Name of a command -> a good call; `demo` has no option of its own."""
HUGE = "1" * 30


def bind(path):
    with chdir(path.parent), socket.socket(socket.AF_UNIX) as server:  # whose paths are short
        server.bind(path.name)


PATHS = {
    **{"pipe": os.mkfifo, "socket": bind, "loop": lambda path: link(path.name)(path)},
    **{"folder": Path.mkdir, "device": link("/dev/zero"), "link": link("no/x")},
    "input": link("log.csv"),
}
"""Paths that are no regular files, or must not be written."""
WRONG = {
    "float": ("nan", "wide", "''", "0x10", "inf", "-1", "0", "1e-300", "1e300"),
    "int": ("nan", "many", "1.5", "''", "-1", "0", HUGE),
    "str": ("''", "nan", "=", ":::", "nobody=1", "shoulder=nan", "'a\x1b[31m'", "1e300", ",", "no"),
    "Path": (*PATHS, "no/x", "log.csv/x", "/proc/x", "'a\0b'"),
}
MORE = {
    "--known-payload": (
        *("::::", "none.csv:lower_link:1", "log.csv:nobody:1", "log.csv:world:1"),
        *(f"log.csv:lower_link:{rest}" for rest in ("-1", "nan", "1e30", "1:nan,0,0", "x")),
        *(f"log.csv:lower_link:1:0,0{rest}" for rest in ("", ",1e200")),
    ),
    "--limits": (
        *("velocity=0", "velocity=-1", "position=1:0", "position=nan:1", "position=1"),
        *("effort=nan", "nobody.velocity=1", "elbow.=1", "velocity="),
    ),
    "--noise": ("-1", "0", "shoulder=1", "shoulder=1,elbow=nan", "shoulder=1,elbow=1e300"),
    "--date": ("soon", "2026-02-30"),
    "--tell-apart": ("drag", "coulomb_friction"),
    "--bandwidth": ("0.001", "0.05", "26", "1000"),
    "--blocks": ("1", "1001"),
    "--horizon": ("0.0001", "0.002", "30", "1e9"),
    "--residual-bound": ("1", "1000", "1e9"),
    "--samples": ("10001",),
    "--units": ("position=furlong",),
}
"""Option -> further bad values of its kind."""
REFUSED = ("nan", "wide", "many", "1.5", "'a\0b'", "pipe", "socket", "device")
"""Values that no option for numbers or paths takes."""
ENDS = {"--save": ".yaml", "--json": ".json", "--report": ".html", "--out": ".html"}
ENDS |= {"--meshcat": ".html", "--draft-effect": ".py", "--export": ".urdf", "--ellipsoids": ".png"}
ENDS |= {"--video": ".gif", ("play", "--to"): ".mcap"}
"""Options of files that are written -> the suffix of their names."""
BEFORE = {("play", "--to"): "mcap "}
"""Options with two values -> the first one."""
OF_LOGS = {"bandwidth", *(field.name for field in fields(ReadingOptions))}
FILES = {"model": "robot.urdf", "logs": "log.csv", "fleet": "fleet.yaml"}
"""Arguments that are files -> their names in the commands above."""


def parameters():
    """Return command, name and kind of all options and arguments with values, each once."""
    found = {}
    for command, made in typer.main.get_command(app).commands.items():
        for each in made.params if command in COMMANDS else ():
            is_file = FILES.get(each.name, "none") in COMMANDS[command]
            if command == "digest" and each.name in OF_LOGS:
                continue  # digest reports it for each log, and continues
            if each.param_type_name == "argument" and is_file and command != "digest":
                found.setdefault((each.name, "Path"), command)  # digest continues with other logs
            elif each.param_type_name == "option" and not each.is_flag and each.name != "live":
                kind = "Path" if "Path" in each.bare_type() else each.bare_type()
                found.setdefault((each.opts[0], kind), command)
    return [(command, name, kind) for (name, kind), command in found.items()]


PARAMETERS = parameters()


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("command", "option", "kind"), PARAMETERS)
def test_values(command, option, kind, tmp_path):
    given = COMMANDS[command]
    end = ENDS.get((command, option), ENDS.get(option, ""))
    make = {"fleet.yaml": FLEET, **{f"{name}{end}": content for name, content in PATHS.items()}}
    for k, value in enumerate((*WRONG.get(kind, WRONG["str"]), *MORE.get(option, ()))):
        words = f"{given} {option} {BEFORE.get((command, option), '')}{value}{end}"
        if option in FILES:
            words = given.replace(FILES[option], value)
        is_wrong = end and (value != "input" or "log.csv" in given)
        code = 2 if is_wrong or (value in REFUSED and kind in ("float", "int", "Path")) else None
        (folder := tmp_path / str(k)).mkdir()
        Row(words, words, make=make, code=code, writes=None).check(folder)


def test_all_options_are_known():
    assert len(PARAMETERS) > 75
    assert {kind for _, _, kind in PARAMETERS} >= {"float", "int", "Path", "str"}
