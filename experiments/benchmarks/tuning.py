"""Tuning against other optimisers: rollouts until an objective value is reached, all on one task in one run.

Rollouts are counted in two ways: each one as one, with or without derivatives; and as plain ones, where every tangent that a
rollout carries counts as one more.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxsphere as js
import tuning
from experiments.plots.search import descent_figure
from experiments.records import Record
from tuning.starts import across

ITERATIONS = {"lm": 40, "lbfgs": 150, "adam": 150}
STARTS = 5
# To reach a value means to come this near to it: the last digits are no use to anyone.
NEAR = 1e-3
HORIZONS = (1, 4, 16)


class Trace(NamedTuple):
    """What one optimiser saw from one start: after so many rollouts, counted in both ways, this objective."""

    objective: np.ndarray
    rollouts: np.ndarray
    plain: np.ndarray
    seconds: float

    def until(self, value: float) -> tuple[float, float]:
        """Rollouts, counted in both ways, until the objective is at or below `value`; infinite if it never is."""
        reached = np.flatnonzero(self.objective <= value)
        return (float(self.rollouts[reached[0]]), float(self.plain[reached[0]])) if reached.size else (np.inf, np.inf)


def tuning_case(record: Record, lanes: int = 1200, steps: int = 1000) -> dict[str, Any]:
    """Tune by every optimiser; `lanes` bounds the rollouts of each of scipy's, `steps` is the rollout's length."""
    objective = tuning.RestToRest(duration=steps * 8e-3, dt=8e-3)
    numbers: dict[str, Any] = {"gradient_memory": gradient_memory(objective)}
    traces = ours(objective)
    if find_spec("scipy"):
        for name, found in scipys(objective, lanes).items():
            traces[name] = found
    else:
        print("scipy is not installed; pip install 'jaxsphere[bench]' for the comparison")
    table = {name: found[0] for name, found in traces.items()}
    numbers["from_table_3"] = {name: _totals(found) for name, found in table.items()}
    numbers["until_value_of_peer"] = against_peers(table)
    numbers["until_one_percent"] = until_one_percent(traces)
    title, best = "Tuning: objective against rollouts (tangents counted), from Table 3", dict(table)
    record.picture("bench_tuning", descent_figure(title, {n: (t.plain, t.objective) for n, t in best.items()}))
    return numbers


def gradient_memory(objective: tuning.RestToRest) -> dict[str, list[int]]:
    """Temporary memory (bytes) of the compiled gradient over 1, 4 and 16 times a quarter of the task's duration."""
    chosen = tuning.parametrise(js.SlidingModeGains())
    sizes: dict[str, list[int]] = {}
    print(f"temporary memory of a compiled gradient, bytes  {''.join(f'{f:>10}x' for f in HORIZONS)} the horizon")
    for gradient in ("forward", "reverse"):
        tasks = [replace(objective, duration=0.25 * objective.duration * factor) for factor in HORIZONS]
        lowered = [jax.jit(tuning.value_and_gradient(task, chosen, gradient)).lower(jnp.zeros(6)) for task in tasks]
        sizes[gradient] = [int(getattr(one.compile().memory_analysis(), "temp_size_in_bytes", 0)) for one in lowered]
        print(f"  {gradient:<46}{''.join(f'{size:>11}' for size in sizes[gradient])}")
    return sizes


def ours(objective: tuning.RestToRest) -> dict[str, list[Trace]]:
    """Traces of our optimisers from `STARTS` starts, the first of them Table 3; the seconds are those of all together."""
    traces = {}
    for name, iterations in ITERATIONS.items():
        begun = time.perf_counter()
        settings: dict[str, Any] = {"bounds": tuning.BOUNDS, "starts": STARTS, "progress": False}
        found = tuning.tune(objective, js.SlidingModeGains(), optimiser=name, iterations=iterations, **settings)
        seconds = time.perf_counter() - begun
        trials = tuning.levenberg_marquardt().trials if name == "lm" else 0
        before = np.arange(iterations)
        rollouts, plain = (before * (one + trials) + one for one in (1, 1 + len(found.names)))
        traces[f"jaxsphere {name}"] = [Trace(row, rollouts, plain, seconds) for row in found.history["objective"].T]
    return traces


def scipys(objective: tuning.RestToRest, budget: int) -> dict[str, list[Trace]]:
    """Traces of scipy's optimisers from the same starts; differential evolution has none and runs as often, by seed."""
    from scipy import optimize

    limits = {name: tuning.bounded(*ends) for name, ends in tuning.BOUNDS.items()}
    chosen = tuning.parametrise(js.SlidingModeGains(), transforms=limits)
    points = across(jax.random.key(0), chosen.to_vector(js.SlidingModeGains()), STARTS)
    evaluate = jax.jit(lambda free: objective(chosen.to_gains(free)))
    box = [(-0.5 * np.pi, 0.5 * np.pi)] * len(chosen.names)
    population = 10 * len(box)
    settings: dict[str, Any] = {"popsize": 10, "maxiter": max(1, budget // population - 1), "polish": False}

    def simplex(counted: Any, row: int) -> None:
        optimize.minimize(counted, points[row], method="Nelder-Mead", options={"maxfev": budget, "adaptive": True})

    def differences(counted: Any, row: int) -> None:
        optimize.minimize(counted, points[row], method="L-BFGS-B", bounds=box, options={"maxfun": budget})

    def evolution(counted: Any, row: int) -> None:
        optimize.differential_evolution(counted, box, rng=row, **settings)

    methods = {"Nelder-Mead": simplex, "L-BFGS-B, differences": differences, "differential evolution": evolution}
    return {f"scipy {name}": [_trace(evaluate, method, row) for row in range(STARTS)] for name, method in methods.items()}


def _trace(evaluate: Callable[[Any], Any], method: Callable[[Any, int], None], row: int) -> Trace:
    seen: list[float] = []

    def counted(vector: np.ndarray) -> float:
        value = float(evaluate(jnp.asarray(vector)))
        seen.append(value if np.isfinite(value) else 1e6)
        return seen[-1]

    begun = time.perf_counter()
    method(counted, row)
    count = np.arange(1, len(seen) + 1)
    return Trace(np.array(seen), count, count, time.perf_counter() - begun)


def _totals(found: Trace) -> dict[str, float]:
    rollouts, plain = found.until(float(np.nanmin(found.objective)))
    return {"best": float(np.nanmin(found.objective)), "rollouts": rollouts, "plain_rollouts": plain, "seconds": found.seconds}


def against_peers(table: dict[str, Trace]) -> dict[str, Any]:
    """Print, for the value each peer ended at, what it and our optimisers needed to come near it."""
    print(f"\nfrom Table 3: rollouts until within {100 * NEAR:g} % of the value at which each peer ended")
    print(f"  {'optimiser':<32}{'best':>9}{'seconds':>9}")
    for name, found in table.items():
        note = f" (all {STARTS} starts, compilation included)" if _is_ours(name) else ""
        print(f"  {name:<32}{float(np.nanmin(found.objective)):>9.4f}{found.seconds:>9.1f}{note}")
    numbers: dict[str, Any] = {}
    print(
        f"  {'peer':<32}{'value':>10}{'its rollouts':>14}{'ours':>18}{'rollouts':>10}{'share':>7}{'as plain':>10}{'share':>7}"
    )
    for peer, name in _pairs(table):
        level = (1.0 + NEAR) * float(np.nanmin(table[peer].objective))
        theirs, (rollouts, plain) = table[peer].until(level)[0], table[name].until(level)
        numbers.setdefault(peer, {"value": level, "rollouts": theirs})[name] = {"rollouts": rollouts, "as_plain": plain}
        shares = (_share(rollouts, theirs), _share(plain, theirs))
        row = f"  {peer:<32}{level:>10.4f}{theirs:>14.0f}{name:>18}{_shown(rollouts):>10}{shares[0]:>7}"
        print(f"{row}{_shown(plain):>10}{shares[1]:>7}")
    return numbers


def _pairs(table: dict[str, Any]) -> Iterator[tuple[str, str]]:
    return ((peer, name) for peer in table if not _is_ours(peer) for name in table if _is_ours(name))


def until_one_percent(traces: dict[str, list[Trace]]) -> dict[str, Any]:
    """Print the median over the starts of the rollouts until within 1 % of the best value that any optimiser found."""
    level = 1.01 * min(float(np.nanmin(one.objective)) for found in traces.values() for one in found)
    print(f"\nrollouts until within 1 % of the best of all ({level / 1.01:.4f}): median of {STARTS} starts, how many get there")
    print(f"  {'optimiser':<32}{'rollouts':>10}{'as plain':>10}{'get there':>11}{'from Table 3: rollouts':>25}{'as plain':>10}")
    numbers = {}
    for name, found in traces.items():
        counts = np.array([one.until(level) for one in found])
        # The upper of two middle ones, so that a start that never gets there cannot be averaged away.
        rollouts, plain = np.sort(counts, axis=0)[len(counts) // 2]
        arrived = int(np.isfinite(counts[:, 0]).sum())
        numbers[name] = {"rollouts": rollouts, "as_plain": plain, "arrived": arrived, "from_table_3": counts[0].tolist()}
        first = f"{_shown(counts[0, 0]):>25}{_shown(counts[0, 1]):>10}" if "evolution" not in name else f"{'-':>25}{'-':>10}"
        print(f"  {name:<32}{_shown(rollouts):>10}{_shown(plain):>10}{arrived:>6} of {STARTS}{first}")
    return numbers


def _is_ours(name: str) -> bool:
    return name.startswith("jaxsphere")


def _share(one: float, other: float) -> str:
    return "-" if not np.isfinite(one) else f"1/{other / one:.1f}"


def _shown(count: float) -> str:
    return "never" if not np.isfinite(count) else f"{count:.0f}"
