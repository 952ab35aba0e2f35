"""A plant around a posture: what rests there, the linear model, natural sizes, and why nothing may be proposed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Bools, Floats
from simgap.errors import UserError
from simgap.late import scipy
from simgap.late import sympy as sp
from simgap.model.symbolic import SymbolicModel

STILL = 1e-6
"""Rate of change that is rest, against the natural size of the state a second."""
PACE = 2.0
"""Rate of a plant whose linear model has none, nothing but masses, 1/s: any pace is as good as another."""
GRAVITY = 9.81
NEAR = 0.02
"""Of its value, and for a position of its natural size, by which a state that is named moves to where the plant rests:
values have two or three digits, and a pole's centre of mass is not quite on its axis."""
_NEWTON = 30
REACH = 0.25
"""Half-width of X for the largest position on which the motion depends: of 1 rad, of the length of a pendulum of the
plant's rate, and of its unit at most. Judgement: the sine of .25 differs from it by a hundredth."""


@dataclass(frozen=True, eq=False)
class Posture:
    """Around x0 and u0 with F(x0, u0) = 0: dx/dt = a (x - x0) + b (u - u0).

    Attributes:
        x, u: (n,), (m,). a, b: (n, n), (n, m).
        rate: the fastest of the linear model, 1/s.
        scale: (n,) natural sizes: 1 rad, the length of a pendulum of that rate, and both times the rate for velocities.
        strength: (m,) the inputs that move a state of size `scale` within 1 / rate.
        free: states on which the motion does not depend.
    """

    x: Floats
    u: Floats
    a: Floats
    b: Floats
    rate: float
    scale: Floats
    strength: Floats
    free: tuple[str, ...]


def posture_of(model: SymbolicModel, at: Mapping[str, float]) -> Posture:
    """The posture at which the states have the values `at`, with the inputs that hold it.

    Where no inputs do, states move to where the plant rests: those that `at` does not name, which begin at 0, and by
    NEAR those that it names, positions last.

    Raises:
        UserError: a name that is no state, or a posture that no input holds.
    """
    names = model.state_names
    unknown = sorted(set(at) - set(names))
    if unknown:
        raise UserError(f"{unknown} are not states", key="--at", remedy=f"States: {', '.join(names)}.")
    linear = _linearised(model)
    asked = np.array([float(at.get(n, 0.0)) for n in names])
    unnamed = np.array([n not in at for n in names])
    positions = np.isin(names, [c.position for c in model.coordinates])
    refusal, elsewhere = None, "Name one that rests, such as --at q2=3.14159."
    loose, every = unnamed | ~positions, np.ones(len(names), dtype=bool)
    for moved, away in ((~every, 0.0), (loose, 0.0), (loose, 1.0), (loose, -1.0), (every, 0.0)):
        try:
            found = _resting(model, linear, asked + away * unnamed, moved)
        except UserError as error:
            refusal = refusal or error
            continue
        room = np.where(unnamed, math.inf, NEAR * np.maximum(np.abs(asked), positions * found.scale))
        if np.all(~moved | (np.abs(found.x - asked) <= room)):
            return found
        elsewhere = f"It rests at {', '.join(f'{n}={v:.6g}' for n, v in zip(names, found.x, strict=True) if n in at)}."
    assert refusal is not None
    raise UserError(refusal.problem, key=refusal.key, remedy=refusal.remedy or elsewhere)


Linear = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]


def _linearised(model: SymbolicModel) -> Linear:
    """(x, u) -> slopes of dx/dt in states (n, n) and in inputs (n, m), and dx/dt itself, (n,).

    It raises a UserError where one of them is no finite number.
    """
    xdot, n = sp.Matrix(model.numeric()), len(model.states)
    symbols, jump = [v.symbol for v in (*model.states, *model.inputs)], sp.Wild("jump")
    slopes = xdot.jacobian(symbols).replace(sp.DiracDelta(jump), sp.S.Zero)  # dry friction, which no linear model has
    whole = sp.lambdify(symbols, sp.Matrix.hstack(slopes, xdot), modules="numpy", cse=True)

    def linear(x: Floats, u: Floats) -> tuple[Floats, Floats, Floats]:
        with np.errstate(all="ignore"):
            found = np.array(whole(*x, *u), dtype=np.float64)
        if not np.isfinite(found).all():
            raise UserError("the model is not finite at this posture", key="--at", remedy="Name another one.")
        return found[:, :n], found[:, n:-1], found[:, -1]

    return linear


def _resting(model: SymbolicModel, linear: Linear, start: Floats, moved: Bools) -> Posture:
    """The posture at `start`, (n,), or where the plant rests near it if those states are `moved`.

    Raises:
        UserError: it does not rest there, or the model is not finite.
    """
    names = model.state_names
    x, u = _rest(linear, start, len(model.inputs), moved)
    a, b, left = linear(x, u)
    rates = np.abs(np.linalg.eigvals(a))
    rate = float(rates.max()) if rates.max() > STILL else PACE
    scale = _scale(model, rate)
    worst = int(np.argmax(np.abs(left) / scale))
    if abs(left[worst]) > 1e-3 * rate * scale[worst]:
        raise UserError(
            f"no input holds the posture {', '.join(f'{n}={v:g}' for n, v in zip(names, x, strict=True))}: "
            f"{names[worst]} changes by {left[worst]:.3g} {model.states[worst].unit}/s", key="--at",
        )  # fmt: skip
    read = set().union(*(sp.sympify(e).free_symbols for e in model.numeric()))
    free = tuple(v.name for v in model.states if v.symbol not in read)
    size = np.abs(b / scale[:, None]).max(axis=0)
    return Posture(x, u, a, b, rate, scale, rate / np.where(size > 0, size, 1.0), free)


def _rest(linear: Linear, x: Floats, inputs: int, moved: Bools) -> tuple[Floats, Floats]:
    """Newton's steps from x and no input towards rates of 0, the shortest ones in inputs and the states `moved`.

    An input that moves nothing to first order where it is 0, as one that acts by its square, begins at 1.

    Raises:
        UserError: they lead to where the model is no finite number.
    """
    u = np.where(linear(x, np.zeros(inputs))[1].any(axis=0), 0.0, 1.0)
    for _ in range(_NEWTON):
        a, b, rates = linear(x, u)
        step = -np.linalg.lstsq(np.hstack([a * moved, b]), rates, rcond=None)[0]
        x, u = x + step[: len(x)], u + step[len(x) :]
    return x, np.where(np.abs(u) < STILL, 0.0, u)


def _scale(model: SymbolicModel, rate: float) -> Floats:
    units = {v.name: v.unit for v in model.states}
    length = GRAVITY / rate**2
    scale = {n: length if unit in ("m", "m/s") else 1.0 for n, unit in units.items()}
    for c in model.coordinates:
        scale[c.velocity] = scale[c.position] * rate
    return np.array([scale[n] for n in model.state_names])


TURNS = (0.45, 0.6, 0.8)
"""Sampling times looked at: shares of 1 / the fastest rate of the linear model. Judgement: at most an eighth turn, and
not so short that X takes speeds at which it is crossed in a few steps."""
ENOUGH = 2.0
"""Times the fewest cells of all sampling times: the shortest sampling time within that is taken. Judgement."""
EVALUATIONS = 120
"""Of the search over r and K, for each of their unknowns."""
EVEN = 0.01
"""Weight of boxes that are alike along all axes: parts of a plant that do not touch each other may have any sizes."""
_LARGEST, _ROUNDS, _SETTLED = 0.999, 400, 1e-4
_FAILED = 1e3


@dataclass(frozen=True, eq=False)
class Proportions:
    """Proportions of a case for one sampling time.

    Attributes:
        tau: s. cells: (n,) along each axis. box: (n,) half-widths, up to one factor for all of them.
        gain: (m, n) of the feedback.
    """

    tau: float
    cells: Floats
    box: Floats
    gain: Floats

    @property
    def size(self) -> float:
        """Cells in all."""
        return float(np.prod(self.cells))


def proportions(a: Floats, b: Floats, rate: float, taus: Sequence[float] | None = None) -> Proportions | None:
    """The proportions that need few cells at a short sampling time.

    Args:
        a, b: dx/dt = a x + b u, (n, n) and (n, m), in units in which states and inputs are of like size.
        rate: what `TURNS` are shares of, 1/s.
        taus: sampling times to look at, s; those of `TURNS` if not given.

    Returns:
        None where no feedback holds the plant.
    """
    tried = [_at(a, b, tau) for tau in (taus or [share / rate for share in TURNS])]
    found = [p for p in tried if p is not None]
    if not found:
        return None
    fewest = min(p.size for p in found)
    return min((p for p in found if p.size <= ENOUGH * fewest), key=lambda p: p.tau)


def _at(a: Floats, b: Floats, tau: float) -> Proportions | None:
    n, m = b.shape
    both = scipy.linalg.expm(np.block([[a, b], [np.zeros((m, n + m))]]) * tau)
    ad, bd = both[:n, :n], both[:n, n:]

    def of(unknown: Floats) -> tuple[Floats, Floats, Floats] | None:
        weights, r = np.exp(np.clip(unknown[:n], -12, 12)), np.exp(np.clip(unknown[n:], -12, 12))
        try:
            cost = scipy.linalg.solve_discrete_are(ad, bd, np.diag(weights), np.eye(m))
        except (np.linalg.LinAlgError, ValueError):
            return None
        gain = np.linalg.solve(np.eye(m) + bd.T @ cost @ bd, bd.T @ cost @ ad)
        spread = _spread(ad, ad - bd @ gain)
        return None if spread is None else (spread @ r / r, spread @ r, gain)

    def size(unknown: Floats) -> float:
        found = of(unknown)
        return _FAILED if found is None else float(np.log(found[0]).sum() + EVEN * np.var(np.log(found[1])))

    start = np.zeros(2 * n)
    options = {"maxfev": EVALUATIONS * 2 * n, "adaptive": True}
    for _ in range(2):  # begun again where it stopped: Nelder and Mead's simplex may have collapsed
        start = scipy.optimize.minimize(size, start, method="Nelder-Mead", options=options).x
    found = of(start)
    return None if found is None else Proportions(tau, *found)


def _spread(ad: Floats, closed: Floats) -> Floats | None:
    """M of this module's head; None where the closed loop does not settle."""
    if np.abs(np.linalg.eigvals(closed)).max() > _LARGEST:
        return None
    power, total, step = np.eye(len(ad)), np.zeros_like(ad), np.abs(ad)
    for _ in range(_ROUNDS):
        total += np.abs(power) @ step
        power = closed @ power
        if np.abs(power).max() < _SETTLED:
            return total
    return None


NOTHING = 1e-3
"""Share of what is natural, or of the X that is sought, that is next to nothing: slips of units are of factors of a
thousand and more. Judgement."""
_MOVED, _STABLE, _PART = 1e-9, -1e-9, 0.1


def check_moved(model: SymbolicModel, posture: Posture) -> None:
    """Refuse inputs that move nothing at the posture, and a plant that changes by nothing.

    Raises:
        UserError: with the input, or the size of the rates.
    """
    idle = [n for n, own in zip(model.input_names, posture.b.T, strict=True) if not own.any()]
    if idle:
        words = f"{' and '.join(idle)} {'moves' if len(idle) == 1 else 'move'} nothing"
        raise UserError(
            f"{words} at this posture: no rate of change there depends on it", key=f"plant.inputs.{idle[0]}",
            remedy="Look at the equations' terms in it, leave it out, or name another posture (--at).",
        )  # fmt: skip
    largest = float(np.abs(posture.a * posture.scale / posture.scale[:, None]).max(initial=0.0))
    if 0.0 < largest < NOTHING * posture.rate:
        raise UserError(
            f"without input the plant hardly moves: within a second no state moves another by more than "
            f"{largest:.2g} of its natural size", key="plant",
            remedy="Look at the units of its equations and parameters: rates are a second, angles in rad.",
        )  # fmt: skip


def unmoved(model: SymbolicModel, posture: Posture) -> str:
    """Why no feedback was found, as a clause: what grows and is moved by no input, by the linear model's eigenvectors.

    (Hautus 1969: an unstable eigenvalue whose left eigenvector the inputs do not see.)
    """
    b = posture.b * posture.strength / posture.scale[:, None]
    values, vectors = np.linalg.eig((posture.a * posture.scale / posture.scale[:, None]).T)
    for value, w in zip(values, vectors.T, strict=True):
        if value.real > _STABLE * posture.rate and np.abs(w @ b).max(initial=0.0) < _MOVED * posture.rate:
            share = np.abs(w) / np.abs(w).max()
            names = [n for n, own in zip(model.state_names, share, strict=True) if own > _PART]
            does = "does" if len(names) == 1 else "do together"
            return f"what {' and '.join(names)} {does} is moved by no input"
    return "by its linear model one exists, but none was found at the sampling times that were tried"


def check_room(at: Mapping[str, float], sought: Floats, room: Mapping[str, tuple[float, float]]) -> None:
    """Refuse states of a posture that are outside their room, or whose room is next to nothing of the half-widths (n,)
    of the X that is sought.

    Raises:
        UserError: with the room's ends.
    """
    for (n, x), aim in zip(at.items(), sought, strict=True):
        lo, hi = room.get(n, (-math.inf, math.inf))
        if not lo < x < hi:
            raise UserError(
                f"the posture is outside the room of {n}, [{lo:g}, {hi:g}]", key="--at", remedy="Name a posture inside."
            )
        if hi - lo < 2.0 * NOTHING * aim:
            raise UserError(
                f"{n} has no room: its limits are {lo:g} and {hi:g}, where +-{aim:.2g} is sought", key=f"domain.X.{n}",
                remedy="Look at the joint's <limit> in the URDF and its unit.",
            )  # fmt: skip


def beyond_rest(model: SymbolicModel, posture: Posture, limits: Mapping[str, float]) -> Floats:
    """The largest inputs beyond those that hold the posture, (m,); `limits` as `propose` has them.

    Raises:
        UserError: an input that does not hold it.
    """
    for n, u in zip(model.input_names, np.abs(posture.u), strict=True):
        if u >= limits.get(n, math.inf):
            raise UserError(
                f"holding the posture takes {u:.3g} of {n}, its limit is {limits[n]:g}", key="--at",
                remedy="Name a posture that takes less, or a stronger drive.",
            )  # fmt: skip
    return np.array([limits.get(n, math.inf) for n in model.input_names]) - np.abs(posture.u)


def check_strength(names: Sequence[str], most: Floats, wanted: Floats) -> None:
    """Refuse inputs of which all can be next to nothing of what would keep the X that is sought, both (m,).

    Raises:
        UserError: with both.
    """
    share = float((most / np.where(wanted > 0, wanted, math.inf)).max(initial=0.0)) if len(most) else 1.0
    if share >= NOTHING:
        return
    given = ", ".join(f"{n} +-{v:.2g}" for n, v in zip(names, most, strict=True))
    needed = ", ".join(f"{n} +-{v:.2g}" for n, v in zip(names, wanted, strict=True))
    raise UserError(
        f"the inputs hardly move anything: {given} is allowed where {needed} would be sought", key="domain.U",
        remedy="Allow larger ones (domain.U, or <limit effort> in the URDF), or look at the units of the equations' "
        "terms in them.",
    )  # fmt: skip
