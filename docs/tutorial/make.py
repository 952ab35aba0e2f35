"""Makes `swings.csv`: a real rod, that is, one with dry friction in its hinge, which `rod.urdf` does not know.

    python docs/tutorial/make.py

Integrated by small steps on its own, so that nothing of simgap decides what simgap is to find. The angle is measured
with an encoder of 4096 steps a turn and no velocity.
"""

from pathlib import Path

import numpy as np

INERTIA, WEIGHT, FRICTION = 1.0 / 3.0, 9.81 * 0.5, 0.15  # kg m^2, N m, N m: 1 kg and 1 m about its end
STEP, EVERY, SECONDS = 1e-4, 100, 20.0


def torque(t: float) -> float:
    """The drive, N m: three tones, held for one sample."""
    return 1.6 * np.sin(2.1 * t) + 1.1 * np.sin(4.3 * t + 1.0) + 0.6 * np.sin(9.7 * t + 2.0)


def main() -> None:
    """Write the recording beside this file."""
    q = v = u = 0.0
    rows = []
    for k in range(round(SECONDS / STEP)):
        if k % EVERY == 0:
            u = round(torque(k * STEP), 4)
            rows.append((k * STEP, round(q * 4096 / (2 * np.pi)) * 2 * np.pi / 4096, u))
        push = u - WEIGHT * np.sin(q)
        held = v == 0.0 and abs(push) <= FRICTION
        after = 0.0 if held else v + STEP * (push - FRICTION * np.sign(v or push)) / INERTIA
        v = 0.0 if after * v < 0.0 else after  # it stops before it turns
        q += STEP * v
    lines = ["t,q,u", *(f"{t:.2f},{angle:.6f},{drive:.4f}" for t, angle, drive in rows)]
    (Path(__file__).parent / "swings.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
