"""The numbers of an effect as a sentence quotes them: value, half-width of the interval, unit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from simgap.notation import with_error


@dataclass(frozen=True)
class Quoted:
    """Parameters as `diagnosis.json` holds them: symbol -> `value`, `ci95` (two ends, or None), `unit`."""

    parameters: Mapping[str, Mapping[str, Any]]

    def value(self, symbol: str) -> float:
        """The number itself, in its unit."""
        return float(self.parameters[symbol]["value"])

    def number(self, symbol: str, scale: float = 1.0, unit: str | None = None) -> str:
        """'0.19 ± 0.01 N m'; with `scale` in another `unit`."""
        p = self.parameters[symbol]
        return with_error(scale * self.value(symbol), scale * self._half(symbol), p["unit"] if unit is None else unit)

    def deviation(self, symbol: str = "ratio") -> str:
        """A ratio as a deviation from 1: 0.75 -> '25 ± 1 % below'; from 2 on as it is: '5.0 ± 0.1 times'."""
        value = self.value(symbol)
        if value >= 2.0:
            return f"{with_error(value, self._half(symbol))} times"
        side = "below" if value < 1.0 else "above"
        return f"{with_error(100.0 * abs(value - 1.0), 100.0 * self._half(symbol))} % {side}"

    def __getitem__(self, symbol: str) -> _Number:
        """A number for a text with formats, such as '{mu:%}'."""
        return _Number(self, symbol)

    def _half(self, symbol: str) -> float:
        lo, hi = (float(v) if v is not None else math.nan for v in self.parameters[symbol]["ci95"])
        return (hi - lo) / 2


@dataclass(frozen=True)
class _Number:
    """One of the numbers: as it is (times in milliseconds), in percent (%), in degrees (deg), off from 1 (off)."""

    quoted: Quoted
    symbol: str

    def __format__(self, kind: str) -> str:
        unit = "ms" if self.quoted.parameters[self.symbol]["unit"] == "s" and not kind else kind
        if unit == "off":
            return self.quoted.deviation(self.symbol)
        scale = {"": 1.0, "ms": 1e3, "%": 100.0, "deg": 180.0 / math.pi}[unit]
        return self.quoted.number(self.symbol, scale, unit or None)
