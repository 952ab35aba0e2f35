"""Conversion between the unit of a column and the unit of a state, through pint."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from simgap.errors import UserError


@dataclass(frozen=True)
class Affine:
    """The map `value = factor * raw + shift` from one unit to another (shift only for scales like degC)."""

    factor: float
    shift: float = 0.0


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint  # half a second: only paid by those who convert

    return pint.UnitRegistry(cache_folder=None)


@lru_cache(maxsize=256)
def _parsed(unit: str) -> Any:
    """The pint unit a person wrote; '1' and '' are the pure number."""
    registry = _registry()
    if unit.strip() in ("", "1"):
        return registry.dimensionless
    try:
        return registry.parse_units(unit.replace("·", "*"))
    except Exception:  # pint raises tokenizer, attribute, value and type errors for a misspelt unit
        raise UserError(f"'{unit}' is not a unit", remedy="Write units like rad, deg/s, N*m, m/s^2, ms.") from None


@lru_cache(maxsize=256)
def conversion(source: str, target: str) -> Affine:
    """How a number in unit `source` becomes one in unit `target`.

    Raises:
        UserError: for a unit that does not exist, or two units of different dimensions.
    """
    if source.strip() == target.strip():
        return Affine(1.0)
    registry, a, b = _registry(), _parsed(source), _parsed(target)
    if a.dimensionality != b.dimensionality:
        raise UserError(
            f"'{source}' cannot be converted to '{target}'", remedy=f"Give the unit of the column, like '{target}'."
        )
    zero, one = (float(registry.Quantity(v, a).to(b).magnitude) for v in (0.0, 1.0))
    return Affine(one - zero, zero)


def full_turn(unit: str) -> float | None:
    """A full turn in the unit of an angle (360 for deg, 2 pi for rad); None for anything that is not an angle.

    Radians have no dimension, so an angle is known by its name: a pure number is not one.
    """
    names = {str(name) for name in _parsed(unit)._units}
    if len(names) != 1 or not names <= {"radian", "degree", "turn", "arcminute", "arcsecond", "milliradian", "grade"}:
        return None
    to_rad = conversion(unit, "rad").factor
    return 2.0 * math.pi / to_rad if float(next(iter(_parsed(unit)._units.values()))) == 1.0 else None
