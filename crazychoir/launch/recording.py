"""The recording file of a run.

It is made before the flight, so that an error with the file is reported before take-off.
"""

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

from crazychoir.bus.network.hello import PACKAGE_VERSION
from crazychoir.config.file_paths import list_files
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import is_library
from crazychoir.guidance.mission import MISSION_PACKAGE, Mission
from crazychoir.recording.analysis.figures import UNSEEN_DRONES_KEY
from crazychoir.recording.mcap.file import RecordingFile
from crazychoir.recording.ros.views import FlightViews

FILES_KEY = "files"
"""Key of a recording's `describe_flight` for the digests of files, as JSON."""


@contextlib.contextmanager
def open_recording_file(
    path: Path | None, config: SwarmConfig, mission: Mission, virtual: bool
) -> Iterator[RecordingFile | None]:
    """Yield a new file for a flight of this swarm, and close it at the end; None without a path.

    Raises ConfigError if the file cannot be made.
    """
    if path is None:
        yield None
        return
    with contextlib.closing(make_recording(path, config, mission, virtual)) as file:
        yield file


def make_recording(
    path: Path, config: SwarmConfig, mission: Mission | None, virtual: bool
) -> RecordingFile:
    """Return a new file for a flight of this swarm.

    Raises ConfigError if it cannot be made.
    """
    told = describe_flight(config, virtual) | {
        FILES_KEY: json.dumps(compute_file_digests(config, mission))
    }
    return RecordingFile(
        path,
        told,
        config.dumps(),
        not virtual,
        read_mission_text(mission),
        FlightViews(config),
    )


def read_mission_text(mission: Mission | None) -> str:
    """Return the text of a mission's file; empty if there is none."""
    path = Path(getattr(mission, "__file__", None) or "")
    return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""


def compute_file_digests(
    config: SwarmConfig, mission: Mission | None
) -> dict[str, str]:
    """Return {name: SHA-256} of the files that a flight depends on, without the mission's file itself.

    A file that the swarm file names has its key as the name. A module that was imported from the
    mission's folder has its path in that folder. No name contains a path of this machine.
    Files that cannot be read are left out.
    """
    found = {
        name: _compute_digest(path)
        for name, path in (list_files(config) | _list_mission_modules(mission)).items()
    }
    return {name: digest for name, digest in found.items() if digest}


def list_changed_files(
    told: Mapping[str, str], config: SwarmConfig, mission: Mission
) -> dict[str, str]:
    """Return {name: kind of change} of the files that have changed since these digests.

    told: the result of `compute_file_digests`
    """
    named = list_files(config)
    folder = _find_mission_folder(mission)
    now = {name: _compute_digest(named.get(name, folder / name)) for name in told}
    return {
        name: "its content is another now" if now[name] else "it is not there any more"
        for name, digest in told.items()
        if now[name] != digest
    }


def _list_mission_modules(mission: Mission | None) -> dict[str, Path]:
    """Return the modules that were imported from the mission's folder or below, by their paths.

    Modules of this package and of libraries do not count.
    """
    if not (name := getattr(mission, "__file__", None)):
        return {}
    folder = _find_mission_folder(mission)
    found = dict[str, Path]()
    for module, loaded in sorted(sys.modules.items()):
        file = str(getattr(loaded, "__file__", None) or "")
        path = Path(file).resolve()
        within = f"{module}."
        ours = within.startswith(
            ("crazychoir.", "__main__.")
        ) and not within.startswith(f"{MISSION_PACKAGE}.")
        if (
            path != Path(name).resolve()
            and path.is_relative_to(folder)
            and not (ours or is_library(file))
        ):
            found[path.relative_to(folder).as_posix()] = path
    return found


def _find_mission_folder(mission: Mission | None) -> Path:
    return Path(str(getattr(mission, "__file__", None) or "")).resolve().parent


def _compute_digest(path: Path) -> str:
    """Return the SHA-256 of a file; empty if it cannot be read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return ""


def describe_flight(config: SwarmConfig, virtual: bool) -> dict[str, str]:
    """Return what is flown: swarm, mission, seed, drones, kind of time, versions."""
    return {
        "swarm": config.name,
        "mission": config.mission or "",
        "seed": str(config.seed),
        "drones": ",".join(map(str, config.ids)),
        UNSEEN_DRONES_KEY: ",".join(map(str, config.topology.unseen)),
        "time": "virtual" if virtual else "wall",
        **list_versions(),
    }


def list_versions() -> dict[str, str]:
    """Return what the result of a flight in virtual time depends on, beside its files.

    It is the versions of this package, Python and the numeric libraries, and the processor.
    """
    return {
        "version": PACKAGE_VERSION,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": numba.__version__,
        "processor": f"{platform.machine()} {llvmlite.binding.get_host_cpu_name()}",
    }
