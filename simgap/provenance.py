"""Provenance of a result: the sections that its stage read, the code that computed it, the engines, the seeds.

The code of a stage is its import closure, which `grimp` finds (imports inside functions too, nothing is imported to
find them), and the plug-ins that the case uses, which no import shows because they are found by name.

`READS` are the sections of a case that each stage reads: a change elsewhere in the file reruns nothing of it.
`section.key=value` says that the stage reads no more than whether the key has that value.
"""

from __future__ import annotations

import ast
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from simgap import plugins, reading
from simgap.cache import PACKAGE, recall, remember, sources
from simgap.config.case import Case
from simgap.config.named_files import KEYS, FunctionFile, named_by
from simgap.config.plugged import used_plugins
from simgap.errors import UserError, excerpt

# What the typing of a case file does shows in the sections that are hashed, and what the registry of plug-ins does in
# the plug-ins that are, and what a stage costs decides nothing of its result: their code would invalidate everything.
UNHASHED = (
    "simgap.config.case", "simgap.config.load", "simgap.config.plugged", "simgap.plugins", "simgap.provenance",
    "simgap.lint.costs",
)  # fmt: skip
MOST_TOLD = 3
"""Keys that a message about another case names."""
# Distributions that any result may depend on; what a plug-in depends on, it declares.
SHARED = ("drake", "numpy", "scipy", "sympy", "numba", "clarabel", "cvxpy")

_PLANT = ("plant.urdf", "plant.states", "plant.inputs", "plant.gravity")
_SIMULATED = ("name", *_PLANT, "plant.symbolic.wheels", "domain", "simulator", "sensing.latency", "sensing.latency_of")

_PREVIOUS = ("hidden_state.previous", "hidden_state.classes")
_MODEL = ("name", "plant", "domain")
_HISTORIES = (
    "hidden_state.length", "hidden_state.chains", "hidden_state.chain_length", "hidden_state.seed",
    "symmetry.headings", "symmetry.histories", "symmetry.seed",
)  # fmt: skip
_COUNTED = ("hidden_state.length", "hidden_state.chains", "hidden_state.chain_length", "symmetry.headings",
    "symmetry.histories")  # fmt: skip
# A padding enters the scenario program where it is `inflate`; which of the others it is does not matter there.
_FIT = (
    "gap.basis", "gap.objective", "gap.slack", "gap.sides", "gap.padding=inflate",
)  # fmt: skip
_RUN = (
    "domain", "simulator", "twin", "symmetry", "hidden_state", "grid", "gap", "sensing", "synthesis", "validation",
    "audit",
)  # fmt: skip
_TOLERATED = ("gap.tolerated_probability", "gap.noise", "hidden_state.tolerated_probability")
_JUDGED = ("synthesis.specification", *_TOLERATED)
_CHAINS = ("hidden_state.length", "hidden_state.chain_length")
_WHOLE = ("name", "title", "plant", *_RUN, "measured")

READS: Mapping[str, tuple[str, ...]] = {
    "check": (*_WHOLE, "budget"),
    "grid": ("name", "plant.states", "plant.inputs", "domain.X", "domain.U", *_PREVIOUS),
    "rollouts": (*_SIMULATED, "grid.shards", "gap.noise", *_HISTORIES),
    "fresh": (*_SIMULATED, "gap.fresh_samples", "gap.seed", "hidden_state"),
    "borders": (*_SIMULATED, "plant", "gap.seed", "gap.noise", "hidden_state"),
    "scp": (*_MODEL, *_FIT, *_COUNTED, "hidden_state.classes", "simulator.effects", "simulator.urdf"),  # switching
    "lipschitz": (*_MODEL, "gap.seed", "gap.lipschitz.extreme_value", *_COUNTED),
    "gap": (*_MODEL, "gap", "hidden_state", "symmetry", "simulator", "sensing.latency", "sensing.latency_of"),
    "synthesis": ("name", "plant", "domain", "simulator.effects", "synthesis", "sensing"),
    "validation": ("name", "plant", "domain", "simulator", *_JUDGED, "sensing", "validation"),
    "audit": ("name", "plant", "domain", "simulator", *_JUDGED, *_CHAINS, "sensing", "validation.steps", "audit"),
    "certify": (*_MODEL, "simulator", "synthesis", "sensing"),
    "twin": (*_SIMULATED, "twin"),
    "paper": _SIMULATED,
    "rig": _SIMULATED,
    "trace": ("name", "title", "plant", "domain", "synthesis.specification"),
    "diagnosis": (*_WHOLE, "budget"),  # the corrected case is a copy of the whole
    "next": ("name", "plant", "domain", "measured"),
    "report": (
        "name",
        "title",
        "plant",
        "domain",
        "simulator",
        "twin",
        "grid.eps",
        "synthesis.specification",
        "sensing",
    ),
}

COPIED = ("title", "twin", "validation", "audit", "budget")
"""Sections of which a diagnosis makes no use: it copies them into the corrected case."""

SIMULATED = ("rollouts", "fresh", "rig")
"""Stages that ask the simulator alone: what the nominal model gains from recordings of it leaves them as they are."""

CONTROLLED = ("synthesis", "gap")
"""Stages on which whatever runs the gap-aware controller rests."""

CLOSED_FORM = ("scp", "lipschitz")
"""Stages that read all of the simulator where its engine may know it in closed form."""

OWN_FORMAT = ("scp",)
"""Stages that read of a simulator's file in its own format where it switches, and not the rest of the simulator."""

EVERY_EFFECT = ("check", "diagnosis", "next", "report")
"""Stages that try or describe effects which the case does not name."""

TRANSLATED = ("grid", "borders", "scp", "lipschitz", "gap")
"""Stages that read all of the symmetry where it is a translation: one cell along its states, and shifted samples."""


def digest(content: Any) -> str:
    """A short hash of plain content."""
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def sections_digest(case: Case, sections: Iterable[str], folder: Path) -> str:
    """A hash of what a stage reads: `parts_of` together."""
    return digest(parts_of(case, sections, folder))


def parts_of(case: Case, sections: Iterable[str], folder: Path) -> dict[str, str]:
    """A hash of each key ('domain.tau') of sections by dotted name ('plant.states'), wherever the case stands.

    Files that a key names, with those that they name in turn, and plug-ins beside the case count by their bytes and not
    by their paths. Of 'gap.padding=inflate' no more is read than whether the key has the value.
    """
    found: dict[str, str] = {}
    whole = case.model_dump(mode="json")
    for name in sections:
        section, _, wanted = name.partition("=")
        value: Any = whole
        for part in section.split("."):
            value = value.get(part) if isinstance(value, dict) else None
        if wanted:
            found[name] = digest(value == wanted)
        elif isinstance(value, dict):
            read = _content("", value, folder)
            found |= {f"{section}.{key}": digest(own) for key, own in read.items()}
        else:
            found[section] = digest(_content(section.rpartition(".")[2], value, folder))
    return found


def _content(key: str, value: Any, folder: Path) -> Any:
    """Content below a key, with the bytes of what it names."""
    if isinstance(value, dict):
        read = {name: _content(name, own, folder) for name, own in value.items()}
        if value.get("engine") == "python":
            function = FunctionFile.find(value["function"], folder)
            files = function.digests()
            read["function"] = [files.pop(function.path.name), files, function.name]
        return read
    if isinstance(value, list):
        return [_content("", own, folder) for own in value]
    file, _, name = value.rpartition(":") if isinstance(value, str) else ("", "", "")
    if file.endswith(".py") and reading.is_file(folder / file):
        return [file_digest(folder / file), name]
    if key in KEYS and isinstance(value, str) and reading.is_file(folder / value):
        named = named_by(folder / value) if key != "fmu" else ()
        return [file_digest(folder / value), {name: file_digest(place) for name, place in named}]
    return value


def sections_of(stage: str, case: Case) -> tuple[str, ...]:
    """Sections of a case that a stage reads: a foreign engine gets the case, and may read all of the plant.

    Equations may be those of the plant, and what is known in closed form is read by whatever bounds slopes.
    """
    found = _of_engine(stage, case)
    translated = case.symmetry is not None and bool(case.symmetry.along)
    if getattr(case.simulator, "mjcf", None) is not None and stage in OWN_FORMAT:
        found = (*found, "simulator.mjcf")
    return (*found, "symmetry") if translated and stage in TRANSLATED else found


def _of_engine(stage: str, case: Case) -> tuple[str, ...]:
    engine = getattr(case.simulator, "engine", None)
    foreign = engine is not None and engine not in plugins.BUILT_IN["engines"]
    if not foreign and engine != "equations":
        return READS[stage]
    own = "plant" if foreign else "plant.symbolic"
    if stage in CLOSED_FORM:
        return (*READS[stage], "simulator", own)
    return (*READS[stage], own) if "simulator" in READS[stage] else READS[stage]


def file_digest(path: Path) -> str:
    """A short hash of a file's bytes."""
    return reading.sha256(path)[:16]


def module_of(stage: str) -> str:
    """The module of a stage, among the optional ones if not among those of a run."""
    own = f"simgap.stages.{stage}"
    return own if own in imports() else f"simgap.extras.{stage}"


def code_digest(stage: str, case: Case | None = None, folder: Path = Path()) -> str:
    """A hash of the code that a stage runs for a case: its import closure and the plug-ins that the case uses."""
    content: dict[str, Any] = module_digests(closure(module_of(stage)))
    for group, name in plugins_of(stage, case):
        content[f"{group}: {name}"] = digest(_sources(group, name, folder))
    return digest(content)


def plugins_of(stage: str, case: Case | None) -> list[tuple[str, str]]:
    """Group and name of the plug-ins that a stage runs for a case: those of the groups whose door it imports."""
    reached = closure(module_of(stage))
    plugins_used = [(u.group, u.name) for u in (used_plugins(case) if case is not None else ())]
    plugins_used += [("effects", name) for name in _effects(stage, case)]
    copied = stage == "diagnosis"  # the corrected case takes copies of the files along
    # over hidden states an engine's settings are asked how far its paths stray, and their methods stand in its file
    asks = case is not None and case.hidden_state is not None and "simulator" in READS.get(stage, ())
    return [
        (g, n)
        for g, n in plugins_used
        if plugins.DOORS.get(g) in reached or (copied and ".py:" in n) or (asks and g == "engines")
    ]


def _effects(stage: str, case: Case | None) -> list[str]:
    """Names of the effects that a stage may apply or describe; an unknown one is told by the stage itself."""
    known = plugins.names("effects")
    if stage in EVERY_EFFECT or case is None:
        return list(known)
    added = (*case.plant.effects, *(case.simulator.effects if case.simulator is not None else ()))
    return sorted({e.name for e in added} & set(known))


def _sources(group: str, name: str, folder: Path) -> dict[str, str]:
    """Sources of a plug-in: its file, and all that this file imports from the package."""
    built_in = plugins.BUILT_IN[group].get(name)
    if built_in is not None:
        return module_digests(closure(built_in.partition(":")[0]))
    file = plugins.source(plugins.find(group, name, folder))
    if file is None:
        return {}
    content = reading.read_bytes(file)
    known = imports()
    modules = {m for name in imported_names(content) if name in known for m in closure(name)}
    named = folder / name.rpartition(":")[0]  # it may take its class from another file
    own = {"named": file_digest(named)} if ".py:" in name and reading.is_file(named) else {}
    return {"": hashlib.sha256(content).hexdigest(), **own, **module_digests(modules)}


def module_digests(names: Iterable[str]) -> dict[str, str]:
    """A hash of the source of each module of the package, which does not change while it runs."""
    return {name: sources()[_file(name)][0][:16] for name in sorted(names)}


def imported_names(source: bytes) -> list[str]:
    """Names of modules, and of what is taken from them, that a file outside the package imports from it."""
    names: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names += [a.name for a in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
    return names


@cache
def closure(module: str) -> frozenset[str]:
    """A module of this package and all that it imports from the package, however late; without `UNHASHED`."""
    graph, found, waiting = imports(), set[str](), [module]
    while waiting:
        name = waiting.pop()
        if name in graph and name not in found:
            found.add(name)
            waiting += graph[name]
    return frozenset(found - {"simgap"})


@cache
def imports() -> dict[str, list[str]]:
    """Imports of each module of the package from it, without `UNHASHED`; found once for sources and then kept."""
    texts = {path.relative_to(PACKAGE).as_posix(): found for path, (found, _) in sources().items()}
    question = digest([texts, UNHASHED, _version("grimp")])
    known: dict[str, list[str]] | None = recall("imports", question)
    if known is not None:
        return known
    import grimp

    graph = grimp.build_graph("simgap", cache_dir=None)
    for module in UNHASHED:
        graph.remove_module(module)
    found = {module: sorted(graph.find_modules_directly_imported_by(module)) for module in graph.modules}
    remember("imports", question, found)
    return found


def _file(module: str) -> Path:
    base = PACKAGE.joinpath(*module.split(".")[1:])
    return base / "__init__.py" if base.is_dir() else base.with_suffix(".py")


def versions(stage: str, case: Case | None = None, folder: Path = Path()) -> dict[str, str]:
    """Versions of what a stage's results depend on: shared distributions, and those of the plug-ins that it runs."""
    found = {name: _version(name) for name in SHARED}
    for group, name in plugins_of(stage, case):
        if group != "effects":  # symbolic terms: no engine, no solver
            plugin = plugins.find(group, name, folder)
            found |= {needed: _version(needed) for needed in getattr(plugin, "distributions", ())}
        own = plugins.distribution(group, name)
        found |= dict([own] if own else [])
    return found


@cache
def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "not installed"


def provenance(
    stage: str, case: Case, folder: Path, seeds: Mapping[str, int] | None = None, rests: Sequence[str] = (), **more: Any
) -> dict[str, Any]:
    """The record that every result carries; it holds no absolute path and no date, so equal runs are equal bytes.

    Args:
        rests: further stages on whose results it rests, so that what these read is compared with a case as well.
    """
    stages = [stage, *rests]
    parts = _parts_of_stages(stages, case, folder)
    return {
        "stage": stage,
        "case": case.name,
        "reads": {"stages": stages, "sections": parts, "sha256": digest(parts)},
        "code": code_digest(stage, case, folder),
        "versions": {"simgap": _version("simgap"), **versions(stage, case, folder)},
        "seeds": dict(seeds or {}),
        **more,
    }


def _parts_of_stages(stages: Iterable[str], case: Case, folder: Path) -> dict[str, str]:
    return parts_of(case, dict.fromkeys(name for stage in stages for name in sections_of(stage, case)), folder)


def require_own(path: Path, record: Any, stages: Sequence[str], case: Case, folder: Path) -> None:
    """Refuse a result of another case, whatever its name: the keys that it rests on have to be those of this one.

    Points of a sweep and a corrected case share what they have in common, so the name alone decides nothing.

    Args:
        record: what `provenance` gave; stages: those of which one must have made it.

    Raises:
        UserError: a result of another stage or of a case whose keys differ, with these.
    """
    made, reads = (record.get("stage"), record.get("reads")) if isinstance(record, dict) else (None, None)
    again = f"Run `simgap {stages[0]}` of this case again."
    if made not in stages:
        what = f"not what `{stages[0]}` makes" + (f", but `{excerpt(made, 40)}`" if isinstance(made, str) else "")
        raise UserError(what, file=path, remedy=again)
    names, parts = (reads.get("stages"), reads.get("sections")) if isinstance(reads, dict) else (None, None)
    if not (isinstance(names, list) and isinstance(parts, dict) and set(names) <= set(READS) and made in names):
        raise UserError("does not say what of a case it was made of", file=path, remedy=again)
    own = _parts_of_stages(names, case, folder)
    passed = {"name", *(["plant.effects"] if made in SIMULATED else COPIED if made == "diagnosis" else [])}
    differing = sorted(key for key in own.keys() | parts.keys() if own.get(key) != parts.get(key))
    keys_named = [excerpt(key, 60) for key in differing if not passed & {key, key.partition(".")[0]}]
    if keys_named:
        rest = f" and {len(keys_named) - MOST_TOLD} more" if len(keys_named) > MOST_TOLD else ""
        keys = ", ".join(keys_named[:MOST_TOLD]) + rest
        raise UserError(f"not of this case, which differs in {keys}", file=path, remedy=f"`{made}` read them. {again}")
