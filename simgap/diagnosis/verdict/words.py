"""The diagnosis in one sentence that a person can act on, from the document that `diagnosis.json` holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from simgap.notation import joined, pretty_unit, with_error

Document = Mapping[str, Any]
Parameters = Mapping[str, Mapping[str, Any]]

_OF_THE_PLANT = {"gravity_tilt": "a base tilt", "wheel_mismatch": "unequal wheels", "lateral_slip": "sideways slip"}


def _quoted(parameters: Parameters, name: str, scale: float = 1.0, unit: str | None = None) -> str:
    p = parameters[name]
    lo, hi = (float(v) if v is not None else math.nan for v in p["ci95"])
    return with_error(scale * float(p["value"]), scale * (hi - lo) / 2, p["unit"] if unit is None else unit)


def _ratio(parameters: Parameters, name: str = "ratio") -> str:
    """A ratio as a deviation: 0.75 -> '25 ± 1 % below'."""
    p = parameters[name]
    lo, hi = (float(v) if v is not None else math.nan for v in p["ci95"])
    side = "below" if p["value"] < 1 else "above"
    return f"{with_error(100 * abs(float(p['value']) - 1), 50 * (hi - lo))} % {side}"


def describe(effect: Mapping[str, Any]) -> str:
    """An effect with its numbers, as a noun phrase: 'Coulomb friction of 0.19 ± 0.01 N m at the hinge'."""
    name, on, p = effect["name"], effect["on"], effect["parameters"]
    match name:
        case "viscous_friction":
            return f"viscous friction of {_quoted(p, 'b')} at the {on}"
        case "coulomb_friction":
            return f"Coulomb friction of {_quoted(p, 'F_c')} at the {on}"
        case "stribeck_friction":
            levels = f"{_quoted(p, 'F_s')} to break away, {_quoted(p, 'F_c')} when sliding"
            return f"Stribeck friction at the {on} ({levels})"
        case "quadratic_drag":
            return f"quadratic drag of {_quoted(p, 'c')} at the {on}"
        case "spring":
            return f"a spring of {_quoted(p, 'k')} at the {on}"
        case "cubic_spring":
            return f"a cubic spring of {_quoted(p, 'k3')} at the {on}"
        case "cogging":
            n = round(float(p["n"]["value"]))
            return f"cogging of {_quoted(p, 'A')} with {n} period{'' if n == 1 else 's'} a turn at the {on}"
        case "input_gain":
            return f"a gain of {on} that is {_ratio(p)} the declared one"
        case "input_bias":
            return f"a bias of {_quoted(p, 'bias')} on {on}"
        case "input_delay":
            return f"a delay of {_quoted(p, 'delay', 1e3, 'ms')} on {on}"
        case "input_lag":
            return f"a lag of {_quoted(p, 'T', 1e3, 'ms')} on {on}"
        case "input_dead_zone":
            return f"a dead zone of ±({_quoted(p, 'width')}) on {on}"
        case "input_saturation":
            return f"a limit of {_quoted(p, 'limit')} on {on}"
        case "sensor_offset":
            return f"a sensor of {on} that reads {_quoted(p, 'offset')} too much"
        case "parameter_error":
            noun = phrase(effect).removeprefix("the ")
            return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun} that is {_ratio(p)} its declared value"
        case "gravity_tilt":
            return f"a base tilted by {_quoted(p, 'tilt', 180 / math.pi, 'deg')}"
        case "wheel_mismatch":
            return f"a right wheel whose radius is {_ratio(p)} the declared one"
        case "lateral_slip":
            return f"sideways slip of {_quoted(p, 'ratio', 100.0)} % of the speed"
    numbers = ", ".join(f"{symbol} = {_quoted(p, symbol)}" for symbol in p)
    return f"{phrase(effect)} ({numbers})" if numbers else phrase(effect)


def phrase(effect: Mapping[str, Any]) -> str:
    """An effect without numbers: 'Coulomb friction at the hinge', 'the torque gain', 'the mass of the rod'."""
    name, on = effect["name"], effect["on"]
    if name == "parameter_error":
        owner, _, quantity = str(on).rpartition(".")
        words = {"com": "centre of mass", "": on}.get(quantity, quantity.replace("_", " "))
        return f"the {words} of the {owner}" if owner else f"the parameter {on}"
    if name.startswith("input_"):
        return f"the {name.removeprefix('input_').replace('_', ' ')} of {on}"
    if name in _OF_THE_PLANT:
        return _OF_THE_PLANT[name]
    if name == "sensor_offset":
        return f"an offset of the sensor of {on}"
    words = name.replace("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")
    return f"{words} at the {on}"


def verdict_sentence(document: Document) -> str:
    """What was found, what it explains, and what cannot be told apart."""
    verdict, effects = document["verdict"], document["effects"]
    if verdict == "none":
        return f"The model explains these data down to their noise: no effect is missing.{_blind(document)}"
    if verdict == "unexplained":
        return _unexplained(document)
    found = joined([describe(e) for e in effects])
    verb = "explains" if len(effects) == 1 else "together explain"
    share = 100 * min(max(float(document["explained_share"]), 0.0), 1.0)
    text = f"{found[0].upper()}{found[1:]} {verb} {share:.0f} % of the excess error"
    doubts = [_doubt(e) for e in effects if e.get("alternatives")]
    if doubts:
        text += f"; {'; '.join(doubts)}"
    text += "."
    if verdict == "partial":
        text += f" {_remainder(document)}"
    return text


def _doubt(effect: Mapping[str, Any]) -> str:
    names = [phrase(effect), *(joined([phrase(e) for e in alternative]) for alternative in effect["alternatives"])]
    if len(names) > 4:
        names = [*names[:3], f"{len(names) - 3} more"]
    return f"{joined(names)} cannot be told apart from this data"


def _blind(document: Document) -> str:
    advice = [w for w in document.get("warnings", ()) if "cannot be told" in w or "look alike" in w]
    return f" But {advice[0]}." if advice else ""


def _remainder(document: Document) -> str:
    error = document["error"]["after"]
    h = error["horizon_s"]
    sizes = joined([f"{x:.2g}{_of(document, s)}" for s, x in error["horizon_rmse"].items()])
    covered = _covered(document.get("remainder"))
    return f"An error of {sizes} is left {h:g} s ahead that nothing in the library explains{covered}."


def _covered(remainder: Mapping[str, Any] | None) -> str:
    """What was done with the one-step part of what is left."""
    if remainder is None:
        return ""
    if remainder["bounded"]:
        return "; its one-step part is bounded into gamma"
    return f"; it is not bounded into gamma: {remainder['reason']}"


def _of(document: Document, state: str) -> str:
    unit = pretty_unit(document.get("units", {}).get(state, ""))
    return f" {unit} in {state}" if unit else f" in {state}"


def _unexplained(document: Document) -> str:
    best = document["candidates"][0] if document["candidates"] else None
    text = "No effect of the library explains the difference between model and data"
    if best is not None:
        text += f" (the nearest is {phrase(best)}, which is not enough)"
    return (
        f"{text}: look for a force that was not measured, a column that is not what the case says, "
        f"or a mechanism outside the library."
    )
