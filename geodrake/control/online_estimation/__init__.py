"""Estimation while data come in: filtered regressors and projections onto what samples say.

A `FilteredRegressor` turns positions, velocities and efforts into rows Y p = effort without an
acceleration; a `SampleUpdate` moves an estimate p̂ into agreement with such rows, along the way
that moves it least in the divergence of its manifold. Both are pure: array in, array out.
"""

from geodrake.control.online_estimation.filtered_regressor import FilteredRegressor
from geodrake.control.online_estimation.sample_update import SampleUpdate

__all__ = ["FilteredRegressor", "SampleUpdate"]
