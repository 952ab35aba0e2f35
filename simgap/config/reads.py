"""What each stage reads of a case: a change elsewhere in the file reruns nothing of it."""

from __future__ import annotations

from collections.abc import Mapping

_PLANT = ("plant.urdf", "plant.states", "plant.inputs", "plant.gravity")
_SIMULATED = ("name", *_PLANT, "domain", "simulator", "sensing.latency", "sensing.latency_of")

_RUN = ("domain", "simulator", "symmetry", "hidden_state", "grid", "gap", "sensing", "synthesis", "validation")
_JUDGED = ("synthesis.specification", "gap.tolerated_probability")
_WHOLE = ("name", "title", "plant", *_RUN, "measured")

READS: Mapping[str, tuple[str, ...]] = {
    "rollouts": (*_SIMULATED, "grid.shards"),
    "fresh": (*_SIMULATED, "gap.fresh_samples", "gap.seed", "hidden_state"),
    "calibration": (*_SIMULATED, "gap.conformal.calibration_samples", "gap.conformal.seed", "hidden_state"),
    "histories": (*_SIMULATED, "hidden_state", "symmetry"),
    "hidden_gap": ("name", "plant", "domain", "simulator", "hidden_state", "symmetry.tolerance"),
    "gap": ("name", "plant", "domain", "gap"),
    "synthesis": ("name", "plant", "domain", "synthesis", "sensing"),
    "validation": ("name", "plant", "domain", "simulator", *_JUDGED, "sensing", "validation"),
    "paper": _SIMULATED,
    "rig": _SIMULATED,
    "trace": ("name", "title", "plant", "domain", "synthesis.specification"),
    "diagnosis": _WHOLE,  # the corrected case is a copy of the whole
    "report": ("name", "title", "plant", "domain", "simulator", "grid.eps", "synthesis.specification", "sensing"),
}

EVERY_EFFECT = ("diagnosis", "report")
"""Stages that try or describe effects which the case does not name."""
