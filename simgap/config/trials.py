"""How much evidence a run gathers beside its proofs: random runs and attacks, never what a bound rests on."""

from __future__ import annotations

from enum import StrEnum


class Trials(StrEnum):
    """Numbers of random and adversarial trials: of a plain run, of `snakemake full`, of `snakemake audit_deep`."""

    PLAIN = "plain"
    FULL = "full"
    DEEP = "deep"
