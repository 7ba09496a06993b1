"""The hooks of a mission file as the runtime calls them.

They are checked when the file is loaded and at every return. Errors name the user's file and line,
the hook, what was found and what is allowed. A failing hook that runs after the flight never loses
the result of the flight.
"""

import inspect
import logging
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from functools import partial
from typing import Any

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, CrazyChoirError, error_text
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import WATCHED_BY_RUNTIME, CFGuidance
from crazychoir.guidance.user_hook import (
    README_ADVICE,
    Hook,
    is_coroutine_function,
    locate_function,
    require_signature,
    shorten_value_text,
)
from crazychoir.team.graph import describe_ids

log = logging.getLogger(__name__)


class MissionFile:
    """A mission file: calls to its hooks are checked, and all other names come from its module.

    A module or object that was made without a file has "" as its `__file__`.
    """

    def __init__(self, module: Any) -> None:
        """Raise ConfigError for a hook that cannot be called with its arguments."""
        self._module = module
        self.__file__ = str(getattr(module, "__file__", None) or "")
        self._guarded: dict[str, Callable[..., Any]] = {}
        for name, (arguments, returns, guard) in MISSION_HOOKS.items():
            function = getattr(module, name, None)
            if function is not None:
                hook = Hook(self.__file__, name, function, arguments, returns)
                hook.check()
                self._guarded[name] = partial(guard, hook)

    def __getattr__(self, name: str) -> Any:
        return self._guarded.get(name) or getattr(self._module, name)


def require_complete(guidance: CFGuidance, where: str) -> None:
    """Raise ConfigError for a guidance without its own `step` or `mission`.

    Wrong arguments are an error, too.

    A law needs `step`. A CFGuidance needs `mission`.

    where: what errors call the place, such as the mission file.
    """
    kind = f"{where}: class {type(guidance).__name__}"
    _require_kinds(type(guidance))
    if isinstance(guidance, CFDistributedFeedback):
        _require_own(
            guidance, CFDistributedFeedback.step, "def step(self, me, heard)", kind
        )
        require_signature(guidance.step, ("me", "heard"), kind, "step")
    _require_own(guidance, CFGuidance.mission, "async def mission(self)", kind)


def _require_kinds(kind: type) -> None:
    """Raise ConfigError for a method of a user that is `async` and must not be, or must be and is not.

    It must be as the method of this package that it overrides. A coroutine function of the package may be overridden by
    a plain function that returns a coroutine, unless the runtime itself awaits it.
    """
    for n, owner in enumerate(kind.__mro__):
        for name, function in vars(owner).items():
            inherited = _find_inherited(kind.__mro__[n + 1 :], name)
            if not (inspect.isfunction(function) and inspect.isfunction(inherited)):
                continue
            is_async = is_coroutine_function(function)
            must_be_async = is_coroutine_function(inherited)
            if is_async and not must_be_async:
                raise _build_kind_error(owner, function, "async def", "def")
            if not is_async and must_be_async and name in WATCHED_BY_RUNTIME:
                raise _build_kind_error(owner, function, "def", "async def")


def _find_inherited(owners: Sequence[type], name: str) -> object:
    """Return the method of this package that `name` overrides; None if there is none."""
    for owner in owners:
        if owner.__module__.startswith("crazychoir.") and name in vars(owner):
            return vars(owner)[name]
    return None


def _build_kind_error(
    owner: type, function: Callable[..., Any], wrong: str, right: str
) -> ConfigError:
    name = function.__name__
    place, _, _ = locate_function(function).rpartition(" ")
    return ConfigError(
        f"{place}: class {owner.__name__}: {name}",
        f"{wrong} {name}",
        f"{right} {name}",
        f"Write `{right} {name}`, not `{wrong} {name}`.",
    )


def _require_own(
    guidance: CFGuidance, inherited: Callable[..., Any], wanted: str, kind: str
) -> None:
    name = inherited.__name__
    if getattr(getattr(guidance, name), "__func__", None) is not inherited:
        return
    near = get_close_matches(
        name,
        [
            own
            for own in vars(type(guidance))
            if not hasattr(CFDistributedFeedback, own)
        ],
        1,
    )
    do = f"Is {near[0]!r} meant to be {name!r}?" if near else README_ADVICE
    raise ConfigError(kind, f"no {name} of its own", wanted, do)


# What each hook may return ------------------------------------------------------------


def _guard_guidance(hook: Hook, i: int, config: SwarmConfig) -> CFGuidance:
    found = hook(i, config)
    if not isinstance(found, CFGuidance):
        raise hook.wrong(f"{shorten_value_text(found)} for drone {i}")
    require_complete(found, f"mission {hook.file}")
    return found


def _guard_swarm(hook: Hook, *values: Any) -> SwarmConfig:
    found = hook(*values)
    if not isinstance(found, SwarmConfig):
        raise hook.wrong(shorten_value_text(found))
    return found


def _guard_check(hook: Hook, config: SwarmConfig, force: bool = False) -> list[str]:
    found = hook(config, force)
    if found is not None and not (
        isinstance(found, list | tuple) and all(isinstance(text, str) for text in found)
    ):
        raise hook.wrong(shorten_value_text(found))
    return list(found or [])


def _guard_goal(hook: Hook, config: SwarmConfig) -> dict[int, Any]:
    found = hook(config)
    if not isinstance(found, Mapping) or any(i not in config.ids for i in found):
        raise hook.wrong(
            f"{shorten_value_text(found)}, with drones {describe_ids(config.ids)} in the swarm"
        )
    for i, place in found.items():
        if np.shape(place) != (3,) or not np.all(np.isfinite(place)):
            raise hook.wrong(f"{shorten_value_text(place)} for drone {i}")
    return dict(found)


def _guard_report(
    hook: Hook, config: SwarmConfig, results: dict[int, dict[str, Any]]
) -> dict[str, Any]:
    """Return the report of the hook. If the hook fails, return a report with that error."""
    try:
        found = hook(config, results)
        if found is not None and not isinstance(found, Mapping):
            raise hook.wrong(shorten_value_text(found))
        figures = dict(found or {})
        if not isinstance(figures.get("reasons", {}), Mapping):
            raise hook.wrong(f"reasons = {shorten_value_text(figures['reasons'])}")
    except CrazyChoirError as error:
        log.error("%s", error)
        return {"success": False, "reasons": {min(config.ids): str(error)}}
    return figures


def _guard_picture(
    hook: Hook, config: SwarmConfig, results: dict[int, dict[str, Any]], path: str
) -> None:
    """Draw the picture, or log why there is none."""
    try:
        hook(config, results, path)
    except CrazyChoirError as error:
        log.error("no picture: %s", error)


def _guard_compile(hook: Hook, config: SwarmConfig) -> None:
    """Let the mission compile its laws, however long that takes."""
    try:
        hook.function(config)
    except CrazyChoirError:
        raise
    except Exception as error:
        raise hook.wrong(error_text(error)) from error


MISSION_HOOKS: dict[str, tuple[tuple[str, ...], str, Callable[..., Any]]] = {
    "guidance": (
        ("i", "config"),
        "a CFGuidance or a CFDistributedFeedback, one for each drone",
        _guard_guidance,
    ),
    "swarm": (("drones",), "a SwarmConfig", _guard_swarm),
    "scatter": (("config",), "a SwarmConfig", _guard_swarm),
    "check": (("config", "force"), "a list of warnings, each a text", _guard_check),
    "goal": (
        ("config",),
        "{i: (3,) m}, a place for each drone that is to be somewhere",
        _guard_goal,
    ),
    "report": (
        ("config", "results"),
        'a dictionary of figures, with "success" and "reasons" {i: text}',
        _guard_report,
    ),
    "picture": (
        ("config", "results", "path"),
        "nothing: a PNG written to path",
        _guard_picture,
    ),
    "compile": (("config",), "nothing", _guard_compile),
}
"""Arguments, allowed result in words, and guard of each hook."""
