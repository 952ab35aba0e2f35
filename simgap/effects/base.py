"""What a physical effect is: a symbolic change of the model, with parameters, units and sign constraints.

The one definition serves the fit, the corrected nominal model and the simulator's twin.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import sympy as sp

from simgap.effects.start import Scales, Start
from simgap.errors import UserError
from simgap.model.symbolic import Parameter, SymbolicModel, symbol

Kind = Literal["coordinate", "input", "state", "parameter", "plant"]
Values = Mapping[str, sp.Expr]


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    `unit` may hold the placeholders `{force}`, `{position}`, `{input}`, `{state}`, filled in for the target. At `null`
    (for all parameters of the effect at once) the effect vanishes. `lower` and `upper` are physical limits. `integer`
    marks a discrete choice.
    """

    symbol: str
    unit: str
    description: str
    null: float
    lower: float = -math.inf
    upper: float = math.inf
    integer: bool = False


class Effect(ABC):
    """A physical term that a model may lack; subclasses are final, one a file, and hold no state."""

    name: ClassVar[str]
    kind: ClassVar[Kind]
    formula: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[EffectParameter, ...]]
    contains: ClassVar[str] = ""
    """Name of an effect that this one extends: its fit is a place to begin from."""

    @abstractmethod
    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """What the effect can act on in this model (its possible `on`)."""

    @abstractmethod
    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """The model with the effect on `on`, its parameters given as numbers or expressions."""

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """Unit of each parameter symbol for this target."""
        return {p.symbol: p.unit for p in self.parameters}

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Where a search for the effect begins; for one parameter, the derivative at its null."""
        (only,) = self.parameters
        return (Start(1, lambda c: {only.symbol: only.null + c[0]}),)

    def beyond(self, contained: Mapping[str, float], start: Mapping[str, float]) -> dict[str, float]:
        """Where to begin from the fit of the effect that this one contains, and from one of its own starts."""
        return {**start, **contained}

    def physical(self, values: Mapping[str, float]) -> bool:
        """Whether the values obey the sign constraints."""
        return all(p.lower <= values[p.symbol] <= p.upper for p in self.parameters)

    def check_target(self, model: SymbolicModel, on: str) -> None:
        """Refuse a target that this model does not have.

        Raises:
            UserError: naming the possible targets.
        """
        known = self.targets(model)
        if on not in known:
            remedy = f"It can act on: {', '.join(known)}." if known else "This plant has nothing it can act on."
            raise UserError(f"effect '{self.name}' cannot act on '{on}'", remedy=remedy)

    def check_values(self, values: Mapping[str, float]) -> None:
        """Refuse unknown, missing or unphysical parameter values.

        Raises:
            UserError: naming the symbol and its limits.
        """
        symbols = [p.symbol for p in self.parameters]
        if set(values) != set(symbols):
            raise UserError(f"effect '{self.name}' has parameters {symbols}, not {sorted(values)}")
        for p in self.parameters:
            if not p.lower <= float(values[p.symbol]) <= p.upper:
                raise UserError(
                    f"parameter {p.symbol} = {values[p.symbol]} of effect '{self.name}' is not physical",
                    remedy=f"It lies in [{p.lower:g}, {p.upper:g}].",
                )
        if not self.physical(values):
            raise UserError(f"the parameters {dict(values)} of effect '{self.name}' are not physical together")

    def apply(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> SymbolicModel:
        """The model corrected by this effect; its numbers become named parameters of the new model.

        Raises:
            UserError: unknown target, missing or unphysical value.
        """
        self.check_target(model, on)
        self.check_values(values)
        units = self.units(model, on)
        names: dict[str, str] = {}
        grown = model
        for p in self.parameters:
            name, count = f"{on}.{self.name}.{p.symbol}", 2
            while name in grown.parameters:
                name, count = f"{on}.{self.name}.{p.symbol}_{count}", count + 1
            names[p.symbol] = name
            description = f"{p.description} ({self.name} on {on})"
            grown = grown.with_parameter(name, Parameter(float(values[p.symbol]), units[p.symbol], description))
        return self.insert(grown, on, {key: symbol(name) for key, name in names.items()})


class CoordinateEffect(Effect):
    """A generalised force on a coordinate."""

    kind: ClassVar[Kind] = "coordinate"

    @abstractmethod
    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """The generalised force on the coordinate at this position and velocity."""

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Every coordinate of the plant."""
        return tuple(c.name for c in model.coordinates)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Add the force to the equations of motion."""
        c = model.coordinate(on)
        return model.with_force(on, self.force(symbol(c.position), symbol(c.velocity), values))

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """Units from the coordinate's: rad for a joint whose force is a torque, m for one that slides."""
        force = model.coordinate(on).force_unit
        position = "rad" if "m" in force.replace("*", " ").replace("·", " ").split() else "m"
        return {p.symbol: p.unit.format(force=force, position=position) for p in self.parameters}


class InputEffect(Effect):
    """A change between the recorded command and what the plant feels."""

    kind: ClassVar[Kind] = "input"

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Every input of the plant."""
        return model.input_names

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """Units from the input's."""
        unit = next(v.unit for v in model.inputs if v.name == on)
        return {p.symbol: p.unit.format(input=unit) for p in self.parameters}


class StaticInputEffect(InputEffect):
    """A memoryless map from command to what the plant feels."""

    @abstractmethod
    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """What the plant feels for this command."""

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Replace the command by what it becomes."""
        return model.with_input(on, self.applied(symbol(on), values))
