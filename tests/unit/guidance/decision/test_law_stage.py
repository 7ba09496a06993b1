"""The laws of a process step together, and a law that fails ends alone."""

from contextlib import nullcontext
from typing import ClassVar

import numpy as np
import pytest
from virtual_time import virtual

from crazychoir.bus.impairment.model import Impairment
from crazychoir.bus.port import Bus
from crazychoir.config.tables import CollisionTable
from crazychoir.flight.tick import FlightTick
from crazychoir.guidance.decision.hearing_rows import HEARING_ROW
from crazychoir.guidance.decision.law_rows import (
    LAW_ROW,
    LawDecision,
    ReferenceKind,
    start_row,
)
from crazychoir.guidance.decision.law_stage import LawGroup, LawStage
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.neighbour_state import PairedStateMailbox
from crazychoir.runtime.clock import run_virtual
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.airspace_rows import FRAME_ROW
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.rules.modes import Mode
from crazychoir.types import Acceleration, State

TICK = 0.01


class ByHand(CFDistributedFeedback):
    """A law that pushes along x."""

    def __init__(self, push=1.0):
        self.push = push

    def step(self, me, heard):
        return Acceleration(np.array([self.push, 0.0, 0.0]))


class OfTeam(ByHand):
    """The same law for a team; it keeps how often it was prepared."""

    prepared: ClassVar = []

    @classmethod
    def for_team(cls, laws, neighbors):
        cls.prepared.append([law.push for law in laws])
        pushes = np.array([[law.push, 0.0, 0.0] for law in laws])

        def step(team):
            if np.isnan(pushes).any():
                raise ValueError("not a number")
            team.accelerate(pushes)

        return step


class Staged:
    """A law in the stage, without a pilot: it keeps what it was told to fly."""

    def __init__(self, drone, law):
        self.drone, self.law = drone, law
        self.ids = ()
        self.rows, self.edges = np.zeros(1, LAW_ROW), np.zeros(0, HEARING_ROW)
        self.rows["period_ns"] = 10_000_000
        self.rows["early_ns"] = 5_000_000
        self.rows["sum"]["h"] = TICK
        self.flown, self.errors, self.stopped = [], [], 0
        start_row(self.rows, self.edges, 0)

    hearings = ()

    def move_to(self, rows, edges):
        rows[:] = self.rows
        edges[:] = self.edges
        self.rows, self.edges = rows, edges

    def guard(self):
        return nullcontext()

    def step(self, me, heard):
        wanted = self.law.step(me, heard)
        self.rows["kind"] = ReferenceKind.ACCELERATION
        self.rows["reference"][0, 6:9] = wanted.a

    def fly(self, reference):
        self.flown.append(float(reference.a[0]))

    def stop(self):
        self.stopped += 1

    def fail(self, error):
        self.errors.append(error)
        self.rows["is_running"] = 0
        return True


class Process:
    """A process with drones that have a new state in each tick.

    mode: of its drones
    """

    def __init__(self, clock, mode=Mode.HOVER):
        self.clock = clock
        self.mode = mode
        bus = Bus(clock)
        self.tick = FlightTick(bus, 4)
        self.stage = LawStage(self.tick, bus.impairment)

    def enter(self, law):
        """Let a law of one more drone run."""
        row = self.tick.batch.add(law.drone)
        row.mode = self.mode
        row.drone["state"] = State.at((0.0, 0.0, 1.0)).flat
        law.rows["place"] = row.index
        self.stage.enter(law)

    async def fly(self, ticks):
        """Let the laws decide in some ticks."""
        for _ in range(ticks):
            await self.clock.sleep(TICK)
            self.tick.batch.drones["ticks"] = 1
            self.stage.decide(self.clock.now_ns())


@virtual
async def test_laws_of_a_team_and_laws_by_hand_step_once_a_tick(clock):
    process = Process(clock)
    laws = [
        Staged(5, OfTeam(5.0)),
        Staged(1, ByHand(1.0)),
        Staged(3, OfTeam(3.0)),
        Staged(2, ByHand(2.0)),
    ]
    for law in laws:
        process.enter(law)
    OfTeam.prepared.clear()
    await process.fly(10)
    assert OfTeam.prepared == [[3.0, 5.0]], "once, in the order of the drones"
    for law in laws:
        assert law.flown == 10 * [float(law.drone)]


class Told(Staged):
    """A law that keeps what it was told of itself and of its neighbours, and spoils its copies."""

    def __init__(self, drone, ids):
        super().__init__(drone, ByHand())
        self.ids, self.edges = ids, np.zeros(len(ids), HEARING_ROW)
        self.told = []

    def step(self, me, heard):
        numbers = {j: (s.flat[0], s.a[0], s.age) for j, s in heard.items()}
        self.told.append((me.flat[0], numbers))
        heard.clear()
        me.flat[:] = np.nan


@pytest.mark.parametrize("seed", range(20))
def test_each_law_is_told_of_the_neighbours_that_it_hears_and_of_no_others(seed):
    draw = np.random.default_rng(seed)
    laws = [
        Told(i, tuple(draw.choice(50, draw.integers(0, 6), replace=False).tolist()))
        for i in range(draw.integers(1, 9))
    ]
    group = LawGroup(laws, Impairment(1))
    rows, edges = group.team.rows, group.team.edges
    rows["decision"] = draw.choice([LawDecision.REST, LawDecision.STEP], len(rows))
    rows["state"] = draw.random((len(rows), 13))
    edges["is_heard"] = draw.integers(0, 2, len(edges))
    edges["told"] = draw.random((len(edges), 13))
    edges["told_acceleration"] = draw.random((len(edges), 3))
    edges["told_age"] = draw.random(len(edges))
    expected = [[] for _ in laws]
    for law, row, told in zip(laws, rows, expected, strict=True):
        numbers = {
            j: (e["told"][0], e["told_acceleration"][0], e["told_age"])
            for j, e in zip(law.ids, law.edges, strict=True)
            if e["is_heard"]
        }
        if row["decision"] == LawDecision.STEP:
            told.append((row["state"][0], numbers))
    group._step_each()
    assert [law.told for law in laws] == expected


@virtual
async def test_a_law_that_has_left_does_not_step_and_a_law_that_enters_does(clock):
    process = Process(clock)
    first, second = Staged(0, OfTeam(1.0)), Staged(1, OfTeam(2.0))
    process.enter(first)
    await process.fly(2)
    first.rows["is_running"] = 0
    process.stage.leave(first)
    process.enter(second)
    await process.fly(3)
    assert (len(first.flown), len(second.flown)) == (2, 3)


@virtual
async def test_numbers_that_have_changed_are_prepared_again(clock):
    process = Process(clock)
    law = Staged(0, OfTeam(1.0))
    process.enter(law)
    await process.fly(1)
    law.law.push = 2.0
    process.stage.renew()
    await process.fly(1)
    assert law.flown == [1.0, 2.0]
    assert law.rows["tally"]["steps"] == 2, "its counts have moved with it"


@pytest.mark.parametrize(
    ("mode", "flown", "stopped"),
    [
        (Mode.HOVER, 3, 0),
        (Mode.TAKEOFF, 0, 0),
        (Mode.LAND, 0, 3),
    ],
)
def test_the_mode_of_a_drone_decides_whether_its_law_steps(mode, flown, stopped):
    async def steps(clock):
        process = Process(clock, mode)
        law = Staged(0, OfTeam(1.0))
        process.enter(law)
        await process.fly(3)
        assert (len(law.flown), law.stopped) == (flown, stopped)

    run_virtual(steps)


@virtual
async def test_an_error_of_a_team_ends_its_laws_and_no_others(clock):
    process = Process(clock)
    laws = [
        Staged(0, OfTeam(1.0)),
        Staged(1, OfTeam(float("nan"))),
        Staged(2, ByHand(1.0)),
    ]
    for law in laws:
        process.enter(law)
    await process.fly(3)
    assert [len(law.errors) for law in laws] == [1, 1, 0]
    assert [len(law.flown) for law in laws] == [0, 0, 3]


@virtual
async def test_a_team_that_cannot_be_prepared_ends_its_laws(clock):
    class Broken(OfTeam):
        """A law with a team that fails at once."""

        @classmethod
        def for_team(cls, laws, neighbors):
            raise ValueError("no numbers")

    process = Process(clock)
    laws = [Staged(0, Broken()), Staged(1, ByHand())]
    for law in laws:
        process.enter(law)
    await process.fly(2)
    assert [len(law.errors) for law in laws] == [1, 0]
    assert [len(law.flown) for law in laws] == [0, 2]


APART = (
    0.5  # m: two drones at rest hear each other 50 times a second, in each second tick
)


class NeighbourProcess:
    """Drones 0 and 1 at rest in one process, near each other. Drone 1 has no law.

    The law of drone 0 hears drone 1 with this rate in Hz; 0: each state.
    """

    def __init__(self, clock, rate=0.0):
        self.clock = clock
        impairment = Impairment(7)
        impairment.begin(0.0)
        bus = Bus(clock, impairment)
        for i in (0, 1):
            bus.port(i)
        self.tick = FlightTick(bus, 2)
        rules_of_air = AirspaceRules(CollisionTable(), 1.0, 0.0)
        self.airspace = self.tick.airspace = Airspace(bus, [0, 1], rules_of_air)
        self.drones = [Neighbours(self.airspace, i) for i in (0, 1)]
        self.states = [State.at((APART * i, 0.0, 1.0)) for i in (0, 1)]
        for i in (0, 1):
            row = self.tick.batch.add(i)
            row.mode = Mode.HOVER
            row.drone["state"] = self.states[i].flat
            row.drone["listener"] = i
        law = Staged(0, ByHand())
        law.ids = (1,)
        law.edges = np.zeros(1, HEARING_ROW)
        PairedStateMailbox(clock, "1", TICK, law.edges).take_from(1, rate)
        law.list_told = lambda: [] if rate else [1]
        self.stage = LawStage(self.tick, impairment)
        self.stage.enter(law)

    async def fly(self, seconds):
        """Tick, and return the largest age of what drone 0 and drone 1 know of each other."""
        ages = [0.0, 0.0]
        for _ in range(round(seconds / TICK)):
            await self.clock.sleep(TICK)
            for i in (0, 1):
                self.drones[i].publish(self.states[i], 0.0)
            self.tick.batch.drones["ticks"] = 1
            self.tick.batch.drones["number"] = self.airspace.numbers
            self.airspace.step()
            self.stage.decide(self.clock.now_ns())
            ages = [max(ages[i], self.age(i, 1 - i)) for i in (0, 1)]
        return ages

    def age(self, i, j):
        """Return the age in s of what the airspace knows of drone j for drone i."""
        known = self.drones[i].row(j)
        return self.clock.now() - (0.0 if known is None else float(known["heard_time"]))

    def take_counts(self):
        """Return the messages of drone 1 since the last call: for the airspace and the law."""
        airspace = int(self.airspace.near.listeners["sent"][1])
        law = int(self.tick.batch.drones["sent"][1])
        self.airspace.near.listeners["sent"] = 0
        self.tick.batch.drones["sent"] = 0
        return airspace, law


@virtual
async def test_the_airspace_knows_each_state_that_a_law_hears(clock):
    process = NeighbourProcess(clock)
    await process.fly(1.5)
    with_law, without_law = await process.fly(1.0)
    assert with_law < 1e-6
    assert without_law == pytest.approx(TICK)


@virtual
async def test_one_message_serves_the_airspace_and_a_law(clock):
    process = NeighbourProcess(clock)
    await process.fly(1.5)
    process.take_counts()
    await process.fly(1.0)
    assert process.take_counts() == (0, 100)


@virtual
async def test_the_airspace_hears_by_itself_what_a_law_hears_seldom(clock):
    process = NeighbourProcess(clock, rate=10.0)
    await process.fly(1.5)
    process.take_counts()
    ages = await process.fly(1.0)
    assert ages == pytest.approx([TICK, TICK])
    assert process.take_counts() == (50, 10)


@virtual
async def test_the_airspace_loses_the_states_that_the_law_loses(clock):
    process = NeighbourProcess(clock)
    process.tick.airspace.bus.impairment.update({"loss": 0.5})
    await process.fly(1.5)
    edge = process.stage._groups[0].team.edges[0]
    for _ in range(50):
        await process.fly(TICK)
        law_age = process.clock.now() - edge["born_ns"] / 1e9
        assert process.age(0, 1) == pytest.approx(law_age, abs=1e-6)


class FrameProcess(NeighbourProcess):
    """As its base, but drone 1 is in another process: its states come in frames."""

    def __init__(self, clock, rate=0.0):
        super().__init__(clock, rate)
        self.law = self.stage._laws[0]
        hearing = PairedStateMailbox(clock, "1", TICK, self.law.edges)
        hearing.take_from_frames(1, rate)
        self.law.hearings = [hearing]
        move_rows = self.law.move_to

        def move_to(rows, edges):
            move_rows(rows, edges)
            hearing.move_to(edges)

        self.law.move_to = move_to
        self.airspace.swarm["listener"][1] = -1
        self.number = 0

    async def fly(self, seconds):
        """Tick, and return the numbers of the states of drone 1 that the law has heard."""
        heard = []
        for _ in range(round(seconds / TICK)):
            await self.clock.sleep(TICK)
            self.drones[0].publish(self.states[0], 0.0)
            self.number += 1
            rows = np.zeros(1, FRAME_ROW)
            rows["drone"] = 1
            rows["number"] = self.number
            rows["age"] = 0.002
            rows["state"] = self.states[1].flat
            sent = np.array([self.clock.now() - 0.003])
            self.airspace.hear_frames(rows, sent, np.array([0]), np.array([1]))
            self.tick.batch.drones["ticks"] = 1
            self.airspace.step()
            self.stage.decide(self.clock.now_ns())
            heard.append(int(self.edge()["version"]))
        return heard

    def edge(self):
        """Return the row of what the law hears of drone 1."""
        return self.stage._groups[0].team.edges[0]


@virtual
async def test_a_law_hears_each_state_of_another_process_once(clock):
    process = FrameProcess(clock)
    assert await process.fly(0.05) == [1, 2, 3, 4, 5]
    process.number -= 1
    assert await process.fly(0.01) == [5], "the same state again"
    edge = process.edge()
    assert edge["state"].tolist() == process.states[1].flat.tolist()
    assert edge["age"] == 0.002
    late = clock.now() - edge["born_ns"] / 1e9
    assert late == pytest.approx(0.005 + TICK)


@virtual
async def test_the_simulated_network_loses_states_that_come_in_frames(clock):
    process = FrameProcess(clock)
    process.airspace.bus.impairment.update({"loss": 0.5})
    heard = (await process.fly(1.0))[-1]
    assert 30 <= heard <= 70
    process.airspace.bus.impairment.update({"loss": 1.0})
    assert (await process.fly(0.1))[-1] == heard


@virtual
async def test_the_simulated_network_delays_states_that_come_in_frames(clock):
    process = FrameProcess(clock)
    process.airspace.bus.impairment.update({"delay": 0.03})
    heard = await process.fly(0.1)
    assert heard[:3] == [0, 0, 0]
    assert heard[-1] >= 6
    late = clock.now() - process.edge()["born_ns"] / 1e9
    assert late == pytest.approx(0.04, abs=0.0051)


def hear_late(effects, *, is_grouped_anew):
    """Return number and time of the newest state that a law has heard, after each of 50 ticks."""

    async def main(clock):
        process = FrameProcess(clock)
        await process.fly(TICK)
        process.airspace.bus.impairment.update(effects)
        heard = []
        for _ in range(50):
            if is_grouped_anew:
                process.stage.renew()
            await process.fly(TICK)
            heard.append((int(process.edge()["version"]), process.edge()["born_ns"]))
        return heard

    return run_virtual(main)


@pytest.mark.parametrize(
    "effects",
    [{"delay": 0.03}, {"delay": 0.033}, {"jitter": 0.05, "duplicate": 0.3}],
)
def test_late_states_arrive_as_if_the_laws_were_not_grouped_anew(effects):
    as_usual = hear_late(effects, is_grouped_anew=False)
    assert as_usual[-1][0] >= 30
    assert hear_late(effects, is_grouped_anew=True) == as_usual


@virtual
async def test_a_late_state_is_counted_once_for_law_and_airspace(clock):
    process = NeighbourProcess(clock)
    process.tick.airspace.bus.impairment.update({"delay": 0.02})
    await process.fly(1.5)
    process.take_counts()
    counters = process.tick.airspace.bus.impairment.counters[1, 0]
    sent, delayed = counters.sent, counters.delayed
    await process.fly(1.0)
    assert process.take_counts() == (0, 100)
    edge = process.stage._groups[0].team.edges[0]
    assert process.age(0, 1) == pytest.approx(clock.now() - edge["born_ns"] / 1e9)
    counters = process.tick.airspace.bus.impairment.counters[1, 0]
    assert (counters.sent - sent, counters.delayed - delayed) == (100, 100)
