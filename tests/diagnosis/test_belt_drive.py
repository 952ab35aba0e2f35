"""Two masses on a belt, read at 500 Hz: a plant that swings many times within a window."""

from __future__ import annotations

import numpy as np
import sympy as sp
from scipy.linalg import expm

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.model.symbolic import Coordinate, NamedParameter, Parameter, SymbolicModel, Variable, symbol

DT, NOISE = 0.002, 2e-5
NUMBERS = {"m1": (0.8, "kg"), "m2": (1.5, "kg"), "k": (2500.0, "N/m"), "d": (2.0, "N*s/m"), "c": (3.0, "N*s/m")}


def belt_model() -> SymbolicModel:
    names = ("x1", "v1", "x2", "v2", "m1", "m2", "k", "d", "c", "F")
    x1, v1, x2, v2, m1, m2, k, d, c, force = (symbol(n) for n in names)
    pull = k * (x1 - x2) + d * (v1 - v2)
    return SymbolicModel(
        states=(Variable("x1", "m"), Variable("v1", "m/s"), Variable("x2", "m"), Variable("v2", "m/s")),
        inputs=(Variable("F", "N"),),
        parameters={n: Parameter(v, unit) for n, (v, unit) in NUMBERS.items()},
        xdot=(v1, (force - pull - c * v1) / m1, v2, (pull - c * v2) / m2),
        coordinates=(Coordinate("motor", "x1", "v1", "N"), Coordinate("load", "x2", "v2", "N")),
        force_map={
            "motor": (sp.Integer(0), 1 / m1, sp.Integer(0), sp.Integer(0)),
            "load": (sp.Integer(0), sp.Integer(0), sp.Integer(0), 1 / m2),
        },
        named_parameters={
            n: NamedParameter(n, v, u, {n: symbol(n) * symbol("ratio")}) for n, (v, u) in NUMBERS.items()
        },
    )


def belt_run(rng: np.random.Generator, seconds: float, ratio: float) -> Trace:
    """Exact for a force that is held: the matrix exponential."""
    m1, m2, k, d, c = (v for v, _ in NUMBERS.values())
    k *= ratio
    a = np.zeros((5, 5))
    a[:4] = [
        [0, 1, 0, 0, 0], [-k / m1, -(d + c) / m1, k / m1, d / m1, 1 / m1],
        [0, 0, 0, 1, 0], [k / m2, d / m2, -k / m2, -(d + c) / m2, 0],
    ]  # fmt: skip
    step, x, t = expm(a * DT), np.zeros(5), np.arange(0.0, seconds, DT)
    force = np.repeat(rng.uniform(-12.0, 12.0, len(t) // 100 + 1), 100)[: len(t)]
    out = []
    for f in force:
        x[4] = f
        out.append(x[[0, 2]])
        x = step @ x
    return Trace("run", t, np.array(out) + NOISE * rng.standard_normal((len(t), 2)), force[:, None])


def test_a_belt_a_fifth_too_soft_is_found_alone():
    """Its swings are a tenth slower than declared, and all else is right."""
    rng = np.random.default_rng(8117)
    record = Record((belt_run(rng, 6.0, 0.8), belt_run(rng, 6.0, 0.8)), ("x1", "x2"), ("F",))
    found = diagnose(belt_model(), record, DiagnosisSettings())
    assert found.verdict == "attributed"
    (effect,) = found.effects
    assert (effect.name, effect.on) == ("parameter_error", "k")
    low, high = effect.parameters["ratio"].ci95
    assert low < 0.8 < high
    assert high - low < 1e-3
