"""What `geodrake excite --tell-apart` is given: two effects, and where they may be."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from geodrake.cli.excitation_options import ExciteOptions
from geodrake.effects import Effect, effect_class
from geodrake.errors import ArgumentError
from geodrake.excitation import MotionLimits, Separation, make_rival, make_separation
from geodrake.excitation.effect_sizes import SIZE_WORDS
from geodrake.excitation.rivals import Rival
from geodrake.model.robot_model import RobotModel

_SIGN_SHARE = 0.02  # of the fastest that is allowed, over which friction changes sign
_FORM = "Write EFFECT,EFFECT; a place may follow either: EFFECT@elbow."


def check_alone(options: ExciteOptions, names: Sequence[str]) -> None:
    """Refuses what says otherwise than --tell-apart what a motion is for."""
    if options.tell_apart is None:
        return
    usual = {name: getattr(ExciteOptions, name) for name in ("criterion", "normalization")}
    wrong = [name for name, value in usual.items() if getattr(options, name) != value]
    if wrong:
        raise ArgumentError(
            f"--{wrong[0]} is a measure of all parameters, and --tell-apart has its own.",
            advice=f"Leave --{wrong[0]} out.",
        )
    if names:
        raise ArgumentError(
            f"With --tell-apart, --effects brings a FILE.py alone; got {', '.join(names)}.",
            advice="Add effects that the robot has to its model first: geodrake add EFFECT MODEL "
            "LOG --save model.yaml.",
        )
    rivals_in(options.tell_apart)


def rivals_in(text: str) -> tuple[tuple[str, tuple[str, ...]], tuple[str, tuple[str, ...]]]:
    """Names and places of two effects, `a@elbow,b@j1+j2`; a place that is not said is empty.

    Raises:
        ArgumentError: There are not two.
    """
    parts = [part.strip().partition("@") for part in text.split(",")]
    if len(parts) != 2 or not all(name for name, _, _ in parts):
        raise ArgumentError(f"--tell-apart takes two effects; got {text!r}.", advice=_FORM)
    (first, _, there), (second, _, here) = parts
    return (first, tuple(filter(None, there.split("+")))), (
        second,
        tuple(filter(None, here.split("+"))),
    )


def placed_rivals(
    text: str, model: RobotModel, limits: MotionLimits, *, extra: Sequence[type[Effect]] = ()
) -> tuple[Rival, Rival]:
    """The two effects at their places.

    Args:
        text: What the option was given. A place said of one is that of the other too, if both are
            at places of one kind.

    Raises:
        ArgumentError: There are no such effects or places.
    """
    (first, there), (second, here) = rivals_in(text)
    if effect_class(first, extra).places == effect_class(second, extra).places:
        there, here = there or here, here or there
    return (
        make_rival(first, model, limits, where=there, extra=extra),
        make_rival(second, model, limits, where=here, extra=extra),
    )


def separation_of(
    text: str,
    model: RobotModel,
    limits: MotionLimits,
    *,
    noise: ArrayLike,
    extra: Sequence[type[Effect]] = (),
) -> tuple[Separation, tuple[str, ...]]:
    """What distinguishing two effects amounts to, and what to say of it.

    Raises:
        ArgumentError: There are no such effects or places, or these cannot be distinguished.
    """
    rivals = placed_rivals(text, model, limits, extra=extra)
    first, second = (rival.name for rival in rivals)
    width = _SIGN_SHARE * limits.velocity
    separation = make_separation(model, *rivals, noise=noise, sign_width=width)
    named = {pair.truth.partition(" (")[0] for pair in separation.pairs}
    notes = [
        f"{other} explains all that {name} does: they can be distinguished the other way around "
        "only"
        for name, other in ((first, second), (second, first))
        if name not in named
    ]
    known = {fitted.effect for fitted in model.effects if fitted.parameters.any()}
    if any(known.intersection(rival.effects) for rival in rivals):
        sizes = "effects are as large as the model has them, rivals as like them as can be"
    else:
        sizes = f"effects of unknown size are thought to take {SIZE_WORDS}"
    return separation, (*notes, sizes)
