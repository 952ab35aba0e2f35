"""The compiled model is compared with Drake's own numbers; a model that differs is a broken promise."""

from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from numba import njit

import simgap
from simgap.errors import BrokenPromise
from simgap.plants import drake_check
from simgap.plants.context import Context
from tests.drake_numbers import time_derivatives

EFFECTS = [
    {"name": "viscous_friction", "on": "hinge", "parameters": {"b": 0.1}},
    {"name": "input_saturation", "on": "u", "parameters": {"limit": 0.9}},
    {"name": "input_lag", "on": "u", "parameters": {"T": 0.05}},
]


@pytest.mark.parametrize("name", ["pendulum", "turtlebot"])
def test_the_cases_agree_with_drake(name, root):
    context = Context.load(root / "configs" / "cases" / f"{name}.yaml")
    context.plant.check_with_drake(context.box, context.input_set)


def test_a_wrong_term_breaks_the_promise_by_name(vary):
    context = Context.load(vary("pendulum", {}))
    plant, box, inputs = context.plant, context.box, context.input_set
    right = plant.declared
    wrong = replace(right, xdot=(right.xdot[0], right.xdot[1] + sp.Float(1e-7)))
    with pytest.raises(BrokenPromise, match=r"dx/dt differs from Drake's in x2"):
        drake_check.check_declared(wrong, plant.section, plant.folder / plant.section.urdf, box, inputs)
    stray = replace(plant.sampled)
    stray.__dict__["kernel"] = njit(lambda x, u: (x[0], x[1]))
    with pytest.raises(BrokenPromise, match=r"the compiled map differs from Drake's in x1"):
        drake_check.check_map(stray, box, inputs)


def test_a_case_is_a_drake_system_in_a_line(root):
    system = simgap.load_plant(root / "configs" / "cases" / "turtlebot.yaml").drake_system()
    assert (system.num_continuous_states(), system.get_input_port().size()) == (3, 2)


def test_effects_are_in_the_drake_system(vary):
    from pydrake.systems.analysis import Simulator

    plant = Context.load(vary("pendulum", {"plant.effects": EFFECTS})).plant
    system = plant.drake_system()
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, (50, 3)), rng.uniform(-1.2, 1.2, (50, 1))
    cut = np.clip(u[:, 0], -0.9, 0.9)  # the lag follows what the saturation lets through
    slope = 3.0 * (x[:, 2] - 0.1 * x[:, 1]) - 14.715 * np.sin(x[:, 0])
    by_hand = np.stack([x[:, 1], slope, (cut - x[:, 2]) / 0.05], axis=1)
    assert np.abs(time_derivatives(system, x, u) - by_hand).max() <= 1e-12
    simulator = Simulator(system)  # it runs in Drake's own simulator
    system.get_input_port().FixValue(simulator.get_mutable_context(), np.zeros(1))
    simulator.AdvanceTo(0.1)
