"""Formulas for the unexplained error: a sparse search, and generated effect classes.

`draft_effects` explains as `geodrake.diagnosis.explain` does, and then searches sums of products of
simple functions of positions, velocities, accelerations and loads for what takes the rest away.
`source_of` writes what it found as effect classes of the user's own. `rest_correlates` says only
what the rest varies with, in a fraction of the time.
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
