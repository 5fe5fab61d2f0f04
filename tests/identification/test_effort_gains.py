"""Gains of signals in the place of efforts: against truth, and against changes of unit."""

from dataclasses import replace

import numpy as np
import pytest
from measurements import DATA, REFERENCE
from pinocchio_logs import MODELS, effort_log

from geodrake import load_model
from geodrake.errors import LogError
from geodrake.identification.logs.case import open_case
from geodrake.identification.logs.effort_gains import _GeodesicBodies
from geodrake.identification.logs.signal_calibration import calibrate_efforts, calibrated
from geodrake.logs import read_log
from geodrake.model import EffortSignal
from geodrake.model.logged_joints import log_of_model

GAINS = np.array([12.0, -7.5, 3.0, 5.0, 1.5, 0.8])


@pytest.fixture(scope="module")
def arm():
    return load_model(MODELS / "arm6.urdf")


def friction(seen):
    """Dry and viscous friction in another formula than the library's."""
    return 2.0 * seen.v / np.sqrt(seen.v**2 + 1e-4) + 1.5 * seen.v


@pytest.fixture(scope="module")
def torques():
    return effort_log("arm6", 3, friction, off=0.05, duration=12.0, rate=100.0).log


def currents(log, gains):
    kinds = dict.fromkeys(log.joints, "current")
    return replace(log, effort=log.effort / gains, effort_kinds=kinds)


@pytest.fixture(scope="module")
def found(arm, torques):
    return calibrated(arm, [currents(torques, GAINS)], ["current"] * 6)


def test_gains_lie_in_their_intervals_and_near(found):
    """Bodies 5 % off in the geometric distance, friction of every joint, one sign turned round."""
    ratio = np.array([s.gain for s in found]) / GAINS
    spread = np.array([s.uncertainty for s in found])
    told = spread < 0.4  # light wrists hardly show theirs
    assert told[:3].all()
    np.testing.assert_allclose(ratio[told], 1.0, atol=0.1)
    assert (np.abs(np.log(np.abs(ratio))) < 2.0 * spread).all()


@pytest.mark.parametrize("are_magnitudes", [True, False])
def test_currents_that_do_not_go_with_the_motion_are_refused(arm, torques, are_magnitudes):
    """Late ones, with and without their sign: no gain makes efforts of them."""
    log = currents(torques, GAINS)
    late = np.roll(log.effort, 400, axis=0)
    log = replace(log, effort=np.abs(late) if are_magnitudes else late)
    with pytest.raises(LogError, match=r"The currents of .* do not match the motion") as error:
        calibrate_efforts(arm, [log])
    assert ("seem to be magnitudes" in error.value.advice) == are_magnitudes


def test_unit_and_signs_of_currents_do_not_matter(arm, torques, found):
    units = 1e3 * np.array([1.0, -1.0, -1.0, 1.0, 1.0, 1.0])
    other = calibrated(arm, [currents(torques, GAINS * units)], ["current"] * 6)
    for a, b, unit in zip(found, other, units, strict=True):
        assert b.gain == pytest.approx(unit * a.gain, rel=1e-3)
        assert b.uncertainty == pytest.approx(a.uncertainty, rel=1e-2)


def test_measured_efforts_tell_the_scale_of_the_others(arm, torques, found):
    log = currents(torques, GAINS)
    effort = log.effort.copy()
    effort[:, 1] *= GAINS[1]
    kinds = {joint: kind for joint, kind in log.effort_kinds.items() if joint != log.joints[1]}
    mixed = replace(log, effort=effort, effort_kinds=kinds)
    names = ["current", "effort", *["current"] * 4]
    known = {s.joint: s.uncertainty for s in calibrated(arm, [mixed], names)}
    alone = {s.joint: s.uncertainty for s in found}
    assert log.joints[1] not in known
    assert known[log.joints[2]] < alone[log.joints[2]]


def test_known_gains_are_taken_as_they_are(arm, torques):
    signals = tuple(
        EffortSignal(joint, "current", gain, 0.02 * abs(gain))
        for joint, gain in zip(torques.joints, GAINS.tolist(), strict=True)
    )
    model, logs, notes = calibrate_efforts(
        replace(arm, effort_signals=signals), [currents(torques, GAINS)]
    )
    np.testing.assert_allclose(logs[0].effort, torques.effort)
    np.testing.assert_allclose(logs[0].gain_deviations, 0.02)
    assert model.effort_signals == signals and not notes


def test_logs_of_two_kinds_are_refused_together(arm, torques):
    with pytest.raises(LogError, match=r"current in .* and effort in"):
        calibrate_efforts(arm, [currents(torques, GAINS), replace(torques, name="other")])


def test_a_model_of_voltages_refuses_currents(arm, torques):
    signals = tuple(EffortSignal(joint, "voltage", 2.0) for joint in torques.joints)
    with pytest.raises(LogError, match="knows its gain from voltage"):
        calibrate_efforts(replace(arm, effort_signals=signals), [currents(torques, GAINS)])
    motor = EffortSignal(torques.joints[0], "effort", 1.0, limit=9.0)
    with pytest.raises(LogError, match="its motor's limit for commanded efforts"):
        calibrate_efforts(replace(arm, effort_signals=(motor,)), [currents(torques, GAINS)])


def test_rows_beyond_the_limit_of_a_motor_are_noted(arm, torques):
    asked = np.abs(torques.effort[:, 0])
    motor = EffortSignal(torques.joints[0], "effort", 1.0, limit=float(np.quantile(asked, 0.75)))
    able = replace(arm, effort_signals=(motor,))
    _, (given,), (note,) = calibrate_efforts(able, [torques])
    assert np.abs(given.effort[:, 0]).max() == motor.limit
    assert (
        f"in 25 % of the rows the commanded effort of {motor.joint} exceeds the motor's limit"
        in note
    )
    assert note in open_case(able, [torques], candidates=False).notes
    assert calibrate_efforts(able, [given])[2] == []


@pytest.mark.measurements("data/ur10e_free_c.csv", "reference/ur10e.urdf")
def test_ur10e_gains_lie_in_their_intervals():
    """The model file is 28 % off in what gravity needs, and its gains know that they may be."""
    model = load_model(REFERENCE / "ur10e.urdf")
    log = log_of_model(read_log(DATA / "ur10e_free_c.csv"), model)
    found = calibrated(model, [currents(log, GAINS)], ["current"] * 6)
    off = np.log([s.gain / gain for s, gain in zip(found, GAINS, strict=True)])
    assert (np.abs(off) < 2.0 * np.array([s.uncertainty for s in found])).all()


def test_slopes_of_geodesic_bodies_are_those_of_differences(arm):
    bodies = _GeodesicBodies.of(arm)
    x = 0.3 * np.random.default_rng(0).normal(size=arm.phi.size)
    x[:10] = 0.0  # where eigenvalues meet
    slope = bodies.at(x)[1]
    step = 1e-6
    columns = [
        (bodies.at(x + step * e)[0] - bodies.at(x - step * e)[0]) / (2.0 * step)
        for e in np.eye(len(x))
    ]
    np.testing.assert_allclose(slope, np.stack(columns, 1), atol=1e-6 * np.abs(slope).max())
