"""What the systems ask of their arguments."""

from __future__ import annotations

from numpy.typing import ArrayLike

from geodrake.boundary.arguments import instance, number, one_or_each, real_array
from geodrake.control.adaptation import UpdateLaw
from geodrake.control.online_estimation import FilteredRegressor
from geodrake.control.regressor import ControlModel
from geodrake.control.regressor.control_model import checked_control
from geodrake.errors import ArgumentError
from geodrake.inertia import Array
from geodrake.manifolds import Manifold


def checked_time_step(time_step: float) -> float:
    """A time step of zero or more, s.

    Raises:
        ArgumentError: It is not.
    """
    return number(time_step, "time_step", lower=0.0)


def checked_gains(values: ArrayLike, nv: int, name: str) -> Array:
    """Gains (nv,) from one for all joints, or one for each.

    Raises:
        ArgumentError: They are not positive and finite, or neither one nor nv.
    """
    return one_or_each(values, name, nv, strict=True)


def require_single_joints(control: ControlModel) -> None:
    """Checks that positions are as many as velocities, joint by joint.

    Raises:
        ArgumentError: They are not.
    """
    if not checked_control(control).single_joints:
        raise ArgumentError(
            "Controllers and estimators need joints of one degree of freedom each; this robot has "
            "others.",
            advice="Weld the base, or use geodrake.control.regressor from Python.",
        )


def require_same_robot(control: ControlModel, filtered: FilteredRegressor) -> None:
    """Checks that a filter is one for the robot.

    Raises:
        ArgumentError: It was made with another `ControlModel`.
    """
    if instance(filtered, "filtered", FilteredRegressor).control is not control:
        raise ArgumentError(
            "The filter was made with another ControlModel.",
            advice="Make FilteredRegressor and system with the same one.",
        )


def checked_estimate(
    control: ControlModel, domain: Manifold | UpdateLaw | None, parameters: ArrayLike | None
) -> Array:
    """A copy of parameters (p,) that an estimate can start from; those of the model if None.

    Args:
        domain: The manifold where the estimate lives, or the law that moves it; None for neither.
        parameters: (p,) the parameters.

    Raises:
        ArgumentError: They are not as many as the robot's, not finite or not in the domain.
    """
    given = control.prior if parameters is None else parameters
    p = real_array(given, "parameters", control.prior.shape).copy()
    if domain is None:
        return p
    if domain.dimension not in (None, len(p)):
        raise ArgumentError(
            f"The law moves {domain.dimension} parameters; the robot has {len(p)}.",
            advice="Make manifold and ControlModel from the same RobotModel.",
        )
    if not domain.contains(p):
        raise ArgumentError(
            f"These parameters are not inside of the law's manifold: {p.tolist()}.",
            advice="Start from a physical estimate, friction and the like above zero.",
        )
    return p
