"""Search for formulas of the unexplained error, written as effect classes.

`draft_effects` explains the logs, then searches for sums of products of simple functions of
positions, velocities, accelerations and loads that explain the remaining error. `source_of` writes
the result as effect classes. `rest_correlates` only reports what the error varies with, which is
much faster.
"""

from geodrake.diagnosis.drafting.draft import draft_effects, rest_correlates
from geodrake.diagnosis.drafting.results import Draft
from geodrake.diagnosis.drafting.source import source_of
from geodrake.diagnosis.results import Correlate

__all__ = [
    "Correlate",
    "Draft",
    "draft_effects",
    "rest_correlates",
    "source_of",
]
