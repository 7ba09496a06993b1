"""An actor: one task, one `run`, mailboxes for its inputs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Restart:
    """What its supervisor does when an actor fails: at most `limit` restarts in `window` s.

    backoff: s, before the first of them; doubles with each; 0: all of them at once.
    """

    limit: int = 0
    window: float = 10.0
    backoff: float = 0.1


NEVER = Restart()
ON_FAILURE = Restart(limit=5)


class Actor:
    """Subclass it, write `run`; set `restart` if it may be started again after a failure.

    `run` ends when its work is done. Only cancellation stops it from outside; `on_stop` runs in every case.
    """

    name: str = "actor"
    restart: Restart = NEVER

    async def run(self) -> None:
        """The actor's whole life."""
        raise NotImplementedError

    async def on_stop(self) -> None:
        """Leave things in order: called once, after `run` has ended for good."""

    def on_restart(self) -> None:
        """Called before `run` starts again: drop what a failed run left behind."""
