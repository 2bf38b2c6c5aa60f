"""Maps of the closed-loop bound: gamma* over two parameters from coarse to fine, and outcomes refined at their boundaries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from experiments.plots.climbing import TORQUE_LIMITED, Axis, BoundMap, OutcomeMap
from experiments.records import progress_bar
from experiments.studies.climbing_axes import Setting, at
from jaxsphere.robot import total_mass
from jaxsphere.simulation.closed_loop import where
from jaxsphere.simulation.search import Pausable
from jaxsphere.sweep.refine import Boundaries, Guesses

# Nodes between those of the first level of a map of gamma*.
_COARSEST = 16
# Share of the static bound where the first level looks first.
_FIRST_GUESS = 0.97


def bound_map(
    setting: Setting,
    x: Axis,
    y: Axis,
    tolerance: float = 1e-3,
    progress: bool = True,
    store: Path | None = None,
    resume: bool = False,
) -> BoundMap:
    """Find gamma* on the whole grid, in brackets of `tolerance` (rad), from coarse to fine.

    Each level halves the spacing. A new node is looked for around the mean of the neighbours known by then; both ends of its
    bracket are simulated all the same, and a guess that was wrong costs trials, not accuracy.
    """

    def lane(guess: Any, **values: Any) -> Pausable:
        return js.slope_search(*at(setting, **values), tolerance=tolerance, guess=guess)

    refine = Guesses(first=_FIRST_GUESS * _static_bounds(setting, x, y), coarsest=_COARSEST)
    found = _sweep(lane, setting, x, y, refine, "bound", progress, store, resume)
    values = {name: np.asarray(found.values[name]) for name in ("value", "lower", "upper", "status")}
    rollouts, seconds = (found.values[name].sum() for name in ("rollouts", "seconds"))
    return BoundMap(x, y, **values, rollouts=int(rollouts), seconds=float(seconds))


def confirm(setting: Setting, found: BoundMap, sample: int, seed: int = 0) -> tuple[int, int]:
    """Simulate the ends of random brackets in full: at most 1 ms, float64, no early decision.

    Returns how many of the ends turn out as the map says, and how many were asked.
    """
    rows, columns = np.nonzero(np.isfinite(found.value))
    chosen = np.random.default_rng(seed).permutation(len(rows))[:sample]
    r, c = rows[chosen], columns[chosen]
    numerics = replace(setting.numerics, dt=min(1e-3, setting.numerics.dt), dtype="float64")

    def outcome(values: Any, slope: Any) -> Pausable:
        here = at(setting, **values)
        return js.outcome_run(replace(here.task, slope=slope), here.gains, numerics, early=False)

    full, values = js.batch(outcome, ragged=True), {found.x.name: found.x.values[c], found.y.name: found.y.values[r]}
    low = np.asarray(full(values, found.lower[r, c]).status) == js.Status.OK
    # Nothing was seen to fail where the bracket ends at the bound (4).
    seen = found.status[r, c] != js.Status.OK
    high = np.asarray(full(values, found.upper[r, c]).status) != js.Status.OK
    return int(low.sum() + (high & seen).sum()), int(len(r) + seen.sum())


def not_monotone(setting: Setting, found: BoundMap, sample: int, slopes: int = 50, seed: int = 0) -> tuple[int, int]:
    """Count random nodes whose climbs change more than once between settling and failing from the flat to the bound (4).

    Returns their number and that of the nodes looked at. Bisection has found one of their changes.
    """
    rows, columns = np.nonzero(np.isfinite(found.value))
    chosen = np.random.default_rng(seed).permutation(len(rows))[:sample]
    values = {found.x.name: found.x.values[columns[chosen]], found.y.name: found.y.values[rows[chosen]]}

    def along(values: Any, share: Any) -> Pausable:
        here = at(setting, **values)
        return js.outcome_run(replace(here.task, slope=share * js.climbing_bound(here.task.robot)), here.gains, here.numerics)

    shares = np.tile(np.linspace(0.0, 0.999, slopes), len(chosen))
    lanes = {name: np.repeat(one, slopes) for name, one in values.items()}
    ends = np.asarray(js.batch(along, ragged=True)(lanes, shares).status)
    settled = (ends == js.Status.OK).reshape(len(chosen), slopes)
    return int(np.sum(np.sum(settled[:, 1:] != settled[:, :-1], axis=1) > 1)), len(chosen)


def outcome_map(
    setting: Setting,
    x: Axis,
    y: Axis,
    coarse: int | None = 16,
    progress: bool = False,
    store: Path | None = None,
    resume: bool = False,
) -> OutcomeMap:
    """Find how every climb of the grid ends, refined where neighbours disagree; `coarse` = None simulates every node.

    A climb that fails under the torque limit is run again without it: where it then settles the motor is to blame.
    """
    refine = None if coarse is None else Boundaries("outcome", coarse)
    found = _sweep(lambda **values: _blamed(at(setting, **values)), setting, x, y, refine, "climb", progress, store, resume)
    outcome = np.asarray(found.values["outcome"])
    simulated = np.ones(outcome.shape, bool) if coarse is None else np.asarray(found.values["simulated"])
    return OutcomeMap(x, y, outcome, simulated)


def _blamed(setting: Setting) -> Pausable:
    """Return the climb under its torque limit, followed by one without where it fails."""
    task, gains, numerics = setting
    if task.torque_limit is None:
        only = js.outcome_run(task, gains, numerics)
        return only._replace(result=lambda carry: {"outcome": only.result(carry).status})

    def climb(limit: Array) -> Pausable:
        return js.outcome_run(replace(task, torque_limit=limit), gains, numerics)

    def advance(now: tuple[Array, Array, Any]) -> tuple[Array, Array, Any]:
        limit, limited, carry = now
        carry = climb(limit).advance(carry)
        status = climb(limit).result(carry).status
        again = climb(limit).is_done(carry) & (status != js.Status.OK) & jnp.isfinite(limit)
        free = jnp.full_like(limit, jnp.inf)
        return where(again, (free, status, climb(free).first), (limit, limited, carry))

    def outcome(now: tuple[Array, Array, Any]) -> dict[str, Array]:
        limit, limited, carry = now
        last = climb(limit).result(carry).status
        freed = jnp.where(last == js.Status.OK, jnp.asarray(TORQUE_LIMITED, limited.dtype), limited)
        return {"outcome": jnp.where(jnp.isinf(limit), freed, last)}

    limit = jnp.asarray(task.torque_limit, numerics.dtype)
    first = (limit, jnp.asarray(js.Status.OK, jnp.int32), climb(limit).first)
    return Pausable(first, advance, lambda now: climb(now[0]).is_done(now[2]), outcome)


def _sweep(
    lane: Any,
    setting: Setting,
    x: Axis,
    y: Axis,
    refine: Any,
    unit: str,
    progress: bool,
    store: Path | None,
    resume: bool,
) -> js.SweepResults:
    axes = [js.axes.linear(one.name, one.values[0], one.values[-1], len(one.values)) for one in (y, x)]
    dtype = getattr(jnp, setting.numerics.dtype)
    with progress_bar(unit, progress) as report:
        return js.sweep(
            lane,
            axes=axes,
            refine=refine,
            dtype=dtype,
            store=store,
            resume=resume,
            progress=report,
        )


def _static_bounds(setting: Setting, x: Axis, y: Axis) -> np.ndarray:
    """Steepest slope (rows, columns) that pendulum and motor hold statically: (4), and M g r sin(gamma) = torque limit."""

    def bound(xv: Any, yv: Any) -> Any:
        here = at(setting, **{x.name: xv, y.name: yv}).task
        limit = jnp.inf if here.torque_limit is None else here.torque_limit
        weight = total_mass(here.robot) * here.robot.gravity * here.robot.shell_radius
        return jnp.minimum(js.climbing_bound(here.robot), jnp.arcsin(jnp.minimum(limit / weight, 1.0)))

    return np.asarray(jax.jit(jax.vmap(jax.vmap(bound, (0, None)), (None, 0)))(x.values, y.values))
