"""Which input of the finite set U a row of numbers is."""

from __future__ import annotations

from simgap.late import njit


@njit(error_model="numpy", cache=True)
def input_index(inputs, u):  # type: ignore[no-untyped-def]
    """Row of the input set that equals u to 1e-9 of its size; -1 if there is none."""
    for m in range(len(inputs)):
        same = True
        for k in range(inputs.shape[1]):
            same = same and abs(inputs[m, k] - u[k]) <= 1e-9 * (1.0 + abs(u[k]))
        if same:
            return m
    return -1
