"""Is the gradient good? Agreement of its three ways, growth with the horizon, chaos, hard against smooth, stiff and sloppy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

import jaxsphere as js
from tuning.objectives import RestToRest
from tuning.second_order import quadratic
from tuning.transforms import parametrise
from tuning.tuner import value_and_gradient

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


def check_gradient(
    objective: RestToRest, gains: js.SlidingModeGains, horizons: Sequence[float] = (1.0, 2.0, 4.0, 8.0)
) -> Health:
    """Examine the gradient of `objective` at `gains` and say whether to trust it, clip it or shorten the horizon."""
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
    rows = np.clip(np.round(np.asarray(horizons) / objective.dt).astype(int), 1, len(so_far) - 1)
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


def lyapunov_exponent(objective: RestToRest, gains: js.SlidingModeGains) -> Array:
    """Largest finite-time Lyapunov exponent (1/s) of the closed loop along its trajectory.

    A vector is pushed through the Jacobian of every step and normalised; the mean rate at which it grows is the exponent.
    """
    trajectory = objective.rollout(gains)
    target = trajectory.state[0, 0] + objective.travel
    options = {"plant": objective.plant, "method": objective.method, "throw": False}

    def step(state: Array) -> Array:
        held = None if objective.continuous else objective.dt
        ahead = js.rest_to_rest(
            objective.robot,
            objective.slope,
            gains,
            target - state[0],
            objective.dt,
            objective.dt,
            objective.smoothing,
            objective.torque_limit,
            initial_state=state,
            control_period=held,
            **options,
        )
        return ahead.state[-1]

    def push(direction: Array, state: Array) -> tuple[Array, Array]:
        moved = jax.jvp(step, (state,), (direction,))[1]
        length = jnp.sqrt(jnp.sum(moved * moved))
        return moved / length, jnp.log(length)

    _, logarithms = jax.lax.scan(push, jnp.full(4, 0.5), trajectory.state[:-1])
    return jnp.sum(logarithms) / objective.duration


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
    gap: float  # relative change of the tracking term from the widest to the hard sign


def audit_sign(objective: RestToRest, gains: js.SlidingModeGains, widths: Sequence[float] = (0.2, 0.05, 0.02)) -> Audit:
    """Score gains with a 1 kHz hold while the smoothing goes to zero: what tuning with a smooth sign has hidden."""
    every = jnp.array([*widths, 0.0])

    def score(width: Array) -> Any:
        task = (objective.robot, objective.slope, gains, objective.travel, objective.duration, 1e-3, width)
        limit = objective.torque_limit
        return js.rest_to_rest(*task, limit, plant=objective.plant, control_period=1e-3, save_every=None, throw=False).metrics

    found = jax.tree.map(np.asarray, jax.vmap(score)(every))
    gap = float(abs(found.itae[-1] - found.itae[0]) / found.itae[0])
    return Audit(np.asarray(every), found.settling_time, found.peak_swing, found.itae, found.chatter, gap)


class Directions(NamedTuple):
    """Eigenvalues (n,) of the Gauss-Newton Hessian in the logarithms of the gains, stiffest first, and their directions."""

    names: tuple[str, ...]
    eigenvalues: np.ndarray
    vectors: np.ndarray  # (n, n), one direction a row

    def sentence(self) -> str:
        """One sentence for people."""
        stiff, sloppy = (self._words(row) for row in (0, -1))
        ratio = self.eigenvalues[0] / max(self.eigenvalues[-1], 1e-300)
        # A change d of the logarithms raises the objective by d' H d / 2.
        harmless = float(np.sqrt(0.02 / max(self.eigenvalues[-1], 1e-300)))
        return (
            f"what matters most is {stiff}, what matters least is {sloppy}: the first is {ratio:.1e} times as stiff, and along "
            f"the last the gains may change by a factor of {np.exp(min(harmless, 20.0)):.3g} before the objective rises by 0.01"
        )

    def _words(self, row: int) -> str:
        vector = self.vectors[row]
        named = [(abs(share), share, name) for name, share in zip(self.names, vector, strict=True) if abs(share) > 0.3]
        first = max(named)[1]
        return " ".join(f"{'x' if share * first > 0 else '/'} {name}" for _, share, name in sorted(named, reverse=True))[2:]


def stiff_and_sloppy(objective: RestToRest, gains: js.SlidingModeGains, names: Sequence[str] = ()) -> Directions:
    """Directions of the logarithms of the gains (all free ones by default) by how much they matter to the objective."""
    names = tuple(names) or parametrise(gains).names

    def residuals(logarithms: Array) -> Array:
        changed = {name: jnp.exp(logarithms[i]) for i, name in enumerate(names)}
        return objective.residuals(replace(gains, **changed))

    point = jnp.log(jnp.stack([jnp.asarray(getattr(gains, name), float) for name in names]))
    hessian = jax.jit(lambda free: quadratic(residuals, free).hessian)(point)
    values, vectors = np.linalg.eigh(np.asarray(hessian))
    return Directions(names, values[::-1], vectors.T[::-1])
