"""The room in which robots visit places: where tasks may be, and which robots may serve them.

Each robot flies at its own height.
"""

from collections.abc import Collection

import numpy as np

from crazychoir.config.drone_room import shared_room
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.tasks.task_book import Place, Task
from crazychoir.team.graph import describe_ids


class TaskRoom:
    """Where tasks of operators may be, and which robots may serve them."""

    def __init__(self, config: SwarmConfig) -> None:
        self.ids = config.ids
        low, high = shared_room(config)
        self.low = np.array(low[:2])
        self.high = np.array(high[:2])

    def lies_badly(self, task: Task, pickup: Place) -> str:
        """Return why no robot can stand at the pickup. Empty if one can."""
        if np.all(self.low <= pickup) and np.all(pickup <= self.high):
            return ""
        room = f"{self.low.round(3).tolist()} to {self.high.round(3).tolist()} m"
        return (
            f"it is at {list(pickup)}, outside the fence, or at its edge: "
            f"drones are sent to {room}"
        )

    def never(self, task: Task) -> str:
        """Return why no robot of this swarm can serve the task. Empty if one can."""
        strangers = [i for i in task.robots if i not in self.ids]
        return (
            f"there is no drone {describe_ids(strangers)}; this swarm has {describe_ids(self.ids)}"
            if strangers
            else ""
        )

    def waits(self, task: Task, flying: Collection[int]) -> str:
        """Return why no flying robot can serve the task. Empty if one can."""
        if not task.robots or any(i in flying for i in task.robots):
            return ""
        return (
            f"drone {describe_ids(task.robots)}, which alone may serve it, does not fly"
        )
