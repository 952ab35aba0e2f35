"""Results that the page of a case is made from, in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from simgap.gap.bounds.function import GapFunction
from simgap.io.traces import SIMULATOR, Trace
from simgap.plants.context import Context
from simgap.synthesis.controller import Controller


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
