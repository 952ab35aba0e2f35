"""Recordings on one side, what the rig was told on the other: only scoring opens the sealed file."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tests.undeclared.rig import alike, draw, mujoco_pendulum, pendulum

_COUNTS = {"one": 1, "two": 2, "three": 3}


def produce(folder: Path, kind: str, seed: int, sigma: float = 1e-3, velocity: bool = False) -> None:
    """Write `record.npz` and `sealed.json`.

    `kind` is none; one, two, three (effects of the first set); wide two (of the whole range); the name of a single
    effect; look-alikes of `alike.py`; mujoco (one effect, in that engine); or the name of something outside.
    """
    rng = np.random.default_rng([seed, *kind.encode()])
    if kind == "mujoco":
        hidden = mujoco_pendulum.draw(rng)
        traces = mujoco_pendulum.record(hidden, rng, sigma)
    else:
        hidden = _hidden(kind, rng)
        traces = pendulum.record(hidden, rng, sigma, velocity)
    arrays = {f"{name}{k}": a for k, trace in enumerate(traces) for name, a in zip("tyu", trace, strict=True)}
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "record.npz", **arrays)
    (folder / "sealed.json").write_text(json.dumps(asdict(hidden)))


def _hidden(kind: str, rng: np.random.Generator) -> pendulum.Hidden:
    if kind in _COUNTS:
        return draw.draw(rng, draw.draw_set(rng, _COUNTS[kind]))
    if kind == "none":
        return pendulum.Hidden()
    if kind == "wide two":
        return draw.draw(rng, draw.draw_set(rng, 2, draw.WIDE, draw.SAME))
    if kind in draw.SIZES:
        return draw.draw(rng, [kind])
    if kind in alike.PAIRS or kind in alike.ONES:
        return alike.draw_alike(rng, kind)
    return draw.draw_outside(rng, kind)
