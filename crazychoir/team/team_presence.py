"""The presence of the team as one drone sees it: received heartbeats, and lost drones."""

from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import takewhile
from typing import Final, Protocol

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.message import Message
from crazychoir.bus.presence import (
    SILENCE_TIMEOUT,
    Presence,
    PresenceMonitor,
)
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import CodecError
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.close_drones import (
    DroneSearch,
    list_lowest,
    list_near,
    list_watched,
)
from crazychoir.team.messages import Roster, TeamHeartbeat
from crazychoir.team.strangers import SETTLE_TIME, Strangers
from crazychoir.team.team_roster import TeamRoster

PRESENCE_HISTORY: Final = 1000
"""Changes of presence that are kept in the history."""


@lru_cache(maxsize=2048)  # all drones of a process receive the same heartbeats
def _read_payload(payload: bytes) -> TeamHeartbeat:
    return TeamHeartbeat.of(decode(payload))


class PresenceReview(Protocol):
    """Acts on heartbeats and losses of other drones while this drone is the coordinator."""

    held_for: int
    """Epoch for which this drone holds its rounds, as another drone has asked; 0 if it does not."""

    @property
    def is_open(self) -> bool:
        """True while the coordinator forms the next roster."""
        ...

    def review(self, source: int, beat: TeamHeartbeat, roster: Roster) -> None:
        """Act on a heartbeat of another drone."""
        ...

    def review_loss(self, j: int, roster: Roster) -> None:
        """Act on the loss of drone j."""
        ...


class TeamPresence:
    """Sends this drone's heartbeats, and tracks which other drones are present.

    A drone watches its neighbours and the coordinator. While it has no coordinator it watches its
    neighbours and the lowest ids instead, and drones that it finds among the others (`_seek`). The
    coordinator watches all.

    rosters: the roster in force at this drone
    agreed_keys: keys of the swarm file with digits of their own in the mission hash
    lost_after: seconds of silence after which a drone is LOST

    Attributes:
    beats: {drone id: its newest heartbeat}
    came_at: {drone id: s: time of the first heartbeat of its present process}
    history: the newest changes of presence, as (seconds, id, presence)
    refused: reason why this drone cannot fly; the others receive it and do not wait for this drone
    refusals: {drone id: reason why it cannot fly}
    lost: lost drones (a dict, to keep their order)
    strangers: drones with another swarm file or mission
    monitor: sends the heartbeats, and watches for silence
    """

    def __init__(
        self,
        rosters: TeamRoster,
        agreed_keys: Sequence[str] = (),
        lost_after: float = 5.0,
    ) -> None:
        port = rosters.port
        graph = rosters.graph
        self.rosters = rosters
        self.port = port
        self.id = port.address
        self.beats: dict[int, TeamHeartbeat] = {}
        self.came_at: dict[int, float] = {}
        self.history: list[tuple[float, int, str]] = []
        self.refused = ""
        self.refusals: dict[int, str] = {}
        self.lost: dict[int, None] = {}
        self._search = DroneSearch(graph.ids)
        search_time = self._search.count_turns() / MESSAGE_TOPICS.heartbeat.rate
        self.strangers = Strangers(
            port.bus.clock,
            self.id,
            len(graph.ids),
            rosters.mission_hash,
            agreed_keys,
            SETTLE_TIME + search_time,
        )
        self._review: PresenceReview | None = None
        self._led_by = -1  # id of the coordinator when the watched drones were chosen
        self._sent: tuple[TeamHeartbeat | None, bytes] = (None, b"")
        self.monitor = PresenceMonitor(
            port,
            list_near(graph, self.id, *list_lowest(graph.ids)),
            self._encode_heartbeat,
            lost_after,
            self._seek,
            rosters.has_member,
        )
        self.monitor.listeners.append(self._handle_change)
        rosters.listeners.append(self._handle_roster)
        port.handlers[MESSAGE_TOPICS.heartbeat.number] = self._handle_heartbeat

    def attach(self, review: PresenceReview) -> None:
        """Call `review` for heartbeats and losses while this drone is the coordinator."""
        self._review = review

    @property
    def others(self) -> tuple[int, ...]:
        """The other drones of the swarm, increasing."""
        return tuple(j for j in self.rosters.graph.ids if j != self.id)

    def is_lost(self, j: int) -> bool:
        """Return True if j is LOST or has left."""
        roster = self.rosters.roster
        return j in self.lost or (roster is not None and j not in roster.members)

    def is_present(self, j: int) -> bool:
        """Return True if drone j sends heartbeats and is not lost."""
        return (
            j in self.beats
            and self.monitor.state(j) in (Presence.ALIVE, Presence.SUSPECT)
            and j not in self.lost
        )

    def is_silent(self, j: int) -> bool:
        """Return True if drone j was not heard in the last SILENCE_TIMEOUT seconds."""
        heard_ns = self.monitor.find_heard_ns(j)
        return (
            heard_ns is None
            or self.port.bus.clock.now_ns() - heard_ns
            >= SILENCE_TIMEOUT * NS_PER_SECOND
        )

    def coordinator(self) -> int:
        """Return the lowest live id among the drones in an epoch.

        Before the first epoch, all drones count.
        """
        roster = self.rosters.roster
        if roster is None:
            live = [j for j in self.beats if self.is_present(j)]
            return min([j for j in live if self.beats[j].epoch] or [self.id, *live])
        # A member that has not adopted the roster until it is settled never will.
        is_settling = self.port.bus.clock.now_ns() < self.rosters.settled_ns
        known = roster.members if is_settling else {}
        return next(
            (
                j
                for j in self._list_lower()
                if self.beats[j].epoch or self.beats[j].incarnation == known.get(j)
            ),
            self.id,
        )

    def _list_lower(self) -> Iterator[int]:
        """Return the present drones with a lower id, increasing."""
        lower = takewhile(self.id.__gt__, self.rosters.graph.ids)
        return filter(self.is_present, lower)

    def mark_lost(self, gone: Iterable[int]) -> None:
        """Count these drones as lost."""
        self.lost.update(dict.fromkeys(gone))

    def mark_found(self, j: int) -> None:
        """No longer count drone j as lost."""
        self.lost.pop(j, None)

    def review_all(self) -> None:
        """Check the next heartbeat of every drone again, even if it has not changed."""
        self.port.ignored_beats.clear()

    # Heartbeats -----------------------------------------------------------------------

    def _encode_heartbeat(self) -> bytes:
        """Return the payload of this drone's heartbeat."""
        roster = self.rosters.roster
        mission_hash = self.rosters.mission_hash
        if roster is None:
            epoch = 0
            hears = tuple(j for j in self.monitor.watched if self.is_present(j))
        else:
            epoch = roster.epoch
            hears = ()
            mission_hash = mission_hash.partition(":")[0]
        beat = TeamHeartbeat(
            self.port.incarnation,
            epoch,
            self.rosters.checksum,
            hears,
            tuple(self.lost),
            mission_hash,
            self.refused,
            self._review.held_for if self._review is not None else 0,
        )
        if beat != self._sent[0]:
            self._sent = (beat, encode(beat.wire()))
        return self._sent[1]

    def _handle_heartbeat(self, message: Message, age: float) -> None:
        """Take a heartbeat of another drone."""
        source = message.source
        payload = message.payload
        if self.port.ignored_beats.get(source) == payload:
            return  # the heartbeat is unchanged since a check that found nothing to do
        try:
            beat = _read_payload(payload)
        except (CodecError, TypeError, ValueError):
            self.port.counters.malformed += 1
            return
        is_ours = source != self.id and source in self.rosters.graph.members
        if self.strangers.heard(source, beat.mission_hash) or not is_ours:
            return
        if beat.refused:
            self.refusals[source] = beat.refused.removeprefix(f"drone {source}: ")
            if self.rosters.roster is None:
                self.beats.pop(source, None)
            return
        self.refusals.pop(source, None)
        if not self._may_matter(source, beat):
            return
        self._take_heartbeat(source, beat)
        is_agreed = (
            beat.epoch > 0
            and beat.checksum == self.rosters.checksum
            and source in self.monitor.watched
        )
        is_forming = self._review is not None and self._review.is_open
        if is_agreed and not (beat.lost or self.lost or is_forming):
            self.port.ignored_beats[source] = payload

    def _may_matter(self, source: int, beat: TeamHeartbeat) -> bool:
        """Return False for a heartbeat that only shows, before the start, that a drone is there.

        Then the coordinator keeps it. Any other drone needs its neighbours, the lower ids and the
        drones that have started, and it would be too much if each drone kept all others.
        """
        if self.rosters.roster is not None or beat.epoch or source in self.beats:
            return True
        lowest = next(self._list_lower(), self.id)
        return lowest == self.id or source < lowest or source in self.monitor.watched

    def _take_heartbeat(self, source: int, beat: TeamHeartbeat) -> None:
        """Store a heartbeat of a drone of this mission, and act on it as the coordinator."""
        roster = self.rosters.roster
        clock = self.port.bus.clock
        known = self.beats.get(source)
        self.beats[source] = beat
        if known is None or known.incarnation != beat.incarnation:
            self.came_at[source] = clock.now()
            if roster is not None and source == roster.ids[0]:
                self._watch()
        is_settled = roster is None or clock.now_ns() > self.rosters.settled_ns
        if is_settled and source not in self.monitor.watched:
            # It sends us heartbeats because it watches or seeks us: send ours in return.
            self.monitor.watched += (source,)
        if roster is None or self._review is None:
            return
        is_theirs = bool(beat.epoch) and source < self.id
        if not is_theirs and self.coordinator() == self.id:
            self._review.review(source, beat, roster)

    # Presence -------------------------------------------------------------------------

    def _handle_change(self, j: int, state: Presence) -> None:
        """React to a new presence of drone j."""
        self.history.append((self.port.bus.clock.now(), j, state.value))
        del self.history[:-PRESENCE_HISTORY]
        if state is Presence.LOST:
            self.lost[j] = None
            roster = self.rosters.roster
            if (
                roster is not None
                and self._review is not None
                and self.coordinator() == self.id
            ):
                self._review.review_loss(j, roster)
            self.review_all()
        elif state is Presence.ALIVE and j in self.lost:
            del self.lost[j]
            self.review_all()
        self._watch()

    def _handle_roster(self, roster: Roster) -> None:
        """Forget the heartbeats of drones that have left, and losses that this roster ends."""
        before = self.rosters.former_members
        neighbors = self.rosters.graph.neighbors(self.id)
        self.came_at.clear()
        for j in [j for j in self.beats if j not in roster.members]:
            del self.beats[j]
        for j in [j for j in self.lost if j in roster.members]:
            if roster.members[j] != before.get(j) or j not in neighbors:
                del self.lost[j]  # the coordinator has received it
        self.review_all()
        self._watch()

    def _watch(self) -> None:
        """Choose the drones that this drone monitors after the start: the coordinator watches all."""
        roster = self.rosters.roster
        if roster is None:
            self.review_all()
            return
        coordinator = self.coordinator()
        is_led = self.monitor.state(roster.ids[0]) is Presence.ALIVE
        watched = list_watched(
            self.rosters.graph, roster.ids, self.id, coordinator if is_led else -1
        )
        if coordinator == self.id:
            watched = self.others
        if watched != self.monitor.watched or coordinator != self._led_by:
            self.monitor.watched = watched
            self._led_by = coordinator
            self.review_all()

    def _seek(self) -> tuple[int, ...]:
        """Return the further drones to which the next heartbeat before the start goes.

        A drone that cannot fly tells all. A drone goes through all others in turn if it sees no
        coordinator among the lowest ids, or if it has met strangers and must count them.
        """
        ids = self.rosters.graph.ids
        is_started = self.rosters.roster is not None
        if is_started or len(self.monitor.watched) == len(ids) - 1:
            return ()
        known = {*self.monitor.watched, self.id}
        if self.refused:
            return tuple(j for j in ids if j not in known)
        lowest = next(self._list_lower(), self.id)
        is_led = lowest < self.id and lowest in list_lowest(ids)
        if is_led and not self.strangers.missions:
            return ()
        return tuple(j for j in self._search.take_turn() if j not in known)
