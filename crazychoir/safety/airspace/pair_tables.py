"""The tables of an airspace: pairs of near drones, and what far drones say in rounds."""

import numpy as np

from crazychoir.bus.port import READER_RATES
from crazychoir.safety.airspace.airspace_rows import (
    DUE_ROW,
    FAR_ROW,
    GRID_ROW,
    LISTENER_ROW,
    MOTION_ROW,
    PACE_ROW,
    PAIR_ROW,
    ROUND_ROW,
    Missed,
)
from crazychoir.safety.airspace.near_grid import CELLS_PER_DRONE
from crazychoir.safety.airspace.near_pairs import CHECK_NS
from crazychoir.safety.airspace.relay_choice import MOST_QUESTIONS
from crazychoir.types import Ints, Records

FIRST_PAIRS = 8  # pairs of a drone for which there is room at first
ROOM_FACTOR = 1.5
"""Room that is made for the pairs of a drone, in multiples of the room that it needs now."""


class PairTables:
    """What the drones of a process know of other drones that may be near: a row a pair.

    Each drone has its rows next to each other, in the order of the other drones.

    places: (n,): rows of the drones of this process in the swarm
    ids: (n,): their ids
    """

    def __init__(self, places: Ints, ids: Ints) -> None:
        self.listeners = np.zeros(len(places), LISTENER_ROW)
        self.pairs = np.zeros(len(places) * FIRST_PAIRS, PAIR_ROW)
        self.motions = np.zeros(len(self.pairs), MOTION_ROW)
        self.paces = np.zeros(len(self.pairs), PACE_ROW)
        self.dues = np.zeros(len(self.pairs), DUE_ROW)
        self.told = np.zeros(0, np.int64)
        """(k,): rows in the swarm of the drones that laws hear: those of the first listener first."""
        listeners = self.listeners
        listeners["place"] = places
        listeners["first_pair"] = FIRST_PAIRS * np.arange(len(places))
        listeners["pair_capacity"] = FIRST_PAIRS
        # Drones of one process do not all check in the same tick.
        listeners["check_ns"] = READER_RATES.phase_step_ns * ids % CHECK_NS

    def make_room(self) -> None:
        """Make room for the pairs of all drones that lack it, or may lack it soon."""
        listeners = self.listeners
        first = listeners["first_pair"].copy()
        wanted = np.ceil(ROOM_FACTOR * listeners["pairs_needed"]).astype(np.int64)
        listeners["pair_capacity"] = np.maximum(listeners["pair_capacity"], wanted)
        capacity = listeners["pair_capacity"]
        ends = np.cumsum(capacity)
        listeners["first_pair"] = ends - capacity
        counts = listeners["pair_count"]
        within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        source = within + np.repeat(first, counts)
        target = within + np.repeat(listeners["first_pair"], counts)
        size = int(ends[-1])
        # One after the other: each old table goes before the next larger one comes.
        self.pairs = _move_rows(self.pairs, source, target, size)
        self.motions = _move_rows(self.motions, source, target, size)
        self.paces = _move_rows(self.paces, source, target, size)
        self.dues = _move_rows(self.dues, source, target, size)

    def has_due(self, now_ns: int) -> bool:
        """Return whether a drone may be due for a check of its distances."""
        # Of few numbers Python finds the least sooner than numpy.
        return min(self.listeners["check_ns"].tolist(), default=now_ns) <= now_ns

    def rows_of(self, listener: int) -> slice:
        """Return where the pairs of a drone are; valid until the next step.

        listener: number of the drone in this process
        """
        row = self.listeners[listener]
        first = int(row["first_pair"])
        return slice(first, first + int(row["pair_count"]))

    def find(self, listener: int, place: int) -> slice:
        """Return where the pair of a drone with another one is, which it has.

        listener: number of the drone in this process
        place: row of the other drone in the swarm
        """
        rows = self.rows_of(listener)
        k = rows.start + int(np.searchsorted(self.paces["other"][rows], place))
        return slice(k, k + 1)


def _move_rows(table: Records, source: Ints, target: Ints, size: int) -> Records:
    """Return a table of this size with rows of another one.

    source: rows in `table`
    target: where they go
    """
    larger: Records = np.zeros(size, table.dtype)
    _words_of(larger)[target] = _words_of(table)[source]
    return larger


def _words_of(table: Records) -> Ints:
    """Return records as rows of whole numbers: numpy copies such rows much faster."""
    words: Ints = table.view(np.int64).reshape(len(table), -1)
    return words


class FarTables:
    """What far drones have said in rounds, and which drones have heard it.

    listeners: number of drones of this process
    drones: number of all flying drones
    rounds: rounds that are kept of each drone
    """

    def __init__(self, listeners: int, drones: int, rounds: int) -> None:
        self.rounds: Records = np.zeros(drones * rounds, ROUND_ROW)
        self.missed = np.full((listeners, drones), Missed.ALL, dtype=np.uint8)
        """(listeners, swarm): rounds missed in a row, or Missed."""
        self.known: Records = np.zeros(drones, FAR_ROW)
        self.known["state_time"] = -np.inf
        self.known["heard_time"] = -np.inf
        self.grid: Records = np.zeros(1, GRID_ROW)
        self.begins = np.zeros(CELLS_PER_DRONE * drones + 1, np.int64)
        """Where the cells of the grid begin in `order`."""
        self.order = np.zeros(drones, np.int64)
        """Rows of the swarm in the order of the cells."""
        self.work = np.zeros(drones, np.int64)
        """Work space."""
        self.work_places = np.zeros((drones, 3))
        """Work space."""
        self.questions = np.zeros((MOST_QUESTIONS, 2), np.int64)
        """The questions of the last call of choose_asked."""
