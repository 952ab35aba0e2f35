"""Several files, several traces, another rate, a state that one file lacks: one diagnosis of them all."""

import numpy as np
import pytest

from simgap.errors import UserError
from simgap.stages import diagnosis as stage
from tests.stages import diagnosis_example as example

TRIED = "measured: {effects: [coulomb_friction, viscous_friction, spring], max_effects: 2}\n"


def write(path, traces):
    """(name, t, y, u) of each trace, one after the other; the column `trace` where they have names."""
    rows = [
        [*(f"{c:.9g}" for c in (t[k], *y[k], u[k])), *([name] if name else [])]
        for name, t, y, u in traces
        for k in range(len(t))
    ]
    header = "t,q,v,u" + (",trace" if traces[0][0] else "")
    path.write_text("\n".join([header, *(",".join(row) for row in rows)]) + "\n")
    return path


def trace(seed, seconds, rate, friction=example.FRICTION):
    t = np.arange(int(seconds * rate)) / rate
    rng = np.random.default_rng(seed)
    y = example.simulate(t, [rng.uniform(-0.5, 0.5), 0.0], friction) + example.SIGMA * rng.standard_normal((t.size, 2))
    return t + rng.uniform(0, 1e6), y, example.torque(t)


@pytest.fixture
def case(tmp_path):
    path = tmp_path / "case.yaml"
    path.write_text(example.CASE + TRIED)
    return path


def test_files_traces_and_rates_of_their_own(case, tmp_path):
    files = [
        write(tmp_path / "fast.csv", [("", *trace(1, 8.0, 100.0))]),
        write(tmp_path / "slow.csv", [("", *trace(2, 8.0, 40.0))]),
        write(tmp_path / "two.csv", [("a", *trace(3, 5.0, 100.0)), ("b", *trace(4, 5.0, 100.0))]),
    ]
    found = stage.run(case, files, tmp_path / "out")
    assert found["verdict"] == "attributed"
    (effect,) = found["effects"]
    assert effect["name"] == "coulomb_friction"
    assert effect["parameters"]["F_c"]["value"] == pytest.approx(example.FRICTION, abs=0.003)
    assert [note["file"] for note in found["data"]] == ["fast.csv", "slow.csv", "two.csv"]
    assert [note["rows"] for note in found["data"]] == [800, 320, 1000]
    rates = {t["name"]: t["rate_hz"] for t in found["survey"]["traces"]}
    assert len(rates) == 4
    assert sorted(round(r) for r in rates.values()) == [40, 100, 100, 100]


@pytest.mark.parametrize(("seed", "push"), [(5, 0.1), (6, 0.05)])  # on the second, a spring fits better than nothing
def test_an_effect_beyond_its_physical_limit_is_not_named(case, tmp_path, seed, push):
    path = write(tmp_path / "driven.csv", [("", *trace(seed, 10.0, 100.0, friction=-push))])  # a hinge that pushes
    found = stage.run(case, [path], tmp_path / "out")
    assert found["verdict"] == "unexplained"
    assert found["effects"] == []
    assert found["error"]["after"] == found["error"]["before"]
    rejected = {c["name"]: c["rejected"] for c in found["candidates"]}
    assert {"coulomb_friction", "viscous_friction"} <= {
        name for name, why in rejected.items() if "opposite sign" in why
    }


def test_a_constant_drive_is_a_warning(case, tmp_path):
    t = np.arange(800) / 100.0
    y = 0.2 + example.SIGMA * np.random.default_rng(6).standard_normal((800, 2))
    y[:, 1] -= 0.2
    held = np.full(800, example.WEIGHT * np.sin(0.2))
    found = stage.run(case, [write(tmp_path / "held.csv", [("", t, y, held)])], tmp_path / "out")
    assert any("input u is constant" in w for w in found["warnings"])
    assert (found["verdict"], found["effects"]) == ("none", [])  # it rests where it is held, as the model says


def test_a_folder_of_mistakes_leaves_no_results(case, tmp_path):
    good = write(tmp_path / "good.csv", [("", *trace(1, 4.0, 100.0))])
    bad = tmp_path / "bad.csv"
    bad.write_text("seconds,angle\n0,1\n1,2\n")
    with pytest.raises(UserError, match=r"bad\.csv"):
        stage.run(case, [good, bad], tmp_path / "out")
    assert not (tmp_path / "out").exists()
