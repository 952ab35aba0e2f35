"""The tables of the documentation, from what the benchmarks wrote.

    python benchmarks/tables.py

Rewrites the text between `<!-- table NAME -->` and `<!-- end -->` in docs; without results a table stays as it is.
A name that is not listed below is that of a table beside the results, NAME.md.
"""

from __future__ import annotations

import json
import re
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from strange_table import strange

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
HIDDEN = ("ks_p", "refused", "log-likelihood lost by scipy")


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def tightness(data: Mapping[str, Any]) -> str:
    """Objective, sides and padding against suprema, means and winning fractions, for each inertia."""
    blocks = [f"eps = {data['eps']:g}; the nominal model alone wins {data['nominal']:.4f}."]
    for inertia, found in data.items():
        if isinstance(found, Mapping):
            head = f"{inertia.capitalize()} ({found['fresh_samples']:,} fresh samples):"
            blocks.append(f"{head}\n\n{bounds(found['rows'], ('x1', 'x2'))}")
    return "\n\n".join(blocks)


def bounds(rows: Mapping[str, Any], states: Sequence[str]) -> str:
    """One line a bound: sup and mean of its size, its mean width, what it wins, what lies outside."""
    table = []
    for name, r in rows.items():
        cells = [
            f"{r[s]['sup']:.3g} ({r[s]['ratio']:.3f}), {r[s]['mean']:.3g}, {r[s]['mean_width']:.2g}" for s in states
        ]
        table.append([name, *cells, f"{r['winning']:.4f}", str(r["violations"])])
    shown = [f"{s}: sup (over largest sample), mean, mean width" for s in states]
    return markdown(["objective, sides, padding", *shown, "winning", "outside"], table)


def robot_tightness(data: Mapping[str, Any]) -> str:
    """The robot's bounds, seen from the robot."""
    about = f"{data['roll_outs']:,} roll-outs, {data['fresh_steps']:,} fresh steps:"
    return f"{about}\n\n{bounds(data['rows'], data['states'])}"


def figures(data: Mapping[str, Any]) -> str:
    """Goals and what was reached."""
    rows = []
    for f in data["figures"]:
        value = f"{f['value']:.4g}" + (f" ({f['note']})" if f["note"] else "")
        rows.append([f["figure"], value, f["goal"], "reached" if f["reached"] else "**missed**"])
    return markdown(["figure", "value", "goal", ""], rows)


def engines(data: Mapping[str, Any]) -> str:
    """The gap between two simulators, or between one and a model."""
    rows = []
    for r in data["rows"]:
        cells = [f"{r[s]['largest']:.2g}, {r[s]['sup']:.2g}, {r[s]['sup_width']:.2g}" for s in ("x1", "x2")]
        rows.append([f"{r['of']} - {r['against']}", *cells, str(r["violations"])])
    units = [f"{s} ({u}): largest gap, sup of the bound, sup of its width" for s, u in (("x1", "rad"), ("x2", "rad/s"))]
    return markdown(["gap", *units, f"outside, of {data['fresh_samples']:,}"], rows)


def shields(data: Mapping[str, Any]) -> str:
    """Policies alone and through a shield."""
    rows = []
    for r in data["rows"]:
        bad = [f"{r[kind]['runs_that_violated_it']} of {r[kind]['runs']}" for kind in ("alone", "shielded")]
        rows.append([r["case"], r["policy"], *bad, f"{r['acted'] / r['samples']:.0%} of {r['samples']:,}"])
    head = ["case", "policy", "violations alone", "through the shield", "samples at which it acted"]
    return markdown(head, rows)


def closed_loop(_: Mapping[str, Any]) -> str:
    """Cases beside the plain pendulum: what they win and what happened in their simulator."""
    rows = []
    for case in ("pendulum_sensing", "pendulum_mujoco"):
        folder = ROOT / "results" / case
        if not (folder / "validation" / "validation.json").is_file():
            continue
        loops = json.loads((folder / "validation" / "validation.json").read_text())["controllers"]
        for kind in ("gap", "nominal"):
            won = json.loads((folder / "synthesis" / kind / "synthesis.json").read_text())["winning_fraction"]
            t = loops[kind]["simulator"]
            runs = f"{t['runs_that_kept_the_specification']:,} of {t['runs']:,}"
            steps = f"{t['steps_outside_gamma']:,} of {t['steps']:,}" if kind == "gap" else "-"
            rows.append([f"`{case}`", "gap-aware" if kind == "gap" else "nominal-only", f"{won:.4f}", runs, steps])
    return markdown(["case", "controller", "winning", "runs that stayed safe", "steps outside gamma"], rows)


def lipschitz(data: Mapping[str, Any]) -> str:
    """Estimators against known constants."""
    names = [n for n in next(iter(data["table"].values())) if n not in HIDDEN]
    rows = []
    for function, found in data["table"].items():
        cells = [cell(found.get(n, {})) for n in names]
        rows.append([function, *cells, f"{found['ks_p']['passes']:.2f}", f"{found['refused']['median']:.0f}"])
    return markdown(["function", *names, "KS passes", "grid refused"], rows)


def cell(found: Mapping[str, float]) -> str:
    """Median, and coverage where the true constant is finite."""
    if "median" not in found:
        return "-"
    return f"{found['median']:.3g}" + (f" ({found['coverage']:.2f})" if "coverage" in found else " (no true constant)")


def rollouts(data: Mapping[str, Any]) -> str:
    """Speed of roll-outs against the bare loop."""
    row = [f"{data['rate_per_core_1/s']:,}", f"{data['bare_rate_per_core_1/s']:,}", f"{data['ratio']:.2f}"]
    return markdown(["roll-outs per second and core", "bare PyBullet loop", "ratio"], [row])


def contact_solver(data: Mapping[str, Any]) -> str:
    """PyBullet's contact solvers on the robot: what a step costs, what headings, mirror and reference differ by."""

    def of(values: Sequence[float]) -> str:
        return ", ".join(f"{1e3 * v:.2g}" for v in values)

    differences = ("between_headings", "from_mirror_image", "from_reference")
    rows = [[name, f"{r['ms_a_step']:.2f}", *(of(r[d]) for d in differences)] for name, r in data["rows"].items()]
    head = ["solver", "CPU ms a step", "between headings", "from its mirror image", "from the reference"]
    return markdown([*head[:2], *(f"{h}: x, y, theta (mm, mm, mrad)" for h in head[2:])], rows)


def plain_run(data: Mapping[str, Any]) -> str:
    """CPU seconds by stage and case, before and, where the case was run again, now."""
    cases = data["before"]["cases"]
    rows = []
    for stage in next(iter(cases.values())):
        runs = ([data[run]["cases"].get(case, {}).get(stage) for run in ("before", "now")] for case in cases)
        rows.append([stage, *(" -> ".join(f"{v:.0f}" for v in pair if v is not None) for pair in runs)])
    return markdown(["CPU s, before -> now", *(case.split("/")[-1] for case in cases)], rows)


def dry_friction(data: Sequence[Mapping[str, Any]]) -> str:
    """Records with rests: names, and what windows fitted jointly miss of windows fitted one by one."""
    rows = []
    for label, kind in dict.fromkeys((r["label"], r["kind"]) for r in data):
        same = [r for r in data if (r["label"], r["kind"]) == (label, kind)]
        covered = [c for r in same for c in r["covered"]]
        ahead, worst = (sorted(values)[len(same) // 2 :] for values in (
            [r["ahead_over_floor"] for r in same], [r["jointly"] / r["alone"] for r in same]
        ))  # fmt: skip
        counts = (sum(r[key] for r in same) for key in ("exact", "settled"))
        named = sum(r["verdict"] == "attributed" for r in same)
        rows.append([
            label, kind, str(len(same)), *map(str, counts), str(named), f"{sum(covered)} of {len(covered)}",
            f"{worst[-1]:.6g}", f"{ahead[0]:.3g}",
        ])  # fmt: skip
    head = ["version", "record", "records", "exact", "settled", "attributed", "intervals that cover"]
    return markdown([*head, "chi^2 jointly / one by one, largest", "error 0.2 s ahead / floor, median"], rows)


def encoders(data: Sequence[Mapping[str, Any]]) -> str:
    """Records by encoders, one plant and step a row."""
    rows = []
    for plant, step in dict.fromkeys((r["plant"], r["step"]) for r in sorted(data, key=lambda r: r["step"])):
        own = [r for r in data if (r["plant"], r["step"]) == (plant, step)]
        covered = [c for r in own for c in r["covered"]]
        right = sum(r["verdict"] == ("attributed" if r["truth"] else "none") for r in own)
        counts = (right, *(sum(bool(r[key]) for r in own) for key in ("exact", "wrong", "faults")))
        cpu = sorted(r["cpu_s"] for r in own)[len(own) // 2]
        rows.append(
            [plant, f"{step:g}", str(len(own)), *map(str, counts), f"{sum(covered)} of {len(covered)}", f"{cpu:.3g}"]
        )
    head = ["plant", "count over noise", "records", "right verdict", "right set", "wrong names", "faults named"]
    return markdown([*head, "intervals that cover", "CPU s, median"], sorted(rows, key=lambda r: r[0]))


def recording_faults(data: Sequence[Mapping[str, Any]]) -> str:
    """Faults of a recording, with and without a missing effect."""
    kinds = {"clean": "", "coloured noise": "coloured_noise", "input late": "late_log", "input reversed": "wrong_sign"}
    kinds |= {"velocity filtered": "filtered_velocity", "columns swapped": "swapped_columns"}
    rows = []
    for plant, fault in dict.fromkeys((r["plant"], r["fault"]) for r in data):
        cells = []
        for missing in (False, True):
            same = [r for r in data if (r["plant"], r["fault"], r["missing"]) == (plant, fault, missing)]
            kind = kinds.get(fault, fault)
            extra = ["input_gain"] if kind == "wrong_sign" else []
            effects = sorted([*extra, *(["viscous_friction"] if missing else [])])
            word = "attributed" if effects else "none"
            named = [set(r["found"]) == ({kind} - {""}) and sorted(r["effects"]) == effects for r in same]
            right = sum(ok and r["verdict"] == word for ok, r in zip(named, same, strict=True))
            said = ", ".join(dict.fromkeys(r["verdict"] for r in same))
            cells.append(f"{right} of {len(same)} ({said})")
        covered = [c for r in data if (r["plant"], r["fault"]) == (plant, fault) for c in r["covered"]]
        rows.append([fault, plant, *cells, f"{sum(covered)} of {len(covered)}"])
    head = ["fault", "plant", "nothing missing: right", "viscous friction: right", "intervals that cover"]
    return markdown(head, rows)


def suprema(_: Mapping[str, Any]) -> str:
    """Sup of gamma for every eps of a plain run of the pendulum."""
    rows = []
    paths = (ROOT / "results" / "pendulum" / "gap").glob("eps~*/gap.json")
    for gap in sorted((json.loads(p.read_text()) for p in paths), key=lambda g: -g["eps"]):
        found = [f"{d['sup_size']:.6f}, {d['sup_width']:.2g}" for d in gap["dimensions"]]
        rows.append([f"{gap['eps']:g}", f"{gap['samples']:,}", *found, f"{gap['fresh']['violations']}"])
    head = ["eps", "roll-outs", "x1: sup size, sup width (rad)", "x2: the same (rad/s)", "outside, of 300,000 fresh"]
    return markdown(head, rows)


def tasks(data: Mapping[str, Any]) -> str:
    """One line a case: what was asked, how large the game is, what it cost, and what the runs did."""
    head = ["case", "formula", "cells x inputs x classes x states", "wins", "progress within", "CPU time, memory",
            "runs that broke it: gap-aware", "nominal-only", "rounds a run", "adversary"]  # fmt: skip
    rows = []
    for name, r in data.items():
        size = f"{' x '.join(map(str, r['cells']))} x {r['inputs']} x {r['classes']} x {r['states']}"
        rounds = f"{r['rounds'][0]} to {r['rounds'][1]}" if r["rounds"] else "-"
        rows.append([
            f"`{name}`", f"`{r['formula']}`", size, f"{100 * r['wins']:.1f} %", f"{r['steps'] * r['tau']:.3g} s",
            f"{r['cpu_s']:.0f} s, {r['mib']:,.0f} MiB", f"{r['violations']:,} of {r['runs']:,}",
            f"{r['nominal_failed']:,} of {r['nominal_runs']:,}", rounds,
            f"{r['attack_violations']:,} in {r['attacked_steps']:,}",
        ])  # fmt: skip
    return markdown(head, rows)


def synthesis(data: Mapping[str, Any]) -> str:
    """Time and memory of synthesis beside goals and SCOTS."""
    rows = []
    for r in data["rows"]:
        once = r["process_s"] - r["cpu_s"] * (r.get("runs", 2) - 1)
        goal, scots = (f"{r[k]:g}" if k in r else "" for k in ("goal_s", "scots_process_s"))
        rows.append(
            [
                r["problem"],
                f"{r['winning']:,}",
                f"{r['cpu_s']:.2f}",
                goal,
                f"{once:.1f}" if once > r["cpu_s"] else "-",
                scots,
                f"{r['peak_MiB']:,}",
            ]
        )
    head = ["problem", "winning cells", "CPU s", "goal", "whole process, CPU s", "SCOTS v0.2", "peak MiB"]
    return markdown(head, rows)


def start_up(data: Mapping[str, Any]) -> str:
    """What each stage of a tiny case spends and imports."""
    seconds = ("cpu_s", "engines_cpu_s", "cold_cpu_s")
    rows = [
        [r["stage"], *(f"{r[k]:.2f}" for k in seconds), str(r["modules"]), ", ".join(r["large"])] for r in data["rows"]
    ]
    head = ["stage", "CPU s", "of its engines", "CPU s, nothing compiled", "modules", "large libraries"]
    return markdown(head, rows)


FAULTS = (
    ("kill", "killed", "not_recovered", "kills of stages (SIGKILL to all processes)", "not taken up to the same bytes"),
    ("storage", "faults", "wrong", "faults of disks, clocks, other programs", "neither one line nor the same bytes"),
    ("fuzz", "inputs", "findings", "hostile and damaged inputs", "neither read nor refused in one line"),
    ("hostile_commands", "folders", "findings", "whole commands in hostile folders", "broke a promise"),
    ("fuzz_guided", "inputs", "findings", "inputs of a fuzzer that follows lines", "read wrongly"),
    ("reproducible", "files", "differing", "files of a run made again elsewhere", "of other bytes"),
    ("mutants", "mutants", "caught", "hand-picked mutants of the code, none of the diagnosis", "caught"),
)
"""Of each benchmark: its name, the keys of its two figures, and what they are."""


def faults(_: Any) -> str:
    """What was done to simgap, how often, and what came of it."""
    rows = []
    for name, number, outcome, what, words in FAULTS:
        path = RESULTS / f"{name}.json"
        if path.is_file():
            data = json.loads(path.read_text())
            found = data[outcome] if isinstance(data[outcome], int) else len(data[outcome])
            rows.append([what, f"{data[number]:,}", f"{found:,} {words}", f"`python benchmarks/{name}.py`"])
    return markdown(["what", "number", "outcome", "command"], rows)


def real_records(data: Mapping[str, Any]) -> str:
    """Answers on recordings of real hardware; those of `kinds` of benchmarks/sentinel.py are its own."""
    shown = ("record", "fitted", "confirmed", "verdict", "named", "result")
    made = json.loads((RESULTS / "sentinel.json").read_text())["now"].values()
    answers = {row["kind"]: row for row in made if row["study"] == "real"}
    rows = [{**r, **_answered([answers[k] for k in r["kinds"]], r)} if "kinds" in r else r for r in data["records"]]
    return markdown(list(shown), [[r[key] for key in shown] for r in rows])


def _answered(rows: Sequence[Mapping[str, Any]], shown: Mapping[str, Any]) -> dict[str, str]:
    """Verdicts, names, the number asked for with the ends of its intervals, and the share of the error explained."""
    names = dict.fromkeys(f"{n} {on.split('.')[-1]}" for r in rows for n, on in r["answer"])
    plain = [n.removeprefix("parameter_error ").replace("_", " ").removesuffix(" hinge") for n in names]
    words = {"verdict": ", ".join(dict.fromkeys(r["verdict"] for r in rows)), "named": ", ".join(plain) or "-"}
    values = [r["numbers"][shown["number"]] for r in rows if shown.get("number") in r["numbers"]]
    if not values or any(r["share"] is None for r in rows):
        return {**words, "result": "-"}
    ends = [e for r in rows for e in r["ci95"][shown["number"]]]
    shares = [100.0 * s for r in rows for s in r["share"]]
    of = f"{min(values):.3g} to {max(values):.3g}" if len(values) > 1 else f"{values[0]:.3g}"
    return {
        **words,
        "result": f"{of} ({min(ends):.3g} to {max(ends):.3g}) {shown['unit']}; "
        f"{min(shares):.0f} to {max(shares):.0f} % of the error explained",
    }


def ur10e(data: Mapping[str, Any]) -> str:
    """Friction of an arm of six joints beside what others found."""
    head = ["joint", "viscous, N m s/rad", "others", "Coulomb, N m", "others"]
    return markdown([*head, "error on `free_5harm`, N m: before", "after"], [list(r.values()) for r in data["ur10e"]])


TABLES: Mapping[str, tuple[str, Callable[[Any], str]]] = {
    "tightness": ("tightness_pendulum.json", tightness),
    "tightness_turtlebot": ("tightness_turtlebot.json", robot_tightness),
    "figures": ("figures_gap.json", figures),
    "engines": ("engines.json", engines),
    "closed_loop": ("../../results/pendulum_sensing/summary.json", closed_loop),
    "tasks": ("tasks.json", tasks),
    "synthesis": ("synthesis.json", synthesis),
    "start_up": ("start_up.json", start_up),
    "lipschitz": ("lipschitz.json", lipschitz),
    "rollouts": ("rollouts.json", rollouts),
    "shields": ("shields.json", shields),
    "plain_run": ("plain_run.json", plain_run),
    "contact_solver": ("contact_solver.json", contact_solver),
    "dry_friction": ("dry_friction.json", dry_friction),
    "encoders": ("encoders.json", encoders),
    "recording_faults": ("recording_faults.json", recording_faults),
    "strange": ("strange.json", strange),
    "real_records": ("real_records.json", real_records),
    "ur10e": ("real_records.json", ur10e),
    "faults": ("fuzz.json", faults),
    "suprema": ("../../results/pendulum/full/summary.json", suprema),
}


def _results(name: str) -> Path:
    return RESULTS / TABLES[name][0] if name in TABLES else RESULTS / f"{name}.md"


def made(name: str) -> str | None:
    """A table by its name: of the results, or as the study wrote it; none where its results are not kept."""
    path = _results(name)
    if not path.is_file():
        return None
    return TABLES[name][1](json.loads(path.read_text())) if name in TABLES else path.read_text().strip()


def made_on(name: str) -> str:
    """The day of the results of a table, by the history of their file; today where that was changed since."""
    git = ("git", "-C", str(ROOT))
    path = str((RESULTS / f"{_results(name).stem}.json").resolve())
    changed = subprocess.run([*git, "status", "--porcelain", path], capture_output=True, text=True, check=True).stdout
    last = subprocess.run([*git, "log", "-1", "--format=%cs", "--", path], capture_output=True, text=True, check=True)
    return time.strftime("%Y-%m-%d") if changed or not last.stdout.strip() else last.stdout.strip()


def filled(text: str, day: Callable[[str], str] | None = None) -> str:
    """A page with its tables made anew, and the `day` of their results below each; None leaves what stands there."""

    def table(found: re.Match[str]) -> str:
        name, below = found[1], found[2] or ""
        new = made(name)
        if new is None:
            return found[0]
        if day is not None:
            below = f"\n*Results of {day(name)}.*\n"
        return f"<!-- table {name} -->\n{new}\n{below}<!-- end -->"

    return re.sub(r"<!-- table (\w+) -->\n.*?(\n\*Results of [\d-]+\.\*\n)?<!-- end -->", table, text, flags=re.S)


def main() -> None:
    """Rewrite every table whose results are there."""
    for page in sorted((ROOT / "docs").rglob("*.md")):
        page.write_text(filled(page.read_text(), made_on))


if __name__ == "__main__":
    main()
