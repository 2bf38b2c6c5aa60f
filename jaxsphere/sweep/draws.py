"""Random numbers and shuffles that depend on a seed, a name and a number only, never on how many are asked for at once."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from zlib import crc32

import jax
import numpy as np

from jaxsphere.simulation.batch import BLOCK, blocks

_LOW = 0xFFFFFFFF  # the lower of two words
ROUNDS = 8  # of the Feistel network; four are enough to look random, the rest serves tiny counts


def uniform(seed: int, name: str, index: np.ndarray) -> np.ndarray:
    """Draws (n,) in [0, 1), one for each `index` (n,), independent of one another and of other names."""
    return _drawn(jax.random.uniform, seed, name, index)


def normal(seed: int, name: str, index: np.ndarray) -> np.ndarray:
    """Standard normal draws (n,), one for each `index` (n,)."""
    return _drawn(jax.random.normal, seed, name, index)


def permutation(seed: int, name: str, index: np.ndarray, count: int) -> np.ndarray:
    """Where a random permutation of 0 ... count - 1 sends each `index` (n,), without a table.

    A Feistel network permutes the smallest square power of two that holds `count`; what falls outside goes through it again
    (cycle walking), which happens less than three times on average.
    """
    half = np.uint64(max(1, ((count - 1).bit_length() + 1) // 2))
    keys = np.random.SeedSequence([seed, crc32(name.encode())]).generate_state(ROUNDS, np.uint64)
    place = _encrypt(index.astype(np.uint64), half, keys)
    while (outside := place >= np.uint64(count)).any():
        place[outside] = _encrypt(place[outside], half, keys)
    return place.astype(np.int64)


def _encrypt(place: np.ndarray, half: np.uint64, keys: np.ndarray) -> np.ndarray:
    mask = (np.uint64(1) << half) - np.uint64(1)
    left, right = place >> half, place & mask
    for key in keys:
        left, right = right, left ^ (_mixed(right ^ key) & mask)
    return (left << half) | right


def _mixed(word: np.ndarray) -> np.ndarray:
    """Every bit of `word` spread over all others (the finaliser of SplitMix64)."""
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return word ^ (word >> np.uint64(31))


def _drawn(draw: Callable[..., jax.Array], seed: int, name: str, index: np.ndarray) -> np.ndarray:
    words = (crc32(name.encode()), seed >> 32, seed & _LOW, index >> 32, index & _LOW)
    parts = _batch(draw)(*(np.broadcast_to(np.asarray(word, np.uint32), index.shape) for word in words))
    return np.concatenate(parts)[: len(index)]


@lru_cache
def _batch(draw: Callable[..., jax.Array]) -> Callable[..., list[jax.Array]]:
    def one(*words: jax.Array) -> jax.Array:
        key = jax.random.key(0)
        for word in words:
            key = jax.random.fold_in(key, word)
        return draw(key, dtype=jax.numpy.float64)

    return blocks(one, BLOCK, jax.local_devices()[:1])
