"""The tables of a case's page, as plain rows for the template."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from simgap.io.traces import MODEL, NOMINAL, ROBUST, SIMULATOR

if TYPE_CHECKING:
    from simgap.stages.report import Material

Rows = list[dict[str, Any]]
BOUND_FIGURES = (
    ("size", "sup_size", "sup of gamma's size"),
    ("width", "sup_width", "sup of its width"),
    ("sampled", "largest_sampled_gap", "largest sampled gap"),
)


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
    horizon = d["error"]["before"]["horizon_s"]
    return {"verdict": d["verdict"], "sentence": d.get("sentence", ""), "rows": rows, "horizon": horizon}


def corrected(m: Material) -> Rows:
    """What the corrected model changes: a row a figure, before and after."""
    if m.corrected is None:
        return []
    after = m.corrected.summary
    bounds = after["sup_gamma"][f"{after['eps']:g}"]
    rows: Rows = []
    for key, own, name in BOUND_FIGURES:
        for d in m.gap["dimensions"]:
            state = d["state"]
            row = {"what": f"{name}, {state}", "before": d[own], "after": bounds[state][key]}
            rows.append(row | {"unit": m.context.units[state]})
    for kind, name in ((NOMINAL, "nominal-only"), (ROBUST, "gap-aware")):
        before, later = m.syntheses[kind]["winning_fraction"], after["winning_fraction"][kind]
        rows.append({"what": f"winning fraction, {name}", "before": before, "after": later, "unit": ""})
    for kind, name in ((NOMINAL, "nominal-only"), (ROBUST, "gap-aware")):
        tallies = (m.validation["controllers"], after["closed_loop"])
        first, second = (t[kind][SIMULATOR]["runs_that_violated_it"] for t in tallies)
        rows.append({"what": f"runs that violate, {name}", "before": first, "after": second, "unit": ""})
    return rows


def sources(m: Material) -> Rows:
    """The provenance of every result that went into the page."""
    named = [(f"gap, eps = {g['eps']:g}", g) for g in m.sweep]
    named += [("synthesis, gap-aware", m.syntheses[ROBUST]), ("synthesis, nominal", m.syntheses[NOMINAL])]
    named.append(("validation", m.validation))
    return [{"what": what, **document["provenance"]} for what, document in named if "provenance" in document]
