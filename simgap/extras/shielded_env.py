"""A Gymnasium environment whose actions pass a shield, for learning and for learned policies (extra `gymnasium`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numpy.typing import ArrayLike

from simgap.errors import optional
from simgap.shield import Shield

with optional("Gymnasium", "gymnasium", key=None):
    import gymnasium


class ShieldedEnv(gymnasium.Wrapper):
    """The environment with each action replaced by what the shield gives; it ends a run where the environment does.

    A step of the environment has to be a sampling time of the case, and its actions inputs in the units of the case.
    Where that has latency, the environment itself applies an action a sample late, and the input `first` before.
    `info` of a step has `shield_action`, what was applied, and `shield_acted`.

    Args:
        env: the environment. shield: of a controller of the same plant.
        state: observation -> measured state (nx,), in the order and units of the case; the observation itself if not
            given.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], shield: Shield, state: Callable[[Any], ArrayLike] = lambda seen: seen
    ) -> None:
        super().__init__(env)
        self.shield, self._state = shield, state

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin a run: observation and info, as the environment has them."""
        seen, info = self.env.reset(**options)
        self.shield.reset()
        self._x = self._state(seen)
        return seen, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Apply what the shield makes of an action (nu,).

        Raises:
            BrokenPromise: from a state outside the winning domain, or in a target.
        """
        before = self.shield.acted
        applied = self.shield(self._x, action)
        seen, reward, terminated, truncated, info = self.env.step(applied)
        self._x = self._state(seen)
        told = {"shield_action": applied, "shield_acted": self.shield.acted > before}
        return seen, reward, terminated, truncated, info | told
