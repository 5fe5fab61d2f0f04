"""A real hobby arm, an SO-101, by commands and positions: whose simulation moves as the arm does?

Three models are fitted to two of five public logs (slow sines, and a multisine): geodrake's, the
same MuJoCo model by mujoco.sysid with the same free parameters, and a second-order servo for each
joint, without dry friction and load. All then follow the commands of the other three logs, for two
minutes from the first measured position; MuJoCo simulates the first two. Reported are root mean
squares of simulated − measured positions.

    python -m diagrams.benchmarks.hobby_arm --json hobby_arm.json

It needs the public logs, and `pip install "mujoco[sysid]"` for the second model, which is left out
otherwise. Another part fits a Dynamixel XL330 that swings a weight at a gain of 100, and predicts
it at one of 400, alone and by MuJoCo; also by the gain that fits best there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares, minimize_scalar
from scipy.signal import cont2discrete, lfilter

from diagrams.benchmarks.simulated.servos import servo_spec, set_damping
from diagrams.harness import script_parser, show, write
from diagrams.public_data import add_folder_option, require
from geodrake import load_model
from geodrake.effects.of_files import BRAKING_SHARE
from geodrake.identification.logs.servo_fit import ServoFit
from geodrake.identification.logs.servo_motion import PARAMETERS
from geodrake.identification.logs.signal_calibration import (
    calibrate_efforts,
    servo_motions,
    with_servo_motions,
)
from geodrake.inertia import Array
from geodrake.logs.files import Reading, read_log
from geodrake.logs.motion import JointLog
from geodrake.logs.motors import motor_named
from geodrake.model.logged_joints import reading_for

FITTED = ("multisine", "friction_gravity")
TESTED = ("reaching_points", "step_response", "backlash_detection")
_STEP = 2e-3  # s, of MuJoCo's simulation
_SYSID_STEP, _SYSID_SHARE, _SYSID_ITERATIONS = 5e-3, 0.25, 12  # of the logs, in the middle
_LATEST = 0.06  # s
_FOLLOWED = 0.2  # of what loads change by in a step: friction by the whole of it goes to and fro
_STIFF = [0.9999, 0.9999, 0.001, 0.5, 2.0]  # solimp of dry friction
# What is free at a joint, where sysid begins, and its bounds.
_FREE: Mapping[str, tuple[float, float, float]] = {
    "stiffness": (17.8, 1.0, 200.0),
    "damping": (0.6, 0.0, 10.0),
    "coulomb": (0.052, 0.0, 5.0),
    "armature": (0.028, 1e-4, 1.0),
    "offset": (0.0, -3.0, 3.0),
    "delay": (0.02, 0.0, _LATEST),
}

Simulate = Callable[[JointLog], Array]


@dataclass(frozen=True)
class Fit:
    """A fitted model, a simulation of a log's commands, and its cost."""

    name: str
    simulate: Simulate
    seconds: float


def arm_spec(urdf: Path, step: float) -> mujoco.MjSpec:
    """Return the arm with a servo at each joint, without its meshes and contacts."""
    spec = servo_spec(urdf.read_text(encoding="utf-8"), step)
    for joint in spec.joints:
        # By MuJoCo's defaults joints creep under dry friction, in two minutes by centimetres.
        joint.solref_friction, joint.solimp_friction = [2.0 * step, 1.0], _STIFF
        spec.add_sensor(
            name=f"{joint.name}_pos",
            type=mujoco.mjtSensor.mjSENS_JOINTPOS,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            objname=joint.name,
        )
    return spec


def put(spec: mujoco.MjSpec, joint: str, name: str, value: float) -> None:
    """Set a parameter of a joint; delays belong to commands, not to the model."""
    servo, own = spec.actuator(joint), spec.joint(joint)
    if name == "stiffness":
        servo.gainprm[0], servo.biasprm[1] = value, -value
    elif name == "offset":
        servo.biasprm[0] = -value
    elif name == "damping":
        set_damping(own, value)
    elif name == "coulomb":
        own.frictionloss = value
    elif name == "armature":
        own.armature = value


def by_mujoco(urdf: Path, values: Mapping[str, Mapping[str, float]]) -> Simulate:
    """Simulate the arm with parameters of its joints.

    Damping against the rate r of the command is that of the joint, with a delay longer by r / kp.
    """
    spec = arm_spec(urdf, _STEP)
    for joint, own in values.items():
        for name, value in own.items():
            rate = own.get("rate", 0.0) if name == "damping" else 0.0
            put(spec, joint, name, value + rate)
    model = spec.compile()
    dry, load = (
        np.array([own.get(name, 0.0) for own in values.values()]) for name in ("coulomb", "load")
    )
    braking = BRAKING_SHARE / np.maximum(load, 1e-6)

    def simulate(log: JointLog) -> Array:
        since = log.time - log.time[0]
        times = np.arange(0.0, since[-1] + _STEP, _STEP)
        told = np.empty((len(times), model.nu))
        for j, joint in enumerate(log.joints):
            own = values[joint]
            late = np.interp(times - own["delay"], since, log.command[:, j])
            lead = own.get("rate_share", 1.0) * own.get("rate", 0.0) / own["stiffness"]
            told[:, j] = late + lead * np.gradient(late, _STEP)
        data, found = mujoco.MjData(model), np.empty_like(told)
        data.qpos[:] = log.position[0]
        needed, now = np.zeros((2, model.nv))  # by the bodies, up to the step before
        for k, command in enumerate(told):
            found[k] = data.qpos
            data.ctrl[:] = command
            along = np.maximum(needed * np.sign(data.qvel), -braking)
            model.dof_frictionloss[:] = dry + load * np.square(along)
            mujoco.mj_step(model, data)
            mujoco.mj_mulM(model, data, now, data.qacc)
            now += data.qfrc_bias - model.dof_armature * data.qacc
            needed += _FOLLOWED * (now - needed)
        return np.column_stack([np.interp(since, times, q) for q in found.T])

    return simulate


def by_geodrake(urdf: Path, logs: Sequence[JointLog]) -> Fit:
    """Fit geodrake's model."""
    began = time.process_time()
    known = calibrate_efforts(load_model(urdf), logs)[0]
    model, fits = with_servo_motions(known, logs)
    seconds = time.process_time() - began
    values = {joint: _values(fits[joint]) for joint in model.joints}
    return Fit("geodrake", by_mujoco(urdf, values), seconds)


def _values(fit: ServoFit) -> dict[str, float]:
    return dict(zip(PARAMETERS, fit.parameters.tolist(), strict=True)) | {
        "rate_share": fit.rate_share
    }


def by_sysid(urdf: Path, logs: Sequence[JointLog]) -> Fit | None:
    """Fit the same parameters by mujoco.sysid, as its documentation does; None without it."""
    from mujoco import sysid

    if not hasattr(sysid, "optimize"):
        return None
    began, spec = time.process_time(), arm_spec(urdf, _SYSID_STEP)
    params, transform = sysid.ParameterDict(), sysid.SignalTransform(normalize=False)
    for joint in logs[0].joints:
        for name, (start, low, high) in _FREE.items():
            put(spec, joint, name, start)
            params.add(
                sysid.Parameter(
                    f"{joint}.{name}",
                    nominal=start,
                    min_value=low,
                    max_value=high,
                    modifier=lambda s, p, j=joint, n=name: put(s, j, n, float(p.value[0])),
                )
            )
        transform.delay(f"{joint}_pos", params[f"{joint}.delay"])
    model = spec.compile()
    sequences = []
    for log in logs:
        since = log.time - log.time[0]
        middle = 0.5 * since[-1] * np.array([1.0 - _SYSID_SHARE, 1.0 + _SYSID_SHARE])
        times = np.arange(*middle, _SYSID_STEP)
        command, measured = (
            np.column_stack([np.interp(times, since, column) for column in values.T])
            for values in (log.command, log.position)
        )
        start = sysid.create_initial_state(model, measured[0], np.zeros(model.nv), np.zeros(0))
        times = times - times[0]
        told = sysid.TimeSeries.from_control_names(times, command, model)
        seen = sysid.TimeSeries.from_names(times, measured, model)
        sequences.append(sysid.ModelSequences("arm", spec, log.name, start, told, seen))
    residual = sysid.build_residual_fn(models_sequences=sequences, modify_residual=transform.apply)
    found, _ = sysid.optimize(
        initial_params=params,
        residual_fn=residual,
        optimizer="mujoco",
        verbose=False,
        max_iters=_SYSID_ITERATIONS,
    )
    values = {
        joint: {name: float(found[f"{joint}.{name}"].value[0]) for name in _FREE}
        for joint in logs[0].joints
    }
    return Fit("mujoco.sysid", by_mujoco(urdf, values), time.process_time() - began)


def by_second_order(logs: Sequence[JointLog]) -> Fit:
    """Fit x'' = w² (c(t − δ) − x) − 2 d w x' to each joint."""
    began = time.process_time()

    def simulated(log: JointLog, j: int, values: Array) -> Array:
        w, d, delay = values
        since = log.time - log.time[0]
        period = float(np.median(np.diff(since)))
        even = np.arange(0.0, since[-1] + period, period)
        late = np.interp(even - delay, since, log.command[:, j]) - log.position[0, j]
        b, a, _ = cont2discrete(([w**2], [1.0, 2.0 * d * w, w**2]), period, "zoh")
        return log.position[0, j] + np.interp(since, even, lfilter(b[0], a, late))

    def fitted(j: int) -> Array:
        def residual(x: Array) -> Array:
            return np.concatenate([simulated(log, j, x) - log.position[:, j] for log in logs])

        low, high = [1.0, 0.05, 0.0], [200.0, 20.0, _LATEST]
        starts = [np.array([w, 1.0, 0.02]) for w in (5.0, 20.0)]
        fits = [least_squares(residual, s, bounds=(low, high), x_scale=s) for s in starts]
        return np.asarray(min(fits, key=lambda fit: fit.cost).x)

    values = [fitted(j) for j in range(len(logs[0].joints))]

    def simulate(log: JointLog) -> Array:
        return np.column_stack([simulated(log, j, own) for j, own in enumerate(values)])

    return Fit("servo of second order", simulate, time.process_time() - began)


def arm_rows(folder: Path, *, quick: bool) -> list[dict[str, Any]]:
    """Return a row for each model and log."""
    urdf = folder / "reference/so101.urdf"
    model = load_model(urdf)
    reading = reading_for(model, Reading(kinds={"": "command"}))

    def read(name: str) -> JointLog:
        files = [folder / f"data/so101/{name}.{kind}.csv" for kind in ("state_motor", "control")]
        return read_log("+".join(map(str, files)), joints=model.joints, reading=reading)

    logs = [read(name) for name in (FITTED[:1] if quick else FITTED)]
    fits = [by_geodrake(urdf, logs), by_second_order(logs)]
    if not quick and (other := by_sysid(urdf, logs)) is not None:
        fits.insert(1, other)
    rows = []
    for name in TESTED[-1:] if quick else TESTED:
        log = read(name)
        for fit in fits:
            departs = fit.simulate(log) - log.position
            rms = np.sqrt(np.mean(np.square(departs), axis=0))
            rows.append(
                {
                    "log": name,
                    "model": fit.name,
                    "MSE, rad²": float(np.mean(np.square(departs))),
                    "RMS, mrad": 1e3 * float(np.sqrt(np.mean(np.square(rms)))),
                    "of motion": float(
                        np.sqrt(np.mean(np.square(rms)) / np.mean(np.var(log.position, axis=0)))
                    ),
                    "CPU, s": fit.seconds,
                    "joints, rad": dict(zip(log.joints, rms.tolist(), strict=True)),
                }
            )
    return rows


def pendulum_row(folder: Path) -> dict[str, Any]:
    """Return the XL330 at a gain of 400, by its motion at one of 100; degrees."""
    model = load_model(folder / "data/xl330/pendulum.urdf")
    slow, fast = (
        read_log(folder / f"data/xl330/cmd_{name}.csv", joints=model.joints)
        for name in ("kp100_sin_sin", "kp400_up_and_down")
    )
    slow = replace(slow, motors={"servo": motor_named("xl330-m288")})
    _, fits = with_servo_motions(calibrate_efforts(model, [slow])[0], [slow])
    (fit,) = fits.values()
    motions = servo_motions(model, [fast], [0])[0]

    def stiffer(share: float) -> ServoFit:
        found = fit.parameters.copy()
        found[PARAMETERS.index("stiffness")] *= 4.0 * share
        return replace(fit, parameters=found)

    def departs(share: float) -> float:
        found = stiffer(share).parameters.tolist()
        servo = motions.servo(found, limit=fit.limit, rate_share=fit.rate_share)
        return float(np.rad2deg(motions.rms(servo)))

    best = minimize_scalar(departs, bounds=(0.5, 1.5), method="bounded")
    found = {"servo": _values(stiffer(1.0))}
    whole = by_mujoco(folder / "data/xl330/pendulum.urdf", found)(fast) - fast.position
    return {
        "fitted, °": float(np.rad2deg(fit.error)),
        "predicted at four times the gain, °": departs(1.0),
        "by MuJoCo, °": float(np.rad2deg(np.sqrt(np.mean(np.square(whole))))),
        "and by the gain that fits best, °": float(best.fun),
        "which is of four times": float(best.x),
    }


def main() -> None:
    """Run from the command line."""
    parser = script_parser(__doc__)
    add_folder_option(parser)
    options = parser.parse_args()
    require(parser, options.shared, "reference/so101.urdf", "data/so101/*.csv", "data/xl330/*.csv")
    rows = arm_rows(options.shared, quick=options.quick)
    show("An SO-101 under its commands, two minutes at a time", rows)
    pendulum = pendulum_row(options.shared)
    show("A Dynamixel XL330", [pendulum])
    write(options, {"arm": rows, "pendulum": pendulum})


if __name__ == "__main__":
    main()
