"""Online residual of a model."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from geodrake.boundary.arguments import instance
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.control.regressor import ControlModel
from geodrake.control.systems.safeguards import require_single_joints
from geodrake.errors import GeodrakeError
from geodrake.inertia import Array
from geodrake.model.simulation.scalar_system import differenced


@differenced
class ModelResidual(LeafSystem):
    """Compares a model with measured efforts online.

    .. pydrake_system::

        name: ModelResidual
        input_ports:
        - estimated_state
        - acceleration
        - effort
        - parameters
        output_ports:
        - residual
        - valid

    `residual` (nv), N·m or N, is measured − predicted effort. Without a filter it is a direct
    function of the inputs. With one, both sides are low-pass filtered (`FilteredRegressor`), and
    the residual is a discrete state. There is no port `acceleration` then.

    `parameters` (p) may come from an estimator; if not connected, those of the model are used.

    `valid` is one if all inputs are finite. Otherwise it is zero, and the residual is zero, or with
    a filter the last valid one.

    The system can be cloned, and converted to AutoDiffXd. As its kernels use floats, derivatives
    are central differences, accurate to about 1e-9.
    """

    def __init__(self, control: ControlModel, *, filtered: FilteredRegressor | None = None) -> None:
        """Construct the system."""
        LeafSystem.__init__(self, converter=self._converter)
        require_single_joints(control)
        if filtered is not None:
            instance(filtered, "filtered", FilteredRegressor).check_robot(control)
        self.control, self._filter = control, filtered
        self._nv = nv = len(control.joints)
        self._state_port = self.DeclareVectorInputPort("estimated_state", BasicVector(2 * nv))
        if filtered is None:
            self._acceleration_port = self.DeclareVectorInputPort("acceleration", BasicVector(nv))
        self._effort_port = self.DeclareVectorInputPort("effort", BasicVector(nv))
        self._parameters_port = self.DeclareVectorInputPort(
            "parameters", BasicVector(len(control.prior))
        )
        if filtered is None:
            tickets = {self.all_input_ports_ticket()}
            residual, valid = BasicVector(nv), BasicVector(1)
            self.DeclareVectorOutputPort("residual", residual, self._calc_residual, tickets)
            self.DeclareVectorOutputPort("valid", valid, self._calc_valid, tickets)
            return
        self._memory, self._residual, self._valid = (
            self.DeclareDiscreteState(value)
            for value in (filtered.start(), np.zeros(nv), np.zeros(1))
        )
        self.DeclarePeriodicDiscreteUpdateEvent(filtered.period, 0.0, self._update)
        self.DeclareStateOutputPort("residual", self._residual)
        self.DeclareStateOutputPort("valid", self._valid)

    def _parameters(self, context: Context) -> Array:
        if self._parameters_port.HasValue(context):
            return np.asarray(self._parameters_port.Eval(context))
        return self.control.prior

    def _error(self, context: Context) -> Array | None:
        """Return measured − predicted effort (nv,); None if it is not finite."""
        x, effort = self._state_port.Eval(context), self._effort_port.Eval(context)
        q, qd, qdd = x[: self._nv], x[self._nv :], self._acceleration_port.Eval(context)
        try:
            with np.errstate(all="ignore"):
                error = effort - self.control.at(q, qd, qd, qdd).effort(self._parameters(context))
        except GeodrakeError:  # an effect has non-finite columns
            return None
        return error if np.isfinite(error).all() else None

    def _calc_residual(self, context: Context, output: BasicVector) -> None:
        error = self._error(context)
        output.SetFromVector(np.zeros(self._nv) if error is None else error)

    def _calc_valid(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector([float(self._error(context) is not None)])

    def _update(self, context: Context, state: DiscreteValues) -> None:
        if self._filter is None:
            return
        x, effort = self._state_port.Eval(context), self._effort_port.Eval(context)
        with np.errstate(all="ignore"):
            memory = context.get_discrete_state(self._memory).value()
            memory = self._filter.advanced(memory, x[: self._nv], x[self._nv :], effort)
            Y, measured = self._filter.rows(memory)
            error = measured - Y @ self._parameters(context)
        state.set_value(self._memory, memory)
        valid = bool(memory[0]) and bool(np.isfinite(error).all())
        state.set_value(self._valid, [float(valid)])
        if valid:
            state.set_value(self._residual, error)
