"""FMUs of both versions, compiled here: they step as their equations say, and hidden state is refused."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
import yaml

from simgap.config.load import load_case
from simgap.errors import UserError
from simgap.provenance import sections_digest
from simgap.simulators.process import run_in_processes
from simgap.simulators.rollouts import roll_out
from simgap.stages import check

SOURCE = Path(__file__).with_name("slider_fmu.c")
HEADERS = [Path(fmpy.__file__).parent / f"c-code/fmi{version}FunctionTypes.h" for version in (2, 3)]
UNITS = "<UnitDefinitions><Unit name='m'/><Unit name='m/s'/><Unit name='N'/></UnitDefinitions>"
ROWS = (("pos", 1, "output", "m"), ("vel", 2, "output", "m/s"), ("F", 3, "input", "N"), ("b", 4, "parameter", ""),
    ("mass", 5, "parameter", ""))  # fmt: skip


def variable(version, name, reference, causality, unit):
    kind = f"causality='{causality}' variability='{'fixed' if causality == 'parameter' else 'continuous'}'"
    kind += " initial='exact'" if causality != "input" else ""
    unit = f" unit='{unit}'" if unit else ""
    if version == 2:
        head = f"<ScalarVariable name='{name}' valueReference='{reference}' {kind}>"
        return f"{head}<Real start='1'{unit}/></ScalarVariable>"
    return f"<Float64 name='{name}' valueReference='{reference}' {kind} start='1'{unit}/>"


def description(version):
    inner = "".join(variable(version, *row) for row in ROWS)
    if version == 3:
        inner = "<Float64 name='time' valueReference='0' causality='independent' variability='continuous'/>" + inner
    unknown = ("<Outputs><Unknown index='1'/><Unknown index='2'/></Outputs>" if version == 2
               else "<Output valueReference='1'/><Output valueReference='2'/>")  # fmt: skip
    token = "guid" if version == 2 else "instantiationToken"
    return (
        f"<?xml version='1.0'?><fmiModelDescription fmiVersion='{version}.0' modelName='slider' {token}='{{s}}'>"
        "<CoSimulation modelIdentifier='slider' canHandleVariableCommunicationStepSize='true'/>"
        f"{UNITS}<ModelVariables>{inner}</ModelVariables><ModelStructure>{unknown}</ModelStructure>"
        "</fmiModelDescription>"
    )


def stubs(source):
    """FMPy binds every function of the standard, also those that no slider needs."""
    headers = "".join(file.read_text() for file in HEADERS)
    named = {name.removesuffix("TYPE") for name in re.findall(r"\bfmi[23][A-Z]\w+TYPE\b", headers)}
    return "".join(f"int {n}(void) {{ return 3; }}\n" for n in sorted(named) if f"{n}(" not in source)


@pytest.fixture(scope="session")
def fmu(tmp_path_factory):
    if shutil.which("cc") is None:
        pytest.skip("no C compiler to make an FMU with")
    folder = tmp_path_factory.mktemp("fmu")

    def make(version, *flags):
        path = folder / f"slider{version}{''.join(flags)}.fmu"
        if not path.exists():
            library = folder / "slider.so"
            source = folder / "slider.c"
            source.write_text(SOURCE.read_text() + stubs(SOURCE.read_text()))
            subprocess.run(["cc", "-shared", "-fPIC", "-O1", *flags, str(source), "-o", str(library)], check=True)
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr("modelDescription.xml", description(version))
                place = "linux64" if version == 2 else "x86_64-linux"
                archive.write(library, f"binaries/{place}/slider.so")
        return path

    return make


@pytest.fixture
def slider(tmp_path):
    """A case whose simulator is an FMU beside it."""

    def make(path, **simulator):
        content = {
            "name": "slider",
            "plant": {
                "states": {"x": {"unit": "m"}, "v": {"unit": "m/s"}},
                "inputs": {"F": {"unit": "N"}},
                "symbolic": {"dynamics": {"x": "v", "v": "F"}},
            },
            "domain": {"tau": 0.1, "X": {"x": [-1, 1], "v": [-1, 1]}, "U": {"F": {"values": [-1, 0, 1]}}},
            "simulator": {
                "engine": "fmu",
                "fmu": path.name,
                "substeps": 4,
                "variables": {"x": "pos", "v": "vel"},
                "parameters": {"b": 0.5},
            }
            | simulator,
            "grid": {"eps": 0.25, "shards": 1},
            "gap": {"basis": ["x", "v", "F", 1], "fresh_samples": 100},
        }
        if path.exists():
            shutil.copy(path, tmp_path / path.name)
        (tmp_path / "slider.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
        return tmp_path / "slider.yaml"

    return make


def rolled(path, x, u):
    ((following, engine),) = run_in_processes(roll_out, [(load_case(path), path.parent, x, u)])
    return following, engine


def refused(path):
    with pytest.raises(UserError) as caught:
        rolled(path, np.array([[0.1, 0.2], [0.3, -0.4]]), np.array([[1.0], [-1.0]]))
    return str(caught.value)


@pytest.mark.parametrize("version", [2, 3])
def test_it_steps_as_its_equations_say(fmu, slider, version):
    rng = np.random.default_rng(0)
    x, u = rng.uniform(-1, 1, (20, 2)), rng.uniform(-1, 1, (20, 1))
    found, engine = rolled(slider(fmu(version)), x, u)
    wanted, h = x.copy(), 0.1 / 4
    for _ in range(4):
        wanted = np.stack([wanted[:, 0] + h * wanted[:, 1], wanted[:, 1] + h * (u[:, 0] - 0.5 * wanted[:, 1]) / 2.0], 1)
    assert np.abs(found - wanted).max() < 1e-15
    assert engine == f"fmu slider (FMI {version}.0)"


def test_a_case_with_it_can_be_checked_and_its_bytes_are_hashed(fmu, slider):
    path = slider(fmu(2))
    assert {cost.stage for cost in check.run(path).costs} >= {"rollouts", "gap"}
    before = sections_digest(load_case(path), ("simulator",), path.parent)
    with zipfile.ZipFile(path.parent / fmu(2).name, "a") as archive:
        archive.writestr("resources/note.txt", "another export")
    assert sections_digest(load_case(path), ("simulator",), path.parent) != before


def test_state_that_the_case_does_not_have_is_refused(fmu, slider):
    assert "more state than the case" in refused(slider(fmu(2, "-DFILTER")))
    assert "gives two results for the same call" in refused(slider(fmu(2, "-DKEEPS")))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"variables": {"v": "vel"}}, ["no real variable 'x'", "simulator.variables.x", "pos, vel, F, b, mass"]),
        ({"variables": {"x": "vel", "v": "vel"}}, ["'m/s'", "simulator.variables.x"]),
        ({"starts": {"x": "mass"}}, ["begins at 0", "simulator.starts.x"]),
        ({"parameters": {"mass": -1.0}}, ["does not take mass = -1"]),
        ({"parameters": {"weight": 1.0}}, ["simulator.parameters.weight"]),
        ({"variables": {"y": "pos"}}, ["['y'] are not of the plant"]),
        ({"fmu": "none.fmu"}, ["does not exist", "none.fmu"]),
        ({"fmu": "slider.yaml"}, ["is not an FMU"]),
    ],
)
def test_what_does_not_fit_is_one_line(fmu, slider, changes, words):
    said = refused(slider(fmu(2), **changes))
    assert "\n" not in said
    assert all(word in said for word in words), said


UNPACK = """
import sys
from pathlib import Path
from simgap.extras.engines.fmu import Unit
unit = Unit(Path(sys.argv[1]))
print("unpacked", flush=True)
sys.stdin.read()
unit.close()
"""


def test_what_a_killed_process_had_unpacked_goes_with_the_next_and_nobody_elses(fmu, tmp_path):
    def unpacking():
        process = subprocess.Popen(
            [sys.executable, "-c", UNPACK, str(fmu(2))], env=os.environ | {"TMPDIR": str(tmp_path)},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert process.stdout.readline() == "unpacked\n"
        return process, {path.name for path in tmp_path.iterdir()}

    killed, first = unpacking()
    living, both = unpacking()
    assert len(first) == 1
    assert first < both
    killed.kill()
    killed.communicate()
    third, after = unpacking()
    assert not first & after
    assert both - first < after
    for process in (living, third):
        process.communicate("")
        assert process.returncode == 0
    assert list(tmp_path.iterdir()) == []
