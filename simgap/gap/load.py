"""A saved gap bound read back: every kind of bound by the name under which it saves itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from simgap.errors import UserError, excerpt
from simgap.gap.cells import CellGap
from simgap.gap.complete import check_complete
from simgap.gap.function import GapDomain, GapFunction
from simgap.gap.linear import LinearGap
from simgap.gap.symmetry import BodyFrameGap
from simgap.gap.tiers import Tier


class Kind(Protocol):
    """What a kind of bound offers to be read back."""

    def from_content(self, data: Mapping[str, Any], domain: GapDomain, tiers: tuple[Tier, ...]) -> GapFunction:
        """The inverse of `GapFunction.to_json`, domain and tiers read already."""


KINDS: Mapping[str, Kind] = {"linear": LinearGap, "cells": CellGap, "body_frame": BodyFrameGap}


def from_json(data: Any) -> GapFunction:
    """A gap function from what `to_json` gave, complete and right side up.

    Raises:
        UserError: for an unknown kind, missing parts, numbers that are none, or a lower side above the upper one.
    """
    try:
        domain = GapDomain.from_json(data["domain"])
        tiers = tuple(Tier.from_json(t) for t in data["guarantee"])
        gap = KINDS[data["kind"]].from_content(data, domain, tiers)
        check_complete(gap)
    except UserError as error:
        raise UserError(f"not a saved gap bound: {error.problem}", remedy="Run the gap stage again.") from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise UserError(f"not a saved gap bound ({excerpt(repr(error))})", remedy="Run the gap stage again.") from None
    return gap
