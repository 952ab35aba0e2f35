"""Witness of a broken promise, with everything that it takes to simulate it again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.attack.campaign import BrokenRun
from simgap.attack.worst_step import GapStep
from simgap.errors import UserError
from simgap.gap.fitting.acceptance import worst_outside
from simgap.gap.json_record import JsonRecord

STEP, RUN = "step outside gamma", "closed-loop run"
SIMULATOR, DISTURBANCE = "simulator", "disturbance"


@dataclass(frozen=True, eq=False)
class Witness(JsonRecord):
    """One step outside gamma, or one run that breaks what the controller promises.

    Attributes:
        kind: STEP or RUN; plant: SIMULATOR, or DISTURBANCE where the states are the adversary's own within f + gamma.
        what: a sentence. rule: by which the inputs were chosen, and end: how it ended, for a run.
        inputs: (k, nu) one after the other. states: (k + 1, nx) of a run, else (1, nx) where the step begins (from rest
            at this pose for a robot that remembers). measured: (k + 1, nx) of a run, else (0, nx).
        d, lo, hi: (nx,) gap and bound of the step outside, in the robot's frame where that remembers; empty for a run.
    """

    kind: str
    plant: str
    what: str
    rule: str
    end: str
    inputs: Floats
    states: Floats
    measured: Floats
    d: Floats
    lo: Floats
    hi: Floats

    @staticmethod
    def of_step(step: GapStep, names: tuple[Sequence[str], Sequence[str]] | None = None) -> Witness:
        """From a step that lies outside; the sentence says where if it knows the names of states and inputs."""
        nothing = np.empty((0, step.x.size))
        inputs = step.u[None] if step.history is None else np.concatenate([step.history, step.u[None]])
        what = f"a step of the simulator lies outside gamma by {step.share:.3g} of its width"
        x, u, d, lo, hi = (row[None] for row in (step.x, step.u, step.d, step.lo, step.hi))
        place = worst_outside(names, x, u, (d, d), lo, hi) if names is not None else None
        what += f": {place}" if place is not None else ""
        return Witness(STEP, SIMULATOR, what, "", "", inputs, step.x[None], nothing, step.d, step.lo, step.hi)

    @staticmethod
    def of_run(plant: str, broken: BrokenRun, inputs: Floats) -> Witness:
        """From a broken run, input numbers into U (M, nu)."""
        run, nothing = broken.run, np.empty(0)
        steps = len(run.inputs)
        after = f"after {steps} step{'' if steps == 1 else 's'}" if steps else "where it begins"
        what = f"a run under the rule '{broken.rule}' ends {after}: {broken.end}"
        if broken.outside.any():
            what += f"; step {int(np.argmax(broken.outside)) + 1} is the first outside gamma"
        u, end = inputs[run.inputs], broken.end
        return Witness(RUN, plant, what, broken.rule, end, u, run.x, run.measured, nothing, nothing, nothing)

    @classmethod
    def read(cls, data: Mapping[str, Any], nx: int, nu: int) -> Witness:
        """From the content of a witness.json.

        Raises:
            UserError: a file that is no witness of a case with that many states and inputs.
        """
        try:
            own = cls.from_json(data)
            states, measured = own.states.reshape(-1, nx), own.measured.reshape(-1, nx)
            own = replace(own, inputs=own.inputs.reshape(-1, nu), states=states, measured=measured)
        except (KeyError, TypeError, ValueError):
            own = None
        if (
            own is None
            or own.kind not in (STEP, RUN)
            or not len(own.states)
            or (own.kind == STEP and not len(own.inputs))
        ):
            raise UserError("not a witness of this case", remedy="Give a witness.json that the audit wrote.")
        return own
