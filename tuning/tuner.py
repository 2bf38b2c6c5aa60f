"""The tuner: many starts of one optimiser, all in one compiled program, with a progress bar between chunks."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from tqdm.auto import tqdm

from jaxsphere import SlidingModeGains, TrackingGains
from jaxsphere.checks import require_choice, require_count, require_scalar
from jaxsphere.files import to_plain, write_json
from jaxsphere.simulation.lanes import over_lanes
from tuning.optimisers import Optimiser, adam, cosine_decay
from tuning.transforms import Parametrisation, Transform, parametrise

Objective = Callable[[Any], Array]
GRADIENTS = ("forward", "reverse")
FORMAT = 1
_GAINS = {kind.__name__: kind for kind in (SlidingModeGains, TrackingGains)}


class _Start(NamedTuple):
    vector: Array
    optimiser: Any
    best_vector: Array
    best: Array
    left: Array  # iterations still to do


@dataclass(frozen=True, eq=False)
class TuningResult:
    """What tuning found.

    gains: the best gains seen in any start; objective: their value. initial_gains, initial_objective: where it began.
    history: "objective" and "gradient_norm", each (iterations, starts). status: "finished" or "interrupted" (by Ctrl-C).
    names: the free gains. evaluations: rollouts with gradient.
    """

    gains: Any
    objective: float
    initial_gains: Any
    initial_objective: float
    history: dict[str, np.ndarray]
    status: str
    names: tuple[str, ...]
    evaluations: int

    def report(self) -> str:
        """Table of the gains and the objective before and after, as text."""
        rows = [f"{'gain':<10}{'before':>12}{'after':>12}"]
        for leaf in fields(self.gains):
            before, after = (float(getattr(gains, leaf.name)) for gains in (self.initial_gains, self.gains))
            rows.append(f"{leaf.name:<10}{before:>12.4f}{after:>12.4f}{'' if leaf.name in self.names else '  frozen'}")
        rows.append(f"{'objective':<10}{self.initial_objective:>12.4f}{self.objective:>12.4f}")
        finals = np.nanmin(self.history["objective"], axis=0) if self.history["objective"].size else np.zeros(0)
        near = int(np.sum(finals <= 1.02 * self.objective)) if self.objective > 0 else 0
        rows.append(
            f"{self.status}: {self.evaluations} rollouts with gradient, {near} of {finals.size} starts within 2 % of the best"
        )
        return "\n".join(rows)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the result to a JSON file, atomically."""
        content = {leaf.name: to_plain(getattr(self, leaf.name)) for leaf in fields(self)}
        return write_json(path, {"format": FORMAT, "gains_type": type(self.gains).__name__, **content})

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> TuningResult:
        """Read a result that `save` wrote. Raises ValueError if the file is none."""
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            kind = _GAINS[content.pop("gains_type")]
            if content.pop("format") != FORMAT:
                raise KeyError("format")
            for name in ("gains", "initial_gains"):
                content[name] = kind(**content[name])
            history = content.pop("history")
            arrays = {name: np.array(rows, dtype=np.float64).reshape(len(rows), -1) for name, rows in history.items()}
            return cls(history=arrays, **content | {"names": tuple(content["names"])})
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise ValueError(
                f"{os.fspath(path)} is no tuning result of this version; type a file that TuningResult.save wrote"
            ) from error


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
    iterations: int = 150,
    learning_rate: float = 0.1,
    starts: int = 1,
    spread: float = 0.5,
    seed: int = 0,
    frozen: Sequence[str] = (),
    transforms: dict[str, Transform | None] | None = None,
    gradient: str = "forward",
    optimiser: Optimiser | None = None,
    chunk: int = 10,
    progress: bool = True,
) -> TuningResult:
    """Make `objective(gains)` small by gradient descent from one or many starts.

    Args:
        objective: gains -> scalar, differentiable, e.g. `tuning.RestToRest(...)`. initial_gains: the first start.
        iterations: steps per start. learning_rate: of Adam in the free coordinates (about relative change per step); it
        decays along a cosine. starts: how many; all but the first are drawn around the first with the standard deviation
        `spread` in free coordinates, from `seed`. frozen: gains to keep. transforms: see `parametrise`.
        gradient: "forward" or "reverse". optimiser: in place of Adam. chunk: iterations between two progress reports.

    Raises:
        ValueError: an argument is not admissible, or the objective is no scalar or not finite at every start.
    """
    for name, value in (("iterations", iterations), ("starts", starts), ("chunk", chunk)):
        require_count(name, value)
    require_scalar("learning_rate", learning_rate, above=0.0)
    require_scalar("spread", spread, above=0.0, or_equal=True)
    chosen = parametrise(initial_gains, frozen, transforms)
    evaluate = value_and_gradient(objective, chosen, gradient)
    optimiser = optimiser or adam(cosine_decay(learning_rate, iterations))
    first = chosen.to_vector(initial_gains)
    shape = jax.eval_shape(evaluate, first)[0].shape
    if shape != ():
        raise ValueError(f"objective returns shape {shape}; return one scalar")

    noise = jax.random.normal(jax.random.key(seed), (starts, first.size)).at[0].set(0.0)
    vectors = first[None, :] + spread * noise

    def iterate(start: _Start, _: None) -> tuple[_Start, tuple[Array, Array]]:
        value, slope = evaluate(start.vector)
        active = start.left > 0
        better = active & (value < start.best)
        vector, state = jax.tree.map(
            lambda new, old: jnp.where(active, new, old),
            optimiser.update(slope, start.optimiser, start.vector),
            (start.vector, start.optimiser),
        )
        best = jnp.where(better, value, start.best)
        after = _Start(vector, state, jnp.where(better, start.vector, start.best_vector), best, start.left - 1)
        return after, (value, jnp.sqrt(jnp.sum(slope * slope)))

    run = over_lanes(lambda start: jax.lax.scan(iterate, start, None, length=chunk))
    batch = _Start(
        vectors,
        jax.vmap(optimiser.init)(vectors),
        vectors,
        jnp.full((starts,), jnp.inf, float),
        jnp.full((starts,), iterations),
    )
    history: list[tuple[np.ndarray, np.ndarray]] = []
    status = "finished"
    with tqdm(total=iterations, desc="tuning", unit="step", disable=not progress) as bar:
        try:
            for done in range(0, iterations, chunk):
                batch, (values, norms) = run(batch)
                count = min(chunk, iterations - done)
                history.append((np.asarray(values).T[:count], np.asarray(norms).T[:count]))
                if not np.isfinite(history[0][0][0]).any():
                    raise ValueError(f"the objective is not finite at any of the {starts} starts; type another initial_gains")
                bar.update(count)
                bar.set_postfix(best=f"{float(jnp.min(batch.best)):.4g}")
        except KeyboardInterrupt:
            status = "interrupted"
            if not history:
                raise
    values, norms = (np.concatenate(parts) for parts in zip(*history, strict=True))
    winner = int(np.nanargmin(np.asarray(batch.best)))
    found = chosen.to_gains(batch.best_vector[winner])
    return TuningResult(
        gains=jax.tree.map(float, found),
        objective=float(batch.best[winner]),
        initial_gains=jax.tree.map(float, initial_gains),
        initial_objective=float(values[0, 0]),
        history={"objective": values, "gradient_norm": norms},
        status=status,
        names=chosen.names,
        evaluations=int(values.size),
    )
