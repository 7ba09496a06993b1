"""Supervision: each actor runs in a wrapper, so that its failure does not end the drone."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from crazychoir.runtime.actor import Actor
from crazychoir.runtime.clock import Clock

log = logging.getLogger(__name__)
STOP_DEADLINE = 2.0
"""Seconds for a cancelled actor to end, and the same again for its `on_stop`.

An actor that takes longer than both together is logged and left behind.
"""
CLEANING_DEADLINE = 0.5
"""Seconds for an `on_stop` that took too long to clean up, before the next actor stops."""

OnFailure = Callable[[Actor, Exception, bool], None]
"""Callback: called with the actor, its error, and whether the actor is started again."""


@dataclass(eq=False)
class _Child:
    """An actor under supervision."""

    actor: Actor
    """The actor."""
    task: "asyncio.Task[None]" = field(init=False)
    """The task that runs it."""
    failures: deque[float] = field(default_factory=deque)
    """Times in s of its failures within the window of its `restart`."""
    stopping: bool = False
    """True once its `on_stop` has begun."""


class Supervisor:
    """Runs the actors of one drone, and stops them in reverse order of creation.

    name: name of the drone in log lines
    on_failure: called when an actor fails
    """

    def __init__(
        self, clock: Clock, name: str, on_failure: OnFailure | None = None
    ) -> None:
        self.clock = clock
        self.name = name
        self.on_failure = on_failure or (lambda actor, error, again: None)
        self._children: list[_Child] = []
        self._stop = asyncio.Event()

    async def run(self, actors: list[Actor]) -> None:
        """Run all actors until they end, `stop` is called, or this task is cancelled.

        On return all have stopped.
        """
        self._children = [_Child(actor) for actor in actors]
        for child in self._children:
            child.task = asyncio.create_task(
                self._supervise(child), name=f"{self.name} {child.actor.name}"
            )
            child.task.add_done_callback(self._ended)
        try:
            if actors:
                await self._stop.wait()
        finally:
            await self._stop_children()

    def stop(self) -> None:
        """Ask the actors to stop in order."""
        self._stop.set()

    def _ended(self, task: "asyncio.Task[None]") -> None:
        if all(child.task.done() for child in self._children):
            self._stop.set()

    async def _stop_children(self) -> None:
        try:
            for child in reversed(self._children):
                await self._stop_child(child)
        except asyncio.CancelledError:  # cancelled a second time: wait no longer
            for child in self._children:
                child.task.cancel()
            raise

    async def _stop_child(self, child: _Child) -> None:
        if not child.stopping:
            child.task.cancel()
        _, late = await asyncio.wait(
            [child.task], timeout=2.0 * STOP_DEADLINE + CLEANING_DEADLINE
        )
        if late:
            log.error("%s %s: does not stop; left behind", self.name, child.actor.name)
        await self._finish(child)

    async def _supervise(self, child: _Child) -> None:
        try:
            while await self._fails(child):
                await self.clock.sleep(
                    child.actor.restart.backoff * 2.0 ** (len(child.failures) - 1)
                )
        finally:
            await self._finish(child)

    async def _fails(self, child: _Child) -> bool:
        """Run the actor. Return True if it failed and is to run again."""
        try:
            if child.failures:
                child.actor.on_restart()
            await child.actor.run()
        except asyncio.CancelledError as cancelled:
            if child.task.cancelling():
                raise
            return self._failed(
                child, RuntimeError(f"cancelled from inside: {cancelled!r}")
            )
        except Exception as error:  # noqa: BLE001 - a failing actor must not take the drone with it
            return self._failed(child, error)
        return False

    def _failed(self, child: _Child, error: Exception) -> bool:
        actor = child.actor
        again = not child.task.cancelling() and self._may_restart(child)
        log.error("%s %s failed: %s", self.name, actor.name, error, exc_info=error)
        try:
            self.on_failure(actor, error, again)
        except Exception:
            log.exception(
                "%s: error in what hears of the failure of %s", self.name, actor.name
            )
        return again

    def _may_restart(self, child: _Child) -> bool:
        now = self.clock.now()
        restart = child.actor.restart
        failures = child.failures
        while failures and now - failures[0] >= restart.window:
            failures.popleft()
        if len(failures) >= restart.limit:
            return False
        failures.append(now)
        return True

    async def _finish(self, child: _Child) -> None:
        """Call `on_stop` once: after `run`, or if `run` never began or does not end."""
        if child.stopping:
            return
        child.stopping = True
        # In a task of its own: before Python 3.11.3 no timeout ends in a task that was cancelled.
        # An `on_stop` that ignores its cancellation is left behind.
        stopping = asyncio.create_task(
            child.actor.on_stop(), name=child.task.get_name()
        )
        stopping.add_done_callback(_retrieve_error)
        try:
            done, _ = await asyncio.wait([stopping], timeout=STOP_DEADLINE)
        finally:
            stopping.cancel()
        is_late = not done
        if is_late:
            done, _ = await asyncio.wait([stopping], timeout=CLEANING_DEADLINE)
        ends = await asyncio.gather(*done, return_exceptions=True)
        error = ends[0] if ends else None
        if is_late and (error is None or isinstance(error, asyncio.CancelledError)):
            error = TimeoutError()
        # The next actor must still be stopped.
        if error is not None:
            log.error(
                "%s %s: on_stop failed, or took more than %g s",
                self.name,
                child.actor.name,
                STOP_DEADLINE,
                exc_info=error,
            )


def _retrieve_error(task: "asyncio.Task[None]") -> None:
    """Look at the error of a task, so that asyncio does not report it as forgotten."""
    if not task.cancelled():
        task.exception()
