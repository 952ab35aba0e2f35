"""From the JSON logs of a servo bench to a verdict: weight, length and supply of each run stand in its own file."""

import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from scipy.integrate import solve_ivp

from simgap.config.load import load_case
from simgap.diagnosis.record.conditions import conditioned, under_conditions
from simgap.diagnosis.result import DiagnosisSettings
from simgap.diagnosis.simulation.parts import parts_of
from simgap.diagnosis.simulation.sensitivity import with_values
from simgap.errors import UserError
from simgap.io.recordings.measured import load_reading
from simgap.plants.context import Context
from simgap.stages import check
from simgap.stages import diagnosis as stage

FRICTION, ROTOR = 0.06, 0.02
CASE = """\
name: bench
plant:
  states: {q: {unit: rad}, v: {unit: rad/s}}
  inputs: {goal: {unit: rad}}
  symbolic:
    parameters:
      m: {value: 1.0, unit: kg, description: weight at the end of the arm}
      l: {value: 0.2, unit: m, description: length of the arm}
      volts: {value: 12, unit: V, description: supply}
      kp: {value: 0.5, unit: N*m/(rad*V), description: of the drive's own controller}
      g: {value: 9.81, unit: m/s^2}
    dynamics: {q: v, v: (kp*volts*(goal - q) - m*g*l*sin(q)) / (m*l^2)}
    coordinates:
      hinge: {position: q, velocity: v, force_gain: 1/(m*l^2)}
measured:
  files: [logs/*.json]
  time: timestamp
  columns: {q: position, goal: goal_position}
  conditions_from:
    m: {column: mass, unit: g}
    l: length
    volts: {column: supply.mv, unit: mV}
  effects: [viscous_friction, coulomb_friction, reflected_inertia, spring]
"""
RUNS = {"a": (0.2, 0.3, 12.0), "b": (1.0, 0.2, 11.1), "c": (2.0, 0.2, 14.8), "d": (0.6, 0.35, 12.6)}


def log(path, mass, length, volts, seed, seconds=8.0, rate=100.0):
    """A run by SciPy: a drive that follows its goal, with viscous friction and the inertia of a rotor."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    hz, phase = rng.uniform(0.2, 2.0, 5), rng.uniform(0.0, 6.3, 5)
    goal = 0.25 * np.sin(2 * np.pi * np.outer(t, hz) + phase).sum(axis=1)
    x, pull, inertia = np.zeros((t.size, 2)), mass * 9.81 * length, mass * length**2 + ROTOR

    def motion(_, s, aim):
        return [s[1], (0.5 * volts * (aim - s[0]) - FRICTION * s[1] - pull * np.sin(s[0])) / inertia]

    for k in range(t.size - 1):
        moved = solve_ivp(motion, (0.0, 1.0 / rate), x[k], args=(goal[k],), rtol=1e-7, atol=1e-9)
        x[k + 1] = moved.y[:, -1]
    q = x[:, 0] + 1e-3 * rng.standard_normal(t.size)
    entries = [
        {"timestamp": a, "position": b, "goal_position": c, "torque_enable": True, "temp": None}
        for a, b, c in zip(t.tolist(), q.tolist(), goal.tolist(), strict=True)
    ]
    said = {"mass": 1000 * mass, "length": length, "supply": {"mv": 1000 * volts}, "motor": "servo", "entries": entries}
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(said))


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    for seed, (name, run) in enumerate(RUNS.items()):
        log(folder / "logs" / f"run_{name}.json", *run, seed)
    (folder / "bench.yaml").write_text(CASE)
    return folder


def test_from_the_logs_of_a_bench_to_a_verdict(bench):
    assert check.run(bench / "bench.yaml") is not None
    found = stage.run(bench / "bench.yaml", [], bench / "found")
    assert found["verdict"] == "attributed"
    numbers = {e["name"]: next(iter(e["parameters"].values()))["value"] for e in found["effects"]}
    assert set(numbers) == {"viscous_friction", "reflected_inertia"}
    assert numbers["viscous_friction"] == pytest.approx(FRICTION, rel=0.002)
    assert numbers["reflected_inertia"] == pytest.approx(ROTOR, rel=0.002)
    assert [note["file"] for note in found["data"]] == [f"logs/run_{name}.json" for name in RUNS]
    assert any("m is read from 'mass'" in line for line in found["columns"])
    corrected = yaml.safe_load((bench / "found/corrected_case.yaml").read_text())
    assert corrected["measured"]["conditions_from"] == yaml.safe_load(CASE)["measured"]["conditions_from"]
    again = stage.run(bench / "found/corrected_case.yaml", [], bench / "again")
    assert again["verdict"] == "none"


WRONG = [
    ({"conditions_from": {"M": "mass"}}, "conditions_from.M", "'M' is not a parameter of the plant", "Known: g, kp"),
    ({"conditions_from": {"m": "weight"}}, "conditions_from.m.column", "has no column 'weight'", "Name one"),
    ({"conditions_from": {"m": "timestamp"}}, "conditions_from.m.column", "is the column of time stamps", "Name one"),
    ({"conditions_from": {"m": {"column": "mass", "unit": "V"}}}, "conditions_from.m.unit", "'V' cannot be", "like"),
    ({"conditions_from": {"m": {"column": "mass", "scale": 0}}}, "conditions_from.m", "scale is 0", "give a factor"),
    ({"conditions": [{"file": "run_a.json", "m": 0.2}]}, "measured", "['m'] are both in conditions", "remove them"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "key", "problem", "remedy"), WRONG)
def test_a_mistake_is_told_by_the_check(bench, changes, key, problem, remedy):
    content = yaml.safe_load(CASE)
    content["measured"] |= changes
    path = bench / "wrong.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(UserError) as caught:
        check.run(path)
    assert key in str(caught.value.key)
    assert problem in str(caught.value)
    assert remedy in str(caught.value)


def changed(bench, folder, change):
    content = json.loads((bench / "logs/run_a.json").read_text())
    change(content)
    (folder / "logs").mkdir()
    (folder / "logs/run_a.json").write_text(json.dumps(content))
    (folder / "bench.yaml").write_text(CASE)
    return folder / "bench.yaml"


def moves(content):
    mass = content.pop("mass")
    for k, entry in enumerate(content["entries"]):
        entry["mass"] = mass + 100 * (k >= 50)


REFUSED = [
    (moves, r"conditions_from\.m.*row 51: 'mass' gives 0\.3 kg where it gave 0\.2 before.*cut the file there"),
    (lambda content: content.update(mass="heavy"), r"row 1, key 'mass': 'heavy' is a text, not a number"),
    (lambda content: content.update(mass=None), r"conditions_from\.m: row 1, 'mass': the cell is empty.*Write the"),
]


@pytest.mark.parametrize(("change", "said"), REFUSED)
def test_a_condition_that_is_none_is_refused_in_one_line(bench, tmp_path, change, said):
    with pytest.raises(UserError, match=rf"run_a\.json.*{said}"):
        stage.run(changed(bench, tmp_path, change), [], tmp_path / "found")


def test_traces_of_one_file_have_conditions_of_their_own(bench):
    columns: dict[str, list] = {name: [] for name in ("timestamp", "position", "goal_position", "trace", "mass", "l")}
    for name, (mass, length, _) in RUNS.items():
        entries = json.loads((bench / f"logs/run_{name}.json").read_text())["entries"]
        for key in ("timestamp", "position", "goal_position"):
            columns[key] += [e[key] for e in entries]
        columns["trace"] += [name] * len(entries)
        columns["mass"] += [mass] * len(entries)
        columns["l"] += [100 * length] * len(entries)
    fields = [pa.field(n, pa.array(v).type, metadata={"unit": "cm"} if n == "l" else None) for n, v in columns.items()]
    pq.write_table(pa.table(columns, schema=pa.schema(fields)), bench / "runs.parquet")
    content = yaml.safe_load(CASE)
    content["measured"] |= {"conditions_from": {"m": {"column": "mass", "scale": 2.0}, "l": "l"}, "files": []}
    path = bench / "traces.yaml"
    path.write_text(yaml.safe_dump(content))
    reading = load_reading(
        Context.load(path).plant.corrected, load_case(path).measured, [bench / "runs.parquet"], bench
    )
    told = {name.split(":")[-1]: values for name, values in reading.conditions.items()}
    for name, (mass, length, _) in RUNS.items():
        assert told[name] == pytest.approx({"m": 2 * mass, "l": length}, rel=1e-12)


def test_dry_friction_is_seen_where_a_condition_divides_the_force(bench):
    model = Context.load(bench / "bench.yaml").plant.corrected
    reading = load_reading(model, load_case(bench / "bench.yaml").measured, [bench / "logs/run_a.json"], bench)
    record, names = under_conditions(reading, model, ())
    assert names == ("m", "l", "volts")
    settings = DiagnosisSettings(window_s=1.0, effects=("coulomb_friction",))
    known = parts_of(conditioned(model, names), record, settings)[0].known.model
    slot = known.find("coulomb_friction", "hinge").slots[0]
    assert not known.rubs(known.null)
    assert known.rubs(with_values(known.null, {slot: 0.1}))
