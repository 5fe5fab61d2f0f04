"""Numbers that several parts of an identification and a diagnosis share.

What is believed of a robot before its logs are seen, and so decides between explanations, is in
`geodrake.diagnosis.beliefs`. What one search alone asks for, such as a window of a contact or a
formula, stands there; and so do numbers that say how finely something is computed.
"""

from __future__ import annotations

# What counts as found.

ALARM = 0.01
"""Largest probability of a false alarm, over all that was tried."""

TIE = 0.05
"""Two fits are no tie if the better one is better with probability 1 − tie."""

PENALTY = 6.0
"""A parameter must bring this gain, twice a log-likelihood, for a fit with it to be better.

χ² of one degree of freedom exceeds it once in seventy times.
"""

# What is noise.

LEAST_NOISE = 1e-4
"""No sensor of efforts has less noise than this share of their deviation."""

NOISE_MARGIN = 1.25
"""Ratio to the noise floor up to which the error of all joints is noise.

A formula is searched at every joint that errs by more, as that may be all that is above the noise.
"""

JOINT_NOISE_MARGIN = 1.6
"""Ratio to its floor up to which the error of one joint is noise.

It counts beside `NOISE_MARGIN`: the others' noise must not cover up one joint at which most of the
squared error is something else.
"""

# What is known before, and how well.

SPREAD = 0.3
"""A model file knows its inertias to about 30 %, as a geometric distance."""

LARGEST = 10.0
"""An effect is thought to need at most so many times the deviation of its joint's effort."""

WORTH = 4.0
"""Effective number of samples of unexplained errors that vary with the motion, in any log.

It is the same whenever the motion repeats: part of it, half of its size in the mean, varies with
any one column of a fit.
"""
