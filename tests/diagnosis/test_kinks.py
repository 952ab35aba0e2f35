"""Effects with a kink are ranked by a trial of their size: at nothing they do something else."""

from __future__ import annotations

import numpy as np
import pytest
import sympy as sp

from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.watch import Watch
from simgap.diagnosis.seek import begun
from simgap.diagnosis.simulation.parts import parts_of
from simgap.model.symbolic import Coordinate, Parameter, SymbolicModel, Variable, symbol

R, L, K, J, B, DRY = 1.0, 1.1e-3, 0.05, 5e-4, 1e-4, 0.011


def _motor() -> SymbolicModel:
    """A DC motor with its winding: V drives the current, the current the rotor; SI units."""
    speed, current, volts = (symbol(n) for n in ("w", "i", "V"))
    r, ell, k, j, b = (symbol(n) for n in ("R", "L", "K", "J", "b"))
    values = {"R": (R, "ohm"), "L": (L, "H"), "K": (K, "N*m/A"), "J": (J, "kg*m^2"), "b": (B, "N*m*s")}
    return SymbolicModel(
        states=(Variable("angle", "rad"), Variable("w", "rad/s"), Variable("i", "A")),
        inputs=(Variable("V", "V"),),
        parameters={n: Parameter(v, unit) for n, (v, unit) in values.items()},
        xdot=(speed, (k * current - b * speed) / j, (volts - r * current - k * speed) / ell),
        coordinates=(Coordinate("rotor", "angle", "w", "N*m"),),
        force_map={"rotor": (sp.Integer(0), 1 / j, sp.Integer(0))},
    )


def _run(seed: int) -> Trace:
    """Ten seconds at 100 Hz by steps of 50 us."""
    rng, n, fine = np.random.default_rng(seed), 1000, 200
    t = np.arange(n) / 100.0
    f, phase = rng.uniform(0.1, 2.0, 5), rng.uniform(0, 2 * np.pi, 5)
    u = 2.0 * np.sin(2 * np.pi * f * t[:, None] + phase).sum(axis=1)
    q, w, i, h, out = 0.0, 0.0, 0.0, 0.01 / fine, []
    for k in range(n):
        out.append(q)
        for _ in range(fine):
            i += h * (u[k] - R * i - K * w) / L
            drive = K * i - B * w
            free = w + h * drive / J
            w = np.sign(free) * max(abs(free) - h * DRY / J, 0.0)  # dry friction, implicit
            q += h * w
    y = np.array(out) + 1e-5 * rng.standard_normal(n)
    return Trace(f"run{seed}", t, y[:, None], u[:, None])


def test_dry_friction_of_a_motor_with_a_winding_is_promised_most_and_at_its_size():
    """By a derivative at nothing it was promised a five-thousandth of its worth, at a thousandth of its size."""
    record = Record((_run(1), _run(2)), ("angle",), ("V",))
    parts, _ = parts_of(_motor(), record, DiagnosisSettings())
    search, base = begun(parts.known, (), Watch(None))
    ranked = search.ranked(search.empty(base))
    dry = next(s for s in ranked if s.candidate.key == ("coulomb_friction", "rotor"))
    assert dry.drop > 0.99 * ranked[0].drop  # a Stribeck peak contains it
    assert dry.values[dry.candidate.slots[0]] == pytest.approx(DRY, rel=0.05)
