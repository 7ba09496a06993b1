"""What one drone knows of the others: a view of the airspace of its process."""

from crazychoir.safety.airspace.airspace import Airspace
from crazychoir.safety.airspace.relay_choice import choose_asked
from crazychoir.types import Records, State


class Neighbours:
    """The other drones, as one drone knows them.

    airspace: of the process
    drone: id of this drone
    keeps_all: whether all others have a row, not only the drones that may be near
    """

    def __init__(
        self, airspace: Airspace, drone: int, *, keeps_all: bool = False
    ) -> None:
        self.airspace = airspace
        self.port = airspace.bus.ports[drone]
        self.listener = airspace.own_ids.index(drone)
        """Number of this drone in its process."""
        if keeps_all:
            airspace.keep_all(self.listener)

    @property
    def ids(self) -> list[int]:
        """Ids of all other drones."""
        return [j for j in self.airspace.ids if j != self.port.address]

    @property
    def rows(self) -> Records:
        """Rows of the drones that may be near, (k,) PAIR_ROW, by id; valid until the next step."""
        return self.airspace.pairs_of(self.listener)

    def row(self, j: int) -> Records | None:
        """Return the row of drone j; None if it is far, or not among the others."""
        found = self.airspace.pair(self.listener, j)
        return None if found is None else found[0]

    def known(self, j: int) -> Records | None:
        """Return a record with the state, acceleration and state_time of drone j; None if unknown."""
        found = self.row(j)
        if found is not None or j not in self.airspace.places:
            return found
        far = self._find_round(self.airspace.places[j])
        return None if far is None else far[0]

    def _find_round(self, place: int) -> Records | None:
        """Return the last round of a far drone that this drone heard, (1,) ROUND_ROW, or None.

        place: row of the far drone in the swarm
        """
        capacity = int(self.airspace.rules["round_capacity"][0])
        count = int(self.airspace.swarm["round_count"][place])
        missed = int(self.airspace.far.missed[self.listener, place])
        if missed >= min(count, capacity):
            return None
        at = place * capacity + (count - 1 - missed) % capacity
        return self.airspace.far.rounds[at : at + 1]

    def choose_asked(self) -> list[tuple[int, int]]:
        """Return which drones this one asks for which states: ids of asked and sought drones."""
        airspace = self.airspace
        far = airspace.far
        count = choose_asked(
            self.listener,
            airspace.near.listeners,
            airspace.near.pairs,
            airspace.near.paces,
            airspace.swarm,
            far.rounds,
            far.missed,
            airspace.rules,
            self.now(),
            far.work,
            far.work_places,
            far.questions,
        )
        chosen = airspace.swarm["drone"][far.questions[:count]].tolist()
        return [(asked, sought) for asked, sought in chosen]

    def now(self) -> float:
        """Return the time in s on the clock of the ages."""
        return self.airspace.now()

    def publish(self, state: State, age: float) -> None:
        """Give the own state, `age` s old, to the others."""
        self.airspace.publish(self.listener, state, age)

    def hear(self, message: tuple[int, State], age: float) -> None:
        """Keep a state that a drone sent `age` s ago, unless it is invalid or outdated."""
        self.airspace.relay(self.listener, *message, age, is_heard=True)

    def told(self, message: tuple[int, State], age: float) -> None:
        """Keep the state of a drone that another drone has relayed."""
        self.airspace.relay(self.listener, *message, age)

    def deaf(self, j: int) -> bool:
        """Return whether the radio of drone j is silent: it goes on with its last command."""
        airspace = self.airspace
        return bool(airspace.swarm["is_deaf"][airspace.places[j]])
