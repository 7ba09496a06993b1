"""The translation of a command into packets, and their way onto the link."""

from crazychoir.errors import CodecError
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.protocol.handlers import RadioHandler
from crazychoir.types import XYZ, Command


class CommandTransmitter:
    """Puts the packets of a command on the link.

    handler: translates the commands of the drone
    """

    def __init__(
        self, setup: DroneSetup, link: CurrentLink, handler: RadioHandler
    ) -> None:
        self.malformed = 0
        """Count of commands that do not fit into a packet."""
        self._setup = setup
        self._link = link
        self._handler = handler

    def transmit(self, command: Command) -> None:
        """Send a command over the connection in use: a set-point replaces the waiting one."""
        connection = self._link.connection
        assert connection is not None  # noqa: S101 - callers have looked
        try:
            packets = self._handler.packets(command)
        except CodecError as error:
            self.malformed += 1
            self._setup.warn("malformed", f"not sent: {error}")
            return
        if len(packets) == 1 and (
            not isinstance(command, XYZ) or command.verb == "line"
        ):
            connection.newest("command", packets[0])
        else:
            # A set-point after the plan would take control from the planner.
            connection.forget("command")
            self._link.send_all(packets)

    def relax(self) -> None:
        """Send that set-points have ended, which gives control to the planner on board."""
        self._link.send_all(self._handler.relax)
