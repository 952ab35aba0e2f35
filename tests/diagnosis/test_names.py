"""Names that deserve it: plants other than the pendulum, made by Euler steps that share nothing with the fit."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.effects import AppliedEffect, apply_effects
from simgap.model.symbolic import Coordinate, Parameter, SymbolicModel, Variable, symbol
from tests.diagnosis.plants import block

DT, FINE, MASS = 0.01, 10, 2.0
Force = Callable[[float, float, float], float]


def _run(seed: int, force: Force, seconds: float = 6.0, offset: float = 0.0, sigma: float = 1e-4) -> Trace:
    """A mass of 2 under a sum of sines and a force f(q, v, t) that the model lacks."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, DT)
    waves = zip(rng.uniform(0.5, 1.5, 3), (0.4, 0.9, 1.7), rng.uniform(0, 6, 3), strict=True)
    u = np.asarray(sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves))
    q, v, out = 0.2, 0.1, []
    for k, now in enumerate(t):
        out.append(q)
        for i in range(FINE):
            v += DT / FINE * (u[k] + force(q, v, now + i * DT / FINE)) / MASS
            q += DT / FINE * v
    y = np.array(out)[:, None] + offset + sigma * rng.standard_normal((len(t), 1))
    return Trace(f"run{seed}", t, y, u[:, None])


def _record(force: Force, **more: float) -> Record:
    return Record(tuple(_run(seed, force, **more) for seed in (1, 2, 3)), ("q",), ("u",))


def rotor() -> SymbolicModel:
    """A motor's rotor: J a = u, an angle that winds."""
    j = symbol("J")
    return SymbolicModel(
        states=(Variable("q", "rad"), Variable("v", "rad/s")),
        inputs=(Variable("u", "N*m"),),
        parameters={"J": Parameter(MASS, "kg*m^2")},
        xdot=(symbol("v"), symbol("u") / j),
        coordinates=(Coordinate("shaft", "q", "v"),),
        force_map={"shaft": (symbol("v") * 0, 1 / j)},
    )


def _spring(k: float) -> SymbolicModel:
    return apply_effects(block(), (AppliedEffect("spring", "slide", {"k": k}),)) if k else block()


@pytest.mark.parametrize(("k", "offset", "seen"), [(0.0, 0.0, False), (0.0, 1000.0, False), (1e-4, 0.0, True)])
def test_an_offset_that_nothing_measures_absolutely_is_never_tried(k, offset, seen):
    """A free mass is the same anywhere; a spring that swings it once in 15 minutes is enough to tell in principle."""
    record = _record(lambda q, v, t: -k * q - 0.5 * v, offset=offset)
    d = diagnose(_spring(k), record, DiagnosisSettings(effects=("sensor_offset", "viscous_friction"), max_effects=2))
    assert [(e.name, e.on) for e in d.effects] == [("viscous_friction", "slide")]
    (row,) = (c for c in d.candidates if c.name == "sensor_offset")
    assert (row.rejected != "these data do not show it") == seen
    if not seen:
        assert (row.chi2_drop, row.bic_gain, row.parameters) == (0.0, None, {})


def test_periodic_effects_act_on_what_turns():
    record = _record(lambda q, v, t: -0.5 * v)
    named = DiagnosisSettings(effects=("cogging", "viscous_friction"), max_effects=1)
    assert {c.on for c in diagnose(block(), record, named).candidates if c.name == "cogging"} == set()
    assert {c.on for c in diagnose(rotor(), record, named).candidates if c.name == "cogging"} == {"shaft"}


def test_springs_pull_a_wound_angle_back_only_if_they_are_named():
    record = _record(lambda q, v, t: 1.0 - 0.2 * v)  # driven round and round
    assert max(float(np.ptp(trace.y)) for trace in record.traces) > 2 * np.pi
    free = diagnose(rotor(), record, DiagnosisSettings(max_effects=2))
    rows = {c.name: c for c in free.candidates}
    assert {(e.name, e.on) for e in free.effects} == {("viscous_friction", "shaft"), ("input_bias", "u")}
    assert all("full turns" in rows[n].rejected and rows[n].chi2_drop == 0.0 for n in ("spring", "cubic_spring"))
    assert not any(a.name.endswith("spring") for s in free.alternatives for a in s.effects)
    named = diagnose(rotor(), record, DiagnosisSettings(effects=("spring", "viscous_friction"), max_effects=2))
    assert "full turns" not in {c.name: c for c in named.candidates}["spring"].rejected


def _push(q: float, v: float, t: float) -> float:
    """What the library has nothing for."""
    return 0.25 * np.sin(2 * np.pi * 3.1 * t)


def test_a_constant_force_that_is_left_is_told_of():
    """One effect may be named; the other is in the library, and the sentence must not say that nothing explains it."""
    record = _record(lambda q, v, t: _push(q, v, t) - 6.0 * q + 0.3)
    settings = DiagnosisSettings(noise={"q": 1e-4}, effects=("spring", "input_bias"), max_effects=1)
    d = diagnose(block(), record, settings)
    told = [(e.name, e.on) for e in d.effects] + [(e.name, e.on) for e in (d.nearest.effects if d.nearest else ())]
    assert len(told) == 1
    (left,) = d.left_over or ()
    assert {left.effect.name, told[0][0]} == {"spring", "input_bias"}
    assert 0.1 < left.share <= 1.0


def test_an_effect_beside_a_force_of_its_size_is_told_with_its_share_and_interval():
    """It takes a part of the error away, surely: told as that part, whatever is left."""
    record = _record(lambda q, v, t: 1.5 * _push(q, v, t) - 0.35 * v)
    d = diagnose(block(), record, DiagnosisSettings(noise={"q": 1e-4}, effects=("viscous_friction",)))
    assert d.verdict == "partial"
    (found,) = d.effects
    assert found.name == "viscous_friction"
    assert found.parameters["b"].value == pytest.approx(0.35, rel=0.2)
    share, least, most = d.explained_error
    assert 0.0 < least < share < most < 0.7


def test_what_falls_short_is_told_with_its_share_and_reasons():
    record = _record(lambda q, v, t: 1.5 * _push(q, v, t) - 0.12 * v)
    d = diagnose(block(), record, DiagnosisSettings(noise={"q": 1e-4}, effects=("viscous_friction",)))
    assert d.verdict == "unexplained"
    assert d.effects == ()


def test_sets_that_do_as_well_are_listed_once():
    """A mass, a gain of a mass under a force and of its only sensor are one; off the noise all are told, once."""
    record = _record(lambda q, v, t: _push(q, v, t))
    scaled = tuple(Trace(r.name, r.t, r.y, r.u * 0.6) for r in record.traces)
    settings = DiagnosisSettings(noise={"q": 1e-4}, effects=("input_gain", "parameter_error"), max_effects=1)
    d = diagnose(block(), Record(scaled, ("q",), ("u",)), settings)
    assert d.verdict == "partial"
    sets = [frozenset((e.name, e.on) for e in a.effects) for a in d.alternatives]
    assert len(sets) == len(set(sets)) == 2
    assert {(e.name, e.on) for e in d.effects} == {("parameter_error", "mass")}
    assert frozenset().union(*sets) == {("input_gain", "u"), ("sensor_gain", "q")}
