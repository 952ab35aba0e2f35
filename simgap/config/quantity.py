"""Numbers with units in a case file: `0.005 s`, `5 ms` or a bare number in the unit of the key."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, WithJsonSchema

from simgap.errors import UserError, excerpt
from simgap.units import conversion


def _to(unit: str) -> BeforeValidator:
    def read(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        number, _, given = value.strip().partition(" ")
        try:
            return float(number) * (conversion(given, unit).factor if given else 1.0)
        except UserError:
            raise ValueError(
                f"'{excerpt(given, 60)}' is no unit that converts to {unit}; write it like '0.005 {unit}'"
            ) from None
        except ValueError:
            raise ValueError(
                f"'{excerpt(value, 60)}' is not a number with a unit; write it like '0.005 {unit}'"
            ) from None

    return BeforeValidator(read)


_NUMBER_OR_TEXT: dict[str, Any] = {"anyOf": [{"type": "number"}, {"type": "string"}]}
Seconds = Annotated[float, _to("s"), WithJsonSchema(_NUMBER_OR_TEXT)]
Hours = Annotated[float, _to("h"), WithJsonSchema(_NUMBER_OR_TEXT)]
Gibibytes = Annotated[float, _to("GiB"), WithJsonSchema(_NUMBER_OR_TEXT)]
