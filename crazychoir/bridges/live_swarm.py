"""A running swarm as a bridge sees it: what the page of the dashboard knows and can command."""

from crazychoir.bridges.operator_services import ServiceDesk
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.dashboard.command_place import PagePlace
from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.model import SwarmModel
from crazychoir.dashboard.operator import PageOperator
from crazychoir.dashboard.polling import Overview, TaskBoard
from crazychoir.numerics.math3d import yaw_of
from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import State


class LiveSwarm:
    """The parts of the dashboard that need no web page.

    place: place on the network of the swarm
    """

    def __init__(self, place: PagePlace) -> None:
        config = place.config
        self.place = place
        self.log = EventLog(place.clock)
        """What the drones say, and how they answer commands."""
        self.model = SwarmModel(place.link.bus, place.address, config, self.log)
        """The newest messages of the drones."""
        self.desk = CommandDesk(place, self.log)
        """Sends commands, and keeps their receipts."""
        self.overview = Overview(self.desk)
        """The routes that the drones report when they are asked."""
        self.board = TaskBoard(self.desk, self.model)
        """The tasks of the mission."""
        self.services = ServiceDesk(
            PageOperator(config, self.desk, self.board), self.desk
        )
        """The commands of an operator."""

    @property
    def actors(self) -> list[Actor]:
        """The actors that ask the drones while they are told to watch."""
        return [self.overview, self.board]

    def now_ns(self) -> int:
        """Return the time in ns since 1970; in virtual time since the start."""
        clock = self.place.clock
        return clock.now_ns() + clock.epoch_ns

    def places(self, max_age: float) -> dict[int, tuple[State, int]]:
        """Return the state of each drone that is not too old, and its time of birth in ns.

        max_age: s
        """
        now_ns = self.now_ns()
        found = {}
        for i in self.place.config.ids:
            last = self.model.state(i)
            if last is not None and last[1] <= max_age:
                state, age = last
                found[i] = state, max(0, now_ns - round(age * NS_PER_SECOND))
        return found

    def heading(self, i: int) -> float | None:
        """Return the yaw of drone i in rad; None without a state that is new enough."""
        last = self.model.state(i)
        if last is None or last[1] > DRONE_TOPICS.state.max_age:
            return None
        return yaw_of(last[0].q)

    def watch(self, watched: bool) -> None:
        """Ask the drones for routes and tasks, or do not."""
        self.overview.watched = watched
        self.board.watched = watched

    def close(self) -> None:
        """Cancel all waiting."""
        self.desk.close()
