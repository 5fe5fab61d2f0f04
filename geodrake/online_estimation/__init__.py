"""Estimation while data come in: filtered regressors and projections onto what samples say.

A `FilteredRegressor` turns positions, velocities and efforts into rows Y p = effort without an
acceleration; a `SlabProjection` moves an estimate p̂ as little as it takes to agree with such rows,
in the divergence of its manifold. Both are pure: array in, array out.
"""

from geodrake.online_estimation.filtered_regressor import FilteredRegressor
from geodrake.online_estimation.mirror_map import MirrorMap
from geodrake.online_estimation.sample_update import Rows, SampleUpdate
from geodrake.online_estimation.slab_projection import SlabProjection

__all__ = ["FilteredRegressor", "MirrorMap", "Rows", "SampleUpdate", "SlabProjection"]
