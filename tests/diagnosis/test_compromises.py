"""Effects that are told only together, or only once another one is known.

Logs are Pinocchio's inverse dynamics with hidden efforts in formulas of their own.
"""

from functools import cache

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from effort_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.diagnosis import explain

LATE = 0.0203  # s


@cache
def model_file(name):
    return load_model(MODELS / f"{name}.urdf")


def steps_of(name, *logs):
    """Effect -> places, parameters and held-out errors of what is found."""
    return {step.effect: step for step in explain(model_file(name), logs).steps}


@pytest.mark.thorough
@pytest.mark.parametrize("pace", [0.6, pytest.param(0.08, marks=pytest.mark.thorough)])
def test_rotor_that_turns_with_the_difference_of_two_joints(pace):
    """It turns with each joint too: alone, none of its three entries explains much."""

    def hidden(seen):
        torque = 0.01 * (seen.a[:, 4] - seen.a[:, 5])
        return {4: torque, 5: -torque}

    steps = steps_of("arm6", effort_log("arm6", 1, hidden, share=0.005, pace=pace).log)
    assert set(steps) <= {"coupled_rotor_inertia", "rotor_inertia"}
    found = steps["coupled_rotor_inertia"]
    joints = model_file("arm6").joints[4:]
    assert found.where == joints
    (values,) = found.parameters.values()
    assert values["inertia"] == pytest.approx(-0.01, rel=0.1)


@pytest.mark.thorough
def test_drag_beside_viscous_friction():
    """v and v² together look like a power between them, which fits nearly as well."""

    def hidden(seen):
        v = seen.v[:, 2]
        return {2: 3.0 * v + 4.0 * v * np.abs(v)}

    steps = steps_of("arm6", effort_log("arm6", 2, hidden, share=0.005).log)
    assert set(steps) == {"viscous_friction", "nonlinear_viscous_friction"}
    joint = model_file("arm6").joints[2]
    drag = steps["nonlinear_viscous_friction"].parameters[joint]
    assert drag["exponent"] == pytest.approx(2.0, abs=0.15)
    assert steps["viscous_friction"].parameters[joint]["viscous"] == pytest.approx(3.0, rel=0.15)


@pytest.mark.thorough
@pytest.mark.parametrize("pace", [0.5, 0.15])
def test_spring_beside_viscous_friction(pace):
    """While the friction is not known a compensator of another phase fits better than a spring."""

    def hidden(seen):
        q, v = seen.q[:, 1], seen.v[:, 1]
        return {1: seen.load[:, 1].std() * (0.13 * (q - 0.8) / q.std() + 0.07 * v / v.std())}

    steps = steps_of("arm6", effort_log("arm6", 1, hidden, share=0.02, pace=pace).log)
    assert set(steps) == {"joint_spring", "viscous_friction"}
    joint = model_file("arm6").joints[1]
    assert all(step.where == (joint,) for step in steps.values())


@pytest.mark.thorough
def test_delay_beside_friction():
    """A delay that is a little off looks like a rotor: it is timed anew once friction is known."""

    def hidden(seen):
        total = seen.load.copy()
        total[:, 1] += 8.0 * seen.v[:, 1]
        later = [np.interp(seen.time - LATE, seen.time, effort) for effort in total.T]
        return np.stack(later, 1) - seen.load

    steps = steps_of("arm6", effort_log("arm6", 3, hidden, share=0.005).log)
    assert set(steps) == {"effort_delay", "viscous_friction"}
    (delay,) = steps["effort_delay"].parameters.values()
    assert delay["delay"] == pytest.approx(LATE, abs=1e-4)
