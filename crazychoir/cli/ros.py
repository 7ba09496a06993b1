"""crazychoir ros: a swarm that flies, for RViz and other programs of ROS 2 that use rmw_zenoh. Experimental."""

from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from crazychoir.cli.look import SwarmOption, looking

if TYPE_CHECKING:
    from crazychoir.bus.zenoh import Outside
    from crazychoir.cli.window import Window
    from crazychoir.types import State, Vec

ROUTER = "tcp/127.0.0.1:7447"
NODE = "crazychoir"
PATH_POINTS, PATH_EVERY = 600, 10
"""Places of a path, and messages between two paths."""


def ros(
    swarm: SwarmOption = None,
    connect: Annotated[str, typer.Option(help="Endpoint of `rmw_zenohd`, or of another Zenoh router.")] = ROUTER,
    domain: Annotated[int, typer.Option(min=0, max=232, help="ROS_DOMAIN_ID.")] = 0,
    rate: Annotated[float, typer.Option(min=0.1, max=100.0, help="Messages of each topic a second.")] = 10.0,
    seconds: Annotated[float, typer.Option(help="How long, in s.")] = 3600.0,
) -> None:
    """Publish poses, paths, markers and transforms of a running swarm as rmw_zenoh does (experimental)."""

    async def work(window: "Window") -> None:
        from crazychoir.bus.topics import STATE
        from crazychoir.bus.zenoh import Outside

        states: dict[int, State] = {}

        def hear(i: int, state: State, age: float) -> None:
            states[i] = state

        ids = await window.find()
        for i in ids:
            window.read(STATE, i, partial(hear, i), rate)
        with Outside(connect) as outside:
            bridge = Bridge(outside, domain, ids)
            ends = window.clock.now() + seconds
            async for _ in window.clock.ticks(rate):
                bridge.publish(states, window.clock.now_ns() + window.clock.epoch_ns)
                if window.clock.now() >= ends or not window.drones:
                    return

    looking(swarm, work)


class Bridge:
    """The node: its publishers, and what they have said; outside: the session with ROS."""

    def __init__(self, outside: "Outside", domain: int, ids: list[int]) -> None:
        from crazychoir.recording.rmw_zenoh import Publisher, node_token

        topics = {f"/drone{i}/pose": "geometry_msgs/PoseStamped" for i in ids}
        topics |= {f"/drone{i}/path": "nav_msgs/Path" for i in ids}
        topics |= {"/tf": "tf2_msgs/TFMessage", "/drones": "visualization_msgs/MarkerArray"}
        self._outside, session = outside, outside.id
        outside.token(node_token(domain, session, NODE))
        self._publishers: dict[str, Publisher] = {}
        for number, (topic, kind) in enumerate(topics.items(), 1):
            self._publishers[topic] = Publisher(domain, session, NODE, number, topic, kind)
            outside.token(self._publishers[topic].token)
        self._said = dict.fromkeys(topics, 0)
        self._ways: dict[int, deque[Vec]] = {i: deque(maxlen=PATH_POINTS) for i in ids}
        self._count = 0

    def publish(self, states: "dict[int, State]", now_ns: int) -> None:
        """What is known now, ns after 1970."""
        from crazychoir.recording import rviz

        if not states:
            return
        for i, state in states.items():
            self._ways[i].append(state.p)
            self._put(f"/drone{i}/pose", rviz.pose(state, now_ns), now_ns)
            if self._count % PATH_EVERY == 0:
                self._put(f"/drone{i}/path", rviz.path(self._ways[i], now_ns), now_ns)
        self._put("/tf", rviz.transforms(states, now_ns), now_ns)
        self._put("/drones", rviz.markers(states, now_ns), now_ns)
        self._count += 1

    def _put(self, topic: str, data: bytes, now_ns: int) -> None:
        self._said[topic] += 1
        publisher = self._publishers[topic]
        self._outside.put(publisher.key, data, publisher.attachment(self._said[topic], now_ns))
