"""What a drone says about itself: its own estimate, its battery and its supervisor."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.dongle_plan import RADIO_TRAFFIC
from crazychoir.errors import LinkFailed
from crazychoir.firmware.supervision import SUPERVISOR_BITS
from crazychoir.numerics.math3d import quaternion_of_yaw, quaternion_product
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.timing import (
    CONNECT_ATTEMPTS,
    LINK_CHECK_RATE,
    SILENCE_LIMITS,
)
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.protocol.compressed import unpack_quaternion
from crazychoir.radio.uptime import Uptime
from crazychoir.runtime.clock import NS_PER_SECOND
from crazychoir.types import Pose, State, Vec

LOG_UNIT = 1e-3
"""SI units in a unit of the logs (mm, mm/s)."""


@dataclass(frozen=True, slots=True)
class LogNames:
    """Names of the log variables that are read from a drone."""

    estimate: tuple[str, ...] = (
        "stateEstimateZ.x",
        "stateEstimateZ.y",
        "stateEstimateZ.z",
        "stateEstimateZ.vx",
        "stateEstimateZ.vy",
        "stateEstimateZ.vz",
        "stateEstimateZ.quat",
    )
    """Log variables of the drone's own estimate."""
    health: tuple[str, ...] = ("pm.vbat", "supervisor.info")
    """Log variables of its battery and its supervisor."""
    variances: tuple[str, ...] = ("kalman.varX", "kalman.varY", "kalman.varZ")
    """Log variables with the variances of the drone's own position."""


LOG_NAMES = LogNames()


class OwnEstimate:
    """Starts the logs of a drone, and keeps the last values in the frame of the world.

    restarted: called when a log shows that the drone was started again
    logged: called after each log with the time in s when it was taken, and the drone's attitude
    """

    def __init__(
        self,
        setup: DroneSetup,
        restarted: Callable[[], None],
        logged: Callable[[float, Vec], None],
    ) -> None:
        self.state: State | None = None
        """Last state in the world; None before the first log."""
        self.state_ns = 0
        """ns: when the last state arrived; 0 before the first log."""
        self.logs_ns = 0
        """ns: when the logs were last started."""
        self.health: dict[str, float] = {}
        """Battery and supervisor by name; empty before the first log."""
        self.variances: dict[str, float] = {}
        """m2: variances of the position by name, for a drone without cameras."""
        self.uptime = Uptime()
        """Clock of the drone."""
        self._setup = setup
        self._clock = setup.clock
        self._restarted = restarted
        self._logged = logged

    @property
    def supervisor(self) -> int:
        """Bits of the firmware's supervisor; 0 before the first log."""
        return int(self.health.get("supervisor.info", 0))

    @property
    def battery(self) -> float:
        """V; NaN before the first log."""
        return self.health.get("pm.vbat", math.nan)

    @property
    def is_flying(self) -> bool:
        """Whether the motors turn, or have turned within 2 s."""
        return bool(int(self.health.get("supervisor.info", 0)) & SUPERVISOR_BITS.flying)

    @property
    def has_arrived(self) -> bool:
        """Whether a log has arrived since the logs were last started."""
        return self.state_ns > self.logs_ns

    @property
    def is_overdue(self) -> bool:
        """Whether the drone has dropped its logs: none has arrived for too long."""
        last_ns = max(self.state_ns, self.logs_ns)
        return (
            self._clock.now_ns() - last_ns > SILENCE_LIMITS.logs_dropped * NS_PER_SECOND
        )

    async def begin_logs(self, connection: Connection) -> None:
        """Let the drone send its logs. Raises LinkFailed if it does not start in time."""
        setup = self._setup
        rate = setup.config.radio.log_rate
        seconds = CONNECT_ATTEMPTS.reopen_deadline
        if setup.seen_by_cameras:
            rate = max(rate, RADIO_TRAFFIC.least_attitude_rate)
        self.logs_ns = self._clock.now_ns()
        await connection.log(
            "own",
            (*LOG_NAMES.estimate, *LOG_NAMES.health),
            1.0 / rate,
            self.take_log,
            seconds,
        )
        if not setup.seen_by_cameras:
            await connection.log(
                "spread",
                LOG_NAMES.variances,
                1.0 / RADIO_TRAFFIC.uncertainty_rate,
                self._take_variances,
                seconds,
            )

    async def reset_logs(self, connection: Connection) -> None:
        """Start the logs again, because the drone sends none any more.

        Raises LinkFailed if they do not start in time.
        """
        self.logs_ns = self._clock.now_ns()
        await connection.reset_logs(CONNECT_ATTEMPTS.reopen_deadline)
        await self.begin_logs(connection)

    async def wait_for_log(self, connection: Connection) -> None:
        """Wait until the drone has told whether it flies: another program may have started it.

        Raises LinkFailed if it does not tell in time.
        """
        for _ in range(round(CONNECT_ATTEMPTS.reopen_deadline * LINK_CHECK_RATE)):
            if self.has_arrived:
                return
            await self._clock.sleep(1.0 / LINK_CHECK_RATE)
        raise LinkFailed(
            connection.uri,
            f"sends no status within {CONNECT_ATTEMPTS.reopen_deadline:g} s",
        )

    def take_log(self, values: dict[str, float], at: int) -> None:
        """Take the values of a log; a log that a newer one has overtaken is dropped.

        at: ms since the drone's start
        """
        if self.uptime.restarted(self._clock.now(), at):
            self._restarted()
            self.uptime = Uptime()
        if self.uptime.overtaken(at):
            return
        taken = self.uptime.taken(self._clock.now(), at)
        self.health = {name: values[name] for name in LOG_NAMES.health}
        p = LOG_UNIT * np.array([values[name] for name in LOG_NAMES.estimate[0:3]])
        v = LOG_UNIT * np.array([values[name] for name in LOG_NAMES.estimate[3:6]])
        q = unpack_quaternion(int(values[LOG_NAMES.estimate[6]]))
        p, v, q = self._transform_to_world(p, v, q)
        self.state = State(np.array([*p, *v, *q, 0.0, 0.0, 0.0]))
        self.state_ns = self._clock.now_ns()
        self._logged(taken, q)
        if not self._setup.seen_by_cameras:
            port = self._setup.port
            port.publish(DRONE_TOPICS.pose, Pose(np.array([*p, *q])))
            port.publish(DRONE_TOPICS.truth, self.state)

    def _take_variances(self, values: dict[str, float], at: int) -> None:
        self.variances = values

    def _transform_to_world(self, p: Vec, v: Vec, q: Vec) -> tuple[Vec, Vec, Vec]:
        """Return p, v and q in the world, from the frame of the drone's own estimate.

        That frame is the world if the drone is told the cameras' poses; otherwise [radio] gives its
        origin and yaw.

        p: (3,) m
        v: (3,) m/s
        q: (4,)
        """
        radio = self._setup.config.radio
        if self._setup.seen_by_cameras or (
            radio.origin_yaw == 0.0 and not any(radio.origin)
        ):
            return p, v, q
        c = math.cos(radio.origin_yaw)
        s = math.sin(radio.origin_yaw)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        a = quaternion_of_yaw(radio.origin_yaw).tolist()
        b = q.tolist()
        turned = np.array(
            quaternion_product((a[0], a[1], a[2], a[3]), (b[0], b[1], b[2], b[3]))
        )
        return turn @ p + np.array(radio.origin), turn @ v, turned
