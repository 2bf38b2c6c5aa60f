"""Computations that end at different times, and a bisection that is one of them.

Under `jax.vmap` a loop lasts as long as its slowest lane. A `Pausable` can be advanced piece by piece instead, so that a ragged
`batch` gives a lane the next computation as soon as it has finished one.

`largest_success` finds the largest value of a parameter up to which a simulated lane succeeds. Every lane of a batch is at a
trial of its own: as soon as one is decided, the lane narrows its bracket and starts the next.

Bisection assumes that success is monotone in the parameter: below the value found it was seen to succeed, above to fail, and
nothing was asked in between.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.simulation.closed_loop import where
from jaxsphere.status import Status, code

# Factor by which the step grows while the bracket is still open on one side.
_GROWTH = 4.0
# More than a double has digits.
_MOST_TRIALS = 100


class Pausable(NamedTuple):
    """A computation cut into pieces."""

    first: Any  # carry before the first piece
    advance: Callable[[Any], Any]  # carry -> carry after one more piece
    is_done: Callable[[Any], Array]  # carry -> bool
    result: Callable[[Any], Any]  # carry of a finished computation -> what it found


def run(computation: Pausable) -> Any:
    """Run one computation to its end; for many type `js.batch(make, ragged=True)`."""
    last = jax.lax.while_loop(lambda carry: ~computation.is_done(carry), computation.advance, computation.first)
    return computation.result(last)


class Trial(NamedTuple):
    """A simulation at one value of a parameter, cut into segments; a Status of OK is success."""

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
        trial: the simulation.
        low, high: ends of the search interval; the answer is never above `high`, which is not tried.
        tolerance: width of the last bracket, wider where numbers have no more digits.
        guess: where to look first, the middle by default.
        step: how far from a guess to look next, growing by 4 until the bracket is closed; the whole interval by default.
    """
    span = high - low
    reach = span if step is None else step
    first = 0.5 * (low + high) if guess is None else jnp.clip(guess, low, high)

    def advance(search: _Search) -> _Search:
        carry, decided, status = trial.advance(search.value, search.carry)
        search = search._replace(carry=carry, segments=search.segments + 1)
        learnt = _learn(search, status, low, high, tolerance)
        learnt = learnt._replace(carry=trial.start(learnt.value))
        return where(decided, learnt, search)

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
