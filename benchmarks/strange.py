"""Strange records, one of each sort: what a whole diagnosis costs, what it answers, and whether that is right.

    python benchmarks/strange.py [--records "pushed cart-pole"] [--again]

Records come from the generators of `strange_joints.py`, `other_plants.py` and `many_effects.py`, which share no code
with the fit. Of what the library holds, right is the hidden set, `attributed`, or one that is proven to be the same; of
what it does not hold, an answer that names nothing that is not there and is not `attributed`. CPU s are of the
diagnosis, putting the model together included, and without compiling what the machine has compiled before. Each row is
kept in benchmarks/results/strange.json as soon as it is there.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import other_plants  # noqa: E402
import strange_joints  # noqa: E402
from kept_rows import Rows  # noqa: E402
from strange_table import strange  # noqa: E402

from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.record.record import Record  # noqa: E402
from simgap.diagnosis.result import DiagnosisSettings  # noqa: E402
from simgap.diagnosis.simulation.supermodel import build_supermodel  # noqa: E402
from simgap.model.symbolic import SymbolicModel  # noqa: E402
from tests.undeclared.many import many_model, many_record  # noqa: E402
from tests.undeclared.nominals import nominal  # noqa: E402
from tests.undeclared.scoring import mark  # noqa: E402

OUT = ROOT / "benchmarks" / "results" / "strange.json"
Truth = dict[tuple[str, str], dict[str, float]]
# name -> record of strange_joints.py, the effects of the library that are in it, whether that is all
JOINTS: dict[str, tuple[str, tuple[tuple[str, str], ...], bool]] = {
    "motor, friction that depends on the place": (
        "strange motor", (("viscous_friction", "axis"), ("coulomb_friction", "axis")), False
    ),
    "pendulum with rests, the same friction": ("strange pendulum with rests", (("coulomb_friction", "axis"),), False),
    "rail with rests, a periodic force": (
        "strange rail", (("coulomb_friction", "axis"), ("input_bias", "u")), False
    ),
    "pendulum, a periodic force": ("pendulum, pushed", (("viscous_friction", "axis"),), False),
    "pendulum, nothing missing": ("clean pendulum", (), True),
}  # fmt: skip
OTHERS: dict[str, tuple[str, str]] = {
    "cart-pole, pushed": ("cart_pole", "push"),
    "cart-pole from a URDF, pushed, two effects": ("cart_pole_urdf", "push on two effects"),
    "motor, pushed, two effects": ("dc_motor", "push on two effects"),
    "pendulum that changed": ("pendulum", "plant changed"),
    "mass on a spring, coloured noise": ("oscillator", "coloured noise"),
    "arm of two links, inputs late": ("two_link", "input late"),
}
MANY: dict[str, tuple[str, tuple[str, ...]]] = {
    "cart-pole, three effects": ("cart_pole", ("dry", "viscous", "delay")),
    "motor, three effects": ("motor", ("dry", "gain", "lag")),
    "belt stage, three effects": ("stage", ("viscous", "gain", "delay")),
    "ball on a beam, dry friction": ("ball", ("dry",)),
}
RECORDS = (*JOINTS, *OTHERS, *MANY)


def made(name: str) -> tuple[SymbolicModel, Record, Truth, bool]:
    """The model as declared, a record, the effects of the library in it, and whether these are all."""
    if name in JOINTS:
        bench, keys, whole = JOINTS[name]
        model, record = strange_joints.BENCHES[bench].made()
        return model, record, {key: {} for key in keys}, whole
    if name in OTHERS:
        record, truth, _ = other_plants.make(*OTHERS[name], 0)
        return nominal(OTHERS[name][0]), record, truth, True
    plant, hidden = MANY[name]
    record, truth = many_record(plant, hidden, 0)
    return many_model(plant), record, truth, True


def one(record: str) -> dict[str, Any]:
    """Make one record, diagnose it, say whether the answer is right."""
    model, data, truth, whole = made(record)
    for second in (False, True):
        build_supermodel(model, data.measured, (), second)
    begun = time.process_time()
    d = diagnose(model, data, DiagnosisSettings())
    cpu = time.process_time() - begun
    sealed = {
        "effects": [list(k) for k in truth], "library": True,
        "parameters": {f"{n} {on}": values for (n, on), values in truth.items()},
    }  # fmt: skip
    answer = [(e.name, e.on) for e in d.effects]
    exact = mark(d, sealed).exact if whole else set(answer) <= set(truth)
    fits = d.verdict == ("attributed" if truth else "none") if whole else d.verdict in ("partial", "unexplained")
    return {
        "record": record, "rows": data.rows, "verdict": d.verdict, "answer": [list(a) for a in answer],
        "hidden": [list(k) for k in truth], "whole": whole, "faults": [f.fault for f in d.recording],
        "right_names": exact, "right_verdict": fits, "cpu_s": round(cpu, 1),
    }  # fmt: skip


def main() -> None:
    """Make what is asked for and is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", nargs="*", default=list(RECORDS), choices=list(RECORDS))
    parser.add_argument("--again", action="store_true", help="make again what is there")
    given = parser.parse_args()
    rows = Rows(OUT, lambda known: strange(known) + "\n", given.again)
    for name in given.records:
        rows.make({"record": name}, lambda name=name: one(name))


if __name__ == "__main__":
    main()
