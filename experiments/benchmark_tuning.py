"""Tuning against other optimisers: rollouts until an objective value is reached, all on one task in one run."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxsphere as js
import tuning
from experiments import plotting
from experiments.records import Record

OURS = {"lm": 80, "lbfgs": 150, "adam": 150}


def tuning_case(record: Record, lanes: int = 1200, steps: int = 1000) -> dict[str, Any]:
    """Tune from Table 3 by every optimiser; `lanes` bounds the rollouts of each of scipy's, `steps` is the rollout's length."""
    initial = js.SlidingModeGains()
    objective = tuning.RestToRest(duration=steps * 8e-3, dt=8e-3)
    free = {name: tuning.bounded(*ends) for name, ends in tuning.BOUNDS.items()}
    chosen = tuning.parametrise(initial, transforms=free)
    settings: dict[str, Any] = {"bounds": tuning.BOUNDS, "progress": False}
    ours = {name: tuning.tune(objective, initial, optimiser=name, iterations=n, **settings) for name, n in OURS.items()}
    traces = {f"jaxsphere {name}": found.history["objective"][:, 0] for name, found in ours.items()}
    if find_spec("scipy"):
        traces |= _scipy(jax.jit(lambda free: objective(chosen.to_gains(free))), chosen.to_vector(initial), lanes)
    else:
        print("  scipy is not installed; pip install 'jaxsphere[bench]' for the comparison")

    cost = {name: 1 + len(chosen.names) if name.startswith("jaxsphere") else 1 for name in traces}
    best = {name: float(np.nanmin(trace)) for name, trace in traces.items()}
    numbers: dict[str, Any] = {}
    print(f"{'optimiser':<28}{'best':>10}{'rollouts':>10}{'  until scipy best: with gradient':>34}{'as plain ones':>15}")
    others = [best[name] for name in traces if not name.startswith("jaxsphere")]
    for name, trace in traces.items():
        reached = _until(trace, min(others)) if others and cost[name] > 1 else None
        plain = None if reached is None else reached * cost[name]
        numbers[name] = {"best": best[name], "evaluations": len(trace), "until_best_of_scipy": reached, "as_plain": plain}
        print(f"{name:<28}{best[name]:>10.4f}{len(trace):>10}{_shown(reached):>34}{_shown(plain):>15}")
    levels = {
        name: _until(traces[f"jaxsphere {name}"], 1.01 * min(found.objective for found in ours.values())) for name in ours
    }
    print("gradient rollouts until within 1 % of our best:", ", ".join(f"{name} {_shown(n)}" for name, n in levels.items()))
    picture = plotting.bars_figure("Best objective found from Table 3", list(best), list(best.values()), "objective")
    record.picture("bench_tuning", picture)
    return numbers | {"until_one_percent": levels}


def _until(trace: np.ndarray, value: float) -> int | None:
    reached = np.flatnonzero(trace <= value)
    return int(reached[0]) + 1 if reached.size else None


def _shown(count: int | None) -> str:
    return "never" if count is None else str(count)


def _scipy(evaluate: Callable[[Any], Any], start: Any, budget: int) -> dict[str, np.ndarray]:
    from scipy import optimize

    seen: list[float] = []

    def counted(vector: np.ndarray) -> float:
        value = float(evaluate(jnp.asarray(vector)))
        seen.append(value if np.isfinite(value) else 1e6)
        return seen[-1]

    def trace(run: Callable[[], Any]) -> np.ndarray:
        seen.clear()
        run()
        return np.array(seen)

    box = [(-0.5 * np.pi, 0.5 * np.pi)] * len(start)
    point, generations = np.asarray(start), max(1, budget // (10 * len(start)) - 1)
    return {
        "scipy Nelder-Mead": trace(
            lambda: optimize.minimize(counted, point, method="Nelder-Mead", options={"maxfev": budget, "adaptive": True})
        ),
        "scipy L-BFGS-B, differences": trace(
            lambda: optimize.minimize(counted, point, method="L-BFGS-B", bounds=box, options={"maxfun": budget})
        ),
        "scipy differential evolution": trace(
            lambda: optimize.differential_evolution(counted, box, popsize=10, maxiter=generations, polish=False, rng=0)
        ),
    }
