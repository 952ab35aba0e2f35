"""The same pendulum in MuJoCo, for the effects that MuJoCo has: an engine that shares nothing with the fit."""

from __future__ import annotations

import mujoco
import numpy as np

from tests.undeclared.rig.pendulum import RATE, multisine

STEP = 1e-4
_XML = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="{gx} 0 {gz}"/>
  <worldbody>
    <body>
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{damping}" stiffness="{stiffness}"/>
      <inertial pos="0 0 -0.5" mass="{mass}" diaginertia="{moment} {moment} 1e-6"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" gear="{gear}"/></actuator>
</mujoco>
"""
SINGLES = ("viscous_friction", "spring", "input_gain", "mass", "gravity_tilt", "sensor_offset", "input_bias")


def record(
    name: str, rng: np.random.Generator, sigma: float, seconds: float = 15.0, traces: int = 2
) -> tuple[list[tuple[np.ndarray, np.ndarray, np.ndarray]], tuple[str, str], float]:
    """Traces (t, y, u) with one hidden effect, its (name, on), and its size."""
    signed = rng.uniform(0.03, 0.1) * rng.choice([-1.0, 1.0])
    numbers = {"damping": 0.0, "stiffness": 0.0, "gear": 1.0, "mass": 1.0, "tilt": 0.0, "offset": 0.0, "bias": 0.0}
    keys = {
        "viscous_friction": ("damping", float(rng.uniform(0.03, 0.15)), ("viscous_friction", "hinge")),
        "spring": ("stiffness", float(rng.uniform(0.1, 0.5)), ("spring", "hinge")),
        "input_gain": ("gear", 1.0 + 2 * signed, ("input_gain", "torque")),
        "mass": ("mass", 1.0 + 2 * signed, ("parameter_error", "rod.mass")),
        "gravity_tilt": ("tilt", signed, ("gravity_tilt", "plant")),
        "sensor_offset": ("offset", signed, ("sensor_offset", "angle")),
        "input_bias": ("bias", signed, ("input_bias", "torque")),
    }
    key, size, effect = keys[name]
    numbers[key] = size
    tilt, mass = numbers["tilt"], numbers["mass"]
    xml = _XML.format(
        step=STEP, gx=9.81 * np.sin(tilt), gz=-9.81 * np.cos(tilt), damping=numbers["damping"],
        stiffness=numbers["stiffness"], mass=mass, moment=mass / 12.0, gear=numbers["gear"],
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_string(xml)
    n, sample = int(seconds * RATE) + 1, round(1.0 / (RATE * STEP))
    out = []
    for _ in range(traces):
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0] = rng.uniform(-0.5, 0.5, 2)
        u, q = multisine(rng, n, RATE), np.empty(n)
        for k in range(n):
            q[k] = data.qpos[0]
            data.ctrl[0] = u[k] + numbers["bias"]
            mujoco.mj_step(model, data, sample)
        y = q[:, None] + numbers["offset"] + sigma * rng.standard_normal((n, 1))
        out.append((np.arange(n) / RATE, y, u[:, None]))
    return out, effect, size
