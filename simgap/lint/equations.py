"""Checks of equations (units, length, sampling time) and of angles (degrees in place of radians, wrapping).

A number that stands in an equation may carry a unit that is not written (9.81, 0.01): what it multiplies is of any
dimension. Small whole numbers and their quotients are pure.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from simgap.arrays import Floats
from simgap.errors import Finding, UserError
from simgap.late import sympy as sp
from simgap.model.sampled import RungeKutta
from simgap.model.symbolic import kinds, symbol
from simgap.notation import pretty_unit
from simgap.plants.context import Context
from simgap.plants.model_file import FileJoint
from simgap.simulators.rollouts import engine_of
from simgap.units import dimension, dimension_text, of_base

HEAVY = 5_000
"""Operations to be compiled beyond which a person is warned; numba's time grows faster than their number. A Furuta
pendulum has 81 by explicit_euler and 74 by rk4, both compiled in seconds; 24,913 were not in 250 s."""

_DRAWN, _SAME = 3, 1e-6
"""Points at which equations in two systems of units are compared, and the relative difference that is rounding."""


def refuse_prefixes(context: Context) -> None:
    """Refuse a unit that is a power of a thousand away from SI (mV, g, km) where the equations mix it with others.

    Numbers enter the equations as they stand. Where all units make one system (mm, mN and kg do) nothing is mixed: the
    same equations then hold in SI, which is what is tried.

    Raises:
        UserError: with the key of the unit.
    """
    if context.case.plant.symbolic is None:
        return
    model = context.plant.declared
    keys = {v.name: f"plant.states.{v.name}.unit" for v in model.states}
    keys |= {v.name: f"plant.inputs.{v.name}.unit" for v in model.inputs}
    keys |= {name: f"plant.symbolic.parameters.{name}.unit" for name in model.parameters}
    units = {v.name: v.unit for v in (*model.states, *model.inputs)} | {k: p.unit for k, p in model.parameters.items()}
    factors = {name: of_base(unit) for name, unit in units.items()}
    odd = [name for name, factor in factors.items() if _prefixed(factor)]
    if not odd or _one_system(model.xdot, [v.name for v in model.states], factors):
        return
    name = odd[0]
    raise UserError(
        f"is {units[name]}, beside units of another size: the equations take each number as it stands, and a factor of "
        f"{max(factors[name], 1.0 / factors[name]):g} is lost", key=keys[name],
        remedy="Write it, and every number of it, in SI units without a prefix.",
    )  # fmt: skip


def _prefixed(factor: float) -> bool:
    thousands = math.log10(factor) / 3.0
    return abs(thousands) > 0.5 and abs(thousands - round(thousands)) < 1e-9


def _one_system(rates: Sequence[sp.Expr], states: Sequence[str], factors: Mapping[str, float]) -> bool:
    """True if f_x g(X / f) = g(X): the rates g of numbers in their own units, f of them in SI, and of numbers in SI."""
    rng = np.random.default_rng(0)
    for _ in range(_DRAWN):
        here = {name: float(rng.uniform(0.5, 2.0)) for name in factors}
        for rate, state in zip(rates, states, strict=True):
            symbols = {s: str(s) for s in rate.free_symbols if str(s) in factors}
            plain = complex(rate.subs({s: here[n] for s, n in symbols.items()}))
            own = factors[state] * complex(rate.subs({s: here[n] / factors[n] for s, n in symbols.items()}))
            if abs(own - plain) > _SAME * max(abs(own), abs(plain)):
                return False
    return True


def find_mixed_units(context: Context) -> Iterator[Finding]:
    """Parameters that are not in SI units while every state and input is: their values are not converted."""
    section = context.case.plant.symbolic
    if section is None or any(abs(of_base(u) - 1.0) > 1e-9 for u in context.units.values()):
        return
    for name, p in section.parameters.items():
        if abs(of_base(p.unit) - 1.0) > 1e-9:
            yield Finding(
                f"plant.symbolic.parameters.{name}",
                f"is in {p.unit}, while states and inputs are in SI units; the equations take the number as it stands",
                f"Write it in SI units: {p.value * of_base(p.unit):.6g}",
            )


def find_wrong_dimensions(context: Context) -> Iterator[Finding]:
    """Equations whose terms are of different dimensions, or that do not give what their state has a second."""
    if context.case.plant.symbolic is None:
        return
    model = context.plant.declared
    units = {v.name: v.unit for v in (*model.states, *model.inputs)} | {k: p.unit for k, p in model.parameters.items()}
    known = {name: dimension(unit) for name, unit in units.items()}
    for v, rate in zip(model.states, model.xdot, strict=True):
        if words := rate_mismatch(rate, v.unit, known):
            remedy = "Correct a unit or the equation (a number may carry any unit)"
            yield Finding(f"plant.symbolic.dynamics.{v.name}", words, remedy)


def find_heavy_steps(context: Context) -> Iterator[Finding]:
    """A nominal step of so many operations that synthesis will take far longer than is estimated."""
    if context.case.synthesis is not None and (operations := context.plant.sampled.operations) > HEAVY:
        yield Finding(
            "plant",
            f"a step of the nominal model has {operations:,} operations; compiling and asking it takes synthesis "
            "minutes to hours more than is estimated",
            "Leave out terms that matter little, or fix joints; what the model then misses is in the gap",
        )


HOPELESS = 100.0
"""Widths of X in one step, from most of X and U, beyond which a unit is wrong. Judgement: from two on nothing stays."""
HARDLY = 1e-4
"""Width of X in one step at most, from all of X and U, below which a state hardly moves: 10,000 cells would not see it.
Judgement: of the shipped cases the least is .006."""
DRAWN, MOST_INPUTS, LONGEST_RULE = 200, 16, 20_000


def find_long_steps(context: Context) -> Iterator[Finding]:
    """A finding for each state that crosses all of X within one sampling time from most of X x U, or hardly moves.

    By the nominal model.

    Of a rule of more than `LONGEST_RULE` operations nothing is asked: reading it would take longer than a check may.

    Raises:
        UserError: a state that crosses X a hundred times.
    """
    if context.case.domain is None or not context.states:
        return
    model, box = context.plant.sampled, context.box
    if model.operations > LONGEST_RULE:
        return
    inputs = context.input_set[np.linspace(0, len(context.input_set) - 1, MOST_INPUTS).round().astype(int)]
    drawn = box.lo + (box.hi - box.lo) * np.random.default_rng(0).random((DRAWN, len(context.states)))
    x, u = (np.array(part) for part in zip(*itertools.product(drawn, inputs), strict=True))
    rows = sp.lambdify((*model.x, *model.u), model.rule, modules="numpy")
    values = _rates(rows, x, u).T
    moved = np.abs(values * model.tau if isinstance(model, RungeKutta) else values - x)
    widths = np.median(moved, axis=0) / (box.hi - box.lo)
    for j in np.argsort(-widths, kind="stable"):  # what is refused is the worst: others may only follow it
        name = context.states[j]
        width, usual = box.hi[j] - box.lo[j], float(np.median(moved[:, j]))
        if j not in context.periodic and usual > width:
            unit = pretty_unit(context.units[name])
            problem = (
                f"in one sampling time of {model.tau:g} s {name} moves by {usual:.3g} {unit}, {usual / width:.2g} "
                "times the width of X, from most of X and U"
            )
            if usual > HOPELESS * width:
                remedy = "Look at the units of tau, X and U, and at parameters."
                raise UserError(problem, key="domain.tau", remedy=remedy)
            yield Finding("domain.tau", problem, "Shorten tau (is it in seconds?), or enlarge X")
        elif float(most := moved[:, j].max()) < HARDLY * width:
            problem = (
                f"{name} moves by at most {most / width:.2g} of the width of X in one sampling time of {model.tau:g} s"
            )
            remedy = "Look at the units of tau and X, and at parameters; or lengthen tau"
            yield Finding("domain.tau", problem, remedy)


_PURE_NUMBERS = frozenset(Fraction(a, b) for a in range(-6, 7) for b in (1, 2, 3, 4, 6, 12))
_OF_PURE = "sin cos tan asin acos atan exp log sinh cosh tanh"
_LIKE_ITS_TERMS = "Add Abs Min Max"
_PURE_RESULT = "sign atan2 Heaviside"


class Mismatch(ValueError):
    """Dimensions that do not fit together, in words."""


def of_expression(expr: sp.Expr, known: Mapping[str, Any]) -> Any:
    """Dimension of an expression (`units.dimension`); None where a number of unknown unit decides it.

    Args:
        expr: in symbols; known: their dimensions by name.

    Raises:
        Mismatch: for a sum of different dimensions, or a sine or exponential of something that is no pure number.
    """
    pure = dimension("1")
    if expr.is_Symbol:
        return known.get(str(expr))
    if expr.is_number:
        pure_number = expr.is_Rational and expr != 0 and Fraction(int(expr.p), int(expr.q)) in _PURE_NUMBERS
        return pure if pure_number else None  # 0 is of any unit
    if isinstance(expr, kinds(_LIKE_ITS_TERMS)):
        return _alike(expr.args, known)
    if isinstance(expr, sp.Mul):
        factors = [of_expression(a, known) for a in expr.args]
        return None if None in factors else math.prod(factors, start=pure)
    if isinstance(expr, sp.Pow) and not isinstance(expr, sp.exp):
        return _power(expr, known)
    if isinstance(expr, kinds(_OF_PURE)):
        inner = of_expression(expr.args[0], known)
        if inner not in (None, pure):
            raise Mismatch(f"{expr.func.__name__}({expr.args[0]}) is taken of {dimension_text(inner)}")
        return pure
    if isinstance(expr, sp.Piecewise):
        return _alike([value for value, _ in expr.args], known)
    for a in expr.args:
        if isinstance(a, sp.Expr):
            of_expression(a, known)
    return pure if isinstance(expr, kinds(_PURE_RESULT)) else None


def rate_mismatch(expr: sp.Expr, unit: str, known: Mapping[str, Any]) -> str:
    """Fault of the equation of a state in a unit, in words; "" if there is none.

    Args:
        expr: the rate of change; unit: of the state; known: dimensions of all symbols.
    """
    try:
        found = of_expression(expr, known)
    except Mismatch as wrong:
        return str(wrong)
    wanted = dimension(unit) / dimension("s")
    # equal and pure: an equation in pure numbers, the second in the ones that stand in it
    fits = found is None or found == wanted or found == dimension(unit) == dimension("1")
    return "" if fits else f"gives {dimension_text(found)}, and the state changes by {dimension_text(wanted)}"


def _alike(terms: Any, known: Mapping[str, Any]) -> Any:
    """The one dimension of all terms that have one."""
    first: tuple[sp.Expr, Any] | None = None
    for term in terms:
        own = of_expression(term, known)
        if own is None:
            continue
        if first is not None and own != first[1]:
            one, other = dimension_text(first[1]), dimension_text(own)
            raise Mismatch(f"adds '{first[0]}' ({one}) and '{term}' ({other})")
        first = first or (term, own)
    return first[1] if first else None


def _power(expr: sp.Pow, known: Mapping[str, Any]) -> Any:
    base, exponent = expr.as_base_exp()
    inner = of_expression(base, known)
    if inner in (None, dimension("1")):
        return inner
    return inner ** float(exponent) if exponent.is_number else None


ROUND, LEAST, LARGE = 5.0, 10.0, 100.0
"""Number of which both ends of an angle are multiples if in degrees, from which size that says something (a turn and
a half in rad), and the size beyond which any number is said. Judgement; an angle may wind: it is said, not refused."""
BEYOND = 3.0
"""How many times an end of X is its joint's limit, beyond which a unit is wrong, if degrees would fit. Judgement."""
PLACES, SAME = 50, 1e-9
"""Places where rates are compared with those a width of X further on, and how much of their size they may differ: pi as
a double leaves 1e-16 of it, four decimals of pi leave 1e-5, and what is proven on X would not hold a turn away."""


def find_degrees(context: Context, joints: Mapping[str, FileJoint]) -> Iterator[Finding]:
    """A finding for each angle of X in rad whose ends look like degrees.

    Args:
        context: of a case with a domain or without.
        joints: of the model file, by name; nothing for equations.

    Raises:
        UserError: an angle far beyond the limits of its joint, which would lie within them as degrees.
    """
    for name in context.states if context.case.domain is not None else ():
        lo, hi = context.domain.X[name]
        most = max(abs(lo), abs(hi))
        whole = all(abs(end / ROUND - round(end / ROUND)) < 1e-9 for end in (lo, hi))
        if context.units[name] != "rad" or (most < LARGE and not (whole and most >= LEAST)):
            continue
        meant = f"[{math.radians(lo):.4g}, {math.radians(hi):.4g}]"
        key, own = f"domain.X.{name}", context.case.plant.states[name].joint or ""
        problem = f"[{lo:g}, {hi:g}] is in rad, {most / math.tau:.3g} turns away from 0; it looks like degrees"
        remedy = f"Write {meant} if it is, and rates, targets and obstacles of it in rad too"
        joint = joints.get(own)
        if joint is not None and joint.range is not None:
            ends = max(abs(end) for end in joint.range)
            if most > BEYOND * ends and math.radians(most) <= ends:
                problem += f"; its joint '{own}' ends at {joint.range[0]:g} and {joint.range[1]:g}"
                raise UserError(problem, key=key, remedy=f"{remedy}.")
        yield Finding(key, problem, f"{remedy}; leave it if the angle winds so far")


def refuse_seams(context: Context) -> None:
    """Refuse a state said to wrap around where model or known simulator differ a width of X further on.

    Raises:
        UserError: with the state, and what its X has to be for an angle in rad.
    """
    if context.case.domain is None or not context.periodic:
        return
    declared = context.plant.declared
    if declared.derived and context.plant.sampled.operations <= LONGEST_RULE:
        _refuse_seams(context, "model's rates", declared.numeric())
    case, folder = context.case, context.folder
    simulator = None if case.simulator is None else engine_of(case, folder).closed_form(case, folder)
    if simulator is not None:
        steps = [e - symbol(s) for e, s in zip(simulator, context.states, strict=True)]
        _refuse_seams(context, "simulator's steps", steps)


def _refuse_seams(context: Context, whose: str, exprs: Sequence[sp.Expr]) -> None:
    for name, apart in _across(context, exprs):
        if apart > SAME:
            lo, hi = context.domain.X[name]
            angle = context.units[name] == "rad"
            raise UserError(
                f"wraps around, yet the {whose} differ by {apart:.2g} of their size after the {hi - lo:.5g} of X",
                key=f"domain.X.{name}",
                remedy=(f"Give a full turn in rad, such as [{-math.pi}, {math.pi}]" if angle else "Give it one period")
                + f", or take {name} out of domain.periodic.",
            )


def _across(context: Context, exprs: Sequence[sp.Expr]) -> Iterator[tuple[str, float]]:
    """For each state that wraps: by how much expressions change a width of X further on, as a share of the largest."""
    box = context.box
    rows = sp.lambdify([symbol(name) for name in (*context.states, *context.inputs)], exprs, modules="numpy")
    rng = np.random.default_rng(0)
    x = box.lo + (box.hi - box.lo) * rng.random((PLACES, len(context.states)))
    u = context.input_set[rng.integers(len(context.input_set), size=PLACES)]
    here = _rates(rows, x, u)
    size = np.nanmax(np.abs(here), axis=1)
    for j in context.periodic:
        turned = x.copy()
        turned[:, j] += box.hi[j] - box.lo[j]
        apart = np.nanmax(np.abs(_rates(rows, turned, u) - here), axis=1)
        yield context.states[j], float(np.max(apart / np.where(size > 0.0, size, 1.0)))


def _rates(rows: Callable[..., list[Floats]], x: Floats, u: Floats) -> Floats:
    """(nx, n) from states (n, nx) and inputs (n, nu)."""
    with np.errstate(all="ignore"):
        return np.stack([np.broadcast_to(row, len(x)) for row in rows(*x.T, *u.T)])
