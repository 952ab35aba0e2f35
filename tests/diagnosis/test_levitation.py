"""A ball held in the air by a coil: an unstable plant with a singularity, whose constants only act together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose, ready
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.model.symbolic import Coordinate, NamedParameter, Parameter, SymbolicModel, Variable, symbol

M, C, G = 0.068, 1.1e-4, 9.81
DT, NOISE = 1e-3, 6e-6


def levitation() -> SymbolicModel:
    z, v, i, m, c, g = (symbol(n) for n in ("z", "v", "i", "m", "C", "g"))
    numbers = {"m": (M, "kg"), "C": (C, "N*m^2/A^2"), "g": (G, "m/s^2")}
    return SymbolicModel(
        states=(Variable("z", "m"), Variable("v", "m/s")),
        inputs=(Variable("i", "A"),),
        parameters={n: Parameter(value, unit) for n, (value, unit) in numbers.items()},
        xdot=(v, g - c * i**2 / (m * z**2)),
        coordinates=(Coordinate("ball", "z", "v", "N"),),
        force_map={"ball": (z * 0, 1 / m)},
        named_parameters={
            n: NamedParameter(n, v, u, {n: symbol(n) * symbol("ratio")}) for n, (v, u) in numbers.items()
        },
    )


def _held(rng: np.random.Generator, seconds: float, coil: float) -> Trace:
    """Under a regulator that knows the declared coil; RK4 in thirds of a sample."""
    t = np.arange(0.0, seconds, DT)
    wanted = np.repeat(rng.uniform(0.0105, 0.0145, len(t) // 400 + 1), 400)
    turns, phase = 2 * math.pi * np.exp(rng.uniform(math.log(4), math.log(40), 6)), rng.uniform(0, 2 * math.pi, 6)
    x, h, read, current = np.array([0.012, 0.0]), DT / 3, [], []

    def rate(x: np.ndarray, i: float) -> np.ndarray:
        return np.array([x[1], G - coil * C * i * i / (M * x[0] ** 2)])

    for k, now in enumerate(t):
        force = max(0.01, M * (G + 900 * (x[0] - wanted[k]) + 55 * x[1]))
        i = min(max(math.sqrt(force / C) * x[0] + 0.02 * float(np.sum(np.sin(turns * now + phase))), 0.05), 3.0)
        read.append(x[0])
        current.append(i)
        for _ in range(3):
            a = rate(x, i)
            b = rate(x + h / 2 * a, i)
            c = rate(x + h / 2 * b, i)
            x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, i))
    y = np.array(read) + NOISE * rng.standard_normal(len(t))
    return Trace("run", t, y[:, None], np.array(current)[:, None])


def test_a_weak_coil_is_found_with_what_is_the_same_and_no_column_is_blamed():
    """Only C / m shows. As declared a window ends in the singularity; with the reading reversed it never does."""
    rng = np.random.default_rng(90431)
    record = Record((_held(rng, 4.0, 0.91), _held(rng, 4.0, 0.91)), ("z",), ("i",))
    d = diagnose(levitation(), record, DiagnosisSettings(window_s=0.1, horizon_s=0.04))
    assert (d.verdict, d.recording) == ("attributed", ())
    sets = [d.effects, *(a.effects for a in d.alternatives)]
    ratios = {e.on: e for (e,) in sets}
    assert {"m", "C", "i"} <= set(ratios)
    (found,) = d.effects
    lo, hi = found.parameters["ratio"].ci95
    truth = {"m": 1 / 0.91, "C": 0.91, "i": math.sqrt(0.91)}[found.on]
    assert lo <= truth <= hi


@pytest.mark.parametrize("coil", [0.8, 0.91, 1.35])
def test_windows_are_as_short_as_errors_grow_along_the_readings(coil):
    """As declared the ball falls away or is caught: calm or lost within a second, and no reading is turned round."""
    rng = np.random.default_rng(71103)
    record = Record((_held(rng, 6.0, coil),), ("z",), ("i",))
    (own,) = ready(levitation(), record, DiagnosisSettings())
    assert (own.parts.window_s, own.parts.horizon_s) == (0.125, 0.125)
    assert own.said[0].startswith("Windows of 0.125 s instead of 1 s")
    assert own.faults == ()
