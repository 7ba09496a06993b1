"""Drones of a running swarm for a script: each call returns when the drones have obeyed."""

from collections.abc import Sequence
from typing import Any

from crazychoir.api.running.async_drones import (
    AsyncDrone,
    AsyncDrones,
    AsyncParameters,
)
from crazychoir.api.running.blocking import BlockingVerb, LoopThread


class DroneParameters:
    """The parameters of some drones: `param["control.kp"]`.

    thread: thread of the loop in which the drones are commanded
    counterpart: their asynchronous parameters
    is_alone: whether a value is that of one drone; else it is {id: value}
    """

    def __init__(
        self, thread: LoopThread[Any], counterpart: AsyncParameters, is_alone: bool
    ) -> None:
        self.thread = thread
        self.counterpart = counterpart
        self._is_alone = is_alone

    def __getitem__(self, name: str) -> Any:
        found = self.thread.call(self.counterpart.get(name))
        return next(iter(found.values())) if self._is_alone else found

    def __setitem__(self, name: str, value: float | Sequence[float]) -> None:
        self.thread.call(self.counterpart.set(name, value))

    get = BlockingVerb(AsyncParameters.get)
    set = BlockingVerb(AsyncParameters.set)


class RunningDrones:
    """Some drones of a running swarm. The methods are those of AsyncDrones, and wait.

    thread: thread of the loop in which they are commanded
    counterpart: the asynchronous drones
    """

    def __init__(self, thread: LoopThread[Any], counterpart: AsyncDrones) -> None:
        self.thread = thread
        self.counterpart = counterpart

    @property
    def ids(self) -> tuple[int, ...]:
        """Ids of the drones."""
        return self.counterpart.ids

    take_off = BlockingVerb(AsyncDrones.take_off)
    go_to = BlockingVerb(AsyncDrones.go_to)
    velocity = BlockingVerb(AsyncDrones.velocity)
    follow = BlockingVerb(AsyncDrones.follow)
    hold = BlockingVerb(AsyncDrones.hold)
    land = BlockingVerb(AsyncDrones.land)
    order = BlockingVerb(AsyncDrones.order)
    stop = BlockingVerb(AsyncDrones.stop)
    states = BlockingVerb(AsyncDrones.states)

    @property
    def param(self) -> DroneParameters:
        """Their parameters."""
        is_alone = isinstance(self.counterpart, AsyncDrone)
        return DroneParameters(self.thread, self.counterpart.param, is_alone)


class RunningDrone(RunningDrones):
    """One drone of a running swarm."""

    state = BlockingVerb(AsyncDrone.state)
    log = BlockingVerb(AsyncDrone.log)

    @property
    def id(self) -> int:
        """Its id."""
        return self.ids[0]
