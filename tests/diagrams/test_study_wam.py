"""The studies of adaptive control of the WAM-like arm: their parts, and what they must show."""

import json

import numpy as np
import pytest
from scripts import call

from diagrams.studies import wam_adaptation as full
from diagrams.studies.adaptive import laws, wam
from geodrake.inertia import to_mass_com_inertia


def test_loads_are_the_sources():
    mass, com, inertia = to_mass_com_inertia(wam.LOADS["ellipsoid 2"])
    assert mass == 3.0
    assert np.linalg.norm(com - wam.HELD) == pytest.approx(0.095, abs=1e-3)
    a, b = 0.2165, 0.1082
    assert inertia[0, 0] == pytest.approx(3.0 / 5.0 * (a * a + b * b))


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


def test_unfinished_rounds_of_a_lost_loop_are_not_told():
    draw = full.Draw(full.NOISE, laws.EUCLIDEAN, 10.0, 0.4, 0, amplitudes=(0.8,))
    row = full.run_draw(draw, seed=1)
    assert row["lost"] and row["rounds"] == [None]


def test_controllers_are_compared(tmp_path):
    table = tmp_path / "table.json"
    call("wam_adaptation", "--quick", "--controllers", "--json", table)
    rows = json.loads(table.read_text(encoding="utf-8"))["summary"]
    found = {(row["controller"], row["noise"] > 0.0, row["law"]) for row in rows}
    assert len(found) == len(rows) == 16
    assert not any(row["lost"] for row in rows if row["law"] != laws.EUCLIDEAN)
