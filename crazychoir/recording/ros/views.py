"""What viewers such as Foxglove and RViz need beside the recorded messages: transforms, and a scene.

Both repeat what is recorded anyway. So other readers of a recording skip them, and they cost
little: a transform has the digits of the odometry before it in the same chunk, and a scene is
written once, because the shapes of a drone move with its transforms.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.recording.mcap.cdr import schema
from crazychoir.recording.mcap.file import RecordingEntry, Series, ViewSeries
from crazychoir.recording.mcap.messages import FORM_BY_VALUE_TYPE
from crazychoir.recording.ros.ros import ROS_DEFINITIONS, ROS_NAMES, pack_transform
from crazychoir.recording.ros.rviz import MARKER_DEFINITIONS
from crazychoir.recording.ros.scene import (
    SCENE_TYPE,
    pack_scene,
    still_shapes,
)
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import State

TRUTH_TIMEOUT = 0.5  # s without a truth after which the drone's own estimate counts
SHORTEST_PERIOD = 0.045  # s between two transforms of a drone: about 20 a second
MOST_TRANSFORMS = 2000  # a second, of all drones: 1 % of a processor
SCENE_TOPIC = "/scene"
ANY_TIME = 0
"""Stamp of what is valid at all times, in ns."""


@dataclass(slots=True)
class LastTimes:
    """When a drone was last seen, in ns."""

    truth_ns: int
    """Time of its last truth."""
    transform_ns: int
    """Time of its last transform."""


class FlightViews:
    """Adds a scene and transforms to the messages of a recording.

    config: the swarm
    """

    def __init__(self, config: SwarmConfig) -> None:
        self._config = config
        self._has_begun = False
        period = max(SHORTEST_PERIOD, len(config.ids) / MOST_TRANSFORMS)
        self._period_ns = round(period * NS_PER_SECOND)
        self._last: dict[int, LastTimes] = {}
        self._transforms = _series(
            ROS_NAMES.transform_topic,
            ROS_NAMES.transform_type,
            schema(ROS_NAMES.transform_type, ROS_DEFINITIONS),
        )
        self._scene = _series(
            SCENE_TOPIC, SCENE_TYPE, schema(SCENE_TYPE, MARKER_DEFINITIONS)
        )

    def extend(self, entries: Sequence[RecordingEntry]) -> list[RecordingEntry]:
        """Return these entries with the scene before the first, and transforms behind some."""
        shown = []
        if not self._has_begun:
            self._has_begun = True
            came_ns = entries[0].came_ns
            data = pack_scene(still_shapes(self._config), ANY_TIME)
            shown.append(RecordingEntry(self._scene, came_ns, came_ns, data))
        for entry in entries:
            shown.append(entry)
            series = entry.series
            if isinstance(series, Series) and self._is_due(series, entry.came_ns):
                data = pack_transform(series.drone, entry.data)
                shown.append(
                    RecordingEntry(self._transforms, entry.came_ns, entry.born_ns, data)
                )
        return shown

    def _is_due(self, series: Series, came_ns: int) -> bool:
        """Return whether a transform follows a message that has come."""
        is_truth = series.topic == DRONE_TOPICS.truth.name
        if not is_truth and series.topic != DRONE_TOPICS.state.name:
            return False
        if series.message is not FORM_BY_VALUE_TYPE[State]:
            return False
        last = self._last.get(series.drone)
        if last is None:
            never_ns = came_ns - NS_PER_SECOND
            last = self._last[series.drone] = LastTimes(never_ns, never_ns)
        if is_truth:
            last.truth_ns = came_ns
        elif came_ns - last.truth_ns < TRUTH_TIMEOUT * NS_PER_SECOND:
            return False
        is_due = came_ns - last.transform_ns >= self._period_ns
        if is_due:
            last.transform_ns = came_ns
        return is_due


def _series(topic: str, name: str, text: str) -> ViewSeries:
    return ViewSeries(topic, name.replace("/", "/msg/"), text)
