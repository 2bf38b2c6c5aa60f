"""Strict numerics and the cases that every test file shares."""

from collections.abc import Callable

import jax
import numpy as np
import pytest

import jaxsphere as js

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

SEED = 20140815

# Another gravity, unequal masses and moments: nothing cancels by accident.
ODD_ROBOT = js.Robot(
    shell_mass=0.7,
    gimbal_mass=3.1,
    pendulum_mass=4.3,
    shell_inertia=np.array([0.021, 0.033, 0.027]),
    gimbal_inertia=np.array([0.004, 0.0055, 0.0031]),
    pendulum_length=0.13,
    shell_radius=0.21,
    gravity=3.7,
)


@pytest.fixture
def rng() -> np.random.Generator:
    """NumPy generator with the seed of the suite."""
    return np.random.default_rng(SEED)


@pytest.fixture
def key() -> jax.Array:
    """JAX key with the seed of the suite."""
    return jax.random.key(SEED)


@pytest.fixture(params=["set_a", "odd"])
def robot(request: pytest.FixtureRequest) -> js.Robot:
    """Set A and a robot that shares no number with it."""
    return js.Robot() if request.param == "set_a" else ODD_ROBOT


@pytest.fixture(scope="session")
def slope() -> float:
    """The slope of the paper's Fig. 4, rad."""
    return float(np.deg2rad(10.0))


@pytest.fixture
def random_states(rng: np.random.Generator) -> Callable[[int], np.ndarray]:
    """Draw states (count, 4) over the whole circle of the swing and rates beyond those of any rollout of the suite."""

    def draw(count: int) -> np.ndarray:
        reach = np.array([20.0, 8.0, np.pi, 12.0])
        return rng.uniform(-reach, reach, (count, 4))

    return draw
