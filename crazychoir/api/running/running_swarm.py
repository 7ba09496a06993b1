"""A running swarm for a script or a notebook: each call returns when the drones have obeyed."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Self, overload

from crazychoir.api.running.async_drones import AsyncDrone
from crazychoir.api.running.async_swarm import AsyncSwarm
from crazychoir.api.running.blocking import BlockingVerb, LoopThread
from crazychoir.api.running.running_drones import RunningDrone, RunningDrones
from crazychoir.api.running.swarm_run import SwarmRun
from crazychoir.config.swarm_config import SwarmConfig


class RunningSwarm(RunningDrones):
    """All drones of a running swarm. `swarm[3]` is one of them, `swarm[[1, 2]]` are some.

    It is a context manager: at the end of a `with` block it leaves the swarm. If this program has
    started the swarm, its drones land first, and `result` then holds the result of the run.

    thread: thread of the loop in which the swarm is commanded
    run: the run that this program has started, None without one
    """

    def __init__(
        self, thread: LoopThread[AsyncSwarm], run: SwarmRun | None = None
    ) -> None:
        super().__init__(thread, thread.value)
        self._swarm = thread.value
        self._run = run
        self.result: dict[str, Any] | None = None
        """Result of the run that this program has started, after its end."""

    impair = BlockingVerb(AsyncSwarm.impair)
    clear_stop = BlockingVerb(AsyncSwarm.clear_stop)

    @property
    def config(self) -> SwarmConfig:
        """The swarm file of this flight."""
        return self._swarm.config

    @overload
    def __getitem__(self, which: int | str) -> RunningDrone: ...
    @overload
    def __getitem__(self, which: Sequence[int | str]) -> RunningDrones: ...
    def __getitem__(
        self, which: int | str | Sequence[int | str]
    ) -> RunningDrone | RunningDrones:
        """Return one drone, or several, by ids or names.

        Raises ConfigError for a drone that is not there.
        """
        found = self._swarm[which]
        if isinstance(found, AsyncDrone):
            return RunningDrone(self.thread, found)
        return RunningDrones(self.thread, found)

    def __iter__(self) -> Iterator[RunningDrone]:
        return (self[i] for i in self.ids)

    def __len__(self) -> int:
        return len(self.ids)

    def close(self) -> None:
        """Leave the swarm, and end the run that this program has started: its drones land."""
        if self._run is None:
            self.thread.close()
        elif self.result is None:
            with ExitStack() as ending:  # each step follows, also if one before fails
                ending.callback(self._end_run, self._run)
                ending.callback(self.thread.close)
                self.thread.call(self._swarm.begin_landing())

    def _end_run(self, run: SwarmRun) -> None:
        self.result = run.end()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
