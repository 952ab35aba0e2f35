"""A shield tried in the simulator of a case: a policy from the same starts as it is, and through the shield."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats, Ints
from simgap.closed_loop import Judge
from simgap.config.named_files import FunctionFile
from simgap.errors import UserError, excerpt, placed
from simgap.extras.certify import of_case, results_of
from simgap.extras.engines.python_function import imported
from simgap.gap.noise import statement_of
from simgap.geometry import Grid
from simgap.io.controller_file import load_controller_of
from simgap.io.gap_file import load_gap
from simgap.plants.context import Context
from simgap.plugins import announce
from simgap.shield import Shield
from simgap.simulators.process import run_in_processes
from simgap.specifications.base import specification_of
from simgap.specifications.solution import Progress
from simgap.specifications.space import Space
from simgap.stages.validation import keep_promise, simulate, starts, tolerated_share

RANDOM = "random"
"""The policy that draws from U at every sample."""
KEY = "--policy"


@dataclass(frozen=True, eq=False)
class Driven:
    """Policy for `simgap.closed_loop`: what a function of the state wants, through a shield or as it is.

    Attributes:
        shield: of the controller in whose place the policy runs; its counts are of the samples that pass it.
        wanted: measured state (nx,) -> input (nu,). through: whether it passes the shield; otherwise the nearest member
            of U is applied.
    """

    shield: Shield
    wanted: Callable[[Floats], Floats]
    through: bool

    @property
    def input_set(self) -> Floats:
        """U, (M, nu)."""
        return self.shield.controller.input_set

    @property
    def first(self) -> int:
        """The memory before the first sample."""
        return self.shield.controller.first

    @property
    def kind(self) -> Ints | None:
        """Class of each input, (M,), where that of the previous one is remembered."""
        return self.shield.controller.kind

    @property
    def progress(self) -> Progress | None:
        """What a task has come to."""
        return self.shield.controller.progress

    @property
    def grid(self) -> Grid:
        """Cells of the measured state."""
        return self.shield.controller.grid

    def lookup(self, x: Floats, pending: Ints | int) -> Ints:
        """Number of the input for a measured state (1, nx): -> (1,), -1 where the shield has none."""
        with placed(key=KEY):
            given, nearest = self.shield.numbers(x[0], self.wanted(x[0]), int(pending))
        if self.through and given >= 0:
            self.shield.count(given, nearest)
        return np.array([given if self.through else nearest])


def run(
    what: Path,
    policy: str = RANDOM,
    runs: int = 100,
    controller: Path | None = None,
    bound: Path | None = None,
    engine_log: Path | None = None,
) -> dict[str, Any]:
    """Figures of a policy alone and through the shield, and of how many samples the shield acted at.

    Args:
        what: case file, or its folder in results/. controller, bound: files that are not where a run leaves them.
        policy: `random`, or `file.py:name` of a function of the measured state (nx,) that gives an input (nu,).
        runs: starts, those of the validation first.

    Raises:
        BrokenPromise: a run through the shield that violates what the controller promises.
        UserError: a policy that cannot be run, results that are not there, a controller that is no shield.
    """
    case = what
    if bound is None or controller is None or what.is_dir():
        case, own_bound, own_controller = results_of(what) if what.is_dir() else of_case(what)
        bound, controller = bound or own_bound, controller or own_controller
    job = (case, bound, controller, policy, runs)
    found = run_in_processes(_drive, [job], 1, engine_log)[0]
    keep_promise(found["shielded"], *found.pop("judged_by"))
    return found


def text(found: dict[str, Any]) -> str:
    """The figures in words."""
    rows = [
        f"{title}: {figures['runs_that_violated_it']} of {figures['runs']} runs violate the specification, "
        f"{figures['steps']:,} steps ({', '.join(f'{end}: {n}' for end, n in figures['ends'].items())})."
        for title, figures in (("Policy alone", found["alone"]), ("Through the shield", found["shielded"]))
    ]
    share = found["acted"] / max(found["samples"], 1)
    return "\n".join([*rows, f"The shield acted at {found['acted']:,} of {found['samples']:,} samples ({share:.1%})."])


def _drive(case_path: Path, bound: Path, controller_path: Path, policy: str, count: int) -> dict[str, Any]:
    """Both kinds of runs, in the engine's process; a person's policy runs there too."""
    context = Context.load(case_path)
    section, case = context.need(context.case.validation, "validation"), context.case
    controller, gap = load_controller_of(controller_path, context), load_gap(bound, context).function
    with placed(file=controller_path):
        shield = Shield(controller)
    with context.blame():
        begin, space = starts(context, section, controller, count), Space.of(case)
        monitor = specification_of(case).monitor(space, controller.solution)
        judge = Judge(space, monitor, section.steps, controller.input_set, context.plant.sampled, gap)
    tolerated, noise = tolerated_share(case), statement_of(case)
    proven = replace(judge, certificate=controller.solution, tolerant=tolerated > 0, noisy=noise is not None)
    figures = {}
    for name, through, by in (("alone", False, judge), ("shielded", True, proven)):
        driven = Driven(shield, policy_of(policy, controller.input_set, section.seed), through)
        made = simulate(case, context.folder, driven, controller.solution, begin)
        figures[name] = by.count(made, range(len(made)), 1)[0]
    about = {"case": case.name, "policy": policy, "acted": shield.acted, "samples": shield.steps}
    return {**about, **figures, "judged_by": (tolerated, noise)}


def policy_of(named: str, inputs: Floats, seed: int) -> Callable[[Floats], Floats]:
    """The function of the measured state that a person means, or the random one.

    Raises:
        UserError: a file that is not there or cannot be imported; from the function, whatever it raises.
    """
    if named == RANDOM:
        rng = np.random.default_rng(seed)
        return lambda _: inputs[rng.integers(len(inputs))]
    place = Path(named)
    file = FunctionFile.find(place.name, place.parent, KEY)
    announce(f"the policy {file.path}")
    try:
        function = imported(file)
    except Exception as error:
        raise _fault(file, "cannot be imported", error) from None

    def wanted(x: Floats) -> Floats:
        try:
            return np.atleast_1d(np.asarray(function(x.copy()), dtype=np.float64))
        except Exception as error:
            raise _fault(file, f"fails at {x.tolist()}", error) from None

    return wanted


def _fault(file: FunctionFile, what: str, error: Exception) -> UserError:
    told = f"the policy '{file.name}' {what}: {type(error).__name__}: {excerpt(error)}"
    return UserError(told, file=file.path, key=KEY, remedy="Correct it.")
