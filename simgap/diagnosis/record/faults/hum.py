"""A line in a channel's spectrum that no force could make: hum of the mains or of a converter, found and taken away.

A sine of amplitude A at omega that were a motion would need an acceleration of omega^2 A. Where that exceeds what the
motion itself shows, and no input has such a line, it is in the reading alone - unless something turns steadily: a force
that depends on the position (cogging, an eccentric wheel) then has lines of its own, at multiples of the speed, and
records that do so are left as they are. A hum stands at the same frequency in every trace.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from simgap.arrays import Floats
from simgap.diagnosis.record.faults.base import Mended, SeenFault
from simgap.diagnosis.record.record import Record, Trace
from simgap.diagnosis.result import RecordingFault
from simgap.diagnosis.thresholds import HUM_LINE, MATTERS, MOST
from simgap.late import scipy
from simgap.model.symbolic import SymbolicModel
from simgap.notation import pretty_unit

_MOST_LINES = 3
_TURNS, _EVEN = 4.0 * math.pi, 4.0  # of steady turning: least travel, and times the scatter around it
_AROUND = 40  # frequencies on either side that are the background of a line
_STANDS = 0.1  # of what a line stands above that, where another one says where to look


class Hum(SeenFault):
    """A steady sine, as from the mains, is added to a reading.

    Detected: a spectral line that would need twice the acceleration of the motion, and that no input contains;
    removed.
    """

    name = "hum"
    unit = "Hz"
    remedy = "Shield or filter the sensor of {}, or set its rate apart from the mains."

    def mend(self, record: Record, model: SymbolicModel) -> Mended:
        """The record without such lines."""
        faults: list[RecordingFault] = []
        for k, name in enumerate(record.measured):
            for _ in range(_MOST_LINES):
                hertz = _line(record, k)
                if hertz is None:
                    break
                sines = [_sine(trace, trace.y[:, k], hertz) for trace in record.traces]
                size = max(float(np.hypot(*c)) for c in sines)
                of = f"{size:.2g} {pretty_unit(model.units.get(name, '1'))}".rstrip()
                what = f"a hum of {hertz:.4g} Hz, {of} in amplitude, which no force produces; it was removed."
                faults.append(self.told(name, hertz, f"{name} has {what}"))
                own = zip(record.traces, sines, strict=True)
                traces = tuple(trace.showing(k, trace.y[:, k] - _wave(trace, hertz) @ c) for trace, c in own)
                record = replace(record, traces=traces)
        return record, tuple(faults)


def _line(record: Record, k: int) -> float | None:
    """Frequency (Hz) of the strongest line of channel k that is hum, if there is one."""
    if any(_steady(trace, y) for trace in record.traces for y in trace.y.T):
        return None
    trace = max(record.traces, key=lambda tr: len(tr.t))
    power, hertz = _power(trace, trace.y[:, k])
    if len(power) < 4 * _AROUND:
        return None
    peak = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    peak = peak[(peak > _AROUND) & (peak < len(power) - 3)]
    for at in peak[np.argsort(-power[peak] * hertz[peak] ** 4)][:5]:
        if _above(power, int(at)) < HUM_LINE or _driven(trace, float(hertz[at])):
            continue
        f = _refined(trace, trace.y[:, k], float(hertz[at]), float(hertz[1] - hertz[0]))
        size = float(np.hypot(*_sine(trace, trace.y[:, k], f)))
        slow = hertz < 0.5 * f
        moved = math.sqrt(float(np.sum(power[slow] * (2 * np.pi * hertz[slow]) ** 4)))
        if size * (2 * np.pi * f) ** 2 > moved / MOST and all(_stands(tr, tr.y[:, k], f) for tr in record.traces):
            return f
    return None


def _steady(trace: Trace, y: Floats) -> bool:
    """Whether a channel (n,) shows steady turning: a position that travels on evenly, or a speed that stays.

    Two turns of travel at least, with a scatter that is small against it.
    """
    since, mean = trace.t - trace.t[0], abs(float(np.mean(y)))
    slope = float(np.polyfit(since, y, 1)[0])
    travels = abs(slope) * trace.duration > max(_TURNS, _EVEN * float(np.std(y - slope * since)))
    return travels or (mean * trace.duration > _TURNS and mean > 0.5 * _EVEN * float(np.std(y)))


def _stands(trace: Trace, values: Floats, hertz: float) -> bool:
    """Whether values (n,) of a trace have a line there; too short a trace says nothing against it."""
    power, at = _power(trace, values)
    here = int(np.argmin(np.abs(at - hertz)))
    if len(power) < 4 * _AROUND or not _AROUND < here < len(power) - 3:
        return True
    return _above(power, here) > _STANDS * HUM_LINE


def _above(power: Floats, at: int) -> float:
    """How many times the median around a line stands out of a spectrum."""
    near = np.concatenate([power[max(at - _AROUND, 0) : at - 3], power[at + 4 : at + _AROUND]])
    return float(power[at - 1 : at + 2].max() / max(float(np.median(near)), 1e-300))


def _power(trace: Trace, values: Floats) -> tuple[Floats, Floats]:
    """Power (n,) that adds up to the mean square, and frequency (n,) Hz, of values (n,) under a Hann window."""
    dt = float(np.median(np.diff(trace.t)))
    even = np.arange(trace.t[0], trace.t[-1], dt)
    y = np.interp(even, trace.t, values)
    taper = np.hanning(len(y) + 2)[1:-1]
    taper /= math.sqrt(float(np.mean(taper**2)))
    spectrum = np.fft.rfft((y - y.mean()) * taper)
    return 2.0 * np.abs(spectrum) ** 2 / len(y) ** 2, np.asarray(np.fft.rfftfreq(len(y), dt), dtype=np.float64)


def _driven(trace: Trace, hertz: float) -> bool:
    """Whether an input has power there too, of which a resonance may make a line: a part of its own that matters."""
    large = [u for u in trace.u.T if np.ptp(u) > 0.0 and np.hypot(*_sine(trace, u, hertz)) > MATTERS * np.std(u)]
    return any(_stands(trace, u, hertz) for u in large)


def _wave(trace: Trace, hertz: float) -> Floats:
    """Cosine and sine at a frequency, (n, 2)."""
    turn = 2 * np.pi * hertz * trace.t
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)


def _sine(trace: Trace, values: Floats, hertz: float) -> Floats:
    """Weights of cosine and sine at a frequency, (2,), by least squares under a Hann window (the motion stays out)."""
    taper = 0.5 - 0.5 * np.cos(2 * np.pi * (trace.t - trace.t[0]) / max(trace.duration, 1e-300))
    basis = np.column_stack([_wave(trace, hertz), np.ones_like(taper)]) * taper[:, None]
    return np.asarray(np.linalg.lstsq(basis, values * taper, rcond=None)[0][:2])


def _refined(trace: Trace, values: Floats, hertz: float, width: float) -> float:
    """The frequency near `hertz` with the largest amplitude."""
    found = scipy.optimize.minimize_scalar(
        lambda f: -float(np.hypot(*_sine(trace, values, f))), bounds=(hertz - width, hertz + width), method="bounded",
        options={"xatol": 1e-4 * width},
    )  # fmt: skip
    return float(found.x)
