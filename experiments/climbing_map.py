"""Maps of the closed-loop bound: gamma* over two parameters from coarse to fine, and outcomes refined at their boundaries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tqdm.auto import tqdm

import jaxsphere as js
from jaxsphere.checks import require_choice, require_count, require_scalar
from jaxsphere.models import planar
from jaxsphere.simulation.refinement import refine

# Lanes per call of the compiled program: few numbers, so that it compiles few times.
_CHUNKS = (512, 4096, 16384)
# Nodes between those of the first level of a map of gamma*.
_COARSEST = 16
# Share of the static bound where the first level looks first.
_FIRST_GUESS = 0.97
# Time steps that divide a minute, s, and the largest product with a rate (1/s); RK4 is stable up to 2.78.
_STEPS = (15e-3, 12e-3, 10e-3, 8e-3, 6e-3, 5e-3, 4e-3, 3e-3, 2e-3, 1e-3)
_STABLE = 2.2


class Setting(NamedTuple):
    """One point of a map: what climbs, and for outcomes on which slope (rad)."""

    climb: js.Climb = js.Climb()
    slope: Any = 0.17453292519943295  # 10 degrees
    dtype: str = "float64"


def _of_climb(name: str) -> Callable[[Setting, Any], Setting]:
    return lambda setting, value: setting._replace(climb=replace(setting.climb, **{name: value}))


def _of_gains(name: str) -> Callable[[Setting, Any], Setting]:
    return lambda setting, value: _of_climb("gains")(setting, replace(setting.climb.gains, **{name: value}))


def _of_robot(name: str) -> Callable[[Setting, Any], Setting]:
    return lambda setting, value: _of_climb("robot")(setting, replace(setting.climb.robot, **{name: value}))


def _slope(setting: Setting, value: Any) -> Setting:
    return setting._replace(slope=value)


def _push(setting: Setting, value: Any) -> Setting:
    return _of_climb("disturbance")(setting, jnp.zeros(4).at[1].set(value))


def _mass_ratio(setting: Setting, value: Any) -> Setting:
    """Move mass between pendulum and shell, whose moment follows; the total stays."""
    robot = setting.climb.robot
    pendulum = value * planar.total_mass(robot)
    shell = planar.total_mass(robot) - robot.gimbal_mass - pendulum
    inertia = robot.shell_inertia * (shell / robot.shell_mass)
    return _of_climb("robot")(setting, replace(robot, pendulum_mass=pendulum, shell_mass=shell, shell_inertia=inertia))


def _length_ratio(setting: Setting, value: Any) -> Setting:
    return _of_robot("pendulum_length")(setting, value * setting.climb.robot.shell_radius)


def stable_step(climb: js.Climb, *axes: Axis) -> float:
    """Largest usual time step (s) with which RK4 stays stable within the smoothed sign, for every point of the axes.

    Raises:
        ValueError: the sign is hard and the controller continuous, or no usual step is short enough.
    """
    largest = {name: float(getattr(climb.gains, name)) for name in ("eta", "k", "c2")}
    largest |= {which.name: float(which.values.max()) for which in axes if which.name in largest}
    smoothing = float(climb.smoothing)
    if climb.control_period is not None:
        return float(climb.control_period)
    if smoothing == 0.0:
        raise ValueError("smoothing = 0 needs a sampled controller; type --control-period 1e-3")
    rate = largest["eta"] / smoothing + largest["k"] + largest["c2"]
    for step in _STEPS:
        if step * rate <= _STABLE:
            return step
    raise ValueError(f"smoothing = {smoothing:g} rad/s is too narrow for eta = {largest['eta']:g} rad/s2; type a larger one")


class Quantity(NamedTuple):
    """A parameter that can be an axis: its label, the range drawn by default, and how it enters a setting."""

    label: str
    low: float
    high: float
    enter: Callable[[Setting, Any], Setting]


QUANTITIES = {
    "c1": Quantity("gain c1 (1/s)", 0.2, 1.5, _of_gains("c1")),
    "c2": Quantity("gain c2 (1/s)", 1.0, 8.0, _of_gains("c2")),
    "z_u": Quantity("largest asked swing z_U (rad)", 0.05, 0.98, _of_gains("z_u")),
    "phi_z": Quantity("width Φ_z (rad/s)", 2.0, 20.0, _of_gains("phi_z")),
    "eta": Quantity("switching gain η (rad/s²)", 0.5, 10.0, _of_gains("eta")),
    "k": Quantity("reaching gain k (1/s)", 0.2, 10.0, _of_gains("k")),
    "pendulum_mass": Quantity("pendulum mass m_p (kg)", 0.5, 6.0, _of_robot("pendulum_mass")),
    "shell_mass": Quantity("shell mass m (kg)", 0.3, 4.0, _of_robot("shell_mass")),
    "gimbal_mass": Quantity("gimbal mass m_i (kg)", 0.3, 4.0, _of_robot("gimbal_mass")),
    "pendulum_length": Quantity("pendulum length l (m)", 0.03, 0.145, _of_robot("pendulum_length")),
    "mass_ratio": Quantity("pendulum mass / total mass", 0.05, 0.6, _mass_ratio),
    "length_ratio": Quantity("pendulum length / shell radius", 0.2, 0.95, _length_ratio),
    "torque_limit": Quantity("torque limit (N m)", 0.5, 4.0, _of_climb("torque_limit")),
    "travel": Quantity("travel (rad)", 1.0, 40.0, _of_climb("travel")),
    "push": Quantity("rate of the sphere at the start (rad/s)", -2.0, 2.0, _push),
    "slope": Quantity("slope γ (rad)", 0.0, 0.34, _slope),
}


class Axis(NamedTuple):
    """One axis of a map: the name of a quantity and evenly spaced values."""

    name: str
    values: np.ndarray

    @property
    def label(self) -> str:
        """Words and unit for a picture."""
        return QUANTITIES[self.name].label


def axis(name: str, count: int, low: float | None = None, high: float | None = None) -> Axis:
    """Axis of `count` values from `low` to `high`. Raises ValueError for an unknown name or an empty range."""
    require_choice("axis", name, tuple(QUANTITIES))
    require_count("size", count)
    quantity = QUANTITIES[name]
    first, last = (quantity.low if low is None else low), (quantity.high if high is None else high)
    require_scalar(f"{name} axis begins at", first)
    require_scalar(f"{name} axis ends at", last, above=first)
    return Axis(name, np.linspace(first, last, count))


class BoundMap(NamedTuple):
    """gamma* (rad) over two axes, rows along y: NaN where the flat is not climbed or the map was interrupted."""

    x: Axis
    y: Axis
    value: np.ndarray
    lower: np.ndarray  # seen to succeed, at most the tolerance below `upper`
    upper: np.ndarray  # seen to fail, or the bound (4)
    status: np.ndarray  # Status at `upper`, OK where that is the bound (4), -1 where not done
    rollouts: int
    seconds: float  # simulated in all of them
    finished: bool


def bound_map(setting: Setting, x: Axis, y: Axis, tolerance: float = 1e-3, progress: bool = True) -> BoundMap:
    """Find gamma* on the whole grid, in brackets of `tolerance` (rad), from coarse to fine.

    Each level halves the spacing. A new node is looked for around the mean of the neighbours known by then; both ends of its
    bracket are simulated all the same, and a guess that was wrong costs trials, not accuracy. Ctrl-C keeps what is done.
    """
    shape = (len(y.values), len(x.values))
    value, lower, upper = (np.full(shape, np.nan) for _ in range(3))
    status, done = np.full(shape, -1), np.zeros(shape, bool)
    run = js.over_queue(
        lambda xv, yv, guess: js.slope_search(_at(setting, (x, xv), (y, yv)).climb, tolerance, guess, setting.dtype)
    )
    rollouts, seconds = 0, 0.0
    finished = True
    with tqdm(total=value.size, desc="map", unit="bound", disable=not progress) as bar:
        try:
            for rows, columns, guess in _levels(value, done, _static_bounds(setting, x, y)):
                size = _chunk(len(rows))
                for start in range(0, len(rows), size):
                    part = slice(start, start + size)
                    r, c = rows[part], columns[part]
                    lanes = (x.values[c], y.values[r], guess[part])
                    found = _padded(run, size, *lanes)
                    value[r, c], status[r, c], done[r, c] = found.value, found.status, True
                    lower[r, c], upper[r, c] = found.lower, found.upper
                    rollouts += int(found.rollouts.sum())
                    seconds += float(found.seconds.sum())
                    bar.update(len(r))
        except KeyboardInterrupt:
            finished = False
    return BoundMap(x, y, value, lower, upper, status, rollouts, seconds, finished)


def _at(setting: Setting, *entries: tuple[Axis, Any]) -> Setting:
    for which, value in entries:
        setting = QUANTITIES[which.name].enter(setting, value)
    return setting


def _chunk(count: int) -> int:
    return next((size for size in _CHUNKS if count <= size), _CHUNKS[-1])


def _padded(run: Callable[..., Any], size: int, *lanes: np.ndarray) -> Any:
    """Run `lanes` with the last one repeated up to `size`, and return the results of the real ones on the host."""
    count = len(lanes[0])
    found = run(*(np.concatenate([leaf, np.repeat(leaf[-1:], size - count, axis=0)]) for leaf in lanes))
    return jax.tree.map(lambda leaf: np.asarray(leaf)[:count], found)


def confirm(setting: Setting, found: BoundMap, sample: int, seed: int = 0) -> tuple[int, int]:
    """Simulate the ends of random brackets in full: 60 s or what `duration` says, 1 ms, float64, no early decision.

    Returns how many of the ends turn out as the map says, and how many were asked.
    """
    rows, columns = np.nonzero(np.isfinite(found.value))
    chosen = np.random.default_rng(seed).permutation(len(rows))[:sample]
    r, c = rows[chosen], columns[chosen]
    climb = replace(setting.climb, dt=min(1e-3, setting.climb.dt), early=False)
    full = js.over_queue(lambda xv, yv, slope: _outcome(_at(Setting(climb, slope), (found.x, xv), (found.y, yv))))
    xv, yv = found.x.values[c], found.y.values[r]
    low = full(xv, yv, found.lower[r, c]).status == js.Status.OK
    # Nothing was seen to fail where the bracket ends at the bound (4).
    seen = found.status[r, c] != js.Status.OK
    high = full(xv, yv, found.upper[r, c]).status != js.Status.OK
    return int(low.sum() + (high & seen).sum()), int(len(r) + seen.sum())


def _static_bounds(setting: Setting, x: Axis, y: Axis) -> np.ndarray:
    """Steepest slope (rows, columns) that pendulum and motor hold statically: (4), and M g r sin(gamma) = torque limit."""

    def bound(xv: Any, yv: Any) -> Any:
        here = _at(setting, (x, xv), (y, yv))
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
        guess = _from_neighbours(value, 2 * stride) if done.any() else _FIRST_GUESS * static
        yield rows[new], columns[new], guess[rows[new], columns[new]]
        stride //= 2


def _from_neighbours(value: np.ndarray, stride: int) -> np.ndarray:
    """Interpolate the known nodes, `stride` apart, linearly to all nodes; 0 where the flat is not climbed around."""
    known = value[::stride, ::stride]
    places = [np.minimum(np.arange(side) / stride, count - 1.0) for side, count in zip(value.shape, known.shape, strict=True)]
    low = [np.floor(place).astype(int) for place in places]
    high = [np.minimum(first + 1, count - 1) for first, count in zip(low, known.shape, strict=True)]
    share = [place - first for place, first in zip(places, low, strict=True)]
    weights, total = np.zeros(value.shape), np.zeros(value.shape)
    for row, by_row in ((low[0], 1.0 - share[0]), (high[0], share[0])):
        for column, by_column in ((low[1], 1.0 - share[1]), (high[1], share[1])):
            corner, weight = known[np.ix_(row, column)], np.outer(by_row, by_column)
            weight = np.where(np.isnan(corner), 0.0, weight)
            weights += weight
            total += weight * np.nan_to_num(corner)
    return np.where(weights > 0.0, total / np.where(weights > 0.0, weights, 1.0), 0.0)


# Beyond the codes of `Status`: fails, and settles with an unlimited motor.
TORQUE_LIMITED = 8


class OutcomeMap(NamedTuple):
    """Status codes (or TORQUE_LIMITED) over two axes, rows along y, and which nodes were simulated."""

    x: Axis
    y: Axis
    outcome: np.ndarray
    simulated: np.ndarray


def outcome_map(setting: Setting, x: Axis, y: Axis, coarse: int | None = 16) -> OutcomeMap:
    """Find how every climb of the grid ends, refined where neighbours disagree; `coarse` = None simulates every node.

    A climb that fails under the torque limit is run again without it: where it then settles the motor is to blame.
    """
    limited = js.over_queue(lambda xv, yv: _outcome(_at(setting, (x, xv), (y, yv))))
    unlimited = js.over_queue(lambda xv, yv: _outcome(_of_climb("torque_limit")(_at(setting, (x, xv), (y, yv)), None)))
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
    count = len(lanes[0])
    size = _chunk(count)
    parts = [_padded(run, size, *(leaf[i : i + size] for leaf in lanes)) for i in range(0, count, size)]
    return np.concatenate([part.status for part in parts]).astype(np.int64)


def _outcome(setting: Setting) -> Any:
    return js.outcome_run(setting.climb, setting.slope, setting.dtype)
