"""Prior beliefs about a robot.

A diagnosis compares explanations by their posterior probability; these are its prior odds and
widths. Those of mistakes in columns, such as usual zeros, gains and ranges of joints, are in
`columns.evidence`.
"""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.boundary.arguments import instances, number, positive
from geodrake.errors import ArgumentError


@dataclass(frozen=True)
class Beliefs:
    """Prior odds and widths of everything that may be missing in a model.

    Attributes:
        size: Prior standard deviation of the effort of an effect's parameter, relative to the
            standard deviation of its joint's measured effort.
        rarer: Odds against an effect for each unit of complexity.
        again: Odds against a delay of each further joint's efforts.
        shape: Effective number of values of a shape parameter, such as an exponent.
        order: The same for an order found in a spectrum, or an instant.
        delays: The same for delays.
        widths: Prior widths of the bodies of a model file, as geometric distances; each is tried.
        wrong: Width beyond which the model file counts as wrong.
        fitted: Odds against a change of a body or effect that was fitted before.
        free: Prior widths of a single wrong body; each is tried.
        payloads: Masses of payloads, from light to heavy, in tenths of the robot's mass.
        load: Prior width of each of these, as a geometric distance.
        inner: Odds against a single wrong body among those that may carry payloads.
        unknown: As `size`, for each term of an unknown function of the motion.
        curves: The same for an unknown curve over one signal as a whole; each is tried.
        reversal: As `size`, for friction at speeds that a log does not resolve.
        columns: Prior odds of a mistake in the columns of a log, shared by all kinds and places.
        odd_joint: Prior odds of efforts at some joint that are unrelated to its motion, or have an
            unknown component.
        discrepancy: Effective number of samples of a residual beyond sensor noise, however long
            the logs are, as it varies with the motion in a way that no effect describes.
        part: Ratio of squared errors, removed by an effect to remaining, at which the effect is as
            probable as being part of something unknown.
        sharpness: Exponent with which these odds grow with the ratio.
        least: Probability below which a finding, compared with something unknown, is not a step.
    """

    size: float = 1.0
    rarer: float = 5.0
    again: float = 3.0
    shape: float = 4.0
    order: float = 100.0
    delays: float = 20.0
    widths: tuple[float, ...] = (0.003, 0.03, 0.07, 0.15, 0.3, 1.0)
    wrong: float = 0.3
    fitted: float = 100.0
    free: tuple[float, ...] = (0.7, 3.0)
    payloads: tuple[float, ...] = (0.05, 0.2, 0.7, 2.4)
    load: float = 0.7
    inner: float = 30.0
    unknown: float = 0.3
    curves: tuple[float, ...] = (0.03, 0.3)
    reversal: float = 0.1
    columns: float = 0.01
    odd_joint: float = 0.2
    discrepancy: float = 100.0
    part: float = 2.0
    sharpness: float = 1.5
    least: float = 0.1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name in ("widths", "payloads", "free", "curves"):
                if not instances(value, name, (int, float)):
                    raise ArgumentError(f"{name} is empty.", advice="Give at least one.")
                for each in value:
                    positive(each, name)
            elif name in ("size", "load"):
                positive(value, name)
            else:
                number(value, name, lower=0.0)
        positive(self.part, "part")
        number(self.least, "least", lower=0.0, upper=1.0)
