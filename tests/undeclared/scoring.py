"""Compares an answer with the sealed truth."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.reading.record import Record, Trace
from simgap.diagnosis.result import Diagnosis
from simgap.model.symbolic import SymbolicModel


@dataclass(frozen=True)
class Mark:
    """How one diagnosis did.

    exact: the right set, or one that the sensitivities prove equivalent to it; listed: the right set is the answer or
    among its alternatives; hits: how many true effects the answer names (an equivalent counts); errors: relative
    errors of the parameters where the answer is the true set, by "effect.symbol"; covered: whether each interval holds
    the truth.
    """

    verdict: str
    library: bool
    truth: list[list[str]]
    answer: list[list[str]]
    exact: bool
    listed: bool
    hits: int
    errors: dict[str, float]
    covered: list[bool]
    held_out_ratio: float


def open_record(folder: Path, measured: tuple[str, ...]) -> Record:
    """The recording alone."""
    data = np.load(folder / "record.npz")
    count = sum(name.startswith("t") for name in data.files)
    traces = tuple(Trace(f"trace-{k}", data[f"t{k}"], data[f"y{k}"], data[f"u{k}"]) for k in range(count))
    return Record(traces, measured, ("torque",))


def examine(folder: Path, model: SymbolicModel, velocity: bool) -> tuple[Diagnosis, Mark]:
    """Diagnose the recording, then open the seal."""
    d = diagnose(model, open_record(folder, ("angle", "rate") if velocity else ("angle",)))
    sealed = json.loads((folder / "sealed.json").read_text())
    return d, mark(d, sealed)


def mark(d: Diagnosis, sealed: dict) -> Mark:
    """Score an answer."""
    truth = frozenset((name, on) for name, on in sealed["effects"])
    answer = frozenset((e.name, e.on) for e in d.effects)
    sets = {frozenset((a.name, a.on) for a in s.effects): s.exact for s in d.alternatives}
    exact = answer == truth or sets.get(truth, False)
    equivalents = [answer, *(s for s, proven in sets.items() if proven)]
    errors, covered = {}, []
    chosen = {(e.name, e.on): e.parameters for e in d.effects}
    for key, parameters in chosen.items():
        for symbol, true in sealed["parameters"].get(f"{key[0]} {key[1]}", {}).items() if answer == truth else ():
            if symbol in ("n", "phase"):
                continue
            estimate = parameters[symbol]
            errors[f"{key[0]}.{symbol}"] = abs(estimate.value - true) / abs(true)
            covered.append(bool(estimate.ci95[0] <= true <= estimate.ci95[1]))
    return Mark(
        verdict=d.verdict,
        library=bool(sealed["library"]),
        truth=[list(t) for t in sorted(truth)],
        answer=[list(a) for a in sorted(answer)],
        exact=exact,
        listed=exact or truth in sets,
        hits=max(len(truth & s) for s in equivalents),
        errors=errors,
        covered=covered,
        held_out_ratio=d.after.held_out_ratio,
    )
