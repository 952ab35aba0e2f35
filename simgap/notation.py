"""Numbers, units, lists and names as people read them, one way everywhere: pages, figures, recordings, messages."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

_RARE = re.compile(r"[^\n\t -~]")
_POWER = re.compile(r"\b\d[\d.]*e[+-]\d+\b")
_INERTIAS = {"N*m*s^2/rad": "kg*m^2", "N*s^2/m": "kg"}
_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def printable(text: str) -> str:
    r"""Text out of somebody's file, for a terminal, a page or a picture; line breaks and tabs stay.

    What would move a cursor, turn the direction of writing, or is no character at all is written out: ESC is `\x1b`.
    """
    return _RARE.sub(lambda c: c[0] if c[0].isprintable() else c[0].encode("unicode_escape").decode(), text)


def one_line(text: str) -> str:
    """Printable, with spaces for line breaks."""
    return printable(" ".join(text.split()))


def superscript(digits: str) -> str:
    """'-12' -> '⁻¹²'."""
    return digits.translate(_SUPERSCRIPTS)


def pretty_unit(unit: str) -> str:
    """A unit as it is printed: 'N*m*s/rad' -> 'N m s/rad', 'kg*m^2' -> 'kg m²'; nothing for a pure number.

    Units that an effect takes from its coordinate are those of a rotation or a translation: '{force}*s/{position}' ->
    'N m s/rad or N s/m'; an input's and a reading's are named. An inertia is in kg m² and a mass in kg.
    """
    if unit in ("1", ""):
        return ""
    if "{force}" in unit or "{position}" in unit:
        kinds = ({"force": "N*m", "position": "rad"}, {"force": "N", "position": "m"})
        return " or ".join(pretty_unit(unit.format(**kind, input="{input}", state="{state}")) for kind in kinds)
    text = _INERTIAS.get(unit, unit)
    text = text.replace("**", "^").replace("{", "").replace("}", " unit").replace("*", " ")
    return re.sub(r"\^([\d-]*)", lambda power: superscript(power[1]), text)


def axis_label(name: str, units: Mapping[str, str]) -> str:
    """'q (rad)'; the name alone for a pure number."""
    unit = pretty_unit(units.get(name, ""))
    return f"{name} ({unit})" if unit else name


def number(value: Any, digits: int = 4) -> str:
    """A number as it is printed in tables."""
    if value is None:
        return ""
    x = float(value)
    if not math.isfinite(x):
        return "unbounded"
    text = f"{x:.{digits}g}"
    if "e" not in text:
        return text
    if 1.0 <= abs(float(text)) < 1e6:
        return f"{float(text):,.0f}"
    mantissa, exponent = text.split("e")
    factor = "" if mantissa == "1" else f"{mantissa}·"
    return f"{factor}10{superscript(str(int(exponent)))}"


def interval(ends: Sequence[Any]) -> str:
    """The ends of an interval with the digits that its width asks for: '1.2990 to 1.3005', not '1.3 to 1.3'."""
    lo, hi = map(float, ends)
    size, width = max(abs(lo), abs(hi)), hi - lo
    if not 0.0 < width < math.inf:
        return f"{number(lo)} to {number(hi)}"
    places = 1 - math.floor(math.log10(width))
    if places <= 6 and size < 1e6:
        return f"{lo:.{max(places, 0)}f} to {hi:.{max(places, 0)}f}"
    digits = max(places + 1 + math.floor(math.log10(size)), 3)
    return f"{number(lo, digits)} to {number(hi, digits)}"


def powers(text: str) -> str:
    """Text with its powers of ten as tables print them: '7.2e-05' -> '7.2·10⁻⁵'."""
    return _POWER.sub(lambda found: number(found[0], 15), text)


def with_error(value: float, half: float, unit: str = "") -> str:
    """`value ± half unit`, rounded where the uncertainty has its first digits: 0.19 ± 0.01 N m."""
    tail = f" {pretty_unit(unit)}" if pretty_unit(unit) else ""
    if not (math.isfinite(half) and half > 0.0):
        return f"{value:.4g}{tail}"
    size = 10.0 ** math.floor(math.log10(half))
    leading = round(half / size, 1)
    digits = -round(math.log10(size)) + (1 if leading < 2.0 and leading != 1.0 else 0)  # 0.01, 0.012 and 0.3
    if not -4 < digits <= 7:
        power = math.floor(math.log10(max(abs(value), half)))
        least = max(power - math.floor(math.log10(half)), 0)
        scale = 10.0**-power
        middle = round(value * scale, least) + 0.0  # no -0
        return f"({middle:.{least}f} ± {half * scale:.1g})·10{superscript(str(power))}{tail}"
    digits = max(digits, 0)
    return f"{value:.{digits}f} ± {half:.{digits}f}{tail}"


def from_to(start: float, stop: float) -> str:
    """Two times with the digits that tell them apart: '3.2 to 5.4 s', '0.01234 to 0.012385 s'."""
    digits = max(0, 1 - math.floor(math.log10(max(stop - start, 1e-9))))
    return f"{round(start, digits):.12g} to {round(stop, digits):.12g} s"


def percent(share: float) -> str:
    """A share as whole per cent of what there is: 0 to 100."""
    return f"{100 * min(max(share, 0.0), 1.0):.0f}"


def few(parts: Sequence[str]) -> Sequence[str]:
    """Three parts or fewer; of more the first three, and how many more there are."""
    return parts if len(parts) <= 3 else [*parts[:3], f"{len(parts) - 3} more"]


def capitalised(text: str) -> str:
    """A phrase at the beginning of a sentence; names within it stay as they are."""
    return f"{text[0].upper()}{text[1:]}"


def joined(parts: Sequence[str], last: str = "and") -> str:
    """'a', 'a and b', 'a, b and c'; nothing for no part."""
    return f"{', '.join(parts[:-1])} {last} {parts[-1]}" if len(parts) > 1 else "".join(parts)
