"""Rules by which an adversary picks one of the admissible inputs, the worst in some sense.

Each gives every input a number and the largest is taken; equal ones are told apart at random.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats, Ints
from simgap.attack.danger import Danger

NEAREST, SLOWEST, LARGEST_GAP = "nearest to losing", "slowest", "largest use of gamma"
REVERSAL, ALTERNATING, ANY = "largest change of input", "alternating extremes", "any admissible"
_TIE = 1e-6  # of the range of a rule's numbers


@dataclass(frozen=True, eq=False)
class Scene:
    """Data that rules rank inputs by.

    Attributes:
        predict: states (n, nx), input numbers (n,) and those before them (n,), -1 at rest -> where the plant gets to,
            (n, nx): the middle of what is possible.
        gap_share: how much of gamma a step uses, (n, nx), (n,) -> (n,); None where asking the simulator costs too much.
        danger: of states; inputs: U, (M, nu); late: whether an input acts one sample after it is chosen.
    """

    predict: Callable[[Floats, Ints, Ints], Floats]
    gap_share: Callable[[Floats, Ints], Floats] | None
    danger: Danger
    inputs: Floats
    late: bool = False

    def rules(self) -> tuple[str, ...]:
        """Names of all rules that there are here."""
        own = [NEAREST]
        own += [SLOWEST] if self.danger.level is not None else []
        own += [LARGEST_GAP] if self.gap_share is not None else []
        own += [f"{end} of input {k + 1}" for k in range(self.inputs.shape[1]) for end in ("least", "largest")]
        return (*own, REVERSAL, ALTERNATING, ANY)


def choose(
    rule: str,
    scene: Scene,
    x: Floats,
    acting: Ints,
    last: Ints,
    step: int,
    admissible: Bools,
    rng: np.random.Generator,
) -> Ints:
    """One of the admissible inputs (n, M) for runs at states x (n, nx), by a rule: -> (n,).

    `last` (n,) is the input that acted last, -1 where there is none, `acting` (n,) the one that acts now where inputs
    are late, else `last` too; `step` counts the samples. Rows without an admissible input get any number.
    """
    row, column = np.nonzero(admissible)
    score = np.full(admissible.shape, -np.inf)
    if len(row):
        values = _scores(rule, scene, x[row], acting[row], last[row], column, step)
        spread = np.ptp(values) if len(values) > 1 else 0.0
        score[row, column] = values + _TIE * (spread + 1e-12) * rng.uniform(size=len(row))
    return np.argmax(score, axis=1).astype(np.int64)


def _scores(rule: str, scene: Scene, x: Floats, acting: Ints, last: Ints, m: Ints, step: int) -> Floats:
    """Numbers for pairs of a run and an input, (k,)."""
    u, inputs = scene.inputs[m], scene.inputs
    scale = np.maximum(np.abs(inputs).max(axis=0), 1e-300)
    if rule in (NEAREST, SLOWEST):
        at = scene.predict(x, acting, last) if scene.late else x
        return scene.danger(scene.predict(at, m, acting), rule == SLOWEST)
    if rule == LARGEST_GAP and scene.gap_share is not None:
        return scene.gap_share(x, m)
    if rule == REVERSAL:
        before = np.where(acting[:, None] >= 0, inputs[acting], 0.0)
        return np.abs((u - before) / scale).sum(axis=1)
    if rule == ALTERNATING:
        return (1.0 if step % 2 else -1.0) * (u / scale).sum(axis=1)
    if rule == ANY:
        return np.zeros(len(m))
    end, axis = rule.split(" of input ")
    return (1.0 if end == "largest" else -1.0) * u[:, int(axis) - 1]


def in_turns(rules: Sequence[str], count: int) -> list[str]:
    """`count` rules, each as often as the others."""
    return [rules[k % len(rules)] for k in range(count)]
