"""The file that a run is recorded into: made before anybody flies, so that what is wrong with it is said then."""

import contextlib
import platform
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from crazychoir.bus.hello import VERSION
from crazychoir.recording.file import RecordingFile
from crazychoir.swarm.config import SwarmConfig


@contextlib.contextmanager
def recording_file(path: Path | None, config: SwarmConfig, virtual: bool) -> Iterator[RecordingFile | None]:
    """A new file for a flight of this swarm, closed afterwards; None without a path. Raises ConfigError."""
    if path is None:
        yield None
        return
    file = RecordingFile(path, about(config, virtual), config.dumps(), durable=not virtual)
    with contextlib.closing(file):
        yield file


def about(config: SwarmConfig, virtual: bool) -> dict[str, str]:
    """What is flown, and by what."""
    return {
        "version": VERSION,
        "swarm": config.name,
        "mission": config.mission or "",
        "seed": str(config.seed),
        "drones": ",".join(map(str, config.ids)),
        "time": "virtual" if virtual else "wall",
        "python": platform.python_version(),
        "numpy": np.__version__,
    }
