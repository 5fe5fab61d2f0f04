"""Every option and argument of every command, with values that it cannot have."""

import os
import socket
from contextlib import chdir
from pathlib import Path

import pytest
import typer.main
from good_files import FLEET
from hostile import Row, link

from geodrake.cli.app import app
from geodrake.errors import ArgumentError
from geodrake.identification.logs.compare import compare
from geodrake.logs.filtering import design_filter
from geodrake.model.saved_model import load_model

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
VALUES = {
    "float": ("nan", "wide", "''", "0x10", "inf", "-1", "0", "1e-300", "1e300"),
    "int": ("nan", "many", "1.5", "''", "-1", "0", HUGE),
    "str": ("''", "nan", "=", ":::", "nobody=1", "shoulder=nan", "'a\x1b[31m'", "1e300", ",", "no"),
    "Path": ("x.pipe", "x.socket", "x.loop", "x", "/dev/zero", "no/x.y", "log.csv/x", "'a\0b'"),
}
MORE = {
    "--known-payload": (
        *("::::", "none.csv:lower_link:1", "log.csv:nobody:1", "log.csv:world:1"),
        *(
            f"log.csv:lower_link:{rest}"
            for rest in ("-1", "nan", "1e30", "1:nan,0,0", "1:0,0", "1:0,0,1e200", "x")
        ),
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
REFUSED = ("nan", "wide", "many", "1.5", "'a\0b'", "x.pipe", "x.socket", "/dev/zero")
"""Values of numbers and paths that no option takes."""
FILES = {"model": "robot.urdf", "logs": "log.csv", "fleet": "fleet.yaml"}
"""Arguments that are files, and what they are in the commands above."""


def parameters():
    """(command, name, kind) of each option and argument that has a value."""
    for command, made in typer.main.get_command(app).commands.items():
        for each in made.params if command in COMMANDS else ():
            if each.param_type_name == "argument" and each.name in FILES:
                yield command, each.name, "Path"
            elif each.param_type_name == "option" and not each.is_flag and each.name != "live":
                kind = each.bare_type()
                yield command, each.opts[0], "Path" if "Path" in kind else kind


PARAMETERS = list(parameters())


def bind(path):
    with chdir(path.parent), socket.socket(socket.AF_UNIX) as server:  # whose paths are short
        server.bind(path.name)


MAKE = {"fleet.yaml": FLEET, "x": Path.mkdir, "x.loop": link("x.loop"), "x.pipe": os.mkfifo}
MAKE |= {"x.socket": bind}
"""What commands need, and paths that are no files."""


@pytest.mark.sampled(20)
@pytest.mark.parametrize(("command", "option", "kind"), PARAMETERS)
def test_values(command, option, kind, tmp_path):
    given = COMMANDS[command]
    for k, value in enumerate((*VALUES.get(kind, VALUES["str"]), *MORE.get(option, ()))):
        words = f"{given} {option} {value}"
        if option in FILES:
            words = given.replace(FILES[option], value)
        code = 2 if value in REFUSED and kind in ("float", "int", "Path") else None
        (folder := tmp_path / str(k)).mkdir()
        Row(words, words, make=MAKE, code=code, writes=None).check(folder)


def test_all_options_are_known():
    assert len(PARAMETERS) > 250
    assert {kind for _, _, kind in PARAMETERS} >= {"float", "int", "Path", "str"}


ROWS = [
    Row("no such effect", f"add friction {DATA}", ("no effect 'friction'",)),
    Row("a mass that is none", f"identify {DATA} --total-mass nan", ("total mass",)),
    Row("beyond the rate", f"compare {DATA} --bandwidth 26", ("bandwidth of", "Hz")),
    Row("over an input", f"digest {DATA} --to new --json log.json", ("is an input",),
        {"log.json": link("log.csv")}),
    Row("no command", "''", ("No such command",)),
    Row("a word of escapes", f"compare {DATA} --blocks '\x1b[31m'", ("Invalid value",)),
    Row("all windows", f"rollout {DATA} --windows {HUGE}", ("departs",), code=0),
    Row("all is well", f"compare {DATA} --json new.json", code=0, writes=("new.json",)),
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_row(row, tmp_path):
    row.check(tmp_path)


@pytest.mark.parametrize("bandwidth", [float("nan"), 0.0, -1.0, 1e-300, 26.0, 1e300])
def test_filters_have_a_bandwidth_that_fits(bandwidth):
    with pytest.raises(ArgumentError, match=r"Choose a bandwidth from 0\.005 to 25 Hz"):
        design_filter(0.01, bandwidth)


def test_a_library_call_has_the_bounds_of_the_command(filled):
    with pytest.raises(ArgumentError, match="blocks"):
        compare(load_model("robot.urdf"), ["log.csv"], blocks=10**9)
