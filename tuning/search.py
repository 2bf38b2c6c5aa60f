"""The tuner: many starts of one optimiser, all in one compiled program, with a progress bar between chunks."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from tqdm.auto import tqdm

import jaxsphere as js
from jaxsphere.checks import require_choice, require_count, require_scalar
from jaxsphere.identity import described, fingerprint_of
from jaxsphere.simulation.closed_loop import where
from tuning import checkpoint as checkpoints
from tuning import starts as drawn
from tuning.objectives.objective import Members, Objective, members_of
from tuning.optimisers.adam import adam, cosine_decay
from tuning.optimisers.lbfgs import lbfgs
from tuning.optimisers.levenberg_marquardt import levenberg_marquardt, linearise
from tuning.optimisers.optimiser import Optimiser
from tuning.result import TuningResult
from tuning.transforms import GRADIENTS, Parametrisation, Transform, bounded, parametrise, value_and_gradient

_ITERATIONS = {"adam": 150, "lbfgs": 60, "lm": 35}


class _Start(NamedTuple):
    """Where one start of the search is."""

    vector: Array
    optimiser: Any
    best_vector: Array
    best: Array
    done: Array  # iterations


class _Search(NamedTuple):
    """What is searched, and how."""

    objective: Objective
    members: Members
    initial_gains: Any
    chosen: Parametrisation
    rule: Optimiser
    label: str
    gradient: str
    iterations: int

    def stage_of(self, done: Array) -> Array:
        """Return the stage that the iteration after `done` ones belongs to."""
        return jnp.clip(done * self.members.stages // self.iterations, 0, self.members.stages - 1)

    def see(self, vector: Array, stage: Array) -> Any:
        """Return what the optimiser needs at a vector, its first two entries the value and the gradient."""
        objective = self.members.stage(stage)
        if self.rule.needs != "residuals":
            return value_and_gradient(objective, self.chosen, self.gradient)(vector)
        residuals, cap = members_of(objective).residuals, self.members.largest_residual_gradient
        if residuals is None:
            raise ValueError("optimiser = 'lm' needs residuals, which this objective has not; type optimiser='lbfgs' or 'adam'")
        return linearise(lambda free: residuals(self.chosen.to_gains(free)), vector, cap)

    def judge(self, stage: Array, gains: Any) -> Array:
        """Return what the search makes small: the objective of a stage, or its residuals where the optimiser needs them."""
        objective = self.members.stage(stage)
        residuals = members_of(objective).residuals
        return residuals(gains) if residuals is not None and self.rule.needs == "residuals" else objective(gains)


def tune(
    objective: Objective,
    initial_gains: Any,
    *,
    optimiser: str | Optimiser | tuple[Any, Any] = "adam",
    iterations: int | None = None,
    learning_rate: float = 0.1,
    starts: int = 1,
    spread: float = 0.5,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    seed: int = 0,
    frozen: Sequence[str] = (),
    transforms: Mapping[str, Transform | None] | None = None,
    gradient: str = "forward",
    chunk: int = 10,
    progress: bool = True,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
) -> TuningResult:
    """Make an objective small by gradients from one or many starts.

    Args:
        objective: gains -> scalar, differentiable, e.g. `tuning.RestToRest(...)`; what else it may offer is in `Members`.
        initial_gains: the first start.
        optimiser: "adam", "lbfgs", "lm" (Levenberg-Marquardt) or a pair (init, update).
        iterations: per start, one rollout with gradient each; 150, 60 or 35 by default.
        learning_rate: of Adam in the free coordinates (about relative change per step), decaying along a cosine.
        starts: how many; all but the first are a Latin hypercube, over `bounds` if every free gain has them, else normal around
            the first.
        spread: standard deviation of the latter in free coordinates.
        bounds: name -> lowest and highest value, kept by construction.
        seed: of the starts.
        frozen: gains to keep.
        transforms: as in `parametrise`.
        gradient: "forward" or "reverse", as in `value_and_gradient`.
        chunk: iterations between two progress reports.
        progress: show a bar.
        checkpoint: file, written after every chunk.
        resume: continue from it. More iterations than before are allowed where nothing is scheduled over them.

    Returns:
        The best gains of the starts that keep the objective's limits, or of all where none does.

    Raises:
        ValueError: an argument is not admissible, the objective is no scalar or not finite at `initial_gains`, or the
            checkpoint is of another problem.
    """
    require_count("starts", starts)
    require_count("chunk", chunk)
    require_scalar("spread", spread, above=0.0, or_equal=True)
    if resume and checkpoint is None:
        raise ValueError("resume = True needs a file; type checkpoint='tuning.npz'")
    limits = {name: bounded(low, high) for name, (low, high) in (bounds or {}).items()}
    chosen = parametrise(initial_gains, frozen, dict(transforms or {}) | limits)
    rule, label, iterations = _optimiser(optimiser, learning_rate, iterations)
    search = _Search(objective, members_of(objective), initial_gains, chosen, rule, label, gradient, iterations)
    first = _checked(search)
    key = jax.random.key(seed)
    inside = bool(limits) and set(chosen.names) <= set(limits)
    vectors = drawn.across(key, first, starts) if inside else drawn.around(key, first, starts, spread)
    best, done = jnp.full((starts,), jnp.inf, float), jnp.zeros((starts,), int)
    batch = _Start(vectors, jax.vmap(rule.init)(vectors), vectors, best, done)
    history = {name: np.zeros((0, starts)) for name in ("objective", "gradient_norm")}
    problem = {}
    if checkpoint is not None:
        drawn_by = {"initial_gains": initial_gains, "starts": starts, "spread": spread, "bounds": bounds, "seed": seed}
        problem = _identity(search, first) | described(drawn_by)
        if resume:
            batch, history = checkpoints.load(checkpoint, problem, batch, partial(_bests, search))
    save = None if checkpoint is None else partial(checkpoints.save, checkpoint, problem)
    return _select(search, *_iterate(search, batch, history, chunk, progress, save))


def _optimiser(asked: Any, learning_rate: float, iterations: int | None) -> tuple[Optimiser, str, int]:
    label = asked if isinstance(asked, str) else "custom"
    iterations = _ITERATIONS.get(label, 150) if iterations is None else iterations
    require_count("iterations", iterations)
    require_scalar("learning_rate", learning_rate, above=0.0)
    if isinstance(asked, str):
        require_choice("optimiser", asked, tuple(_ITERATIONS))
        known = {"lbfgs": lbfgs, "lm": levenberg_marquardt, "adam": lambda: adam(cosine_decay(learning_rate, iterations))}
        return known[asked](), label, iterations
    if isinstance(asked, Optimiser):
        return asked, label, iterations
    if type(asked) is not tuple or len(asked) != 2 or not all(map(callable, asked)):
        raise ValueError(f"optimiser = {asked!r} is none; type one of {', '.join(_ITERATIONS)}, or a pair (init, update)")
    return Optimiser(*asked), label, iterations


def _checked(search: _Search) -> Float[Array, " n"]:
    """Free vector of the initial gains. Raises ValueError for an objective that cannot be searched like this."""
    require_choice("gradient", search.gradient, GRADIENTS)
    first, members = search.chosen.to_vector(search.initial_gains), search.members
    if members.check is not None:
        members.check()
    if search.iterations < members.stages:
        raise ValueError(
            f"iterations = {search.iterations} does not reach the last of {members.stages} stages; type at least "
            f"{members.stages}"
        )
    if search.rule.needs != "residuals":  # whose squares sum to a scalar whatever they are
        shape = jax.eval_shape(lambda vector: members.stage(0)(search.chosen.to_gains(vector)), first).shape
        if shape != ():
            raise ValueError(f"objective returns shape {shape}; return one scalar")
    return first


def _identity(search: _Search, vector: Array) -> dict[str, Any]:
    """What two searches share when they solve the same problem in the same way: traced programs, and plain settings."""
    rule, members = search.rule, search.members

    def shown(vector: Array) -> Any:  # an update on a bowl has every constant of the optimiser in it
        bowl = {"value": (jnp.sum(vector**2), vector), "gradient": vector}
        return rule.update(bowl.get(rule.needs, linearise(jnp.sin, vector)), rule.init(vector), vector)

    return {
        "objective": fingerprint_of(search.judge, jnp.zeros((), int), search.chosen.to_gains(vector)),
        "transforms": fingerprint_of(search.chosen.to_gains, vector),
        "optimiser": fingerprint_of(shown, vector),
        "largest_residual_gradient": str(members.largest_residual_gradient),
        "gradient": search.gradient,
        # Stages and Adam's rate are spread over the iterations.
        "iterations": search.iterations if members.stages > 1 or search.label == "adam" else "any",
    }


def _bests(search: _Search, batch: _Start) -> Array:
    """Objective at the best vectors, of the stage that the last iteration belonged to."""
    stage = search.stage_of(jnp.max(jnp.asarray(batch.done)) - 1)

    def value(vector: Array) -> Array:
        seen = search.judge(stage, search.chosen.to_gains(vector))
        return jnp.sum(seen * seen) if search.rule.needs == "residuals" else seen

    return js.batch(value)(batch.best_vector)


def _step(search: _Search, start: _Start, _: None) -> tuple[_Start, tuple[Array, Array]]:
    """One iteration of one start; it tells the objective and the norm of its gradient."""
    rule, stage = search.rule, search.stage_of(start.done)
    if search.members.stages > 1:  # a new stage resets the best value and the optimiser's state
        again = start._replace(
            vector=start.best_vector, optimiser=rule.init(start.best_vector), best=jnp.full_like(start.best, jnp.inf)
        )
        start = where(stage != search.stage_of(start.done - 1), again, start)
    seen = search.see(start.vector, stage)
    value, slope = seen[:2]
    active = start.done < search.iterations
    better = active & (value < start.best)
    moved = rule.update(slope if rule.needs == "gradient" else seen, start.optimiser, start.vector)
    vector, state = where(active, moved, (start.vector, start.optimiser))
    best_vector, best = where(better, (start.vector, value), (start.best_vector, start.best))
    return _Start(vector, state, best_vector, best, start.done + active), (value, jnp.sqrt(jnp.sum(slope * slope)))


def _iterate(
    search: _Search, batch: _Start, history: dict[str, np.ndarray], chunk: int, progress: bool, save: Callable[..., Any] | None
) -> tuple[_Start, dict[str, np.ndarray], str]:
    """Run all iterations that are left; Ctrl-C ends them once something is known."""
    run = js.batch(lambda start: jax.lax.scan(partial(_step, search), start, None, length=chunk))
    first, last = len(history["objective"]), search.iterations
    with tqdm(total=last, desc="tuning", unit="step", disable=not progress, initial=first) as bar:
        try:
            for done in range(first, last, chunk):
                batch, rows = run(batch)
                count = min(chunk, last - done)
                added = zip(history.items(), rows, strict=True)
                history = {name: np.concatenate([old, np.asarray(new).T[:count]]) for (name, old), new in added}
                if not all(np.isfinite(values[0, 0]) for values in history.values()):
                    raise ValueError(_not_finite(search, history))
                if save is not None:
                    save(batch, history)
                bar.update(count)
                bar.set_postfix(best=f"{float(jnp.min(batch.best)):.4g}")
        except KeyboardInterrupt:
            if not history["objective"].size:
                raise
            return batch, history, "interrupted"
    return batch, history, "finished"


def _select(search: _Search, batch: _Start, history: dict[str, np.ndarray], status: str) -> TuningResult:
    """The best start that keeps the limits, and how the search ended."""
    answers, bests = jax.vmap(search.chosen.to_gains)(batch.best_vector), np.asarray(batch.best)
    last = search.members.stage(search.members.stages - 1)
    judge = members_of(last).limits
    limits = None if judge is None else jax.tree.map(np.asarray, js.batch(judge)(answers))
    feasible = np.ones(bests.shape, bool) if limits is None else np.asarray(limits.feasible)
    if status == "finished" and not np.any(history["gradient_norm"] > 0.0):
        status = "zero gradient"
    elif status == "finished" and not feasible.any():
        status = "infeasible"
    winner = int(np.nanargmin(np.where(feasible | ~feasible.any(), bests, np.inf)))
    before = history["objective"][0, 0] if search.members.stages == 1 else jax.jit(last)(search.initial_gains)
    return TuningResult(
        gains=jax.tree.map(lambda leaf: float(leaf[winner]), answers),
        objective=float(bests[winner]),
        initial_gains=jax.tree.map(float, search.initial_gains),
        initial_objective=float(before),
        history=history,
        status=status,
        names=search.chosen.names,
        evaluations=int(history["objective"].size),
        optimiser=search.label,
        bests=np.where(np.isfinite(bests), bests, np.nan),
        answers={name: np.broadcast_to(np.asarray(value, float), bests.shape) for name, value in vars(answers).items()},
        feasible=feasible,
        limits="" if limits is None else jax.tree.map(lambda leaf: leaf[winner], limits).sentence(),
    )


def _not_finite(search: _Search, history: dict[str, np.ndarray]) -> str:
    values = history["objective"][0]
    if np.isfinite(values[0]):
        return (
            "the gradient at initial_gains is not finite though the objective is; type another initial_gains, or a smoother "
            "objective, e.g. a larger smoothing"
        )
    explain = search.members.explain
    cause = f" ({explain(search.initial_gains)})" if explain is not None else ""
    return (
        f"objective = {values[0]} at initial_gains{cause}, and it is finite at {int(np.sum(np.isfinite(values)))} of "
        f"{values.size} starts; type another initial_gains, or mend that term"
    )
