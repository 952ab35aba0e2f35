"""The rows of a scenario program: the basis at every sample, kept or evaluated in chunks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simgap.gap.bases import Basis
from simgap.geometry import Floats

_KEEP = 32_000_000  # numbers; above this the rows are evaluated again for each pass
_CHUNK = 1_000_000


@dataclass(frozen=True, eq=False)
class Design:
    """Rows p(x_r, u_m) of all states (N, nx) times inputs (M, nu); row index r M + m."""

    basis: Basis
    x: Floats
    u: Floats

    @property
    def shape(self) -> tuple[int, int]:
        """(N, M)."""
        return len(self.x), len(self.u)

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(self.x) * len(self.u)

    def rows(self, index: NDArray[np.int64]) -> Floats:
        """Rows by index: (k,) -> (k, z)."""
        return self.basis.evaluate(self.x[index // len(self.u)], self.u[index % len(self.u)])

    @cached_property
    def _kept(self) -> Floats | None:
        return self._block(0, len(self.x)) if self.size * self.basis.size <= _KEEP else None

    def _block(self, first: int, last: int) -> Floats:
        x = np.repeat(self.x[first:last], len(self.u), axis=0)
        return self.basis.evaluate(x, np.tile(self.u, (last - first, 1)))

    def blocks(self) -> list[tuple[int, int]]:
        """Ranges of states whose rows are held at once."""
        if self._kept is not None:
            return [(0, len(self.x))]
        step = max(1, _CHUNK // (len(self.u) * self.basis.size))
        return [(a, min(a + step, len(self.x))) for a in range(0, len(self.x), step)]

    def block(self, first: int, last: int) -> Floats:
        """Rows of states first..last: ((last - first) M, z)."""
        return self._kept if self._kept is not None else self._block(first, last)

    def product(self, q: Floats) -> Floats:
        """q.p at every sample: (z,) -> (N, M)."""
        parts = [self.block(a, b) @ q for a, b in self.blocks()]
        return np.concatenate(parts).reshape(self.shape)

    @cached_property
    def mean(self) -> Floats:
        """(z,) mean row."""
        return sum((self.block(a, b).sum(axis=0) for a, b in self.blocks()), np.zeros(self.basis.size)) / self.size

    @cached_property
    def _gram(self) -> Floats:
        z = self.basis.size
        return sum((p.T @ p for p in (self.block(a, b) for a, b in self.blocks())), np.zeros((z, z))) / self.size

    @cached_property
    def whitening(self) -> Floats:
        """(z, k) map from coordinates y to coefficients q = W y in which the mean of (q.p)^2 is |y|^2.

        Directions in which the samples do not tell the terms apart are left out (their coefficient is 0).
        """
        scale = np.sqrt(np.diag(self._gram))
        scale = np.where(scale > 0.0, scale, 1.0)
        values, vectors = np.linalg.eigh(self._gram / np.outer(scale, scale))
        kept = values > 1e-12 * values.max()
        return (vectors[:, kept] / np.sqrt(values[kept])) / scale[:, None]

    def least_squares(self, target: Floats) -> Floats:
        """(z,) coefficients of the least-squares fit of (N, M) values; refined once against rounding."""
        w, q = self.whitening, np.zeros(self.basis.size)
        for _ in range(2):
            rest = target - self.product(q)
            moment = sum((self.block(a, b).T @ rest[a:b].ravel() for a, b in self.blocks()), np.zeros(self.basis.size))
            q = q + w @ (w.T @ moment) / self.size
        return q
