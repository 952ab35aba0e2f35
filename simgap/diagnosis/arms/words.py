"""The diagnosis of an arm in words, from the document that `diagnosis.json` holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from simgap.diagnosis.arms.problem import INERTIAL
from simgap.effects import effect
from simgap.effects.quoted import Quoted
from simgap.notation import joined

Document = Mapping[str, Any]


def describe(found: Mapping[str, Any]) -> str:
    """An effect with its numbers; of a link, how many combinations of inertial parameters are not as declared."""
    if found["name"] == INERTIAL:
        return f"inertial parameters of {found['on']}"
    return effect(found["name"]).describe(str(found["on"]), Quoted(found["parameters"]))


def sentence(document: Document) -> str:
    """Torque columns that are wrong and what to do; what was found, what it explains, what was mounted."""
    wrong = "".join(f"{f['sentence']} {f['remedy']} " for f in document["recording"])
    return wrong + _found(document)


def _found(document: Document) -> str:
    verdict, effects = document["verdict"], document["effects"]
    if verdict == "none":
        return f"The model explains the torques down to their noise: no effect is missing.{_mounted(document)}"
    if verdict == "unexplained":
        return (
            "No friction, inertia, bias or change of inertial parameters halves the error of the torques on data that "
            "were never fitted: look for a torque column or a drive gain that is not what the case says, or for a "
            "force that was not measured."
        )
    share = 100 * min(max(float(document["explained_share"]), 0.0), 1.0)
    own = [describe(e) for e in effects if e["name"] != INERTIAL]
    links = [e["on"] for e in effects if e["name"] == INERTIAL]
    parts = [*own, *([f"other inertial parameters of {joined(links)}"] if links else [])]
    what = joined(parts)
    verb = "explains" if own == parts and len(parts) == 1 else "explain" if len(parts) == 1 else "together explain"
    text = f"{what[0].upper()}{what[1:]} {verb} {share:.0f} % of the excess error of the torques."
    return f"{text}{_mounted(document)}"


def _mounted(document: Document) -> str:
    return "".join(f" {mounted(p)}" for p in document["payloads"])


def mounted(payload: Mapping[str, Any]) -> str:
    """A sentence about a payload whose mass was found."""
    if "m" not in payload["parameters"]:
        return ""
    mass = Quoted(payload["parameters"]).number("m")
    return f"In {joined(_listed(payload['traces']))} {payload['link']} carries {mass} more."


def _listed(traces: Sequence[str]) -> list[str]:
    return list(traces) if len(traces) <= 4 else [*traces[:3], f"{len(traces) - 3} more"]
