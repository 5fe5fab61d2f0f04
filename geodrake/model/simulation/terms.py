"""Efforts of several effects at one state, with numbers of any of Drake's scalar types."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from geodrake.effects import Effect, JointMotion, RobotMotion
from geodrake.effects.effect_columns import EffectColumns
from geodrake.inertia import Array
from geodrake.model.formulas.evaluation import evaluated
from geodrake.model.formulas.recorded_rows import recorded_rows
from geodrake.model.formulas.symbols import Formulas, Symbols
from geodrake.model.simulation.plant_motion import PlantMotion
from geodrake.model.simulation.scalars import value_of

Parameters = tuple[Any, Array]
"""(k,) linear parameters of all effects, and (nb, 10) inertial parameters of the bodies."""


@dataclass(frozen=True, eq=False)
class PlantState:
    """State of a plant and of its motors, in floats or in one of Drake's other scalar types.

    Attributes:
        q: (nq,) positions of the links.
        v: (nv,) their velocities.
        time: Time since the log began, s.
        hidden: (h,) hidden states of effects.
        lag: (m,) positions of the motors of soft joints less those of their links, rad or m.
        speed: (m,) velocities of these motors.
    """

    q: Any
    v: Any
    time: Any
    hidden: Any
    lag: Any = ()
    speed: Any = ()


@dataclass(frozen=True, eq=False)
class Terms:
    """Some effects of a plant, evaluated together; those of accelerations or loads see any given.

    Attributes:
        plant: The motion of the plant.
        places: (k,) where their parameters are among those of all effects.
        hidden: Effect -> where its hidden states are among those of all effects.
    """

    plant: PlantMotion
    effects: tuple[Effect, ...]
    places: NDArray[np.intp]
    hidden: dict[Effect, slice]
    _recorded: dict[Any, Formulas] = field(default_factory=dict)

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return bool(self.effects)

    @cached_property
    def columns(self) -> EffectColumns:
        """Return their columns."""
        return EffectColumns(self.plant.joints, self.effects, self.plant.trial)

    @cached_property
    def timed(self) -> bool:
        """Return whether the time must be known."""
        return "time" in self.columns.depends_on or self.warmed

    @cached_property
    def warmed(self) -> bool:
        """Return whether the temperatures of the joints matter, and are known."""
        return self.plant.temperatures is not None and "temperature" in self.columns.depends_on

    def direct(self, at: PlantState, parameters: Parameters) -> Any:
        """Return the effort (nv,) of effects that see neither accelerations nor loads."""
        rest = np.zeros(len(at.v))
        return self.effort(at, rest[None], rest, parameters)[0]

    def split(
        self, at: PlantState, accelerations: Array, load: Any, parameters: Parameters
    ) -> tuple[Any, Any]:
        """Return the effort (nv,) at v̇ = 0, and its change (nv, n) with n accelerations (n, nv)."""
        vd = np.vstack([np.zeros_like(accelerations[:1]), accelerations])
        efforts = self.effort(at, vd, load, parameters)
        return efforts[0], (efforts[1:] - efforts[0]).T

    def effort(self, at: PlantState, vd: Array, load: Any, parameters: Parameters) -> Any:
        """Return efforts (N, nv) at one state with N accelerations (N, nv), under a load (nv,)."""
        if not self.effects:
            return np.zeros_like(vd)
        if (scalar := _scalar(at, parameters, load)) is not float:
            formulas = self.record(len(at.hidden), parameters)
            inputs = (self._inputs(at, row, load, parameters[0]) for row in np.asarray(vd))
            rows = [evaluated(formulas, each, scalar) for each in inputs]
            return self.plant.own(np.array(rows, object))
        mu, signals = parameters[0][self.places], self.columns.depends_on
        if not signals & {"vd", "load"}:
            rest, rates = np.zeros(len(at.v)), (at.v[None], vd, np.zeros_like(vd))
            signs = self.plant.direction(at.v)
            joints = JointMotion(self.plant.of_joints(at.q), at.v, rest, rest, signs)
            columns = self.columns.at(joints, lambda _: self._seen(at, rates, parameters))
            return self.plant.own(columns @ mu)[None]
        if signals <= {"vd"}:
            still, *moved = self._of_acceleration @ mu
            return self.plant.own(still + vd @ (np.array(moved) - still))
        rates = np.tile(at.v, (len(vd), 1)), vd, np.tile(load, (len(vd), 1))
        return self.plant.own(self.columns.effort(self._seen(at, rates, parameters), mu))

    @cached_property
    def _of_acceleration(self) -> Array:
        """Return columns (nv + 1, nv, k) without acceleration, and with 1 at each velocity alone.

        They are all that there is of rotors, which a simulation asks for at every step.
        """
        nv = len(self.plant.joints)
        rest = np.zeros((nv + 1, nv))
        motion = self.plant.trial(rest, np.vstack([rest[0], np.eye(nv)]), rest)
        return np.concatenate([effect.regressor(motion) for effect in self.effects], axis=-1)

    def state_rates(self, at: PlantState, parameters: Parameters) -> Any:
        """Return rates of all hidden states, zero where the effect is not one of these."""
        zero, scalar = np.zeros((1, len(at.v))), _scalar(at, parameters)
        if scalar is float:
            motion = self._seen(at, (at.v[None], zero, zero), parameters)
            return self._rates(motion, at.hidden, np.zeros(len(at.hidden)))
        if "rates" not in self._recorded:
            motion, z = self._recorded_motion(len(at.hidden), parameters[1])
            self._recorded["rates"] = self._rates(motion, z, Symbols.of(np.zeros(len(z))))
        inputs = self._inputs(at, zero[0], zero[0], parameters[0])
        return evaluated(self._recorded["rates"], inputs, scalar)

    def _rates(self, motion: RobotMotion, hidden: Any, rates: Any) -> Any:
        """Writes the rates of hidden states (h,) at one sample into zeros (h,)."""
        for effect, place in self.hidden.items():
            rates[place] = effect.state_rates(motion, hidden[None, place])[0]
        return rates

    def record(self, states: int, parameters: Parameters) -> Formulas:
        """Return the effort (nv,) as formulas; inertial parameters are numbers in them.

        Raises:
            ModelError: An effect cannot be recorded.
        """
        mu, phi = parameters
        key = phi.tobytes()
        if key not in self._recorded:
            motion, _ = self._recorded_motion(states, phi)
            symbols = Symbols.inputs("mu", len(mu))[self.places]
            effort = Symbols.of(np.zeros(len(self.plant.joints)))
            ends = np.cumsum([0, *(len(effect.parameters) for effect in self.effects)]).tolist()
            for effect, part in zip(self.effects, pairwise(ends), strict=True):
                for joint, columns in recorded_rows(effect, motion).items():
                    place = self.plant.joints.index(joint)
                    effort[place] = effort[place] + columns @ symbols[slice(*part)]
            self._recorded[key] = effort
        return self._recorded[key]

    def _recorded_motion(self, states: int, phi: Array) -> tuple[RobotMotion, Symbols]:
        """Return one sample of symbols, and all hidden states (h,)."""
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
        self, at: PlantState, rates: tuple[Array, Array, Array], parameters: Parameters
    ) -> RobotMotion:
        """Return N samples at one position with velocities, accelerations and loads (N, nv)."""
        count = len(rates[0])
        known: dict[str, Any] = {"states": {e: at.hidden[None, s] for e, s in self.hidden.items()}}
        if self.timed:
            known["time"] = np.full(count, at.time)
        if self.warmed:
            known["temperature"] = np.repeat(self._temperature(at), count, axis=0)
        return self.plant.seen(np.tile(at.q, (count, 1)), rates, parameters[1], **known)

    def _temperature(self, at: PlantState) -> Array:
        """Return (1, nv) temperatures at an instant, °C; NaN where not known."""
        plant = self.plant
        if plant.temperatures is None:
            return np.full((1, len(plant.joints)), np.nan)
        return plant.temperatures.at(value_of(np.array([at.time])), plant.joints)

    def _inputs(self, at: PlantState, vd: Any, load: Any, mu: Any) -> dict[str, Any]:
        """Return what formulas are of; temperatures are slow, and have no slope with the time."""
        known = {"q": at.q, "v": at.v, "vd": vd, "load": load, "hidden": at.hidden, "mu": mu}
        if self.warmed:
            known["temperature"] = self._temperature(at)[0]
        return {**known, "time": [at.time]}


def _scalar(at: PlantState, parameters: Parameters, load: Any = ()) -> type:
    """Return the scalar type of a state."""
    for values in (at.q, at.v, at.hidden, parameters[0], load):
        if np.asarray(values).dtype == object and len(values):
            return type(values[0])
    return float
