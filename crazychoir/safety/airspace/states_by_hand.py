"""States on links on which the simulated network may delay or duplicate messages."""

from collections.abc import Callable

from crazychoir.bus.port import Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.clock import NS_PER_SECOND, AlarmPriority
from crazychoir.types import Records, State

STATE_BYTES = 144  # length of a message with a state, without its header


class StatesByHand:
    """Lets the simulated network decide on single states.

    bus: of the process
    swarm: SWARM_ROW of the airspace
    listeners: LISTENER_ROW of the airspace
    hear: lets an own drone hear a state, as Airspace.hear
    """

    def __init__(
        self,
        bus: Bus,
        swarm: Records,
        listeners: Records,
        hear: Callable[[int, int, State, float], None],
    ) -> None:
        self._bus = bus
        self._swarm = swarm
        self._listeners = listeners
        self._hear = hear

    def judge(self, at: int, i: int, pair: Records, now_ns: int) -> None:
        """Let the simulated network decide on the newest state of a drone for drone i.

        at: number of drone i in this process
        pair: one row of PAIR_ROW
        now_ns: ns
        """
        sender = self._swarm[pair["other"]]
        j = int(sender["drone"])
        now = now_ns / NS_PER_SECOND
        verdict = self._bus.impairment.verdict(
            j, i, DRONE_TOPICS.state.name, int(sender["number"]), 0, STATE_BYTES, now
        )
        # As count_message does.
        own = int(sender["listener"])
        counted = self._listeners[own if own >= 0 else at]
        counted["sent"] += 1
        counted["lost"] += not verdict.deliveries
        state = State(sender["state"].copy(), 0.0, sender["acceleration"].copy())
        age = now - float(sender["state_time"])
        for delay in verdict.deliveries:
            if delay > 0.0:
                self._bus.clock.call_at(
                    now_ns + round(delay * NS_PER_SECOND),
                    self._hear,
                    at,
                    j,
                    state,
                    age + delay,
                    priority=AlarmPriority.MESSAGE,
                    drone=i,
                )
            else:
                self._hear(at, j, state, age)
