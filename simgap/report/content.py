"""Content of a case's page as plain data for the template: a plain sentence and key figures first, then the details."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from simgap.closed_loop import BEYOND
from simgap.config.controller import Trials
from simgap.gap.bounds.function import PROVEN
from simgap.gap.fitting.acceptance import Outside, clopper_pearson_upper
from simgap.gap.noise import statement_of
from simgap.io.traces import BASELINE, EVERY_TITLE, GAP_AWARE, MODEL, NOMINAL, shown
from simgap.notation import number, pretty_unit
from simgap.report import tables
from simgap.report.tables import Material
from simgap.specifications.base import STUCK, specification_of
from simgap.specifications.space import Space

INTEGRATORS = {
    "explicit_euler": "explicit Euler step",
    "semi_implicit_euler": "semi-implicit Euler step",
    "rk4": "Runge-Kutta step of order 4",
    "exact_arc": "exact arc of a unicycle",
}
ENGINES = {
    "pybullet": "PyBullet",
    "pybullet_wheeled": "PyBullet with wheels",
    "mujoco": "MuJoCo",
    "mujoco_wheeled": "MuJoCo with wheels",
    "drake": "Drake",
    "fmu": "FMU",
}
INERTIAS = {"engine": "inertia computed by the engine, not the file's", "file": "inertia of the file"}

SAID = ("recordings", "plain", "noise", "little", "gap_aware", "nominal", "baseline", "arrival", "winning")
"""Sentences of the headline, in order."""


def content(m: Material) -> dict[str, Any]:
    """Everything that the template prints."""
    case, audit = m.context.case, m.audit or {}
    specification = specification_of(case)
    return {
        "m": m,
        "tables": tables,
        "case": case,
        "title": case.title or case.name,
        "units": m.context.units,
        "verdict": verdict(m),
        "specification": specification,
        "specification_sentence": specification.sentence(Space.of(case)),
        "settings": settings(m),
        "gap": m.gap,
        "sweep": tables.sweep(m),
        "syntheses": m.syntheses,
        "common_free": common_free(m.syntheses),
        "between": between_samples(m),
        "unproven": unproven(m.gap),
        "adversary": tables.adversary(m),
        "margins": audit.get("margins"),
        "no_margins": audit.get("no_margins", ""),
        "diagnosis": tables.diagnosis(m),
    }


def unproven(gap: Mapping[str, Any]) -> str:
    """Why the rate within a step is an assumption, as a clause: a bound of whole steps says nothing of it."""
    if any(tier["text"] == PROVEN.text for tier in gap["guarantee"]):
        return "is not part of the proof: what is proven is the bound of whole steps"
    return "samples alone cannot prove"


def between_samples(m: Material) -> dict[str, float]:
    """Distances by which states may stray between samples with the gap-aware controller; empty if nothing says so."""
    said = m.syntheses[GAP_AWARE].get("between_samples") or {}
    return {state: bound for state, bound in said.items() if bound}


def settings(m: Material) -> list[tuple[str, str]]:
    """Model, simulator and grid as names with text."""
    case, domain = m.context.case, m.context.domain
    plant = case.plant
    source = f"{plant.urdf.rsplit('/', 1)[-1]} (URDF)" if plant.urdf else "equations in the case file"
    names = m.context.units
    boxes = [f"{n} in [{lo:g}, {hi:g}] {pretty_unit(names[n])}" for n, (lo, hi) in domain.X.items()]
    grid = m.context.input_set
    inputs = [
        f"{n} in [{grid[:, j].min():g}, {grid[:, j].max():g}] {pretty_unit(names[n])}"
        for j, n in enumerate(m.context.inputs)
    ]
    rows = [
        ("nominal model", f"{source}, {INTEGRATORS[plant.integrator]}, sampling time {domain.tau:g} s"),
        ("states X", "; ".join(boxes)),
        ("inputs U", f"{'; '.join(inputs)} ({len(grid)} values)"),
    ]
    rows += [("effect in the model", _effect(e)) for e in plant.effects]
    if case.simulator is not None:
        given = case.simulator.model_dump(mode="json")
        given.pop("effects", None)
        engine, urdf = str(given.pop("engine")), given.pop("urdf", None)
        inertia = INERTIAS.get(str(given.pop("inertia", "")), "")
        rows.append(
            ("simulator", "; ".join(filter(None, [ENGINES.get(engine, engine), urdf, inertia, *_plain(given)])))
        )
        rows += [("effect in the simulator", _effect(e)) for e in getattr(case.simulator, "effects", ())]
    if m.twin is not None:
        rows.append(("twin of", twin_sentence(m.twin)))
    rows.append(("specification", specification_of(m.context.case).sentence(Space.of(m.context.case))))
    sensing = case.sensing
    if sensing is not None:
        rows.append(("sensing", "; ".join(_plain(sensing.model_dump(mode="json")))))
    return rows


def twin_sentence(twin: Mapping[str, Any]) -> str:
    """Sentence on how far the simulator is from the engine that it stands for."""
    parts = [f"{name} {row['difference']:.2g} {pretty_unit(row['unit'])}" for name, row in twin["largest"].items()]
    total = sum(twin["samples"].values())
    return f"{twin['engine']}: largest difference after one step, over all {total:,} samples: {', '.join(parts)}"


def _plain(given: Mapping[str, Any], prefix: str = "") -> list[str]:
    out = []
    for key, value in given.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            out += _plain(value, f"{name} ")
        elif value is not None:
            out.append(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}")
    return out


def _effect(effect: Any) -> str:
    numbers = ", ".join(f"{k} = {v:g}" for k, v in effect.parameters.items())
    return f"{effect.name.replace('_', ' ')} on {effect.on}: {numbers}"


def summary(m: Material, page: Mapping[str, Any]) -> dict[str, Any]:
    """The figures that a script wants."""
    return {
        "case": m.context.case.name,
        "title": page["title"],
        "promise_kept": page["verdict"]["good"],
        "verdict": [page["verdict"][k] for k in SAID if page["verdict"][k]],
        "eps": m.gap.get("eps"),
        "units": {state: m.context.units[state] for state in m.context.states},
        "sup_gamma": [{"eps": r["eps"], "states": r["states"]} for r in page["sweep"]],
        "fresh": {
            k: v for k, v in m.gap.get("fresh", {}).items() if k in ("samples", "violations", "upper", "confidence")
        },
        "winning_fraction": {kind: s["winning_fraction"] for kind, s in m.syntheses.items()},
        "winning_cells": {kind: s["winning_cells"] for kind, s in m.syntheses.items()},
        "closed_loop": m.validation["controllers"],
        "between_samples": page["between"],
        "audit": tables.adversary_figures(m),
        "margins": page["margins"],
        "guarantee": m.gap["guarantee"],
        "diagnosis": page["diagnosis"]["verdict"] if page["diagnosis"] else None,
        **({"twin": {k: m.twin[k] for k in ("engine", "samples", "largest")}} if m.twin is not None else {}),
    }


LITTLE = 2
"""Steps to the target, at the most, of a controller that is said to win next to nothing (judgement)."""


def verdict(m: Material) -> dict[str, Any]:
    """Verdict on the promise, in plain words and figures, and a technical sentence on each part of the evidence."""
    gap_aware = m.tally(GAP_AWARE)
    kept, runs = gap_aware["runs_that_kept_the_specification"], gap_aware["runs"]
    attacked = m.audit["violations"] if m.audit is not None else 0
    noise, outside, beyond = statement_of(m.context.case), gap_aware["steps_outside_gamma"], 0
    if noise is not None:
        beyond = gap_aware["ends"].get(BEYOND, 0)
        outside = outside if noise.is_contradicted(gap_aware["steps"], outside) else 0
    good = kept + beyond == runs and outside == 0 and not attacked
    words = specification_of(m.context.case).words
    little = little_won(tables.promised_steps(m))
    recordings = contradicted(m)
    only = " in the simulator, not shown for the plant" if recordings else ", but small" if little else ""
    return {
        "good": good,
        "badge": f"promise kept{only}" if good else "promise broken",
        "recordings": recordings,
        "plain": plain(m),
        "noise": m.validation.get("noise", ""),
        "tiles": tiles(m),
        "little": little,
        "gap_aware": f"Gap-aware controller: {kept:,} of {runs:,} runs {words.kept}, "
        f"{gap_aware['steps_outside_gamma']:,} of {gap_aware['steps']:,} steps outside gamma.",
        "sample": _sample(m),
        "nominal": f"Nominal-only controller: {_violations(m)}.",
        "failure": failure(m),
        "on_model": on_model(m),
        "baseline": _baseline(m),
        "arrival": _arrival(m),
        "winning": f"The gap-aware controller wins {_won(m, GAP_AWARE)} of the {words.allowed} for every gap within "
        f"its bound; the nominal-only controller wins {_won(m, NOMINAL)}, for the model alone.{_own_share(m)}",
        "adversary": tables.adversary_sentence(m),
        "tolerated": m.gap.get("fresh", {}).get("violations", 0),
        "outside": str(Outside(**worst)) if (worst := m.gap.get("fresh", {}).get("outside")) else "",
    }


def contradicted(m: Material) -> str:
    """Sentences where recordings of the plant show what both model and simulator lack: no promise covers that."""
    found, section = m.diagnosis, m.context.case.measured
    if found is None or section is None or section.rig == "simulator" or found["verdict"] == "none":
        return ""
    lacking = (found.get("simulator") or {}).get("effects")
    if found["verdict"] == "unexplained":
        return (
            "Recordings of the plant contradict the model, and no effect of the library explains the difference: what "
            "is promised here is promised for the simulator alone."
        )
    words = (
        "Recordings of the plant contradict the model, and the simulator lacks the same effects: what is promised here "
        "is promised for the simulator alone. The corrected case has a bound and a controller with these effects."
    )
    return words if lacking else ""


def plain(m: Material) -> str:
    """Summary for a reader who does not know the terms: both controllers, and the adversary."""
    gap_aware, failed = m.tally(GAP_AWARE), specification_of(m.context.case).words.failed
    bad, runs = gap_aware["runs_that_violated_it"], gap_aware["runs"]
    checked = "" if specification_of(m.context.case).between_samples else f", checked every {m.context.domain.tau:g} s"
    said = f"In {runs:,} simulated runs{_length(m)}{checked}, the controller that knows the gap "
    said += f"never {failed}. " if not bad else f"failed {bad:,} times. "
    if outside := gap_aware["steps_outside_gamma"]:
        said += f"But {outside:,} of {gap_aware['steps']:,} steps lay outside the bound of the gap. "
    said += f"The controller that trusts the model {_trusting(m, failed)}."
    if m.audit is None:
        return said
    found, tried = m.audit["violations"], tables.attempts(m.audit)
    return f"{said} An adversary found {found or 'no'} violation{'s' * (found > 1)} in {tried:,} attempts."


def _length(m: Material) -> str:
    """How long a run is, as words behind it: a promise may be for ever, no run is."""
    tally, steps = m.tally(GAP_AWARE), m.validation["steps"]
    whole = tally["steps"] == tally["runs"] * steps
    return f" of {'' if whole else 'at most '}{number(steps * m.context.domain.tau, 3)} s"


def _trusting(m: Material, failed: str) -> str:
    """Clause on how the nominal-only controller ended, after the words that name it."""
    tally = m.tally(NOMINAL)
    bad, runs = tally["runs_that_violated_it"], tally["runs"]
    if not runs:
        return "promises nothing at any of these starts"
    if not bad:
        return f"did not fail in {runs:,} runs either, but nothing guarantees that"
    return f"{_ended(tally, failed)} in {bad:,} of {runs:,} runs{_soon(m)}"


def _soon(m: Material) -> str:
    """Clause on when half of the failures had occurred; one that is counted when the time is up has no instant."""
    tally = m.tally(NOMINAL)
    median = tally.get("median_steps_until_violation")
    if not median or tally["runs_that_violated_it"] < 2:
        return ""
    if median >= m.validation["steps"]:
        return ", most of them counted at the end of the run"
    return f", half of the failures within {number(median * m.context.domain.tau, 2)} s"


def _ended(tally: Mapping[str, Any], failed: str) -> str:
    """What the runs of a controller did that broke the promise; one without an input is stopped before it leaves."""
    return "failed" if tally["ends"].get(STUCK) else failed


def tiles(m: Material) -> list[tuple[str, str]]:
    """Key figures: a value, and what it is."""
    words = specification_of(m.context.case).words
    found = [
        (f"{t['runs_that_violated_it']:,} of {t['runs']:,}", f"runs {_ended(t, words.failed)}, {EVERY_TITLE[kind]}")
        for kind in (GAP_AWARE, BASELINE, NOMINAL)
        if (t := m.tally(kind))
    ]
    if m.audit is not None:
        found.append(
            (f"{m.audit['violations']:,}", f"violations in {tables.attempts(m.audit):,} attempts of an adversary")
        )
    share = m.syntheses[GAP_AWARE]["winning_cells"] / max(1, common_free(m.syntheses))
    return [*found, (f"{100.0 * share:.1f} %", f"of the {words.allowed}: states where the promise holds")]


def little_won(promised: int | None) -> str:
    """Sentences where the promise ends a step or two from the target; `promised` steps are the longest way."""
    if promised is None or promised > LITTLE:
        return ""
    samples = "one sample" if promised == 1 else f"{promised} samples"
    return (
        f"It wins almost nothing: every winning state lies within {samples} of the target. Stronger inputs "
        "(domain.U), another domain.tau, finer synthesis.cells or a smaller gap carry it further."
    )


def common_free(syntheses: Mapping[str, Mapping[str, Any]]) -> int:
    """The cells that shares of all controllers are of: the largest set in which one of them may be.

    The path between samples takes cells from controllers that check it, so that a share of their own rest is more.
    """
    return max(int(s["free_cells"]) for s in syntheses.values())


def _won(m: Material, kind: str) -> str:
    """The share of the common cells that is won, and how many cells it is."""
    cells = int(m.syntheses[kind]["winning_cells"])
    return f"{100 * cells / max(1, common_free(m.syntheses)):.1f} % ({cells:,} cells)"


def _own_share(m: Material) -> str:
    """Sentence on the share won of the cells that stay free between samples, where these are fewer."""
    found, every = m.syntheses[GAP_AWARE], common_free(m.syntheses)
    if found["free_cells"] == every:
        return ""
    return (
        f" Both are shares of {every:,} cells; {found['free_cells']:,} of them stay free between samples, of which "
        f"it wins {100 * found['winning_fraction']:.1f} %."
    )


def failure(m: Material) -> str:
    """Why the nominal-only controller fails: the step that takes the run drawn out of its domain, which its gap did.

    Nothing where the run fails otherwise: the step has to end outside the domain, and inside without its gap.
    """
    run, controller, units = shown(m.traces, NOMINAL), m.controllers[NOMINAL], m.context.units
    if len(run.x) < 2 or not m.tally(NOMINAL)["runs_that_violated_it"]:
        return ""
    end, gap = run.x[-1], run.d[-2]
    if not controller.contains((end - gap)[None])[0] or controller.contains(end[None])[0]:
        return ""
    named = [(name, pretty_unit(units[name])) for name in m.context.states]
    where = ", ".join(f"{n} = {number(x)} {unit}".rstrip() for (n, unit), x in zip(named, end, strict=True))
    by = ", ".join(f"{number(d, 3)} {unit} in {n}".replace("  ", " ") for (n, unit), d in zip(named, gap, strict=True))
    return (
        f" In the run drawn, the last step ends at {where}, outside its winning domain. The gap of that step ({by}) is "
        "the cause: the model alone would have stayed inside."
    )


def on_model(m: Material) -> str:
    """Why the gap-aware controller fails on the nominal model, where it does: that is not what it was made for."""
    tally = m.tally(GAP_AWARE, MODEL)
    if not tally or not tally["runs_that_violated_it"]:
        return ""
    bad, runs = tally["runs_that_violated_it"], tally["runs"]
    if not tables.is_signed(m.gap):
        return f"On the nominal model itself, {bad:,} of {runs:,} runs of the gap-aware controller fail."
    own = getattr(m.context.case.simulator, "inertia", None) == "engine"
    other = ", whose inertia the engine computes," * own
    return (
        f"The gap-aware controller is made for the simulator{other} and promises nothing about the nominal model. "
        f"There, {bad:,} of {runs:,} runs fail, as they may: gamma excludes a gap of zero in places."
    )


def _violations(m: Material) -> str:
    tally = m.tally(NOMINAL)
    bad, runs = tally["runs_that_violated_it"], tally["runs"]
    if not bad:
        return f"none of {runs:,} runs violates the specification in the simulator, but nothing guarantees that"
    text = f"{bad:,} of {runs:,} runs violate the specification in the simulator"
    if stuck := min(bad, tally["ends"].get(STUCK, 0)):  # nobody knows what the plant would do next
        own = "all" if stuck == bad else f"{stuck:,}"
        text = (
            f"{bad:,} of {runs:,} runs fail in the simulator; {own} of them reach a state without an admissible input"
        )
    return f"{text}{_soon(m)}"


def _sample(m: Material) -> str:
    """Sentence on what the number of runs alone says, whatever bound and controller rest on, and what more would."""
    tally, section = m.tally(GAP_AWARE), m.context.case.validation
    given = len(section.first) if section is not None else 0
    bad, drawn = tally["runs_that_violated_it"], tally["runs"] - given
    if drawn < 1:
        return ""
    share = f"Of starts drawn like these at most {_at_most(drawn, min(bad, drawn))} fail, with 95 % confidence"
    full = section.count(Trials.FULL) - given if section is not None else 0
    return share + (
        f"; {full:,} starts, of a full run, would make it {_at_most(full, 0)}." if full > drawn and not bad else "."
    )


def _at_most(n: int, bad: int) -> str:
    """The upper bound of a share, rounded up to a tenth of a per cent."""
    return f"{math.ceil(1000.0 * clopper_pearson_upper(n, bad)) / 10.0:g} %"


def _arrival(m: Material) -> str:
    """When the target is reached at the latest, promised and seen."""
    tally, tau = m.tally(GAP_AWARE), m.context.domain.tau
    promised, steps, rounds = tables.promised_steps(m), tally.get("steps_to_target"), tally.get("rounds")
    if promised is None or not (steps or rounds):
        return ""
    seen = f"its longest run here took {max(steps) * tau:g} s" if steps else ""
    if rounds:
        least, most = min(rounds), max(rounds)
        each = f"{least:,} times each" if least == most else f"{least:,} to {most:,} times"
        seen = f"its runs here got on with it {each}"
    return (
        f"The gap-aware controller promises {specification_of(m.context.case).words.goal} within {promised * tau:g} s "
        f"from every winning state, whatever the gap does within gamma; {seen}."
    )


def _baseline(m: Material) -> str:
    """Sentence on what the fair baseline did; empty where none ran."""
    tally = m.tally(BASELINE)
    if not tally:
        return ""
    words = specification_of(m.context.case).words
    kept, runs = tally["runs_that_kept_the_specification"], tally["runs"]
    left, steps = tally.get("steps_that_left_the_certified_box"), tally["steps"]
    outside = f", {left:,} of {steps:,} steps outside the certified box" if left is not None else ""
    return (
        "Fair baseline (nominal-only, but it checks the model's path between samples): "
        f"{kept:,} of {runs:,} runs {words.kept}{outside}."
    )
