"""jaxsphere: a pendulum-driven spherical robot on a slope, as pure functions of pytrees.

`jit`, `vmap` and `grad` apply to everything: one rollout, a million rollouts, or the gradient of a million rollouts. Importing
it switches JAX to float64.

Where the equations live (`grep -rn "Eq. (12)" jaxsphere` finds the home of any of them):

    (1) (5) (60)      models.planar                   dynamics, canonical form
    (2) - (4)         models.equilibrium              equilibrium, bound, poles of the zero dynamics
    (6) - (16)        controllers.sliding_mode        decoupled sliding-mode control of the plane
    (19) - (26), (30), (31), (35), (41) - (44)    models.spatial.frames         frames, rolling constraint
    (27) - (39)       models.spatial.energy           energies and Lagrangian
    (40)              models.spatial.contact          constraint forces
    (45), (46)        models.spatial.dynamics         reduced dynamics, in the frame of `attitude`
    (47) - (59)       controllers.tracking, .printed  trajectory tracking in five realisations

Symbols:

    alpha   sphere angle, rad           gamma   slope, rad                  phi     swing of the pendulum, rad
    phi_0   equilibrium swing, rad      s1, s2  sliding surfaces, rad/s     z       swing asked for beyond phi_0, rad
"""

import jax

jax.config.update("jax_enable_x64", True)

from jaxsphere import units  # noqa: E402
from jaxsphere.controllers import references, sliding_mode, tracking  # noqa: E402
from jaxsphere.controllers.sliding_mode import SlidingModeGains  # noqa: E402
from jaxsphere.controllers.sliding_mode import nonsingularity_margin as nonsingularity_margin  # noqa: E402
from jaxsphere.controllers.sliding_mode import sliding_mode_poles as sliding_mode_poles  # noqa: E402
from jaxsphere.controllers.tracking import TABLE_4, TrackingGains  # noqa: E402
from jaxsphere.linear import linearise  # noqa: E402
from jaxsphere.linear import poles as poles  # noqa: E402
from jaxsphere.models import equilibrium, planar, spatial  # noqa: E402
from jaxsphere.models.equilibrium import climbing_bound, equilibrium_swing  # noqa: E402
from jaxsphere.models.equilibrium import equilibria as equilibria  # noqa: E402
from jaxsphere.models.equilibrium import zero_dynamics_poles as zero_dynamics_poles  # noqa: E402
from jaxsphere.robot import Friction as Friction  # noqa: E402
from jaxsphere.robot import Robot, robots  # noqa: E402
from jaxsphere.robot import check_robot as check_robot  # noqa: E402
from jaxsphere.robot import robot_named as robot_named  # noqa: E402
from jaxsphere.simulation.batch import batch  # noqa: E402
from jaxsphere.simulation.batch import use_all_cores as use_all_cores  # noqa: E402
from jaxsphere.simulation.closed_loop import ClosedLoop as ClosedLoop  # noqa: E402
from jaxsphere.simulation.closed_loop import Measure as Measure  # noqa: E402
from jaxsphere.simulation.closed_loop import Plant as Plant  # noqa: E402
from jaxsphere.simulation.closed_loop import closed_loop as closed_loop  # noqa: E402
from jaxsphere.simulation.host import RolloutError as RolloutError  # noqa: E402
from jaxsphere.simulation.rollout import Trajectory as Trajectory  # noqa: E402
from jaxsphere.simulation.rollout import rollout as rollout  # noqa: E402
from jaxsphere.status import ControllerOutput as ControllerOutput  # noqa: E402
from jaxsphere.status import Status  # noqa: E402
from jaxsphere.sweep import axes  # noqa: E402
from jaxsphere.sweep.refine import Boundaries as Boundaries  # noqa: E402
from jaxsphere.sweep.refine import Guesses as Guesses  # noqa: E402
from jaxsphere.sweep.results import SweepResults as SweepResults  # noqa: E402
from jaxsphere.sweep.results import open_sweep  # noqa: E402
from jaxsphere.sweep.run import sweep  # noqa: E402
from jaxsphere.sweep.store import SweepError as SweepError  # noqa: E402
from jaxsphere.tasks import Numerics, PlanarTask, SpatialTask, rest_to_rest, simulate, steepest_slope, track, track_line  # noqa: E402
from jaxsphere.tasks import climb_outcome as climb_outcome  # noqa: E402
from jaxsphere.tasks import closed_loop_of as closed_loop_of  # noqa: E402
from jaxsphere.tasks import outcome_run as outcome_run  # noqa: E402
from jaxsphere.tasks import require_holdable as require_holdable  # noqa: E402
from jaxsphere.tasks import slope_search as slope_search  # noqa: E402
from jaxsphere.tasks import static_bound_by_release as static_bound_by_release  # noqa: E402
from jaxsphere.tasks.metrics import RegulationMetrics, TrackingMetrics  # noqa: E402

units.declare(
    *(Robot, Friction, SlidingModeGains, TrackingGains, PlanarTask, SpatialTask, Numerics),
    *(RegulationMetrics, TrackingMetrics, Trajectory),
    speed=("m/s", "along a line or a circle"),
    start=("m", "where the robot rests at first when it follows a line"),
)

__version__ = "0.1.0"

# The names to begin with, by subject, then the modules. What else can be imported from here is for those who build further.
__all__ = [
    "Robot",
    "SlidingModeGains",
    "TrackingGains",
    "rest_to_rest",
    "track",
    "track_line",
    "PlanarTask",
    "SpatialTask",
    "Numerics",
    "simulate",
    "climbing_bound",
    "steepest_slope",
    "linearise",
    "batch",
    "sweep",
    "open_sweep",
    "Status",
    "TABLE_4",
    "equilibrium_swing",
    "robots",
    "axes",
    "equilibrium",
    "planar",
    "references",
    "sliding_mode",
    "spatial",
    "tracking",
]
