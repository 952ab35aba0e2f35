"""Compares an answer with the sealed truth."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import Diagnosis
from simgap.model.symbolic import SymbolicModel


@dataclass(frozen=True)
class Mark:
    """How one diagnosis did.

    exact: the right set, or one that the sensitivities prove equivalent to it; listed: the right set is the answer or
    among its alternatives; hits: how many true effects the answer names (an equivalent counts); errors: relative
    errors of the parameters where the answer is the true set, by "effect.symbol"; listed_errors: the same where the
    true set is an alternative, which has values and no intervals; covered: whether each interval holds the truth.
    """

    verdict: str
    library: bool
    truth: list[list[str]]
    answer: list[list[str]]
    exact: bool
    listed: bool
    hits: int
    errors: dict[str, float]
    listed_errors: dict[str, float]
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


def _sealed(sealed: dict, key: tuple[str, str]) -> dict[str, float]:
    """What was hidden of one effect; a number and a phase of ripples are no sizes."""
    return {s: v for s, v in sealed["parameters"][f"{key[0]} {key[1]}"].items() if s not in ("n", "phase")}


def _errors(sealed: dict, values: dict[tuple[str, str], dict[str, float]]) -> dict[str, float]:
    """Relative errors by "effect.symbol"."""
    return {
        f"{key[0]}.{symbol}": abs(found[symbol] - true) / abs(true)
        for key, found in values.items() for symbol, true in _sealed(sealed, key).items()
    }  # fmt: skip


def mark(d: Diagnosis, sealed: dict) -> Mark:
    """Score an answer."""
    truth = frozenset((name, on) for name, on in sealed["effects"])
    answer = frozenset((e.name, e.on) for e in d.effects)
    sets = {frozenset((a.name, a.on) for a in s.effects): s.exact for s in d.alternatives}
    exact = answer == truth or sets.get(truth, False)
    equivalents = [answer, *(s for s, proven in sets.items() if proven)]
    chosen = {(e.name, e.on): e.parameters for e in d.effects} if answer == truth else {}
    beside = next((s.effects for s in d.alternatives if frozenset((a.name, a.on) for a in s.effects) == truth), ())
    covered = [
        bool(chosen[key][symbol].ci95[0] <= true <= chosen[key][symbol].ci95[1])
        for key in chosen for symbol, true in _sealed(sealed, key).items()
    ]  # fmt: skip
    return Mark(
        verdict=d.verdict,
        library=bool(sealed["library"]),
        truth=[list(t) for t in sorted(truth)],
        answer=[list(a) for a in sorted(answer)],
        exact=exact,
        listed=exact or truth in sets,
        hits=max(len(truth & s) for s in equivalents),
        errors=_errors(sealed, {k: {s: e.value for s, e in p.items()} for k, p in chosen.items()}),
        listed_errors=_errors(sealed, {(a.name, a.on): dict(a.values) for a in beside}),
        covered=covered,
        held_out_ratio=d.after.held_out_ratio,
    )
