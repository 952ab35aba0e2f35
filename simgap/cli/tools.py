"""Subcommands beside the stages: the paper's numbers, lists, the schema."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from simgap.cli.options import AsJson, Log, Out, app, new_file, new_folder, start_log
from simgap.cli.terminal import console, say, say_json


@app.command()
def paper(
    folder: Annotated[Path, typer.Argument(help="Folder with the paper's cases and printed.yaml.")],
    pendulum: Annotated[Path, typer.Option(help="Case whose simulator is PyBullet with its default inertia.")],
    out: Out,
    workers: Annotated[int, typer.Option(help="Threads.")] = 2,
    log: Log = None,
) -> None:
    """Show what the paper's printed gap functions allow, and printed numbers beside reproduced ones."""
    from simgap.paper import table
    from simgap.stages import paper as stage

    start_log(log)
    say(table(stage.run(folder, pendulum, out, workers, log)))


@app.command()
def effects(
    case: Annotated[Path | None, typer.Argument(help="Case file; lists what it can act on.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the effects with formula, parameters and units; with a case, what each can act on."""
    from simgap.stages.effects import listed, printed

    start_log(None)
    if as_json:
        say_json(listed(case))
    else:
        say(printed(listed(case)))


@app.command()
def schema(
    out: Annotated[Path, typer.Option(help="File to write.", callback=new_file)] = Path("configs/schema.json"),
) -> None:
    """Write the JSON schema of case files, for editors that complete and check."""
    from simgap.config.case import schema_text
    from simgap.io.atomic import write_text

    write_text(out, schema_text())


@app.command()
def reference(
    out: Annotated[Path, typer.Option(help="Folder to write into.")] = Path("docs/reference"),
) -> None:
    """Write the pages of all keys of a case and of all effects."""
    from simgap.io.atomic import write_text
    from simgap.stages.reference import reference as pages

    for name, text in pages().items():
        write_text(out / name, text)


@app.command()
def times(
    results: Annotated[Path, typer.Argument(help="Folder of results, or of one case.")] = Path("results"),
    as_json: AsJson = False,
) -> None:
    """Show where the time of a run went: every job with its wall time, CPU time and memory, the costliest first."""
    from simgap.cli.timed import show
    from simgap.io.job_times import job_times

    jobs = job_times(results)
    if as_json:
        say_json([asdict(job) for job in jobs])
    else:
        show(console(), jobs)


@app.command()
def export(
    what: Annotated[Path, typer.Argument(help="controller.npz, or a case file with effects.", show_default=False)],
    out: Annotated[
        Path, typer.Option(help="law.h, law.py, model.urdf or model.xml (MJCF).", show_default=False, callback=new_file)
    ],
) -> None:
    """Write a controller as a C header or a Python file, or the model of a case with its effects as a URDF or MJCF."""
    from simgap.io.controller_export import export_controller
    from simgap.io.controller_file import load_controller
    from simgap.io.model_export import export_model

    if what.suffix in (".yaml", ".yml"):
        export_model(what, out)
    else:
        controller = load_controller(what)
        export_controller(controller, out)
        cells, size = len(controller.choice), out.stat().st_size
        held = f"; compiled, its table takes {2 * cells:,}, 2 for each of {cells:,} cells" if out.suffix == ".h" else ""
        say(f"Wrote {out}, {size:,} bytes{held}.")


@app.command()
def certify(
    what: Annotated[Path, typer.Argument(help="Case file, or its folder in results/.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Folder for the certificate.", show_default=False, callback=new_folder)],
    bound: Annotated[Path | None, typer.Option("--gap", help="gap.json, if it is not at its place.")] = None,
    controller: Annotated[Path | None, typer.Option(help="controller.npz, if it is not at its place.")] = None,
    log: Log = None,
) -> None:
    """Export a controller as a certificate that checker/check.py verifies without simgap."""
    from simgap.stages import certify as stage

    start_log(log)
    if bound is not None and controller is not None:
        stage.run(what, bound, controller, out)
        return
    case, own_bound, own_controller = stage.results_of(what) if what.is_dir() else stage.of_case(what)
    stage.run(case, bound or own_bound, controller or own_controller, out)
