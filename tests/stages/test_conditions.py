"""Recordings under known conditions: one fit over files whose weight differs tells what one weight cannot."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simgap.config.measured import MeasuredSection
from simgap.diagnosis.record.conditions import conditioned, under_conditions
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.search.fit import fit
from simgap.diagnosis.simulation.initial import initial_states
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.sensitivity import choose_steps, with_values
from simgap.diagnosis.verdict.held_out import judge
from simgap.errors import UserError
from simgap.io.recordings.measured import load_reading
from simgap.plants.context import Context
from simgap.stages import diagnosis as stage

ROOT = Path(__file__).parents[2]
RECORDS = ROOT / "../shared/data/go1_motor"
LENGTH, ARM, GAIN, DRAG, ROTOR = 0.3, 0.1, 0.9, 0.06, 0.02
CASE = """\
name: bench
plant:
  states: {q: {unit: rad}, v: {unit: rad/s}}
  inputs: {u: {unit: N*m}}
  symbolic:
    parameters:
      m: {value: 1.0, unit: kg}
      arm: {value: 0.1, unit: kg}
      l: {value: 0.3, unit: m}
      g: {value: 9.81, unit: m/s^2}
    dynamics: {q: v, v: (u - (m + arm/2)*g*l*sin(q)) / ((m + arm/3)*l^2)}
    coordinates: {hinge: {position: q, velocity: v, force_gain: 1/((m + arm/3)*l^2)}}
measured:
  effects: [input_gain, viscous_friction, reflected_inertia, coulomb_friction]
  conditions: [CONDITIONS]
"""
WEIGHTS = {"light.csv": 0.2, "middle.csv": 1.0, "heavy.csv": 2.0}


def write(path, weight, seed):
    """The bench with a weight, by SciPy: gain, viscous friction and the inertia of a rotor that the case lacks."""
    rng, rate = np.random.default_rng(seed), 100.0
    t = np.arange(int(12 * rate)) / rate
    hz, phase = rng.uniform(0.2, 3.0, 6), rng.uniform(0.0, 6.3, 6)
    u = (0.3 + 0.5 * weight) * np.sin(2 * np.pi * np.outer(t, hz) + phase).sum(axis=1)
    inertia = (weight + ARM / 3) * LENGTH**2 + ROTOR
    pull = (weight + ARM / 2) * 9.81 * LENGTH
    x = np.zeros((t.size, 2))
    for k in range(t.size - 1):
        moved = solve_ivp(
            lambda _, s, f: [s[1], (GAIN * f - DRAG * s[1] - pull * np.sin(s[0])) / inertia],
            (0.0, 1.0 / rate), x[k], args=(u[k],), rtol=1e-7, atol=1e-9,
        )  # fmt: skip
        x[k + 1] = moved.y[:, -1]
    q = x[:, 0] + 1e-3 * rng.standard_normal(t.size)
    np.savetxt(path, np.column_stack([t, q, u]), delimiter=",", header="t,q,u", comments="")
    return path


def case(folder, conditions):
    (folder / "case.yaml").write_text(CASE.replace("CONDITIONS", ", ".join(conditions)))
    return folder / "case.yaml"


def test_files_with_other_weights_are_fitted_as_one(tmp_path):
    files = [write(tmp_path / name, weight, k) for k, (name, weight) in enumerate(WEIGHTS.items())]
    said = [f"{{file: {name}, m: {weight}}}" for name, weight in WEIGHTS.items() if weight != 1.0]
    found = stage.run(case(tmp_path, said), files, tmp_path / "out")
    assert found["verdict"] == "attributed"
    numbers = {e["name"]: next(iter(e["parameters"].values())) for e in found["effects"]}
    for name, true in (("input_gain", GAIN), ("viscous_friction", DRAG), ("reflected_inertia", ROTOR)):
        assert numbers[name]["value"] == pytest.approx(true, rel=0.02)
    assert set(numbers) == {"input_gain", "viscous_friction", "reflected_inertia"}
    error = found["error"]
    assert error["after"]["horizon_rmse"]["q"] < 0.3 * error["before"]["horizon_rmse"]["q"]
    corrected = (tmp_path / "out" / "corrected_case.yaml").read_text()
    assert "conditions" in corrected  # the next diagnosis knows them too


@pytest.mark.parametrize(
    ("conditions", "said"),
    [
        (["{file: other.csv, m: 2.0}"], "there is no recording"),
        (["{file: light.csv, mass: 2.0}"], "not a parameter of the plant"),
        (["{file: light.csv}"], "a parameter of the plant"),
        (["{file: light.csv, m: 2.0}", "{file: light.csv, m: 1.0}"], "given twice"),
        (["{file: light.csv, m: heavy}"], "m"),
    ],
)
def test_a_mistake_in_the_conditions_is_one_line(tmp_path, conditions, said):
    rows = np.column_stack([np.arange(400) / 100, np.sin(np.arange(400) / 20), np.zeros(400)])
    np.savetxt(tmp_path / "light.csv", rows, delimiter=",", header="t,q,u", comments="")
    with pytest.raises(UserError, match=said) as error:
        stage.run(case(tmp_path, conditions), [tmp_path / "light.csv"], tmp_path / "out")
    assert "measured.conditions" in str(error.value.key)


@pytest.mark.parametrize("how", ["conditions: [{file: light.csv, m: 0}]", "conditions_from: {m: weight}"])
def test_a_condition_under_which_the_plant_has_no_rate_is_one_line(tmp_path, how):
    """Without an arm the hinge turns nothing where no weight hangs on it."""
    rows = np.column_stack([np.arange(400) / 100, np.sin(np.arange(400) / 20), np.zeros((400, 2))])
    np.savetxt(tmp_path / "light.csv", rows, delimiter=",", header="t,q,u,weight", comments="")
    path = case(tmp_path, [])
    path.write_text(path.read_text().replace("arm: {value: 0.1", "arm: {value: 0").replace("conditions: []", how))
    with pytest.raises(UserError, match="the rate of 'v' is not a finite real number with m = 0") as error:
        stage.run(path, [tmp_path / "light.csv"], tmp_path / "out")
    assert "measured.conditions" in str(error.value.key)


@pytest.mark.skipif(not RECORDS.is_dir(), reason="the measured records are not beside the project")
def test_a_real_drive_under_four_weights_has_the_gain_that_others_found_and_carries_over():
    """Sixteen recordings at 0 to 3 kg, two of them never fitted; others found a gain of .912, and more."""
    path = ROOT / "configs/cases/go1_motor.yaml"
    context = Context.load(path)
    section, model = context.case.measured, context.plant.corrected
    reading = load_reading(model, section, [path.parent / f for f in section.files], path.parent)
    assert not [w for w in reading.warnings if "derivative" in w]
    record, names = under_conditions(reading, model, section.conditions)
    places = {
        "input_gain": ("torque", 1.0, 0.912), "coulomb_friction": ("hinge", 0.05, 0.091),
        "viscous_friction": ("hinge", 0.01, 0.047), "reflected_inertia": ("hinge", 0.005, 0.0109),
    }  # fmt: skip
    settings = DiagnosisSettings(
        window_s=section.window_s, effects=tuple(places), held_out_traces=reading.held_out, horizon_s=section.horizon_s
    )
    parts, _ = parts_of(conditioned(model, names), record, settings)
    compiled, problem = parts.known.model, parts.known
    slots = {name: compiled.find(name, on).slots[0] for name, (on, _, _) in places.items()}
    start, others = (with_values(compiled.null, {slots[n]: p[k] for n, p in places.items()}) for k in (1, 2))
    x0 = initial_states(problem)
    steps = choose_steps(problem, start, x0, slots.values())
    ends = fit(problem, start, x0, list(slots.values()), steps)
    assert ends.theta[slots["input_gain"]] == pytest.approx(0.912, rel=0.05)
    declared, mine, theirs = (judge(parts.confirm, th, 0.2) for th in (compiled.null, ends.theta, others))
    assert np.all(mine.horizon.rmse <= theirs.horizon.rmse)
    assert np.all(mine.horizon.rmse <= 0.5 * declared.horizon.rmse)


@pytest.mark.skipif(not RECORDS.is_dir(), reason="the measured records are not beside the project")
def test_the_real_drive_s_runs_as_json_with_their_weights_inside_are_the_same_record(tmp_path):
    path = ROOT / "configs/cases/go1_motor.yaml"
    context = Context.load(path)
    section, model = context.case.measured, context.plant.corrected
    files = [path.parent / f for f in section.files]
    for file in files:
        names, *rows = (line.split(",") for line in file.read_text().splitlines())
        entries = [dict(zip(names, map(float, row), strict=True)) for row in rows]
        weight = int(file.stem.rsplit("_", 1)[1].removesuffix("kg"))
        (tmp_path / f"{file.stem}.json").write_text(json.dumps({"mass": 1000 * weight, "entries": entries}))
    said = section.model_dump(mode="json") | {
        "conditions": (), "conditions_from": {"m": {"column": "mass", "unit": "g"}},
        "masks": [m.model_dump(mode="json") | {"file": m.file.replace(".csv", ".json")} for m in section.masks],
        "held_out": {"files": [f.replace(".csv", ".json") for f in section.held_out.files]},
    }  # fmt: skip
    inside = load_reading(
        model, MeasuredSection.model_validate(said), [tmp_path / f"{f.stem}.json" for f in files], tmp_path
    )
    stated = load_reading(model, section, files, path.parent)
    record, names = under_conditions(inside, model, ())
    other, _ = under_conditions(stated, model, section.conditions)
    assert names == ("m",)
    assert len(record.traces) == len(other.traces) == 16
    for one, two in zip(record.traces, other.traces, strict=True):
        assert np.array_equal(one.t, two.t)
        assert np.array_equal(one.y, two.y)
        assert one.u == pytest.approx(two.u, rel=1e-12)
    assert inside.held_out == stated.held_out
