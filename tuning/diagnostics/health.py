"""Is the gradient good? Agreement of its three ways, growth with the horizon, chaos, hard against smooth sign."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

import jaxsphere as js
from tuning.objectives.following import FollowLine
from tuning.objectives.regulation import RestToRest
from tuning.objectives.task_objective import SCORING, with_settings
from tuning.transforms import parametrise, value_and_gradient

# A gradient whose ways differ by more than this is not the slope of anything; one that grows faster than this per second
# loses its meaning within a rollout.
_AGREEMENT = 1e-4
_GROWTH = 1.0


class Health(NamedTuple):
    """What `check_gradient` found; gradients are in the free coordinates, in the order of `names`."""

    names: tuple[str, ...]
    forward: np.ndarray
    reverse: np.ndarray
    differences: np.ndarray
    disagreement: float  # largest difference between the three, of the largest entry or the objective
    horizons: np.ndarray  # s
    norms: np.ndarray  # of the gradient over each horizon
    growth: float  # 1/s, of the logarithm of the norm over the later half of the horizons
    lyapunov: float  # 1/s, largest finite-time Lyapunov exponent along the trajectory
    verdict: str


def check_gradient(objective: RestToRest | FollowLine, gains: Any, horizons: Sequence[float] = (1.0, 2.0, 4.0, 8.0)) -> Health:
    """Return whether to trust the gradient of an objective, to clip it or to shorten the horizon.

    Args:
        objective: to examine.
        gains: where.
        horizons: s, at which the growth of the gradient is looked at.
    """
    chosen = parametrise(gains)
    vector = chosen.to_vector(gains)
    value, slope = jax.jit(value_and_gradient(objective, chosen, "forward"))(vector)
    forward = np.asarray(slope)
    reverse = np.asarray(jax.jit(value_and_gradient(objective, chosen, "reverse"))(vector)[1])
    differences = _central(lambda free: objective(chosen.to_gains(free)), vector, forward)
    # At an optimum the gradient itself is no scale.
    scale = max(float(np.max(np.abs(forward))), abs(float(value)), 1e-12)
    disagreement = float(max(np.max(np.abs(forward - other)) for other in (reverse, differences))) / scale
    so_far = jax.jit(jax.jacfwd(lambda free: objective.cost_so_far(chosen.to_gains(free))))(vector)
    last = len(so_far) - 1
    rows = np.clip(np.round(np.asarray(horizons) / objective.duration * last).astype(int), 1, last)
    norms = np.linalg.norm(np.asarray(so_far)[rows], axis=1)
    late = slice(len(horizons) // 2 - 1, None)
    growth = float(np.polyfit(np.asarray(horizons)[late], np.log(np.maximum(norms[late], 1e-300)), 1)[0])
    lyapunov = float(lyapunov_exponent(objective, gains))
    verdict = _verdict(disagreement, growth, lyapunov, objective.duration)
    found = (chosen.names, forward, reverse, differences, disagreement, np.asarray(horizons), norms, growth, lyapunov)
    return Health(*found, verdict)


def _central(function: Callable[[Array], Array], vector: Array, expected: np.ndarray) -> np.ndarray:
    """Central differences with the step, of three, that comes closest to `expected`: long ones see curvature, short noise."""
    steps, size = np.array([1e-5, 1e-6, 1e-7]), vector.shape[0]
    both = jnp.concatenate([jnp.eye(size), -jnp.eye(size)])
    points = vector[None] + jnp.concatenate([float(step) * both for step in steps])
    up, down = np.split(np.asarray(jax.jit(jax.vmap(function))(points)).reshape(3, -1), 2, axis=1)
    found = (up - down) / (2.0 * steps[:, None])
    return found[np.argmin(np.max(np.abs(found - expected), axis=1))]


def lyapunov_exponent(objective: RestToRest | FollowLine, gains: Any) -> Float[Array, ""]:
    """Return the largest finite-time Lyapunov exponent (1/s) of the closed loop along its trajectories.

    A vector is pushed through the Jacobian of every step (every hold of a sampled controller) and normalised; the mean rate at
    which it grows is the exponent.
    """

    def of_one(task: Any) -> Array:
        period, dt = task.control_period, objective.numerics.dt
        stride = 1 if period is None else round(period / dt)
        numerics = replace(objective.numerics, save_every=stride)
        found = js.simulate(task, gains, numerics, throw=False)
        loop, out = js.closed_loop_of(task, gains, numerics), task.dynamics().out

        def ahead(state: Array, memory: Array, index: Array) -> Array:
            start = loop.init(tuple(state), tuple(memory))._replace(index=index)
            end, _ = jax.lax.scan(lambda now, _: (loop.step(now)[0], None), start, None, length=stride)
            if out is None:
                return jnp.stack(end.x)
            return jnp.stack(out(tuple(part[None] for part in end.x), tuple(state))[0])[:, 0]

        def push(direction: Array, here: tuple[Array, Array, Array]) -> tuple[Array, Array]:
            state, memory, index = here
            moved = jax.jvp(lambda x: ahead(x, memory, index), (state,), (direction,))[1]
            length = jnp.sqrt(jnp.sum(moved * moved))
            return moved / length, jnp.log(length)

        before = found.state[:-1], found.memory[:-1], stride * jnp.arange(len(found.state) - 1, dtype=jnp.int32)
        _, logarithms = jax.lax.scan(push, jnp.full(found.state.shape[1], 0.5), before)
        return jnp.sum(logarithms) / objective.duration

    return jnp.max(objective.each(of_one))


def _verdict(disagreement: float, growth: float, lyapunov: float, duration: float) -> str:
    if not disagreement < _AGREEMENT:
        return (
            f"clip: forward, reverse and differences disagree by {disagreement:.1e}, the objective is not smooth here; "
            "clip the gradient or raise smoothing"
        )
    if growth > _GROWTH or lyapunov > _GROWTH:
        return (
            f"shorten: neighbouring trajectories part at {max(growth, lyapunov):.2g} per second, over {duration:g} s the "
            f"gradient grows {np.exp(min(max(growth, lyapunov) * duration, 700.0)):.0e}-fold; tune over a shorter duration"
        )
    return (
        f"trust: forward, reverse and differences agree to {disagreement:.1e} and neighbouring trajectories "
        f"{'part' if lyapunov > 0.0 else 'close'} at {abs(lyapunov):.2g} per second"
    )


class Audit(NamedTuple):
    """The same gains with the smoothed and with the hard sign; figures are (widths + 1,), the hard sign last."""

    smoothing: np.ndarray  # rad/s, 0 for the hard sign
    settling_time: np.ndarray  # s
    peak_swing: np.ndarray  # rad
    itae: np.ndarray  # s^2
    chatter: np.ndarray  # total variation of the torque, N m
    gap: float  # relative change of the ITAE from the widest to the hard sign


def audit_sign(objective: RestToRest, gains: js.SlidingModeGains, widths: Sequence[float] = (0.2, 0.05, 0.02)) -> Audit:
    """Return what tuning with a smooth sign has hidden: the gains' score with a 1 kHz hold while the smoothing goes to zero.

    The tracking law of lines has no sign; there is nothing to audit in a `FollowLine`.

    Args:
        objective: whose task is simulated.
        gains: to score.
        widths: smoothings to try before the hard sign, rad/s.
    """
    every = jnp.array([*widths, 0.0])
    task, numerics = with_settings(objective.task, objective.numerics, SCORING)

    def score(width: Array) -> Any:
        return js.simulate(replace(task, smoothing=width), gains, numerics, throw=False).metrics

    found = jax.tree.map(np.asarray, jax.vmap(score)(every))
    gap = float(abs(found.itae[-1] - found.itae[0]) / found.itae[0])
    return Audit(np.asarray(every), found.settling_time, found.peak_swing, found.itae, found.chatter, gap)
