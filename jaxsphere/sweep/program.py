"""A lane function as a program: traced for what it computes, compiled for blocks of lanes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun

from jaxsphere import identity
from jaxsphere.checks import require_choice
from jaxsphere.simulation.batch import batch, blocks
from jaxsphere.simulation.search import Pausable, run
from jaxsphere.sweep import leaves

# Ragged batches of up to so many lanes share one compiled program.
CAPACITY = 65536


class Program(NamedTuple):
    """A lane function, ready to run."""

    run: Callable[[dict[str, np.ndarray]], list[tuple[jax.Array, ...]]]  # leaf -> (n,) to outputs, block after block
    layout: np.dtype  # of one lane's outputs
    units: dict[str, str]  # of the outputs
    fingerprint: str  # of what is computed


def trace(
    lane: Callable[..., Any], base: dict[str, Any], names: list[str], kept: Sequence[str], dtype: Any, block: int
) -> Program:
    """Return the program of a lane function.

    Args:
        lane: as in `sweep`.
        base: arguments of every lane.
        names: dotted names of the leaves that vary.
        kept: names of the outputs to keep beside the status; all if empty.
        dtype: of the leaves that vary, and of the arrays in base.
        block: lanes of one program.

    Raises:
        ValueError: the lane function does not fit its arguments, or returns what is no number.
    """
    base = leaves.with_dtype(base, dtype)
    if leaves.takes_dtype(lane):
        base = {"dtype": dtype} | base
    leaves.require_arguments(lane, base | dict.fromkeys(name.split(".")[0] for name in names))
    units: dict[str, str] = {}

    def computed(*numbers: jax.Array) -> Any:
        return lane(**leaves.replaced(base, dict(zip(names, numbers, strict=True))))

    def named(result: Any) -> dict[str, jax.Array]:
        found = leaves.named_outputs(result)
        for name in kept:
            require_choice("output", name, tuple(found))
        units.update(leaves.output_units(result))
        return {name: jnp.asarray(leaf) for name, leaf in sorted(found.items()) if not kept or name in ("status", *kept)}

    def one(*numbers: jax.Array) -> dict[str, jax.Array]:
        nonlocal ragged
        result = computed(*numbers)
        ragged = isinstance(result, Pausable)
        return named(run(result) if ragged else result)

    def pieces(*numbers: jax.Array) -> Pausable:
        work = computed(*numbers)
        return work._replace(result=lambda carry: tuple(named(work.result(carry)).values()))

    ragged = False
    jaxpr, outputs = jax.make_jaxpr(one, return_shape=True)(*[jax.ShapeDtypeStruct((), dtype)] * len(names))
    if "status" in outputs and not (outputs["status"].shape == () and jnp.issubdtype(outputs["status"].dtype, jnp.integer)):
        raise ValueError(f"the lane function returns status = {outputs['status']}; let it return one js.Status, or rename it")
    traced = jaxpr_as_fun(jaxpr)
    equal = blocks(lambda *numbers: tuple(traced(*numbers)), block)
    unequal = batch(pieces, ragged=True, capacity=CAPACITY)
    layout = np.dtype([(name, outputs[name].dtype, outputs[name].shape) for name in sorted(outputs)])
    fingerprint = identity.fingerprint_of_jaxpr(jaxpr)

    def compute(values: dict[str, np.ndarray]) -> list[tuple[jax.Array, ...]]:
        numbers = [np.asarray(values[name], dtype) for name in names]
        return [unequal(*numbers)] if ragged else equal(*numbers)

    return Program(compute, layout, units, fingerprint)
