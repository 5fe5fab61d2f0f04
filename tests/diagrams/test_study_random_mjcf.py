"""Random MJCFs mean to geodrake what they mean to MuJoCo."""

import json

import pytest
from scripts import call


@pytest.mark.parametrize("seed", [0, 7])
def test_random_files_agree_with_mujoco(tmp_path, seed):
    call("random_mjcf", "--quick", "--seed", seed, "--json", tmp_path / "table.json")
    table = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))
    assert table["largest relative difference"] <= 1e-9
    assert table["refused by MuJoCo"] <= 4 and table["joints"] > 200
    assert table["files with something left out"] == 0
