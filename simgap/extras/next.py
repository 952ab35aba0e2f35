"""The next recording of a plant: what a diagnosis left open, the input that settles it, its picture and its words."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.config.measured import MeasuredSection
from simgap.diagnosis.diagnose import ready
from simgap.diagnosis.record.conditions import conditioned, under_conditions
from simgap.diagnosis.record.faults.measurement import is_fault
from simgap.diagnosis.record.record import Record
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.thresholds import CONFIDENCE, MATTERS
from simgap.effects import AppliedEffect
from simgap.errors import UserError
from simgap.extras.experiment.ask import WANTED, Advice, Question, ask, windows_to_come
from simgap.extras.experiment.propose import missed
from simgap.extras.experiment.rivals import Explained, library_names
from simgap.geometry import Box
from simgap.io import figure_style as style
from simgap.io.atomic import write_text
from simgap.io.recordings.measured import load_reading
from simgap.io.results import write_json
from simgap.notation import axis_label, few, joined, number, pretty_unit
from simgap.plants.context import Context
from simgap.stages import log
from simgap.stages.diagnosis import settings_of
from simgap.stages.gap_inputs import read_result


def paragraph(question: Question, advice: Advice, units: Mapping[str, str], file: str) -> str:
    """Sentences: what cannot be told apart, what to record, how sure one will be, and what else would help."""
    rivals, best = advice.known.rivals, advice.proposal.best
    labels = [r.label for r in rivals]
    shown = few(labels)
    if len(rivals) == 1:
        opening = f"These recordings separate {labels[0]} from all that was tried and does not act exactly alike."
    else:
        each = "; ".join(f"({k}) {words}" for k, words in enumerate(shown, start=1))
        opening = f"These recordings cannot separate these explanations: {each}."
    if best is None:
        return (
            f"{opening} Each of the {advice.proposal.tried} inputs that were tried takes the plant out of its range "
            "(domain.X, or the recorded one): widen it, or start elsewhere."
        )
    how = _recording(question, advice, units, file)
    if len(rivals) == 1:
        return f"{opening} {how} {_intervals(advice)}"
    return f"{opening} {'' if advice.proposal.sure < WANTED else f'{how} '}{_certainty(advice)}"


def _recording(question: Question, advice: Advice, units: Mapping[str, str], file: str) -> str:
    best, t, model = advice.proposal.found, advice.proposal.bench.t, question.model
    own = model.input_names[: len(question.middle)]
    peaks = [
        f"{name} within {number(float(u.min()), 3)} and {number(float(u.max()), 3)} {pretty_unit(units.get(name, ''))}"
        for name, u in zip(own, best.u.T, strict=False)
        if np.ptp(u) > 0.0
    ]
    start = _values(model.state_names, question.start, {})
    held = _values(model.conditions, advice.proposal.bench.held, model.units)
    return (
        f"Apply {file} ({best.name}, improved from there; {t[-1] - t[0]:.3g} s at {1.0 / float(t[1] - t[0]):.4g} Hz, "
        f"{joined([peak.strip() for peak in peaks])}) from {start}{f' with {held}' if held else ''}, record the "
        "response, and diagnose it together with the existing recordings, the new file first."
    )


def _values(names: Sequence[str], values: Iterable[float], units: Mapping[str, str]) -> str:
    pairs = zip(names, values, strict=True)
    return ", ".join(f"{n} = {number(float(v))} {pretty_unit(units.get(n, ''))}".strip() for n, v in pairs)


def _certainty(advice: Advice) -> str:
    best, rivals = advice.proposal.found, advice.known.rivals
    a, b = advice.proposal.closest
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
    """Sentences on what else the recording would show, and what a longer one would."""
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
    rows = zip(_seconds(advice), (advice.proposal, advice.longest), strict=True)
    return "\n".join(
        f"{s}: separated with {_percent(p.sure)}, another effect named with {_percent(p.shown)}"
        for s, p in rows
        if p is not None
    )


def _seconds(advice: Advice) -> tuple[str, str]:
    """Length of the proposed recording, and of the longest that was tried."""
    t, whole = advice.proposal.bench.t, (advice.longest or advice.proposal).found
    return f"{t[-1] - t[0]:.3g} s", f"{(t[1] - t[0]) * (len(whole.u) - 1):.3g} s"


def _percent(probability: float) -> str:
    return f"{100 * min(probability, 0.999):.3g} %"


def _besides(advice: Advice) -> str:
    """Clause on what tells those explanations apart that no input does."""
    if advice.remedy is None:
        return ": take whichever is simpler to correct"
    return f"; to separate these, {advice.remedy.sentence} (probability {_percent(advice.remedy.probability)})"


def _intervals(advice: Advice) -> str:
    best, (only,) = advice.proposal.found, advice.known.rivals
    ratios: Sequence[float] = (best.d / np.maximum(advice.proposal.bench.errors_now(only), 1e-300)).tolist()
    little = " That is little: another recording of this kind is hardly needed." if min(ratios) > 1.0 - MATTERS else ""
    widths = joined([f"{100 * r:.2g} %" for r in ratios])
    return f"It would narrow the intervals of these numbers to {widths} of their present width.{little}"


COLOURS = (style.BLUE, style.VERMILLION, style.GREEN, style.PURPLE, style.ORANGE)


def next_figure(advice: Advice, measured: Sequence[str], left: Floats | None, units: Mapping[str, str]) -> Any:
    """The input, what each explanation predicts, and what the closest wrong one would miss.

    Args:
        measured: names of the readings.
        left: (n, k) what that one would miss, fitted again, in units of the noise; None of one explanation alone.
    """
    best, rivals, t = advice.proposal.found, advice.known.rivals, advice.proposal.bench.t
    inputs = advice.proposal.bench.model.model.input_names[: len(advice.proposal.bench.middle)]
    rows = 2 if left is None else 3
    figure, grid = style.panels(rows, 1, 2.2 * rows + 0.8, sharex=True)
    axes = grid[:, 0]
    for name, u, colour in zip(inputs, best.u.T, itertools.cycle(COLOURS), strict=False):
        axes[0].step(t, u, where="post", lw=1.2, color=colour, label=name)
    axes[0].set_ylabel(axis_label(inputs[0], units) if len(inputs) == 1 else "inputs")
    axes[0].set_title(lengths_in_words(advice))
    if len(inputs) > 1:
        axes[0].legend(loc="upper right", ncols=4)
    for k, (rival, y) in enumerate(zip(rivals, best.readings, strict=True)):
        dash = "-" if k == 0 else (0, (4, 1 + k))
        axes[1].plot(t, y[:, 0], color=COLOURS[k % len(COLOURS)], ls=dash, lw=1.4, label=rival.label)
    axes[1].set(ylabel=axis_label(measured[0], units), title="what each explanation predicts")
    if left is not None:
        for name, missing, colour in zip(measured, left.T, itertools.cycle(COLOURS), strict=False):
            axes[2].plot(t, missing, lw=1.2, color=colour, label=name)
        axes[2].axhspan(-2, 2, color=style.FLOOR, alpha=0.35, lw=0, label="noise, ±2σ")
        right, wrong = (rivals[k].label for k in advice.proposal.closest)
        axes[2].set(ylabel="missed / σ", title=f"if {right} is right, what {wrong} misses, fitted again")
        axes[2].legend(loc="upper right", ncols=4)
    axes[-1].set_xlabel("time (s)")
    figure.align_ylabels()
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure


DIAGNOSIS, INPUT, JSON, PICTURE = "diagnosis.json", "input.csv", "next.json", "next.png"
LONGEST_S, MOST_SAMPLES = 20.0, 40_000
MOST_RIVALS = 4
ROOM = 0.1
"""Beyond what was recorded, a share of its range that the next recording may use where the case has no `domain`."""
SEED = 1


def run(
    case_path: Path, found: Path, out_dir: Path, seconds: float | None = None, start: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Propose the next recording and write `input.csv`, `next.json` and `next.png`.

    Args:
        case_path: the case that was diagnosed; found: the folder with `diagnosis.json`.
        seconds: how long the recording is; as short as is enough if not given, and no longer than the longest so far
            (20 s at most).
        start: states at its first sample; 0 (or what X has nearest to it) where not given.

    Returns:
        the content of `next.json`.

    Raises:
        UserError: a diagnosis that leaves nothing open or is of another case, recordings that are gone, wrong limits.
    """

    def tell(words: str) -> None:
        log.info("%s", words)
        if progress is not None:
            progress(words)

    context = Context.load(case_path)
    document = read_result(context, found / DIAGNOSIS, "diagnosis")
    with context.blame():
        question = _question(context, document, found, seconds, start or {})
        advice = ask(question, np.random.default_rng(SEED), tell)
    return _write(context, question, advice, out_dir)


def _question(
    context: Context, document: Mapping[str, Any], found: Path, seconds: float | None, start: Mapping[str, float]
) -> Question:
    section = context.case.measured or MeasuredSection()
    sets = _sets(document, found)
    paths = [context.folder / note["file"] for note in document["data"]]
    model = context.plant.corrected
    reading = load_reading(model, section, paths, context.folder, str(context.path), strict=False)
    record, names = under_conditions(reading, model, section.conditions)
    conditions = tuple(dict.fromkeys(tuple(t.u[0, len(model.inputs) :].tolist()) for t in record.traces))
    settings = settings_of(context.case, section, reading)
    told = {(f["fault"], f["channel"]) for f in document["recording"]}  # of columns that are others among them
    read = ready(conditioned(model, names), record, replace(settings, effects=library_names(sets)))
    record = max(read, key=lambda each: sum((f.fault, f.channel) in told for f in each.faults)).record
    allowed, middle, reach = _limits(context, record)
    return Question(
        conditioned(model, names), record, settings, dict(document["noise"]), sets,
        _stamps(context, record, settings, seconds), _start(context, model.state_names, allowed, start), allowed,
        middle, reach, conditions, seconds is None,
    )  # fmt: skip


def _sets(document: Mapping[str, Any], found: Path) -> tuple[Explained, ...]:
    """The answer and what could not be told from it."""
    if "joints" in document:
        problem = "an arm of three joints or more has no simulation to try inputs on"
        remedy = "Vary postures and speeds; docs/reference/effects.md says what each effect needs."
        raise UserError(problem, file=found / DIAGNOSIS, remedy=remedy)
    if not document["effects"]:
        raise UserError(
            f"the verdict is '{document['verdict']}', so there are no explanations to separate",
            file=found / DIAGNOSIS, remedy="Diagnose a recording with more motion first.",
        )  # fmt: skip
    answer = tuple(
        AppliedEffect(e["name"], e["on"], {s: p["value"] for s, p in e["parameters"].items()})
        for e in document["effects"]
    )
    others = [
        tuple(AppliedEffect(e["name"], e["on"], e["parameters"]) for e in a["effects"])
        for a in document["alternatives"]
        if not any(is_fault(e["name"]) for e in a["effects"])  # of the readings alone: no input tells more of it
    ]
    return (answer, *others[: MOST_RIVALS - 1])


def _limits(context: Context, record: Record) -> tuple[Box, Floats, Floats]:
    """States that the plant may come to, and middle and half of the range of its inputs."""
    case, own = context.case, len(context.inputs)
    if case.domain is not None:
        free = [n in case.domain.periodic for n in context.states]
        ends = np.array([case.domain.X[n] for n in context.states], dtype=np.float64)
        ends[free] = -np.inf, np.inf
        values = [case.domain.U[n].list() for n in context.inputs]
        span = np.array([[v.min(), v.max()] for v in values]).reshape(own, 2)
    else:
        y, u = (np.concatenate([getattr(t, k) for t in record.traces]) for k in ("y", "u"))
        ends = np.tile([-np.inf, np.inf], (len(context.states), 1))
        for k, name in enumerate(record.measured):
            room = ROOM * float(np.ptp(y[:, k]))
            ends[context.states.index(name)] = y[:, k].min() - room, y[:, k].max() + room
        span = np.stack([u[:, :own].min(axis=0), u[:, :own].max(axis=0)], axis=1)
    if not np.any(span[:, 1] > span[:, 0]):
        problem = "no input has a range, so that there is nothing to try"
        remedy = "Give the inputs a range (domain), or release the plant from other postures."
        raise UserError(problem, file=context.path, key="domain.U", remedy=remedy)
    return Box(ends[:, 0], ends[:, 1]), span.mean(axis=1), 0.5 * (span[:, 1] - span[:, 0])


def _stamps(context: Context, record: Record, settings: DiagnosisSettings, seconds: float | None) -> Floats:
    """Stamps (n,), s, of the longest recording that may be proposed, or of one of the given length."""
    domain = context.case.domain
    dt = domain.tau if domain is not None else record.interval
    length = seconds if seconds is not None else min(LONGEST_S, max(t.duration for t in record.traces))
    count = round(length / dt) + 1
    if count > MOST_SAMPLES:
        remedy = f"Give at most {MOST_SAMPLES * dt:.3g} s."
        raise UserError(f"a recording of {length:.3g} s at {1 / dt:.4g} Hz is too long", key="--seconds", remedy=remedy)
    t = np.asarray(dt * np.arange(count))
    windows_to_come(record, settings, t)  # or it says why the diagnosis could not use it
    return t


def _start(context: Context, names: tuple[str, ...], allowed: Box, given: Mapping[str, float]) -> Floats:
    if unknown := sorted(set(given) - set(names)):
        raise UserError(f"{unknown} are not states", key="--start", remedy=f"States: {list(names)}.")
    own = {n: float(np.clip(0.0, lo, hi)) for n, lo, hi in zip(context.states, allowed.lo, allowed.hi, strict=True)}
    return np.array([given.get(n, own.get(n, 0.0)) for n in names])


def _write(context: Context, question: Question, advice: Advice, out_dir: Path) -> dict[str, Any]:
    out_dir.mkdir(parents=True, exist_ok=True)
    text = paragraph(question, advice, context.units, str(out_dir / INPUT))
    best, rivals, names = advice.proposal.best, advice.known.rivals, context.inputs
    content: dict[str, Any] = {
        "paragraph": text,
        "rivals": [r.label for r in rivals],
        "tried": advice.proposal.tried,
        "outside": advice.proposal.left,
        "probability": advice.proposal.sure if len(rivals) > 1 else None,
        "seconds": float(advice.proposal.bench.t[-1]),
        "remedy": None if advice.remedy is None else asdict(advice.remedy),
        "input": None if best is None else INPUT,
        "conditions": dict(zip(question.model.conditions, advice.proposal.bench.held, strict=True)),
        "start": dict(zip(question.model.state_names, question.start.tolist(), strict=True)),
    }
    left = None
    if best is not None and len(rivals) > 1:
        whole = advice.longest or advice.proposal
        content["asked"], content["shown"] = CONFIDENCE if question.brief else None, advice.proposal.shown
        content["longest"] = {"seconds": float(question.t[-1]), "probability": whole.sure, "shown": whole.shown}
        content["expected_chi2"] = best.d.tolist()
        content["alike"] = [[rivals[a].label, rivals[b].label] for a, b in advice.proposal.alike()]
        left = missed(best, *advice.proposal.closest)
        content["chi2_alone"] = float(np.sum(left**2))
    elif best is not None:
        content["standard_errors"] = best.d.tolist()
    if best is not None:
        rows = np.column_stack([advice.proposal.bench.t, best.u[:, : len(names)]]).tolist()
        lines = [",".join(["t", *names]), *(",".join(f"{v:.9g}" for v in row) for row in rows)]
        write_text(out_dir / INPUT, "\n".join(lines) + "\n")
    content["provenance"] = context.record("next", {"inputs": SEED})
    write_json(out_dir / JSON, content)
    if best is not None:
        with style.figure_style():
            style.drawn(out_dir / PICTURE, next_figure, advice, question.record.measured, left, context.units)
    return content
