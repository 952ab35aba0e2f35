"""Stage `gap`: from roll-outs to a bound of the gap on all of X x U, checked on fresh samples."""

from __future__ import annotations

import resource
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pyarrow as pa

from simgap.errors import BrokenPromise, UserError
from simgap.gap.conformal import Calibration
from simgap.gap.fit import fit_gap
from simgap.gap.fresh_check import FreshCheck, check_fresh
from simgap.gap.function import GapFunction
from simgap.gap.samples import GapSamples
from simgap.gap.settings import GapSettings
from simgap.gap.tiers import Tier
from simgap.geometry import Floats, Grid
from simgap.io.documents import write_json
from simgap.io.parquet import read_parquet, stack, table, write_parquet
from simgap.model.sampled import NominalModel
from simgap.provenance import provenance
from simgap.stages.context import Context, log
from simgap.stages.rollouts import successors

THINNED = 20_000  # samples kept for pictures
REMEMBERED = Tier(
    2,
    "Delay or lag of the inputs is not in the nominal model: the bound is the hull over what the least and the largest "
    "admissible earlier commands leave behind in the simulator. That nothing in between does more is an estimate, "
    "checked on fresh samples with random earlier commands.",
)
FINER = "Use a smaller eps, or set gap.tolerated_probability."
WIDER = (
    "A conformal bound leaves out up to gap.conformal.miscoverage of the random samples: lower that, or set "
    "gap.tolerated_probability further above it."
)


def run(
    case_path: Path,
    eps: float,
    shards: Sequence[Path],
    fresh: Path,
    out: Path,
    thinned: Path,
    calibration: Path | None = None,
) -> None:
    """Fit gamma on the shards of one eps (a conformal one on `calibration` too), check it on the fresh samples.

    Raises:
        UserError: damaged shards, settings that do not fit.
        BrokenPromise: a Lipschitz constant that cannot be trusted, or more violations than the case tolerates.
    """
    context = Context.load(case_path)
    section = context.need(context.case.gap, "gap")
    with context.blame():
        model = context.plant.sampled
        context.plant.check_with_drake(context.box, context.input_set)
        samples = collect(context, model, eps, shards)
        log.info("fitting on %d states x %d inputs", samples.grid.size, len(samples.inputs))
        began = time.perf_counter()
        drawn = Calibration(*gaps(context, model, read_parquet(calibration))) if calibration else None
        result = fit_gap(samples, GapSettings.of(section), drawn)
        log.info("fitted in %.2f s", time.perf_counter() - began)
    x, u, d = gaps(context, model, read_parquet(fresh))
    check = check_fresh(result.function, x, u, d, section.confidence)
    log.info("%s", check.tier.text)
    memory = () if samples.d_upper is None else (REMEMBERED,)
    tolerate(check, section.tolerated_probability, WIDER if section.bound == "conformal" else FINER)
    function = covering_remainder(
        context, result.function.with_tiers([*result.function.tiers, *memory, check.tier]), section.remainder
    )
    content = result.to_json() | function.to_json()
    seeds = {"fresh": section.seed, "fit": section.seed}
    seeds |= {"calibration": section.conformal.seed} if drawn else {}
    record = provenance("gap", context.case, context.folder, seeds, eps=eps)
    content |= {"eps": eps, "fresh": asdict(check), "provenance": record}
    write_parquet(thinned, thin(context, samples))
    write_json(out, content)
    log.info("peak memory %d MiB", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)


def collect(context: Context, model: NominalModel, eps: float, shards: Sequence[Path]) -> GapSamples:
    """The signed gap on the grid, from shards in order.

    Raises:
        UserError: a shard that is damaged, missing or of another grid.
    """
    grid, inputs = Grid.covering(context.box, eps), context.input_set
    rows = grid.size * len(inputs)
    d = np.empty((2, rows, len(context.states)))
    done, spread = 0, False
    for path in shards:
        rolled = read_parquet(path)
        if done + len(rolled) > rows:
            break
        ends = successors(context, rolled)
        predicted = model.step(stack(rolled, context.states), stack(rolled, context.inputs))
        for side, values in zip(d, ends, strict=True):
            side[done : done + len(rolled)] = values - predicted
        spread, done = spread or ends[0] is not ends[1], done + len(rolled)
    if done != rows:
        raise UserError(
            f"the shards hold {done} roll-outs, the grid of eps = {eps:g} needs {rows}",
            file=shards[0],
            remedy="Delete the shards of this eps and run again.",
        )
    lower, upper = d.reshape(2, grid.size, len(inputs), -1)
    names = tuple(context.states), tuple(context.inputs)
    return GapSamples(grid, inputs, lower, *names, upper if spread else None)


def gaps(context: Context, model: NominalModel, rolled: pa.Table) -> tuple[Floats, Floats, Floats]:
    """States, inputs and signed gap `f_hat - f` of a table of roll-outs."""
    x, u = stack(rolled, context.states), stack(rolled, context.inputs)
    return x, u, stack(rolled, [f"next_{n}" for n in context.states]) - model.step(x, u)


def tolerate(check: FreshCheck, probability: float, remedy: str = FINER) -> None:
    """One violation breaks the promise, unless the case tolerates a probability that the check confirms."""
    if check.violations == 0 or check.upper <= probability:
        return
    allowed = "none is tolerated" if probability == 0 else f"tolerated probability {probability:g} < {check.upper:.2g}"
    raise BrokenPromise(
        f"gamma does not cover: {check.violations} of {check.samples} fresh samples exceed it ({allowed}), "
        f"by up to {check.worst}",
        remedy,
    )


def covering_remainder(context: Context, function: GapFunction, remainder: Mapping[str, float]) -> GapFunction:
    """The bound moved outward by what measured data leave unexplained in one step.

    Raises:
        UserError: a remainder of something that is no state.
    """
    unknown = [name for name in remainder if name not in context.states]
    if unknown:
        raise UserError(f"{unknown} are not states", file=context.path, key="gap.remainder")
    if not remainder:
        return function
    by = np.array([remainder.get(name, 0.0) for name in context.states])
    words = ", ".join(f"{value:.3g} for {name}" for name, value in remainder.items())
    left_out = [name for name in context.states if name not in remainder]
    note = f" Nothing measured bounds {', '.join(left_out)}." if left_out else ""
    tier = Tier(3, f"Raised on both sides by {words}: the split-conformal bound of what measured data leave.{note}")
    return function.raised(by, by).with_tiers([*function.tiers, tier])


def thin(context: Context, samples: GapSamples) -> pa.Table:
    """Evenly spaced samples with their gap, for pictures."""
    pairs = samples.d.shape[0] * samples.d.shape[1]
    rows = np.unique(np.linspace(0, pairs - 1, min(pairs, THINNED)).astype(int))
    k, m = np.divmod(rows, len(samples.inputs))
    x, u, d = samples.grid.centres()[k], samples.inputs[m], samples.d[k, m]
    if samples.d_upper is not None:
        d[1::2] = samples.d_upper[k, m][1::2]  # both ends of the range are seen
    columns = {n: x[:, j] for j, n in enumerate(context.states)}
    columns |= {n: u[:, j] for j, n in enumerate(context.inputs)}
    columns |= {f"gap_{n}": d[:, j] for j, n in enumerate(context.states)}
    units = context.units | {f"gap_{n}": context.units[n] for n in context.states}
    return table(columns, units, {"case": context.case.name}, provenance("gap", context.case, context.folder))
