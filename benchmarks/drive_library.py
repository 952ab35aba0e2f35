"""Effects of drives and sensors, each hidden alone and beside what resembles it, on several plants.

    python benchmarks/drive_library.py [--kinds torque_speed_limit] [--plants arm] [--seeds 1] [--again]

Records are made in steps of 20 microseconds (tests/undeclared/rig/drives.py), 2 x 12 s at 200 Hz, position alone. Each
row is kept in benchmarks/results/drive_library.json as soon as it is there; the table is drive_library.md beside it.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from kept_rows import Rows, asked  # noqa: E402

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.reading.record import Record, Trace  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from simgap.effects import EFFECTS  # noqa: E402
from simgap.model.symbolic import SymbolicModel  # noqa: E402
from tests.effects.plants import unicycle  # noqa: E402
from tests.undeclared.joints import JOINTS, joint, record  # noqa: E402
from tests.undeclared.rig import robot  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "drive_library.json"
ROBOTS = ("robot", "robot without heading")
PLANTS = ("arm", "motor", "oscillator", "slide", *ROBOTS)
# sizes that each plant can show: largest command, a typical speed, a viscous friction; the heavy slide hardly moves
SCALES = {"arm": (3.0, 4.0, 0.06), "motor": (3.0, 4.0, 0.06), "slide": (3.0, 1.5, 0.2), "oscillator": (3.0, 2.0, 0.15)}
Truth = dict[str, dict[str, float]]


def _limit(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    top, speed, _ = SCALES[plant]
    stall = 0.8 * draw() * top
    fall = 0.5 * draw() * stall / speed
    return {"stall": stall, "fall": fall}, {"torque_speed_limit": {"T_s": stall, "k": fall}}


def _viscous(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    b = SCALES[plant][2] * draw()
    return {"viscous": b}, {"viscous_friction": {"b": b}}


def _saturation(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    limit = 0.55 * draw() * SCALES[plant][0]
    return {"limit": limit}, {"input_saturation": {"limit": limit}}


def _gain(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    ratio = 1.0 - 0.12 * draw()
    return {"ratio_p": ratio, "ratio_m": ratio}, {"input_gain": {"ratio": ratio}}


def _curve(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    return {"soft": 1.3 * draw() * SCALES[plant][0]}, {"input_curve": {}}  # a tanh is none of its curves


def _sensor(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    ratio = 1.0 + 0.05 * draw()
    return {"sensor": ratio}, {"sensor_gain": {"ratio": ratio}}


def _slow_actuator(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    lag = 0.02 * draw()
    return {"act": lag}, {"input_lag": {"T": lag}}


def _slow_sensor(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    lag = 0.02 * draw()
    return {"sense": lag}, {"filtered_reading": {"lag": lag}}


def _dead(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    width = 0.06 * draw() * SCALES[plant][0]
    return {"dead": width}, {"input_dead_zone": {"width": width}}


def _soft(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    """A motor of about a tenth of the link's inertia on a spring: a resonance at about 8 Hz, damped by about 8 %."""
    link = JOINTS[plant][0]
    motor = 0.1 * draw() ** 2 * link
    stiff = (2.0 * math.pi * 8.0 * draw() ** 2) ** 2 * motor / (1.0 + motor / link)
    damper = 2.0 * 0.08 * draw() * math.sqrt(stiff * motor)
    told = {"motor": motor, "stiff": stiff, "soft_c": damper}
    return told, {"joint_elasticity": {"I": motor, "k": stiff, "c": damper}}


def _play(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    """A gap that a third of the largest command crosses in about 25 ms; stiff stops, half critically damped."""
    top = SCALES[plant][0]
    motor = 0.08 * draw() ** 2 * JOINTS[plant][0]
    gap = top / 3.0 * (0.025 * draw()) ** 2 / (2.0 * motor)
    quick = 600.0 * draw()
    told = {"motor": motor, "gap": gap, "stiff": motor * quick**2, "soft_c": 2.0 * 0.5 * draw() * motor * quick}
    return told, {"backlash": {"b": gap, "I": motor}}


def _bouncing(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    """The same gap between stops that give back 0.6 to 0.8 of the speed."""
    told, truth = _play(plant, draw)
    return told | {"soft_c": 0.22 * draw() * math.sqrt(told["stiff"] * told["motor"])}, truth


def _behind(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    """The encoder on the motor, which no effect of the library is."""
    return {"behind": 1.0}, {"encoder on the motor": {}}


def _dahl(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    force, way = 0.04 * draw() * SCALES[plant][0], 0.01 * draw() * SCALES[plant][1]
    return {"F_c": force, "d": way}, {"dahl_friction": {"F_c": force, "d": way}}


def _bristles(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    """A breakaway force of 1.6 times the sliding one, told apart by speeds of a few hundredths of the typical one."""
    told, _ = _dahl(plant, draw)
    rise, slow = 0.6 * draw(), 0.08 * draw() * SCALES[plant][1]
    force = told["F_c"]
    truth = {"lugre_friction": {"F_c": force, "d": told["d"], "rise": rise, "v_s": slow}}
    return told | {"F_s": (1.0 + rise) * force, "v_s": slow}, truth


def _dry(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    force = 0.04 * draw() * SCALES[plant][0]
    return {"F_p": force, "F_m": force}, {"coulomb_friction": {"F_c": force}}


def _rolling(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    loss = 0.02 * draw()
    return {"rolling": loss}, {"rolling_resistance": {"loss": loss}}


def _speed_gain(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    ratio = 1.0 - 0.1 * draw()
    return {"speed_gain": ratio}, {"input_gain": {"ratio": ratio}}


def _speed_bias(plant: str, draw: Callable[[], float]) -> tuple[dict[str, float], Truth]:
    bias = 0.02 * draw()
    return {"speed_bias": bias}, {"input_bias": {"bias": bias}}


Part = Callable[[str, Callable[[], float]], tuple[dict[str, float], Truth]]
ROBOT_KINDS: dict[str, tuple[Part, ...]] = {
    "rolling resistance": (_rolling,),
    "rolling resistance, speed gain": (_rolling, _speed_gain),
    "rolling resistance, speed bias": (_rolling, _speed_bias),
    "speed bias": (_speed_bias,),
}
KINDS: dict[str, tuple[Part, ...]] = {
    "nothing": (),
    "viscous friction": (_viscous,),
    "saturation": (_saturation,),
    "saturation, viscous friction": (_saturation, _viscous),
    "gain": (_gain,),
    "torque-speed limit": (_limit,),
    "torque-speed limit, viscous friction": (_limit, _viscous),
    "torque-speed limit, gain": (_limit, _gain),
    "sensor gain": (_sensor,),
    "sensor gain, viscous friction": (_sensor, _viscous),
    "sensor gain, gain": (_sensor, _gain),
    "slow actuator": (_slow_actuator,),
    "slow sensor": (_slow_sensor,),
    "slow sensor, viscous friction": (_slow_sensor, _viscous),
    "dead zone": (_dead,),
    "gain curve": (_curve,),
    "gain curve, viscous friction": (_curve, _viscous),
    "gain curve, dead zone": (_curve, _dead),
    "Dahl friction": (_dahl,),
    "LuGre friction": (_bristles,),
    "LuGre friction, viscous friction": (_bristles, _viscous),
    "dry friction": (_dry,),
    "elastic joint": (_soft,),
    "elastic joint, viscous friction": (_soft, _viscous),
    "elastic joint, gain": (_soft, _gain),
    "elastic joint, slow actuator": (_soft, _slow_actuator),
    "elastic joint, encoder on the motor": (_soft, _behind),
    "backlash": (_play,),
    "backlash, rebound": (_bouncing,),
    "backlash, viscous friction": (_play, _viscous),
    "backlash, gain": (_play, _gain),
    "backlash, dead zone": (_play, _dead),
    "backlash, dry friction": (_play, _dry),
    "backlash, encoder on the motor": (_play, _behind),
}


KINDS |= ROBOT_KINDS
ASIDE: dict[Part, tuple[str, ...]] = {
    _soft: (), _play: (), _bouncing: (), _bristles: ("dahl_friction", "lugre_friction"),
}  # fmt: skip
UNNAMED = ", nothing named"
KINDS |= {kind + UNNAMED: KINDS[kind] for kind in ("elastic joint", "backlash", "backlash, viscous friction")}


def made_on(plant: str, told: dict[str, float], seed: int) -> tuple[SymbolicModel, Record, DiagnosisSettings]:
    """The plant as declared, a record of it, and how long its windows are."""
    if plant not in ROBOTS:
        return joint(plant), record(plant, told, seed), DiagnosisSettings()
    heading = plant == "robot"
    runs = robot.record(told, np.random.default_rng([seed, 83]), heading)
    traces = tuple(Trace(f"run{k}", *run) for k, run in enumerate(runs))
    measured = ("px", "py", "heading") if heading else ("px", "py")
    settings = DiagnosisSettings(window_s=2.0, horizon_s=2.0)
    return unicycle(robot.TRACK), Record(traces, measured, ("speed", "turn")), settings


def hidden(plant: str, kind: str, seed: int) -> tuple[dict[str, float], Truth]:
    """What the rig is told, and the effects that are to be found with their numbers."""
    rng = np.random.default_rng([seed, *kind.encode(), *plant.encode()])
    told: dict[str, float] = {}
    truth: Truth = {}
    for part in KINDS[kind]:
        numbers, names = part(plant, lambda: float(rng.uniform(0.8, 1.25)))
        told, truth = told | numbers, truth | names
    if "filtered_reading" in truth and plant != "arm":  # linear, read by one sensor: named by its actuator
        truth["input_lag"] = {"T": truth.pop("filtered_reading")["lag"]}
    if {"sensor_gain", "input_gain"} <= set(truth) and plant != "arm":  # linear, read by one sensor: they act as one
        truth["input_gain"]["ratio"] *= truth.pop("sensor_gain")["ratio"]
    return told, truth


def one(plant: str, kind: str, seed: int, budget: float | None) -> dict[str, Any]:
    """Make one record, diagnose it, score it."""
    told, truth = hidden(plant, kind, seed)
    model, made, settings = made_on(plant, told, seed)
    named = {n for part, n in ASIDE.items() if part in KINDS[kind] and not kind.endswith(UNNAMED)}
    if named:  # what is sought only where it is named, and what it extends
        also = {n for names in named for n in names}
        settings = replace(settings, effects=tuple(n for n, e in EFFECTS.items() if not e.second or n in also))
    begun = time.process_time()
    d = diagnose(model, made, replace(settings, budget_s=budget))
    cpu = time.process_time() - begun
    answer = {e.name: {n: p.value for n, p in e.parameters.items()} for e in d.effects}
    answer |= {f.fault: {"lag": f.value} for f in d.recording if f.fault == "filtered_reading"}
    sets = [{e.name for e in a.effects} for a in d.alternatives]
    errors = [
        abs(answer[name][n] - v) / abs(v) for name, own in truth.items() if name in answer for n, v in own.items()
    ]
    faults = {"filtered_reading"} & set(truth)
    ci = {(e.name, n): p.ci95 for e in d.effects for n, p in e.parameters.items()}
    covered = [bool(ci[name, n][0] <= v <= ci[name, n][1]) for name, own in truth.items() if name in answer
               for n, v in own.items() if ci.get((name, n)) is not None]  # fmt: skip
    return {
        "plant": plant, "kind": kind, "seed": seed, "verdict": d.verdict, "truth": truth, "answer": answer,
        "right": d.verdict == ("attributed" if set(truth) - faults else "none"),
        "exact": set(answer) == set(truth), "listed": set(answer) == set(truth) or set(truth) in sets,
        "wrong": sorted(set(answer) - set(truth)), "error": max(errors, default=None), "covered": covered,
        "ratio": d.after.held_out_ratio, "chi2_dof": [d.before.chi2_dof, d.after.chi2_dof],
        "alternatives": [sorted(s) for s in sets], "faults": [f.fault for f in d.recording], "cpu_s": round(cpu, 1),
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown, one kind a row."""
    head = ("plants", "records", "exact", "listed", "right verdict", "wrong attributed", "wrong partial",
            "largest error of an exact answer", "intervals that cover", "CPU s, median")  # fmt: skip
    lines = ["| hidden | " + " | ".join(head) + " |", "|---" * (len(head) + 1) + "|"]
    for kind in KINDS:
        own = [r for r in rows if r["kind"] == kind]
        if not own:
            continue
        covered = [c for r in own if r["exact"] for c in r["covered"]]
        errors = [r["error"] for r in own if r["exact"] and r["error"] is not None]
        wrong = [r for r in own if not r["listed"] and r["wrong"]]
        cells = (
            ", ".join(p for p in PLANTS if any(r["plant"] == p for r in own)), len(own),
            sum(r["exact"] for r in own), sum(r["listed"] for r in own),
            sum(r.get("right", r["verdict"] == ("attributed" if r["truth"] else "none")) for r in own),
            sum(r["verdict"] == "attributed" for r in wrong), sum(r["verdict"] == "partial" for r in wrong),
            f"{max(errors):.2g}" if errors else "", f"{sum(covered)} of {len(covered)}" if covered else "",
            f"{float(np.median([r['cpu_s'] for r in own])):.3g}",
        )  # fmt: skip
        lines.append(f"| {kind} | " + " | ".join(str(c) for c in cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Make what is asked for and is not there yet."""
    given = asked(__doc__, PLANTS, KINDS, usual=("arm", "motor"))
    rows = Rows(OUT, table, given.again)
    for seed in range(given.first, given.first + given.seeds):
        for kind in given.kinds:
            for plant in ROBOTS if kind in ROBOT_KINDS else [p for p in given.plants if p not in ROBOTS]:
                place = {"plant": plant, "kind": kind, "seed": seed}
                rows.make(place, lambda place=place: one(**place, budget=given.budget), unsaid=("covered",))


if __name__ == "__main__":
    main()
