"""A grid of samples that is too coarse is refused with the state and the key, before any roll-out."""

import pytest

from simgap.errors import UserError
from simgap.lint.gap import refuse_few_cells
from simgap.plants.context import Context


def test_a_half_width_that_leaves_too_few_cells_is_named(vary):
    refuse_few_cells(Context.load(vary("cart_pole", {"grid.half_widths": {"a": 0.0125, "w": 0.3}})))
    with pytest.raises(UserError, match="leaves 3 cells along w") as refused:
        refuse_few_cells(Context.load(vary("cart_pole", {"grid.half_widths": {"a": 0.0125, "w": 0.4}})))
    assert refused.value.key == "grid.half_widths.w"
    assert "At most 0.3 there" in refused.value.remedy


def test_no_case_that_ships_is_refused(root):
    for path in sorted((root / "configs/cases").glob("*.yaml")):
        context = Context.load(path)
        if context.case.domain is not None:
            refuse_few_cells(context)
