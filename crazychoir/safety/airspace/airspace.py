"""The airspace of a process: which states of the other drones each of its drones has heard."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from crazychoir.bus.port import READER_RATES, Bus
from crazychoir.config.tables import CollisionTable
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace_rows import (
    AIRSPACE_RULES_ROW,
    ALL_BITS,
    SWARM_ROW,
    Missed,
)
from crazychoir.safety.airspace.distances import COLLISION_DISTANCES, compute_silent_gap
from crazychoir.safety.airspace.hearing import (
    hear_states,
    is_valid_state,
    take_frames,
    take_message,
    take_states,
)
from crazychoir.safety.airspace.late_states import LateStates
from crazychoir.safety.airspace.near_pairs import (
    CHECK_NS,
    check_distances,
    tell_pairs,
)
from crazychoir.safety.airspace.pair_tables import FarTables, PairTables
from crazychoir.safety.airspace.state_links import StateLinks
from crazychoir.safety.airspace.state_rates import NEIGHBOUR_AGES, compute_far_rate
from crazychoir.safety.airspace.states_by_hand import STATE_BYTES, StatesByHand
from crazychoir.types import Ints, LinkStatus, Records, State, Vec

SPARE_ROUNDS = 4  # rounds that are kept beyond NEIGHBOUR_AGES.gone


@dataclass(frozen=True, slots=True)
class AirspaceRules:
    """What holds for all drones of an airspace."""

    collision: CollisionTable
    """[collision]."""
    v_max: float
    """m/s, largest speed of the others."""
    ground: float
    """m, height of the ground."""
    alone: tuple[int, ...] = ()
    """Ids of the drones that do not give way, because a planner on board flies them."""
    hosts: Mapping[int, str] = field(default_factory=dict)
    """{id: host of the processes that may fly the drone}; empty: all drones have the same host."""
    a_max: float = 2.0
    """m/s2, with which the drones brake."""


class Airspace:
    """The newest states of all flying drones, and what each drone of this process has heard of them.

    Each drone hears all others in rounds, a few times a second. Two drones that could meet soon, or
    that would soon brake for want of a state, have a pair each: a record of what one has heard of
    the other, often enough. A pair also exists while a drone may be near, because it has not been
    heard for long or never.

    bus: of the process, with a port of each of its drones
    ids: of all flying drones of the swarm
    rules: what holds for all of them
    """

    def __init__(self, bus: Bus, ids: Sequence[int], rules: AirspaceRules) -> None:
        self.bus = bus
        self.ids = sorted(ids)
        self.own_ids = [i for i in self.ids if i in bus.ports]
        self.places = {j: place for place, j in enumerate(self.ids)}
        interval_ns = round(NS_PER_SECOND / compute_far_rate(max(len(self.ids) - 1, 1)))
        self.rules = _build_rules(rules, interval_ns)
        self.own_places = np.array([self.places[i] for i in self.own_ids], np.int64)
        """(n,): rows of the drones of this process in the swarm."""
        self._shares = {j: 1.0 if j in rules.alone else 0.5 for j in self.ids}
        self.swarm = _build_swarm(self._shares, self.own_places, interval_ns)
        names = [rules.hosts.get(j, "") for j in self.ids]
        self.swarm["host"] = [names.index(name) for name in names]
        self.near = PairTables(self.own_places, np.array(self.own_ids, np.int64))
        self.far = FarTables(
            len(self.own_ids), len(self.ids), int(self.rules["round_capacity"][0])
        )
        self.links = StateLinks(bus.impairment, [(i, self.ids) for i in self.own_ids])
        self._trace_due_ns = 0
        self.trace: Callable[..., None] | None = None
        """Gets what each drone knows, when its distances are checked."""
        self.states = np.zeros((len(self.own_ids), 16))
        """(n, 16): own states (13,) and accelerations (3,), before the next step."""
        self.times = np.full(len(self.own_ids), -math.inf)
        """(n,) s: times of the own states."""
        self.numbers = np.zeros(len(self.own_ids), np.int64)
        """(n,): ticks of the own drones."""
        self._late = LateStates()
        self._by_hand = StatesByHand(bus, self.swarm, self.near.listeners, self.hear)

    def keep_all(self, listener: int) -> None:
        """Give an own drone a pair with every other drone, from now on.

        listener: number of the drone in this process
        """
        row = self.near.listeners[listener]
        row["keeps_all"] = 1
        self._check_all(int(row["check_ns"]))

    def note_told(self, told: Mapping[int, Sequence[int]]) -> None:
        """Note which drones in this process a law hears in each tick.

        The collision filter of its drone then knows these states as well, if both could meet soon.

        told: {drone: drones that its law hears}
        """
        found: list[int] = []
        for listener, i in zip(self.near.listeners, self.own_ids, strict=True):
            listener["first_told"] = len(found)
            found += [self.places[j] for j in told.get(i, ()) if j in self.places]
            listener["told_count"] = len(found) - int(listener["first_told"])
        self.near.told = np.array(found, np.int64)
        tell_pairs(
            self.near.listeners,
            self.near.paces,
            self.near.dues,
            self.swarm,
            self.near.told,
        )

    def now(self) -> float:
        """Return the time in s on the clock of the ages."""
        return self.bus.clock.now_ns() / NS_PER_SECOND

    def publish(self, listener: int, state: State, age: float) -> None:
        """Take the state of one drone of this process; the others hear it in the next step.

        listener: number of the drone in this process
        age: s
        """
        row = self.states[listener]
        row[0:13] = state.flat
        row[13:16] = state.a
        self.times[listener] = self.now() - max(age, 0.0)
        self.numbers[listener] += 1

    def hear_frames(self, rows: Records, times: Vec, hosts: Ints, bits: Ints) -> bool:
        """Take states from other processes; the own drones hear them in the next step.

        rows: (k,) FRAME_ROW
        times: (k,) s, when the frame of each row was sent
        hosts: (k,), of the sender, as host in SWARM_ROW
        bits: (k,), of the sender, as process_bits in SWARM_ROW
        Returns whether one of the drones is now flown by another process than before.
        """
        return bool(take_frames(self.swarm, rows, times, hosts, bits))

    def due_frame(self) -> Ints:
        """Return (n,): the bits of the processes that need the newest state of each own drone now.

        Valid from one step to the next one.
        """
        bits: Ints = self.near.listeners["frame_due"]
        return bits

    def step(self) -> list[int]:
        """Let all drones of this process hear what is due, then check the distances.

        Returns the numbers of the own drones that should ask others for states.
        """
        now_ns = self.bus.clock.now_ns()
        if self.rules["began_ns"][0] < 0:
            self.rules["began_ns"] = now_ns
        if self.links.refresh(now_ns / NS_PER_SECOND):
            self.rules["has_late"] = self.links.has_late
        if self.links.has_late:
            self._late.make_room(len(self.near.pairs))
        take_states(
            self.swarm,
            self.own_places,
            self.numbers,
            self.states,
            self.times,
        )
        waiting = hear_states(
            self.near.listeners,
            self.near.pairs,
            self.near.motions,
            self.near.paces,
            self.near.dues,
            self.swarm,
            self.far.rounds,
            self.far.known,
            self.far.missed,
            self.links.rows,
            self.links.kinds,
            self.links.losses,
            self._late.rows,
            self._late.count,
            self.rules,
            self.far.work,
            now_ns,
        )
        if waiting:
            self._judge_by_hand(now_ns)
        seekers = self._check_due(now_ns)
        self._trace(now_ns)
        return seekers

    def _check_due(self, now_ns: int) -> list[int]:
        """Check the own drones that are due; return the drones that should ask others for states."""
        if not self.near.has_due(now_ns):
            return []
        listeners = self.near.listeners
        counts = listeners["check_count"].copy()
        self._check_all(now_ns)
        was_checked = counts != listeners["check_count"]
        must_ask = was_checked & (listeners["sought_count"] > 0)
        return list(must_ask.nonzero()[0].tolist())

    def _check_all(self, now_ns: int) -> None:
        """Check the distances of all own drones that are due."""
        while check_distances(
            self.near.listeners,
            self.near.pairs,
            self.near.motions,
            self.near.paces,
            self.near.dues,
            self.near.told,
            self.swarm,
            self.far.rounds,
            self.far.known,
            self.far.missed,
            self.links.kinds,
            self.rules,
            self.far.grid,
            self.far.begins,
            self.far.order,
            self.far.work,
            now_ns,
        ):
            # Some drones lack room for their pairs, and have not been checked.
            self.near.make_room()

    def _trace(self, now_ns: int) -> None:
        """Trace what the own drones know of near drones, as often as the distances are checked."""
        if self.trace is not None and now_ns >= self._trace_due_ns:
            self._trace_due_ns = now_ns + CHECK_NS
            self.trace(
                np.ascontiguousarray(self.near.pairs["state_time"]),
                np.ascontiguousarray(self.near.pairs["heard_time"]),
            )

    def report_messages(self) -> None:
        """Add the messages since the last call to the counters of the ports."""
        listeners = self.near.listeners
        for at in np.flatnonzero(listeners["sent"]).tolist():
            port = self.bus.ports.get(self.own_ids[at])
            if port is not None:
                port.counters.sent += int(listeners["sent"][at])
                port.counters.bytes += STATE_BYTES * int(listeners["sent"][at])
                port.counters.lost += int(listeners["lost"][at])
        listeners["sent"] = 0
        listeners["lost"] = 0

    def _judge_by_hand(self, now_ns: int) -> None:
        """Let the simulated network decide on the states that wait for its verdict."""
        for at, i in enumerate(self.own_ids):
            for pair in self.pairs_of(at):
                if pair["is_by_hand"]:
                    pair["is_by_hand"] = 0
                    self._by_hand.judge(at, i, pair, now_ns)

    def pairs_of(self, listener: int) -> Records:
        """Return the pairs of an own drone, (k,) PAIR_ROW, ordered by id; valid until the next step.

        listener: number of the drone in this process
        """
        return self.near.pairs[self.near.rows_of(listener)]

    def pair(self, listener: int, j: int) -> Records | None:
        """Return the pair of an own drone with drone j, (1,) PAIR_ROW, or None.

        listener: number of the drone in this process
        """
        found = self._find_pair(listener, j)
        return None if found is None else self.near.pairs[found]

    def _find_pair(self, listener: int, j: int) -> slice | None:
        """Return where the pair of an own drone with drone j is, or None.

        listener: number of the drone in this process
        """
        place = self.places.get(j)
        if place is None or self.far.missed[listener, place] != Missed.PAIRED:
            return None
        return self.near.find(listener, place)

    def hear(self, listener: int, j: int, state: State, age: float) -> None:
        """Let an own drone hear a state that drone j sent itself.

        listener: number of the drone in this process
        age: s, of the state
        """
        self.relay(listener, j, state, age, is_heard=True)

    def relay(
        self,
        listener: int,
        j: int,
        state: State,
        age: float,
        *,
        is_heard: bool = False,
    ) -> None:
        """Let an own drone learn a state of drone j.

        listener: number of the drone in this process
        age: s, of the state
        is_heard: whether drone j sent it itself
        """
        found = self._find_pair(listener, j)
        values = np.concatenate([state.flat, state.a])
        if found is None or not is_valid_state(values):
            return
        take_message(
            self.near.pairs[found],
            self.near.motions[found],
            values,
            self.now() - age,
            self.swarm["share"][self.places[j]],
            self.rules["lag"][0],
            not is_heard,
        )

    def see(self, j: int, state: State, age: float) -> None:
        """Take the place of drone j that the cameras see.

        It counts for drones that have not heard drone j for NEIGHBOUR_AGES.unheard s.
        """
        place = self.places.get(j)
        if place is not None and is_valid_state(np.concatenate([state.flat, state.a])):
            self.swarm["seen_state"][place] = state.flat
            self.swarm["seen_time"][place] = self.now() - max(age, 0.0)
            self.rules["has_seen"] = 1

    def take_link(self, j: int, link: LinkStatus | None, age: float) -> None:
        """Note the state of the radio of drone j.

        A drone that does not hear its agent gives way to no other, whatever the agent says.
        """
        place = self.places.get(j)
        if place is not None and link is not None:
            is_deaf = link.silence + age > NEIGHBOUR_AGES.deaf
            self.swarm["share"][place] = 1.0 if is_deaf else self._shares[j]
            self.swarm["is_deaf"][place] = is_deaf


def _build_swarm(shares: dict[int, float], own: Ints, interval_ns: int) -> Records:
    """Return what a process knows of the drones of a swarm at the start, (n,) SWARM_ROW.

    shares: {id: share, see SWARM_ROW}, increasing
    own: rows of the drones of this process
    interval_ns: ns, of rounds
    """
    ids = np.array(list(shares), np.int64)
    swarm = np.zeros(len(ids), SWARM_ROW)
    swarm["drone"] = ids
    swarm["listener"] = -1
    swarm["process_bits"] = ALL_BITS
    swarm["listener"][own] = np.arange(len(own))
    swarm["lacking_count"] = len(own)
    swarm["lacking_count"][own] -= 1
    swarm["state"][:, 9] = 1.0
    swarm["seen_state"][:, 9] = 1.0
    swarm["state_time"] = -math.inf
    swarm["seen_time"] = -math.inf
    swarm["share"] = list(shares.values())
    if interval_ns >= READER_RATES.slow_interval_ns:
        swarm["phase_ns"] = READER_RATES.phase_step_ns * ids % interval_ns
    swarm["round_due_ns"] = swarm["phase_ns"]
    return swarm


def _build_rules(rules: AirspaceRules, interval_ns: int) -> Records:
    """Return the rules for compiled laws, (1,) AIRSPACE_RULES_ROW.

    interval_ns: ns, of rounds
    """
    sx, sy, sz = rules.collision.semi_axes
    kept = math.ceil(NEIGHBOUR_AGES.gone * NS_PER_SECOND / interval_ns) + SPARE_ROUNDS
    row = np.zeros(1, AIRSPACE_RULES_ROW)
    row["scale"] = (1.0, sx / sy, sx / sz)
    row["width"] = 2.0 * sx + rules.collision.margin
    row["range"] = rules.collision.range
    row["v_max"] = rules.v_max
    row["silent_gap"] = compute_silent_gap(rules.v_max, rules.a_max)
    row["lag"] = rules.collision.lag
    row["standing_height"] = rules.ground + COLLISION_DISTANCES.standing_height
    row["far_interval_ns"] = interval_ns
    row["round_capacity"] = min(kept, Missed.MOST)
    row["began_ns"] = -1
    return row
