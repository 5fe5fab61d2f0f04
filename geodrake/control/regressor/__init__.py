"""Regressors for control: one sample at a time, a thousand times a second.

    M(q, p) a + C(q, q̇, p) v + g(q, p) + effects(v, a, p) = Y(q, q̇, v, a) p  [Lee2019] (5.2.10)

`ControlModel.of(model)` reads a robot model once; `ControlModel.at(q, qd, v, a)` gives a
`ControlSample` for which Y p, Yᵀ r and the mass matrix are a few array operations. Parameters are
one vector p = [φ, μ]: inertial parameters, ten a body, and then the effects' parameters.
"""

from geodrake.control.regressor.control_model import ControlModel

__all__ = [
    "ControlModel",
]
