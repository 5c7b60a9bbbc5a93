"""Policies made elsewhere: Python callables and Stable-Baselines3 files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hrl_comfort.config import ConfigError
from hrl_comfort.config.checks import takes

SB3 = "sb3:"
"""Prefix of a file that Stable-Baselines3 saved."""
SB3_KEYS = ("policy_class", "policy_kwargs", "observation_space", "action_space", "use_sde")
"""Entries of such a file that a policy is made of; the others are not unpickled."""
UNREADABLE = (
    AttributeError, BadZipFile, EOFError, ImportError, LookupError, OSError, RuntimeError, TypeError, UnpicklingError,
    ValueError,
)  # fmt: skip
"""Errors of damaged files and of classes that are not installed."""

Function = Callable[[NDArray[np.float32]], ArrayLike]
"""Observations (N, D) -> actions (N, A) in [-1, 1]; larger ones are clipped."""


@dataclass(frozen=True)
class ObservationPolicy:
    """A map from observations to actions, from any source."""

    source: str
    """Value of `policy=`, or the name of a function."""
    function: Function
    observation_dim: int | None = None
    """D; None if the function does not say."""
    action_dim: int | None = None
    """A; None if the function does not say."""

    def __call__(self, observation: ArrayLike) -> NDArray[np.float64]:
        """Return actions (N, A) for observations (N, D), or one action (A,) for one observation (D,).

        Raises:
          ConfigError: the width of the observations is another one, or the actions are not N finite rows of A.
        """
        given = np.asarray(observation, dtype=np.float32)
        batch = given.reshape(-1, given.shape[-1])
        if self.observation_dim not in (None, batch.shape[1]):
            trained = Path(self.source).exists()
            remedy = f"; hrl_comfort.load(run={self.source!r}) is the environment that gives them" if trained else ""
            raise ConfigError(
                f"policy={self.source!r} takes observations of {self.observation_dim} numbers, not {batch.shape[1]}"
                f"{remedy}"
            )
        returned = self.function(batch)
        try:
            action = np.asarray(returned, dtype=np.float64)
        except (TypeError, ValueError):
            raise ConfigError(f"policy={self.source!r} returned {type(returned).__name__} without a shape") from None
        width = action.shape[-1:] if self.action_dim is None else (self.action_dim,)
        if action.shape != (len(batch), *width):
            wanted = f"({len(batch)}, {self.action_dim or 'A'})"
            raise ConfigError(f"policy={self.source!r} returned shape {action.shape}; actions have shape {wanted}")
        if not np.isfinite(action).all():
            raise ConfigError(f"policy={self.source!r} returned actions that are not finite")
        return action.reshape(*given.shape[:-1], -1)


def from_function(source: str, function: Any) -> ObservationPolicy:
    """Return the policy of a callable; of a class, that of its instance made without arguments.

    Raises:
      ConfigError: it cannot be called.
    """
    try:
        function = function() if isinstance(function, type) else function
    except TypeError as error:
        raise ConfigError(f"policy={source!r} is a class that cannot be made without arguments: {error}") from error
    if not callable(function):
        raise ConfigError(f"policy={source!r} is of type {type(function).__name__}; it must be callable")
    takes(f"policy={source!r}", function, "observation")
    return ObservationPolicy(source, function)


def from_sb3(source: str) -> ObservationPolicy:
    """Return the deterministic policy of `sb3:FILE.zip`, saved by any algorithm with a policy on vectors.

    The file holds pickles, which run code: load only files that you trust.

    Raises:
      ConfigError: Stable-Baselines3 is not installed, the file is missing or damaged, or it holds another kind of
        policy.
    """
    file = Path(source.removeprefix(SB3))
    if not file.is_file():
        raise ConfigError(f"policy={source!r}: {str(file)!r} is not there")
    try:
        from stable_baselines3.common.save_util import load_from_zip_file
    except ModuleNotFoundError as error:
        raise ConfigError(f"policy={source!r} needs Stable-Baselines3: pip install 'hrl-comfort[sb3]'") from error
    try:
        with ZipFile(file) as archive:
            names = json.loads(archive.read("data"))
        skipped = {name: None for name in names if name not in SB3_KEYS}
        data, parameters, _ = load_from_zip_file(file, device="cpu", custom_objects=skipped)
        assert data is not None  # for it was read above
        seen, acted = data["observation_space"].shape, data["action_space"].shape
        settings = {**data["policy_kwargs"], **({"use_sde": True} if data.get("use_sde") else {})}
        policy = data["policy_class"](data["observation_space"], data["action_space"], lambda _: 0.0, **settings)
        policy.load_state_dict(parameters["policy"])
    except UNREADABLE as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"policy={source!r} is not a readable file of Stable-Baselines3: {reason}") from error
    if seen is None or len(seen) != 1 or len(acted) != 1:
        raise ConfigError(
            f"policy={source!r} maps {data['observation_space']} to {data['action_space']}; "
            "both must be boxes of one dimension"
        )
    return ObservationPolicy(source, lambda each: policy.predict(each, deterministic=True)[0], seen[0], acted[0])
