"""The studies of adaptive control of the WAM-like arm: their parts, and what they must show."""

import json
import math

import numpy as np
import pytest
from scripts import call

from diagrams.harness import run_draws, script_parser, write
from diagrams.studies import wam_adaptation as full
from diagrams.studies.adaptive import laws, loop, wam
from geodrake.inertia import is_physical, to_mass_com_inertia


class TestArm:
    def test_is_the_public_one_repaired(self):
        model = wam.load_wam().model
        assert is_physical(model.phi).all()
        assert model.phi[:, 0].sum() == pytest.approx(19.0, abs=0.01)
        assert len(model.joints) == len(model.bodies) == 7

    def test_plant_weighs_the_load(self):
        plain, loaded = wam.make_plant(), wam.make_plant(wam.LOADS["ellipsoid 2"])
        masses = [plant.CalcTotalMass(plant.CreateDefaultContext()) for plant in (plain, loaded)]
        assert masses[1] - masses[0] == pytest.approx(3.0)

    def test_loads_are_the_sources(self):
        mass, com, inertia = to_mass_com_inertia(wam.LOADS["ellipsoid 2"])
        assert mass == 3.0
        assert np.linalg.norm(com - wam.HELD) == pytest.approx(0.095, abs=1e-3)
        a, b = 0.2165, 0.1082
        assert inertia[0, 0] == pytest.approx(3.0 / 5.0 * (a * a + b * b))

    def test_first_estimates_scale_bodies(self):
        phi = wam.load_wam().model.phi
        some = [wam.first_estimate(sigma, 3, 1).reshape(phi.shape) for sigma in (0.1, 0.4)]
        one, other = (estimate[:, 0] / phi[:, 0] - 1.0 for estimate in some)
        np.testing.assert_allclose(4.0 * one, other)
        assert 0.05 < np.abs(other).max() <= 0.4
        np.testing.assert_allclose(some[1], phi * (1.0 + other[:, None]))
        assert not np.allclose(wam.first_estimate(0.1, 3, 2), wam.first_estimate(0.1, 3, 1))

    def test_rounds_rest_in_between(self):
        motion = loop.rounds((0.4, 1.2), 5.0, 2)
        t = np.linspace(0.0, 10.0, 77)
        amplitude = np.where(t < 5.0, 0.4, 1.2)
        wanted = amplitude * (np.cos(2.0 * np.pi * t / 5.0) - 1.0)
        found = np.array([motion.value(x)[0, 0] for x in t])
        np.testing.assert_allclose(found, wanted, atol=1e-6)
        assert np.abs(motion.EvalDerivative(5.0, 1)).max() < 1e-12


class TestOptions:
    @pytest.mark.parametrize("wrong", [["--seed", "-1"], ["--jobs", "0"], ["--jobs", "two"]])
    def test_numbers_that_make_no_sense_are_told_of(self, wrong, capsys):
        with pytest.raises(SystemExit):
            script_parser("A study.", draws=True).parse_args(wrong)
        assert wrong[0] in capsys.readouterr().err

    def test_draws_of_two_processes_are_kept_and_not_done_again(self, tmp_path):
        parser = script_parser("A study.", draws=True)
        table = tmp_path / "new" / "table.json"
        options = parser.parse_args(["--quick", "--jobs", "2", "--json", str(table)])
        assert run_draws(parser, options, math.factorial, [4, 3]) == [24, 6]
        write(options, {})
        assert table.is_file()
        cache = table.with_suffix(".draws.jsonl")
        assert len(cache.read_text(encoding="utf-8").splitlines()) == 2
        with cache.open("a", encoding="utf-8") as file:
            file.write('{"key": {"versi')
        assert run_draws(parser, options, math.isqrt, [3, 4]) == [6, 24]
        assert run_draws(parser, options, math.isqrt, [4], plan="another") == [2]


class TestRule:
    def rows(self, rms, lost=(), rise=()):
        return [
            {
                "law": law,
                "part": "grid",
                "speed": speed,
                "rms": rms(speed),
                "lost": speed in lost,
                "rise": 1.0 if speed in rise else 1e-6,
                "unphysical": 0.0,
            }
            for law in laws.LAWS[1:]
            for speed in laws.GRID
        ]

    def chosen(self, rows):
        lines = laws.grid_lines(rows, "part")
        return [line["speed"] for line in lines if line["chosen"]]

    def test_takes_the_best_of_what_is_stable(self):
        assert self.chosen(self.rows(lambda speed: 1.0 / speed)) == [3e3] * 3
        rows = self.rows(lambda speed: 1.0 / speed, lost=(3e3, 1e3), rise=(3e2,))
        assert self.chosen(rows) == [1e2] * 3
        assert self.chosen(self.rows(lambda speed: abs(np.log(speed / 3.0)))) == [3.0] * 3

    def test_reported_draws_take_what_is_chosen(self):
        for chosen in laws.CHOSEN.values():
            assert {laws.EUCLIDEAN, laws.NATURAL} <= set(chosen) <= set(laws.LAWS[1:])
            assert set(chosen.values()) <= set(laws.GRID)
        assert laws.speeds("wam", "source")[laws.EUCLIDEAN] == 5e-5


@pytest.fixture(scope="module", params=[0.1, pytest.param(0.4, marks=pytest.mark.thorough)])
def adapted(request):
    """Rows of all laws by name, over σ."""
    speed = laws.speeds("wam", "rule")
    draws = [
        full.Draw(full.NOISE, law, speed[law], request.param, 0, amplitudes=(0.8,), end=1.3)
        for law in laws.LAWS
    ]
    return {draw.law: full.run_draw(draw, seed=0) for draw in draws}


class TestFullAdaptation:
    def test_geometric_laws_track_best(self, adapted):
        rms = {law: row["rms"] for law, row in adapted.items()}
        assert max(rms[laws.NATURAL], rms[laws.PULLBACK]) < 0.5 * rms[laws.EUCLIDEAN]
        assert rms[laws.EUCLIDEAN] < 0.5 * rms[laws.NONE]

    def test_only_the_euclidean_leaves_what_is_physical(self, adapted):
        assert adapted[laws.EUCLIDEAN]["unphysical"] > 0.5
        assert adapted[laws.NATURAL]["unphysical"] == adapted[laws.PULLBACK]["unphysical"] == 0.0

    def test_lyapunov_value_does_not_rise(self, adapted):
        for law in laws.LAWS[1:]:
            assert 0.0 <= adapted[law]["rise"] < 1e-3

    def test_unfinished_rounds_of_a_lost_loop_are_not_told(self):
        draw = full.Draw(full.NOISE, laws.EUCLIDEAN, 10.0, 0.4, 0, amplitudes=(0.8,))
        row = full.run_draw(draw, seed=1)
        assert row["lost"] and row["rounds"] == [None]


def test_controllers_are_compared(tmp_path):
    table = tmp_path / "table.json"
    call("wam_adaptation", "--quick", "--controllers", "--json", table)
    rows = json.loads(table.read_text(encoding="utf-8"))["summary"]
    found = {(row["controller"], row["noise"] > 0.0, row["law"]) for row in rows}
    assert len(found) == len(rows) == 16
    assert not any(row["lost"] for row in rows)
