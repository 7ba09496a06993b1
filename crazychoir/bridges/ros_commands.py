"""Commands from ROS 2: services for an operator's commands, goals as poses, and streams of velocities.

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

from crazychoir.bridges.live_swarm import LiveSwarm
from crazychoir.bridges.operator_services import SERVICE_PREFIX, describe_receipt
from crazychoir.bridges.ros_node import Outside, RosNode
from crazychoir.bridges.ros_requests import (
    GOAL_TYPE,
    VELOCITY_TYPE,
    read_goal,
    read_velocity,
)
from crazychoir.dashboard.receipts import Receipt
from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.cdr import Layout, Leaf
from crazychoir.recording.ros.rmw_zenoh import EndpointKind, reply_attachment
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.runtime.throttle import Throttle

SWARM_SERVICES = (
    *("arm", "take_off", "start", "hold", "go", "land", "home"),
    *("stop", "clear_stop"),
)
"""Services for all drones."""
DRONE_SERVICES = ("take_off", "hold", "go", "land", "stop")
"""Services for one drone."""
SERVICE_TYPE = "std_srvs/srv/Trigger"
GOAL_PERIOD = 0.1
"""Seconds in which several goals of a drone count as one, the newest."""
VELOCITY_PERIOD = 0.04
"""Seconds in which several velocities of a drone count as one, the newest."""
NOT_FLOWN = (
    ConfigError,
    msgspec.ValidationError,
    struct.error,
    IndexError,
    UnicodeDecodeError,
)
"""Errors of a message that cannot be read or flown."""
_ANSWER_LAYOUT = Layout([Leaf("success", "bool"), Leaf("message", "string")], {})

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
    """Offers services for all drones and for each, and reads goals and velocities of each.

    live: the swarm, which carries out the commands
    outside: session with the ROS network
    node: node that offers the services
    ids: the drones
    """

    def __init__(
        self,
        live: LiveSwarm,
        outside: CommandSession,
        node: RosNode,
        ids: list[int],
    ) -> None:
        self._live = live
        self._desk = live.services
        self._outside = outside
        self._node = node
        self._clock = live.place.clock
        self._loop = asyncio.get_running_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._newest: dict[tuple[str, int], bytes] = {}
        self._throttle = Throttle()
        self._flights: dict[int, Receipt] = {}
        for name in SWARM_SERVICES:
            self._offer(SERVICE_PREFIX + name, name, {})
        for i in ids:
            for name in DRONE_SERVICES:
                self._offer(f"/drone{i}/{name}", name, {"drones": [i]})
            self._read(i, "goal_pose", GOAL_TYPE, GOAL_PERIOD, self._give_goal)
            self._read(
                i, "cmd_vel", VELOCITY_TYPE, VELOCITY_PERIOD, self._give_velocity
            )

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

    def _read(
        self,
        i: int,
        name: str,
        kind: str,
        period: float,
        give: Callable[[int, bytes], None],
    ) -> None:
        """Read a topic of drone i; `give` gets the newest message once in a period of s."""
        topic = self._node.announce(
            f"/drone{i}/{name}", kind, EndpointKind.SUBSCRIPTION
        )

        def give_newest() -> None:
            data = self._newest.pop((name, i))
            try:
                give(i, data)
            except NOT_FLOWN as error:
                text = f"drone {i}: its {name} is not flown: {error}"
                if self._throttle.due(self._clock.now(), text):
                    log.warning(text)

        def take(data: bytes) -> None:
            if (name, i) not in self._newest:
                due_ns = self._clock.now_ns() + round(period * NS_PER_SECOND)
                self._clock.call_at(due_ns, give_newest)
            self._newest[name, i] = data

        def receive(data: bytes) -> None:
            self._loop.call_soon_threadsafe(take, data)

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
        return receipt["done"], _answers_in_words(receipt)

    def _give_goal(self, i: int, data: bytes) -> None:
        self._begin(self._fly_to, i, read_goal(data))

    async def _fly_to(self, i: int, goal: dict[str, Any]) -> None:
        path = f"{SERVICE_PREFIX}go_to"
        done, words = await self._command(path, {"drones": [i], **goal})
        if not done:
            log.warning("drone %d: its goal %s: %s", i, goal["p"], words)

    def _give_velocity(self, i: int, data: bytes) -> None:
        """Fly a velocity of a stream; log how a flight by hand ends, if it is not flown."""
        asked = read_velocity(data, i)
        yaw = 0.0 if asked.in_world else self._live.heading(i)
        if yaw is None:
            raise ConfigError(
                "cmd_vel", "a heading that is not known", "a drone that is seen"
            )
        receipt = self._desk.steer(i, asked.in_the_world(yaw), asked.yaw_rate)
        if receipt is not None and receipt is not self._flights.get(i):
            self._flights[i] = receipt
            self._begin(self._watch_flight, i, receipt)

    async def _watch_flight(self, i: int, receipt: Receipt) -> None:
        described = describe_receipt(await self._live.desk.settled(receipt))
        if not described["done"]:
            log.warning("drone %d: cmd_vel: %s", i, _answers_in_words(described))

    def _now_ns(self) -> int:
        return self._clock.now_ns() + self._clock.epoch_ns


def _answers_in_words(receipt: dict[str, Any]) -> str:
    """Return what each drone says in a described receipt."""
    return "; ".join(
        f"drone {i}: {said['answer']}: {said['says']}".removesuffix(": ")
        for i, said in receipt["answers"].items()
    )
