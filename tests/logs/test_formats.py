"""Logs that other libraries wrote, read without a word about what is in them."""

from dataclasses import replace
from pathlib import Path

import foreign_logs
import numpy as np
import pytest
from foreign_logs import FORMATS, joint_states, lerobot, ros2_header, ros2_store, write_rosbag2

from geodrake.errors import ArgumentError, LogError
from geodrake.identification.logs.compare import compare
from geodrake.logs import JointLog, log_of_frame, read_log, write_log
from geodrake.model.saved_model import load_model

MODEL = Path(__file__).parents[2] / "models" / "double_pendulum.urdf"
JOINTS = ("shoulder", "elbow")


@pytest.fixture(scope="module")
def model():
    return load_model(MODEL)


@pytest.fixture(scope="module")
def log():
    time = 0.01 * np.arange(1200)
    q = np.column_stack([np.sin(1.9 * time), np.cos(3.1 * time) + 0.3 * np.sin(0.7 * time)])
    noise = 0.05 * np.random.default_rng(1).standard_normal(q.shape)
    effort = 8.0 * np.sin(q) + np.sign(np.gradient(q, axis=0)) + noise
    return JointLog("log", JOINTS, time, q, effort, np.gradient(q, time, axis=0))


@pytest.fixture(scope="module")
def csv_errors(model, log, tmp_path_factory):
    path = tmp_path_factory.mktemp("csv") / "log.csv"
    write_log(log, path)
    return errors(model, path)


def errors(model, path):
    table = compare(model, [path]).errors
    return np.array([[e.rms, e.std, e.floor] for e in table.joints])


@pytest.mark.parametrize("write", FORMATS, ids=lambda write: write.__name__)
def test_compare_says_the_same_as_of_a_csv(tmp_path, model, log, csv_errors, write):
    path = write(tmp_path, log)
    read = read_log(path, joints=JOINTS)
    assert read.joints == JOINTS
    for quantity in ("time", "position", "velocity", "effort"):
        assert np.allclose(getattr(read, quantity), getattr(log, quantity), rtol=0, atol=1e-8)
    assert np.allclose(errors(model, path), csv_errors, rtol=1e-6)
