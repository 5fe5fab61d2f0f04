"""The quick form of the fuzzer: its long run is `python tests/hostile/fuzz.py`."""

import json
import os
import subprocess
import sys
from pathlib import Path

from hostile import ROOT

SCRIPT = Path(__file__).with_name("fuzz.py")


def test_nothing_breaks(tmp_path):
    command = [sys.executable, str(SCRIPT), "--quick", "--seed", "1"]
    command += ["--json", str(tmp_path / "fuzz.json"), "--keep", str(tmp_path / "broken")]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=600, check=False
    )
    ended = [path.read_text() for path in tmp_path.glob("broken/*/ended.txt")]
    assert done.returncode == 0, (done.stdout, done.stderr, ended)
    found = json.loads((tmp_path / "fuzz.json").read_text(encoding="utf-8"))
    assert found["cases"] == 40 and found["broken"] == 0
    ends = {end for own in found["counts"].values() for end in own}
    assert ends == {"result", "refused"}
