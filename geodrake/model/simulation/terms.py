"""Efforts of several effects at one state, with numbers of any of Drake's scalar types."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Effect, JointMotion, RobotMotion
from geodrake.effects.base import BEYOND_MOTION
from geodrake.effects.column_checks import line_of
from geodrake.effects.effect_columns import EffectColumns
from geodrake.errors import ArgumentError, ModelError
from geodrake.inertia import Array
from geodrake.model.formulas.evaluation import Scalars, evaluated
from geodrake.model.formulas.symbols import Formulas, Symbols
from geodrake.model.simulation.plant_motion import PlantMotion
from geodrake.model.simulation.scalars import value_of

Parameters = tuple[Any, Array]
"""(k,) linear parameters of all effects, and (nb, 10) inertial parameters of the bodies."""


@dataclass(frozen=True, eq=False)
class Sample:
    """What effects see at an instant, in floats or in one of Drake's other scalar types.

    Attributes:
        q: (nq,) positions.
        v: (nv,) velocities.
        time: Since the log began, s.
        hidden: (h,) hidden states of all effects.
    """

    q: Any
    v: Any
    time: Any
    hidden: Any


@dataclass(frozen=True, eq=False)
class Terms:
    """Some effects of a plant, evaluated together.

    Attributes:
        plant: The motion of the plant.
        effects: The effects.
        places: (k,) where their parameters are among those of all effects.
        hidden: Effect -> where its hidden states are among those of all effects.
    """

    plant: PlantMotion
    effects: tuple[Effect, ...]
    places: NDArray[np.intp]
    hidden: dict[Effect, slice]
    _recorded: dict[Any, Formulas] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self.effects)

    @cached_property
    def columns(self) -> EffectColumns:
        """Their columns."""
        return EffectColumns(self.plant.joints, self.effects, self.plant.trial)

    @cached_property
    def timed(self) -> bool:
        """Whether the time must be known."""
        return "time" in self.columns.depends_on or self.warmed

    @cached_property
    def warmed(self) -> bool:
        """Whether the temperatures of the joints matter, and are known."""
        return self.plant.temperatures is not None and "temperature" in self.columns.depends_on

    def direct(self, at: Sample, parameters: Parameters) -> Any:
        """Effort (nv,) of effects that see neither accelerations nor loads.

        Args:
            at: The sample.
            parameters: Of the effects and of the bodies.
        """
        rest = np.zeros(len(at.v))
        if not self.effects:
            return rest
        if _scalar(at, parameters) is not float:
            return self._by_formulas(at, rest[None], rest, parameters)[0]

        def seen(joints: JointMotion) -> RobotMotion:
            rates = joints.v[None], joints.vd[None], joints.load[None]
            return self._seen(at, at.q[None], rates, parameters)

        joints = JointMotion(
            self.plant.of_joints(at.q), at.v, rest, rest, self.plant.direction(at.v)
        )
        return self.plant.own(self.columns.at(joints, seen) @ parameters[0][self.places])

    def effort(self, at: Sample, vd: Array, load: Any, parameters: Parameters) -> Any:
        """Efforts (N, nv) at one state with N accelerations.

        Args:
            at: The state.
            vd: (N, nv) accelerations.
            load: (nv,) load of the joints.
            parameters: Of the effects and of the bodies.
        """
        if not self.effects:
            return np.zeros_like(vd)
        if _scalar(at, parameters, load) is not float:
            return self._by_formulas(at, vd, load, parameters)
        if self.columns.depends_on <= {"vd"}:
            rest, *moved = self._of_acceleration @ parameters[0][self.places]
            return self.plant.own(rest + vd @ (np.array(moved) - rest))
        many = (len(vd), 1)
        rates = np.tile(at.v, many), vd, np.tile(load, many)
        motion = self._seen(at, np.tile(at.q, many), rates, parameters)
        return self.plant.own(self.columns.effort(motion, parameters[0][self.places]))

    @cached_property
    def _of_acceleration(self) -> Array:
        """Columns (nv + 1, nv, k) without acceleration, and with one of 1 at each velocity alone.

        They are all that there is of rotors, which a simulation asks for at every step.
        """
        nv = len(self.plant.joints)
        rest = np.zeros((nv + 1, nv))
        motion = self.plant.trial(rest, np.vstack([rest[0], np.eye(nv)]), rest)
        return np.concatenate([effect.regressor(motion) for effect in self.effects], axis=-1)

    def state_rates(self, at: Sample, parameters: Parameters) -> Any:
        """Rates of all hidden states, zero where the effect is not one of these.

        Args:
            at: The state.
            parameters: Of the effects and of the bodies.
        """
        own = [effect for effect in self.effects if effect.state_count]
        zero = np.zeros((1, len(at.v)))
        scalar = _scalar(at, parameters)
        if scalar is float:
            motion = self._seen(at, at.q[None], (at.v[None], zero, zero), parameters)
            rates = np.zeros(len(at.hidden))
            for effect in own:
                place = self.hidden[effect]
                rates[place] = effect.state_rates(motion, at.hidden[None, place])[0]
            return rates
        if "rates" not in self._recorded:
            motion, z = self._recorded_motion(len(at.hidden), parameters[1])
            formulas = Symbols.of(np.zeros(len(at.hidden)))
            for effect in own:
                place = self.hidden[effect]
                formulas[place] = effect.state_rates(motion, z[None, place])[0]
            self._recorded["rates"] = formulas
        inputs = self._inputs(at, zero[0], zero[0], parameters[0])
        return evaluated(self._recorded["rates"], inputs, scalar)

    def record(self, at: Sample, parameters: Parameters) -> Formulas:
        """The effort (nv,) as formulas.

        Args:
            at: A state, for its sizes.
            parameters: Of the effects and of the bodies; the latter go into the formulas.

        Raises:
            ModelError: An effect cannot be recorded.
        """
        mu, phi = parameters
        key = phi.tobytes()
        if key not in self._recorded:
            motion, _ = self._recorded_motion(len(at.hidden), phi)
            symbols = Symbols.inputs("mu", len(mu))
            effort = Symbols.of(np.zeros(len(self.plant.joints)))
            ends = np.cumsum([0, *(len(effect.parameters) for effect in self.effects)]).tolist()
            for effect, part in zip(self.effects, pairwise(ends), strict=True):
                own = symbols[self.places[slice(*part)]]
                for joint, columns in recorded_rows(effect, motion).items():
                    place = self.plant.joints.index(joint)
                    effort[place] = effort[place] + np.asarray(columns, object)[0] @ own
            self._recorded[key] = effort
        return self._recorded[key]

    def _by_formulas(self, at: Sample, vd: Array, load: Any, parameters: Parameters) -> Scalars:
        formulas, scalar = self.record(at, parameters), _scalar(at, parameters, load)
        rows = [
            evaluated(formulas, self._inputs(at, row, load, parameters[0]), scalar)
            for row in np.asarray(vd)
        ]
        return self.plant.own(np.array(rows, object))

    def _recorded_motion(self, states: int, phi: Array) -> tuple[RobotMotion, Symbols]:
        """One sample of symbols, and all hidden states (h,)."""
        nv, nq = len(self.plant.joints), self.plant.plant.num_positions()
        q, v, vd, load = (
            Symbols.inputs(name, count)[None]
            for name, count in (("q", nq), ("v", nv), ("vd", nv), ("load", nv))
        )
        z = Symbols.inputs("hidden", states)
        known: dict[str, Any] = {"states": {e: z[None, s] for e, s in self.hidden.items()}}
        if self.timed:
            known["time"] = Symbols.inputs("time", 1)
        if self.warmed:
            courses = self.plant.temperatures.courses if self.plant.temperatures else {}
            is_known = [joint in courses for joint in self.plant.joints]
            warmth = np.where(is_known, Symbols.inputs("temperature", nv), np.nan)
            known["temperature"] = warmth[None]
        return self.plant.formulas(q, (v, vd, load), phi, **known), z

    def _seen(
        self, at: Sample, q: Array, rates: tuple[Array, Array, Array], parameters: Parameters
    ) -> RobotMotion:
        hidden = {e: at.hidden[None, place] for e, place in self.hidden.items()}
        time = np.full(len(q), at.time) if self.timed else None
        known: dict[str, Any] = {"time": time, "states": hidden}
        if self.warmed:
            known["temperature"] = np.repeat(self._temperature(at), len(q), axis=0)
        return self.plant.seen(q, rates, parameters[1], **known)

    def _temperature(self, at: Sample) -> Array:
        """(1, nv) temperatures at an instant, °C; NaN where not known."""
        plant = self.plant
        if plant.temperatures is None:
            return np.full((1, len(plant.joints)), np.nan)
        return plant.temperatures.at(value_of(np.array([at.time])), plant.joints)

    def _inputs(self, at: Sample, vd: Any, load: Any, mu: Any) -> dict[str, Any]:
        """Numbers for the formulas; temperatures have no slope with the time, they are slow."""
        known = {"q": at.q, "v": at.v, "vd": vd, "load": load, "hidden": at.hidden, "mu": mu}
        if self.warmed:
            known["temperature"] = self._temperature(at)[0]
        return {**known, "time": [at.time]}


def recorded_rows(effect: Effect, motion: RobotMotion) -> Any:
    """Columns of an effect in symbols, by joint.

    Args:
        effect: The effect.
        motion: One sample of symbols; with time and hidden states where it has any.

    Raises:
        ModelError: It does not compute them by NumPy's functions alone.
    """
    with_past = bool(effect.depends_on & BEYOND_MOTION)
    try:
        return (effect.rows if with_past else effect.formula_rows)(motion)
    except Exception as error:  # whatever NumPy says of symbols
        line = line_of(type(effect), "columns", "rows", "formula_rows")
        problem = error.problem if isinstance(error, ArgumentError) else str(error)
        raise ModelError(
            f"{effect.name} of {effect.place} is known for numbers only, without derivatives or "
            f"symbols{line}: {problem}",
            advice="Let it use functions of NumPy's on whole arrays, or define formula_rows.",
        ) from error


def _scalar(at: Sample, parameters: Parameters, *others: Any) -> type:
    """The scalar type of a sample."""
    for values in (at.q, at.v, at.hidden, parameters[0], *others):
        if np.asarray(values).dtype == object and len(values):
            return type(values[0])
    return float
