"""The `grid` section: where nominal model and simulator are compared."""

from __future__ import annotations

from pydantic import Field

from simgap.config.base import Section


class GridSection(Section):
    """States that cover X, and how the roll-outs are cut into files."""

    eps: float = Field(gt=0, description="Radius of the balls around samples: no cell's half-diagonal is longer.")
    shards: int = Field(2, ge=1, le=1000, description="Files (and jobs) that the roll-outs are cut into.")
