"""Prior beliefs about a robot, before its logs are seen: the numbers that decide.

A diagnosis weighs explanations by their probability, and these are the prior probabilities and
widths. Those of errors in columns, such as usual zeros, gains and ranges of joints, stand with the
columns' evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

from geodrake.boundary.arguments import instances, number, positive
from geodrake.errors import ArgumentError


@dataclass(frozen=True)
class Beliefs:
    """Prior odds and widths of everything that may be missing in a model.

    Attributes:
        size: Standard deviation of the effort that a parameter of an effect makes, as a share of
            the deviation of its joint's measured effort: a friction may be as large as all else.
        rarer: How much rarer an effect is than one that is less complex by one.
        again: Odds against an effect at one joint more of a robot that has it elsewhere.
        shape: Values among which the data choose a shape parameter, such as an exponent.
        order: Values among which they choose one that is found in a spectrum, or an instant.
        delays: Delays among which they choose.
        widths: How well a model file knows its bodies, as geometric distances: each is tried.
        wrong: Widths above this one mean that the file is wrong.
        fitted: Odds against a body, or an effect, of a model that was fitted before being another
            one since.
        free: Widths of one body that is wrong while the others are right: each is tried.
        payloads: Masses of payloads, from light to heavy, in tenths of the robot's mass; what a
            body carries that carries others is thought to be the last but one.
        load: How well each of these is known, as a geometric distance.
        inner: Odds against a payload on a body that carries others.
        unknown: As `size`, for each term of a function of the motion that no effect describes.
        curves: The same for a curve of one signal of the motion as a whole: each is tried.
        reversal: As `size`, for what friction does at speeds that a log does not resolve.
        columns: Odds of a mistake in the columns of a log; all kinds and places share them.
        odd_joint: Odds of efforts at some joint that have nothing to do with its motion, or have
            something unknown in them.
        discrepancy: What is more than sensor noise in a residual is worth so many samples, however
            long logs are: it varies with the motion in a way that no effect describes.
        part: Beside an error that nothing explains, an effect that takes so many times as much of
            the squared error away is as likely itself as it is a part of something unknown.
        sharpness: With so many times the logarithm of that number, its odds grow.
        least: A finding is no step if it is less probable than this beside something unknown.
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
    reversal: float = 0.3
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
