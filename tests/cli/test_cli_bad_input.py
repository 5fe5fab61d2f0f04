"""Input that no command can use: one clear line, exit code 2, and no file touched."""

import shlex
import shutil
from pathlib import Path

import pandas
import pytest
from commands import contents, refused, run, told
from own_code import effect
from pendulum_logs import PENDULUM, pendulum_log, with_gripper

from geodrake.logs import write_log
from geodrake.model import load_model, save_model

BIPED = PENDULUM.with_name("biped.urdf")
BAD = {
    "compare robot.urdf log.csv": {
        "--bandwidth 0": "Hz",
        "--bandwidth 1000": "Hz",
        "--bandwidth wide": "Usage",
        "--blocks 0": "Use 2 to 1000 blocks",
        "--units position=furlong": "not a known unit of position",
        "--units position=dge": "Did you mean deg",
        "--units position": "--units got 'position'",
        "--units time=s,time=ms": "has 'time' twice",
        "--gain shoulder": "--gain got 'shoulder'",
        "--gain shoulder=much": "which is not a number",
        "--gain wrist=2": "--gain names 'wrist'",
        "--gain shoulder=0": "nonzero number",
        "--gain shoulder=2±3": "less than the gain",
        "--gain shoulder=2±": "which is not a number",
        "--kind shoulder=power": "not a known kind of efforts of 'shoulder'",
        "--kind power": "not a known kind of efforts",
        "--kind current,voltage": "several values for all joints: current and voltage",
        "--kind elbw=current": "Did you mean elbow",
        "--kind shoulder=": "--kind got 'shoulder='",
        "--kind wrist=current": "--kind names 'wrist'",
        "--kind shoulder=command": "no column of 'shoulder' with kind 'command'",
        "--kind voltage --units effort=mA": "a unit of current",
        "--motor elbw=sts3215": "--motor names 'elbw', which is not a joint of the log",
        "--passive wrist": "--passive names 'wrist'",
        "--passive shoulder": "Joint 'shoulder' is passive",
        "--passive shoulder --kind shoulder=current": "but --kind says that it is",
        "--rate -1": "a finite number above",
        "--columns time,a": "--columns names 2",
        "--mapping missing.yaml": "missing.yaml does not exist",
        "--mapping log.csv": "log.csv",
        "--mass 3": "--mass needs --axis",
        "--axis prismatic --mass 3": "robot.urdf exists",
        "--robot other": "no robot 'other'. It has double_pendulum",
        "--package x": "Write --package",
        "--package x=/nowhere": "/nowhere of package 'x' does not exist",
        "--package =/tmp": "--package has",
        "--package 'a b=/tmp'": "--package has",
        "--xacro-arg a=1": "Write --xacro-arg",
        "--xacro-arg a:=1 --xacro-arg a:=2": "'a' occurs twice",
        "--xacro-arg a:=1": "is not a xacro file",
        "--known-payload other:lower_link:0.5": "does not begin with a log",
        "--known-payload log:hand:0.5": "no moving body 'hand'",
        "--known-payload log:lower_link:-1": "a mass of -1 kg",
        "--known-payload log:lower_link": "cannot be parsed",
        "--known-payload log:lower_link:heavy": "cannot be parsed",
        "--known-payload log:lower_link:0.5:1,2": "cannot be parsed",
        "--lock finger=0": "no joint 'finger'",
        "--lock left=1": "'left' cannot be fixed at 1: its limits are 0 … 0.04",
        "--lock left=nan": "--lock of 'left' must be a finite number",
        "--lock right=0": "'right' cannot be fixed, as it follows 'left'",
        "--lock lef=1": "Did you mean left",
        "--lock left": "--lock got 'left'",
        "--lock left=b": "--lock of 'left' got 'b', which is not a number",
        "--lock left=0 --lock left=0": "has 'left' twice",
        "--lock left=0 --lock shoulder=0 --lock elbow=0": "All joints",
        "--json none/x.json": "No such file",
        "--report log.csv/x.html": "Not a directory",
        "--json folder.json": "is a folder",
        "--json /proc/x.json": "--json /proc/x.json",
        "--json log.csv": "does not end in .json",
        "--save a.yaml --save b.yaml": "more than once",
        "--save x.json": "does not end in .yaml or .yml",
        "--report x.pdf": "does not end in .html",
        f"--save {'x' * 300}.yaml": "cannot be written",
        "--series x.txt": "does not end in .csv or .parquet",
        "--effects none.py": "none.py does not exist",
        "--effects folder.json": "is a folder",
    },
    "compare saved.yaml log.csv": {
        "--save base.dmd.yaml": "is an input",
        "--save link.yaml": "is an input",
    },
    "log log.csv": {
        "--units position=furlong": "not a known unit of position",
        "--convert x.bag": "does not end in",
        "--convert log.csv": "is an input",
        "log_2.csv --figure x.png": "takes one log; 2 are given",
        "--model robot.urdf --lock nope=0.3": "nope",
    },
    "add": {
        "colomb_friction robot.urdf log.csv": "Did you mean coulomb_friction",
        "coulomb_friction robot.urdf log.csv --where elbw": "'elbw'. Did you mean elbow? It has",
        "payload@flange robot.urdf log.csv --where hand": "given twice: payload@flange and",
    },
    "identify robot.urdf log.csv --save kept.yaml": {
        "--regularizer ridge": 'regularizer must be one of "euclidean", "pullback"',
        "--gamma 0": "gamma must be a finite number above 0; it is 0",
        "--gamma 1 --residual-bound 1.1": "Give one of them",
        "--residual-bound 0.9": "must be above 1",
        "--residual-bound nan": "The residual bound must be a finite number",
        "--total-mass -1": "The total mass, in kg, must be a finite number above 0",
        "--effects friction": "Did you mean",
        "--effects payload": "payload needs a place. Give its body",
        "--effects payload@hand": "no body 'hand'",
        "--effects coulomb_friction@wrist": "no joint 'wrist'",
        "--effects stribeck_friction": "geodrake add stribeck_friction MODEL LOG",
        "--export out.sdf": "robot.urdf is a URDF",
        "--export out.txt": "does not end in .urdf",
        "--export robot.urdf": "is an input of this command",
        "--ellipsoids e.gif": "does not end in .png",
        "--meshcat nowhere/e.html": "cannot be written: No such file",
        "--meshcat a.html --report a.html": "already the target",
    },
    "identifiable robot.urdf log.csv": {
        "--threshold 1e-12": ": the most certain one has variance",
        "--threshold 0": "--threshold must be a finite number above 0",
        "--noise 0": "The noise of shoulder, elbow is not a positive number",
        "--noise elbow=0.1": "--noise has no value for shoulder",
        "--noise knee=0.1,elbow=1": "names 'knee', which is not a joint",
        "--noise much": "'much', which is not a number",
    },
    "excite pendulum.urdf --json n.json": {
        "--trajectory circle": '--trajectory must be one of "fourier", "spline", "free"',
        "--criterion f_optimality": '--criterion must be one of "a_optimality"',
        "--normalization some": '--normalization must be one of "none"',
        "--points 9": "--points needs --trajectory spline",
        "--trajectory spline --harmonics 3": "--harmonics needs --trajectory fourier",
        "--trajectory free --save m.csv": "--save does not apply to --trajectory free",
        "--obstacle wall": "'wall' is not an obstacle. Write box:",
        "--obstacle none.obj": "does not exist",
        "--obstacle none.stl": "does not exist",
        "--obstacle box:1,1@0,0,0": "A box needs 3 sizes",
        "--obstacle box:1,1,x@0,0,0": "is not numeric",
        "--obstacle box:1,1,1@0,0": "3 numbers, or 6 with rotation; got 2",
        "--obstacle sphere:-1@0,0,0": "positive",
        "--stand 99": "robot's stand is outside the limits: joint 'shoulder'",
        "--start 99": "start is outside the limits: joint 'shoulder'",
        "--duration -1": "duration must be",
        "--harmonics 0": "--harmonics must be an integer",
        "--seeds 0": "--seeds must be 1 to 1000 integers; there are none",
        "--samples 0": "--samples must be an integer from 1",
        "--clearance -1": "--clearance must be a finite number from 0 to 100; it is -1",
        "--noise 0": "noise of shoulder, elbow is not a positive number",
        "--rate nan": "--rate must be a finite number between",
        "--solver magic": "Nonlinear solver 'magic' is unknown",
        "--save motion.bag": "does not end in .csv or .npz",
        "--meshcat m.png": "does not end in .html",
        "--limits half": "'half', which is not a number",
        "--limits effort=abc,effort=40": "'abc', which is not a number",
        "--limits velocty=1": "Did you mean velocity",
        "--floor --no-floor": "more than once",
        "--limits speed=1": "unknown quantity 'speed'",
        "--limits knee.velocity=1": "'knee', which is not a joint",
        "--limits elbow.position=1": "has position=1, not a range",
        "--limits elbow.position=1:0": "'elbow' has no range of motion",
        "--limits velocity=0": "'shoulder' has no range of motion",
        "--limits elbow.effort=0": "'elbow' has no range of motion",
        "--limits velocity=inf": "velocity of joint 'shoulder' is unlimited",
        "--limits -1": "share must be a finite number above 0",
        "--limits acceleration=inf,effort=0.001": "rest within its limits, but hardly move",
        "--tell-apart coulomb_friction": "takes two effects; got 'coulomb_friction'",
        "--tell-apart ,viscous_friction": "takes two effects",
        "--tell-apart coulomb,viscous_friction": "'coulomb'. Did you mean coulomb_friction",
        "--tell-apart coulomb_friction,viscous_friction@elbw": "Did you mean elbow",
        "--tell-apart payload,viscous_friction@elbow": "payload needs a place",
        "--tell-apart payload@hand,viscous_friction@elbow": "body must be one of",
        "--tell-apart coulomb_friction,coulomb_friction": "cannot be distinguished from itself",
        "--tell-apart effort_delay,viscous_friction": "no linear parameters",
        "--tell-apart drag,viscous_friction --criterion d_optimality": "Omit --criterion",
        "--tell-apart drag,viscous_friction --normalization none": "Omit --normalization",
        "--tell-apart drag,viscous_friction --effects effort_offset": "takes only FILE.py",
    },
    f"excite {BIPED} --duration 4 --harmonics 2 --seeds 1 --iterations 1": {
        "--floating": "Name the links that it stands on: --feet LINK,LINK",
        "--force-plate": "Add --feet LINK,LINK",
        "--feet l_foot=": "LINK=LENGTHxWIDTH",
        "--feet l_foot=big": "'big' of --feet 'l_foot=big' is not a size",
        "--feet l_foot=0.1": "'0.1' of --feet 'l_foot=0.1' is not a size",
        "--feet paw": "The model has no link 'paw' to stand on",
        "--feet l_foot --force-plate --effects effort_offset": "force plate",
        "--feet l_foot --friction 0": "--friction",
        "--feet l_foot --stand 0.3": "its range is",
        "--feet l_foot --limits pelvis_x.position=-1:1": "'pelvis_x'",
    },
    "play pendulum.urdf log.csv": {
        "--out p.png": "does not end in .html",
        "--speed 0": "--speed must be",
        "--seconds -1": "--seconds must be",
        "--live 99999": "is not a port",
        "--before none.urdf": "does not exist",
        "--video p.avi": "does not end in .mp4 or .gif",
        "--to foxglove p.mcap": "--to must be",
        "--to rerun p.mcap": "does not end in .rrd",
        "--video no/p.gif": "cannot be written: No such file",
    },
    "export robot.urdf --to": {
        "usd out": "urdf, sdf, mjcf",
        "urdf . --force": "is an input",
        "urdf log.csv": "not a folder",
        "urdf log.csv/out": "log.csv",
        "urdf out --json no/x.json": "No such file",
        "urdf": "--to-dir",
    },
    "demo": {"--report no_folder/page.html": "Cannot write"},
    "compare": {
        "nothing.urdf log.csv": "nothing.urdf",
        "robot.urdf nothing.csv": "nothing.csv",
        "log.csv robot.urdf": "A model comes before its logs",
        "page.urdf log.csv": "page.urdf",
        "folder.json log.csv": "is a folder",
        "robot.urdf log.csv ./log.csv": "has the same measurements",
        "robot.urdf": "Usage",
    },
}


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder of robots, a saved model, logs, and files that are none of them."""
    folder = tmp_path_factory.mktemp("files")
    shutil.copy(PENDULUM, folder / "pendulum.urdf")
    with_gripper(folder / "robot.urdf")
    (folder / "base.dmd.yaml").write_text(
        f"directives: [{{add_model: {{name: robot, file: file://{PENDULUM}}}}}]\n"
    )
    save_model(load_model(folder / "base.dmd.yaml"), folder / "saved.yaml")
    (folder / "link.yaml").symlink_to("base.dmd.yaml")
    (folder / "page.urdf").write_text("<html><body/></html>")
    (folder / "folder.json").mkdir()
    for name, seed in (("log.csv", 1), ("log_2.csv", 2)):
        write_log(pendulum_log(seed, seconds=10.0, rate=100.0), folder / name)
    return folder


@pytest.fixture
def folder(files, working_folder):
    shutil.copytree(files, working_folder, dirs_exist_ok=True, symlinks=True)
    return working_folder


@pytest.mark.parametrize(
    ("words", "says"),
    [(f"{given} {options}", says) for given, rows in BAD.items() for options, says in rows.items()],
)
def test_one_line_and_no_file(folder, words, says):
    before = contents(folder)
    assert says in refused(*shlex.split(words))
    assert contents(folder) == before


def test_columns_must_be_those_of_the_robot(folder):
    header, rows = Path("log.csv").read_text().split("\n", 1)
    for changed, says in (
        (header.replace("effort", "colour"), "efforts: none"),
        (header.replace("elbow", "elbw"), "(nearest: 'elbow')"),
        (header.replace("elbow.effort", "elbow.colour"), "has positions but no efforts of elbow"),
        ("0,0.1,0.1,0.1,0.1", "has no header"),
    ):
        Path("wrong.csv").write_text(f"{changed}\n{rows}")
        assert says in refused("compare", "pendulum.urdf", "wrong.csv")


def test_effects_of_files_that_fail(folder):
    raising = effect('raise KeyError("what")', name="odd_friction")
    for name, text in (("zero", "x = 1 / 0\n"), ("own", raising), ("twin", raising)):
        Path(f"{name}.py").write_text(text)
    given = ("explain", "pendulum.urdf", "log.csv", "--effects")
    assert "ZeroDivisionError" in refused(*given, "zero.py")
    assert "Two --effects files define" in refused(*given, "own.py", "--effects", "twin.py")
    assert "Two --effects files define" in refused(*given, "own.py,twin.py")
    assert "no effect 'none'" in refused("identify", *given[1:], "own.py, none,coulomb_friction")
    said = refused("add", "odd_friction", *given[1:], "own.py")
    assert "line 14 of" in said and "KeyError" in said


def test_bad_words_are_refused_before_anything_is_read(folder, monkeypatch):
    def read(*_, **__):
        raise AssertionError("a model or a log was read")

    monkeypatch.setattr("geodrake.cli.command.read_model", read)
    for words in ("add nonsense", "compare --json none/x.json", "compare --save x.json"):
        command, *options = words.split()
        refused(command, *options[:1], "pendulum.urdf", "log.csv", *options[1:])


def test_a_saved_model_names_its_missing_base_file(folder):
    save_model(load_model("pendulum.urdf"), "pendulum.yaml")
    Path("pendulum.urdf").unlink()
    message = refused("explain", "pendulum.yaml", "log.csv")
    assert "pendulum.urdf" in message and "base_model" in message


def test_zero_masses_and_odd_units_are_noted_and_not_fatal(folder):
    text = Path("pendulum.urdf").read_text()
    Path("light.urdf").write_text(text.replace('<mass value="0.6256"/>', '<mass value="0"/>'))
    table = pandas.read_csv("log.csv")
    table[[name for name in table if name.endswith("effort")]] *= 1000.0
    table.to_csv("large.csv", index=False)
    output = told("compare", "light.urdf", "large.csv")
    assert "lower_link has a mass of 0 kg" in output
    assert "Efforts seem to be in other units" in output


def test_bugs_are_reported_in_one_line_and_traced_on_demand(folder, monkeypatch):
    def broken(*_arguments, **_settings):
        raise RuntimeError("the sky\nfell")

    monkeypatch.setattr("geodrake.cli.command.read_model", broken)
    words = ("compare", PENDULUM, "log.csv")
    message = refused(*words, code=1)
    assert message.startswith("Internal error: RuntimeError: the sky fell. ")
    for more, environment in ((("--debug",), {}), ((), {"GEODRAKE_DEBUG": "1"})):
        result = run(*words, *more, env=environment)
        assert result.exit_code == 1 and "Traceback" in result.stderr


def test_robots_that_a_command_cannot_use(folder):
    ball = '<sdf version="1.9"><model name="m"><link name="l"/><joint name="j" type="ball">'
    end = "<parent>world</parent><child>l</child></joint></model></sdf>"
    Path("ball.sdf").write_text(ball + end)
    to_sdf = ("export", "pendulum.urdf", "--floating", "--to", "sdf", "out")
    assert "joint j has type" in refused("export", "ball.sdf", "--to", "urdf", "out")
    assert "floating robot" in refused(*to_sdf)
    assert "does not exist" in refused("excite", "none.urdf")
