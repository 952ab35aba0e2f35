"""Stage `certify`: the controller of a case as a certificate that `checker/` verifies without this package."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simgap import reading
from simgap.errors import UserError
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.sampling.gap_samples import known_gap
from simgap.gap.sampling.points import own_point, remembers
from simgap.geometry import Box
from simgap.io.certificate import Certified, Reached, write_certificate
from simgap.io.controller_file import load_controller_of
from simgap.io.gap_file import SavedGap, load_gap
from simgap.plants.context import Context
from simgap.provenance import provenance
from simgap.specifications.base import specification_of
from simgap.specifications.invariance import Invariance
from simgap.specifications.reach_avoid import ReachAvoid
from simgap.specifications.space import Space
from simgap.stages import log
from simgap.stages.synthesis import pose


def run(case_path: Path, gap: Path, controller_path: Path, out: Path) -> None:
    """Export cells, admissible inputs, nominal map and bound; towards a target levels, obstacles and paths as well.

    Raises:
        UserError: results of another case, or what a certificate does not cover, in one line.
    """
    context = Context.load(case_path)
    with context.blame():
        sensing = context.case.sensing
        if sensing is not None and (sensing.latency > 0 or any(sensing.error.values())):
            raise _refused("exact sensing")
        controller, bound = load_controller_of(controller_path, context), load_gap(gap, context)
        what = Certified(
            context.case.name, context.units, context.plant.sampled, bound.function, known_gap(context),
            controller.solution, controller.input_set, controller.input_names, _task(context, bound, gap),
        )  # fmt: skip
        head = write_certificate(out, what, provenance("certify", context.case, context.folder))
    won = int(controller.solution.winning.sum())
    pairs = int(np.bitwise_count(controller.solution.admitted(len(controller.input_set))).sum())
    log.info("certificate of %d cells and %d pairs in %s (digest %s)", won, pairs, out, head["digest"][:16])


def _task(context: Context, bound: SavedGap, gap: Path) -> Box | Reached:
    """The safe box, or target, obstacles and what is known of the path between samples.

    Raises:
        UserError: a specification of another kind, or a simulator whose hidden state the controller does not see.
    """
    specification, space = specification_of(context.case), Space.of(context.case)
    framed = isinstance(bound.function, BodyFrameGap)
    if remembers(context.case) and not framed:
        raise _refused("no hidden state but that of a robot in the plane")
    if isinstance(specification, Invariance) and not framed:
        return specification.region(space)
    if not isinstance(specification, ReachAvoid):
        raise _refused("invariance, or reach-while-avoid that ends in its target")
    problem, _ = pose(context, gap)
    swept = None
    if problem.swept is not None and bound.swept is not None:
        swept = bound.swept_by_class or (bound.swept[0][None], bound.swept[1][None])
    return Reached(
        specification.goal_box(space), specification.boxes(space), space.vector(specification.clearance),
        np.zeros(space.size) if problem.stray is None else problem.stray, space.pose if framed else None, swept,
    )  # fmt: skip


def _refused(what: str) -> UserError:
    return UserError(
        f"a certificate covers {what}", key="synthesis.specification",
        remedy="The closed loop and the audit are what checks this case.",
    )  # fmt: skip


def results_of(folder: Path) -> tuple[Path, Path, Path]:
    """Case, bound and controller of a results folder `results/<case>`, as a run leaves them.

    Raises:
        UserError: a folder without results, or whose case is not at its place.
    """
    case = Path("configs/cases") / f"{folder.name}.yaml"
    if not reading.is_file(case):
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
        if not reading.is_file(path):
            raise UserError("there is no such result", file=path, remedy="Run the case first.")
    return case, gap, controller
