"""Numbers with their units, and results in plain sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from geodrake.diagnosis.results import (
    NOISE_MARGIN,
    Comparison,
    Diagnosis,
    ErrorTable,
    Explanation,
    Step,
)
from geodrake.effects import effect_class
from geodrake.effects.base import Effect
from geodrake.effects.shape_units import SHAPE_UNITS, when_sliding
from geodrake.errors import ArgumentError
from geodrake.model import RobotModel

UNKNOWN = "–"  # in place of a number that is none
_FEW = 2  # places whose values are told one by one


def number(value: float) -> str:
    """Three significant digits without an exponent, unless very small or large; – for none."""
    if not np.isfinite(value):
        return UNKNOWN
    if not 1e-4 <= abs(value) < 1e6 or value == round(value):
        return f"{value:.3g}"
    digits = np.format_float_positional(
        value, 3, unique=False, fractional=False, min_digits=3, trim="k"
    )
    return digits.rstrip(".")


def percent(share: float) -> str:
    """A share in percent, never rounded up to all of it; – for none."""
    if not np.isfinite(share):
        return UNKNOWN
    return "> 99 %" if 0.99 < share < 1 else f"{100 * share:.0f} %"


def with_deviation(value: float, deviation: float) -> str:
    """`3.08 ± 0.04`: the value to the first digit of its standard deviation."""
    if not np.isfinite(deviation) or deviation < 1e-4 * abs(value) or deviation <= 0:
        return number(value)
    decimals = int(np.clip(-np.floor(np.log10(deviation)), 0, 6))
    return f"{value:.{decimals}f} ± {deviation:.{decimals}f}"


def listed(names: Sequence[str], last: str = "and") -> str:
    """`a`, `a and b`, `a, b and c`."""
    head, tail = ", ".join(names[:-1]), "".join(names[-1:])
    return f"{head} {last} {tail}" if head else tail


@dataclass(frozen=True)
class Wording:
    """How to speak about one model.

    Attributes:
        model: The model.
        extra: Effects of the user's own.
    """

    model: RobotModel
    extra: tuple[type[Effect], ...] = ()
    prismatic: frozenset[str] = field(init=False)

    def __post_init__(self) -> None:
        plant = self.model.plant
        joints = (plant.get_joint(index) for index in plant.GetJointIndices())
        sliding = {j.velocity_start() for j in joints if j.type_name() == "prismatic"}
        names = frozenset(self.model.joints[i] for i in sliding)
        object.__setattr__(self, "prismatic", names)

    @property
    def effort_unit(self) -> str:
        """Unit of the joints' efforts."""
        if not self.prismatic:
            return "N·m"
        return "N" if len(self.prismatic) == len(self.model.joints) else "N·m or N"

    def where(self, places: Sequence[str]) -> str:
        """Joints or bodies in words; `all 6 joints` if it is all of several."""
        joints = self.model.joints
        if not places or (len(joints) > _FEW and set(places) == set(joints)):
            return f"all {len(joints)} joints"
        return ", ".join(places)

    def parameters(self, step: Step) -> tuple[str, ...]:
        """The parameters of a step, a line each: values at few places, or their range."""
        values = _by_name(step.parameters, step.where)
        if "mass" in values and step.effect == "payload":
            values = {"mass": values["mass"]}
        return tuple(f"{name} {self._amount(step, name, found)}" for name, found in values.items())

    def finding(self, step: Step) -> str:
        """`payload on wrist_3_link, 3.08 ± 0.04 kg, nrms 0.434 -> 0.048`."""
        words = f"{step.effect} on {self.where(step.where)}"
        values = _by_name(step.parameters, step.where)
        if "mass" in values or len(values) == 1:
            name = "mass" if "mass" in values else next(iter(values))
            words += f", {self._amount(step, name, values[name])}"
        return f"{words}, nrms {step.error_before:.3f} -> {step.error_after:.3f}"

    def _amount(self, step: Step, name: str, values: Mapping[str, float]) -> str:
        """Values of one parameter with their unit."""
        unit, scale = self.unit(step.effect, name, tuple(values)), 1.0
        if name == "delay":
            unit, scale = "ms", 1e3
        values = {place: scale * value for place, value in values.items()}
        if len(values) > _FEW:
            low, high = number(min(values.values())), number(max(values.values()))
            text = low if low == high else f"{low} … {high}"
        else:
            text = ", ".join(
                with_deviation(value, scale * step.deviations.get(place, {}).get(name, np.nan))
                for place, value in values.items()
            )
        return text if unit in ("", "1") else f"{text} {unit}"

    def unit(self, effect: str, name: str, places: Sequence[str]) -> str:
        """Unit of a parameter of an effect at some places; "" for plain numbers."""
        try:
            parameters = effect_class(effect, self.extra).parameters
        except ArgumentError:  # wrong_inertia is found by loosening the prior; it is no class
            parameters = ()
        unit = {p.name: p.unit for p in parameters}.get(name, SHAPE_UNITS.get(name, ""))
        if places and self.prismatic.issuperset(places):
            unit = when_sliding(unit)
        return unit


def explanation_verdict(explanation: Explanation, wording: Wording) -> str:
    """What an explanation amounts to, in a few sentences."""
    end, steps = explanation.end, explanation.steps
    if explanation.verdict == "adequate":
        return f"Adequate: no effect is worth adding; {_noise_alone(end)}."
    found = "no effect that geodrake knows takes the error down"
    if len(steps) == 1:
        found = wording.finding(steps[0])
    elif steps:
        found = (
            f"{listed([step.effect for step in steps])} take the held-out error from nrms "
            f"{steps[0].error_before:.3f} to {end.nrms:.3f}"
        )
    if explanation.verdict == "explained":
        return f"Explained: {found}; {_noise_alone(end)}."
    rest = f"An error is left that nothing explains: {_against_noise(end)}."
    head = "Explained in part" if steps else "Unexplained"
    return f"{head}: {found}. {rest}{_worst(explanation)}"


def what_to_do(explanation: Explanation) -> str:
    """What to do where an error is left that nothing explains, as a sentence after a space."""
    if explanation.verdict != "unexplained":
        return ""
    return (
        " For a formula of it, run this again with --draft-effect my_effect.py: that searches "
        "what it goes with, and writes the formula as an effect."
    )


def rivals_told(step: Step) -> list[str]:
    """What the log cannot tell a step from: `viscous_friction (0.0312 against 0.0310)`.

    In brackets is the held-out nrms with the rival, and that with the effect at the same time.
    """
    fitted = [
        f"{rival.effect} ({rival.error:.4f} against {rival.error_of_choice:.4f})"
        for rival in step.rivals
    ]
    return [*fitted, *step.unfitted_rivals]


def addition_verdict(explanation: Explanation, wording: Wording) -> str:
    """What adding an effect changed, and what is left."""
    found = listed([wording.finding(step) for step in explanation.steps]) or "nothing"
    if explanation.verdict != "unexplained":
        return f"Added {found}; {_noise_alone(explanation.end)}."
    return f"Added {found}. Left: {_against_noise(explanation.end)}.{_worst(explanation)}"


def diagnosis_verdict(diagnosis: Diagnosis, wording: Wording) -> str:
    """What a diagnosis amounts to, in a few sentences."""
    left = diagnosis.refitted
    if not diagnosis.candidates:
        if diagnosis.verdict == "adequate":
            return f"Adequate: nothing is missing; {_noise_alone(left)}."
        return (
            "Unexplained: no effect that geodrake knows takes the error down: "
            f"{_against_noise(left)}."
        )
    best, *others = diagnosis.candidates
    words = (
        f"Missing: {best.effect} on {wording.where(best.where)}; adding it takes the held-out "
        f"nrms from {best.error_before:.3f} to {best.error_after:.3f}."
    )
    tied = list(dict.fromkeys(c.effect for c in others if c.tied and c.effect != best.effect))
    if tied:
        words += f" The log cannot tell it from {listed(tied, 'or')}."
    return words


def comparison_verdict(comparison: Comparison) -> str:
    """What a comparison amounts to, in a sentence."""
    errors = comparison.errors
    share = max(0.0, 1.0 - (errors.floor_nrms / errors.nrms) ** 2) if errors.nrms else 0.0
    return (
        f"{_against_noise(errors)}; a better model could remove {percent(share)} of the squared "
        "error."
    )


def _against_noise(errors: ErrorTable) -> str:
    """How an error compares with the noise floor."""
    nrms, floor = errors.nrms, errors.floor_nrms
    if floor <= 0:
        return f"nrms {nrms:.3f}, without measurable sensor noise"
    words = f"nrms {nrms:.3f}, {number(nrms / floor)} times the sensor noise of {floor:.3f}"
    told = [
        f"{joint.joint} errs by {number(joint.rms / joint.floor)} times its own"
        for joint in errors.above_noise
        if joint.floor > 0
    ]
    # Where the whole is hardly above its noise, those joints are why it is not called noise.
    return f"{words}, and {listed(told)}" if told and nrms <= NOISE_MARGIN * floor else words


def _noise_alone(errors: ErrorTable) -> str:
    """That an error is no larger than the noise floor, or hardly."""
    return f"what is left, nrms {errors.nrms:.3f}, is sensor noise ({errors.floor_nrms:.3f})"


def _worst(explanation: Explanation) -> str:
    """Where the final model errs most, as a sentence after a space."""
    failing = explanation.after.failing
    return f" {failing[0]}" if failing else ""


def _by_name(
    parameters: Mapping[str, Mapping[str, float]], order: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Parameter name -> place -> value, places in the order of a step."""
    rank = {place: i for i, place in enumerate(order)}
    values: dict[str, dict[str, float]] = {}
    for place in sorted(parameters, key=lambda place: rank.get(place, len(rank))):
        for name, value in parameters[place].items():
            values.setdefault(name, {})[place] = value
    return values
