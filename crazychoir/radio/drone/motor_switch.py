"""The motors of a drone: they are armed for a flight, and cut for good in an emergency."""

from crazychoir.errors import LinkFailed, Refused
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.radio.drone.background_tasks import BackgroundTasks
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.own_estimate import OwnEstimate
from crazychoir.radio.drone.timing import LINK_CHECK_RATE
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.firmware import ConnectedFirmware
from crazychoir.radio.protocol.handlers import emergency_packets


class MotorSwitch:
    """Arms the motors of one drone, and cuts them for good."""

    def __init__(
        self,
        setup: DroneSetup,
        link: CurrentLink,
        estimate: OwnEstimate,
        tasks: BackgroundTasks,
    ) -> None:
        self.is_cut = False
        """Whether the motors were cut for good."""
        self.is_cut_confirmed = False
        """Whether the drone is known to have obeyed the cut."""
        self._is_arming = False
        self._setup = setup
        self._link = link
        self._estimate = estimate
        self._tasks = tasks

    def cut(self) -> None:
        """Stop the motors for good.

        The packet is repeated until the drone is locked or was switched off and on.
        """
        self.is_cut = True
        if self.is_cut_confirmed:
            return
        if (way := self._link.connection or self._link.opening) is not None:
            way.urgent(emergency_packets())

    async def insist(self, connection: Connection) -> None:
        """Repeat the emergency stop of a cut drone until the drone confirms it.

        Runs as long as the link, from its opening on.
        """
        async for _ in self._setup.clock.ticks(LINK_CHECK_RATE):
            if self.is_cut and not self.is_cut_confirmed:
                connection.urgent(emergency_packets())

    def note_log(self) -> None:
        """Confirm the cut if the last log says that the drone is locked."""
        if self.is_cut and self._estimate.supervisor & SUPERVISOR_BITS.locked:
            self.is_cut_confirmed = True

    def note_restart(self) -> None:
        """Confirm the cut, because the drone was started again, which stops its motors."""
        self.is_cut_confirmed = self.is_cut

    def arm_for_flight(self) -> None:
        """Arm the drone, once a flight: its motors wait for this."""
        connection = self._link.connection
        if (
            self._estimate.supervisor & SUPERVISOR_BITS.armed
            or self._is_arming
            or connection is None
        ):
            return
        self._is_arming = True
        self._tasks.start(self._arm_in_flight(connection))

    async def _arm_in_flight(self, connection: Connection) -> None:
        try:
            await ConnectedFirmware(connection).arm()
        except LinkFailed as error:
            self._setup.warn("arm", str(error))
        finally:
            self._is_arming = False

    async def arm(self) -> str:
        """Arm the drone at once, without waiting for a first command; return the result as a text.

        The firmware disarms a drone that does not fly for a while. The first command of a flight
        then arms it again.
        Raises Refused if the drone cannot be armed.
        """
        if not self._setup.platform.firmware.needs_arming:
            return "ready: its firmware needs no arming"
        where = f"drone {self._setup.drone}"
        link = self._link
        if link.connection is None or self.is_cut:
            raise Refused(where, link.problem or link.why or "its motors were cut")
        try:
            await ConnectedFirmware(link.connection).arm()
        except LinkFailed as error:
            raise Refused(where, str(error)) from error
        return "armed"
