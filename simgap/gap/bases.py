"""The kinds of bases p(x, u) that a case can ask for: each a frozen section that lists its terms [plug-ins]."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import comb
from typing import Literal

from pydantic import Field, field_validator

from simgap.config.gap import BasisSection
from simgap.errors import UserError
from simgap.geometry import Box

MOST = 20_000
"""Terms beyond which not even their list is made; `check` refuses far fewer for the time of their programs."""


class Monomials(BasisSection):
    """All monomials of the states and inputs up to a total degree, inputs to the first power."""

    kind: Literal["monomials"] = "monomials"
    """Kind of basis."""
    degree: int = Field(2, ge=0)
    """Largest total degree; inputs enter linearly."""

    def listed(self, states: Sequence[str], inputs: Sequence[str], domain: Box) -> tuple[str, ...]:
        """From the highest degree to the constant.

        Raises:
            UserError: a degree with more terms than any program takes.
        """
        names = (*states, *inputs)
        count = comb(len(states) + self.degree, self.degree) * 2 ** len(inputs)  # at most
        if count > MOST:
            raise UserError(
                f"degree {self.degree} has {count:.2g} terms", key="gap.basis.degree", remedy="Use a lower degree."
            )
        top = [self.degree] * len(states) + [1] * len(inputs)
        powers = [p for p in product(*(range(t + 1) for t in top)) if sum(p) <= self.degree]
        powers.sort(key=lambda p: (-sum(p), [-k for k in p]))
        return tuple(_monomial(names, p) for p in powers)


def _monomial(names: Sequence[str], powers: Sequence[int]) -> str:
    factors = [name if k == 1 else f"{name}^{k}" for name, k in zip(names, powers, strict=True) if k]
    return "*".join(factors) or "1"


class Expressions(BasisSection):
    """The terms as written."""

    kind: Literal["expressions"] = "expressions"
    """Kind of basis."""
    terms: tuple[str, ...]
    """The terms, over states and inputs."""

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


class Blocks(BasisSection):
    """A value for each block of X and each input."""

    kind: Literal["blocks"] = "blocks"
    """Kind of basis."""
    blocks: tuple[int, ...] | None = None
    """Number of blocks along each state axis; without it 8, or as many as the grid has cells."""

    def listed(self, states: Sequence[str], inputs: Sequence[str], domain: Box) -> tuple[str, ...]:
        """The constant: what is left of blocks where a bound is linear in expressions."""
        return ("1",)
