"""Ways to the optimum of the dual: straight to it, or along a path for points that are far off."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from geodrake.errors import ArgumentError
from geodrake.manifolds.projections.dual import State

_SLOW = 0.5  # share of the error that a Newton step may leave before single rows are tried
_EXACT = 1e-13  # error after which there is nothing to gain
_PRECISE = 1e-8  # error below which steps only polish
_LOOSE = 0.3  # length of the next Newton step on the path
_LEAST_WEIGHT = 1e-24
_LONG, _SHORT = 1e-3, 4.0  # factors of the weight on the way away from x and on the way back


def attempts(start: State, max_iterations: int) -> Iterator[State]:
    """States that may be optimal, each at more expense than the last one."""
    state = solved(start, _EXACT, max_iterations)
    yield state
    if state.error < _PRECISE:  # but some point on the way was known less precisely
        again = start.pushed(state.multipliers)
        if again is not None:
            yield solved(again, _EXACT, max_iterations)
    state = _along_path(start, max_iterations)
    yield state
    again = start.pushed(state.multipliers)
    if again is not None:
        yield solved(again, _EXACT, max_iterations)


def solved(state: State, enough: float, max_iterations: int) -> State:
    """The best of a sequence of states towards the optimum.

    Args:
        enough: Error of a state below which it is good enough.
    """
    single = True  # where rows are far apart, one at a time goes further than all at once
    best = state
    try:
        for _ in range(max_iterations):
            if state.error <= enough:
                return state
            if best.error <= _PRECISE and state.error > _SLOW * best.error and state is not best:
                break  # rounding leaves no more
            best = min(state, best, key=lambda s: s.error)
            following = state.single_step(int(np.argmax(state.errors))) if single else None
            following = following or state.newton_step()
            if following is None:
                if single:
                    break
                single = True
                continue
            single = not single and not following.error <= _SLOW * state.error
            state = following
        return min(state, best, key=lambda s: s.error)
    except (ArgumentError, np.linalg.LinAlgError):  # on the edge, as far as rounding tells
        return best


def _along_path(start: State, max_iterations: int) -> State:
    """The optimum by way of those for points whose gradient is w ∇h(x), with w from small to 1.

    Where the optimum has to be much greater than x, ∇h(x) outweighs the barrier so far that the
    quadratic model of a Newton step is good for small steps only. A small w makes x great, and then
    the path is that of interior-point methods.
    """
    weight, state, found = 1.0, start, False
    try:
        while weight > _LEAST_WEIGHT:
            start, weight = start.weighted(_LONG), _LONG * weight
            state, found = _centered(start, max_iterations)
            if found:
                break
        while weight < 1.0 and found:
            factor = min(_SHORT, 1.0 / weight)
            weight = weight * factor if factor == _SHORT else 1.0
            state, found = _centered(state.weighted(factor), max_iterations)
    except (ArgumentError, np.linalg.LinAlgError):
        return state
    return solved(state, _EXACT, max_iterations) if weight == 1.0 else state


def _centered(state: State, max_iterations: int) -> tuple[State, bool]:
    """A state on the path, and whether it is near enough to the path."""
    for _ in range(max_iterations):
        if state.newton_length < _LOOSE:
            return state, True
        following = state.newton_step() or state.single_step(int(np.argmax(state.errors)))
        if following is None:
            break
        state = following
    return state, False
