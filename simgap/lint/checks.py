"""Every check of a case, in the order in which they run: `(Context) -> findings`, or a refusal."""

from __future__ import annotations

from collections.abc import Callable

from simgap.errors import Finding
from simgap.lint.angles import refuse_seams
from simgap.lint.controller import refuse_free_path, refuse_specification
from simgap.lint.equations import (
    find_heavy_steps,
    find_long_steps,
    find_mixed_units,
    find_wrong_dimensions,
    refuse_prefixes,
)
from simgap.lint.gap import find_jumps_at_rest, find_stuck_joints, refuse_basis, refuse_few_cells
from simgap.lint.measured import find_missing_coordinates
from simgap.lint.wheels import find_bolted_base, find_other_wheel_sizes
from simgap.plants.context import Context

Check = Callable[[Context], list[Finding] | None]
"""What is odd about a case; what no stage could use raises UserError with the key and the remedy."""

OF_CASE: tuple[Check, ...] = (
    refuse_prefixes, refuse_few_cells, refuse_seams, refuse_specification, refuse_basis, refuse_free_path,
)  # fmt: skip
"""What takes no engine; asked first, since starting one takes seconds."""

OF_NUMBERS: tuple[Check, ...] = (
    find_mixed_units, find_wrong_dimensions, find_heavy_steps, find_long_steps, find_bolted_base,
    find_other_wheel_sizes, find_jumps_at_rest, find_stuck_joints, find_missing_coordinates,
)  # fmt: skip
"""What is asked once the engine has loaded its model file: its reasons come before those that follow from them."""


def run_checks(checks: tuple[Check, ...], context: Context) -> list[Finding]:
    """All that these checks find.

    Raises:
        UserError: the first refusal.
    """
    return [finding for check in checks for finding in check(context) or ()]
