"""The pendulum as it is declared to the diagnosis."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from simgap.config.plant import Input, State
from simgap.model.symbolic import SymbolicModel
from simgap.plants.urdf import load_urdf

URDF = Path(__file__).parents[2] / "configs" / "models" / "pendulum.urdf"


@lru_cache(maxsize=1)
def pendulum() -> SymbolicModel:
    """A uniform rod of 1 kg and 1 m on a hinge, driven by a torque; no friction."""
    states = {
        "angle": State(joint="hinge", quantity="position", unit="rad"),
        "rate": State(joint="hinge", quantity="velocity", unit="rad/s"),
    }
    return load_urdf(URDF, states, {"torque": Input(joint="hinge", unit="N*m")})
