"""Every subcommand: its group in `--help`, what it does, and the function behind it, imported when it is called.

The options of a stage are those of its function (`simgap.stages`); what a command adds is the log.
"""

from __future__ import annotations

import inspect
from collections import UserDict
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from importlib import import_module, metadata
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperGroup
from typer.main import get_command_from_info
from typer.models import CommandInfo

from simgap.cli.terminal import Log, new_file, new_folder, say, start_log
from simgap.stages import Argument

SNAKEMAKE = {"allow_extra_args": True, "ignore_unknown_options": True}
_STAGES = "simgap.stages"


@dataclass(frozen=True)
class Command:
    """A subcommand: where its function stands, what it does in a sentence (else its docstring says it), settings."""

    place: str
    help: str | None = None
    settings: Mapping[str, Any] | None = None

    @property
    def of_a_stage(self) -> bool:
        """True if its options are those of a stage's function, with a log beside."""
        return self.place.startswith(_STAGES)

    def load(self, name: str) -> Any:
        """The command as Typer has it."""
        module, _, function = self.place.partition(":")
        called = getattr(import_module(module), function)
        callback = _with_log(called) if self.of_a_stage else called
        settings = dict(self.settings) if self.settings is not None else None
        info = CommandInfo(name, callback=callback, help=self.help, context_settings=settings)
        return get_command_from_info(info, pretty_exceptions_short=False, rich_markup_mode=None)


def _stage(name: str, help: str, function: str = "run") -> Command:
    return Command(f"{_STAGES}.{name}:{function}", help)


GROUPS: Mapping[str, Mapping[str, Command]] = {
    "Your robot": {
        "tutorial": Command("simgap.cli.cases:tutorial"),
        "new": Command("simgap.cli.cases:new"),
        "check": Command("simgap.cli.cases:check"),
        "run": Command("simgap.cli.workflow:run", settings=SNAKEMAKE),
        "propose": Command("simgap.cli.cases:propose"),
        "refine": Command("simgap.cli.cases:refine"),
        "sweep": Command("simgap.cli.workflow:sweep", settings=SNAKEMAKE),
        "certify": Command("simgap.cli.cases:certify"),
        "export": Command("simgap.cli.cases:export"),
    },
    "Your recordings": {
        "diagnose": Command("simgap.cli.cases:diagnose"),
        "next": Command("simgap.cli.cases:next_experiment"),
        "effects": Command("simgap.cli.cases:effects"),
    },
    "Results": {
        "view": Command("simgap.cli.tools:view"),
        "times": Command("simgap.cli.tools:times"),
        "why": Command("simgap.cli.tools:why"),
        "replay": Command("simgap.cli.tools:replay"),
        "shield": Command("simgap.cli.tools:shield"),
    },
    "Stages, which `simgap run` calls in order": {
        "grid": _stage(
            "grid",
            "Cover X by samples, or list the earlier inputs that stand for a hidden state, and write them with the "
            "inputs.",
        ),
        "rollouts": _stage("rollouts", "Run the simulator on one shard of grid x inputs."),
        "fresh": _stage("fresh", "Run the simulator on random samples that no fit will see."),
        "borders": _stage("borders", "Run the simulator on the border of X and on both sides of switching surfaces."),
        "scp": _stage("scp", "Solve the scenario programs of the gap, one for each dimension."),
        "lipschitz": _stage("lipschitz", "Estimate the Lipschitz constants of the gap, one for each dimension."),
        "gap": _stage(
            "gap", "Combine the dimensions into a bound of the gap, a function of state and input, and check it."
        ),
        "synthesis": _stage(
            "synthesis", "Synthesise the controller on the abstraction of f with its gap, or of f alone."
        ),
        "twin": _stage("twin", "Compare the simulator with the engine that it stands for, on every sample of the run."),
        "validation": _stage(
            "validation", "Run both controllers in the simulator and on the nominal model, and count what they promise."
        ),
        "audit": _stage("audit", "Let an adversary attack the bound and the controller; one violation fails."),
        "trace": _stage("trace", "Record the closed loop for Rerun, and read the recording back."),
        "report": _stage("report", "Write the page of a case: pictures, tables and what the guarantee rests on."),
        "index": _stage("index", "Write the page that links the reports of all cases."),
        "rig": _stage("rig", "Move a stand-in for hardware and record it."),
        "point": _stage("sweep", "Write the case of one point of a sweep.", "write_point"),
        "sweep-page": _stage("sweep", "Write the table and the page of a sweep."),
    },
    "For developers of simgap": {
        "paper": Command("simgap.cli.tools:paper"),
        "schema": Command("simgap.cli.tools:schema"),
        "reference": Command("simgap.cli.tools:reference"),
    },
}
COMMANDS = {name: command for group in GROUPS.values() for name, command in group.items()}


def _with_log(stage: Callable[..., Any]) -> Callable[..., None]:
    """A stage's function with options that Typer reads: those of its signature, then `--log`; text is printed.

    A parameter that is a dataclass stands for its fields, each an option; one that says nothing is Python's alone, but
    for `engine_log`, which is the log.
    """
    hints, groups, given = get_type_hints(stage, include_extras=True), {}, list[inspect.Parameter]()
    names = dict[str, str]()
    for name, parameter in inspect.signature(stage).parameters.items():
        if is_dataclass(hints[name]):
            own = get_type_hints(hints[name], include_extras=True)
            groups[name] = hints[name]
            given += [_parameter(f.name, own[f.name], f.default) for f in fields(hints[name])]
        elif get_origin(hints[name]) is Annotated:
            given.append(_parameter(name, hints[name], parameter.default))
            names[given[-1].name] = name
    given.sort(key=lambda p: p.default is not inspect.Parameter.empty)
    given.append(inspect.Parameter("log", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Log))

    def called(**values: Any) -> None:
        log = values.pop("log")
        start_log(log)
        values = {names.get(name, name): value for name, value in values.items()}
        for name, kind in groups.items():
            values[name] = kind(**{f.name: values.pop(f.name) for f in fields(kind)})
        text = stage(**values, **({"engine_log": log} if "engine_log" in hints else {}))
        if isinstance(text, str):
            say(text)

    called.__signature__ = inspect.Signature(given)  # type: ignore[attr-defined]
    called.__annotations__ = {p.name: p.annotation for p in given}
    return called


def _parameter(name: str, hint: Any, default: Any) -> inspect.Parameter:
    """A parameter of a stage in Typer's words; one that may be None is so where nothing is given."""
    kind, mark = get_args(hint)
    if default in (MISSING, inspect.Parameter.empty):
        default = None if type(None) in get_args(kind) else inspect.Parameter.empty
    if isinstance(mark, Argument):
        name, typed = mark.name or name, typer.Argument(help=mark.help, show_default=False)
    else:
        callback = {"file": new_file, "folder": new_folder, None: None}[mark.writes]
        typed = typer.Option(*([mark.flag] if mark.flag else []), help=mark.help, callback=callback)
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, typed])


class _Loaded(UserDict[str, Any]):
    """Commands by name, each loaded when it is asked for; those that a program adds come first."""

    def __getitem__(self, name: str) -> Any:
        if isinstance(self.data[name], Command):
            self.data[name] = self.data[name].load(name)
        return self.data[name]


class Groups(TyperGroup):
    """Lists the commands of each group under its title, with the whole of their first sentence."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = _Loaded({**self.commands, **COMMANDS, **self.commands})

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]
        """Names in the order of the groups."""
        return list(COMMANDS)

    def format_commands(self, ctx: typer.Context, formatter: object) -> None:  # type: ignore[override]
        """Write the groups."""
        for title, group in GROUPS.items():
            rows = [(n, own.help or self.commands[n].get_short_help_str(200)) for n, own in group.items()]
            with formatter.section(title):  # type: ignore[attr-defined]
                formatter.write_dl(rows)  # type: ignore[attr-defined]


def _version(wanted: bool) -> None:
    if wanted:
        say(f"simgap {metadata.version('simgap')}")
        raise typer.Exit


app = typer.Typer(cls=Groups, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Measure, bound and close the gap between a robot model, its simulator and its recordings."""
