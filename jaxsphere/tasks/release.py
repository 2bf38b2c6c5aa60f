"""The bound (4) found by simulation: robots released on slopes under the torque that balances them."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import require_scalar
from jaxsphere.models import planar
from jaxsphere.models.equilibrium import climbing_bound, equilibrium_swing
from jaxsphere.numerics import Real
from jaxsphere.robot import Robot, check_robot
from jaxsphere.simulation.closed_loop import ClosedLoop, LoopState, closed_loop
from jaxsphere.simulation.host import cast
from jaxsphere.simulation.search import Trial, largest_success, run
from jaxsphere.status import ControllerOutput, Status, code
from jaxsphere.tasks.climbing import SteepestSlope, in_seconds
from jaxsphere.tasks.planar import planar_plant

# In units of the pendulum's own time sqrt(I / (m_p g l)): beside the bound by 1e-6 of the torque the whirl takes about 100.
_RELEASE_STEP = 0.05
_RELEASE_STEPS = 250
_RELEASE_SEGMENTS = 20


def static_bound_by_release(robot: Robot, tolerance: Real = 1e-5, offset: Real = 1e-3) -> SteepestSlope:
    """Find the bound (4) by simulation: the steepest slope (rad) on which a released robot is held by a constant torque.

    The torque is the one that balances the slope, tau = (m + m_i + m_p) g r sin(gamma), whatever the pendulum does. Row 1 of
    (1) then conserves M11 alpha' + M12 phi', so that the sphere moves only as the pendulum does, and the pendulum is a ball on
    the washboard of its weight and this torque: it has a hollow at phi_0 and a rim at pi - phi_0 as long as (2) has a
    solution. Released at rest `offset` (rad) up-slope of phi_0 (of pi/2 where there is none), it rocks in the hollow or
    whirls. (Clamping the sphere's angle instead would be no test: there phi_0 is a saddle, see `zero_dynamics_poles`.)

    Args:
        robot: the robot.
        tolerance: rad, width of the bracket.
        offset: rad.
    """
    check_robot(robot)
    require_scalar("tolerance", tolerance, above=0.0, unit="rad")
    require_scalar("offset", offset, above=0.0, unit="rad")
    return _static(*cast((robot, tolerance, offset), jnp.float64))


@jax.jit
def _static(robot: Robot, tolerance: Array, offset: Array) -> SteepestSlope:
    zero = jnp.zeros_like(climbing_bound(robot))
    level = planar.lump(robot, zero)
    total = _RELEASE_STEPS * _RELEASE_SEGMENTS
    dt = _RELEASE_STEP * jnp.sqrt(level.pendulum_inertia / level.pendulum_weight)

    def loop(slope: Array) -> ClosedLoop:
        balance = jnp.asarray(planar.lump(robot, slope).slope_torque)

        def hold(time: Array, state: planar.State, memory: tuple[Array, ...]) -> ControllerOutput:
            del time, state, memory
            return ControllerOutput((balance,), (), code(Status.OK))

        return closed_loop(planar_plant(robot, slope, zero, zero), hold, dt=dt, steps=total)

    def start(slope: Array) -> LoopState:
        return loop(slope).init((zero, zero, equilibrium_swing(robot, slope) + offset, zero), ())

    def advance(slope: Array, now: LoopState) -> tuple[LoopState, Array, Array]:
        step = loop(slope).step
        now, _ = jax.lax.scan(lambda one, _: (step(one)[0], None), now, None, length=_RELEASE_STEPS)
        return now, (now.status != Status.OK) | (now.index >= total), now.status

    search = largest_success(Trial(start, advance), zero, zero + 0.5 * jnp.pi, tolerance)
    return run(in_seconds(search, _RELEASE_STEPS * dt))
