"""Noise that remembers, and what happens outside the plant and its sensors: told here, found by the search."""

from __future__ import annotations

from collections.abc import Iterable

from simgap.diagnosis.record.faults.base import Fault
from simgap.diagnosis.record.faults.measurement import Drift
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.thresholds import MOST


class ColouredNoise(Fault):
    """Noise that is correlated in time."""

    name = "coloured_noise"
    meaning = "noise is correlated in time"
    detected = "see below"
    unit = "s"
    remedy = "Look for a filter, a slow sensor or an interpolation in the path of {}; log its raw readings."

    def of(self, laws: Iterable[tuple[str, float, float]], window_s: float) -> list[RecordingFault]:
        """Findings of channels, each with the share of its variance that remembers, over how long (s).

        What is slower than a window is a zero that wanders.
        """
        found = []
        for name, share, tau in laws:
            what = f"{100 * share:.0f} % of the noise of {name} (its variance)"
            if share > 0.0 and tau > window_s:
                sentence = f"{what} wanders: a reading that drifts, slower than a window of {window_s:.2g} s."
                remedy = "Warm the sensor up, or zero it at a stop between runs."
                found.append(Drift().told(name, tau, sentence, remedy, unit="s"))
            elif share > 0.0:
                sentence = f"{what} is correlated over {1e3 * tau:.3g} ms"
                found.append(self.told(name, tau, f"{sentence}; intervals and criteria count what is independent."))
        return found


class FaintMemory(Fault):
    """Noise of which a part alone is correlated: what a mechanism leaves, unseen in noise, looks so too."""

    name = "faint_memory"
    meaning = "less than half of a channel's noise is correlated"
    detected = "effects are then at most `partial`: backlash on a soft spring leaves such a trace"

    def is_in(self, share: float) -> bool:
        """Whether it is this share (of the variance) that remembers."""
        return 0.0 < share < MOST


class Push(Fault):
    """Something that touched the plant."""

    name = "push"
    meaning = "something acted on the plant for a moment"
    detected = (
        "short intervals carry most of the error, and no effect explains them; excluded from the fit, see "
        "[disturbances](../explanation/diagnosis.md#disturbances)"
    )
    unit = "s"
    remedy = "Drop what was disturbed (measured.masks), or repeat the run with nothing touching the plant."


class PlantChanged(Fault):
    """Another plant after some time."""

    name = "plant_changed"
    meaning = "a parameter changed during the recording"
    detected = "see below"
    unit = "s"
    remedy = "Diagnose the times before and after apart (measured.masks), or say what differs (measured.conditions)."
