"""What CONTRIBUTING says of an effect: one class and its name in the registry, and every room has it."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from simgap import effects, plugins
from simgap.config.load import load_case
from simgap.config.plant import AddedEffect
from simgap.diagnosis.simulation.past import memories
from simgap.diagnosis.simulation.supermodel import build_supermodel
from simgap.diagnosis.verdict.words import describe, phrase
from simgap.plants.plant_model import PlantModel
from simgap.simulators.commands import CommandPath
from simgap.simulators.joints import JointPlant, joint_forces
from simgap.simulators.mujoco import MuJoCoJoints
from simgap.stages.effects import listed, printed
from tests.undeclared.plant import pendulum

FORCE = '''
"""A brush that drags less than in proportion to speed."""

import sympy as sp

from simgap.effects.base import CoordinateEffect, EffectParameter


class BrushDrag(CoordinateEffect):
    """Drag that grows with the root of speed."""

    name = "brush_drag"
    formula = "F = -c sqrt(|v|) sign(v)"
    source = "a test"
    parameters = (EffectParameter("c", "{force}", "size", null=0.0, lower=0.0),)

    def force(self, position, velocity, values):
        """-c sqrt(|v|) sign(v)."""
        return -values["c"] * sp.sqrt(sp.Abs(velocity)) * sp.sign(velocity)
'''
MEMORY = '''
"""A bus that is late and a motor that lags, in a fixed ratio."""

from simgap.effects.base import EffectParameter
from simgap.effects.commands import MemoryInputEffect
from simgap.effects.base import multiple


class SlowDrive(MemoryInputEffect):
    """A delay of T and a lag of 2 T."""

    name = "slow_drive"
    formula = "u'(t) = z(t - T), 2 T dz/dt = u - z"
    source = "a test"
    parameters = (EffectParameter("T", "s", "cycle", null=0.0, lower=0.0),)

    def starts(self, scales):
        """One sampling interval."""
        return (multiple("T", scales.interval),)

    def delay(self, values):
        """T."""
        return values["T"]

    def lag(self, values):
        """2 T."""
        return 2 * values["T"]
'''

BRISTLES = '''
"""Friction of a brush that remembers which way it was bent."""

import sympy as sp

from simgap.effects.base import EffectParameter, MemoryForceEffect
from simgap.effects.base import Start


class SoftBristles(MemoryForceEffect):
    """Friction that comes back with the square of how far its bristles are bent."""

    name = "soft_bristles"
    formula = "F = -F_c z |z|, dz/dt = (v - |v| z) / d"
    source = "a test"
    parameters = (
        EffectParameter("F_c", "{force}", "force when sliding", null=0.0, lower=0.0),
        EffectParameter("d", "{position}", "way to bend", null=0.05, lower=1e-6, shape=True),
    )

    def starts(self, scales):
        """The level, over one way."""
        return (Start(1, lambda c: {"F_c": c[0], "d": 0.02 * scales.speed}),)

    def rate(self, memory, velocity, values):
        """(v - |v| z) / d."""
        return (velocity - sp.Abs(velocity) * memory) / values["d"]

    def force(self, memory, velocity, values):
        """-F_c z |z|."""
        return -values["F_c"] * memory * sp.Abs(memory)
'''


@pytest.fixture
def added(tmp_path, monkeypatch):
    """Write the file, add its name to the registry."""

    def make(text, name):
        (tmp_path / f"{name.lower()}.py").write_text(text)
        monkeypatch.syspath_prepend(str(tmp_path))
        known = re.search('name = "(.*)"', text).group(1)
        table = {**plugins.BUILT_IN["effects"], known: f"{name.lower()}:{name}"}
        monkeypatch.setattr(plugins, "BUILT_IN", {**plugins.BUILT_IN, "effects": table})
        return effects.effect(known)

    return make


def found(effect, on, symbol, value, unit):
    return {"name": effect.name, "on": on,
            "parameters": {symbol: {"value": value, "ci95": [0.9 * value, 1.1 * value], "unit": unit}}}  # fmt: skip


def test_a_force(added, vary):
    effect = added(FORCE, "BrushDrag")
    assert "brush_drag" in printed(listed(None))
    assert effect.units(pendulum(), "hinge") == {"c": "N*m"}
    # fitted: the supermodel's dynamics at c = 0.2, by hand 3 N^-1 m^-1 s^-2 * c sqrt(|v|)
    fit = build_supermodel(pendulum(), ("angle", "rate"), ("brush_drag",))
    (slot,) = fit.find("brush_drag", "hinge").slots
    theta = fit.null.copy()
    theta[slot] = 0.2
    rates = fit.dynamics.derivative(np.array([0.0, 0.49]), np.zeros(1), theta, np.array([1.0]))
    assert rates == pytest.approx([0.49, -3.0 * 0.2 * 0.7], rel=1e-12)
    # described
    assert describe(found(effect, "hinge", "c", 0.2, "N*m")) == "brush drag at the hinge (c = 0.20 ± 0.02 N m)"
    # in the nominal model of a case, and acted out by an engine of joints
    path = vary("pendulum", {"plant.effects": [{"name": "brush_drag", "on": "hinge", "parameters": {"c": 0.2}}]})
    plant = PlantModel.of(load_case(path), path.parent)
    step = plant.sampled.step(np.array([[0.0, 0.49]]), np.zeros((1, 1)))
    assert step[0, 1] == pytest.approx(0.49 - plant.tau * 3.0 * 0.2 * 0.7, rel=1e-12)
    joints = JointPlant(Path("m.urdf"), ("hinge",), (0,), (1,), ((0,),), ("u",), 0.01)
    assert MuJoCoJoints.acts_out(effect)
    forces = joint_forces(joints, [AddedEffect(name="brush_drag", on="hinge", parameters={"c": 0.2})])
    assert forces(0.0, 0.49, 1.0) == pytest.approx([1.0 - 0.2 * 0.7], rel=1e-12)


def test_an_effect_with_memory(added, vary):
    effect = added(MEMORY, "SlowDrive")
    assert "slow_drive" in printed(listed(None))
    # fitted: the delay and the lag of the input as functions of the one parameter
    fit = build_supermodel(pendulum(), ("angle", "rate"), ("slow_drive",))
    (slot,) = fit.find("slow_drive", "torque").slots  # beside faults of the recording
    theta = fit.null.copy()
    assert list(fit.memory(theta)) == [0.0, 0.0]
    theta[slot] = 0.01
    assert list(fit.memory(theta)) == pytest.approx([0.01, 0.02])
    # described
    assert phrase({"name": "slow_drive", "on": "torque"}) == "the slow drive of torque"
    assert "T = 0.010 ± 0.001 s" in describe(found(effect, "torque", "T", 0.01, "s"))
    # left to gamma, or carried as a state; as seconds where its memory is left out
    slow = {"name": "slow_drive", "on": "u", "parameters": {"T": 0.01}}
    state = {"plant.states.u_lagged": {"unit": "N*m", "lag_of": "u"}, "domain.X.u_lagged": [-1.2, 1.2]}
    path = vary("pendulum", {"plant.effects": [slow]})
    bare = PlantModel.of(load_case(path), path.parent)
    assert bare.carried.state_names == ("x1", "x2")
    path = vary("pendulum", {"plant.effects": [slow], **state})
    plant = PlantModel.of(load_case(path), path.parent)
    lag = plant.sampled.step(np.array([[0.0, 0.0, 0.5]]), np.array([[-0.1]]))[0, 2]
    assert lag == pytest.approx(0.5 - plant.tau * 0.6 / 0.02, rel=1e-12)
    assert float(plant.corrected.delays["u"].subs(plant.corrected.values())) == 0.01
    assert bare.corrected_by([effects.AppliedEffect("slow_drive", "u", {"T": 0.01})])[1] == pytest.approx({"u": 0.03})
    # acted out on the path of the command
    assert MuJoCoJoints.acts_out(effect)
    command = CommandPath.of([AddedEffect(**slow)], "u", [-1.0, 1.0], 0.0)
    assert (command.delay, command.lag) == pytest.approx((0.01, 0.02))
    assert math.isclose(command.static(0.4), 0.4)


def test_a_force_with_memory(added):
    """One file and one line: its own state is simulated, and begun from the motion before a window."""
    effect = added(BRISTLES, "SoftBristles")
    fit = build_supermodel(pendulum(), ("angle", "rate"), (effect.name,))
    found = fit.find("soft_bristles", "hinge")
    theta = fit.null.copy()
    theta[list(found.slots)] = 0.2, 0.1
    rates = fit.dynamics.derivative(np.array([0.0, 0.49, 0.5]), np.zeros(1), theta, np.array([1.0]))
    assert rates == pytest.approx([0.49, -3.0 * 0.2 * 0.25, 2.45], rel=1e-12)
    t, one_way = np.arange(0.0, 1.0, 0.01), np.full((100, 1), 0.3)  # bent all the way after three ways
    z = memories(fit.past, theta, t, one_way, np.array([0]))
    assert z[:, 0] == pytest.approx(1.0 - np.exp(-0.3 * t / 0.1), abs=1e-9)
    # in models and in words
    inserted = effect.insert(pendulum(), "hinge", {"F_c": 0.2, "d": 0.1})
    assert inserted.state_names == ("angle", "rate", "hinge_soft_bristles")
