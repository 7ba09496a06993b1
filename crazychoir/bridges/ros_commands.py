"""Commands from ROS 2: services for an operator's commands, and goals as poses.

A service takes the same way as a command of the web page. Its answer is a receipt: whether all
drones have done it, and what each drone says.
"""

import asyncio
import logging
import struct
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, Protocol

import msgspec
import numpy as np

from crazychoir.bridges.operator_services import SERVICE_PREFIX, ServiceDesk
from crazychoir.bridges.ros_node import Outside, RosNode
from crazychoir.errors import ConfigError
from crazychoir.numerics.math3d import yaw_of
from crazychoir.recording.mcap.cdr import Layout, Leaf, leaves, unpack_values
from crazychoir.recording.ros.rmw_zenoh import EndpointKind, reply_attachment
from crazychoir.recording.ros.ros import ROS_DEFINITIONS
from crazychoir.recording.ros.rviz import RVIZ_SETTINGS
from crazychoir.runtime.clock import NS_PER_SECOND, Clock

SWARM_SERVICES = (
    *("arm", "take_off", "start", "hold", "go", "land", "home"),
    *("stop", "clear_stop"),
)
"""Services for all drones."""
DRONE_SERVICES = ("take_off", "hold", "go", "land", "stop")
"""Services for one drone."""
SERVICE_TYPE = "std_srvs/srv/Trigger"
GOAL_TYPE = "geometry_msgs/msg/PoseStamped"
GOAL_PERIOD = 0.1
"""Seconds in which several goals of a drone count as one, the newest."""
_ANSWER_LAYOUT = Layout([Leaf("success", "bool"), Leaf("message", "string")], {})
_GOAL_FIELDS = list(leaves("geometry_msgs/PoseStamped", ROS_DEFINITIONS))

log = logging.getLogger(__name__)


class Query(Protocol):
    """A request of a service."""

    attachment: bytes
    """Number of the request and id of its client."""

    def reply(self, data: bytes, attachment: bytes) -> None:
        """Send the answer."""
        ...


class CommandSession(Outside, Protocol):
    """The part of a session with ROS that commands come through."""

    def subscribe(self, key: str, receive: Callable[[bytes], None]) -> None:
        """Let `receive` get the messages of a key, in a thread."""
        ...

    def serve(self, key: str, handle: Callable[[Query], None]) -> None:
        """Let `handle` get the requests of a key, in a thread."""
        ...


class RosCommands:
    """Offers services and reads goals, for all drones and for each.

    desk: carries out the commands
    outside: session with the ROS network
    node: node that offers the services
    ids: the drones
    clock: clock of the swarm; commands are given on its event loop
    """

    def __init__(
        self,
        desk: ServiceDesk,
        outside: CommandSession,
        node: RosNode,
        ids: list[int],
        clock: Clock,
    ) -> None:
        self._desk = desk
        self._outside = outside
        self._node = node
        self._clock = clock
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._goals: dict[int, bytes] = {}
        for name in SWARM_SERVICES:
            self._offer(SERVICE_PREFIX + name, name, {})
        for i in ids:
            for name in DRONE_SERVICES:
                self._offer(f"/drone{i}/{name}", name, {"drones": [i]})
            self._read_goals(i)

    def close(self) -> None:
        """Cancel all waiting."""
        for task in self._tasks:
            task.cancel()

    def _offer(self, path: str, name: str, request: dict[str, Any]) -> None:
        """Offer a service; request: fields of the request of the operator's service."""
        service = self._node.announce(path, SERVICE_TYPE, EndpointKind.SERVICE)
        answer = partial(self._answer, SERVICE_PREFIX + name, request)

        def handle(query: Query) -> None:
            self._loop.call_soon_threadsafe(self._begin, answer, query)

        self._outside.serve(service.key, handle)

    def _read_goals(self, i: int) -> None:
        """Read the goals of drone i."""
        topic = self._node.announce(
            f"/drone{i}/goal_pose", GOAL_TYPE, EndpointKind.SUBSCRIPTION
        )

        def receive(data: bytes) -> None:
            self._loop.call_soon_threadsafe(self._take_goal, i, data)

        self._outside.subscribe(topic.key, receive)

    def _begin(
        self, work: Callable[..., Coroutine[Any, Any, None]], *arguments: Any
    ) -> None:
        task = self._loop.create_task(work(*arguments))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _answer(self, path: str, request: dict[str, Any], query: Query) -> None:
        """Carry out a request, and answer it with a receipt."""
        try:
            attachment = reply_attachment(query.attachment, self._now_ns())
        except struct.error as error:
            log.warning("a request of %s is not of rmw_zenoh: %s", path, error)
            return
        done, words = await self._command(path, request)
        query.reply(_ANSWER_LAYOUT.pack((done, words)), attachment)

    async def _command(self, path: str, request: dict[str, Any]) -> tuple[bool, str]:
        """Give a command; return whether all drones have done it, and what each says."""
        try:
            receipt = await self._desk.call(path, request)
        except (ConfigError, msgspec.ValidationError) as error:
            return False, str(error)
        words = (
            f"drone {i}: {said['answer']}: {said['says']}".removesuffix(": ")
            for i, said in receipt["answers"].items()
        )
        return receipt["done"], "; ".join(words)

    def _take_goal(self, i: int, data: bytes) -> None:
        """Keep the newest goal of drone i, and fly to it within GOAL_PERIOD."""
        if i not in self._goals:
            due_ns = self._clock.now_ns() + round(GOAL_PERIOD * NS_PER_SECOND)
            self._clock.call_at(due_ns, self._give_goal, i)
        self._goals[i] = data

    def _give_goal(self, i: int) -> None:
        data = self._goals.pop(i)
        try:
            goal = read_goal(data)
        except (ConfigError, struct.error, IndexError, UnicodeDecodeError) as error:
            log.warning("drone %d: its goal is not flown to: %s", i, error)
            return
        self._begin(self._fly_to, i, goal)

    async def _fly_to(self, i: int, goal: dict[str, Any]) -> None:
        path = f"{SERVICE_PREFIX}go_to"
        done, words = await self._command(path, {"drones": [i], **goal})
        if not done:
            log.warning("drone %d: its goal %s: %s", i, goal["p"], words)

    def _now_ns(self) -> int:
        return self._clock.now_ns() + self._clock.epoch_ns


def read_goal(data: bytes) -> dict[str, Any]:
    """Return the fields of a go-to for a geometry_msgs/PoseStamped: its place and its yaw.

    Raises ConfigError for another frame than the world, and struct.error, IndexError or
    UnicodeDecodeError for bytes of another message.
    """
    values = unpack_values(_GOAL_FIELDS, data)
    frame = values["header.frame_id"]
    if frame not in ("", RVIZ_SETTINGS.frame):
        raise ConfigError("goal_pose: frame_id", frame, RVIZ_SETTINGS.frame)
    place = [values[f"pose.position.{axis}"] for axis in "xyz"]
    q = np.array([values[f"pose.orientation.{axis}"] for axis in "xyzw"])
    has_attitude = 0.5 < np.linalg.norm(q) < 2.0
    return {"p": place} | ({"yaw": yaw_of(q)} if has_attitude else {})
