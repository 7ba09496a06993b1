"""The body of a drone as its pilot sees it: in a world of this process, of another one, or behind a radio."""

from typing import Protocol

from crazychoir.safety.rules.radio_watch import RadioWatch
from crazychoir.simulation.common.world import DroneLink
from crazychoir.simulation.remote import RemoteLink
from crazychoir.types import Command


class DroneBody(Protocol):
    """What a pilot sends to a body, and asks of it."""

    is_watched: bool
    """Whether the pilot must ask the body in each tick."""

    def send(self, command: Command) -> None:
        """Let the body obey this command until the next one."""
        ...

    def cut(self) -> None:
        """Stop the motors for good."""
        ...

    def is_turning(self) -> bool:
        """Return whether the motors turn or the body flies, as its owner or its firmware says."""
        ...

    def is_unheard(self) -> bool:
        """Return whether the owner of the body is silent.

        Commands do not arrive there then, and it lands the body without them.
        """
        ...

    def list_problems(self) -> list[str]:
        """Return the reasons of the body against a take-off."""
        ...

    def explain_astray(self) -> str:
        """Return how the body that the cameras take for the drone moved unlike it.

        Returns an empty text if it has not.
        """
        ...


class LocalBody:
    """A body in a world of this process.

    link: of the world
    """

    is_watched = False

    def __init__(self, link: DroneLink) -> None:
        self.link = link

    def send(self, command: Command) -> None:
        """Let the body obey this command until the next one."""
        self.link.send(command)

    def cut(self) -> None:
        """Stop the motors for good."""
        self.link.cut()

    def is_turning(self) -> bool:
        """Return False: nothing but the pilot turns the motors."""
        return False

    def is_unheard(self) -> bool:
        """Return False: this process is its owner."""
        return False

    def list_problems(self) -> list[str]:
        """Return no problems."""
        return []

    def explain_astray(self) -> str:
        """Return an empty text: no body is mistaken for another one."""
        return ""


class DistantBody:
    """A body in a world that another process owns.

    remote: link to that process
    """

    is_watched = True

    def __init__(self, remote: RemoteLink) -> None:
        self.remote = remote

    def send(self, command: Command) -> None:
        """Let the body obey this command until the next one."""
        self.remote.send(command)

    def cut(self) -> None:
        """Stop the motors for good."""
        self.remote.cut()

    def is_turning(self) -> bool:
        """Return whether the body flies, as its owner says."""
        return self.remote.flying()

    def is_unheard(self) -> bool:
        """Return whether the owner of the body is silent."""
        return self.remote.unheard()

    def list_problems(self) -> list[str]:
        """Return why the body may not take off, as its owner says."""
        return self.remote.problems()

    def explain_astray(self) -> str:
        """Return an empty text: the owner of a world confuses no bodies."""
        return ""


class RadioBody:
    """A Crazyflie behind a radio; another process owns the dongle.

    remote: link to that process
    watch: of the radio
    """

    is_watched = True

    def __init__(self, remote: RemoteLink, watch: RadioWatch) -> None:
        self.remote = remote
        self.watch = watch

    def send(self, command: Command) -> None:
        """Let the drone obey this command until the next one."""
        self.remote.send(command)

    def cut(self) -> None:
        """Stop the motors for good."""
        self.remote.cut()

    def is_turning(self) -> bool:
        """Return whether the motors turn, as the firmware says."""
        return self.watch.turning()

    def is_unheard(self) -> bool:
        """Return whether the owner of the dongle is silent."""
        return self.remote.unheard()

    def list_problems(self) -> list[str]:
        """Return why the drone may not take off, as its radio says."""
        return self.watch.problems()

    def explain_astray(self) -> str:
        """Return how the body that the cameras take for the drone moved unlike it."""
        return self.watch.astray()
