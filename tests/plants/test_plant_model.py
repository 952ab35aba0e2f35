"""The one door to the nominal model: its shapes, what each holds, and that a stage builds the plant once."""

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.effects import AppliedEffect
from simgap.errors import UserError
from simgap.plants import plant_model
from simgap.plants.plant_model import PlantModel
from simgap.stages import synthesis

FRICTION = {"name": "viscous_friction", "on": "hinge", "parameters": {"b": 0.1}}
LAG = {"name": "input_lag", "on": "u", "parameters": {"T": 0.03}}
DELAY = {"name": "input_delay", "on": "u", "parameters": {"delay": 0.02}}


def plant(vary, *effects, **changes):
    path = vary("pendulum", {"plant.effects": list(effects), **changes})
    return PlantModel.of(load_case(path), path.parent)


def test_each_shape_holds_what_it_says(vary):
    p = plant(vary, FRICTION, LAG, DELAY)
    assert p.declared.state_names == ("x1", "x2")
    assert "hinge.viscous_friction.b" not in p.declared.parameters
    assert p.corrected.state_names == ("x1", "x2", "u_lagged")
    assert list(p.corrected.delays) == ["u"]
    assert p.carried.state_names == ("x1", "x2")
    assert not p.carried.delays
    # x2+ = x2 + tau (3 u - 14.715 sin(x1) - 3 b x2): friction, neither lag nor delay
    x, u, tau = np.array([[0.2, -0.4]]), np.array([[0.7]]), p.sampled.tau
    slope = 3.0 * (0.7 + 0.1 * 0.4) - 14.715 * np.sin(0.2)
    assert np.allclose(p.sampled.step(x, u), [[0.2 - 0.4 * tau, -0.4 + tau * slope]], rtol=1e-12)


def test_a_lag_among_the_states_is_carried(vary):
    state = {"plant.states.u_lagged": {"unit": "N*m", "lag_of": "u"}, "domain.X.u_lagged": [-1.2, 1.2]}
    assert plant(vary, LAG, DELAY, **state).carried.state_names == ("x1", "x2", "u_lagged")
    with pytest.raises(UserError, match="lagged inputs"):
        _ = plant(vary, FRICTION, **state).carried


def test_found_effects_that_remember_become_seconds(vary):
    p = plant(vary, FRICTION)
    found = [AppliedEffect("input_delay", "u", {"delay": 0.02}), AppliedEffect("input_lag", "u", {"T": 0.01}),
             AppliedEffect("input_gain", "u", {"ratio": 0.9})]  # fmt: skip
    model, late = p.corrected_by(found)
    assert late == pytest.approx({"u": 0.03})
    assert model.state_names == p.corrected.state_names
    assert model.parameters["u.input_gain.ratio"].value == 0.9


def test_synthesis_builds_the_plant_once(vary, tmp_path, monkeypatch):
    built = []
    real = plant_model.declared_model
    monkeypatch.setattr(plant_model, "declared_model", lambda *args: built.append(args) or real(*args))
    synthesis.run(vary("pendulum", {"synthesis.cells": [100, 100]}), None, tmp_path / "c.npz", tmp_path / "s.json", 1)
    assert len(built) == 1


def test_a_case_without_domain_cannot_be_sampled(vary):
    path = vary("pendulum", {})
    with pytest.raises(UserError, match=r"domain\.tau"):
        _ = PlantModel(load_case(path).plant, path.parent).sampled
