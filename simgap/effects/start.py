"""Where the search for an effect begins: a family of points that leaves the null along a few linear directions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Scales:
    """Typical sizes in a record, from which starts are taken.

    Attributes:
        interval: median sampling interval, s.
        command: largest input that the effect would act on, or that drives its coordinate (1 for none).
        speed: root mean square speed of the coordinate that it would act on (1 if it acts on none).
        inertia: of that coordinate as declared, with all others free, where it stands at 0.
        places: lowest and highest place where that coordinate was read (the same number twice if it was not).
    """

    interval: float
    command: float = 1.0
    speed: float = 1.0
    inertia: float = 1.0
    places: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Start:
    """A map from `size` linear coefficients to parameter values; coefficients of 0 are the null.

    Attributes:
        size: number of coefficients.
        point: coefficients -> value of every parameter symbol.
        amplitude: coefficient at which the response is taken: small steps are chosen by whoever asks if this is
            None (a derivative), 1 for a secant to a definite size of the effect.
    """

    size: int
    point: Callable[[Sequence[float]], dict[str, float]]
    amplitude: float | None = None


def multiple(symbol: str, value: float) -> Start:
    """A secant from 0 to a definite value of a one-parameter effect."""
    return Start(1, lambda c: {symbol: max(c[0], 0.0) * value}, amplitude=1.0)
