"""The one door to the nominal model of a case, in four shapes: declared, corrected, carried and sampled.

It is built once from the `plant` section; declared is the model before any effect.

A force on one coordinate of written equations moves all of them: with `M(q) dv/dt = Q + ...` a generalised force Q_j
adds column j of M^-1 to the accelerations (Siciliano et al. (2009), Robotics, sec. 7.2). Where the equations themselves
show that coordinates are coupled, a force that is said to move its own coordinate alone is refused.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from simgap.arrays import Floats
from simgap.config.case import Case
from simgap.config.load import load_case
from simgap.config.plant import PlantSection, State, SymbolicCoordinate, SymbolicPlant
from simgap.effects import AppliedEffect, apply_effects, check_listed, delays_and_lags, effect
from simgap.errors import UserError, placed
from simgap.geometry import Box
from simgap.late import sympy as sp
from simgap.model.expressions import parse
from simgap.model.sampled import NominalModel, sampled_model
from simgap.model.symbolic import Coordinate, NamedParameter, Parameter, PlanarWheels, SymbolicModel, Variable, symbol
from simgap.model.tree import Tree
from simgap.plants.drake_check import check_declared, check_map, symbolic_plant
from simgap.plants.urdf import load_tree, load_urdf
from simgap.plants.urdf_checks import check_joint_units, check_urdf
from simgap.units import check_unit, dimension, force_along, require_unit

Column: TypeAlias = "tuple[sp.Expr, ...]"
Parse: TypeAlias = "Callable[[str, str], sp.Expr]"
"""Text of an expression and its key -> expression."""
_DRAWS = 20  # positions at which numbers are looked at, within one unit of zero
_SAME = 1e-9  # relative
_KEY = "plant.symbolic.mass_matrix"


def force_columns(
    written: SymbolicPlant, states: Sequence[str], xdot: Sequence[sp.Expr], inputs: Sequence[str], parsed: Parse
) -> dict[str, Column]:
    """d xdot / d Q of the force on each coordinate, over the states.

    Args:
        written: the equations; states, inputs: names, in order.
        xdot: their rates, parsed; parsed: reads a further expression of the case.

    Raises:
        UserError: no structure or two, a matrix that is no mass matrix, coupling that the case does not say.
    """
    if written.mass_matrix is not None:
        return _from_mass_matrix(written, states, parsed)
    columns = {}
    for name, c in written.coordinates.items():
        key = f"plant.symbolic.coordinates.{name}"
        if (c.force_gain is None) == (c.force_map is None):
            raise UserError(
                "a coordinate has either force_gain or force_map", key=key, remedy="Or give the plant a mass_matrix."
            )
        gains = c.force_map if c.force_map is not None else {c.velocity: str(c.force_gain)}
        unknown = sorted(set(gains) - {other.velocity for other in written.coordinates.values()})
        if unknown:
            raise UserError(
                f"{unknown} are not velocities of coordinates", key=f"{key}.force_map",
                remedy="Declare a coordinate for each; its position is a state that need not be measured.",
            )  # fmt: skip
        where = f"{key}.force_map" if c.force_map is not None else f"{key}.force_gain"
        read = {n: parsed(text, where if c.force_map is None else f"{where}.{n}") for n, text in gains.items()}
        columns[name] = tuple(read.get(n, sp.Integer(0)) for n in states)
    _refuse_hidden_coupling(written, states, xdot, inputs, columns)
    return columns


def _from_mass_matrix(written: SymbolicPlant, states: Sequence[str], parsed: Parse) -> dict[str, Column]:
    """Columns of the inverse, after a look at what makes a mass matrix."""
    names, rows = list(written.coordinates), written.mass_matrix or ()
    if len(rows) != len(names) or any(len(row) != len(names) for row in rows):
        remedy = f"One row and column for each of the coordinates {names}."
        raise UserError(f"the mass matrix is not {len(names)} x {len(names)}", key=_KEY, remedy=remedy)
    for name, c in written.coordinates.items():
        if c.force_gain is not None or c.force_map is not None:
            problem = "with a mass matrix a coordinate has no force_gain and no force_map"
            raise UserError(problem, key=f"plant.symbolic.coordinates.{name}", remedy="Remove it.")
    matrix = sp.Matrix(len(names), len(names), lambda i, j: parsed(rows[i][j], f"{_KEY}.{i}.{j}"))
    positions = [c.position for c in written.coordinates.values()]
    _check_mass_matrix(written, matrix, positions)
    inverse = matrix.adjugate() / matrix.det(method="berkowitz")
    place = {c.velocity: k for k, c in enumerate(written.coordinates.values())}
    zero = sp.Integer(0)
    return {name: tuple(inverse[place[n], j] if n in place else zero for n in states) for j, name in enumerate(names)}


def _check_mass_matrix(written: SymbolicPlant, matrix: sp.Matrix, positions: Sequence[str]) -> None:
    """Symmetric and positive definite at some positions, and of positions and parameters alone."""
    numbers = {symbol(n): p.value for n, p in written.parameters.items()}
    foreign = {str(s) for s in matrix.free_symbols} - set(positions) - set(written.parameters)
    if foreign:
        raise UserError(
            f"the mass matrix holds {sorted(foreign)}", key=_KEY, remedy="It is made of positions and parameters alone."
        )
    rng = np.random.default_rng(0)
    for at in rng.uniform(-1.0, 1.0, (_DRAWS, len(positions))):
        here = numbers | {symbol(n): v for n, v in zip(positions, at, strict=True)}
        try:
            m = np.array(matrix.subs(here).tolist(), dtype=np.float64)
        except TypeError:
            raise UserError("the mass matrix is not a finite real number everywhere", key=_KEY) from None
        lacks, remedy = "", "Correct the entries off its diagonal."
        if not np.allclose(m, m.T, rtol=_SAME, atol=0.0):
            lacks = "symmetric"
        elif not np.isfinite(m).all() or np.linalg.eigvalsh(m)[0] <= 0.0:
            lacks, remedy = "positive definite", "Correct its entries or the parameters."
        if lacks:
            raise UserError(f"the mass matrix is not {lacks}", key=_KEY, remedy=remedy)


def _refuse_hidden_coupling(
    written: SymbolicPlant, states: Sequence[str], xdot: Sequence[sp.Expr], inputs: Sequence[str],
    columns: Mapping[str, Column],
) -> None:  # fmt: skip
    """Refuse coordinates that their equations couple while the case says that a force moves its own one alone.

    What shows it: an input that acts on a coordinate as a force does and accelerates another one too, and products of
    velocities (Coriolis and centrifugal terms) in an acceleration that are not of its own speed alone. Forces between
    bodies, such as springs, dampers and drag, show nothing of this kind.
    """
    rates = dict(zip(states, xdot, strict=True))
    alone = {n: c for n, c in written.coordinates.items() if c.force_map is None}
    for (a, first), (b, second) in itertools.permutations(alone.items(), 2):
        gain = columns[a][states.index(first.velocity)]
        for u in map(symbol, inputs):
            here, there = (sp.diff(rates[c.velocity], u) for c in (first, second))
            if there != 0 and _constant(here / gain, written):
                raise _coupled(a, b, f"{u} drives '{a}' and accelerates '{b}' too")
        if _coriolis(rates[second.velocity], first, alone):
            raise _coupled(a, b, f"the acceleration of '{b}' holds products of velocities with that of '{a}'")


def _constant(share: sp.Expr, written: SymbolicPlant) -> bool:
    """True if an expression is the same number, not 0, wherever it is evaluated."""
    share = share.subs({symbol(n): p.value for n, p in written.parameters.items()})
    free = sorted(share.free_symbols, key=str)
    rng = np.random.default_rng(0)
    try:
        found = [float(share.subs(dict(zip(free, at, strict=True)))) for at in rng.uniform(-1.0, 1.0, (4, len(free)))]
    except TypeError:  # not a real number there
        return False
    return abs(found[0]) > 0.0 and bool(np.allclose(found, found[0], rtol=_SAME, atol=0.0))


def _coriolis(rate: sp.Expr, of: SymbolicCoordinate, among: Mapping[str, SymbolicCoordinate]) -> bool:
    """True if the rate of another velocity holds the square of this speed or its product with one, as powers."""
    speeds = [symbol(c.velocity) for c in among.values()]
    if not rate.is_polynomial(*speeds):
        return False
    return any(sp.diff(rate, symbol(of.velocity), v) != 0 for v in speeds)


def _coupled(a: str, b: str, why: str) -> UserError:
    return UserError(
        f"'{a}' and '{b}' look coupled ({why}), but force_gain says that a force on one moves it alone",
        key="plant.symbolic.coordinates",
        remedy="Give plant.symbolic.mass_matrix in the order of the coordinates, diagonal if they are not coupled, "
        "and no force_gain; or a force_map for each coordinate.",
    )


def declared_model(section: PlantSection, folder: Path) -> SymbolicModel:
    """The plant as declared, before any effect; paths in the section are relative to `folder`.

    Raises:
        UserError: whatever is wrong with the model file, the equations or the units.
    """
    if section.urdf is not None:
        path = folder / section.urdf
        check_urdf(path)
        check_joint_units(section, path)
        own = {n: s for n, s in section.states.items() if s.lag_of is None}
        return load_urdf(path, own, section.inputs, section.gravity)
    if section.symbolic is None:  # the section's own check makes this impossible
        raise UserError("neither urdf nor symbolic", key="plant")
    return _from_equations(section, section.symbolic)


def _from_equations(section: PlantSection, written: SymbolicPlant) -> SymbolicModel:
    states = {n: s for n, s in section.states.items() if s.lag_of is None}
    names = [*states, *section.inputs, *written.parameters]
    twice = sorted({n for n in names if names.count(n) > 1})
    if twice:
        raise UserError(f"the names {twice} are used twice", key="plant.symbolic")
    written = _with_evident_coordinate(section, written, states)
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


def _with_evident_coordinate(
    section: PlantSection, written: SymbolicPlant, states: Mapping[str, State]
) -> SymbolicPlant:
    """The equations with the one degree of freedom that they show, where they name none.

    A state whose rate is another state is a position. Of a single one no force moves anything else, so that forces are
    accelerations: the inertia is unknown. With several, only the case can say how they are coupled.
    """
    if written.coordinates or written.wheels is not None or written.mass_matrix is not None:
        return written
    pairs = [(n, rate.strip()) for n, rate in written.dynamics.items() if rate.strip() in states]
    if len(pairs) != 1 or pairs[0][0] == pairs[0][1]:
        return written
    position, velocity = pairs[0]
    if dimension(states[velocity].unit) != dimension(_rate_of(states[position].unit)):
        return written
    unit = states[position].unit
    force = "N/kg" if dimension(unit) == dimension("m") else f"{unit}/s^2" if unit not in ("1", "") else "1/s^2"
    evident = SymbolicCoordinate(position=position, velocity=velocity, force_gain="1", force_unit=force)
    return written.model_copy(update={"coordinates": {"axis": evident}})


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
            problem = f"a mass or an inertia of {parameter.value:g} {parameter.unit} is negative"
            remedy = "No body has one; the sign of a product of inertia belongs into the equations."
            raise UserError(problem, key=f"plant.symbolic.parameters.{name}.value", remedy=remedy)
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
    unknown = [name for name in written.gravity or () if name not in written.parameters]
    if unknown:
        raise UserError(f"'{unknown[0]}' is not a parameter", key="plant.symbolic.gravity")
    return written.gravity


def _parse(text: str, names: list[str], key: str) -> sp.Expr:
    with placed(key=key, remedy="Correct the expression."):
        return parse(text, names)


@dataclass(frozen=True, eq=False)
class PlantModel:
    """The nominal plant of a case; each shape is made when first asked for and kept.

    An effect may remember past commands (a delay, a lag). The sampled map is a function of the case's states and the
    present input, so it has such an effect only where the case carries its memory: a lag whose output is among the
    states (`lag_of`). One sample of delay is carried where `sensing.latency_of` is `input_delay`: the controller then
    knows the pending input. What is not carried is left out of the map, and gamma has to cover it: the gap is taken
    over everything that admissible earlier commands can leave behind (`simulators.memory`).

    Attributes:
        section: the plant, with its effects.
        folder: where the section's relative paths start.
        tau: sampling time, s; None for a case without a domain, whose model cannot be sampled.
    """

    section: PlantSection
    folder: Path
    tau: float | None = None

    @staticmethod
    def of(case: Case, folder: Path) -> PlantModel:
        """The plant of a case."""
        return PlantModel(case.plant, folder, case.domain.tau if case.domain is not None else None)

    @cached_property
    def declared(self) -> SymbolicModel:
        """Continuous, as declared, before any effect.

        Raises:
            UserError: whatever is wrong with the model file, the equations or the units.
        """
        return declared_model(self.section, self.folder)

    @cached_property
    def tree(self) -> Tree | None:
        """The model file as numbers, before any effect; None for written equations."""
        if self.section.urdf is None:
            return None
        _ = self.declared  # refuses what is wrong with the file
        return load_tree(self.folder / self.section.urdf, self.section.gravity)

    @cached_property
    def effects(self) -> tuple[AppliedEffect, ...]:
        """The effects that the case adds, in the order in which it lists them.

        Raises:
            UserError: a name that no effect has, or numbers that are not its own.
        """
        check_listed(self.section.effects, "plant.effects")
        return tuple(AppliedEffect(e.name, e.on, e.parameters) for e in self.section.effects)

    def _with(self, effects: Sequence[AppliedEffect]) -> SymbolicModel:
        """The declared plant with these; a mistake is told with the key of the effect."""
        declared = self.declared  # a mistake in the file or the equations is none of an effect
        try:
            return apply_effects(declared, effects)
        except UserError as error:
            wrong = (k for k, e in enumerate(self.effects) if e.on not in effect(e.name).targets(declared))
            k = next(wrong, None)
            key = "plant.effects" if k is None else f"plant.effects.{k}.on"
            raise UserError(error.problem, key=error.key or key, remedy=error.remedy) from None

    @cached_property
    def corrected(self) -> SymbolicModel:
        """Continuous, with all effects and all their memory: further states and delays.

        Raises:
            UserError: an effect that does not fit the plant.
        """
        return self._with(self.effects)

    @cached_property
    def carried(self) -> SymbolicModel:
        """Continuous, over the case's own states: with the effects whose memory these carry.

        Raises:
            UserError: states that are not those of the plant with its lags.
        """
        states = tuple(self.section.states)
        kept = [e for e in self.effects if not effect(e.name).remembers or effect(e.name).memory_state(e.on) in states]
        model = self._with(kept)
        if model.state_names != states:
            raise UserError(
                f"the states are {list(states)}, the plant with its lagged inputs has {list(model.state_names)}",
                key="plant.states",
                remedy="A state with lag_of is called <input>_lagged, comes last, and its input has an effect that "
                "lags, such as input_lag.",
            )
        for name, state in self.section.states.items():
            if state.lag_of is not None:
                require_unit(state.unit, self.section.inputs[state.lag_of].unit, f"plant.states.{name}.unit")
        return model

    @cached_property
    def sampled(self) -> NominalModel:
        """The compiled map f over tau, of `carried`.

        Raises:
            UserError: a case without `domain`, or an integrator that does not fit the plant.
        """
        if self.tau is None:
            raise UserError("the nominal model needs a sampling time", key="domain.tau", remedy="Add `domain:`.")
        if not self.carried.derived:
            raise UserError(
                f"the equations of {len(self.carried.coordinates)} joints are not written out, which a bound or a "
                "controller needs", key="plant.urdf",
                remedy="Take at most two joints, fixing the others; `simgap diagnose` takes them all.",
            )  # fmt: skip
        return sampled_model(self.carried, self.tau, self.section.integrator)

    def drake_system(self) -> Any:
        """`corrected` as a Drake system that can be wired into a diagram, whatever the case declares it by.

        A `SymbolicVectorSystem` in continuous time: its input is the inputs of the case, its state their states (those
        of lags last), its output what the sensors read.

        Raises:
            UserError: a delay, or a function that Drake does not have.
        """
        return symbolic_plant(self.corrected)

    def check_with_drake(self, box: Box, inputs: Floats) -> None:
        """Compare the compiled map, and the model file as declared, with Drake's own numbers on X and U, (M, nu).

        Raises:
            BrokenPromise: naming the state in which they differ beyond rounding.
        """
        check_map(self.sampled, box, inputs)
        if self.section.urdf is not None:
            check_declared(self.declared, self.section, self.folder / self.section.urdf, box, inputs)

    def corrected_by(self, found: Sequence[AppliedEffect]) -> tuple[SymbolicModel, dict[str, float]]:
        """`corrected` with further effects but no further memory: -> model, input -> seconds by which it acts later.

        For slow commands delay and lag are alike.
        """
        late = {on: delay + lag for on, (delay, lag) in delays_and_lags(found).items()}
        return apply_effects(self.corrected, [e for e in found if not effect(e.name).remembers]), late


def load_plant(path: str | Path) -> PlantModel:
    """The nominal model of a case file.

    Raises:
        UserError: a case that does not check.
    """
    return PlantModel.of(load_case(Path(path)), Path(path).parent)
