"""Random MJCFs mean to geodrake what they mean to MuJoCo."""

import json

from scripts import call


def test_random_files_agree_with_mujoco(tmp_path):
    call("random_mjcf", "--quick", "--seed", 7, "--json", tmp_path / "table.json")
    table = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))
    assert table["largest relative difference"] <= 1e-9
    assert table["refused by MuJoCo"] <= 4 and table["joints"] > 200
    assert table["files with something left out"] == 0
