"""What a bound says of a simulator with noise: how many draws it takes, and what steps and runs keep with what chance.

At every sample the hull of K draws of the noise covers at least a share 1 - alpha of it; K is such that all samples do
together with the stated confidence (`statistics.fewest_draws`, its doubt divided by the number of samples).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from simgap.config.case import Case
from simgap.statistics import clopper_pearson_lower, fewest_draws

WANTED = 0.95
"""Probability of a run that `check` names an alpha for. Judgement."""


@dataclass(frozen=True)
class NoiseStatement:
    """With `confidence`, a step at any state and input lies within the bound with a probability of 1 - `alpha`.

    Attributes:
        samples: pairs of state and input at which the noise was drawn; draws: at each of them. 0 where that is not
            asked.
    """

    alpha: float
    confidence: float
    samples: int
    draws: int

    @property
    def of_step(self) -> str:
        """Sentences on a step, in the place of one that nothing lies outside."""
        return (
            f"The simulator is random: at every state of X and input of U, a step lies within the bound with a "
            f"probability of at least {share(1.0 - self.alpha)}, with {share(self.confidence)} confidence at its "
            f"samples ({self.draws:,} draws of the noise at each of {self.samples:,} samples; order statistics of all "
            "states together). Between samples this takes the quantiles of the noise to move with the state no faster "
            "than the extremes of these draws, by their Lipschitz constants. Noise is independent from step to step."
        )

    def of_run(self, steps: int) -> str:
        """Sentence on a run."""
        return (
            f"A run of {steps:,} steps keeps its promise with a probability of at least "
            f"{math.floor(1000.0 * (1.0 - self.alpha) ** steps) / 10.0:g} %, with {share(self.confidence)} confidence "
            "in the bound at its samples, if the noise changes between them as estimated and is independent from step "
            "to step."
        )

    def is_contradicted(self, steps: int, outside: int) -> bool:
        """True if so many steps outside show, with the same confidence, that more than a share alpha lies there."""
        return steps > 0 and clopper_pearson_lower(steps, outside, self.confidence) > self.alpha


def share(value: float) -> str:
    """A share in per cent."""
    return f"{100.0 * value:.10g} %"


def statement_of(case: Case, samples: int = 0) -> NoiseStatement | None:
    """The statement that the bound of a case makes with so many samples; None without noise."""
    if not case.is_random or case.gap is None:
        return None
    noise = case.gap.noise
    return NoiseStatement(noise.alpha, noise.confidence, samples, draws_at(case, samples) if samples else 0)


def draws_at(case: Case, samples: int, alpha: float | None = None) -> int:
    """How often the noise is drawn at each of so many samples, 0 without noise; `alpha` in place of the case's own."""
    if not case.is_random or case.gap is None:
        return 0
    missed = case.gap.noise.alpha if alpha is None else alpha
    return fewest_draws(missed, (1.0 - case.gap.noise.confidence) / samples, 2 * len(case.plant.states))


def alpha_of_run(steps: int, wanted: float = WANTED) -> float:
    """The alpha by which a run of so many steps keeps its promise with a wanted probability: two digits, downward."""
    exact = -math.expm1(math.log(wanted) / steps)
    digit = 10.0 ** (math.floor(math.log10(exact)) - 1)
    return float(f"{math.floor(exact / digit) * digit:.2g}")
