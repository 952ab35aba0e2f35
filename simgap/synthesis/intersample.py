"""What can happen between two sampling instants.

Let |dx_i/dt| <= V_i. A point of the path is at most half a sampling time away from one of the two samples around it, so
it is within V_i tau / 2 of that sample in every coordinate at once. Hence a path whose samples all lie in a box leaves
it by at most that much, and a path whose samples all keep that distance from an obstacle never touches it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from simgap.errors import BrokenPromise
from simgap.geometry import Box
from simgap.model.sampled import NominalModel
from simgap.model.symbolic import SymbolicModel

Floats = NDArray[np.float64]
Rates = Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]
_ROUNDS = 50


def rates(model: SymbolicModel) -> Rates:
    """Enclosure of the continuous dynamics: boxes (n, nx), (n, nx) and inputs (n, nu) -> two (n, nx), state units/s."""
    x, u = (tuple(v.symbol for v in group) for group in (model.states, model.inputs))
    return NominalModel(x, u, model.numeric(), 0.0).enclosure


def excursion(
    rates_over: Rates,
    region: Box,
    inputs: Floats,
    tau: float,
    extra_rate: Floats | None = None,
    names: Sequence[str] = (),
) -> tuple[Floats, Floats]:
    """Bound of how far a path strays from its samples: -> (V_i tau / 2, V_i), each (nx,).

    Args:
        rates_over: enclosure of dx/dt over boxes, outward rounded.
        region: box that holds every sample.
        inputs: U, (M, nu); the input is constant between samples.
        tau: sampling time, s.
        extra_rate: bound of what the real dx/dt adds to the model's, (nx,). A gap bound at sampling instants does not
            give one; a caller who uses gamma / tau here makes an assumption and should say so.
        names: of the states, for the message.

    The rates are bounded over the region widened by the excursion itself, found by iteration from below.

    Raises:
        BrokenPromise: when the iteration does not settle (the dynamics may leave any bound within half a sample).
    """
    added = np.zeros(region.size) if extra_rate is None else np.asarray(extra_rate, dtype=np.float64)
    reach = np.zeros(region.size)
    for _ in range(_ROUNDS):
        lo, hi = (np.tile(end, (len(inputs), 1)) for end in (region.lo - reach, region.hi + reach))
        low, high = rates_over(lo, hi, inputs)
        speed = np.maximum(np.abs(low), np.abs(high)).max(axis=0) + added
        needed = 0.5 * tau * speed * (1.0 + 1e-12)
        if np.all(needed <= reach):
            return reach, speed
        if not np.all(np.isfinite(needed)):
            break
        reach = needed * (1.0 + 1e-6)
    axis = int(np.argmax(np.where(np.isfinite(needed), needed / (region.hi - region.lo), np.inf)))
    of = f" of {names[axis]}" if names else ""
    raise BrokenPromise(
        f"the motion{of} between samples has no bound: within half of tau = {tau:g} s it may leave any box",
        "Shorten domain.tau, or shrink domain.X",
    )
