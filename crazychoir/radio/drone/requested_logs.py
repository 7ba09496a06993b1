"""Log variables that users ask for beside those of the flight."""

from collections.abc import Iterable

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.errors import LinkFailed
from crazychoir.radio.drone.background_tasks import BackgroundTasks
from crazychoir.radio.drone.current_link import CurrentLink
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.timing import CONNECT_ATTEMPTS
from crazychoir.radio.link.connection import Connection
from crazychoir.simulation.telemetry import check_log_period


class RequestedLogs:
    """Lets the drone log the variables that were asked for, over each connection."""

    def __init__(
        self, setup: DroneSetup, link: CurrentLink, tasks: BackgroundTasks
    ) -> None:
        self._setup = setup
        self._link = link
        self._tasks = tasks
        self._periods: dict[tuple[str, ...], float] = {}

    def ask(self, names: Iterable[str], period: float) -> None:
        """Let the drone log these variables too, from now on.

        Unknown variables are reported in the log.

        period: s
        """
        check_log_period(period, f"drone {self._setup.drone}: log")
        variables = tuple(names)
        self._periods[variables] = period
        if self._link.connection is not None:
            self._tasks.start(self._begin(self._link.connection, variables, period))

    async def begin_all(self, connection: Connection) -> None:
        """Start all logs that were asked for so far."""
        for names, period in list(self._periods.items()):
            await self._begin(connection, names, period)

    async def _begin(
        self, connection: Connection, names: tuple[str, ...], period: float
    ) -> None:
        try:
            await connection.log(
                "asked",
                names,
                period,
                self._publish,
                CONNECT_ATTEMPTS.reopen_deadline,
            )
        except LinkFailed as error:
            self._setup.warn("log", str(error))

    def _publish(self, values: dict[str, float], at: int) -> None:
        self._setup.port.publish(
            DRONE_TOPICS.telemetry,
            {name: [float(value), 0.0] for name, value in values.items()},
        )
