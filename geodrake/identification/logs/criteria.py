"""Thresholds and priors that identification and diagnosis share.

Prior beliefs that decide between explanations are in `geodrake.diagnosis.beliefs`. Constants of a
single search, and numerical tolerances, are in its module.
"""

from __future__ import annotations

# Significance.

ALARM = 0.01
"""Largest probability of a false alarm, over all candidates."""

TIE = 0.05
"""Two fits are tied unless one is better with probability 1 − TIE."""

PENALTY = 6.0
"""Twice the log-likelihood that a parameter must gain for a fit with it to be better.

χ² with one degree of freedom exceeds it with probability 1/70.
"""

# Noise.

LEAST_NOISE = 1e-4
"""Least noise of an effort sensor, relative to the standard deviation of the effort."""

NOISE_MARGIN = 1.25
"""Largest ratio of the error of all joints to the noise floor that counts as noise.

A formula is searched at every joint with a larger ratio, as that joint may be the only one.
"""

JOINT_NOISE_MARGIN = 1.6
"""Largest ratio of the error of one joint to its noise floor that counts as noise.

It applies beside `NOISE_MARGIN`, so that the noise of other joints cannot hide one bad joint.
"""

# Priors.

SPREAD = 0.3
"""Uncertainty of a model file's inertias, as a geometric distance: about 30 %."""

LARGEST = 10.0
"""Largest effort of an effect, relative to the standard deviation of its joint's effort."""

WORTH = 4.0
"""Effective number of samples of unexplained errors that vary with the motion, in any log.

Such errors repeat with the motion. On average, half of their size correlates with any one column of
a fit.
"""
