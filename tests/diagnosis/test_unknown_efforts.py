"""Efforts that no effect of the catalogue describes: what they go with is told, and no name.

Logs are Pinocchio's inverse dynamics with hidden efforts in formulas of their own.
"""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from pinocchio_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import explain

ARM = load_model(MODELS / "arm6.urdf")
OWN, OTHER = ARM.joints[2], ARM.joints[4]


def brake(seen):
    """Friction of a joint that another one's position tightens."""
    return {2: 2.0 * (1.2 + np.sin(2.0 * seen.q[:, 4])) * np.tanh(seen.v[:, 2] / 0.01)}


def stop(seen):
    """A spring that begins past an angle."""
    q = seen.q[:, 2]
    return {2: 30.0 * np.logaddexp(0.0, (q - q.min() - 0.6 * np.ptp(q)) / 0.02) * 0.02}


def damper(seen):
    """A damper that another joint opens."""
    return {2: 3.0 * (seen.q[:, 4] - seen.q[:, 4].mean()) * seen.v[:, 2]}


@pytest.mark.parametrize(
    ("hidden", "signal"),
    [
        pytest.param(brake, f"its direction of motion times the position of {OTHER}", id="brake"),
        pytest.param(stop, "its position", id="stop"),
        pytest.param(damper, f"its velocity times the position of {OTHER}", id="damper"),
    ],
)
def test_signal_is_told_and_no_name(hidden, signal):
    explanation = explain(ARM, [effort_log("arm6", 1, hidden, share=0.01).log])
    assert not [step.effect for step in explanation.steps if step.probability > 0.9]
    assert explanation.verdict == "unexplained"
    assert [note for note in explanation.notes if f"at {OWN} varies with {signal} in a" in note]
