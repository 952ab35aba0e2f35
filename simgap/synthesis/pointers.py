"""The one shape of a `post` function: a C pointer, so that the fixed-point kernels compile once for every model.

    void post(const int64 *k, int64 cells, int64 group, int64 m0, int64 m1,
              const int64 *meta, const double *data, const int32 *table, int32 *out)

`k` (nx,) is a cell's index along each axis. For `cells` cells in a row along the last axis, starting there, and for the
inputs m0 <= m < m1 it writes 2 nx numbers each: the lower, then the upper cell index per axis of the smallest box of
cells known to hold every successor; the input runs fastest. With `group` > 1 the gap may be bounded over that many
neighbouring cells at once: the boxes are larger and cheaper; with 1 they are as tight as the abstraction gets. Indices
may leave the grid (periodic axes wrap later). `meta`, `data` and `table` are whatever the abstraction put there.
"""

from __future__ import annotations

from numba import types

POST = types.void(
    types.CPointer(types.int64),
    types.int64,
    types.int64,
    types.int64,
    types.int64,
    types.CPointer(types.int64),
    types.CPointer(types.float64),
    types.CPointer(types.int32),
    types.CPointer(types.int32),
)
