"""What Drake itself makes of a system in continuous time."""

import numpy as np


def time_derivatives(system, x, u):
    """Drake's own numeric evaluation of dx/dt: states (n, nx), inputs (n, nu) -> (n, nx)."""
    context = system.CreateDefaultContext()
    out = np.empty_like(x, dtype=np.float64)
    for k in range(len(x)):
        context.SetContinuousState(x[k])
        if u.shape[1]:
            system.get_input_port().FixValue(context, u[k])
        out[k] = system.EvalTimeDerivatives(context).CopyToVector()
    return out
