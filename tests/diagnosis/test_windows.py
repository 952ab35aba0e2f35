"""Windows of plants whose motion depends on how it began: an unstable rest, wells; and the step that they need."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simgap.diagnosis import seek
from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.folds import split_windows
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.watch import Stopped, Watch
from simgap.diagnosis.simulation.initial import initial_states, runs_away
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.problem import build_problem
from simgap.diagnosis.simulation.refit import begun_afresh, refit, stand_out
from simgap.diagnosis.simulation.sensitivity import state_columns, state_steps
from simgap.diagnosis.simulation.supermodel import cached_supermodel
from simgap.late import sympy as sp
from simgap.model.symbolic import Coordinate, Parameter, SymbolicModel, Variable, symbol

POLE, WELLS, DEPTH = 12.0, 12, 200.0
DT, NOISE = 0.005, 1e-3


def on_a_line(force) -> SymbolicModel:
    """q'' = force(q, v, u), of unit mass."""
    q, v, u = (symbol(n) for n in ("q", "v", "u"))
    return SymbolicModel(
        states=(Variable("q", "rad"), Variable("v", "rad/s")),
        inputs=(Variable("u", "N*m"),),
        parameters={"m": Parameter(1.0, "kg*m^2")},
        xdot=(v, force(q, v, u)),
        coordinates=(Coordinate("joint", "q", "v", "N*m"),),
        force_map={"joint": (sp.Integer(0), sp.Integer(1))},
    )


def moved(force, x, inputs, fine=10):
    """The states (n, 2) under inputs that are held for DT, by Runge and Kutta's steps of a tenth of it."""
    h, states = DT / fine, [np.array(x, dtype=float)]
    for u in inputs(states):
        at = states[-1].copy()
        for _ in range(fine):
            rate = lambda y, u=u: np.array([y[1], force(y[0], y[1], u)])  # noqa: E731
            a = rate(at)
            b = rate(at + 0.5 * h * a)
            c = rate(at + 0.5 * h * b)
            at = at + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(at + h * c))
        states.append(at)
    return np.array(states)


def balanced(rng: np.random.Generator, seconds: float) -> Trace:
    """An unstable rest under a regulator that feels a rough reference, with noise on the position alone."""
    told: list[float] = []
    wanted = np.repeat(rng.uniform(-0.1, 0.1, int(seconds / 0.25) + 1), round(0.25 / DT))[: round(seconds / DT)]

    def regulator(states):
        for r in wanted:
            q, v = states[-1]
            told.append(float(-2.2 * POLE**2 * (q - r) - 1.8 * POLE * v))
            yield told[-1]

    x = moved(lambda q, v, u: POLE**2 * q + u, (0.0, 0.0), regulator)[:-1]
    y = x[:, :1] + NOISE * rng.standard_normal((len(x), 1))
    return Trace("run", np.arange(len(x)) * DT, y, np.array(told)[:, None])


def test_windows_of_an_unstable_plant_are_as_short_as_its_growth_bears():
    """A pole of 12 1/s grows by e^12 in a second, from which no start is fitted; nothing is missing."""
    rng = np.random.default_rng(91501)
    record = Record((balanced(rng, 12.0), balanced(rng, 12.0)), ("q",), ("u",))
    d = diagnose(on_a_line(lambda q, v, u: POLE**2 * q + u), record, DiagnosisSettings())
    assert d.verdict == "none"
    assert any("Windows of 0.5 s instead of 1 s" in w for w in d.warnings)


@pytest.mark.parametrize("late", [3, 8])
def test_a_speed_that_is_logged_whole_samples_late_is_told_where_torques_step(late):
    """What it shows at the start of a window is from before, where no parabola through the window leads."""
    runs, rng = [], np.random.default_rng(91513)
    for _ in range(2):
        plain = balanced(rng, 12.0)
        states = moved(lambda q, v, u: POLE**2 * q + u, (0.0, 0.0), lambda _, u=plain.u: u[:, 0])[:-1]
        speed = np.concatenate([np.zeros(late), states[:-late, 1]]) + 3e-3 * rng.standard_normal(len(states))
        runs.append(replace(plain, y=np.column_stack([plain.y, speed])))
    d = diagnose(
        on_a_line(lambda q, v, u: POLE**2 * q + u), Record(tuple(runs), ("q", "v"), ("u",)), DiagnosisSettings()
    )
    assert d.verdict == "none"
    (fault,) = d.recording
    assert (fault.fault, fault.channel) == ("late_log", "v")
    assert fault.value == pytest.approx(late * DT, abs=0.1 * DT)


def test_of_a_short_record_of_an_unstable_plant_both_reasons_for_short_windows_are_said():
    record = Record((balanced(np.random.default_rng(91507), 12.0),), ("q",), ("u",))
    _, said = parts_of(on_a_line(lambda q, v, u: POLE**2 * q + u), record, DiagnosisSettings(window_s=8.0))
    short, unstable = said
    assert short.startswith("The record is short: windows of 2 s instead of 8 s")
    assert unstable.startswith("Windows of 0.5 s instead of 2 s: in a longer one the model multiplies")


def test_what_drifts_or_swings_keeps_its_windows():
    rng = np.random.default_rng(91502)
    t = np.arange(1000) * DT
    record = Record((Trace("run", t, np.cos(5.0 * t)[:, None], rng.standard_normal((1000, 1))),), ("q",), ("u",))
    for force in (
        lambda q, v, u: u, lambda q, v, u: u - 25.0 * q, lambda q, v, u: u - 3.0 * v,
        lambda q, v, u: u - np.pi**2 * q, lambda q, v, u: u - (2.0 * np.pi) ** 2 * q,  # the middle sees nothing of v
    ):  # fmt: skip
        compiled = cached_supermodel(on_a_line(force), ("q",))
        assert not runs_away(build_problem(compiled, record, split_windows(record, 1.0), np.array([NOISE])))


@pytest.mark.parametrize("pole", [12.0, 24.0, 48.0])
def test_a_model_that_is_lost_within_a_window_runs_away(pole):
    rng = np.random.default_rng(91507)
    t = np.arange(1000) * DT
    record = Record((Trace("run", t, np.cos(5.0 * t)[:, None], rng.standard_normal((1000, 1))),), ("q",), ("u",))
    compiled = cached_supermodel(on_a_line(lambda q, v, u: pole**2 * q + u), ("q",))
    assert runs_away(build_problem(compiled, record, split_windows(record, 1.0), np.array([NOISE])))


def test_a_window_that_ended_in_another_well_is_begun_afresh():
    """Over twelve wells a turn a start that is off by a well's width ends where no small step leads out."""
    rng = np.random.default_rng(91503)
    wave = 8.0 * np.repeat(rng.uniform(-1.0, 1.0, 160), 10)
    x = moved(lambda q, v, u: u - DEPTH * np.sin(WELLS * q) - 2.0 * v, (0.3, 3.0), lambda _: iter(wave))[:-1]
    y = x[:, :1] + NOISE * rng.standard_normal((len(x), 1))
    record = Record((Trace("run", np.arange(len(x)) * DT, y, wave[:, None]),), ("q",), ("u",))
    model = on_a_line(lambda q, v, u: u - DEPTH * sp.sin(WELLS * q) - 2.0 * v)
    compiled = cached_supermodel(model, ("q",))
    problem = build_problem(compiled, record, split_windows(record, 1.0), np.array([NOISE]))
    null, bad = compiled.null, initial_states(problem)
    bad[[1, 4]] += [2.0 * np.pi / WELLS, 25.0]
    stuck = refit(problem, null, bad)
    lost = stand_out(problem, null, stuck.chi2)
    assert list(np.flatnonzero(lost)) == [1, 4]
    found = begun_afresh(problem, null, stuck, lost)
    assert np.all(found.chi2 < 1.3 * problem.counts)
    assert np.all(found.chi2 <= stuck.chi2)


def test_a_window_that_follows_the_few_readings_before_a_push_is_begun_afresh():
    """Where most of a window's readings are gross errors the fit follows the others; where few are it is right."""
    rng = np.random.default_rng(91511)
    wave = 3.0 * np.repeat(rng.uniform(-1.0, 1.0, 60), 10)
    x = moved(lambda q, v, u: u - 2.0 * v, (0.0, 0.5), lambda _: iter(wave))[:-1]
    y = x[:, :1] + NOISE * rng.standard_normal((len(x), 1))
    y[200:208] -= 1.0  # of the third window; of the fifth the last ones
    y[490:500] += 1.0
    record = Record((Trace("run", np.arange(len(x)) * DT, y, wave[:, None]),), ("q",), ("u",))
    compiled = cached_supermodel(on_a_line(lambda q, v, u: u - 2.0 * v), ("q",))
    plain = build_problem(compiled, record, split_windows(record, 1.0), np.array([NOISE]))
    problem, begin = replace(plain, usual=np.array([NOISE])), x[plain.windows.start].copy()
    begin[2, 0] -= 1.0
    stuck = refit(problem, compiled.null, begin)
    lost = stand_out(problem, compiled.null, stuck.chi2)
    assert list(np.flatnonzero(lost)) == [2]
    found = begun_afresh(problem, compiled.null, stuck, lost)
    assert found.x0[2, 0] == pytest.approx(x[plain.windows.start[2], 0], abs=5.0 * NOISE)


@pytest.mark.parametrize("suits", [True, False])
def test_an_answer_on_a_step_that_is_too_long_is_sought_again_on_half_of_it(suits, monkeypatch):
    rng = np.random.default_rng(91504)
    t, wave = np.arange(1600) * DT, 4.0 * np.repeat(rng.uniform(-1.0, 1.0, 160), 10)
    x = moved(lambda q, v, u: u - 2.0 * v, (0.0, 0.0), lambda _: iter(wave))[:-1]
    record = Record(
        (Trace("run", t, x[:, :1] + NOISE * rng.standard_normal((1600, 1)), wave[:, None]),), ("q",), ("u",)
    )
    settings = DiagnosisSettings(effects=("viscous_friction",))
    parts, _ = parts_of(on_a_line(lambda q, v, u: u), record, settings)
    under = seek.Hypothesis.of(parts, replace(settings, max_effects=1), {}, Watch()).searched()
    assert [c.key for c in under.found.members] == [("viscous_friction", "joint")]
    asked = iter([suits, True])
    monkeypatch.setattr(seek, "resolved_everywhere", lambda *_: next(asked))
    after = seek.on_its_step(under)
    assert after.parts.known.h_max == parts.known.h_max / (1 if suits else 2)
    assert (after is under) == suits
    assert after.found.fit.theta == pytest.approx(under.found.fit.theta, rel=1e-3)


def test_a_stop_on_a_finer_step_leaves_the_answer_before_it(monkeypatch):
    rng = np.random.default_rng(91506)
    t, wave = np.arange(1600) * DT, 4.0 * np.repeat(rng.uniform(-1.0, 1.0, 160), 10)
    x = moved(lambda q, v, u: u - 2.0 * v, (0.0, 0.0), lambda _: iter(wave))[:-1]
    y = x[:, :1] + NOISE * rng.standard_normal((1600, 1))
    record, settings = Record((Trace("run", t, y, wave[:, None]),), ("q",), ("u",)), DiagnosisSettings(max_effects=1)
    parts, _ = parts_of(on_a_line(lambda q, v, u: u), record, settings)
    under = seek.Hypothesis.of(parts, settings, {}, Watch()).searched()
    monkeypatch.setattr(seek, "resolved_everywhere", lambda *_: False)

    def stopped(self: Watch, best: str) -> None:
        self.stopped = "The search was stopped for a test"
        raise Stopped

    monkeypatch.setattr(Watch, "step", stopped)
    assert under.found.members
    assert seek.on_its_step(under) is under


@pytest.mark.parametrize(("slope", "off"), [(1e8, 1e-3), (1e5, 0.1)])
def test_a_window_that_bends_within_a_step_takes_a_shorter_one(slope, off):
    """Of x + 1e6 x^2 a step of 1e-7 from 0 is off by a tenth: by ten noises, and by a hundredth of one."""
    t = np.arange(200) * DT
    record = Record((Trace("run", t, np.zeros((200, 1)), np.zeros((200, 1))),), ("q",), ("u",))
    problem = parts_of(on_a_line(lambda q, v, u: u), record, DiagnosisSettings(window_s=0.2))[0].known
    x0 = np.zeros((len(problem.windows), 2))

    def missed(at, theta, x):
        return -slope * np.repeat(x[:, 0] + 1e6 * x[:, 0] ** 2, np.diff(at.rows))[:, None]

    _, columns = state_columns(problem, problem.model.null, x0, state_steps(x0), missed)
    assert columns[0] == pytest.approx(slope * (1.0 + off))


def test_an_effect_that_was_named_and_has_no_place_is_said():
    rng = np.random.default_rng(91509)
    record = Record(
        (Trace("run", np.arange(800) * DT, rng.standard_normal((800, 1)), np.zeros((800, 1))),), ("q",), ("u",)
    )
    settings = DiagnosisSettings(effects=("viscous_friction", "elasticity_behind_encoder"))
    _, said = parts_of(on_a_line(lambda q, v, u: 3.0 * u), record, settings)
    assert [w for w in said if "elasticity_behind_encoder was named and not sought" in w]
    assert not [w for w in said if "viscous_friction" in w]


def test_a_brief_time_is_no_longer_than_a_window():
    rng = np.random.default_rng(91505)
    record = Record(
        (Trace("run", np.arange(800) * DT, rng.standard_normal((800, 1)), np.zeros((800, 1))),), ("q",), ("u",)
    )
    compiled = cached_supermodel(on_a_line(lambda q, v, u: u), ("q",))
    problem = build_problem(compiled, record, split_windows(record, 1.0), np.ones(1))
    assert problem.brief == pytest.approx(0.2)
    fast = replace(problem, t=problem.t / 100.0)
    assert fast.brief == pytest.approx(0.01, rel=0.02)
