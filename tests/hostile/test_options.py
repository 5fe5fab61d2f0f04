"""Every option and argument of every command, with values that it cannot have."""

import os
import socket
from contextlib import chdir
from dataclasses import fields
from pathlib import Path

import pytest
import typer.main
from good_files import FLEET
from hostile import Row, link

from geodrake.cli.app import app
from geodrake.cli.input_options import ReadingOptions

DATA = "robot.urdf log.csv"
EXCITE = "excite robot.urdf --limits acceleration=10 --seeds 1 --iterations 2 --seconds 5 --quiet"
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
    "excite": f"{EXCITE} --samples 30 --duration 4",
}
"""Command -> how it is given in order; `demo` has no option of its own."""
HUGE = "1" * 30


def bind(path):
    with chdir(path.parent), socket.socket(socket.AF_UNIX) as server:  # whose paths are short
        server.bind(path.name)


PATHS = {
    **{"pipe": os.mkfifo, "socket": bind, "loop": lambda path: link(path.name)(path)},
    **{"folder": Path.mkdir, "device": link("/dev/zero"), "link": link("no/x")},
    "input": link("log.csv"),
}
"""Paths that are no files, or none to be written."""
VALUES = {
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
"""Option -> what it cannot be or hardly, of its own kind."""
REFUSED = ("nan", "wide", "many", "1.5", "'a\0b'", "pipe", "socket", "device")
"""Values of numbers and paths that no option takes."""
ENDS = {"--save": ".yaml", "--json": ".json", "--report": ".html", "--out": ".html"}
ENDS |= {"--meshcat": ".html", "--draft-effect": ".py", "--export": ".urdf", "--ellipsoids": ".png"}
ENDS |= {"--video": ".gif", ("play", "--to"): ".mcap"}
"""Options of files that are written -> how their names end; none of the paths above is one."""
BEFORE = {("play", "--to"): "mcap "}
"""Options of two values, and the first of these."""
OF_LOGS = {"bandwidth", *(field.name for field in fields(ReadingOptions))}
FILES = {"model": "robot.urdf", "logs": "log.csv", "fleet": "fleet.yaml"}
"""Arguments that are files, and what they are in the commands above."""


def parameters():
    """(command, name, kind) of each option and argument that has a value, at one command each."""
    found = {}
    for command, made in typer.main.get_command(app).commands.items():
        for each in made.params if command in COMMANDS else ():
            is_file = FILES.get(each.name, "none") in COMMANDS[command]
            if command == "digest" and each.name in OF_LOGS:
                continue  # which it says of each log, and goes on
            if each.param_type_name == "argument" and is_file and command != "digest":
                found.setdefault((each.name, "Path"), command)  # digest goes on with other logs
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
    for k, value in enumerate((*VALUES.get(kind, VALUES["str"]), *MORE.get(option, ()))):
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
