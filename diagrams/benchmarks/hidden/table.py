"""The tables of what logs may hide: one line adds an effect to the benchmark."""

from __future__ import annotations

from diagrams.benchmarks.hidden import body_truths, truths
from diagrams.benchmarks.hidden.motions import SLOW
from diagrams.benchmarks.hidden.outside import OUTSIDE, Outside
from diagrams.benchmarks.hidden.truths import (
    BODY,
    JOINT,
    PAIR,
    ROBOT,
    Truth,
    joint_law,
    smooth_sign,
)
from geodrake.effects import catalogue

__all__ = ["KINDS", "OUTSIDE", "TRUTHS", "truth_of"]

COLOURED = "coloured"
DRY, WET = "coulomb_friction", "viscous_friction"

_ALL = (
    Truth(WET, JOINT, joint_law(lambda q, v, a, load: v, viscous=1.0)),
    Truth(DRY, JOINT, joint_law(lambda q, v, a, load: smooth_sign(v), coulomb=1.0)),
    Truth("asymmetric_friction", JOINT, truths.asymmetric),
    Truth("stribeck_friction", JOINT, truths.stribeck, (DRY, WET), alone=True),
    Truth("nonlinear_viscous_friction", JOINT, truths.nonlinear_viscous),
    Truth(
        "load_dependent_friction",
        JOINT,
        joint_law(lambda q, v, a, load: abs(load) * smooth_sign(v), load_factor=1.0),
    ),
    Truth("coupled_friction", PAIR, truths.belt),
    Truth("friction_drift", JOINT, truths.warming, (DRY, WET), alone=True),
    Truth("hysteresis", JOINT, truths.hysteresis, alone=True),
    Truth("effort_offset", JOINT, joint_law(lambda q, v, a, load: 0.0 * q + 1.0, offset=1.0)),
    Truth("effort_scale", JOINT, truths.gain, needs_known_inertia=True, alone=True),
    Truth("effort_delay", ROBOT, truths.late, unit=0.01, largest=0.03),
    Truth("joint_spring", JOINT, truths.spring),
    Truth("gravity_compensator", JOINT, truths.compensator),
    Truth("torque_ripple", JOINT, truths.cogging),
    Truth("rotor_inertia", JOINT, joint_law(lambda q, v, a, load: a, inertia=1.0)),
    Truth("coupled_rotor_inertia", PAIR, truths.coupled_rotor, ("rotor_inertia",), alone=True),
    Truth("joint_elasticity", JOINT, body_truths.soft_gear, unit=1e-4, alone=True),
    Truth(
        "backlash",
        JOINT,
        body_truths.loose_gear,
        unit=1e-3,
        largest=0.02,
        alone=True,
        reverses=True,
    ),
    Truth("payload", BODY, body_truths.payload),
    Truth("wrong_inertia", BODY, body_truths.wrong_body, unit=0.5, largest=2.0, alone=True),
    Truth("gravity_tilt", ROBOT, body_truths.tilt, unit=0.05, largest=0.2, alone=True),
    Truth("contact", BODY, body_truths.touch, alone=True),
    Truth("aerodynamic_drag", BODY, body_truths.drag, alone=True),
)

_KNOWN = {effect.name for effect in catalogue()} | {"wrong_inertia"}

TRUTHS = {truth.name: truth for truth in _ALL if truth.name in _KNOWN}
"""Effects by name; those that geodrake does not know yet are left out."""

KINDS = {
    "wrench that turns with its body": (Truth("contact", BODY, body_truths.jet), {}),
    "friction that fades to nothing": (
        Truth("friction_drift", JOINT, truths.running_in, (DRY, WET)),
        {},
    ),
    "delay in slow motion, coloured noise": (
        TRUTHS["effort_delay"],
        {"motion": SLOW, "colour": COLOURED},
    ),
    "tilt": (TRUTHS["gravity_tilt"], {}),
}
"""Kinds that other engines' logs showed to be hard, each with what of the draws is given."""


def truth_of(name: str) -> Truth | Outside:
    """What is hidden by a name of any of the tables."""
    return TRUTHS.get(name) or (KINDS[name][0] if name in KINDS else OUTSIDE[name])
