"""Units: a short product of names and powers is read, anything that pint would compute with is not."""

import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.io.recordings.tables import read_header
from simgap.plants.plant_model import PlantModel
from simgap.units import Affine, conversion
from tests.little_cart import CASE, write_cart

LONG = "9**9**9"
READ = {
    "deg/s": (np.pi / 180, "rad/s"), "mN*m": (1e-3, "N*m"), "g*cm^2": (1e-7, "kg*m^2"), "1/min": (1 / 60, "1/s"),
    "(km/h)^2": ((1 / 3.6) ** 2, "m^2/s^2"), "N m": (1.0, "N*m"), "cm**-1": (100.0, "1/m"),
    "km^0.5": (1000**0.5, "m^0.5"),
}  # fmt: skip


@pytest.mark.parametrize("unit", READ)
def test_what_people_write_is_read(unit):
    factor, target = READ[unit]
    assert conversion(unit, target).factor == pytest.approx(factor, rel=1e-12)


HOSTILE = (
    LONG, "m**9**9**9", "m^9^9^9", "(m^9)^9^9", "((((m^9*s)^9*s)^9*s)^9*s)^9", "m^1e9", "m^99999999", "1e9*m", "9*m",
    "m*" * 40 + "m", "(" * 200 + "m" + ")" * 200, "m" * 61, "m^(9^9)", "m^-(9**9)", "m if 1 else s", "__import__('os')",
    "m\x00", "m\n*9**9**9", "*m", "m//s", "m%9", "{m}", "[m]", "m.real", "m^inf", "m^nan", "m" + " m" * 20,
)  # fmt: skip


@pytest.mark.parametrize("unit", HOSTILE)
def test_anything_else_is_refused_at_once(unit):
    began = time.process_time()
    with pytest.raises(UserError, match="is not a unit"):
        conversion(unit, "s")
    assert time.process_time() - began < 2.0  # loading pint


def _of_case(**changes):
    return lambda folder: load_case(write_cart(folder, **changes))


def _of_state(folder):
    states = {"x": {"unit": LONG}, "v": {"unit": "m/s"}}
    _ = PlantModel.of(load_case(write_cart(folder, plant=CASE["plant"] | {"states": states})), folder).declared


def _of_parquet(folder):
    fields = [pa.field("t", pa.float64()), pa.field("x", pa.float64(), metadata={"unit": LONG})]
    pq.write_table(pa.table([np.arange(3.0), np.zeros(3)], schema=pa.schema(fields)), folder / "a.parquet")
    _, units = read_header(folder / "a.parquet", "a.parquet")
    assert units == {"x": LONG}
    conversion(units["x"], "m")


WHERE = {
    "a state": _of_state,
    "tau": _of_case(domain=CASE["domain"] | {"tau": f"1 {LONG}"}),
    "a budget": _of_case(budget={"time": f"1 {LONG}"}),
    "a column": _of_parquet,
}


@pytest.mark.parametrize("where", WHERE)
def test_it_holds_wherever_a_unit_comes_from(tmp_path, where):
    with pytest.raises(UserError, match=r"9\*\*9\*\*9"):
        WHERE[where](tmp_path)


def test_every_unit_of_the_package_is_read(root):
    """What cases and documents write is not what the guard is against."""
    found = set()
    for path in sorted((root / "configs/cases").glob("*.yaml")):
        waiting = [yaml.safe_load(path.read_text())]
        while waiting:
            node = waiting.pop()
            found |= {node["unit"]} if isinstance(node, dict) and isinstance(node.get("unit"), str) else set()
            waiting += list(node.values()) if isinstance(node, dict) else node if isinstance(node, list) else []
    assert len(found) > 10
    assert all(conversion(f"{unit}", f" {unit}*1") == Affine(1.0) for unit in found)
