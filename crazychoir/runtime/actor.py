"""An actor: one task, one `run` method, and mailboxes for its inputs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RestartPolicy:
    """The restarts that a supervisor allows an actor that fails."""

    limit: int = 0
    """Most restarts within `window`; a further failure ends the actor."""
    window: float = 10.0
    """Seconds in which restarts are counted."""
    backoff: float = 0.1
    """Seconds before the first restart; doubles with each restart. 0: restart at once, always."""


NEVER_RESTART = RestartPolicy()
"""Do not restart the actor."""
RESTART_ON_FAILURE = RestartPolicy(limit=5)
"""Restart the actor at most 5 times in 10 s."""


class Actor:
    """A task of a drone.

    A subclass writes `run`, and sets `restart` if it may run again after a failure. `run` ends when
    its work is done. From outside only a cancellation stops it. `on_stop` runs in every case.
    """

    name: str = "actor"
    """Name in log lines and reports."""
    restart: RestartPolicy = NEVER_RESTART
    """Restarts that the supervisor allows this actor."""

    async def run(self) -> None:
        """Do the work of the actor, from its start to its end."""
        raise NotImplementedError

    async def on_stop(self) -> None:
        """Release what the actor holds. Called once, after `run` has ended for good."""

    def on_restart(self) -> None:
        """Drop what a failed run left behind. Called before `run` starts again."""
