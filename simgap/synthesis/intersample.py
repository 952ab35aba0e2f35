"""What can happen between two sampling instants.

Let |dx_i/dt| <= V_i. A point of the path is at most half a sampling time away from one of the two samples around it, so
it is within V_i tau / 2 of that sample in every coordinate at once. Hence a path whose samples all lie in a box leaves
it by at most that much, and a path whose samples all keep that distance from an obstacle never touches it.
"""

from __future__ import annotations

import math
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
_LEAVES, _HALVINGS, _REFINED = 0.25, 24, 8
"""Of the width of a box, what a path may stray at a sampling time that a refusal names (judgement: half of the box is
left); how often tau is halved in search of it, and then how often bisected."""


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
    reach, speed, needed = _settled(rates_over, region, inputs, tau, added)
    if speed is not None:
        return reach, speed
    axis = int(np.argmax(np.where(np.isfinite(needed), needed / (region.hi - region.lo), np.inf)))
    of = f" of {names[axis]}" if names else ""
    shorter = enough(rates_over, region, inputs, tau, added)
    raise BrokenPromise(
        f"the motion{of} between samples has no bound: within half of tau = {tau:g} s it may leave any box",
        f"Shorten domain.tau{f' to about {shorter:g} s' if shorter else ''}, or shrink domain.X",
    )


def enough(rates_over: Rates, region: Box, inputs: Floats, tau: float, extra_rate: Floats) -> float | None:
    """A shorter sampling time, two digits, at which a path strays by a quarter of the region at most; None if none is.

    The arguments are those of `excursion`. `extra_rate` is kept, as if what it stands for shrank as tau does.
    """

    def leaves(time: float) -> bool:
        reach, speed, _ = _settled(rates_over, region, inputs, time, extra_rate)
        return speed is not None and bool((reach <= _LEAVES * (region.hi - region.lo)).all())

    low = next((own for own in tau / 2.0 ** np.arange(1, _HALVINGS) if leaves(own)), None)
    if low is None:
        return None
    high = 2.0 * low
    for _ in range(_REFINED):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if leaves(middle) else (low, middle)
    digits = 1 - math.floor(math.log10(low))
    return math.floor(low * 10.0**digits) / 10.0**digits


def _settled(
    rates_over: Rates, region: Box, inputs: Floats, tau: float, added: Floats
) -> tuple[Floats, Floats | None, Floats]:
    """The excursion, the rates over the region so widened (None where it does not settle), what it would take next."""
    reach = needed = np.zeros(region.size)
    for _ in range(_ROUNDS):
        lo, hi = (np.tile(end, (len(inputs), 1)) for end in (region.lo - reach, region.hi + reach))
        low, high = rates_over(lo, hi, inputs)
        speed = np.maximum(np.abs(low), np.abs(high)).max(axis=0) + added
        needed = 0.5 * tau * speed * (1.0 + 1e-12)
        if np.all(needed <= reach):
            return reach, speed, needed
        if not np.all(np.isfinite(needed)):
            break
        reach = needed * (1.0 + 1e-6)
    return reach, None, needed
