"""Stage `certify`: the controller of a case as a certificate that `checker/` verifies without this package."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simgap.errors import UserError
from simgap.gap.points import own_point, remembers
from simgap.gap.steps.samples import known_gap
from simgap.io.certificate import Certified, write_certificate
from simgap.io.controller_file import load_controller
from simgap.io.gap_file import load_gap
from simgap.provenance import provenance
from simgap.specifications.base import specification_of
from simgap.specifications.invariance import Invariance
from simgap.specifications.space import Space
from simgap.stages.context import Context, log


def run(case_path: Path, gap: Path, controller_path: Path, out: Path) -> None:
    """Export cells, admissible inputs, nominal map and bound.

    Raises:
        UserError: results of another case, or what a certificate does not cover, in one line.
    """
    context = Context.load(case_path)
    with context.blame():
        controller, bound = load_controller(controller_path), load_gap(gap, context).function
        certified = _certified(context, controller.states, controller.input_names)
        if not np.array_equal(controller.input_set, context.input_set):
            raise UserError("the controller was made for other inputs", file=controller_path)
        specification, space = specification_of(context.case), Space.of(context.case)
        if not certified or not isinstance(specification, Invariance):
            raise UserError(
                "a certificate covers invariance with exact sensing, without hidden state",
                key="synthesis.specification", remedy="The closed loop and the audit are what checks this case.",
            )  # fmt: skip
        model = context.plant.sampled
        what = Certified(
            context.case.name, context.units, model, bound, known_gap(context), controller.solution,
            controller.input_set, controller.input_names, specification.region(space),
        )  # fmt: skip
        head = write_certificate(out, what, provenance("certify", context.case, context.folder))
    won, pairs = int(controller.solution.winning.sum()), int(np.bitwise_count(controller.solution.mask).sum())
    log.info("certificate of %d cells and %d pairs in %s (digest %s)", won, pairs, out, head["digest"][:16])


def _certified(context: Context, states: tuple[str, ...], inputs: tuple[str, ...]) -> bool:
    """Whether the case is of a kind that a certificate covers.

    Raises:
        UserError: a controller of other states or inputs.
    """
    if (list(states), list(inputs)) != (list(context.states), list(context.inputs)):
        raise UserError("the controller is of another case", key="name", remedy="Give the results of this one.")
    sensing = context.case.sensing
    blurred = sensing is not None and (sensing.latency > 0 or any(sensing.error.values()))
    return not (remembers(context.case) or blurred)


def results_of(folder: Path) -> tuple[Path, Path, Path]:
    """Case, bound and controller of a results folder `results/<case>`, as a run leaves them.

    Raises:
        UserError: a folder without results, or whose case is not at its place.
    """
    case = Path("configs/cases") / f"{folder.name}.yaml"
    if not case.is_file():
        raise UserError("no case of that name in configs/cases", file=folder, remedy="Give the case file.")
    return of_case(case, folder)


def of_case(case: Path, folder: Path | None = None) -> tuple[Path, Path, Path]:
    """Case, bound and controller where a run leaves them.

    Raises:
        UserError: results that are not there.
    """
    own = Context.load(case).case
    results = folder if folder is not None else Path("results") / own.name
    gap, controller = results / "gap" / own_point(own) / "gap.json", results / "synthesis/gap/controller.npz"
    for path in (gap, controller):
        if not path.is_file():
            raise UserError("there is no such result", file=path, remedy="Run the case first.")
    return case, gap, controller
