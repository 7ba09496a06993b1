"""What all agents of a run need alike: the swarm file, and a mission of agents/.

The fork server reads them once for all.
"""

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import load_mission
from crazychoir.numerics.compiling import KERNEL_QUEUE


class PreloadedSwarms:
    """The swarm files that this process, or the fork server that made it, has read before."""

    def __init__(self) -> None:
        self._kept: dict[str, SwarmConfig] = {}

    def preload(self, path: str) -> bool:
        """Read a swarm file, and import its mission; return False if that was done before.

        A mission in a file of the user is not imported, because it may start threads. Laws of the
        mission that are not kept on disk stay uncompiled.
        Raises the errors of the swarm file and of the mission.
        """
        if path in self._kept:
            return False
        with KERNEL_QUEUE.checks_first():
            config = SwarmConfig.load(path)
            if config.mission is not None and not config.mission.endswith(".py"):
                load_mission(config.mission)
        KERNEL_QUEUE.load_kept()
        config.graph()
        self._kept[path] = config
        return True

    def find(self, path: str | None) -> SwarmConfig | None:
        """Return the swarm of a file that was read before; None if it was not."""
        return None if path is None else self._kept.get(path)


PRELOADED_SWARMS = PreloadedSwarms()
"""The swarm files of this process."""
