"""Recordings under known conditions: one fit over files whose weight differs tells what one weight cannot."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simgap.errors import UserError
from simgap.stages import diagnosis as stage

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
        (["{file: other.csv, m: 2.0}"], "no recording is called"),
        (["{file: light.csv, mass: 2.0}"], "no parameter of the plant"),
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
