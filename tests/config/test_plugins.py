"""Plug-ins: found by name, in a file beside a case or offered by a distribution; their keys checked like any others."""

import subprocess
import sys
from typing import Annotated

import pytest
from pydantic import BaseModel, ValidationError

from simgap import plugins
from simgap.config.base import Section
from simgap.config.load import load_case
from simgap.config.plugged import INNER, Plugged
from simgap.errors import UserError
from simgap.simulators.process import run_in_processes
from tests.little_cart import write_cart

MINE = """
from typing import Literal
from simgap.config.base import Section

class Mine(Section):
    engine: str
    gain: float = 1.0
"""


class Holder(BaseModel):
    simulator: Annotated[Section, Plugged("engines", "engine")]


def test_a_file_beside_the_case_is_a_plug_in(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    held = Holder.model_validate({"simulator": {"engine": "mine.py:Mine", "gain": 2.0}}, context={"folder": tmp_path})
    assert held.simulator.gain == 2.0
    assert held.model_dump()["simulator"] == {"engine": "mine.py:Mine", "gain": 2.0}
    assert plugins.source(type(held.simulator)) == tmp_path / "mine.py"


def test_a_changed_file_is_another_plug_in(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    first = plugins.find("engines", "mine.py:Mine", tmp_path)
    (tmp_path / "mine.py").write_text(MINE.replace("1.0", "3.0"))
    second = plugins.find("engines", "mine.py:Mine", tmp_path)
    assert (first(engine="a").gain, second(engine="a").gain) == (1.0, 3.0)


def test_errors_inside_keep_their_place(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    with pytest.raises(ValidationError) as caught:
        Holder.model_validate({"simulator": {"engine": "mine.py:Mine", "gian": 2.0}}, context={"folder": tmp_path})
    (error,) = caught.value.errors()
    assert (error["type"], error["loc"]) == (INNER, ("simulator",))
    (inner,) = error["ctx"]["errors"]
    assert (inner["type"], inner["loc"]) == ("extra_forbidden", ("gian",))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing.py:Mine", "does not exist"),
        ("../outside.py:Mine", "outside the case's folder"),
        ("mine.py:Yours", "no class 'Yours'"),
        ("broken.py:Mine", "does not run: ZeroDivisionError"),
        ("nothing", "Known:"),
    ],
)
def test_what_cannot_be_found_is_told(tmp_path, name, words):
    folder = tmp_path / "cases"
    folder.mkdir()
    (tmp_path / "outside.py").write_text(MINE)
    (folder / "mine.py").write_text(MINE)
    (folder / "broken.py").write_text("1 / 0")
    with pytest.raises(UserError) as caught:
        plugins.find("engines", name, folder)
    assert words in str(caught.value)


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A distribution with an engine and one with a broken one, as an installer would leave them on the path."""
    site = tmp_path / "site"
    for name, module in (("theirs", MINE), ("halved", "import nothing_of_this_name\n")):
        info = site / f"{name}_engines-2.5.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}-engines\nVersion: 2.5\n")
        (info / "entry_points.txt").write_text(f"[simgap.engines]\n{name} = {name}_module:Mine\n")
        (site / f"{name}_module.py").write_text(module)
    monkeypatch.syspath_prepend(str(site))
    plugins._offered.cache_clear()
    plugins._installed.cache_clear()
    yield site
    plugins._offered.cache_clear()
    plugins._installed.cache_clear()


def test_a_distribution_offers_plug_ins(installed, caplog):
    held = Holder.model_validate({"simulator": {"engine": "theirs", "gain": 2.0}})
    assert held.simulator.gain == 2.0
    assert plugins.names("engines")[-2:] == ("halved", "theirs")
    assert plugins.distribution("engines", "theirs") == ("theirs-engines", "2.5")
    assert plugins.distribution("engines", "pybullet") is None
    assert plugins.source(type(held.simulator)) == installed / "theirs_module.py"
    assert "is code of theirs_module" in caplog.text


def test_a_distribution_that_cannot_be_imported_is_told(installed):
    with pytest.raises(UserError, match="'halved' cannot be imported: No module named 'nothing_of_this_name'"):
        plugins.find("engines", "halved")


def test_a_file_is_said_to_be_code_once(tmp_path, caplog):
    (tmp_path / "mine.py").write_text(MINE)
    for _ in range(3):
        plugins.find("engines", "mine.py:Mine", tmp_path)
    assert caplog.text.count("is code and runs with your permissions") == 1
    assert not list(tmp_path.rglob("__pycache__"))


def test_what_a_file_made_can_be_read_in_another_process(tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    held = plugins.find("engines", "mine.py:Mine", tmp_path)(engine="mine.py:Mine", gain=4.0)
    assert run_in_processes(gain, [(held,)]) == [4.0]


def gain(section):
    return section.gain


def test_a_plug_in_without_its_methods_is_one_line(vary):
    path = vary("pendulum", {"simulator": {"engine": "half.py:Half"}, "gap.basis": {"kind": "half.py:Less"}})
    bases = "from simgap.config.gap import BasisSection\nfrom simgap.simulators.base import Engine\n"
    (path.parent / "half.py").write_text(
        f"{bases}class Half(Engine):\n    def reset(self, x): pass\nclass Less(BasisSection): pass\n"
    )
    with pytest.raises(UserError, match=r"simulator: the plug-in 'half\.py:Half' lacks advance, build"):
        load_case(path)
    path = vary("pendulum", {"gap.basis": {"kind": "half.py:Less"}})
    with pytest.raises(UserError, match=r"gap\.basis: the plug-in 'half\.py:Less' lacks listed"):
        load_case(path)


@pytest.mark.parametrize(
    ("simulator", "words"),
    [
        ({"engine": "bullet"}, "no engine is called 'bullet'. Known: pybullet, pybullet_wheeled, mujoco, equations"),
        ({"inertia": "file"}, "needs the key 'engine', one of pybullet"),
        ({"engine": "mine.py:Mine"}, "mine.py: the plug-in file does not exist"),
        ({"engine": "pybullet", "inertia": "file", "dampign": 1}, "simulator.dampign: unknown key"),
        ({"engine": "odd.py:Odd"}, "must derive from simgap.config.simulator.EngineSection"),
    ],
)
def test_a_case_with_an_engine_that_is_none_is_one_line(vary, simulator, words):
    path = vary("pendulum", {"simulator": simulator})
    (path.parent / "odd.py").write_text(MINE.replace("Mine", "Odd"))
    with pytest.raises(UserError) as caught:
        load_case(path)
    text = str(caught.value)
    assert words in text
    assert "\n" not in text
    assert text.startswith(f"{path}: simulator")


def test_a_person_who_checks_a_case_is_told_that_it_runs_code(tmp_path):
    """In a process of its own: it is said once, whatever ran before."""
    path = write_cart(tmp_path, simulator={"engine": "python", "function": "my_sim.py:step"})
    (tmp_path / "my_sim.py").write_text("def step(x, u, tau):\n    return x + tau * u[0]\n")
    command = [sys.executable, "-m", "simgap.cli", "check", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    said = "".join(done.stderr.split())  # lines are as long as the terminal is wide
    assert said.count(f"thesimulator{tmp_path.resolve() / 'my_sim.py'}iscodeandrunswithyourpermissions") == 1
