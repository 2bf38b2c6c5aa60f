"""Trajectory tracking of the spatial robot: equations (47)-(59), in five realisations.

The output y = (x, y) is the centre of the sphere. An outer loop with gains k1..k4 asks for its acceleration; what differs is
how that is turned into two torques (N m):

    axis_aligned        beyond the paper, the default: limit the demand, lean the pendulum so that gravity gives it (`lean`),
                        and control the two joints. The demand damps the coning of the spin axis (`axis_aligned`). Stable.
    pendulum_attitude   beyond the paper: the same with (58) as it is. It follows a path within 1.2 cm with Table 4's gains,
                        but straight rolling is unstable: the spin axis cones.
    exact               the torques that give the demand at once. The zero dynamics are unstable: the pendulum leaves.
    pseudo_inverse      (47) as printed, with (53) read as a pseudo-inverse. Unstable.
    ideal               (48) taken literally: the five accelerations are the input and no torque exists. Not a robot.

Differs from the paper (`printed` has what is printed of (47), (48) and (53)):
    (54)        the zero dynamics are called stable; `zero_dynamics_poles` shows that they are not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import require_choice
from jaxsphere.controllers import axis_aligned, printed
from jaxsphere.controllers.lean import Joints, Lean, balancing_lean, joints_to, limit
from jaxsphere.controllers.references import Pair, Reference, ReferenceFunction
from jaxsphere.controllers.spin_axis import posture_of
from jaxsphere.controllers.tracking_gains import TABLE_4 as TABLE_4
from jaxsphere.controllers.tracking_gains import TrackingGains
from jaxsphere.controllers.tracking_gains import check_gains as check_gains
from jaxsphere.models.spatial import Affine, GimbalState, Lumped, SpatialState, State, attitude, dynamics, frames
from jaxsphere.models.spatial.attitude import Axes
from jaxsphere.models.spatial.lumped import lump
from jaxsphere.models.spatial.paper import paper_affine, paper_rates
from jaxsphere.numerics import Real, evaluate_once
from jaxsphere.numerics.linear_algebra import Vector3, cross, solve_pair
from jaxsphere.robot import Robot
from jaxsphere.status import ControllerOutput, Status, code

# Cosine of beta2 below which the pendulum points along the spin axis.
_ALONG_AXIS = 1e-6

# Square of the sine of the lean below which beta1 has no acceleration of its own.
_AXIS_MARGIN = 1e-12

REALISATIONS = ("axis_aligned", "pendulum_attitude", "exact", "pseudo_inverse", "ideal")

# Those that lean the pendulum and control the two joints.
BY_ATTITUDE = ("axis_aligned", "pendulum_attitude")


class Pairs(NamedTuple):
    """Two accelerations, affine in the torques: drift + drive tau1 + tilt tau2."""

    drift: Pair
    drive: Pair
    tilt: Pair


class Signals(NamedTuple):
    """What the controller computes on the way to its torques; also the diagnostics of a rollout."""

    error: Pair  # e1, e2, m
    demand: Pair  # acceleration asked of the centre by (58), m/s2
    limited: Pair  # the demand that is realised, m/s2
    lean: Lean  # of the pendulum, that would give the limited demand
    joints: Joints
    determinant: Array  # of the two equations solved for the torques, positive while they can be, 1/(kg2 m4)
    torque: tuple[Array, ...]  # before the torque limit, N m; five accelerations, rad/s2, for "ideal"


def output(state: State) -> Pair:
    """Output y = h(q) = (x, y), the centre of the sphere, m, Eq. (49), Eq. (55)."""
    x, y, *_ = state
    return x, y


def tracking_error(reference: Reference, state: State) -> Pair:
    """Errors e1 = x - x_d and e2 = y - y_d, m, Eq. (57)."""
    x, y = output(state)
    return x - reference.position[0], y - reference.position[1]


def demanded_acceleration(gains: TrackingGains, reference: Reference, error: Pair, velocity: Pair) -> Pair:
    """Acceleration asked of the centre, v = a_d - k e' - k e for each of x and y, m/s2, Eq. (58)."""
    error_rate = velocity[0] - reference.velocity[0], velocity[1] - reference.velocity[1]
    return (
        reference.acceleration[0] - gains.k2 * error_rate[0] - gains.k1 * error[0],
        reference.acceleration[1] - gains.k4 * error_rate[1] - gains.k3 * error[1],
    )


def error_poles(gains: TrackingGains) -> Array:
    """Poles (1/s, complex, (4,)) of the errors under an exactly met demand, two of x and two of y, Eq. (59)."""
    stiffness = jnp.stack([jnp.asarray(gains.k1, float), jnp.asarray(gains.k3, float)])
    damping = jnp.stack([jnp.asarray(gains.k2, float), jnp.asarray(gains.k4, float)])
    root = jnp.sqrt((0.25 * damping**2 - stiffness).astype(complex))
    return jnp.concatenate([-0.5 * damping - root, -0.5 * damping + root])


def decoupling_matrix(robot: Robot, state: State) -> Array:
    """Decoupling matrix Phi(q) = J_h C, (2, 5), m, with y'' = Phi v' + Phi' v, Eq. (50)."""
    return frames.null_space(robot, state)[:2]


def decoupling_determinant(robot: Robot, slope: Real, state: State) -> Array:
    """Determinant of Phi G (2 x 2), from the two torques to the centre's acceleration, 1/kg2; `exact` divides by it."""
    lumped, now = lump(robot, slope), attitude.of_state(state)
    return _determinant(centre_accelerations(lumped, now, attitude.axes_of(now), dynamics.affine(lumped, now)))


def centre_accelerations(lumped: Lumped, now: GimbalState, axes: Axes, terms: Affine) -> Pairs:
    """Accelerations of the centre along x and y, m/s2."""
    drift, drive, tilt = (attitude.to_slope(axes, dynamics.rolled(lumped, axes, one))[:2] for one in terms)
    more = attitude.to_slope(axes, dynamics.centre_drift(lumped, now, axes.normal))
    return Pairs((drift[0] + more[0], drift[1] + more[1]), drive, tilt)


def joint_angle_accelerations(now: GimbalState, axes: Axes, terms: Affine) -> Pairs:
    """Accelerations beta1'' and beta2'' of the joints, rad/s2."""
    x, y, _ = attitude.turning_of(now)

    def precession(normal: Vector3, turning_x: Real, turning_y: Real) -> Array:
        """psi' cos(theta), what omega_z is beyond beta1'."""
        a, b, c = normal
        return evaluate_once(c / jnp.maximum(a * a + b * b, _AXIS_MARGIN)) * (a * turning_x + b * turning_y)

    def gimbal(one: tuple[Array, ...]) -> Array:
        return one[2] - precession(axes.normal, one[0], one[1])

    turned = cross(axes.normal, attitude.turning_of(now))
    drift = evaluate_once(jax.jvp(lambda *normal: precession(normal, x, y), axes.normal, turned)[1])
    free, drive, tilt = ((gimbal(one), one[4]) for one in terms)
    return Pairs((free[0] - drift, free[1]), drive, tilt)


def assigning_torque(pairs: Pairs, wanted: Pair) -> tuple[Array, Array]:
    """Torques that give the two accelerations the wanted values, N m."""
    matrix = (pairs.drive[0], pairs.tilt[0]), (pairs.drive[1], pairs.tilt[1])
    return solve_pair(matrix, (wanted[0] - pairs.drift[0], wanted[1] - pairs.drift[1]))


def _determinant(pairs: Pairs) -> Array:
    return jnp.asarray(pairs.drive[0] * pairs.tilt[1] - pairs.tilt[0] * pairs.drive[1])


def _upright_sign(lumped: Lumped) -> Real:
    """Sign of the centre's `_determinant` with the robot upright and the pendulum normal to the slope, in closed form."""
    coupling = lumped.pendulum_mass * lumped.length * lumped.radius
    about_y, about_z = (a + b for a, b in zip(lumped.gimbal_inertia[1:], lumped.pendulum_inertia[1:], strict=True))
    return -jnp.sign((coupling - about_y) * (coupling - about_z))


def joint_accelerations(gains: TrackingGains, joints: Joints) -> Pair:
    """Accelerations k_p (beta* - beta) + k_d (beta*' - beta') of the two joints, rad/s2."""
    drive, tilt = (gains.k_p * error + gains.k_d * rate for error, rate in zip(joints.error, joints.rate, strict=True))
    return drive, tilt


def signals(
    lumped: Lumped,
    gains: TrackingGains,
    reference: Reference,
    state: State,
    realisation: str = "axis_aligned",
) -> Signals:
    """Evaluate the law at one state.

    Args:
        lumped: robot and slope that the controller believes in.
        gains: the gains.
        reference: desired motion now.
        state: 12 components.
        realisation: one of REALISATIONS.
    """
    now = attitude.of_state(state)
    axes = attitude.axes_of(now)
    error = tracking_error(reference, now)
    velocity = attitude.to_slope(axes, dynamics.rolled(lumped, axes, now[8:]))
    attitude_law = realisation in BY_ATTITUDE
    if realisation == "axis_aligned":
        demand = axis_aligned.demanded_acceleration(lumped, gains, reference, posture_of(lumped, now), error)
        limited = axis_aligned.limit(lumped, demand, gains.a_max)
    else:
        demand = demanded_acceleration(gains, reference, error, velocity[:2])
        limited = limit(demand, gains.a_max) if attitude_law else demand
    lean = balancing_lean(lumped, limited)
    joints = joints_to(now, lean.direction)
    terms = dynamics.affine(lumped, now)
    centre = centre_accelerations(lumped, now, axes, terms)
    determinant = _determinant(centre) * _upright_sign(lumped)
    if attitude_law:
        pairs = joint_angle_accelerations(now, axes, terms)
        torque, determinant = assigning_torque(pairs, joint_accelerations(gains, joints)), -_determinant(pairs)
    elif realisation == "exact":
        torque = assigning_torque(centre, limited)
    else:
        paper = SpatialState(*state) if len(state) == len(SpatialState._fields) else attitude.paper_state(now)
        zero, assigned = jnp.zeros_like(paper.x), printed.assigned_accelerations(lumped.radius, paper, limited)
        torque = zero, *assigned, zero, zero
        if realisation == "pseudo_inverse":
            torque = printed.pseudo_inverse_torque(paper_affine(paper, now, terms), torque)
    return Signals(error, demand, limited, lean, joints, determinant, torque)


def law(
    robot: Robot,
    slope: Real,
    gains: TrackingGains,
    reference: ReferenceFunction,
    realisation: str = "axis_aligned",
) -> Callable[[Array, State, tuple[Array, ...]], ControllerOutput]:
    """Build the control law (time, state, memory) -> ControllerOutput; it has no memory.

    The torques are drive and tilt (N m). For "ideal" they are five accelerations (rad/s2), the input of `ideal_derivative`. The
    status is INFEASIBLE_LEAN on a slope past the bound (4) and where no lean gives the demand at time 0, SINGULAR_DECOUPLING
    where no torques give what is asked for, and SINGULAR_JOINTS where the pendulum points along the spin axis.

    Args:
        robot: the robot that the controller believes in.
        slope: rad.
        gains: the gains.
        reference: time -> Reference.
        realisation: one of REALISATIONS.
    """
    require_choice("realisation", realisation, REALISATIONS)
    lumped = lump(robot, slope)
    holdable = balancing_lean(lumped, (0.0, 0.0)).margin >= 0.0
    resting = jnp.where(holdable | (realisation == "ideal"), code(Status.OK), code(Status.INFEASIBLE_LEAN))

    def control(time: Array, state: State, memory: tuple[Array, ...]) -> ControllerOutput:
        del memory
        now = signals(lumped, gains, reference(time), state, realisation)
        solvable = (now.determinant > 0.0) | (realisation in ("ideal", "pseudo_inverse"))
        status = jnp.where(solvable, resting, code(Status.SINGULAR_DECOUPLING))
        if realisation in BY_ATTITUDE:
            # Later the nearest lean is kept; at the start there is nothing to recover from.
            status = jnp.where((time <= 0.0) & (now.lean.margin < 0.0), code(Status.INFEASIBLE_LEAN), status)
            along_axis = jnp.abs(dynamics.direction_of(attitude.of_state(state))[0]) < _ALONG_AXIS
            status = jnp.where(along_axis, code(Status.SINGULAR_JOINTS), status)
        return ControllerOutput(now.torque, (), status)

    return control


def resting_state(robot: Robot, slope: Real, position: Pair = (0.0, 0.0), heading: Real = 0.25 * jnp.pi) -> tuple[Real, ...]:
    """State at rest with the spin axis upright to `heading` and the pendulum at the lean that holds the slope, 12 components.

    Args:
        robot: the robot.
        slope: rad.
        position: x, y, m.
        heading: rad, the direction in which a positive spin rolls.
    """
    zero = jnp.zeros_like(jnp.asarray(slope, jnp.result_type(float, slope)))
    right = zero + 0.5 * jnp.pi
    upright = (zero + position[0], zero + position[1], heading + right, right, *(zero,) * 8)
    gimbal, pendulum = joints_to(upright, balancing_lean(lump(robot, slope), (zero, zero)).direction).error
    return (*upright[:5], gimbal, pendulum, *upright[7:])


def zero_dynamics_poles(robot: Robot, slope: Real, heading: Real = 0.0) -> Array:
    """Poles (1/s, complex, (8,)) of what is left when torques hold the centre still, linearised at rest on the slope.

    The states left are psi, theta, phi, beta1, beta2, psi', beta1' and beta2'. A pole in the right half plane means that the
    centre is a non-minimum-phase output: no law that prescribes it exactly is internally stable.
    """
    lumped = lump(robot, slope)
    kept = jnp.array([2, 3, 4, 5, 6, 7, 10, 11])
    rest = jnp.stack(resting_state(robot, slope, heading=heading))

    def held(reduced_state: Array) -> Array:
        state = tuple(rest.at[kept].set(reduced_state))
        now = attitude.of_state(state)
        axes = attitude.axes_of(now)
        centre = centre_accelerations(lumped, now, axes, dynamics.affine(lumped, now))
        torque = assigning_torque(centre, (0.0, 0.0))
        rates = dynamics.derivative_components(lumped, now, torque)
        return jnp.stack(paper_rates(state, now, rates))[kept]

    return jnp.linalg.eigvals(jax.jacfwd(held)(rest[kept]))
