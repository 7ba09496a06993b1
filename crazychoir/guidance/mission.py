"""A mission is one Python file, in agents/ or anywhere: what it may define, and how it is found."""

import hashlib
import importlib
import importlib.util
import pkgutil
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, cast

from crazychoir.config.checks import refuse_conflicts
from crazychoir.config.digest import compute_digest, compute_key_digests
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.files.examples import find_example, list_examples, suggest_name
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission_hooks import MissionFile
from crazychoir.radio.budget import compute_setpoint_rates
from crazychoir.runtime.user_module import import_from_file
from crazychoir.types import Point

MISSION_PACKAGE = "crazychoir.agents"
"""The package with the missions that come with crazychoir."""


class Mission(Protocol):
    """The functions of a mission file. `guidance` is required; all others are optional."""

    def guidance(self, i: int, config: SwarmConfig) -> CFGuidance:
        """Return the guidance of drone i."""
        ...

    def swarm(self, drones: int | None) -> SwarmConfig:
        """Return the swarm for a run without a swarm file.

        drones: number of drones, if the mission can choose it. None: the mission's own number.
        """
        ...

    def scatter(self, config: SwarmConfig) -> SwarmConfig:
        """Return the mission's own swarm with the starting places for the seed of this run."""
        ...

    def check(self, config: SwarmConfig, force: bool) -> list[str]:
        """Check the swarm before any drone flies, and return warnings.

        force: fly in spite of doubts.
        Raises ConfigError or Refused.
        """
        ...

    def goal(self, config: SwarmConfig) -> dict[int, Point]:
        """Return {i: (3,) m}, the places of the drones at the end of the law.

        Optional: only if there are such places.
        """
        ...

    def report(
        self, config: SwarmConfig, results: dict[int, dict[str, Any]]
    ) -> dict[str, Any]:
        """Combine the results of all drones into one report.

        It has `success`, and if that is false `reasons` by drone.
        """
        ...

    def picture(
        self, config: SwarmConfig, results: dict[int, dict[str, Any]], path: str
    ) -> None:
        """Draw the plan or the flight into the file `path`."""
        ...

    def compile(self, config: SwarmConfig) -> None:
        """Compile laws of the mission's own that are compiled at their first use.

        Optional. `crazychoir run` calls it in the first run on a machine, beside the processes that compile the rest.
        """
        ...


def load_mission(name: str, where: str = "mission") -> Mission:
    """Return a mission with its hooks guarded.

    name: name of a mission in agents/, or path of a .py file.
    where: what names the mission, for errors, such as "lab.toml: mission"
    Raises ConfigError if there is no such mission.
    """
    module = (
        import_from_file(Path(name), "mission", where)
        if name.endswith(".py")
        else _import_from_package(name, where)
    )
    if not callable(getattr(module, "guidance", None)):
        do = "See agents/bearing_formation.py."
        raise ConfigError(
            f"mission {name}",
            "no function guidance(i, config)",
            "a mission file defines it",
            do,
        )
    return cast(Mission, MissionFile(module))


def has_hook(mission: Mission, what: str) -> bool:
    """Return whether the mission file defines this optional function."""
    return callable(getattr(mission, what, None))


def check_before_flight(
    mission: Mission, config: SwarmConfig, force: bool = False
) -> list[str]:
    """Check a mission before any drone flies, and return its warnings.

    Raises all errors of the mission's check. Raises ConfigError for goals that are in conflict, and
    for radio dongles that cannot carry the traffic of their drones.
    """
    compute_setpoint_rates(config)
    warnings = mission.check(config, force) if has_hook(mission, "check") else []
    if has_hook(mission, "goal"):
        goals = {
            i: (float(p[0]), float(p[1]), float(p[2]))
            for i, p in mission.goal(config).items()
        }
        refuse_conflicts(config, goals, "goals")
    return warnings


def compute_mission_hash(config: SwarmConfig, mission: Mission) -> str:
    """Return a hash of all that hosts must have in common: swarm file and mission text.

    After a colon follow the hashes of the parts, see strangers.difference.
    """
    text = Path(getattr(mission, "__file__", None) or "")
    code = text.read_bytes() if text.is_file() else b""
    whole = hashlib.blake2b(
        compute_digest(config).encode() + code, digest_size=8
    ).hexdigest()
    return f"{whole}:{compute_key_digests(config)}{hashlib.blake2b(code, digest_size=1).hexdigest()}"


def list_mission_names() -> list[str]:
    """Return the names of the missions in agents/."""
    package = importlib.import_module(MISSION_PACKAGE)
    return sorted(module.name for module in pkgutil.iter_modules(package.__path__))


def resolve_example(what: str) -> str:
    """Return the swarm file of the example that `what` names; else `what`, unchanged.

    A mission of the same name comes first.
    """
    example = None if what in list_mission_names() else find_example(what)
    return what if example is None else str(example)


def _import_from_package(name: str, where: str) -> ModuleType:
    if name not in list_mission_names():
        names = list_mission_names()
        files = [
            file for file in (f"{name}.toml", f"{name}.py") if Path(file).is_file()
        ]
        near = suggest_name(name, files or [*names, *list_examples()])
        do = f"{near} Or give the path of a .py file.".strip()
        raise ConfigError(where, name, ", ".join(names), do)
    return importlib.import_module(f"{MISSION_PACKAGE}.{name}")
