"""Effects between a command and the plant: gain, bias, dead zone, limit, curve, torque-speed limit, delay and lag."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from simgap.arrays import Floats
from simgap.effects.base import COMMAND, EffectParameter, MjcfPlace, Quoted, Scales, Start, Values, both_sides, multiple
from simgap.effects.commands import DriveEffect, MemoryInputEffect, StaticInputEffect
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class InputGain(StaticInputEffect):
    """The plant feels a multiple of the command; a negative one if a wire, a motor or a convention is reversed."""

    name = "input_gain"
    formula = "u' = ratio u"
    source = "Ljung (1999), System Identification, sec. 4.2"
    rank = COMMAND + 40
    parameters = (EffectParameter("ratio", "1", "true over declared gain", null=1.0),)
    hides_columns = True
    mjcf = MjcfPlace("actuator", ("gear",))
    several_valleys = True

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The declared gain, and its reverse: a wrong sign lies too far away for a derivative."""
        return (*super().starts(scales), Start(1, lambda c: {"ratio": 1.0 - 2.0 * c[0]}, amplitude=1.0))

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """ratio u."""
        return values["ratio"] * command

    def describe(self, on: str, quoted: Quoted) -> str:
        """Deviation of the gain, and whether it is reversed."""
        if quoted.value("ratio") < 0.0:
            return f"a reversed {on} (wrong sign), with a gain of {quoted.number('ratio')} times the declared one"
        return f"a gain of {on} that is {quoted.deviation()} the declared one"


class InputDirectionalGain(StaticInputEffect):
    """One gain for positive commands, another for negative ones: a valve, a thruster, a bridge with unequal legs."""

    name = "input_directional_gain"
    long = "a gain of {on} that differs with the sign ({ratio_p:off} for positive, {ratio_m:off} for negative commands)"
    contains = InputGain
    second = True
    formula = "u' = ratio_p u for u > 0, ratio_m u for u < 0"
    source = "Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 2"
    rank = COMMAND + 40
    parameters = (
        EffectParameter("ratio_p", "1", "true over declared gain of positive commands", null=1.0),
        EffectParameter("ratio_m", "1", "true over declared gain of negative commands", null=1.0),
    )

    def beyond(self, contained: Mapping[str, float], start: Mapping[str, float]) -> dict[str, float]:
        """The same gain for both."""
        return {"ratio_p": contained["ratio"], "ratio_m": contained["ratio"]}

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """ratio_p (u + |u|)/2 + ratio_m (u - |u|)/2: the other's part is 0 without rounding."""
        up, down = (command + sp.Abs(command)) / 2, (command - sp.Abs(command)) / 2
        return values["ratio_p"] * up + values["ratio_m"] * down

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Command 0, where its sign changes."""
        return (symbol(on),)


class InputBias(StaticInputEffect):
    """The plant feels the command plus a constant."""

    name = "input_bias"
    long = "a bias of {bias} on {on}"
    formula = "u' = u + bias"
    source = "Ljung (1999), System Identification, sec. 4.2"
    rank = COMMAND + 30
    parameters = (EffectParameter("bias", "{input}", "offset of the input", null=0.0),)
    hides_columns = True

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """u + bias."""
        return command + values["bias"]


class InputDeadZone(StaticInputEffect):
    """Commands within the dead zone do nothing, larger ones lose its half-width."""

    name = "input_dead_zone"
    long = "a dead zone of ±({width}) on {on}"
    passes_a_constant = False
    formula = "u' = sign(u) max(|u| - width, 0)"
    source = "Tao, Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 2"
    rank = COMMAND + 20
    parameters = (EffectParameter("width", "{input}", "half-width of the dead zone", null=0.0, lower=0.0),)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Widths at a few shares of the largest command."""
        return tuple(multiple("width", share * scales.command) for share in (0.02, 0.07, 0.2))

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """u minus its part within +-width."""
        width = values["width"]
        return command - sp.Max(-width, sp.Min(command, width))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Both ends of the dead zone."""
        return both_sides(symbol(on), values["width"])


FLAT = 0.1
"""A limit is seen where commands beyond it differ by more than this share of what it cuts off (judgement)."""


class InputSaturation(StaticInputEffect):
    """The plant feels no more than the limit."""

    name = "input_saturation"
    long = "a limit of {limit} on {on}"
    passes_a_constant = False
    formula = "u' = max(-limit, min(u, limit))"
    source = "Tarbouriech et al. (2011), Stability and Stabilization of Linear Systems with Saturating Actuators, ch. 1"
    rank = COMMAND + 10
    parameters = (EffectParameter("limit", "{input}", "largest input", null=math.inf, lower=0.0),)

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Limits at several shares of the largest command."""

        def at(share: float) -> Start:
            return Start(1, lambda c: {"limit": scales.command * share if c[0] > 0.0 else math.inf}, amplitude=1.0)

        return tuple(at(share) for share in (0.95, 0.85, 0.7, 0.5, 0.35))

    def doubt(self, values: Mapping[str, float], visited: Floats) -> str:
        """Commands of several sizes beyond a limit are felt alike; those of one size are felt less, as by any curve."""
        size = np.abs(visited)
        beyond = size[size > values["limit"]]
        if not beyond.size:
            return ""
        if beyond.size == size.size:
            return "all commands lie beyond the limit: an input that has no effect would look like it"
        if np.ptp(beyond) > FLAT * (beyond.max() - values["limit"]):
            return ""
        return "all commands beyond the limit are of one size: a smaller gain there would look like it"

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """u cut to +-limit."""
        limit = values["limit"]
        return sp.Max(-limit, sp.Min(command, limit))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Both limits; none where the limit is infinite."""
        return both_sides(symbol(on), values["limit"])


class TorqueSpeedLimit(DriveEffect):
    """The torque-speed line: a stall torque at rest, less as the motor drives faster, more where it brakes.

    With the largest voltage V, resistance R and motor constant K: T_s = K V / R and k = K^2 / R, both by the gear.
    """

    name = "torque_speed_limit"
    short = "the torque-speed limit of {on}"
    long = "a torque-speed limit of {on} ({T_s} at rest, less {k} times the speed)"
    passes_a_constant = False
    contains = InputSaturation
    second = True
    several_valleys = True
    resembles = ("input_saturation",)
    formula = "u' = max(-T_s - k v, min(u, T_s - k v))"
    source = "Spong, Hutchinson, Vidyasagar (2006), Robot Modeling and Control, sec. 6.1 (torque-speed curve)"
    excitation = "command large inputs at rest and at speed, driving and braking"
    parameters = (
        EffectParameter("T_s", "{input}", "largest input at rest", null=math.inf, lower=0.0),
        EffectParameter("k", "{input}*s/{position}", "decrease of the limit with speed", null=0.0, lower=0.0),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Stall torques at shares of the largest command, and speeds at which nothing is left of them."""

        def at(share: float, idle: float) -> Start:
            stall = share * scales.command
            there, none = {"T_s": stall, "k": stall / (idle * scales.speed)}, {"T_s": math.inf, "k": 0.0}
            return Start(1, lambda c: dict(there if c[0] > 0.0 else none), amplitude=1.0)

        return tuple(at(share, idle) for share, idle in ((1.5, 3.0), (1.2, 6.0), (0.9, 4.0), (0.9, 8.0), (0.6, 6.0)))

    def beyond(self, contained: Mapping[str, float], start: Mapping[str, float]) -> dict[str, float]:
        """A line through the limit that was found at the start's slope, a third above it at rest."""
        stall = 4.0 / 3.0 * contained["limit"]
        return {"T_s": stall, "k": stall * start["k"] / start["T_s"]}

    def felt(self, drive: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """u cut to -T_s - k v and T_s - k v."""
        stall, fall = values["T_s"], values["k"] * velocity
        return sp.Max(-stall - fall, sp.Min(drive, stall - fall))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Both limits; none where they are infinite."""
        return both_sides(symbol(on) + sp.Float(values["k"]) * self.speed(model, on), values["T_s"])


class InputCurve(StaticInputEffect):
    """A static curve, the same for both signs and nowhere falling: magnetic saturation, a valve, a propeller.

    Its slope is linear in u^2 between three knots, at no command, at U/2 and at U, and constant beyond; U is the
    largest command of the record and not fitted. A slope that is nowhere negative makes the curve monotone.
    """

    name = "input_curve"
    short = "the gain curve of {on}"
    long = (
        "a gain of {on} that changes with its size ({g_0} at small, {g_1} at half, {g_2} at full command, of the "
        "declared one)"
    )
    second = True
    resembles = ("input_gain", "input_saturation", "input_dead_zone")
    formula = "du'/du = g, linear in u^2 from g_0 at 0 to g_1 at U/2, from there to g_2 at U"
    source = "Ramsay (1988), Monotone Regression Splines in Action, Statistical Science 3(4)"
    rank = COMMAND + 40
    parameters = (
        EffectParameter("g_0", "1", "true over declared gain of small commands", null=1.0, lower=0.0),
        EffectParameter("g_1", "1", "true over declared gain, for more command, at U/2", null=1.0, lower=0.0),
        EffectParameter("g_2", "1", "true over declared gain, for more command, at U", null=1.0, lower=0.0),
        EffectParameter("U", "{input}", "largest command, taken from the record", null=1.0, lower=1e-12, integer=True),
    )

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The three slopes as linear coefficients."""
        names = ("g_0", "g_1", "g_2")
        return (Start(3, lambda c: {"U": scales.command} | {n: 1.0 + v for n, v in zip(names, c, strict=True)}),)

    def ratios(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """The largest slope: small commands, or large ones, may do nothing."""
        return (max(values["g_0"], values["g_1"], values["g_2"]),)

    def applied(self, command: sp.Expr, values: Values) -> sp.Expr:
        """The integral of the slope, piece by piece."""
        half, size = values["U"] / 2, sp.Abs(command)
        g_0, g_1, g_2 = values["g_0"], values["g_1"], values["g_2"]
        inner, whole = sp.Min(size, half), sp.Min(size, 2 * half)
        curve = g_0 * inner + (g_1 - g_0) * inner**3 / (3 * half**2)
        curve += g_1 * (whole - inner) + (g_2 - g_1) * ((whole**3 - inner**3) / (9 * half**2) - (whole - inner) / 3)
        curve += g_2 * (size - whole)
        return sp.sign(command) * curve

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Commands where the curve bends: both signs, their knots."""
        return symbol(on), *both_sides(symbol(on), values["U"] / 2, values["U"])


class InputDelay(MemoryInputEffect):
    """The plant feels what was commanded some time ago (computation, bus, network)."""

    name = "input_delay"
    long = "a delay of {delay} on {on}"
    formula = "u'(t) = u(t - delay)"
    source = "Astrom, Wittenmark (1997), Computer-Controlled Systems, sec. 2.3"
    begin = (0.5, 2.0, 6.0)
    rank = COMMAND + 50
    parameters = (EffectParameter("delay", "s", "time from command to effect", null=0.0, lower=0.0),)

    def delay(self, values: Values) -> sp.Expr:
        """delay."""
        return values["delay"]


class InputLag(MemoryInputEffect):
    """The actuator follows its command with a time constant."""

    name = "input_lag"
    long = "a lag of {T} on {on}"
    formula = "u' = z, T dz/dt = u - z"
    source = "Astrom, Murray (2008), Feedback Systems, sec. 3.2"
    begin = (1.0, 4.0, 12.0)
    rank = COMMAND
    parameters = (EffectParameter("T", "s", "time constant", null=0.0, lower=0.0),)

    def lag(self, values: Values) -> sp.Expr:
        """T."""
        return values["T"]
