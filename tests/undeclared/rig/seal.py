"""Recordings on one side, what the rig was told on the other: only scoring opens the sealed file."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tests.undeclared.rig import draw, pendulum


def produce(folder: Path, kind: str, seed: int, sigma: float = 1e-3, velocity: bool = False) -> None:
    """Write `record.npz` and `sealed.json`; kind is none, one, two, three or the name of something outside."""
    rng = np.random.default_rng([seed, *kind.encode()])
    counts = {"one": 1, "two": 2, "three": 3}
    if kind in counts:
        hidden = draw.draw(rng, draw.draw_set(rng, counts[kind]))
    elif kind == "none":
        hidden = pendulum.Hidden()
    else:
        hidden = draw.draw_outside(rng, kind)
    traces = pendulum.record(hidden, rng, sigma, velocity)
    arrays = {f"{name}{k}": a for k, trace in enumerate(traces) for name, a in zip("tyu", trace, strict=True)}
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "record.npz", **arrays)
    (folder / "sealed.json").write_text(json.dumps(asdict(hidden)))
