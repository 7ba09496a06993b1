"""The decide stage of a process: it collects the running laws, and lets them step in each tick."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from itertools import groupby, islice
from typing import Any, Protocol

import numpy as np

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.flight.batch import Batch
from crazychoir.flight.tick import FlightTick
from crazychoir.guidance.decision.flight_rows import (
    FRAMES_SOURCE,
    deliver_rows,
    hand_over_rows,
    look_rows,
)
from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import (
    LAW_ROW,
    LawDecision,
    collect_received,
    count_rows,
    decide_rows,
)
from crazychoir.guidance.decision.team import (
    LawOfTeam,
    Rows,
    Team,
    TeamLaw,
    has_team_law,
    read_references,
)
from crazychoir.runtime.clock import NS_PER_SECOND, AlarmPriority, Clock
from crazychoir.safety.airspace.airspace_rows import SWARM_ROW
from crazychoir.safety.airspace.late_states import LateStates
from crazychoir.safety.airspace.state_links import StateLinks
from crazychoir.safety.airspace.states_by_hand import STATE_BYTES
from crazychoir.types import Heard, Records, Reference, State

NO_SWARM: Records = np.zeros(0, SWARM_ROW)
"""The swarm of a process without an airspace."""


LateState = tuple[tuple[int, int], Records]
"""A state on its way: the drone that hears it and its neighbour, and a record of LATE_ROW."""


class StateTaker(Protocol):
    """What a law hears of one neighbour."""

    def put(self, value: State, age: float = 0.0) -> None:
        """Take a state that is `age` s old."""
        ...


class StagedLaw(Protocol):
    """The law of one drone, as the decide stage sees it."""

    law: Any
    """The law with `step` and `for_team`."""
    drone: int
    """Id of the drone."""
    ids: tuple[int, ...]
    """Its neighbours, in the order of the edges."""

    @property
    def hearings(self) -> Sequence[StateTaker]:
        """What it hears of them."""
        ...

    def list_told(self) -> list[int]:
        """Return the neighbours in this process that the law hears in each tick."""
        ...

    def move_to(self, rows: Rows, edges: Rows) -> None:
        """Go on with these rows: (1,) of LAW_ROW and (k,) of HEARING_ROW."""

    def guard(self) -> AbstractContextManager[object]:
        """Return a context in which a step that does not return is interrupted."""
        ...

    def step(self, me: State, heard: Heard) -> None:
        """Take one step by hand: call `step` of the law and fly its reference."""

    def fly(self, reference: Reference | None) -> None:
        """Fly a reference of a step; None: hover."""

    def stop(self) -> None:
        """End the law, because the pilot does something else."""

    def fail(self, error: BaseException) -> bool:
        """End the law with an error; return False if it has ended before."""
        ...


class LawStage:
    """The running laws of one process.

    Laws enter and leave. In each tick `decide` lets the laws step that are due: in one call for all
    laws of a class with a step for a team, one by one otherwise. An error ends the laws that it
    comes from, and no others.

    tick: of the process, which calls `decide`
    impairment: the simulated network between the drones
    """

    def __init__(self, tick: FlightTick, impairment: Impairment) -> None:
        self._tick = tick
        self._batch = tick.batch
        self._clock = tick.clock
        self._impairment = impairment
        self._laws: dict[int, StagedLaw] = {}
        self._groups: list[LawGroup] = []
        self._is_grouped = True
        tick.deciders.append(self.decide)

    def enter(self, law: StagedLaw) -> None:
        """Add a law that runs from now on."""
        self._laws[law.drone] = law
        self._is_grouped = False

    def leave(self, law: StagedLaw) -> None:
        """Remove a law that does not run any more.

        Its row stays, at rest, until the rows are built again.
        """
        self._laws.pop(law.drone, None)

    def renew(self) -> None:
        """Build all rows and teams again in the next tick."""
        self._is_grouped = False

    def decide(self, now_ns: int) -> None:
        """Let all laws step that are due, and hand their references to the drones.

        now_ns: ns: the present time
        """
        if not self._is_grouped:
            self._build_groups()
        batch = self._batch
        airspace = self._tick.airspace
        swarm = NO_SWARM if airspace is None else airspace.swarm
        for group in self._groups:
            group.team.now_ns = now_ns
            group.team.epoch_ns = self._clock.epoch_ns
            look_rows(group.team.rows, batch.drones, batch.filters.rows)
            group.deliver(batch, swarm, self._clock, self._impairment)
            if group.decide():
                group.hand_over(batch)

    def _build_groups(self) -> None:
        """Build the rows anew: a group for each class with a step for a team, one for the others.

        Rows are in the order of the drones.
        """
        self._is_grouped = True
        laws = [self._laws[i] for i in sorted(self._laws)]
        laws.sort(key=_name_group)
        on_their_way = [late for group in self._groups for late in group.close()]
        self._groups = [
            LawGroup(list(same), self._impairment)
            for _, same in groupby(laws, key=_find_team_kind)
        ]
        for group in self._groups:
            group.resume(on_their_way)
        if self._tick.airspace is not None:
            told = {law.drone: law.list_told() for law in laws}
            self._tick.airspace.note_told(told)


def _find_team_kind(law: StagedLaw) -> type[LawOfTeam] | None:
    """Return the class of a law if it has a step for a team, else None."""
    kind = type(law.law)
    return kind if has_team_law(kind) else None


def _name_group(law: StagedLaw) -> str:
    """Return the name by which the groups are sorted."""
    kind = _find_team_kind(law)
    return "" if kind is None else f"{kind.__module__}.{kind.__qualname__}"


class LawGroup:
    """Laws that step together: those of a class with a step for a team, or all other laws.

    laws: in the order of their drones
    impairment: the simulated network between the drones
    """

    def __init__(self, laws: Sequence[StagedLaw], impairment: Impairment) -> None:
        self.laws = laws
        self.links = StateLinks(impairment, [(law.drone, law.ids) for law in laws])
        """The simulated network on the edges of the team."""
        self._late = LateStates()
        """The states on their way to the laws."""
        ends = np.cumsum([len(law.ids) for law in laws])
        rows = np.zeros(len(laws), LAW_ROW)
        edges = np.zeros(int(ends[-1]), HEARING_ROW)
        self.team = Team(rows, edges)
        first = 0
        for r, (law, end) in enumerate(zip(laws, ends.tolist(), strict=True)):
            law.move_to(rows[r : r + 1], edges[first:end])
            rows[r]["first_edge"] = first
            rows[r]["end_edge"] = end
            first = end
        self._found = np.zeros(max(len(laws), len(edges)), np.int64)
        self._ids = np.array([j for law in laws for j in law.ids], np.int64)
        """(e,): the neighbour that is heard along each edge."""
        self._law_of_edge = np.repeat(
            np.arange(len(laws)), [len(law.ids) for law in laws]
        )
        """(e,): the number of the law that hears along each edge."""
        self._team_law = self._prepare_team()

    def _prepare_team(self) -> TeamLaw | None:
        """Return the step for the team, or None if the laws step one by one."""
        kind = _find_team_kind(self.laws[0])
        if kind is None:
            return None
        for_team: Any = kind.for_team
        try:
            with self.laws[0].guard():
                prepared: TeamLaw | None = for_team(
                    [law.law for law in self.laws], [law.ids for law in self.laws]
                )
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - the laws raise it
            for law in self.laws:
                law.fail(error)
            return None
        return prepared

    def close(self) -> list[LateState]:
        """End the group, and return the states on their way to its laws."""
        self.links.close()
        return [
            (self._find_ends(int(state["receiver"])), state)
            for state in self._late.rows[: self._late.count[0]]
        ]

    def resume(self, states: Sequence[LateState]) -> None:
        """Go on with states on their way that are for laws of this group."""
        if not states:
            return
        edges = {self._find_ends(e): e for e in range(len(self._ids))}
        for ends, state in states:
            if ends in edges:
                self._late.add(state, edges[ends])

    def _find_ends(self, e: int) -> tuple[int, int]:
        """Return the drone that hears along an edge, and its neighbour."""
        return self.laws[self._law_of_edge[e]].drone, int(self._ids[e])

    def deliver(
        self, batch: Batch, swarm: Records, clock: Clock, impairment: Impairment
    ) -> None:
        """Let the laws hear the neighbours in this process, and the neighbours that come in frames.

        swarm: SWARM_ROW, of the airspace; empty without one
        """
        team = self.team
        self.links.refresh(clock.now())
        links = self.links
        if links.has_late:
            self._late.make_room(len(team.edges))
        count = deliver_rows(
            team.edges,
            batch.drones,
            swarm,
            links.rows,
            links.kinds,
            links.losses,
            self._late.rows,
            self._late.count,
            team.now_ns,
            self._found,
        )
        for e in self._found[:count].tolist():
            self._deliver_by_hand(e, batch, swarm, clock, impairment)

    def _deliver_by_hand(
        self,
        e: int,
        batch: Batch,
        swarm: Records,
        clock: Clock,
        impairment: Impairment,
    ) -> None:
        """Let the simulated network decide on the state of one edge."""
        source = int(self.team.edges["source"][e])
        is_far = source == FRAMES_SOURCE
        sender = (
            swarm[self.team.edges["frame_place"][e]] if is_far else batch.drones[source]
        )
        age = float(sender["age"])
        if is_far:
            age = clock.now() - float(sender["state_time"])
        state = State(sender["state"].copy(), age, sender["acceleration"].copy())
        law, hearing = self._find_hearing(e)
        verdict = impairment.verdict(
            int(self._ids[e]),
            law.drone,
            DRONE_TOPICS.state.name,
            int(sender["number"]),
            0,
            STATE_BYTES,
            clock.now(),
        )
        if not is_far:
            sender["sent"] += 1
            sender["lost"] += not verdict.deliveries
        for delay in verdict.deliveries:
            clock.call_at(
                clock.now_ns() + round(delay * NS_PER_SECOND),
                hearing.put,
                state,
                state.age + delay,
                priority=AlarmPriority.MESSAGE,
                drone=law.drone,
            )

    def _find_hearing(self, e: int) -> tuple[StagedLaw, StateTaker]:
        """Return the law that hears along an edge, and its mailbox."""
        r = int(self._law_of_edge[e])
        law = self.laws[r]
        return law, law.hearings[e - int(self.team.rows["first_edge"][r])]

    def decide(self) -> bool:
        """Let the laws step that are due; return whether any did. The team holds the time."""
        team = self.team
        steps, ends = decide_rows(team.rows, team.edges, team.now_ns)
        if ends > 0:
            for r in np.flatnonzero(team.rows["decision"] == LawDecision.END).tolist():
                self.laws[r].stop()
        if steps == 0:
            return False
        if self._team_law is None:
            self._step_each()
        else:
            self._step_team(self._team_law)
        return True

    def hand_over(self, batch: Batch) -> None:
        """Let the drones fly the references of the laws that have stepped."""
        rows = self.team.rows
        count = hand_over_rows(
            rows, batch.drones, batch.plans, self.team.now_ns, self._found
        )
        if count == 0:
            return
        found = self._found[:count]
        for r, reference in zip(
            found.tolist(), read_references(rows[found]), strict=True
        ):
            self.laws[r].fly(reference)

    def _step_team(self, team_law: TeamLaw) -> None:
        """Take one step for all laws, and fly their references."""
        team = self.team
        steps = team.steps.tolist()
        try:
            with self.laws[steps[0]].guard():
                team_law(team)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - the laws raise it
            for r in steps:
                self.laws[r].fail(error)
                team.rows["decision"][r] = LawDecision.REST
            return
        count_rows(team.rows)

    def _step_each(self) -> None:
        """Let each law step that is due, with copies of its rows."""
        rows = self.team.rows
        steps = self.team.steps.tolist()
        # A law may keep what it gets, so these arrays are new in each tick.
        most = len(rows) + len(self._ids)
        ids = np.empty(most, np.int64)
        states = np.empty((most, 13))
        accelerations = np.empty((most, 3))
        ages = np.empty(most)
        counts = np.empty(len(rows), np.int64)
        count = collect_received(
            rows, self.team.edges, self._ids, ids, states, accelerations, ages, counts
        )
        # Loops in C, because this is done for all neighbours of all drones.
        received = map(
            State, list(states[:count]), ages[:count].tolist(), list(accelerations)
        )
        known = zip(ids[:count].tolist(), received, strict=True)
        rows["reference"] = 0.0
        for r, heard in zip(steps, counts.tolist(), strict=False):
            _, me = next(known)
            self.laws[r].step(me, dict(islice(known, heard)))
        count_rows(rows)
