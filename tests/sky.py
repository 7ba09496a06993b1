"""A sky of drones of one process, for tests of the airspace."""

from types import SimpleNamespace

import numpy as np

from crazychoir.bus.impairment.model import EdgeCounters, Impairment
from crazychoir.bus.port import Bus
from crazychoir.config.tables import CollisionTable
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.safety.airspace.airspace import Airspace, AirspaceRules
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.types import State

TICK = 0.01  # s


class Sky:
    """Drones of one process, each at a place of its own, with all drones of the swarm around."""

    def __init__(self, places, others=(), rules=(), partitions=(), alone=()):
        self.ticks = 0
        self.alarms = []
        clock = SimpleNamespace(
            now_ns=lambda: round(self.ticks * TICK * NS_PER_SECOND),
            now=lambda: self.ticks * TICK,
            call_at=lambda at, work, *arguments, **_: self.alarms.append(
                (at, work, arguments)
            ),
        )
        impairment = Impairment(7, rules, partitions)
        impairment.begin(0.0)
        self.bus = Bus(clock, impairment)
        for i in range(len(places)):
            self.bus.port(i)
        ids = [*range(len(places)), *others]
        self.airspace = Airspace(
            self.bus, ids, AirspaceRules(CollisionTable(), 1.0, 0.0, alone)
        )
        self.drones = [Neighbours(self.airspace, i) for i in range(len(places))]
        self.places = [np.array(p, dtype=float) for p in places]
        self.velocities = [np.zeros(3) for _ in places]

    def fly(self, seconds, silent=(), each=lambda: None):
        for _ in range(round(seconds / TICK)):
            self.ticks += 1
            for i, p in enumerate(self.places):
                self.places[i] = p = p + TICK * self.velocities[i]
                if i not in silent:
                    self.drones[i].publish(State.at(p, self.velocities[i]), 0.0)
            each()
            self.airspace.step()
            now_ns = self.bus.clock.now_ns()
            due = [alarm for alarm in self.alarms if alarm[0] <= now_ns]
            self.alarms = [alarm for alarm in self.alarms if alarm[0] > now_ns]
            for _, work, arguments in due:
                work(*arguments)

    def age(self, i, j):
        return self.bus.clock.now() - float(self.drones[i].known(j)["state_time"])

    def counts(self, j, i):
        edge = self.bus.impairment.counters.get((j, i), EdgeCounters())
        return edge.sent, edge.lost
