"""The library of physical effects by family: plug-ins of the group `effects`, all in `EFFECTS`.

Several effects enter a model in the order of their ranks: plant, forces, sensors, and then the path of a command from
the plant backwards, so that a command is delayed, amplified, shifted, loses its dead zone, is cut and then lags.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache

from simgap import plugins
from simgap.config.plant import AddedEffect
from simgap.effects.base import AppliedEffect, CoordinateEffect, Effect, EffectParameter, MjcfPlace
from simgap.effects.commands import InputEffect, MemoryInputEffect, StaticInputEffect
from simgap.errors import UserError, placed
from simgap.model.symbolic import SymbolicModel

__all__ = [
    "EFFECTS",
    "AppliedEffect",
    "CoordinateEffect",
    "Effect",
    "EffectParameter",
    "InputEffect",
    "MemoryInputEffect",
    "StaticInputEffect",
    "apply_effects",
    "check_listed",
    "delays_and_lags",
    "effect",
    "joint_effect",
]


class _Registry(Mapping[str, Effect]):
    """The effects by name, each imported when it is asked for."""

    def __getitem__(self, name: str) -> Effect:
        if name not in plugins.names("effects"):
            raise KeyError(name)
        return _instance(name)

    def __iter__(self) -> Iterator[str]:
        return iter(plugins.names("effects"))

    def __len__(self) -> int:
        return len(plugins.names("effects"))


@lru_cache(maxsize=256)
def _instance(name: str) -> Effect:
    made = plugins.find("effects", name)()
    if not isinstance(made, Effect) or made.name != name:
        raise UserError(f"the plug-in '{name}' is not an effect of that name", remedy="Derive it from simgap's Effect.")
    return made


EFFECTS: Mapping[str, Effect] = _Registry()


def effect(name: str) -> Effect:
    """The effect of that name.

    Raises:
        UserError: an unknown name, with the known ones.
    """
    if name not in EFFECTS:
        raise UserError(f"there is no effect '{name}'", remedy=f"Known: {', '.join(EFFECTS)}.")
    return EFFECTS[name]


def joint_effect(attribute: str) -> Effect:
    """The effect that an attribute of a joint states in MJCF: damping, frictionloss, armature or stiffness."""
    return next(e for e in EFFECTS.values() if e.mjcf == MjcfPlace("joint", (attribute,)))


def check_listed(declared: Sequence[AddedEffect], key: str) -> None:
    """Refuse effects of a case that do not exist, or whose numbers are not theirs or not physical.

    Raises:
        UserError: with the full key, such as simulator.effects.0.parameters.F_c; `key` is that of the list.
    """
    for k, added in enumerate(declared):
        with placed(key=f"{key}.{k}.name"):
            kind = effect(added.name)
        try:
            kind.check_values(added.parameters)
        except UserError as error:
            raise UserError(error.problem, key=f"{key}.{k}.{error.key or 'parameters'}", remedy=error.remedy) from None


def delays_and_lags(effects: Iterable[AppliedEffect]) -> dict[str, tuple[float, float]]:
    """Delay and time constant of the lag, s, of every input on which an effect remembers commands.

    Raises:
        UserError: a value that is missing or unphysical.
    """
    found: dict[str, tuple[float, float]] = {}
    for e in effects:
        kind = effect(e.name)
        if isinstance(kind, MemoryInputEffect):
            kind.check_values(e.values)
            (delay, lag), own = kind.seconds(e.values), found.get(e.on, (0.0, 0.0))
            found[e.on] = own[0] + delay, own[1] + lag
    return found


def apply_effects(model: SymbolicModel, applied: Iterable[AppliedEffect]) -> SymbolicModel:
    """The model with several effects, inserted in the order of their ranks, then of the registry.

    Raises:
        UserError: unknown effect or target, missing or unphysical value.
    """
    place = {name: k for k, name in enumerate(EFFECTS)}
    for item in sorted(applied, key=lambda a: (effect(a.name).rank, place[a.name], a.on)):
        model = effect(item.name).apply(model, item.on, item.values)
    return model
