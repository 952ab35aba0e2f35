"""Base of every section of a case file, and numbers with units: `0.005 s`, `5 ms`, or a bare number."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    WithJsonSchema,
    model_serializer,
)

from simgap.errors import UserError, excerpt
from simgap.units import conversion


class Section(BaseModel):
    """A frozen group of keys of a case file, each with its description below it; unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    OPTIONAL: ClassVar[tuple[str, ...]] = ()
    """Keys that are no part of its content while they have their default: results made before they were there hold."""

    @model_serializer(mode="wrap")
    def _without_unused(self, own: SerializerFunctionWrapHandler) -> dict[str, Any]:
        content: dict[str, Any] = own(self)
        fields = type(self).model_fields
        for key in self.OPTIONAL:
            if getattr(self, key) == fields[key].get_default(call_default_factory=True):
                content.pop(key, None)
        return content


def _to(unit: str) -> BeforeValidator:
    def read(value: Any) -> Any:
        if not isinstance(value, str):
            return value
        number, _, given = value.strip().partition(" ")
        try:
            return float(number) * (conversion(given, unit).factor if given else 1.0)
        except UserError:
            raise ValueError(
                f"'{excerpt(given, 60)}' is not a unit that converts to {unit}; write it like '0.005 {unit}'"
            ) from None
        except ValueError:
            raise ValueError(
                f"'{excerpt(value, 60)}' is not a number with a unit; write it like '0.005 {unit}'"
            ) from None

    return BeforeValidator(read)


def _ordered(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError(f"its ends are reversed: {ends[0]} is not below {ends[1]}. Give the lower end first")
    return ends


Interval = Annotated[tuple[float, float], AfterValidator(_ordered)]
"""Lower and upper end."""
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
_NUMBER_OR_TEXT: dict[str, Any] = {"anyOf": [{"type": "number"}, {"type": "string"}]}
Seconds = Annotated[float, _to("s"), WithJsonSchema(_NUMBER_OR_TEXT)]
Hours = Annotated[float, _to("h"), WithJsonSchema(_NUMBER_OR_TEXT)]
Gibibytes = Annotated[float, _to("GiB"), WithJsonSchema(_NUMBER_OR_TEXT)]
