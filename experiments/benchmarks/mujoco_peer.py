"""The spatial robot in MuJoCo, for speed: free rolling of many lanes on all threads, Euler, 1 ms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import jaxsphere as js

_XML = """
<mujoco>
  <option timestep="0.001" gravity="{gx} 0 {gz}" integrator="Euler"/>
  <worldbody>
    <geom type="plane" size="50 50 1" friction="10 0 0" condim="3"/>
    <body pos="0 0 {r}">
      <freejoint/>
      <inertial pos="0 0 0" mass="{m}" diaginertia="{shell}"/>
      <geom type="sphere" size="{r}" friction="10 0 0" condim="3"/>
      <body>
        <joint type="hinge" axis="0 0 1"/>
        <inertial pos="0 0 0" mass="{mi}" diaginertia="{gimbal}"/>
        <body>
          <joint type="hinge" axis="0 1 0"/>
          <inertial pos="{l} 0 0" mass="{mp}" diaginertia="1e-9 1e-9 1e-9"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def rollouts(robot: js.Robot, slope: float, lanes: int, steps: int, threads: int) -> Callable[[], Any]:
    """Return a function that rolls `lanes` robots with different spins out for `steps` steps on `threads` threads."""
    import mujoco
    import mujoco.rollout

    gravity = float(robot.gravity)
    shape = {
        "gx": -gravity * np.sin(slope),
        "gz": -gravity * np.cos(slope),
        "r": robot.shell_radius,
        "l": robot.pendulum_length,
    }
    masses = {"m": robot.shell_mass, "mi": robot.gimbal_mass, "mp": robot.pendulum_mass}
    moments = {name: " ".join(map(str, getattr(robot, f"{name}_inertia"))) for name in ("shell", "gimbal")}
    model = mujoco.MjModel.from_xml_string(_XML.format(**shape, **masses, **moments))  # type: ignore[attr-defined]
    data = [mujoco.MjData(model) for _ in range(threads)]  # type: ignore[attr-defined]
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS  # type: ignore[attr-defined]
    states = np.zeros((lanes, mujoco.mj_stateSize(model, full)))  # type: ignore[attr-defined]
    for lane, spin in enumerate(np.linspace(0.0, 3.0, lanes)):
        mujoco.mj_resetData(model, data[0])  # type: ignore[attr-defined]
        # Shell upright on its rim: its z axis, about which the gimbal turns, lies in the slope.
        data[0].qpos[3:7] = np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0
        data[0].qvel[0], data[0].qvel[5] = float(robot.shell_radius) * spin, spin
        mujoco.mj_getState(model, data[0], states[lane], full)  # type: ignore[attr-defined]

    def run() -> Any:
        with mujoco.rollout.Rollout(nthread=threads) as pool:
            return pool.rollout(model, data, states, nstep=steps)

    return run
