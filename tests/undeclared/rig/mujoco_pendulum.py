"""The same pendulum in MuJoCo, for the effects that MuJoCo has: an engine that shares nothing with the fit."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from tests.undeclared.rig.draw import SIZES
from tests.undeclared.rig.pendulum import NOMINAL, RATE, Draft, Hidden, multisine

STEP = 1e-4
_XML = """
<mujoco>
  <option timestep="{step}" integrator="RK4" gravity="{gx} 0 {gz}"/>
  <worldbody>
    <body>
      <joint name="hinge" type="hinge" axis="0 1 0" damping="{damping}" stiffness="{stiffness}"/>
      <inertial pos="0 0 -{com}" mass="{mass}" diaginertia="{moment} {moment} 1e-6"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" gear="{gear}" forcelimited="true" forcerange="-{limit} {limit}"/></actuator>
</mujoco>
"""
SINGLES = (
    "viscous_friction", "spring", "input_gain", "mass", "length", "com", "inertia", "gravity_tilt", "sensor_offset",
    "input_bias", "input_saturation", "fractional_delay",
)  # fmt: skip
_NULL = {"b": 0.0, "k": 0.0, "gain": 1.0, "tilt": 0.0, "bias": 0.0, "limit": 1e6, **NOMINAL}


def draw(rng: np.random.Generator, name: str = "") -> Hidden:
    """One effect that MuJoCo can act out, any of SINGLES if none is named."""
    draft = Draft()
    SIZES[name or str(rng.choice(SINGLES))](rng, draft)
    if draft.delay:  # of this engine's steps
        draft.delay = round(draft.delay / STEP) * STEP
        draft.parameters["input_delay torque"]["delay"] = draft.delay
    return draft.hidden()


def record(
    hidden: Hidden, rng: np.random.Generator, sigma: float, seconds: float = 15.0, traces: int = 2
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Traces (t, y, u) of the angle with white noise."""
    h = {**_NULL, **hidden.rig}
    xml = _XML.format(
        step=STEP, gx=9.81 * math.sin(h["tilt"]), gz=-9.81 * math.cos(h["tilt"]), damping=h["b"], stiffness=h["k"],
        com=h["com"], mass=h["mass"], moment=h["inertia"] - h["mass"] * h["com"] ** 2, gear=h["gain"],
        limit=h["limit"] / h["gain"],
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_string(xml)
    n, sample, late = int(seconds * RATE) + 1, round(1.0 / (RATE * STEP)), round(hidden.delay / STEP)
    whole, part = divmod(late, sample)
    out = []
    for _ in range(traces):
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0] = rng.uniform(-0.5, 0.5, 2)
        u, q = multisine(rng, n, RATE), np.empty(n)
        for k in range(n):
            q[k] = data.qpos[0]
            if part:  # the command before still acts
                data.ctrl[0] = u[max(k - whole - 1, 0)] + h["bias"]
                mujoco.mj_step(model, data, part)
            data.ctrl[0] = u[max(k - whole, 0)] + h["bias"]
            mujoco.mj_step(model, data, sample - part)
        y = q[:, None] + hidden.offset + sigma * rng.standard_normal((n, 1))
        out.append((np.arange(n) / RATE, y, u[:, None]))
    return out
