"""The diagnosis in one sentence that a person can act on, from the document that `diagnosis.json` holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from simgap.diagnosis.record.faults.measurement import FITTED, effect_or_fault
from simgap.effects import EFFECTS
from simgap.effects.base import Quoted
from simgap.notation import capitalised, few, from_to, joined, percent, pretty_unit

Document = Mapping[str, Any]


def describe(found: Mapping[str, Any]) -> str:
    """An effect with its numbers, as a noun phrase: 'Coulomb friction of 0.19 ± 0.01 N m at the hinge'."""
    return effect_or_fault(found["name"]).describe(str(found["on"]), Quoted(found["parameters"]))


def phrase(found: Mapping[str, Any]) -> str:
    """An effect without numbers: 'Coulomb friction at the hinge', 'the torque gain', 'the mass of the rod'."""
    return effect_or_fault(found["name"]).phrase(str(found["on"]))


def verdict_parts(document: Document) -> list[str]:
    """What was found and explains how much, what cannot be told apart, what is left, where the error is if it is in one
    place, whether the search ended early, what is wrong with the recording: a sentence or more each, the answer first.
    """
    where, stopped = _where(document.get("concentrated")), document.get("stopped", "")
    parts = [*_answer(document), where, stopped, *_faults(document)]
    return [part for part in parts if part]


def _faults(document: Document) -> list[str]:
    """What is wrong with the recording, each once; what was fitted is no surer than the effects beside it."""
    unsure = {f.told_as or f.name for f in FITTED.values()} if document["verdict"] in ("partial", "unexplained") else ()
    said: dict[str, list[str]] = {}
    for f in document.get("recording", ()):
        begin = "About the recording, no surer than the effects" if f["fault"] in unsure else "About the recording"
        said.setdefault(begin, []).append(f["sentence"])
    return [f"{begin}: {' '.join(sentences)}" for begin, sentences in said.items()]


def _answer(document: Document) -> list[str]:
    verdict, effects = document["verdict"], document["effects"]
    if verdict == "none":
        but = ", the faults of the recording allowed for" if document.get("recording") else ""
        advice = [w for w in document.get("warnings", ()) if "cannot be told" in w or "look alike" in w]
        unseen = f"But {advice[0]}." if advice else ""
        return [f"The model explains these data down to their noise{but}: no effect is missing.", unseen]
    if verdict == "unexplained":
        return [_remainder(document)] if document.get("unconfirmed") else _unexplained(document)
    found = joined([describe(e) for e in effects])
    verb = "explains" if len(effects) == 1 else "together explain"
    named = f"Provisionally, {found}" if document.get("stopped") else capitalised(found)
    text = f"{named} {verb} {explained(document)}."
    doubts = [f"{capitalised(_doubt(e))}." for e in effects if e.get("alternatives")]
    return [text, *doubts, _remainder(document) if verdict == "partial" else ""]


def explained(document: Document) -> str:
    """How much: off the noise floor, of the error ahead on data that it was not fitted to, else of what is above it."""
    told, ahead = document.get("explained_error"), _ahead(document["error"]["after"])
    if told is None:
        return f"{percent(float(document['explained_share']))} % of the excess error{ahead}"
    low, high = map(percent, told["ci95"])
    share = f"{100 * told['share']:.0f} % (95 % interval {low} to {high})"
    return f"{share} of the error{ahead}"


def _ahead(error: Mapping[str, Any]) -> str:
    """How far ahead it is; no stretch may be as long, and an arm has no windows."""
    if error["horizon_rmse"]:
        return f" {error['horizon_s']:g} s ahead"
    return " within the windows" if error["horizon_s"] else ""


def _where(c: Mapping[str, Any] | None) -> str:
    """The places that carry most of the error, and what the answer is worth without them."""
    if c is None:
        return ""
    spans = [f"{from_to(s['from'], s['to'])} of {s['trace']}" for s in c["stretches"]]
    share = c["explained_share_without"]
    without = f"; without them the effects explain {percent(share)} %" if share > 0.0 else ""
    return f"{100 * c['error_share']:.0f} % of what is left lies at {joined(few(spans))} (a push?){without}."


def _doubt(effect: Mapping[str, Any]) -> str:
    """What else it may be; sets of several effects are kept apart by "from"."""
    sets = [" with ".join(phrase(e) for e in alternative) for alternative in effect["alternatives"]]
    more = [f"{len(sets) - 2} more"] if len(sets) > 3 else []
    sets = sets[:2] if more else sets
    if all(len(alternative) == 1 for alternative in effect["alternatives"]):
        return f"{joined([phrase(effect), *sets, *more])} cannot be distinguished by these data"
    rest = f" (and {more[0]})" if more else ""
    return f"these data do not tell {phrase(effect)} {joined([f'from {s}' for s in sets], 'or')}{rest}"


def _remainder(document: Document) -> str:
    """What keeps the answer from being attributed, or the error that is left."""
    if further := document.get("unconfirmed"):
        return (
            f"What was kept is down to its noise; but where gross errors begin {joined(list(further))} "
            f"{'goes' if len(further) == 1 else 'go'} further than in other data, and a stop, a collision or a limit "
            "there would look like a push: record a run that goes there, and keep it for confirming "
            "(measured.held_out)."
        )
    if faint := document.get("faint_memory"):
        return (
            f"What is left looks like coloured noise of {joined(list(faint))}; play in a gear and other mechanisms "
            "outside the library would leave the same: measure that noise with the plant held at rest."
        )
    if document.get("doubts"):
        return (
            f"All data are predicted down to their noise, but that does not settle it. {' '.join(document['doubts'])}"
        )
    error, noise = document["error"]["after"], document["error"]["noise_floor"]
    kind = "horizon_rmse" if error["horizon_rmse"] else "fit_rmse"
    sizes = joined([f"{x:.2g}{_of(document, s)}" for s, x in error[kind].items()])
    over, stopped = document.get("left_over", ()), document.get("stopped")
    if over is not None and not stopped and all(x <= noise[kind].get(s, 0.0) for s, x in error[kind].items()):
        return (
            f"What is left{_ahead(error)}, {sizes}, is no larger than the noise of the readings; but within the fitted "
            "windows it is no white noise, which keeps this from being sure."
        )
    covered = _covered(document.get("remainder"))
    left = f"An error of {sizes} is left{_ahead(error)}"
    if stopped:
        why = ""
    elif over is None:
        why = " on the data that confirm, while the fitted ones are down to their noise: look for what changed"
    elif over:
        why = f"; {_also(over)}"
    elif document.get("at_most"):
        why = f" with {document['at_most']} effects, as many as were sought: allow more by measured.max_effects"
    else:
        why = " for which no explanation in the library was found"
    return f"{left}{why}{covered}."


def _also(over: Sequence[Mapping[str, Any]]) -> str:
    """Effects that would take away a part of what is left."""
    parts = joined([f"{describe(e)} would remove {100 * e['share']:.0f} % of it" for e in over[:1]])
    others = joined([phrase(e) for e in over[1:]])
    return f"{parts}{f' (or {others}, less)' if others else ''}, but is not established"


def _covered(remainder: Mapping[str, Any] | None) -> str:
    """What was done with the one-step part of what is left."""
    if remainder is None:
        return ""
    if remainder["bounded"]:
        left = 100.0 * remainder["confidence"]
        few = f", with a confidence of {left:.0f} %" if remainder["confidence"] < remainder["level"] else ""
        return f"; its one-step part is bounded into gamma{few}"
    return f"; it is not bounded into gamma: {remainder['reason']}" if remainder["asked"] else ""


def _of(document: Document, state: str) -> str:
    unit = pretty_unit(document.get("units", {}).get(state, ""))
    return f" {unit} in {state}" if unit else f" in {state}"


def _unexplained(document: Document) -> list[str]:
    """What comes nearest and why it is not named, then where to look."""
    tried = {c["name"] for c in document.get("candidates", ())}
    kinds = {EFFECTS[name].kind for name in tried if name in EFFECTS}
    unasked = [e.name for e in EFFECTS.values() if e.by_name and e.name not in tried and e.kind in kinds]
    places = [
        "a force that was not measured", "noise that is correlated over time",
        "a column that is not what the case says", "a mechanism outside the library",
        *(f"{name}, which is sought where measured.effects names it" for name in unasked),
    ]  # fmt: skip
    seek = joined(places, "or")
    near, over = document.get("nearest"), document.get("left_over")
    if near is not None:
        effects, most = near["effects"], document.get("at_most")
        ahead = _ahead(document["error"]["after"])
        nearest, it_is = ("The nearest is", "It is") if len(effects) == 1 else ("The nearest are", "They are")
        more = f"Allow more than {most} effects (measured.max_effects), or look" if most else "Look"
        text = (
            "No effect of the library is established as the difference between model and data. "
            f"{nearest} {joined([describe(e) for e in effects])}, with {100 * near['explained_share']:.0f} % of the "
            f"excess error{ahead}. {it_is} not named because {joined(near['reasons'])}."
        )
        return [text] if document.get("stopped") else [text, f"{more} for {seek}."]
    if document.get("stopped"):
        return ["No effect that was tried explains the difference between model and data."]
    if over:
        return [f"No effect of the library is confirmed on held-out data; {_also(over)}.", f"Look for {seek}."]
    return ["No effect of the library explains the difference between model and data.", f"Look for {seek}."]
