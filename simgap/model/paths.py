"""Where the nominal model is between two samples."""

from __future__ import annotations

import numpy as np

from simgap.arrays import Floats
from simgap.late import sympy as sp
from simgap.model.integrators import discretise
from simgap.model.symbolic import SymbolicModel


def nominal_paths(
    model: SymbolicModel, integrator: str, tau: float, start: Floats, inputs: Floats, poses: int
) -> tuple[Floats, float]:
    """States after 1/poses, 2/poses, ..., all of tau from one state under each input held.

    Args:
        start: (nx,); inputs: (M, nu).

    Returns:
        (M, poses, nx), and how far the path between two of them may bulge out of the line through them, in state units:
        an eighth of the largest second difference, a tenth more for what second differences miss.
    """
    symbols = [v.symbol for v in (*model.states, *model.inputs)]
    columns = [*start, *inputs.T]
    out = np.empty((len(inputs), poses, len(start)))
    for k in range(poses):
        f = sp.lambdify(symbols, discretise(model, tau * (k + 1) / poses, integrator), "numpy")
        for i, values in enumerate(f(*columns)):
            out[:, k, i] = values
    path = np.concatenate([np.broadcast_to(start, (len(inputs), 1, len(start))), out], axis=1)
    bulge = np.abs(np.diff(path, n=2, axis=1)).max() / 8.0 if poses > 1 else np.abs(np.diff(path, axis=1)).max()
    return out, 1.1 * float(bulge)
