"""A basis of monomials."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import comb
from typing import Literal

from pydantic import Field

from simgap.config.gap import BasisSection
from simgap.errors import UserError
from simgap.geometry import Box

MOST = 20_000
"""Terms beyond which not even their list is made; `check` refuses far fewer for the time of their programs."""


class Monomials(BasisSection):
    """All monomials of the states and inputs up to a total degree, inputs to the first power."""

    kind: Literal["monomials"] = Field("monomials", description="Which basis.")
    degree: int = Field(2, ge=0, description="Largest total degree; inputs enter linearly.")

    def listed(self, states: Sequence[str], inputs: Sequence[str], domain: Box) -> tuple[str, ...]:
        """From the highest degree to the constant.

        Raises:
            UserError: a degree with more terms than any program takes.
        """
        names = (*states, *inputs)
        count = comb(len(states) + self.degree, self.degree) * 2 ** len(inputs)  # at most
        if count > MOST:
            raise UserError(
                f"degree {self.degree} has {count:.2g} terms", key="gap.basis.degree", remedy="Take a lower degree."
            )
        top = [self.degree] * len(states) + [1] * len(inputs)
        powers = [p for p in product(*(range(t + 1) for t in top)) if sum(p) <= self.degree]
        powers.sort(key=lambda p: (-sum(p), [-k for k in p]))
        return tuple(_monomial(names, p) for p in powers)


def _monomial(names: Sequence[str], powers: Sequence[int]) -> str:
    factors = [name if k == 1 else f"{name}^{k}" for name, k in zip(names, powers, strict=True) if k]
    return "*".join(factors) or "1"
