"""Effects between a drive and the coordinate that it moves, which depend on the motion too."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from simgap.effects.base import COMMAND, Effect, Kind, Values, drives
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class DriveEffect(Effect):
    """What becomes of an input that is a force on a coordinate, at the speed of that coordinate.

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
        return tuple(u for u in model.input_names if drives(model, u) is not None)

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """Units from the input's and from the position's of the coordinate that it drives."""
        unit, coordinate = next(v.unit for v in model.inputs if v.name == on), drives(model, on)
        position = "" if coordinate is None else model.coordinate(coordinate).position
        length = next((v.unit for v in model.states if v.name == position), "1")
        return {p.symbol: p.unit.format(input=unit, position=length) for p in self.parameters}

    def speed(self, model: SymbolicModel, on: str) -> sp.Symbol:
        """The velocity of the coordinate that the input drives.

        Raises:
            UserError: an input that is not a force on one coordinate.
        """
        coordinate = drives(model, on)
        if coordinate is None:
            raise UserError(
                f"'{self.name}' needs the speed of what '{on}' drives, but that is not a force on one coordinate",
                remedy="Give the plant coordinates, or name another input.",
            )
        return symbol(model.coordinate(coordinate).velocity)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Replace the drive by what the coordinate feels of it."""
        return model.with_input(on, self.felt(symbol(on), self.speed(model, on), values))
