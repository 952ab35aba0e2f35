"""Faults of a recording are told apart from what the plant lacks, on plants that share no code with the fit."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from simgap.diagnosis.diagnose import diagnose
from simgap.diagnosis.record.faults.columns import SwappedColumns
from simgap.diagnosis.record.faults.hum import Hum
from simgap.diagnosis.record.faults.readings import SaturatedReading, Stale
from simgap.diagnosis.record.faults.registry import READINGS, mended
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.columns import Columns, better_columns
from simgap.diagnosis.search.noise_colour import _law
from simgap.diagnosis.simulation.coarse import coarse
from simgap.diagnosis.simulation.noise_law import Colour, whiten
from simgap.diagnosis.simulation.parts import parts_of
from tests.diagnosis import rigs
from tests.diagnosis.plants import block
from tests.undeclared.counted import counted_model, counted_record
from tests.undeclared.nominals import nominal, record
from tests.undeclared.rig.textbook import Hidden, cart_pole, oscillator

FEW = DiagnosisSettings(effects=("viscous_friction", "coulomb_friction", "input_gain", "input_delay", "spring"))


def _repaired(made):
    return mended(made, rigs.oscillator_model(), READINGS)


def _without_hum(made):
    return Hum().mend(made, rigs.oscillator_model())


def _diagnosed(rig, fault, seed=1, **hidden):
    return diagnose(rig.model, rigs.record(rig, fault, seed, seconds=6.0, **hidden), FEW)


@pytest.mark.parametrize("fault", ["coloured noise", "drift", "input late", "velocity filtered"])
def test_a_perfect_model_under_a_fault_lacks_nothing(fault):
    d = _diagnosed(rigs.pendulum(), fault)
    assert d.verdict == "none"
    assert not d.effects
    assert [f.fault for f in d.recording] == [rigs.FAULTS[fault][1]]


def test_an_effect_is_named_beside_the_fault_and_its_interval_holds():
    for fault in ("coloured noise", "input late"):
        d = _diagnosed(rigs.oscillator(), fault, viscous=0.3)
        assert d.verdict == "attributed"
        (found,) = d.effects
        assert found.name == "viscous_friction"
        lo, hi = found.parameters["b"].ci95
        assert lo <= 0.3 <= hi
        assert [f.fault for f in d.recording] == [rigs.FAULTS[fault][1]]


def test_noise_that_remembers_is_told_where_three_effects_had_stood_in_for_it():
    """Under noise taken for white every effect that bends to it seems to pay, up to as many as are tried anyhow."""
    made, keep, rng = record(oscillator(), Hidden(viscous={"slide": 0.32}), 0), np.exp(-1 / 3), np.random.default_rng(9)
    noisy = []
    for run in made.traces:
        e = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(run.y.shape), axis=0)
        noisy.append(replace(run, y=run.y + 1e-3 * e))
    d = diagnose(nominal("oscillator"), replace(made, traces=tuple(noisy)))
    sets = [{(e.name, e.on) for e in d.effects}, *({(e.name, e.on) for e in a.effects} for a in d.alternatives)]
    assert d.verdict == "attributed"
    assert {("viscous_friction", "slide")} in sets
    assert [f.fault for f in d.recording] == ["coloured_noise"]


def test_the_size_of_a_fault_is_told():
    late, drift = (_diagnosed(rigs.pendulum(), f).recording[0] for f in ("input late", "drift"))
    assert late.value == pytest.approx(0.01, rel=0.05)
    assert drift.value == pytest.approx(4e-3, rel=0.05)


def test_errors_of_prediction_are_white():
    rng, dt = np.random.default_rng(5), 0.005
    y = rigs.ar1(rng, 40_000, 0.8, 0.03, dt) + 0.6 * rng.standard_normal(40_000)
    colour = Colour(np.array([0.64]), np.array([0.03]), dt)
    e = y[:, None].copy()
    whiten(e, np.array([0, len(e)]), *colour.memory)
    assert np.std(e) == pytest.approx(1.0, abs=0.02)
    assert abs(np.corrcoef(e[1:, 0], e[:-1, 0])[0, 1]) < 0.015
    means = y.reshape(-1, 5).mean(axis=1)
    after, spread = colour.of_blocks(5, True)
    e = means[:, None] / spread
    whiten(e, np.array([0, len(e)]), *after.memory)
    assert np.std(e) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("fault", ["stale", "spikes", "hum"])
def test_readings_that_are_none_are_found_and_the_others_left(fault):
    for rig in (rigs.pendulum(), rigs.oscillator()):
        dirty, clean_ = (rigs.record(rig, f, 3, seconds=6.0, coulomb=0.1) for f in (fault, "clean"))
        clear, said = _repaired(dirty)
        clear, lines = _without_hum(clear)
        assert [f.fault for f in (*said, *lines)] == [rigs.FAULTS[fault][1]]
        for a, b in zip(clear.traces, clean_.traces, strict=True):
            used = a.compared > 0.0
            assert used.mean() > 0.9
            assert np.std((a.y - b.y)[used]) < 2e-3  # noise alone, of 1e-3 in each
        assert _repaired(clean_) == (clean_, ())
        assert _without_hum(clean_)[1] == ()


def _counted(motion, seconds=30.0, rate=100.0, step=4e-5):
    """An encoder's readings of a motion (function of time), and the record of it."""
    t = np.arange(int(seconds * rate)) / rate
    y = np.round(motion(t) / step) * step
    return t, y, lambda y: Record((Trace("run", t, y[:, None], np.zeros((len(t), 1))),), ("q",), ("force",))


def test_what_turns_round_or_breaks_away_under_an_encoder_repeats_counts_and_is_not_stale():
    turning = lambda t: 0.03 * np.sin(2.0 * np.pi * 2.9 * t) + 0.05 * np.sin(2.0 * np.pi * 0.61 * t)  # noqa: E731
    resting = lambda t: np.cumsum(np.sign(turning(t)) * np.maximum(np.abs(turning(t)) - 0.02, 0.0)) / 20.0  # noqa: E731
    for motion in (turning, resting):
        _, y, record = _counted(motion)
        repeats = np.diff(y) == 0.0
        assert repeats.sum() > 5
        assert _repaired(record(y))[1] == ()


def test_stale_readings_of_an_encoder_are_found():
    t, y, record = _counted(lambda t: 0.05 * np.sin(2.0 * np.pi * 0.61 * t) + 0.01 * np.sin(2.0 * np.pi * 2.9 * t))
    hit = np.zeros(len(t), dtype=bool)
    hit[7::33] = True
    dirty = y.copy()
    dirty[hit] = dirty[np.flatnonzero(hit) - 1]
    clear, (fault,) = _repaired(record(dirty))
    assert fault.fault == "stale"
    found = ~clear.traces[0].used[:, 0]
    assert not found[~hit].any()
    assert found[hit].mean() > 0.8


def test_a_reading_that_is_no_measurement_counts_for_nothing():
    rig = rigs.oscillator()
    trace = rigs.record(rig, "clean", 4, seconds=6.0).traces[0]
    y, used = trace.y.copy(), np.ones(trace.y.shape, dtype=bool)
    y[5::20], used[5::20] = y[5::20] + 0.05, False
    record = Record((replace(trace, y=y, used=used),), ("q",), ("force",))
    d = diagnose(rig.model, record, replace(FEW, noise={"q": 1e-3}))
    assert d.verdict == "none"
    assert d.before.fit_rmse["q"] < 2e-3


def test_columns_in_another_unit_or_place_are_found():
    wanted = [
        (rigs.pendulum(), "position in degrees", ("wrong_unit", "angle", np.pi / 180)),
        (rigs.oscillator(), "input in thousandths", ("wrong_unit", "force", 1e-3)),
        (rigs.oscillator(), "columns swapped", ("swapped_columns", "q, v", None)),
        (rigs.oscillator(), "clean", None),
    ]
    for rig, fault, answer in wanted:
        parts, _ = parts_of(rig.model, rigs.record(rig, fault, 1, seconds=6.0, viscous=0.2), FEW)
        found = better_columns(coarse(parts.known), (), {})
        assert (found and (found.finding.fault, found.finding.channel, found.finding.value)) == answer


@pytest.mark.parametrize(
    ("plant", "of_input", "factor", "wanted"),
    [
        ("ball", False, 1e3, ("wrong_unit", "q", 1e-3)),
        ("ball", True, 180 / np.pi, ("wrong_unit", "u", np.pi / 180)),
        ("spring", False, 1e3, ("wrong_unit", "q", 1e-3)),
        ("motor", False, 180 / np.pi, ("wrong_unit", "q", np.pi / 180)),
        ("motor", True, 1e3, ("wrong_unit", "u", 1e-3)),
        ("spring", False, 1.0, None),
        ("ball", False, 1.0, None),
    ],
)
def test_strong_friction_hides_no_wrong_unit(plant, of_input, factor, wanted):
    """Friction that takes most of the force, and a column in millimetres, degrees or milliamperes."""
    made, _ = counted_record(plant, "both", 5e-5, 3, seconds=8.0)
    traces = tuple(replace(r, u=r.u * factor) if of_input else replace(r, y=r.y * factor) for r in made.traces)
    parts, _ = parts_of(counted_model(plant), replace(made, traces=traces), DiagnosisSettings())
    found = better_columns(coarse(parts.known), (), {})
    assert (found and (found.finding.fault, found.finding.channel, found.finding.value)) == wanted
    if (plant, of_input) == ("spring", False) and found is not None:  # linear: a motion cannot tell
        assert found.finding.sentence.endswith("with u in a thousand times the declared unit.")


def test_swapped_columns_are_exchanged_and_the_model_lacks_nothing():
    d = _diagnosed(rigs.oscillator(), "columns swapped")
    assert (d.verdict, d.effects) == ("none", ())
    assert [f.fault for f in d.recording] == ["swapped_columns"]


@pytest.mark.parametrize(("speed", "found"), [(5.0, []), (0.0, ["hum"])])
def test_the_lines_of_a_shaft_that_turns_steadily_are_no_hum(speed, found):
    """Cogging of 24 teeth at 5 rad/s: a line at 19.1 Hz, which a force makes."""
    t, rng = np.arange(4000) / 200.0, np.random.default_rng(4)
    slow = 0.3 * np.sin(0.9 * t)
    q = speed * t + slow + 2e-3 * np.sin(24 * (5.0 * t)) + 1e-4 * rng.standard_normal(len(t))
    _, faults = _without_hum(Record((Trace("a", t, q[:, None], np.zeros((len(t), 0))),), ("q",), ()))
    assert [f.fault for f in faults] == found


def test_a_resonance_that_an_input_of_changing_size_drives_is_no_hum():
    """Its tones are broad, so that none of them stands out of the input as the resonance does of the reading."""
    rng, dt = np.random.default_rng(71104), 0.05
    t = dt * np.arange(1200)
    tones, phases = np.linspace(1.2, 8.0, 12), rng.uniform(0.0, 6.28, 12)
    u = np.sin(np.outer(t, tones) + phases).sum(axis=1) * (0.3 + 0.7 * np.sin(0.2 * t) ** 2)
    pole = np.exp(dt * (tones[5] + 0.03) * (-0.01 + 1j))
    y = lfilter([dt**2], [1.0, -2.0 * pole.real, abs(pole) ** 2], u) + 1e-4 * rng.standard_normal(len(t))
    made = Record((Trace("run", t, y[:, None], u[:, None]),), ("q",), ("u",))
    assert Hum().mend(made, nominal("oscillator"))[1] == ()
    still = Record((Trace("run", t, y[:, None], 0.0 * u[:, None]),), ("q",), ("u",))
    assert Hum().mend(still, nominal("oscillator"))[1] != ()


@pytest.mark.parametrize(("noise", "found"), [(2.0, ["stale"]), (0.2, [])])
def test_a_sensor_that_stands_still_in_its_own_noise_is_stuck(noise, found):
    """Of less than a count: a rest."""
    rng = np.random.default_rng(71105)
    t = 0.002 * np.arange(10_000)
    y = np.round(300.0 * np.sin(0.9 * t) * (np.abs(np.sin(0.9 * t)) < 0.99) + noise * rng.standard_normal(len(t)))
    y[4000:4120] = y[4000]
    made = Record((Trace("run", t, y[:, None], np.ones((len(t), 1))),), ("q",), ("u",))
    stuck, faults = Stale().mend(made, nominal("oscillator"))
    assert [f.fault for f in faults] == found
    if found:
        assert 100 < np.sum(stuck.traces[0].compared == 0.0) < 140


def test_a_line_of_one_trace_alone_is_no_hum():
    t, rng = np.arange(4000) / 200.0, np.random.default_rng(4)
    traces = []
    for name, size in (("a", 2e-3), ("b", 0.0)):
        q = 0.3 * np.sin(0.9 * t) + size * np.sin(120.0 * t) + 1e-4 * rng.standard_normal(len(t))
        traces.append(Trace(name, t, q[:, None], np.zeros((len(t), 0))))
    assert _without_hum(Record(tuple(traces), ("q",), ()))[1] == ()
    assert len(_without_hum(Record(tuple(traces[:1]), ("q",), ()))[1]) == 1


def test_windows_of_a_few_samples_have_no_law_of_the_noise():
    assert _law(np.ones(2), 5.0, 0.125, 1.0, (2, 3)) is None


def test_what_a_force_leaves_one_integration_away_is_no_noise_of_a_sensor():
    """A spectrum that falls with the second power from below the motion on: of a position noise, of a level a flow."""
    n, dt, motion = 200, 0.14, 0.5
    turn = 2.0 * np.pi * np.arange(1, n // 2) / n / dt
    slow, quick = (1.0 + size / (1.0 + (turn * tau) ** 2) for size, tau in ((4e4, 10.0), (40.0, 0.4)))
    assert _law(slow, 20.0, dt, motion, (2, 3)) is not None
    assert _law(slow, 20.0, dt, motion, (1, 2, 3)) is None
    assert _law(quick, 20.0, dt, motion, (1, 2, 3)) is not None  # from above the motion on


@pytest.mark.parametrize("hidden", [{}, {"viscous": 0.3}, {"viscous": 3.0}, {"coulomb": 1.0}])
def test_swapped_columns_are_told_by_the_derivative_however_much_is_missing(hidden):
    for rig in (rigs.pendulum(), rigs.oscillator()):
        swapped, good = (rigs.record(rig, f, 1, 6.0, **hidden) for f in ("columns swapped", "velocity filtered"))
        back, found = SwappedColumns().mend(swapped, rig.model)
        assert [(f.fault, f.channel) for f in found] == [("swapped_columns", ", ".join(rig.states))]
        assert all(np.array_equal(a.y, b.y[:, ::-1]) for a, b in zip(back.traces, swapped.traces, strict=True))
        assert SwappedColumns().mend(good, rig.model) == (good, ())


def test_friction_behind_swapped_columns_is_named():
    """Strong friction beside a swap was a spring and a filter, `partial`."""
    d = _diagnosed(rigs.pendulum(), "columns swapped", viscous=0.3)
    assert (d.verdict, [e.name for e in d.effects]) == ("attributed", ["viscous_friction"])
    lo, hi = d.effects[0].parameters["b"].ci95
    assert lo <= 0.3 <= hi
    assert [f.fault for f in d.recording] == ["swapped_columns"]


def test_a_reading_that_is_logged_later_than_the_others_is_told_with_its_size():
    """The place of a cart that rubs is logged 20 ms after the angle of its pole."""
    plant, rubs = cart_pole(), 0.6
    good = record(plant, Hidden(viscous={"cart": rubs}), 3, seconds=8.0)
    traces = tuple(Trace(r.name, r.t[2:], np.stack([r.y[:-2, 0], r.y[2:, 1]], axis=1), r.u[2:]) for r in good.traces)
    settings = DiagnosisSettings(effects=("viscous_friction", "coulomb_friction", "input_gain", "input_delay"))
    late, clean_ = (
        diagnose(nominal("cart_pole"), r, settings) for r in (Record(traces, plant.measured, plant.inputs), good)
    )
    assert [(f.fault, f.channel) for f in late.recording] == [("late_log", "x")]
    assert late.recording[0].value == pytest.approx(0.02, rel=0.02)
    assert clean_.recording == ()
    for d in (late, clean_):
        assert d.verdict == "attributed"
        (effect,) = d.effects
        assert (effect.name, effect.on) == ("viscous_friction", "cart")
        assert effect.parameters["b"].value == pytest.approx(rubs, rel=0.02)


@pytest.mark.parametrize("speed_too", [True, False])
def test_no_delay_of_the_log_stands_for_a_force_outside_the_library(speed_too):
    """As long as a window it would leave nothing of it to compare."""
    rng, runs = np.random.default_rng(71108), []
    t = 0.01 * np.arange(1000)
    for k in range(3):
        u = 2.0 * np.sin(np.outer(t, (2.5, 6.0, 11.0)) + rng.uniform(0.0, 6.28, 3)).sum(axis=1)
        q, v, states = 0.2, 0.0, []
        for now in u:
            states.append((q, v))
            for _ in range(20):
                v += 5e-4 * (now + 3.0 * np.sin(25.0 * q) + 2.0 * np.cos(17.0 * v)) / 2.0
                q += 5e-4 * v
        y = np.array(states)[:, : 1 + speed_too] + 1e-3 * rng.standard_normal((1000, 1 + speed_too))
        runs.append(Trace(f"run{k}", t, y, u[:, None]))
    few = DiagnosisSettings(effects=("spring", "viscous_friction", "coulomb_friction"))
    d = diagnose(block(), Record(tuple(runs), ("q", "v")[: 1 + speed_too], ("u",)), few)
    assert d.verdict not in ("none", "attributed")
    assert not any(f.fault == "late_log" for f in d.recording)


def test_a_unit_that_leads_readings_out_of_where_the_plant_works_is_not_tried():
    """A ball at 2 to 20 mm was "in kilometres", as the equations have a pole beside where it floats."""
    problem = SimpleNamespace(y=np.array([[0.002], [0.02]]), model=SimpleNamespace(measured=("y",)))
    far = Columns(None, np.array([1e3]), np.ones(0), (0,), ())
    near = Columns(None, np.array([-1.0]), np.ones(0), (0,), ())
    assert far.leads_out(problem, {"y": (0.001, 0.02)})
    assert not far.leads_out(problem, {})
    assert not far.leads_out(problem, {"y": (0.005, 0.02)})  # it lies outside as it is
    assert not near.leads_out(problem, {"y": (-0.02, 0.02)})


@pytest.mark.parametrize(("share", "found"), [(0.65, ["saturated_reading"]), (0.8, ["saturated_reading"]), (-0.5, [])])
def test_an_extreme_at_which_a_reading_stands_most_of_the_time_is_no_limit(share, found):
    """A sine cut off at both ends is at each of them for less than half of the time; at one, below its middle, more."""
    t = np.arange(2000) / 100.0
    y = np.sin(2.0 * t) + 1e-3 * np.random.default_rng(7995).standard_normal(len(t))
    y = np.clip(y, -abs(share), share) if share > 0.0 else np.minimum(y, share)
    record = Record((Trace("a", t, y[:, None], np.zeros((len(t), 1))),), ("q",), ("force",))
    assert [f.fault for f in mended(record, rigs.oscillator().model, [SaturatedReading()])[1]] == found
