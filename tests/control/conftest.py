"""The model of two masses, on which rollouts are tested."""

import pytest
from two_masses import URDF

from geodrake import load_model


@pytest.fixture(scope="session")
def pendulum(tmp_path_factory):
    path = tmp_path_factory.mktemp("pendulum") / "pendulum.urdf"
    path.write_text(URDF)
    return load_model(path)
