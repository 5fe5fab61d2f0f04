"""The fuzzer on two kinds of files; thoroughly its quick form. Its long run is a script's."""

import json

import pytest
from fuzz import main


@pytest.mark.parametrize(
    ("cases", "options"),
    [
        (4, ["--cases", "4", "--kind", "CSV log", "--kind", "URDF"]),
        pytest.param(16, ["--quick"], marks=pytest.mark.thorough),
        pytest.param(40, ["--cases", "40"], marks=pytest.mark.thorough),
    ],
)
def test_nothing_breaks(cases, options, tmp_path, capsys):
    target, broken = tmp_path / "fuzz.json", tmp_path / "broken"
    code = main([*options, "--seed", "1", "--json", str(target), "--keep", str(broken)])
    ended = [path.read_text() for path in broken.glob("*/ended.txt")]
    assert code == 0, (capsys.readouterr(), ended)
    found = json.loads(target.read_text(encoding="utf-8"))
    assert found["cases"] == cases and found["broken"] == 0
    ends = {end for own in found["counts"].values() for end in own}
    assert ends == {"result", "refused"}
