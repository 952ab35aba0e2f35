"""The key `gap.basis`: what every basis has in common; the built-in ones are in `simgap/gap/kinds`, one a file."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

from pydantic import Field

from simgap.config.base import Section
from simgap.geometry import Box


class BasisSection(Section):
    """A basis is a section of a case, its options, that lists its terms: a plug-in of the group `bases`, one a file."""

    kind: str = Field(
        description="Which basis: a built-in one, one that an installed distribution offers, or file.py:Class for a "
        "class in a file beside the case."
    )

    @abstractmethod
    def listed(self, states: Sequence[str], inputs: Sequence[str], domain: Box) -> tuple[str, ...]:
        """The terms as expressions over the names of states and inputs, twice differentiable in the states.

        Args:
            states, inputs: their names, in order.
            domain: the box X of the states, for terms that depend on its size.
        """
