"""The bus of one process: its ports, their readers, and the way of a message to the next mailbox.

A message between two drones always passes the codec and the simulated network, within one process
too. Actors of one drone pass frozen values by reference. Messages for other processes go to the
`Forwarder`.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, Protocol

from crazychoir.bus.clock_offset import OffsetEstimate
from crazychoir.bus.codec import encode
from crazychoir.bus.impairment.model import (
    LOST_MESSAGE,
    UNDELAYED_MESSAGE,
    Impairment,
    MessageFate,
)
from crazychoir.bus.message import Message
from crazychoir.bus.topics import (
    MESSAGE_TOPICS,
    REQUESTED_TOPICS,
    TOPIC_BY_NAME,
    MessageClass,
    Topic,
)
from crazychoir.errors import CodecError
from crazychoir.runtime.clock import NS_PER_SECOND, AlarmPriority, Clock
from crazychoir.runtime.mailbox import AnyMailbox
from crazychoir.runtime.shared_ticks import SharedTicks


@dataclass(frozen=True, slots=True)
class PortAddresses:
    """Ranges of the addresses of ports."""

    any_drone: int = -1
    """Source of an interest in all drones but the reader; a mailbox then gets (drone, value).
    """
    first_observer: int = 10_000
    """Addresses from here on are observers and operators; lower ones are drones."""
    body_offset: int = 1 << 25
    """Offset of the address of a drone's body, if another process than the drone's holds it.

    It is above the addresses of all observers.
    """
    camera_offset: int = 1 << 26
    """Offset of the address at which motion capture publishes the poses
    of a drone, if the cameras have their own process.
    """


PORT_ADDRESSES = PortAddresses()
FIRST_OBSERVER: Final = PORT_ADDRESSES.first_observer
"""`PORT_ADDRESSES.first_observer` for code that runs for each message."""


@dataclass(frozen=True, slots=True)
class ReaderTiming:
    """Times at which readers with a rate get values."""

    never_ns: int = 1 << 62
    """ns: a time that never comes."""
    slow_interval_ns: int = NS_PER_SECOND // 10
    """ns: values with at least this interval leave at another time at each drone."""
    phase_step_ns: int = NS_PER_SECOND // 100
    """ns: difference of these times from one drone id to the next."""


READER_RATES = ReaderTiming()


Handler = Callable[[Message, float], None]
"""Callable that gets (message, its age in s)."""
Tap = Callable[[int, Message, float], None]
"""Callable that gets (address of the receiver, message, its age in s) of each arriving message."""


class Forwarder(Protocol):
    """The way to other processes."""

    def forward(self, message: Message, to: list[int], age: float) -> None:
        """Take a message for ports in other processes.

        age: s, its age
        """

    def then(self, work: Callable[[], None]) -> None:
        """Call `work` when all messages forwarded in this pass of the event loop have left."""

    def interested(self) -> None:
        """React to a change of the interests of this process."""


@dataclass(slots=True)
class Rate:
    """The rate at which another port gets a topic: one value in each interval of a fixed grid."""

    interval_ns: int
    """ns: the shortest interval that the reader asked for."""
    due_ns: int = 0
    """ns: begin of the next interval."""

    def due(self, now_ns: int) -> bool:
        """Return True if a value may be sent now, and begin the next interval."""
        if now_ns < self.due_ns:
            return False
        self.due_ns += (
            (now_ns - self.due_ns) // self.interval_ns + 1
        ) * self.interval_ns
        return True


@dataclass(slots=True)
class Readers:
    """The readers of a topic of one drone."""

    mailboxes: list[AnyMailbox] = field(default_factory=list)
    """Mailboxes of the drone's own actors."""
    every: list[int] = field(default_factory=list)
    """Ports that get every value."""
    some: dict[int, Rate] = field(default_factory=dict)
    """Ports that get some values a second."""
    due: dict[int, list[int]] = field(default_factory=dict)
    """{time in ns: ports of `some` that are due then}.

    An entry of a port is ignored if its due time has changed since.
    """
    next_ns: int = READER_RATES.never_ns
    """ns: no port of `some` is due before."""

    def add(self, address: int, interval_ns: int, phase: int = 0) -> None:
        """Add a port; a port that is added twice keeps its fastest rate.

        phase: ns, shift of a slow grid, so that drones do not all send in the same tick
        """
        if address in self.every:
            return
        if interval_ns == 0:
            self.some.pop(address, None)
            self.every.append(address)
        elif address in self.some:
            rate = self.some[address]
            rate.interval_ns = min(rate.interval_ns, interval_ns)
        else:
            is_slow = interval_ns >= READER_RATES.slow_interval_ns
            rate = Rate(interval_ns, phase % interval_ns if is_slow else 0)
            self.some[address] = rate
            self.due.setdefault(rate.due_ns, []).append(address)
            self.next_ns = min(self.next_ns, rate.due_ns)

    def now_due(self, now_ns: int) -> list[int]:
        """Return the ports of `some` that get a value now."""
        found: list[int] = []
        if now_ns < self.next_ns:
            return found
        for at in [at for at in self.due if at <= now_ns]:
            for j in self.due.pop(at):
                rate = self.some.get(j)
                if rate is not None and rate.due_ns == at and rate.due(now_ns):
                    found.append(j)
                    self.due.setdefault(rate.due_ns, []).append(j)
        self.next_ns = min(self.due, default=READER_RATES.never_ns)
        return found

    @property
    def is_read(self) -> bool:
        """Whether the topic has a reader."""
        return bool(self.mailboxes or self.every or self.some)

    def drop(self, addresses: Sequence[int]) -> None:
        """Remove ports."""
        self.every = [j for j in self.every if j not in addresses]
        self.some = {j: rate for j, rate in self.some.items() if j not in addresses}


@dataclass(slots=True)
class LatchedValues:
    """The values of the latched topics of a port, for readers that come later."""

    _kept: dict[int, tuple[Any, int]] = field(default_factory=dict)
    _offers: dict[int, tuple[Callable[[], Any], Callable[[], float]]] = field(
        default_factory=dict
    )

    def keep(self, topic: Topic, value: Any, born_ns: int) -> None:
        """Keep the newest value of a topic.

        born_ns: ns, time at which it was true
        """
        self._kept[topic.number] = value, born_ns

    def offer(
        self,
        topic: Topic,
        find_value: Callable[[], Any],
        find_age: Callable[[], float] = lambda: 0.0,
    ) -> None:
        """Give new readers of a topic the present value, instead of the last published one.

        So the value need not be published while no port reads it.
        find_value: returns the present value; None if there is none
        find_age: returns its age in s
        """
        self._offers[topic.number] = find_value, find_age

    def find(self, topic: Topic, now_ns: int) -> tuple[Any, float] | None:
        """Return the value of a topic and its age in s; None if there is no value."""
        if topic.number in self._offers:
            find_value, find_age = self._offers[topic.number]
            present = find_value()
            return None if present is None else (present, find_age())
        if topic.number not in self._kept:
            return None
        value, born_ns = self._kept[topic.number]
        return value, (now_ns - born_ns) / NS_PER_SECOND


@dataclass(slots=True)
class Counters:
    """Counts of a port's messages."""

    sent: int = 0
    """Messages to drones that pass the simulated network, and states that come without a message."""
    lost: int = 0
    """Messages that the simulated network lost."""
    resent: int = 0
    """Messages sent again."""
    received: int = 0
    """Messages that arrived."""
    malformed: int = 0
    """Payloads that could not be decoded."""
    bytes: int = 0
    """Bytes of the messages to drones."""


@dataclass(frozen=True)
class Interest:
    """The wish of a port to get a topic."""

    topic: str
    """Name of the topic."""
    source: int
    """Drone that publishes it, or PORT_ADDRESSES.any_drone."""
    reader: int
    """Address of the port."""
    rate: float = 0.0
    """Most values a second; 0 for all."""


class Bus:
    """All ports of one process.

    offsets: clock offset of each other host, to be shown
    link_faults: counts of what went wrong on the link to other processes, to be shown
    unroutable: messages without a receiver
    stopped: True while an emergency stop is in force
    tap: callable that gets every arriving message, or None
    heartbeat_ticks: calls the drones that send heartbeats
    """

    def __init__(
        self,
        clock: Clock,
        impairment: Impairment | None = None,
        process: str = "local",
        host: str = "local",
    ) -> None:
        self.clock = clock
        self._now_ns = clock.now_ns
        self.impairment = impairment or Impairment(0)
        self.process = process
        self.host = host
        self.ports: dict[int, Port] = {}
        self.forwarder: Forwarder | None = None
        self.offsets: dict[str, OffsetEstimate] = {}
        self.link_faults: list[str] = []
        self.interests: list[Interest] = []
        self.unroutable = 0
        self.stopped = False
        self.tap: Tap | None = None
        self.heartbeat_ticks = SharedTicks(clock, MESSAGE_TOPICS.heartbeat.rate)
        self._readers: dict[int, dict[int, Readers]] = {}
        self._read_addresses: dict[int, tuple[int, ...]] = {}

    def port(self, address: int, incarnation: int = 1) -> "Port":
        """Open the port of a drone or an observer.

        If it was open before, its readers in other processes are still there.
        """
        readers = self._readers.setdefault(address, {})
        port = self.ports[address] = Port(self, address, incarnation, _readers=readers)
        for topic in readers.values():
            topic.mailboxes.clear()
        self.note_reader_change()
        for interest in self.interests:
            if address in self._sources(interest):
                port.add_reader(interest, None)
        return port

    def close(self, address: int) -> None:
        """Close a port: its messages are lost from now on, as if its drone had crashed."""
        self.ports.pop(address, None)

    def deliver(self, message: Message, to: Iterable[int], age: float) -> None:
        """Deliver a message at ports of this process; send it on to those of other processes.

        age: s, its age
        """
        ports = self.ports
        tap = self.tap
        source = message.source
        topic = message.topic.number
        now_ns = self._now_ns()
        for j in to:
            port = ports.get(j)
            if port is None:
                self._forward(message, j, age)
                continue
            port.counters.received += 1
            if tap is not None:
                tap(j, message, age)
            port.heard_ns[source] = now_ns
            handler = port.handlers.get(topic)
            if handler is not None:
                handler(message, age)
            else:
                port.fill_mailboxes(message, age)

    def _forward(self, message: Message, j: int, age: float) -> None:
        """Send a message on to a port of another process."""
        if self.forwarder is None:
            self.unroutable += 1
        else:
            self.forwarder.forward(message, [j], age)

    def drones(self) -> list[int]:
        """Return the ids of the drones of this process."""
        return [
            address for address in self.ports if address < PORT_ADDRESSES.first_observer
        ]

    def subscribe(
        self,
        topic: Topic,
        source: int,
        reader: int,
        mailbox: AnyMailbox,
        rate: float = 0.0,
    ) -> None:
        """Let `mailbox` of `reader` get `topic` of drone `source`, or of any drone.

        source: PORT_ADDRESSES.any_drone for all drones
        rate: values a second; 0 for all
        """
        interest = Interest(topic.name, source, reader, rate)
        self.ports[reader].mailboxes.setdefault(topic.number, {}).setdefault(
            source, []
        ).append(mailbox)
        for address in self._sources(interest):
            self.ports[address].add_reader(
                interest, mailbox if address == reader else None
            )
        if (
            source == PORT_ADDRESSES.any_drone or source not in self.ports
        ) and interest not in self.interests:
            self.interests.append(interest)
            if self.forwarder is not None:
                self.forwarder.interested()

    def add_remote_interests(self, interests: list[Interest]) -> None:
        """Add the interests of another process."""
        for interest in interests:
            if interest.topic in REQUESTED_TOPICS:
                for address in self._sources(interest):
                    self.ports[address].add_reader(interest, None)

    def _sources(self, interest: Interest) -> list[int]:
        """Return the open ports of this process that an interest names."""
        if interest.source != PORT_ADDRESSES.any_drone:
            return [interest.source] if interest.source in self.ports else []
        return [address for address in self.drones() if address != interest.reader]

    def drop_readers(self, addresses: list[int]) -> None:
        """Remove these ports of another process from all readers."""
        for port in self.ports.values():
            port.drop_readers(addresses)

    def note_reader_change(self) -> None:
        """Note that a topic has gained or lost a reader."""
        self._read_addresses.clear()

    def find_read_addresses(self, topic: Topic) -> tuple[int, ...]:
        """Return the addresses in this process from which this topic is read, in order.

        The answer is the same tuple until a reader comes or goes. So a publisher of many drones
        asks once, and not each port.
        """
        number = topic.number
        addresses = self._read_addresses.get(number)
        if addresses is None:
            addresses = self._read_addresses[number] = tuple(
                sorted(
                    address
                    for address, topics in self._readers.items()
                    if number in topics and topics[number].is_read
                )
            )
        return addresses


@dataclass(eq=False)
class Port:
    """The place of one drone or one observer on the bus."""

    bus: Bus
    """Bus of the process."""
    address: int
    """Drone id or address of an observer."""
    incarnation: int
    """Number that a restarted process changes."""
    counters: Counters = field(default_factory=Counters)
    """Counts of its messages."""
    handlers: dict[int, Handler] = field(default_factory=dict)
    """{topic: callable that gets its messages}."""
    mailboxes: dict[int, dict[int, list[AnyMailbox]]] = field(default_factory=dict)
    """{topic: {source or PORT_ADDRESSES.any_drone: mailboxes}}."""
    heard_ns: dict[int, int] = field(default_factory=dict)
    """ns: {address: time of its last message}."""
    life_signs: list[Callable[[int], int | None]] = field(default_factory=list)
    """Each returns when a drone was heard without a message, ns; None: never."""
    ignored_beats: dict[int, bytes] = field(default_factory=dict)
    """{drone id: payload of its heartbeat that changes nothing when it is repeated}."""
    latched: LatchedValues = field(default_factory=LatchedValues)
    """Values for readers that come later."""
    _readers: dict[int, Readers] = field(default_factory=dict)
    _numbers: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._now_ns = self.bus.clock.now_ns

    def send(
        self,
        message: Message,
        to: Sequence[int],
        attempt: int = 0,
        age: float = 0.0,
    ) -> None:
        """Send a message to each address of `to`, in any process.

        Messages between drones pass the simulated network.
        attempt: number of this repeat of the message
        age: s, age of its content
        """
        bus = self.bus
        topic = message.topic
        counters = self.counters
        drones = 0
        for j in to:
            drones += j < FIRST_OBSERVER
        counters.bytes += drones * len(message.payload)
        if topic.impaired:
            counters.sent += drones
            if bus.impairment.active:
                to = self._list_unharmed(message, to, attempt, age)
        forwarder = bus.forwarder
        if forwarder is not None:
            ports = bus.ports
            here: list[int] = []
            far: list[int] = []
            for j in to:
                if j in ports:
                    here.append(j)
                else:
                    far.append(j)
            if far:
                to = here
                forwarder.forward(message, far, age)
                if here and topic.klass is MessageClass.ROUNDS:
                    # Other processes wait for this round, and we wait for theirs: they go first.
                    forwarder.then(partial(bus.deliver, message, here, age))
                    return
        if to:
            bus.deliver(message, to, age)

    def _list_unharmed(
        self, message: Message, to: Sequence[int], attempt: int, age: float
    ) -> list[int]:
        """Let the simulated network decide about a message to each of these addresses.

        Returns the addresses that get it now, once.
        """
        unharmed = []
        now = self._now_ns() / NS_PER_SECOND
        for j in to:
            if j >= FIRST_OBSERVER:
                unharmed.append(j)
                continue
            fate = self.bus.impairment.verdict(
                self.address,
                j,
                message.channel or message.topic.name,
                message.number,
                attempt,
                len(message.payload),
                now,
            )
            if fate is UNDELAYED_MESSAGE:
                unharmed.append(j)
            elif fate is LOST_MESSAGE:
                self.counters.lost += 1
            else:
                self._deliver_late(fate, message, j, age)
        return unharmed

    def list_readers(self, topic: Topic) -> list[int]:
        """Return the addresses of the other ports that read this topic of this port."""
        readers = self._readers.get(topic.number)
        return [] if readers is None else [*readers.every, *readers.some]

    def is_read(self, topic: Topic) -> bool:
        """Return whether this topic of this port has a reader."""
        readers = self._readers.get(topic.number)
        return readers is not None and readers.is_read

    def publish(self, topic: Topic, value: Any, age: float = 0.0) -> None:
        """Give a value to all its readers; this costs nothing without readers."""
        if topic.latched:
            self.latched.keep(topic, value, self._now_ns() - round(age * NS_PER_SECOND))
        readers = self._readers.get(topic.number)
        if readers is None:
            return
        for mailbox in readers.mailboxes:
            mailbox.put(value, age)
        to = readers.every
        if readers.some:
            to = [*to, *readers.now_due(self.bus.clock.now_ns())]
        if to:
            number = self._numbers[topic.number] = (
                self._numbers.get(topic.number, 0) + 1
            )
            message = Message(topic, self.address, encode(value), number)
            self.send(message, to, age=age)

    def fill_mailboxes(self, message: Message, age: float) -> None:
        """Give the value of a message to the mailboxes that ask for it.

        age: s, its age
        """
        inputs = self.mailboxes.get(message.topic.number)
        if inputs is None:
            return
        boxes = inputs.get(message.source, ())
        every = inputs.get(PORT_ADDRESSES.any_drone, ())
        if not boxes and not every:
            return
        try:
            value = message.open()
        except CodecError:
            self.counters.malformed += 1
            return
        for box in boxes:
            box.put(value, age)
        for box in every:
            box.put((message.source, value), age)

    def add_reader(self, interest: Interest, mailbox: AnyMailbox | None) -> None:
        """Give the topic to `interest.reader` from now on, and a latched value at once.

        mailbox: mailbox of an actor of this drone; None for another port

        A port is served once, at its fastest rate.
        """
        topic = TOPIC_BY_NAME[interest.topic]
        readers = self._readers.setdefault(topic.number, Readers())
        if mailbox is None:
            interval_ns = (
                round(NS_PER_SECOND / interest.rate) if interest.rate > 0 else 0
            )
            readers.add(
                interest.reader, interval_ns, READER_RATES.phase_step_ns * self.address
            )
        elif mailbox not in readers.mailboxes:
            readers.mailboxes.append(mailbox)
        self.bus.note_reader_change()
        latched = self.latched.find(topic, self._now_ns())
        if latched is None:
            return
        value, age = latched
        if mailbox is not None:
            mailbox.put(value, age)
        else:
            message = Message(topic, self.address, encode(value))
            self.send(message, (interest.reader,), age=age)

    def drop_readers(self, addresses: list[int]) -> None:
        """Remove the readers at these addresses."""
        for readers in self._readers.values():
            readers.drop(addresses)
        self.bus.note_reader_change()

    def _deliver_late(
        self, fate: MessageFate, message: Message, j: int, age: float
    ) -> None:
        """Deliver each copy of a message to drone j after its delay in the simulated network."""
        bus = self.bus
        now_ns = self._now_ns()
        for delay in fate.deliveries:
            if delay > 0.0:
                bus.clock.call_at(
                    now_ns + round(delay * NS_PER_SECOND),
                    bus.deliver,
                    message,
                    (j,),
                    age + delay,
                    priority=AlarmPriority.MESSAGE,
                    drone=j,
                )
            else:
                bus.deliver(message, (j,), age + delay)
