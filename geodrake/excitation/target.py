"""Targets of a motion: the parameters to identify, how they are measured, and the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from scipy.linalg import block_diag

from geodrake.boundary.arguments import instance, instances, one_of, real_array
from geodrake.boundary.showing import Short
from geodrake.effects import Effect, FittedEffect, RobotMotion
from geodrake.errors import ArgumentError
from geodrake.identification.logs.dataset import is_payload
from geodrake.identification.logs.unknowns import payload_reference
from geodrake.inertia import PARAMETERS_PER_BODY, Array, is_physical
from geodrake.logs.motion import Motion
from geodrake.manifolds import PhysicalInertia
from geodrake.model.robot_model import RobotModel
from geodrake.robot.base_parameters import BaseParameters, base_parameters
from geodrake.robot.regressor import (
    base_wrench_regressor,
    inverse_dynamics,
    inverse_dynamics_regressor,
)

Indices = NDArray[np.intp]

WRENCH = ("nx", "ny", "nz", "fx", "fy", "fz")
"""Names of the components of a base wrench."""

_SIGN_SHARE = 0.02  # of a joint's velocity limit, over which its friction changes sign
_EFFECT_SHARE = 0.1  # of a joint's effort, assumed for an effect of unknown size
_RANDOM_SAMPLES = 200
_NOISE = 1e-12, 1e12  # N·m or N; beyond these, squares of weighted columns overflow or underflow
_RANK_TOLERANCE, _TRIAL_TOLERANCE = 1e-9, 1e-6  # relative to the best excited direction
_WEIGHTLESS = 1e-12  # share of gravity in efforts attributed to rounding

SIZE_WORDS = "a tenth of the load, or 2 % of the effort limit if that is more"
_LEAST_SHARE = 0.02  # of the effort limit
_NOISE_SHARE = 0.01  # of the effort limit


@dataclass(frozen=True, eq=False)
class Measurement:
    """The measurements of a motion."""

    motion: Motion  # (N, ·) motion
    regressor: Array  # (N, m, p) regressor X of the measurements, not weighted by the noise
    seen: RobotMotion | None  # the motion for effects; None for base wrenches


@dataclass(frozen=True, eq=False)
class Target(Short):
    """Unknown parameters of a robot, and the measurements that should identify them.

    Attributes:
        bodies: Names of the bodies whose inertial parameters are unknown, ten each.
        effects: Effects with unknown parameters and their nominal values; payloads come first.
        noise: (m,) standard deviations of the measurements of one sample: nv efforts, N·m or N, or
            the six components of a base wrench, N·m and N.
        sign_width: (nv,) speed over which friction changes sign, rad/s or m/s.
        X_WP: Frame of the measured base wrench; None for efforts.
        trial: States that excite all identifiable parameters; random ones at all positions if
            None. Directions that they hardly excite count as unidentifiable.
    """

    model: RobotModel
    bodies: tuple[str, ...]
    effects: tuple[FittedEffect, ...]
    noise: Array
    sign_width: Array
    X_WP: RigidTransform | None = None
    trial: Motion | None = None

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the m measurements of a sample: joints, or components of a wrench."""
        return self.model.joints if self.X_WP is None else WRENCH

    @cached_property
    def payloads(self) -> tuple[FittedEffect, ...]:
        """The payloads among the effects."""
        return tuple(fitted for fitted in self.effects if is_payload(fitted.effect))

    @property
    def further(self) -> tuple[FittedEffect, ...]:
        """The effects that are not payloads."""
        return self.effects[len(self.payloads) :]

    @cached_property
    def columns(self) -> Indices:
        """Columns of the inertial regressor that belong to unknown parameters."""
        carriers = [fitted.effect.where[0] for fitted in self.payloads]
        index = np.array([self.model.bodies.index(n) for n in (*self.bodies, *carriers)], np.intp)
        return (PARAMETERS_PER_BODY * index[:, None] + np.arange(PARAMETERS_PER_BODY)).ravel()

    @cached_property
    def inertial_prior(self) -> Array:
        """(blocks, 10) nominal inertial parameters: bodies, then payloads."""
        unknown = {fitted.effect for fitted in self.payloads}
        phi = self.model.with_volume.phi.copy()
        for fitted in self.model.effects:
            if is_payload(fitted.effect) and fitted.effect not in unknown:
                phi[self.model.bodies.index(fitted.effect.where[0])] += fitted.parameters
        rows = [phi[self.model.bodies.index(name)] for name in self.bodies]
        for fitted in self.payloads:
            physical = bool(is_physical(fitted.parameters))
            rows.append(np.asarray(fitted.parameters) if physical else payload_reference(phi))
        return np.array(rows).reshape(-1, PARAMETERS_PER_BODY)

    @cached_property
    def spans(self) -> tuple[slice, ...]:
        """Range of each effect among the p unknown parameters, after the bodies."""
        counts = [len(fitted.effect.parameters) for fitted in self.effects]
        ends = PARAMETERS_PER_BODY * len(self.bodies) + np.cumsum([0, *counts])
        return tuple(slice(*pair) for pair in pairwise(ends.tolist()))

    @property
    def further_spans(self) -> list[tuple[FittedEffect, slice]]:
        """The effects that are not payloads, each with its range of parameters."""
        return [*zip(self.effects, self.spans, strict=True)][len(self.payloads) :]

    @property
    def size(self) -> int:
        """Number p of unknown parameters."""
        return len(self.columns) + sum(len(f.effect.parameters) for f in self.further)

    @cached_property
    def prior(self) -> Array:
        """(p,) nominal parameters."""
        return np.concatenate([self.inertial_prior.ravel(), *(f.parameters for f in self.further)])

    @cached_property
    def metric_root(self) -> Array:
        """(p, p) L with G₀⁻¹ = L Lᵀ, of the metric (B.1.7) on bodies and dx²/(2 x²) on effects."""
        inverse = 2.0 * PhysicalInertia().inverse_metric_times(
            self.inertial_prior[:, None], np.eye(PARAMETERS_PER_BODY)
        )
        blocks = [np.linalg.cholesky(block) for block in inverse]
        return np.asarray(block_diag(*blocks, np.sqrt(2.0) * np.diag(self.effect_sizes)))

    @cached_property
    def effect_sizes(self) -> Array:
        """(k,) size of each parameter of an effect, its nominal value if nonzero.

        A parameter of value zero is assumed to explain a tenth of the joint's effort in random
        motion.
        """
        sizes = np.abs(np.concatenate([np.zeros(0), *(f.parameters for f in self.further)]))
        if np.all(sizes > 0):
            return sizes
        motion = self.random_motion
        X = self.measure(motion).regressor[:, :, len(self.columns) :]
        effort = _EFFECT_SHARE * np.abs(self.model.motion(motion).load)
        overlap = np.square(X).sum((0, 1))
        typical = np.einsum("nik,ni->k", np.abs(X), effort) / np.where(overlap > 0, overlap, 1.0)
        return np.where(sizes > 0, sizes, np.where(typical > 0, typical, 1.0))

    @cached_property
    def base(self) -> BaseParameters:
        """The identifiable combinations of parameters, those of the robot's inertias first."""
        X = self.measure(self.random_motion).regressor / self.noise[:, None]
        tolerance = _TRIAL_TOLERANCE if self.trial is not None else _RANK_TOLERANCE
        return base_parameters(X, extra=self.size - len(self.columns), tolerance=tolerance)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Descriptions of the base parameters."""
        carriers = tuple(f"payload of {fitted.effect.where[0]}" for fitted in self.payloads)
        names = [
            f"{parameter.name} of {fitted.effect.name} of {'/'.join(fitted.effect.where)}"
            for fitted in self.further
            for parameter in fitted.effect.parameters
        ]
        return self.base.labels((*self.bodies, *carriers), extra=names)

    @cached_property
    def random_motion(self) -> Motion:
        """A random motion at all positions whose inertial efforts are as large as gravity's."""
        if self.trial is not None:
            return self.trial
        random, nv = np.random.default_rng(0), len(self.model.joints)
        count = max(_RANDOM_SAMPLES, 3 * self.size)
        q = random.uniform(*_ranges(self.model), (count, self.model.tree.num_positions))
        q = self.model.tree.inside(q)
        v, vd = random.uniform(-1.0, 1.0, (2, count, nv))
        zeros, phi = np.zeros_like(v), self.model.total_phi
        gravity = inverse_dynamics(self.model.tree, q, zeros, zeros, phi)
        inertial = inverse_dynamics(self.model.tree, q, v, vd, phi) - gravity
        ratio = np.linalg.norm(gravity) / np.linalg.norm(inertial)
        rate = np.sqrt(ratio) if ratio > _WEIGHTLESS else 1.0
        return Motion(q, rate * v, rate**2 * vd)

    def measure(self, motion: Motion) -> Measurement:
        """Return the regressor of the measurements of a motion."""
        tree, samples = self.model.tree, (motion.q, motion.v, motion.vd)
        if self.X_WP is not None:
            Y = base_wrench_regressor(tree, *samples, X_WP=self.X_WP)
            return Measurement(motion, Y[:, :, self.columns], None)
        Y = inverse_dynamics_regressor(tree, *samples)
        load = Y @ self.model.total_phi.ravel()
        seen = self.model.motion(motion, sign_width=self.sign_width, load=load)
        is_complete = np.array_equal(self.columns, np.arange(Y.shape[2]))
        parts = [Y if is_complete else Y[:, :, self.columns]]
        parts += [fitted.effect.regressor(seen) for fitted in self.further]
        return Measurement(motion, np.concatenate(parts, axis=2), seen)


def make_target(
    model: RobotModel,
    *,
    noise: ArrayLike | None = None,
    bodies: Sequence[str] | None = None,
    effects: Sequence[FittedEffect | Effect] | None = None,
    sign_width: ArrayLike | None = None,
    X_WP: RigidTransform | None = None,
) -> Target:
    """Return the parameters that a motion of a robot should identify.

    Args:
        noise: Standard deviation of the measurements, one or one per joint (N·m or N); of a base
            wrench, one for each of nx, ny, nz, fx, fy, fz. Default: that of the model's last fit,
            otherwise one.
        bodies: Names of the bodies with unknown inertial parameters; all by default. Their prior
            includes the model's payloads, unless those are among `effects`.
        effects: Effects with unknown parameters; by default those of the model except payloads.
            An `Effect` without values is assumed to have a typical size.
        sign_width: Speed over which friction changes sign; by default 2 % of each velocity limit.
        X_WP: Frame of the base wrench of a force plate or base sensor. It measures no internal
            effects.
    """
    instance(model, "model", RobotModel)
    if X_WP is not None:
        instance(X_WP, "X_WP", RigidTransform)
    bodies = model.bodies if bodies is None else instances(bodies, "bodies", str)
    if effects is None:
        effects = [f for f in model.effects if not is_payload(f.effect) and X_WP is None]
    known = tuple(
        e if isinstance(e, FittedEffect) else FittedEffect(e, np.zeros(len(e.parameters)))
        for e in instances(effects, "effects", (FittedEffect, Effect))
    )
    known = tuple(fitted for fitted in known if fitted.effect.parameters)
    ordered = tuple(sorted(known, key=lambda fitted: not is_payload(fitted.effect)))
    carriers = [fitted.effect.where[0] for fitted in known if is_payload(fitted.effect)]
    for name in (*bodies, *carriers):
        one_of(name, "body", model.bodies)
    if not bodies and not ordered:
        raise ArgumentError(
            "There is nothing to identify: no body or effect is unknown.",
            advice="Choose bodies or effects.",
        )
    if X_WP is not None and any(not is_payload(fitted.effect) for fitted in ordered):
        raise ArgumentError(
            "A base wrench does not depend on internal efforts, such as friction.",
            advice="Remove these effects, or measure efforts.",
        )
    if noise is None:
        noise = 1.0 if model.effort_noise is None or X_WP is not None else model.effort_noise
    rows = model.joints if X_WP is None else WRENCH
    limits = model.velocity_limits
    widths = np.where(np.isfinite(limits), _SIGN_SHARE * limits, _SIGN_SHARE)
    return Target(
        model,
        tuple(bodies),
        ordered,
        _checked_noise(noise, rows),
        model.sign_widths(widths if sign_width is None else sign_width),
        X_WP,
    )


def _checked_noise(noise: ArrayLike, rows: Sequence[str]) -> Array:
    """Return the standard deviations (m,)."""
    given = real_array(noise, "noise", finite=False)
    if given.shape not in ((), (1,), (len(rows),)):
        raise ArgumentError(
            f"The noise must be one number or {len(rows)}; its shape is {given.shape}."
        )
    values = np.broadcast_to(given, (len(rows),)).copy()
    least, most = _NOISE
    wrong = [n for n, x in zip(rows, values.tolist(), strict=True) if not least <= x <= most]
    if wrong:
        raise ArgumentError(
            f"The noise of {', '.join(wrong)} is not a positive number between {least:g} and "
            f"{most:g}: {values.tolist()}.",
            advice="Without noise, every motion identifies everything exactly. Use the "
            "standard deviation of the measured efforts, such as 1 % of the largest one.",
            wrong=wrong,
        )
    return values


def _ranges(model: RobotModel) -> tuple[Array, Array]:
    """Return ranges of random positions: a full turn, or the limits of sliding joints."""
    lower, upper = model.position_limits
    sliding = [k for k in model.single_places if model.joints[k] in model.sliding_joints]
    limited = np.isin(np.arange(len(lower)), sliding) & np.isfinite(lower) & np.isfinite(upper)
    return np.where(limited, lower, -np.pi), np.where(limited, upper, np.pi)


def sized_effects(target: Target) -> tuple[FittedEffect, ...]:
    """Return the effects of a target, replacing parameters of zero by typical values.

    These also depend on the effort limits, since friction exists at any load. Payloads are
    unchanged.
    """
    limits = target.model.effort_limits
    X = target.measure(target.random_motion).regressor[:, :, len(target.columns) :]
    rms = np.sqrt(np.mean(np.square(X), axis=0))  # (nv, k)
    effort = _LEAST_SHARE * np.where(np.isfinite(limits), limits, 0.0)[:, None]
    least = np.where(rms > 0, effort / np.where(rms > 0, rms, 1.0), np.inf).min(axis=0)
    sizes = np.maximum(target.effect_sizes, np.where(np.isfinite(least), least, 0.0))
    typical = np.concatenate([np.zeros(len(target.columns)), sizes])
    further = (
        FittedEffect(f.effect, np.where(f.parameters, f.parameters, typical[span]))
        for f, span in target.further_spans
    )
    return (*target.payloads, *further)


def usual_target(model: RobotModel, *, noise: ArrayLike, effects: Sequence[Effect]) -> Target:
    """Return the target of a model without its payloads, plus effects of unknown size."""
    known = [fitted for fitted in model.effects if not is_payload(fitted.effect)]
    if effects:
        known += sized_effects(make_target(model, noise=noise, effects=effects))
    return make_target(model, noise=noise, effects=known)


def usual_noise(model: RobotModel) -> tuple[Array, str]:
    """Return the default noise of motor efforts, N·m or N, and a description of its source."""
    motors = [k for k, joint in enumerate(model.joints) if joint not in model.base_joints]
    if model.effort_noise is not None:
        return model.effort_noise[motors], "the held-out residuals of the model's last fit"
    limits = model.effort_limits[motors]
    if np.isfinite(limits).all() and (limits > 0).all():
        share = f"{100 * _NOISE_SHARE:.0f} % of the effort limits"
        return _NOISE_SHARE * limits, f"{share}, as nothing else is known"
    return np.ones(len(limits)), "1 N·m or N at every joint, as nothing else is known"
