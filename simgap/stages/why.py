"""Why a state of a case wins or loses, from the results of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from simgap.errors import UserError
from simgap.gap.sampling.points import own_point
from simgap.io.controller_file import load_controller_of
from simgap.io.gap_file import load_gap
from simgap.plants.context import Context
from simgap.stages.synthesis import pose_problem
from simgap.synthesis.explain import why
from simgap.synthesis.margins import margins_of


def run(case: Path, at: Mapping[str, float], results: Path | None = None) -> tuple[str, ...]:
    """Sentences on the state that `at` names, all states of the case by name.

    Args:
        results: folder of the case's results; `results/<case>` if not given.

    Raises:
        UserError: a state that is not named, results that are not there.
    """
    context = Context.load(case)
    if set(at) != set(context.states) or not np.isfinite([*at.values()]).all():
        remedy = "Give each of them a number, once."
        raise UserError(f"a state is {', '.join(context.states)}", key="--at", remedy=remedy)
    folder = results if results is not None else Path("results") / context.case.name
    with context.blame():
        bound = folder / "gap" / own_point(context.case) / "gap.json"
        problem, _ = pose_problem(context, bound)
        controller = load_controller_of(folder / "synthesis" / "gap" / "controller.npz", context)
        x = np.array([at[name] for name in context.states], dtype=np.float64)
        cell = int(controller.grid.index(x[None])[0])
        margins = margins_of(context, load_gap(bound, context).function, controller.solution, cell)
        return why(problem, controller, margins, x)
