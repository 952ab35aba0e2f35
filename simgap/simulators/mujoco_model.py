"""A model of MuJoCo with its data; a motion that diverges is refused.

Left to itself MuJoCo puts what diverges back to where it began and goes on: `mj_step` resets its data when a position,
velocity or acceleration is no number or beyond 1e10, prints a line into a file MUJOCO_LOG.TXT of the folder, and the
step that follows looks like any other. Here the reset is off and the counters of these warnings are asked after each
sampling time.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from simgap.errors import UserError
from simgap.plants.model_file import Link
from simgap.simulators.mjcf import require_mujoco


class MuJoCoModel:
    """A compiled model, and its data, which a step changes.

    Attributes:
        mujoco: the module. engine: MuJoCo with its version.
    """

    def __init__(self, model: Any) -> None:
        """Let what diverges stay as it is, and MuJoCo write no file about it."""
        self.mujoco, self.model = require_mujoco(), model
        self.engine = f"mujoco {self.mujoco.__version__}"
        model.opt.disableflags |= self.mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.mujoco.set_mju_user_warning(_silent)
        self.data = self.mujoco.MjData(model)
        kinds = self.mujoco.mjtWarning
        # how often a position, velocity or acceleration was bad since the last reset: a view, (3,)
        self._bad = self.data.warning.number[int(kinds.mjWARN_BADQPOS) : int(kinds.mjWARN_BADQACC) + 1]

    def reset(self) -> None:
        """Fresh data."""
        self.mujoco.mj_resetData(self.model, self.data)

    def step(self, count: int = 1) -> None:
        """So many engine steps."""
        self.mujoco.mj_step(self.model, self.data, count)

    def links(self, first: int) -> dict[str, Link]:
        """Bodies from number `first` on as MuJoCo computes with them; links on fixed joints are part of others."""
        m = self.model
        return {
            m.body(k).name: Link(float(m.body_mass[k]), np.sort(m.body_inertia[k]), np.array(m.body_ipos[k]))
            for k in range(first, m.nbody)
        }

    @property
    def has_diverged(self) -> bool:
        """True if something was bad since the last reset."""
        return any(self._bad)

    def diverged(self, engine: str, where: Iterable[tuple[str, float]]) -> UserError:
        """Error about what was bad.

        Args:
            engine: as in the case. where: names and values of state and input that the sampling time began with.
        """
        names = [n for n, bad in zip(("position", "velocity", "acceleration"), self._bad, strict=True) if bad]
        at = ", ".join(f"{name} = {value:.9g}" for name, value in where)
        return UserError(
            f"the engine '{engine}' diverges (no number, or beyond 1e10: {', '.join(names)}), at {at}",
            key="simulator.substeps",
            remedy="Take more substeps, weaker effects or contacts, or leave the place out of domain.X and domain.U.",
        )


def _silent(text: str) -> None:
    """The counters say it."""
