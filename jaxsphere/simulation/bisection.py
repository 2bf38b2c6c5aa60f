"""Largest value of a parameter up to which a simulated lane succeeds: bisection inside a compiled loop.

A trial is a simulation at one value of the parameter, cut into segments: `start(value)` gives its first carry, and
`advance(value, carry)` runs one segment and says whether the fate is decided. Every lane of a batch is at a trial of its own:
as soon as one is decided, the lane narrows its bracket and starts the next, while its neighbours are still on theirs. Run a
search with `pausable.run`, or many with `pausable.over_queue`.

Bisection assumes that success is monotone in the parameter: below the value found it was seen to succeed, above to fail, and
nothing was asked in between.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.simulation.pausable import Pausable
from jaxsphere.status import Status, code

# Factor by which the step grows while the bracket is still open on one side.
_GROWTH = 4.0
# More than a double has digits.
_MOST_TRIALS = 100


class Trial(NamedTuple):
    """A simulation at one value of a parameter; a Status of OK is success."""

    start: Callable[[Array], Any]  # value -> carry
    advance: Callable[[Array, Any], tuple[Any, Array, Array]]  # (value, carry) -> (carry, decided, Status code)


class Bound(NamedTuple):
    """What a search found; every entry a scalar per lane, in the parameter's unit."""

    value: Array  # middle of the bracket; NaN where the lowest value fails already
    lower: Array  # largest value seen to succeed; NaN where none was
    upper: Array  # smallest value seen to fail, or the end of the search interval
    status: Array  # Status at `upper`; OK where nothing failed below the end of the interval
    trials: Array  # how many
    segments: Array  # simulated in all of them


class _Search(NamedTuple):
    low: Array
    high: Array
    low_known: Array  # `low` was seen to succeed
    status: Array  # at `high`; OK while that is the end of the interval
    step: Array
    value: Array  # on trial
    carry: Any
    trials: Array
    segments: Array
    done: Array


class _One(NamedTuple):
    carry: Any
    decided: Array
    status: Array
    segments: Array


def outcome(trial: Trial, value: Array) -> Pausable:
    """One trial; it ends with the Status code and the number of segments that it took."""

    def advance(one: _One) -> _One:
        carry, decided, status = trial.advance(value, one.carry)
        return _One(carry, decided, status, one.segments + 1)

    first = _One(trial.start(value), jnp.zeros((), bool), code(Status.OK), jnp.zeros((), jnp.int32))
    return Pausable(first, advance, lambda one: one.decided, lambda one: (one.status, one.segments))


def largest_success(
    trial: Trial, low: Array, high: Array, tolerance: Array, guess: Array | None = None, step: Array | None = None
) -> Pausable:
    """Search for the largest value in [low, high] up to which `trial` succeeds; it ends with a `Bound`.

    Args:
        trial: the simulation. low, high: ends of the search interval; the answer is never above `high`, which is not tried.
        tolerance: width of the last bracket, wider where numbers have no more digits. guess: where to look first, the middle by
        default. step: how far from a guess to look next, growing by 4 until the bracket is closed; by default the interval's
        end.
    """
    span = high - low
    reach = span if step is None else step
    first = 0.5 * (low + high) if guess is None else jnp.clip(guess, low, high)

    def advance(search: _Search) -> _Search:
        carry, decided, status = trial.advance(search.value, search.carry)
        search = search._replace(carry=carry, segments=search.segments + 1)
        learnt = _learn(search, status, low, high, tolerance)
        learnt = learnt._replace(carry=trial.start(learnt.value))
        return jax.tree.map(lambda new, old: jnp.where(decided, new, old), learnt, search)

    count = jnp.zeros((), jnp.int32)
    begin = _Search(
        low=low,
        high=high,
        low_known=jnp.zeros((), bool),
        status=code(Status.OK),
        step=reach,
        value=first,
        carry=trial.start(first),
        trials=count,
        segments=count,
        done=jnp.zeros((), bool),
    )

    def result(found: _Search) -> Bound:
        nothing = jnp.nan * span
        return Bound(
            value=jnp.where(found.low_known, 0.5 * (found.low + found.high), nothing),
            lower=jnp.where(found.low_known, found.low, nothing),
            upper=found.high,
            status=found.status,
            trials=found.trials,
            segments=found.segments,
        )

    return Pausable(begin, advance, lambda search: search.done, result)


def _learn(search: _Search, status: Array, low: Array, high: Array, tolerance: Array) -> _Search:
    """Narrow the bracket by the outcome of the trial and choose the next value."""
    good = status == Status.OK
    new_low = jnp.where(good, search.value, search.low)
    new_high = jnp.where(good, search.high, search.value)
    low_known = search.low_known | good
    high_known = (search.status != Status.OK) | ~good
    middle = 0.5 * (new_low + new_high)
    upwards = jnp.where(new_low + search.step < new_high, new_low + search.step, middle)
    downwards = jnp.maximum(new_high - search.step, low)
    value = jnp.where(low_known, jnp.where(high_known, middle, upwards), downwards)
    return search._replace(
        low=new_low,
        high=new_high,
        low_known=low_known,
        status=jnp.where(good, search.status, status),
        step=_GROWTH * search.step,
        value=value,
        trials=search.trials + 1,
        # Where the lowest value of all has failed there is nothing left to find; a tolerance may be below the last digit.
        done=(low_known & (new_high - new_low <= tolerance)) | (new_high <= low) | (search.trials + 1 >= _MOST_TRIALS),
    )
