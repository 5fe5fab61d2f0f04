"""Efforts outside the catalogue of effects, as rivals of every explanation."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from geodrake.diagnosis.residuals import (
    SLOW,
    filtered_columns,
    full_motion,
    joint_residuals,
)
from geodrake.effects.base import (
    Effect,
    JointEffect,
    JointMotion,
    JointPairEffect,
    Parameter,
    RobotMotion,
    Rows,
)
from geodrake.effects.declarations import Shape
from geodrake.identification.logs.case import Case
from geodrake.identification.logs.hypothesis import Hypothesis
from geodrake.identification.logs.reduce import peak_speeds, sign_widths
from geodrake.logs.motion import Trajectory
from geodrake.model.robot_model import RobotModel

Array = NDArray[np.float64]

_SAMPLES = 100_000  # of a segment that are loaded at a time
_RESOLVED = 2.0  # least speed of a shape, over that below which the direction is unknown
_MOST_COUPLED = 6  # curves of other joints' motions at a joint
_CHOSEN_BY = 4_000  # samples to choose them
_DEGREES = 7  # polynomials of a curve
_WIDER = 3.0  # speed up to which friction may differ, over that of unknown directions
_SLIP = 0.02  # of a joint's peak speed, below which presliding may occur


@dataclass(frozen=True)
class UnresolvedReversal(JointEffect):
    """Dry friction at speeds at which a log hardly shows the direction of motion.

    effort = h₀ (sgn v − d) + Σ_k h_k (tanh(2^k v/w) − d) + Σ_k e_k e^{−|v|/s_k} d
             + Σ_k j_k (v/√(v² + s_k²) − d) + Σ_k m_k (1 − |tanh(v/s_k)|) + l (1 − |d|) sgn v̇,
    with d = tanh(v/w): friction that jumps more sharply than the direction d of other effects, or
    less, or that differs there, or whose mean over both directions is not zero, or that jumps late
    or early, as do the measured velocities. Speeds below w pass within a sample, or are noise.
    Ordinary motions do not show presliding, below the speeds s_k.
    """

    speed: float  # w, rad/s or m/s
    slip: float  # the largest s_k, rad/s or m/s

    name: ClassVar[str] = "unresolved_reversal"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        *(Parameter(f"sharper_{k}", "N·m") for k in range(3)),
        *(Parameter(f"excess_{k}", "N·m") for k in range(3)),
        *(Parameter(f"softer_{k}", "N·m") for k in range(2)),
        *(Parameter(f"mean_{k}", "N·m") for k in range(2)),
        Parameter("late", "N·m"),
    )
    shapes: ClassVar[tuple[Shape, ...]] = (Shape("speed", "rad/s"), Shape("slip", "rad/s"))
    depends_on: ClassVar[frozenset[str]] = frozenset({"v", "vd"})
    unsure: ClassVar[int] = [each.name for each in parameters].index("mean_0")
    """Index of the column with the share of time of unknown direction."""

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Return one column for each parameter, in the order of the equation."""
        v, usual = joint.v, np.tanh(joint.v / self.speed)
        speeds = self.speed, float(np.sqrt(self.speed * self.slip)), self.slip
        excess = [np.exp(-np.abs(v) / s) * usual for s in speeds]
        softer = [v / np.hypot(v, s) - usual for s in speeds[1:]]
        sharper = [np.sign(v) - usual, *(np.tanh(k * v / self.speed) - usual for k in (2.0, 4.0))]
        means = [1.0 - np.abs(np.tanh(v / s)) for s in (self.speed, self.slip)]
        late = np.sign(joint.vd) * means[0]
        return [*sharper, *excess, *softer, *means, late]


@dataclass(frozen=True)
class UnknownFunction(JointEffect):
    """Smooth function of a joint's own motion that no effect describes.

    It has no constant, and no part that is proportional to the velocity, which are effects.
    """

    center: float  # middle of the joint's range of motion, rad or m
    reach: float  # half that range
    speed: float  # its peak speed, rad/s or m/s

    name: ClassVar[str] = "unknown_function"
    parameters: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(f"coefficient_{k}", "N·m") for k in range(9)
    )
    shapes: ClassVar[tuple[Shape, ...]] = tuple(
        Shape(name) for name in ("center", "reach", "speed")
    )
    depends_on: ClassVar[frozenset[str]] = frozenset({"q", "v"})
    complexity: ClassVar[int] = 3

    @property
    def free_shapes(self) -> int:
        """Return zero: the scales are those of the motion."""
        return 0

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Return polynomials of position and velocity, and the direction times the position."""
        q, v = (joint.q - self.center) / self.reach, joint.v / self.speed
        even, odd = q * q - 1.0 / 3.0, q**3 - 0.6 * q
        return [
            q,
            even,
            odd,
            np.abs(v) * v,
            v**3,
            v * v - 1.0 / 3.0,
            q * v,
            even * v,
            joint.sign_v * q,
        ]


_OWN = ("q", "1"), ("q", "v"), ("q", "sgn v"), ("v", "1"), ("v", "sgn v")
_OTHERS = (
    *_OWN,
    *((signal + sense, "1") for signal in "qv" for sense in "+-"),
    *(("v" + sense, "its sign") for sense in "+-"),
)
_FACTORS = {
    "1": "{}",
    "v": "its velocity times {}",
    "sgn v": "its direction of motion times {}",
    "its sign": "{}, and its direction",
}


@dataclass(frozen=True)
class Curve:
    """Smooth curve of a signal, times a function of the motion of the joint it acts on."""

    # Position "q" or velocity "v" of the other joint; "q+", "v-": its sum with, or difference from,
    # that of the joint it acts on.
    of: str
    times: str  # "1", "v", "sgn v", or "its sign", the sign of the signal
    center: float  # middle of the signal's range, rad or m, or per second
    reach: float  # half that range
    speed: float  # peak speed of the joint it acts on, rad/s or m/s

    def columns(self, own: JointMotion, other: JointMotion, unsure: float = 0.0) -> list[Array]:
        """Return Legendre polynomials of the signal, times its factor.

        Effects are left to others: offsets, and dry and viscous friction of the joint itself.
        `unsure` is the speed below which the direction of a sum of speeds is unknown.
        """
        signal = (other.q if self.of[0] == "q" else other.v) - self.center
        if self.of[1:]:
            added = own.q if self.of[0] == "q" else own.v
            signal = signal + (added if self.of[1] == "+" else -added)
        scaled = signal / self.reach
        factor = {
            "1": np.ones_like(scaled),
            "v": own.v / self.speed,
            "sgn v": own.sign_v,
            "its sign": np.tanh(signal / max(unsure, 1e-9)),
        }[self.times]
        first = 0 if self.times == "its sign" else 1
        if own is other and (self.of, self.times) == ("v", "1"):
            first = 2
        return [*(factor * legvander(scaled, first + _DEGREES - 1).T[first:])]

    def words(self, other: str = "") -> str:
        """Return its signal in words, given the name of a joint other than its own."""
        signal = "position" if self.of[0] == "q" else "velocity"
        phrase = f"the {signal} of {other}" if other else f"its {signal}"
        if self.of[1:]:
            kind = "sum of" if self.of[1] == "+" else "difference between"
            phrase = f"the {kind} its {signal} and {phrase}"
        return _FACTORS[self.times].format(phrase)


class _Unknown(Effect):
    """Curve of one signal, which is less complex than a function of all the motion."""

    parameters: ClassVar[tuple[Parameter, ...]] = tuple(
        Parameter(f"coefficient_{k}", "N·m") for k in range(_DEGREES)
    )
    depends_on: ClassVar[frozenset[str]] = frozenset({"q", "v"})
    complexity: ClassVar[int] = 3
    free_shapes: ClassVar[int] = 1  # the kind of curve; its scales are those of the motion


@dataclass(frozen=True)
class UnknownCurve(_Unknown, JointEffect):
    """Unknown curve of a joint's own position or velocity."""

    curve: Curve

    name: ClassVar[str] = "unknown_curve"

    def columns(self, joint: JointMotion) -> Sequence[Array]:
        """Return the columns of the curve."""
        return self.curve.columns(joint, joint)


@dataclass(frozen=True)
class UnknownCoupling(_Unknown, JointPairEffect):
    """Unknown curve at the first joint, of the position or velocity of the second."""

    curve: Curve

    name: ClassVar[str] = "unknown_coupling"

    def rows(self, motion: RobotMotion) -> Rows:
        """Return the columns at the first joint; see `Effect.rows`."""
        own, other = (motion.joint(name) for name in self.joints)
        unsure = float(sum(motion.sign_width[motion.index(name)] for name in self.joints))
        columns = self.curve.columns(own, other, unsure)
        return motion.efforts_at(self.joints[0], np.stack(columns, -1))


CURVES = UnknownCurve, UnknownCoupling
UNKNOWN = UnknownFunction, *CURVES
"""Types of unknown functions of the motion."""


def reversals(
    model: RobotModel, trajectories: Sequence[Trajectory]
) -> tuple[UnresolvedReversal, ...]:
    """Return an unresolved reversal for every moving joint with a measured motor effort."""
    peaks, steps = peak_speeds(trajectories), np.zeros(len(model.joints))
    excluded = {joint for trajectory in trajectories for joint in trajectory.unmeasured}
    excluded.update(model.base_joints)
    for trajectory in trajectories:
        for segment in trajectory.segments:
            samples = segment[:_SAMPLES]
            step = np.sqrt(np.mean(np.square(samples.acceleration), axis=0)) * samples.period
            steps = np.maximum(steps, 0.5 * step)
    # Where friction fades, the log shows directions at lower speeds.
    unsure = np.maximum(sign_widths(replace(model, fading_speed=None), trajectories), steps)
    speeds = model.sign_widths(unsure)
    slips = np.maximum(speeds, np.maximum(_WIDER * unsure, _SLIP * peaks))
    return tuple(
        UnresolvedReversal(joint, float(speeds[j]), float(slips[j]))
        for j, joint in enumerate(model.joints)
        if peaks[j] > 0.0 and joint in model.single_joints and joint not in excluded
    )


def is_resolved(effect: Effect, unsure: Sequence[UnresolvedReversal]) -> bool:
    """Return whether all speeds among an effect's shapes are high enough to show directions."""
    least = {each.joint: _RESOLVED * each.speed for each in unsure}
    names = [shape.name for shape in effect.shapes if shape.scale == "speed"]
    values = [getattr(effect, name) for name in names]
    return all(value >= least.get(joint, 0.0) for value in values for joint in effect.where)


def unknown_functions(case: Case, hypothesis: Hypothesis, joints: Collection[str]) -> list[Effect]:
    """Return functions of the motion for some joints: of their own, and of others' motions.

    Functions of other joints' motions are those that remove most of the residual, beside functions
    of the joint's own motion.
    """
    model, peaks = case.model, peak_speeds(case.trajectories)
    lowest, highest = range_of_motion(case.trajectories)
    center, reach = 0.5 * (lowest + highest), np.maximum(0.5 * (highest - lowest), 1e-9)
    moving = [j for j, name in enumerate(model.joints) if peaks[j] and name in model.single_joints]
    scales = {"q": (center, reach), "v": (np.zeros_like(peaks), peaks)}

    slides = [name in model.sliding_joints for name in model.joints]

    def curves(own: int, other: int) -> list[Curve]:
        found = list[Curve]()
        # A position in rad and one in m have no sum.
        for of, times in _OWN if other == own or slides[other] != slides[own] else _OTHERS:
            middle, half = (each[[other, own]] for each in scales[of[0]])
            if of[1:]:
                middle, half = middle @ [1.0, 1.0 if of[1] == "+" else -1.0], half.sum()
            else:
                middle, half = middle[0], half[0]
            found.append(Curve(of, times, float(middle), float(half), float(peaks[own])))
        return found

    motion, found = full_motion(case), list[Effect]()
    raw = [np.hstack([s.position[:, moving], s.velocity[:, moving]]) for _, s in motion]
    for residual in joint_residuals(case, hypothesis):
        own = model.joints.index(residual.joint)
        if residual.joint not in joints or own not in moving:
            continue
        function = UnknownFunction(
            residual.joint, float(center[own]), float(reach[own]), float(peaks[own])
        )
        found.append(function)
        found += [UnknownCurve(residual.joint, curve) for curve in curves(own, own)]
        signals = filtered_columns(case, motion, residual, raw)
        valid = np.flatnonzero(np.isfinite(signals).all(axis=1))
        valid = valid[:: 1 + len(valid) // _CHOSEN_BY]
        motions = {
            j: JointMotion(q, v, q, q, residual.direction(v))
            for j, q, v in zip(moving, *np.split(signals[valid].T, 2), strict=True)
        }
        pairs = [(o, curve) for o in moving if o != own for curve in curves(own, o)]
        own_columns = function.columns(motions[own])  # what the joint's own motion may do
        b = residual.residual[valid]
        sse = [
            _sse([*own_columns, *curve.columns(motions[own], motions[o], SLOW * curve.reach)], b)
            for o, curve in pairs
        ]
        for k in np.argsort(sse)[:_MOST_COUPLED].tolist():
            other, curve = pairs[k]
            found.append(UnknownCoupling((residual.joint, model.joints[other]), curve))
    return found


def _sse(columns: list[Array], b: Array) -> float:
    """Return the squared residual of the least-squares fit of b (K,) by columns."""
    A = np.stack(columns, -1)
    return float(np.square(b - A @ np.linalg.lstsq(A, b, rcond=None)[0]).sum())


def range_of_motion(trajectories: Sequence[Trajectory]) -> tuple[Array, Array]:
    """Return the lowest and highest positions (nv,) of every joint, rad or m."""
    ends = [
        (q.min(axis=0), q.max(axis=0))
        for trajectory in trajectories
        for s in trajectory.segments
        for first in range(0, len(s), _SAMPLES)
        for q in [s[first : first + _SAMPLES].position]
    ]
    lowest, highest = zip(*ends, strict=True)
    return np.min(lowest, axis=0), np.max(highest, axis=0)
