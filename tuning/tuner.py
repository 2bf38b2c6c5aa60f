"""The tuner: many starts of one optimiser, all in one compiled program, with a progress bar between chunks."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from tqdm.auto import tqdm

import jaxsphere as js
from jaxsphere.checks import require_choice, require_count, require_scalar
from tuning import checkpoint as checkpoints
from tuning import starts as drawn
from tuning.optimisers import Optimiser, adam, cosine_decay
from tuning.result import TuningResult
from tuning.second_order import lbfgs, levenberg_marquardt, linearise
from tuning.transforms import Parametrisation, Transform, bounded, parametrise

Objective = Callable[[Any], Array]
GRADIENTS = ("forward", "reverse")
OPTIMISERS = ("adam", "lbfgs", "lm")
_ITERATIONS = {"adam": 150, "lbfgs": 60, "lm": 35}


class _Start(NamedTuple):
    vector: Array
    optimiser: Any
    best_vector: Array
    best: Array
    done: Array  # iterations


def value_and_gradient(
    objective: Objective, chosen: Parametrisation, gradient: str = "forward"
) -> Callable[[Array], tuple[Array, Array]]:
    """Return vector (n,) -> (objective, its gradient (n,)) in the free coordinates of `chosen`.

    Forward mode pushes the n unit vectors through the rollout: no memory in the horizon, best for a few gains. Reverse mode
    costs the same for any number of gains and recomputes each saved block of the rollout.
    """
    require_choice("gradient", gradient, GRADIENTS)

    def of_vector(vector: Array) -> Array:
        return objective(chosen.to_gains(vector))

    def forward(vector: Array) -> tuple[Array, Array]:
        def push(direction: Array) -> tuple[Array, Array]:
            return jax.jvp(of_vector, (vector,), (direction,))

        return jax.vmap(push, out_axes=(None, 0))(jnp.eye(vector.size, dtype=vector.dtype))

    return forward if gradient == "forward" else jax.value_and_grad(of_vector)


def tune(
    objective: Objective,
    initial_gains: Any,
    *,
    optimiser: str | Optimiser = "adam",
    iterations: int | None = None,
    learning_rate: float = 0.1,
    starts: int = 1,
    spread: float = 0.5,
    bounds: dict[str, tuple[float, float]] | None = None,
    seed: int = 0,
    frozen: Sequence[str] = (),
    transforms: Mapping[str, Transform | None] | None = None,
    gradient: str = "forward",
    chunk: int = 10,
    progress: bool = True,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
) -> TuningResult:
    """Make `objective(gains)` small by gradients from one or many starts.

    Args:
        objective: gains -> scalar, differentiable, e.g. `tuning.RestToRest(...)`, or `tuning.Annealed(...)` of one, whose
        stages share the iterations. Its `limits(gains)`, where it has them, decide which starts ended feasible; the best of
        those wins. initial_gains: the first start.
        optimiser: "adam", "lbfgs", "lm" (Levenberg-Marquardt; the objective then needs `residuals(gains) -> (m,)`, whose
        squares sum to it, and may have `steepest`, see `linearise`) or a pair (init, update).
        iterations: per start, one rollout with gradient each; 150, 60 or 35 by default. learning_rate: of Adam in the free
        coordinates (about relative change per step), decaying along a cosine.
        starts: how many, by Latin hypercube, all but the first: over `bounds` (name -> lowest and highest value, kept by
        construction) for the gains that have them all, otherwise normal around the first with the standard deviation
        `spread` in free coordinates, from `seed`. frozen: gains to keep. transforms: see `parametrise`.
        gradient: "forward" or "reverse". chunk: iterations between two progress reports. checkpoint: file, written after
        every chunk. resume: continue from it.

    Raises:
        ValueError: an argument is not admissible, the objective is no scalar or not finite at `initial_gains`, or the
        checkpoint is of another problem.
    """
    if isinstance(optimiser, str):
        require_choice("optimiser", optimiser, OPTIMISERS)
    require_choice("gradient", gradient, GRADIENTS)
    label = optimiser if isinstance(optimiser, str) else "custom"
    iterations = _ITERATIONS.get(label, 150) if iterations is None else iterations
    for name, value in (("iterations", iterations), ("starts", starts), ("chunk", chunk)):
        require_count(name, value)
    require_scalar("learning_rate", learning_rate, above=0.0)
    require_scalar("spread", spread, above=0.0, or_equal=True)
    if resume and checkpoint is None:
        raise ValueError("resume = True needs a file; type checkpoint='tuning.npz'")
    limits = {name: bounded(low, high) for name, (low, high) in (bounds or {}).items()}
    chosen = parametrise(initial_gains, frozen, dict(transforms or {}) | limits)
    first = chosen.to_vector(initial_gains)
    rule = optimiser if isinstance(optimiser, Optimiser) else _named_optimiser(label, learning_rate, iterations)
    getattr(objective, "check", lambda: None)()
    stages, at = getattr(objective, "stages", 1), getattr(objective, "stage", lambda _: objective)
    if iterations < stages:
        raise ValueError(f"iterations = {iterations} does not reach the last of {stages} stages; type at least {stages}")

    def evaluate(vector: Array, stage: Array) -> Any:
        return _evaluator(at(stage), chosen, gradient, rule.needs)(vector)

    if rule.needs != "residuals":  # whose squares sum to a scalar whatever they are
        shape = jax.eval_shape(lambda vector: at(0)(chosen.to_gains(vector)), first).shape
        if shape != ():
            raise ValueError(f"objective returns shape {shape}; return one scalar")

    key = jax.random.key(seed)
    inside = bool(limits) and set(chosen.names) <= set(limits)
    vectors = drawn.across(key, first, starts) if inside else drawn.around(key, first, starts, spread)
    problem = checkpoints.describe(
        {"objective": objective, "initial_gains": initial_gains, "optimiser": label, "iterations": iterations}
        | {"learning_rate": learning_rate, "starts": starts, "spread": spread, "bounds": bounds, "seed": seed}
        | {"names": chosen.names, "gradient": gradient}
    )

    def iterate(start: _Start, _: None) -> tuple[_Start, tuple[Array, Array]]:
        stage, before = (jnp.clip(done * stages // iterations, 0, stages - 1) for done in (start.done, start.done - 1))
        if stages > 1:  # what is known of another objective counts for nothing
            fresh = stage != before
            again = start._replace(
                vector=start.best_vector, optimiser=rule.init(start.best_vector), best=jnp.full_like(start.best, jnp.inf)
            )
            start = jax.tree.map(lambda new, old: jnp.where(fresh, new, old), again, start)
        seen = evaluate(start.vector, stage)
        value, slope = seen[:2]
        active = start.done < iterations
        better = active & (value < start.best)
        vector, state = jax.tree.map(
            lambda new, old: jnp.where(active, new, old),
            rule.update(slope if rule.needs == "gradient" else seen, start.optimiser, start.vector),
            (start.vector, start.optimiser),
        )
        best = jnp.where(better, value, start.best)
        after = _Start(vector, state, jnp.where(better, start.vector, start.best_vector), best, start.done + 1)
        return after, (value, jnp.sqrt(jnp.sum(slope * slope)))

    run = js.batch(lambda start: jax.lax.scan(iterate, start, None, length=chunk))
    batch = _Start(
        vectors, jax.vmap(rule.init)(vectors), vectors, jnp.full((starts,), jnp.inf, float), jnp.zeros((starts,), int)
    )
    history = {name: np.zeros((0, starts)) for name in ("objective", "gradient_norm")}
    if resume and checkpoint is not None:
        batch, history = checkpoints.load(checkpoint, problem, batch)
    status = "finished"
    with tqdm(total=iterations, desc="tuning", unit="step", disable=not progress, initial=len(history["objective"])) as bar:
        try:
            for done in range(len(history["objective"]), iterations, chunk):
                batch, (values, norms) = run(batch)
                count = min(chunk, iterations - done)
                new = {"objective": values, "gradient_norm": norms}
                history = {n: np.concatenate([rows, np.asarray(new[n]).T[:count]]) for n, rows in history.items()}
                if not (np.isfinite(history["objective"][0, 0]) and np.isfinite(history["gradient_norm"][0, 0])):
                    raise ValueError(_not_finite(objective, initial_gains, history))
                if checkpoint is not None:
                    checkpoints.save(checkpoint, problem, batch, history)
                bar.update(count)
                bar.set_postfix(best=f"{float(jnp.min(batch.best)):.4g}")
        except KeyboardInterrupt:
            status = "interrupted"
            if not history["objective"].size:
                raise
    answers = jax.vmap(chosen.to_gains)(batch.best_vector)
    bests = np.asarray(batch.best)
    judge = getattr(at(stages - 1), "limits", None)
    limits = None if judge is None else jax.tree.map(np.asarray, js.batch(judge)(answers))
    feasible = np.ones(starts, bool) if limits is None else np.asarray(limits.feasible)
    if status == "finished" and not feasible.any():
        status = "infeasible"
    winner = int(np.nanargmin(np.where(feasible | ~feasible.any(), bests, np.inf)))
    return TuningResult(
        gains=jax.tree.map(lambda leaf: float(leaf[winner]), answers),
        objective=float(bests[winner]),
        initial_gains=jax.tree.map(float, initial_gains),
        initial_objective=float(history["objective"][0, 0] if stages == 1 else jax.jit(at(stages - 1))(initial_gains)),
        history=history,
        status=status,
        names=chosen.names,
        evaluations=int(history["objective"].size),
        optimiser=label,
        bests=np.where(np.isfinite(bests), bests, np.nan),
        answers={name: np.broadcast_to(np.asarray(value, float), (starts,)) for name, value in vars(answers).items()},
        feasible=feasible,
        limits="" if limits is None else jax.tree.map(lambda leaf: leaf[winner], limits).sentence(),
    )


def _named_optimiser(name: str, learning_rate: float, iterations: int) -> Optimiser:
    if name == "lbfgs":
        return lbfgs()
    return levenberg_marquardt() if name == "lm" else adam(cosine_decay(learning_rate, iterations))


def _evaluator(objective: Objective, chosen: Parametrisation, gradient: str, needs: str) -> Callable[[Array], Any]:
    evaluate = value_and_gradient(objective, chosen, gradient)
    if needs != "residuals":
        return evaluate
    residuals = getattr(objective, "residuals", None)
    if residuals is None:
        raise ValueError("optimiser = 'lm' needs residuals, which this objective has not; type optimiser='lbfgs' or 'adam'")
    steepest = getattr(objective, "steepest", math.inf)
    return lambda vector: linearise(lambda free: residuals(chosen.to_gains(free)), vector, steepest)


def _not_finite(objective: Objective, gains: Any, history: dict[str, np.ndarray]) -> str:
    values, starts = history["objective"][0], history["objective"].shape[1]
    if np.isfinite(values[0]):
        return (
            "the gradient at initial_gains is not finite though the objective is; type another initial_gains, or a smoother "
            "objective, e.g. a larger smoothing"
        )
    explain = getattr(objective, "explain", None)
    cause = f" ({explain(gains)})" if explain is not None else ""
    others = int(np.sum(np.isfinite(values)))
    return (
        f"objective = {values[0]} at initial_gains{cause}, and it is finite at {others} of {starts} starts; type another "
        "initial_gains, or mend that term"
    )
