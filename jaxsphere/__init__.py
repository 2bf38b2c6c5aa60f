"""jaxsphere: a pendulum-driven spherical robot on a slope, as pure functions of pytrees.

`jit`, `vmap` and `grad` apply to everything: one rollout, a million rollouts, or the gradient of a million rollouts. Importing
it switches JAX to float64.

Where the equations live (`grep -rn "Eq. (12)" jaxsphere` finds the home of any of them):

    (1) (5) (60)      models.planar                   dynamics, canonical form
    (2) - (4)         models.climbing                 equilibrium, bound, poles of the zero dynamics
    (6) - (16)        controllers.sliding_mode        decoupled sliding-mode control of the plane

Symbols:

    alpha   sphere angle, rad           gamma   slope, rad                  phi     swing of the pendulum, rad
    phi_0   equilibrium swing, rad      s1, s2  sliding surfaces, rad/s     z       swing asked for beyond phi_0, rad
"""

import jax

jax.config.update("jax_enable_x64", True)

from jaxsphere.command import Command, Status  # noqa: E402
from jaxsphere.controllers import sliding_mode  # noqa: E402
from jaxsphere.controllers.sliding_mode import SlidingModeGains, nonsingularity_margin, sliding_mode_poles  # noqa: E402
from jaxsphere.models import climbing, planar  # noqa: E402
from jaxsphere.models.climbing import (  # noqa: E402
    climbing_bound,
    equilibria,
    equilibrium_swing,
    zero_dynamics_poles,
)
from jaxsphere.robot import Robot, check_robot, robot_named, robots  # noqa: E402
from jaxsphere.simulation.host import RolloutError  # noqa: E402
from jaxsphere.simulation.rollout import Measure, Plant, Trajectory, rollout  # noqa: E402
from jaxsphere.tasks import require_holdable, rest_to_rest  # noqa: E402

__all__ = [
    "Command",
    "Measure",
    "Plant",
    "Robot",
    "RolloutError",
    "SlidingModeGains",
    "Status",
    "Trajectory",
    "check_robot",
    "climbing",
    "climbing_bound",
    "equilibria",
    "equilibrium_swing",
    "nonsingularity_margin",
    "planar",
    "require_holdable",
    "rest_to_rest",
    "robot_named",
    "robots",
    "rollout",
    "sliding_mode",
    "sliding_mode_poles",
    "zero_dynamics_poles",
]
