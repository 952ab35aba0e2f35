"""Makes `swings.csv`: the machine of `machine.urdf`, a heavier rod than `rod.urdf` says, on a hinge with friction.

    python docs/tutorial/make.py

The motion is integrated here by small steps, so that no code of simgap decides what simgap is to find. A PD law keeps
the rod upright while three tones move it. The angle is measured with an encoder of 4096 counts per turn, the velocity
is not.
"""

from pathlib import Path

import numpy as np

MASS, LENGTH, FRICTION = 1.3, 1.0, 0.2  # kg, m, N m s/rad
INERTIA, WEIGHT = MASS * LENGTH**2 / 3.0, 9.81 * MASS * LENGTH / 2.0  # kg m^2 about the hinge, N m
STEP, EVERY, SECONDS = 1e-4, 100, 20.0
COUNT = 2.0 * np.pi / 4096.0


def torque(t: float, angle: float, speed: float) -> float:
    """Tones and PD law, N m: from the measured angle (rad) and its difference quotient (rad/s)."""
    tones = 0.9 * np.sin(2.1 * t) + 0.7 * np.sin(5.3 * t + 1.0) + 0.5 * np.sin(11.7 * t + 2.0)
    return float(tones - 16.0 * angle - 2.5 * speed)


def main() -> None:
    """Write the recording beside this file."""
    q = v = u = read = 0.0
    rows = []
    for k in range(round(SECONDS / STEP)):
        if k % EVERY == 0:
            before, read = read, round(q / COUNT) * COUNT
            u = round(torque(k * STEP, read, (read - before) / (STEP * EVERY)), 4)
            rows.append((k * STEP, read, u))
        v += STEP * (u + WEIGHT * np.sin(q) - FRICTION * v) / INERTIA
        q += STEP * v
    lines = ["t,q,u", *(f"{t:.2f},{angle:.6f},{drive:.4f}" for t, angle, drive in rows)]
    (Path(__file__).parent / "swings.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
