"""A diagnosis made by hand: a pendulum with Coulomb friction that the model lacks, integrated by small Euler steps."""

import re

import numpy as np

from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.record.traces import FileNotes, Reading
from simgap.diagnosis.result import (
    Alternative,
    CandidateScore,
    Collinear,
    Diagnosis,
    Estimate,
    FoundEffect,
    Judged,
    Option,
    Step,
    WindowPrediction,
)
from simgap.effects import AppliedEffect

FRICTION, INERTIA, WEIGHT = 0.19, 0.25, 1.5
SIGMA = np.array([1e-3, 1e-2])

CASE = """\
name: bench
title: A pendulum on the bench
plant:
  states:
    q: {unit: rad}
    v: {unit: rad/s}
  inputs:
    u: {unit: N*m}
  symbolic:
    parameters:
      w: {value: 1.5, unit: N*m}
      J: {value: 0.25, unit: kg*m^2}
    dynamics:
      q: v
      v: (u - w*sin(q)) / J
    coordinates:
      hinge: {position: q, velocity: v, force_gain: 1/J}
"""


def torque(t):
    return 0.8 * np.sin(1.1 * t) + 0.7 * np.sin(3.1 * t + 1)


def simulate(t, x0, friction):
    """States at even stamps, (n, 2), by 50 semi-implicit Euler steps in each interval."""
    x, out, h = np.array(x0, dtype=float), [], (t[1] - t[0]) / 50
    for k in range(t.size):
        out.append(x.copy())
        for _ in range(50):
            x[1] += h * (torque(t[k]) - WEIGHT * np.sin(x[0]) - friction * np.tanh(x[1] / 1e-3)) / INERTIA
            x[0] += h * x[1]
    return np.array(out)


def record(seconds=12.0, rate=100.0, seed=3):
    t = np.arange(int(seconds * rate)) / rate
    y = simulate(t, [0.4, 0.0], FRICTION) + SIGMA * np.random.default_rng(seed).standard_normal((t.size, 2))
    return Record((Trace("bench", t, y, torque(t)[:, None]),), ("q", "v"), ("u",))


def windows(data, seconds=1.0):
    (trace,) = data.traces
    n = int(seconds / (trace.t[1] - trace.t[0]))
    out = []
    for k in range(len(trace.t) // n):
        s = slice(k * n, (k + 1) * n)
        true = simulate(trace.t[s], trace.y[s][0], FRICTION)
        declared = simulate(trace.t[s], trace.y[s][0], 0.0)
        out.append(
            WindowPrediction(
                "bench", k % 4 == 2, trace.t[s], trace.y[s], declared, true, true, trace.u[s], np.ones_like(true)
            )
        )
    return tuple(out)


def judged(q, v, chi2, ratio):
    return Judged({"q": 0.4 * q, "v": 0.4 * v}, 0.5, {"q": q, "v": v}, chi2, ratio)


def diagnosis(model, data, verdict="attributed"):
    effects = (
        (AppliedEffect("coulomb_friction", "hinge", {"F_c": 0.19}),) if verdict in ("attributed", "partial") else ()
    )
    found = FoundEffect(
        "coulomb_friction", "hinge", {"F_c": Estimate(0.19, (0.18, 0.2), "N*m")}, ((("stribeck_friction", "hinge"),),)
    )
    rows = (
        ("coulomb_friction", 4210.0, 4100.0, 1.01),
        ("viscous_friction", 2300.0, 1900.0, 43.0),
        ("cogging", 40.0, None, None),
    )
    return Diagnosis(
        verdict=verdict,
        effects=(found,) if effects else (),
        alternatives=(
            Alternative(
                (AppliedEffect("stribeck_friction", "hinge", {"F_c": 0.19, "F_s": 0.2, "v_s": 0.1}),), 4.0, False
            ),
        ),
        before=judged(0.05, 0.4, 80.0, 9.0),
        after=judged(0.0022, 0.012, 1.01, 1.02),
        floor=judged(0.002, 0.011, 1.0, 1.0),
        excess_share=0.16 if effects else 1.0,
        sigma={"q": 1e-3, "v": 1e-2},
        candidates=tuple(CandidateScore(n, "hinge", d, g, {}, "", left) for n, d, g, left in rows),
        collinear=(Collinear(("spring", "hinge"), ("parameter_error", "w"), 0.9994, "swing wider"),),
        folds={
            "fit": (("bench", 0.0, 2.0), ("bench", 3.0, 5.0), ("bench", 7.0, 9.0)),
            "choose": (("bench", 5.0, 6.0), ("bench", 9.0, 10.0)),
            "confirm": (("bench", 2.0, 3.0), ("bench", 6.0, 7.0)),
        },
        warnings=(),
        applied=effects,
        windows=windows(data),
        left_over=(),
        steps=(Step(80.0, tuple(Option(n, "hinge", left, g, k == 0) for k, (n, _, g, left) in enumerate(rows[:2]))),),
    )


def reading(data):
    note = FileNotes("bench.csv", "ab" * 32, 1200, 1200, 0.0, 0, 0, 0, 0, 0, (), ("bench",))
    return Reading(data, (note,), ())


def without_scripts(page):
    """The text of a page, what its scripts hold apart."""
    return re.sub(r"<script.*?</script>", "", page.read_text(), flags=re.DOTALL)
