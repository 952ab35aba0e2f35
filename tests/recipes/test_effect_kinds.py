"""What CONTRIBUTING says of every further kind of effect: one class of its kind and its name is all that it takes."""

import re

import pytest

from simgap import effects, plugins
from simgap.diagnosis.simulation.supermodel import build_supermodel
from simgap.extras.engines.mujoco_wheeled import MuJoCoWheeled
from simgap.model.symbolic import symbol
from simgap.simulators.equations import EquationsEngine
from simgap.simulators.mujoco import MuJoCoJoints
from simgap.stages.effects import listed, printed
from tests.effects.plants import unicycle
from tests.undeclared.plant import pendulum

HEAD = '''
from simgap.effects.base import CoordinateTarget, Effect, EffectParameter, Start, WheelEffect, multiple
from simgap.effects.commands import DriveEffect, StaticInputEffect
from simgap.effects.drive_train import DriveTrainEffect, Law
from simgap.model.symbolic import symbol


class Own(Kind):
    """One of its kind."""

    name = "own_effect"
    formula = "see below"
    source = "a test"
    parameters = (EffectParameter("a", "UNIT", "size", null=NULL, lower=0.0),)
'''
STATIC = '''
    def applied(self, command, values):
        """A command that grows faster than it is told."""
        return command + values["a"] * command**3
'''
DRIVE = '''
    def felt(self, drive, velocity, values):
        """Less of it at speed."""
        return drive * (1 - values["a"] * velocity)
'''
TRAIN = '''
    def starts(self, scales):
        """A motor as heavy as its link."""
        return (multiple("a", scales.inertia),)

    def law(self, values):
        """A soft shaft."""
        return Law(values["a"], 4.0)
'''
WHEELS = '''
    def turned(self, left, right, values):
        """Tyres that have worn alike."""
        return values["a"] * left, values["a"] * right
'''
PLANT = '''
    kind, rank = "plant", 5

    def targets(self, model):
        """Whatever feels gravity."""
        return ("plant",) if model.gravity is not None else ()

    def insert(self, model, on, values):
        """More of it."""
        down = model.gravity[2]
        return model.substitute({down: symbol(down) * values["a"]})
'''
HELD = {"angle": 0.3, "rate": 2.0, "torque": 0.5, "hinge_motor": 0.4, "hinge_motor_rate": 1.0}
DRIVEN = {"px": 0.0, "py": 0.0, "heading": 0.0, "speed": 0.5, "turn": 0.2}
BARE = -14.715 * 0.2955202066613396  # 3 g / 2 L of a rod that hangs, at sin(.3)


@pytest.fixture
def added(tmp_path, monkeypatch):
    """A class of a kind in a file of its own, and its name in the registry: the two steps of the recipe."""

    def make(kind, text, unit, null):
        text = HEAD.replace("(Kind)", f"({kind})").replace("UNIT", unit).replace("NULL", str(null)) + text
        module = f"own_{re.sub('[^a-z]', '', kind.lower())}"
        (tmp_path / f"{module}.py").write_text(text)
        monkeypatch.syspath_prepend(str(tmp_path))
        table = {**plugins.BUILT_IN["effects"], "own_effect": f"{module}:Own"}
        monkeypatch.setattr(plugins, "BUILT_IN", {**plugins.BUILT_IN, "effects": table})
        effects._instance.cache_clear()
        return effects.effect("own_effect")

    yield make
    effects._instance.cache_clear()


@pytest.mark.parametrize(
    ("kind", "text", "unit", "null", "on", "state", "rate", "engine"),
    [
        ("StaticInputEffect", STATIC, "1/{input}^2", 0.0, "torque", "rate", BARE + 1.5375, MuJoCoJoints),
        ("DriveEffect", DRIVE, "s/{position}", 0.0, "torque", "rate", BARE + 3.0 * 0.5 * 0.8, MuJoCoJoints),
        ("DriveTrainEffect", TRAIN, "{force}*s^2/{position}", 0.0, "hinge", "rate", BARE + 3.0 * 0.4, EquationsEngine),
        ("WheelEffect", WHEELS, "1", 1.0, "plant", "px", 0.05, MuJoCoWheeled),
        ("Effect", PLANT, "1", 1.0, "plant", "rate", 0.1 * BARE + 1.5, EquationsEngine),
    ],
)  # fmt: skip
def test_a_class_and_its_name_are_all_that_it_takes(added, kind, text, unit, null, on, state, rate, engine):
    effect = added(kind, text, unit, null)
    assert "own_effect" in printed(listed(None))
    model, here = (unicycle(), DRIVEN) if kind == "WheelEffect" else (pendulum(), HELD)
    # in a model, by hand at a = 0.1
    grown = effect.apply(model, on, {"a": 0.1})
    values = {symbol(name): value for name, value in here.items()}
    assert float(grown.numeric()[grown.state_names.index(state)].subs(values)) == pytest.approx(rate, rel=1e-9)
    # fitted, and simulated by an engine that supports its kind
    assert build_supermodel(model, model.state_names, ("own_effect",)).find("own_effect", on).slots
    assert engine.acts_out(effect)
    assert "own effect" in effect.phrase(on)
