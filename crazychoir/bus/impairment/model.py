"""A simulated bad network between drones: loss, bursts, delay,
jitter, duplicates, reordering, bandwidth, partitions.

A verdict is a pure function of (seed, source, destination, channel, number, attempt). Therefore it
does not depend on processes, scheduling or the order of calls. Only the queue of a limited
bandwidth depends on earlier messages.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any, NamedTuple

from crazychoir.bus.impairment.random_draws import (
    RANDOM_DRAWS,
    bad_states,
    draw,
    draw_key,
)
from crazychoir.bus.impairment.rules import (
    EdgeEffects,
    ImpairmentRule,
    NetworkPartition,
    apply_changes,
    effects_on_edge,
)


@dataclass(frozen=True, slots=True)
class ImpairmentDraws:
    """Constants of the draws of delays and duplicates."""

    half_range: int = 1 << 32
    """Half of a 64-bit draw: two draws of 32 bits."""
    delay_salt: int = 0x3C6EF372FE94F82B
    """Salt of the draws of delays."""
    duplicate_salt: int = 0xA54FF53A5F1D36F1
    """Salt of the draws of duplicates."""


IMPAIRMENT_DRAWS = ImpairmentDraws()


class MessageFate(NamedTuple):
    """The fate of a message."""

    deliveries: tuple[float, ...]
    """Seconds of delay for each copy that arrives; empty if the message is lost."""


@dataclass(slots=True)
class EdgeCounters:
    """Counts of the messages on one directed edge of a simulated network."""

    sent: int = 0
    """Messages that the network handled."""
    lost: int = 0
    """Lost messages, also by partitions and full queues."""
    duplicated: int = 0
    """Messages that arrived twice."""
    delayed: int = 0
    """Messages that arrived late."""


LOST_MESSAGE = MessageFate(())
"""The message is lost."""
UNDELAYED_MESSAGE = MessageFate((0.0,))
"""The message arrives without a delay."""


class Impairment:
    """The simulated network of one process.

    active: True if any rule or partition is set
    version: number of changes of the rules and partitions
    count_sources: functions that add what compiled laws have counted, called before counts are read
    began: time of GO on the clock of `now`; partitions count from it, and cut no message before
    """

    def __init__(
        self,
        seed: int,
        rules: Iterable[ImpairmentRule] = (),
        partitions: Iterable[NetworkPartition] = (),
    ) -> None:
        self.seed = seed
        self.began = inf
        self.version = 0
        self.count_sources: list[Callable[[], None]] = []
        self._counters: dict[tuple[int, int], EdgeCounters] = {}
        self.replace(rules, partitions)

    def replace(
        self,
        rules: Iterable[ImpairmentRule],
        partitions: Iterable[NetworkPartition] = (),
    ) -> None:
        """Use these rules and partitions and no others from now on; queues become empty."""
        self.rules = tuple(rules)
        self.partitions = tuple(partitions)
        self.active = bool(self.rules or self.partitions)
        self.version += 1
        self._edges: dict[tuple[int, int], _ImpairedEdge] = {}

    @property
    def counters(self) -> dict[tuple[int, int], EdgeCounters]:
        """Counts by (source, destination), since the start."""
        for count in self.count_sources:
            count()
        return self._counters

    def count(
        self,
        source: int,
        destination: int,
        sent: int,
        lost: int,
        delayed: int = 0,
        duplicated: int = 0,
    ) -> None:
        """Add messages that a compiled law has sent on an edge, and what became of them."""
        edge = self._counters.setdefault((source, destination), EdgeCounters())
        edge.sent += sent
        edge.lost += lost
        edge.delayed += delayed
        edge.duplicated += duplicated

    def update(self, changes: Mapping[str, Any]) -> None:
        """Change a rule, or the partitions.

            {"loss": 0.3}
            {"edge": [1, 2], "directed": true, "delay": 0.05}
            {"drone": 3, "loss": None}

        The named fields of the rule of that scope change; None unsets a field.
        {"clear": True} drops everything first.
        {"partitions": [{"since": 5, "until": 9, "a": [0, 1], "b": []}]} sets the partitions.
        {"cut": {"a": [2]}} adds one.
        Raises ConfigError, and then changes nothing.
        """
        self.replace(*apply_changes(self.rules, self.partitions, changes))

    def begin(self, now: float, age: float = 0.0) -> None:
        """Set the time of GO: the mission is `age` s old.

        Of several calls the oldest GO counts, because the other messages were longer on their way.
        """
        self.began = min(self.began, now - age)

    def age(self, now: float) -> float:
        """Return the seconds since GO; 0 before."""
        return max(0.0, now - self.began)

    def verdict(
        self,
        source: int,
        destination: int,
        channel: int | str,
        number: int,
        attempt: int,
        size: int,
        now: float,
    ) -> MessageFate:
        """Return the fate of a message of `size` bytes.

        now: seconds, sender's clock
        """
        edge = self._edges.get((source, destination)) or self._edge(source, destination)
        lane = edge.lanes.get(channel) or edge.lane(channel)
        counters = edge.counters
        counters.sent += 1
        wait = edge.wait(size, now, now - self.began) if edge.stateful else 0.0
        threshold = (
            edge.loss_bad if edge.bursty and lane.bad(number + attempt) else edge.loss
        )
        if wait < 0.0 or draw(lane.key, number, attempt) < threshold:
            counters.lost += 1
            return LOST_MESSAGE
        return (
            edge.late(lane.key, number, attempt, wait)
            if edge.slow
            else UNDELAYED_MESSAGE
        )

    def effects(self, source: int, destination: int) -> EdgeEffects:
        """Return the effects on an edge, without those of partitions."""
        return self._edge(source, destination).link

    def only_loses(self, source: int, destination: int) -> bool:
        """Return True if an edge loses some messages by draws, and changes no other."""
        edge = self._edge(source, destination)
        return not (edge.slow or edge.stateful)

    def draw_key(self, source: int, destination: int, channel: str) -> int:
        """Return the key of the draws of a channel of an edge."""
        edge = self._edge(source, destination)
        return (edge.lanes.get(channel) or edge.lane(channel)).key

    def describe(self) -> dict[str, Any]:
        """Return the settings in the terms of `update`, for people and for JSON."""
        return {
            "seed": self.seed,
            "rules": [rule.describe() for rule in self.rules],
            "partitions": [partition.describe() for partition in self.partitions],
        }

    def _edge(self, source: int, destination: int) -> "_ImpairedEdge":
        pair = (source, destination)
        if pair not in self._edges:
            cuts = tuple(
                (cut.since, cut.until)
                for cut in self.partitions
                if cut.cuts(source, destination)
            )
            counters = self._counters.setdefault(pair, EdgeCounters())
            link = effects_on_edge(self.rules, source, destination)
            self._edges[pair] = _ImpairedEdge(
                link,
                cuts,
                counters,
                lambda channel: draw_key(self.seed, source, destination, channel),
            )
        return self._edges[pair]


@dataclass(slots=True)
class _ChannelDraws:
    """One channel of an edge: its key, and the latest blocks of burst states."""

    key: int
    """Key of its draws."""
    link: EdgeEffects
    """Effects on the edge."""
    blocks: dict[int, bytes] = field(default_factory=dict)
    """{number of a block: its burst states, a byte each: 1 bad, 0 good}."""

    def bad(self, index: int) -> bool:
        number, place = divmod(index, RANDOM_DRAWS.block_size)
        states = self.blocks.get(number)
        if states is None:
            states = self._compute_block(number)
        return states[place] == 1

    def _compute_block(self, number: int) -> bytes:
        """Compute a block of burst states, and keep it in place of the oldest one.

        Several are kept, because asked and unasked messages have indices far from each other.
        """
        while len(self.blocks) >= RANDOM_DRAWS.kept_blocks:
            del self.blocks[next(iter(self.blocks))]
        states = self.blocks[number] = bad_states(
            self.key, number, self.link.p_good_bad, self.link.p_bad_good
        )
        return states


@dataclass(slots=True)
class _ImpairedEdge:
    """A directed edge: its link, with the probabilities as thresholds of draws."""

    link: EdgeEffects
    """Effects on the edge."""
    cuts: tuple[tuple[float, float], ...]
    """(since, until) of the partitions that cut it, in s since GO."""
    counters: EdgeCounters
    """Counts of its messages."""
    key_of: Callable[[int | str], int]
    """Callable that returns the key of a channel."""
    lanes: dict[int | str, _ChannelDraws] = field(default_factory=dict)
    """Its channels."""
    free_at: float = 0.0
    """s, sender's clock: time at which the bandwidth is free again."""
    loss: int = 0
    """Threshold of the draws that lose a message."""
    loss_bad: int = 0
    """Threshold of the draws that lose a message in the bad state of the burst chain."""
    bursty: bool = False
    """True if it has a burst chain."""
    slow: bool = False
    """True if messages may be late or doubled."""
    stateful: bool = False
    """True if a partition or a bandwidth acts on it."""
    affected: bool = False
    """True if there is any effect."""

    def __post_init__(self) -> None:
        link = self.link
        self.loss = round(link.loss * RANDOM_DRAWS.range_size)
        self.loss_bad = round(link.loss_bad * RANDOM_DRAWS.range_size)
        self.bursty = link.p_good_bad > 0.0
        self.stateful = bool(self.cuts) or link.bandwidth > 0.0
        self.slow = (
            max(link.delay, link.jitter, link.duplicate, link.reorder, link.bandwidth)
            > 0.0
        )
        self.affected = self.slow or self.stateful or self.bursty or self.loss > 0

    def lane(self, channel: int | str) -> _ChannelDraws:
        lane = self.lanes[channel] = _ChannelDraws(self.key_of(channel), self.link)
        return lane

    def wait(self, size: int, now: float, age: float) -> float:
        """Return the seconds until the last byte has left.

        The result is -1 if a partition or a full queue stops the message.
        """
        for since, until in self.cuts:
            if since <= age < until:
                return -1.0
        if self.link.bandwidth <= 0.0:
            return 0.0
        queued = max(self.free_at - now, 0.0)
        if queued > self.link.queue:
            return -1.0
        self.free_at = now + queued + size / self.link.bandwidth
        return self.free_at - now

    def late(self, lane: int, number: int, attempt: int, wait: float) -> MessageFate:
        """Return the delays of a message that arrives, and of its
        copy, by delay, jitter and reordering.
        """
        link = self.link
        delay = wait + link.delay
        if link.jitter > 0.0 or link.reorder > 0.0:
            first, second = divmod(
                draw(lane ^ IMPAIRMENT_DRAWS.delay_salt, number, attempt),
                IMPAIRMENT_DRAWS.half_range,
            )
            delay += link.jitter * (first / IMPAIRMENT_DRAWS.half_range)
            if second < link.reorder * IMPAIRMENT_DRAWS.half_range:
                delay += link.reorder_delay
        self.counters.delayed += delay > 0.0
        if link.duplicate <= 0.0:
            return MessageFate((delay,))
        first, second = divmod(
            draw(lane ^ IMPAIRMENT_DRAWS.duplicate_salt, number, attempt),
            IMPAIRMENT_DRAWS.half_range,
        )
        if first >= link.duplicate * IMPAIRMENT_DRAWS.half_range:
            return MessageFate((delay,))
        self.counters.duplicated += 1
        return MessageFate(
            (
                delay,
                wait
                + link.delay
                + link.jitter * (second / IMPAIRMENT_DRAWS.half_range),
            )
        )
