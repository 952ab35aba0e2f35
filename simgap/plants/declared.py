"""From the `plant` section of a case to the symbolic model as declared, before any effect."""

from __future__ import annotations

from pathlib import Path

import sympy as sp

from simgap.config.plant import PlantSection, SymbolicPlant
from simgap.errors import UserError
from simgap.model.expressions import parse
from simgap.model.symbolic import (
    Coordinate,
    NamedParameter,
    Parameter,
    PlanarWheels,
    SymbolicModel,
    Variable,
    symbol,
)
from simgap.plants.urdf import JointState, load_urdf
from simgap.units import conversion


def declared_model(section: PlantSection, folder: Path) -> SymbolicModel:
    """The plant as declared, before any effect; paths in the section are relative to `folder`.

    Raises:
        UserError: whatever is wrong with the model file, the equations or the units.
    """
    if section.urdf is not None:
        return _from_urdf(section, folder / section.urdf)
    if section.symbolic is None:  # the section's own check makes this impossible
        raise UserError("neither urdf nor symbolic", key="plant")
    return _from_equations(section, section.symbolic)


def _from_urdf(section: PlantSection, path: Path) -> SymbolicModel:
    own = {n: s for n, s in section.states.items() if s.lag_of is None}
    states = {n: JointState(s.joint or "", s.quantity or "", s.unit) for n, s in own.items()}
    inputs = {n: (i.joint or "", i.unit) for n, i in section.inputs.items()}
    model = load_urdf(path, states, inputs, section.gravity)
    for c in model.coordinates:
        length, force = ("rad", "N*m") if c.force_unit == "N*m" else ("m", "N")
        wanted = {c.position: length, c.velocity: f"{length}/s"}
        wanted |= {name: force for name, (joint, _) in inputs.items() if joint == c.name}
        for variable in (*model.states, *model.inputs):
            if variable.name in wanted:
                _require_unit(variable, wanted[variable.name])
    return model


def _require_unit(variable: Variable, wanted: str) -> None:
    """Drake and PyBullet compute in SI; a state in other units would be silently wrong."""
    key = f"plant: {variable.name}.unit"
    try:
        factor = conversion(variable.unit, wanted).factor
    except UserError:
        factor = float("nan")
    if factor != 1.0:
        raise UserError(f"the unit is '{variable.unit}', the model computes in '{wanted}'", key=key, remedy="Use SI.")


def _from_equations(section: PlantSection, written: SymbolicPlant) -> SymbolicModel:
    states = {n: s for n, s in section.states.items() if s.lag_of is None}
    names = [*states, *section.inputs, *written.parameters]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise UserError(f"the names {twice} are used twice", key="plant.symbolic")
    xdot = tuple(_parse(written.dynamics[n], names, f"plant.symbolic.dynamics.{n}") for n in states)
    coordinates, columns = [], {}
    for name, c in written.coordinates.items():
        key = f"plant.symbolic.coordinates.{name}"
        for role in (c.position, c.velocity):
            if role not in states:
                raise UserError(f"'{role}' is not a state", key=key, remedy=f"States: {list(states)}.")
        gain = _parse(c.force_gain, names, f"{key}.force_gain")
        coordinates.append(Coordinate(name, c.position, c.velocity, c.force_unit))
        columns[name] = tuple(gain if n == c.velocity else sp.Integer(0) for n in states)
    ratio = symbol("ratio")
    return SymbolicModel(
        states=tuple(Variable(n, s.unit) for n, s in states.items()),
        inputs=tuple(Variable(n, i.unit) for n, i in section.inputs.items()),
        parameters={n: Parameter(p.value, p.unit, p.description) for n, p in written.parameters.items()},
        xdot=xdot,
        coordinates=tuple(coordinates),
        force_map=columns,
        named_parameters={
            n: NamedParameter(n, p.value, p.unit, {n: symbol(n) * ratio})
            for n, p in written.parameters.items()
            if p.value != 0.0
        },
        gravity=_gravity(written),
        wheels=PlanarWheels(**written.wheels.model_dump()) if written.wheels else None,
    )


def _gravity(written: SymbolicPlant) -> tuple[str, str, str] | None:
    for name in written.gravity or ():
        if name not in written.parameters:
            raise UserError(f"'{name}' is not a parameter", key="plant.symbolic.gravity")
    return written.gravity


def _parse(text: str, names: list[str], key: str) -> sp.Expr:
    try:
        return parse(text, names)
    except UserError as error:
        raise UserError(error.problem, key=key, remedy="Correct the expression.") from None
