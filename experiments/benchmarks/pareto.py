"""Pareto fronts against differential evolution: hypervolume for the same number of rollouts, all in one run.

Of the peers' every point that was ever evaluated is a candidate, of ours those that an iteration ended at; our rollouts are
counted as plain ones, every tangent, trial and scoring as one, while the scoring of scipy's points is not counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxsphere as js
import tuning
from experiments.plots.search import fronts_figure
from experiments.records import Record
from tuning import pareto

REFERENCE = np.array([8.0, 0.7, 60.0])  # s, rad, (N m)^2 s: worse than any useful gains
WEIGHTINGS = 24
POPULATION = 60
SWING, EFFORT = (0.01, 0.7), (1e-4, 0.3)
# Close to what the front shows: settling itself counts, chatter hardly does.
WEIGHTS = tuning.Weights(settling=1.0, chatter=0.1, prior=0.01)

Figures = Callable[[np.ndarray], np.ndarray]


def pareto_case(record: Record, lanes: int = 96, steps: int = 1000) -> dict[str, Any]:
    """Draw and compare fronts; `lanes` is the number of our weightings, `steps` the length of the tuning's rollouts."""
    objective = tuning.RestToRest(duration=steps * 8e-3, dt=8e-3, weights=WEIGHTS, overshoot_limit=0.018)
    begun = time.perf_counter()
    front = tuning.pareto_front(objective, js.SlidingModeGains(), points=lanes, swing=SWING, effort=EFFORT)
    fronts = {"jaxsphere": front.figures}
    seconds = {"jaxsphere": time.perf_counter() - begun}
    budget = front.plain_rollouts
    peers: dict[str, Callable[[], np.ndarray]] = {"differential evolution (GDE3)": lambda: generalised(objective, budget)}
    if find_spec("scipy"):
        peers["scipy differential evolution"] = lambda: scalarised(objective, budget)
    else:
        print("scipy is not installed; pip install 'jaxsphere[bench]' for its differential evolution")
    for name, search in peers.items():
        begun = time.perf_counter()
        points = search()
        seconds[name] = time.perf_counter() - begun
        fronts[name] = points[pareto.non_dominated(points)]
    print(f"Pareto fronts of settling, swing and effort, {budget} plain rollouts each ({front.rollouts} of ours with gradient)")
    print(f"  {'':<34}{'points':>8}{'hypervolume':>13}{'seconds':>9}")
    numbers: dict[str, Any] = {"plain_rollouts": budget, "gradient_rollouts": front.rollouts, "reference": REFERENCE.tolist()}
    for name, points in fronts.items():
        volume = pareto.hypervolume(points, REFERENCE)
        numbers[name] = {"points": len(points), "hypervolume": volume, "seconds": seconds[name]}
        print(f"  {name:<34}{len(points):>8}{volume:>13.2f}{seconds[name]:>9.1f}")
    record.picture("bench_pareto", fronts_figure("Pareto fronts for the same number of rollouts", fronts))
    return numbers


def _chosen() -> tuning.Parametrisation:
    limits = {name: tuning.bounded(*ends) for name, ends in tuning.BOUNDS.items()}
    return tuning.parametrise(js.SlidingModeGains(), transforms=limits)


def _scoring(objective: tuning.RestToRest) -> Figures:
    """Free vectors (n, 6) -> settling, swing and effort (n, 3), by the same function that scores our front."""
    chosen = _chosen()
    batch = js.batch(lambda vector: pareto.figures(objective, chosen.to_gains(vector)))
    return lambda vectors: np.asarray(batch(jnp.asarray(vectors)))


def generalised(objective: tuning.RestToRest, budget: int, seed: int = 0, score: Figures | None = None) -> np.ndarray:
    """Every point (budget, 3) that generalised differential evolution (GDE3, Kukkonen and Lampinen 2005) evaluates."""
    score = _scoring(objective) if score is None else score
    rng = np.random.default_rng(seed)
    size, high = len(_chosen().names), 0.5 * np.pi
    vectors = rng.uniform(-high, high, (POPULATION, size))
    values = score(vectors)
    archive = [values]
    for _ in range(max(0, budget // POPULATION - 1)):
        first, second, third = (vectors[rng.permutation(POPULATION)] for _ in range(3))
        mixed = rng.uniform(size=vectors.shape) < 0.9
        mixed[np.arange(POPULATION), rng.integers(size, size=POPULATION)] = True
        trials = np.clip(np.where(mixed, first + 0.5 * (second - third), vectors), -high, high)
        found = score(trials)
        archive.append(found)
        wins, loses = _dominates(found, values), _dominates(values, found) | ~np.isfinite(found[:, 0])
        vectors, values = np.where(wins[:, None], trials, vectors), np.where(wins[:, None], found, values)
        both = ~wins & ~loses
        vectors, values = np.concatenate([vectors, trials[both]]), np.concatenate([values, found[both]])
        kept = survivors(values, POPULATION)
        vectors, values = vectors[kept], values[kept]
    return np.concatenate(archive)


def _dominates(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.all(one <= other, axis=1) & np.any(one < other, axis=1)


def survivors(values: np.ndarray, count: int) -> np.ndarray:
    """Rows of `values` (n, d) that non-dominated sorting keeps, the last rank by its crowding distance."""
    left, kept = np.arange(len(values)), np.array([], int)
    while len(kept) < count:
        front = pareto.non_dominated(values[left])
        front = front if front.any() else np.ones(len(left), bool)
        rank, left = left[front], left[~front]
        room = count - len(kept)
        if len(rank) > room:
            rank = rank[np.argsort(-_crowding(values[rank]), kind="stable")[:room]]
        kept = np.concatenate([kept, rank])
    return kept


def _crowding(values: np.ndarray) -> np.ndarray:
    finite = np.nan_to_num(values, posinf=1e6)
    distance = np.zeros(len(values))
    for column in finite.T:
        order = np.argsort(column, kind="stable")
        spread = max(float(np.ptp(column)), 1e-300)
        distance[order[1:-1]] += (column[order[2:]] - column[order[:-2]]) / spread
        distance[order[[0, -1]]] = np.inf
    return distance


def scalarised(objective: tuning.RestToRest, budget: int, seed: int = 0) -> np.ndarray:
    """Every point that scipy's differential evolution evaluates on weightings like ours; scoring them is not counted."""
    from scipy import optimize

    chosen = _chosen()

    def value(vector: jax.Array, limit: jax.Array, weight: jax.Array) -> jax.Array:
        task = replace(objective, swing_limit=limit, weights=objective.weights._replace(torque=weight))
        found = task(chosen.to_gains(vector))
        return jnp.where(jnp.isfinite(found), found, 1e6)

    batch = js.batch(value)
    seen: list[np.ndarray] = []
    box = [(-0.5 * np.pi, 0.5 * np.pi)] * len(chosen.names)
    generations = max(1, budget // (WEIGHTINGS * POPULATION) - 1)
    cube = np.asarray(tuning.latin_hypercube(jax.random.key(seed), WEIGHTINGS, 2))
    for row, (one, two) in enumerate(cube):
        limit, weight = SWING[0] * (SWING[1] / SWING[0]) ** one, EFFORT[0] * (EFFORT[1] / EFFORT[0]) ** two

        def evaluate(columns: np.ndarray, limit: float = limit, weight: float = weight) -> np.ndarray:
            rows = np.atleast_2d(columns.T)
            seen.append(rows)
            return np.asarray(batch(jnp.asarray(rows), jnp.full(len(rows), limit), jnp.full(len(rows), weight)))

        settings: dict[str, Any] = {"maxiter": generations, "popsize": POPULATION // len(box), "tol": 0.0}
        optimize.differential_evolution(evaluate, box, rng=row, vectorized=True, updating="deferred", polish=False, **settings)
    return _scoring(objective)(np.concatenate(seen))
