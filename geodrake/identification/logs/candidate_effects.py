"""Candidate effects of a diagnosis: every effect at every place where it can occur."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import catalogue
from geodrake.effects.base import Effect, JointEffect
from geodrake.effects.column_checks import of_geodrake
from geodrake.effects.declarations import Proposer, Role
from geodrake.effects.friction import SharedActuatorEffect
from geodrake.effects.user_effects import candidates_of
from geodrake.identification.logs.reduce import moving_together, peak_speeds
from geodrake.logs.filtering import ZeroPhaseFilter
from geodrake.logs.motion import Trajectory
from geodrake.logs.smoothing import Segment
from geodrake.model.carried_payloads import joints_on_ground, joints_with_known_gain
from geodrake.model.ground_contacts import contact_frames
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

LONGEST_DELAY = 0.05
"""Longest candidate delay between motion and effort, s."""

_FROM_RESIDUAL = (Proposer.WAVES, Proposer.EPISODE, Proposer.HANDLING)
_LEAST_WARMING = 2.0  # °C; sensors resolve 1 °C, in which friction changes by a few per cent
_ALIKE = 1e-9  # largest 1 − |cos| between the speeds of joints that move alike


def candidate_effects(
    model: RobotModel,
    trajectories: Sequence[Trajectory],
    extra: Sequence[type[Effect]] = (),
    *,
    speeds: Array | None = None,
) -> tuple[Effect, ...]:
    """Return all instances of effects, of the catalogue and the user, that a robot can have.

    Excluded are effects whose shape comes from a residual (see `proposals`), those of pairs of
    joints that do not follow each other (see `coupled`), shared actuators of joints that never move
    together in these logs, and effects that need inertias known from other logs, unless known
    payloads or the ground provide them (see `joints_with_known_gain`). Joints that bear ground
    forces get no elasticity, as no column has the deflection by these forces. Shape grids scale
    with the logs' temperatures and with peak `speeds` (nv,), rad/s or m/s, by default the logs'.
    """
    peaks = peak_speeds(trajectories) if speeds is None else speeds
    single = [joint for joint in model.joints if joint in model.single_joints]
    unmeasured = {joint for trajectory in trajectories for joint in trajectory.unmeasured}
    unseen = unmeasured.union(model.base_joints)
    single = [joint for joint in single if joint not in unseen]
    grounded = [frame for t in trajectories for frame in t.ground_frames]
    calibrated = joints_with_known_gain(model, [t.payloads for t in trajectories], grounded)
    standing = joints_on_ground(model, grounded)
    known = [joint for joint in single if joint in calibrated]
    speed = dict(zip(model.joints, peaks.tolist(), strict=True))
    temperatures = mean_temperatures(trajectories)
    effects: list[Effect] = []
    segments = [
        segment
        for trajectory in trajectories
        for segment in (s[:100_000] for s in trajectory.segments)
    ]
    spans = np.max([np.ptp(segment.position, axis=0) for segment in segments], axis=0)
    reach = dict(zip(model.joints, spans.tolist(), strict=True))
    followers = [p for p in model.joint_pairs if not {*p}.intersection(unseen)]
    overlap = moving_together(trajectories) if speeds is None else np.ones((len(peaks),) * 2)
    together = [p for p in followers if overlap[*map(model.joints.index, p)]]
    duration = max(float(t.segments[-1][-1:].time[0] - t.began) for t in trajectories)
    passive = {joint for trajectory in trajectories for joint in trajectory.passive}
    frames = dict.fromkeys(frame for t in trajectories for frame in t.force_sensors)
    # One sensor per body, the first: their offsets add up.
    sensors = {f.body: f.origin.tolist() for f in reversed(contact_frames(model, [*frames]))}

    def has_none(effect: type[Effect], joint: str) -> bool:
        slides = effect.turning_only and joint in model.sliding_joints
        gives_way = effect.role is Role.DEFLECTION and joint in standing
        return slides or gives_way or (effect.of_motor and joint in passive)

    for effect in (*catalogue(), *extra):
        unknown = effect.needs_known_inertia and model.information is None
        from_residual = effect.proposer in _FROM_RESIDUAL
        if from_residual or (unknown and effect.places != "joint"):
            continue
        if effect.places == "joint":
            for joint in (j for j in (known if unknown else single) if not has_none(effect, j)):
                if speed[joint] > 0.0 and effect.proposer in (Proposer.WARMING, Proposer.BRISTLES):
                    effects.extend(effect.shaped(joint, reach=reach[joint], duration=duration))
                elif speed[joint] > 0.0:
                    effects.extend(_at_joint(effect, joint, speed[joint], temperatures.get(joint)))
        elif effect.places == "joint_pair":
            pairs = together if issubclass(effect, SharedActuatorEffect) else followers
            for pair in (p for p in pairs if not any(has_none(effect, j) for j in p)):
                effects.extend(candidates_of(effect, pair))
        elif effect.places == "body":
            for body in () if effect.of_force_sensor else model.bodies:
                effects.extend(candidates_of(effect, body))
            for body, origin in sensors.items() if effect.of_force_sensor else ():
                effects.extend(candidates_of(effect, body, *origin))
        elif effect.places == "robot":
            effects.extend(candidates_of(effect))
    return (*effects, *_effects_behind(model, segments))


def _effects_behind(model: RobotModel, segments: Sequence[Segment]) -> Iterator[Effect]:
    """Yield effects of joints that follow with varying ratio, as in closed loops."""
    speeds = _speeds_behind(model, segments)
    for effect in catalogue() if speeds else ():
        for joint, peak in speeds.items() if _acts_behind(effect) else ():
            yield from candidates_of(effect, joint, peak)


def _acts_behind(effect: type[Effect]) -> bool:
    """Return whether an effect is friction or a spring, which joints without motors have too."""
    if not issubclass(effect, JointEffect) or effect.rows is not JointEffect.rows:
        return False
    if effect.role is not Role.FORCE or effect.turning_only or effect.of_motor:
        return False
    return of_geodrake(effect) and effect.depends_on in ({"q"}, {"v"})


def _speeds_behind(model: RobotModel, segments: Sequence[Segment]) -> dict[str, float]:
    """Return the peak speeds, rad/s or m/s, of joints that follow with a varying ratio.

    Of joints that move alike, only the first is included.
    """
    coordinates, peaks = model.coordinates, dict[str, float]()
    if coordinates.constant is not None or not segments:
        return peaks
    driven, rates = list[Array](), list[Array]()
    for segment in segments:
        q, v = model.positions(segment.position), segment.velocity
        driven.append(v)
        rates.append(coordinates.all_samples(q, v, np.zeros_like(v))[1])
    others = [v / max(float(np.linalg.norm(v)), 1e-300) for v in np.concatenate(driven).T]
    for joint, index in coordinates.behind.items():
        v = np.concatenate(rates)[:, index]
        unit = v / max(float(np.linalg.norm(v)), 1e-300)
        if unit.any() and not any(abs(unit @ other) > 1.0 - _ALIKE for other in others):
            peaks[joint] = float(np.abs(v).max())
            others.append(unit)
    return peaks


def _at_joint(
    effect: type[Effect], joint: str, speed: float, temperature: float | None
) -> Sequence[Effect]:
    """Return candidate instances of an effect at a joint with a peak speed, rad/s or m/s.

    The mean `temperature`, °C, is None if it is constant or unknown.
    """
    if "temperature" not in effect.depends_on:
        return candidates_of(effect, joint, speed)
    if temperature is None:
        return ()
    return effect.shaped(joint, speed=speed, temperature=temperature)


def mean_temperatures(trajectories: Sequence[Trajectory]) -> dict[str, float]:
    """Return the mean temperature, °C, of each joint whose temperature changes enough."""
    courses = [t.temperatures.courses for t in trajectories if t.temperatures is not None]
    means = {}
    for joint in trajectories[0].joints:
        values = [course[joint][1] for course in courses if joint in course]
        if values and np.ptp(temperature := np.concatenate(values)) >= _LEAST_WARMING:
            means[joint] = float(temperature.mean())
    return means


_SHORT = 0.25, 0.1  # fractions of a step: robots with heavy rotors reveal shorter delays


def candidate_delays(low_pass: ZeroPhaseFilter) -> tuple[float, ...]:
    """Return candidate delays, s: 0, multiples of the step that the data resolve, and fractions.

    The step depends on the sampling period and the bandwidth of efforts and regressors.
    """
    period, bandwidth = low_pass.period, low_pass.bandwidth
    step = max(period, LONGEST_DELAY / 10, min(0.02 / bandwidth, LONGEST_DELAY / 2))
    steps = np.arange(1, max(2, int(LONGEST_DELAY / step + 1e-9) + 1)) * step
    fractions = [sign * share * step for share in _SHORT for sign in (1.0, -1.0)]
    return (0.0, *steps.tolist(), *(-steps[: (len(steps) + 1) // 2]).tolist(), *fractions)
