"""Folders that somebody else prepared: each begins as a whole one, then something in it is changed."""

from __future__ import annotations

import io
import json
import os
import random
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from hostile.cases import ROOT

TAU = 0.2
CART = """name: cart
plant:
  states: {{x: {{unit: {unit}}}, v: {{unit: m/s}}}}
  inputs: {{F: {{unit: N}}}}
  symbolic: {{dynamics: {{x: v, v: F}}}}
domain: {{tau: {tau}, X: {{x: [-1, 1], v: [-1, 1]}}, U: {{F: {{values: [-1, 0, 1]}}}}}}
simulator: {{engine: equations, integrator: rk4}}
grid: {{eps: 0.2, shards: 1}}
gap: {{basis: [x, v, F, 1], fresh_samples: 200}}
synthesis: {{cells: [20, 20], specification: {{kind: invariance, safe: {{x: [-0.9, 0.9]}}}}}}
measured: {{files: [{files}]}}
"""
ROD = """name: rod
plant:
  urdf: rod.urdf
  states: {q: {joint: hinge, quantity: position, unit: rad}, w: {joint: hinge, quantity: velocity, unit: rad/s}}
  inputs: {u: {joint: hinge, unit: N*m}}
domain: {tau: 0.01, X: {q: [-1, 1], w: [-3, 3]}, U: {u: {values: [-2, 0, 2]}}}
simulator: {engine: pybullet, inertia: file}
grid: {eps: 0.3, shards: 1}
gap: {basis: [q, 1], fresh_samples: 200}
"""
FMU = """name: fmu
plant:
  states: {x: {unit: m}, v: {unit: m/s}}
  inputs: {F: {unit: N}}
  symbolic: {dynamics: {x: v, v: F}}
domain: {tau: 0.01, X: {x: [-1, 1], v: [-1, 1]}, U: {F: {values: [-1, 0, 1]}}}
simulator: {engine: fmu, fmu: unit.fmu, variables: {x: pos, v: vel}, timeout: 3}
grid: {eps: 0.2, shards: 1}
gap: {basis: [x, v, F, 1], fresh_samples: 200}
"""
RUN = "t,x,v,F\n" + "".join(f"{k / 20:g},{k % 7 / 10:g},{k % 5 / 10:g},{k % 3 - 1}\n" for k in range(120))
INPUTS = ("cart.yaml", "rod.yaml", "rod.urdf", "run.csv", "run.json", "fmu.yaml", "unit.fmu")
OUTPUTS = (
    "diagnosis", "diagnosis/diagnosis.log", "diagnosis/report.html", "diagnosis/diagnosis.json", "results",
    "results/cart", "results/cart/benchmarks/check.tsv", "results/cart/logs/check.log", "results/cart/certificate",
    "results/cart/check/check.json", ".snakemake", ".snakemake/simgap/runs/0-1.json", ".snakemake/metadata/x", "law.py",
    ".snakemake/simgap", "new", "MUJOCO_LOG.TXT", "a.log", "results/cart/gap", "results/cart/synthesis/gap",
)  # fmt: skip
TRACES = ("results/cart/trace/trace.rrd", "results/cart/gap/eps~0.2/gap.json", "whole.npz",
          "results/cart/synthesis/gap/controller.npz")  # fmt: skip
NAMES = ("r1_$x_{$.csv", "{case}.csv", "a b.csv", "ü ß.csv", "a\nb.csv", "\x1b[31mred.csv", "-n.csv", "%s.csv",
         "a;b.csv", "'q'.csv", '"q".csv', "$(touch ran).csv", "`id`.csv", "<b>.csv", "\u202egpj.csv",
         "x" * 200 + ".csv", "*.csv", "[a].csv", "~.csv", "#.csv")  # fmt: skip
MODULES = ("yaml", "types", "numpy", "simgap", "snakemake", "sitecustomize", "usercustomize", "json", "pandas", "typer")
RUN_ME = "open({!r}, 'a').write(__file__)\n"


@dataclass
class Place:
    """A folder `here`, one `outside` whose files must stay as they are, and what was done to it.

    `environment` and `limits` (of resource) are of the command; `first` runs before it, in its process.
    """

    here: Path
    outside: Path
    kept: Path
    done: list[str] = field(default_factory=list)
    environment: dict[str, str | None] = field(default_factory=dict)
    limits: dict[str, int] = field(default_factory=dict)
    first: list[Callable[[], None]] = field(default_factory=list)
    mounted: bool = False
    twice: bool = False

    def put(self, name: str, content: str | bytes) -> None:
        """Replace whatever stands there."""
        path = self.clear(name)
        if path is not None:
            path.write_bytes(content.encode() if isinstance(content, str) else content)

    def clear(self, name: str) -> Path | None:
        """An empty place, its folders there; None where something else was put on the way."""
        path = self.here / name
        if any(p.is_symlink() or (p.exists() and not p.is_dir()) for p in path.parents if p.is_relative_to(self.here)):
            return None
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        path.unlink(missing_ok=True)
        return path


def whole(place: Place, kept: Path) -> None:
    """Cases, a model, recordings and results, as they should be."""
    place.here.mkdir(parents=True)
    place.outside.mkdir()
    for name in ("precious", "report.html", "diagnosis.json", "diagnosis.log", "check.json", "gap.json"):
        (place.outside / name).write_text(f"{name} of somebody")
    place.put("cart.yaml", CART.format(unit="m", tau=TAU, files="run.csv"))
    place.put("rod.yaml", ROD)
    place.put("fmu.yaml", FMU)
    place.put("rod.urdf", (ROOT / "docs/tutorial/rod.urdf").read_bytes())
    place.put("run.csv", RUN)
    place.put("run.json", json.dumps([{"t": k / 20, "x": 0.1 * k, "v": 0.0, "F": 0} for k in range(60)]))
    found = kept / "whole.fmu"
    place.put("unit.fmu", found.read_bytes() if found.is_file() else archive({"modelDescription.xml": b"<a/>"}))
    if (kept / "results").is_dir():
        shutil.copytree(kept / "results", place.here / "results")
    place.put("whole.npz", (kept / "whole.npz").read_bytes())


def archive(parts: Mapping[str, bytes]) -> bytes:
    """A zip file."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in parts.items():
            packed.writestr(name, content)
    return out.getvalue()


INSIDE = {
    "whole": "",
    "crash": "if (F > 0.5) __builtin_trap();",
    "hang": "while (F > 0.5) s->z += 1;",
    "leave": "if (F > 0.5) exit(0);",
    "fill": "while (F > 0.5) memset(malloc(1 << 24), 1, 1 << 24);",
}
"""FMUs by what theirs do where the input is large."""


def units(kept: Path) -> None:
    """FMUs that run, and what they do when they do; none without a compiler."""
    sys.path.insert(0, str(ROOT / "tests/simulators"))
    if shutil.which("cc") is None:
        return
    from test_fmu import SOURCE, description, stubs

    for name, act in INSIDE.items():
        text = SOURCE.read_text().replace("s->v += h *", f"{act} s->v += h *")
        source, library = kept / f"{name}.c", kept / f"{name}.so"
        source.write_text("#include <stdlib.h>\n#include <string.h>\n" + text + stubs(SOURCE.read_text()))
        subprocess.run(["cc", "-shared", "-fPIC", "-O0", str(source), "-o", str(library)], check=True)
        parts = {"modelDescription.xml": description(2).encode(), "binaries/linux64/slider.so": library.read_bytes()}
        (kept / f"{name}.fmu").write_bytes(archive(parts))


@cache
def _bomb() -> bytes:
    return archive({"modelDescription.xml": b"<fmiModelDescription/>", "resources/x": bytes(2_100_000_000)})


def link(rng: random.Random, place: Place) -> None:
    """A file that is read is a link: to itself, a device, a pipe, a folder, nothing, or a file of somebody else's."""
    name = rng.choice((*INPUTS, *TRACES))
    devices = ("/dev/zero", "/dev/full", "/dev/random", "/dev/tty", "/proc/self/mem", "/proc/kmsg", "/etc/passwd")
    own = name.rpartition("/")[2]
    target = rng.choice((own, *devices, ".", "/", "nowhere", str(place.outside / "precious")))
    path = place.clear(name)
    if path is not None:
        path.symlink_to(target)


def pipe(rng: random.Random, place: Place) -> None:
    """A pipe, read or written."""
    extra = (".numba_config.yaml", "matplotlibrc", "results/cart/benchmarks/check.tsv")
    path = place.clear(rng.choice((*INPUTS, *OUTPUTS, *TRACES, *extra)))
    if path is not None:
        os.mkfifo(path)


def output_link(rng: random.Random, place: Place) -> None:
    """An output that is a link to a file or folder of somebody else's, or to itself."""
    name = rng.choice(OUTPUTS)
    path = place.clear(name)
    if path is not None:
        path.symlink_to(rng.choice((place.outside, place.outside / "precious", place.outside / "new", path.name)))


def hard_link(rng: random.Random, place: Place) -> None:
    """An output that is a second name of a file of somebody else's."""
    path = place.clear(rng.choice([name for name in OUTPUTS if "." in name.rpartition("/")[2]]))
    if path is not None:
        os.link(place.outside / "precious", path)


def modules(rng: random.Random, place: Place) -> None:
    """Modules beside the case, under names that programs import."""
    for name in rng.sample(MODULES, 3):
        place.put(f"{name}.py", RUN_ME.format(str(place.outside.parent / "ran")))


def profile(rng: random.Random, place: Place) -> None:
    """Settings of Snakemake and of libraries."""
    place.put("profiles/default/config.yaml", rng.choice(("touch: true\n", "[", "shadow-prefix: /\n", "x: !!y\n")))
    if rng.random() < 0.3:
        place.put(rng.choice((".numba_config.yaml", "matplotlibrc", "Snakefile", ".env")), "text.usetex: true\n")


def named(rng: random.Random, place: Place) -> None:
    """A recording under a name that means something elsewhere."""
    name = rng.choice(NAMES)
    place.put(name, RUN)
    place.put("cart.yaml", CART.format(unit="m", tau=TAU, files=json.dumps(name)))


def unit(rng: random.Random, place: Place) -> None:
    """A unit that is an expression."""
    said = rng.choice(("9**9**9", "m^9^9^9", "m*" * 500 + "m", "(" * 3000, "m if x", "__import__('os')", "1e999*m"))
    tau = rng.choice((TAU, f"1 {said}"))
    place.put("cart.yaml", CART.format(unit=json.dumps(said), tau=json.dumps(tau), files="run.csv"))


def pattern(rng: random.Random, place: Place) -> None:
    """Recordings by a pattern that leads out."""
    said = rng.choice(("/**/*", "../**/*", "**/*.csv", "/proc/*/mem", "*", "**", "[", "run.csv/../*", "/dev/*", "~/*"))
    place.put("cart.yaml", CART.format(unit="m", tau=TAU, files=json.dumps(said)))


def huge(rng: random.Random, place: Place) -> None:
    """A file that says it is large, or is."""
    name = rng.choice((*INPUTS, *TRACES))
    path = place.clear(name)
    if path is None:
        return
    with path.open("wb") as stream:
        stream.write(rng.choice((b"", b"t,x,v,F\n", b"[", b"{", b"PK\x03\x04", b"<robot>", b"RRF2")))
        if name not in ("run.csv",):
            stream.truncate(rng.choice((1 << 30, 1 << 33, 1 << 42)))
        else:
            stream.write(rng.choice((b"1," * 4_000_000, b"\n" * 4_000_000, b"#" * 8_000_000)))


def nested(rng: random.Random, place: Place) -> None:
    """A file of many levels, or with entities that multiply."""
    deep = rng.choice((100, 5_000, 200_000))
    entities = "".join(f'<!ENTITY e{k} "&e{k + 1};&e{k + 1};">' for k in range(rng.choice((20, 20_000))))
    choices: tuple[tuple[str, str], ...] = (
        ("cart.yaml", "[" * deep), ("cart.yaml", "a: &a [*a]\n"), ("run.json", "[" * deep),
        ("run.json", '{"a":' * deep),        ("cart.yaml", "\n".join(" " * k + "a:" for k in range(min(deep, 1300)))),
        ("rod.urdf", "<robot>" + "<link>" * deep), ("rod.urdf", f"<!DOCTYPE a [{entities}]><robot>&e0;</robot>"),
        ("rod.urdf", "<robot name='r'>" + "<a>" * deep + "</a>" * deep + "</robot>"),
        ("rod.urdf", f'<robot name="{"a" * 21_000_000}"/>'), ("results/cart/gap/eps~0.2/gap.json", "[" * deep),
        ("cart.yaml", CART.format(unit="m", tau=TAU, files="run.csv").replace("v: F", "v: " + "(" * deep)),
    )  # fmt: skip
    place.put(*rng.choice(choices))


def unpacked(rng: random.Random, place: Place) -> None:
    """An FMU whose archive leads out, is a bomb, has a hostile description, or whose library crashes."""
    about = (
        b"<?xml version='1.0'?><fmiModelDescription fmiVersion='2.0' modelName='a' guid='a'><CoSimulation "
        b"modelIdentifier='a'/><ModelVariables><ScalarVariable name='pos' valueReference='1' causality='output'>"
        b"<Real/></ScalarVariable></ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    one = "modelDescription.xml"
    library = rng.choice((b"\x7fELF" + bytes(200), b"", b"#!/bin/sh\ntouch ran\n"))
    doctype = b"<!DOCTYPE a [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><fmiModelDescription>&x;</fmiModelDescription>"
    how, inside = rng.randrange(10), place.kept / f"{rng.choice(list(INSIDE))}.fmu"
    content = (
        inside.read_bytes() if how > 6 and inside.is_file() else
        _bomb() if how == 0
        else archive({one: about, rng.choice(("../../outside/precious", "/tmp/ran", "..\\x", "a/../../x")): b"x"})
        if how == 1
        else archive({one: doctype}) if how == 2
        else archive({one: about} | {f"f{k}": b"" for k in range(10_001)}) if how == 3
        else archive({one: b"<a>" * 300_000}) if how == 4
        else archive({one: about})[:-30] if how == 5
        else archive({one: about, "binaries/linux64/a.so": library})
    )  # fmt: skip
    place.put("unit.fmu", content)


def environment(rng: random.Random, place: Place) -> None:
    """No home, another locale, no place for temporary files, few descriptors, little memory."""
    how = rng.randrange(9)
    if how == 0:
        place.environment |= {"HOME": None, "XDG_CACHE_HOME": None}
    elif how == 1:
        place.environment |= {
            "LC_ALL": rng.choice(("C", "POSIX", "de_DE.UTF-8", "tr_TR.UTF-8", "xx")),
            "PYTHONUTF8": "0",
        }
    elif how == 2:
        place.environment |= {"TMPDIR": "/nowhere", "TZ": "Mars/Olympus"}
    elif how == 3:
        place.environment |= {"XDG_CACHE_HOME": "/proc/nowhere", "COLUMNS": "3"}
    elif how == 4:
        place.limits["RLIMIT_NOFILE"] = rng.choice((24, 40, 64))
    elif how == 5:
        place.limits["RLIMIT_AS"] = rng.choice((1, 2, 3)) << 29
    elif how == 6:
        place.limits["RLIMIT_FSIZE"] = rng.choice((0, 1000, 20_000))
    elif how == 7:
        place.environment |= {"HOME": "relative", "MPLBACKEND": "TkAgg", "PYTHONHASHSEED": "7"}
    else:
        place.twice = True


def disk(rng: random.Random, place: Place) -> None:
    """A disk that is full or takes nothing."""
    place.mounted = True


def clock(rng: random.Random, place: Place) -> None:
    """A clock that jumps by years, forwards and back."""
    import time

    now, jumps = time.time, random.Random(rng.random())

    def jumping() -> float:
        return now() + jumps.choice((0.0, 1e9, -1e9, -1.0))

    place.first.append(lambda: setattr(time, "time", jumping))


Ingredient = Callable[[random.Random, Place], None]
INGREDIENTS: tuple[Ingredient, ...] = (
    link, link, pipe, output_link, output_link, hard_link, modules, profile, named, unit, pattern, huge, nested, nested,
    unpacked, environment, environment, disk, clock,
)  # fmt: skip
FOLDERS = ("here", "a b", "über ß", "a\nb", "-x", "{case}", "$HOME", "x" * 120, "%s", "'")
