"""A motion that diverges in MuJoCo is refused: left to itself MuJoCo puts the plant back to where it began and goes on.

`mj_step` resets its data when a position, velocity or acceleration is no number or beyond 1e10, prints a line into a
file MUJOCO_LOG.TXT of the folder, and the step that follows looks like any other. Here the reset is off and the
counters of these warnings are asked after each sampling time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from simgap.errors import UserError


def keep_diverged_state(mujoco: Any, model: Any) -> None:
    """Let what diverges stay as it is, and MuJoCo write no file about it."""
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    mujoco.set_mju_user_warning(_silent)


def counters(mujoco: Any, data: Any) -> Any:
    """How often a position, velocity or acceleration was bad since the last reset: a view, (3,)."""
    kinds = mujoco.mjtWarning
    first, last = int(kinds.mjWARN_BADQPOS), int(kinds.mjWARN_BADQACC)
    return data.warning.number[first : last + 1]


def refuse_divergence(counted: Any, engine: str, where: Sequence[tuple[str, float]]) -> None:
    """Refuse a sampling time in which something was bad.

    Args:
        counted: of `counters`. engine: as in the case. where: names and values of state and input that it began with.

    Raises:
        UserError: what was bad, and from where.
    """
    if not np.any(counted):
        return
    names = [n for n, bad in zip(("position", "velocity", "acceleration"), counted, strict=True) if bad]
    at = ", ".join(f"{name} = {value:.9g}" for name, value in where)
    raise UserError(
        f"the engine '{engine}' diverges (no number, or beyond 1e10: {', '.join(names)}), at {at}",
        key="simulator.substeps",
        remedy="Take more substeps, weaker effects or contacts, or leave the place out of domain.X and domain.U.",
    )


def _silent(text: str) -> None:
    """The counters say it."""
