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

Differs from the paper:
    (47), (48)  five accelerations cannot be assigned by two torques, so (48) is not what (47) gives.
    (53)        Phi is 2 x 5 and has no inverse; its pseudo-inverse, the smallest u, is used.
    (54)        the zero dynamics are called stable; `zero_dynamics_poles` shows that they are not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxsphere.checks import require_choice
from jaxsphere.controllers import axis_aligned
from jaxsphere.controllers.lean import Joints, Lean, balancing_lean, joints_to, limit
from jaxsphere.controllers.references import Pair, Reference, ReferenceFunction
from jaxsphere.controllers.spin_axis import posture_of
from jaxsphere.controllers.tracking_gains import TABLE_4 as TABLE_4
from jaxsphere.controllers.tracking_gains import TrackingGains
from jaxsphere.controllers.tracking_gains import check_gains as check_gains
from jaxsphere.models import spatial
from jaxsphere.models.spatial import Affine, State, frames, momentum
from jaxsphere.models.spatial.momentum import BETA1, BETA2, PHI, THETA, Lumped
from jaxsphere.numerics import Real, sincos
from jaxsphere.numerics.linear_algebra import dot, solve_pair
from jaxsphere.robot import Robot
from jaxsphere.status import ControllerOutput, Status, code

REALISATIONS = ("axis_aligned", "pendulum_attitude", "exact", "pseudo_inverse", "ideal")

# Those that lean the pendulum and control the two joints.
BY_ATTITUDE = ("axis_aligned", "pendulum_attitude")

_OUTPUT_PAIR, _JOINT_PAIR = (THETA, PHI), (BETA1, BETA2)


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
    return state[0], state[1]


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
    radius, lumped = robot.shell_radius, momentum.lump(robot, slope)
    return -(radius**2) * sincos(state[3])[0] * _determinant(spatial.affine(lumped, state), _OUTPUT_PAIR)


def assigned_accelerations(lumped: Lumped, state: State, demand: Pair) -> tuple[Array, Array]:
    """Accelerations (theta'', phi'') that give the centre the demanded one, rad/s2: u = Phi^+ (v - Phi' v), Eq. (53).

    Differs from the paper: the pseudo-inverse of Phi stands for its inverse; u is zero on psi, beta1 and beta2.
    """
    angles, velocity = momentum.angles_of(state), tuple(state)[7:]
    _, (drift_x, drift_y) = momentum.center_of(lumped, angles, velocity, "corrected")
    along_x = angles.c_psi * demand[0] + angles.s_psi * demand[1] - drift_x
    along_y = angles.c_psi * demand[1] - angles.s_psi * demand[0] - drift_y
    return along_x / lumped.radius, -along_y / (lumped.radius * angles.s_theta)


def ideal_derivative(robot: Robot, state: State, accelerations: State) -> tuple[Real, ...]:
    """Time derivative (C v, u) of a state whose five accelerations u (rad/s2) are the input, Eq. (48)."""
    return (*frames.coordinate_rates(robot, state), *accelerations)


def pseudo_inverse_torque(terms: Affine, accelerations: tuple[Real, ...]) -> tuple[Array, Array]:
    """Torques G^+ (u - f2) that come nearest to the five accelerations u (rad/s2), N m, Eq. (47)."""
    missing = [wanted - drift for wanted, drift in zip(accelerations, terms.drift, strict=True)]
    cross_term = dot(terms.drive, terms.tilt)
    normal = (dot(terms.drive, terms.drive), cross_term), (cross_term, dot(terms.tilt, terms.tilt))
    return solve_pair(normal, (dot(terms.drive, missing), dot(terms.tilt, missing)))


def assigning_torque(terms: Affine, pair: tuple[int, int], wanted: Pair) -> tuple[Array, Array]:
    """Torques that give the two accelerations of v numbered `pair` the wanted values (rad/s2), N m."""
    i, j = pair
    matrix = (terms.drive[i], terms.tilt[i]), (terms.drive[j], terms.tilt[j])
    return solve_pair(matrix, (wanted[0] - terms.drift[i], wanted[1] - terms.drift[j]))


def _determinant(terms: Affine, pair: tuple[int, int]) -> Array:
    i, j = pair
    return terms.drive[i] * terms.tilt[j] - terms.tilt[i] * terms.drive[j]


def _upright_sign(lumped: Lumped, pair: tuple[int, int]) -> Real:
    """Sign of `_determinant` with the robot upright and the pendulum normal to the slope, in closed form."""
    if pair == _JOINT_PAIR:
        return -1.0
    coupling = lumped.pendulum_mass * lumped.length * (lumped.radius - lumped.length)
    _, about_y, about_z = lumped.gimbal_inertia
    return jnp.sign((coupling - about_y) * (coupling - about_z))


def joint_accelerations(gains: TrackingGains, joints: Joints, rates: Pair) -> Pair:
    """Accelerations k_p (beta* - beta) + k_d (beta*' - beta') of the two joints, rad/s2."""
    return (
        gains.k_p * joints.error[0] + gains.k_d * (joints.rate[0] - rates[0]),
        gains.k_p * joints.error[1] + gains.k_d * (joints.rate[1] - rates[1]),
    )


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
    velocity = momentum.center_velocity(lumped, state)
    error = tracking_error(reference, state)
    attitude = realisation in BY_ATTITUDE
    if realisation == "axis_aligned":
        posture = posture_of(lumped, state)
        demand = axis_aligned.demanded_acceleration(lumped, gains, reference, posture, error)
        limited = axis_aligned.limit(lumped, demand, gains.a_max)
    else:
        demand = demanded_acceleration(gains, reference, error, velocity)
        limited = limit(demand, gains.a_max) if attitude else demand
    lean = balancing_lean(lumped, limited)
    joints = joints_to(state, lean.direction)
    terms = spatial.affine(lumped, state)
    about_theta, about_phi = assigned_accelerations(lumped, state, limited)
    pair, wanted = _OUTPUT_PAIR, (about_theta, about_phi)
    if attitude:
        pair, wanted = _JOINT_PAIR, joint_accelerations(gains, joints, (state[10], state[11]))
    zero = jnp.zeros_like(about_theta)
    if realisation == "ideal":
        torque = zero, about_theta, about_phi, zero, zero
    elif realisation == "pseudo_inverse":
        torque = pseudo_inverse_torque(terms, (zero, about_theta, about_phi, zero, zero))
    else:
        torque = assigning_torque(terms, pair, wanted)
    return Signals(error, demand, limited, lean, joints, _determinant(terms, pair) * _upright_sign(lumped, pair), torque)


def law(
    robot: Robot,
    slope: Real,
    gains: TrackingGains,
    reference: ReferenceFunction,
    realisation: str = "axis_aligned",
) -> Callable[[Array, State, tuple[Array, ...]], ControllerOutput]:
    """Build the control law (time, state, memory) -> ControllerOutput; it has no memory.

    The torques are drive and tilt (N m). For "ideal" they are five accelerations (rad/s2), the input of `ideal_derivative`. The
    status is INFEASIBLE_LEAN on a slope past the bound (4) and where no lean gives the demand at time 0, and
    SINGULAR_DECOUPLING where no torques give what is asked for.

    Args:
        robot: the robot that the controller believes in. slope: rad. gains: the gains. reference: time -> Reference.
        realisation: one of REALISATIONS.
    """
    require_choice("realisation", realisation, REALISATIONS)
    lumped = momentum.lump(robot, slope)
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
        return ControllerOutput(now.torque, (), status)

    return control


def resting_state(robot: Robot, slope: Real, position: Pair = (0.0, 0.0), heading: Real = 0.25 * jnp.pi) -> tuple[Real, ...]:
    """State at rest with the spin axis upright to `heading` and the pendulum at the lean that holds the slope, 12 components.

    Args:
        robot: the robot. slope: rad. position: x, y, m. heading: rad, the direction in which a positive spin rolls.
    """
    zero = jnp.zeros_like(jnp.asarray(slope, jnp.result_type(float, slope)))
    right = zero + 0.5 * jnp.pi
    upright = (zero + position[0], zero + position[1], heading + right, right, *(zero,) * 8)
    gimbal, pendulum = joints_to(upright, balancing_lean(momentum.lump(robot, slope), (zero, zero)).direction).error
    return (*upright[:5], gimbal, pendulum, *upright[7:])


def zero_dynamics_poles(robot: Robot, slope: Real, heading: Real = 0.0) -> Array:
    """Poles (1/s, complex, (8,)) of what is left when torques hold the centre still, linearised at rest on the slope.

    The states left are psi, theta, phi, beta1, beta2, psi', beta1' and beta2'. A pole in the right half plane means that the
    centre is a non-minimum-phase output: no law that prescribes it exactly is internally stable.
    """
    lumped = momentum.lump(robot, slope)
    kept = jnp.array([2, 3, 4, 5, 6, 7, 10, 11])
    rest = jnp.stack(resting_state(robot, slope, heading=heading))

    def held(reduced_state: Array) -> Array:
        state = tuple(rest.at[kept].set(reduced_state))
        terms = spatial.affine(lumped, state)
        torque = assigning_torque(terms, _OUTPUT_PAIR, assigned_accelerations(lumped, state, (0.0, 0.0)))
        return jnp.stack(spatial.derivative_components(lumped, state, torque))[kept]

    return jnp.linalg.eigvals(jax.jacfwd(held)(rest[kept]))
