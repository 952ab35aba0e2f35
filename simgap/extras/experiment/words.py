"""The next experiment in one paragraph."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from simgap.extras.experiment.ask import WANTED, Advice, Question
from simgap.notation import joined, number, pretty_unit

_MOST_NAMED = 3


def paragraph(question: Question, advice: Advice, units: Mapping[str, str], file: str) -> str:
    """What cannot be told apart, what to record, how sure one will be, and what else would help."""
    rivals, best = advice.known.rivals, advice.proposal.best
    labels = [r.label for r in rivals]
    shown = labels if len(labels) <= _MOST_NAMED else [*labels[:_MOST_NAMED], f"{len(labels) - _MOST_NAMED} more"]
    if len(rivals) == 1:
        opening = f"These recordings separate {labels[0]} from everything else that was tried."
    else:
        opening = f"These recordings cannot separate {joined(shown)}."
    if best is None:
        return (
            f"{opening} Each of the {advice.proposal.tried} inputs that were tried takes the plant out of its range "
            "(domain.X, or the recorded one): widen it, or start elsewhere."
        )
    how = _recording(question, advice, units, file)
    if len(rivals) == 1:
        return f"{opening} {how} Its numbers will be known to {_intervals(advice)}."
    if advice.proposal.sure < WANTED:
        return f"{opening} {_certainty(advice)}"
    return f"{opening} {how} {_certainty(advice)}"


def _recording(question: Question, advice: Advice, units: Mapping[str, str], file: str) -> str:
    best, t = advice.proposal.best, advice.bench.t
    assert best is not None
    own = len(question.middle)
    peaks = [
        f"{name} within {number(float(best.u[:, j].min()), 3)} and {number(float(best.u[:, j].max()), 3)} "
        f"{pretty_unit(units.get(name, ''))}".strip()
        for j, name in enumerate(question.model.input_names[:own])
        if np.ptp(best.u[:, j]) > 0.0
    ]
    start = ", ".join(
        f"{n} = {number(float(v))}" for n, v in zip(question.model.state_names, question.start, strict=True)
    )
    held = ", ".join(
        f"{n} = {number(v)} {pretty_unit(question.model.units[n])}".strip()
        for n, v in zip(question.model.conditions, advice.bench.held, strict=True)
    )
    under = f" with {held}" if held else ""
    rate = 1.0 / float(t[1] - t[0])
    return (
        f"Apply {file} ({best.name}, improved from there; {t[-1] - t[0]:.3g} s at {rate:.4g} Hz, "
        f"{joined(peaks)}) from {start}{under}, record the response, and diagnose it together with the existing "
        "recordings, the new file first."
    )


def _certainty(advice: Advice) -> str:
    best, rivals = advice.proposal.best, advice.known.rivals
    assert best is not None
    a, b = advice.proposal.closest(rivals, advice.bench)
    pair = f"if {rivals[a].label} is right, {rivals[b].label} is expected to miss by {number(best.d[a, b], 3)} in χ²"
    chance = _percent(advice.proposal.sure)
    if advice.proposal.sure >= WANTED:
        equal = [f"{rivals[i].label} and {rivals[j].label}" for i, j in advice.proposal.alike()]
        text = (
            f"Then {'the others' if equal else 'they'} are separated with a probability of at least {chance} (the "
            f"closest pair: {pair}), given the measured noise and that one of them is right. {_besides_them(advice)}"
        )
        if not equal:
            return text
        return f"{text} Under every input that was tried {joined(equal)} act alike{_besides(advice)}."
    text = (
        f"No input within the limits is enough: the best of {advice.proposal.tried} that were tried separates them "
        f"with a probability of {chance} ({pair})."
    )
    if advice.remedy is None:
        return f"{text} They act alike on what is measured here; take whichever is simpler to correct."
    return f"{text} Instead {advice.remedy.sentence}: then the probability is {_percent(advice.remedy.probability)}."


def _besides_them(advice: Advice) -> str:
    """What else the recording would show, and what a longer one would."""
    text = (
        "Another effect beside them, no larger than these recordings leave it, would be named with a probability of "
        f"{_percent(advice.proposal.shown)}."
    )
    if advice.longest is None:
        return text
    short, long = _seconds(advice)
    chances = f"{_percent(advice.longest.sure)} and {_percent(advice.longest.shown)}"
    return f"{text} {short} are enough; {long} would make it {chances}."


def lengths_in_words(advice: Advice) -> str:
    """Lines over the picture: how sure one will be by the length that is proposed, and by the longest."""
    if len(advice.known.rivals) == 1:
        return "what to play"
    short, long = _seconds(advice)
    now, whole = advice.proposal, advice.longest
    rows = [(short, now)] if whole is None else [(short, now), (long, whole)]
    each = [f"{s}: separated with {_percent(p.sure)}, another effect named with {_percent(p.shown)}" for s, p in rows]
    return "\n".join(each)


def _seconds(advice: Advice) -> tuple[str, str]:
    """How long the proposed recording is, and the longest that was tried."""
    t, whole = advice.bench.t, (advice.longest or advice.proposal).best
    assert whole is not None
    return f"{t[-1] - t[0]:.3g} s", f"{(t[1] - t[0]) * (len(whole.u) - 1):.3g} s"


def _percent(probability: float) -> str:
    return f"{100 * min(probability, 0.999):.3g} %"


def _besides(advice: Advice) -> str:
    """What tells those apart that no input does."""
    if advice.remedy is None:
        return ": take whichever is simpler to correct"
    return f"; to separate these, {advice.remedy.sentence} (probability {_percent(advice.remedy.probability)})"


def _intervals(advice: Advice) -> str:
    best, (only,) = advice.proposal.best, advice.known.rivals
    assert best is not None
    now = np.sqrt(np.diag(np.linalg.pinv(only.information, hermitian=True)) * advice.bench.excess)
    ratios: Sequence[float] = (best.d / np.maximum(now, 1e-300)).tolist()
    return f"{joined([f'{100 * r:.2g} %' for r in ratios])} of their present intervals"
