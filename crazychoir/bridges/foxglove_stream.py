"""What Foxglove is told of a running swarm, at bounded rates, and the calls of its services."""

import asyncio
import hmac
import json
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from typing import Any

from crazychoir.bridges.foxglove_server import FoxgloveServer, MessageSeries
from crazychoir.bridges.live_scene import LiveScene
from crazychoir.bridges.live_swarm import LiveSwarm
from crazychoir.bus.topics import DRONE_TOPICS, Topic
from crazychoir.dashboard.command_place import PagePlace
from crazychoir.errors import ConfigError
from crazychoir.recording.mcap.messages import (
    FORM_BY_VALUE_TYPE,
    Pack,
    make_packer,
    usual_type,
)
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.runtime.mailbox import Call
from crazychoir.runtime.supervisor import Supervisor


@dataclass(frozen=True, slots=True)
class FoxgloveRates:
    """Largest rates of what is sent."""

    scene_rate: float = 2.0
    """Hz: rate of the scene; the drones in it move with their transforms."""
    reference_rate: float = 10.0
    """Hz: rate of the references."""
    link_rate: float = 4.0
    """Hz: rate of the states of radio links."""


FOXGLOVE_RATES = FoxgloveRates()


class WatchedSeries:
    """One topic of one drone: packs its values only while a client reads them.

    series: topic of the server
    pack: makes a message of a value and the time of its birth
    now_ns: returns the time in ns since 1970
    """

    def __init__(
        self, series: MessageSeries, pack: Pack, now_ns: Callable[[], int]
    ) -> None:
        self._series = series
        self._pack = pack
        self._now_ns = now_ns

    def hear(self, value: Any, age: float) -> None:
        """Send a value that has come, `age` s old."""
        if self._series.is_watched:
            now_ns = self._now_ns()
            born_ns = max(0, now_ns - round(age * NS_PER_SECOND))
            self._series.send(self._pack(value, born_ns), now_ns)


class ServiceCalls:
    """Carries calls from the threads of the server to the event loop, and their answers back.

    swarm: the swarm
    key: text that every request must have in its field `key`
    loop: the event loop of the swarm
    """

    def __init__(
        self, swarm: LiveSwarm, key: str, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._swarm = swarm
        self._key = key
        self._loop = loop
        self._waiting: dict[Future[dict[str, Any]], None] = {}

    def answer(self, path: str, request: bytes) -> bytes:
        """Carry out a call, and return its receipt as JSON; called in a thread of the call.

        Raises ConfigError, or msgspec.ValidationError, for a call that cannot be carried out.
        """
        fields = _read_request(path, request)
        key = str(fields.pop("key", ""))
        if not hmac.compare_digest(key.encode(), self._key.encode()):
            allowed = "the key that `crazychoir foxglove` has printed"
            raise ConfigError(f"{path}: key", "another one" if key else "none", allowed)
        future = asyncio.run_coroutine_threadsafe(
            self._swarm.services.call(path, fields), self._loop
        )
        self._waiting[future] = None
        try:
            return json.dumps(future.result()).encode()
        except CancelledError:
            raise ConfigError(path, "the server ends", "a running server") from None
        finally:
            self._waiting.pop(future, None)

    def close(self) -> None:
        """End all calls that still wait."""
        for future in list(self._waiting):
            future.cancel()


def _read_request(path: str, request: bytes) -> dict[str, Any]:
    try:
        fields = json.loads(request or b"{}")
    except ValueError as error:
        raise ConfigError(path, "no JSON", "one JSON object", str(error)) from error
    if not isinstance(fields, dict):
        raise ConfigError(path, type(fields).__name__, "one JSON object")
    return fields


class FoxgloveStream(Actor):
    """Sends transforms, the scene and the log; other topics go out as they come.

    swarm: the swarm
    server: the server
    rate: Hz of the transforms and the states
    """

    name = "foxglove"

    def __init__(self, swarm: LiveSwarm, server: FoxgloveServer, rate: float) -> None:
        self._swarm = swarm
        self._server = server
        self._rate = rate
        self._scene = LiveScene(swarm.model, swarm.overview, swarm.board)
        self._lines = 0
        for i in swarm.place.config.ids:
            self._open(DRONE_TOPICS.state, i, rate)
            self._open(DRONE_TOPICS.reference, i, FOXGLOVE_RATES.reference_rate)
            self._open(DRONE_TOPICS.status, i, 0.0)
            self._open(DRONE_TOPICS.link, i, FOXGLOVE_RATES.link_rate)

    def _open(self, topic: Topic, i: int, rate: float) -> None:
        """Send the values of a topic of drone i; rate: largest rate in Hz, 0 for all values."""
        swarm = self._swarm
        place = swarm.place
        form = FORM_BY_VALUE_TYPE[usual_type(topic)]
        series = self._server.series(f"/drone{i}/{topic.name}", form)
        watched = WatchedSeries(series, make_packer(form, i), swarm.now_ns)
        place.link.bus.subscribe(
            topic,
            place.config.topology.source(topic, i),
            place.address,
            Call(place.clock, watched.hear, f"foxglove {topic.name} of {i}"),
            rate,
        )

    async def run(self) -> None:
        """Send what is due, until this task is cancelled."""
        ticks_per_scene = max(1, round(self._rate / FOXGLOVE_RATES.scene_rate))
        count = 0
        async for _ in self._swarm.place.clock.ticks(self._rate):
            self._send_transforms()
            self._send_log()
            if count % ticks_per_scene == 0:
                self._send_scene()
            count += 1

    def _send_transforms(self) -> None:
        places = self._swarm.places(DRONE_TOPICS.state.max_age)
        if places:
            self._server.send_transforms(places, self._swarm.now_ns())
            self._scene.note_places()

    def _send_scene(self) -> None:
        watched = self._server.shows_scene
        self._swarm.watch(watched)
        if watched:
            self._server.send_scene(self._scene.shapes(), self._swarm.now_ns())

    def _send_log(self) -> None:
        for line in self._swarm.log.after(self._lines):
            self._server.send_log(line, self._swarm.now_ns())
            self._lines = line.number


async def serve_foxglove(
    place: PagePlace,
    port: int,
    rate: float,
    key: str | None,
    say: Callable[[str], None],
) -> None:
    """Serve a swarm to Foxglove until this task is cancelled.

    place: place on the network of the swarm
    port: port to listen at, 0 for a free one
    rate: Hz of transforms and states
    key: key of the commands; None to accept no commands
    say: prints a line for the operator
    Raises ConfigError if the port is taken.
    """
    swarm = LiveSwarm(place)
    calls = (
        None if key is None else ServiceCalls(swarm, key, asyncio.get_running_loop())
    )
    server = FoxgloveServer(
        place.config.name, port, None if calls is None else calls.answer
    )
    stream = FoxgloveStream(swarm, server, rate)
    say(
        f"swarm {place.config.name} for Foxglove: ws://127.0.0.1:{server.port}; Ctrl-C ends it, and the swarm flies on"
    )
    if key is not None:
        say(f'commands are accepted; each request needs "key": "{key}"')
    try:
        await Supervisor(place.clock, "foxglove").run([stream, *swarm.actors])
    finally:
        swarm.close()
        if calls is not None:
            calls.close()
        server.close()
