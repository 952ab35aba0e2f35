"""Sections of a case that each stage reads: a change elsewhere in the file reruns nothing of it.

`section.key=value` says that the stage reads no more than whether the key has that value.
"""

from __future__ import annotations

from collections.abc import Mapping

_PLANT = ("plant.urdf", "plant.states", "plant.inputs", "plant.gravity")
_SIMULATED = ("name", *_PLANT, "plant.symbolic.wheels", "domain", "simulator", "sensing.latency", "sensing.latency_of")

_PREVIOUS = ("hidden_state.previous", "hidden_state.classes")
_MODEL = ("name", "plant", "domain")
_HISTORIES = (
    "hidden_state.length", "hidden_state.chains", "hidden_state.chain_length", "hidden_state.seed",
    "symmetry.headings", "symmetry.histories", "symmetry.seed",
)  # fmt: skip
_COUNTED = ("hidden_state.length", "hidden_state.chains", "hidden_state.chain_length", "symmetry.headings",
    "symmetry.histories")  # fmt: skip
# A padding enters the scenario program where it is `inflate`; which of the others it is does not matter there.
_FIT = (
    "gap.basis", "gap.objective", "gap.slack", "gap.sides", "gap.padding=inflate",
)  # fmt: skip
_RUN = (
    "domain", "simulator", "twin", "symmetry", "hidden_state", "grid", "gap", "sensing", "synthesis", "validation",
    "audit",
)  # fmt: skip
_TOLERATED = ("gap.tolerated_probability", "gap.noise", "hidden_state.tolerated_probability")
_JUDGED = ("synthesis.specification", *_TOLERATED)
_CHAINS = ("hidden_state.length", "hidden_state.chain_length")
_WHOLE = ("name", "title", "plant", *_RUN, "measured")

READS: Mapping[str, tuple[str, ...]] = {
    "check": (*_WHOLE, "budget"),
    "grid": ("name", "plant.states", "plant.inputs", "domain.X", "domain.U", *_PREVIOUS),
    "rollouts": (*_SIMULATED, "grid.shards", "gap.noise", *_HISTORIES),
    "fresh": (*_SIMULATED, "gap.fresh_samples", "gap.seed", "hidden_state"),
    "borders": (*_SIMULATED, "plant", "gap.seed", "gap.noise", "hidden_state"),
    "scp": (*_MODEL, *_FIT, *_COUNTED, "hidden_state.classes", "simulator.effects", "simulator.urdf"),  # switching
    "lipschitz": (*_MODEL, "gap.seed", "gap.lipschitz.extreme_value", *_COUNTED),
    "gap": (*_MODEL, "gap", "hidden_state", "symmetry", "simulator", "sensing.latency", "sensing.latency_of"),
    "synthesis": ("name", "plant", "domain", "simulator.effects", "synthesis", "sensing"),
    "validation": ("name", "plant", "domain", "simulator", *_JUDGED, "sensing", "validation"),
    "audit": ("name", "plant", "domain", "simulator", *_JUDGED, *_CHAINS, "sensing", "validation.steps", "audit"),
    "certify": (*_MODEL, "simulator", "synthesis", "sensing"),
    "twin": (*_SIMULATED, "twin"),
    "paper": _SIMULATED,
    "rig": _SIMULATED,
    "trace": ("name", "title", "plant", "domain", "synthesis.specification"),
    "diagnosis": (*_WHOLE, "budget"),  # the corrected case is a copy of the whole
    "next": ("name", "plant", "domain", "measured"),
    "report": (
        "name",
        "title",
        "plant",
        "domain",
        "simulator",
        "twin",
        "grid.eps",
        "synthesis.specification",
        "sensing",
    ),
}

COPIED = ("title", "twin", "validation", "audit", "budget")
"""Sections of which a diagnosis makes no use: it copies them into the corrected case."""

SIMULATED = ("rollouts", "fresh", "rig")
"""Stages that ask the simulator alone: what the nominal model gains from recordings of it leaves them as they are."""

CONTROLLED = ("synthesis", "gap")
"""Stages on which whatever runs the gap-aware controller rests."""

CLOSED_FORM = ("scp", "lipschitz")
"""Stages that read all of the simulator where its engine may know it in closed form."""

OWN_FORMAT = ("scp",)
"""Stages that read of a simulator's file in its own format where it switches, and not the rest of the simulator."""

EVERY_EFFECT = ("check", "diagnosis", "next", "report")
"""Stages that try or describe effects which the case does not name."""

TRANSLATED = ("grid", "borders", "scp", "lipschitz", "gap")
"""Stages that read all of the symmetry where it is a translation: one cell along its states, and shifted samples."""
