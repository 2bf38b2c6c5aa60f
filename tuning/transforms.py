"""Gains as a vector without bounds: the optimiser sees R^n, the controller sees admissible gains in physical units.

A tree of transforms runs parallel to the gains: POSITIVE (logarithm), UNIT (logit, for gains in (0, 1)), `bounded` or FROZEN.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxsphere import SlidingModeGains, TrackingGains
from jaxsphere.checks import require_choice
from tuning.optimisers.levenberg_marquardt import with_jacobian


class Transform(NamedTuple):
    """A smooth bijection between the real line and the admissible values of one gain."""

    to_gain: Callable[[Array], Array]
    to_free: Callable[[Array], Array]


POSITIVE = Transform(jnp.exp, jnp.log)
UNIT = Transform(jax.nn.sigmoid, lambda gain: jnp.log(gain) - jnp.log1p(-gain))
FROZEN = None
GRADIENTS = ("forward", "reverse")


def bounded(low: float, high: float) -> Transform:
    """Return a transform of a positive gain between two bounds: its logarithm runs along a sine, as in MINUIT.

    A search that steps past a bound comes back inside; with a logit it would be lost where the slope is zero.
    """
    if not 0.0 < low < high < float("inf"):
        raise ValueError(f"bounds ({low}, {high}) hold no positive gain; type two increasing positive numbers")
    middle, half = 0.5 * float(np.log(low * high)), 0.5 * float(np.log(high / low))
    return Transform(
        lambda free: jnp.exp(middle + half * jnp.sin(free)),
        lambda gain: jnp.arcsin((jnp.log(gain) - middle) / half),
    )


# The transforms of each kind of gains that the package knows, by the name of the field.
_KNOWN: dict[Any, dict[str, Any]] = {
    SlidingModeGains: dict.fromkeys(("c1", "c2", "phi_z", "eta", "k"), POSITIVE) | {"z_u": UNIT, "k_i": FROZEN},
    TrackingGains: {
        name: POSITIVE if name in ("k1", "k2", "k3", "k4", "axis_damping") else FROZEN
        for name in TrackingGains.__dataclass_fields__
    },
}


@dataclass(frozen=True)
class Parametrisation:
    """Which gains are free, in which order, and how they map to a vector of R^n; the others keep `reference`'s values."""

    reference: Any
    transforms: dict[str, Transform]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free gains, in the order of the vector."""
        return tuple(self.transforms)

    def to_vector(self, gains: Any) -> Array:
        """Return the free vector (n,) of the gains."""
        return jnp.stack([t.to_free(jnp.asarray(getattr(gains, name), float)) for name, t in self.transforms.items()])

    def to_gains(self, vector: Array) -> Any:
        """Return the gains of a free vector (n,)."""
        free = {name: t.to_gain(vector[i]) for i, (name, t) in enumerate(self.transforms.items())}
        kept = {leaf.name: getattr(self.reference, leaf.name) for leaf in fields(self.reference)}
        return type(self.reference)(**kept | free)


def parametrise(
    gains: Any, frozen: Sequence[str] = (), transforms: Mapping[str, Transform | None] | None = None
) -> Parametrisation:
    """Return which gains are free, and how they map to a vector.

    Args:
        gains: any dataclass of scalar gains; it also gives the values of the frozen ones.
        frozen: names of gains to keep.
        transforms: a transform per field, needed for gains of the user's own; they override the known ones.

    Raises:
        ValueError: an unknown name, no transform known, a gain outside its range, or nothing left to tune.
    """
    known = _KNOWN.get(type(gains), {}) | dict(transforms or {})
    names = [leaf.name for leaf in fields(gains)]
    for name in (*frozen, *known):
        if name not in names:
            raise ValueError(f"frozen or transforms name {name!r}, which is no gain; type some of {', '.join(names)}")
    missing = [name for name in names if name not in known]
    if missing:
        raise ValueError(
            f"no transform is known for {', '.join(missing)}; type transforms={{{missing[0]!r}: tuning.POSITIVE, ...}}"
        )
    free = {name: known[name] for name in names if known[name] is not FROZEN and name not in frozen}
    if not free:
        raise ValueError("frozen leaves nothing to tune; leave at least one gain free")
    chosen = Parametrisation(gains, free)  # type: ignore[arg-type]
    for name, value in zip(chosen.names, chosen.to_vector(gains), strict=True):
        if not jnp.isfinite(value):
            raise ValueError(f"initial gain {name} = {getattr(gains, name)} is outside its range; type an admissible start")
    return chosen


def value_and_gradient(
    objective: Callable[[Any], Array], chosen: Parametrisation, gradient: str = "forward"
) -> Callable[[Array], tuple[Array, Array]]:
    """Return a function of the free vector (n,) to the objective and its gradient (n,) there.

    Args:
        objective: of the gains.
        chosen: which gains are free, and how they map to the vector.
        gradient: "forward" pushes the n unit vectors through the rollout: no memory in the horizon, best for a few gains.
            "reverse" costs the same for any number of gains and recomputes each saved block of the rollout.

    Raises:
        ValueError: `gradient` is neither.
    """
    require_choice("gradient", gradient, GRADIENTS)

    def of_vector(vector: Array) -> Array:
        return objective(chosen.to_gains(vector))

    return partial(with_jacobian, of_vector) if gradient == "forward" else jax.value_and_grad(of_vector)
