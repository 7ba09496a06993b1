"""The change to the next epoch of a team, when a member is lost or joins.

It takes two steps. The coordinator asks the remaining members to hold their rounds (HOLD). Each
answers with the first round that it has not sent. The new roster counts from a round that no member
has reached. A newer epoch wins.

A drone may drop its proposal, because it receives the roster of another coordinator. The drones that
hold for it tell so in their heartbeats, and the coordinator proposes another roster, which ends that.
"""

from collections.abc import Iterable
from typing import Protocol

from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.team.messages import HoldAnswer, HoldRequest, Roster, TeamHeartbeat
from crazychoir.team.team_presence import TeamPresence
from crazychoir.team.team_roster import TeamRoster


class HeldRounds(Protocol):
    """The rounds of a drone, as an epoch change needs them."""

    def hold(self) -> int:
        """Send no further round until the next epoch; return the first held round."""
        ...


class EpochChange:
    """Forms the next roster as the coordinator, and holds the rounds when another drone asks.

    rosters: the roster in force at this drone
    presence: which other drones are present

    Attributes:
    held_for: epoch for which this drone holds its rounds, as another drone has asked; 0 if it does not
    """

    def __init__(self, rosters: TeamRoster, presence: TeamPresence) -> None:
        self.rosters = rosters
        self.presence = presence
        self.id = presence.id
        self._rounds: HeldRounds | None = None
        self._next: dict[int, int] = {}
        """{drone id: incarnation} of the next roster; empty if none is formed."""
        self._target = 0
        """Number of the next roster."""
        self._held: dict[int, int] = {}
        """{drone id: its first held round} of the drones that have answered HOLD."""
        self._halves: dict[int, int] = {}
        """{drone id: incarnation} of the members of other halves of the team."""
        self._give_up_ns = 0
        """ns: time at which the drones that have not answered are given up."""
        self.held_for = 0
        rosters.listeners.append(self._end)
        presence.attach(self)

    @property
    def is_open(self) -> bool:
        """True while this drone forms the next roster."""
        return bool(self._next)

    def attach(self, rounds: HeldRounds) -> None:
        """Hold these rounds while an epoch changes."""
        self._rounds = rounds

    # What the coordinator finds -------------------------------------------------------

    def review(self, source: int, beat: TeamHeartbeat, roster: Roster) -> None:
        """Act, as the coordinator, on a heartbeat.

        It may show a lost member, a new or restarted one, or a wrong roster.
        source: id of the sender
        roster: the present roster
        """
        members = self._next or roster.members
        if dead := self._find_dead((*beat.lost, *self.presence.lost), roster):
            self._propose_without(dead, roster)
        elif members.get(source) != beat.incarnation:
            self.presence.mark_found(source)
            self._propose({**members, source: beat.incarnation}, roster)
        elif self._next:
            self._review_while_open(source, beat, roster)
        elif beat.epoch < roster.epoch:
            self.rosters.remind(source, roster)
        elif beat.epoch > roster.epoch or beat.checksum != self.rosters.checksum:
            # Two coordinators that did not receive each other have both issued rosters.
            self._propose(dict(members), roster)
        elif beat.held_for > roster.epoch:
            # It holds for a drone that has dropped its proposal.
            self._propose(dict(members), roster)

    def _review_while_open(
        self, source: int, beat: TeamHeartbeat, roster: Roster
    ) -> None:
        """Act on a heartbeat of a member of the next roster."""
        if beat.epoch >= self._target:
            # It followed another coordinator while we did not receive it.
            self._propose(dict(self._next), roster)
        elif source not in self._held and beat.epoch:
            self._ask_to_hold(source)

    def review_loss(self, j: int, roster: Roster) -> None:
        """Act, as the coordinator, on the loss of drone j.

        Drones that were lost while another drone coordinated leave with it.
        roster: the present roster
        """
        dead = self._find_dead(self.presence.lost, roster)
        if dead or j in (self._next or roster.members):
            self._propose_without([j, *dead], roster)

    def _find_dead(self, lost: Iterable[int], roster: Roster) -> list[int]:
        """Return the members that are reported lost and from which this drone hears nothing."""
        members = self._next or roster.members
        return [
            j
            for j in lost
            if j in members and j != self.id and self.presence.is_silent(j)
        ]

    # The proposal ---------------------------------------------------------------------

    def _propose_without(self, gone: list[int], roster: Roster) -> None:
        """Propose a roster without these members."""
        self.presence.mark_lost(gone)
        members = self._next or roster.members
        remaining = {j: n for j, n in members.items() if j not in gone}
        self._propose(remaining, roster)

    def _propose(self, members: dict[int, int], roster: Roster) -> None:
        """Propose the members of the next roster: ask the drones in an epoch to hold their rounds.

        members: {drone id: incarnation}
        roster: the present roster
        """
        presence = self.presence
        presence.review_all()
        self._next = dict(sorted(members.items()))
        epochs = [presence.beats[j].epoch for j in members if j in presence.beats]
        before = self._target
        self._target = max([before, *(epoch + 1 for epoch in (roster.epoch, *epochs))])
        if self._target > before:
            # A drone that held for a lower epoch may have continued since.
            self._held = {}
        self._held[self.id] = self._hold()
        clock = self.rosters.port.bus.clock
        patience_ns = int(presence.monitor.lost_after * NS_PER_SECOND)
        self._give_up_ns = clock.now_ns() + patience_ns
        clock.call_at(self._give_up_ns, self._give_up, drone=self.id)
        for j in self._list_running(roster):
            if j not in self._held:
                self._ask_to_hold(j)
        self._conclude()

    def _give_up(self) -> None:
        """Continue without the members that have not answered HOLD and are silent.

        Only a timer can trigger this: there may be no drone left that sends anything.
        """
        roster = self.rosters.roster
        now_ns = self.rosters.port.bus.clock.now_ns()
        if roster is not None and self._next and now_ns >= self._give_up_ns:
            waited = [j for j in self._list_running(roster) if j not in self._held]
            self._propose_without(self._find_dead(waited, roster), roster)

    def _list_running(self, roster: Roster) -> list[int]:
        """Return the members of the next roster that are in an epoch now.

        It may be the epoch of another part of a divided team.
        """
        beats = self.presence.beats
        known = {**self._halves, **roster.members}
        here = [j for j, n in self._next.items() if known.get(j) == n]
        elsewhere = [
            j for j in self._next if j not in here and j in beats and beats[j].epoch
        ]
        return here + elsewhere

    def _conclude(self) -> None:
        """Issue the next roster as soon as all running members hold their rounds.

        It counts from the highest held round + 1.
        """
        roster = self.rosters.roster
        if roster is None or not self._next:
            return
        running = self._list_running(roster)
        if all(j in self._held for j in running):
            free = [self._held[j] + 1 for j in running]
            first_round = max([roster.first_round, *free])
            self.rosters.issue(self._next, self._target, first_round)

    def _end(self, roster: Roster) -> None:
        """Drop the proposal: a roster is in force."""
        self._next = {}
        self._held = {}
        self._halves = {}
        self._target = 0
        self.held_for = 0

    # HOLD -----------------------------------------------------------------------------

    def _ask_to_hold(self, j: int) -> None:
        """Ask drone j to hold its rounds."""
        self.rosters.send_message(j, HoldRequest(self._target))

    def _hold(self) -> int:
        """Hold our rounds and return the first held round; 0 for a drone without rounds."""
        return self._rounds.hold() if self._rounds is not None else 0

    def answer(self, source: int, request: HoldRequest) -> None:
        """Hold our rounds for another coordinator, and answer with the first held round.

        A sender with a lower id takes precedence: drop our own proposal. A sender with a higher id
        is ignored while this drone is the coordinator: it will receive our request.
        """
        roster = self.rosters.roster
        if request.epoch <= self.rosters.epoch:
            return
        if source < self.id:
            self._next = {}
        elif self.presence.coordinator() == self.id:
            return
        self.held_for = request.epoch
        members = roster.members if roster is not None else {}
        answer = HoldAnswer(request.epoch, self._hold(), members)
        self.rosters.send_message(source, answer)

    def take_answer(self, source: int, answer: HoldAnswer) -> None:
        """Store the answer of `source` to HOLD.

        If `source` has another roster, because the team was divided, all members of that roster
        join the proposal.
        """
        if answer.epoch != self._target or not self._next:
            return
        self._held[source] = answer.first_held_round
        roster = self.rosters.roster
        if roster is not None and source not in roster.members:
            self._add_half(answer.members, roster)
        self._conclude()

    def _add_half(self, members: dict[int, int], roster: Roster) -> None:
        """Extend the proposed roster by the members of another part of a divided team."""
        new = {
            j: members[j]
            for j in members
            if j in self.presence.others and j not in self._next
        }
        self._halves.update(new)
        for j in new:
            self.presence.mark_found(j)  # its own half still receives it
        if new:
            self._propose({**self._next, **new}, roster)
