"""Formulas for what stays unexplained: a sparse search, and effect classes written out.

`draft_effects` explains as `geodrake.diagnosis.explain` does, and then searches sums of products of
simple functions of positions, velocities, accelerations and loads for what takes the rest away.
`source_of` writes what it found as effect classes of the user's own. `rest_correlates` tells only
what the rest goes with, in a fraction of the time.
"""

from geodrake.drafting.draft import draft_effects, draft_rest, rest_correlates
from geodrake.drafting.formula import Factor, Formula, Term
from geodrake.drafting.results import Correlate, Draft, DraftedEffect
from geodrake.drafting.source import source_of

__all__ = [
    "Correlate",
    "Draft",
    "DraftedEffect",
    "Factor",
    "Formula",
    "Term",
    "draft_effects",
    "draft_rest",
    "rest_correlates",
    "source_of",
]
