"""crazychoir ros: publish a running swarm for RViz and other ROS 2 programs that use rmw_zenoh.

Experimental.
"""

from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from crazychoir.cli.operate.inspect import SwarmOption, run_as_observer
from crazychoir.launch import number_options as options

if TYPE_CHECKING:
    from crazychoir.bus.network.zenoh_session import OutsideSession
    from crazychoir.cli.shared.observer import Window
    from crazychoir.recording.ros.rviz import Places
    from crazychoir.types import State, Vec


@dataclass(frozen=True, slots=True)
class RosBridgeSettings:
    """Settings of the bridge to ROS 2: its router, its node and what it publishes."""

    router: str = "tcp/127.0.0.1:7447"
    """Endpoint of `rmw_zenohd`."""
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


def ros(
    swarm: SwarmOption = None,
    connect: Annotated[
        str, typer.Option(help="Endpoint of `rmw_zenohd`, or of another Zenoh router.")
    ] = ROS_BRIDGE.router,
    domain: Annotated[int, options.whole("ROS_DOMAIN_ID.", least=0, most=232)] = 0,
    rate: Annotated[
        float, options.real("Messages of each topic a second.", least=0.1, most=100.0)
    ] = 10.0,
    seconds: Annotated[float, options.seconds("How long, in s.")] = 3600.0,
) -> None:
    """Show a running swarm in ROS 2 (experimental).

    Publishes poses, paths, markers and transforms as rmw_zenoh does.
    """

    async def work(window: "Window") -> None:
        from crazychoir.bus.network.zenoh_session import OutsideSession

        ids = await window.find()
        with OutsideSession(connect) as outside:
            await serve(window, RosBridge(outside, domain, ids), ids, rate, seconds)

    run_as_observer(swarm, work)


async def serve(
    window: "Window", bridge: "RosBridge", ids: list[int], rate: float, seconds: float
) -> None:
    """Publish the places of these drones until all have gone, or until `seconds` have passed.

    rate: Hz of each topic
    """
    from crazychoir.bus.topics import DRONE_TOPICS
    from crazychoir.runtime.clock import NS_PER_SECOND

    clock = window.clock
    places = dict[int, tuple["State", int]]()

    def hear(i: int, state: "State", age: float) -> None:
        places[i] = state, clock.now_ns() + clock.epoch_ns - round(age * NS_PER_SECOND)

    for i in ids:
        window.read(
            DRONE_TOPICS.state,
            i,
            partial(hear, i),
            max(rate, ROS_BRIDGE.reads_per_age / DRONE_TOPICS.state.max_age),
        )
    ends = clock.now() + seconds
    async for _ in clock.ticks(rate):
        bridge.publish(places, clock.now_ns() + clock.epoch_ns)
        if clock.now() >= ends or not window.drones:
            return


class RosBridge:
    """The ROS node: its publishers and their message counters.

    outside: session with the ROS network
    domain: ROS_DOMAIN_ID
    ids: drones to publish
    """

    def __init__(self, outside: "OutsideSession", domain: int, ids: list[int]) -> None:
        from crazychoir.recording.ros.rmw_zenoh import Publisher, node_token

        topics = {f"/drone{i}/pose": "geometry_msgs/PoseStamped" for i in ids}
        topics |= {f"/drone{i}/path": "nav_msgs/Path" for i in ids}
        topics |= {
            "/tf": "tf2_msgs/TFMessage",
            "/drones": "visualization_msgs/MarkerArray",
        }
        self._outside = outside
        session = outside.id
        outside.token(node_token(domain, session, ROS_BRIDGE.node))
        self._publishers: dict[str, Publisher] = {}
        for number, (topic, kind) in enumerate(topics.items(), 1):
            self._publishers[topic] = Publisher(
                domain, session, ROS_BRIDGE.node, number, topic, kind
            )
            outside.token(self._publishers[topic].token)
        self._said = dict.fromkeys(topics, 0)
        self._ways: dict[int, deque[Vec]] = {
            i: deque(maxlen=ROS_BRIDGE.most_path_points) for i in ids
        }
        self._shown: set[int] = set()
        self._count = 0

    def publish(self, places: "Places", now_ns: int) -> None:
        """Publish the known states; remove the marker of a drone with a state that is too old.

        places: for each drone its state and the time of that state, ns after 1970
        now_ns: ns after 1970
        """
        from crazychoir.bus.topics import DRONE_TOPICS
        from crazychoir.recording.ros import rviz
        from crazychoir.runtime.clock import NS_PER_SECOND

        since_ns = now_ns - DRONE_TOPICS.state.max_age * NS_PER_SECOND
        fresh = {
            i: (state, born_ns)
            for i, (state, born_ns) in places.items()
            if born_ns >= since_ns
        }
        gone = sorted(self._shown - fresh.keys())
        self._shown = set(fresh)
        for i, (state, born_ns) in fresh.items():
            self._ways[i].append(state.p)
            self._put(f"/drone{i}/pose", rviz.pack_pose(state, born_ns), now_ns)
            if self._count % ROS_BRIDGE.poses_per_path == 0:
                self._put(
                    f"/drone{i}/path", rviz.pack_path(self._ways[i], born_ns), now_ns
                )
        if fresh:
            self._put("/tf", rviz.pack_transforms(fresh), now_ns)
            self._count += 1
        if fresh or gone:
            self._put("/drones", rviz.pack_markers(fresh, gone), now_ns)

    def _put(self, topic: str, data: bytes, now_ns: int) -> None:
        self._said[topic] += 1
        publisher = self._publishers[topic]
        self._outside.put(
            publisher.key, data, publisher.attachment(self._said[topic], now_ns)
        )
