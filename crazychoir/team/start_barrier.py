"""The start of a team: GO as soon as the drones are present and receive each other."""

from collections.abc import Container
from typing import Final, Literal

from crazychoir.errors import Refused
from crazychoir.team.messages import Roster
from crazychoir.team.team_presence import TeamPresence
from crazychoir.team.team_roster import TeamRoster

BARRIER_POLL_INTERVAL: Final = 0.02  # s


class StartBarrier:
    """Waits for the first roster, and issues it as the coordinator.

    rosters: the roster in force at this drone
    presence: which other drones are present
    start: "all", or the number of present drones with which the team starts at the deadline
    start_deadline: seconds to wait for the team
    """

    def __init__(
        self,
        rosters: TeamRoster,
        presence: TeamPresence,
        start: int | Literal["all"],
        start_deadline: float,
    ) -> None:
        self.rosters = rosters
        self.presence = presence
        self.start = start
        self.start_deadline = start_deadline
        self.id = presence.id
        self.ids = rosters.graph.ids

    async def go(self) -> Roster:
        """Wait for GO and return the roster.

        A coordinator that appeared late gets the full start deadline from its arrival on.
        Raises Refused at the deadline, with the absent drones, or if this drone's mission is
        another one. Raises it at once, with the reasons, if too many drones report that they cannot
        fly.
        """
        clock = self.rosters.port.bus.clock
        ends = clock.now() + self.start_deadline
        while self.rosters.roster is None:
            self._refuse_hopeless_start()
            first = self.presence.coordinator()
            if first == self.id:
                self._coordinate(clock.now() >= ends)
            came_at = self.presence.came_at.get(first, 0.0)
            patient = max(ends, came_at + self.start_deadline) + 1.0
            if clock.now() > patient and self.rosters.roster is None:
                raise Refused(f"drone {self.id}", self._absent_text())
            await clock.sleep(BARRIER_POLL_INTERVAL, drone=self.id)
        return self.rosters.roster

    def _refuse_hopeless_start(self) -> None:
        """Raise Refused if this drone's mission is another one, or too many drones cannot fly."""
        strangers = self.presence.strangers
        if strangers.are_more(self.presence.beats):
            raise Refused(f"drone {self.id}", strangers.text())
        fewest = len(self.ids) if self.start == "all" else self.start
        if len(self.ids) - len(self.presence.refusals) < fewest:
            raise Refused(
                f"drone {self.id}",
                f"{self._refusals_text()} Correct that, or {self._fewer_text()}.",
            )

    def _coordinate(self, is_late: bool) -> None:
        """Issue the first roster if enough drones are present and all edges work.

        is_late: True after the start deadline
        """
        members = self._list_present()
        is_enough = len(members) == len(self.ids) or (
            is_late and self.start != "all" and len(members) >= self.start
        )
        if is_enough and not self._find_deaf(members):
            self.rosters.issue(self._find_incarnations(members), 1, 0)

    def _list_present(self) -> list[int]:
        """Return the drones that are present, this drone included."""
        return [j for j in self.ids if j == self.id or self.presence.is_present(j)]

    def _find_incarnations(self, members: list[int]) -> dict[int, int]:
        """Return {drone id: incarnation} of these drones."""
        beats = self.presence.beats
        incarnation = self.rosters.port.incarnation
        return {
            j: incarnation if j == self.id else beats[j].incarnation for j in members
        }

    def _find_deaf(self, members: list[int]) -> list[tuple[int, int]]:
        """Return the pairs (i, j) where i should receive j but does not.

        Each drone must receive its in-neighbours and the coordinator, and the coordinator must
        receive every member.
        """
        beats = self.presence.beats
        hears: dict[int, Container[int]] = {
            j: beats[j].hears for j in members if j != self.id
        }
        hears[self.id] = beats
        first = self.presence.coordinator()
        inside = self.rosters.restrict_graph(members)
        deaf = []
        for i in members:
            others = members if i == first else [first]
            needed = dict.fromkeys((*inside.in_neighbors(i), *others))
            deaf += [(i, j) for j in needed if j != i and j not in hears[i]]
        return deaf

    # Texts ----------------------------------------------------------------------------

    def _fewer_text(self) -> str:
        """Return the advice to fly with fewer drones."""
        do = "set start = n" if self.start == "all" else f"lower start = {self.start}"
        return f"{do} in the swarm file"

    def _refusals_text(self) -> str:
        """Return a text with the drones that cannot fly and their reasons."""
        return " ".join(
            f"drone {j} cannot fly: {why.rstrip('.')}."
            for j, why in sorted(self.presence.refusals.items())
        )

    def _absent_text(self) -> str:
        """Return a text with the absent drones, the broken edges, the other missions, and what to
        do.
        """
        strangers = self.presence.strangers
        refusals = self.presence.refusals
        here = self._list_present()
        known = {*here, *strangers.missions, *refusals}
        absent = [j for j in self.presence.others if j not in known]
        texts = []
        if absent:
            names = ", ".join(map(str, absent))
            texts.append(f"drone(s) {names} absent after {self.start_deadline:g} s.")
        if refusals:
            texts.append(self._refusals_text())
        for i, j in self._find_deaf(here):
            texts.append(f"drone {i} does not hear drone {j}.")
        if strangers.missions:
            texts.append(strangers.text())
        advice = f"Start their agents, look at the network, or {self._fewer_text()}."
        return " ".join([*texts, advice])
