"""Effects between a command and the plant: static, with the memory of a delay and a lag, or with the speed of what
the command drives."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from simgap.effects.base import COMMAND, Effect, Kind, Values
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, Variable, symbol


class InputEffect(Effect):
    """A change between the recorded command and what the plant feels; every engine acts it out."""

    kind: ClassVar[Kind] = "input"
    needs: ClassVar[str] = "a commanded input"
    rank: ClassVar[int] = COMMAND

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Every input of the plant that is commanded."""
        return tuple(name for name in model.input_names if name not in model.conditions)

    def phrase(self, on: str) -> str:
        """'the dead zone of torque'."""
        return self.short.format(on=on) or f"the {self.name.removeprefix('input_').replace('_', ' ')} of {on}"


class MemoryInputEffect(InputEffect):
    """A dead time and a first-order lag between command and plant: what the plant feels depends on past commands.

    An effect gives one of them or both, as functions of its parameters; the model, the fit and the simulators take
    them from there.
    """

    remembers: ClassVar[bool] = True
    excitation: ClassVar[str] = "add faster input changes"

    def delay(self, values: Values) -> sp.Expr:
        """Seconds until a command begins to act."""
        return sp.Integer(0)

    def lag(self, values: Values) -> sp.Expr:
        """Time constant of the actuator, s; 0 for none."""
        return sp.Integer(0)

    def seconds(self, values: Mapping[str, float]) -> tuple[float, float]:
        """Delay and time constant of the lag, s."""
        numbers = {name: sp.Float(value) for name, value in values.items()}
        return float(self.delay(numbers)), float(self.lag(numbers))

    def memory_state(self, on: str) -> str | None:
        """The actuator's output, if there is a lag."""
        lag = self.lag({p.symbol: symbol(p.symbol) for p in self.parameters})
        return f"{on}_lagged" if sp.sympify(lag) != 0 else None

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Declare the delay; add the actuator's output as a state that follows its command."""
        state, delay, lag = self.memory_state(on), self.delay(values), self.lag(values)
        if state is not None:
            lagged = model.with_input(on, symbol(state))
            model = lagged.with_state(Variable(state, model.units[on]), (symbol(on) - symbol(state)) / lag)
        return model if delay == 0 else model.with_delay(on, delay)


class StaticInputEffect(InputEffect):
    """A memoryless map from command to what the plant feels."""

    excitation: ClassVar[str] = "vary the size of the input, both signs"

    @abstractmethod
    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """The input that the plant feels for this command."""

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Replace the command by what it becomes."""
        return model.with_input(on, self.applied(symbol(on), values))


class DriveEffect(Effect):
    """A change of an input that is a force on a coordinate, by the speed of that coordinate.

    It comes after everything else on the path of the command; an engine of joints acts it out at each of its steps.
    """

    kind: ClassVar[Kind] = "input"
    needs: ClassVar[str] = "an input that is a force on one coordinate"
    rank: ClassVar[int] = COMMAND - 10

    @abstractmethod
    def felt(self, drive: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """The force on the coordinate for this drive at this velocity."""

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Inputs that are a force on a coordinate."""
        return tuple(u for u in model.input_names if u in model.driven)

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """Units from the input's and from the position's of the coordinate that it drives."""
        length = model.units[model.coordinate(model.driven[on]).position]
        return {p.symbol: p.unit.format(input=model.units[on], position=length) for p in self.parameters}

    def speed(self, model: SymbolicModel, on: str) -> sp.Symbol:
        """The velocity of the coordinate that the input, one of the targets, drives."""
        return symbol(model.coordinate(model.driven[on]).velocity)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Replace the drive by what the coordinate feels of it."""
        return model.with_input(on, self.felt(symbol(on), self.speed(model, on), values))
