"""Inputs that may be tried: multisines, chirps, steps, slow ramps and holds, within the limits of the drive."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Floats
from simgap.excitation import multisine


@dataclass(frozen=True, eq=False)
class Wave:
    """An input to be tried.

    Attributes:
        name: what people read; u: (n, m) in units of the way from the middle of each input's range to its end.
    """

    name: str
    u: Floats


def waves(t: Floats, inputs: int, rng: np.random.Generator) -> Iterator[Wave]:
    """Every family on each input alone and, where there are several, on all of them together; t: (n,) s."""
    for name, shape in _shapes(t, rng):
        for j in range(inputs):
            alone = np.zeros((len(t), inputs))
            alone[:, j] = shape
            yield Wave(name, alone)
        if inputs > 1:
            shifts = [np.roll(shape, j * len(t) // inputs) for j in range(inputs)]
            yield Wave(f"{name}, all inputs", np.stack(shifts, axis=1))


def random_wave(t: Floats, inputs: int, rng: np.random.Generator) -> Wave:
    """A multisine of random band and size on every input: what a person takes who does not ask."""
    low, high = sorted(np.exp(rng.uniform(np.log(0.1), np.log(5.0), 2)))
    u = np.stack([multisine(t, 1.0, low, max(high, 1.5 * low), rng) for _ in range(inputs)], axis=1)
    return Wave(f"multisine of {low:.2g} to {high:.2g} Hz", u * rng.uniform(0.2, 1.0))


def _shapes(t: Floats, rng: np.random.Generator) -> Iterator[tuple[str, Floats]]:
    """Waves (n,) between -1 and 1."""
    span, rate = float(t[-1] - t[0]), 1.0 / float(t[1] - t[0])
    since = t - t[0]
    top = min(0.2 * rate, 8.0)
    for low, high in ((0.1, 0.5), (0.1, 2.0), (0.5, 2.0), (0.5, 5.0), (2.0, 8.0)):
        if low < top:
            for _ in range(2):
                band = (low, min(high, top))
                yield f"multisine of {low:g} to {band[1]:.2g} Hz", multisine(t, 1.0, *band, rng)
    for first, last in ((0.1, 2.0), (0.2, 5.0), (3.0, 0.2)):
        end = min(last, top)
        turns = first * since + 0.5 * (end - first) / span * since**2
        yield f"chirp of {first:g} to {end:.2g} Hz", np.asarray(np.sin(2.0 * np.pi * turns))
    for dwell in (0.15, 0.5, 1.5):
        levels = rng.uniform(-1.0, 1.0, int(span / dwell) + 2)
        yield f"steps of {dwell:g} s", levels[(since / dwell).astype(np.int64)]
        signs = np.sign(levels)
        yield f"reversals of {dwell:g} s", signs[(since / dwell).astype(np.int64)]
    for count in (1, 2, 5):
        phase = (count * since / span + 0.25) % 1.0
        yield f"ramps of {span / count:.3g} s", np.asarray(1.0 - 4.0 * np.abs(phase - 0.5))
    for count in (4, 8):
        held = np.round(3.0 * np.sin(2.0 * np.pi * np.floor(count * since / span) / count)) / 3.0
        yield f"holds of {span / count:.3g} s", 0.8 * held
        yield (
            f"holds of {span / count:.3g} s with a multisine",
            0.6 * held + multisine(t, 0.4, 0.5, min(4.0, max(top, 0.6)), rng),
        )
    decay = np.exp(-3.0 * since / span)
    yield "a multisine that fades", decay * multisine(t, 1.0, 0.2, min(3.0, max(top, 0.3)), rng)
    yield "a multisine that grows", decay[::-1] * multisine(t, 1.0, 0.2, min(3.0, max(top, 0.3)), rng)
