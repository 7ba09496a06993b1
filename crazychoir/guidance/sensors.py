"""The sensor readings of a drone for its guidance: log variables with their ages.

The names are those of the firmware.
"""

import logging
from collections.abc import Callable, Iterable

from crazychoir.bus.port import Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.runtime.clock import NS_PER_SECOND, Clock
from crazychoir.runtime.mailbox import Call
from crazychoir.simulation.telemetry import check_log_names, check_log_period

log = logging.getLogger(__name__)
MOST_MISSED_PERIODS = 3.0
"""Periods without a value after which the last value is stale."""
Ask = Callable[[tuple[str, ...], float], None]
"""Requests log variables (names, period s) from the drone."""


class SensorReadings:
    """The newest values of some log variables.

    `readings["pm.vbat"]` is None before the first value, and when the last value is stale.
    """

    def __init__(self, clock: Clock, names: tuple[str, ...], max_age: float) -> None:
        self.clock = clock
        self.names = names
        self.max_age = max_age
        self._born_ns: dict[str, int] = {}
        self._values: dict[str, float] = {}

    def put(self, said: dict[str, list[float]], age: float) -> None:
        """Store new values. A value that is older than the stored value is ignored.

        said: {name: [value, s that it is older than the message]}.
        age: s: age of the message.
        """
        now_ns = self.clock.now_ns()
        for name in self.names:
            if name in said:
                value, old = said[name]
                born_ns = now_ns - round((age + old) * NS_PER_SECOND)
                if born_ns >= self._born_ns.get(name, born_ns):
                    self._values[name] = value
                    self._born_ns[name] = born_ns

    def __getitem__(self, name: str) -> float | None:
        if name not in self.names:
            raise KeyError(
                f"{name!r} was not asked for; there are {', '.join(self.names)}"
            )
        return self._values[name] if self.age(name) <= self.max_age else None

    def age(self, name: str) -> float:
        """Return the s since a value was measured; infinite before the first value."""
        born_ns = self._born_ns.get(name)
        return (
            float("inf")
            if born_ns is None
            else (self.clock.now_ns() - born_ns) / NS_PER_SECOND
        )

    def fresh(self) -> dict[str, float]:
        """Return all values that are not stale."""
        return {name: value for name in self.names if (value := self[name]) is not None}


class Sensors:
    """The log variables of one drone.

    port: the bus port of the drone.
    body: the address that publishes the variables.
    known: names of the variables, None if only the body knows them.
    ask: requests variables from the body. It raises ConfigError for unknown names, or logs them
        later.
    """

    def __init__(
        self, port: Port, body: int, known: Iterable[str] | None, ask: Ask
    ) -> None:
        self.port = port
        self.known = known
        self.ask = ask
        self._readings: dict[tuple[tuple[str, ...], float], SensorReadings] = {}
        self._body = body

    def log(self, names: tuple[str, ...], period: float) -> SensorReadings:
        """Return the newest values of these variables.

        names: names of the variables.
        period: s between two values.
        Raises ConfigError for names that do not exist.
        """
        if (names, period) in self._readings:
            return self._readings[names, period]
        clock = self.port.bus.clock
        self.check(names, period)
        self.ask(names, period)
        if not self._readings:
            told = Call(clock, self._told, f"drone {self.port.address} telemetry")
            self.port.bus.subscribe(
                DRONE_TOPICS.telemetry, self._body, self.port.address, told
            )
        readings = self._readings[names, period] = SensorReadings(
            clock, names, MOST_MISSED_PERIODS * period + DRONE_TOPICS.telemetry.max_age
        )
        return readings

    def check(self, names: tuple[str, ...], period: float) -> None:
        """Raise ConfigError for names that do not exist, as far as they are known here, or a wrong period."""
        where = f"drone {self.port.address}: log"
        check_log_period(period, where)
        if self.known is not None:
            check_log_names(names, self.known, where)

    def _told(self, said: dict[str, list[float]], age: float) -> None:
        for readings in self._readings.values():
            readings.put(said, age)
