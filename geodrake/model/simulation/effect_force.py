"""Effects in a Drake simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import (
    BasicVector,
    Context,
    ContinuousState,
    DiagramBuilder,
    LeafSystem,
    OutputPort,
    ValueProducer,
)

from geodrake.boundary.arguments import instance, real_array
from geodrake.effects import Effect
from geodrake.effects.deflection import SPRING_DAMPING
from geodrake.effects.robot_motion import log_number
from geodrake.errors import ArgumentError
from geodrake.inertia import PARAMETERS_PER_BODY, Array
from geodrake.inertia.bodies import check_context
from geodrake.logs.temperatures import Temperatures
from geodrake.model.simulation.force_law import (
    Coupling,
    EffectWithValues,
    ForceLaw,
    Response,
    admissible,
)
from geodrake.model.simulation.scalar_system import differenced
from geodrake.model.simulation.terms import PlantMotion, PlantState
from geodrake.robot.robot_instance import RobotInstance, add_generalized_force, selected

_PARAMETERS, _PHI = 0, 1


@differenced
class EffectForce(LeafSystem):
    """The force law of effects, for a MultibodyPlant to be simulated with them.

    .. pydrake_system::

        name: EffectForce
        input_ports:
        - state
        - applied_effort
        output_ports:
        - generalized_force
        - motor_state

    An effect adds to the effort that a motion needs, so it takes its effort away from the plant:

        generalized_force = −Σ_e Y_e(q, v, v̇, τ_model) μ_e

    which belongs at `plant.get_applied_generalized_force_input_port()`; see `AddToBuilder`. A wrong
    gain (`EffortScale`) turns the effort u that is commanded, or measured, into u / (1 + ε).

    Effects of v̇ (rotor inertia, payload) are f(q, v) + M_e(q, v) v̇ with the v̇ that the plant has
    with them, (M + M_e) v̇ = u − C v + τ_g + … − f: the plant moves exactly as if its mass matrix
    were M + M_e. Friction that depends on the load τ_model, the effort that the rigid bodies need,
    is found by fixed-point iteration. Both need u, the `applied_effort` (nv) of controllers at the
    joints, zero if the port is not connected; forces that reach the plant otherwise, as by contact,
    are not known here. Where no effect depends on v̇ or load, the port is not read.

    Hidden states (`Hysteresis`) are continuous states, zero at first (`set_hidden_states`). Joints
    that are elastic or have play (`DeflectionEffect`) are two bodies: the plant's joint is the
    link; the motor's position, less that of the link, and its velocity are continuous states, zero
    at first (`set_motors`), with the spring of the effect between them, or its dead band (see
    `geodrake.model.simulation.force_law`). Efforts, friction and rotor inertia act at the motor;
    gravity, payloads and contacts at the link. `motor_state` (nq + nv), which encoders measure, is
    the plant's state with the motors in the place of the links; it is there with soft joints alone.
    A motor has at least 1 % of its link's inertia; `notes` says where that is more than the
    model's. Explicit integrators need steps below some 1.7 / ω, with ω = √(k (1/B + 1/M)) the
    frequency at which motor and link swing against each other; stiff ones are for "radau3" or
    "implicit_euler" (`ResetIntegratorFromFlags`). Plants with time steps take the torque of the
    spring as it was when the step began, and need steps far below 1 / ω.

    Effects of the time since a log began (`FrictionDrift`, `Contact`) take the Context's, and
    contacts that were found in a log act only where that log is simulated. Friction that varies
    with the temperature takes that of `temperatures`.

    Numeric parameters of the Context are all μ (`set_effect_parameters`), and the inertial
    parameters that the plant is taken to have (`set_inertial_parameters`), which matter to effects
    of v̇, load and bodies. No system sees another one's Context: who changes the plant's inertias
    there must change them here, too, as `RobotInDiagram.set_parameters` does. All else of the plant
    is as by default. In a plant that holds more than the robot (`RobotInstance`), state, efforts
    and forces are those of the whole plant, with zeros where the robot has no part in them.

    The system can be cloned, and converted to AutoDiffXd: derivatives with state, efforts, time and
    parameters are central differences, exact to some 1e-9, and a diagram may be linearized.

    Dry friction makes a simulation stiff. Its sgn v is tanh(v / sign_width), so F acts near rest
    like a damper F / sign_width, and a joint that it holds creeps at less than sign_width. Explicit
    integrators, and plants with time steps, need steps below 2 · sign_width · inertia / F, rotor
    inertia included: 1 ms for 0.1 kg·m² and 2 N·m, but tens of µs for a wrist of bare links without
    rotors. There, use "implicit_euler", or widen sign_width.

    Args:
        plant: A finalized plant, with the joints and bodies that the effects name; or one robot in
            it: then nothing else feels them; or one that moves with a model of other coordinates
            (`RobotModel.driving`): efforts and `motor_state` are the model's then.
        effects: Effects with their linear parameters μ, SI, such as those of a model; or pairs.
        sign_width: Speed below which dry friction fades, rad/s or m/s (`RobotModel.sign_widths`
            has those of a fitted model); one, or (nv,), of a robot in a plant (n,).
        phi: (nb, 10) inertial parameters of the simulated plant, where its Context has others
            than the default ones; such as `model.total_phi`, whose payloads then are no effects.
        log: Name of the log that is simulated; None for none.
        temperatures: Those of the joints, in the time of the Context; without, each joint has that
            to which its friction belongs.
        spring_damping: Damping of elastic joints that have none of their own, as a share of the
            critical one.

    Raises:
        ArgumentError: An effect does not fit the plant, parameters are not on the manifold
            of their effect, as negative friction is not, or a payload is among the effects
            although `phi` is given.
    """

    def __init__(
        self,
        plant: MultibodyPlant | RobotInstance | PlantMotion,
        effects: Iterable[EffectWithValues],
        *,
        sign_width: ArrayLike = 1e-2,
        phi: ArrayLike | None = None,
        log: str | None = None,
        temperatures: Temperatures | None = None,
        spring_damping: float = SPRING_DAMPING,
    ) -> None:
        """Construct the system."""
        LeafSystem.__init__(self, converter=self._converter)
        number = 0 if log is None else log_number(instance(log, "log", str))
        motion = plant
        if not isinstance(motion, PlantMotion):
            motion = PlantMotion(motion, sign_width, number, temperatures)
        self.law = law = ForceLaw(motion, effects, phi, spring_damping=spring_damping)
        (self._nq, nv), plant = motion.sizes, motion.plant
        in_plant = plant.num_multibody_states(), plant.num_velocities()
        self._state_port = self.DeclareVectorInputPort("state", BasicVector(in_plant[0]))
        self._effort_port = self.DeclareVectorInputPort("applied_effort", BasicVector(nv))
        self.DeclareNumericParameter(BasicVector(law.mu))
        self.DeclareNumericParameter(BasicVector(law.phi.ravel()))
        states = law.state_count + 2 * len(law.soft)
        known = {self._state_port.ticket(), self.all_parameters_ticket()}
        if law.timed:
            known.add(self.time_ticket())
        if states:
            self.DeclareContinuousState(states)
            known.add(self.xc_ticket())
        moved = {*known, self._effort_port.ticket()} if law.coupled else known
        producer = ValueProducer(
            allocate=lambda: AbstractValue.Make(object()), calc=self._calc_response
        )
        # Both force and rates of the motors need it.
        self._response = self.DeclareCacheEntry("response", producer, moved)
        self.DeclareVectorOutputPort(
            "generalized_force",
            BasicVector(in_plant[1]),
            self._calc_force,
            {self._response.ticket()},
        )
        if law.soft or motion.driven:
            self.DeclareVectorOutputPort(
                "motor_state", BasicVector(self._nq + nv), self._calc_motor_state, known
            )

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Return the effects, in the order of their parameters."""
        return self.law.effects

    @property
    def soft_joints(self) -> tuple[str, ...]:
        """Return the joints whose motors have their own state."""
        return self.law.soft.names

    @property
    def notes(self) -> tuple[str, ...]:
        """Return the assumptions."""
        return self.law.notes

    def effect_parameters(self, context: Context, effect: Effect) -> Array:
        """Return linear parameters (k,) of an effect in a Context of the system."""
        return self._parameters(context)[self._part(effect)]

    def set_effect_parameters(self, context: Context, values: Mapping[Effect, ArrayLike]) -> None:
        """Changes linear parameters μ (k,), SI, of effects in a Context; others keep theirs."""
        check_context(self, context)
        mu = self._parameters(context)
        for effect, given in values.items():
            mu[self._part(effect)] = admissible(effect, given)
        self.law.soft.couplings(mu)  # do all of them still give way?
        context.get_mutable_numeric_parameter(_PARAMETERS).SetFromVector(mu)

    def set_inertial_parameters(self, context: Context, phi: ArrayLike) -> None:
        """Set the plant's inertial parameters (nb, 10) in a Context.

        They are those that `set_inertial_parameters` writes into the plant's.
        """
        check_context(self, context)
        phi = real_array(phi, "phi", self.law.phi.shape)
        context.get_mutable_numeric_parameter(_PHI).SetFromVector(phi.ravel())

    def set_hidden_states(self, context: Context, states: Mapping[Effect, ArrayLike]) -> None:
        """Set hidden states (s,), such as `Effect.states_along` leaves; others keep theirs."""
        check_context(self, context)
        whole = np.array(context.get_continuous_state_vector().CopyToVector())
        for effect, values in states.items():
            count = effect.state_count if effect in self.law.states else 0
            name = f"the state of {effect.name} of {effect.place}"
            state = real_array(values, name, (count,))
            if not count:
                raise ArgumentError(f"{effect.name} of {effect.place} has no hidden state here.")
            whole[self.law.states[effect]] = state
        context.SetContinuousState(whole)

    def set_motors(self, context: Context, lag: ArrayLike, speed: ArrayLike) -> None:
        """Set where the motors of `soft_joints` are, by lags and speeds (m,).

        A lag is the position of a motor less that of its link, rad or m.
        """
        check_context(self, context)
        size = (len(self.law.soft),)
        both = [real_array(lag, "lag", size), real_array(speed, "speed", size)]
        whole = np.array(context.get_continuous_state_vector().CopyToVector())
        whole[self.law.state_count :] = np.concatenate(both)
        context.SetContinuousState(whole)

    def couplings(self, context: Context) -> list[Coupling]:
        """Return spring and damper of each soft joint, by the parameters of a Context."""
        return self.law.soft.couplings(self._parameters(context))

    def lags(
        self, context: Context, q: ArrayLike, v: ArrayLike, vd: ArrayLike | None = None
    ) -> Array:
        """Return positions (m,) of the motors of soft joints less those of links that follow them.

        Positions (nq,), velocities (nv,) and accelerations are those of the motors; parameters
        those of the Context.
        """
        check_context(self, context)
        size = (self.law.plant.sizes[1],)
        q, v = real_array(q, "q", (self._nq,)), real_array(v, "v", size)
        vd = np.zeros(size) if vd is None else real_array(vd, "vd", size)
        return self.law.lags(q, v, vd, self._values(context))

    def deflect(self, root: Context) -> None:
        """Take the plant's state for that of the motors, and put links where a load has them.

        That is the load of a steady motion; their velocities are those of the motors. Without soft
        joints nothing changes.
        """
        soft, plant = self.law.soft, self.law.plant.plant
        if not soft:
            return
        own, context = (s.GetMyMutableContextFromRoot(root) for s in (self, plant))
        q, v = plant.GetPositions(context), plant.GetVelocities(context)
        lag = self.lags(own, q, v)
        self.set_motors(own, lag, v[soft.velocities])
        q[soft.positions] -= lag
        plant.SetPositions(context, q)

    def state_port(self, builder: DiagramBuilder, joints: Sequence[str]) -> OutputPort:
        """Return an output (2 n) of measured positions and then velocities of all joints in order.

        Each has one degree of freedom.
        """
        robot = self.law.plant.robot
        if not self.law.soft:
            return robot.state_port(builder, joints)
        at_v = self._nq + robot.velocities[robot.order(joints)]
        places = np.concatenate([robot.positions(joints), at_v])
        return selected(builder, self.GetOutputPort("motor_state"), places)

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Rates of hidden states, and of the motors of soft joints, per second."""
        if not derivatives.size():
            return
        state, law = self._plant_state(context), self.law
        rates = [np.zeros(0)]
        if law.state_count:
            rates.append(law.state_rates(state, self._values(context)))
        if law.soft:
            response: Response = self._response.Eval(context)
            rates += [state.speed - state.v[law.soft.velocities], response.motor_acceleration]
        derivatives.get_mutable_vector().SetFromVector(np.concatenate(rates))

    def _part(self, effect: Effect) -> slice:
        if effect not in self.law.effects:
            raise ArgumentError(
                f"{effect.name} of {effect.place} is not in this system, or has another shape.",
                advice=f"Effects are {', '.join(f'{e.name} of {e.place}' for e in self.effects)}.",
            )
        return self.law.parts[self.law.effects.index(effect)]

    def _parameters(self, context: Context) -> Array:
        return np.array(context.get_numeric_parameter(_PARAMETERS).value())

    def _values(self, context: Context) -> tuple[Array, Array]:
        """Return parameters (k,) of all effects, and (nb, 10) of the bodies."""
        phi = np.array(context.get_numeric_parameter(_PHI).value())
        return self._parameters(context), phi.reshape(-1, PARAMETERS_PER_BODY)

    def _plant_state(self, context: Context) -> PlantState:
        both = self._state_port.Eval(context)
        own = np.asarray(context.get_continuous_state_vector().CopyToVector())
        hidden, m = self.law.state_count, len(self.law.soft)
        lag, speed = own[hidden : hidden + m], own[hidden + m :]
        return PlantState(*self.law.plant.split(both), context.get_time(), own[:hidden], lag, speed)

    def _calc_response(self, context: Context, value: AbstractValue) -> None:
        state, parameters = self._plant_state(context), self._values(context)
        u = np.zeros(len(state.v))
        if self.law.coupled and self._effort_port.HasValue(context):
            u = self._effort_port.Eval(context)
        acting = self.law.applied(u, parameters[0])
        response = self.law.response(state, acting, parameters)
        force = acting - u - response.effort
        if self.law.plant.driven:
            both = self._state_port.Eval(context)
            force = self.law.plant.moving_force(both, response.acceleration)
        value.set_value(response._replace(effort=force))

    def _calc_force(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._response.Eval(context).effort)

    def _calc_motor_state(self, context: Context, output: BasicVector) -> None:
        motor = self.law.at_motors(self._plant_state(context))
        output.SetFromVector(np.concatenate([motor.q, motor.v]))

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        plant: MultibodyPlant | RobotInstance | PlantMotion,
        effects: Iterable[EffectWithValues],
        **options: Any,
    ) -> EffectForce:
        """Add the system and connect it to a plant's state and generalized force ports.

        `RobotModel.add_to_builder` does this with a plant that has the model's inertias.

        `applied_effort` is left to be connected. Generalized forces that act on the plant already
        stay. Where joints are soft, what is measured is the port `motor_state`. The plant was added
        to the builder; options are those of the constructor.
        """
        instance(builder, "builder", DiagramBuilder)
        system = builder.AddSystem(EffectForce(plant, effects, **options))
        whole = system.law.plant.plant
        builder.Connect(whole.get_state_output_port(), system.GetInputPort("state"))
        add_generalized_force(builder, whole, system.GetOutputPort("generalized_force"))
        return system
