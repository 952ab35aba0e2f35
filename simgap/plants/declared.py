"""From the `plant` section of a case to the symbolic model as declared, before any effect."""

from __future__ import annotations

from pathlib import Path

from simgap.config.plant import PlantSection, SymbolicPlant
from simgap.errors import UserError
from simgap.late import sympy as sp
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
from simgap.plants.coupling import force_columns
from simgap.plants.joint_units import check_joint_units
from simgap.plants.urdf import JointState, load_urdf
from simgap.plants.urdf_checks import check_urdf
from simgap.units import check_unit, dimension, force_along, require_unit


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
    check_urdf(path)
    check_joint_units(section, path)
    return load_urdf(path, states, inputs, section.gravity)


def _from_equations(section: PlantSection, written: SymbolicPlant) -> SymbolicModel:
    states = {n: s for n, s in section.states.items() if s.lag_of is None}
    names = [*states, *section.inputs, *written.parameters]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise UserError(f"the names {twice} are used twice", key="plant.symbolic")
    _check_units(section, written)
    xdot = tuple(_parse(written.dynamics[n], names, f"plant.symbolic.dynamics.{n}") for n in states)
    coordinates = []
    for name, c in written.coordinates.items():
        key = f"plant.symbolic.coordinates.{name}"
        for role in (c.position, c.velocity):
            if role not in states:
                raise UserError(f"'{role}' is not a state", key=key, remedy=f"States: {list(states)}.")
        require_unit(states[c.velocity].unit, _rate_of(states[c.position].unit), f"plant.states.{c.velocity}.unit")
        force = c.force_unit if c.force_unit is not None else force_along(states[c.position].unit)
        coordinates.append(Coordinate(name, c.position, c.velocity, force))
    columns = force_columns(
        written, list(states), xdot, list(section.inputs), lambda text, key: _parse(text, names, key)
    )
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


def _check_units(section: PlantSection, written: SymbolicPlant) -> None:
    """Equations may be in any units, but in units that exist, and in SI where a role gives numbers a meaning.

    Raises:
        UserError: naming the key.
    """
    for kind, entries in (("states", section.states), ("inputs", section.inputs)):
        for name, variable in entries.items():
            check_unit(variable.unit, f"plant.{kind}.{name}.unit")
    for name, parameter in written.parameters.items():
        check_unit(parameter.unit, f"plant.symbolic.parameters.{name}.unit")
        if parameter.value < 0.0 and dimension(parameter.unit) in map(dimension, ("kg", "kg*m^2")):
            raise UserError(
                f"a mass or an inertia of {parameter.value:g} {parameter.unit} is negative",
                key=f"plant.symbolic.parameters.{name}.value",
                remedy="No body has one; the sign of a product of inertia belongs into the equations.",
            )
    for name, c in written.coordinates.items():
        if c.force_unit is not None:
            check_unit(c.force_unit, f"plant.symbolic.coordinates.{name}.force_unit")
    if written.wheels is not None:  # the track is in m, a heading turns by sin and cos
        roles = written.wheels
        for name, unit in ((roles.x, "m"), (roles.y, "m"), (roles.heading, "rad")):
            if name in section.states:
                require_unit(section.states[name].unit, unit, f"plant.states.{name}.unit")
        for name, unit in ((roles.linear, "m/s"), (roles.angular, "rad/s")):
            if name in section.inputs:
                require_unit(section.inputs[name].unit, unit, f"plant.inputs.{name}.unit")


def _rate_of(unit: str) -> str:
    return "1/s" if unit in ("1", "") else f"{unit}/s"


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
