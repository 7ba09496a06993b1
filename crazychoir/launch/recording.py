"""The file that a run is recorded into: made before anybody flies, so that what is wrong with it is said then."""

import contextlib
import platform
from collections.abc import Iterator
from pathlib import Path

import llvmlite.binding
import numba
import numpy as np
import scipy

from crazychoir.bus.hello import VERSION
from crazychoir.guidance.mission import Mission
from crazychoir.recording.figures import UNSEEN
from crazychoir.recording.file import RecordingFile
from crazychoir.swarm.config import SwarmConfig


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


def new_recording(path: Path, config: SwarmConfig, mission: Mission | None, virtual: bool) -> RecordingFile:
    """A new file for a flight of this swarm; raises ConfigError."""
    return RecordingFile(path, about(config, virtual), config.dumps(), not virtual, text_of(mission))


def text_of(mission: Mission | None) -> str:
    """The text of a mission's file; empty without one."""
    path = Path(getattr(mission, "__file__", None) or "")
    return path.read_text(errors="replace") if path.is_file() else ""


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
