"""`jaxsphere simulate planar` and `jaxsphere simulate spatial`."""

from __future__ import annotations

from typing import Any

import jaxsphere as js
from experiments.cli.options import RobotOptions, arguments, command, options, robot
from experiments.cli.printing import print_numbers
from experiments.records import Record
from experiments.studies.settings import Path

# Parameters that are objects, not options, and those that a command sets itself.
_OBJECTS = ("robot", "plant", "gains", "save_every", "dtype", "throw", "diagnostics")
PLANAR_OBJECTS = (*_OBJECTS, "late")
SPATIAL_OBJECTS = (*_OBJECTS, "reference", "options", "initial_state")

PlanarGains = options("PlanarGains", js.SlidingModeGains)
SpatialGains = options("SpatialGains", js.TrackingGains)
PlanarMotion = options("PlanarMotion", js.rest_to_rest, without=PLANAR_OBJECTS)
SpatialMotion = options("SpatialMotion", Path, js.track_line, js.track, without=SPATIAL_OBJECTS)


def simulate_planar(chosen: Any) -> None:
    """Simulate one move, print its figures of merit and draw it."""
    from experiments.plots import regulation
    from experiments.studies import fig4

    motion, believed = arguments(chosen.motion), robot(chosen.robot)
    plant, gains = robot(chosen.plant, believed, "plant"), js.SlidingModeGains(**arguments(chosen.gains))
    js.sliding_mode.check_gains(gains)
    js.require_holdable(believed, motion["slope"])
    record = Record(chosen.out)
    trajectory = js.rest_to_rest(believed, gains=gains, plant=plant, **motion, throw=False)
    numbers = fig4.figures(trajectory)
    words = f"over {motion['travel']:g} rad on a {chosen.motion.slope_deg:g}° slope: {numbers['status'].replace('_', ' ')}"
    shown = [regulation.Run("simulated", trajectory, gains)]
    drawn = (shown, believed, motion["slope"], motion["travel"], float(trajectory.end_time))
    record.picture("simulation", regulation.regulation_figure(f"Rest to rest {words}", *drawn))
    record.finish({"simulation": numbers}, robot=believed, plant=plant, gains=gains, settings=chosen.motion)
    print_numbers(numbers)
    print(f"simulation.png, metrics.json and manifest.json are in {record.folder}")


def simulate_spatial(chosen: Any) -> None:
    """Follow one path, print how well, and draw it."""
    from experiments.plots import tracking
    from experiments.studies import fig5

    motion, believed = arguments(chosen.motion), js.spatial.check_spatial_robot(robot(chosen.robot))
    plant = js.spatial.check_spatial_robot(robot(chosen.plant, believed, "plant"), "plant")
    gains = js.tracking.check_gains(js.TrackingGains(**arguments(chosen.gains)))
    path = Path(**{name: motion.pop(name) for name in Path.__dataclass_fields__})
    reference = path.reference()
    if motion["realisation"] != "ideal":
        js.require_holdable(believed, motion["slope"])
    if path.path != "line":
        del motion["start"], motion["heading"]
    record = Record(chosen.out)
    trajectory = js.track(believed, reference=reference, gains=gains, plant=plant, **motion, diagnostics=True, throw=False)
    numbers = fig5.figures(trajectory)
    title = f"Following a {path.path} on a {chosen.motion.slope_deg:g}° slope: {numbers['status'].replace('_', ' ')}"
    name = motion["realisation"].replace("_", " ")
    track = tracking.Track(name, trajectory, fig5.positions(reference, trajectory.time))
    record.picture("simulation", tracking.tracking_figure(title, [track], motion["torque_limit"]))
    if motion["realisation"] != "ideal":
        record.picture("simulation_friction", tracking.friction_figure("Friction that rolling without slip needs", [track]))
    record.finish({"simulation": numbers}, robot=believed, plant=plant, gains=gains, settings=chosen.motion)
    print_numbers(numbers)
    print(f"pictures, metrics.json and manifest.json are in {record.folder}")


_GROUPS: dict[str, Any] = {"robot": RobotOptions, "plant": RobotOptions}
COMMANDS = {
    "simulate planar": command(simulate_planar, **_GROUPS, gains=PlanarGains, motion=PlanarMotion),
    "simulate spatial": command(simulate_spatial, **_GROUPS, gains=SpatialGains, motion=SpatialMotion),
}
