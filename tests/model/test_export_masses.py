"""MJCFs whose settings change masses are exported with the inertias that they then have."""

from dataclasses import replace

import numpy as np
import pytest

from geodrake import load_model
from geodrake.model.export import export_model

TEXT = """<mujoco model="m"><compiler {}/><worldbody>
<body name="a"><joint name="a" axis="0 1 0"/><geom size=".1" pos=".1 0 0"/>
<inertial pos="0 0 .1" mass="2" diaginertia=".1 .1 .1"/>
<body name="b" pos="0 0 .3"><joint name="b"/><geom type="box" size=".1 .2 .3" pos=".1 0 0"/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    "settings",
    ['settotalmass="5"', 'boundmass="3" boundinertia="1"', 'inertiafromgeom="true"'],
)
def test_settings_of_masses_are_not_exported(tmp_path, settings):
    path, out = tmp_path / "m.xml", tmp_path / "out.xml"
    path.write_text(TEXT.format(settings), encoding="utf-8")
    model = load_model(path)
    phi = model.phi.copy()
    phi[1] *= 1.5
    exported = export_model(replace(model, phi=phi))
    out.write_bytes(exported.content)
    np.testing.assert_allclose(load_model(out).phi, phi, rtol=1e-9, atol=1e-12)
    assert any("settings of m.xml by which MuJoCo changes masses" in n for n in exported.notes)
