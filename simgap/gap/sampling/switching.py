"""Where a case's plant or simulator switches: the surfaces that its own effects, equations and end stops imply.

Each is an expression over the names of states and inputs that is 0 on the surface. Effects own theirs
(`Effect.surfaces`), a nominal model in equations has those of its `sign`, `abs`, `min` and `max`, a joint those of its
end stops. What an engine does on its own, unknown to the case, is not among them.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

from simgap import reading
from simgap.effects import effect
from simgap.late import sympy as sp
from simgap.model.symbolic import symbol
from simgap.plants.context import Context
from simgap.plants.stops import joint_stops
from simgap.simulators.build import switches


def switching_surfaces(context: Context) -> tuple[sp.Expr, ...]:
    """All surfaces of a case, each once, in order of their text: those of model and simulator alike.

    Raises:
        UserError: a plant that cannot be built.
    """
    plant, simulator = context.case.plant, context.case.simulator
    declared = context.plant.declared
    found = [*kinks(context.plant.carried.numeric()), *_stops(context), *switches(context.case, context.folder)]
    for added in (*plant.effects, *(simulator.effects if simulator is not None else ())):
        own = effect(added.name)
        if added.on in own.targets(declared):
            found += own.surfaces(declared, added.on, added.parameters)
    known = {symbol(name) for name in (*context.states, *context.inputs)}
    kept = {e for e in found if e.free_symbols and e.free_symbols <= known}
    return tuple(sorted(kept, key=str))


def kinks(expressions: Iterable[sp.Expr]) -> list[sp.Expr]:
    """Surfaces on which `sign`, `abs`, `min` and `max` in the expressions switch."""
    found: list[sp.Expr] = []
    for expression in expressions:
        for node in sp.preorder_traversal(expression):
            if isinstance(node, sp.sign | sp.Abs):
                found.append(node.args[0])
            elif isinstance(node, sp.Min | sp.Max):
                found += [a - b for a, b in combinations(node.args, 2)]
    return found


def _stops(context: Context) -> list[sp.Expr]:
    plant, simulator = context.case.plant, context.case.simulator
    places = {s.joint: name for name, s in plant.states.items() if s.quantity == "position" and s.joint}
    files = {f for f in (plant.urdf, simulator.urdf if simulator is not None else None) if f}
    return [
        symbol(places[joint]) - sp.Float(end)
        for file in sorted(files)
        if reading.is_file(context.folder / file)
        for joint, ends in joint_stops(context.folder / file, list(places)).items()
        for end in ends
    ]
