"""jaxsphere: a pendulum-driven spherical robot on a slope, as pure functions of pytrees.

`jit`, `vmap` and `grad` apply to everything: one rollout, a million rollouts, or the gradient of a million rollouts. Importing
it switches JAX to float64.

Where the equations live (`grep -rn "Eq. (12)" jaxsphere` finds the home of any of them):

    (1) (5) (60)      models.planar                   dynamics, canonical form
    (2) - (4)         models.equilibrium              equilibrium, bound, poles of the zero dynamics
    (6) - (16)        controllers.sliding_mode        decoupled sliding-mode control of the plane
    (19) - (26), (30), (31), (35), (41) - (43)    models.spatial.frames         frames, rolling constraint
    (27) - (39)       models.spatial.energy           energies and Lagrangian
    (40)              models.spatial.contact          constraint forces
    (44) - (46)       models.spatial.dynamics         reduced dynamics
    (47) - (59)       controllers.tracking            trajectory tracking in five realisations

Symbols:

    alpha   sphere angle, rad           gamma   slope, rad                  phi     swing of the pendulum, rad
    phi_0   equilibrium swing, rad      s1, s2  sliding surfaces, rad/s     z       swing asked for beyond phi_0, rad
"""

import jax

jax.config.update("jax_enable_x64", True)

from jaxsphere.controllers import references, sliding_mode, tracking  # noqa: E402
from jaxsphere.controllers.sliding_mode import SlidingModeGains, nonsingularity_margin, sliding_mode_poles  # noqa: E402
from jaxsphere.controllers.tracking import TABLE_4, TrackingGains  # noqa: E402
from jaxsphere.models import equilibrium, planar, spatial  # noqa: E402
from jaxsphere.models.equilibrium import (  # noqa: E402
    climbing_bound,
    equilibria,
    equilibrium_swing,
    zero_dynamics_poles,
)
from jaxsphere.robot import Robot, check_robot, robot_named, robots  # noqa: E402
from jaxsphere.simulation.closed_loop import ClosedLoop, Measure, Plant, closed_loop  # noqa: E402
from jaxsphere.simulation.host import RolloutError  # noqa: E402
from jaxsphere.simulation.lanes import over_lanes, use_all_cores  # noqa: E402
from jaxsphere.simulation.pausable import over_queue  # noqa: E402
from jaxsphere.simulation.rollout import Trajectory, rollout  # noqa: E402
from jaxsphere.status import ControllerOutput, Status  # noqa: E402
from jaxsphere.sweep import axes  # noqa: E402
from jaxsphere.sweep.results import SweepResults, open_sweep  # noqa: E402
from jaxsphere.sweep.run import sweep  # noqa: E402
from jaxsphere.sweep.store import SweepError  # noqa: E402
from jaxsphere.tasks import (  # noqa: E402
    Climb,
    Numerics,
    PlanarTask,
    SpatialTask,
    check_climb,
    climb_outcome,
    closed_loop_of,
    outcome_run,
    require_holdable,
    rest_to_rest,
    simulate,
    slope_search,
    static_bound_by_release,
    steepest_slope,
    track,
    track_line,
)

__all__ = [
    "ClosedLoop",
    "Numerics",
    "PlanarTask",
    "SpatialTask",
    "closed_loop",
    "closed_loop_of",
    "simulate",
    "TABLE_4",
    "TrackingGains",
    "references",
    "spatial",
    "track",
    "track_line",
    "tracking",
    "Climb",
    "ControllerOutput",
    "Measure",
    "Plant",
    "Robot",
    "RolloutError",
    "SlidingModeGains",
    "Status",
    "SweepError",
    "SweepResults",
    "Trajectory",
    "axes",
    "check_climb",
    "check_robot",
    "climb_outcome",
    "equilibrium",
    "climbing_bound",
    "equilibria",
    "equilibrium_swing",
    "nonsingularity_margin",
    "open_sweep",
    "outcome_run",
    "over_lanes",
    "over_queue",
    "planar",
    "require_holdable",
    "rest_to_rest",
    "robot_named",
    "robots",
    "rollout",
    "sliding_mode",
    "slope_search",
    "sliding_mode_poles",
    "sweep",
    "static_bound_by_release",
    "steepest_slope",
    "use_all_cores",
    "zero_dynamics_poles",
]
