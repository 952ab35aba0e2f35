"""The three folds of an arm's record: whole traces, or blocks of time where there are fewer than three."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simgap.diagnosis.arms.problem import Part, Payload
from simgap.diagnosis.thresholds import SEVERAL_TRACES
from simgap.errors import UserError

NAMES = ("fit", "choose", "confirm")
_BLOCKS = ("fit", "choose", "fit", "confirm", "fit", "choose", "fit", "confirm")


@dataclass(frozen=True, eq=False)
class ArmFolds:
    """Parts of each fold, and the traces that each is made of."""

    fit: Part
    choose: Part
    confirm: Part
    traces: dict[str, tuple[str, ...]]
    whole: bool


def folds_of(
    part: Part, names: Sequence[str], held: Sequence[str], share: float, payloads: Sequence[Payload] = ()
) -> ArmFolds:  # fmt: skip
    """Cut rows into fit, choose and confirm.

    Args:
        part: all rows; names: of the traces that `part.trace` counts.
        held: traces that confirm; if empty, the last `share` of them.
        payloads: of each the first trace that is not held out is fitted to, as nothing else says what it is.

    Raises:
        UserError: nothing would be left to fit to, or nothing of a payload.
    """
    if held or len(names) >= SEVERAL_TRACES:
        label = _whole(names, held, share, payloads)
        rows = np.array([label[names[k]] for k in part.trace])
    else:
        rows = np.empty(len(part.t), dtype=object)
        for k in range(len(names)):
            own = np.flatnonzero(part.trace == k)
            rows[own] = [_BLOCKS[int(len(_BLOCKS) * i / len(own))] for i in range(len(own))]
        label = {}
    parts = {name: _rows(part, rows == name) for name in NAMES}
    if not all(len(p.t) for p in parts.values()):
        raise UserError(
            "the traces are too few for the three folds fit, choose and confirm", key="measured.held_out",
            remedy="Record more traces, or hold out fewer.",
        )  # fmt: skip
    traces = {n: tuple(t for t in names if label[t] == n) if label else tuple(names) for n in NAMES}
    return ArmFolds(**parts, traces=traces, whole=bool(label))


def together(a: Part, b: Part) -> Part:
    """The rows of two parts."""
    pairs = zip(_arrays(a), _arrays(b), strict=True)
    return Part(*(np.concatenate(pair) for pair in pairs))


def _whole(names: Sequence[str], held: Sequence[str], share: float, payloads: Sequence[Payload]) -> dict[str, str]:
    """Fold of each trace; the last traces confirm and choose, those that a payload needs only if no others are left."""
    needed = {next((n for n in names if n in p.traces and n not in held), None) for p in payloads}
    last = [*(n for n in names if n in needed), *(n for n in names if n not in needed)]
    confirm = tuple(held) or tuple(last[-max(1, round(share * len(names))) :])
    rest = [n for n in last if n not in confirm]
    chosen = rest[-max(1, min(round(share * len(rest)), len(rest) - 1)) :] if len(rest) > 1 else []
    label = {n: "confirm" if n in confirm else "choose" if n in chosen else "fit" for n in names}
    for p in payloads:
        if not any(label[n] == "fit" for n in p.traces):
            raise UserError(
                f"nothing that is fitted to carries the payload of '{p.link}'", key="measured.held_out",
                remedy="Record more traces, or hold out other files.",
            )  # fmt: skip
    return label


def _arrays(part: Part) -> tuple[np.ndarray, ...]:
    return part.x, part.y, part.live, part.trace, part.t, part.torque


def _rows(part: Part, mask: np.ndarray) -> Part:
    return Part(*(a[mask] for a in _arrays(part)))
