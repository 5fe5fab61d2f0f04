"""Effects in a Drake simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    DiagramBuilder,
    LeafSystem,
)

from geodrake.boundary.arguments import instance, real_array
from geodrake.effects import Effect
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.model.simulation.force_law import EffectWithValues, ForceLaw
from geodrake.robot.robot_instance import RobotInstance, add_generalized_force


class EffectForce(LeafSystem):
    """The force law of effects, for a MultibodyPlant to be simulated with them.

    .. pydrake_system::

        name: EffectForce
        input_ports:
        - state
        - applied_effort
        output_ports:
        - generalized_force

    An effect adds to the effort that a motion needs, so it takes its effort away from the plant:

        generalized_force = −Σ_e Y_e(q, v, v̇, τ_model) μ_e

    which belongs at `plant.get_applied_generalized_force_input_port()`; see `AddToBuilder`.

    A wrong gain of a joint (`EffortScale`) turns the effort u that is commanded, or measured, into
    u / (1 + ε): the difference is taken away, and all else is computed with what is left.

    Effects of v̇ (rotor inertia, payload) are taken as f(q, v) + M_e(q, v) v̇, and v̇ is the one that
    the plant has with them, (M + M_e) v̇ = u − C v + τ_g + … − f. The plant then moves exactly as if
    its mass matrix were M + M_e. Friction that depends on the load τ_model, the effort that the
    plant's rigid bodies need, is found by fixed-point iteration. Both need u, the `applied_effort`
    (nv): the effort that controllers apply at the joints, zero if the port is not connected. Forces
    that reach the plant otherwise, as by contact, are not known here. Where no effect depends on v̇
    or load, the port is not read and no dynamics are computed.

    Effects with hidden states (`Hysteresis`) have them among the continuous state, zero at first;
    `set_hidden_states` starts them otherwise.

    Effects that depend on the time since a log began (`FrictionDrift`, `Contact`) take the time of
    the Context for it. Contacts that were found in a log act only where that log is simulated.

    In a plant that holds more than the robot (`RobotInstance`), state, efforts and forces are still
    those of the whole plant, with zeros where the robot has no part in them.

    The plant's parameters are those of its default context, but for `phi`.

    Dry friction makes a simulation stiff. Its sgn v is tanh(v / sign_width), so F acts near rest
    like a damper F / sign_width, and a joint that it holds creeps at less than sign_width. Explicit
    integrators, and plants with time steps, need steps below 2 · sign_width · inertia / F, rotor
    inertia included: 1 ms for 0.1 kg·m² and 2 N·m, but tens of µs for a wrist of bare links without
    rotors. There, make the plant continuous and its integrator "implicit_euler"
    (`pydrake.systems.analysis.ResetIntegratorFromFlags`), or widen sign_width.
    """

    def __init__(
        self,
        plant: MultibodyPlant | RobotInstance,
        effects: Iterable[EffectWithValues],
        *,
        sign_width: ArrayLike = 1e-2,
        phi: ArrayLike | None = None,
        log: str | None = None,
    ) -> None:
        """Constructs the system.

        Args:
            plant: A finalized plant, with the joints and bodies that the effects name; or one robot
                in it, whose joints and bodies they name: then nothing else feels them.
            effects: Effects with their linear parameters μ, in SI units: such as those of a model,
                or pairs of an effect and μ.
            sign_width: Speed below which dry friction fades, rad/s or m/s (`RobotModel.sign_widths`
                has those of a fitted model); one for all velocities
                or (nv,), of a robot in a plant (n,).
            phi: (nb, 10) inertial parameters of the simulated plant, where its Context has others
                than the default ones; such as `model.total_phi`, which has the payloads: these are
                then no effects.
            log: Name of the log that is simulated; None for none.

        Raises:
            ArgumentError: An effect does not fit the plant, parameters are not on the manifold
                of their effect, as negative friction is not, or a payload is among the effects
                although `phi` is given.
        """
        LeafSystem.__init__(self)
        self._law = ForceLaw(
            plant, sign_width, 0 if log is None else log_number(instance(log, "log", str))
        )
        self._effects = self._law.sort(effects, phi)
        if isinstance(plant, RobotInstance):
            plant = plant.plant
        nq, nv = plant.num_positions(), plant.num_velocities()
        self._nq = nq
        self._state_port = self.DeclareVectorInputPort("state", BasicVector(nq + nv))
        self._effort_port = self.DeclareVectorInputPort("applied_effort", BasicVector(nv))
        prerequisites = {self._state_port.ticket()}
        if self._effects.coupled:
            prerequisites.add(self._effort_port.ticket())
        if self._effects.timed:
            prerequisites.add(self.time_ticket())
        if hidden := sum(effect.state_count for effect in self._effects.states):
            self.DeclareContinuousState(hidden)
            prerequisites.add(self.xc_ticket())
        self.DeclareVectorOutputPort(
            "generalized_force", BasicVector(nv), self._calc_force, prerequisites
        )

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        plant: MultibodyPlant | RobotInstance,
        effects: Iterable[EffectWithValues],
        *,
        sign_width: ArrayLike = 1e-2,
        phi: ArrayLike | None = None,
        log: str | None = None,
    ) -> EffectForce:
        """Adds the system and connects it to a plant's state and generalized force ports.

        `RobotModel.add_to_builder` does this with a plant that has the model's inertias.

        `applied_effort` is left to be connected. Generalized forces that act on the plant already
        stay.

        Args:
            builder: The diagram's builder.
            plant: A finalized plant that was added to it, or one robot in it.
            effects: Effects with their parameters, as for the constructor.
            sign_width: Speed below which dry friction fades, rad/s or m/s; one for all velocities
                or (nv,).
            phi: As for the constructor.
            log: Name of the log that is simulated; None for none.

        Returns:
            The system.
        """
        instance(builder, "builder", DiagramBuilder)
        system = builder.AddSystem(
            EffectForce(plant, effects, sign_width=sign_width, phi=phi, log=log)
        )
        whole = plant.plant if isinstance(plant, RobotInstance) else plant
        builder.Connect(whole.get_state_output_port(), system.GetInputPort("state"))
        add_generalized_force(builder, whole, system.GetOutputPort("generalized_force"))
        return system

    @property
    def implicit(self) -> bool:
        """Whether some effects depend on the plant's acceleration, or its load."""
        return self._effects.implicit

    def set_hidden_states(self, context: Context, states: Mapping[Effect, ArrayLike]) -> None:
        """Sets hidden states, such as a motion leaves them by `Effect.states_along`.

        Args:
            context: The system's own Context.
            states: Effect -> (s,) its state; effects that are left out keep theirs.

        Raises:
            ArgumentError: An effect has no hidden states here, or not as many.
        """
        hidden = _hidden(context)
        for effect, values in states.items():
            place = self._effects.states.get(effect)
            count = 0 if place is None else effect.state_count
            name = f"the state of {effect.name} of {effect.place}"
            state = real_array(values, name, (count,))
            if place is None:
                raise ArgumentError(f"{effect.name} of {effect.place} has no hidden state here.")
            hidden[place] = state
        context.SetContinuousState(hidden)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Rates of the hidden states.

        Args:
            context: Context of this system; the hidden states are its continuous state.
            derivatives: Receives their rates, per second.
        """
        if derivatives.size():
            state, hidden = self._state_port.Eval(context), _hidden(context)
            q, v, time = state[: self._nq], state[self._nq :], context.get_time()
            rates = self._law.state_rates(self._effects, q, v, hidden, time=time)
            derivatives.SetFromVector(rates)

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        state, effects = self._state_port.Eval(context), self._effects
        q, v, time = state[: self._nq], state[self._nq :], context.get_time()
        hidden = _hidden(context) if effects.states else None
        u = np.zeros(len(v))
        if effects.coupled and self._effort_port.HasValue(context):
            u = self._effort_port.Eval(context)
        applied = u / effects.gain
        effort = self._law.effort(effects, q, v, applied, time=time, states=hidden)
        output.SetFromVector(applied - u - effort)


def _hidden(context: Context) -> Array:
    """Hidden states of the effects."""
    return np.asarray(context.get_continuous_state_vector().CopyToVector())
