"""A mission is one Python file: in agents/, or anywhere. What it may define, and how it is found."""

import hashlib
import importlib
import importlib.util
import pkgutil
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, cast

from crazychoir.config.checks import refuse_conflicts
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, Hung, error_text, without_exit
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission_hooks import MissionFile
from crazychoir.radio.budget import rates
from crazychoir.runtime.user_code_guard import HOOK, limited
from crazychoir.types import Point

PACKAGE = "crazychoir.agents"


class Mission(Protocol):
    """What a mission file defines: `guidance`; the rest may be left out."""

    def guidance(self, i: int, config: SwarmConfig) -> CFGuidance:
        """The guidance of drone i."""
        ...

    def swarm(self, drones: int | None) -> SwarmConfig:
        """The swarm when no swarm file is given, with so many drones if the mission can."""
        ...

    def scatter(self, config: SwarmConfig) -> SwarmConfig:
        """The mission's own swarm as it starts with the seed of this run."""
        ...

    def check(self, config: SwarmConfig, force: bool) -> list[str]:
        """Look before anybody flies: warnings; raises ConfigError or Refused."""
        ...

    def goal(self, config: SwarmConfig) -> dict[int, Point]:
        """Where the drones are to be at the end of the law, if the mission has such a place."""
        ...

    def report(
        self, config: SwarmConfig, results: dict[int, dict[str, Any]]
    ) -> dict[str, Any]:
        """What all drones' results say together; among it `success`, and `reasons` by drone if it failed."""
        ...

    def picture(
        self, config: SwarmConfig, results: dict[int, dict[str, Any]], path: str
    ) -> None:
        """Draw what was planned or flown."""
        ...


def load(name: str) -> Mission:
    """The mission of this name in agents/, or of this .py file, with its hooks guarded; raises ConfigError."""
    module = (
        from_file(Path(name), "mission")
        if name.endswith(".py")
        else _from_package(name)
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


def has(mission: Mission, what: str) -> bool:
    """Whether the mission file defines one of the optional functions."""
    return callable(getattr(mission, what, None))


def look_before(
    mission: Mission, config: SwarmConfig, force: bool = False
) -> list[str]:
    """The warnings of the mission's check; raises what it raises, and ConfigError for goals that are in conflict.

    And for dongles that do not carry what their drones would be sent.
    """
    rates(config)
    warnings = mission.check(config, force) if has(mission, "check") else []
    if has(mission, "goal"):
        goals = {
            i: (float(p[0]), float(p[1]), float(p[2]))
            for i, p in mission.goal(config).items()
        }
        refuse_conflicts(config, goals, "goals")
    return warnings


def mission_hash(config: SwarmConfig, mission: Mission) -> str:
    """What all hosts must have in common: the swarm file, and the text of the mission; then, after a colon, its parts.

    See strangers.difference.
    """
    text = Path(getattr(mission, "__file__", None) or "")
    code = text.read_bytes() if text.is_file() else b""
    whole = hashlib.blake2b(config.digest().encode() + code, digest_size=8).hexdigest()
    return (
        f"{whole}:{config.digests()}{hashlib.blake2b(code, digest_size=1).hexdigest()}"
    )


def names() -> list[str]:
    """Missions in agents/."""
    package = importlib.import_module(PACKAGE)
    return sorted(module.name for module in pkgutil.iter_modules(package.__path__))


def _from_package(name: str) -> ModuleType:
    if name not in names():
        do = "Or give the path of a .py file."
        raise ConfigError("mission", name, ", ".join(names()), do)
    return importlib.import_module(f"{PACKAGE}.{name}")


def from_file(path: Path, kind: str) -> ModuleType:
    """The module of a user's .py file; kind: what errors call it."""
    if not path.is_file():
        raise ConfigError(kind, str(path), "a Python file that exists")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ConfigError(kind, str(path), "a Python file")
    module = importlib.util.module_from_spec(spec)
    _see_neighbors(path)
    try:
        with limited(HOOK, f"the import of {path}"), without_exit(f"the {kind} file"):
            spec.loader.exec_module(module)
    except Exception as error:
        if isinstance(error.__cause__, SystemExit):
            raise
        lines = [
            at.lineno
            for at in traceback.extract_tb(error.__traceback__)
            if at.filename == spec.origin
        ]
        where = f"{kind} {path}{f':{lines[-1]}' if lines else ''}"
        hangs = isinstance(error, Hung)
        found = (
            f"no end within {HOOK:g} s of its import" if hangs else error_text(error)
        )
        raise ConfigError(
            where, found, "a file that Python can import", "Mend it."
        ) from error
    return module


def _see_neighbors(path: Path) -> None:
    """A mission file may import the files beside it, as a script may; installed modules of the same name come first.

    For good, because it may import when it flies.
    """
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)
