"""The quick form of the fuzzer: its long run is `python tests/hostile/fuzz.py`."""

import json
import sys

import fuzz
import pytest


def test_nothing_breaks(tmp_path, monkeypatch):
    files = ["--json", str(tmp_path / "fuzz.json"), "--keep", str(tmp_path / "broken")]
    monkeypatch.setattr(fuzz, "warm_up", lambda: None)  # other tests of this process have
    monkeypatch.setattr(sys, "argv", ["fuzz.py", "--quick", "--seed", "1", *files])
    with pytest.raises(SystemExit) as done:
        fuzz.main()
    ended = [path.read_text() for path in tmp_path.glob("broken/*/ended.txt")]
    assert not done.value.code, ended
    found = json.loads((tmp_path / "fuzz.json").read_text(encoding="utf-8"))
    assert found["cases"] == 40 and found["broken"] == 0
    ends = {end for own in found["counts"].values() for end in own}
    assert ends == {"result", "refused"}
