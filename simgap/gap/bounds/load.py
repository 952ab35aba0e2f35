"""A saved gap bound read back: every form of bound by the name under which it saves itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simgap.errors import UserError, excerpt
from simgap.gap.bounds.body_frame import BodyFrameGap
from simgap.gap.bounds.cells import CellGap
from simgap.gap.bounds.function import GapDomain, GapFunction, Tier, require
from simgap.gap.bounds.linear import LinearGap

FORMS: Mapping[str, type[GapFunction]] = {"linear": LinearGap, "cells": CellGap, "body_frame": BodyFrameGap}


def from_json(data: Any) -> GapFunction:
    """A gap function from what `to_json` gave, complete and right side up.

    Raises:
        UserError: for an unknown form, missing parts, numbers that are none, or a lower side above the upper one.
    """
    try:
        domain = GapDomain.from_json(data["domain"])
        tiers = tuple(Tier.from_json(t) for t in data["guarantee"])
        gap = FORMS[data["kind"]].from_content(data, domain, tiers)
        domain.check()
        require(len(tiers) > 0, "it does not say what it rests on")
        require(all(tier.level in (1, 2, 3) for tier in tiers), "it rests on a tier that does not exist")
        gap.check()
    except UserError as error:
        raise UserError(f"not a saved gap bound: {error.problem}", remedy="Run the gap stage again.") from None
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise UserError(f"not a saved gap bound ({excerpt(repr(error))})", remedy="Run the gap stage again.") from None
    return gap
