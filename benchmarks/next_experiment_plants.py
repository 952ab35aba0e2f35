"""Confusions for the study of the next experiment: small first recordings that leave several explanations open.

A pendulum, moved by fine steps that share no code with the fit, and the plants of tests/undeclared/rig/textbook.py,
moved by SciPy from their equations of motion. Each hides one effect or two, drawn at random.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT)]

from simgap.arrays import Floats  # noqa: E402
from simgap.diagnosis.diagnose import diagnose  # noqa: E402
from simgap.diagnosis.record.record import Record, Trace  # noqa: E402
from simgap.diagnosis.result import Diagnosis, DiagnosisSettings  # noqa: E402
from simgap.extras.experiment.ask import Question  # noqa: E402
from simgap.extras.experiment.propose import Wave  # noqa: E402
from simgap.geometry import Box  # noqa: E402
from simgap.model.symbolic import SymbolicModel  # noqa: E402
from simgap.signals import multisine  # noqa: E402
from tests.undeclared.nominals import nominal  # noqa: E402
from tests.undeclared.plant import pendulum  # noqa: E402
from tests.undeclared.rig import pendulum as swing  # noqa: E402
from tests.undeclared.rig.textbook import PLANTS, Hidden, Textbook, _moved  # noqa: E402

SECONDS = 4.0
"""Of the first recording, and of the longest next one."""
Key = tuple[str, str]
Keys = frozenset[Key]
Size = Callable[[float], dict[str, Any]]


def random_wave(t: Floats, inputs: int, rng: np.random.Generator) -> Wave:
    """A multisine of random band and size on every input: what a person takes who does not ask."""
    low, high = sorted(np.exp(rng.uniform(np.log(0.1), np.log(5.0), 2)))
    u = np.stack([multisine(t, 1.0, low, max(high, 1.5 * low), rng) for _ in range(inputs)], axis=1)
    return Wave(f"multisine of {low:.2g} to {high:.2g} Hz", u * rng.uniform(0.2, 1.0))


@dataclass(frozen=True)
class Confusion:
    """What a first recording left open.

    Attributes:
        plant, seed: which; truth: what was hidden; before: the answer.
        question: as `simgap next` asks it; play: inputs (n, m) -> the recording that comes of them.
    """

    plant: str
    seed: int
    truth: Keys
    before: Diagnosis
    question: Question
    play: Callable[[str, np.ndarray], Trace]

    def settled(self, found: Diagnosis) -> bool:
        """Whether the answer is what was hidden, up to exact equals, and nothing else is listed."""
        return settled(found, self.truth)

    def diagnosed(self, more: Trace) -> Diagnosis:
        """The new recording before the first."""
        q = self.question
        return diagnose(q.model, Record((more, *q.record.traces), q.record.measured, q.record.inputs), q.settings)


def settled(found: Diagnosis, truth: Keys) -> bool:
    """Whether the answer is what was hidden, up to exact equals, and nothing else is listed."""
    answer = frozenset((e.name, e.on) for e in found.effects)
    sets = [(frozenset((e.name, e.on) for e in a.effects), a.exact) for a in found.alternatives]
    equal = truth == answer or any(keys == truth and exact for keys, exact in sets)
    return equal and all(exact for _, exact in sets)


def open_sets(found: Diagnosis) -> tuple[Any, ...]:
    """The answer and what cannot be told from it, exact equals aside: no recording tells these."""
    return (found.applied, *(a.effects for a in found.alternatives if not a.exact))[:4]


@dataclass(frozen=True)
class Study:
    """Largest inputs, largest states, and what may be hidden, with a size between 0 and 1."""

    top: tuple[float, ...]
    reach: tuple[float, ...]
    hidden: dict[Key, Size]


def _force(name: str, kind: str, on: str, low: float, high: float) -> dict[Key, Size]:
    return {(name, on): lambda s: {kind: {on: low + (high - low) * s}}}


def _off(kind: str, name: str, on: str) -> dict[Key, Size]:
    return {(name, on): lambda s: {kind: {on: 0.8 + 0.15 * s}}}


STUDIES = {
    "dc_motor": Study((6.0,), (500.0, 300.0, 20.0), {
        **_force("viscous_friction", "viscous", "shaft", 1e-4, 6e-4),
        **_force("coulomb_friction", "coulomb", "shaft", 3e-3, 1.5e-2),
        **_force("input_bias", "bias", "V", 0.05, 0.3), **_off("gain", "input_gain", "V"),
        **_off("factors", "parameter_error", "J"),
    }),
    "oscillator": Study((6.0,), (3.0, 20.0), {
        **_force("viscous_friction", "viscous", "slide", 0.05, 0.4),
        **_force("coulomb_friction", "coulomb", "slide", 0.05, 0.3),
        **_force("input_bias", "bias", "u", 0.05, 0.3), **_off("gain", "input_gain", "u"),
        **_off("factors", "parameter_error", "m"), **_off("factors", "parameter_error", "k"),
    }),
    "cart_pole": Study((4.0,), (5.0, 10.0, 10.0, 30.0), {
        **_force("viscous_friction", "viscous", "cart", 0.1, 0.8),
        **_force("viscous_friction", "viscous", "pole", 3e-3, 3e-2),
        **_force("coulomb_friction", "coulomb", "cart", 0.05, 0.4),
        **_force("input_bias", "bias", "u", 0.05, 0.3), **_off("gain", "input_gain", "u"),
    }),
    "two_link": Study((6.0, 2.0), (10.0, 10.0, 40.0, 40.0), {
        **_force("viscous_friction", "viscous", "shoulder", 0.05, 0.3),
        **_force("viscous_friction", "viscous", "elbow", 0.02, 0.1),
        **_force("coulomb_friction", "coulomb", "shoulder", 0.05, 0.3),
        **_force("input_bias", "bias", "u2", 0.02, 0.1), **_off("gain", "input_gain", "u1"),
    }),
}  # fmt: skip

EFFECTS = ("viscous_friction", "coulomb_friction", "quadratic_drag", "spring", "input_gain", "input_bias",
           "parameter_error")  # fmt: skip
SWING_EFFECTS = (
    "viscous_friction", "coulomb_friction", "quadratic_drag", "spring", "cubic_spring", "gravity_tilt", "input_gain",
    "input_bias", "parameter_error", "input_dead_zone",
)  # fmt: skip
SWING: dict[Key, Size] = {  # numbers of the rig for a size between 0 and 1
    ("viscous_friction", "hinge"): lambda s: {"b": 0.02 + 0.15 * s},
    ("coulomb_friction", "hinge"): lambda s: {"F_c": 0.02 + 0.15 * s},
    ("quadratic_drag", "hinge"): lambda s: {"c": 0.02 + 0.1 * s},
    ("spring", "hinge"): lambda s: {"k": 0.2 + 0.8 * s},
    ("gravity_tilt", "plant"): lambda s: {"tilt": 0.01 + 0.05 * s},
    ("input_bias", "torque"): lambda s: {"bias": 0.05 + 0.3 * s},
    ("input_gain", "torque"): lambda s: {"gain": 0.8 + 0.15 * s},
    ("parameter_error", "rod.com"): lambda s: {"com": 0.5 * (1.03 + 0.1 * s)},
}
SWING_SIGMA, SWING_TOP = 1e-3, 6.0


def confusion(plant: str, seed: int) -> Confusion | None:
    """One record of a plant; None where it leaves nothing open."""
    return _swing(seed) if plant == "pendulum" else _textbook(plant, seed)


def _picked(of: dict[Key, Size], rng: np.random.Generator) -> list[Key]:
    return [list(of)[k] for k in rng.choice(len(of), size=int(rng.integers(1, 3)), replace=False)]


def _swing(seed: int) -> Confusion | None:
    rng = np.random.default_rng(seed)
    keys, numbers = _picked(SWING, rng), dict[str, float]()
    for key in keys:
        numbers |= SWING[key](float(rng.uniform()))
    hidden = swing.Hidden(rig=numbers)

    def play(name: str, u: np.ndarray, noise: np.random.Generator) -> Trace:
        x = swing.move(hidden, u[:, 0], np.zeros(2))
        y = x[:, :1] + hidden.offset + SWING_SIGMA * noise.standard_normal((len(u), 1))
        return Trace(name, np.arange(len(u)) / swing.RATE, y, u)

    t = np.arange(int(SECONDS * swing.RATE) + 1) / swing.RATE
    small = float(np.exp(rng.uniform(np.log(0.05), np.log(0.4))))
    first = play("first", swing.multisine(rng, len(t), swing.RATE, top=small)[:, None], rng)
    settings = DiagnosisSettings(effects=SWING_EFFECTS, max_effects=2, budget_s=60.0)
    record = Record((first,), ("angle",), ("torque",))
    limits = Box([-6.0, -20.0], [6.0, 20.0]), np.zeros(1), np.full(1, SWING_TOP)
    return _asked("pendulum", seed, frozenset(keys), pendulum(), record, settings, t, limits, play)


def _textbook(plant: str, seed: int) -> Confusion | None:
    book, study, model = PLANTS[plant](), STUDIES[plant], nominal(plant)
    rng = np.random.default_rng([seed, *plant.encode()])
    keys, told = _picked(study.hidden, rng), dict[str, dict[str, float]]()
    for key in keys:
        for kind, numbers in study.hidden[key](float(rng.uniform())).items():
            told[kind] = told.get(kind, {}) | numbers
    hidden, top = Hidden(**told), np.array(study.top)

    def play(name: str, u: np.ndarray, noise: np.random.Generator) -> Trace:
        return recorded(book, name, hidden, u, noise)

    t = np.arange(round(SECONDS * book.rate) + 1) / book.rate
    small = float(np.exp(rng.uniform(np.log(0.02), np.log(0.15))))
    first = play("first", small * top * random_wave(t, len(top), rng).u, rng)
    settings = DiagnosisSettings(effects=EFFECTS, max_effects=2, budget_s=60.0)
    reach = np.array(study.reach)
    limits = Box(-reach, reach), np.zeros(len(top)), top
    record = Record((first,), book.measured, book.inputs)
    return _asked(plant, seed, frozenset(keys), model, record, settings, t, limits, play)


def recorded(book: Textbook, name: str, hidden: Hidden, u: np.ndarray, rng: np.random.Generator) -> Trace:
    """The plant under these inputs (n, m) from rest, its readings with noise."""
    t = np.arange(len(u)) / book.rate
    x, acted = _moved(book, hidden, 0, t, np.zeros(len(book.states)), u)
    read = [book.states.index(n) for n in book.measured]
    return Trace(name, t, x[:, read] + np.asarray(book.sigma) * rng.standard_normal((len(t), len(read))), acted)


def _asked(
    plant: str, seed: int, truth: Keys, model: SymbolicModel, record: Record, settings: DiagnosisSettings,
    t: np.ndarray, limits: tuple[Box, np.ndarray, np.ndarray],
    play: Callable[[str, np.ndarray, np.random.Generator], Trace],
) -> Confusion | None:  # fmt: skip
    before = diagnose(model, record, settings)
    if not before.effects or settled(before, truth) or len(open_sets(before)) < 2:
        return None
    rest = np.zeros(len(model.state_names))
    question = Question(model, record, settings, dict(before.sigma), open_sets(before), t, rest, *limits)
    return Confusion(
        plant, seed, truth, before, question,
        lambda name, u: play(name, u, np.random.default_rng([seed, 7])),
    )  # fmt: skip
