"""What the page of a case is made from, in memory, and its tables, as plain rows for the template."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simgap.gap.bounds.function import GapFunction
from simgap.io.traces import BASELINE, EVERY_TITLE, GAP_AWARE, MODEL, NOMINAL, SIMULATOR, TITLES, Trace
from simgap.notation import number, pretty_unit
from simgap.plants.context import Context
from simgap.synthesis.controller import Controller

Rows = list[dict[str, Any]]
SEES_GAMMA = 0.5
"""Share of transitions that noise alone leaves inside gamma: below it the recorded share tells nothing (judgement)."""
ATTACKS = ("evaluations", "steps", "steps_against_the_disturbance")
BOUND_FIGURES = (
    ("size", "sup of gamma's size"),
    ("width", "sup of its width"),
    ("sampled", "largest sampled gap"),
)


@dataclass(frozen=True, eq=False)
class Corrected:
    """The same case with the nominal model that the diagnosis corrected.

    `inside` is the share of measured transitions inside f +- gamma, "before" and "after"; None where it is not known.
    """

    summary: Mapping[str, Any]
    controllers: Mapping[str, Controller]
    inside: Mapping[str, Mapping[str, float] | None]


@dataclass(frozen=True, eq=False)
class Material:
    """Results that were read.

    Attributes:
        sweep: the content of every gap.json, largest eps first; gap: of the case's own eps; bound: the function in it.
        syntheses, controllers: by kind, "nominal" and "gap". twin: how far the simulator is from what it stands for.
        audit: what the adversary did; margins: table of the one-step margins of every cell; None without an audit.
    """

    context: Context
    sweep: Sequence[Mapping[str, Any]]
    gap: Mapping[str, Any]
    bound: GapFunction
    samples: Any
    syntheses: Mapping[str, Mapping[str, Any]]
    controllers: Mapping[str, Controller]
    validation: Mapping[str, Any]
    traces: Sequence[Trace]
    diagnosis: Mapping[str, Any] | None
    corrected: Corrected | None
    printed: Mapping[str, Any]
    audit: Mapping[str, Any] | None = None
    margins: Any = None
    twin: Mapping[str, Any] | None = None

    def tally(self, controller: str, plant: str = SIMULATOR) -> Mapping[str, Any]:
        """What the runs of a controller on a plant came to; empty where there were none."""
        own: Mapping[str, Any] = self.validation["controllers"].get(controller, {}).get(plant, {})
        return own


def is_signed(gap: Mapping[str, Any]) -> bool:
    """True if lower and upper bound were fitted apart."""
    if gap.get("kind") == "cells":  # a table has no program
        return any(np.any(np.add(own["lower"], own["upper"]) != 0.0) for own in gap["gap"].values())
    programs = [d["scenario"] for d in gap.get("dimensions", ()) if "scenario" in d]
    return all("lower" in p and "upper" in p for p in programs)


def coefficients(gap: Mapping[str, Any]) -> Rows:
    """For bounds linear in a basis: each state with its terms and both coefficients."""
    if gap.get("kind") != "linear":
        return []
    out = []
    for state, sides in gap["gap"].items():
        terms = list(sides["upper"]["coefficients"])
        rows = [{"term": t, **{s: sides[s]["coefficients"].get(t) for s in ("lower", "upper")}} for t in terms]
        rows.append({"term": "raised by", "lower": sides["lower"]["offset"], "upper": sides["upper"]["offset"]})
        out.append({"state": state, "rows": rows})
    return out


def sweep(m: Material) -> Rows:
    """The table of suprema against eps, with the values that the paper prints."""
    rows = []
    for gap in m.sweep:
        printed = m.printed.get("sup_gamma", {}).get(f"{gap.get('eps') or 0:g}", {})
        states = {s: row | {"printed": printed.get(s)} for s, row in suprema(m, gap).items()}
        rows.append({key: gap.get(key) for key in ("eps", "samples", "fresh")} | {"states": states})
    return rows


def suprema(m: Material, gap: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Suprema of a bound by state: of its size and of its width, with the largest sampled gap where it is known."""
    reports = {d["state"]: d for d in gap.get("dimensions", ())}
    if reports:
        keys = (("size", "sup_size"), ("width", "sup_width"), ("sampled", "largest_sampled_gap"))
        return {s: {short: d.get(key) for short, key in keys} for s, d in reports.items()}
    return {s: {"size": v.size, "width": v.width, "sampled": None} for s, v in m.bound.sup().items()}


def lipschitz(m: Material) -> Rows:
    """Estimates of each state side by side: method, value, goodness of fit, remark."""
    printed = m.printed.get("lipschitz", {})
    out = []
    for d in m.gap.get("dimensions", ()):
        rows = [dict(e) for e in d.get("lipschitz_estimates", ())]
        if rows and d["state"] in printed:
            rows.append({"method": "printed in the paper", "value": printed[d["state"]], "ks_p": None, "note": ""})
        if rows:
            out.append({"state": d["state"], "rows": rows})
    return out


def scenario(gap: Mapping[str, Any]) -> Rows:
    """One row a scenario program."""
    return [
        {"state": d["state"], "side": side, **program}
        for d in gap.get("dimensions", ())
        for side, program in d.get("scenario", {}).items()
    ]


def loops(m: Material) -> Rows:
    """One row for each controller on each plant."""
    return [
        {"controller": EVERY_TITLE[kind], "plant": plant, **tally}
        for kind in (GAP_AWARE, BASELINE, NOMINAL)
        for plant in (SIMULATOR, MODEL)
        if (tally := m.tally(kind, plant))
    ]


def promised_steps(m: Material) -> int | None:
    """Steps within which the gap-aware controller arrives from any winning cell; None where it has nowhere to go."""
    value = m.controllers[GAP_AWARE].solution.value
    return int(value.max()) if value is not None and value.size and value.max() > 0 else None


def unsettled(gap: Mapping[str, Any]) -> bool:
    """True if older inputs seem to act as strongly as newer ones, by no more than headings do that change nothing."""
    ages = [list(map(float, row)) for row in gap.get("memory", ()) if any(row)]
    headings = gap.get("heading_deviation")
    if len(ages) < 2 or not headings:
        return False
    rises = any(b > a for older, newer in zip(ages[1:], ages, strict=False) for b, a in zip(older, newer, strict=True))
    return rises and all(x <= 1.1 * h for row in ages for x, h in zip(row, headings, strict=True))


def hidden_state(m: Material) -> list[tuple[str, str]]:
    """Rows (name, text) on what a bound over hidden state was taken over and what was found; empty for other bounds."""
    if "budget" not in m.gap:
        return []
    rows = [(k.replace("_", " "), f"{v:,}") for k, v in m.gap["budget"].items() if isinstance(v, int)]
    for age, influence in enumerate(m.gap.get("memory", ())):
        if any(influence):  # histories end somewhere: 0 there is not a finding
            rows.append((f"effect of inputs more than {age + 1} samples back", _by_state(m, influence)))
    if "heading_deviation" in m.gap:
        rows.append(("largest deviation between headings", _by_state(m, m.gap["heading_deviation"])))
    for key, name in (("beyond_previous_inputs", "found beyond the previous input"), ("margin", "added for that")):
        if all(key in d for d in m.gap["dimensions"]):
            rows.append((name, _by_state(m, [d[key] for d in m.gap["dimensions"]])))
    tried = (m.gap.get("directed_search") or {}).get("tried_to_break")
    if tried:
        rows.append(("directed search against the bound", f"{tried['outside']} of {tried['evaluations']:,} outside"))
    return rows


def _by_state(m: Material, values: Iterable[float]) -> str:
    named = zip(m.context.states, values, strict=False)
    return ", ".join(f"{n} {number(v, 3)} {pretty_unit(m.context.units[n])}" for n, v in named)


def diagnosis(m: Material) -> dict[str, Any] | None:
    """Answer of the measured data about the model, for a short section with a link."""
    d = m.diagnosis
    if d is None:
        return None
    before, after = d["error"]["before"]["horizon_rmse"], d["error"]["after"]["horizon_rmse"]
    floor = d["error"]["noise_floor"]["horizon_rmse"]
    rows = [{"state": s, "before": before[s], "after": after[s], "floor": floor[s]} for s in before]
    horizon = d["error"]["before"]["horizon_s"]
    return {"verdict": d["verdict"], "sentence": d.get("sentence", ""), "rows": rows, "horizon": horizon}


def corrected(m: Material) -> Rows:
    """Changes by the corrected model: a row a figure, before and after."""
    rows = _changes(m, m.corrected.summary) if m.corrected is not None else ()
    return [dict(zip(("what", "before", "after", "unit"), row, strict=True)) for row in rows]


def _changes(m: Material, later: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any, str]]:
    """What it is, before, after (of the summary of the corrected case), and the unit."""
    own, bounds, units = suprema(m, m.gap), later["sup_gamma"][-1]["states"], m.context.units
    for key, name in BOUND_FIGURES:
        for state in own:
            yield f"{name}, {state}", own[state][key], bounds[state][key], units[state]
    yield from _measured(m)
    for kind, name in TITLES.items():
        before, after = m.syntheses[kind]["winning_fraction"], later["winning_fraction"][kind]
        yield f"winning fraction, {name}", 100 * before, 100 * after, "%"
    for kind, name in TITLES.items():
        before, after = m.tally(kind), later["closed_loop"][kind][SIMULATOR]
        yield f"runs that violate, {name}", before["runs_that_violated_it"], after["runs_that_violated_it"], ""


def _measured(m: Material) -> Iterator[tuple[str, Any, Any, str]]:
    """The same of one-step errors, and of the share inside f +- gamma, on held-out transitions."""
    step = ((m.diagnosis or {}).get("remainder") or {}).get("one_step") or {"before": {}}
    for state, before in step["before"].items():
        floor = step["noise_floor"][state]
        hidden = "already no more than the noise of" if before <= floor else "noise floor"
        what = f"one-step error on held-out data, {state} ({hidden} {floor:.3g})"
        yield what, before, step["after"][state], m.context.units[state]
    first, second = _inside(m)
    if first and second and max(first["noise_alone"], second["noise_alone"]) >= SEES_GAMMA:
        count = f"{first['transitions']:,.0f} held-out transitions in X"
        yield f"share of {count} inside f ± gamma", first["share"], second["share"], ""
        yield "the same if noise were all there is", first["noise_alone"], second["noise_alone"], ""


def _inside(m: Material) -> tuple[Any, Any]:
    inside = m.corrected.inside if m.corrected is not None else {}
    return inside.get("before"), inside.get("after")


def too_noisy(m: Material) -> str:
    """Why the recordings are not compared with gamma, where their noise alone leaves it; "" where they are."""
    first, second = _inside(m)
    if not first or not second or max(first["noise_alone"], second["noise_alone"]) >= SEES_GAMMA:
        return ""
    return (
        f"The {first['transitions']:,.0f} held-out transitions that lie in X cannot be compared with f ± gamma one "
        "by one: the noise of their readings is wider than gamma."
    )


def overview(summary: Mapping[str, Any]) -> dict[str, Any]:
    """One row of the index from a `summary.json`: how large the gap is, what is won, what became of the runs.

    Raises:
        KeyError: a summary of another version.
    """
    loops = {kind: plants[SIMULATOR] for kind, plants in summary["closed_loop"].items()}
    own = next((r for r in summary["sup_gamma"] if r["eps"] == summary["eps"]), summary["sup_gamma"][-1])
    units = summary.get("units", {})
    audit = summary.get("audit")
    return {
        "gap": [(s, v["size"], pretty_unit(units.get(s, ""))) for s, v in own["states"].items()],
        "winning": summary["winning_fraction"],
        "runs": [
            (EVERY_TITLE[kind], loops[kind]["runs_that_kept_the_specification"], loops[kind]["runs"])
            for kind in (GAP_AWARE, BASELINE, NOMINAL)
            if kind in loops
        ],
        "outside": loops[GAP_AWARE]["steps_outside_gamma"],
        "steps": loops[GAP_AWARE]["steps"],
        "attacked": audit["violations"] if audit is not None else None,
        "evaluations": sum(audit[k] for k in ATTACKS) if audit is not None else None,
    }


def sources(m: Material) -> Rows:
    """The provenance of every result that went into the page."""
    named = [(f"gap, eps = {g['eps']:g}" if g.get("eps") else "gap", g) for g in m.sweep]
    named += [("synthesis, gap-aware", m.syntheses[GAP_AWARE]), ("synthesis, nominal", m.syntheses[NOMINAL])]
    named.append(("validation", m.validation))
    return [{"what": what, **document["provenance"]} for what, document in named if "provenance" in document]


def adversary_figures(m: Material) -> dict[str, Any] | None:
    """For `summary.json`: evaluations, steps, violations and witnesses; the steps against the disturbance apart."""
    if m.audit is None:
        return None
    return {
        **{key: m.audit[key] for key in ("evaluations", "steps", "violations", "witnesses")},
        "steps_against_the_disturbance": m.audit["closed_loop"]["disturbance"]["steps"],
        "largest_share": m.audit["gap"]["largest_share"],
    }


def attempts(audit: Mapping[str, Any]) -> int:
    """Steps of every kind in which the adversary looked for a violation."""
    return int(audit["evaluations"] + sum(loop["steps"] for loop in audit["closed_loop"].values()))


def adversary_sentence(m: Material) -> str:
    """One line for the verdict."""
    if m.audit is None:
        return ""
    loops = m.audit["closed_loop"]
    steps = sum(loop["steps"] for loop in loops.values())
    return (
        f"Adversary: {m.audit['violations']:,} violations in {m.audit['evaluations']:,} single steps that attack the "
        f"bound and {steps:,} closed-loop steps under the worst admissible inputs."
    )


def adversary(m: Material) -> dict[str, Any] | None:
    """Rows of random samples and of the adversary, where the worst step lies, and counts by search and rule."""
    if m.audit is None:
        return None
    loops, gap = m.audit["closed_loop"], m.audit["gap"]
    fresh, random = m.gap.get("fresh", {}), m.tally(GAP_AWARE)
    rows = [
        ("gamma, single steps", "random", None, fresh.get("samples", 0), fresh.get("violations", 0)),
        ("gamma, single steps", "adversary", None, m.audit["evaluations"], gap["violations"]),
        ("closed loop in the simulator", "random starts, the controller's own choice", random["runs"],
         random["steps"], random["runs_that_violated_it"]),
    ]  # fmt: skip
    named = (("simulator", "closed loop in the simulator"), ("disturbance", "closed loop against the worst of gamma"))
    rows += [(what, "adversary", *(loops[k][n] for n in ("runs", "steps", "violations"))) for k, what in named]
    by = [(f"gamma: {name}", count) for name, count in gap["evaluations_by_search"].items()]
    for k, what in named:
        by += [(f"{what}: {name}", count) for name, count in loops[k]["steps_by_rule"].items()]
    columns = ("what", "how", "runs", "steps", "violations")
    return {"rows": [dict(zip(columns, row, strict=True)) for row in rows], "by": by, "place": _worst_place(m)}


def _worst_place(m: Material) -> str:
    gap = (m.audit or {})["gap"]
    if gap["largest_share"] is None:
        return ""
    units = m.context.units
    where = ", ".join(f"{n} = {x:.4g} {pretty_unit(units[n])}".strip() for n, x in gap["worst"].items())
    side = "inside" if gap["largest_share"] <= 0 else "outside"
    at = f" (at {where})" if m.context.case.hidden_state is None else ""
    return f"The worst step found{at} lies {side} the bound by {100 * abs(gap['largest_share']):.2g} % of its width."
