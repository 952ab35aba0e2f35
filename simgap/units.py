"""Units, through pint: whether one exists, whether it is the one that is computed in, how to convert to it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from simgap.errors import UserError, excerpt, placed


@dataclass(frozen=True)
class Affine:
    """The map `value = factor * raw + shift` from one unit to another (shift only for scales like degC)."""

    factor: float
    shift: float = 0.0


_PLAIN = frozenset({"1", "", "rad", "rad/s", "m", "m/s", "m/s^2", "s", "kg", "kg*m^2", "N", "N*m", "N*m*s/rad"})
"""Known without pint, which takes half a second to load."""
LONGEST, MOST_POWER = 60, 9
"""Characters of a unit, and the power of a name in it."""
_FACTOR = r"\(*(?:1|(?!\d)[\w%°]+)\)*(?:\s*(?:\^|\*\*)\s*(?:-?\d(?:\.\d{1,2})?|\(-?\d(?:\.\d{1,2})?\)))?\)*"
_WRITTEN = re.compile(rf"\s*{_FACTOR}(?:(?:\s*[*/·]\s*|\s+){_FACTOR})*\s*")
"""Names and 1, products, quotients, powers of one digit. pint computes what stands there: 9**9**9 never ends."""
_FORCES = {"rad": "N*m", "1": "N*m", "": "N*m", "m": "N"}


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint  # half a second: only paid by those who convert

    registry: Any = pint.UnitRegistry(cache_folder=None)
    registry.define("@alias turn = rev")  # as data sheets of motors and encoders have it
    return registry


@lru_cache(maxsize=256)
def _parsed(unit: str) -> Any:
    """The pint unit a person wrote; '1' and '' are the pure number."""
    registry = _registry()
    if unit.strip() in ("", "1"):
        return registry.dimensionless
    try:
        if len(unit) > LONGEST or not _WRITTEN.fullmatch(unit):
            raise ValueError(unit)
        found = registry.parse_units(unit.replace("·", "*"))
        if any(abs(power) > MOST_POWER for power in found._units.values()):
            raise ValueError(unit)
        return found
    except Exception:  # pint raises tokenizer, attribute, value and type errors for a misspelt unit
        raise UserError(
            f"'{excerpt(unit, LONGEST)}' is not a unit", remedy="Write units like rad, deg/s, N*m, m/s^2, ms."
        ) from None


def check_unit(unit: str, key: str) -> None:
    """Refuse a unit that does not exist.

    Raises:
        UserError: naming the key.
    """
    if unit not in _PLAIN:
        with placed(key=key):
            _parsed(unit)


def require_unit(unit: str, wanted: str, key: str) -> None:
    """Refuse a unit in which a number is not the same number as in the one that is computed in.

    Raises:
        UserError: naming the key and the unit that is wanted.
    """
    try:
        same = conversion(unit, wanted) == Affine(1.0)
    except UserError:
        same = False
    if not same:
        remedy = f"Use '{wanted}' for it and for every number of it."
        raise UserError(f"the unit is '{unit}', but this is computed in '{wanted}'", key=key, remedy=remedy)


@lru_cache(maxsize=256)
def conversion(source: str, target: str) -> Affine:
    """Map by which a number in unit `source` becomes one in unit `target`.

    Raises:
        UserError: for a unit that does not exist, two units of different dimensions, or Hz for an angular velocity,
            which may mean turns as well as radians per second.
    """
    if source.strip() == target.strip():
        return Affine(1.0)
    registry, a, b = _registry(), _parsed(source), _parsed(target)
    if a.dimensionality != b.dimensionality or _counts_turns(a) != _counts_turns(b):
        raise UserError(
            f"'{source}' cannot be converted to '{target}'", remedy=f"Give the unit of the column, like '{target}'."
        )
    zero, one = (float(registry.Quantity(v, a).to(b).magnitude) for v in (0.0, 1.0))
    return Affine(one - zero, zero)


def _counts_turns(unit: Any) -> bool:
    return "hertz" in {str(name) for name in unit._units}


def force_along(position: str) -> str:
    """Unit of the generalised force on a coordinate: 'N' along a length, 'N*m' about an angle or on a pure number.

    For any other unit of its position, what makes an energy with it.
    """
    if position in _FORCES:
        return _FORCES[position]
    unit = _parsed(position)
    if unit.dimensionless:
        return "N*m"
    return "N" if unit.dimensionality == _parsed("m").dimensionality else f"N*m/({position})"


def full_turn(unit: str) -> float | None:
    """A full turn in the unit of an angle (360 for deg, 2 pi for rad); None for anything that is not an angle.

    Radians have no dimension, so an angle is known by its name: a pure number is not one.
    """
    if unit in _PLAIN:
        return 2.0 * math.pi if unit == "rad" else None
    names = {str(name) for name in _parsed(unit)._units}
    if len(names) != 1 or not names <= {"radian", "degree", "turn", "arcminute", "arcsecond", "milliradian", "grade"}:
        return None
    to_rad = conversion(unit, "rad").factor
    return 2.0 * math.pi / to_rad if float(next(iter(_parsed(unit)._units.values()))) == 1.0 else None


_BASE = {"[length]": "m", "[mass]": "kg", "[time]": "s", "[current]": "A", "[temperature]": "K", "[substance]": "mol",
         "[luminosity]": "cd"}  # fmt: skip


@lru_cache(maxsize=256)
def dimension(unit: str) -> Any:
    """Dimension of a unit as pint has it: exponents of the SI base units by name, none for angles and pure numbers.

    Products, quotients and powers of dimensions are dimensions.

    Raises:
        UserError: a unit that does not exist.
    """
    return _parsed(unit).dimensionality


def dimension_text(own: Any) -> str:
    """A dimension as a unit is written, such as kg*m^2/s; 1 for none."""
    named = sorted((_BASE.get(name, name), float(power)) for name, power in own.items())
    parts = {s: [n if s * p == 1.0 else f"{n}^{s * p:g}" for n, p in named if s * p > 0.0] for s in (1, -1)}
    return ("*".join(parts[1]) or "1") + "".join(f"/{part}" for part in parts[-1])


def of_base(unit: str) -> float:
    """Size of a unit in units of the SI base: 0.001 for g, 1 for N*m.

    Raises:
        UserError: a unit that does not exist.
    """
    return 1.0 if unit in _PLAIN else float(_registry().Quantity(1.0, _parsed(unit)).to_base_units().magnitude)
