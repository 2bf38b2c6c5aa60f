"""Maps of the closed-loop bound: gamma* over two parameters from coarse to fine, and outcomes refined at their boundaries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm.auto import tqdm

import jaxsphere as js
from experiments.plots.climbing import TORQUE_LIMITED, Axis, BoundMap, OutcomeMap
from experiments.studies.climbing_axes import Setting, at, of_climb
from jaxsphere.models import planar
from jaxsphere.sweep.refine import from_neighbours, refine

# Lanes per call: as many as are done between two moves of the progress bar.
_CHUNK = 16384
# Nodes between those of the first level of a map of gamma*.
_COARSEST = 16
# Share of the static bound where the first level looks first.
_FIRST_GUESS = 0.97


def bound_map(setting: Setting, x: Axis, y: Axis, tolerance: float = 1e-3, progress: bool = True) -> BoundMap:
    """Find gamma* on the whole grid, in brackets of `tolerance` (rad), from coarse to fine.

    Each level halves the spacing. A new node is looked for around the mean of the neighbours known by then; both ends of its
    bracket are simulated all the same, and a guess that was wrong costs trials, not accuracy. Ctrl-C keeps what is done.
    """
    shape = (len(y.values), len(x.values))
    value, lower, upper = (np.full(shape, np.nan) for _ in range(3))
    status, done = np.full(shape, -1), np.zeros(shape, bool)
    run = js.over_queue(
        lambda xv, yv, guess: js.slope_search(at(setting, (x, xv), (y, yv)).climb, tolerance, guess, setting.dtype),
        capacity=_CHUNK,
    )
    rollouts, seconds = 0, 0.0
    finished = True
    with tqdm(total=value.size, desc="map", unit="bound", disable=not progress) as bar:
        try:
            for rows, columns, guess in _levels(value, done, _static_bounds(setting, x, y)):
                for start in range(0, len(rows), _CHUNK):
                    part = slice(start, start + _CHUNK)
                    r, c = rows[part], columns[part]
                    found = run(x.values[c], y.values[r], guess[part])
                    value[r, c], status[r, c], done[r, c] = found.value, found.status, True
                    lower[r, c], upper[r, c] = found.lower, found.upper
                    rollouts += int(found.rollouts.sum())
                    seconds += float(found.seconds.sum())
                    bar.update(len(r))
        except KeyboardInterrupt:
            finished = False
    return BoundMap(x, y, value, lower, upper, status, rollouts, seconds, finished)


def confirm(setting: Setting, found: BoundMap, sample: int, seed: int = 0) -> tuple[int, int]:
    """Simulate the ends of random brackets in full: 60 s or what `duration` says, 1 ms, float64, no early decision.

    Returns how many of the ends turn out as the map says, and how many were asked.
    """
    rows, columns = np.nonzero(np.isfinite(found.value))
    chosen = np.random.default_rng(seed).permutation(len(rows))[:sample]
    r, c = rows[chosen], columns[chosen]
    climb = replace(setting.climb, dt=min(1e-3, setting.climb.dt), early=False)
    full = js.over_queue(lambda xv, yv, slope: _outcome(at(Setting(climb, slope), (found.x, xv), (found.y, yv))))
    xv, yv = found.x.values[c], found.y.values[r]
    low = full(xv, yv, found.lower[r, c]).status == js.Status.OK
    # Nothing was seen to fail where the bracket ends at the bound (4).
    seen = found.status[r, c] != js.Status.OK
    high = full(xv, yv, found.upper[r, c]).status != js.Status.OK
    return int(low.sum() + (high & seen).sum()), int(len(r) + seen.sum())


def not_monotone(setting: Setting, found: BoundMap, sample: int, slopes: int = 50, seed: int = 0) -> tuple[int, int]:
    """Count random nodes whose climbs change more than once between settling and failing from the flat to the bound (4).

    Returns their number and that of the nodes looked at. Bisection has found one of their changes.
    """
    rows, columns = np.nonzero(np.isfinite(found.value))
    chosen = np.random.default_rng(seed).permutation(len(rows))[:sample]
    xv, yv = found.x.values[columns[chosen]], found.y.values[rows[chosen]]

    def along(xv: Any, yv: Any, share: Any) -> Any:
        here = at(setting, (found.x, xv), (found.y, yv))
        return _outcome(here._replace(slope=share * js.climbing_bound(here.climb.robot)))

    shares = np.linspace(0.0, 0.999, slopes)
    lanes = (*(np.repeat(values, slopes) for values in (xv, yv)), np.tile(shares, len(chosen)))
    settled = (js.over_queue(along)(*lanes).status == js.Status.OK).reshape(len(chosen), slopes)
    return int(np.sum(np.sum(settled[:, 1:] != settled[:, :-1], axis=1) > 1)), len(chosen)


def _static_bounds(setting: Setting, x: Axis, y: Axis) -> np.ndarray:
    """Steepest slope (rows, columns) that pendulum and motor hold statically: (4), and M g r sin(gamma) = torque limit."""

    def bound(xv: Any, yv: Any) -> Any:
        here = at(setting, (x, xv), (y, yv))
        limit = jnp.inf if here.climb.torque_limit is None else here.climb.torque_limit
        weight = planar.total_mass(here.climb.robot) * here.climb.robot.gravity * here.climb.robot.shell_radius
        return jnp.minimum(js.climbing_bound(here.climb.robot), jnp.arcsin(jnp.minimum(limit / weight, 1.0)))

    return np.asarray(jax.jit(jax.vmap(jax.vmap(bound, (0, None)), (None, 0)))(x.values, y.values))


def _levels(value: np.ndarray, done: np.ndarray, static: np.ndarray) -> Any:
    """Yield (rows, columns, guesses) of the nodes of one level after the other; `value` and `done` are filled meanwhile."""
    stride = _COARSEST
    while stride >= 1:
        rows, columns = np.meshgrid(*(np.arange(0, side, stride) for side in value.shape), indexing="ij")
        new = ~done[rows, columns]
        guess = from_neighbours(value, 2 * stride) if done.any() else _FIRST_GUESS * static
        yield rows[new], columns[new], guess[rows[new], columns[new]]
        stride //= 2


def outcome_map(setting: Setting, x: Axis, y: Axis, coarse: int | None = 16) -> OutcomeMap:
    """Find how every climb of the grid ends, refined where neighbours disagree; `coarse` = None simulates every node.

    A climb that fails under the torque limit is run again without it: where it then settles the motor is to blame.
    """
    limited = js.over_queue(lambda xv, yv: _outcome(at(setting, (x, xv), (y, yv))), capacity=_CHUNK)
    unlimited = js.over_queue(
        lambda xv, yv: _outcome(of_climb("torque_limit")(at(setting, (x, xv), (y, yv)), None)), capacity=_CHUNK
    )
    has_limit = setting.climb.torque_limit is not None or "torque_limit" in (x.name, y.name)

    def evaluate(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        xv, yv = x.values[columns], y.values[rows]
        ends = _in_chunks(limited, xv, yv)
        failed = np.flatnonzero(ends != js.Status.OK)
        if has_limit and len(failed):
            free = _in_chunks(unlimited, xv[failed], yv[failed])
            ends[failed[free == js.Status.OK]] = TORQUE_LIMITED
        return ends

    shape = (len(y.values), len(x.values))
    if coarse is None:
        rows, columns = (index.ravel() for index in np.indices(shape))
        return OutcomeMap(x, y, evaluate(rows, columns).reshape(shape), np.ones(shape, bool))
    refined = refine(evaluate, shape, coarse)
    return OutcomeMap(x, y, refined.outcomes, refined.simulated)


def _in_chunks(run: Callable[..., Any], *lanes: np.ndarray) -> np.ndarray:
    parts = [run(*(leaf[i : i + _CHUNK] for leaf in lanes)) for i in range(0, len(lanes[0]), _CHUNK)]
    return np.concatenate([part.status for part in parts]).astype(np.int64)


def _outcome(setting: Setting) -> Any:
    return js.outcome_run(setting.climb, setting.slope, setting.dtype)
