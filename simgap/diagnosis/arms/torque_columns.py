"""Torque columns that are not what the case says: reversed, of another joint, or of nothing.

The torque of each joint is regressed on that of the declared model beside friction and a bias, on *fit* and *choose*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.arms.fit import correlation_rows, solve, spread, standard_errors
from simgap.diagnosis.arms.problem import TERMS, Part
from simgap.diagnosis.record.faults.columns import ConstantColumn, SwappedColumns, WrongSign
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.thresholds import MATTERS, MOST, PLAUSIBLE_RATIO, SURE

_CONSTANT = 1e-6  # a torque that varies less than this share of the declared model's is no reading

_TAKEN_OUT = "Nothing is fitted to that."


@dataclass(frozen=True)
class _Line:
    """A torque over a model's, regressed on that beside friction and a bias.

    Attributes:
        theta, errors: (4,) slope, viscous and dry friction, bias, and their standard errors.
        left, at_one, without: RMS of what is left; at a slope of 1; without the model's torque.
    """

    theta: Floats
    errors: Floats
    left: float
    at_one: float
    without: float

    @property
    def tells(self) -> bool:
        """Whether the model's torque takes away most of what friction and a bias leave."""
        return self.left**2 < (1.0 - MOST) * self.without**2

    @property
    def is_reversed(self) -> bool:
        """Whether it follows the model's with the other sign, and no friction would have to push."""
        slope, *friction = self.theta[:3] + SURE * self.errors[:3] * [1.0, -1.0, -1.0]
        return self.tells and slope < 0.0 and max(friction) <= 0.0


def faulty_columns(
    part: Part, first: int, inputs: Sequence[str]
) -> tuple[tuple[RecordingFault, ...], tuple[int, ...], tuple[str, ...]]:  # fmt: skip
    """Findings, the joints whose torques say nothing, and warnings.

    Args:
        part: rows that may be looked at; first: its first column of a term.
        inputs: input of each joint.
    """
    faults = list[RecordingFault]()
    still = np.std(part.torque, axis=0) <= _CONSTANT * np.std(part.torque - part.y, axis=0)
    out = set(np.flatnonzero(still).tolist())
    for j in sorted(out):
        sentence = f"The column of {inputs[j]} does not change while the arm moves. {_TAKEN_OUT}"
        faults.append(ConstantColumn().told(inputs[j], float(np.mean(part.torque[:, j])), sentence))
    own = {j: _line(part, first, j, j) for j in np.flatnonzero(~still).tolist()}
    for j in own:
        better = _other(part, first, j, own[j], [k for k in own if k != j])
        if better is None:
            continue
        out.add(j)
        both = _other(part, first, better, own[better], [j]) is not None
        if better > j or not both:
            what = f"The column of {inputs[j]} follows what {inputs[better]} would be far better than its own."
            if both:
                what = f"The columns of {inputs[j]} and {inputs[better]} are swapped."
            faults.append(SwappedColumns().of(inputs[j], inputs[better], f"{what} {_TAKEN_OUT}"))
    for j in sorted(set(own) - out):
        if own[j].is_reversed:
            sentence = f"The column of {inputs[j]} has the wrong sign. {_TAKEN_OUT}"
            faults.append(WrongSign().told(inputs[j], float(own[j].theta[0]), sentence))
            out.add(j)
    said = tuple(
        f"Besides friction, {inputs[j]} is {own[j].theta[0]:.3g} times what the declared arm needs: check units, drive "
        "gain and masses before trusting other effects named there; a payload of known mass separates them."
        for j in sorted(set(own) - out)  # another multiple explains most of what a multiple of 1 leaves
        if own[j].theta[0] > 0.0 and own[j].left ** 2 < MATTERS * own[j].at_one ** 2
    )
    return tuple(faults), tuple(sorted(out)), said


def without(part: Part, joints: Sequence[int]) -> Part:
    """The rows with nothing to say of these joints: no row of theirs is fitted or chosen by."""
    live = part.live.copy()
    live[:, list(joints)] = 0.0
    return replace(part, live=live)


def _other(part: Part, first: int, j: int, own: _Line, others: Sequence[int]) -> int | None:
    """The joint whose declared torque, of some, the torque of joint j follows far better than that of its own."""
    lines = {k: _line(part, first, j, k) for k in others}
    fits = {
        k: line.left
        for k, line in lines.items()
        if line.tells and 1 / PLAUSIBLE_RATIO < line.theta[0] < PLAUSIBLE_RATIO and line.left**2 < MATTERS * own.left**2
    }
    return min(fits, key=lambda k: fits[k], default=None)


def _line(part: Part, first: int, j: int, model: int) -> _Line:
    """The torque of joint j over that of the declared model at the joint `model`, with friction and bias of that."""
    names = list(TERMS)
    terms = [names.index(e) for e in ("viscous_friction", "coulomb_friction", "input_bias")]
    columns = part.x[:, model, [first + len(TERMS) * model + k for k in terms]]
    x = np.column_stack([part.torque[:, model] - part.y[:, model], columns])[:, None, :]
    live = (part.live[:, j] * part.live[:, model])[:, None]
    rows = Part(x, part.torque[:, [j]], live, part.trace, part.t, part.torque[:, [j]])
    gram, right = rows.grams(np.ones(1))
    found, bare = solve(gram, right, range(4)), solve(gram, right, range(1, 4))
    one = solve(gram, right - gram[:, 0], range(1, 4)) + np.array([1.0, 0.0, 0.0, 0.0])
    errors = standard_errors(rows, found, range(4), np.ones(1), correlation_rows(rows, found))
    return _Line(found, errors, *(float(spread(rows, theta)[0]) for theta in (found, one, bare)))
