"""Classes of the previous input: the part of a simulator's hidden state that a controller knows, because it chose it.

Where the motors settle within a sample the hidden state is what the previous input left behind. A controller that
remembers the class of that input may use the bound of the class, which is narrower than the one for any previous input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.errors import UserError
from simgap.gap.json_record import JsonRecord
from simgap.simulators.body_samples import REST


@dataclass(frozen=True, eq=False)
class PreviousClasses(JsonRecord, names={"kind": "of_input", "rest": "at_rest"}):
    """A partition of U.

    Attributes:
        kind: (M,) class of each input. rest: class of a robot at rest, that of the input nearest to zero.
    """

    kind: Ints
    rest: int = 0

    @property
    def count(self) -> int:
        """Number of classes."""
        return int(self.kind.max()) + 1

    def after(self, previous: Ints) -> Ints:
        """Classes after previous inputs (n,), `REST` among them: -> (n,)."""
        return np.where(previous == REST, self.rest, self.kind[previous])

    @staticmethod
    def single(inputs: int) -> PreviousClasses:
        """One class of all of them."""
        return PreviousClasses(np.zeros(inputs, np.int64))

    @staticmethod
    def of(inputs: Floats, counts: Sequence[int]) -> PreviousClasses:
        """Intervals of each input's values, as equal in number as can be: U (M, nu), classes per input (nu,).

        Raises:
            UserError: more classes than values.
        """
        kind = np.zeros(len(inputs), np.int64)
        for j, count in enumerate(counts):
            values = np.unique(inputs[:, j])
            groups = intervals(values, count)
            first = np.array([own[0] for own in groups])
            kind = kind * count + np.searchsorted(first, inputs[:, j], side="right") - 1
        size = np.maximum(np.abs(inputs).max(axis=0), 1e-300)
        return PreviousClasses(kind, int(kind[np.argmin(((inputs / size) ** 2).sum(axis=1))]))


def intervals(values: Floats, count: int) -> list[Floats]:
    """Sorted values (n,) in `count` groups that follow each other.

    Raises:
        UserError: more groups than values, or none.
    """
    if not 1 <= count <= len(values):
        raise UserError(
            f"{count} classes of an input that has {len(values)} values", key="hidden_state.classes",
            remedy=f"Take between 1 and {len(values)}.",
        )  # fmt: skip
    return np.array_split(values, count)
