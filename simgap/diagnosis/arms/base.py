"""Base inertial parameters: the combinations of inertial parameters that a tree's motion shows at all.

Some columns of the regressor are combinations of others whatever the motion: only sums of such parameters act. They are
found on the regressor at random motions, each column against those before it (numerical QR: Gautier (1991), J. Robotic
Systems 8(4)), and named, such as `upper.mx + 0.61 fore.m`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.diagnosis.arms.thresholds import INDEPENDENT
from simgap.model.tree import UNITS, Tree, regressor

_DRAWS = 200


@dataclass(frozen=True, eq=False)
class BaseParameters:
    """The combinations.

    Attributes:
        kept: (b,) columns of the regressor that stand for the combinations: `Y pi = Y[:, kept] K pi`.
        combine: K, (b, 10 n).
        names, units: of each combination; links: the link that it is listed at.
    """

    kept: Ints
    combine: Floats
    names: tuple[str, ...]
    units: tuple[str, ...]
    links: tuple[str, ...]


def base_parameters(tree: Tree) -> BaseParameters:
    """The base parameters of a tree, from the base to the tip."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-np.pi, np.pi, (_DRAWS, tree.size))
    v, a = rng.normal(size=(2, _DRAWS, tree.size))
    columns = regressor(tree, q, v, a).reshape(_DRAWS * tree.size, -1)
    kept = independent(columns)
    combine = np.asarray(np.linalg.lstsq(columns[:, kept], columns, rcond=None)[0], dtype=np.float64)
    combine[np.abs(combine) < 1e-9] = 0.0
    names = tuple(_named(row, tree.names, int(k)) for row, k in zip(combine, kept, strict=True))
    return BaseParameters(
        kept, combine, names, tuple(UNITS[k % 10] for k in kept), tuple(tree.links[k // 10] for k in kept)
    )


def independent(columns: Floats) -> Ints:
    """Columns, from the left, that are no combination of those before them."""
    basis, found = np.zeros((len(columns), 0)), []
    for k in range(columns.shape[1]):
        size = np.linalg.norm(columns[:, k])
        if size < INDEPENDENT * max(1.0, float(np.abs(columns).max())):
            continue
        rest = columns[:, k] / size
        for _ in range(2):  # twice is enough (Giraud, Langou, Rozloznik (2005))
            rest = rest - basis @ (basis.T @ rest)
        own = np.linalg.norm(rest)
        if own > np.sqrt(INDEPENDENT):
            basis = np.column_stack([basis, rest / own])
            found.append(k)
    return np.array(found, dtype=np.int64)


def _named(row: Floats, names: tuple[str, ...], first: int) -> str:
    """The combination in words, its leading parameter first."""
    text = names[first]
    for k in np.flatnonzero(row):
        if k == first:
            continue
        size = "" if abs(abs(row[k]) - 1.0) < 1e-9 else f"{abs(row[k]):.4g} "
        text += f" {'+' if row[k] > 0 else '-'} {size}{names[k]}"
    return text
