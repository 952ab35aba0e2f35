"""Coverage of the bound of three simulators with noise, on steps that nothing has seen.

    python benchmarks/noise.py

writes benchmarks/results/noise.json and benchmarks/results/noise.md. For each plant a million steps are taken, 1,000 at
each of 1,000 places: half of them random, half corners of the cells of samples, farthest from every sample. Beside the
share outside gamma stands by how much a bound without a statement about noise would have to be wider: that leaves none
of these steps out, and would be wrong at the next million.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"
PLACES, DRAWS, SEED = 1_000, 1_000, 17

FRICTION = """
import numpy as np

def step(x, u, tau, rng):
    b = rng.gamma(4.0, 0.05, len(x))
    for _ in range(4):
        v = x[:, 1] + 0.25 * tau * (4.0 * u[:, 0] - 9.0 * np.sin(x[:, 0]) - b * x[:, 1])
        x = np.stack([x[:, 0] + 0.25 * tau * v, v], axis=1)
    return x
"""
CART = {
    "plant": {"states": {"x": {"unit": "m"}, "v": {"unit": "m/s"}}, "inputs": {"F": {"unit": "N"}},
              "symbolic": {"dynamics": {"x": "v", "v": "F"}}},
    "domain": {"tau": 0.1, "X": {"x": [-1, 1], "v": [-1, 1]}, "U": {"F": {"values": [-1, 0, 1]}}},
}  # fmt: skip
PENDULUM = {
    "plant": {"states": {"q": {"unit": "rad"}, "w": {"unit": "rad/s"}}, "inputs": {"T": {"unit": "N*m"}},
              "symbolic": {"dynamics": {"q": "w", "w": "4*T - 9*sin(q)"}}},
    "domain": {"tau": 0.05, "X": {"q": [-0.5, 0.5], "w": [-1, 1]}, "U": {"T": {"values": [-1, 0, 1]}}},
}  # fmt: skip
EQUATIONS = {"engine": "equations", "integrator": "rk4", "slopes": "sampled"}
PLANTS: dict[str, dict[str, Any]] = {
    "cart, additive noise": CART | {
        "simulator": EQUATIONS | {"equations": {"dynamics": {"x": "v", "v": "F - 0.1*v - 0.05*sin(3*x)"}},
                                  "noise": {"x": {"normal": 0.001}, "v": {"normal": 0.005}}}},
    "pendulum, random friction": PENDULUM | {
        "simulator": {"engine": "python", "function": "friction.py:step", "batch": True, "stochastic": True}},
    "cart, noise of the motor": CART | {
        "simulator": EQUATIONS | {"equations": {"dynamics": {"x": "v", "v": "F - 0.1*v - 0.05*sin(3*x)"}},
                                  "noise": {"F": {"normal": 0.05}}}},
}  # fmt: skip


def bounded(name: str, case: Path, folder: Path) -> dict[str, Any]:
    """Make the bound of a case by its stages, and take the steps."""
    from simgap.config.load import load_case
    from simgap.gap.bounds.load import from_json
    from simgap.gap.sampling.points import covering_grid, own_point
    from simgap.plants.context import Context
    from simgap.stages import fresh
    from tests.stages import road

    began = time.process_time()
    shards = road.roll_out(case, folder)
    fresh.run(case, folder / "fresh.parquet", None, 1)
    road.bound(case, folder, shards, folder / "fresh.parquet", folder / "gap.json")
    content = json.loads((folder / "gap.json").read_text())
    context, gap = Context.load(case), from_json(content)
    rng = np.random.default_rng(SEED)
    grid = covering_grid(context.case, context.box, own_point(context.case))
    corners = np.stack([rng.integers(0, n + 1, PLACES // 2) for n in grid.cells], axis=1)
    x = np.concatenate([context.box.sample(rng, PLACES // 2), context.box.lo + 2.0 * grid.h * corners])
    u = context.input_set[rng.integers(0, len(context.input_set), PLACES)]
    d = steps(load_case(case), case.parent, x, u) - context.plant.sampled.step(x, u)[:, None]
    lo, hi = (ends[:, None] for ends in gap.bounds(x, u))
    excess = np.maximum(lo - d, d - hi)
    outside = (excess > 0.0).any(axis=2)
    half = PLACES // 2
    widths = {
        state: {
            "mean_width": float((hi - lo)[:, 0, i].mean()),
            "wider_for_none_outside": float(max(0.0, (lo - d)[..., i].max()) + max(0.0, (d - hi)[..., i].max())),
            "mean_range_seen": float(np.ptp(d[..., i], axis=1).mean()),
        }
        for i, state in enumerate(context.states)
    }
    return {
        "plant": name, **content["noise"], "steps": outside.size, "outside": int(outside.sum()),
        "share_at_random_places": float(outside[:half].mean()), "share_at_corners": float(outside[half:].mean()),
        "largest_share_at_a_place": float(outside.mean(axis=1).max()), "states": widths,
        "fresh": {key: content["fresh"][key] for key in ("samples", "violations", "upper")},
        "cpu_s": round(time.process_time() - began, 1),
    }  # fmt: skip


def steps(case: Any, folder: Path, x: Any, u: Any) -> Any:
    """DRAWS steps from each place, with noise that no bound has seen: (places, DRAWS, nx)."""
    from simgap.simulators.rollouts import make_simulator

    with make_simulator(case.model_copy(update={"simulator": case.simulator.model_copy(update={"noise_seed": SEED})}),
                        folder) as simulator:  # fmt: skip
        found = []
        for place, command in zip(x, u, strict=True):
            simulator._begin(place, command)
            found.append(simulator._steps(place, command, DRAWS))
    return np.array(found)


def row(found: dict[str, Any]) -> str:
    """A row of the table."""
    name, own = list(found["states"].items())[-1]
    wider = own["wider_for_none_outside"] / own["mean_width"]
    return (
        f"| {found['plant']} | {found['alpha']:g} | {found['draws']:,} x {found['samples']:,} | "
        f"{found['outside']:,} of {found['steps']:,} | {found['share_at_corners']:.1e} | "
        f"{found['largest_share_at_a_place']:.1e} | {own['mean_width']:.3g} ({name}) | {100 * wider:.0f} % |"
    )


def written(rows: list[dict[str, Any]]) -> None:
    """Write what there is, so that a run that is ended leaves its first rows."""
    (RESULTS / "noise.json").write_text(json.dumps(rows, indent=1) + "\n")
    head = [
        "| plant | alpha | draws x samples | outside | share at corners | largest at a place | mean width of gamma | "
        "wider for none outside |",
        "|---|---|---|---|---|---|---|---|",
    ]
    (RESULTS / "noise.md").write_text("\n".join([*head, *map(row, rows)]) + "\n")


def main() -> None:
    """All plants, each for two shares."""
    sys.path.insert(0, str(ROOT))
    rows = []
    for name, own in PLANTS.items():
        for alpha in (0.01, 0.001):
            with tempfile.TemporaryDirectory() as place:
                folder = Path(place)
                (folder / "friction.py").write_text(FRICTION)
                case = folder / "case.yaml"
                more = {"grid": {"eps": 0.15, "shards": 1},
                        "gap": {"basis": [*own["plant"]["states"], *own["plant"]["inputs"], 1], "fresh_samples": 20_000,
                                "noise": {"alpha": alpha}, "lipschitz": {"extreme_value": False}}}  # fmt: skip
                case.write_text(yaml.safe_dump({"name": "noise", **own, **more}, sort_keys=False))
                rows.append(bounded(name, case, folder))
                print(row(rows[-1]), flush=True)
                written(rows)


if __name__ == "__main__":
    main()
