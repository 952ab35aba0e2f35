"""Masses and gravity that differ from what is declared: a parameter, the tilt of the base, a rotor, a payload."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from simgap.effects.base import (
    PLANT,
    AppliedEffect,
    CoordinateTarget,
    Effect,
    EffectParameter,
    Equal,
    MjcfPlace,
    Quoted,
    Scales,
    Start,
    Values,
    beside,
)
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel, symbol


class ParameterError(Effect):
    """A named physical property is a multiple of what was declared."""

    name = "parameter_error"
    kind = "parameter"
    needs = "a named parameter that is not 0"
    formula = "p' = ratio p"
    source = "Ljung (1999), System Identification, sec. 4.2"
    rank = PLANT
    excitation = "swing wider: their forces differ with the angle"
    parameters = (EffectParameter("ratio", "1", "true over declared value", null=1.0, lower=1e-3, upper=1e3),)
    mjcf = MjcfPlace("body", ("mass", "inertia", "fullinertia"), quantity="mass")

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Every named parameter of the plant."""
        return tuple(model.named_parameters)

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Scale everything that the named property is made of."""
        scaling = model.named_parameters[on].scaling
        ratio = {symbol("ratio"): values["ratio"]}
        return model.substitute({name: sp.sympify(expr).subs(ratio) for name, expr in scaling.items()})

    def phrase(self, on: str) -> str:
        """'the mass of the rod' for rod.mass, 'the parameter g' for one without an owner."""
        owner, _, quantity = on.rpartition(".")
        words = {"com": "centre of mass", "": on}.get(quantity, quantity.replace("_", " "))
        return f"the {words} of the {owner}" if owner else f"the parameter {on}"

    def describe(self, on: str, quoted: Quoted) -> str:
        """Deviation of the property."""
        noun = self.phrase(on).removeprefix("the ")
        return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun} that is {quoted.deviation()} its declared value"


class GravityTilt(Effect):
    """The whole plant is turned about a horizontal axis, so that gravity points elsewhere in its frame.

    The axis is the world's y axis, or x for a plant that moves in the y-z plane alone.
    """

    name = "gravity_tilt"
    short = "a base tilt"
    long = "a base tilted by {tilt:deg}"
    kind = "plant"
    needs = "gravity that the plant declares"
    formula = "g' = R(-tilt) g, R a rotation about the horizontal axis normal to the plane of motion"
    source = "Siciliano et al. (2009), Robotics, sec. 7.3 (gravity in the base frame)"
    rank = PLANT + 10
    excitation = "swing wider: their forces differ with the angle"
    parameters = (EffectParameter("tilt", "rad", "angle of the base", null=0.0, lower=-math.pi / 2, upper=math.pi / 2),)

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """The plant, if it declares gravity."""
        return ("plant",) if model.gravity is not None else ()

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Rotate the gravity vector in the base frame."""
        gravity = model.gravity or ("", "", "")  # a target was checked: it is declared
        x, y, z = (symbol(name) for name in gravity)
        c, s = sp.cos(values["tilt"]), sp.sin(values["tilt"])
        used = set().union(*(sp.sympify(e).free_symbols for e in model.xdot))
        if x in used or y not in used:  # about y
            return model.substitute({gravity[0]: c * x - s * z, gravity[2]: s * x + c * z})
        return model.substitute({gravity[1]: c * y + s * z, gravity[2]: -s * y + c * z})


Column: TypeAlias = "tuple[sp.Expr, ...]"


class ReflectedInertia(CoordinateTarget):
    """A further inertia on the coordinate alone: I added to the diagonal of the mass matrix.

    With m the column of the inverse mass matrix and a the coordinate's acceleration, every acceleration falls by
    m I a / (1 + I m_c), m_c its entry at the coordinate (Sherman, Morrison (1950), Ann. Math. Stat. 21(1)).
    """

    name = "reflected_inertia"
    long = "a reflected inertia of {I} at the {on}"
    formula = "M' = M + I e e^T, e the coordinate"
    source = "Siciliano et al. (2009), Robotics, sec. 7.2.1 (rotor inertia times the gear ratio squared)"
    rank = PLANT + 40
    excitation = "vary the speed, and add faster input changes"
    parameters = (EffectParameter("I", "{force}*s^2/{position}", "reflected inertia", null=0.0, lower=0.0),)
    mjcf = MjcfPlace("joint", ("armature",))

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Change the accelerations and what every force does to them."""
        c = model.coordinate(on)
        own = model.state_names.index(c.velocity)
        column = model.force_map[on]
        share = values["I"] / (1 + values["I"] * column[own])

        def slowed(rates: Column) -> Column:
            return tuple(f - m * share * rates[own] for f, m in zip(rates, column, strict=True))

        columns = {name: slowed(other) for name, other in model.force_map.items()}
        return replace(model, xdot=slowed(model.xdot), force_map=columns)


_AXES = "xyz"


class Payload(Effect):
    """A point mass on the line from a link's joint through its centre of mass: one change of inertia and gravity.

    Where one link moves it is an error of the centre of mass beside one of the inertia; it is told of beside these and
    not sought by itself. Where two move it is one effect in the place of three errors, and sought.
    """

    name = "payload"
    short = "a payload on the {on}"
    long = "a payload of {m_p} on the {on}, {r} from its joint"
    kind = "plant"
    several_valleys = True
    needs = "a link from a URDF of one or two joints that has a mass, a centre of mass and an inertia"
    formula = "m' = m + m_p, m' c' = m c + m_p p, I' = I + m_p (p.p 1 - p p^T), p = r c/|c|"
    source = "Khalil, Dombre (2002), Modeling, Identification and Control of Robots, sec. 9.9 (payload identification)"
    rank = PLANT + 5
    excitation = "swing wider, slowly and fast"
    parameters = (
        EffectParameter("m_p", "kg", "mass of the payload", null=0.0, lower=0.0),
        EffectParameter("r", "m", "its distance from the link's joint", null=0.3, lower=1e-3, shape=True),
    )

    def targets(self, model: SymbolicModel) -> tuple[str, ...]:
        """Links whose mass, centre of mass and inertia are parameters of the equations."""
        links = [n.removesuffix(".m") for n in model.parameters if n.endswith(".m")]
        return tuple(n for n in links if _centre(model, n) and _moments(model, n) and model.derived)

    def sought_on(self, model: SymbolicModel) -> tuple[str, ...]:
        """Nowhere on a single joint: two effects that are tried are the same."""
        return self.targets(model) if len(model.coordinates) > 1 else ()

    def starts(self, scales: Scales) -> tuple[Start, ...]:
        """The mass as a linear coefficient, at a few distances."""
        return tuple(beside("m_p", r=distance) for distance in (0.05, 0.2, 0.5, 1.2))

    def insert(self, model: SymbolicModel, on: str, values: Values) -> SymbolicModel:
        """Change mass, centre of mass and inertia at once."""
        mass, centre, extra = symbol(f"{on}.m"), _centre(model, on), values["m_p"]
        away = sp.sqrt(sp.Add(*(symbol(n) ** 2 for n in centre.values())))
        place = {axis: values["r"] * symbol(n) / away for axis, n in centre.items()}
        changes = {f"{on}.m": mass + extra}
        for axis, name in centre.items():
            changes[name] = (mass * symbol(name) + extra * place[axis]) / (mass + extra)
        for (a, b), name in _moments(model, on).items():
            square = values["r"] ** 2 if a == b else sp.Integer(0)
            changes[name] = symbol(name) + extra * (square - place.get(a, 0) * place.get(b, 0))
        return model.substitute(changes)

    def restates(self, model: SymbolicModel, on: str, found: Sequence[AppliedEffect], measured: Sequence[str]) -> Equal:
        """Errors of the centre of mass and of the inertia of the only link that moves, where a weight makes both."""
        own = {k: a for k, a in enumerate(found) if a.name == "parameter_error" and a.on.startswith(f"{on}.")}
        centre, moments = _centre(model, on), _moments(model, on)
        if len(model.coordinates) != 1 or not own or len(moments) != 1 or len(centre) != 1:
            return None
        before = {n: p.value for n, p in model.parameters.items()}
        after = dict(before)
        for a in own.values():
            at = {symbol(n): v for n, v in before.items()} | {symbol("ratio"): a.values["ratio"]}
            for n, rule in model.named_parameters[a.on].scaling.items():
                after[n] *= float(sp.sympify(rule).subs(at)) / before[n]
        ((name,), (moment,)) = centre.values(), moments.values()
        turn = (after[f"{on}.m"] * after[name] - before[f"{on}.m"] * before[name]) / (1.0 if before[name] > 0 else -1.0)
        slow = after[moment] - before[moment]
        if turn <= 0.0 or slow <= 0.0:
            return None
        return frozenset(own), {"m_p": turn**2 / slow, "r": slow / turn}


def _centre(model: SymbolicModel, link: str) -> dict[str, str]:
    """Axis -> name of the parameter that holds the link's centre of mass along it."""
    names = {axis: f"{link}.c{axis}" for axis in _AXES}
    return {axis: n for axis, n in names.items() if n in model.parameters and model.parameters[n].value != 0.0}


def _moments(model: SymbolicModel, link: str) -> Mapping[tuple[str, str], str]:
    """Two axes -> name of the parameter that holds the link's moment of inertia."""
    pairs = (("x", "x"), ("y", "y"), ("z", "z"), ("x", "y"), ("x", "z"), ("y", "z"))
    names = {(a, b): f"{link}.I{a}{b}" for a, b in pairs}
    return {pair: n for pair, n in names.items() if n in model.parameters}
