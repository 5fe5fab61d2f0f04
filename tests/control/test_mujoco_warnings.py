"""What MuJoCo warns of is kept with the proof, and no file beside the user's."""

from pathlib import Path

import numpy as np

from geodrake.control.export_proof.engines.mujoco_engine import MujocoEngine
from geodrake.model.saved_model import load_model

MODEL = Path(__file__).parents[2] / "models" / "double_pendulum.urdf"
MJCF = """<mujoco><worldbody><body name="one"><joint name="shoulder" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <body name="two"><joint name="elbow" axis="0 1 0"/>
    <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>"""


def test_what_mujoco_warns_of_is_no_file(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "two.xml"
    file.write_text(MJCF, encoding="utf-8")
    engine = MujocoEngine(file, load_model(MODEL))
    engine.roll_out(np.zeros(2), np.zeros(2), np.full((3, 2), 1e30), 1e-3)
    (said,) = engine.messages
    assert "The simulation is unstable" in said
    assert [path.name for path in tmp_path.iterdir()] == ["two.xml"]
    assert capfd.readouterr().err == ""
