"""A plant parameter that differs from its declared value."""

from __future__ import annotations

from simgap.effects.base import PLANT, Effect, EffectParameter, MjcfPlace, Values
from simgap.effects.quoted import Quoted
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
        """How far the property is off."""
        noun = self.phrase(on).removeprefix("the ")
        return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun} that is {quoted.deviation()} its declared value"
