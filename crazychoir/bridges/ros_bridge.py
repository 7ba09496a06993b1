"""A running swarm as topics of ROS 2: poses, paths, odometry, status, markers and transforms."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from crazychoir.bridges.ros_node import Outside, RosNode
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.dashboard.command_place import PageLink
from crazychoir.recording.mcap.messages import (
    FORM_BY_VALUE_TYPE,
    in_json,
    make_packer,
)
from crazychoir.recording.ros import rviz
from crazychoir.recording.ros.rviz import Places
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.types import State, Status, Vec


@dataclass(frozen=True, slots=True)
class RosBridgeSettings:
    """Settings of the bridge to ROS 2: its node and what it publishes."""

    node: str = "crazychoir"
    """Name of the ROS node."""
    most_path_points: int = 600
    """Largest number of places in a path."""
    poses_per_path: int = 10
    """Poses of a drone after which its path is published again."""
    reads_per_age: float = 2.0
    """Smallest number of places to read within DRONE_TOPICS.state.max_age, the age limit of a published place.
    """


ROS_BRIDGE = RosBridgeSettings()


class RosPlace(Protocol):
    """A place on the network of a swarm that a bridge reads from."""

    clock: Clock

    @property
    def drones(self) -> list[int]:
        """Drones that are there."""
        ...

    @property
    def link(self) -> PageLink:
        """Its connection to the network."""
        ...

    def read(
        self,
        topic: Topic,
        i: int,
        function: Callable[[Any, float], None],
        rate: float = 0.0,
    ) -> object:
        """Call the function with each value of drone i and its age in s."""
        ...


class RosBridge:
    """The ROS node: what it publishes about drones.

    outside: session with the ROS network
    domain: ROS_DOMAIN_ID
    ids: drones to publish
    """

    def __init__(self, outside: Outside, domain: int, ids: list[int]) -> None:
        self.node = RosNode(outside, domain, ROS_BRIDGE.node)
        """The node; it may get services too."""
        for i in ids:
            self.node.publish_on(f"/drone{i}/pose", "geometry_msgs/msg/PoseStamped")
            self.node.publish_on(f"/drone{i}/path", "nav_msgs/msg/Path")
            self.node.publish_on(f"/drone{i}/odom", "nav_msgs/msg/Odometry")
            self.node.publish_on(f"/drone{i}/status", "std_msgs/msg/String")
        self.node.publish_on("/tf", "tf2_msgs/msg/TFMessage")
        self.node.publish_on("/drones", "visualization_msgs/msg/MarkerArray")
        odometry = FORM_BY_VALUE_TYPE[State]
        self._odometry = {i: make_packer(odometry, i) for i in ids}
        self._text = make_packer(FORM_BY_VALUE_TYPE[str], 0)
        self._ways: dict[int, deque[Vec]] = {
            i: deque(maxlen=ROS_BRIDGE.most_path_points) for i in ids
        }
        self._shown: set[int] = set()
        self._count = 0

    def publish(self, places: Places, now_ns: int) -> None:
        """Publish the known states; remove the marker of a drone with a state that is too old.

        places: for each drone its state and the time of that state, ns after 1970
        now_ns: ns after 1970
        """
        since_ns = now_ns - DRONE_TOPICS.state.max_age * NS_PER_SECOND
        fresh = {
            i: (state, born_ns)
            for i, (state, born_ns) in places.items()
            if born_ns >= since_ns
        }
        gone = sorted(self._shown - fresh.keys())
        self._shown = set(fresh)
        put = self.node.put
        for i, (state, born_ns) in fresh.items():
            self._ways[i].append(state.p)
            put(f"/drone{i}/pose", rviz.pack_pose(state, born_ns), now_ns)
            put(f"/drone{i}/odom", self._odometry[i](state, born_ns), now_ns)
            if self._count % ROS_BRIDGE.poses_per_path == 0:
                put(f"/drone{i}/path", rviz.pack_path(self._ways[i], born_ns), now_ns)
        if fresh:
            put("/tf", rviz.pack_transforms(fresh), now_ns)
            self._count += 1
        if fresh or gone:
            put("/drones", rviz.pack_markers(fresh, gone), now_ns)

    def publish_status(self, i: int, status: Status, now_ns: int) -> None:
        """Publish the status of drone i, as JSON.

        now_ns: ns after 1970
        """
        self.node.put(f"/drone{i}/status", self._text(in_json(status), now_ns), now_ns)


async def serve(
    place: RosPlace, bridge: RosBridge, ids: list[int], rate: float, seconds: float
) -> None:
    """Publish what these drones say until all have gone, or until `seconds` have passed.

    rate: Hz of each topic
    """
    clock = place.clock
    places = dict[int, tuple[State, int]]()

    def now_ns() -> int:
        return clock.now_ns() + clock.epoch_ns

    def hear(i: int, state: State, age: float) -> None:
        places[i] = state, now_ns() - round(age * NS_PER_SECOND)

    def hear_status(i: int, status: Status, age: float) -> None:
        bridge.publish_status(i, status, now_ns())

    least_rate = ROS_BRIDGE.reads_per_age / DRONE_TOPICS.state.max_age
    for i in ids:
        place.read(DRONE_TOPICS.state, i, partial(hear, i), max(rate, least_rate))
        place.read(DRONE_TOPICS.status, i, partial(hear_status, i))
    ends = clock.now() + seconds
    async for _ in clock.ticks(rate):
        bridge.publish(places, now_ns())
        if clock.now() >= ends or not place.drones:
            return
