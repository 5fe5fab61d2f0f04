"""Options with values that they cannot have."""

from itertools import chain

import pytest
from hostile import Row, fill

from geodrake.errors import ArgumentError
from geodrake.identification.logs.compare import compare
from geodrake.logs.filtering import design_filter
from geodrake.model.saved_model import load_model

DATA = "robot.urdf log.csv"
NO_FLOATS = ("wide", "''", "1,5", "0x10")
NO_INTEGERS = ("nan", "inf", "1.5", "many", "''")
ODD = ("nan", "inf", "-1", "1e-300")
HUGE = ("1" * 30,)


def rows(command, option, values, *says, **settings):
    """A row for each value of an option of a command."""
    for value in values:
        name = f"{command.split()[0]} {option} {value}"
        yield Row(name, f"{command} {option} {value}", says, **settings)


def fleet(folder):
    """A fleet file of one robot beside the log."""
    said = "to: new\ntypes: {arm: {model: robot.urdf}}\nrobots: [{name: a, logs: log.csv}]\n"
    (folder / "fleet.yaml").write_text(said, encoding="utf-8")


ROWS = [
    Row("no such effect", "add friction robot.urdf log.csv", ("no effect 'friction'",)),
    Row("all is well", "compare robot.urdf log.csv --json new.json", code=0, writes=("new.json",)),
]

CHECK = [
    Row("check", "check robot.urdf --json new.json", ("agree",), code=0, writes=("new.json",)),
    *rows("check robot.urdf", "--samples", ("0", "-1", "10001", *HUGE), "samples"),
    *rows("check robot.urdf", "--samples", NO_INTEGERS, "'--samples'"),
    *rows("check robot.urdf", "--seed", ("-1",), "seed"),
    *rows("check robot.urdf", "--lock", ("elbow", "elbow=x"), "--lock"),
    *rows("check robot.urdf", "--lock", ("x=0",), "no joint 'x'"),
    Row("check of no file", "check nothing.urdf", ("nothing.urdf",)),
    Row("check over its model", "check robot.urdf --json robot.urdf", ("robot.urdf",)),
]

DIGEST = [
    *rows(f"digest {DATA} --to new", "--bandwidth", ODD, "bandwidth"),
    *rows(f"digest {DATA} --to new", "--bandwidth", ("0.001", "26", "1000"), "bandwidth of"),
    *rows(f"digest {DATA} --to new", "--bandwidth", NO_FLOATS, "'--bandwidth'"),
    *rows(f"digest {DATA} --to new", "--blocks", ("0", "-1", "1", "101", *HUGE), "blocks"),
    *rows(f"digest {DATA} --to new", "--date", ("soon", "nan", "2026-02-30"), "A date is such as"),
    *rows(f"digest {DATA}", "--to", ("log.csv", "log.csv/new"), "no folder"),
    *rows(f"digest {DATA}", "--to", ("/dev/null", "x" * 300), "Digests cannot be"),
    *rows(f"digest {DATA} --to new", "--units", ("position=furlong",), "furlong"),
    *rows(f"digest {DATA} --to new", "--known-payload", ("log.csv:nobody:1",), "nobody"),
    *rows(f"digest {DATA} --to new", "--known-payload", ("log.csv:lower_link:-1",), "mass of"),
    *rows(f"digest {DATA} --to new", "--json", ("log.csv", "robot.urdf", "x.txt"), "--json"),
    Row("digest to nowhere", f"digest {DATA}", ("--to",)),
    Row("digest of no log", "digest robot.urdf --to new", ("LOG",)),
    Row("digest over its input", f"digest {DATA} --to new --json log.json", ("is an input",),
        lambda folder: (folder / "log.json").symlink_to("log.csv")),
]  # fmt: skip

FLEET = [
    *rows("fleet fleet.yaml", "--workers", ("-1", *HUGE), "workers", make=fleet),
    *rows("fleet fleet.yaml", "--every", ODD, "--every", make=fleet),
    *rows("fleet fleet.yaml", "--false-alarms", ("nan", "0", "1"), "false_alarms", make=fleet),
    *rows("fleet fleet.yaml", "--json", ("fleet.yaml", "robot.urdf"), "--json", make=fleet),
    Row("fleet of no file", "fleet none.yaml", ("none.yaml",)),
    Row("fleet of a log", "fleet log.csv", ("log.csv",)),
    Row("fleet of nothing", "fleet", ("FLEET.yaml",)),
]


LOG_OPTIONS = [
    *chain.from_iterable(
        rows(f"{command} {DATA}", "--bandwidth", ODD, "bandwidth of", "Hz")
        for command in ("compare", "rollout")
    ),
    *chain.from_iterable(
        rows(f"{command} {DATA}", "--bandwidth", ("0.05",), "too short")
        for command in ("compare", "diagnose", "explain", "identify", "identifiable", "rollout")
    ),
    *rows(f"compare {DATA}", "--bandwidth", ("0.001", "26"), "bandwidth of"),
    *rows(f"compare {DATA}", "--bandwidth", ("25", "5"), code=0),
    *chain.from_iterable(
        rows(f"{command} {DATA}", "--blocks", ("0", "1", "1001", *HUGE), "blocks")
        for command in ("compare", "diagnose", "identify")
    ),
    *rows(f"compare {DATA}", "--blocks", ("2", "1000"), code=0),
    *rows(f"rollout {DATA}", "--horizon", (*ODD, "1e9", "0.0001"), "horizon"),
    *rows(f"rollout {DATA}", "--horizon", ("0.002",), "between two samples"),
    *rows(f"rollout {DATA}", "--horizon", ("30", "1000"), "In no log does the robot move for"),
    *rows(f"rollout {DATA}", "--windows", ("0", "-1"), "window"),
    Row("a fit of nothing", f"rollout {DATA} --fit", ("no soft joint and no play",)),
    Row("a rollout saved", f"rollout {DATA} --save new.yaml", ("Without --fit",)),
    Row("a fit under commands", f"rollout {DATA} --fit --commands", ("no soft joint and no play",)),
    *rows(f"rollout {DATA}", "--windows", HUGE[-1:], "departs", code=0),
    *rows(f"identify {DATA}", "--gamma", ("nan", "-inf", "0"), "gamma must be"),
    *rows(f"identify {DATA}", "--gamma", ("1e-300",), "gamma 1.00·10⁻³⁰⁰", "·10¹⁵", code=0),
    *rows(f"identify {DATA}", "--gamma", ("1e300",), code=0),
    *rows(f"identify {DATA}", "--residual-bound", (*ODD, "1", "1e9"), "residual bound"),
    *rows(f"identify {DATA}", "--residual-bound", (
        "1000", "1000 --compare"), "nothing limits gamma", code=0),
    *rows(f"identify {DATA}", "--total-mass", ("nan", "-inf", "0"), "total mass"),
    *rows(f"identify {DATA}", "--total-mass", ("1e300", "1e-300"), "leads to a solution"),
    *rows(f"identify {DATA}", "--regularizer", ("''", "nan", "0"), "no regularizer"),
    *rows(f"identifiable {DATA}", "--threshold", ("nan", "-inf", "0"), "threshold"),
    *rows(f"identifiable {DATA}", "--threshold", ("1e-300",)),
    *rows(f"identifiable {DATA}", "--threshold", ("1e300",), code=0),
    *rows(f"identifiable {DATA}", "--noise", ODD, "noise of shoulder, elbow"),
    *rows(f"identifiable {DATA}", "--noise", ("shoulder=1",), "--noise says nothing of elbow"),
    *rows(f"identifiable {DATA}", "--noise", (
        "shoulder=1,elbow=nan", "shoulder=1,elbow=1e300"), "noise of elbow"),
    *rows(f"identifiable {DATA}", "--noise", ("wide", "''", "=1", ",", "elbow="), "--noise"),
    *rows("demo", "--report", ("new.txt",), "does not end in .html"),
]  # fmt: skip

PAYLOADS = [
    *rows(f"compare {DATA} other.csv", "--known-payload", [
        f"log.csv:lower_link:{mass}" for mass in (*ODD, "1e30", "1e20")], "has a mass of"),
    *rows(f"compare {DATA} other.csv", "--known-payload", [
        f"log.csv:lower_link:1:{place}" for place in ("nan,0,0", "0,inf,0", "1e30,0,0", "0,0,1e200")
    ], "has its centre at"),
    *rows(f"compare {DATA} other.csv", "--known-payload", [
        "log.csv::1", "log.csv:lower_link", "log.csv:lower_link:", "log.csv:lower_link:x",
        "log.csv:lower_link:1:0,0", "log.csv:lower_link:1:0,0,0,0"], "cannot be read"),
    *rows(f"compare {DATA} other.csv", "--known-payload", [
        "''", "::::", "none.csv:lower_link:1", "lower_link:1"], "there is no such log"),
    *rows(f"compare {DATA} other.csv", "--known-payload", [
        "log.csv:nobody:1", "log.csv:world:1"], "no body"),
]  # fmt: skip
PAYLOADS = [row for row in PAYLOADS if not row.name.endswith(":1e-300")]  # light, but a mass

QUICK = "--seeds 1 --iterations 2 --seconds 5"
LIMITED = f"excite robot.urdf --limits acceleration=10 {QUICK}"
DESIGN = f"{LIMITED} --samples 30"

DESIGNS = [
    *rows(DESIGN, "--duration", (*ODD, "1e9"), "motion needs a positive duration"),
    *rows(f"{DESIGN} --duration 1e5", "--frequency", ("1000",), "is too long"),
    *rows(DESIGN, "--harmonics", ("0", "-1", *HUGE), "at least one mode"),
    *rows(DESIGN, "--frequency", (*ODD, "1e9"), "frequency"),
    *rows(f"{DESIGN} --trajectory spline", "--points", ("0", "-1", *HUGE), "control points"),
    *rows(LIMITED, "--samples", ("0", "-1", *HUGE), "--samples is a positive number"),
    *rows(f"{LIMITED} --trajectory free", "--samples", ("0", "-1", "5000", *HUGE), "sample"),
    *rows(f"excite robot.urdf {QUICK}", "--limits", ("nan", "0", "-1", "wide", "nan%"), ""),
    *rows(f"excite robot.urdf {QUICK}", "--limits", [
        f"{what}={value}" for what in ("velocity", "acceleration", "effort")
        for value in ("nan", "-1", "0")], ""),
    *rows(f"excite robot.urdf {QUICK}", "--limits", [
        f"position={span}" for span in ("1:0", "0:0", "nan:1", "-inf:inf", "1", ":")], ""),
    *rows(f"excite robot.urdf {QUICK}", "--limits", (
        "=1", "velocity", "nobody.velocity=1", "elbow.=1", "velocity="), "--limits"),
    *rows(DESIGN, "--start", ("nan", "inf", "1e300"), ""),
    *rows(DESIGN, "--start", ("wide", "shoulder=1"), "--start"),
    *rows(DESIGN, "--clearance", ("nan", "inf", "-inf", "-1", "1e300"), "--clearance"),
    *rows(DESIGN, "--noise", ODD, "noise of shoulder, elbow"),
    *rows(DESIGN, "--seeds", ("0", "-1", *HUGE), "--seeds is a positive number"),
    *rows(DESIGN, "--seed", ("-1", "1" * 30), "--seed is not negative"),
    *rows(DESIGN, "--seconds", ("nan", "-inf", "0"), "--seconds is a"),
    *rows(DESIGN, "--iterations", ("0", "-1", *HUGE), "--iterations is a positive number"),
    *rows(f"{DESIGN} --save new.csv", "--rate", (
        "nan", "-inf", "0"), "--rate is a positive number"),
    *rows(DESIGN, "--criterion", ("''", "nan"), "no criterion"),
    *rows(DESIGN, "--normalization", ("''", "0"), "no normalization"),
    *rows(DESIGN, "--solver", ("''", "simplex"), "solver"),
    *rows(DESIGN, "--trajectory", ("''", "circle"), "no trajectory"),
    *rows(DESIGN, "--tell-apart", ("''", ",", "drag", "coulomb_friction"), ""),
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_row(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "row", [*CHECK, *DIGEST, *FLEET, *LOG_OPTIONS, *PAYLOADS, *DESIGNS], ids=str
)
def test_options(row, tmp_path, monkeypatch):
    row.check(tmp_path, monkeypatch)


@pytest.mark.parametrize("bandwidth", [float("nan"), 0.0, -1.0, 1e-300, 1e-9, 26.0, 1e300])
def test_filters_have_a_bandwidth_that_fits(bandwidth):
    with pytest.raises(ArgumentError, match=r"Choose a bandwidth from 0\.005 to 25 Hz"):
        design_filter(0.01, bandwidth)


def test_a_library_call_has_the_bounds_of_the_command(tmp_path):
    fill(tmp_path)
    model = load_model(tmp_path / "robot.urdf")
    with pytest.raises(ArgumentError, match="blocks"):
        compare(model, [tmp_path / "log.csv"], blocks=10**9)
