"""The sessions with Zenoh. This is the only module that imports zenoh.

Every put is DROP and never waits. What arrives is handed over in Zenoh's threads.
"""

import asyncio
import contextlib
import json
import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Protocol, Self

import zenoh

from crazychoir.bus.network import endpoints, handshakes
from crazychoir.bus.network.access import NetworkAccess
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.link_keys import LinkKeys
from crazychoir.bus.topics import ALL_TOPICS, MessageClass
from crazychoir.errors import ConfigError
from crazychoir.runtime.clock import NS_PER_SECOND

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SessionRules:
    """How a session with Zenoh runs and ends."""

    close_deadline: float = 1.5
    """s: time to close the session; shorter than the time that a supervisor grants."""
    close_thread: str = "zenoh close"
    """Name of the thread in which a session may be left behind, see launch/process/ending.py.
    """
    runtime_variable: str = "ZENOH_RUNTIME"
    """Environment variable with Zenoh's threads; a value that the user has set is kept."""
    local_receivers: int = 4
    """Receiving threads of Zenoh for this host and for observers."""
    most_receivers: int = 64
    """Most receiving threads of Zenoh.

    If a process vanishes, for example by a cut cable, Zenoh closes its connection in one of these
    threads. The thread then waits up to 10 s for the network (SO_LINGER; zenoh issues 1101, 2718). If
    no thread is left, no message is received. Therefore each process of another host adds one.
    """
    kept_tokens: int = 8
    """Additional tokens of this process that are kept, the newest."""


SESSION_RULES = SessionRules()


OPEN_NETWORK_WARNING = (
    "the network is neither encrypted nor closed (security.insecure): "
    "every host on it can read and command"
)
"""Warning for a network that is neither encrypted nor closed."""
LISTS_LINKS = hasattr(zenoh.SessionInfo, "links")
"""Whether this version of Zenoh lists its links, as it does since 1.9."""
UNSEEN_LINKS_WARNING = (
    "this version of Zenoh does not list its links: no warning comes if a program that is no process "
    "of the swarm connects with the certificate of a host. pip install 'eclipse-zenoh>=1.9'"
)
"""Warning for a version of Zenoh that does not list its links."""
_CLASS_PRIORITIES = {
    MessageClass.ESTOP: zenoh.Priority.REAL_TIME,
    MessageClass.CONTROL: zenoh.Priority.INTERACTIVE_HIGH,
    MessageClass.ROUNDS: zenoh.Priority.DATA_HIGH,
    MessageClass.RELIABLE: zenoh.Priority.DATA,
    MessageClass.BULK: zenoh.Priority.DATA_LOW,
}
"""Zenoh's priority of each class."""


@dataclass(frozen=True, slots=True)
class SessionEndpoints:
    """Where a process listens, and to which others it connects."""

    listen: list[str]
    """Endpoints at which to listen."""
    connect: list[str]
    """Endpoints to which to connect."""
    routers: list[str] = field(default_factory=list)
    """Endpoint of a router that passes all messages on, instead of `listen` and `connect`.

    It is empty without a router.
    """
    lease: float = 1.0
    """s: time without a sign of a host before its tokens disappear."""
    remote_processes: int = 0
    """Number of processes of the swarm on other hosts. Links to these may vanish."""


class FramePayload(Protocol):
    """The bytes of a received frame, before they are copied."""

    def __len__(self) -> int: ...

    def to_bytes(self) -> bytes:
        """Return a copy of the bytes."""


class FrameSample(Protocol):
    """A received frame as Zenoh hands it over."""

    @property
    def key_expr(self) -> object:
        """Key of the frame, as text by `str`."""

    @property
    def payload(self) -> FramePayload:
        """Bytes of the frame."""


class FramePublisher(Protocol):
    """The way of the frames of one class to one process through Zenoh."""

    def put(self, payload: bytes) -> None:
        """Send a frame."""

    def undeclare(self) -> None:
        """Give the way up."""


@dataclass(frozen=True, slots=True)
class OccasionalPublisher:
    """A way of frames for which nothing is declared: it costs other processes nothing while it is not used.

    Zenoh tells each process of the swarm of each publisher. Between the processes of one host frames
    go through Zenoh only until their socket is connected.
    """

    put: Callable[[bytes], None]
    """Send a frame."""

    def undeclare(self) -> None:
        """Give the way up."""


ReceiveSample = Callable[[FrameSample], None]
"""Callable that gets each frame, in a thread of Zenoh. It must not block."""
ReceiveToken = Callable[[str, bool], None]
"""Callable that gets (key, True) if a token appears, (key, False) if it disappears.

It is called in a thread of Zenoh, and must not block.
"""


class ZenohSession:
    """The session of a process in a swarm: what it declares, and its puts.

    keys: keys of this process
    reach: endpoints of this process
    access: rules for hosts; None if every host may do everything
    counters: gets the number of additional tokens, and the time and the errors of the puts
    now_ns: returns the time in ns
    Raises ConfigError for a malformed endpoint.

    Attributes:
    is_open: True from `open` to `close`
    """

    def __init__(
        self,
        keys: LinkKeys,
        reach: SessionEndpoints,
        access: NetworkAccess | None,
        counters: LinkCounters,
        now_ns: Callable[[], int],
    ) -> None:
        self.keys = keys
        self.is_open = False
        self._listen = [] if reach.routers else reach.listen
        self._connect = reach.routers or reach.connect
        self._access = access
        self._counters = counters
        self._now_ns = now_ns
        mode = "client" if reach.routers else "peer"
        settings = endpoints.zenoh_settings(
            self._listen, self._connect, reach.lease, mode
        )
        self._config = _zenoh_config(settings, access)
        self._receivers = count_receivers(reach)
        self._session: zenoh.Session | None = None
        self._declared: list[Any] = []
        self._tokens: deque[Any] = deque()
        self._audiences: dict[str, zenoh.Publisher] = {}
        """By public topic: knows whether another program reads its keys."""

    # Opening and closing --------------------------------------------------------------

    def open(self, receive: ReceiveSample, receive_token: ReceiveToken) -> None:
        """Listen, connect, subscribe, and only then declare the token.

        receive: gets each frame for this process
        receive_token: gets the tokens of all processes that appear and disappear
        Raises ConfigError if the session cannot be opened, for example for a busy endpoint.
        """

        def take_token(sample: zenoh.Sample) -> None:
            receive_token(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        _report_security(self._access, self._listen + self._connect)
        session = _open_session(
            self._config, self._listen, self._connect, self._receivers
        )
        self._session = session
        self.is_open = True
        received = zenoh.handlers.Callback(receive, indirect=True)
        tokens = zenoh.handlers.Callback(take_token, indirect=True)
        self._declared = [
            session.declare_subscriber(self.keys.arriving_frames, received),
            session.liveliness().declare_subscriber(
                self.keys.all_tokens, tokens, history=True
            ),
            session.liveliness().declare_token(self.keys.own_token),
        ]
        self._audiences = {
            topic.name: session.declare_publisher(self.keys.public("*", topic.name))
            for topic in ALL_TOPICS
            if topic.public > 0
        }

    async def close(self) -> None:
        """Close the session in a thread, because that may take long; leave it behind then."""
        session = self._session
        self._session = None
        self.is_open = False
        if session is None:
            return
        closed = asyncio.Event()
        report = partial(asyncio.get_running_loop().call_soon_threadsafe, closed.set)
        threading.Thread(
            target=self._close,
            args=(session, report),
            name=SESSION_RULES.close_thread,
            daemon=True,
        ).start()
        try:
            async with asyncio.timeout(SESSION_RULES.close_deadline):
                await closed.wait()
        except TimeoutError:
            log.warning(
                "the Zenoh session does not close within %g s; left behind",
                SESSION_RULES.close_deadline,
            )

    def _close(self, session: zenoh.Session, report: Callable[[], object]) -> None:
        try:
            for declared in reversed(
                [*self._declared, *self._audiences.values(), *self._tokens]
            ):
                declared.undeclare()
            session.close()
        except zenoh.ZError as error:
            log.warning("while the Zenoh session closed: %s", error)
        finally:
            with contextlib.suppress(RuntimeError):  # the event loop is closed
                report()

    # Declaring ------------------------------------------------------------------------

    def make_publisher(
        self, process: str, klass: MessageClass, *, is_occasional: bool
    ) -> FramePublisher:
        """Return a publisher for the frames of a class to another process.

        is_occasional: whether few frames are expected
        Raises RuntimeError if the session is not open.
        """
        if self._session is None:
            raise RuntimeError("the Zenoh session is not open")
        if is_occasional:
            return OccasionalPublisher(self._bind_put(self._session, process, klass))
        return self._session.declare_publisher(
            self.keys.frame_to(process, klass),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=_CLASS_PRIORITIES[klass],
            reliability=zenoh.Reliability.RELIABLE,
        )

    def declare_another_token(self) -> None:
        """Declare one more token of this process, and drop the oldest additional one."""
        if self._session is None:
            return
        self._counters.tokens += 1
        key = f"{self.keys.own_token}/{self._counters.tokens}"
        try:
            self._tokens.append(self._session.liveliness().declare_token(key))
            if len(self._tokens) > SESSION_RULES.kept_tokens:
                self._tokens.popleft().undeclare()
        except zenoh.ZError as error:
            log.warning("a liveliness token could not be declared: %s", error)

    # Sending --------------------------------------------------------------------------

    def send(self, put: Callable[[bytes], None], frame: bytes) -> bool:
        """Send a frame with the `put` of a publisher, and measure how long that takes.

        Returns False if Zenoh refuses the frame.
        """
        began_ns = self._now_ns()
        counters = self._counters
        try:
            put(frame)
        except zenoh.ZError:
            counters.put_errors += 1
            return False
        counters.worst_put_s = max(
            counters.worst_put_s, (self._now_ns() - began_ns) / NS_PER_SECOND
        )
        return True

    def send_frame(self, process: str, klass: MessageClass, frame: bytes) -> bool:
        """Send a frame to a process for which there is no publisher.

        Returns False if Zenoh refuses the frame, or the session is not open.
        """
        if self._session is None:
            return False
        return self.send(self._bind_put(self._session, process, klass), frame)

    def _bind_put(
        self, session: zenoh.Session, process: str, klass: MessageClass
    ) -> Callable[[bytes], None]:
        """Return a function that sends a frame to a process without a publisher."""
        return partial(
            session.put,
            self.keys.frame_to(process, klass),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=_CLASS_PRIORITIES[klass],
        )

    def put(self, key: str, data: bytes | str) -> None:
        """Send data to all subscribers of a key, if the session is open.

        May be called from any thread, also while the event loop hangs.
        """
        session = self._session
        if session is not None:
            session.put(key, data)

    def announce(self, drone: int, topic: str, text: bytes) -> None:
        """Put a JSON text under the drone's public key, for other Zenoh programs."""
        if self._session is not None:
            self._session.put(
                self.keys.public(drone, topic),
                text,
                encoding=zenoh.Encoding.APPLICATION_JSON,
            )

    # Looking around -------------------------------------------------------------------

    def has_audience(self, topic: str) -> bool:
        """Return whether another program reads the public copy of this topic of some drone."""
        publisher = self._audiences.get(topic)
        # zenoh's type stubs call this status a bool.
        status: Any = None if publisher is None else publisher.matching_status
        return status is not None and bool(status.matching)

    def connected_programs(self) -> list[tuple[str | None, str]]:
        """Return, for each link, the name in the certificate and Zenoh's id of the program.

        It is empty if this version of Zenoh does not list its links.
        """
        if self._session is None or not LISTS_LINKS:
            return []
        links = self._session.info.links()
        return [(link.auth_identifier, str(link.zid)) for link in links]


ReceiveBytes = Callable[[bytes], None]
"""Callable that gets the bytes of each message, in a thread of Zenoh. It must not block."""


class OutsideQuery:
    """A question of a program outside of a swarm, which is answered once or not at all.

    query: the question as Zenoh hands it over
    """

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.data = _bytes_of(query.payload)
        """Bytes of the question."""
        self.attachment = _bytes_of(query.attachment)
        """Bytes that came with the question; empty if there are none."""

    def reply(self, data: bytes, attachment: bytes) -> None:
        """Send the answer; it is dropped if the program has gone."""
        try:
            self._query.reply(self._query.key_expr, data, attachment=attachment)
        except zenoh.ZError as error:
            log.warning("an answer to %s is lost: %s", self._query.key_expr, error)


def _bytes_of(data: zenoh.ZBytes | None) -> bytes:
    return b"" if data is None else data.to_bytes()


class OutsideSession:
    """A session with programs outside of a swarm, at an endpoint, while its `with` lasts.

    Raises ConfigError if the session cannot be opened.
    """

    def __init__(self, connect: str) -> None:
        config = _zenoh_config(endpoints.zenoh_settings([], [connect], 1.0), None)
        threads = SESSION_RULES.local_receivers
        self._session = _open_session(config, [], [connect], threads)
        self._declared: list[Any] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        for declared in reversed(self._declared):
            declared.undeclare()
        self._session.close()

    @property
    def id(self) -> str:
        """Id of the session, hexadecimal without leading zeros."""
        return str(self._session.info.zid()).lstrip("0")

    def token(self, key: str) -> None:
        """Declare a liveliness token until the end of the session."""
        self._declared.append(self._session.liveliness().declare_token(key))

    def subscribe(self, key: str, receive: ReceiveBytes) -> None:
        """Let `receive` get the messages of a key until the end of the session."""

        def take(sample: zenoh.Sample) -> None:
            receive(sample.payload.to_bytes())

        self._declared.append(self._session.declare_subscriber(key, take))

    def serve(self, key: str, handle: Callable[[OutsideQuery], None]) -> None:
        """Let `handle` get the questions of a key until the end of the session.

        handle: called in a thread of Zenoh; it must not block
        """

        def take(query: zenoh.Query) -> None:
            handle(OutsideQuery(query))

        self._declared.append(self._session.declare_queryable(key, take, complete=True))

    def put(self, key: str, data: bytes, attachment: bytes) -> None:
        """Send data to all subscribers of a key; it is dropped if they are too slow."""
        drop = zenoh.CongestionControl.DROP
        self._session.put(key, data, attachment=attachment, congestion_control=drop)


@contextlib.contextmanager
def route_messages(
    listen: list[str], lease: float, access: NetworkAccess | None
) -> Iterator[None]:
    """Pass on the messages between the processes of a swarm, while its `with` lasts.

    lease: seconds without a sign of a host before its tokens disappear
    Raises ConfigError if the session cannot be opened.
    """
    _report_security(access, listen)
    config = _zenoh_config(endpoints.router_settings(listen, lease), access)
    session = _open_session(config, listen, [], SESSION_RULES.most_receivers)
    try:
        yield
    finally:
        session.close()


def _report_security(access: NetworkAccess | None, used: list[str]) -> None:
    """Let failed handshakes be logged, and warn about a network that is open to all.

    used: all endpoints of this process
    """
    if access is not None and handshakes.is_reading_output():
        zenoh.init_log_from_env_or(handshakes.ZENOH_LOG_READING.log_levels)
    if access is not None and not LISTS_LINKS:
        log.warning("%s", UNSEEN_LINKS_WARNING)
    if access is None and not endpoints.are_local(used):
        log.warning("%s", OPEN_NETWORK_WARNING)


def _zenoh_config(
    settings: Mapping[str, Any], access: NetworkAccess | None
) -> zenoh.Config:
    """Return Zenoh's configuration, with the keys and rules of the hosts.

    Raises ConfigError for a setting that Zenoh refuses.
    """
    secured = access.settings() if access is not None else {}
    config = zenoh.Config()
    for key, value in {**settings, **secured}.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            raise ConfigError(
                f"Zenoh setting {key}", value, str(error).split(" at /", 1)[0]
            ) from error
    return config


def count_receivers(reach: SessionEndpoints) -> int:
    """Return the number of Zenoh's receiving threads for these endpoints.

    A process with a router has one link, to the router.
    """
    remote = 1 if reach.routers else reach.remote_processes
    return min(SESSION_RULES.local_receivers + remote, SESSION_RULES.most_receivers)


def _open_session(
    config: zenoh.Config, listen: list[str], connect: list[str], receivers: int
) -> zenoh.Session:
    """Return an open session.

    listen, connect: endpoints in the configuration, for the error
    receivers: number of Zenoh's receiving threads, if this is the first session of this process
    Raises ConfigError if it cannot be opened.
    """
    variable = SESSION_RULES.runtime_variable
    chosen = os.environ.get(variable)
    os.environ[variable] = chosen or f"(rx: (worker_threads: {receivers}))"
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise endpoints.opening_error(listen, connect, str(error)) from error
    finally:
        if chosen is None:
            del os.environ[variable]  # processes that start later count their own
