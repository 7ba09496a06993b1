"""The file that a run is recorded into: made before anybody flies, so that what is wrong with it is said then."""

import contextlib
import hashlib
import json
import platform
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import llvmlite.binding
import numba
import numpy as np
import scipy

from crazychoir.bus.network.hello import VERSION
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import is_library
from crazychoir.guidance.mission import PACKAGE, Mission
from crazychoir.recording.analysis.figures import UNSEEN
from crazychoir.recording.mcap.file import RecordingFile

FILES = "files"
"""What a recording's `about` calls the digests of files, as JSON."""


@contextlib.contextmanager
def recording_file(
    path: Path | None, config: SwarmConfig, mission: Mission, virtual: bool
) -> Iterator[RecordingFile | None]:
    """A new file for a flight of this swarm, closed afterwards; None without a path. Raises ConfigError."""
    if path is None:
        yield None
        return
    with contextlib.closing(new_recording(path, config, mission, virtual)) as file:
        yield file


def new_recording(
    path: Path, config: SwarmConfig, mission: Mission | None, virtual: bool
) -> RecordingFile:
    """A new file for a flight of this swarm; raises ConfigError."""
    told = about(config, virtual) | {FILES: json.dumps(digests(config, mission))}
    return RecordingFile(path, told, config.dumps(), not virtual, text_of(mission))


def text_of(mission: Mission | None) -> str:
    """The text of a mission's file; empty without one."""
    path = Path(getattr(mission, "__file__", None) or "")
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def digests(config: SwarmConfig, mission: Mission | None) -> dict[str, str]:
    """SHA-256 of what a flight depends on beside the mission's text, as far as it is there; no name has a path of here.

    The files that the swarm file names, by its keys; and by their paths within the mission's folder the modules that
    were imported from there.
    """
    found = {
        name: _digest(path) for name, path in (config.files | _modules(mission)).items()
    }
    return {name: digest for name, digest in found.items() if digest}


def other_files(
    told: Mapping[str, str], config: SwarmConfig, mission: Mission
) -> dict[str, str]:
    """Which of the files with these digests are others now, and how."""
    named = config.files
    folder = _folder(mission)
    now = {name: _digest(named.get(name, folder / name)) for name in told}
    return {
        name: "its content is another now" if now[name] else "it is not there any more"
        for name, digest in told.items()
        if now[name] != digest
    }


def _modules(mission: Mission | None) -> dict[str, Path]:
    """The files beside a mission's, or below, from which modules were imported; none of the package or of libraries."""
    if not (name := getattr(mission, "__file__", None)):
        return {}
    folder = _folder(mission)
    found = dict[str, Path]()
    for module, loaded in sorted(sys.modules.items()):
        file = str(getattr(loaded, "__file__", None) or "")
        path = Path(file).resolve()
        within = f"{module}."
        ours = within.startswith(
            ("crazychoir.", "__main__.")
        ) and not within.startswith(f"{PACKAGE}.")
        if (
            path != Path(name).resolve()
            and path.is_relative_to(folder)
            and not (ours or is_library(file))
        ):
            found[path.relative_to(folder).as_posix()] = path
    return found


def _folder(mission: Mission | None) -> Path:
    return Path(str(getattr(mission, "__file__", None) or "")).resolve().parent


def _digest(path: Path) -> str:
    """Empty for a file that cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def about(config: SwarmConfig, virtual: bool) -> dict[str, str]:
    """What is flown, and by what."""
    return {
        "swarm": config.name,
        "mission": config.mission or "",
        "seed": str(config.seed),
        "drones": ",".join(map(str, config.ids)),
        UNSEEN: ",".join(map(str, config.unseen)),
        "time": "virtual" if virtual else "wall",
        **versions(),
    }


def versions() -> dict[str, str]:
    """What a flight in virtual time depends on, beside the swarm file and the mission."""
    return {
        "version": VERSION,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": numba.__version__,
        "processor": f"{platform.machine()} {llvmlite.binding.get_host_cpu_name()}",
    }
