"""Base of the physical effects: a symbolic change of the model, with parameters, units, sign constraints and words.

The one definition serves the fit, the corrected nominal model, the simulator's twin and the report. The few
places that know an effect by name say why there. Beside it stand where a search for an effect begins (`Start`) and how
a sentence quotes its numbers (`Quoted`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, TypeAlias

from simgap.arrays import Floats
from simgap.errors import UserError
from simgap.late import sympy as sp
from simgap.model.symbolic import Parameter, PlanarWheels, SymbolicModel, Variable, symbol
from simgap.notation import with_error


@dataclass(frozen=True)
class Quoted:
    """Parameters as `diagnosis.json` holds them: symbol -> `value`, `ci95` (two ends, or None), `unit`."""

    parameters: Mapping[str, Mapping[str, Any]]

    def value(self, symbol: str) -> float:
        """The number itself, in its unit."""
        return float(self.parameters[symbol]["value"])

    def number(self, symbol: str, scale: float = 1.0, unit: str | None = None) -> str:
        """'0.19 ± 0.01 N m'; with `scale` in another `unit`."""
        p = self.parameters[symbol]
        return with_error(scale * self.value(symbol), scale * self._half(symbol), p["unit"] if unit is None else unit)

    def deviation(self, symbol: str = "ratio") -> str:
        """A ratio as a deviation from 1: 0.75 -> '25 ± 1 % below'; from 2 on as it is: '5.0 ± 0.1 times'."""
        value = self.value(symbol)
        if value >= 2.0:
            return f"{with_error(value, self._half(symbol))} times"
        side = "below" if value < 1.0 else "above"
        return f"{with_error(100.0 * abs(value - 1.0), 100.0 * self._half(symbol))} % {side}"

    def __getitem__(self, symbol: str) -> _Number:
        """A number for a text with formats, such as '{mu:%}'."""
        return _Number(self, symbol)

    def _half(self, symbol: str) -> float:
        lo, hi = (float(v) if v is not None else math.nan for v in self.parameters[symbol]["ci95"])
        return (hi - lo) / 2


@dataclass(frozen=True)
class _Number:
    """One of the numbers: as it is (times in milliseconds), in percent (%), in degrees (deg), off from 1 (off)."""

    quoted: Quoted
    symbol: str

    def __format__(self, kind: str) -> str:
        brief = self.quoted.parameters[self.symbol]["unit"] == "s" and abs(self.quoted.value(self.symbol)) < 10.0
        unit = "ms" if brief and not kind else kind
        if unit == "off":
            return self.quoted.deviation(self.symbol)
        scale = {"": 1.0, "ms": 1e3, "%": 100.0, "deg": 180.0 / math.pi}[unit]
        return self.quoted.number(self.symbol, scale, unit or None)


@dataclass(frozen=True)
class Scales:
    """Typical sizes in a record, from which starts are taken.

    Attributes:
        interval: median sampling interval, s.
        command: largest input that the effect would act on, or that drives its coordinate (1 for none).
        speed: root mean square speed of the coordinate that it would act on (1 if it acts on none).
        inertia: of that coordinate as declared, with all others free, where it stands at 0.
        places: lowest and highest place where that coordinate was read (the same number twice if it was not).
    """

    interval: float
    command: float = 1.0
    speed: float = 1.0
    inertia: float = 1.0
    places: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Start:
    """A map from `size` linear coefficients to parameter values; coefficients of 0 are the null.

    Attributes:
        size: number of coefficients.
        point: coefficients -> value of every parameter symbol.
        amplitude: coefficient at which the response is taken: small steps are chosen by whoever asks if this is
            None (a derivative), 1 for a secant to a definite size of the effect.
    """

    size: int
    point: Callable[[Sequence[float]], dict[str, float]]
    amplitude: float | None = None


def multiple(symbol: str, value: float) -> Start:
    """A secant from 0 to a definite value of a one-parameter effect."""
    return Start(1, lambda c: {symbol: max(c[0], 0.0) * value}, amplitude=1.0)


def beside(symbol: str, **held: float) -> Start:
    """A derivative at 0 in one parameter, the others at definite values."""
    return Start(1, lambda c: {symbol: c[0], **held})


Kind = Literal["coordinate", "input", "state", "parameter", "plant"]
Values: TypeAlias = "Mapping[str, sp.Expr]"
PLANT, FORCE, SENSOR, COMMAND = 0, 100, 200, 300
"""Ranks: in the plant itself, forces on it, its sensors, the path of a command from the plant backwards."""


@dataclass(frozen=True)
class AppliedEffect:
    """An effect with its target and the values of its parameters."""

    name: str
    on: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    `unit` may hold the placeholders `{force}`, `{position}`, `{input}`, `{state}`, filled in for the target. At `null`
    (for all parameters of the effect at once) the effect vanishes. `lower` and `upper` are physical limits. `integer`
    marks a choice that starts make and no fit changes, `shape` a number that matters only while the others are away
    from their null. `times` is the largest ratio of the truth to what is fitted that the effect's own simplification
    makes: the interval reaches up by it.
    """

    symbol: str
    unit: str
    description: str
    null: float
    lower: float = -math.inf
    upper: float = math.inf
    integer: bool = False
    shape: bool = False
    may_vanish: bool = False
    times: float = 1.0

    def widened(self, interval: tuple[float, float]) -> tuple[float, float]:
        """An interval of the fit as one of the truth."""
        lo, hi = interval
        return lo, hi * self.times if hi > 0.0 else hi


@dataclass(frozen=True)
class MjcfPlace:
    """Place where MuJoCo's format says an effect of one parameter: attributes of a joint, a body or an actuator.

    A parameter that is 1 at its null multiplies them. Another adds to them, to coefficient `power` where they are those
    of a polynomial: of v |v|^power for a damping, of q^(power + 1) for a stiffness. `quantity` is the one of the body
    that is meant, where the effect acts on several.
    """

    of: Literal["joint", "body", "actuator"]
    attributes: tuple[str, ...]
    power: int = 0
    quantity: str = ""


Equal: TypeAlias = "tuple[frozenset[int], dict[str, float]] | None"
"""Places, among effects that were found, of those that another equals, and its values then; None if it equals none."""


class Effect(ABC):
    """A physical term that a model may lack; subclasses are final and hold no state."""

    name: ClassVar[str]
    kind: ClassVar[Kind]
    formula: ClassVar[str]
    source: ClassVar[str]
    parameters: ClassVar[tuple[EffectParameter, ...]]
    contains: ClassVar[type[Effect] | None] = None
    """An effect that this one extends: its fit is a place to begin from."""
    rank: ClassVar[int]
    """Where it enters a model that has several: plant, forces, sensors, then the path of a command backwards."""
    remembers: ClassVar[bool] = False
    """True if what it does depends on the past beyond the plant's own state."""
    several_valleys: ClassVar[bool] = False
    """True if fits begun at different starts end in different places: then each start is fitted."""
    jerks: ClassVar[bool] = False
    """True if the motion has kinks that move with every number: derivatives are then taken over larger differences."""
    second: ClassVar[bool] = False
    """True if it refines or resembles effects that are tried first: sought where these leave more than noise."""
    last: ClassVar[bool] = False
    """True if it is sought in a look of its own, after all others."""
    by_name: ClassVar[bool] = False
    """True if it is sought only where the settings name it."""
    resembles: ClassVar[tuple[str, ...]] = ()
    """Names of effects that may come within the noise of it: it is tried in their place where one was found."""
    one_curve: ClassVar[bool] = False
    """True if its numbers are values of one curve, in one unit: their agreement is then by the size of all of them.

    It bends to whatever is left a little, so that it is an answer only where nothing is left."""
    pulls_to_a_place: ClassVar[bool] = False
    """True if it pulls a coordinate back to one place: on an angle that winds on it is tried only if it is named."""
    hides_columns: ClassVar[bool] = False
    """True if it is so common and so large that a column in a wrong unit may not be seen without it."""
    dry: ClassVar[bool] = False
    """True if it is friction that holds a coordinate at rest, or nearly so."""
    mjcf: ClassVar[MjcfPlace | None] = None
    """Where MuJoCo's format says it, and a URDF as far as that can; None if neither does."""
    passes_a_constant: ClassVar[bool] = True
    """True if a constant added to the command before it arrives as the same constant force behind it."""
    excitation: ClassVar[str] = ""
    """Advice on the motion that would tell it apart from other effects."""
    reading_remedy: ClassVar[str] = ""
    """Remedy for an effect of the readings alone, which a simulator's twin must not act out."""
    needs: ClassVar[str] = "nothing beyond what every plant has"
    """Property that a plant must have for it, told where it has no target."""

    begin: ClassVar[tuple[float, ...] | None] = None
    """Starts of a time, in sampling intervals, from which a search begins."""
    short: ClassVar[str] = ""
    """A noun phrase without numbers, `{on}` its place: 'Coulomb friction at the {on}'; from the name if not given."""
    long: ClassVar[str] = ""
    """The same with its numbers by symbol: 'Coulomb friction of {F_c} at the {on}'; times are told in milliseconds, and
    `{mu:%}` in percent, `{tilt:deg}` in degrees, `{ratio:off}` as a deviation from 1."""

    @abstractmethod
    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Names on which the effect can act in this model (its possible `on`)."""

    def sought_on(self, model: SymbolicModel) -> tuple[str, ...]:
        """The targets on which a search tries it: all, but for those where it is another effect under a second name."""
        return () if self.by_name else self.targets(model)

    @abstractmethod
    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """The model with the effect on `on`, its parameters given as numbers or expressions."""

    def units(self, model: SymbolicModel, on: str) -> dict[str, str]:
        """Unit of each parameter symbol for this target."""
        own = {"input": model.units.get(on), "state": model.units.get(on)}
        if self.kind == "coordinate":
            c = model.coordinate(on)
            own |= {"force": c.force_unit, "position": model.units[c.position]}
        return {p.symbol: p.unit.format_map(own) for p in self.parameters}

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """Starts of a search for the effect: at the times of `begin`, or with the derivatives at its null."""
        own = self.parameters
        if self.begin is None:
            return (Start(len(own), lambda c: {p.symbol: p.null + x for p, x in zip(own, c, strict=True)}),)
        return tuple(multiple(own[0].symbol, k * scales.interval) for k in self.begin)

    def beyond(self, contained: Mapping[str, float], start: Mapping[str, float]) -> dict[str, float]:
        """Values to begin with, from the fit of the effect that this one contains and from one of its own starts."""
        return {**start, **contained}

    def restates(self, model: SymbolicModel, on: str, found: Sequence[AppliedEffect], measured: Sequence[str]) -> Equal:
        """Which of the effects that were found it equals exactly; `measured`: the states that are read."""
        return None

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Surfaces where the effect switches or changes faster than a grid may see: expressions, 0 on one each.

        They are over the names of the model's states and inputs; the gap is sampled on both sides. None by default.
        """
        return ()

    def memory_state(self, on: str) -> str | None:
        """Name of the state that carries what the effect remembers of the input `on`; None if no state does."""
        return None

    def doubt(self, values: Mapping[str, float], visited: Floats) -> str:
        """Why what its input, or the position of its coordinate, was (n,) does not show that it is this; '' if it
        does."""
        return ""

    def canonical(self, values: Mapping[str, float]) -> dict[str, float]:
        """The same effect with values as they are reported, such as an angle within half a turn."""
        return dict(values)

    def ratios(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Those of the values that are true over declared, which a column in another unit would make large or small."""
        return tuple(values[p.symbol] for p in self.parameters if p.symbol.startswith("ratio") and p.null == 1.0)

    def phrase(self, on: str) -> str:
        """A noun phrase without numbers: 'viscous friction at the hinge'."""
        return self.short.format(on=on) or f"{self.name.replace('_', ' ')} at the {on}"

    def describe(self, on: str, quoted: Quoted) -> str:
        """A noun phrase with its numbers: 'Coulomb friction of 0.19 ± 0.01 N m at the hinge'."""
        if self.long:
            return self.long.format(on=on, **{p.symbol: quoted[p.symbol] for p in self.parameters})
        numbers = ", ".join(f"{p.symbol} = {quoted.number(p.symbol)}" for p in self.parameters)
        return f"{self.phrase(on)} ({numbers})" if numbers else self.phrase(on)

    def physical(self, values: Mapping[str, float]) -> bool:
        """True if the values obey the sign constraints."""
        return all(p.lower <= values[p.symbol] <= p.upper for p in self.parameters)

    def check_target(self, model: SymbolicModel, on: str) -> None:
        """Refuse a target that this model does not have.

        Raises:
            UserError: naming the possible targets.
        """
        known = self.targets(model)
        if on not in known:
            remedy = f"It can act on: {', '.join(known)}." if known else "This plant has nothing it can act on."
            raise UserError(f"effect '{self.name}' cannot act on '{on}'", remedy=remedy)

    def check_values(self, values: Mapping[str, float]) -> None:
        """Refuse unknown, missing or unphysical parameter values.

        Raises:
            UserError: naming the symbol and its limits.
        """
        symbols = [p.symbol for p in self.parameters]
        if set(values) != set(symbols):
            raise UserError(
                f"effect '{self.name}' has parameters {symbols}, not {sorted(values)}", key="parameters",
                remedy="Give each a number; `simgap effects` lists them with their units.",
            )  # fmt: skip
        for p in self.parameters:
            if not p.lower <= float(values[p.symbol]) <= p.upper:
                raise UserError(
                    f"parameter {p.symbol} = {values[p.symbol]} of effect '{self.name}' is not physical",
                    key=f"parameters.{p.symbol}",
                    remedy=f"It lies in [{p.lower:g}, {p.upper:g}].",
                )
        if not self.physical(values):
            raise UserError(
                f"the parameters {dict(values)} of effect '{self.name}' are not physical together", key="parameters"
            )

    def apply(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> SymbolicModel:
        """The model corrected by this effect; its numbers become named parameters of the new model.

        Raises:
            UserError: unknown target, missing or unphysical value.
        """
        self.check_target(model, on)
        self.check_values(values)
        units = self.units(model, on)
        names: dict[str, str] = {}
        grown = model
        for p in self.parameters:
            name, count = f"{on}.{self.name}.{p.symbol}", 2
            while name in grown.parameters:
                name, count = f"{on}.{self.name}.{p.symbol}_{count}", count + 1
            names[p.symbol] = name
            description = f"{p.description} ({self.name} on {on})"
            grown = grown.with_parameter(name, Parameter(float(values[p.symbol]), units[p.symbol], description))
        return self.insert(grown, on, {key: symbol(name) for key, name in names.items()})


class WheeledTarget(Effect):
    """Whatever acts on a planar robot on two driven wheels."""

    kind: ClassVar[Kind] = "plant"
    needs: ClassVar[str] = "a planar robot on two driven wheels (plant.symbolic.wheels)"

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """The plant, if it is such a robot."""
        return ("plant",) if model.wheels is not None else ()


class WheelEffect(WheeledTarget):
    """A change of the speeds of a robot's driven wheels; an engine of such a robot acts it out on its motors."""

    @abstractmethod
    def turned(self, left: Any, right: Any, values: Mapping[str, Any]) -> tuple[Any, Any]:
        """Speeds of the left and the right wheel at their rims, m/s, where these were commanded.

        Numbers, or expressions of these.
        """

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Turn the commands into wheel speeds and back with what the wheels make of them."""
        if (wheels := model.wheels) is None:
            return model
        left, right = self.turned(*rim_speeds(wheels), values)
        held = model.with_input(wheels.linear, symbol("_linear"))  # both commands change at once
        turned = held.with_input(wheels.angular, (right - left) / wheels.track)
        return turned.substitute({"_linear": (right + left) / 2})


def rim_speeds(wheels: PlanarWheels) -> tuple[sp.Expr, sp.Expr]:
    """Commanded speeds of the left and the right wheel at their rims."""
    v, w = symbol(wheels.linear), symbol(wheels.angular) * wheels.track / 2
    return v - w, v + w


class CoordinateTarget(Effect):
    """Whatever acts on a coordinate."""

    kind: ClassVar[Kind] = "coordinate"
    needs: ClassVar[str] = "a coordinate (joints of a URDF, or plant.symbolic.coordinates)"
    rank: ClassVar[int] = FORCE

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Every coordinate of the plant."""
        return tuple(c.name for c in model.coordinates)


class CoordinateEffect(CoordinateTarget):
    """A generalised force on a coordinate; an engine of joints acts it out at each of its steps."""

    @abstractmethod
    def force(self, position: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """The generalised force on the coordinate at this position and velocity."""

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Add the force to the equations of motion."""
        c = model.coordinate(on)
        return model.with_force(on, self.force(symbol(c.position), symbol(c.velocity), values))

    def surfaces(self, model: SymbolicModel, on: str, values: Mapping[str, float]) -> tuple[sp.Expr, ...]:
        """Rest, where dry friction turns round; none of another force."""
        return (symbol(model.coordinate(on).velocity),) if self.dry else ()


class MemoryForceEffect(CoordinateTarget):
    """A force on a coordinate that depends on how it came where it is: a state z beside the plant's own.

    The rate of z is affine in z and vanishes at rest, so that the motion before a window tells z at its start.
    """

    remembers: ClassVar[bool] = True

    @abstractmethod
    def rate(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """dz/dt."""

    @abstractmethod
    def force(self, memory: sp.Expr, velocity: sp.Expr, values: Values) -> sp.Expr:
        """The generalised force on the coordinate."""

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Add the state and the force."""
        state, velocity = f"{on}_{self.name}", symbol(model.coordinate(on).velocity)
        grown = model.with_state(Variable(state, "1"), self.rate(symbol(state), velocity, values))
        return grown.with_force(on, self.force(symbol(state), velocity, values))


def both_sides(of: sp.Expr, *limits: float) -> tuple[sp.Expr, ...]:
    """Surfaces on which something is at a limit or at its opposite; none of limits that are infinite."""
    return tuple(of - sp.Float(side * limit) for limit in limits if math.isfinite(limit) for side in (-1.0, 1.0))


def driven_by(model: SymbolicModel, coordinate: str) -> tuple[str, ...]:
    """The inputs that are a force on the coordinate, one to one."""
    return tuple(u for u, on in model.driven.items() if on == coordinate)
