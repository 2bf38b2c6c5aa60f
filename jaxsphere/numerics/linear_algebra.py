"""Small vectors and matrices by components, so that a rollout calls no library routine and lanes stay last.

A vector is a tuple of equally shaped arrays; a matrix is a sequence of rows. The plain number 0.0 marks an entry that is zero
by structure; no operation is spent on it.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from jaxsphere.numerics.fences import Real, evaluate_once

Vector3 = tuple[Real, Real, Real]


def is_structural_zero(value: Real) -> bool:
    """Tell whether `value` is the plain number 0.0, which no lane can change."""
    return isinstance(value, int | float) and value == 0


def sum_of_products(*pairs: tuple[Real, Real]) -> Real:
    """Sum of the products of the pairs, without the terms that are zero by structure."""
    total: Real = 0.0
    for left, right in pairs:
        if is_structural_zero(left) or is_structural_zero(right):
            continue
        product = left * right
        total = product if is_structural_zero(total) else total + product
    return total


def dot(left: Sequence[Real], right: Sequence[Real]) -> Real:
    """Scalar product of two vectors."""
    return sum_of_products(*zip(left, right, strict=True))


def cross(left: Vector3, right: Vector3) -> Vector3:
    """Vector product of two vectors of three components."""
    (a, b, c), (x, y, z) = left, right
    return b * z - c * y, c * x - a * z, a * y - b * x


def combine(*terms: tuple[Real, Vector3]) -> Vector3:
    """Sum of vectors, each times its factor."""
    x, y, z = (sum(factor * vector[i] for factor, vector in terms) for i in range(3))
    return x, y, z


def solve_pair(matrix: tuple[tuple[Real, Real], tuple[Real, Real]], right: tuple[Real, Real]) -> tuple[Array, Array]:
    """Solve two equations in two unknowns by the formula; the result is not finite where the determinant is zero."""
    (a, b), (c, d) = matrix
    x, y = right
    inverse = jnp.reciprocal(a * d - b * c)
    return (d * x - b * y) * inverse, (a * y - c * x) * inverse


def solve_positive_definite(lower: Sequence[Sequence[Real]], *right: Sequence[Real]) -> tuple[tuple[Array, ...], ...]:
    """Solve A x = b for a symmetric positive definite A, for every b in `right`, by an unrolled square-root-free Cholesky.

    Args:
        lower: row i holds A[i, 0..i].
        right: vectors b. The last unknown is eliminated first.

    Returns:
        One solution per vector of `right`.
    """
    rest = [list(row) for row in lower]
    sides = [list(side) for side in right]
    size = len(rest)
    inverses: list[Real] = [0.0] * size
    for pivot in reversed(range(size)):
        row = rest[pivot]
        inverses[pivot] = 1.0 / row[pivot]
        for i in range(pivot):
            if is_structural_zero(row[i]):
                continue
            factor = row[i] * inverses[pivot]
            for j in range(i + 1):
                if not is_structural_zero(row[j]):
                    rest[i][j] = rest[i][j] - factor * row[j]
            for side in sides:
                side[i] = side[i] - factor * side[pivot]
    return tuple(_substitute(rest, inverses, side) for side in sides)


def _substitute(rest: list[list[Real]], inverses: list[Real], side: list[Real]) -> tuple[Array, ...]:
    solution: list[Array] = []
    for row, inverse, value in zip(rest, inverses, side, strict=True):
        known = dot(row[: len(solution)], solution)
        solution.append(evaluate_once(jnp.asarray((value - known) * inverse)))
    return tuple(solution)
