"""What the page of a case says: the verdict, tables and the guarantee, as plain data for the template."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from simgap.config.synthesis import InvarianceSpecification
from simgap.diagnosis.words import pretty_unit
from simgap.io.traces import MODEL, NOMINAL, ROBUST, SIMULATOR

if TYPE_CHECKING:
    from simgap.stages.report import Material

Rows = list[dict[str, Any]]


def content(m: Material) -> dict[str, Any]:
    """Everything that the template prints."""
    return {
        "case": m.context.case,
        "title": m.context.case.title or m.context.case.name,
        "units": m.context.units,
        "verdict": verdict(m),
        "invariance": _is_invariance(m),
        "settings": settings(m),
        "gap": m.gap,
        "coefficients": coefficients(m.gap),
        "sweep": sweep(m),
        "printed": m.printed,
        "signed": is_signed(m.gap),
        "lipschitz": lipschitz(m),
        "scenario": scenario(m.gap),
        "syntheses": m.syntheses,
        "loops": loops(m),
        "between": m.validation.get("between_samples"),
        "validation": m.validation,
        "diagnosis": diagnosis(m),
        "corrected": corrected(m),
        "sources": sources(m),
    }


def _is_invariance(m: Material) -> bool:
    section = m.context.need(m.context.case.synthesis, "synthesis")
    return isinstance(section.specification, InvarianceSpecification)


def verdict(m: Material) -> dict[str, Any]:
    """The headline: a class for its colour, a sentence each for both controllers, and for the winning domains."""
    tallies = m.validation["controllers"]
    robust, nominal = tallies[ROBUST][SIMULATOR], tallies[NOMINAL][SIMULATOR]
    kept, runs = robust["runs_that_kept_the_specification"], robust["runs"]
    good = kept == runs and robust["steps_outside_gamma"] == 0
    deed = "safe" if _is_invariance(m) else "in the target without touching anything"
    return {
        "good": good,
        "badge": "promise kept" if good else "promise broken",
        "robust": f"Gap-aware controller: {kept:,} of {runs:,} runs {deed}, "
        f"{robust['steps_outside_gamma']:,} of {robust['steps']:,} steps outside gamma.",
        "nominal": f"Nominal-only controller: {_violations(nominal)}.",
        "winning": f"The gap-aware controller wins {m.syntheses[ROBUST]['winning_fraction']:.3f} of the "
        f"{'safe set' if _is_invariance(m) else 'free cells'} with the gap taken into account; the nominal model "
        f"alone would promise {m.syntheses[NOMINAL]['winning_fraction']:.3f}.",
        "tolerated": m.gap["fresh"]["violations"],
    }


def _violations(tally: Mapping[str, Any]) -> str:
    bad, runs = tally["runs_that_violated_it"], tally["runs"]
    if not bad:
        return f"none of {runs:,} runs violates the specification in the simulator; here it happens to survive"
    text = f"{bad:,} of {runs:,} runs violate the specification in the simulator"
    median = tally.get("median_steps_until_violation")
    return text + (f", half of them within {median:,.0f} steps" if median else "")


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
        ("nominal model", f"{source}, {plant.integrator.replace('_', ' ')}, sampling time {domain.tau:g} s"),
        ("states X", "; ".join(boxes)),
        ("inputs U", f"{'; '.join(inputs)} ({len(grid)} values)"),
    ]
    rows += [("effect in the model", _effect(e)) for e in plant.effects]
    if case.simulator is not None:
        given = case.simulator.model_dump(mode="json")
        effects = given.pop("effects", ())
        rows.append(("simulator", "; ".join(_plain(given))))
        rows += [("effect in the simulator", _effect(e)) for e in case.simulator.effects] if effects else []
    rows.append(("specification", _specification(m)))
    sensing = case.sensing
    if sensing is not None:
        rows.append(("sensing", "; ".join(_plain(sensing.model_dump(mode="json")))))
    return rows


def _plain(given: Mapping[str, Any], prefix: str = "") -> list[str]:
    out = []
    for key, value in given.items():
        if isinstance(value, Mapping):
            out += _plain(value, f"{prefix}{key} ")
        elif value is not None:
            out.append(f"{prefix}{key} {value:g}" if isinstance(value, float) else f"{prefix}{key} {value}")
    return out


def _effect(effect: Any) -> str:
    numbers = ", ".join(f"{k} = {v:g}" for k, v in effect.parameters.items())
    return f"{effect.name.replace('_', ' ')} on {effect.on}: {numbers}"


def _specification(m: Material) -> str:
    spec = m.context.need(m.context.case.synthesis, "synthesis").specification
    if isinstance(spec, InvarianceSpecification):
        return f"stay for ever in {_box(spec.safe, m)}"
    text = f"reach {_box(spec.target, m)} and avoid {len(spec.obstacles)} obstacles"
    if spec.clearance:
        text += ", clear of them and of the walls by " + _distances(spec.clearance, m)
    return text


def _box(named: Mapping[str, tuple[float, float]], m: Material) -> str:
    return ", ".join(f"{n} in [{lo:g}, {hi:g}] {pretty_unit(m.context.units[n])}" for n, (lo, hi) in named.items())


def _distances(named: Mapping[str, float], m: Material) -> str:
    return ", ".join(f"{v:g} {pretty_unit(m.context.units[n])} in {n}" for n, v in named.items())


def is_signed(gap: Mapping[str, Any]) -> bool:
    """Whether lower and upper bound were fitted apart."""
    return all("lower" in d["scenario"] and "upper" in d["scenario"] for d in gap["dimensions"])


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
        printed = m.printed.get("sup_gamma", {}).get(f"{gap['eps']:g}", {})
        states = {
            d["state"]: {
                "size": d["sup_size"],
                "width": d["sup_width"],
                "sampled": d["largest_sampled_gap"],
                "printed": printed.get(d["state"]),
            }
            for d in gap["dimensions"]
        }
        fresh = gap["fresh"]
        rows.append({"eps": gap["eps"], "samples": gap["samples"], "states": states, "fresh": fresh})
    return rows


def lipschitz(m: Material) -> Rows:
    """Estimates of each state side by side: method, value, goodness of fit, remark."""
    printed = m.printed.get("lipschitz", {})
    out = []
    for d in m.gap["dimensions"]:
        rows = [dict(e) for e in d.get("lipschitz_estimates", [])]
        if d["state"] in printed:
            rows.append({"method": "printed in the paper", "value": printed[d["state"]], "ks_p": None, "note": ""})
        out.append({"state": d["state"], "rows": rows})
    return out


def scenario(gap: Mapping[str, Any]) -> Rows:
    """One row a scenario program."""
    return [
        {"state": d["state"], "side": side, **program}
        for d in gap["dimensions"]
        for side, program in d.get("scenario", {}).items()
    ]


def loops(m: Material) -> Rows:
    """One row for each controller on each plant."""
    titles = {ROBUST: "gap-aware", NOMINAL: "nominal-only"}
    return [
        {"controller": titles[kind], "plant": plant, **m.validation["controllers"][kind][plant]}
        for kind in (ROBUST, NOMINAL)
        for plant in (SIMULATOR, MODEL)
        if plant in m.validation["controllers"][kind]
    ]


def diagnosis(m: Material) -> dict[str, Any] | None:
    """What measured data said about the model, for a short section with a link."""
    d = m.diagnosis
    if d is None:
        return None
    before, after = d["error"]["before"]["horizon_rmse"], d["error"]["after"]["horizon_rmse"]
    floor = d["error"]["noise_floor"]["horizon_rmse"]
    rows = [{"state": s, "before": before[s], "after": after[s], "floor": floor[s]} for s in before]
    return {"verdict": d["verdict"], "sentence": d.get("sentence", ""), "effects": d["effects"], "rows": rows,
            "horizon": d["error"]["before"]["horizon_s"]}  # fmt: skip


def corrected(m: Material) -> Rows:
    """What the corrected model changes: a row a figure, before and after."""
    if m.corrected is None:
        return []
    after = m.corrected.summary
    bounds = after["sup_gamma"][f"{after['eps']:g}"]
    rows: Rows = []
    for key, name in (("size", "sup of gamma's size"), ("width", "sup of its width"), ("sampled", "largest sampled gap")):
        for d in m.gap["dimensions"]:
            before = d[{"size": "sup_size", "width": "sup_width", "sampled": "largest_sampled_gap"}[key]]
            state = d["state"]
            row = {"what": f"{name}, {state}", "before": before, "after": bounds[state][key], "unit": m.context.units[state]}
            rows.append(row)
    for kind, name in ((NOMINAL, "nominal-only"), (ROBUST, "gap-aware")):
        before, later = m.syntheses[kind]["winning_fraction"], after["winning_fraction"][kind]
        rows.append({"what": f"winning fraction, {name}", "before": before, "after": later, "unit": ""})
    for kind, name in ((NOMINAL, "nominal-only"), (ROBUST, "gap-aware")):
        counts = [t[kind][SIMULATOR]["runs_that_violated_it"] for t in (m.validation["controllers"], after["closed_loop"])]
        rows.append({"what": f"runs that violate, {name}", "before": counts[0], "after": counts[1], "unit": ""})
    return rows


def sources(m: Material) -> Rows:
    """The provenance of every result that went into the page."""
    named = [(f"gap, eps = {g['eps']:g}", g) for g in m.sweep]
    named += [("synthesis, gap-aware", m.syntheses[ROBUST]), ("synthesis, nominal", m.syntheses[NOMINAL])]
    named.append(("validation", m.validation))
    return [{"what": what, **document["provenance"]} for what, document in named if "provenance" in document]


def summary(m: Material, page: Mapping[str, Any]) -> dict[str, Any]:
    """The figures that a script wants."""
    return {
        "case": m.context.case.name,
        "title": page["title"],
        "promise_kept": page["verdict"]["good"],
        "verdict": [page["verdict"][k] for k in ("robust", "nominal", "winning")],
        "eps": m.gap["eps"],
        "sup_gamma": {f"{r['eps']:g}": r["states"] for r in page["sweep"]},
        "fresh": {k: m.gap["fresh"][k] for k in ("samples", "violations", "upper", "confidence")},
        "winning_fraction": {kind: s["winning_fraction"] for kind, s in m.syntheses.items()},
        "winning_cells": {kind: s["winning_cells"] for kind, s in m.syntheses.items()},
        "closed_loop": m.validation["controllers"],
        "between_samples": page["between"],
        "guarantee": m.gap["guarantee"],
        "diagnosis": page["diagnosis"]["verdict"] if page["diagnosis"] else None,
    }
