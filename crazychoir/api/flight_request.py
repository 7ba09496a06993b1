"""What a user asks to fly: a mission with its swarm, and the values that replace those of the swarm."""

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec

from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import ConfigError
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import (
    Mission,
    has_hook,
    load_mission,
    resolve_example,
)
from crazychoir.guidance.mission_hooks import MissionFile

DEFAULT_DRONE_COUNT = 4
"""Number of drones for a mission that brings no swarm of its own."""
SWARM_FILE_SUFFIXES = (".toml", ".json")
ALLOWED_MISSIONS = (
    "the name of a mission, a mission file (.py), a swarm file (.toml), a class of guidance, a function "
    "guidance(i, config), or an object that has one"
)
"""What may be flown, for errors."""


@dataclass(frozen=True, slots=True)
class FlightRequest:
    """What a user asks to fly."""

    what: object
    """What flies, see ALLOWED_MISSIONS."""
    drones: int | None = None
    """Number of drones; None: as many as the mission has by itself."""
    swarm: str | SwarmConfig | None = None
    """Swarm file or swarm; None: the mission's own swarm."""
    loss: float | None = None
    """Share of messages that are lost; None: as the swarm says."""
    seed: int | None = None
    """Seed; None: that of the swarm."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Values of mission options by name, and of other keys of the swarm by "table.key"."""

    def __post_init__(self) -> None:
        """Let the name of an example stand for its swarm file."""
        if isinstance(self.what, str):
            object.__setattr__(self, "what", resolve_example(self.what))

    @property
    def has_swarm_file(self) -> bool:
        """Whether the drones are those of a swarm file or of a given swarm."""
        return self.swarm is not None or self._is_swarm_file

    @property
    def swarm_file(self) -> str | None:
        """Resolved path of the swarm file; None without a file."""
        file = self.what if self._is_swarm_file else self.swarm
        return str(Path(file).resolve()) if isinstance(file, str) else None

    @property
    def _is_swarm_file(self) -> bool:
        return isinstance(self.what, str) and self.what.endswith(SWARM_FILE_SUFFIXES)

    def choose(self) -> tuple[SwarmConfig, Mission]:
        """Return the swarm and the mission.

        Raises ConfigError for values that contradict each other, for a swarm file without a mission,
        and for a number of drones that the mission cannot fly. Its `where` is the name of the field.
        """
        self.require_one_source()
        if self._is_swarm_file:
            config = SwarmConfig.load(str(self.what))
            if config.mission is None:
                raise ConfigError(str(self.what), "no mission", 'mission = "name"')
            named = load_mission(config.mission, f"{self.what}: mission")
            return self._change(config, None), named
        name, mission = find_mission(self.what)
        if self.swarm is not None:
            given = self.swarm
            config = (
                given if isinstance(given, SwarmConfig) else SwarmConfig.load(given)
            )
            return self._change(config, name), mission
        own = (
            mission.swarm(self.drones)
            if has_hook(mission, "swarm")
            else default_swarm(self.drones or DEFAULT_DRONE_COUNT)
        )
        config = self._change(own, name)
        if self.drones not in (None, len(config.ids)):
            allowed = f"{len(config.ids)}: mission {name} needs this number of drones"
            raise ConfigError("drones", self.drones, allowed)
        scatter = getattr(mission, "scatter", None)
        return (scatter(config) if scatter else config), mission

    def require_one_source(self) -> None:
        """Raise ConfigError if two swarms are named, or a number of drones beside a swarm."""
        if self.swarm is not None and self._is_swarm_file:
            found = f"{self.swarm} beside {self.what}"
            raise ConfigError("swarm", found, "one swarm file")
        if self.has_swarm_file and self.drones:
            found = f"{self.drones} beside a swarm file"
            do = "Change the [[drones]] of the file."
            raise ConfigError("drones", found, "the drones of that file", do)

    def _change(self, config: SwarmConfig, mission: str | None) -> SwarmConfig:
        changed = replace_swarm_values(config, self.loss, self.seed, mission)
        return replace_options(changed, self.options)


def replace_swarm_values(
    config: SwarmConfig, loss: float | None, seed: int | None, mission: str | None
) -> SwarmConfig:
    """Return the swarm with each value replaced that is not None."""
    changes: dict[str, Any] = {}
    if loss is not None:
        config = config.with_network(loss=loss)
    if seed is not None:
        changes["seed"] = seed
    if mission is not None:
        changes["mission"] = mission
    return config.replace(**changes) if changes else config


def replace_options(config: SwarmConfig, options: Mapping[str, Any]) -> SwarmConfig:
    """Return the swarm with other values of mission options and of keys in its tables.

    options: {"gain": 2.0} is the mission option `gain`; {"network.delay": 0.01} is the key `delay` of
        the table [network]
    Raises ConfigError for a table or key that does not exist, and for a value that is not allowed.
    """
    if not options:
        return config
    changes: dict[str, Any] = {}
    for name, value in options.items():
        table, _, key = name.rpartition(".")
        table = table or "mission_options"
        if table not in changes:
            found = getattr(config, table, None)
            if not isinstance(found, msgspec.Struct | dict):
                allowed = 'a mission option, or "table.key" of the swarm file'
                raise ConfigError(
                    f"options: {name}", f"{table}, no such table", allowed
                )
            changes[table] = msgspec.to_builtins(found)
        changes[table][key] = value
    return config.replace(**changes)


def refuse_operator(found: str) -> ConfigError:
    """Return the error for virtual time with an operator.

    found: what asks for the operator
    """
    allowed = "virtual time, in which no operator can send commands"
    return ConfigError("fast", found, allowed, "Leave one of them out.")


def find_mission(what: object) -> tuple[str, Mission]:
    """Return the name of a mission for the swarm file, and the mission with its hooks guarded.

    what: see ALLOWED_MISSIONS
    Raises ConfigError if it is no mission.
    """
    if isinstance(what, str | Path):
        return str(what), load_mission(str(what))
    name = _name_mission(str(getattr(what, "__name__", type(what).__name__)))
    if isinstance(what, type) and issubclass(what, CFGuidance):
        return name, _make_mission(_build_constructor(what), what)
    guidance = getattr(what, "guidance", None)
    if callable(guidance):
        return name, cast(Mission, MissionFile(what))
    if inspect.isfunction(what):
        return name, _make_mission(what, what)
    raise ConfigError(
        "mission", f"{type(what).__name__} {what!r:.60}", ALLOWED_MISSIONS
    )


def _name_mission(name: str) -> str:
    """Return the name of a class, function or module in the form of a mission's name.

    "SameHeight" becomes "same_height".
    """
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name.rpartition(".")[2]).lower()
    return re.sub(r"^[^a-z]+|[^a-z0-9_]", "", words) or "mission"


def _build_constructor(
    kind: type[CFGuidance],
) -> Callable[[int, SwarmConfig], CFGuidance]:
    """Return the function that makes the guidance of each drone, without arguments."""

    def guidance(i: int, config: SwarmConfig) -> CFGuidance:
        return kind()

    return guidance


def _make_mission(guidance: Callable[..., Any], source: Any) -> Mission:
    """Return a mission of this function alone.

    source: the class or function of the user
    """
    try:
        file = inspect.getsourcefile(source) or ""
    except (TypeError, OSError):  # it was made without a file, as in a notebook
        file = ""
    return cast(Mission, MissionFile(SimpleNamespace(guidance=guidance, __file__=file)))
