"""A basis of sines and cosines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from simgap.config.gap import BasisSection
from simgap.geometry import Box


class Trigonometric(BasisSection):
    """sin and cos of `k omega_j x_j`, k = 1..harmonics, the inputs and 1; omega_j = pi / width of X along axis j.

    The period is twice the width, so that a term need not return to its first value across X.
    """

    kind: Literal["trigonometric"] = Field("trigonometric", description="Which basis.")
    harmonics: int = Field(1, ge=1, description="Harmonics along each state axis.")

    def listed(self, states: Sequence[str], inputs: Sequence[str], domain: Box) -> tuple[str, ...]:
        """State by state, then the inputs and the constant."""
        terms = []
        for name, width in zip(states, domain.hi - domain.lo, strict=True):
            for k in range(1, self.harmonics + 1):
                omega = k * math.pi / width
                terms += [f"sin({omega:.15g}*{name})", f"cos({omega:.15g}*{name})"]
        return (*terms, *inputs, "1")
