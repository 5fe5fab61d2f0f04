"""The numbers by which explanations are compared, and that several parts of a diagnosis share.

What one search alone asks for, such as a window of a contact or a formula, stands there; and so do
numbers that say how finely something is computed. `diagrams/criteria_worth.py` tells what other
values would change.
"""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.boundary.arguments import number


@dataclass(frozen=True)
class Criteria:
    """When a candidate counts as found.

    Attributes:
        alarm: Largest probability of a false alarm, over all candidates tried.
        reduction: Least share of the squared error at the joints acted upon that must go.
        agreement: Least share of the folds in which the error must fall.
        tie: Two hypotheses are no tie if the better one is better with probability 1 − tie.
    """

    alarm: float = 0.01
    reduction: float = 0.05
    agreement: float = 0.7
    tie: float = 0.05

    def __post_init__(self) -> None:
        for name in ("alarm", "reduction", "agreement", "tie"):
            number(getattr(self, name), name, lower=0.0, upper=1.0)


# How two explanations are compared.

PENALTY = 6.0
"""A parameter must bring this gain, twice a log-likelihood, for a hypothesis with it to be better.

χ² of one degree of freedom exceeds it once in seventy times.
"""

MOST = 0.5
"""Most of something, such as a squared error, joints or folds, is more than this share."""

MORE_THAN_HALF = 0.51
"""Share of the folds that must agree on what most joints of a robot have already."""

SEVERAL = 4.0
"""Several times as much: no tie, for example, where so many times the squared error is left."""

RARER = 1.0 / 3.0
"""An effect is so much rarer than one that is less complex by one."""

# What is noise.

LEAST_NOISE = 1e-4
"""No sensor of efforts has less noise than this share of their deviation."""

NOISE_MARGIN = 1.25
"""All joints together err by noise alone up to this many times their noise floor.

A formula is searched at every joint that errs by more, as that may be all that is above the noise.
"""

JOINT_NOISE_MARGIN = 1.6
"""One joint errs by noise alone up to this many times its floor, which is known less well.

It counts beside `NOISE_MARGIN`: the others' noise must not cover up one joint at which most of the
squared error is something else.
"""

SEARCH_MARGIN = 1.5
"""Pairs and fading friction are tried at joints that err by more than this times their floor."""

RESTART_MARGIN = 2.0 * SEARCH_MARGIN
"""What was found at a joint is replaced by a pair if it leaves more than this times the floor.

An error so large is no small effect that is missing beside the others, but a sign that the first of
them were compromises.
"""

# What is known before, and how well.

SPREAD = 0.3
"""A model file knows its inertias to about 30 %, as a geometric distance."""

TIGHTER_PRIORS = (0.1, 1.0 / 3.0, 1.0)
"""The data choose among these widths of the inertial prior, as shares of the assumed one."""

LOOSER_PRIORS = (3.0, 10.0, 30.0)
"""To see if inertias are wrong, their prior is made so many times wider."""

FIXED = 1e-3
"""Inertias stay as they are if their prior is narrowed to this share of the assumed width."""

IMPROBABLE = 0.05
"""Bodies are not where they may well be if chance takes them so far in less than this share."""

LARGEST = 10.0
"""An effect is thought to need at most so many times the deviation of its joint's effort."""

USUAL_GAIN = 2.0
"""A gain is usual that is off by so many of its standard deviations, `effort_uncertainty`."""

WORTH = 4.0
"""What goes with the motion and stays unexplained is worth so many samples, however long logs are.

It is the same whenever the motion repeats: part of it, half of its size in the mean, goes with any
one column of a fit.
"""

# What a residual must show for a search to try what it suggests.

DOMINANT = 0.3
"""A suggestion comes first if it explains at least this share of a joint's squared error.

Noise never has so large a share: it need not be as improbable then as `SUGGESTED` asks.
"""

SUGGESTED = 3e-5
"""Largest probability of a false alarm of one joint and kind, of which there are about 40 a log."""
