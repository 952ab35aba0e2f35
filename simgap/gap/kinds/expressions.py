"""A basis of terms as a person wrote them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from pydantic import Field, field_validator

from simgap.config.gap import BasisSection
from simgap.geometry import Box


class Expressions(BasisSection):
    """The terms as written."""

    kind: Literal["expressions"] = Field("expressions", description="Which basis.")
    terms: tuple[str, ...] = Field(description="The terms, over states and inputs.")

    @field_validator("terms", mode="before")
    @classmethod
    def _numbers_are_terms(cls, value: object) -> object:
        """The constant term is written 1, which YAML reads as a number."""
        if isinstance(value, list | tuple) and not value:
            raise ValueError("the basis has no terms; list at least the constant 1")
        return [str(term) for term in value] if isinstance(value, list | tuple) else value

    def listed(self, states: Sequence[str], inputs: Sequence[str], domain: Box) -> tuple[str, ...]:
        """The terms."""
        return self.terms
