"""The effort that a model needs, as formulas of q, v and v̇."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from geodrake.boundary.arguments import typed
from geodrake.effects import Effect, FittedEffect, RobotMotion, Role
from geodrake.effects.base import BEYOND_MOTION
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.model.formulas.recorded_rows import recorded_rows
from geodrake.model.formulas.rigid_bodies import BodyFormulas, inverse_dynamics_formula
from geodrake.model.formulas.symbols import Operand, Symbols
from geodrake.model.robot_model import RobotModel

_NOT_INCLUDED = {
    Role.DELAY: "logged efforts lag behind what is needed by it",
    Role.DEFLECTION: "it depends on how the motion goes on",
    Role.EPISODE: "it belongs to one log",
}


@dataclass(frozen=True, eq=False)
class EffortFormula:
    """Efforts as formulas, and what they are without.

    Attributes:
        efforts: (nv) formulas of the entries of q, v and vd, or numbers.
        included: The effects that they have, in words.
        left_out: The effects that they have not, or not as they are, with the reason.
    """

    efforts: tuple[Operand, ...]
    included: tuple[str, ...]
    left_out: tuple[str, ...]


@typed
def is_written(effect: Effect) -> bool:
    """Return whether a formula of q, v and v̇ has an effect as it is."""
    return effect.role not in _NOT_INCLUDED and not effect.depends_on & BEYOND_MOTION


def effort_formula(model: RobotModel, sign_width: ArrayLike) -> EffortFormula:
    """Return the effort that a model needs for a motion.

    Args:
        sign_width: Speed below which dry friction fades, at least; see `RobotModel.sign_widths`.

    Raises:
        ModelError: An effect cannot be written.
    """
    nv = len(model.joints)
    q = Symbols.inputs("q", model.tree.num_positions)
    v, vd = Symbols.inputs("v", nv), Symbols.inputs("vd", nv)
    load = inverse_dynamics_formula(model.tree, q, v, vd, model.total_phi)
    seen = RobotMotion(
        model.joints,
        _by_joint(model, q),
        v[None],
        vd[None],
        load[None],
        model.sign_widths(sign_width),
        _no_columns,
        BodyFormulas(model.tree, q[None], model.total_phi),
    )
    effort, scales = load.copy(), []
    included, left_out = [], []
    for fitted in model.effects:
        effect, what = fitted.effect, _words(fitted)
        if effect.role in _NOT_INCLUDED:
            left_out.append(f"{what}: {_NOT_INCLUDED[effect.role]}")
            continue
        if effect.role is Role.SCALE:
            scales.append(fitted)
        elif effect.role is not Role.BODY:
            for joint, columns in recorded_rows(effect, seen, with_past=False).items():
                at = seen.index(joint)
                effort[at] = effort[at] + columns @ fitted.parameters.astype(object)
        included.append(what)
        if not is_written(effect):
            warm = "temperature" in effect.depends_on
            left_out.append(
                f"the temperature of {what}: it is taken to be the reference"
                if warm
                else f"the history of {what}: it is as if the motion had gone on for long"
            )
    total = effort.copy()
    for fitted in scales:
        at = seen.index(fitted.effect.where[0])
        total[at] = total[at] + float(fitted.parameters[0]) * effort[at]
    return EffortFormula(tuple(total.tolist()), tuple(included), tuple(left_out))


def _words(fitted: FittedEffect) -> str:
    effect = fitted.effect
    values, _ = effect.reported(fitted.parameters, np.full(len(fitted.parameters), np.nan))
    listed = ", ".join(f"{name} {value:.6g}" for name, value in values.items())
    place = effect.place if effect.where else "the robot"
    return f"{effect.name} of {place}{f' ({listed})' if listed else ''}"


def _by_joint(model: RobotModel, q: Symbols) -> Symbols:
    """(1, nv) position belonging to each velocity, NaN for joints of several degrees."""
    found = Symbols.of(np.full((1, len(model.joints)), np.nan))
    at_velocity, at_position = model.single_places
    found[0, at_velocity] = q[at_position]
    return found


def _no_columns(body: str) -> Array:
    raise ArgumentError(
        f"The inertial columns of {body!r} are not known here.",
        advice="Use motion.body_motions, or a payload.",
    )
