"""Is a change of the diagnosis as right as what was there? Some sixty records of all studies and the real sets, paired.

    python benchmarks/sentinel.py --as before [--half set] [--only push real] [--workers 2]
    python benchmarks/sentinel.py --as after --against before

Every record has a seed that no test and no table uses; numbers that decide may be set on the half "set", and are held
against the half "judge". Real sets are read where they are at hand. Each row is kept as soon as it is there, in
benchmarks/results/sentinel.json; `--against` lists every record whose answer differs. CPU seconds include
what compiles.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(Path(__file__).parent)]
OUT = ROOT / "benchmarks" / "results" / "sentinel.json"
DATA = ROOT.parent / "shared" / "data"
SEED = 7300
Row = dict[str, Any]
SAID = ("verdict", "answer", "faults")
# study -> what is hidden -> plants; the first of them judges, the second may set, and so on in turn
STUDIES: dict[str, dict[str, Sequence[str]]] = {
    "other_plants": {
        "nothing": ("dc_motor", "pendulum", "cart_pole"), "viscous friction": ("oscillator", "dc_motor"),
        "dry friction": ("pendulum", "oscillator", "dc_motor"), "gain": ("cart_pole", "pendulum"),
        "two effects": ("dc_motor", "oscillator"), "push": ("oscillator", "dc_motor", "pendulum", "oscillator"),
        "push on two effects": ("dc_motor", "pendulum"), "plant changed": ("oscillator", "dc_motor"),
        "input late": ("pendulum", "oscillator"), "state late": ("vtol", "vtol"),
        "coloured noise": ("dc_motor", "oscillator"),
    },
    "mimics": {
        "stop": ("oscillator", "dc_motor"), "stiff stop": ("dc_motor",), "brake": ("oscillator", "cart_pole"),
        "strip that rubs": ("dc_motor",), "two pushes": ("oscillator", "dc_motor"), "long push": ("dc_motor",),
    },
    "noise_colours": {
        "heavy tails": ("oscillator", "dc_motor"), "1/f": ("oscillator",), "filtered": ("dc_motor", "oscillator"),
    },
    "drive_library": {
        "saturation, viscous friction": ("motor",), "torque-speed limit": ("arm", "motor"), "slow sensor": ("arm",),
        "gain curve": ("motor",), "Dahl friction": ("motor", "arm"), "elastic joint": ("arm",),
        "backlash, nothing named": ("motor", "arm"), "load friction": ("motor",), "directional gain": ("arm",),
        "directional friction": ("motor",),
    },
    "many_effects": {
        "": ("ball",), "dry": ("stage", "spring"), "dry+viscous+delay": ("motor", "stage"),
        "dry+gain+lag": ("stage",),
    },
    "outside_library": {
        "absorber": ("oscillator", "dc_motor"), "viscoelastic": ("oscillator",), "limit cycle": ("dc_motor",),
        "rough guide": ("oscillator",),
    },
    "undeclared": {"one": ("", "", ""), "two": ("", ""), "dahl": ("",), "backlash": ("",), "sine": ("",)},
}  # fmt: skip
REAL = ("rod ilqr", "rod sac", "rod direct_collocation", "rod ddp", "rod payload", "rod by hand", "free swings")


def places() -> list[Row]:
    """Every record, in turns of the half that judges and the half that may set."""
    each = [
        {"study": study, "kind": kind, "plant": plant}
        for study, kinds in STUDIES.items() for kind, plants in kinds.items() for plant in plants
    ]  # fmt: skip
    rows = [{**p, "seed": SEED + k, "half": ("judge", "set")[k % 2]} for k, p in enumerate(each)]
    return rows + [{"study": "real", "kind": k, "plant": "", "seed": 0, "half": "judge"} for k in REAL if DATA.is_dir()]


def one(place: Row) -> Row:
    """Make one record, diagnose it, and say whether the answer is right."""
    begun, kept = time.process_time(), real_row if place["study"] == "real" else _simulated
    row = kept(place)
    return {**place, "cpu_s": round(time.process_time() - begun, 1), **row}


def _simulated(place: Row) -> Row:
    """A row of the study that it is of; a record of what the library lacks is right unless a name is `attributed`."""
    study, plant, kind, seed = (place[k] for k in ("study", "plant", "kind", "seed"))
    if study == "undeclared":
        return _undeclared(kind, seed)
    module = __import__(study)
    if study == "mimics":
        row = module.one(plant, kind, seed)
        right = not row["bold"] and (row["verdict"] == "partial" or row["exact"] or kind in module.MIMICS)
        return _row(row, right, row["bold"])
    if study == "outside_library":
        row = module.one(plant, kind, seed % 4 == 0, seed, None)
        return _row(row, row["verdict"] in ("partial", "unexplained"), row["verdict"] == "attributed" and row["other"])
    if study == "noise_colours":
        row = module.one(plant, kind, True, seed, None)
        return _row(row, row["exact"] and row["verdict"] == "attributed", not row["exact"])
    row = module.one(plant, kind, seed) if study == "many_effects" else module.one(plant, kind, seed, None)
    told = set(row.get("hidden_faults", ())) <= set(row.get("faults", ()))
    same = row["exact"] or bool(row.get("equal"))
    word = "attributed" if set(map(str, row["truth"])) - {"filtered_reading"} else "none"
    return _row(row, same and told and row["verdict"] == word, bool(row["wrong"]) and not same)


def _row(row: Row, right: object, wrong: object) -> Row:
    keep = ("verdict", "answer", "faults", "covered", "chi2_dof", "ratio")
    named = row["verdict"] in ("attributed", "partial")
    return {"right": bool(right), "wrong": row["verdict"] if wrong and named else "",
            **{k: row[k] for k in keep if k in row}}  # fmt: skip


def _undeclared(kind: str, seed: int) -> Row:
    from tests.undeclared.plant import pendulum
    from tests.undeclared.rig.seal import produce
    from tests.undeclared.scoring import examine

    with tempfile.TemporaryDirectory() as folder:
        produce(Path(folder), kind, seed)
        d, m = examine(Path(folder), pendulum(), False)
    row = {"verdict": m.verdict, "answer": m.answer, "faults": [f.fault for f in d.recording], "covered": m.covered,
           "chi2_dof": [d.before.chi2_dof, d.after.chi2_dof], "ratio": m.held_out_ratio}  # fmt: skip
    if not m.library:
        return _row(row, m.verdict in ("partial", "unexplained"), m.verdict == "attributed")
    return _row(row, m.exact and m.verdict == "attributed", not m.exact)


def real_row(place: Row) -> Row:
    """A real set; what is right is what is known of it: friction on the rod, the payload's mass, no name by hand."""
    from simgap.diagnosis.diagnose import diagnose
    from simgap.diagnosis.record.record import Record
    from simgap.diagnosis.result import DiagnosisSettings
    from tests.diagnosis.plants import point_pendulum

    kind, horizon, held, keys = place["kind"], 0.2, (), ("time", "position", "velocity", "torque")
    model = point_pendulum(0.6755, 0.5, 0.6755 * 0.25)
    if kind == "free swings":
        horizon, held, keys = 3.0, ("free_swing_2", "free_swing_4"), ("time", "angle", "velocity")
        model = point_pendulum(0.1476, 0.1478, 1.09e-4 + 0.1476 * 0.1478**2)
        runs = [(f"multiarm_pendulum/free_swing_{k}", math.inf) for k in (1, 2, 3, 4)]
    elif kind == "rod by hand":
        runs = [("dfki_pendulum/hand_moved", 10.0)]
    elif kind == "rod payload":
        runs = [("dfki_pendulum/energy_shaping_1kg", math.inf)]
    else:
        held = (kind.split()[1],)
        runs = [("dfki_pendulum/energy_shaping", 3.95), (f"dfki_pendulum/{held[0]}", math.inf)]
    record = Record(tuple(_trace(f, until, keys) for f, until in runs), ("angle", "rate"), ("torque",))
    d = diagnose(model, record, DiagnosisSettings(horizon_s=horizon, held_out_traces=held))
    names = {e.name for e in d.effects}
    right = {
        "free swings": d.verdict == "partial" and bool(names & {"viscous_friction", "coulomb_friction"}),
        "rod by hand": d.verdict == "unexplained",
        "rod payload": any((e.name, e.on) == ("parameter_error", "arm.mass") for e in d.effects),
    }.get(kind, d.verdict == "partial" and bool(names & {"coulomb_friction", "stribeck_friction"}))
    return {
        "verdict": d.verdict, "answer": [[e.name, e.on] for e in d.effects], "right": right, "wrong": "",
        "numbers": {f"{e.name} {e.on} {s}": p.value for e in d.effects for s, p in e.parameters.items()},
        "ci95": {f"{e.name} {e.on} {s}": p.ci95 for e in d.effects for s, p in e.parameters.items()},
        "nearest": [[e.name, e.on] for e in d.nearest.effects] if d.nearest else [],
        "chi2_dof": [d.before.chi2_dof, d.after.chi2_dof],
        "ahead": [dict(d.before.horizon_rmse), dict(d.after.horizon_rmse)],
        "share": d.explained_error, "faults": [f.fault for f in d.recording],
    }  # fmt: skip


def _trace(path: str, until: float, keys: Sequence[str]) -> Any:
    from simgap.diagnosis.record.record import Trace

    table = np.genfromtxt(DATA / f"{path}.csv", delimiter=",", names=True)
    fresh = np.concatenate([[True], np.diff(table[keys[0]]) > 1e-6]) & (table[keys[0]] < until)
    t, q, v, *u = (table[k][fresh] for k in keys)
    if not u:  # free swings: 1 kHz, hanging at pi
        t, q, v = t[::4], q[::4] - math.pi, v[::4]
    return Trace(path.split("/")[1], t, np.stack([q, v], axis=1), (u[0] if u else np.zeros_like(t))[:, None])


def summary(rows: Sequence[Row]) -> str:
    """Right, wrong names, coverage and CPU seconds of each half and of the real sets."""
    lines = []
    for half in ("judge", "set", "real"):
        own = [r for r in rows if (r["study"] == "real") == (half == "real") and half in ("real", r["half"])]
        if own:
            covered = [c for r in own for c in r.get("covered", ())]
            lines.append(
                f"{half:5s} {sum(r['right'] for r in own)} of {len(own)} right, wrong names "
                f"{sum(r['wrong'] == 'attributed' for r in own)} attributed "
                f"{sum(r['wrong'] == 'partial' for r in own)} partial, "
                f"{sum(covered)} of {len(covered)} intervals cover, CPU s {sum(r['cpu_s'] for r in own):.0f}, "
                f"median {np.median([r['cpu_s'] for r in own]):.1f}"
            )
    return "\n".join(lines)


def told(before: Row | None, row: Row) -> str:
    """A row in words, beside what it was."""

    def short(r: Row) -> str:
        answer = "+".join(f"{a[0]} {a[1]}" if isinstance(a, list) else str(a) for a in r["answer"])
        mark = "right" if r["right"] else "WRONG" if r["wrong"] else "short"
        return f"{mark} {r['verdict']} {answer} {r['faults']} {r['cpu_s']:g} s"

    place = f"{row['study']}/{row['kind']}/{row['plant']}/{row['seed']}"
    return f"{place}: {'' if before is None else short(before) + ' -> '}{short(row)}"


def main() -> None:
    """Run the records asked for that are not there yet under this name, and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--as", dest="name", default="now", help="name of this version in the results")
    parser.add_argument("--against", help="name of the version to compare with")
    parser.add_argument("--half", choices=("judge", "set"))
    parser.add_argument("--only", nargs="*", help="words of which a record's study, kind or plant has one")
    parser.add_argument("--again", action="store_true", help="make again what is there")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    kept: dict[str, dict[str, Row]] = json.loads(OUT.read_text()) if OUT.exists() else {}
    own, other = kept.setdefault(given.name, {}), kept.get(given.against or "", {})
    asked = {}
    for place in places():
        words = {place["study"], place["kind"], place["plant"], *place["kind"].split()}
        if given.half in (None, place["half"]) and (not given.only or words & set(given.only)):
            asked["/".join(str(place[k]) for k in ("study", "kind", "plant", "seed"))] = place
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(one, p): key for key, p in asked.items() if given.again or key not in own}
        for job in as_completed(jobs):
            own[jobs[job]] = job.result()
            print(told(other.get(jobs[job]), own[jobs[job]]), flush=True)
            OUT.write_text(json.dumps(kept, indent=1) + "\n")
    rows = [own[key] for key in asked]
    if given.against:
        changed = [k for k in asked if k in other and any(other[k][w] != own[k][w] for w in SAID)]
        print("\nanswers that differ:", *(told(other[k], own[k]) for k in changed), sep="\n")
        print(f"\n{given.against}:\n{summary([other[k] for k in asked if k in other])}\n{given.name}:")
    print(summary(rows))


if __name__ == "__main__":
    main()
