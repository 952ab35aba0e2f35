"""Lipschitz estimators on functions whose constant is known: `python benchmarks/lipschitz.py [--repeats 120]`.

Each repeat gives every estimator 10^4 evaluations or pairs: random pairs within a radius for the extreme-value ones
(100 blocks of 100), a grid of 90 to 110 cells along each axis for the grid estimate. Printed: median estimate / true
constant, and in brackets the share of repeats in which the estimate was at least the true constant; for the jump the
median estimate.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.stats import kstest, weibull_max

from simgap.arrays import Floats
from simgap.gap.lipschitz.estimates import ReverseWeibull, fit_reverse_weibull, profile_upper
from simgap.gap.lipschitz.grid import estimate
from simgap.gap.thresholds import GATE
from simgap.geometry import Box, Grid
from simgap.statistics import extrapolated_maximum

BOX = Box([-1.0, -1.0], [1.0, 1.0])
BLOCKS, PAIRS, RADIUS = 100, 100, 0.05
FUNCTIONS: dict[str, tuple[Callable[[Floats], Floats], float | None]] = {
    "smooth": (lambda x: np.sin(2.0 * x[:, 0]) + 0.5 * np.sin(2.0 * x[:, 1]), float(np.hypot(2.0, 1.0))),
    "corner maximum": (lambda x: 0.5 * (x[:, 0] + 1.0) ** 2 + 0.5 * (x[:, 1] + 1.0) ** 2, float(np.hypot(2.0, 2.0))),
    "tanh, width .05": (lambda x: 0.05 * np.tanh(x[:, 0] / 0.05), 1.0),
    "tanh, width .005": (lambda x: 0.005 * np.tanh(x[:, 0] / 0.005), 1.0),
    "jump": (lambda x: np.sign(x[:, 0]), None),
}


def fit_scipy_default(maxima: Floats) -> ReverseWeibull:
    """`scipy.stats.weibull_max.fit` from its own start, for comparison: it can stop far from the optimum."""
    shape, location, scale = (float(v) for v in weibull_max.fit(maxima))
    law = weibull_max(shape, loc=location, scale=scale)
    return ReverseWeibull(
        shape, location, scale, float(law.logpdf(maxima).sum()), float(kstest(maxima, law.cdf).pvalue)
    )


def pair_slopes(
    function: Callable[[Floats], Floats], box: Box, radius: float, pairs: int, rng: np.random.Generator
) -> Floats:
    """|g(a) - g(b)| / |a - b| of random pairs with |a - b| <= radius, inside the box: -> (pairs,)."""
    n = box.size
    a = box.sample(rng, pairs)
    direction = rng.normal(size=(pairs, n))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    b = np.clip(a + direction * radius * rng.random((pairs, 1)) ** (1.0 / n), box.lo, box.hi)
    distance = np.linalg.norm(a - b, axis=1)
    kept = distance > 1e-9 * radius
    return np.abs(function(a) - function(b))[kept] / distance[kept]


def one_repeat(function: Callable[[Floats], Floats], rng: np.random.Generator) -> dict[str, float]:
    """All estimates of the Euclidean constant, the KS p-value and the resolution ratio of one repeat."""
    slopes = pair_slopes(function, BOX, RADIUS, BLOCKS * PAIRS + 200, rng)[: BLOCKS * PAIRS]
    maxima = slopes.reshape(BLOCKS, PAIRS).max(axis=1)
    law, default = fit_reverse_weibull(maxima), fit_scipy_default(maxima)
    grid = Grid(BOX, rng.integers(90, 111, 2))
    found = estimate(function(grid.centres())[:, None], grid)
    return {
        "max slope": float(maxima.max()),
        "EVT, scipy start": default.location,
        "EVT, multi-start": law.location,
        "profile 95 %": profile_upper(maxima, law),
        "top-20 spacing": extrapolated_maximum(slopes, 4),
        "grid": found.euclidean,
        "ks_p": law.ks_p,
        "refused": float(found.ratio.max() > GATE),
        "log-likelihood lost by scipy": law.log_likelihood - default.log_likelihood,
    }


def main() -> None:
    """Run, print the table, write the numbers."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--repeats", type=int, default=120)
    arguments.add_argument("--seed", type=int, default=0)
    given = arguments.parse_args()
    table = {}
    for name, (function, true) in FUNCTIONS.items():
        rng = np.random.default_rng(given.seed)
        runs = [one_repeat(function, rng) for _ in range(given.repeats)]
        row = {}
        for key in runs[0]:
            values = np.array([run[key] for run in runs])
            entry = {"median": float(np.median(values)), "mean": float(values.mean())}
            if true is not None and key not in ("ks_p", "refused", "log-likelihood lost by scipy"):
                entry["coverage"] = float(np.mean(values >= true * (1.0 - 1e-12)))
                entry["median"] /= true
                entry["mean"] /= true
            row[key] = entry
        row["ks_p"]["passes"] = float(np.mean([run["ks_p"] > 0.05 for run in runs]))
        table[name] = row
    show(table)
    out = Path(__file__).parent / "results" / "lipschitz.json"
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps({"repeats": given.repeats, "seed": given.seed, "table": table}, indent=1) + "\n")


def show(table: dict[str, dict[str, dict[str, float]]]) -> None:
    """Print estimate / true (coverage), and how often the grid estimate was refused."""
    methods = ["max slope", "EVT, scipy start", "EVT, multi-start", "profile 95 %", "top-20 spacing", "grid"]
    print(f"{'':18}" + "".join(f"{m:>19}" for m in methods) + f"{'grid refused':>14}{'KS passes':>11}")
    for name, row in table.items():
        cells = [
            f"{row[m]['median']:.4g}" + (f" ({row[m]['coverage']:.2f})" if "coverage" in row[m] else " abs")
            for m in methods
        ]
        ends = f"{row['refused']['mean']:>14.2f}{row['ks_p']['passes']:>11.2f}"
        print(f"{name:18}" + "".join(f"{c:>19}" for c in cells) + ends)


if __name__ == "__main__":
    main()
