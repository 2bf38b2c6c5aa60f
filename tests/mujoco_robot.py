"""The spatial robot as MuJoCo sees it: a sphere on a tilted plane with a gimbal hinge and a pendulum hinge."""

import jax.numpy as jnp
import mujoco
import numpy as np
import spatial_oracle as oracle

import jaxsphere as js

_XML = """
<mujoco>
  <option timestep="{dt}" gravity="{gx} 0 {gz}" integrator="implicitfast" cone="elliptic" iterations="20" tolerance="1e-12"
          impratio="100"/>
  <default>
    <geom solref="0.002 1" solimp="0.99 0.9999 0.0001"/>
  </default>
  <worldbody>
    <geom type="plane" size="50 50 1" friction="10 {spinning} 0" condim="{condim}"/>
    <body name="shell" pos="0 0 {r}">
      <freejoint name="shell"/>
      <inertial pos="0 0 0" mass="{m}" diaginertia="{shell}"/>
      <geom type="sphere" size="{r}" friction="10 {spinning} 0" condim="{condim}"/>
      <body name="gimbal">
        <joint name="gimbal" type="hinge" axis="0 0 1" damping="{drive}"/>
        <inertial pos="0 0 0" mass="{mi}" diaginertia="{gimbal}"/>
        <body name="pendulum">
          <joint name="pendulum" type="hinge" axis="0 1 0" damping="{tilt}"/>
          <inertial pos="{l} 0 0" mass="{mp}" diaginertia="{bob}"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="gimbal" gear="-1"/>
    <motor joint="pendulum"/>
  </actuator>
</mujoco>
"""


def build(robot, slope, dt):
    """Return (model, data) of the robot. The controls are drive and tilt torque, N m."""
    friction = robot.friction or js.Friction()
    model = mujoco.MjModel.from_xml_string(
        _XML.format(
            dt=dt,
            gx=-float(robot.gravity) * np.sin(slope),
            gz=-float(robot.gravity) * np.cos(slope),
            r=robot.shell_radius,
            l=robot.pendulum_length,
            m=robot.shell_mass,
            mi=robot.gimbal_mass,
            mp=robot.pendulum_mass,
            shell=" ".join(str(float(i)) for i in robot.shell_inertia),
            spinning=friction.spinning,
            condim=4 if friction.spinning else 3,
            drive=friction.drive_viscous,
            tilt=friction.tilt_viscous,
            bob=" ".join(str(float(i) + 1e-9) for i in robot.pendulum_inertia),
            gimbal=" ".join(str(float(i)) for i in robot.gimbal_inertia),
        )
    )
    return model, mujoco.MjData(model)


def set_state(model, data, robot, state):
    """Put the engine into a state (12,) of the spatial model, rolling without slip."""
    q, v = np.asarray(state[:7]), np.asarray(state[7:])
    rotation = np.asarray(oracle.shell_rotation(q))
    data.qpos[:3] = q[0], q[1], float(robot.shell_radius)
    mujoco.mju_mat2Quat(data.qpos[3:7], rotation.ravel())
    data.qpos[7], data.qpos[8] = q[5] - q[4], q[6]
    q_rate = np.asarray(oracle.null_space(robot, q, "corrected")) @ v
    data.qvel[:3] = q_rate[0], q_rate[1], 0.0
    data.qvel[3:6] = np.asarray(oracle.turning_in_body(oracle.shell_rotation, q, q_rate))
    data.qvel[6], data.qvel[7] = v[3] - v[2], v[4]
    mujoco.mj_forward(model, data)


def get_state(data):
    """Read a state (12,) of the spatial model with the lean in (0, pi); spin and gimbal angle up to full turns."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
    rotation = rotation.reshape(3, 3)
    axis = rotation[:, 2]
    sine = np.hypot(axis[0], axis[1])
    psi, theta = np.arctan2(axis[1], axis[0]), np.arctan2(sine, axis[2])
    level = np.array([-np.sin(psi), np.cos(psi), 0.0])
    frame = np.stack([np.cross(level, axis), level, axis], axis=1)
    unspun = frame.T @ rotation
    spin = np.arctan2(unspun[1, 0], unspun[0, 0])
    turning = unspun @ data.qvel[3:6]
    psi_rate = -turning[0] / sine
    spin_rate = turning[2] - psi_rate * axis[2]
    return np.array(
        [
            *(data.qpos[0], data.qpos[1], psi, theta, spin, spin + data.qpos[7], data.qpos[8]),
            *(psi_rate, turning[1], spin_rate, spin_rate + data.qvel[6], data.qvel[7]),
        ]
    )


def get_pose(data):
    """Read x, y, the rotation of the gimbal (9), and the angles of the pendulum and of the gimbal joint, whatever the lean."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
    sine, cosine = np.sin(data.qpos[7]), np.cos(data.qpos[7])
    gimbal = rotation.reshape(3, 3) @ np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.array([*data.qpos[:2], *gimbal.ravel(), data.qpos[8], data.qpos[7]])


def pose_of(state):
    """The numbers of `get_pose` of a state (12,) of the spatial model."""
    angles = jnp.stack([state[6], state[5] - state[4]])
    return jnp.concatenate([state[:2], oracle.gimbal_rotation(state[:7]).ravel(), angles])


def simulate(robot, slope, state, control, duration, dt, hold, save, read=get_state):
    """Roll the engine out under `control(time, state)`, held for `hold` s; return what `read` reads every `save` s.

    That are states (n, 12) unless another `read` is given.
    """
    model, data = build(robot, slope, dt)
    set_state(model, data, robot, state)
    states = []
    for step in range(round(duration / dt)):
        sampled, saved = step % round(hold / dt) == 0, step % round(save / dt) == 0
        now = read(data) if sampled or saved else None
        if saved:
            states.append(now)
        if sampled:
            data.ctrl[:] = control(step * dt, now)
        mujoco.mj_step(model, data)
    return np.array([*states, read(data)])
