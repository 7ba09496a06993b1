"""The start barrier of a team, and the epochs that follow when members join or leave.

Every heartbeat contains the sender's incarnation and the drones that it receives. The lowest live
id is the coordinator. It issues GO(roster) as soon as all members are present and each edge works
in both directions, or, at the start deadline, when enough are present.

A member that is LOST or joins begins a new epoch in two steps. The coordinator asks the remaining
members to hold their rounds (HOLD). Each answers with the first round that it has not sent (HELD).
The new roster counts from a round that no member has reached. A newer epoch wins.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Final, Literal

import msgspec

from crazychoir.bus.codec import decode, encode
from crazychoir.bus.port import Port
from crazychoir.bus.presence import SILENCE_TIMEOUT, Presence, PresenceMonitor
from crazychoir.bus.reliable import Reliable
from crazychoir.bus.topics import MESSAGE_TOPICS
from crazychoir.errors import CodecError, Refused
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.graph import Graph
from crazychoir.team.messages import GoMessage, Roster, TeamHeartbeat
from crazychoir.team.strangers import Strangers

__all__ = ["Barrier", "Roster", "TeamHeartbeat"]

BARRIER_POLL_INTERVAL: Final = 0.02  # s
PRESENCE_HISTORY: Final = 1000
"""Changes of presence that are kept in the history."""


@lru_cache(maxsize=2048)  # all drones of a process receive the same heartbeats
def _read_payload(payload: bytes) -> TeamHeartbeat:
    return TeamHeartbeat.of(decode(payload))


class Barrier:
    """One drone's part in forming and keeping the team.

    Also tells the communicator which drones are lost.
    agreed_keys: keys of the swarm file that the mission hash holds one by one
    start: "all", or the number of drones that suffice at the deadline
    start_deadline: seconds to wait for the team
    lost_after: seconds of silence after which a drone is LOST

    Attributes:
    roster: the present roster; None before GO
    beats: {drone id: its newest heartbeat}
    hold: callable that holds the rounds until the next epoch and returns the first held round;
        `Communicator.follow` sets it, and it returns 0 for a drone without exchanges
    listeners: callables that get each new roster
    history: the newest changes of presence, as (seconds, id, presence)
    refused: reason why this drone cannot fly; the others receive it and do not wait for this drone
    apart: text with the parts of the graph that cannot reach each other, if the graph of the whole
        swarm has fewer parts; else empty
    """

    def __init__(
        self,
        port: Port,
        graph: Graph,
        *,
        mission_hash: str,
        version: str,
        agreed_keys: Sequence[str] = (),
        seed: int = 0,
        start: int | Literal["all"] = "all",
        start_deadline: float = 30.0,
        lost_after: float = 5.0,
    ) -> None:
        self.port = port
        self.graph = graph
        self.mission_hash = mission_hash
        self.version = version
        self.seed = seed
        self.start = start
        self.start_deadline = start_deadline
        self.id = port.address
        self.roster: Roster | None = None
        self.beats: dict[int, TeamHeartbeat] = {}
        self.hold: Callable[[], int] = lambda: 0
        self.listeners: list[Callable[[Roster], None]] = []
        self.history: list[tuple[float, int, str]] = []
        self.refused = ""
        self.apart = ""
        self._refusals: dict[int, str] = {}
        self._others = tuple(j for j in graph.ids if j != self.id)
        self._known = frozenset(self._others)
        self._came: dict[int, float] = {}
        self._lost: dict[int, None] = {}
        self._strangers = Strangers(
            port.bus.clock, self.id, len(graph.ids), mission_hash, agreed_keys
        )
        self._checksum = 0
        self._calm: dict[int, bytes] = {}
        self._settled_ns = 0
        self._next: dict[int, int] = {}
        self._held: dict[int, int] = {}
        self._halves: dict[int, int] = {}
        self._give_up_ns = 0
        self._target = 0
        self._beaten: tuple[TeamHeartbeat | None, bytes] = (None, b"")
        self.monitor = PresenceMonitor(port, self._others, self._beat, lost_after)
        self.monitor.listeners.append(self._changed)
        self.reliable = Reliable(port)
        self.reliable.listen(MESSAGE_TOPICS.roster, self._told)
        port.handlers[MESSAGE_TOPICS.heartbeat.number] = self._heard

    @property
    def absent(self) -> tuple[int, ...]:
        """Drones of the mission that are not in the team."""
        here = self.roster.members if self.roster is not None else {}
        return tuple(j for j in self.graph.ids if j not in here)

    def lost(self, j: int) -> bool:
        """Return True if j is LOST or has left."""
        return j in self._lost or (
            self.roster is not None and j not in self.roster.members
        )

    def coordinator(self) -> int:
        """Return the lowest live id among the drones in an epoch.

        Before the first epoch, all drones count.
        """
        if self.roster is None:
            live = [j for j in self._others if self._present(j)]
            return min([j for j in live if self.beats[j].epoch] or [self.id, *live])
        settling = self.port.bus.clock.now_ns() < self._settled_ns
        known = (
            self.roster.members if settling else {}
        )  # a member that has not adopted the roster by then never will
        lower = (j for j in self._others if j < self.id and self._present(j))
        return next(
            (
                j
                for j in lower
                if self.beats[j].epoch or self.beats[j].incarnation == known.get(j)
            ),
            self.id,
        )

    async def go(self) -> Roster:
        """Wait for GO and return the roster.

        A coordinator that appeared late gets the full start deadline from its arrival on.
        Raises Refused at the deadline, with the absent drones, or if this drone's mission is
        another one. Raises it at once, with the reasons, if too many drones report that they cannot
        fly.
        """
        clock = self.port.bus.clock
        ends = clock.now() + self.start_deadline
        while self.roster is None:
            if self._strangers.are_more(self.beats):
                raise Refused(f"drone {self.id}", self._strangers.text())
            if len(self.graph.ids) - len(self._refusals) < self._fewest:
                raise Refused(
                    f"drone {self.id}",
                    f"{self._refusals_text()} Correct that, or {self._fewer_text()}.",
                )
            first = self.coordinator()
            if first == self.id:
                self._coordinate(clock.now() >= ends)
            patient = max(ends, self._came.get(first, 0.0) + self.start_deadline) + 1.0
            if clock.now() > patient and self.roster is None:
                raise Refused(f"drone {self.id}", self._absent_text())
            await clock.sleep(BARRIER_POLL_INTERVAL, drone=self.id)
        return self.roster

    # Forming --------------------------------------------------------------------------

    def _coordinate(self, late: bool) -> None:
        """Issue the first roster if enough drones are present and all edges work.

        late: True after the start deadline
        """
        members = [j for j in self.graph.ids if j == self.id or self._present(j)]
        enough = len(members) == len(self.graph.ids) or (
            late and self.start != "all" and len(members) >= self.start
        )
        if enough and not self._deaf(members):
            self._issue(self._incarnations(members), 1, 0)

    def _deaf(self, members: list[int]) -> list[tuple[int, int]]:
        """Return the pairs (i, j) where i should receive j but does not.

        Each drone must receive its in-neighbours and the coordinator, and the coordinator must
        receive every member.
        """
        hears = {j: self.beats[j].hears for j in members if j != self.id} | {
            self.id: tuple(self.beats)
        }
        first = self.coordinator()
        inside = self._restricted(members)
        needed = {
            i: dict.fromkeys(
                (*inside.in_neighbors(i), *((first,) if i != first else members))
            )
            for i in members
        }
        return [
            (i, j) for i in members for j in needed[i] if j != i and j not in hears[i]
        ]

    def _incarnations(self, members: list[int]) -> dict[int, int]:
        return {
            j: self.port.incarnation if j == self.id else self.beats[j].incarnation
            for j in members
        }

    def _restricted(self, members: list[int]) -> Graph:
        arcs = [
            arc for arc in self.graph.arcs if arc[0] in members and arc[1] in members
        ]
        return Graph.from_edges(tuple(members), arcs, directed=True)

    def _issue(self, members: dict[int, int], epoch: int, first_round: int) -> None:
        """Send a roster to its members, and adopt it."""
        graph = self._restricted(sorted(members))
        directed = not graph.is_undirected
        edges = [list(arc) for arc in (graph.arcs if directed else graph.edges())]
        roster = Roster(
            epoch,
            members,
            edges,
            directed,
            self.seed,
            first_round,
            self.mission_hash,
            self.version,
        )
        for j in members:
            if j != self.id:
                self._tell(j, roster)
        self._adopt(roster)

    def _tell(self, j: int, roster: Roster) -> None:
        bus = self.port.bus
        self.reliable.send(
            MESSAGE_TOPICS.roster,
            j,
            GoMessage(roster, bus.impairment.age(bus.clock.now())).wire(),
        )

    def _told(self, source: int, payload: bytes) -> None:
        """Handle a message on ROSTER.

        It is a roster (GO), [epoch] (HOLD), or [epoch, first held round, members of the sender's
        roster as id, incarnation, id, incarnation, ...] (HELD).
        """
        try:
            told = msgspec.convert(decode(payload), GoMessage | list[int])
        except (CodecError, msgspec.ValidationError):
            self.port.counters.malformed += 1
            return
        epoch = self.roster.epoch if self.roster is not None else 0
        if isinstance(told, GoMessage):
            roster = told.roster
            ours = (
                roster.mission_hash == self.mission_hash
                and roster.members.get(self.id) == self.port.incarnation
            )
            if ours and roster.epoch > epoch:
                self._adopt(roster, told.age)
        elif len(told) == 1 and told[0] > epoch:
            self._asked(source, told[0])
        elif len(told) >= 2 and told[0] == self._target and self._next:
            self._holds(
                source, told[1], dict(zip(told[2::2], told[3::2], strict=False))
            )

    def _asked(self, source: int, target: int) -> None:
        """Answer a HOLD request with the first round that we hold.

        If the sender has the lower id it coordinates, so drop our proposal. If it has the higher id
        and we coordinate, ignore the request: it will receive ours.
        """
        if source < self.id:
            self._next = {}
        elif self.coordinator() == self.id:
            return
        members = self.roster.members if self.roster is not None else {}
        self.reliable.send(
            MESSAGE_TOPICS.roster,
            source,
            encode(
                [target, self.hold(), *(n for pair in members.items() for n in pair)]
            ),
        )

    def _adopt(self, roster: Roster, age: float = 0.0) -> None:
        """Put a roster in force at this drone.

        age: seconds since GO
        """
        self.port.bus.impairment.begin(self.port.bus.clock.now(), age)
        before = self.roster.members if self.roster is not None else {}
        for j in self._others:
            if j not in roster.members:
                self.beats.pop(j, None)
            elif roster.members[j] != before.get(j) or j not in self.graph.neighbors(
                self.id
            ):
                self._lost.pop(j, None)  # the coordinator has heard from it
        self.roster = roster
        self._checksum = roster.checksum
        parts = roster.graph.parts()
        said = " | ".join(" ".join(map(str, part)) for part in parts)
        self.apart = (
            f"graph in {len(parts)} parts: {said}"
            if len(parts) > len(self.graph.parts())
            else ""
        )
        self._next = {}
        self._held = {}
        self._halves = {}
        self._target = 0
        self._settled_ns = self.port.bus.clock.now_ns() + int(
            SILENCE_TIMEOUT * NS_PER_SECOND
        )  # until then the others adopt the roster and begin to watch fewer drones
        for listener in self.listeners:
            listener(roster)
        self._watch()

    def _watch(self) -> None:
        """Choose the drones that this drone monitors after the start.

        The coordinator watches all. The others watch their neighbours and the coordinator, or all
        drones if the coordinator is silent.
        """
        self._calm.clear()
        if self.roster is None:
            return
        first = self.roster.ids[0]
        alive = self.monitor.state(first) is Presence.ALIVE
        calm = (
            first != self.id and alive and self.coordinator() == first
        )  # a restarted coordinator may have no team
        near = {*self.graph.neighbors(self.id), first} - {self.id}
        self.monitor.watched = tuple(sorted(near)) if calm else self._others

    # Keeping --------------------------------------------------------------------------

    def _beat(self) -> bytes:
        """Return the payload of this drone's heartbeat."""
        epoch = self.roster.epoch if self.roster else 0
        hears = (
            ()
            if self.roster
            else tuple(j for j in self.monitor.watched if self._present(j))
        )
        mission = (
            self.mission_hash.partition(":")[0] if self.roster else self.mission_hash
        )
        lost = tuple(self._lost)
        texts = (mission, self.refused)
        beat = TeamHeartbeat(
            self.port.incarnation, epoch, self._checksum, hears, lost, *texts
        )
        if beat != self._beaten[0]:
            self._beaten = beat, encode(beat.wire())
        return self._beaten[1]

    def _heard(
        self,
        source: int,
        payload: bytes,
        number: int,
        channel: str,
        flags: int,
        age: float,
    ) -> None:
        """Take a heartbeat of another drone."""
        if self._calm.get(source) == payload:
            return  # the heartbeat is unchanged since a check that found nothing to do
        try:
            beat = _read_payload(payload)
        except (CodecError, TypeError, ValueError):
            self.port.counters.malformed += 1
            return
        if (
            not self._strangers.heard(source, beat.mission_hash)
            and source in self._known
        ):
            if beat.refused:
                self._refusals[source] = beat.refused.removeprefix(f"drone {source}: ")
                if self.roster is None:
                    self.beats.pop(source, None)
                return
            self._refusals.pop(source, None)
            known = self.beats.get(source)
            self.beats[source] = beat
            if known is None or known.incarnation != beat.incarnation:
                self._came[source] = self.port.bus.clock.now()
                if self.roster is not None and source == self.roster.ids[0]:
                    self._watch()
            if (
                source not in self.monitor.watched
                and self.port.bus.clock.now_ns() > self._settled_ns
            ):
                # It sends us heartbeats because it watches us: send ours in return.
                self.monitor.watched += (source,)
            theirs = bool(beat.epoch) and source < self.id
            if self.roster is not None and not theirs and self.coordinator() == self.id:
                self._review(source, beat, self.roster)
            agreed = (
                beat.epoch > 0
                and beat.checksum == self._checksum
                and source in self.monitor.watched
            )
            if agreed and not (beat.lost or self._lost or self._next):
                self._calm[source] = payload

    def _review(self, source: int, beat: TeamHeartbeat, roster: Roster) -> None:
        """Act, as the coordinator, on a heartbeat: a lost member, a
        new or restarted one, or a wrong roster.
        """
        members = self._next or roster.members
        if dead := self._dead((*beat.lost, *self._lost), roster):
            self._without(dead, roster)
        elif members.get(source) != beat.incarnation:
            self._lost.pop(source, None)
            self._propose({**members, source: beat.incarnation}, roster)
        elif self._next and beat.epoch >= self._target:
            self._propose(
                dict(self._next), roster
            )  # it followed another coordinator while we did not receive it
        elif self._next and source not in self._held and beat.epoch:
            self.reliable.send(MESSAGE_TOPICS.roster, source, encode([self._target]))
        elif self._next:
            return
        elif beat.epoch < roster.epoch:
            self._tell(source, roster)
        elif beat.epoch > roster.epoch or beat.checksum != self._checksum:
            self._propose(
                dict(members), roster
            )  # two coordinators that did not receive each other have both issued rosters

    def _changed(self, j: int, state: Presence) -> None:
        """React to a new presence of drone j."""
        self.history.append((self.port.bus.clock.now(), j, state.value))
        del self.history[:-PRESENCE_HISTORY]
        roster = self.roster
        if state is Presence.LOST:
            self._lost[j] = None
            if roster is not None and self.coordinator() == self.id:
                dead = self._dead(
                    self._lost, roster
                )  # includes drones that were lost while another drone coordinated
                if dead or j in (self._next or roster.members):
                    self._without([j, *dead], roster)
        elif state is Presence.ALIVE:
            self._lost.pop(j, None)
        self._watch()

    def _dead(self, lost: Iterable[int], roster: Roster) -> list[int]:
        """Return the members of the next roster that are reported
        lost and that we do not receive either.
        """
        members = self._next or roster.members
        return [j for j in lost if j in members and j != self.id and not self._alive(j)]

    def _without(self, gone: list[int], roster: Roster) -> None:
        """Propose a roster without these members."""
        self._lost.update(dict.fromkeys(gone))
        members = self._next or roster.members
        self._propose(
            {j: incarnation for j, incarnation in members.items() if j not in gone},
            roster,
        )

    def _propose(self, members: dict[int, int], roster: Roster) -> None:
        """Propose the members of the next roster: ask the
        drones in an epoch to hold their rounds.
        """
        self._calm.clear()
        self._next = dict(sorted(members.items()))
        epochs = [self.beats[j].epoch for j in members if j in self.beats]
        before = self._target
        self._target = max(
            [self._target, *(epoch + 1 for epoch in (roster.epoch, *epochs))]
        )
        if self._target > before:
            self._held = {}  # a drone that held for a lower epoch may have continued since
        self._held[self.id] = self.hold()
        clock = self.port.bus.clock
        self._give_up_ns = clock.now_ns() + int(self.monitor.lost_after * NS_PER_SECOND)
        clock.call_at(self._give_up_ns, self._give_up, drone=self.id)
        for j in self._running(roster):
            if j not in self._held:
                self.reliable.send(MESSAGE_TOPICS.roster, j, encode([self._target]))
        self._conclude()

    def _give_up(self) -> None:
        """Continue without the members that have not answered HOLD and are not received.

        The timeout is needed because there may be no other drone that sends anything.
        """
        roster = self.roster
        if (
            roster is not None
            and self._next
            and self.port.bus.clock.now_ns() >= self._give_up_ns
        ):
            waited = [j for j in self._running(roster) if j not in self._held]
            self._without(self._dead(waited, roster), roster)

    def _holds(self, source: int, first: int, theirs: dict[int, int]) -> None:
        """Store the answer of `source` to HOLD.

        A drone of another half of the team adds all of its half.
        """
        self._held[source] = first
        if self.roster is not None and source not in self.roster.members:
            new = {
                j: theirs[j]
                for j in theirs
                if j in self._others and j not in self._next
            }
            self._halves.update(new)
            for j in new:
                self._lost.pop(j, None)  # its own half still receives it
            if new:
                self._propose({**self._next, **new}, self.roster)
        self._conclude()

    def _running(self, roster: Roster) -> list[int]:
        """Return the members of the next roster that are in an
        epoch now, maybe in another half of the team.
        """
        known = {**self._halves, **roster.members}
        here = [
            j for j, incarnation in self._next.items() if known.get(j) == incarnation
        ]
        return here + [
            j
            for j in self._next
            if j not in here and j in self.beats and self.beats[j].epoch
        ]

    def _conclude(self) -> None:
        """Issue the next roster as soon as all running members hold their rounds.

        It counts from the highest held round + 1.
        """
        roster = self.roster
        if (
            roster is None
            or not self._next
            or any(j not in self._held for j in self._running(roster))
        ):
            return
        held = [self._held[j] + 1 for j in self._running(roster)]
        self._issue(self._next, self._target, max([roster.first_round, *held]))

    def _alive(self, j: int) -> bool:
        """Return True if a message of drone j came in the last SILENCE seconds."""
        heard_ns = self.port.heard_ns.get(j)
        return (
            heard_ns is not None
            and self.port.bus.clock.now_ns() - heard_ns
            < SILENCE_TIMEOUT * NS_PER_SECOND
        )

    def _present(self, j: int) -> bool:
        """Return True if drone j sends heartbeats and is not lost."""
        return (
            j in self.beats
            and self.monitor.state(j) in (Presence.ALIVE, Presence.SUSPECT)
            and j not in self._lost
        )

    @property
    def _fewest(self) -> int:
        """Number of drones that must be present."""
        return len(self.graph.ids) if self.start == "all" else self.start

    def _fewer_text(self) -> str:
        """Return the advice to fly with fewer drones."""
        do = "set start = n" if self.start == "all" else f"lower start = {self.start}"
        return f"{do} in the swarm file"

    def _refusals_text(self) -> str:
        """Return a text with the drones that cannot fly and their reasons."""
        return " ".join(
            f"drone {j} cannot fly: {why.rstrip('.')}."
            for j, why in sorted(self._refusals.items())
        )

    def _absent_text(self) -> str:
        """Return a text with the absent drones, the broken
        edges, the other missions, and what to do.
        """
        here = [j for j in self.graph.ids if j == self.id or self._present(j)]
        known = {*here, *self._strangers.missions, *self._refusals}
        absent = [j for j in self._others if j not in known]
        said = (
            [
                f"drone(s) {', '.join(map(str, absent))} absent after {self.start_deadline:g} s."
            ]
            if absent
            else []
        )
        said += [self._refusals_text()] if self._refusals else []
        said += [f"drone {i} does not hear drone {j}." for i, j in self._deaf(here)]
        said += [self._strangers.text()] if self._strangers.missions else []
        return " ".join(
            [
                *said,
                f"Start their agents, look at the network, or {self._fewer_text()}.",
            ]
        )
