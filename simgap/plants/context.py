"""A checked case with its nominal model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from simgap.config import context
from simgap.plants.plant_model import PlantModel
from simgap.provenance import require_own


@dataclass(frozen=True)
class Context(context.Context):
    """A case with its nominal model, which is built when first asked for, once a stage."""

    @cached_property
    def plant(self) -> PlantModel:
        """The nominal model in all its shapes."""
        return PlantModel.of(self.case, self.folder)

    def own(self, path: Path | str, record: Any, *stages: str) -> None:
        """Refuse a result that one of these stages did not make of this case: `provenance.require_own`.

        Raises:
            UserError: with the keys that differ.
        """
        require_own(Path(path), record, stages, self.case, self.folder)
