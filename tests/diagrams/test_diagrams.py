"""Every script in `diagrams/` runs, shortened, and writes its numbers and figures.

One script runs in a new process, as a user starts it; the others run in this process.
"""

import json
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from statistics import mean

import numpy as np
import pytest
from meshcat_pages import drawn, tracks
from scripts import ROOT, SCRIPTS, call, start

from diagrams import benchmarks_page
from geodrake.logs import read_log

RUNS = json.loads(benchmarks_page.FIGURES.read_text(encoding="utf-8"))
APART = "body_distances"


def reaches_its_bars(table):
    """A few logs tell little: in 90 to 98 % of all runs, one of them is wrong."""
    lines = {line["figure"]: line for line in table["lines"] if line["bar"] is not None}
    told = {figure: line["reached"] for figure, line in lines.items() if line["logs"]}
    del told["coverage of 95 % intervals, coloured noise"], told["said at 0.9 – 0.99: true"]
    assert len(told) >= 9
    assert all(told.values()), told
    (least,) = table["smallest"]
    assert least["smallest"] <= 0.01


def takes_little_memory(table):
    """Most of the memory is that of Python and Drake."""
    works = {"compare", "diagnose", "read csv", "read parquet"}
    assert {cost["work"] for cost in table} == works
    for cost in table:
        assert cost["samples"] == 20_000
        assert 0.1 < cost["peak_memory"] < 0.6


def digests_are_small_and_merge(table):
    """Two digests equal a reading of both logs up to rounding."""
    (cost,) = table
    assert cost["bytes"] < 2e5
    assert cost["merged"] < 1e-12
    assert cost["made"] < 5.0 * cost["reading"]


def says_what_diagnose_names_and_days_tell(table):
    assert table["named_afterwards"] == {"double pendulum": []}
    (pair,) = table["days"]
    assert pair["fit"] != pair["test"] and pair["steps"]
    ((before, after),) = pair["third"].values()
    assert 0.0 < after != before


def finds_servos(table):
    assert table["summary"]["all effects in the set"] == 1.0
    assert table["summary"]["kp"]["inside"] == 1.0
    assert table["summary"]["kp"]["median error"] < 0.1
    assert table["summary"]["departure over that of the true model, median"] < 1.2


def names_friction_and_tool_of_an_arm(table):
    lines = {line["figure"]: line["value"] for line in table["lines"]}
    assert lines["ordinary: everything named"] == 1.0
    assert lines["tool's mass inside its interval"] == 1.0
    assert lines["nothing hidden, white noise: something named"] == 0.0


def names_what_an_arm_hides(table):
    lines = {line["figure"]: line["value"] for line in table["lines"]}
    assert lines["everyday: nothing else named"] == 1.0
    (row,) = table["rows"]
    assert row["failed"] is None
    assert row["end_nrms"] < 0.3


def logs_of_feet_agree_with_inverse_dynamics(table):
    """MuJoCo's inverse dynamics, less the wrenches of the feet, are the motors' efforts."""
    assert len(table["rows"]) == 2
    assert all(0.0 < row["inverse_error"] < 1e-9 for row in table["rows"])


def finds_changes_of_a_fleet(table):
    assert table["summary"]["found"] == 1.0
    assert table["summary"]["robots with nothing that are named"] == 0


def goes_on_where_it_was_killed(table):
    found = table["summary"]
    assert found["the same results"] == found["runs"] > found["nothing killed"]
    assert found["digests made again"] == 0


def orders_laws_as_the_source(table):
    """The natural law tracks best, then the Euclidean one, then none."""
    rows = table.get("summary", table["rows"])
    for part in {row.get("part") for row in rows} - {"steps"}:
        rms = {row["law"]: row["rms"] for row in rows if row.get("part") == part}
        assert rms["natural"] < rms["euclidean"] < rms["none"], part
        assert rms["pullback"] < rms["none"]


def adapts_to_a_sandbag_and_stays_physical(table):
    orders_laws_as_the_source(table)
    (natural,) = (row for row in table["rows"] if row["law"] == "natural")
    assert natural["unphysical"] == 0.0
    assert not natural["lost"]


def orders_normalizations_as_the_source(table):
    """Compare means over frames or base representations, as one may be lucky."""
    errors = {}
    for row in table["rows"]:
        if row.get("criterion", "e_optimality") == "e_optimality":
            errors.setdefault(row["normalization"], []).append(row["error"])
    assert mean(errors["geometric"]) < mean(errors["diagonal"]) < mean(errors["none"])


def one_map_with_geometric_normalization_alone(table):
    """Without it, the best motion differs between coordinates."""
    rows = {}
    for row in table["rows"]:
        rows.setdefault(row["normalization"], []).append(row)
    own = rows["geometric"]
    assert max(row["shape_difference"] for row in own) < 1e-9  # decades
    assert len({(row["best_amplitude"], row["best_offset"]) for row in own}) == 1
    assert np.ptp([row["best_value"] for row in own]) < 1e-9 * own[0]["best_value"]
    for name in ("none", "diagonal"):
        assert min(row["shape_difference"] for row in rows[name]) > 0.5
        assert len({(row["best_amplitude"], row["best_offset"]) for row in rows[name]}) >= 3


def identifies_less_but_better(table):
    assert 0 < table["identifiable"] < table["base_parameters"]
    rows = {row["way"]: row for row in table["rows"]}
    assert rows["reduced"]["error"] < rows["prior"]["error"] < 1e-2 * rows["full"]["error"]
    assert rows["reduced"]["moment"] < rows["full"]["moment"]


def survives_its_faults(table):
    for row in table["rows"]:
        if row["controller"] != "unguarded":
            assert row["faults"] >= 2
            assert row["ratio"] < 3.0 and row["recovery"] < 5.0
            assert 0.02 < row["least_mass"] < row["greatest_mass"] < 20.0
            assert row["last_memory"] - row["first_memory"] < 20.0


def moves_as_the_arm_does(table):
    ours, simple = (row["MSE, rad²"] for row in table["arm"])
    assert ours < 1e-4 and ours < 0.1 * simple
    assert table["pendulum"]["fitted, °"] < 1.8
    assert table["pendulum"]["by MuJoCo, °"] < 2.5


def newton_and_others_have_the_same_cost(table):
    """Check only the direction of times, which are those of a busy machine."""
    found = table["arm"]["from the factor"]
    assert abs(found["cost difference, drake"]) < 1e-6
    assert abs(found.get("cost difference, cvxpy", 0.0)) < 1e-4
    assert found["newton / drake"] < 0.8
    (row,) = table["arm"]["geodesic least squares"]
    assert row["curvature"] > 0
    assert row["entropic residual"] == pytest.approx(row["residual"], rel=1e-3)
    for kind in ("geodesic", "entropic"):
        assert row[kind]["error"] < 0.5 * row["prior"]["error"]


def euclidean_bodies_are_flat_and_far(table):
    means = {(x["samples"], x["regularizer"]): x for x in table["summary"]}
    entropic, euclidean = (means[30, kind] for kind in ("entropic", "euclidean"))
    assert euclidean["training"] == pytest.approx(entropic["training"], rel=1e-4)
    assert means[4100, "entropic"]["test"] < entropic["test"] < euclidean["test"]
    assert entropic["at_boundary"] == 0 and euclidean["at_boundary"] > 3
    assert entropic["distance"] < 1.1 * means[0, "prior"]["distance"] < 0.5 * euclidean["distance"]


def few_samples_need_a_distance_of_bodies(table):
    few = {row["regularizer"]: row for row in table if row["samples"] == 30 and row["stretch"]}
    euclidean = few["euclidean"]
    assert euclidean["median"] > euclidean["prior"]
    for kind in ("point_mass_euclidean", "pullback", "entropic"):
        assert few[kind]["median"] < 0.9 * euclidean["median"]
        assert few[kind]["test"] < 0.9 * euclidean["test"]
    assert few["riemannian"]["median"] < euclidean["median"]
    for kind in ("euclidean", "point_mass_euclidean", "pullback"):  # fair: as good in training
        assert few[kind]["train"] == pytest.approx(few["entropic"]["train"], rel=1e-5)
    most = max(row["samples"] for row in table)
    tests = [row["test"] for row in table if row["samples"] == most]
    assert len(tests) == 5 and max(tests) < 1.02 * min(tests)
    assert max(tests) < 0.3 * few["entropic"]["median"]


def a_leg_predicts_the_gallop(table):
    means = {(row["quantity"], row["regularizer"]): row["mean"] for row in table}
    for quantity in ("body force", "body moment"):
        entropic, euclidean, prior = (
            means[quantity, kind] for kind in ("entropic", "euclidean", "prior")
        )
        assert entropic < 0.7 * euclidean < euclidean < prior


def distances_of_bodies_know_no_frames_and_units(table):
    """The Euclidean distance depends on them, and grows with the mass."""
    spread = table["frames_and_units"]["largest_over_smallest_less_1"]
    geometric = ("pullback", "entropic", "riemannian")
    euclidean = ("euclidean, kg-m", "euclidean, inch-pound")
    assert all(spread[name] < 1e-9 for name in geometric) and spread["euclidean"] > 1e3
    assert all(angle in (0.0, 180.0) for angle in table["direction_of_shortest_deg"].values())
    ratio = table["shortest_over_longest_by_direction"]
    # Moved by d along x: m d² / Σxx with Σxx = m a²/5, against a ninth of it across.
    assert ratio["entropic"] == pytest.approx(1 / 9)
    assert all(ratio[name] > 0.8 for name in euclidean)
    ratio = table["largest_over_smallest_by_mass"]
    assert all(ratio[name] < 1.5 for name in geometric)  # which is the noise of 200 samples
    assert all(ratio[name] == pytest.approx(40**2, rel=0.4) for name in euclidean)


def names_mistakes_of_columns_and_nothing_else(table):
    lines = {line["columns"]: line for line in table["lines"]}
    assert lines["as it is"]["alarms"] == 0
    assert lines["sign of an effort"]["named"] == lines["efforts swapped"]["named"] == 1


def reads_random_files_as_mujoco(table):
    assert table["largest relative difference"] <= 1e-9
    assert table["refused by MuJoCo"] <= 4 and table["joints"] > 200
    assert table["files with something left out"] == 0


def predicts_a_human_better_than_its_prior(tables):
    """Compare blocks that were not fitted, at equal residuals."""
    found = {line["regularizer"]: line for line in tables["errors"]}
    prior = (13.79, 2.09, 1.58)  # [Lee2019] table 3.1: N, cm, cm
    np.testing.assert_allclose(found["prior"]["test"], prior, atol=0.005)
    for name in set(found) - {"prior"}:
        test = np.array(found[name]["test"])
        assert (test < 0.95 * np.array(found["prior"]["test"])).all(), name
        assert (test[1:] > found[name]["train"][1:]).all(), name
    assert len(tables["fits"]) == 10
    for row in tables["fits"]:
        assert abs(row["mismatch"]) < 1e-5
        assert sum(row["masses"]) == pytest.approx(64.0, rel=1e-7)
        if row["regularizer"] == "euclidean":
            assert len(row["degenerate"]) >= 8  # as in figure 3.13
        else:
            assert not row["degenerate"] and row["least"] > 0.1
        assert row["starts_agree"] in ((True,) if row["regularizer"] == "riemannian" else (None,))


@dataclass(frozen=True)
class Run:
    """A script, and how it is run."""

    shows: object = None  # what its numbers must show
    long: bool = False  # whether it takes more than 3 s of the processor
    draws: bool = False  # whether it has figures
    alike: bool = False  # whether what --quick writes has all figures of docs/benchmarks.md
    needs: tuple = ()  # measurements below their folder


TABLE = {
    "adaptive_soak": Run(survives_its_faults, long=True, alike=True),
    "adaptive_speed": Run(alike=True),
    "ambidex_arm": Run(euclidean_bodies_are_flat_and_far, long=True, draws=True),
    "ambidex_sandbags": Run(adapts_to_a_sandbag_and_stays_physical, long=True, draws=True),
    "atlas_identification": Run(identifies_less_but_better, long=True, draws=True, alike=True),
    APART: Run(distances_of_bodies_know_no_frames_and_units, draws=True),
    "cheetah_gallop": Run(a_leg_predicts_the_gallop, long=True, draws=True),
    "cheetah_leg": Run(few_samples_need_a_distance_of_bodies, long=True, draws=True),
    "column_errors": Run(names_mistakes_of_columns_and_nothing_else),
    "digest_speed": Run(digests_are_small_and_merge),
    "effect_pictures": Run(draws=True),
    "everyday_robots": Run(names_what_an_arm_hides, long=True),
    "excitation_contours": Run(one_map_with_geometric_normalization_alone, draws=True),
    "excitation_speed": Run(alike=True),
    "excite_arms": Run(long=True),
    "fleet_kills": Run(goes_on_where_it_was_killed, long=True, alike=True),
    "fleet_speed": Run(),
    "fleet_study": Run(finds_changes_of_a_fleet, long=True, alike=True),
    "floating_robots": Run(logs_of_feet_agree_with_inverse_dynamics, long=True),
    "hidden_effect_log": Run(),
    "hidden_effects": Run(reaches_its_bars, long=True),
    "hobby_arm": Run(
        moves_as_the_arm_does,
        long=True,
        needs=("data/so101/*.csv", "data/xl330/*.csv", "reference/so101.urdf"),
    ),
    "human_identification": Run(
        predicts_a_human_better_than_its_prior,
        long=True,
        draws=True,
        needs=("data/human_force_plate.npz",),
    ),
    "identification_speed": Run(newton_and_others_have_the_same_cost),
    "iiwa_excitation": Run(orders_normalizations_as_the_source),
    "long_log": Run(takes_little_memory, long=True),
    "online_payload": Run(long=True, needs=("data/ur10e_*.csv", "reference/ur10e.urdf")),
    "ordinary_robots": Run(names_friction_and_tool_of_an_arm, long=True),
    "pages_and_exports": Run(long=True),
    "random_mjcf": Run(reads_random_files_as_mujoco),
    "readme_figures": Run(long=True, draws=True),
    "real_robots": Run(
        says_what_diagnose_names_and_days_tell,
        long=True,
        needs=("data/double_pendulum_c1_*.csv",),
    ),
    "regressor_speed": Run(alike=True),
    "scara_excitation": Run(orders_normalizations_as_the_source, long=True),
    "servo_gains": Run(finds_servos, long=True),
    "tell_apart": Run(long=True, alike=True),
    "wam_adaptation": Run(orders_laws_as_the_source, long=True, draws=True),
    "wam_payload": Run(orders_laws_as_the_source, draws=True),
}
"""All scripts but those with tests of their own."""


def marks_of(run):
    marks = [pytest.mark.measurements(*run.needs)] if run.needs else []
    return [*marks, pytest.mark.thorough] if run.long else marks


def test_every_script_is_run():
    assert {*SCRIPTS} - {"iiwa_messages", "run_scenario"} == {*TABLE}


@pytest.mark.parametrize("name", [pytest.param(n, marks=marks_of(r)) for n, r in TABLE.items()])
def test_script(name, tmp_path):
    run, table, figures = TABLE[name], tmp_path / "table.json", tmp_path / "figures"
    arguments = ("--quick", "--seed", 3, "--json", table, *run.draws * ("--figures", figures))
    if name == APART:
        done = start(name, *arguments)
        assert done.returncode == 0, done.stderr
    else:
        call(name, *arguments)
    found = json.loads(table.read_text(encoding="utf-8"))
    assert found
    if run.shows:
        run.shows(found)
    if run.alike:
        benchmarks_page.read(RUNS[name], found)
    assert not run.draws or list(figures.glob("*.png"))


@pytest.mark.parametrize("name", [name for name, run in TABLE.items() if run.needs])
def test_absent_measurements_are_said_clearly(name, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        call(name, "--quick", "--shared", tmp_path)
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith(f"There are no measurements in {tmp_path}: it lacks\n")
    for path in TABLE[name].needs:
        assert path.partition("*")[0] in said
    assert "GEODRAKE_MEASUREMENTS" in said


class TestRunScenario:
    def test_two_arms_and_a_crate(self, tmp_path):
        table = tmp_path / "table.json"
        call("run_scenario", "--quick", "--seed", 3, "--json", table, "--figures", tmp_path)
        found = json.loads(table.read_text(encoding="utf-8"))
        rms = {row["robot"]: row["rms"] for row in found["tracking"] if row["joint"] == "all"}
        assert set(rms) == {"arm", "second"}
        assert 0.0 < rms["arm"] < 0.01
        assert 0.0 < rms["second"] < 0.05
        assert np.abs(found["moved"]["crate::crate"]).max() < 1e-3
        assert (tmp_path / "push_errors.png").stat().st_size > 10_000
        page = (tmp_path / "push.html").read_text(encoding="utf-8")
        moved = {path.split("/visualizer/")[-1].split("/")[0] for path, _ in tracks(page)}
        assert {"arm", "second", "crate"} <= moved
        assert any("/table/" in path for path in drawn(page))

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("--scenario", "none.yaml"), "none.yaml does not exist"),
            (("--scenario-name", "dance"), "It has push, carry, messages, controller"),
            (("--json", "/dev/null/x/table.json"), "no folder /dev/null/x"),
        ],
    )
    def test_errors_of_scenarios_are_one_line(self, arguments, message, capsys):
        with pytest.raises(SystemExit) as ended:
            call("run_scenario", *arguments)
        assert ended.value.code == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("Error: ") and message in line


class TestHiddenEffectLog:
    SCRIPT = "hidden_effect_log"

    def test_demo_log_is_what_the_script_makes(self, tmp_path):
        demo = Path(str(files("geodrake.demo")))
        arm = (ROOT / "models" / "arm6.urdf").read_bytes()
        assert (demo / "demo.urdf").read_bytes() == arm
        call(self.SCRIPT, "--demo", "--quick", "--log", tmp_path / "log.csv")
        made = read_log(tmp_path / "log.csv")
        shipped = read_log(demo / "demo.csv")
        assert made.joints == shipped.joints
        first = slice(len(made))
        np.testing.assert_allclose(made.time, shipped.time[first])
        np.testing.assert_allclose(made.position, shipped.position[first], atol=1e-4)
        np.testing.assert_allclose(made.velocity, shipped.velocity[first], atol=2e-3)
        # Noise is a share of the effort's deviation, which differs between 4 and 24 s.
        error = (made.effort - shipped.effort[first]).std(0)
        assert (error < 0.05 * shipped.effort.std(0)).all()

    @pytest.mark.parametrize(
        ("effect", "where", "message"),
        [("friction", "elbow", "no effect 'friction'"), ("viscous_friction", "knee", "'knee'")],
    )
    def test_bad_effects(self, tmp_path, effect, where, message):
        log = tmp_path / "log.csv"
        options = ("--effect", effect, "--where", where, "--size", "1")
        with pytest.raises(SystemExit, match=message):
            call(self.SCRIPT, "--quick", "--robot", "double_pendulum", "--log", log, *options)
        assert not log.exists()
